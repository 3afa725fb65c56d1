"""Measurement models.

    nu = z (-) h(x_hat) = H dx + v,   v ~ N(0, R)

`evaluate(x, gyro_b)` gives nu (m,), H (m, 15), rows of given components only. Attitude noise about n: R_true = exp(dtheta_n)
R_measured.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import cholesky, so3
from models.messages import RADIAN_M, Array
from models.state import E, X

# Compiled code reads plain integers.
_P, _V, _T, _G, _N = E.P.start, E.V.start, E.THETA.start, E.BG.start, E.SIZE
_XP, _XV, _XQ, _XG = X.P.start, X.V.start, X.Q.start, X.BG.start
_XA = X.BA.start

_XYZ, _FIRST = np.arange(3), np.arange(1)
_STEEPEST, _TINY = math.radians(84.0), 1e-30  # rad: what points up or down more shows no heading
DIRECTION_SCALE = np.array([1.0, 1.0, 1.0, RADIAN_M, RADIAN_M, RADIAN_M])  # D / this has orthonormal rows


class Measurement(Protocol):
    """Interface of a measurement."""

    @property
    def noise(self) -> Array:
        """R, (m, m), of the given components."""

    @property
    def rows(self) -> NDArray[np.intp]:
        """Given components of the whole measurement, (m,)."""

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """nu (m,) and H (m, 15) at the nominal state x (16,); gyro_b: raw rate (3,), rad/s."""


class Position(msgspec.Struct, frozen=True, eq=False):
    """z = p + R_nb l, of given axes of n.

    z_n: (3,) m; noise: (m, m) m^2; rows: given components; lever_b: IMU to the point, m.
    """

    z_n: Array
    noise: Array
    rows: NDArray[np.intp]
    lever_b: Array

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """See Measurement."""
        nu, h = _position(x, self.z_n, self.lever_b)
        return (nu, h) if len(self.rows) == len(nu) else (nu[self.rows], h[self.rows])


class Velocity(msgspec.Struct, frozen=True, eq=False):
    """z = v + R_nb ((w - b_g) x l), m/s in n, of an antenna at lever_b; noise (3, 3)."""

    z_n: Array
    noise: Array
    lever_b: Array

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return _XYZ

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """See Measurement."""
        return _velocity(x, self.z_n, self.lever_b, gyro_b)


class Pose(msgspec.Struct, frozen=True, eq=False):
    """Position and attitude, given components.

    rows: of (x y z rx ry rz); noise (m, m) in that order. Attitude: whole, roll and pitch, yaw, or none.
    """

    z_n: Array
    q_nb_wxyz: Array
    noise: Array
    rows: NDArray[np.intp]
    attitude: str = "full"  # full | tilt | yaw | none

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """See Measurement."""
        if self.attitude == "yaw":
            nu, h = _pose_yaw(x, self.z_n, self.q_nb_wxyz)
        elif self.attitude == "tilt":
            nu, h = _pose_tilt(x, self.z_n, self.q_nb_wxyz)
        else:
            nu, h = _pose(x, self.z_n, self.q_nb_wxyz)
        return (nu, h) if len(self.rows) == len(nu) else (nu[self.rows], h[self.rows])


class Curved:
    """A measurement nonlinear over the remaining uncertainty."""

    __slots__ = ()

    def bend(self, x: Array, cov: Array, nu: Array, h: Array, s: Array) -> Array:
        """Covariance (m, m) of nonlinear terms at x with P (n, n); nu, H, S of this reading."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class PartialPose(Curved):
    """r combinations of position and attitude, D (x_true (-) z) = y + v, metres; D (r, 6), y (r,), noise (r, r).

    z_n, q_nb_wxyz: linearisation of the images.
    """

    z_n: Array
    q_nb_wxyz: Array
    directions: Array
    readings: Array
    noise: Array

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return np.arange(len(self.directions))

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """nu = D (z (-) x) + y. See Measurement."""
        nu, h = _pose(x, self.z_n, self.q_nb_wxyz)
        return self.directions @ nu + self.readings, self.directions @ h

    def bend(self, x: Array, cov: Array, nu: Array, h: Array, s: Array) -> Array:
        """See Curved.

        Poses that look the same are x exp(t zeta), of which d - theta x d / 2 is linear in t, so D_p (theta x d) / 2 is left out.
        d, theta: of the truth from z, which is x (+) K nu (-) z with its covariance.
        """
        return _bend(x, cov, nu, h, s, self.z_n, self.q_nb_wxyz, self.directions)


