"""Profiles across an outline, their colours, and the search for where the roof ends."""

import numpy as np
import pytest

from vision.outline import alien, along_contrast, crossed, off_roof, profiles, search

POINTS, HALF = 12, 12
ONE = np.zeros(POINTS, dtype=np.int64)
ROOF = np.ones(1, dtype=np.bool_)
LANDMARK = np.zeros(1, dtype=np.int64)


def bars(*widths_and_colours: tuple[int, tuple[float, float, float]]) -> np.ndarray:
    """Profiles (N, 25, 3) of bars one after the other."""
    profile = np.concatenate([np.tile(colour, (width, 1)) for width, colour in widths_and_colours])
    return np.tile(profile, (POINTS, 1, 1)).astype(float)


def everything() -> np.ndarray:
    return np.ones(POINTS, dtype=np.bool_)


def test_profiles_of_a_ramp_are_the_ramp() -> None:
    v, u = np.mgrid[0:60, 0:80]
    picture = np.stack([2 * u, 2 * v, u + v], axis=2).astype(np.uint8)
    px = np.array([[40.3, 30.6], [35.0, 25.0]])
    normal = np.array([[0.6, 0.8], [-1.0, 0.0]])
    values = profiles(picture, px, normal, 4, 0.5, 3, np.ones(2, dtype=np.bool_))
    at = px[:, None, :] + np.arange(-2.0, 2.5, 0.5)[None, :, None] * normal[:, None, :]
    np.testing.assert_allclose(values, np.stack([2 * at[..., 0], 2 * at[..., 1], at.sum(axis=2)], axis=2), atol=1e-9)


def test_a_profile_that_leaves_the_picture_is_not_usable() -> None:
    usable = np.ones(3, dtype=np.bool_)
    px = np.array([[3.0, 20.0], [20.0, 20.0], [np.nan, 5.0]])
    profiles(np.zeros((40, 40, 1), dtype=np.uint8), px, np.tile([1.0, 0.0], (3, 1)), 5, 1.0, 1, usable)
    assert usable.tolist() == [False, True, False]


RED, DARK, GREEN = (40.0, 40.0, 190.0), (25.0, 35.0, 30.0), (70.0, 120.0, 110.0)


@pytest.mark.parametrize("shift", [-4, 0, 5])
def test_the_roof_ends_where_its_colour_ends_not_where_the_shadow_does(shift: int) -> None:
    """The shadow's rim has the larger contrast in green; the roof ends before it."""
    values = bars((12 + shift, RED), (4, DARK), (9 - shift, GREEN))
    distance = off_roof(values, ONE, LANDMARK, ROOF, everything())
    assert not alien(values, ONE, LANDMARK, ROOF, everything()).any()
    offsets = search(distance, ONE, 1, 1.0, everything())
    np.testing.assert_allclose(offsets, shift - 0.5, atol=0.6)


def test_an_edge_inside_the_ground_is_alien() -> None:
    """Two edges of one landmark: one has the roof inside, the other ground on both sides."""
    edge = np.repeat([0, 1], POINTS // 2)
    values = bars((13, RED), (12, GREEN))
    values[POINTS // 2 :] = bars((13, GREEN), (12, (90.0, 150.0, 140.0)))[: POINTS // 2]
    values = np.concatenate((values[: POINTS // 2], values))  # the roof's colour is the majority's
    edge = np.concatenate((np.zeros(POINTS // 2, dtype=np.int64), edge))
    found = alien(values, edge, np.zeros(2, dtype=np.int64), np.ones(2, dtype=np.bool_), np.ones(len(edge), dtype=np.bool_))
    assert found.tolist() == [False, True]


def test_no_step_no_offset() -> None:
    distance = off_roof(bars((25, GREEN)), ONE, LANDMARK, ROOF, everything())
    assert np.isnan(search(distance, ONE, 1, 1.0, everything())).all()


def test_two_equal_steps_are_ambiguous() -> None:
    """Off the roof, back on it, off again: either may be its end."""
    off = np.concatenate((np.zeros(5), np.full(6, 60.0), np.zeros(6), np.full(8, 60.0)))
    assert np.isnan(search(np.tile(off, (POINTS, 1)), ONE, 1, 1.0, everything())).all()
    once = np.concatenate((np.zeros(17), np.full(8, 60.0)))
    assert np.isfinite(search(np.tile(once, (POINTS, 1)), ONE, 1, 1.0, everything())).all()


def test_contrast_leaves_saturated_channels_out() -> None:
    values = bars((12, (255.0, 150.0, 60.0)), (13, (150.0, 20.0, 60.0)))
    grey, clipped = along_contrast(values, ONE, 1, everything())
    np.testing.assert_allclose(np.abs(grey[:, -1] - grey[:, 0]), 130.0)  # green alone
    assert not clipped[0]


def test_contrast_that_is_all_saturated_is_said() -> None:
    values = bars((12, (255.0, 60.0, 60.0)), (13, (100.0, 50.0, 60.0)))
    grey, clipped = along_contrast(values, ONE, 1, everything())
    assert clipped[0]
    assert np.abs(grey[0, -1] - grey[0, 0]) > 150.0


def test_contrast_of_a_dark_wall_between_two_like_colours() -> None:
    values = bars((9, GREEN), (7, DARK), (9, GREEN))
    grey, _ = along_contrast(values, ONE, 1, everything())
    assert np.ptp(grey[0]) > 80.0


def test_profiles_crossed_by_another_edge() -> None:
    start, end = np.array([[0.0, 0.0], [0.0, 4.0], [0.0, 6.0]]), np.array([[50.0, 0.0], [20.0, 4.0], [50.0, 6.0]])
    px, normal = np.array([[10.0, 0.0], [30.0, 0.0], [30.0, 0.0]]), np.array([[0.0, 1.0]] * 3)
    edge, alone, partnered = np.zeros(3, dtype=np.int64), np.array([-1, -1, -1]), np.array([1, 0, -1])
    assert crossed(px, normal, edge, alone, start, end, 5.0).tolist() == [True, False, False]
    assert crossed(px, normal, edge, partnered, start, end, 5.0).tolist() == [False, False, False]
    assert crossed(px, normal, edge, partnered, start, end, 7.0).all()
