import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from calib.board.chessboard import Board
from calib.cameras.bundle import Pose
from calib.files.formats import BodyPose, load_cameras, load_rig, save_rig
from estimator.cli import app
from estimator.commands.common import image_source
from logs.store.recorder import Recorder
from logs.wire.codec import encode_input
from logs.wire.images import encode_image
from models import so3
from models.camera import CameraModel, StereoRig
from models.frames import GRAVITY
from models.messages import ImuSample, vec3
from tests.boards import motion as synthetic_motion
from tests.boards import views as synthetic
from tests.boards.motion import EUROC_NOISE, Truth

BOARD = Board(7, 5, 0.03)
LEFT = CameraModel(320, 240, 270.0, 271.0, 158.0, 121.0, (-0.2, 0.05, 0.0, 0.0))
RIGHT = CameraModel(320, 240, 268.0, 269.0, 161.0, 119.0, (-0.21, 0.06, 0.0, 0.0))
RIG = StereoRig(
    LEFT, RIGHT, so3.matrix(so3.quat_exp(np.array([0.005, 0.01, -0.004]))), np.array([-0.06, 0.001, 0.0]), np.eye(3), np.zeros(3)
)
SIZE = ("--board", "7x5", "--square-mm", "30", "--lens", "4")


def run(*args: object) -> Result:
    return CliRunner().invoke(app, ["calibrate", *(str(a) for a in args)])