@dataclass(frozen=True, slots=True, eq=False)
class Height:
    """z = -p_d, metres above n's origin; noise (1, 1)."""

    z_m: float
    noise: Array

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return _FIRST

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """See Measurement."""
        h = np.zeros((1, _N))
        h[0, E.P.stop - 1] = -1.0
        return np.array([self.z_m + x[X.P][2]]), h


class Conditional:
    """A measurement valid at some states only."""

    __slots__ = ()

    def objection(self, x: Array) -> str:
        """Why it is unusable at x (16,); '' if usable."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, eq=False)
class Heading(Conditional):
    """alpha = atan2(d_e, d_n), d_n = R_nb d_b: azimuth of a body direction; rad, noise (1, 1).

    direction_b: (3,) of any length (field, baseline); elevation: above the horizon, +- elevation_within [rad], None: unknown;
    is_steep: only turns about the vertical count: through tilt a constant error would tilt a vehicle at rest.
    """

    direction_b: Array
    azimuth: float
    noise: Array
    elevation: float | None = None
    elevation_within: float = math.pi
    is_steep: bool = False

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return _FIRST

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """nu = wrap(alpha - atan2(d_e, d_n));  H_theta = (d_n e_e - d_e e_n)^T (-R [d_b]x) / (d_n^2 + d_e^2)."""
        nu, by_direction = self._off(x)
        h = np.zeros((1, _N))
        h[0, E.THETA] = by_direction @ -so3.skew(self.direction_b)
        if self.is_steep:
            down_b = so3.matrix(x[X.Q])[2]
            h[0, E.THETA] = (h[0, E.THETA] @ down_b) * down_b
        return nu, h

    def by_direction(self, x: Array) -> Array:
        """d alpha / d d_b, (1, 3)."""
        return self._off(x)[1][np.newaxis]

    def _off(self, x: Array) -> tuple[Array, Array]:
        r = so3.matrix(x[X.Q])
        north, east = (r[:2] @ self.direction_b).tolist()
        level = max(north * north + east * east, _TINY)
        off = self.azimuth - math.atan2(east, north)
        return np.array([math.atan2(math.sin(off), math.cos(off))]), (north * r[1] - east * r[0]) / level

    def objection(self, x: Array) -> str:
        """See Conditional."""
        up = -float(so3.matrix(x[X.Q])[2] @ self.direction_b) / float(np.linalg.norm(self.direction_b))
        elevation = math.asin(min(max(up, -1.0), 1.0))
        if self.elevation is not None and abs(elevation - self.elevation) > self.elevation_within:
            return f"points {math.degrees(elevation):.0f} deg above the horizon, {math.degrees(self.elevation):.0f} expected"
        return "points up or down, which shows no heading" if abs(elevation) > _STEEPEST else ""


@njit(cache=True, error_model="numpy")
def _bend(x: Array, cov: Array, nu: Array, h: Array, s: Array, z: Array, q: Array, directions: Array) -> Array:
    """D_p E[c c^T] D_p^T / 4, c = theta x d, of (d, theta) ~ N(x (+) K nu (-) z, J P J^T - K S K^T).

    J: z (-) x by the error of x. With S = L L^T, B = L^-1 H P J^T: K S K^T = B^T B, K nu = B^T L^-1 nu.
    """
    n, m = cov.shape[0], nu.shape[0]
    off, by_state = _pose(x, z, q)
    to_pose = np.zeros((6, n))
    for i in range(6):
        for k in range(_N):
            to_pose[i, k] = by_state[i, k]
    left, with_all = innovation_covariance(cov, to_pose, np.zeros((6, 6)))
    low, white = np.empty((m, m)), np.zeros((m, 7))
    for i in range(m):
        for k in range(n):
            if h[i, k] != 0.0:
                for j in range(6):
                    white[i, j] += h[i, k] * with_all[j, k]
        white[i, 6] = nu[i]
    if not cholesky.factor(s, low):
        s = np.empty((m, m))
        for i in range(m):
            for j in range(m):
                s[i, j] = np.nan
        return s
    cholesky.forward(low, white)
    for i in range(6):
        for k in range(m):
            off[i] -= white[k, i] * white[k, 6]
            for j in range(6):
                left[i, j] -= white[k, i] * white[k, j]
    moment, bend = _cross_moment(off, left), np.zeros((m, m))
    for i in range(m):
        for j in range(m):
            for a in range(3):
                for b in range(3):
                    bend[i, j] += 0.25 * directions[i, a] * moment[a, b] * directions[j, b]
    return bend


@njit(cache=True, error_model="numpy")
def _cross_moment(mean: Array, cov: Array) -> Array:
    """E[c c^T], (3, 3), c = t x d, (d, t) ~ N(mean (6,), cov (6, 6)): c_k = t_a d_b - t_b d_a, (k, a, b) cyclic."""
    second, moment = np.empty((6, 6)), np.empty((3, 3))
    for i in range(6):
        for j in range(6):
            second[i, j] = cov[i, j] + mean[i] * mean[j]
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        for m in range(3):
            c, e = (m + 1) % 3, (m + 2) % 3
            moment[k, m] = (
                _fourth(mean, second, a, b, c, e) - _fourth(mean, second, a, b, e, c)
                - _fourth(mean, second, b, a, c, e) + _fourth(mean, second, b, a, e, c)
            )  # fmt: skip
    return moment


@njit(cache=True, error_model="numpy", inline="always")
def _fourth(m: Array, s: Array, a: int, b: int, c: int, e: int) -> float:
    """E[t_a d_b t_c d_e] from means and second moments, by Isserlis' theorem."""
    paired: float = s[3 + a, b] * s[3 + c, e] + s[3 + a, 3 + c] * s[b, e] + s[3 + a, e] * s[3 + c, b]
    four: float = m[3 + a] * m[b] * m[3 + c] * m[e]
    return paired - 2.0 * four


