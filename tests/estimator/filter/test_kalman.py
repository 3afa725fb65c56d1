"""The one update: it is the textbook's and that of filterpy, P stays symmetric, a shape that does not fit is refused."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from estimator.filter.kalman import update
from models.messages import Array

NONE = np.zeros(0)


def _problem(n: int, m: int, seed: int) -> tuple[Array, Array, Array, Array]:
    """P (n, n), nu (m,), H (m, n), R (m, m)."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(n, n)), rng.normal(size=(m, m))
    return a @ a.T + 0.1 * np.eye(n), rng.normal(size=m), rng.normal(size=(m, n)), b @ b.T + 0.1 * np.eye(m)


def _updated(cov: Array, nu: Array, h: Array, noise: Array, estimated: Array = NONE) -> tuple[Array, Array]:
    """dx and the posterior."""
    posterior = cov.copy()
    return update(posterior, nu, h, h @ cov, noise, estimated), posterior


@pytest.mark.parametrize(("n", "m"), [(15, 1), (15, 3), (15, 6), (18, 3), (21, 6)])
def test_update_is_that_of_the_information_filter_and_of_filterpy(n: int, m: int) -> None:
    cov, nu, h, noise = _problem(n, m, n + m)
    dx, posterior = _updated(cov, nu, h, noise)
    expected = np.linalg.inv(np.linalg.inv(cov) + h.T @ np.linalg.solve(noise, h))
    np.testing.assert_allclose(posterior, expected, atol=1e-9 * np.abs(cov).max())
    np.testing.assert_allclose(dx, expected @ h.T @ np.linalg.solve(noise, nu), atol=1e-8)
    reference = KalmanFilter(dim_x=n, dim_z=m)
    reference.x, reference.P = np.zeros((n, 1)), cov
    reference.update(nu[:, np.newaxis], noise, h)
    np.testing.assert_allclose(posterior, reference.P, atol=1e-12 * np.abs(cov).max())
    np.testing.assert_allclose(dx, reference.x[:, 0], atol=1e-11)


def test_covariance_comes_out_exactly_symmetric_and_positive_where_the_short_form_fails() -> None:
    """A prior of 1e6 and a measurement of 1e-6: (I - K H) P loses symmetry and sign, Joseph's form does not."""
    rng = np.random.default_rng(0)
    a = rng.normal(size=(15, 15))
    cov = 1e6 * (a @ a.T)
    h, noise = rng.normal(size=(3, 15)), 1e-6 * np.eye(3)
    _, posterior = _updated(0.5 * (cov + cov.T), rng.normal(size=3), h, noise)
    gain = cov @ h.T @ np.linalg.inv(h @ cov @ h.T + noise)
    short = (np.eye(15) - gain @ h) @ cov
    np.testing.assert_array_equal(posterior, posterior.T)
    assert np.linalg.eigvalsh(h @ posterior @ h.T)[0] > 0.0
    assert np.abs(short - short.T).max() > 0.0


def test_what_is_considered_keeps_its_covariance_and_takes_no_correction() -> None:
    cov, nu, h, noise = _problem(18, 6, 5)
    estimated = np.array([0.0, 1.0, 0.0])
    dx, posterior = _updated(cov, nu, h, noise, estimated)
    gain = cov @ h.T @ np.linalg.inv(h @ cov @ h.T + noise)
    gain[[15, 17]] = 0.0
    left = np.eye(18) - gain @ h
    np.testing.assert_allclose(dx, gain @ nu, atol=1e-12)
    np.testing.assert_allclose(posterior, left @ cov @ left.T + gain @ noise @ gain.T, atol=1e-12 * np.abs(cov).max())
    np.testing.assert_array_equal(posterior[np.ix_([15, 17], [15, 17])], cov[np.ix_([15, 17], [15, 17])])


def test_leaves_all_but_the_covariance_alone() -> None:
    cov, *others = _problem(15, 3, 3)
    others.append(others[1] @ cov)
    before = [part.copy() for part in others]
    nu, h, noise, hp = others
    update(cov.copy(), nu, h, hp, noise, NONE)
    for part, original in zip(others, before, strict=True):
        np.testing.assert_array_equal(part, original)


@pytest.mark.parametrize(
    ("which", "shape"),
    [("nu", (3, 1)), ("h", (3, 14)), ("h", (2, 15)), ("hp", (3, 14)), ("noise", (3,)), ("noise", (1, 1)), ("cov", (14, 14)),
     ("cov", (15, 1)), ("estimated", (16,)), ("estimated", (1, 1))],
)  # fmt: skip
def test_a_shape_that_does_not_fit_is_refused(which: str, shape: tuple[int, ...]) -> None:
    cov, nu, h, noise = _problem(15, 3, 4)
    parts = {"cov": cov, "nu": nu, "h": h, "hp": h @ cov, "noise": noise, "estimated": NONE} | {which: np.ones(shape)}
    with pytest.raises(ValueError, match="shapes do not fit"):
        update(**parts)


def test_a_singular_innovation_covariance_is_an_error_not_a_result() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        update(np.zeros((15, 15)), np.ones(3), np.ones((3, 15)), np.zeros((3, 15)), np.zeros((3, 3)), NONE)
