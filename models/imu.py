"""Strapdown mechanisation, error transition and process noise, compiled (docs/estimator.md, section 2).

    p' = v,   v' = R (f - b_a - n_a) + g(p) - 2 w_ie x v,   R' = R [w - b_g - n_g - R^T w_ie]x,   b' = n_b
                                                                        (Groves 2013, sec. 5.3; Sola 2017, eq. 235)
Rates and specific forces are linear between samples (rest: models.sampling). Over a step h, R0, Rm, R1 at start, middle, end:

    alpha = h (w0 + w1)/2 + h^2/12 w0 x w1                               (exact to h^3 for linear w; Groves 2013, eq. 5.80)
    s_v = h/6 (R0 f0 + 4 Rm fm + R1 f1),   s_p = h^2/6 (R0 f0 + 2 Rm fm)                              (Simpson's rule)
    v1 = v0 + s_v + h (g - 2 w_ie x v),    p1 = p0 + h v0 + s_p + h^2/2 (g - 2 w_ie x v)

Error transition (local attitude error):

    dp1 = dp + h dv - [s_p]x R0 theta + h^2/6 [s_v]x Rm db_g - h^2/2 Rm db_a
    dv1 = (I - 2h [w_ie]x) dv + h G dp - [s_v]x R0 theta + h/2 [s_v]x Rm db_g - h Rm db_a,  G = g/r diag(-1, -1, 2)
    theta1 = R1^T (I - h [w_ie]x) R0 theta - h R1^T Rm db_g

Without IMU: constant velocity, decaying turn rate, larger noise (`coast`). Slow errors beyond E.SIZE: c1 = exp(-h/tau) c + n_c.
"""

import math
from typing import Annotated

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import sampling
from models.frames import GRAVITY, Origin
from models.messages import Array
from models.state import E, X, sound

# Compiled code reads plain integers: where the parts of the error state and of the packed nominal state begin.
_P, _V, _T, _G, _A, _N = E.P.start, E.V.start, E.THETA.start, E.BG.start, E.BA.start, E.SIZE
_XP, _XV, _XQ, _XG, _XA = X.P.start, X.V.start, X.Q.start, X.BG.start, X.BA.start

_NS = 1e-9  # s per ns
_EARTH_RADIUS = 6_371_000.0  # m, mean
_NONE, NOTHING = np.zeros(0), np.zeros((0, 0))
_LANES = 8  # numbers that a vector register holds
# What a step calls is inlined: a call counts references to every array that it hands over, a quarter of the time of a step.


