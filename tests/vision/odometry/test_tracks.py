"""Corners and tracks on drawn images."""

import cv2
import numpy as np
import pytest

from models.camera import CameraModel
from tests.vision.odometry.scene import pair
from vision.image.rectify import Image
from vision.odometry.corners import corners
from vision.odometry.tracks import coarse_columns, stereo, temporal
from vision.odometry.views import Lens

CAMERA = CameraModel(320, 240, 300.0, 300.0, 159.5, 119.5)
LENS = Lens(CAMERA, np.eye(3), CAMERA, None, 2)


def texture(shift: int = 0) -> Image:
    noise = cv2.GaussianBlur(np.random.default_rng(1).normal(0.0, 1.0, (240, 500)), (0, 0), 1.5)
    grey = 128.0 + 40.0 * noise / noise.std()
    return np.asarray(np.clip(np.rint(grey[:, 100 + shift : 420 + shift]), 0.0, 255.0), np.uint8)


def test_corners_cover_the_image() -> None:
    """One half has half of the other's contrast, and still gets its share."""
    image = texture()
    image[:, 160:] = 128 + (image[:, 160:].astype(int) - 128) // 2
    px = corners(image, None, 100)
    assert len(px) == 100
    assert 35 < (px[:, 0] > 160).sum() < 65


def test_corners_respect_the_mask() -> None:
    mask = np.zeros((240, 320), np.uint8)
    mask[100:, :] = 255
    assert corners(texture(), mask, 100)[:, 1].min() >= 100


def test_corners_of_a_wide_image_lie_where_its_texture_is() -> None:
    """They are sought at half the size: a mask and a patch of texture at full size."""
    image = np.full((720, 1280), 128, np.uint8)
    image[200:440, 600:920] = texture()
    mask = np.zeros(image.shape, np.uint8)
    mask[:, 700:] = 255
    px = corners(image, mask, 50)
    assert len(px) >= 40
    assert (px > (697.0, 196.0)).all()
    assert (px < (922.0, 442.0)).all()


def test_a_strong_texture_needs_few_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where each cell has strong corners, thresholds that give tens of thousands are not tried."""
    tried: list[int] = []
    create = cv2.FastFeatureDetector.create

    def noted(threshold: int) -> cv2.FastFeatureDetector:
        tried.append(threshold)
        return create(threshold)

    monkeypatch.setattr(cv2.FastFeatureDetector, "create", noted)
    image = np.random.default_rng(2).integers(0, 255, (480, 640), dtype=np.uint8)
    assert len(corners(image, None, 140)) == 140
    assert tried == [96]


def test_near_points_are_found_far_along_the_row() -> None:
    """60 px of disparity, beyond any window."""
    left, right = (LENS.view(texture(shift)) for shift in (0, 60))
    px = corners(left.raw, None, 80)
    px = px[(px[:, 0] > 90) & (px[:, 0] < 300)]
    columns = coarse_columns(left, right, px, px[:, 0] - 80.0, px[:, 0])
    fine = stereo(left, right, px, px[:, 1], columns, LENS)
    found = np.isfinite(fine)
    assert found.mean() > 0.7
    np.testing.assert_allclose(px[found, 0] - fine[found], 60.0, atol=0.2)


def test_a_fence_has_no_disparity() -> None:
    """Posts every 16 px look alike: no answer instead of one of several."""
    fence = np.tile(np.where(np.arange(320) % 16 < 8, 60, 190).astype(np.uint8), (240, 1))
    fence[::7] = 120
    px = np.array([[160.0, 120.0], [200.0, 60.0]])
    view = LENS.view(fence)
    assert np.isnan(coarse_columns(view, view, px, px[:, 0] - 60.0, px[:, 0])).all()


def test_a_turn_about_the_optical_axis_does_not_hinder() -> None:
    """90 degrees, given by H."""
    image = pair(0)[0][:, :, 1][:, 80:560]
    turned = np.ascontiguousarray(np.rot90(image))
    px = corners(image, None, 60).astype(float)
    px = px[(np.abs(px - 240) < 220).all(axis=1)]
    H = np.array([[0.0, -1.0, 479.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # turned -> image
    guess = np.column_stack((px[:, 1], 479.0 - px[:, 0]))
    there = temporal(image, turned, px, guess + 2.0, H)
    assert np.isfinite(there[:, 0]).mean() > 0.9
    np.testing.assert_allclose(there[np.isfinite(there[:, 0])], guess[np.isfinite(there[:, 0])], atol=0.1)