@njit(cache=True, error_model="numpy")
def _position(x: Array, z: Array, lever: Array) -> tuple[Array, Array]:
    """nu = z - p - R l;  H_p = I, H_theta = -R [l]x."""
    r = so3.matrix(x[_XQ:_XG])
    h = np.zeros((3, _N))
    offset = so3.applied(r, lever)
    by_turn, nu = so3.product(r, so3.skew(lever)), np.empty(3)
    for i in range(3):
        for k in range(3):
            h[i, _T + k] = -by_turn[i, k]
        h[i, _P + i] = 1.0
        nu[i] = z[i] - x[_XP + i] - offset[i]
    return nu, h


@njit(cache=True, error_model="numpy")
def _velocity(x: Array, z: Array, lever: Array, gyro: Array) -> tuple[Array, Array]:
    """nu = z - v - R (w x l);  H_v = I, H_theta = -R [w x l]x, H_bg = R [l]x  (w = gyro - b_g)."""
    r = so3.matrix(x[_XQ:_XG])
    rate, nu, h = np.empty(3), np.empty(3), np.zeros((3, _N))
    for i in range(3):
        rate[i] = gyro[i] - x[_XG + i]
    spin = so3.applied(so3.skew(rate), lever)
    by_turn, by_bias = so3.product(r, so3.skew(spin)), so3.product(r, so3.skew(lever))
    offset = so3.applied(r, spin)
    for i in range(3):
        for k in range(3):
            h[i, _T + k], h[i, _G + k] = -by_turn[i, k], by_bias[i, k]
        h[i, _V + i] = 1.0
        nu[i] = z[i] - x[_XV + i] - offset[i]
    return nu, h