class ImuNoise(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Noise densities and walks as mounted: vibration makes them up to 20 x the data sheet's."""

    gyro_noise: Annotated[float, msgspec.Meta(ge=1e-9, le=10, description="rad/s/sqrt(Hz): white noise of the gyroscope")] = 2e-3
    accel_noise: Annotated[
        float, msgspec.Meta(ge=1e-9, le=100, description="m/s^2/sqrt(Hz): white noise of the accelerometer")
    ] = 0.1
    gyro_walk: Annotated[float, msgspec.Meta(ge=1e-12, le=1, description="rad/s^2/sqrt(Hz): random walk of the gyro bias")] = 1e-4
    accel_walk: Annotated[float, msgspec.Meta(ge=1e-12, le=10, description="m/s^3/sqrt(Hz): random walk of the accel bias")] = (
        3e-3
    )
    gyro_scale: Annotated[
        float, msgspec.Meta(ge=0, lt=1, description="share of a turn that is wrong: scale and axes of the gyroscope; 0: none")
    ] = 1e-3

    def scaled(self, factor: float) -> "ImuNoise":
        """Noise and walk times `factor`."""
        densities = {name: factor * getattr(self, name) for name in ("gyro_noise", "accel_noise", "gyro_walk", "accel_walk")}
        return msgspec.structs.replace(self, **densities)


class Coast(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Motion model without IMU samples."""

    gap_s: Annotated[float, msgspec.Meta(ge=1e-3, le=60, description="s: longer gaps between IMU samples are coasted")] = 0.1
    accel_noise: Annotated[
        float, msgspec.Meta(ge=1e-6, le=1000, description="m/s^2/sqrt(Hz): unknown acceleration while coasting")
    ] = 3.0
    gyro_noise: Annotated[float, msgspec.Meta(ge=1e-6, le=100, description="rad/s/sqrt(Hz): unknown turning while coasting")] = (
        0.3
    )
    turn_decay_s: Annotated[float, msgspec.Meta(ge=1e-3, le=1e4, description="s: time in which the last turn rate dies away")] = (
        1.0
    )


# Layout of the constants that the kernels read, one float array.
_C_GRAVITY = 0  # m/s^2 at the origin
_C_GRADIENT = 1  # 1/s^2: g / radius of the Earth where the origin is known, else 0
_C_EARTH = 2  # rad/s, Earth rate in n, three numbers
_C_GYRO_PSD, _C_ACCEL_PSD = 5, 6  # (rad/s)^2/Hz, (m/s^2)^2/Hz
_C_GYRO_WALK_PSD, _C_ACCEL_WALK_PSD = 7, 8
_C_COAST_GYRO_PSD, _C_COAST_ACCEL_PSD = 9, 10
_C_GAP_S, _C_TURN_DECAY_S = 11, 12
_C_SCALE_PSD = 13  # 1/Hz: of the error of a gyroscope, over the square of the rate
_C_SIZE = 14

_LEAST_RANGE_GYRO, _LEAST_RANGE_ACCEL = 4.3, 18.0  # rad/s, m/s^2: no sensor ends below 250 deg/s, 2 g
_LOOK_BACK = 8  # samples
_AT_ONCE_S = 1e-6
_TURN_S = 1.0  # a turn lasts about as long; the next one is about another axis, or back


def constants(noise: ImuNoise, coast: Coast, origin: Origin | None) -> Array:
    """Constants of the kernels, in the order of C."""
    c = np.zeros(_C_SIZE)
    c[_C_GRAVITY] = GRAVITY
    if origin is not None:
        c[_C_GRAVITY], c[_C_EARTH : _C_EARTH + 3] = origin.gravity, origin.earth_rate_n
        c[_C_GRADIENT] = origin.gravity / _EARTH_RADIUS
    c[_C_GYRO_PSD], c[_C_ACCEL_PSD] = noise.gyro_noise**2, noise.accel_noise**2
    c[_C_GYRO_WALK_PSD], c[_C_ACCEL_WALK_PSD] = noise.gyro_walk**2, noise.accel_walk**2
    c[_C_COAST_GYRO_PSD], c[_C_COAST_ACCEL_PSD] = coast.gyro_noise**2, coast.accel_noise**2
    c[_C_GAP_S], c[_C_TURN_DECAY_S] = coast.gap_s, coast.turn_decay_s
    c[_C_SCALE_PSD] = noise.gyro_scale**2 * _TURN_S
    return c


def in_doubt(constants: Array) -> Array:
    """Constants where the IMU is taken for wrong: the state coasts at all times, straight on, without turning."""
    c = constants.copy()
    c[_C_GAP_S], c[_C_TURN_DECAY_S] = 0.0, _AT_ONCE_S
    return c


def unknown_motion(constants: Array, dt: float) -> Array:
    """Covariance (15, 15) of an unknown motion over dt, vertical unknown by its own turning:

    s_v = (q_a + g^2 q_w dt^2 / 3) dt,   s_p = s_v dt^2 / 3,   s_pv = s_v dt / 2,   s_theta = q_w dt
    """
    q_w, q_a = constants[_C_COAST_GYRO_PSD], constants[_C_COAST_ACCEL_PSD]
    s_v = (q_a + constants[_C_GRAVITY] ** 2 * q_w * dt**2 / 3.0) * dt
    added = np.zeros((E.SIZE, E.SIZE))
    for block, other, value in (
        (E.P, E.P, s_v * dt**2 / 3.0), (E.P, E.V, s_v * dt / 2.0), (E.V, E.P, s_v * dt / 2.0),
        (E.V, E.V, s_v), (E.THETA, E.THETA, q_w * dt),
    ):  # fmt: skip
        added[block, other] = value * np.eye(3)
    return added


@njit(cache=True, inline="always")
def _matrix_into(q: Array, r: Array) -> None:
    w, x, y, z = q[0], q[1], q[2], q[3]
    r[0, 0], r[0, 1], r[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    r[1, 0], r[1, 1], r[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    r[2, 0], r[2, 1], r[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


@njit(cache=True, inline="always")
def _turn(q: Array, hw: float, hx: float, hy: float, hz: float) -> None:
    """q <- q (hw, hx, hy, hz), in place."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    q[0] = w * hw - x * hx - y * hy - z * hz
    q[1] = w * hx + x * hw + y * hz - z * hy
    q[2] = w * hy - x * hz + y * hw + z * hx
    q[3] = w * hz + x * hy - y * hx + z * hw


_NEXT = (1, 2, 0)  # row i of [s]x r is s_a r_b - s_b r_a, a and b the two that come after i
# The rows of Phi that are not those of the identity, (9, 15), have nothing outside these columns.
_FIRST, _LAST = (_P,) * _T + (_T,) * 3, (_N,) * _T + (_A,) * 3


@njit(cache=True, error_model="numpy")
def _strapdown(x: Array, h: float, ends: Array, c: Array, r: Array, n: Array, phi: Array) -> None:
    """One nominal step in place; fills r = R0, Rm, R1 (3, 3, 3) and phi (9, 15), unless it is empty.

    ends (4, 3): w0, w1, f0, f1. Scratch: n (3, 3), R (f - b_a) of the three.
    """
    q, r0, rm, r1 = x[_XQ:_XG], r[0], r[1], r[2]
    wx, wy, wz = c[_C_EARTH], c[_C_EARTH + 1], c[_C_EARTH + 2]
    _matrix_into(q, r0)
    a0, a1, a2 = ends[0, 0] - x[_XG], ends[0, 1] - x[_XG + 1], ends[0, 2] - x[_XG + 2]
    b0, b1, b2 = ends[1, 0] - x[_XG], ends[1, 1] - x[_XG + 1], ends[1, 2] - x[_XG + 2]
    k12 = h * h / 12.0
    ax = 0.5 * h * (a0 + b0) + k12 * (a1 * b2 - a2 * b1) - h * (r0[0, 0] * wx + r0[1, 0] * wy + r0[2, 0] * wz)
    ay = 0.5 * h * (a1 + b1) + k12 * (a2 * b0 - a0 * b2) - h * (r0[0, 1] * wx + r0[1, 1] * wy + r0[2, 1] * wz)
    az = 0.5 * h * (a2 + b2) + k12 * (a0 * b1 - a1 * b0) - h * (r0[0, 2] * wx + r0[1, 2] * wy + r0[2, 2] * wz)
    quarter = 0.25 * math.sqrt(ax * ax + ay * ay + az * az)  # half of the half rotation's angle
    s = 0.25 if quarter < 1e-8 else 0.25 * math.sin(quarter) / quarter
    hw = math.cos(quarter)
    _turn(q, hw, s * ax, s * ay, s * az)
    _matrix_into(q, rm)
    _turn(q, hw, s * ax, s * ay, s * az)
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] *= scale
    _matrix_into(q, r1)
    for i in range(3):
        f0, f1 = ends[2, i], ends[3, i]
        n[0, i], n[1, i], n[2, i] = f0 - x[_XA + i], 0.5 * (f0 + f1) - x[_XA + i], f1 - x[_XA + i]
    kv, kp, hh = h / 6.0, h * h / 6.0, 0.5 * h * h
    sp, sv = ends[0], ends[1]
    for i in range(3):
        n0 = r0[i, 0] * n[0, 0] + r0[i, 1] * n[0, 1] + r0[i, 2] * n[0, 2]
        nm = rm[i, 0] * n[1, 0] + rm[i, 1] * n[1, 1] + rm[i, 2] * n[1, 2]
        n1 = r1[i, 0] * n[2, 0] + r1[i, 1] * n[2, 1] + r1[i, 2] * n[2, 2]
        sp[i], sv[i] = kp * (n0 + 2.0 * nm), kv * (n0 + 4.0 * nm + n1)
    k = c[_C_GRADIENT]  # g(p) - 2 w_ie x v in n: weaker with height, plus Coriolis (Groves 2013, eq. 5.53)
    g = ends[2]
    g[0] = -k * x[_XP] - 2.0 * (wy * x[_XV + 2] - wz * x[_XV + 1])
    g[1] = -k * x[_XP + 1] - 2.0 * (wz * x[_XV] - wx * x[_XV + 2])
    g[2] = c[_C_GRAVITY] + 2.0 * k * x[_XP + 2] - 2.0 * (wx * x[_XV + 1] - wy * x[_XV])
    for i in range(3):
        x[_XP + i] += h * x[_XV + i] + sp[i] + hh * g[i]
        x[_XV + i] += sv[i] + h * g[i]
    if phi.shape[0] == 0:
        return
    wx, wy, wz = h * wx, h * wy, h * wz
    phi[_V, _V], phi[_V, _V + 1], phi[_V, _V + 2] = 1.0, 2.0 * wz, -2.0 * wy  # I - 2h [w_ie]x
    phi[_V + 1, _V], phi[_V + 1, _V + 1], phi[_V + 1, _V + 2] = -2.0 * wz, 1.0, 2.0 * wx
    phi[_V + 2, _V], phi[_V + 2, _V + 1], phi[_V + 2, _V + 2] = 2.0 * wy, -2.0 * wx, 1.0
    for j in range(3):
        phi[_P + j, _P + j], phi[_P + j, _V + j] = 1.0, h
        phi[_V + j, _P + j] = (2.0 if j == 2 else -1.0) * k * h
        x0, x1, x2 = r0[0, j], r0[1, j], r0[2, j]
        y0, y1, y2 = x0 + wz * x1 - wy * x2, x1 - wz * x0 + wx * x2, x2 + wy * x0 - wx * x1
        for i in range(3):
            a, b = _NEXT[i], _NEXT[_NEXT[i]]
            phi[_P + i, _T + j] = -1.0 * (sp[a] * r0[b, j] - sp[b] * r0[a, j])
            phi[_V + i, _T + j] = -1.0 * (sv[a] * r0[b, j] - sv[b] * r0[a, j])
            phi[_P + i, _G + j] = kp * (sv[a] * rm[b, j] - sv[b] * rm[a, j])
            phi[_V + i, _G + j] = 0.5 * h * (sv[a] * rm[b, j] - sv[b] * rm[a, j])
            phi[_P + i, _A + j], phi[_V + i, _A + j] = -hh * rm[i, j], -h * rm[i, j]
            phi[_T + i, _T + j] = r1[0, i] * y0 + r1[1, i] * y1 + r1[2, i] * y2
            phi[_T + i, _G + j] = -h * (r1[0, i] * rm[0, j] + r1[1, i] * rm[1, j] + r1[2, i] * rm[2, j])


@njit(cache=True, error_model="numpy")
def _transition_rows(phi: Array, m: Array, out: Array) -> None:
    """out (9, k) = phi m, m (15, k): position, velocity, attitude rows of Phi m.

    One inner loop a row with scalar coefficients: vectorised by LLVM.
    """
    k = m.shape[1]
    for i in range(3):
        f = phi[_P + i]
        v, t0, t1, t2, g0, g1, g2 = f[_V + i], f[_T], f[_T + 1], f[_T + 2], f[_G], f[_G + 1], f[_G + 2]
        a0, a1, a2 = f[_A], f[_A + 1], f[_A + 2]
        for j in range(k):
            out[_P + i, j] = (
                m[_P + i, j] + v * m[_V + i, j]
                + t0 * m[_T, j] + t1 * m[_T + 1, j] + t2 * m[_T + 2, j]
                + g0 * m[_G, j] + g1 * m[_G + 1, j] + g2 * m[_G + 2, j]
                + a0 * m[_A, j] + a1 * m[_A + 1, j] + a2 * m[_A + 2, j]
            )  # fmt: skip
        f = phi[_V + i]
        p, v0, v1, v2 = f[_P + i], f[_V], f[_V + 1], f[_V + 2]
        t0, t1, t2, g0, g1, g2 = f[_T], f[_T + 1], f[_T + 2], f[_G], f[_G + 1], f[_G + 2]
        a0, a1, a2 = f[_A], f[_A + 1], f[_A + 2]
        for j in range(k):
            out[_V + i, j] = (
                p * m[_P + i, j] + v0 * m[_V, j] + v1 * m[_V + 1, j] + v2 * m[_V + 2, j]
                + t0 * m[_T, j] + t1 * m[_T + 1, j] + t2 * m[_T + 2, j]
                + g0 * m[_G, j] + g1 * m[_G + 1, j] + g2 * m[_G + 2, j]
                + a0 * m[_A, j] + a1 * m[_A + 1, j] + a2 * m[_A + 2, j]
            )  # fmt: skip
        f = phi[_T + i]
        t0, t1, t2, g0, g1, g2 = f[_T], f[_T + 1], f[_T + 2], f[_G], f[_G + 1], f[_G + 2]
        for j in range(k):
            out[_T + i, j] = (
                t0 * m[_T, j] + t1 * m[_T + 1, j] + t2 * m[_T + 2, j]
                + g0 * m[_G, j] + g1 * m[_G + 1, j] + g2 * m[_G + 2, j]
            )  # fmt: skip


@njit(cache=True, inline="always")
def _covariance(p: Array, phi: Array, rows: Array) -> None:
    """P <- Phi P Phi^T, in place; p: (15, >= 15) rows of P, symmetric in the 15; scratch: rows (9, like p)."""
    _transition_rows(phi, p, rows)
    for i in range(_G):
        for j in range(i, _G):
            total = 0.0
            for k in range(_FIRST[j], _LAST[j]):
                total += rows[i, k] * phi[j, k]
            p[i, j] = total
            p[j, i] = total
        for j in range(_G, _N):
            p[j, i] = rows[i, j]
        for j in range(_G, p.shape[1]):
            p[i, j] = rows[i, j]


@njit(cache=True, error_model="numpy")
def _is_saturated(u: Array, i: int, sensor: int) -> bool:
    """Saturation of sample i or the one before: an axis repeats a large value to the bit."""
    for at in range(max(i - 1, 0), i + 1):
        for k in range(3 * sensor, 3 * sensor + 3):
            size = abs(u[at, k])
            if size > (_LEAST_RANGE_GYRO if sensor == 0 else _LEAST_RANGE_ACCEL):
                for j in range(max(at - _LOOK_BACK, 0), at):
                    if abs(u[j, k]) == size:
                        return True
    return False


@njit(cache=True, inline="always")
def _add_noise(
    p: Array, x: Array, h: float, i: int, coasting: bool, t_ns: NDArray[np.int64], u: Array, known: Array, c: Array
) -> None:
    """P <- P + Q of white acceleration, turn-rate and bias noise over h (position: double integral).

    A share s of the turn rate is wrong for T: density s^2 T |w - b_g|^2, (rad/s)^2/Hz. Saturated samples count as missing.
    """
    gyro, accel = c[_C_COAST_GYRO_PSD], c[_C_COAST_ACCEL_PSD]
    if not coasting:
        span, square = (t_ns[i] - t_ns[i - 1]) * _NS, 0.0
        for k in range(3):
            rate = u[i, k] - x[_XG + k]
            square += rate * rate
        for sensor in range(2):  # not literals: density would be compiled once for each
            psd = c[_C_GYRO_PSD + sensor]
            psd += sampling.density(known[i], sensor, span, psd)
            if _is_saturated(u, i, sensor):
                psd = max(psd, c[_C_COAST_GYRO_PSD + sensor])
            if sensor == 0:
                gyro = psd + c[_C_SCALE_PSD] * square
            else:
                accel = psd
    for k in range(3):
        p[_P + k, _P + k] += accel * h * h * h / 3.0
        p[_P + k, _V + k] += 0.5 * accel * h * h
        p[_V + k, _P + k] += 0.5 * accel * h * h
        p[_V + k, _V + k] += accel * h
        p[_T + k, _T + k] += gyro * h
        p[_G + k, _G + k] += c[_C_GYRO_WALK_PSD] * h
        p[_A + k, _A + k] += c[_C_ACCEL_WALK_PSD] * h


@njit(cache=True, inline="always")
def _gauss_markov(cov: Array, p: Array, h: float, tau: Array, psd: Array) -> None:
    """c1 = exp(-h/tau) c + n, Q = q tau/2 (1 - exp(-2 h/tau)); Q = q h for infinite tau.

    cov (n, n): covariance behind the 15; p (15, >= n): cross-covariances in the same columns.
    """
    n, last, stays = cov.shape[0], 0.0, 1.0
    for k in range(tau.shape[0]):
        i = _N + k
        if tau[k] == math.inf:
            cov[i, i] += psd[k] * h
            continue
        if tau[k] != last:  # most are of the same kind
            last, stays = tau[k], math.exp(-h / tau[k])
        for j in range(_N):
            p[j, i] *= stays
        for j in range(_N, n):
            cov[i, j] *= stays
            cov[j, i] *= stays
        cov[i, i] += 0.5 * psd[k] * tau[k] * (1.0 - stays * stays)


@njit(cache=True, error_model="numpy")
def _coast(x: Array, h: float, age: float, w: Array, c: Array, r: Array, phi: Array) -> None:
    """One nominal step without IMU: the last rate decays, v turns with the attitude.

    psi = integral of w_n,z;  v1 = Rz(psi) v,  p1 = p + h v,  R1 = R exp(alpha)      (coordinated turn; Bar-Shalom 2001, 11.7)
    Error transition of constant velocity: theta and dv do not mix.
    """
    decay = c[_C_TURN_DECAY_S]
    gain = decay * (math.exp(-age / decay) - math.exp(-(age + h) / decay))
    phi[:] = 0.0
    q, r0, r1 = x[_XQ:_XG], r[0], r[2]
    _matrix_into(q, r0)
    ax, ay, az = gain * (w[0] - x[_XG]), gain * (w[1] - x[_XG + 1]), gain * (w[2] - x[_XG + 2])
    psi = r0[2, 0] * ax + r0[2, 1] * ay + r0[2, 2] * az
    for i in range(3):
        x[_XP + i] += h * x[_XV + i]
    cos, sin = math.cos(psi), math.sin(psi)
    x[_XV], x[_XV + 1] = cos * x[_XV] - sin * x[_XV + 1], sin * x[_XV] + cos * x[_XV + 1]
    angle = math.sqrt(ax * ax + ay * ay + az * az)
    s = 0.5 if angle < 1e-8 else math.sin(0.5 * angle) / angle
    _turn(q, math.cos(0.5 * angle), s * ax, s * ay, s * az)
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for k in range(4):
        q[k] /= norm
    _matrix_into(q, r1)
    for i in range(3 if phi.shape[0] > 0 else 0):
        phi[_P + i, _P + i], phi[_P + i, _V + i], phi[_V + i, _V + i] = 1.0, h, 1.0
        for j in range(3):
            phi[_T + i, _T + j] = r1[0, i] * r0[0, j] + r1[1, i] * r0[1, j] + r1[2, i] * r0[2, j]


@njit(cache=True, inline="always")
def _step(
    x: Array, t_ns: NDArray[np.int64], u: Array, count: int, i: int, from_ns: int, to_ns: int, c: Array,
    rotations: Array, ends: Array, n: Array, phi: Array,
) -> bool:  # fmt: skip
    """The nominal state from `from_ns` to `to_ns`, within sample i's interval; True if it coasted.

    Fills phi (9, 15). Scratch: rotations (3, 3, 3), ends (4, 3).
    """
    h = (to_ns - from_ns) * _NS
    if i <= 0:
        for k in range(3):
            ends[0, k] = 0.0
        _coast(x, h, 1e9, ends[0], c, rotations, phi)
        return True
    if i >= count or (t_ns[i] - t_ns[i - 1]) * _NS > c[_C_GAP_S]:
        _coast(x, h, (from_ns - t_ns[i - 1]) * _NS, u[i - 1], c, rotations, phi)
        return True
    span = (t_ns[i] - t_ns[i - 1]) * _NS
    s0 = (from_ns - t_ns[i - 1]) * _NS / span
    s1 = (to_ns - t_ns[i - 1]) * _NS / span
    for k in range(3):
        w, f = u[i, k] - u[i - 1, k], u[i, 3 + k] - u[i - 1, 3 + k]
        ends[0, k], ends[1, k] = u[i - 1, k] + s0 * w, u[i - 1, k] + s1 * w
        ends[2, k], ends[3, k] = u[i - 1, 3 + k] + s0 * f, u[i - 1, 3 + k] + s1 * f
    _strapdown(x, h, ends, c, rotations, n, phi)
    return False


@njit(cache=True, error_model="numpy")
def _of_state(cov: Array) -> Array:
    """First 15 rows of P (n, n), zero columns appended to fill vector registers."""
    n = cov.shape[0]
    p = np.zeros((_N, -(-n // _LANES) * _LANES))
    for i in range(_N):
        for j in range(n):
            p[i, j] = cov[i, j]
    return p


@njit(cache=True, error_model="numpy")
def _into(cov: Array, p: Array) -> None:
    """Rows and columns of the 15 in P (n, n) from p (15, >= n)."""
    for i in range(_N):
        for j in range(cov.shape[0]):
            cov[i, j] = p[i, j]
            cov[j, i] = p[i, j]


def propagate(
    x: Array, cov: Array, t_ns: NDArray[np.int64], u: Array, known: Array, count: int, i: int, from_ns: int, to_ns: int,
    c: Array, tau: Array, psd: Array, whole: Array = NOTHING,
) -> bool:  # fmt: skip
    """State and covariance from `from_ns` to `to_ns`, in place; False where unsound (state.sound).

    x: (16,); cov: (n, n), n = 15 + slow errors; t_ns (>= count,), u (>= count, 6): samples, gyro then accel; known (>= count,
    sampling.SIZE): sampling.learn, or zero; i: first sample with t_ns[i] > from_ns; c: constants(); tau, psd: (n - 15,), s and
    variance per s; whole: (15, 15) <- Phi whole, or empty. Samples are interpolated; beyond the gap the state coasts. A stop at
    a sample's time changes no bit; one between splits the interval.
    """
    return bool(advance(x, cov, whole, t_ns, u, known, count, i, from_ns, to_ns, c, tau, psd))


def transition(x: Array, t_ns: NDArray[np.int64], u: Array, count: int, i: int, from_ns: int, to_ns: int, c: Array) -> Array:
    """Phi (15, 15) from `from_ns` to `to_ns` along the motion from x (unchanged)."""
    whole: Array = np.eye(_N)
    advance(x.copy(), NOTHING, whole, t_ns, u, NOTHING, count, i, from_ns, to_ns, c, _NONE, _NONE)
    return whole


@njit(cache=True, error_model="numpy")
def advance(
    x: Array, cov: Array, whole: Array, t_ns: NDArray[np.int64], u: Array, known: Array, count: int, i: int, from_ns: int,
    to_ns: int, c: Array, tau: Array, psd: Array,
) -> bool:  # fmt: skip
    """propagate, and whole (15, 15) <- Phi whole; either of cov and whole may be empty: one kernel."""
    n = cov.shape[0]
    p = _of_state(cov)
    rows = np.empty((_G, max(p.shape[1], _N)))
    rotations, ends, forces = np.empty((3, 3, 3)), np.empty((4, 3)), np.empty((3, 3))
    phi = np.zeros((_G if n > 0 or whole.shape[0] > 0 else 0, _N))
    while from_ns < to_ns:
        end = t_ns[i] if i < count and t_ns[i] < to_ns else to_ns
        h = (end - from_ns) * _NS
        coasting = _step(x, t_ns, u, count, i, from_ns, end, c, rotations, ends, forces, phi)
        if whole.shape[0] > 0:
            _transition_rows(phi, whole, rows)
            for k in range(_G):
                for j in range(_N):
                    whole[k, j] = rows[k, j]
        if n > 0:
            _covariance(p, phi, rows)
            _add_noise(p, x, h, i, coasting, t_ns, u, known, c)
        if n > _N:
            _gauss_markov(cov, p, h, tau, psd)
        from_ns = end
        if i < count and end == t_ns[i]:
            i += 1
    _into(cov, p)
    return sound(x, cov)


def interpolate(t_ns: NDArray[np.int64], u: Array, count: int, i: int, at_ns: int) -> Array:
    """IMU sample (6,) at `at_ns`, linear between i-1 and i (first with t_ns[i] > at_ns)."""
    before, after = max(i - 1, 0), min(i, count - 1)
    share = 0.0 if before == after else (at_ns - int(t_ns[before])) / int(t_ns[after] - t_ns[before])
    between: Array = u[before] + share * (u[after] - u[before])
    return between


def moved(x: Array, t_ns: NDArray[np.int64], u: Array, count: int, i: int, from_ns: int, to_ns: int, c: Array) -> Array:
    """The nominal state (16,) at `to_ns`, from x at `from_ns`, which is not changed: propagate without a covariance."""
    after = x.copy()
    advance(after, NOTHING, NOTHING, t_ns, u, NOTHING, count, i, from_ns, to_ns, c, _NONE, _NONE)
    return after
