"""The verdict on a pair."""

import cv2
import numpy as np
import pytest

from tests.vision import stereo_scene
from tests.vision.describe.test_correspond import grey, regions_of
from vision.describe import epipolar
from vision.describe.correspond import correspond


@pytest.mark.parametrize("vertical_px", [-5.3, -1.5, 0.0, 1.2, 6.7])
def test_edges_tell_the_vertical_residual(vertical_px: float) -> None:
    rig = stereo_scene.rig()
    left, right, _ = stereo_scene.board(rig, 9.0, vertical_px=vertical_px)
    residual = epipolar.edge_residual(grey(left), grey(right), rig)
    assert residual is not None
    assert residual.count >= 8
    assert residual.vertical_px == pytest.approx(vertical_px, abs=0.25)
    reason = epipolar.pair_reason([], residual)
    assert (reason is None) == (vertical_px == 0.0)


def test_regions_tell_it_too() -> None:
    rig = stereo_scene.rig()
    for vertical, fits in ((0.0, True), (0.3, True), (1.5, False)):
        left, right, _ = stereo_scene.board(rig, 9.0, vertical_px=vertical)
        matches = correspond(grey(left), grey(right), regions_of(left), rig)
        residual = epipolar.region_residual(matches)
        assert residual is not None
        assert residual.vertical_px == pytest.approx(vertical, abs=0.12)
        reason = epipolar.pair_reason(matches, residual)
        assert reason is None if fits else reason is not None and "rows do not fit by +1." in reason


def test_swapped_images_are_said() -> None:
    rig = stereo_scene.rig()
    left, right, _ = stereo_scene.board(rig, 9.0)
    matches = correspond(grey(right), grey(left), regions_of(right), rig)
    assert "swapped: 1 of 1 regions" in (epipolar.pair_reason(matches, epipolar.region_residual(matches)) or "")


def test_images_without_anything_in_common_tell_nothing() -> None:
    rig = stereo_scene.rig()
    rng = np.random.default_rng(1)
    a, b = (cv2.GaussianBlur(rng.integers(0, 255, (240, 320), dtype=np.uint8), (0, 0), 2.0) for _ in range(2))
    assert epipolar.edge_residual(a, b, rig) is None
    assert epipolar.edge_residual(np.zeros((240, 320), np.uint8), b, rig) is None
    assert epipolar.region_residual([]) is None
    assert epipolar.pair_reason([], None) is None
