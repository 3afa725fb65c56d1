import contextlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.files.formats import (
    BodyPose,
    CalibrationError,
    Format,
    load_cameras,
    load_rig,
    save_camera,
    save_mounted,
    save_rig,
)
from calib.files.rig_yaml import FORWARD
from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array


def covariance(n: int, seed: int) -> Array:
    a = np.random.default_rng(seed).normal(0.0, 1e-3, (n, n))
    return a @ a.T


def rig(covariances: bool = True) -> StereoRig:
    distortion = (-0.28, 0.07, 2e-4, 1.7e-5)
    left = CameraModel(752, 480, 458.654, 457.296, 367.215, 248.375, distortion, covariance(8, 1) if covariances else None)
    right = CameraModel(752, 480, 457.587, 456.134, 379.999, 255.238, distortion, covariance(8, 2) if covariances else None)
    R_rc, R_bc = so3.matrix(so3.quat_exp(np.array([0.01, -0.02, 0.005]))), so3.matrix(so3.quat_exp(np.array([1.2, -1.1, 1.3])))
    rc, bc = (covariance(6, 3), covariance(6, 4)) if covariances else (None, None)
    return StereoRig(left, right, R_rc, np.array([-0.11, 1e-5, 2e-3]), R_bc, np.array([-0.02, -0.06, 0.01]), rc, bc, 0.0123)


def assert_same(a: StereoRig, b: StereoRig, atol: float) -> None:
    for one, other in ((a.left, b.left), (a.right, b.right)):
        assert (one.width, one.height) == (other.width, other.height)
        np.testing.assert_allclose(one.matrix, other.matrix, atol=1e3 * atol)
        np.testing.assert_allclose(one.distortion, other.distortion[: len(one.distortion)], atol=atol)
    for name in ("R_rc", "t_rc", "R_bc", "p_bc"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=atol)
    assert a.time_offset_s == pytest.approx(b.time_offset_s, abs=atol)


@pytest.mark.parametrize("name", ["rig.yaml", "rig.xml", "rig.yml"])
def test_a_rig_comes_back_to_the_bit_with_its_covariances(tmp_path: Path, name: str) -> None:
    save_rig(tmp_path / name, rig())
    back = load_rig(tmp_path / name)
    assert_same(rig(), back, 0.0)
    for part in ("covariance_rc", "covariance_bc"):
        np.testing.assert_array_equal(getattr(back, part), getattr(rig(), part))
    assert back.right.covariance is not None
    np.testing.assert_array_equal(back.right.covariance, covariance(8, 2))


def test_kalibr_and_back(tmp_path: Path) -> None:
    save_rig(tmp_path / "camchain.yaml", rig(), Format.KALIBR)
    assert_same(rig(), load_rig(tmp_path / "camchain.yaml"), 1e-15)


def test_the_rig_of_a_recorded_data_set(landfix_data: Path) -> None:
    """EuRoC's, as OpenVINS writes a camchain (in JSON, which is YAML): its README measured baseline 0.11008 m, 0.818 degrees."""
    euroc = load_rig(landfix_data / "flights" / "euroc" / "calib.json")
    assert euroc.baseline_m == pytest.approx(0.11008, abs=1e-5)
    turn = np.linalg.norm(so3.quat_log(so3.from_matrix(np.ascontiguousarray(euroc.R_rc))))
    assert np.rad2deg(turn) == pytest.approx(0.818, abs=1e-3)
    np.testing.assert_allclose(euroc.p_bc, (-0.0216401454975, -0.064676986768, 0.00981073058949))
    with pytest.raises(CalibrationError, match="80 degrees"):  # TUM-VI's lenses see 195 degrees
        load_rig(landfix_data / "flights" / "tumvi_room" / "calib.json")


def test_ros_and_back_without_the_pose_on_the_body(tmp_path: Path) -> None:
    written = save_rig(tmp_path / "rig.yaml", rig(), Format.ROS)
    assert [p.name for p in written] == ["rig_left.yaml", "rig_right.yaml"]
    back = load_rig(written[1])
    np.testing.assert_allclose(back.R_rc, rig().R_rc, atol=1e-12)
    np.testing.assert_allclose(back.t_rc, rig().t_rc, atol=1e-12)


