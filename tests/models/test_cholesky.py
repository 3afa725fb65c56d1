"""Cholesky's factor and what is solved with it, against numpy."""

import math

import numpy as np
import pytest

from models import cholesky
from models.messages import Array


def _definite(m: int) -> Array:
    a = np.random.default_rng(m).normal(size=(m, m + 2))
    s: Array = a @ a.T
    return s


@pytest.mark.parametrize("m", [1, 3, 6])
def test_factor_is_the_lower_root(m: int) -> None:
    s, low = _definite(m), np.zeros((m, m))
    assert cholesky.factor(s, low)
    np.testing.assert_allclose(low, np.linalg.cholesky(s), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan])
def test_what_is_not_positive_definite_has_no_factor_and_no_inverse(bad: float) -> None:
    s = np.diag([1.0, bad, 1.0])
    assert not cholesky.factor(s, np.zeros((3, 3)))
    with pytest.raises(np.linalg.LinAlgError):
        cholesky.inverse(s)


@pytest.mark.parametrize("m", [1, 3, 6])
def test_forward_and_backward_solve_with_the_factor_and_its_transpose(m: int) -> None:
    low, b = np.zeros((m, m)), np.random.default_rng(0).normal(size=(m, 2))
    assert cholesky.factor(_definite(m), low)
    y = b.copy()
    cholesky.forward(low, y)
    np.testing.assert_allclose(low @ y, b, rtol=1e-12, atol=1e-12)
    x = b.copy()
    cholesky.backward(low, x)
    np.testing.assert_allclose(low.T @ x, b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("m", [1, 3, 6])
def test_substitution_solves_in_place_of_matrix_and_right_hand_side(m: int) -> None:
    s, b = _definite(m), np.random.default_rng(1).normal(size=m)
    low, x = s.copy(), b.copy()
    assert cholesky.factor(low, low)
    cholesky.substitute(low, x)
    np.testing.assert_allclose(s @ x, b, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("m", [1, 3, 6])
def test_inverse_is_exactly_symmetric(m: int) -> None:
    s = _definite(m)
    inverse = cholesky.inverse(s)
    np.testing.assert_allclose(inverse @ s, np.eye(m), atol=1e-10)
    np.testing.assert_array_equal(inverse, inverse.T)


def test_symmetrise_takes_the_mean_of_the_two_halves() -> None:
    m = np.arange(9.0).reshape(3, 3)
    expected = 0.5 * (m + m.T)
    cholesky.symmetrise(m)
    np.testing.assert_array_equal(m, expected)
