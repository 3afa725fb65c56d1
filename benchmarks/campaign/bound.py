"""The posterior Cramer-Rao bound of a flight along the *true* trajectory, independent of the filter's kernels, which it judges.

P_{k+1} = F_k P_k F_k^T + Q_k,      P <- (P^-1 + H^T R^-1 H)^-1 at a measurement           (Tichavsky 1998, eq. 21, 34)

dp' = dv                                       R theta: local attitude error, R_true = R_hat exp(theta)
dv' = -R [f]x theta - R db_a - 2 w_ie x dv + G dp - R n_a
theta' = -[omega]x theta - db_g - n_g,         db_g' = n_wg,   db_a' = n_wa
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.frames import Origin
from models.imu import ImuNoise
from models.messages import Array, GnssFix, GnssVelocity, Input, PoseFix
from models.sim.scenario import Truth
from models.state import E

_EARTH_RADIUS = 6_371_000.0  # m, mean

# Compiled code needs plain numbers, not attributes of a class.
_P, _V, _THETA, _BG, _BA, _SIZE = E.P.start, E.V.start, E.THETA.start, E.BG.start, E.BA.start, E.SIZE


@dataclass(frozen=True, slots=True)
class Linear:
    """z = h(x) + noise R (m, m), H (m, 15)."""

    t_ns: int
    H: Array
    R: Array


def linearise(message: Input, truth: Truth, antenna_b_m: Sequence[float] = (0.0, 0.0, 0.0)) -> Linear | None:
    """A message as a measurement at the true state; None if no aid.

    position of the antenna:  H = [I, 0, -R [l]x, 0, 0]           velocity:  H = [0, I, -R [omega x l]x, R [l]x, 0]
    pose fix:                 H = [I, 0, 0, 0, 0; 0, 0, R, 0, 0]     (attitude error about the axes of n)
    """
    k = int(np.clip(np.searchsorted(truth.t_ns, message.t_ns, side="right") - 1, 0, len(truth.t_ns) - 1))
    step = np.asarray(truth.omega_b[k] * ((message.t_ns - int(truth.t_ns[k])) * 1e-9))
    R_nb = truth.R_nb[k] @ so3.matrix(so3.quat_exp(step))
    lever_b = np.array(antenna_b_m, dtype=np.float64)
    H = np.zeros((6 if isinstance(message, PoseFix) else 3, E.SIZE))
    match message:
        case PoseFix(covariance=R):
            H[:3, E.P], H[3:, E.THETA] = np.eye(3), R_nb
            return Linear(message.t_ns, H, R)
        case GnssFix(covariance_n=R) if R is not None:
            H[:, E.P], H[:, E.THETA] = np.eye(3), -R_nb @ so3.skew(lever_b)
            return Linear(message.t_ns, H, R)
        case GnssVelocity(covariance_n=R) if R is not None:
            H[:, E.V], H[:, E.THETA] = np.eye(3), -R_nb @ so3.skew(np.cross(truth.omega_b[k], lever_b))
            H[:, E.BG] = R_nb @ so3.skew(lever_b)
            return Linear(message.t_ns, H, R)
    return None


def posterior_bound(
    truth: Truth, noise: ImuNoise, measurements: Sequence[Linear], P0: Array, at_ns: Sequence[int], origin: Origin | None
) -> Array:
    """The bound at at_ns (n, 15, 15) by measurements up to then; P0 (15, 15) at truth.t_ns[0].

    Raises ValueError for instants outside the truth.
    """
    first, last = int(truth.t_ns[0]), int(truth.t_ns[-1])
    if any(not first <= t <= last for t in at_ns):
        raise ValueError("the bound is requested outside the truth")
    used = sorted((m for m in measurements if first <= m.t_ns <= last), key=lambda m: m.t_ns)
    # One grid of all instants: IMU samples, measurements and questions; no step ever needs to be split.
    grid_ns = np.unique(np.concatenate([truth.t_ns, [m.t_ns for m in used], at_ns]).astype(np.int64))
    R_nb, gyro_b, accel_b = _on_grid(truth, grid_ns)
    Qc = np.diag(np.repeat(np.square([0.0, noise.accel_noise, noise.gyro_noise, noise.gyro_walk, noise.accel_walk]), 3))
    earth_rate, gradient = np.zeros(3), 0.0
    if origin is not None:
        earth_rate, gradient = origin.earth_rate_n, origin.gravity / _EARTH_RADIUS
    steps = (np.diff(grid_ns) * 1e-9, R_nb, gyro_b, accel_b, earth_rate, gradient, Qc)
    result = np.empty((len(at_ns), E.SIZE, E.SIZE))
    wanted = np.searchsorted(grid_ns, at_ns)
    stops = sorted({*np.searchsorted(grid_ns, [m.t_ns for m in used]).tolist(), *wanted.tolist()})
    P, now, pending = P0.copy(), 0, 0
    for stop in stops:
        P, now = _propagate(P, now, stop, *steps), stop
        while pending < len(used) and used[pending].t_ns <= grid_ns[stop]:
            P, pending = _inform(P, used[pending].H, used[pending].R), pending + 1
        result[wanted == stop] = P
    return result


def _on_grid(truth: Truth, grid_ns: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    k = np.searchsorted(truth.t_ns, grid_ns, side="right") - 1
    since_s = np.asarray((grid_ns - truth.t_ns[k]) * 1e-9)
    R_nb = truth.R_nb[k].copy()
    for i in np.flatnonzero(since_s):
        R_nb[i] = R_nb[i] @ so3.matrix(so3.quat_exp(truth.omega_b[k[i]] * since_s[i]))
    seconds, grid_s = (truth.t_ns - truth.t_ns[0]) * 1e-9, (grid_ns - truth.t_ns[0]) * 1e-9
    gyro_b, accel_b = (
        np.column_stack([np.interp(grid_s, seconds, axis) for axis in rate.T]) for rate in (truth.gyro_b, truth.accel_b)
    )
    return R_nb, gyro_b, accel_b


def _inform(P: Array, H: Array, R: Array) -> Array:
    """(P^-1 + H^T R^-1 H)^-1 without inverting P (matrix inversion lemma)."""
    PH = P @ H.T
    P = P - PH @ np.linalg.solve(H @ PH + R, PH.T)
    return np.asarray(0.5 * (P + P.T))


@njit(cache=True)
def _dynamics(R_nb: Array, gyro_b: Array, accel_b: Array, earth_rate: Array, gradient: float) -> Array:
    """A (15, 15) of dx' = A dx + noise; G = g/r diag(-1, -1, 2)."""
    A = np.zeros((_SIZE, _SIZE))
    coriolis = -2.0 * so3.skew(earth_rate)
    tilt = -R_nb @ so3.skew(accel_b)
    turn = -so3.skew(gyro_b)
    for i in range(3):
        A[_P + i, _V + i] = 1.0
        A[_V + i, _P + i] = -gradient if i < 2 else 2.0 * gradient
        A[_THETA + i, _BG + i] = -1.0
        for j in range(3):
            A[_V + i, _V + j] = coriolis[i, j]
            A[_V + i, _THETA + j] = tilt[i, j]
            A[_V + i, _BA + j] = -R_nb[i, j]
            A[_THETA + i, _THETA + j] = turn[i, j]
    return A


@njit(cache=True)
def _propagate(
    P: Array,
    first: int,
    last: int,
    dts: Array,
    R_nb: Array,
    gyro_b: Array,
    accel_b: Array,
    earth_rate: Array,
    gradient: float,
    Qc: Array,
) -> Array:
    """P from grid point first to last; F = exp(A dt) to second order, Q by trapezoids; isotropic noise."""
    for k in range(first, last):
        dt = dts[k]
        R_mid = 0.5 * (R_nb[k] + R_nb[k + 1])
        A = _dynamics(R_mid, 0.5 * (gyro_b[k] + gyro_b[k + 1]), 0.5 * (accel_b[k] + accel_b[k + 1]), earth_rate, gradient) * dt
        F = np.eye(_SIZE) + A + 0.5 * A @ A
        half = 0.5 * dt * Qc
        P = F @ (P + half) @ F.T + half
        P = 0.5 * (P + P.T)
    return P
