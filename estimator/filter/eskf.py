"""The error-state extended Kalman filter: propagate, innovation, update.

    x <- x (+) dx,   P <- G P G^T,   G_theta = I - [theta/2]x                         (Sola 2017, sec. 6, eq. 287)

Behind the 15 error states P carries slow errors, which repeat from fix to fix, most of them *considered*: never corrected. Their
gain is zero, and Joseph's form holds for any gain:

    P <- (I - K H) P (I - K H)^T + K R K^T,   K_c = 0                          (Schmidt 1966; Bierman 1977, sec. VIII.3)

A kept pose (stochastic clone) is an estimated block (dp, theta).
"""

import math
from collections.abc import Sequence
from functools import cache

import msgspec
import numpy as np
from msgspec.structs import replace
from numba import njit

from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.kalman import ErrorStateKalman
from estimator.filter.slow_errors import NO_SLOW_ERRORS, SlowErrors
from models import cholesky, imu, so3
from models.measurements import Curved, Measurement, innovation_covariance, mahalanobis
from models.messages import Array
from models.relative_pose import POSE_ERROR, moved, pose_of
from models.state import XYZ, E, X, retract, sound

_WIDEST = 1.0  # rad: sigma of an attitude that is unknown
NO_CLONES: dict[str, Array] = {}
_ARITHMETIC = 1e-12  # epsilon: an update rounds P by less than this share of S; in SI units
_LN_2PI = math.log(2.0 * math.pi)
_kalman = cache(ErrorStateKalman)  # one wrapper for each size of the state
_identity = cache(np.eye)


class Innovation(msgspec.Struct, frozen=True, eq=False):
    """One measurement against one state: nu (m,), H and H P (m, n), R, f S (m, m), nu^T (f S)^-1 nu, ln det f S.

    besides: ln density of what is left out of it.
    """

    nu: Array
    h: Array
    hp: Array
    noise: Array
    s: Array
    distance2: float
    logdet: float
    besides: float = 0.0

    @property
    def log_likelihood(self) -> float:
        """ln N(nu; 0, S)."""
        return self.besides - 0.5 * (self.distance2 + self.logdet + len(self.nu) * _LN_2PI)

    def first(self, m: int) -> "Innovation":
        """Of its first m components alone."""
        s, noise = (np.ascontiguousarray(a[:m, :m]) for a in (self.s, self.noise))  # as compiled code knows them
        return Innovation(self.nu[:m], self.h[:m], self.hp[:m], noise, s, *mahalanobis(self.nu[:m], s))


