"""Relative pose against a kept pose (stochastic clone).

    z_p = R_0^T (p_1 - p_0) + v_p,   z_R = R_0^T R_1 exp(v_theta),   v ~ N(0, R)

The kept pose's error (dp_0, theta_0), R_0 = R_0,hat exp(theta_0), stands behind the state: the increment constrains the
difference only. (Roumeliotis and Burdick 2002.)
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.messages import Array
from models.state import E, X

_P, _T, _N = E.P.start, E.THETA.start, E.SIZE  # compiled code reads plain integers
_XP, _XQ, _XG = X.P.start, X.Q.start, X.BG.start
_HERE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
POSE_ERROR = np.r_[E.P, E.THETA]  # of the error state, what a clone of the pose has


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """An increment (dp_b, dq); noise (m, m); rows (m,): given of (dp_b, theta); origin: kept p_n, q_nb (7,)."""

    dp_b: Array
    dq_wxyz: Array
    noise: Array
    rows: NDArray[np.intp]
    origin: Array | None = None

    def since(self, origin: Array) -> "RelativePose":
        """Seen from this pose (7,)."""
        return replace(self, origin=origin)

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """See models.measurements.Measurement; the error of the kept pose is none of these states."""
        nu, h, _ = _relative(x, _HERE if self.origin is None else self.origin, self.dp_b, self.dq_wxyz)
        return (nu, h) if len(self.rows) == len(nu) else (nu[self.rows], h[self.rows])

    def by_origin(self, x: Array) -> Array:
        """Derivative of the increment by the kept pose's error (dp_0, theta_0) at x, (6, 6)."""
        _, _, by_origin = _relative(x, _HERE if self.origin is None else self.origin, self.dp_b, self.dq_wxyz)
        return by_origin


def pose_of(x: Array) -> Array:
    """p_n and q_nb of a packed state, (7,)."""
    return np.concatenate((x[X.P], x[X.Q]))


@njit(cache=True, error_model="numpy")
def between(origin: Array, pose: Array) -> Array:
    """(dp_b, dq) between poses (7,) of one frame, (7,): R_0^T (p_1 - p_0), R_0^T R_1."""
    out, back = np.empty(7), so3.conjugate(origin[3:])
    dp = so3.applied(so3.matrix(back), pose[:3] - origin[:3])
    turn = so3.normalise(so3.multiply(back, pose[3:]))
    for i in range(3):
        out[i] = dp[i]
    for i in range(4):
        out[3 + i] = turn[i]
    return out


@njit(cache=True, error_model="numpy")
def moved(pose: Array, error: Array) -> tuple[Array, Array]:
    """A kept pose (7,) corrected by its error (6,), p + dp, R exp(theta), and I - [theta/2]x of theta."""
    out, g = np.empty(7), so3.skew(error[3:])
    q = so3.normalise(so3.multiply(pose[3:], so3.quat_exp(error[3:])))
    for i in range(3):
        out[i] = pose[i] + error[i]
        for j in range(3):
            g[i, j] = (1.0 if i == j else 0.0) - 0.5 * g[i, j]
    for i in range(4):
        out[3 + i] = q[i]
    return out, g


@njit(cache=True, error_model="numpy")
def _relative(x: Array, origin: Array, dp: Array, dq: Array) -> tuple[Array, Array, Array]:
    """nu (6,), H (6, 15) and H_0 (6, 6).

    d = R_0^T (p - p_0):           nu_p = dp - d,         H_p = R_0^T,                 H_p0 = -R_0^T,  H_theta0 = [d]x
    D = R_0^T R, n = log(D^T dR):  nu_theta = n,          H_theta = J_l^-1(n),         H_theta0 = -J_l^-1(n) D^T
    """
    r0, back = so3.matrix(origin[3:]), so3.conjugate(origin[3:])
    turn = so3.multiply(back, x[_XQ:_XG])
    d = so3.applied(so3.matrix(back), x[_XP : _XP + 3] - origin[:3])
    n = so3.quat_log(so3.multiply(so3.conjugate(turn), dq))
    by_turn = so3.right_jacobian_inverse(-n)  # J_l^-1(n)
    by_turn_0, across = so3.product(by_turn, so3.matrix(so3.conjugate(turn))), so3.skew(d)
    nu, h, h0 = np.empty(6), np.zeros((6, _N)), np.zeros((6, 6))
    for i in range(3):
        nu[i], nu[3 + i] = dp[i] - d[i], n[i]
        for j in range(3):
            h[i, _P + j], h0[i, j] = r0[j, i], -r0[j, i]
            h0[i, 3 + j] = across[i, j]
            h[3 + i, _T + j], h0[3 + i, 3 + j] = by_turn[i, j], -by_turn_0[i, j]
    return nu, h, h0
