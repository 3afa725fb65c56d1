"""The camera against OpenCV, which the program's models do not use, and its derivatives against differentiation."""

import math

import cv2
import numpy as np
import pytest

from models.camera import CameraModel, StereoRig
from models.messages import Array
from models.so3 import from_euler, matrix, quat_exp

DISTORTIONS = {
    "none": (),
    "brown4": (-0.283, 0.074, 2e-4, 1.8e-5),
    "brown5": (-0.2, 0.05, 1e-3, -2e-3, -0.002),
    "rational": (0.5, 0.1, 1e-3, -2e-3, 0.02, 0.6, 0.2, 0.01),
}


@pytest.fixture(params=DISTORTIONS)
def camera(request: pytest.FixtureRequest) -> CameraModel:
    return CameraModel(752, 480, 458.65, 457.30, 367.2, 248.4, DISTORTIONS[request.param])


def points(count: int, seed: int = 0) -> Array:
    """In front of the camera, up to 45 degrees aside, 0.5 to 200 m away."""
    rng = np.random.default_rng(seed)
    plane = np.column_stack((rng.uniform(-0.8, 0.8, (count, 2)), np.ones(count)))
    return plane * np.exp(rng.uniform(math.log(0.5), math.log(200.0), (count, 1)))


def test_projection_is_opencv_s(camera: CameraModel) -> None:
    x_c = points(500)
    distortion = np.array(camera.distortion) if camera.distortion else None
    expected = cv2.projectPoints(x_c, np.zeros(3), np.zeros(3), camera.matrix, distortion)[0].reshape(-1, 2)
    np.testing.assert_allclose(camera.project(x_c), expected, atol=1e-10)


def test_undistortion_is_opencv_s(camera: CameraModel) -> None:
    px = np.random.default_rng(1).uniform([0, 0], [751, 479], (500, 2))
    distortion = np.array(camera.distortion) if camera.distortion else None
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    expected = cv2.undistortPoints(px[:, None], camera.matrix, distortion, criteria=criteria).reshape(-1, 2)
    np.testing.assert_allclose(camera.undistort(px), expected, atol=1e-9)


def test_undistortion_undoes_projection_and_rays_point_at_what_is_seen(camera: CameraModel) -> None:
    x_c = points(500)
    px = camera.project(x_c)
    np.testing.assert_allclose(camera.undistort(px), x_c[:, :2] / x_c[:, 2:], atol=1e-12)
    np.testing.assert_allclose(camera.ray(px), x_c / np.linalg.norm(x_c, axis=1, keepdims=True), atol=1e-12)


def test_jacobian_of_the_point(camera: CameraModel) -> None:
    x_c = points(200)
    for axis in range(3):
        step = 1e-6 * x_c[:, 2:] * np.eye(3)[axis]
        slope = (camera.project(x_c + step) - camera.project(x_c - step)) / (2e-6 * x_c[:, 2:])
        np.testing.assert_allclose(
            camera.project_jacobian(x_c)[:, :, axis] * x_c[:, 2:], slope * x_c[:, 2:], rtol=1e-7, atol=2e-6
        )


def test_jacobian_of_the_parameters(camera: CameraModel) -> None:
    x_c = points(200)
    jacobian = camera.parameter_jacobian(x_c)
    values = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
    assert jacobian.shape == (200, 2, len(values))
    for k in range(len(values)):
        step = np.zeros(len(values))
        step[k] = 1e-6 * max(1.0, abs(values[k]))
        plus, minus = (
            CameraModel(752, 480, v[0], v[1], v[2], v[3], tuple(v[4:].tolist())).project(x_c)
            for v in (values + step, values - step)
        )
        np.testing.assert_allclose(jacobian[:, :, k], (plus - minus) / (2 * step[k]), rtol=1e-6, atol=1e-6)


def test_nothing_behind_the_camera_is_seen(camera: CameraModel) -> None:
    x_c = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 1.0, 0.0], [0.0, 0.0, math.nan], [math.inf, 0.0, 1.0]])
    seen = [True, False, False, False, False]
    assert (~np.isnan(camera.project(x_c)).any(axis=1)).tolist() == seen
    assert (~np.isnan(camera.project_jacobian(x_c)).any(axis=(1, 2))).tolist() == seen
    assert (~np.isnan(camera.parameter_jacobian(x_c)).any(axis=(1, 2))).tolist() == seen