class Eskf:
    """State, covariance and time of one filter."""

    __slots__ = ("clones", "constants", "cov", "slow", "sound", "t_ns", "variance_factor", "x")

    def __init__(
        self,
        t_ns: int,
        x: Array,
        cov: Array,
        constants: Array,
        slow: SlowErrors = NO_SLOW_ERRORS,
        variance_factor: float = 1.0,
        clones: dict[str, Array] = NO_CLONES,
    ) -> None:
        self.t_ns, self.x, self.cov = t_ns, x, cov
        self.constants, self.slow = constants, slow
        self.variance_factor = variance_factor  # f: the errors' covariance is f P; see variance_factor.py
        self.clones = clones  # poses (7,) that are kept, by the name of their block; never changed in place
        self.sound = True  # state.sound of the present state

    def copy(self) -> "Eskf":
        """An independent filter in the same state."""
        return Eskf(self.t_ns, self.x.copy(), self.cov.copy(), self.constants, self.slow, self.variance_factor, self.clones)

    def propagate(self, samples: ImuBuffer, index: int, to_ns: int, whole: Array = imu.NOTHING) -> None:
        """Through the IMU samples to `to_ns`; index: first sample after t_ns; whole: see imu.propagate."""
        s = self.slow
        self.sound = imu.propagate(
            self.x, self.cov, samples.t_ns, samples.u, samples.known, samples.count, index, self.t_ns, to_ns,
            self.constants, s.tau_s, s.psd, whole,
        )  # fmt: skip
        self.t_ns = to_ns

    def consider(self, block: str, covariance: Array, tau_s: float, walk: Array | None = None) -> None:
        """Consider the slow error `block`, unless it is known already.

        covariance: (k, k), steady; with `walk` (k,), variance per second, an estimated random walk begins.
        """
        if block in self.slow.columns:
            return
        n, k = len(self.cov), len(covariance)
        wider = np.zeros((n + k, n + k))
        wider[:n, :n], wider[n:, n:] = self.cov, covariance
        self.cov = wider
        if walk is None:
            self.slow = self.slow.also(block, 2.0 * np.diag(covariance) / tau_s, tau_s, estimated=False)
        else:
            self.slow = self.slow.also(block, walk, math.inf, estimated=True)

    def keep_pose(self, block: str) -> None:
        """Clone the present pose in place of the kept `block`: P <- [I; J] P [I; J]^T, J picks (dp, theta)."""
        if block in self.slow.columns:
            self.forget(block)
        every = np.concatenate((np.arange(len(self.cov)), POSE_ERROR))
        self.cov = self.cov[np.ix_(every, every)]
        self.slow = self.slow.also(block, np.zeros(len(POSE_ERROR)), math.inf, estimated=True)
        self.clones = {**self.clones, block: pose_of(self.x)}

    def zero(self, block: str, seen: Innovation) -> None:
        """Set the unknown first error s of an estimated block by a reading z = h(x) + s + v: s = nu,

        ds = -(H dx + v),   cov(ds, dx) = -P H^T,   var(ds) = H P H^T + R               (H of all states but s itself)
        """
        column = self.slow.columns[block].start
        h = seen.h[0].copy()
        h[column] = 0.0
        cross = -h @ self.cov
        variance = h @ self.cov @ h + seen.noise[0, 0]
        self.cov[column, :], self.cov[:, column] = cross, cross
        self.cov[column, column] = variance
        by = np.zeros(len(self.slow.mean))
        by[column - E.SIZE] = seen.nu[0]
        self.slow = self.slow.moved(by)

    def widen(self, factor: float) -> None:
        """P_nn <- factor^2 P_nn: position, velocity and attitude have jumped by an independent error.

        Cross-covariances stay: D P D would move the biases by many sigmas. The attitude is widened up to _WIDEST, by f_theta:

            P_nn <- f_theta^2 P_nn + (f^2 - f_theta^2) blockdiag(P_pp,vv, 0)

        Kept poses go: they may have jumped, too.
        """
        for block in self.clones:
            self.forget(block)
        sigma = math.sqrt(max(self.cov.diagonal()[E.THETA].tolist()))
        turned = min(factor, max(1.0, _WIDEST / sigma)) ** 2
        self.cov[:_G, :_G] *= turned
        if turned < factor**2:
            self.cov[:_T, :_T] *= factor**2 / turned

    def limit_attitude(self) -> None:
        """P_theta <- D P_theta D, sigma at most _WIDEST: the attitude is unknown, and its error is bounded by half a turn."""
        sigma = math.sqrt(self.variance_factor * max(self.cov.diagonal()[E.THETA].tolist()))
        if sigma > _WIDEST:
            self.cov[E.THETA, :] *= _WIDEST / sigma
            self.cov[:, E.THETA] *= _WIDEST / sigma

    def admit_noise(self, seen: Innovation, noise: Array, readings: int) -> None:
        """The last k readings were fused with R, and their noise is R' (m, m): P <- P + k K (R' - R) K^T, K = P H^T S^-1."""
        hp = seen.h @ self.cov
        gain = np.linalg.solve(hp @ seen.h.T + seen.noise, hp)
        self.cov += readings * (gain.T @ (noise - seen.noise) @ gain)

    def change_imu(self, shift: Array, sigma: Array) -> None:
        """Change the IMU: b <- b + d, P_bb <- P_bb + diag(sigma^2); shift d, sigma: (6,), gyroscope then accelerometer."""
        self.x[X.BG] += shift[:3]
        self.x[X.BA] += shift[3:]
        self.widen_biases(sigma)

    def widen_biases(self, sigma: Array) -> None:
        """P_bb <- P_bb + diag(sigma^2); sigma: (6,), gyroscope then accelerometer."""
        self.cov[E.BG, E.BG] += np.diag(sigma[:3] ** 2)
        self.cov[E.BA, E.BA] += np.diag(sigma[3:] ** 2)

    def forget_clones(self) -> None:
        """No pose of an odometry is kept any more."""
        for block in list(self.clones):
            self.forget(block)

    def forget(self, block: str) -> None:
        """The slow error `block` is no longer taken into account."""
        gone = self.slow.columns[block]
        rows = np.concatenate((self.cov[: gone.start], self.cov[gone.stop :]))
        self.cov = np.concatenate((rows[:, : gone.start], rows[:, gone.stop :]), axis=1)
        self.slow = self.slow.without(block)
        if block in self.clones:
            self.clones = {name: pose for name, pose in self.clones.items() if name != block}

    def innovation(self, z: Measurement, gyro_b: Array, slow: Sequence[tuple[str, Array | None]] = ()) -> Innovation:
        """Innovation of z; slow: carried blocks with d z / d s (m, k) of the whole measurement, None: I."""
        nu, by_state = z.evaluate(self.x, gyro_b)
        m, noise = len(nu), z.noise
        h = np.zeros((m, len(self.cov)))
        h[:, : E.SIZE] = by_state
        for block, jacobian in slow:
            columns = self.slow.columns[block]
            moved = _identity(columns.stop - columns.start) if jacobian is None else jacobian
            h[:, columns] = moved if len(moved) == m else moved[z.rows]
        hp, noise, s, distance2, logdet = compare(nu, self.cov, h, noise, self.slow.mean)
        if isinstance(z, Curved):
            bend = z.bend(self.x, self.cov, nu, h, s)
            s = s + bend
            noise = resolved(noise + bend, s)
            distance2, logdet = mahalanobis(nu, s)
        if (f := self.variance_factor) > 1.0:
            s, distance2, logdet = f * s, distance2 / f, logdet + m * math.log(f)
        return Innovation(nu, h, hp, noise, s, distance2, logdet)

    def update(self, seen: Innovation) -> None:
        """Fuse a gated measurement."""
        mean, self.sound = fused(self.x, self.cov, seen.nu, seen.h, seen.noise, self.slow.mean, self.slow.estimated)
        self.slow = replace(self.slow, mean=mean)
        for block in self.clones:
            self._correct_pose(block)

    def cover(self, seen: Innovation) -> None:
        """Cover a measurement without fusing it: P <- P + d d^T, d = K nu of the estimated states."""
        f = self.variance_factor
        d = f * (seen.hp.T @ np.linalg.solve(seen.s, seen.nu))  # S here is f S
        d[E.SIZE :] *= self.slow.estimated
        self.cov += np.outer(d, d) / f

    def _correct_pose(self, block: str) -> None:
        at = self.slow.columns[block]
        error = np.zeros(len(self.slow.mean))
        error[at.start - E.SIZE : at.stop - E.SIZE] = self.slow.mean[at.start - E.SIZE : at.stop - E.SIZE]
        self.slow = self.slow.moved(-error)
        pose, g = moved(self.clones[block], error[at.start - E.SIZE : at.stop - E.SIZE])
        self.clones = {**self.clones, block: pose}
        turn = slice(at.start + XYZ, at.stop)
        self.cov[turn] = g @ self.cov[turn]
        self.cov[:, turn] = self.cov[:, turn] @ g.T
        cholesky.symmetrise(self.cov)

    def correct(self, seen: Innovation) -> Array:
        """Fuse a measurement into P and the slow errors; the error dx (15,) of the state, which is not moved yet.

        As `fused`: filterpy updates all errors, then the considered ones are put back.
        """
        dx, cov, _ = _kalman(len(self.cov)).update(self.cov, seen.nu, seen.h, seen.noise)
        considered = E.SIZE + np.flatnonzero(self.slow.estimated == 0.0)
        block = np.ix_(considered, considered)
        cov[block] = self.cov[block]
        self.cov, self.slow = cov, self.slow.moved(dx[E.SIZE :])
        return dx[: E.SIZE]


