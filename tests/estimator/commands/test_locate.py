"""landfix locate on a rendered pair, from files."""

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner, Result

from calib.errors import CalibrationError
from calib.files.formats import load_rig, save_camera, save_rig
from calib.files.rig_yaml import FORWARD
from estimator.cli import app
from estimator.commands.photo import fitted as photo
from models import so3
from models.camera import CameraModel
from models.frames import Origin
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_pair
from vision.synthetic.scenes import WorldSpec, make_world

P_N, EULER = np.array([0.0, 0.0, -80.0]), (0.04, -0.03, 0.7)


def run(*args: object) -> Result:
    return CliRunner().invoke(app, ["locate", *map(str, args)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """left.png, right.png, rig.yaml, map.geojson, prior.txt (5 m off)."""
    out = tmp_path_factory.mktemp("locate")
    spec = WorldSpec("lookalikes", painted=1.0, area_m=240.0, sigma_m=0.2, height_sigma_m=0.1, outline_sigma_m=0.05)
    scene = make_world(2, spec)
    left, right = render_pair(
        scene.world, scene.rig, P_N, so3.matrix(so3.from_euler(*EULER)), Conditions(), np.random.default_rng(1)
    )
    cv2.imwrite(str(out / "left.png"), left)
    cv2.imwrite(str(out / "right.png"), right)
    save_rig(out / "rig.yaml", scene.rig_calibrated)
    (out / "map.geojson").write_bytes(scene.map.to_geojson())
    place = scene.map.frame.to_geodetic(P_N + np.array([4.0, -3.0, 2.0]))
    angles = (math.degrees(a) + e for a, e in zip(EULER, (0.5, -0.5, 1.0), strict=True))
    (out / "prior.txt").write_text(",".join(f"{x:.9f}" for x in (*place, *angles)))
    return out


def options(folder: Path) -> list[object]:
    return ["--rig", folder / "rig.yaml", "--map", folder / "map.geojson", "--prior", (folder / "prior.txt").read_text()]


def test_a_pair_is_located_and_drawn(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "seen.png"
    result = run(folder / "left.png", folder / "right.png", *options(folder), "--prior-sigma", "5,1", "--json", "-o", out)
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["outcome"] == "fixed"
    truth = Origin(*make_world(2, WorldSpec("lookalikes")).map.origin).to_geodetic(P_N)
    joint, fix = answer["with_prior"], answer["fix"]
    assert math.hypot((joint["lat_deg"] - truth[0]) * 111_200.0, (joint["lon_deg"] - truth[1]) * 75_000.0) < 1.0
    assert joint["alt_m"] == pytest.approx(truth[2], abs=1.0)
    assert joint["yaw_deg"] == pytest.approx(math.degrees(EULER[2]), abs=1.0)
    assert max(joint["sigma_north_east_down_m"]) <= max(fix["sigma_north_east_down_m"]) + 1e-9
    assert len(fix["landmarks"]) == [r["state"] for r in answer["regions"]].count("identified")
    image = cv2.imread(str(out))
    assert image is not None
    assert image.shape == (480, 640, 3)
    assert (image != cv2.imread(str(folder / "left.png"))).any()


def test_one_image_is_located_for_a_person(folder: Path) -> None:
    result = run(folder / "left.png", *options(folder), "--prior-sigma", "5,1")
    assert result.exit_code == 0, result.output
    assert "identified" in result.stdout
    assert "latitude" in result.stdout
    assert "right camera not used: missing" in result.stderr


def test_a_fix_may_be_asked_to_be_good_enough(folder: Path) -> None:
    """The limit is compared with the accuracy of fix and prior together, in the worst direction."""
    given = [folder / "left.png", folder / "right.png", *options(folder), "--prior-sigma", "5,1", "--json"]
    joint = json.loads(run(*given).stdout)["with_prior"]
    worst = math.sqrt(7.814728 * np.linalg.eigvalsh(np.array(joint["covariance"])[:3, :3])[-1])
    assert joint["within_m"] == pytest.approx(worst, rel=1e-6)
    assert run(*given, "--within", 1.01 * worst).exit_code == 0
    refused = run(*given, "--within", 0.99 * worst)
    assert refused.exit_code == 1
    assert json.loads(refused.stdout)["outcome"] == "fixed"
    assert refused.stderr.startswith(f"landfix: no fix good to {0.99 * worst:g} m: with the prior it is good to {worst:.2f} m")


def test_without_a_fix_it_reports_why_and_fails(folder: Path, tmp_path: Path) -> None:
    black, out = tmp_path / "black.png", tmp_path / "seen.png"
    cv2.imwrite(str(black), np.zeros((480, 640, 3), np.uint8))
    result = run(black, black, *options(folder), "--json", "-o", out)
    assert result.exit_code == 1
    assert json.loads(result.stdout)["outcome"] == "no_image"
    assert result.stderr == "landfix: no fix: no_image: left: black; right: black\n"
    assert out.exists()


def test_a_refusal_names_its_remedy(folder: Path) -> None:
    """An image of something else: the outlines are not there."""
    cv2.imwrite(str(folder / "noise.png"), np.random.default_rng(0).integers(0, 255, (480, 640, 3)).astype(np.uint8))
    result = run(folder / "noise.png", *options(folder))
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("landfix: no fix: ")
    assert "; " in result.stderr
    assert any(word in result.stderr.rpartition("; ")[2] for word in ("check --prior", "narrow --prior-sigma"))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--prior", "1,2,3"], "--prior '1,2,3' must be 6 numbers"),
        (["--prior", "a,b,c,d,e,f"], "must be 6 numbers"),
        (["--prior", "99,8,500,0,0,0"], "no place on Earth"),
        (["--prior-sigma", "0,1"], "must be positive"),
        (["--prior-sigma", "nan,1"], "must be 2 numbers"),
        (["--prior-sigma", "1e200,1"], "at most 10000000 m and 180 degrees"),
        (["--prior-sigma", "5,1,2"], "must be 2 numbers"),
        (["--prior-sigma", "5,1,0,2"], "must be positive"),
        (["--prior-sigma", "5,1,x,2"], "must be 4 numbers"),
        (["--within", "0"], "--within 0 must be above 0"),
        (["--within", "nan"], "--within nan must be above 0"),
    ],
)
def test_wrong_usage_exits_with_2(folder: Path, given: list[str], said: str) -> None:
    usual = options(folder)[: 4 if given[0] == "--prior" else None]
    result = run(folder / "left.png", *usual, *given)
    assert result.exit_code == 2
    assert said in " ".join(result.stderr.replace("│", " ").split())


def test_a_torn_image_gets_one_reason_only(folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """libpng writes to the process' stderr, where no logger reaches it."""
    (tmp_path / "torn.png").write_bytes((folder / "left.png").read_bytes()[:20_000])
    run(tmp_path / "torn.png", folder / "right.png", *options(folder))
    assert "libpng" not in capfd.readouterr().err


def test_a_missing_or_bad_file_is_one_line(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.geojson").write_text("{}")
    (tmp_path / "bad.png").write_bytes(b"nothing")
    bad_map = [*options(folder)[:2], "--map", tmp_path / "bad.geojson", *options(folder)[4:]]
    for args in (
        [folder / "none.png", *options(folder)],
        [tmp_path / "bad.png", *options(folder)],
        [folder / "left.png", *bad_map],
    ):
        result = run(*args)
        assert result.exit_code == 1
        assert result.stderr.startswith("landfix: ")
        assert result.stderr.count("\n") == 1
        assert "internal error" not in result.stderr


def test_a_position_far_from_the_map_reports_how_far_and_whether_it_is_exchanged(folder: Path) -> None:
    lat, lon, *rest = (folder / "prior.txt").read_text().split(",")
    north = ",".join((f"{float(lat) + 0.2:.6f}", lon, *rest))
    far = run(folder / "left.png", *options(folder)[:4], "--prior", north)
    assert far.exit_code == 1
    assert "the nearest landmark is 22." in far.stderr
    assert "exchanged" not in far.stderr
    exchanged = run(folder / "left.png", *options(folder)[:4], "--prior", ",".join((lon, lat, *rest)))
    assert "latitude and longitude exchanged" in exchanged.stderr


def one_camera(folder: Path, out: Path) -> list[object]:
    """The rig's left camera as `calibrate mono` writes it, and --mount: forward is the upper edge of the photo."""
    rig = load_rig(folder / "rig.yaml")
    save_camera(out / "camera.yaml", rig.left)
    mount = [*rig.p_bc, *(math.degrees(a) for a in so3.to_euler(so3.from_matrix(rig.R_bc @ FORWARD.T)))]
    assert rig.covariance_bc is not None
    metres, radians = np.sqrt(np.diag(rig.covariance_bc))[[0, 3]].tolist()
    sigma = f"{metres:.6f},{math.degrees(radians):.6f}"
    place = ",".join(f"{x:.9f}" for x in mount)
    return ["--rig", out / "camera.yaml", *options(folder)[2:], "--json", "--mount-sigma", sigma, "--mount", place]


def test_one_camera_gives_the_fix_of_the_rig_s_left_one(folder: Path, tmp_path: Path) -> None:
    """Where the camera is half as large, the photo at twice its size gives nearly the same."""
    given = one_camera(folder, tmp_path)
    of_rig = json.loads(run(folder / "left.png", *options(folder), "--prior-sigma", "5,1", "--json").stdout)["fix"]
    result = run(folder / "left.png", *given, "--prior-sigma", "5,1")
    assert result.exit_code == 0, result.output
    np.testing.assert_allclose(json.loads(result.stdout)["fix"]["p_n_m"], of_rig["p_n_m"], atol=0.3)
    left = cv2.imread(str(folder / "left.png"))
    assert left is not None
    cv2.imwrite(str(tmp_path / "large.png"), cv2.resize(left, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC))
    large = run(tmp_path / "large.png", *given, "--prior-sigma", "5,1")
    assert large.exit_code == 0, large.output
    np.testing.assert_allclose(json.loads(large.stdout)["fix"]["p_n_m"], of_rig["p_n_m"], atol=0.5)
    cv2.imwrite(str(tmp_path / "narrow.png"), left[:, 100:])
    narrow = run(tmp_path / "narrow.png", *given)
    assert narrow.exit_code == 1
    assert "another aspect ratio" in narrow.stderr


def test_several_photos_of_one_camera(folder: Path, tmp_path: Path) -> None:
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((480, 640, 3), np.uint8))
    given = [*one_camera(folder, tmp_path), "--prior-sigma", "5,1"]
    answer = json.loads(run(folder / "left.png", black, *given).stdout)
    assert [p["outcome"] for p in answer["photos"]] == ["fixed", "no_image"]
    assert answer["photo"] == str(folder / "left.png")
    three = run(folder / "left.png", black, black, *given, "--prior", "47,8,500,0,0,0")
    assert three.exit_code == 2
    assert "2 times for 3 photos" in " ".join(three.stderr.replace("│", " ").split())


def test_one_camera_without_a_mount_or_where_two_are_needed(folder: Path, tmp_path: Path) -> None:
    given = one_camera(folder, tmp_path)
    assert "--mount X,Y,Z,ROLL,PITCH,YAW" in run(folder / "left.png", *given[:-2]).stderr
    pair = folder / "left.png", folder / "right.png"
    measured = CliRunner().invoke(app, ["measure", *map(str, pair), "--rig", str(tmp_path / "camera.yaml")])
    assert measured.exit_code == 1
    assert "one camera" in measured.stderr


@pytest.mark.parametrize(("flag", "turns"), [(1, 0), (6, 1), (3, 2), (8, 3)])
def test_the_mount_is_that_of_the_photo_as_it_is_shown(tmp_path: Path, flag: int, turns: int) -> None:
    """The same ray on the body, through the sensor's pixel, and through the pixel of the photo as OpenCV shows it upright."""
    marked = np.zeros((60, 80, 3), np.uint8)
    marked[8:13, 18:23] = 255
    exif = Image.Exif()
    exif[0x0112] = flag
    Image.fromarray(marked).save(tmp_path / "photo.jpg", exif=exif)
    shown = cv2.imread(str(tmp_path / "photo.jpg"))  # OpenCV obeys the flag
    assert shown is not None
    assert photo.quarter_turns(tmp_path / "photo.jpg") == turns
    height, width = shown.shape[:2]
    sensor, upright = (CameraModel(w, h, 50.0, 50.0, 0.5 * (w - 1), 0.5 * (h - 1)) for w, h in ((80, 60), (width, height)))
    at = np.argwhere(shown[..., 0] > 128).mean(axis=0)[::-1]
    turned = photo.turned_mount(FORWARD, turns) @ sensor.ray(np.array([[20.0, 10.0]]))[0]
    np.testing.assert_allclose(turned, FORWARD @ upright.ray(at[None])[0], atol=0.01)
    image, was_turned = photo.fitted(tmp_path / "photo.jpg", marked, upright, turns)
    assert was_turned == (turns % 2 == 1)
    if was_turned:
        np.testing.assert_allclose(image.astype(float), shown.astype(float), atol=60)


def test_a_mirrored_photo_is_refused(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 5
    Image.fromarray(np.zeros((60, 80, 3), np.uint8)).save(tmp_path / "photo.jpg", exif=exif)
    with pytest.raises(CalibrationError, match="mirrored"):
        photo.quarter_turns(tmp_path / "photo.jpg")
