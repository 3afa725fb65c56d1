"""Profiles across an outline, their colours, and the search for where the roof ends."""

import numpy as np
import pytest

from vision.outline.edge_search import crossed, search
from vision.outline.profiles import along_contrast, profiles
from vision.outline.roof_colour import alien, covered, off_roof, roof_beside

POINTS, HALF = 12, 12
ONE = np.zeros(POINTS, dtype=np.int64)
ROOF = np.ones(1, dtype=np.bool_)
MARK = np.zeros(1, dtype=np.int64)


def bars(*widths_and_colours: tuple[int, tuple[float, float, float]]) -> np.ndarray:
    """Profiles (N, 25, 3) of bars one after the other."""
    profile = np.concatenate([np.tile(colour, (width, 1)) for width, colour in widths_and_colours])
    return np.tile(profile, (POINTS, 1, 1)).astype(float)


def every(values: np.ndarray) -> np.ndarray:
    return np.ones(len(values), dtype=np.bool_)


def everything() -> np.ndarray:
    return np.ones(POINTS, dtype=np.bool_)


def beside(values: np.ndarray, edge: np.ndarray, interior: np.ndarray | None = None) -> np.ndarray:
    """The roof's colour beside each point, of edges of one landmark that are all its roof's."""
    marks = np.zeros(edge.max() + 1, dtype=np.int64)
    seen = np.full(len(values), interior is not None)
    roof, all_of_it = np.ones(len(marks), dtype=np.bool_), np.ones(len(values), dtype=np.bool_)
    return roof_beside(values, values[:, :5] if interior is None else interior, seen, edge, marks, roof, all_of_it)


def test_profiles_of_a_ramp_are_the_ramp() -> None:
    v, u = np.mgrid[0:60, 0:80]
    image = np.stack([2 * u, 2 * v, u + v], axis=2).astype(np.uint8)
    px = np.array([[40.3, 30.6], [35.0, 25.0]])
    normal = np.array([[0.6, 0.8], [-1.0, 0.0]])
    values = profiles(image, px, normal, 4, 0.5, 3, np.ones(2, dtype=np.bool_))
    at = px[:, None, :] + np.arange(-2.0, 2.5, 0.5)[None, :, None] * normal[:, None, :]
    np.testing.assert_allclose(values, np.stack([2 * at[..., 0], 2 * at[..., 1], at.sum(axis=2)], axis=2), atol=1e-9)


def test_a_profile_that_leaves_the_image_is_not_usable() -> None:
    usable = np.ones(3, dtype=np.bool_)
    px = np.array([[3.0, 20.0], [20.0, 20.0], [np.nan, 5.0]])
    profiles(np.zeros((40, 40, 1), dtype=np.uint8), px, np.tile([1.0, 0.0], (3, 1)), 5, 1.0, 1, usable)
    assert usable.tolist() == [False, True, False]


RED, DARK, GREEN = (40.0, 40.0, 190.0), (25.0, 35.0, 30.0), (70.0, 120.0, 110.0)


@pytest.mark.parametrize("shift", [-4, 0, 5])
def test_the_roof_ends_where_its_colour_ends_not_where_the_shadow_does(shift: int) -> None:
    """The shadow's rim has the larger contrast in green; the roof ends before it."""
    values = bars((12 + shift, RED), (4, DARK), (9 - shift, GREEN))
    distance = off_roof(values, beside(values, ONE), ONE, ROOF, everything())
    assert not covered(values, beside(values, ONE), ONE, MARK, ROOF, everything()).any()
    offsets = search(distance, ONE, 1, 1.0, everything())
    np.testing.assert_allclose(offsets, shift - 0.5, atol=0.6)


