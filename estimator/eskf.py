"""The error-state extended Kalman filter: propagate, innovation, update.

A nominal state x runs through the nonlinear motion model; the filter estimates its error dx, which is injected and reset to
zero after every update (Sola 2017, sec. 6):

    x <- x (+) dx,   P <- G P G^T,   G_theta = I - [theta/2]x                                                     (eq. 287)

P may carry, behind the 15 error states, errors that are *considered*: they repeat from fix to fix (map, rig, slow GNSS), take
part in S and in the correlations, and are never corrected (Schmidt 1966). With the optimal gain for the others this is the
full update whose considered block and mean are put back (Bierman 1977, sec. VIII.3).
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numba import njit

from estimator.kalman import ErrorStateKalman
from estimator.samples import ImuBuffer
from models import imu, so3
from models.measurements import Measurement, innovation_covariance, mahalanobis
from models.messages import Array
from models.state import E, X, sound

_LN_2PI = math.log(2.0 * math.pi)
_kalman = cache(ErrorStateKalman)  # one wrapper for each size of the state


@dataclass(frozen=True, slots=True)
class Considered:
    """Slow errors behind the 15 states of P: first-order Gauss-Markov, named blocks of them.

    columns: where a block stands in P; tau_s, sigma2: (k,) of all states.
    """

    columns: dict[str, slice]
    tau_s: Array
    sigma2: Array

    def also(self, block: str, sigma2: Array, tau_s: float) -> "Considered":
        """With one more block behind the others."""
        start = E.SIZE + len(self.tau_s)
        return Considered(
            self.columns | {block: slice(start, start + len(sigma2))},
            np.append(self.tau_s, np.full(len(sigma2), tau_s)),
            np.append(self.sigma2, sigma2),
        )


NOTHING_CONSIDERED = Considered({}, np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True)
class Innovation:
    """One measurement seen from one state: nu (m,), H (m, n), R and S (m, m), squared Mahalanobis distance, ln det S."""

    nu: Array
    h: Array
    noise: Array
    s: Array
    distance2: float
    logdet: float

    @property
    def log_likelihood(self) -> float:
        """ln N(nu; 0, S)."""
        return -0.5 * (self.distance2 + self.logdet + len(self.nu) * _LN_2PI)


class Eskf:
    """State, covariance and time of one filter."""

    __slots__ = ("considered", "constants", "cov", "sound", "t_ns", "x")

    def __init__(self, t_ns: int, x: Array, cov: Array, constants: Array, considered: Considered = NOTHING_CONSIDERED) -> None:
        self.t_ns, self.x, self.cov = t_ns, x, cov
        self.constants, self.considered = constants, considered
        self.sound = True  # state.sound of the present state

    def copy(self) -> "Eskf":
        """An independent filter in the same state."""
        return Eskf(self.t_ns, self.x.copy(), self.cov.copy(), self.constants, self.considered)

    def propagate(self, samples: ImuBuffer, index: int, to_ns: int) -> None:
        """Through the IMU samples to `to_ns`; index: first sample after t_ns."""
        c = self.considered
        self.sound = imu.propagate(
            self.x, self.cov, samples.t_ns, samples.u, samples.count, index, self.t_ns, to_ns, self.constants, c.tau_s, c.sigma2
        )  # fmt: skip
        self.t_ns = to_ns

    def consider(self, block: str, covariance: Array, tau_s: float) -> None:
        """From now on take the slow error `block` into account; covariance: (k, k), steady. Once known it stays as it is."""
        if block in self.considered.columns:
            return
        n, k = len(self.cov), len(covariance)
        wider = np.zeros((n + k, n + k))
        wider[:n, :n], wider[n:, n:] = self.cov, covariance
        self.cov = wider
        self.considered = self.considered.also(block, np.diag(covariance).copy(), tau_s)

    def widen(self, factor: float) -> None:
        """P <- D P D: position, velocity and attitude are `factor` times less certain than they claimed; biases stay."""
        scale = np.ones(len(self.cov))
        scale[E.P], scale[E.V], scale[E.THETA] = factor, factor, factor
        self.cov = self.cov * np.outer(scale, scale)

    def innovation(self, z: Measurement, gyro_b: Array, slow_error: str | None = None) -> Innovation:
        """z against the present state; slow_error: the considered block that shifts its leading components."""
        nu, h = z.evaluate(self.x, gyro_b)
        if len(self.cov) > E.SIZE:
            h = np.hstack([h, np.zeros((len(nu), len(self.cov) - E.SIZE))])
            if slow_error is not None:
                columns = self.considered.columns[slow_error]
                h[:, columns] = np.eye(columns.stop - columns.start)[z.rows]
        s = innovation_covariance(self.cov, h, z.noise)
        distance2, logdet = mahalanobis(nu, s)
        return Innovation(nu, h, z.noise, s, distance2, logdet)

    def update(self, seen: Innovation) -> None:
        """Fuse a measurement that has passed its gate."""
        dx, cov = _kalman(len(self.cov)).update(self.cov, seen.nu, seen.h, seen.noise)
        if len(cov) > E.SIZE:
            cov[E.SIZE :, E.SIZE :] = self.cov[E.SIZE :, E.SIZE :]
        self.cov = cov
        self.sound = inject(self.x, self.cov, dx[: E.SIZE])


_XP, _XV, _XQ, _XG = X.P.start, X.V.start, X.Q.start, X.BG.start
_P, _V, _T, _G, _N = E.P.start, E.V.start, E.THETA.start, E.BG.start, E.SIZE


@njit(cache=True)
def inject(x: Array, cov: Array, dx: Array) -> bool:
    """x <- x (+) dx and P <- G P G^T, in place; dx (15,). False where the result is not sound."""
    for i in range(_XQ - _XP):
        x[_XP + i] += dx[_P + i]
    for i in range(_N - _G):
        x[_XG + i] += dx[_G + i]
    theta = dx[_T:_G]
    x[_XQ:_XG] = so3.normalise(so3.multiply(x[_XQ:_XG], so3.quat_exp(theta)))
    g = np.eye(3) - 0.5 * so3.skew(theta)
    n = cov.shape[0]
    row = np.empty(3)
    for j in range(n):
        for i in range(3):
            row[i] = g[i, 0] * cov[_T, j] + g[i, 1] * cov[_T + 1, j] + g[i, 2] * cov[_T + 2, j]
        for i in range(3):
            cov[_T + i, j] = row[i]
    for j in range(n):
        for i in range(3):
            row[i] = g[i, 0] * cov[j, _T] + g[i, 1] * cov[j, _T + 1] + g[i, 2] * cov[j, _T + 2]
        for i in range(3):
            cov[j, _T + i] = row[i]
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (cov[i, j] + cov[j, i])
            cov[i, j] = mean
            cov[j, i] = mean
    return sound(x, cov)
