"""Bounds: what is compiled passes nothing that the words refuse, and nothing that is no number."""

import math

import numpy as np
import pytest

from estimator.filter.bounds import BoundsConfig
from models import so3
from models.state import E, X

_BOUNDS = BoundsConfig(speed_m_s=20.0, lowest_m=0.0, highest_m=1000.0, sigma_m=100.0)
_ORIGIN_M = 500.0


def _violation(place: int | None = None, value: float = 0.0, diagonal: int | None = None, variance: float = 0.0) -> str:
    """Of a state at rest at the origin with one number changed."""
    x, cov = np.zeros(X.SIZE), 0.01 * np.eye(E.SIZE)
    x[X.Q] = so3.from_euler(0.1, -0.2, 1.0)
    if place is not None:
        x[place] = value
    if diagonal is not None:
        cov[diagonal, diagonal] = variance
    return _BOUNDS.violation(x, cov, _ORIGIN_M)


@pytest.mark.parametrize(
    ("place", "good", "bad", "says"),
    [
        (X.V.start, 19.9, 20.1, "speed of 20 m/s exceeds"),
        (X.V.stop - 1, -19.9, math.nan, "speed of nan"),
        (X.P.stop - 1, -499.0, -501.0, "height of 1001 m is outside"),
        (X.P.stop - 1, 499.0, 501.0, "height of -1 m is outside"),
        (X.P.stop - 1, 0.0, math.nan, "height of nan m is outside"),
    ],
)
def test_a_state_out_of_bounds_is_named(place: int, good: float, bad: float, says: str) -> None:
    assert _violation(place, good) == ""
    assert says in _violation(place, bad)


@pytest.mark.parametrize(
    ("diagonal", "good", "bad", "says"),
    [
        (E.P.start, 99.0**2, 101.0**2, "position sigma of 101 m"),
        (E.P.start, 99.0**2, math.nan, "position sigma"),
        (E.THETA.start, math.radians(59.0) ** 2, math.radians(100.0) ** 2, "roll and pitch"),
    ],
)
def test_a_covariance_out_of_bounds_is_named(diagonal: int, good: float, bad: float, says: str) -> None:
    assert _violation(diagonal=diagonal, variance=good) == ""
    assert says in _violation(diagonal=diagonal, variance=bad)


def test_a_heading_may_be_unknown() -> None:
    assert _violation(diagonal=E.THETA.stop - 1, variance=math.radians(100.0) ** 2) == ""
