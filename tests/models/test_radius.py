"""The 95 % circle of an ellipse, the reach of an ellipsoid: against their limits, and against draws."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from models.radius import horizontal_radius, reach


def test_no_row_gives_no_row() -> None:
    assert horizontal_radius(np.empty((0, 2, 2))).shape == (0,)


def test_horizontal_radius_limits() -> None:
    """A circle: sqrt(chi2_2); a line: the normal's two-sided quantile; it turns and scales with the ellipse."""
    r = horizontal_radius(np.array([np.eye(2), np.diag([0.0, 4.0]), 9.0 * np.eye(2), np.zeros((2, 2)), np.diag([np.nan, 1.0])]))
    np.testing.assert_allclose(r, [2.447747, 2 * 1.959964, 3 * 2.447747, 0.0, np.nan], atol=1e-5)


@pytest.mark.parametrize("minor", [0.03, 0.4, 0.8])
def test_horizontal_radius_holds_95_percent(minor: float) -> None:
    rng = np.random.default_rng(8)
    turn = Rotation.from_rotvec([0, 0, 0.7]).as_matrix()[:2, :2]
    covariance = turn @ np.diag([1.0, minor**2]) @ turn.T
    error = rng.multivariate_normal([0, 0], covariance, size=200_000)
    inside = np.linalg.norm(error, axis=1) <= horizontal_radius(covariance[None])[0]
    assert inside.mean() == pytest.approx(0.95, abs=0.002)


def test_reach_is_that_of_the_worst_direction() -> None:
    """sqrt(chi2_3) of the largest standard deviation, however the ellipsoid is turned; nothing is known of what is not finite."""
    turn = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
    assert reach(turn @ np.diag([0.01, 4.0, 1.0]) @ turn.T) == pytest.approx(2 * 2.795483, rel=1e-6)
    assert reach(np.zeros((3, 3))) == 0.0
    assert np.isnan(reach(np.diag([1.0, np.nan, 1.0])))


def test_reach_bounds_95_percent_of_errors_along_every_direction() -> None:
    rng = np.random.default_rng(9)
    covariance = np.diag([0.2, 1.0, 0.5]) ** 2
    error = rng.multivariate_normal(np.zeros(3), covariance, size=100_000)
    squared = np.einsum("ni,ij,nj->n", error, np.linalg.inv(covariance), error)
    inside = error[squared < np.quantile(squared, 0.95)]
    assert np.abs(inside).max() == pytest.approx(reach(covariance), rel=0.02)
