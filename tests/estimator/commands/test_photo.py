"""Photos with tags: what is read, the camera and the pose it tells of, and landfix locate with nothing else."""

import json
import math
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from calib.errors import CalibrationError
from calib.files.formats import save_camera
from calib.files.rig_yaml import FORWARD
from estimator.cli import app
from estimator.commands.photo.camera import camera_of
from estimator.commands.photo.fitted import at_width
from estimator.commands.photo.pose import DOWN, prior_of
from estimator.commands.photo.tags import Tags, read
from estimator.map_files.geoid import geoid_m
from models import so3
from models.camera import CameraModel
from models.frames import Origin
from models.messages import Array
from tests.estimator.commands.photos import DJI, exif, of_scene, packet, save
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_pair
from vision.synthetic.scenes import Scene, WorldSpec, make_world

GREY = np.full((60, 80, 3), 128, np.uint8)
PLACE = Origin(46.8426, -91.9946, 160.0)


def tags_of(folder: Path, properties: dict[str, str], make: str = "DJI", *, as_elements: bool = False) -> Tags:
    tags = exif(46.842607, -91.994560, main={0x010F: make})
    return read(save(folder / "photo.jpg", GREY, tags, packet(properties, as_elements=as_elements)))


def angles(name: str, *degrees: str) -> dict[str, str]:
    return {name.format(axis): value for axis, value in zip(("Roll", "Pitch", "Yaw"), degrees, strict=True)}


def test_tags_of_a_dji_photo(tmp_path: Path) -> None:
    tags = tags_of(tmp_path, DJI)
    assert (tags.make, tags.width, tags.height) == ("DJI", 80, 60)
    assert tags.lat_lon_deg == pytest.approx((46.842607, -91.994560), abs=1e-7)
    assert (tags.above_takeoff_m, tags.altitude_m, tags.above_ellipsoid) == (39.8, 198.31, False)
    assert tags.attitude_deg == (0.0, -89.9, 45.0)


@pytest.mark.parametrize(
    ("make", "properties", "attitude"),
    [
        (
            "Autel Robotics",
            {f"drone:Gimbal{a}Degree": v for a, v in (("Roll", "0.5"), ("Pitch", "-60"), ("Yaw", "10"))},
            (0.5, -60, 10),
        ),
        (
            "Parrot",
            {f"drone-parrot:Camera{a}Degree": v for a, v in (("Roll", "1"), ("Pitch", "-80"), ("Yaw", "20"))},
            (1, -80, 20),
        ),
        ("Parrot", {"Camera:Roll": "0.3", "Camera:Pitch": "-89.9", "Camera:Yaw": "112.5"}, (0.3, -89.9, 112.5)),
        ("senseFly", {"Camera:Roll": "3.7", "Camera:Pitch": "139/10", "Camera:Yaw": "62.1"}, (3.7, -76.1, 62.1)),
        ("senseFly", {"Camera:Pitch": "5"}, None),
        ("DJI", {"drone-dji:GimbalPitchDegree": "nan", "drone-dji:GimbalYawDegree": "1"}, None),
    ],
)
def test_angles_of_each_maker_are_from_the_horizon(
    tmp_path: Path, make: str, properties: dict[str, str], attitude: tuple[float, ...] | None
) -> None:
    found = tags_of(tmp_path, properties, make, as_elements=True).attitude_deg
    assert found is None if attitude is None else found == pytest.approx(attitude)


def test_a_receiver_without_a_fix_gives_no_position(tmp_path: Path) -> None:
    assert read(save(tmp_path / "zero.jpg", GREY, exif(0.0, 0.0))).lat_lon_deg is None
    void = exif(46.8, -91.9)
    void.get_ifd(0x8825)[9] = "V"
    assert read(save(tmp_path / "void.jpg", GREY, void)).lat_lon_deg is None