@njit(cache=True, error_model="numpy")
def _pose(x: Array, z: Array, q: Array) -> tuple[Array, Array]:
    """nu_p = z - p;  nu_a = log(R_z R^T), H_theta = J_r^-1(nu_a) R   (R_z R^T = exp(nu_a) stays, R moves to R exp(theta))."""
    r = so3.matrix(x[_XQ:_XG])
    nu, h = np.empty(6), np.zeros((6, _N))
    turn = so3.quat_log(so3.multiply(q, so3.conjugate(x[_XQ:_XG])))
    by_turn = so3.product(so3.right_jacobian_inverse(turn), r)
    for i in range(3):
        for k in range(3):
            h[3 + i, _T + k] = by_turn[i, k]
        h[i, _P + i] = 1.0
        nu[i] = z[i] - x[_XP + i]
        nu[3 + i] = turn[i]
    return nu, h


def _pose_yaw(x: Array, z: Array, q: Array) -> tuple[Array, Array]:
    """Yaw alone: nu = wrap(psi_z - psi), psi = atan2(R10, R00), as rz; H from R's first column."""
    nu, h = _pose(x, z, q)
    r, m = so3.matrix(x[_XQ:_XG]), so3.matrix(q)
    difference = math.atan2(m[1, 0], m[0, 0]) - math.atan2(r[1, 0], r[0, 0])
    nu[5] = math.atan2(math.sin(difference), math.cos(difference))
    level = max(r[0, 0] ** 2 + r[1, 0] ** 2, _TINY)
    north, east = -r[2, 0] * r[0, 0] / level, -r[2, 0] * r[1, 0] / level
    h[5, E.THETA] = north * r[0] + east * r[1] + r[2]
    return nu, h


def _pose_tilt(x: Array, z: Array, q: Array) -> tuple[Array, Array]:
    """Roll and pitch alone: d = R R_z^T e_z; nu = (d_y, -d_x).

    H from d(exp(delta) d) = delta x d; rows x and y of R where the two agree.
    """
    nu, h = _pose(x, z, q)
    r, m = so3.matrix(x[_XQ:_XG]), so3.matrix(q)
    down = so3.applied(r, m[2])
    nu[3], nu[4] = down[1], -down[0]
    h[3, E.THETA] = down[2] * r[0] - down[0] * r[2]
    h[4, E.THETA] = down[2] * r[1] - down[1] * r[2]
    return nu, h


@njit(cache=True, error_model="numpy")
def innovation_covariance(cov: Array, h: Array, noise: Array) -> tuple[Array, Array]:
    """S = H P H^T + R (m, m), symmetric, and H P (m, n); H (m, n) is mostly zero."""
    m, n = h.shape
    s, hp = np.empty((m, m)), np.zeros((m, n))
    for i in range(m):
        for k in range(n):
            if h[i, k] != 0.0:
                for j in range(n):
                    hp[i, j] += h[i, k] * cov[k, j]
    for i in range(m):
        for j in range(i, m):
            total = 0.5 * (noise[i, j] + noise[j, i])
            for k in range(n):
                total += h[i, k] * hp[j, k]
            s[i, j] = total
            s[j, i] = total
    return s, hp


@njit(cache=True, error_model="numpy")
def mahalanobis(nu: Array, s: Array) -> tuple[float, float]:
    """(nu^T S^-1 nu, ln det S) by Cholesky; (inf, inf) unless positive definite."""
    m = nu.shape[0]
    low, y = np.empty((m, m)), np.empty((m, 1))
    if not cholesky.factor(s, low):
        return np.inf, np.inf
    for i in range(m):
        y[i, 0] = nu[i]
    cholesky.forward(low, y)
    d2, logdet = 0.0, 0.0
    for i in range(m):
        d2 += y[i, 0] * y[i, 0]
        logdet += 2.0 * np.log(low[i, i])
    return d2, logdet
