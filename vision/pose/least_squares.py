"""Joint least squares of pose and nuisances on independent edges.

    Omega = sum_e A_e^T W_e A_e + diag(0, I),   eta = sum_e A_e^T W_e (z_e + N_e nu_0),   A = (H, N),  W_e = R_e^-1

nu has unit variance, nu_0 is drawn already. The pose's prior is used to solve, not reported.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import cholesky, order
from models.messages import Array

Indices = NDArray[np.int64]
POSE = 6
_REWEIGHTED, _HUBER_ROUNDS = 4, 2
_TUKEY = 5.0  # in units of the median edge's distance
_LEAST_SCALE = 0.5


@dataclass(frozen=True, slots=True)
class System:
    """z (E, M) px, A (E, M, 6 + P), R and W = R^-1 (E, M, M), W 0 where nothing was found."""

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
        """Number of informative lines."""
        return int(np.count_nonzero(self.W[:, ::2, ::2].diagonal(axis1=1, axis2=2)))


@dataclass(frozen=True, slots=True)
class Solution:
    """dx (6,), nuisances (P,), omega (6 + P, 6 + P) without the pose's prior, residual (E, M)."""

    dx: Array
    nuisance: Array
    omega: Array
    residual: Array


def solve(system: System, present: Array, information: Array, delta: Array) -> Solution:
    """Gauss-Newton step; present: (P,) nu_0; information (6, 6) of the prior, delta = x (-) x0."""
    solution, omega, residual = _step(system.A, system.W, system.z, present, information, delta)
    return Solution(solution[:POSE], solution[POSE:], omega, residual)


def solve_robustly(system: System, present: Array, information: Array, delta: Array) -> Solution:
    """Iteratively reweighted by whole edges: Huber, then Tukey, scale by the median edge."""
    solution, omega, residual = _robust_step(system.A, system.W, system.z, present, information, delta)
    return Solution(solution[:POSE], solution[POSE:], omega, residual)


@njit(cache=True)
def _robust_step(A: Array, W: Array, z: Array, present: Array, information: Array, delta: Array) -> tuple[Array, Array, Array]:
    found = _found(W)
    weight, ratio, numbers = np.ones(len(found)), np.empty(len(found)), np.zeros(len(found))
    for f in range(len(found)):
        for i in range(W.shape[1]):
            numbers[f] += W[found[f], i, i] != 0.0
    normal, right, column, count = _normal_equations(A, W, z, present, found)
    solution, omega = _solved(normal, right, column, count, present, information, delta, weight)
    for k in range(_REWEIGHTED):
        residual = _residual(A, z, present, solution, found, column, count)
        for f in range(len(found)):
            e = found[f]
            ratio[f] = np.sqrt(2.0 * max(_distance(W[e], residual[e]), 0.0) / numbers[f])
        scale = max(1.4826 * order.median(ratio), _LEAST_SCALE)
        for f in range(len(found)):
            r = ratio[f] / scale
            if k < _HUBER_ROUNDS:
                weight[f] = 1.0 / max(r, 1.0)
            else:
                weight[f] = (1.0 - (r / _TUKEY) ** 2) ** 2 if r < _TUKEY else 0.0
        solution, omega = _solved(normal, right, column, count, present, information, delta, weight)
    return solution, omega, _residual(A, z, present, solution, found, column, count)


@njit(cache=True)
def _step(A: Array, W: Array, z: Array, present: Array, information: Array, delta: Array) -> tuple[Array, Array, Array]:
    found = _found(W)
    normal, right, column, count = _normal_equations(A, W, z, present, found)
    solution, omega = _solved(normal, right, column, count, present, information, delta, np.ones(len(found)))
    return solution, omega, _residual(A, z, present, solution, found, column, count)


@njit(cache=True)
def _found(W: Array) -> Indices:
    found, count = np.empty(len(W), np.int64), 0
    for e in range(len(W)):
        if nonzero(W[e]):
            found[count] = e
            count += 1
    return found[:count]


