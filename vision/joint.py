"""Joint least squares of the pose and of what else may be wrong, on edges that do not disturb each other.

    Omega = sum_e A_e^T W_e A_e + diag(0, I),   eta = sum_e A_e^T W_e (z_e + N_e nu_0),   A = (H, N),  W_e = R_e^-1

nu has unit variance by construction, nu_0 is what the drawn outlines contain of it already. The prior of the pose is added to
solve, and left out of what is reported: information of the pictures alone.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

POSE = 6


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
        both = found[:, :, None] & found[:, None, :]
        inverse = np.linalg.inv(np.where(both, R, np.eye(R.shape[1])))
        return cls(z, A, R, np.where(both, inverse, 0.0))

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
    omega, eta = _normal_equations(system.A, system.W, system.z, present)
    diagonal = np.arange(POSE, len(eta))
    omega[diagonal, diagonal] += 1.0
    whole = omega.copy()
    whole[:POSE, :POSE] += information
    eta[:POSE] -= information @ delta
    solution = np.linalg.solve(whole, eta)
    dx, nuisance = solution[:POSE], solution[POSE:]
    change = np.concatenate((dx, nuisance - present))
    return Solution(dx, nuisance, omega, system.z - system.A @ change)


@njit(cache=True)
def _normal_equations(A: Array, W: Array, z: Array, present: Array) -> tuple[Array, Array]:
    edges, rows, columns = A.shape
    omega, eta = np.zeros((columns, columns)), np.zeros(columns)
    WA = np.empty((rows, columns))
    for e in range(edges):
        if not W[e].any():
            continue
        WA[:] = 0.0
        for i in range(rows):
            for j in range(rows):
                w = W[e, i, j]
                if w != 0.0:
                    for k in range(columns):
                        WA[i, k] += w * A[e, j, k]
        for i in range(rows):
            target = z[e, i]
            for k in range(len(present)):
                target += A[e, i, POSE + k] * present[k]
            for k in range(columns):
                a = WA[i, k]
                if a != 0.0:
                    eta[k] += a * target
                    for m in range(columns):
                        omega[k, m] += a * A[e, i, m]
    return omega, eta


def distances(system: System, residual: Array) -> Array:
    """r_e^T W_e r_e of every edge (E,)."""
    result: Array = np.einsum("ei,eij,ej->e", residual, system.W, residual)
    return result
