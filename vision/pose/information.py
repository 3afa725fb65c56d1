"""Information of images about the pose, and its measured directions (docs/vision_pose.md).

    Lambda_I = Omega_pp - Omega_pn Omega_nn^-1 Omega_np = L U diag(lambda) U^T L^T,   Lambda_0 = L L^T

Lambda_I: with unknown errors of map and rig (n); Lambda_0: of the prior. A direction is measured where lambda exceeds a share;
with open ones the measurement is D xi, D = U_k^T L^T orthonormalised.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from models import cholesky
from models.measurements import DIRECTION_SCALE
from models.messages import Array
from vision.pose.least_squares import POSE, System, nonzero

_WIDEST_M, _WIDEST_RAD = 200.0, 2.0  # standard deviations of a whole fix are limited to these: still "given", and worth nothing
_LEAST_SHARE = 1e-3  # of the prior's information: below it a direction is not measured
_STRAIGHT_SHARE = 0.5  # below it in any, a fix is reported along its directions


@dataclass(frozen=True, slots=True)
class Measured:
    """prior: Lambda_0; low: L; basis: U (6, 6), best first; share: lambda (6,); rank: measured."""

    prior: Array
    low: Array
    basis: Array
    share: Array
    rank: int

    @classmethod
    def of(cls, omega: Array, prior: Array) -> "Measured":
        """omega (6 + P, 6 + P): images, with priors of map and rig; prior (6, 6): of the pose."""
        low = np.asarray(np.linalg.cholesky(prior), dtype=np.float64)
        values, vectors = np.linalg.eigh(_white(omega, low))
        return cls(prior, low, vectors[:, ::-1], values[::-1], int((values >= _LEAST_SHARE).sum()))

    @property
    def whole(self) -> bool:
        """Whether the images alone determine the pose near the linearisation."""
        return bool(self.share[-1] >= _STRAIGHT_SHARE)

    def reported_along(self, delta: Array, covariance: Array) -> tuple[Array, Array]:
        """D (r, 6), orthonormal with a radian as RADIAN_M metres, and y = D C Lambda_0 delta (r,), as in LandmarkFix.

        delta (6,): of the joint optimum, which y preserves with the prior.
        """
        rows = self.basis[:, : self.rank].T @ self.low.T
        q, _ = np.linalg.qr((rows / DIRECTION_SCALE).T)
        directions = np.asarray(q.T * DIRECTION_SCALE, dtype=np.float64)
        return directions, directions @ (covariance @ (self.prior @ delta))

    def covariances(self, system: System, omega: Array, factor: float) -> tuple[Array, Array]:
        """Pose error by the images (6, 6), and by unit errors of map and rig (6, P).

        G = (Omega^-1)_pose A^T W / factor,   image = factor G R G^T (+ what the limit on large variances adds),   moved = G N
        Open directions have 1 / share times the prior's variance, and no error of map and rig.
        """
        floor, inverse = self._floor(), self._inverse(omega, factor)
        image = inverse[:POSE] @ floor @ inverse[:POSE]  # what the floor adds
        moved = _add_covariances(system.A, system.W, system.R, inverse, factor, image)
        if self.rank == POSE:
            return image, moved
        through = self.through
        open_ways = np.linalg.solve(self.low.T, self.basis[:, self.rank :])
        return through @ image @ through.T + open_ways @ open_ways.T / _LEAST_SHARE, through @ moved

    def moved_by(self, system: System, omega: Array, factor: float, own: Array) -> Array:
        """G_e B_e (E, 6, c): effect on the pose of c unit errors of each edge, B own (E, M, c)."""
        seen = system.A @ self._inverse(omega, factor)
        moved = seen.transpose(0, 2, 1) @ (system.W @ own) / factor
        return np.asarray(moved if self.rank == POSE else self.through @ moved)

    def _inverse(self, omega: Array, factor: float) -> Array:
        """Pose columns (6 + P, 6) of (Omega / factor)^-1, priors and limits unscaled."""
        limited = omega / factor
        limited[:POSE, :POSE] += self._floor()
        rest = np.arange(POSE, len(omega))
        limited[rest, rest] += 1.0 - 1.0 / factor
        return _of_pose(limited)

    @property
    def through(self) -> Array:
        """L^-T U_k U_k^T L^T (6, 6): projection on measured directions; D through = D."""
        kept = self.basis[:, : self.rank]
        return np.asarray(np.linalg.solve(self.low.T, kept @ kept.T) @ self.low.T, dtype=np.float64)

    def _floor(self) -> Array:
        """Added information for invertibility: limits of a whole fix, or open directions."""
        if self.rank == POSE:
            return np.diag([_WIDEST_M**-2] * 3 + [_WIDEST_RAD**-2] * 3)
        rest = self.low @ self.basis[:, self.rank :]
        return (rest * (_LEAST_SHARE - self.share[self.rank :])) @ rest.T

    def alone(self, delta: Array, covariance: Array) -> Array:
        """z (-) x0 = delta + C Lambda_0 delta, delta (6,) of the joint optimum; open directions keep delta."""
        values, vectors = np.linalg.eigh(self.low.T @ covariance @ self.low)  # C in units of the prior's
        values[self.rank :] = 0.0
        white = vectors @ (values * (vectors.T @ (self.low.T @ delta)))
        step: Array = delta + np.linalg.solve(self.low.T, white)
        return step

    def surprise(self, delta: Array, covariance: Array, limit: float) -> float:
        """Chi-square of the reading against the prior over limit: nu^T (P_0 + C)^-1 nu, nu = (P_0 + C) Lambda_0 delta.

        limit: for six degrees of freedom; fewer use the same quantile.
        """
        if self.rank < POSE:
            delta, limit = self.through @ delta, _same_quantile(limit, self.rank)
        pull = self.prior @ delta
        return float(delta @ pull + pull @ covariance @ pull) / limit


@njit(cache=True)
def _white(omega: Array, low: Array) -> Array:
    """L^-1 Lambda_I L^-T (6, 6), in units of the prior's information L L^T.

    Lambda_I = Omega_pp - B^T B,   B = F^-1 Omega_np,   Omega_nn = F F^T
    """
    root, B, alone = omega[POSE:, POSE:].copy(), omega[POSE:, :POSE].copy(), omega[:POSE, :POSE].copy()
    if not cholesky.factor(root, root):
        raise np.linalg.LinAlgError("errors of map and rig have no information")
    cholesky.forward(root, B)
    for n in range(len(B)):
        for i in range(POSE):
            for j in range(POSE):
                alone[i, j] -= B[n, i] * B[n, j]
    cholesky.forward(low, alone)
    white = alone.T.copy()
    cholesky.forward(low, white)
    cholesky.symmetrise(white)
    return white


@njit(cache=True)
def _add_covariances(A: Array, W: Array, R: Array, inverse: Array, factor: float, image: Array) -> Array:
    """moved (6, P) where all directions are measured; G R G^T added to image (6, 6), in place.

    inverse (6 + P, 6): pose columns of Omega^-1.
    """
    edges, numbers, size = A.shape
    seen, gain, moved = np.empty((numbers, POSE)), np.empty((numbers, POSE)), np.zeros((POSE, size - POSE))  # A Omega^-1, G^T
    for e in range(edges):
        if not nonzero(W[e]):
            continue
        seen[:], gain[:] = 0.0, 0.0
        for i in range(numbers):
            for k in range(size):
                if A[e, i, k] != 0.0:
                    for p in range(POSE):
                        seen[i, p] += A[e, i, k] * inverse[k, p]
        for i in range(numbers):
            for j in range(numbers):
                for p in range(POSE):
                    gain[i, p] += W[e, i, j] * seen[j, p] / factor
        for i in range(numbers):
            for p in range(POSE):
                for j in range(numbers):
                    for q in range(POSE):
                        image[p, q] += factor * gain[i, p] * R[e, i, j] * gain[j, q]
                for k in range(size - POSE):
                    moved[p, k] += gain[i, p] * A[e, i, POSE + k]
    return moved


@njit(cache=True)
def _of_pose(omega: Array) -> Array:
    low, columns = np.empty_like(omega), np.zeros((len(omega), POSE))
    for k in range(POSE):
        columns[k, k] = 1.0
    if not cholesky.factor(omega, low):
        raise np.linalg.LinAlgError("the information is not positive definite")
    cholesky.forward(low, columns)
    cholesky.backward(low, columns)
    return columns


def _same_quantile(limit: float, dof: int) -> float:
    """Limit for dof with the same quantile as `limit` for six: (chi2 / n)^(1/3) ~ N(1 - 2 / 9n, 2 / 9n)."""
    six, other = 2.0 / (9.0 * POSE), 2.0 / (9.0 * dof)
    z = ((limit / POSE) ** (1.0 / 3.0) - 1.0 + six) / math.sqrt(six)
    return float(dof * max(1.0 - other + z * math.sqrt(other), 0.0) ** 3)
