"""The density of what is not in the map, at the turn and scale of a hypothesis."""

import numpy as np
import pytest

from vision.identify.assignment import SCALE, STATES
from vision.identify.clutter_density import ClutterDensity

TURNS, SCALES = np.linspace(-0.1, 0.1, 5), np.linspace(-0.08, 0.08, 5)
HEADING = 5


def state(turn: float, scale: float, sigma: float) -> tuple[np.ndarray, np.ndarray]:
    x, covariance = np.zeros((1, STATES)), np.zeros((1, STATES, STATES))
    x[0, HEADING], x[0, SCALE] = turn, scale
    covariance[0] = sigma**2 * np.eye(STATES)
    return x, covariance


def summit_at(t: int, s: int, low: float = 0.01) -> ClutterDensity:
    """One region next to which much stands, were the image turned and grown just so."""
    density = np.full((1, 5, 5), low)
    density[0, t, s] = 1.0
    return ClutterDensity(np.log(density), np.zeros((5, 5)), TURNS, SCALES)


ABSENT = np.ones((1, 1), np.bool_)


def test_a_hypothesis_is_judged_by_the_density_at_its_own_turn_and_scale() -> None:
    clutter_density = summit_at(3, 1)
    assert clutter_density.highest == pytest.approx(0.0)
    there = clutter_density.below_highest(ABSENT, *state(TURNS[3], SCALES[1], 1e-4))
    beside = clutter_density.below_highest(ABSENT, *state(TURNS[1], SCALES[3], 1e-4))
    assert there == pytest.approx(0.0, abs=0.6)
    assert beside == pytest.approx(np.log(0.01), abs=0.1)


def test_one_that_has_not_found_them_is_judged_by_the_mean() -> None:
    unknown = summit_at(3, 1).below_highest(ABSENT, *state(0.0, 0.0, 10.0))
    assert unknown == pytest.approx(np.log((1.0 + 24 * 0.01) / 25.0), abs=1e-3)


def test_a_density_that_is_the_same_everywhere_changes_nothing() -> None:
    clutter_density = ClutterDensity(np.full((2, 5, 5), -3.0), np.zeros((5, 5)), TURNS, SCALES)
    below = clutter_density.below_highest(
        np.array([[True, True]]), *state(0.03, -0.5, 1e-3)
    )  # its scale is beyond those considered
    np.testing.assert_allclose(below, 0.0, atol=1e-12)


def test_only_what_is_said_not_to_be_in_the_map_counts() -> None:
    clutter_density = summit_at(3, 1)
    assert clutter_density.below_highest(~ABSENT, *state(0.0, 0.0, 1e-4)) == pytest.approx(0.0)


def test_where_no_region_is_a_landmark_the_first_may_stand_anywhere() -> None:
    """With one landmark named, the others have a position in the map, and stand a block from it."""
    density = ClutterDensity(np.full((2, 5, 5), -3.0), np.full((5, 5), 4.0), TURNS, SCALES)
    x, covariance = state(0.0, 0.0, 1e-3)
    absent = np.array([[True, True], [True, False]])
    below = density.below_highest(absent, np.repeat(x, 2, axis=0), np.repeat(covariance, 2, axis=0))
    np.testing.assert_allclose(below, [-4.0, 0.0], atol=1e-12)
