"""Cholesky S = L L^T of small matrices, and solutions with it; compiled."""

import math

import numpy as np
from numba import njit

from models.messages import Array


@njit(cache=True, error_model="numpy")
def factor(s: Array, low: Array) -> bool:
    """Lower triangle of low (may be S) <- L of S (m, m); False unless positive definite."""
    for i in range(s.shape[0]):
        for j in range(i + 1):
            total = s[i, j]
            for k in range(j):
                total -= low[i, k] * low[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                low[i, i] = math.sqrt(total)
            else:
                low[i, j] = total / low[j, j]
    return True


@njit(cache=True, error_model="numpy")
def forward(low: Array, b: Array) -> None:
    """b (m, k) <- L^-1 b, in place."""
    for i in range(b.shape[0]):
        for k in range(i):
            for j in range(b.shape[1]):
                b[i, j] -= low[i, k] * b[k, j]
        for j in range(b.shape[1]):
            b[i, j] /= low[i, i]


@njit(cache=True, error_model="numpy")
def backward(low: Array, b: Array) -> None:
    """b (m, k) <- L^-T b, in place."""
    for i in range(b.shape[0] - 1, -1, -1):
        for k in range(i + 1, b.shape[0]):
            for j in range(b.shape[1]):
                b[i, j] -= low[k, i] * b[k, j]
        for j in range(b.shape[1]):
            b[i, j] /= low[i, i]


@njit(cache=True, error_model="numpy")
def substitute(low: Array, b: Array) -> None:
    """b (m,) <- S^-1 b = L^-T L^-1 b, in place."""
    for i in range(b.shape[0]):
        for k in range(i):
            b[i] -= low[i, k] * b[k]
        b[i] /= low[i, i]
    for i in range(b.shape[0] - 1, -1, -1):
        for k in range(i + 1, b.shape[0]):
            b[i] -= low[k, i] * b[k]
        b[i] /= low[i, i]


@njit(cache=True, error_model="numpy")
def inverse(s: Array) -> Array:
    """S^-1 = L^-T L^-1 (m, m), symmetric. Raises numpy.linalg.LinAlgError."""
    m = s.shape[0]
    low, root, result = np.empty((m, m)), np.zeros((m, m)), np.empty((m, m))
    for i in range(m):
        root[i, i] = 1.0
    if not factor(s, low):
        raise np.linalg.LinAlgError("not positive definite")
    forward(low, root)
    for i in range(m):
        for j in range(i, m):
            total = 0.0
            for k in range(j, m):
                total += root[k, i] * root[k, j]
            result[i, j] = total
            result[j, i] = total
    return result


@njit(cache=True, error_model="numpy")
def symmetrise(m: Array) -> None:
    """m <- (m + m^T) / 2, in place, (n, n)."""
    for i in range(m.shape[0]):
        for j in range(i):
            mean = 0.5 * (m[i, j] + m[j, i])
            m[i, j] = mean
            m[j, i] = mean
