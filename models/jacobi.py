"""Eigenvalues of small symmetric matrices by Jacobi's rotations, A = V diag(d) V^T: a few lines that stay in the cache.

A rotation by phi in the plane (p, q) makes a_pq zero (Golub, Van Loan 2013, sec. 8.5):

    t^2 + 2 tau t - 1 = 0,  tau = (a_qq - a_pp) / (2 a_pq),  t = tan phi the smaller root
"""

import math

import numpy as np
from numba import njit

from models.messages import Array

_ROUNDING, _NOTHING = 2.0**-53, 1e-18  # of the two diagonal elements, of the trace: what is smaller is zero
_SWEEPS = 30  # 6 are usual


@njit(cache=True)
def eigen(matrix: Array) -> tuple[Array, Array]:
    """Values d (k,), in no order, and vectors V (k, k), by column, of a symmetric matrix (k, k); its lower half is read."""
    k = matrix.shape[0]
    a, v = np.empty((k, k)), np.eye(k)
    trace = 0.0
    for i in range(k):
        trace += abs(matrix[i, i])
        for j in range(i + 1):
            a[i, j], a[j, i] = matrix[i, j], matrix[i, j]
    for _ in range(_SWEEPS):
        done = True
        for p in range(k - 1):
            for q in range(p + 1, k):
                size = abs(a[p, q])
                if size <= _NOTHING * trace or size <= _ROUNDING * math.sqrt(abs(a[p, p])) * math.sqrt(abs(a[q, q])):
                    continue
                done = False
                _rotate(a, v, p, q)
        if done:
            break
    return np.diag(a).copy(), v


@njit(cache=True)
def _rotate(a: Array, v: Array, p: int, q: int) -> None:
    """A <- J^T A J with a_pq = 0, V <- V J, in place."""
    tau = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    t = math.copysign(1.0, tau) / (abs(tau) + math.hypot(1.0, tau))
    cos = 1.0 / math.sqrt(1.0 + t * t)
    sin = t * cos
    off = t * a[p, q]
    a[p, p] -= off
    a[q, q] += off
    a[p, q], a[q, p] = 0.0, 0.0
    for i in range(a.shape[0]):
        if i not in (p, q):
            x, y = a[i, p], a[i, q]
            a[i, p], a[i, q] = cos * x - sin * y, sin * x + cos * y
            a[p, i], a[q, i] = a[i, p], a[i, q]
        x, y = v[i, p], v[i, q]
        v[i, p], v[i, q] = cos * x - sin * y, sin * x + cos * y
