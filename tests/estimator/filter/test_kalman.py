"""The one update: shapes are checked before filterpy could broadcast them, the result is the textbook's, P stays symmetric."""

import numpy as np
import pytest

from estimator.filter.kalman import ErrorStateKalman
from models.messages import Array


def _problem(n: int, m: int, seed: int) -> tuple[Array, Array, Array, Array]:
    """P (n, n), nu (m,), H (m, n), R (m, m)."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    return a @ a.T + 0.1 * np.eye(n), rng.normal(size=m), rng.normal(size=(m, n)), b @ b.T + 0.1 * np.eye(m)


@pytest.mark.parametrize(("n", "m"), [(15, 1), (15, 3), (15, 6), (18, 3), (21, 6)])
def test_update_is_that_of_the_information_filter(n: int, m: int) -> None:
    cov, nu, h, noise = _problem(n, m, n + m)
    dx, posterior, gain = ErrorStateKalman(n).update(cov, nu, h, noise)
    information = np.linalg.inv(cov) + h.T @ np.linalg.solve(noise, h)
    expected = np.linalg.inv(information)
    np.testing.assert_allclose(posterior, expected, atol=1e-9 * np.abs(cov).max())
    np.testing.assert_allclose(dx, expected @ h.T @ np.linalg.solve(noise, nu), atol=1e-8)
    np.testing.assert_allclose(gain @ nu, dx, atol=1e-12)


def test_covariance_comes_out_exactly_symmetric_and_positive_where_the_short_form_fails() -> None:
    """A prior of 1e6 and a measurement of 1e-6: (I - K H) P loses symmetry and sign, Joseph's form does not."""
    rng = np.random.default_rng(0)
    a = rng.normal(size=(15, 15))
    cov = 1e6 * (a @ a.T)
    h, noise = rng.normal(size=(3, 15)), 1e-6 * np.eye(3)
    _, posterior, _ = ErrorStateKalman(15).update(0.5 * (cov + cov.T), rng.normal(size=3), h, noise)
    gain = cov @ h.T @ np.linalg.inv(h @ cov @ h.T + noise)
    short = (np.eye(15) - gain @ h) @ cov
    np.testing.assert_array_equal(posterior, posterior.T)
    assert np.linalg.eigvalsh(h @ posterior @ h.T)[0] > 0.0
    assert np.abs(short - short.T).max() > 0.0


def test_holds_nothing_from_one_update_to_the_next() -> None:
    kalman = ErrorStateKalman(15)
    first, second = _problem(15, 3, 1), _problem(15, 6, 2)
    alone = kalman.update(*first)
    kalman.update(*second)
    again = kalman.update(*first)
    np.testing.assert_array_equal(alone[0], again[0])
    np.testing.assert_array_equal(alone[1], again[1])


def test_leaves_its_arguments_alone() -> None:
    problem = _problem(15, 3, 3)
    before = [part.copy() for part in problem]
    ErrorStateKalman(15).update(*problem)
    for part, original in zip(problem, before, strict=True):
        np.testing.assert_array_equal(part, original)


@pytest.mark.parametrize(
    ("which", "shape"),
    [("nu", (3, 1)), ("h", (3, 14)), ("h", (2, 15)), ("noise", (3,)), ("noise", (1, 1)), ("cov", (14, 14)), ("cov", (15, 1))],
)
def test_a_shape_that_does_not_fit_is_refused(which: str, shape: tuple[int, ...]) -> None:
    cov, nu, h, noise = _problem(15, 3, 4)
    parts = {"cov": cov, "nu": nu, "h": h, "noise": noise} | {which: np.ones(shape)}
    with pytest.raises(ValueError, match="shapes do not fit"):
        ErrorStateKalman(15).update(**parts)


def test_a_singular_innovation_covariance_is_an_error_not_a_result() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        ErrorStateKalman(15).update(np.zeros((15, 15)), np.ones(3), np.ones((3, 15)), np.zeros((3, 3)))
