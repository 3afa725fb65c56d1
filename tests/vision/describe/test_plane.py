"""The disparity plane: what it finds, what it refuses, and whether its covariance is true."""

import numpy as np

from models.messages import Array
from vision.describe.plane import fit_plane

FLAT = np.zeros(2)


def drawn(rng: np.random.Generator, count: int = 30) -> tuple[Array, Array, Array]:
    points = rng.uniform(0, 80, (count, 2))
    sigmas = rng.uniform(0.03, 0.2, count)
    return points, 9.0 + 0.01 * points[:, 0] - 0.004 * points[:, 1] + rng.normal(0, sigmas), sigmas


def test_the_covariance_is_true() -> None:
    """Mean Mahalanobis distance squared of (c, p, q) over 300 draws: chi-square of 3, 99.9 % of the mean within 2.6..3.4."""
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(300):
        points, d, sigmas = drawn(rng)
        plane = fit_plane(points, d, sigmas, FLAT, 10.0)
        assert plane is not None
        at_origin = 9.0 + 0.01 * plane.origin[0] - 0.004 * plane.origin[1]
        error = plane.coefficients - (at_origin, 0.01, -0.004)
        squares.append(error @ np.linalg.solve(plane.covariance, error))
    assert 2.5 < np.mean(squares) < 3.6  # the robust weights cost some 5 %


def test_sigmas_that_are_too_small_are_found_out() -> None:
    rng = np.random.default_rng(2)
    points, d, sigmas = drawn(rng, 60)
    plane = fit_plane(points, d, sigmas / 5.0, FLAT, 10.0)
    assert plane is not None
    assert 3.5 < plane.scatter < 6.0


def test_a_third_of_the_points_may_lie() -> None:
    rng = np.random.default_rng(3)
    points, d, sigmas = drawn(rng, 40)
    d[::3] += rng.choice((-1, 1), d[::3].size) * rng.uniform(1.0, 4.0, d[::3].size)
    plane = fit_plane(points, d, sigmas, FLAT, 10.0)
    assert plane is not None
    assert np.abs(plane.at(points) - (9.0 + 0.01 * points[:, 0] - 0.004 * points[:, 1])).max() < 0.15
    assert 22 <= plane.used <= 28


def test_what_is_accepted_of_the_tilt_holds_where_the_points_say_nothing() -> None:
    plane = fit_plane(np.array([[5.0, 5.0]]), np.array([7.0]), np.array([0.1]), np.array([0.01, 0.02]), 0.003)
    assert plane is not None
    np.testing.assert_allclose(plane.coefficients, (7.0, 0.01, 0.02), atol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(plane.covariance)), (0.1, 0.003, 0.003), rtol=1e-6)


def test_without_points_there_is_no_plane() -> None:
    assert fit_plane(np.empty((0, 2)), np.empty(0), np.empty(0), FLAT, 1.0) is None
