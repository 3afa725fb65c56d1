"""Gauss-Newton between two pairs, on points without images."""

import numpy as np
import pytest

from models import so3
from models.messages import Array
from tests.vision.odometry.scene import RIG, truth
from vision.image.rectify import rectification
from vision.odometry.motion import Geometry, Motion, Plane, solve

GEOMETRY = Geometry(rectification(RIG).rig)
START = Motion(np.zeros(3), np.eye(3))


def points(rng: np.random.Generator, n: int, near_m: float, far_m: float) -> Array:
    z = rng.uniform(near_m, far_m, n)
    return np.column_stack((rng.uniform(-0.4, 0.4, n) * z, rng.uniform(-0.3, 0.3, n) * z, z))


def measured(x: Array, motion: Motion, sigma: float, rng: np.random.Generator) -> tuple[Array, Array]:
    y0, _ = GEOMETRY.project(x)
    y1, _ = GEOMETRY.project(GEOMETRY.seen_from(motion, x)[1])
    return y0 + rng.normal(0.0, sigma, y0.shape), y1 + rng.normal(0.0, sigma, y1.shape)


def error(motion: Motion, true: Motion) -> Array:
    turn = so3.quat_log(so3.from_matrix(np.ascontiguousarray(true.R.T @ motion.R)))
    return np.concatenate((motion.p - true.p, turn))


def test_exact_points_give_the_exact_motion() -> None:
    true = Motion(*truth())
    y0, y1 = measured(points(np.random.default_rng(1), 40, 5.0, 20.0), true, 0.0, np.random.default_rng(2))
    solution = solve(GEOMETRY, y0, y1, 0.25, 0.1, START, None)
    assert solution.converged
    np.testing.assert_allclose(error(solution.motion, true), 0.0, atol=2e-4)  # stops far below its sigma
    assert solution.distances.max() < 1e-4


def test_no_points_give_no_motion_and_no_warning() -> None:
    none = np.zeros((0, 3))
    for guide in (None, np.eye(6)):
        assert not solve(GEOMETRY, none, none, 0.25, 0.1, START, None, guide=guide).converged


def test_the_covariance_is_that_of_the_errors() -> None:
    """200 draws of the noise: the squared distances have the mean of a chi-square of 6."""
    true, rng = Motion(*truth()), np.random.default_rng(3)
    x = points(rng, 60, 5.0, 25.0)
    d = []
    for _ in range(200):
        y0, y1 = measured(x, true, 0.3, rng)
        solution = solve(GEOMETRY, y0, y1, 0.3, 0.01, true, None)
        e = error(solution.motion, true)
        total = solution.covariance + solution.systematic @ solution.systematic.T
        d.append(e @ np.linalg.solve(total, e) / solution.scale**2)
    assert 3.5 < np.mean(d) < 7.5  # Cauchy weights make the covariance somewhat too large


def test_small_disparities_do_not_shorten_the_motion() -> None:
    """Points at 3 px of disparity: with depths held where the first pair measured them the motion comes out 1 % too short."""
    true, rng = Motion(np.array([4.0, 0.0, 0.0]), np.eye(3)), np.random.default_rng(4)
    x = points(rng, 120, 55.0, 65.0)
    e = []
    for _ in range(60):
        y0, y1 = measured(x, true, 0.3, rng)
        e.append(solve(GEOMETRY, y0, y1, 0.3, 0.001, true, None).motion.p[0] - 4.0)
    assert abs(np.mean(e)) < 3.0 * np.std(e) / np.sqrt(len(e)) + 0.01


def test_systematic_is_what_a_disparity_error_does() -> None:
    true, rng = Motion(np.array([2.0, 0.5, 0.0]), np.eye(3)), np.random.default_rng(5)
    y0, y1 = measured(points(rng, 80, 20.0, 22.0), true, 0.0, rng)
    bias = 0.1
    y0[:, 2] -= bias  # disparities too large
    y1[:, 2] -= bias
    solution = solve(GEOMETRY, y0, y1, 0.25, bias, true, None)
    e = error(solution.motion, true)
    assert np.linalg.norm(e[:3]) > 0.01
    np.testing.assert_allclose(e[:3], solution.systematic[:3, 0], atol=0.15 * float(np.linalg.norm(e[:3])))


@pytest.mark.parametrize("right", [True, False])
def test_a_plane_gives_the_scale(right: bool) -> None:
    """Level ground, a height 1 sigma (5 %) too large: the motion is too long, and systematic says so."""
    true, rng = Motion(np.array([2.0, 0.5, 0.0]), np.eye(3)), np.random.default_rng(6)
    n, h = GEOMETRY.R_bc.T @ np.array([0.0, 0.0, 1.0]), 60.0
    m = np.column_stack((rng.uniform(-0.4, 0.4, 80), rng.uniform(-0.3, 0.3, 80), np.ones(80)))
    y0, y1 = measured(m * (h / (m @ n))[:, None], true, 0.05, rng)
    if not right:
        y0[:, 2] = y1[:, 2] = np.nan
    plane = Plane(n, 1.05 * h, 0.05 * h, np.radians(3.0), 0.5)
    solution = solve(GEOMETRY, y0, y1, 0.25, 0.5, true, plane)
    e = error(solution.motion, true)
    assert solution.converged
    np.testing.assert_allclose(e[:3], solution.systematic[:3, 1], atol=0.02)
    if not right:
        np.testing.assert_allclose(solution.motion.p[:2], 1.05 * true.p[:2], atol=0.02)


def test_outliers_do_not_move_it() -> None:
    true, rng = Motion(*truth()), np.random.default_rng(7)
    y0, y1 = measured(points(rng, 60, 5.0, 20.0), true, 0.1, rng)
    y1[:18] += rng.uniform(-40.0, 40.0, (18, 3))
    solution = solve(GEOMETRY, y0, y1, 0.25, 0.01, true, None)
    assert np.linalg.norm(error(solution.motion, true)[:3]) < 0.02
    assert (solution.distances[:18] > 16.0).all()


def test_a_guide_finds_the_nearer_of_two_motions() -> None:
    near, far, rng = Motion(*truth()), Motion(truth()[0] + [0.0, 0.8, 0.0], truth()[1]), np.random.default_rng(8)
    x = points(rng, 60, 15.0, 20.0)
    (a0, a1), (b0, b1) = measured(x[:25], near, 0.1, rng), measured(x[25:], far, 0.1, rng)
    guide = np.diag(np.r_[np.full(3, 0.1**-2), np.full(3, np.radians(0.2) ** -2)])
    start = Motion(near.p + 0.04, near.R)
    solution = solve(GEOMETRY, np.vstack((a0, b0)), np.vstack((a1, b1)), 0.25, 0.1, start, None, guide=guide)
    assert (solution.distances[:25] < 16.0).all()
    assert (solution.distances[25:] > 16.0).all()


@pytest.mark.parametrize("far_m", [30.0, 3000.0])
def test_the_covariance_is_symmetric_and_positive_however_badly_the_points_show_the_motion(far_m: float) -> None:
    """Points far off hardly show the translation: metres and radians of the information differ by many orders of magnitude."""
    rng = np.random.default_rng(5)
    y0, y1 = measured(points(rng, 12, 0.9 * far_m, far_m), Motion(*truth()), 0.0, rng)
    covariance = solve(GEOMETRY, y0, y1, 0.25, 1e-3, START, None).covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