def test_points_of_an_edge_inside_the_ground_are_not_the_roofs() -> None:
    """Two edges of one landmark: one has the roof inside, the other ground on both sides."""
    edge = np.repeat([0, 1], (POINTS, POINTS // 2))
    values = np.concatenate((
        bars((13, RED), (12, GREEN)),  # the roof's colour is the majority's
        bars((13, GREEN), (12, (90.0, 150.0, 140.0)))[: POINTS // 2],
    ))  # fmt: skip
    found = covered(values, beside(values, edge), edge, np.zeros(2, dtype=np.int64), np.ones(2, dtype=np.bool_), every(values))
    np.testing.assert_array_equal(found, edge == 1)


@pytest.mark.parametrize("hidden", [0, 4, 8])
def test_a_roof_keeps_its_colour_where_a_tower_hides_most_of_its_rim(hidden: int) -> None:
    """The tower goes on beyond the rim, the roof ends there; what the tower covers does not count."""
    values = bars((13, RED), (12, GREEN))
    values[:hidden] = bars((25, (150.0, 152.0, 150.0)))[:hidden]
    ours = beside(values, ONE)
    np.testing.assert_allclose(ours, np.tile(RED, (POINTS, 1)))
    found = covered(values, ours, ONE, MARK, ROOF, everything())
    np.testing.assert_array_equal(found, np.arange(POINTS) < hidden)


def test_a_shadow_across_a_roof_covers_nothing() -> None:
    values = bars((13, RED), (12, GREEN))
    values[:5] *= 0.55
    assert not covered(values, beside(values, ONE), ONE, MARK, ROOF, everything()).any()


def test_texture_of_a_roof_covers_nothing() -> None:
    """Shingles as rough as the roof's contrast with the ground is small."""
    rng = np.random.default_rng(4)
    values = bars((13, (150.0, 150.0, 150.0)), (12, (138.0, 138.0, 138.0))) + 6.0 * rng.normal(size=(POINTS, 25, 1))
    assert not covered(values, beside(values, ONE), ONE, MARK, ROOF, everything()).any()


def test_a_slope_in_other_light_is_roof_and_a_wall_is_not() -> None:
    """Most of the outline runs along the light slope, one edge along the dark one, and one along the foot of a dark wall."""
    light, dark = np.array([150.0, 140.0, 145.0]), 0.82 * np.array([150.0, 140.0, 145.0])
    edge = np.repeat([0, 1, 2], (2 * POINTS, POINTS // 2, POINTS // 2))
    values = np.concatenate((
        np.repeat(bars((13, tuple(light)), (12, GREEN)), 2, axis=0),
        np.repeat(bars((13, tuple(dark)), (12, GREEN)), 2, axis=0)[: POINTS],
    ))  # fmt: skip
    interior = np.tile(light, (len(values), 5, 1))
    interior[edge == 1] = dark  # farther inside: the same slope; behind the wall: the light one
    ours = beside(values, edge, interior)
    np.testing.assert_allclose(ours[edge == 1], dark[None].repeat(POINTS // 2, axis=0))
    roof, everywhere = np.ones(3, dtype=np.bool_), np.ones(len(values), dtype=np.bool_)
    assert not covered(values, ours, edge, np.zeros(3, dtype=np.int64), roof, everywhere).any()
    assert alien(values, ours, edge, roof, everywhere).tolist() == [False, False, True]
    offsets = search(off_roof(values, ours, edge, roof, everywhere), edge, 3, 1.0, everywhere)
    np.testing.assert_allclose(offsets[edge == 1], 0.5, atol=0.6)


def test_texture_makes_no_step() -> None:
    """Roughness as strong as a weak step, without one: hardly an edge is elected; with one it is."""
    rng, found = np.random.default_rng(2), [0, 0]
    for _ in range(50):
        rough = 8.0 + 6.0 * rng.normal(size=(POINTS, 25))
        for k, step in enumerate((0.0, 25.0)):
            offsets = search(rough + step * (np.arange(25) > 12), ONE, 1, 1.0, everything())
            found[k] += bool(np.isfinite(offsets).any())
    assert found[0] <= 2
    assert found[1] >= 48


def test_no_step_no_offset() -> None:
    distance = off_roof(bars((25, GREEN)), beside(bars((25, GREEN)), ONE), ONE, ROOF, everything())
    assert np.isnan(search(distance, ONE, 1, 1.0, everything())).all()


def test_two_equal_steps_are_ambiguous() -> None:
    """Off the roof, back on it, off again: either may be its end."""
    off = np.concatenate((np.zeros(5), np.full(6, 60.0), np.zeros(6), np.full(8, 60.0)))
    assert np.isnan(search(np.tile(off, (POINTS, 1)), ONE, 1, 1.0, everything())).all()
    once = np.concatenate((np.zeros(17), np.full(8, 60.0)))
    assert np.isfinite(search(np.tile(once, (POINTS, 1)), ONE, 1, 1.0, everything())).all()


def test_contrast_leaves_saturated_channels_out() -> None:
    values = bars((12, (255.0, 150.0, 60.0)), (13, (150.0, 20.0, 60.0)))
    grey, clipped = along_contrast(values, ONE, ROOF, everything())
    np.testing.assert_allclose(np.abs(grey[:, -1] - grey[:, 0]), 130.0)  # green alone
    assert not clipped[0]


def test_contrast_that_is_all_saturated_is_said() -> None:
    values = bars((12, (255.0, 60.0, 60.0)), (13, (100.0, 50.0, 60.0)))
    grey, clipped = along_contrast(values, ONE, ROOF, everything())
    assert clipped[0]
    assert np.abs(grey[0, -1] - grey[0, 0]) > 150.0


def test_contrast_of_a_dark_wall_between_two_like_colours() -> None:
    values = bars((9, GREEN), (7, DARK), (9, GREEN))
    grey, _ = along_contrast(values, ONE, ROOF, everything())
    assert np.ptp(grey[0]) > 80.0


@pytest.mark.parametrize(
    ("between", "measured"),
    [((39.0, 72.0, 62.0), True), ((150.0, 150.0, 150.0), False), ((20.0, 30.0, 110.0), False), ((70.0, 130.0, 110.0), False)],
    ids=["its shadow", "a parapet", "red gutters", "hardly darker"],
)
def test_contrast_beside_a_shadow_is_where_the_roof_ends(between: tuple[float, float, float], measured: bool) -> None:
    """A green roof that has as little red as the shadow it casts on a meadow: by the red of both sides only this one ends."""
    roof, meadow = (60.0, 146.0, 50.0), (86.0, 160.0, 138.0)
    grey, _ = along_contrast(bars((12, roof), (3, between), (10, meadow)), ONE, ROOF, everything())
    strip, outside = abs(grey[0, 13] - grey[0, 0]), abs(grey[0, -1] - grey[0, 0])
    whole_strip, whole_outside = (np.linalg.norm(np.subtract(colour, roof)) for colour in (between, meadow))
    assert np.isclose(strip, whole_strip) == measured
    assert np.isclose(outside, whole_outside) == (not measured)


def test_a_dark_line_on_the_roof_is_no_shadow_beside_it() -> None:
    """A line of the meadow's colour in a shadow, well inside: the roof ends where the meadow begins."""
    roof, meadow = (60.0, 146.0, 50.0), (86.0, 160.0, 138.0)
    values = bars((5, roof), (1, (39.0, 72.0, 62.0)), (6, roof), (13, meadow))
    grey, _ = along_contrast(values, ONE, ROOF, everything())
    assert abs(grey[0, -1] - grey[0, 8]) > 0.95 * np.linalg.norm(np.subtract(meadow, roof))


def test_profiles_crossed_by_another_edge() -> None:
    start, end = np.array([[0.0, 0.0], [0.0, 4.0], [0.0, 6.0]]), np.array([[50.0, 0.0], [20.0, 4.0], [50.0, 6.0]])
    px, normal = np.array([[10.0, 0.0], [30.0, 0.0], [30.0, 0.0]]), np.array([[0.0, 1.0]] * 3)
    edge, alone, partnered = np.zeros(3, dtype=np.int64), np.array([-1, -1, -1]), np.array([1, 0, -1])
    assert crossed(px, normal, edge, alone, start, end, 5.0).tolist() == [True, False, False]
    assert crossed(px, normal, edge, partnered, start, end, 5.0).tolist() == [False, False, False]
    assert crossed(px, normal, edge, partnered, start, end, 7.0).all()
