"""Outlines as fine as an image can show them."""

import numpy as np
import pytest

from models.maps import outline as polygon
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.outline.detail import as_seen


def circle(corners: int, radius: float = 10.0) -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return radius * np.column_stack((np.cos(angle), np.sin(angle)))


def test_a_circle_keeps_its_place_and_area_and_gets_longer_sides() -> None:
    mark = Landmark.of("pad", circle(24))
    seen = as_seen(mark, 4.0)  # sides of 10 px
    side = np.linalg.norm(np.roll(seen.outline_n, -1, axis=0) - seen.outline_n, axis=1) * 4.0
    assert 16.0 <= side.min() <= side.max() < 33.0
    assert polygon.area(seen.outline_n) == pytest.approx(polygon.area(mark.outline_n), rel=2e-3)
    np.testing.assert_allclose(seen.outline_n.mean(axis=0), 0.0, atol=0.05)
    assert np.abs(np.linalg.norm(seen.outline_n, axis=1) - 10.0).max() * 4.0 < 1.0
    assert (seen.id, seen.size_m2) == (mark.id, mark.size_m2)


def test_seen_from_near_a_curve_stays_as_it_is() -> None:
    mark = Landmark.of("pad", circle(24))
    assert as_seen(mark, 10.0) is mark


def test_a_curve_never_goes_further_off_than_a_pixel() -> None:
    """Small circles keep short sides rather than become triangles."""
    seen = as_seen(Landmark.of("tank", circle(48, 3.0)), 5.0)
    assert len(seen.outline_n) >= 8
    assert np.abs(np.linalg.norm(seen.outline_n, axis=1) - 3.0).max() * 5.0 < 1.0


def test_corners_stay() -> None:
    """A small house with a small bay has short sides, but they turn."""
    house = np.array([(0.0, 0.0), (0.0, 8.0), (6.0, 8.0), (6.0, 5.0), (7.0, 5.0), (7.0, 3.0), (6.0, 3.0), (6.0, 0.0)])
    mark = Landmark.of("house", house)
    assert as_seen(mark, 2.0) is mark


def test_points_on_a_straight_side_go() -> None:
    """As footprints traced from images have them."""
    side = np.linspace(0.0, 20.0, 21)
    outline = np.concatenate([np.column_stack((0.0 * side[:-1], side[:-1])), [(0.0, 20.0), (10.0, 20.0), (10.0, 0.0)]])
    seen = as_seen(Landmark.of("hall", outline), 3.0)
    assert polygon.area(seen.outline_n) == pytest.approx(200.0)
    assert len(seen.outline_n) < 10
    for corner in ((0.0, 0.0), (0.0, 20.0), (10.0, 20.0), (10.0, 0.0)):
        assert np.linalg.norm(seen.outline_n - corner, axis=1).min() < 1e-9
