"""A line with a width as outlines on the ground."""

from itertools import pairwise

import numpy as np
import pytest

from models.frames import Origin
from models.maps.outline import area
from models.maps.strips import PIECE_M, strips
from models.messages import Array

PLACE = Origin(47.0, 8.0, 0.0)


def line(*corners: tuple[float, float]) -> list[list[float]]:
    """North, east [m] as longitude, latitude."""
    return [list(PLACE.to_geodetic(np.array([*corner, 0.0]))[1::-1]) for corner in corners]


def outlines(of: list[list[float]], width_m: float) -> list[Array]:
    return [np.array([PLACE.to_ned(lat, lon, 0.0)[:2] for lon, lat in ring]) for ring in strips(of, width_m)]


def test_a_straight_road_is_a_rectangle() -> None:
    (found,) = outlines(line((0.0, 0.0), (0.0, 100.0)), 8.0)
    expected = np.array([[4.0, 0.0], [4.0, 100.0], [-4.0, 100.0], [-4.0, 0.0]])
    assert np.abs(found - expected).max() < 0.4  # a degree of latitude has no one length


def test_the_sides_of_a_bend_are_parallel_to_it() -> None:
    """The inner corner of a right angle is as far from both ways as the outer one."""
    (found,) = outlines(line((0.0, 0.0), (50.0, 0.0), (50.0, 50.0)), 6.0)
    assert np.abs(found[[1, 4]] - [[53.0, -3.0], [47.0, 3.0]]).max() < 0.3
    assert abs(area(found)) == pytest.approx(6.0 * 100.0, rel=0.02)


@pytest.mark.parametrize(("length_m", "count"), [(PIECE_M - 10.0, 1), (PIECE_M + 10.0, 2), (4.5 * PIECE_M, 5)])
def test_a_long_road_is_cut_into_pieces(length_m: float, count: int) -> None:
    found = outlines(line((0.0, 0.0), (length_m, 0.0)), 5.0)
    assert len(found) == count
    assert sum(abs(area(ring)) for ring in found) == pytest.approx(5.0 * length_m, rel=0.02)
    for one, following in pairwise(found):
        np.testing.assert_allclose(one[1:3], following[[0, 3]], atol=1e-6)


def test_a_ring_road_and_a_way_back_do_not_cross_themselves() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 37)
    ring = outlines(line(*zip(60.0 * np.cos(t), 60.0 * np.sin(t), strict=True)), 10.0)
    assert sum(abs(area(one)) for one in ring) == pytest.approx(2.0 * np.pi * 60.0 * 10.0, rel=0.02)
    assert len(outlines(line((0.0, 0.0), (0.0, 80.0), (5.0, 0.0)), 4.0)) == 2


@pytest.mark.parametrize("of", [[], line((0.0, 0.0)), line((0.0, 0.0), (0.0, 0.0))])
def test_what_has_no_length_gives_nothing(of: list[list[float]]) -> None:
    assert list(strips(of, 5.0)) == []