def test_a_rig_without_a_pose_on_the_body_reports_that_it_is_not_given(tmp_path: Path) -> None:
    save_rig(tmp_path / "rig.yaml", rig(), Format.ROS)
    known = load_rig(tmp_path / "rig_left.yaml")
    for name in ("again.yaml", "again.xml"):
        save_rig(tmp_path / name, known)
        back = load_rig(tmp_path / name)
        np.testing.assert_array_equal(back.R_bc, FORWARD)
        assert back.covariance_bc is not None
        assert back.covariance_bc[0, 0] >= 9e4
        assert back.covariance_bc[3, 3] >= 10.0


def test_published_files_of_opencv_are_read(landfix_data: Path) -> None:
    folder = landfix_data / "images" / "opencv_chessboard_stereo"
    camera = load_cameras(folder / "left_intrinsics.yml", BodyPose(np.eye(3), np.zeros(3), np.eye(6))).left
    assert (camera.width, camera.height) == (640, 480)
    assert camera.fx == pytest.approx(535.91573396)
    assert camera.distortion[4] == pytest.approx(0.23839153)
    with pytest.raises(CalibrationError, match="R, T missing"):
        load_rig(folder / "intrinsics.yml")
    with pytest.raises(CalibrationError, match="one camera"):
        load_rig(folder / "left_intrinsics.yml")


def test_the_rectification_in_an_opencv_file_brings_points_to_one_row(tmp_path: Path) -> None:
    save_rig(tmp_path / "rig.xml", rig())
    storage = cv2.FileStorage(str(tmp_path / "rig.xml"), cv2.FILE_STORAGE_READ)
    R1, R2, P1, P2, Q, F = (np.asarray(storage.getNode(name).mat()) for name in ("R1", "R2", "P1", "P2", "Q", "F"))
    x_c = np.array([0.3, -0.2, 2.0])
    u_left, u_right = (P[:, :3] @ x + P[:, 3] for P, x in ((P1, R1 @ x_c), (P2, R1 @ x_c)))
    left, right = u_left / u_left[2], u_right / u_right[2]
    assert left[1] == pytest.approx(right[1])
    np.testing.assert_allclose(P2[:, :3] @ R2 @ rig().to_right(x_c[None])[0] / (R2 @ rig().to_right(x_c[None])[0])[2], right)
    space = Q @ np.array([left[0], left[1], left[0] - right[0], 1.0])
    np.testing.assert_allclose(space[:3] / space[3], R1 @ x_c)
    x_r = rig().to_right(x_c[None])[0]
    assert (rig().right.matrix @ x_r) @ F @ (rig().left.matrix @ x_c) == pytest.approx(0.0, abs=1e-9)