def fails(*args: object) -> str:
    """The one line on stderr of a command that fails."""
    result = run(*args)
    assert result.exit_code == 1, result.output
    assert result.stderr.count("\n") == 1
    assert "internal error" not in result.stderr
    return result.stderr.removeprefix("landfix: ").strip()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve rendered pairs left_00.png, right_00.png; no EXIF in them."""
    folder = tmp_path_factory.mktemp("images")
    rng = np.random.default_rng(3)
    painters = [synthetic.Painter(c, BOARD) for c, _ in synthetic.both(RIG)]
    for k, pose in enumerate(synthetic.poses(synthetic.both(RIG), BOARD, 12, rng)):
        for name, painter, (_, place) in zip(("left", "right"), painters, synthetic.both(RIG), strict=True):
            seen = Pose(place.R @ pose.R, place.of(pose.t[None])[0])
            cv2.imwrite(str(folder / f"{name}_{k:02d}.png"), painter.paint(seen, rng))
    return folder


def test_mono_writes_camera_report_and_picture(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "camera.xml"
    text = run("mono", folder / "left_*.png", *SIZE, "-o", out)
    assert text.exit_code == 0, text.output
    assert "Verdict: " in text.stdout
    camera = load_cameras(out, BodyPose(np.eye(3), np.zeros(3), np.eye(6))).left
    assert camera.fx == pytest.approx(270.0, rel=0.01)
    assert camera.covariance is not None
    page = (tmp_path / "camera.html").read_text()
    for part in ("Judged by", "left_00.png", "data:image/png;base64,", "sigma"):
        assert part in page
    assert (tmp_path / "camera.png").read_bytes().startswith(b"\x89PNG")
    facts = json.loads(run("mono", folder / "left_*.png", *SIZE, "-o", out, "--json").stdout)
    assert facts["verdict"] in {"good", "usable"}
    assert 0.02 < facts["rms_px"] < 0.4
    assert len(facts["camera"]["sigma"]) == 8


def test_mono_with_a_mount_writes_a_rig_of_one_camera(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "camera.yaml"
    text = run("mono", folder / "left_*.png", *SIZE, "-o", out, "--mount", "0.1,0.0,0.05,0,-90,0")
    assert text.exit_code == 0, text.output
    rig = load_cameras(out)
    assert rig.one_camera
    np.testing.assert_allclose(rig.p_bc, (0.1, 0.0, 0.05))
    np.testing.assert_allclose(rig.R_bc @ (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), atol=1e-12)  # it looks down,
    np.testing.assert_allclose(rig.R_bc @ (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), atol=1e-12)  # the upper edge is forward


def test_stereo_writes_a_rig_that_is_where_the_mount_reports(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "rig.yaml"
    pairs = ("--left", folder / "left_*.png", "--right", folder / "right_*.png")
    facts = json.loads(run("stereo", *pairs, *SIZE, "-o", out, "--mount", "0.1,0.0,0.05,0,-90,0", "--json").stdout)
    assert facts["baseline_m"] == pytest.approx(0.06, abs=1e-3)
    assert 0.01 < facts["row_error_px"] < 0.3 < facts["epipolar_before_px"]
    rig = load_rig(out)
    np.testing.assert_allclose(rig.t_rc, RIG.t_rc, atol=2e-3)
    np.testing.assert_allclose(rig.p_bc, (0.1, 0.0, 0.05))
    np.testing.assert_allclose(rig.R_bc @ np.array([0.0, 0.0, 1.0]), (0.0, 0.0, 1.0), atol=1e-12)  # looks down
    np.testing.assert_allclose(rig.R_bc @ np.array([0.0, -1.0, 0.0]), (1.0, 0.0, 0.0), atol=1e-12)  # upper edge forward
    assert rig.covariance_bc is not None
    np.testing.assert_allclose(np.sqrt(np.diagonal(rig.covariance_bc)), [0.02] * 3 + [np.deg2rad(1.0)] * 3)
    assert run("stereo", *pairs, *SIZE, "-o", out).exit_code == 0
    unknown = load_rig(out).covariance_bc
    assert unknown is not None
    assert unknown[0, 0] >= 9e4


def test_convert_and_back(tmp_path: Path) -> None:
    save_rig(tmp_path / "rig.yaml", RIG)
    for name, form in (("a.yaml", "kalibr"), ("b.xml", "opencv"), ("c.yaml", "ros")):
        assert run("convert", tmp_path / "rig.yaml", "-o", tmp_path / name, "--to", form).exit_code == 0
    for name in ("a.yaml", "b.xml", "c_left.yaml"):
        np.testing.assert_allclose(load_rig(tmp_path / name).t_rc, RIG.t_rc, atol=1e-12)
    assert "no such file" in fails("convert", tmp_path / "none.yaml", "-o", tmp_path / "x.yaml")


def test_bad_images_are_one_line_that_reports_what_to_do(folder: Path, tmp_path: Path) -> None:
    out = ("-o", tmp_path / "x.yaml")
    left = sorted(folder.glob("left_*.png"))
    assert "3 usable views" in fails("mono", *left[:3], *SIZE, *out)
    assert "take more images" in fails("mono", *left[:3], *SIZE, *out)
    wrong = fails("mono", *left[:5], "--board", "9x6", *out)
    assert "7x5 inner corners: is --board right?" in wrong
    part = fails("mono", *left[:6], "--board", "6x5", *out)
    assert "a board of 7x5 inner corners, not 6x5: is --board right?" in part
    assert "all alike" in fails("mono", *[left[0]] * 8, *SIZE, *out)
    assert "squares of 25 m: --square-mm is the side of one square in millimetres" in fails(
        "mono", *left, "--board", "7x5", "--square-mm", "25000", *out
    )
    blurred, empty, large = tmp_path / "blurred", tmp_path / "empty", tmp_path / "large"
    for made in (blurred, empty, large):
        made.mkdir()
    for k, path in enumerate(left):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        cv2.imwrite(str(blurred / path.name), cv2.GaussianBlur(image, (0, 0), 3.0))
        cv2.imwrite(str(empty / path.name), np.full((240, 320), 90 + k, np.uint8))
        cv2.imwrite(str(large / path.name), cv2.resize(image, (640, 480)) if k % 2 else image)
    assert "blurred: hold the board still" in fails("mono", blurred, *SIZE, *out)
    assert "no 7x5 board found in 12 images" in fails("mono", empty, *SIZE, *out)
    assert "different sizes" in fails("mono", large, *SIZE, *out)
    assert "exchange --left and --right" in fails(
        "stereo", "--left", folder / "right_*.png", "--right", folder / "left_*.png", *SIZE, *out
    )


def test_an_image_that_cannot_be_read_is_left_out_with_its_reason(folder: Path, tmp_path: Path) -> None:
    """Two folders with the same names, too: each image stands for itself."""
    for k in (1, 2):
        (tmp_path / str(k)).mkdir()
        for path in sorted(folder.glob("left_*.png"))[6 * k - 6 : 6 * k]:
            (tmp_path / str(k) / f"{int(path.stem[-2:]) % 6}.png").write_bytes(path.read_bytes())
    (tmp_path / "1" / "torn.png").write_bytes((tmp_path / "1" / "0.png").read_bytes()[:900])
    (tmp_path / "2" / "empty.jpg").write_bytes(b"")
    facts = json.loads(run("mono", tmp_path / "1", tmp_path / "2", *SIZE, "-o", tmp_path / "x.yaml", "--json").stdout)
    assert set(facts["unused"]) == {"torn.png", "empty.jpg"}
    assert all("no image that can be read" in reason for reason in facts["unused"].values())
    assert facts["figures"]["views short of 20"] == 8


def test_files_that_cannot_be_written_are_reported_of_before_the_work(tmp_path: Path) -> None:
    board, log = tmp_path / "board.png", tmp_path / "log.mcap"  # empty: an error if they were read first
    board.touch()
    log.touch()
    nowhere = ("-o", tmp_path / "no" / "x.yaml")
    assert "cannot be written" in fails("mono", board, *nowhere)
    assert "it is a folder" in fails("mono", board, "-o", tmp_path)
    assert "the report is written there" in fails("mono", board, "-o", tmp_path / "x.html")
    assert "would overwrite the input" in fails("mono", tmp_path / "*.png", "-o", tmp_path / "board.yaml")  # its report's picture
    assert "would overwrite the input" in fails("imu", log, "-o", log)
    assert "cannot be written" in fails("imu", log, "--report", tmp_path / "no" / "x.html")
    assert "cannot be written" in fails("camera-imu", log, "--rig", board, *nowhere)
    assert "cannot be written" in fails("stereo", "--left", board, "--right", board, *nowhere)


class TwoCameras:
    """Stands in for cv2.VideoCapture: what a right camera hands over is what the left one grabbed last."""

    def __init__(self, folder: Path) -> None:
        self.frames = {side: sorted(folder.glob(f"{side}_*.png")) for side in ("left", "right")}
        self.now = -1

    def __call__(self, side: str) -> "TwoCameras.One":
        return self.One(self, side)

    class One:
        def __init__(self, both: "TwoCameras", side: str) -> None:
            self.both, self.side = both, side

        def isOpened(self) -> bool:
            return True

        def grab(self) -> bool:
            self.both.now += self.side == "left"
            return self.both.now < 12

        def retrieve(self) -> tuple[bool, object]:
            return True, cv2.imread(str(self.both.frames[self.side][self.both.now]))


def test_two_live_cameras_take_their_images_together(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(image_source, "_LIVE_S", 0.0)
    monkeypatch.setattr(cv2, "VideoCapture", TwoCameras(folder))
    live = ("--left", "camera:left", "--right", "camera:right")
    facts = json.loads(run("stereo", *live, *SIZE, "-o", tmp_path / "rig.yaml", "--json").stdout)
    assert facts["baseline_m"] == pytest.approx(0.06, abs=1e-3)
    assert facts["figures"]["views short of 20"] == 8
    dark = TwoCameras(folder)
    dark.now = 12
    monkeypatch.setattr(cv2, "VideoCapture", dark)
    assert "gives no image" in fails("mono", "camera:left", "-o", tmp_path / "x.yaml")


def test_bad_sources_are_one_line(folder: Path, tmp_path: Path) -> None:
    out = ("-o", tmp_path / "x.yaml")
    (tmp_path / "no.png").write_text("no image")
    (tmp_path / "no.mp4").write_text("no video")
    (tmp_path / "empty").mkdir()
    assert "no image that can be read" in fails("mono", tmp_path / "no.png", *out)
    assert "no video that can be read" in fails("mono", tmp_path / "no.mp4", *out)
    assert "no images in this folder" in fails("mono", tmp_path / "empty", *out)
    assert "no file has such a name" in fails("mono", tmp_path / "q*.png", *out)
    assert "no such file" in fails("mono", tmp_path / "nowhere.png", *out)
    assert "cannot be opened" in fails("mono", "camera:/nowhere", *out)
    (tmp_path / "other").mkdir()
    for path in folder.glob("right_*.png"):
        (tmp_path / "other" / path.name.replace("right_0", "right_9").replace("right_1", "right_8")).write_bytes(
            path.read_bytes()
        )
    assert "must have the same number" in fails(
        "stereo", "--left", folder / "left_*.png", "--right", tmp_path / "other", *SIZE, *out
    )
    assert "cannot be written" in fails("mono", folder / "left_*.png", *SIZE, "-o", tmp_path / "no" / "x.yaml")
    assert run("mono", folder, "--board", "nine", *out).exit_code == 2
    assert run("stereo", "--left", folder, "--right", folder, "--mount", "1,2", *out).exit_code == 2


def test_dlt(tmp_path: Path) -> None:
    rng, K = np.random.default_rng(0), np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])
    x_o = rng.uniform((-1, -1, 4), (1, 1, 6), (12, 3))
    u = x_o @ K.T
    rows = [f"{x},{y},{z},{a},{b}" for (x, y, z), (a, b) in zip(x_o, u[:, :2] / u[:, 2:], strict=True)]
    (tmp_path / "points.csv").write_text("\n".join(["X,Y,Z,u,v", *rows]))
    shifted = tmp_path / "shifted.csv"
    shifted.write_text(
        "\n".join(f"{x},{y},{z - 5.0},{a},{b}" for (x, y, z), (a, b) in zip(x_o, u[:, :2] / u[:, 2:], strict=True))
    )
    facts = json.loads(run("dlt", shifted, "--json").stdout)
    np.testing.assert_allclose(facts["location_m"], (0.0, 0.0, -5.0), atol=1e-6)
    assert facts["rms_px"] < 1e-6
    assert "in the plane of the camera" in fails("dlt", tmp_path / "points.csv")
    (tmp_path / "torn.csv").write_text("\n".join([*rows, "1,2,3"]))
    assert "line 13" in fails("dlt", tmp_path / "torn.csv")
    assert "No such file" in fails("dlt", tmp_path / "none.csv")


def imu_log(path: Path, seconds: float, still: bool, broken: int = 0) -> None:
    """broken: so many samples are NaN."""
    rng = np.random.default_rng(0)
    with Recorder(path) as log:
        for k in range(int(100 * seconds)):
            t_ns = 1_700_000_000_000_000_000 + k * 10_000_000
            shake = np.zeros(3) if still else 3.0 * rng.normal(size=3)
            gyro, accel = rng.normal(0.0, 2e-3, 3) + shake, np.array([0.0, 0.0, -GRAVITY]) + rng.normal(0.0, 0.02, 3) + shake
            gyro = gyro if k % 100 or k >= 100 * broken else np.full(3, np.nan)
            log.write(*encode_input(ImuSample(t_ns, t_ns, vec3(gyro), vec3(accel))), t_ns)


def test_imu_noise_in_the_units_of_the_configuration(tmp_path: Path) -> None:
    log, out = tmp_path / "still.mcap", tmp_path / "imu.toml"
    imu_log(log, 60.0, still=True)
    facts = json.loads(run("imu", log, "-o", out, "--json").stdout)
    assert facts["config"]["gyro_noise"] == pytest.approx(2e-4, rel=0.1)
    assert facts["config"]["accel_noise"] == pytest.approx(2e-3, rel=0.1)
    from estimator.config import load  # noqa: PLC0415  (the program imports it late, too)

    assert load(out).imu.gyro_noise == pytest.approx(2e-4, rel=0.1)
    assert (tmp_path / "still.png").exists()
    assert "random walk" in run("imu", log).stdout
    assert "missing: axis" in fails("imu", log, "--six")


def test_imu_logs_that_cannot_be_used_are_one_line(tmp_path: Path) -> None:
    log, empty = tmp_path / "shaken.mcap", tmp_path / "empty.mcap"
    imu_log(log, 20.0, still=False)
    assert "let it lie still" in fails("imu", log)
    with Recorder(empty):
        pass
    assert "no IMU in it" in fails("imu", empty)
    assert "no such file" in fails("imu", tmp_path / "none.mcap").lower()
    imu_log(log, 20.0, still=True, broken=9)
    few = run("imu", log, "--json")
    assert "9 IMU samples are not finite and are left out" in few.stderr
    assert json.loads(few.stdout)["config"]["gyro_noise"] == pytest.approx(2e-4, rel=0.15)
    imu_log(log, 4.0, still=True, broken=5)
    assert "4 of 400 IMU samples are not finite" in fails("imu", log)


def test_camera_imu_from_a_log_of_images(tmp_path: Path) -> None:
    """Ten seconds of rendered images, encoded as JPEG: the whole way from pixels to the rig on the body."""
    rng = np.random.default_rng(1)
    R_bc = so3.matrix(so3.quat_exp(np.array([0.1, -0.2, 0.05]))) @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    true = Truth(R_bc, np.array([0.05, -0.02, 0.03]), 0.012, 10.0, camera_hz=10.0, distance_m=0.6)
    imu, stamps, views, motion = synthetic_motion.record(true, LEFT, BOARD, EUROC_NOISE, rng)
    painter, log = synthetic.Painter(LEFT, BOARD), tmp_path / "moving.mcap"
    with Recorder(log) as recorder:
        for t_ns, gyro, accel in zip(imu.t_ns.tolist(), imu.gyro, imu.accel, strict=True):
            recorder.write(*encode_input(ImuSample(t_ns, t_ns, vec3(gyro), vec3(accel))), t_ns)
        for t_ns in stamps.tolist():
            R_oc, p_o = motion.camera(1e-9 * (t_ns - int(imu.t_ns[0])) + true.time_offset_s)
            image = painter.paint(Pose(R_oc.T, -R_oc.T @ p_o), rng)
            recorder.write(*encode_image(t_ns, image, "/left/image", jpeg_quality=95), t_ns)
    save_rig(tmp_path / "rig.yaml", RIG)
    (tmp_path / "imu.toml").write_text(
        f"[imu]\ngyro_noise = {EUROC_NOISE.gyro_noise}\naccel_noise = {EUROC_NOISE.accel_noise}\n"
        f"gyro_walk = {EUROC_NOISE.gyro_walk}\naccel_walk = {EUROC_NOISE.accel_walk}\n"
    )
    common = (log, "--rig", tmp_path / "rig.yaml", "--board", "7x5", "--square-mm", "30", "-c", tmp_path / "imu.toml")
    done = run("camera-imu", *common, "-o", tmp_path / "out.yaml", "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["images"] > 50
    found = load_rig(tmp_path / "out.yaml")
    assert found.time_offset_s == pytest.approx(0.012, abs=5e-4)
    np.testing.assert_allclose(found.p_bc, true.p_bc, atol=5e-3)
    turn = so3.quat_log(so3.from_matrix(np.ascontiguousarray(true.R_bc @ found.R_bc.T)))
    assert np.rad2deg(np.linalg.norm(turn)) < 0.2
    assert found.covariance_bc is not None
    assert found.covariance_bc[0, 0] < 1e-5
    assert "Camera on the body" in (tmp_path / "out.html").read_text()
    other = StereoRig(CameraModel(640, 480, 500, 500, 320, 240), RIGHT, RIG.R_rc, RIG.t_rc, RIG.R_bc, RIG.p_bc)
    save_rig(tmp_path / "other.yaml", other)
    wrong = fails("camera-imu", log, "--rig", tmp_path / "other.yaml", "--board", "7x5", "-o", tmp_path / "x.yaml")
    assert "calibrated for 640 x 480" in wrong
    assert len(views) == len(stamps) > 50


def test_pairs_of_a_log_are_made_by_stamp_and_of_videos_by_frame(folder: Path, tmp_path: Path) -> None:
    log, stamp_ns = tmp_path / "pairs.mcap", 1_700_000_000_000_000_000
    images = {
        side: [np.asarray(cv2.imread(str(p), cv2.IMREAD_GRAYSCALE)) for p in sorted(folder.glob(f"{side}_*.png"))]
        for side in ("left", "right")
    }
    with Recorder(log) as recorder:
        for k, (left, right) in enumerate(zip(images["left"], images["right"], strict=True)):
            t_ns = stamp_ns + k * 200_000_000
            if k != 3:  # one left image was lost: frames no longer count alike
                recorder.write(*encode_image(t_ns, np.asarray(left, np.uint8), "/left/image"), t_ns)
            recorder.write(*encode_image(t_ns + 2_000_000, np.asarray(right, np.uint8), "/right/image"), t_ns)
    facts = json.loads(run("stereo", "--left", log, "--right", log, *SIZE, "-o", tmp_path / "rig.yaml", "--json").stdout)
    assert facts["row_error_px"] < 0.3
    assert list(facts["unused"].values()) == ["no partner with a view of the board"]
    assert "no images under /other in it" in fails(
        "stereo", "--left", log, "--right", log, "--left-topic", "/other", "-o", tmp_path / "x.yaml"
    )
    for side, frames in images.items():
        video = cv2.VideoWriter(str(tmp_path / f"{side}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 5.0, (320, 240))
        for frame in frames:
            video.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
        video.release()
    filmed = json.loads(
        run(
            "stereo",
            "--left",
            tmp_path / "left.avi",
            "--right",
            tmp_path / "right.avi",
            *SIZE,
            "-o",
            tmp_path / "v.yaml",
            "--json",
        ).stdout
    )
    assert filmed["baseline_m"] == pytest.approx(0.06, abs=2e-3)