_T, _G, _N = E.THETA.start, E.BG.start, E.SIZE


@njit(cache=True, error_model="numpy")
def compare(nu: Array, cov: Array, h: Array, noise: Array, mean: Array) -> tuple[Array, Array, Array, float, float]:
    """H P, R, S, nu^T S^-1 nu and ln det S, after nu <- nu - H_s s in place; s: mean (n - 15,) of the slow errors."""
    for i in range(nu.shape[0]):
        for k in range(mean.shape[0]):
            nu[i] -= h[i, _N + k] * mean[k]
    s, hp = innovation_covariance(cov, h, noise)
    noise = resolved(noise, s)
    distance2, logdet = mahalanobis(nu, s)
    return hp, noise, s, distance2, logdet


@njit(cache=True, error_model="numpy")
def resolved(noise: Array, s: Array) -> Array:
    """R (m, m), or R + epsilon (I + diag S) and S likewise, in place, where R - epsilon (I + diag S) is not positive definite.

    No reading is more exact than the arithmetic: P would not be positive definite after it.
    """
    more = noise.copy()
    for i in range(s.shape[0]):
        more[i, i] -= _ARITHMETIC * (1.0 + s[i, i])
    if cholesky.factor(more, more):
        return noise
    more = noise.copy()
    for i in range(s.shape[0]):
        rounding = _ARITHMETIC * (1.0 + s[i, i])
        more[i, i] += rounding
        s[i, i] += rounding
    return more


