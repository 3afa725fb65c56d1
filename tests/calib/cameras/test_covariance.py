import numpy as np
import pytest

from calib.cameras.covariance import bowed, marginal
from models.messages import Array

_VIEWS, _UNKNOWNS = 14, 6


def solved(rng: np.random.Generator, in_common: Array) -> tuple[Array, Array, Array]:
    """H_i, g_i at the solution and s - 0 of views whose corners err independently (1 px), and by e_i of scatter in_common."""
    roots = rng.normal(size=(_VIEWS, 3 * _UNKNOWNS, _UNKNOWNS)) * np.array([1.0, 1e-3, 1e3, 1.0, 1.0, 1.0])
    H_i = roots.transpose(0, 2, 1) @ roots
    errors = rng.normal(size=(_VIEWS, _UNKNOWNS)) * in_common
    g_i = np.array([J.T @ (J @ e + rng.normal(size=len(J))) for J, e in zip(roots, errors, strict=True)])
    s = np.linalg.solve(H_i.sum(axis=0), g_i.sum(axis=0))
    return H_i, g_i - H_i @ s, s


def scatter(in_common: Array) -> tuple[Array, Array]:
    """RMS of s over its sigma, and over the one that is widened alike in all directions, over many draws."""
    z, alike = [], []
    for seed in range(60):
        H_i, g_i, s = solved(np.random.default_rng(seed), in_common)
        spread = marginal(H_i, g_i, 1.0)
        z.append(s / np.sqrt(np.diagonal(spread.covariance)))
        alike.append(s / np.sqrt(spread.f * np.diagonal(np.linalg.inv(H_i.sum(axis=0)))))
    return np.sqrt(np.mean(np.square(z), axis=0)), np.sqrt(np.mean(np.square(alike), axis=0))


def test_independent_errors_leave_the_inverse_of_the_normal_matrix() -> None:
    H_i, g_i, _ = solved(np.random.default_rng(1), np.zeros(_UNKNOWNS))
    spread = marginal(H_i, g_i, 1.0)
    np.testing.assert_allclose(spread.covariance, np.linalg.inv(H_i.sum(axis=0)), rtol=1e-9)
    assert (spread.f, spread.widened) == (1.0, 1.0)
    z, _ = scatter(np.zeros(_UNKNOWNS))
    assert 0.8 < np.sqrt(np.mean(z**2)) < 1.1


def test_errors_in_common_widen_the_parameters_that_they_move() -> None:
    """The first parameter is another one in each view; scaled alike, its sigma would be by far too small."""
    z, alike = scatter(np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert alike[0] > 1.6
    assert 0.7 < z[0] < 1.3  # Student's, not the normal law: 14 views
    assert z[1:].max() < 1.1


def test_sigma_is_never_less_than_the_common_factor_reports() -> None:
    H_i, g_i, _ = solved(np.random.default_rng(3), np.full(_UNKNOWNS, 0.5))
    spread = marginal(H_i, g_i, 1.0)
    assert spread.widened > spread.f > 1.2
    scale = np.sqrt(np.diagonal(H_i.sum(axis=0)))
    more = (spread.covariance - spread.f * np.linalg.inv(H_i.sum(axis=0))) * np.outer(scale, scale)
    assert np.linalg.eigvalsh(more).min() > -1e-9 * np.abs(more).max()


def test_a_view_that_the_solution_hangs_on_leaves_nothing_to_compare() -> None:
    H_i = np.array([np.diag([1.0, 0.0]), np.diag([1.0, 0.0]), np.diag([1.0, 2.0])])
    spread = marginal(H_i, np.array([[9.0, 0.0], [-4.0, 0.0], [-5.0, 0.0]]), 100.0)
    np.testing.assert_allclose(spread.covariance, np.diag([100.0 / 3.0, 50.0]))
    assert spread.f == 1.0


def test_the_bow_is_where_the_normal_equations_have_their_minimum() -> None:
    rng = np.random.default_rng(0)
    J, truth = rng.normal(size=(400, 7)), np.array([0.3, -0.2, 0.1, 0.5, 0.02, 0.0, -0.04])
    r = J @ truth
    r -= J[:, :4] @ np.linalg.lstsq(J[:, :4], r, rcond=None)[0]  # at the solution without a bow
    bow, moved = bowed(J.T @ J, J.T @ r, 1e-4, 0.2)
    assert bow == pytest.approx(0.25 * 0.2 * 0.04)
    without = truth[:4] + np.linalg.lstsq(J[:, :4], J[:, 4:] @ truth[4:], rcond=None)[0]
    np.testing.assert_allclose(moved, truth[:4] - without)
    assert bowed(J.T @ J, J.T @ r, 1.0, 0.2)[0] == 0.0
