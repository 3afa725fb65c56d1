"""Eigenvalues by Jacobi's rotations, against numpy."""

import numpy as np
import pytest

from models import jacobi
from models.messages import Array


def _matrix(k: int, rank: int, scale: Array, seed: int) -> Array:
    a = np.random.default_rng(seed).normal(size=(k, rank))
    m: Array = (a @ a.T) * np.outer(scale, scale)
    return m


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("k", "rank"), [(1, 1), (3, 3), (6, 6), (6, 3), (6, 1)])
def test_values_and_vectors_are_those_of_numpy(k: int, rank: int, seed: int) -> None:
    m = _matrix(k, rank, np.ones(k), seed)
    values, vectors = jacobi.eigen(m)
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(m), rtol=0, atol=1e-13 * np.trace(m))
    np.testing.assert_allclose(vectors @ vectors.T, np.eye(k), rtol=0, atol=1e-13)
    np.testing.assert_allclose((vectors * values) @ vectors.T, m, rtol=0, atol=1e-13 * np.trace(m))


@pytest.mark.parametrize("seed", range(5))
def test_metres_and_radians_do_not_spoil_one_another(seed: int) -> None:
    scale = np.array([3.0, 3.0, 3.0, 1e-4, 1e-4, 1e-4])
    m = _matrix(6, 8, scale, seed)
    values, vectors = jacobi.eigen(m)
    back = (vectors * values) @ vectors.T
    np.testing.assert_allclose(back / np.outer(scale, scale), m / np.outer(scale, scale), rtol=0, atol=1e-8)


@pytest.mark.parametrize("m", [np.zeros((6, 6)), np.eye(6), np.diag([1e150, 1.0, 0.0]), np.diag([-1.0, 2.0, -3.0])])
def test_what_is_diagonal_stays(m: Array) -> None:
    values, vectors = jacobi.eigen(m)
    np.testing.assert_array_equal(values, np.diag(m))
    np.testing.assert_array_equal(vectors, np.eye(len(m)))


def test_a_negative_value_is_found_and_the_upper_half_not_read() -> None:
    values, _ = jacobi.eigen(np.array([[1.0, 77.0], [2.0, 1.0]]))
    np.testing.assert_allclose(np.sort(values), [-1.0, 3.0], atol=1e-14)