@njit(cache=True, error_model="numpy")
def fused(x: Array, cov: Array, nu: Array, h: Array, noise: Array, mean: Array, estimated: Array) -> tuple[Array, bool]:
    """P <- (I - K H) P (I - K H)^T + K R K^T and x <- x (+) K nu, in place; means of the slow errors, whether all is sound.

    K = P H^T S^-1, but 0 in the rows of considered slow errors: estimated (n - 15,) 0; h: H (m, n), mostly zero.
    """
    (m, n), dx, mean = h.shape, np.zeros(cov.shape[0]), mean.copy()
    s, hp = innovation_covariance(cov, h, noise)
    gain = hp.copy()  # K^T (m, n)
    if not cholesky.factor(s, s):
        raise np.linalg.LinAlgError("not positive definite")
    cholesky.forward(s, gain)
    cholesky.backward(s, gain)
    for i in range(m):
        for j in range(n):
            gain[i, j] *= 1.0 if j < _N else estimated[j - _N]
            dx[j] += gain[i, j] * nu[i]
    for i in range(m):
        for j in range(n):
            for k in range(n):
                cov[j, k] -= hp[i, j] * gain[i, k]
    left = innovation_covariance(cov, h, noise)[1]  # H P (I - K H)^T - R K^T: 0 but for rounding where nothing is considered
    for i in range(m):
        for k in range(m):
            for j in range(n):
                left[i, j] -= noise[i, k] * gain[k, j]
    for i in range(m):
        for j in range(n):
            for k in range(n):
                cov[j, k] -= gain[i, j] * left[i, k]
    cholesky.symmetrise(cov)
    for k in range(n - _N):
        mean[k] += dx[_N + k]
    return mean, inject(x, cov, dx)


@njit(cache=True, error_model="numpy")
def inject(x: Array, cov: Array, dx: Array) -> bool:
    """x <- x (+) dx and P <- G P G^T, in place; dx (15,). False where the result is not sound."""
    moved, g, n = retract(x, dx), so3.skew(dx[_T:_G]), cov.shape[0]
    for i in range(x.shape[0]):
        x[i] = moved[i]
    for i in range(3):
        for j in range(3):
            g[i, j] = (1.0 if i == j else 0.0) - 0.5 * g[i, j]
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
    cholesky.symmetrise(cov)
    return sound(x, cov)