def test_accuracy_is_what_the_camera_reports_of_it(tmp_path: Path) -> None:
    rtk = {"RtkFlag": "50", "RtkStdLat": "0.014", "RtkStdLon": "0.012", "RtkStdHgt": "0.025", "AbsoluteAltitude": "+150"}
    tags = tags_of(tmp_path, {f"drone-dji:{name}": value for name, value in rtk.items()})
    assert tags.sigma_m == (0.014, 0.025)
    assert tags.above_ellipsoid
    assert tags_of(tmp_path, {"Camera:GPSXYAccuracy": "1.2", "Camera:GPSZAccuracy": "17/10"}).sigma_m == (1.2, 1.7)
    assert tags_of(tmp_path, {"Camera:GPSXYAccuracy": "0", "Camera:GPSZAccuracy": "0"}).sigma_m is None


@pytest.mark.parametrize("size", [None, (40_000, 40_000)])
def test_what_is_no_photo_or_declares_too_many_pixels_is_one_line(size: tuple[int, int] | None, tmp_path: Path) -> None:
    path = tmp_path / "photo.png"
    header = b"IHDR" + struct.pack(">IIBBBBB", *size, 1, 0, 0, 0, 0) if size else b""
    png = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    path.write_bytes(png if size else b"noise")
    with pytest.raises(CalibrationError, match=r"photo\.png: damaged, or not as its format says") as refused:
        read(path)
    assert str(refused.value).isprintable()


