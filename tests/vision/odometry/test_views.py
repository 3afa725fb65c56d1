"""Raw and rectified pixels, and the small image."""

import cv2
import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import CameraModel, StereoRig
from tests.vision.odometry.scene import RIG, pair, prediction, truth
from vision.image.rectify import rectification, rectify
from vision.odometry.corners import corners
from vision.odometry.step import OdometrySettings, StereoOdometry
from vision.odometry.views import grey, lenses, reduced, scaled_px

LENS = (-0.28, 0.07, 2e-4, 2e-5)
LEFT = CameraModel(752, 480, 458.0, 457.0, 367.0, 248.0, LENS)
RIGHT = CameraModel(752, 480, 457.0, 456.0, 379.0, 255.0, LENS)
TURN = so3.matrix(so3.quat_exp(np.radians([0.8, -0.5, 0.3])))
BARREL = StereoRig(LEFT, RIGHT, TURN, TURN @ np.array([-0.11, 0.002, 0.001]), np.eye(3), np.zeros(3))


def test_points_are_rectified_as_images_are() -> None:
    """A point of the world stands in the same row of both cameras, and f b / Z apart: as in the rectified rig."""
    rig, left, right = lenses(BARREL)
    x_c = np.random.default_rng(1).uniform((-1.0, -0.6, 2.0), (1.0, 0.6, 6.0), (200, 3))
    px = [lens.rectified(lens.camera.project(x)) for lens, x in ((left, x_c), (right, BARREL.to_right(x_c)))]
    np.testing.assert_allclose(px[0][:, 1], px[1][:, 1], atol=1e-9)
    depth = (x_c @ (rig.R_bc.T @ BARREL.R_bc).T)[:, 2]
    disparity = px[0][:, 0] - px[1][:, 0] - (rig.left.cx - rig.right.cx)
    np.testing.assert_allclose(disparity, rig.left.fx * rig.baseline_m / depth, rtol=1e-9)
    np.testing.assert_allclose(left.raw(px[0]), left.camera.project(x_c), atol=1e-8)
    of_images = rectification(BARREL).rig
    assert (rig.left.fx, rig.left.cx) == pytest.approx((of_images.left.fx, of_images.left.cx))


@pytest.mark.parametrize(("camera", "scale"), [(LEFT, 2), (msgspec.structs.replace(LEFT, width=1504, cx=734.0), 4)])
def test_the_small_image_is_the_rectified_one_reduced(camera: CameraModel, scale: int) -> None:
    rig = StereoRig(camera, camera, BARREL.R_rc, BARREL.t_rc, BARREL.R_bc, BARREL.p_bc)
    noise = np.random.default_rng(2).normal(128.0, 400.0, (camera.height, camera.width))
    image = np.clip(cv2.GaussianBlur(noise, (0, 0), 6.0), 0.0, 255.0).astype(np.uint8)
    view = lenses(rig)[1].view(image)
    assert view.scale == scale
    whole = reduced(rectify(image, rectification(rig).left), scale).astype(float)
    inside = (slice(20, -20), slice(20, -20))
    assert np.corrcoef(view.small[inside].ravel(), whole[inside].ravel())[0, 1] > 0.995


def test_a_right_image_of_another_size() -> None:
    """A right camera of twice the resolution: rows correspond, in the small images too."""
    right = CameraModel(1504, 960, 2 * RIGHT.fx, 2 * RIGHT.fy, 758.5, 510.5, LENS)
    rig = StereoRig(LEFT, right, BARREL.R_rc, BARREL.t_rc, BARREL.R_bc, BARREL.p_bc)
    _, left_lens, right_lens = lenses(rig)
    x_c = np.random.default_rng(1).uniform((-0.5, -0.4, 2.0), (0.5, 0.4, 6.0), (50, 3))
    rows = [lens.rectified(lens.camera.project(x))[:, 1] for lens, x in ((left_lens, x_c), (right_lens, rig.to_right(x_c)))]
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-9)
    views = [lens.view(np.zeros((c.height, c.width), np.uint8)) for lens, c in ((left_lens, LEFT), (right_lens, right))]
    assert [view.scale for view in views] == [2, 2]
    assert views[0].small.shape == views[1].small.shape


def test_corners_keep_from_the_border_of_both_images() -> None:
    left = lenses(BARREL)[1]
    image = np.random.default_rng(3).integers(0, 255, (480, 752), dtype=np.uint8)
    raw = corners(cv2.GaussianBlur(image, (0, 0), 1.5), left.inner(), 140)
    for px in (raw, left.rectified(raw)):
        assert px.min() > 6.0
        assert (px < (746.0, 474.0)).all()


def test_pixels_of_a_reduced_image() -> None:
    """The first pixel of a half image is the mean of the first four: its centre lies between them."""
    np.testing.assert_allclose(scaled_px(np.array([0.0, 3.0]), 2.0), [0.5, 6.5])
    np.testing.assert_allclose(scaled_px(np.array([0.5, 6.5]), 0.5), [0.0, 3.0])


def test_a_distorted_rig_gives_the_motion() -> None:
    """The rendered pairs as cameras with barrel distortion would have taken them."""
    k = (-0.2, 0.04, 1e-4, 0.0)
    cameras = [msgspec.structs.replace(c, distortion=k) for c in (RIG.left, RIG.right)]
    rig = StereoRig(cameras[0], cameras[1], RIG.R_rc, RIG.t_rc, RIG.R_bc, RIG.p_bc)
    odometry = StereoOdometry(rig, OdometrySettings(disparity_sigma_px=0.1))
    frames = []
    for at in (0, 1):
        images = []
        for image, camera, rendered in zip(pair(at), cameras, (RIG.left, RIG.right), strict=True):
            v, u = np.mgrid[0 : camera.height, 0 : camera.width]
            plane = camera.undistort(np.column_stack((u.ravel(), v.ravel())).astype(float)).reshape(*u.shape, 2)
            source = rendered.project(np.column_stack((plane.reshape(-1, 2), np.ones(u.size))))
            maps = source.reshape(*u.shape, 2).astype(np.float32)
            images.append(cv2.remap(grey(image), maps[:, :, 0].copy(), maps[:, :, 1].copy(), cv2.INTER_LINEAR))
        frames.append(odometry.frame(images[0], images[1]))
    assert not any(isinstance(f, str) for f in frames)
    step = odometry.step(frames[0], frames[1], prediction())  # type: ignore[arg-type]
    assert step.reason == ""
    assert np.linalg.norm(step.p - truth()[0]) < 0.08
    assert step.points > 50
