"""Which other landmark a fix may have been made of, by map and prior alone."""

import numpy as np
import pytest

from models.maps.landmarks import Landmark
from models.messages import Array
from vision.identify.ambiguity import steps_off

POSITION, ODDS = np.array([0.0, 0.0, -60.0]), 1e3


def house(name: str, north: float, east: float, length: float = 14.0, width: float = 9.0) -> Landmark:
    half = 0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width]])
    return Landmark.of(name, half + np.array([north, east]), 0.0, 4.0)


HERE, NEXT, LARGE = house("here", 0.0, 0.0), house("next", 0.0, 25.0), house("large", 25.0, 0.0, 30.0, 20.0)


def doubted(
    sigma: float, off: tuple[float, float, float] = (0.0, 0.0, 0.0), near: tuple[Landmark, ...] = (HERE, NEXT),
    used: tuple[Landmark, ...] = (HERE,), share: float = 1.0 / 3.0,
) -> bool:  # fmt: skip
    covariance: Array = np.diag([sigma**2] * 3 + [1e-4] * 3)
    return len(steps_off(POSITION + off, used, near, POSITION, covariance, ODDS, share)) > 0


@pytest.mark.parametrize(("sigma", "doubt"), [(2.0, False), (6.0, False), (7.0, True), (20.0, True)])
def test_the_next_house_is_out_of_the_question_where_the_prior_reports_it(sigma: float, doubt: bool) -> None:
    """25 m are 3.72 sigma, of which the odds are 1000, at 6.7 m."""
    assert doubted(sigma) == doubt


def test_a_fix_far_from_the_prior_is_doubted_if_the_next_house_would_bring_it_back() -> None:
    assert doubted(5.0, (0.0, -18.0, 0.0))
    assert not doubted(5.0, (0.0, 10.0, 0.0))  # one step further is farther off still


def test_only_landmarks_that_look_alike_are_taken_for_each_other() -> None:
    assert not doubted(20.0, near=(HERE, LARGE))
    assert not doubted(20.0, near=(HERE,))
    across = house("across", 0.0, 25.0, 9.0, 14.0)  # turned by a quarter, which the heading decides
    assert not doubted(20.0, near=(HERE, across))
    assert doubted(20.0, near=(HERE, house("square", 0.0, 25.0, 11.0, 12.0)))


def test_a_circle_painted_in_a_square_is_no_other_position() -> None:
    assert not doubted(20.0, near=(HERE, house("rim", 0.5, 0.0, 15.0, 10.0)))


def test_a_step_counts_where_the_map_repeats_itself() -> None:
    """Three in a row: with two of them the street goes on, with three seen at their places one step would need unmapped ones."""
    row = tuple(house(str(k), 0.0, 25.0 * k) for k in range(4))
    apart = (row[0], house("a", 30.0, 7.0), house("b", -40.0, 12.0))
    assert doubted(20.0, near=row, used=row[:3])
    assert not doubted(12.0, near=(*apart, row[1]), used=apart)


def test_steps_tell_where_the_map_shows_the_same_each_of_them_once() -> None:
    """Three of a row of five: one step to either side has all three in the map, two steps only two of them."""
    row = tuple(house(str(k), 0.0, 25.0 * k) for k in range(-2, 3))
    covariance: Array = np.diag([20.0**2] * 3 + [1e-4] * 3)
    steps = steps_off(POSITION, row[1:4], row, POSITION, covariance, ODDS, 2.0 / 3.0)
    assert sorted(steps[:, 1].tolist()) == [-25.0, 25.0]
    both = steps_off(POSITION, row[1:4], row, POSITION, covariance, ODDS, 1.0 / 3.0)
    assert sorted(both[:, 1].tolist()) == [-50.0, -25.0, 25.0, 50.0]