@pytest.mark.parametrize("xmp", [b"<x", b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', b"\0" * 50, b"<a>" * 9000])
def test_xmp_that_is_none_is_left_out(tmp_path: Path, xmp: bytes) -> None:
    path = tmp_path / "photo.jpg"
    save(path, GREY, exif(46.8, -91.9), xmp)
    assert read(path).attitude_deg is None
    assert read(path).lat_lon_deg is not None


def test_the_geoid_is_that_of_egm96() -> None:
    """NGA's test values for EGM96 (OUTF477.DAT, 15' grid); a grid of one degree is 0.5 m off, RMS."""
    places = {(38.6281550, 269.7791550): -31.628, (-14.6212170, 305.0211140): -2.969, (46.8743190, 102.4487290): -43.575,
              (-23.6174460, 133.8747120): 15.871, (38.6254730, 359.9995000): 50.066, (-0.4667440, 0.0023000): 17.329}  # fmt: skip
    off = [geoid_m(*place) - height for place, height in places.items()]
    assert np.abs(off).max() < 1.5
    assert np.sqrt(np.mean(np.square(off))) < 0.8
    assert geoid_m(10.0, 359.999) == pytest.approx(geoid_m(10.0, -0.001), abs=1e-9)


# ------------------------------------------------------------------------------------------------------------------ the camera


def test_a_focal_length_of_35_mm_film(tmp_path: Path) -> None:
    """A Phantom 3 writes 20 mm and has 3.61 mm over 6.317 mm, 0.5715 of the width: within 3 %."""
    path = save(tmp_path / "photo.jpg", np.zeros((225, 400, 3), np.uint8), exif(camera={0xA405: 20}))
    camera, source, sigma = camera_of(read(path), 200, "photo")
    assert (camera.width, camera.height, source, sigma) == (200, 112, "FocalLengthIn35mmFilm", 0.03)
    assert abs(camera.fx / 200 - 0.5715) < 0.03 * 0.5715
    assert camera.covariance is not None
    assert math.sqrt(camera.covariance[0, 0]) == pytest.approx(0.03 * camera.fx)


def test_the_makers_calibration_is_preferred_and_scaled(tmp_path: Path) -> None:
    """DewarpData: fx fy, and cx cy from the middle, of the photo as it was taken."""
    size = {0xA002: 5280, 0xA003: 3960, 0xA405: 24}
    numbers = "2022-06-08;3713.29,3713.25,7.02,-8.72,-0.112575240,0.014874430,-0.000085710,0.000000100,-0.027064110"
    xmp = {"drone-dji:DewarpData": numbers, "drone-dji:DewarpFlag": "0", "drone-dji:CalibratedFocalLength": "3725.15"}
    path = save(tmp_path / "photo.jpg", np.zeros((396, 528, 3), np.uint8), exif(camera=size), packet(xmp))
    camera, source, sigma = camera_of(read(path), 264, "photo")
    assert (source, sigma) == ("DewarpData", 0.003)
    assert (camera.fx, camera.cx) == pytest.approx((3713.29 / 20.0, 131.5 + 7.02 / 20.0))
    assert camera.distortion == (-0.11257524, 0.01487443, -0.00008571, 0.0000001, -0.02706411)
    del xmp["drone-dji:DewarpData"]
    camera, source, _ = camera_of(
        read(save(path, np.zeros((396, 528, 3), np.uint8), exif(camera=size), packet(xmp))), 528, "photo"
    )
    assert source == "CalibratedFocalLength"
    assert camera.fx == pytest.approx(372.515)


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ({}, "do not tell the focal length"),
        ({0xA405: 24, 0xA404: 2.0}, "digital zoom of 2"),
        ({0xA405: 24, 0xA002: 4000, 0xA003: 2250}, "cropped from 4000 x 2250 to 80 x 60"),
    ],
)
def test_a_camera_that_tags_do_not_tell_is_refused(tmp_path: Path, camera: dict[int, float], said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        camera_of(read(save(tmp_path / "photo.jpg", GREY, exif(camera=camera))), 80, "photo")


def test_a_camera_at_another_width_sees_the_same_ray() -> None:
    camera = CameraModel(4000, 3000, 3000.0, 3010.0, 1990.0, 1510.0, (0.01, 0.0, 0.0, 0.0), np.eye(8))
    small = at_width(camera, 1000)
    px = np.array([[100.0, 2000.0]])
    np.testing.assert_allclose(small.ray((px + 0.5) / 4.0 - 0.5), camera.ray(px), atol=1e-12)
    assert small.covariance is not None
    assert small.covariance[0, 0] == pytest.approx(1.0 / 16.0)
    assert small.covariance[4, 4] == 1.0


# -------------------------------------------------------------------------------------------------------------------- the pose


def a_prior(tags: Tags, height_m: float | None = None) -> tuple[Array, Array]:
    prior = prior_of(tags, PLACE, lambda north, east: 2.0, height_m, "photo")  # noqa: ARG005
    return np.asarray(prior.p_n), prior.R_nb @ DOWN


def test_the_upper_edge_of_a_photo_from_above_is_where_the_gimbal_looks(tmp_path: Path) -> None:
    """Yaw 45: the camera's -y, up in the photo, is north-east; its z is down. 39.8 m above ground at -2 m of n."""
    p_n, R_nc = a_prior(tags_of(tmp_path, DJI))
    np.testing.assert_allclose(-R_nc[:, 1], [math.sqrt(0.5), math.sqrt(0.5), 0.0], atol=0.01)
    np.testing.assert_allclose(R_nc[:, 2], [0.0, 0.0, 1.0], atol=0.01)
    assert p_n[2] == pytest.approx(2.0 - 39.8, abs=1e-3)
    ahead = DJI | {"drone-dji:GimbalPitchDegree": "-30", "drone-dji:GimbalYawDegree": "90"}
    np.testing.assert_allclose(a_prior(tags_of(tmp_path, ahead))[1][:, 2], [0.0, math.cos(math.pi / 6), 0.5], atol=1e-6)


def test_a_height_above_the_sea_needs_the_geoid(tmp_path: Path) -> None:
    """198.31 m above the sea are 169.5 m above the ellipsoid, 11.5 m above the ground at 158 m."""
    without = {name: value for name, value in DJI.items() if "Relative" not in name}
    p_n, _ = a_prior(tags_of(tmp_path, without))
    assert p_n[2] == pytest.approx(2.0 - (198.31 + geoid_m(46.842607, -91.99456) - 158.0), abs=0.01)
    assert a_prior(tags_of(tmp_path, without), 55.0)[0][2] == pytest.approx(2.0 - 55.0, abs=1e-3)


@pytest.mark.parametrize(
    ("left_out", "said"),
    [
        ("Gimbal", "no camera angles in its tags (XMP): give --prior"),
        ("Altitude", "-317 m above the map's ground"),
    ],
)
def test_what_tags_do_not_tell_names_its_remedy(tmp_path: Path, left_out: str, said: str) -> None:
    properties = {name: value for name, value in DJI.items() if left_out not in name}
    tags = tags_of(tmp_path, properties | ({"drone-dji:RelativeAltitude": "-317"} if left_out == "Altitude" else {}))
    with pytest.raises(CalibrationError) as failed:
        a_prior(tags)
    assert said in str(failed.value)


def test_a_camera_without_a_gimbal_writes_angles_of_0_and_is_named(tmp_path: Path) -> None:
    fixed = DJI | {f"drone-dji:Gimbal{axis}Degree": "+0.00" for axis in ("Roll", "Pitch", "Yaw")}
    tags = tags_of(tmp_path, fixed)
    with pytest.raises(CalibrationError, match="gimbal angles are 0: give --camera-pitch -90 if it looks down"):
        a_prior(tags)
    prior = prior_of(tags, PLACE, lambda north, east: 2.0, None, "photo", -90.0)  # noqa: ARG005
    upper_edge = prior.R_nb @ DOWN @ np.array([0.0, -1.0, 0.0])
    np.testing.assert_allclose(upper_edge, [np.cos(np.radians(46.0)), np.sin(np.radians(46.0)), 0.0], atol=1e-9)
    without = tags_of(tmp_path, {name: value for name, value in fixed.items() if "Flight" not in name})
    with pytest.raises(CalibrationError, match="no heading of the aircraft"):
        prior_of(without, PLACE, lambda north, east: 2.0, None, "photo", -90.0)  # noqa: ARG005


# ------------------------------------------------------------------------------------------------------------------ the command


WORLD = WorldSpec("lookalikes", painted=1.0, area_m=240.0, sigma_m=0.2, height_sigma_m=0.1, outline_sigma_m=0.05)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_world(
        2, WorldSpec("lookalikes", painted=1.0, area_m=240.0, sigma_m=0.2, height_sigma_m=0.1, outline_sigma_m=0.05)
    )


@pytest.fixture(scope="module")
def town(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("town") / "town.geojson"
    path.write_bytes(scene.map.to_geojson())
    return path


def locate(*args: object) -> Result:
    return CliRunner().invoke(app, ["locate", *map(str, args)])


def test_a_photo_and_a_map_are_enough(scene: Scene, town: Path, tmp_path: Path) -> None:
    """Tags 3 m off; the answer is within its own claim and better."""
    p_nc = of_scene(
        tmp_path / "DJI_0001.JPG", scene, np.array([0.0, 0.0, -80.0]), (0.04, -0.03, 0.7), off=np.array([2.5, -1.5, 2.0])
    )
    result = locate(tmp_path / "DJI_0001.JPG", "--map", town, "--json", "-o", tmp_path / "seen.png")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["with_prior"]
    assert np.linalg.norm(np.array(found["p_n_m"]) - p_nc) < min(2.0, found["within_m"])
    assert "camera by its tag CalibratedFocalLength" in result.stderr
    assert (tmp_path / "seen.png").exists()


def test_a_folder_of_photos_with_a_calibrated_camera(scene: Scene, town: Path, tmp_path: Path) -> None:
    save_camera(tmp_path / "camera.yaml", scene.rig_calibrated.left)
    (tmp_path / "flight").mkdir()
    for k, north in enumerate((0.0, 12.0)):
        place = np.array([north, 0.0, -80.0])
        of_scene(tmp_path / "flight" / f"{k}.jpg", scene, place, (0.04, -0.03, 0.7), off=np.array([2.0, 1.0, 1.0]), seed=k)
    result = locate(tmp_path / "flight", "--map", town, "--rig", tmp_path / "camera.yaml", "--json")
    assert result.exit_code == 0, result.output
    photos = json.loads(result.stdout)["photos"]
    assert [photo["outcome"] for photo in photos] == ["fixed", "fixed"]
    assert photos[1]["lat_deg"] - photos[0]["lat_deg"] == pytest.approx(12.0 / 111_200.0, abs=1.0 / 111_200.0)


def test_a_video_goes_on_from_its_last_fix(scene: Scene, town: Path, tmp_path: Path) -> None:
    """Three frames, 12 m apart; the prior, good to 5 m, is that of the first one."""
    rig, euler = scene.rig_calibrated, (0.04, -0.03, 0.7)
    save_camera(tmp_path / "camera.yaml", rig.left)
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 1.0, (rig.left.width, rig.left.height))
    R_nb = so3.matrix(so3.from_euler(*euler))
    for k in range(3):
        place = np.array([12.0 * k, 0.0, -80.0])
        film.write(render_pair(scene.world, scene.rig, place, R_nb, Conditions(), np.random.default_rng(k))[0])
    film.release()
    prior = (*scene.map.frame.to_geodetic(np.array([2.0, -1.0, -79.0])), *map(math.degrees, euler))
    mount = (*rig.p_bc, *map(math.degrees, so3.to_euler(so3.from_matrix(rig.R_bc @ FORWARD.T))))
    options = ["--rig", tmp_path / "camera.yaml", "--map", town, "--prior-sigma", "4,1", "--json"]
    texts = [",".join(f"{x:.9f}" for x in numbers) for numbers in (prior, mount)]
    result = locate(tmp_path / "film.avi", *options, "--prior", texts[0], "--mount", texts[1])
    assert result.exit_code == 0, result.output
    photos = json.loads(result.stdout)["photos"]
    assert [photo["outcome"] for photo in photos] == ["fixed"] * 3
    way_m = (photos[2]["lat_deg"] - photos[0]["lat_deg"]) * 111_200.0
    assert way_m == pytest.approx(24.0, abs=1.5)


def test_wrong_usage_of_photos(scene: Scene, town: Path, tmp_path: Path) -> None:
    photo = save(tmp_path / "plain.jpg", GREY, exif(camera={0xA405: 24}))
    assert "no position in its tags (EXIF, XMP): give --prior" in locate(photo, "--map", town).stderr
    mounted = locate(photo, "--map", town, "--mount", "0,0,0,0,-90,0")
    assert mounted.exit_code == 2
    assert "--mount is for --prior" in " ".join(mounted.stderr.replace("│", " ").split())
    assert "needs --mount" in locate(photo, "--map", town, "--prior", "47,8,500,0,0,0").stderr
    (tmp_path / "film.mp4").write_bytes(b"")
    assert "a video has no tags" in locate(tmp_path / "film.mp4", "--map", town).stderr
    of_scene(tmp_path / "a.jpg", scene, np.array([0.0, 0.0, -80.0]), (0.04, -0.03, 0.7), off=np.zeros(3))
    save(tmp_path / "b.jpg", np.zeros((480, 640, 3), np.uint8), exif(47.0, 8.0, main={0x0110: "FC7303"}), packet(DJI))
    assert "of another camera or size" in locate(tmp_path / "a.jpg", tmp_path / "b.jpg", "--map", town).stderr


def test_an_edited_photo_is_remarked_on(scene: Scene, town: Path, tmp_path: Path) -> None:
    """A viewer that turns the pixels leaves the tags as they were."""
    edited = exif(46.84, -91.99, main={0x0131: "Microsoft Windows Photo Viewer 10.0"}, camera={0xA405: 24})
    photo = save(tmp_path / "edited.jpg", GREY, edited, packet(DJI))
    assert read(photo).edited_by.startswith("Microsoft")
    assert scene.map.origin[0] != 46.84
    assert "saved by Microsoft Windows Photo Viewer" in locate(photo, "--map", town).stderr
