"""The delay tau of a source, a constant of it (score.py).

    z = h(x(t - tau)) + v = h(x(t)) + J tau + v,   J = - d h / d t
    position  J = -(v + R_nb (w x l))        velocity  J = -(R_nb f + g)        attitude  J = -R_nb w
    P <- P + E[tau^2] v v^T,   E[tau^2] = 1 / (A + s^-2) + (b / (A + s^-2))^2

s: configured sigma. A filter aligned with this source alone knows x(t - tau).
"""

import math

import numpy as np
from numba import njit

from estimator.filter.mismatch.score import Constant, Sums
from models import so3
from models.frames import GRAVITY, GRAVITY_N
from models.measurements import Measurement, PartialPose, Pose, Position, Velocity
from models.messages import Array
from models.state import XYZ, E, X

_LONGEST_S = 0.5  # no longer delay is found
_COUNTS_M2 = 1e-3  # less is not worth the time of an estimate
_AT_IMU = np.zeros(3)


def covariance(found: Sums, sigma_s: float, v_n: Array) -> Array | None:
    """E[tau^2] v v^T of the position, (3, 3), prior sigma_s; None where negligible."""
    if found.is_state or not sigma_s:
        return None
    information, score = max(found.evidence, found.before)
    information += sigma_s**-2
    variance = 1.0 / information + (score / information) ** 2
    if variance * math.hypot(*v_n.tolist()) ** 2 <= _COUNTS_M2:
        return None
    return variance * (v_n[:, None] * v_n)


def explains(off: Array, s: Array, x: Array) -> bool:
    """Whether a delay may explain a source's distance off (3,) [m] of covariance s (3, 3).

    |off| <= |v| tau_max + 3 sigma, sigma^2 = tr s.
    """
    return float(np.linalg.norm(off)) <= _LONGEST_S * float(np.linalg.norm(x[X.V])) + 3.0 * math.sqrt(float(s.trace()))


def jacobian(z: Measurement, x: Array, u: Array) -> Array | None:
    """J of all components of a measurement, (m,), 1/s; None for what has no delay here."""
    if isinstance(z, Pose | PartialPose):
        by_pose = _jacobian(x, u, _AT_IMU)[: 2 * XYZ]
        return np.asarray(z.directions @ by_pose) if isinstance(z, PartialPose) else by_pose
    if isinstance(z, Position):
        return _jacobian(x, u, z.lever_b)[:XYZ]
    return _jacobian(x, u, _AT_IMU)[2 * XYZ :] if isinstance(z, Velocity) else None


def _follows(x: Array, u: Array) -> Array:
    """dx / dt (15,), but for the biases."""
    moved, rotation = np.zeros(E.SIZE), so3.matrix(x[X.Q])
    moved[E.P], moved[E.V], moved[E.THETA] = x[X.V], rotation @ (u[XYZ:] - x[X.BA]) + GRAVITY_N, u[:XYZ] - x[X.BG]
    return moved


def _says(topic: str, late_s: float, sigma_s: float) -> str:
    side = "late" if late_s >= 0.0 else "early"
    return f"stamps of {topic} are {1e3 * abs(late_s):.0f} ms {side} (sigma {1e3 * sigma_s:.0f} ms), beyond the configured delay"


DELAY = Constant("delay", 0.1, 2e-3**2, 0.02, _LONGEST_S, jacobian, _follows, _says)  # s

_XV, _XQ, _XG, _XA = X.V.start, X.Q.start, X.BG.start, X.BA.start  # compiled code reads plain integers


@njit(cache=True, error_model="numpy")
def _jacobian(x: Array, u: Array, lever: Array) -> Array:
    """J (9,) of a position at lever_b, of the attitude and of the velocity."""
    rotation, rate, force, j = so3.matrix(x[_XQ:_XG]), np.empty(3), np.empty(3), np.empty(9)
    for i in range(3):
        rate[i], force[i] = u[i] - x[_XG + i], u[3 + i] - x[_XA + i]
    moved, turned, pushed = so3.applied(so3.skew(rate), lever), so3.applied(rotation, rate), so3.applied(rotation, force)
    moved = so3.applied(rotation, moved)
    for i in range(3):
        j[i], j[3 + i], j[6 + i] = -(x[_XV + i] + moved[i]), -turned[i], -pushed[i]
    j[8] -= GRAVITY
    return j