def test_a_lens_model_that_folds_back_draws_no_ghosts() -> None:
    """r (1 - 0.4 r^2) has its maximum at r = 0.913: 0.608. A point at r = 1.4 would come to lie at r' = 0.30."""
    camera = CameraModel(640, 480, 400.0, 400.0, 320.0, 240.0, (-0.4, 0.0, 0.0, 0.0))
    aside = np.array([[0.9, 0.0, 1.0], [0.92, 0.0, 1.0], [1.4, 0.0, 1.0]])
    px = camera.project(aside)
    assert px[0, 0] == pytest.approx(320 + 400 * 0.9 * (1 - 0.4 * 0.81), abs=1e-9)
    assert np.isnan(px[1:]).all()
    beyond = camera.undistort(np.array([[320 + 400 * 0.61, 240.0]]))
    assert np.isnan(beyond).all(), "no point is seen there"
    assert np.isnan(camera.undistort(np.array([[math.nan, 0.0]]))).all()


def test_undistortion_converges_up_to_the_fold() -> None:
    camera = CameraModel(640, 480, 400.0, 400.0, 320.0, 240.0, (-0.4, 0.0, 0.0, 0.0))
    r = np.array([0.5, 0.8, 0.9, 0.912])
    px = np.column_stack((320 + 400 * r * (1 - 0.4 * r**2), np.full(4, 240.0)))
    np.testing.assert_allclose(camera.undistort(px)[:, 0], r, atol=1e-8)


def test_what_lies_in_the_image() -> None:
    camera = CameraModel(640, 480, 400.0, 400.0, 319.5, 239.5)
    px = np.array([[-0.5, 0.0], [-0.51, 0.0], [639.5, 479.5], [639.6, 0.0], [5.0, 5.0], [math.nan, 5.0]])
    assert camera.contains(px).tolist() == [True, False, True, False, True, False]
    assert camera.contains(px, margin_px=6.0).tolist() == [False] * 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": 0.0}, "focal"),
        ({"cy": math.nan}, "finite"),
        ({"width": 0}, "size"),
        ({"distortion": (0.1, 0.2)}, "2 distortion coefficients"),
        ({"covariance": np.eye(3)}, "covariance"),
    ],
)
def test_what_is_no_camera_is_refused(change: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"width": 640, "height": 480, "fx": 400.0, "fy": 400.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(ValueError, match=message):
        CameraModel(**(arguments | change))  # type: ignore[arg-type]


def rig() -> StereoRig:
    left = CameraModel(640, 480, 400.0, 400.0, 319.5, 239.5)
    R_rc = matrix(quat_exp(np.array([0.01, -0.02, 0.015])))
    R_bc = matrix(from_euler(0.0, 0.1, 1.5))
    return StereoRig(left, left, R_rc, np.array([-0.3, 0.01, 0.02]), R_bc, np.array([0.2, 0.1, 0.05]))


def test_both_cameras_see_one_point_from_their_own_places() -> None:
    it = rig()
    p_n, R_nb = np.array([10.0, -5.0, -30.0]), matrix(from_euler(0.1, -0.2, 2.0))
    x_c = np.array([[1.0, 2.0, 20.0], [-3.0, 1.0, 33.0]])
    p_nc, R_nc = it.camera_pose(p_n, R_nb)
    p_nr, R_nr = it.right_camera_pose(p_n, R_nb)
    x_b = x_c @ it.R_bc.T + it.p_bc
    x_n = x_b @ R_nb.T + p_n
    np.testing.assert_allclose(x_c @ R_nc.T + p_nc, x_n, atol=1e-12)
    np.testing.assert_allclose(it.to_right(x_c) @ R_nr.T + p_nr, x_n, atol=1e-12)
    assert it.baseline_m == pytest.approx(math.sqrt(0.09 + 0.0001 + 0.0004))


@pytest.mark.parametrize("R", [np.eye(3) * 1.1, np.diag([1.0, 1.0, -1.0]), np.full((3, 3), math.nan), np.eye(2)])
def test_what_is_no_rotation_is_refused(R: Array) -> None:
    it = rig()
    with pytest.raises(ValueError, match=r"R_rc|pose rc"):
        StereoRig(it.left, it.right, R, it.t_rc, it.R_bc, it.p_bc)