@njit(cache=True)
def nonzero(matrix: Array) -> bool:
    """Whether anything in a matrix is not 0."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            if matrix[i, j] != 0.0:
                return True
    return False


@njit(cache=True)
def _normal_equations(A: Array, W: Array, z: Array, present: Array, found: Indices) -> tuple[Array, Array, Indices, Indices]:
    """A_e^T W_e A_e (F, S, S), upper half, and A_e^T W_e (z_e + N_e nu_0) (F, S) of found edges in nonzero columns (F, S), their
    number (F,): an edge depends on its own landmark's map errors only.
    """
    rows, columns = A.shape[1], A.shape[2]
    column, count, most = np.empty((len(found), columns), np.int64), np.zeros(len(found), np.int64), 0
    for f in range(len(found)):
        for k in range(columns):
            for i in range(rows):
                if A[found[f], i, k] != 0.0:
                    column[f, count[f]] = k
                    count[f] += 1
                    break
        most = max(most, count[f])
    normal, right = np.zeros((len(found), most, most)), np.zeros((len(found), most))
    own, WA, target = np.empty((rows, most)), np.empty((rows, most)), np.empty(rows)
    for f in range(len(found)):
        e = found[f]
        WA[:] = 0.0
        for i in range(rows):
            target[i] = z[e, i]
            for c in range(count[f]):
                own[i, c] = A[e, i, column[f, c]]
                if column[f, c] >= POSE:
                    target[i] += own[i, c] * present[column[f, c] - POSE]
        for i in range(rows):
            for j in range(rows):
                for c in range(count[f]):
                    WA[i, c] += W[e, i, j] * own[j, c]
        for i in range(rows):
            for c in range(count[f]):
                right[f, c] += WA[i, c] * target[i]
                for d in range(c, count[f]):
                    normal[f, c, d] += WA[i, c] * own[i, d]
    return normal, right, column[:, :most].copy(), count


@njit(cache=True)
def _solved(
    normal: Array, right: Array, column: Indices, count: Indices, present: Array, information: Array, delta: Array, weight: Array
) -> tuple[Array, Array]:
    """Pose and nuisances (6 + P,), information without the pose's prior; weight (F,) of found edges."""
    columns = POSE + len(present)
    omega, eta = np.zeros((columns, columns)), np.zeros(columns)
    for f in range(len(normal)):
        w, own, at = weight[f], normal[f], column[f]
        for c in range(count[f]):
            eta[at[c]] += w * right[f, c]
            row = omega[at[c]]
            for d in range(c, count[f]):
                row[at[d]] += w * own[c, d]
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
    cholesky.substitute(whole, eta)
    return eta, omega


@njit(cache=True)
def _residual(A: Array, z: Array, present: Array, solution: Array, found: Indices, column: Indices, count: Indices) -> Array:
    """Residuals (E, M) after the step; of edges without information z."""
    change, residual = solution.copy(), z.copy()
    for k in range(len(present)):
        change[POSE + k] -= present[k]
    for f in range(len(found)):
        for i in range(A.shape[1]):
            for c in range(count[f]):
                residual[found[f], i] -= A[found[f], i, column[f, c]] * change[column[f, c]]
    return residual


@njit(cache=True)
def _inverse(R: Array, found: NDArray[np.bool_]) -> Array:
    inverse, numbers = np.zeros(R.shape), R.shape[1]
    some, part = np.empty(numbers, np.int64), np.empty((numbers, numbers))
    for e in range(len(R)):
        count = 0
        for i in range(numbers):
            if found[e, i]:
                some[count] = i
                count += 1
        for i in range(count):
            for j in range(count):
                part[i, j] = R[e, some[i], some[j]]
        of_some = cholesky.inverse(part[:count, :count].copy())
        for i in range(count):
            for j in range(count):
                inverse[e, some[i], some[j]] = of_some[i, j]
    return inverse


def distances(system: System, residual: Array) -> Array:
    """r_e^T W_e r_e of every edge (E,)."""
    return np.asarray(_distances(system.W, residual))


@njit(cache=True)
def _distances(W: Array, residual: Array) -> Array:
    result = np.empty(len(W))
    for e in range(len(W)):
        result[e] = _distance(W[e], residual[e])
    return result


@njit(cache=True)
def _distance(W: Array, r: Array) -> float:
    total = 0.0
    for i in range(len(r)):
        for j in range(len(r)):
            total += r[i] * W[i, j] * r[j]
    return total
