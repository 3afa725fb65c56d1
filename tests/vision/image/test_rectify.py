"""Rectification."""

import cv2
import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import CameraModel, StereoRig
from tests.vision import stereo_scene
from vision.image.rectify import rectification, rectify


def bent_rig() -> StereoRig:
    """Two different lenses, squinting and turned by some degrees."""
    left = CameraModel(640, 480, 610.0, 605.0, 322.0, 236.0, (-0.21, 0.06, 0.0008, -0.0006))
    right = CameraModel(640, 480, 598.0, 602.0, 315.0, 245.0, (-0.18, 0.05, -0.0004, 0.0005))
    R_rc = so3.matrix(so3.quat_exp(np.array([0.02, -0.03, 0.015])))
    return StereoRig(
        left, right, R_rc, np.array([-0.25, 0.004, -0.006]), so3.matrix(so3.quat_exp(np.array([0.3, 0.1, 1.5]))), np.zeros(3)
    )


def test_corresponding_points_stand_in_the_same_row() -> None:
    """A point's raw pixel, looked for in the maps, is where the rectified rig says, in both images; rows are equal."""
    rig = bent_rig()
    made = rectification(rig)
    assert made.left is not None
    assert made.right is not None
    rng = np.random.default_rng(1)
    x_c = np.column_stack((rng.uniform(-2, 2, 40), rng.uniform(-1.5, 1.5, 40), rng.uniform(6, 20, 40)))
    R = made.rig.R_bc.T @ rig.R_bc  # raw left axes to rectified ones
    x_rect = x_c @ R.T
    left, right = made.rig.left.project(x_rect), made.rig.right.project(made.rig.to_right(x_rect))
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
    disparity = left[:, 0] - right[:, 0]
    np.testing.assert_allclose(disparity, made.rig.left.fx * rig.baseline_m / x_rect[:, 2], rtol=1e-9)
    for maps, camera, rectified, raw in (
        (made.left, rig.left, left, rig.left.project(x_c)),
        (made.right, rig.right, right, rig.right.project(rig.to_right(x_c))),
    ):
        u, v = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
        for raw_coordinate, image in ((0, u), (1, v)):  # an image whose values are its own raw coordinates
            seen = cv2.remap(image, maps.pixels, maps.fractions, cv2.INTER_LINEAR)
            inside = (rectified > 2).all(axis=1) & (rectified < (camera.width - 3, camera.height - 3)).all(axis=1)
            x, y = rectified[inside].astype(np.float32).T[:, None]
            at = cv2.remap(seen, x, y, cv2.INTER_LINEAR)[0]
            assert inside.sum() > 10
            np.testing.assert_allclose(at, raw[inside, raw_coordinate], atol=0.06)


def test_what_the_camera_has_not_seen_is_marked() -> None:
    """Cameras that squint by 8 degrees each look past what the rectified ones would see."""
    rig = msgspec.structs.replace(bent_rig(), R_rc=so3.matrix(so3.quat_exp(np.array([0.0, -0.28, 0.0]))))
    made = rectification(rig)
    assert made.left is not None
    white = rectify(np.full((480, 640, 3), 200, np.uint8), made.left)
    np.testing.assert_array_equal(white[..., 0][made.left.valid > 0], 200)
    assert 0.8 < (made.left.valid > 0).mean() < 1.0


def test_a_rectified_rig_is_left_alone() -> None:
    """No interpolation: the image comes back itself, the principal points keep their difference."""
    rig = stereo_scene.rig(shift_px=12.0)
    made = rectification(rig)
    image = np.zeros((240, 320), np.uint8)
    assert made.rig is rig
    assert rectify(image, made.left) is image


def test_covariances_turn_with_their_axes() -> None:
    rng = np.random.default_rng(2)
    A = rng.normal(size=(6, 6))
    rig = msgspec.structs.replace(bent_rig(), covariance_rc=A @ A.T * 1e-6)
    made = rectification(rig).rig
    assert made.covariance_rc is not None
    assert rig.covariance_rc is not None
    R = rectification(rig).rig.R_bc.T @ rig.R_bc @ rig.R_rc.T  # raw right axes to rectified ones
    np.testing.assert_allclose(made.covariance_rc[:3, 3:], R @ rig.covariance_rc[:3, 3:] @ R.T, atol=1e-15)


@pytest.mark.parametrize("t_rc", [(0.3, 0.0, 0.0), (0.0, -0.3, 0.0), (0.0, 0.0, 0.0)])
def test_cameras_that_do_not_stand_side_by_side_are_refused(t_rc: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="stereo rig"):
        rectification(msgspec.structs.replace(bent_rig(), t_rc=np.array(t_rc)))