EDITS: dict[str, tuple[Callable[[str], str], str]] = {
    "torn": (lambda s: s[: len(s) // 2], "rig.yaml"),
    "no YAML": (lambda s: s.replace("left:", "left: [", 1), "no valid YAML, line"),
    "later version": (lambda s: s.replace("version: 1", "version: 7"), "version 7"),
    "typo": (lambda s: s.replace("  fx:", "  f_x:", 1), "f_x"),
    "no number": (lambda s: s.replace("width: 752", "width: wide", 1), "width"),
    "millimetres": (lambda s: s.replace("translation_m: [-0.11", "translation_m: [-110.0", 1), "metres"),
    "no rotation": (lambda s: s.replace("rotation:\n    - [0.9", "rotation:\n    - [0.5", 1), "not a rotation"),
    "NaN": (lambda s: s.replace("fx: 458.654", "fx: .nan", 1), "finite"),
    "negative": (lambda s: s.replace("fx: 458.654", "fx: -458.654", 1), "positive"),
    "other": (lambda _: "a: 1\n", "neither"),
    "list": (lambda _: "- 1\n", "mapping"),
    "empty": (lambda _: "", "mapping"),
    "xml": (lambda _: "<?xml version='1.0'?><opencv_storage>", "no valid OpenCV file"),
}


@pytest.mark.parametrize("name", EDITS)
def test_a_bad_file_is_one_clear_line(tmp_path: Path, name: str) -> None:
    edit, expected = EDITS[name]
    path = tmp_path / "rig.yaml"
    save_rig(path, rig())
    path.write_text(edit(path.read_text()))
    with pytest.raises(CalibrationError, match=expected) as caught:
        load_rig(path)
    assert "\n" not in str(caught.value)
    assert "rig.yaml" in str(caught.value)


def test_files_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "image.png").write_bytes(b"\x89PNG\xff\xfe")
    for path, expected in (
        (tmp_path / "nowhere.yaml", "no such file"),
        (tmp_path / "image.png", "no text file"),
        (tmp_path, "no text"),
    ):
        with pytest.raises(CalibrationError, match=expected):
            load_rig(path)
    with pytest.raises(CalibrationError, match="cannot be written"):
        save_rig(tmp_path / "no" / "rig.yaml", rig())
    save_camera(tmp_path / "camera.yaml", rig().left)
    with pytest.raises(CalibrationError, match="one camera"):
        load_rig(tmp_path / "camera.yaml")


@settings(max_examples=60)
@given(st.data())
def test_no_damage_to_a_file_escapes_as_another_error(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.mktemp("fuzz") / data.draw(st.sampled_from(["rig.yaml", "rig.xml"]))
    save_rig(path, rig())
    text = path.read_text()
    begin = data.draw(st.integers(0, len(text)))
    path.write_text(
        text[:begin] + data.draw(st.text(alphabet="0-.e:[]<>/ \n#x", max_size=4)) + text[begin + data.draw(st.integers(0, 40)) :]
    )
    with contextlib.suppress(CalibrationError):
        load_rig(path)


_LEVELS = 20_000
_OPENCV = "%YAML:1.0\n---\na: "
_DEEP = {
    "xml": '<?xml version="1.0"?><opencv_storage>' + "<a>" * 13_000 + "</a>" * 13_000 + "</opencv_storage>",
    "opencv brackets": _OPENCV + "[" * _LEVELS + "]" * _LEVELS,
    "opencv braces": _OPENCV + "{a:" * _LEVELS,
    "opencv dashes": _OPENCV + "- " * _LEVELS + "1\n",
    "opencv dashes without spaces": _OPENCV + "-" * _LEVELS + "1\n",
    "opencv colons": _OPENCV + "a:" * _LEVELS + "1\n",
    "opencv lines": _OPENCV + "".join(f"\n{' ' * k}a:" for k in range(400)) + " 1\n",
    "opencv json": '{"x": "!!opencv-matrix#", "a": ' + "[" * _LEVELS + "]" * _LEVELS + "}",
    "yaml brackets": "a: " + "[" * _LEVELS + "]" * _LEVELS,
    "yaml dashes": "- " * _LEVELS + "1",
    "json": '{"a":' * 15_000 + "1" + "}" * 15_000,
}


@pytest.mark.parametrize("kind", list(_DEEP))
def test_a_file_that_is_nested_too_deeply_is_refused_and_ends_no_process(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "rig"
    path.write_text(_DEEP[kind])
    with pytest.raises(CalibrationError, match=r"rig: (is nested more than 100 levels|.*nested too deeply)") as refused:
        load_rig(path)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "rig"
    path.write_text("%YAML:1.0\n" + "# nothing\n" * 10_000)
    with pytest.raises(CalibrationError, match=r"rig: is larger than 0\.1 MB"):
        load_rig(path)


def test_one_camera_on_the_body_comes_back(tmp_path: Path) -> None:
    """It is no rig of two, says where it sits, or is given that; its covariance too."""
    known = rig()
    alone = StereoRig.of_one(known.left, known.R_bc, known.p_bc, known.covariance_bc)
    save_mounted(tmp_path / "camera.yaml", alone)
    back = load_cameras(tmp_path / "camera.yaml")
    assert back.one_camera
    assert_same(alone, back, 0.0)
    np.testing.assert_array_equal(back.covariance_bc, known.covariance_bc)
    with pytest.raises(CalibrationError, match="one camera"):
        load_rig(tmp_path / "camera.yaml")
    with pytest.raises(CalibrationError, match="yaml only"):
        save_mounted(tmp_path / "camera.xml", alone)
    assert known.covariance_bc is not None
    mount = BodyPose(known.R_bc, known.p_bc, known.covariance_bc)
    for name, form in (("a.yaml", None), ("b.xml", None), ("c.yaml", Format.ROS), ("d.yaml", Format.KALIBR)):
        save_camera(tmp_path / name, known.left, form)
        with pytest.raises(CalibrationError, match="--mount"):
            load_cameras(tmp_path / name)
        given = load_cameras(tmp_path / name, mount)
        assert given.one_camera
        assert_same(alone, given, 1e-12)
