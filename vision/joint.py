"""Joint least squares of the pose and of what else may be wrong, on edges that do not disturb each other.

    Omega = sum_e A_e^T W_e A_e + diag(0, I),   eta = sum_e A_e^T W_e (z_e + N_e nu_0),   A = (H, N),  W_e = R_e^-1

nu has unit variance by construction, nu_0 is what the drawn outlines contain of it already. The prior of the pose is added to
solve, and left out of what is reported: information of the pictures alone.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import cholesky
from models.messages import Array

POSE = 6
_REWEIGHTED, _HUBER_ROUNDS = 4, 2
_TUKEY = 5.0  # in units of the median edge's distance
_LEAST_SCALE = 0.5


@dataclass(frozen=True, slots=True)
class System:
    """E edges of M lines' numbers each: z (E, M) px, A (E, M, 6 + P), R and W = R^-1 (E, M, M), W 0 where nothing was found."""

    z: Array
    A: Array
    R: Array
    W: Array

    @classmethod
    def of(cls, z: Array, A: Array, R: Array, found: NDArray[np.bool_]) -> "System":
        """found: (E, M)."""
        return cls(z, np.ascontiguousarray(A), R, _inverse(R, found))

    def weighted(self, weight: Array) -> "System":
        """The same with each edge's information times weight (E,)."""
        return System(self.z, self.A, self.R, self.W * weight[:, None, None])

    @property
    def count(self) -> int:
        """Lines that carry information."""
        return int(np.count_nonzero(self.W[:, ::2, ::2].diagonal(axis1=1, axis2=2)))


@dataclass(frozen=True, slots=True)
class Solution:
    """dx (6,), nuisances (P,) as they now are, information omega (6 + P, 6 + P) without the pose's prior, residual (E, M)."""

    dx: Array
    nuisance: Array
    omega: Array
    residual: Array


def solve(system: System, present: Array, information: Array, delta: Array) -> Solution:
    """Gauss-Newton step; present: (P,) nu_0; information (6, 6) of the prior, delta = x (-) x0."""
    solution, omega, residual = _step(system.A, system.W, system.z, present, information, delta, np.ones(len(system.z)))
    return Solution(solution[:POSE], solution[POSE:], omega, residual)


def solve_robustly(system: System, present: Array, information: Array, delta: Array) -> Solution:
    """The same, iteratively reweighted by edges: Huber first, then Tukey, their scale by the median edge.

    An edge caught by a shadow or a neighbour is an outlier as a whole.
    """
    solution, omega, residual = _robust_step(system.A, system.W, system.z, present, information, delta)
    return Solution(solution[:POSE], solution[POSE:], omega, residual)


@njit(cache=True)
def _robust_step(A: Array, W: Array, z: Array, present: Array, information: Array, delta: Array) -> tuple[Array, Array, Array]:
    edges, rows = z.shape
    weight, ratio = np.ones(edges), np.zeros(edges)
    numbers = np.array([np.count_nonzero(np.diag(W[e])) for e in range(edges)])
    solution, omega, residual = _step(A, W, z, present, information, delta, weight)
    for k in range(_REWEIGHTED):
        for e in range(edges):
            total = 0.0
            for i in range(rows):
                for j in range(rows):
                    total += residual[e, i] * W[e, i, j] * residual[e, j]
            ratio[e] = np.sqrt(2.0 * max(total, 0.0) / max(numbers[e], 1))
        scale = max(1.4826 * np.median(ratio[numbers > 0]), _LEAST_SCALE)
        for e in range(edges):
            r = ratio[e] / scale
            if k < _HUBER_ROUNDS:
                weight[e] = 1.0 / max(r, 1.0)
            else:
                weight[e] = (1.0 - (r / _TUKEY) ** 2) ** 2 if r < _TUKEY else 0.0
        solution, omega, residual = _step(A, W, z, present, information, delta, weight)
    return solution, omega, residual


@njit(cache=True)
def _step(
    A: Array, W: Array, z: Array, present: Array, information: Array, delta: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Pose and nuisances (6 + P,), information without the pose's prior, and residuals (E, M) after the step.

    An edge depends on the map errors of its own landmark only: columns that are 0 are left out of its sums.
    """
    edges, rows, columns = A.shape
    omega, eta = np.zeros((columns, columns)), np.zeros(columns)
    own, WA, some = np.empty((columns, rows)), np.empty((columns, rows)), np.empty(columns, np.int64)
    for e in range(edges):
        if weight[e] == 0.0 or not W[e].any():
            continue
        count, target = _used_columns(A[e], some), z[e].copy()
        for i in range(rows):
            for k in range(len(present)):
                target[i] += A[e, i, POSE + k] * present[k]
        for c in range(count):
            for i in range(rows):
                own[c, i], WA[c, i] = A[e, i, some[c]], 0.0
                for j in range(rows):
                    WA[c, i] += weight[e] * W[e, i, j] * A[e, j, some[c]]
                eta[some[c]] += WA[c, i] * target[i]
        for c in range(count):
            for d in range(c, count):
                total = 0.0
                for i in range(rows):
                    total += WA[c, i] * own[d, i]
                omega[some[c], some[d]] += total
    for k in range(columns):
        for m in range(k):
            omega[k, m] = omega[m, k]
    for k in range(POSE, columns):
        omega[k, k] += 1.0
    whole = omega.copy()
    for k in range(POSE):
        for m in range(POSE):
            whole[k, m] += information[k, m]
            eta[k] -= information[k, m] * delta[m]
    if not cholesky.factor(whole, whole):
        raise np.linalg.LinAlgError("the normal equations are not positive definite")
    solution = eta.copy()
    cholesky.substitute(whole, solution)
    change = solution.copy()
    change[POSE:] -= present
    residual = z.copy()
    for e in range(edges):
        for i in range(rows):
            for k in range(columns):
                residual[e, i] -= A[e, i, k] * change[k]
    return solution, omega, residual


@njit(cache=True)
def _used_columns(A: Array, some: NDArray[np.int64]) -> int:
    """Write which columns of A (M, C) are not 0, rising, into some; how many they are."""
    count = 0
    for k in range(A.shape[1]):
        for i in range(A.shape[0]):
            if A[i, k] != 0.0:
                some[count] = k
                count += 1
                break
    return count


@njit(cache=True)
def _inverse(R: Array, found: NDArray[np.bool_]) -> Array:
    """R^-1 (E, M, M) of the numbers that were found (E, M), 0 elsewhere."""
    inverse = np.zeros(R.shape)
    for e in range(len(R)):
        some = np.flatnonzero(found[e])
        of_some = cholesky.inverse(R[e][some][:, some])
        for i in range(len(some)):
            for j in range(len(some)):
                inverse[e, some[i], some[j]] = of_some[i, j]
    return inverse


def distances(system: System, residual: Array) -> Array:
    """r_e^T W_e r_e of every edge (E,)."""
    result: Array = np.einsum("ei,eij,ej->e", residual, system.W, residual)
    return result
