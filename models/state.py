"""Indices of the packed nominal state (X) and the error state (E).

    x = (p_n, v_n, q_nb, b_g, b_a)                   16 numbers
    dx = (dp_n, dv_n, theta, db_g, db_a)             15 numbers
    p = p_hat + dp, v = v_hat + dv, R_nb = R_hat exp(theta), b = b_hat + db        (Sola 2017, table 4, local error)

No other file writes an index of the state.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numba import njit

from models import so3
from models.messages import Array

XYZ = 3  # components of a vector


class X:
    """Packed: position n [m], velocity n [m/s], quaternion wxyz, gyro bias [rad/s], accel bias [m/s^2]."""

    P = slice(0, 3)
    V = slice(3, 6)
    Q = slice(6, 10)
    BG = slice(10, 13)
    BA = slice(13, 16)
    SIZE = 16


class E:
    """Error state: position n, velocity n, attitude (about body axes), gyro bias, accel bias."""

    P = slice(0, 3)
    V = slice(3, 6)
    THETA = slice(6, 9)
    BG = slice(9, 12)
    BA = slice(12, 15)
    SIZE = 15
    NAMES = ("pn", "pe", "pd", "vn", "ve", "vd", "thx", "thy", "thz", "bgx", "bgy", "bgz", "bax", "bay", "baz")


@dataclass(frozen=True, slots=True)
class NavState:
    """The nominal state as a record; x_n = R_nb @ x_b."""

    p_n: Array
    v_n: Array
    q_nb_wxyz: Array
    gyro_bias: Array
    accel_bias: Array

    @classmethod
    def unpack(cls, x: Array) -> Self:
        """From the packed (16,) array; the parts are copies."""
        return cls(x[X.P].copy(), x[X.V].copy(), x[X.Q].copy(), x[X.BG].copy(), x[X.BA].copy())

    def pack(self) -> Array:
        """To the packed (16,) array."""
        x = np.empty(X.SIZE)
        x[X.P], x[X.V], x[X.Q], x[X.BG], x[X.BA] = self.p_n, self.v_n, self.q_nb_wxyz, self.gyro_bias, self.accel_bias
        return x

    @property
    def R_nb(self) -> Array:
        """Rotation matrix body -> n, (3, 3)."""
        return so3.matrix(self.q_nb_wxyz)


# Compiled code reads plain integers: before and behind the attitude, the errors add up.
_XQ, _XG, _SIZE, _T, _G, _N = X.Q.start, X.BG.start, X.SIZE, E.THETA.start, E.BG.start, E.SIZE


@njit(cache=True, error_model="numpy")
def retract(x: Array, dx: Array) -> Array:
    """x (+) dx: packed state (16,) moved by the error (15,)."""
    y = np.empty(_SIZE)
    q = so3.normalise(so3.multiply(x[_XQ:_XG], so3.quat_exp(dx[_T:_G])))
    for k in range(_XQ):
        y[k] = x[k] + dx[k]
    for k in range(4):
        y[_XQ + k] = q[k]
    for k in range(_SIZE - _XG):
        y[_XG + k] = x[_XG + k] + dx[_G + k]
    return y


@njit(cache=True, error_model="numpy")
def local(x: Array, y: Array) -> Array:
    """dx with x (+) dx = y."""
    dx = np.empty(_N)
    turn = so3.quat_log(so3.multiply(so3.conjugate(x[_XQ:_XG]), y[_XQ:_XG]))
    for k in range(_XQ):
        dx[k] = y[k] - x[k]
    for k in range(3):
        dx[_T + k] = turn[k]
    for k in range(_SIZE - _XG):
        dx[_G + k] = y[_XG + k] - x[_XG + k]
    return dx


@njit(cache=True, error_model="numpy")
def has_moved(x: Array, y: Array, cov: Array, sigmas: float) -> bool:
    """Whether dx with x (+) dx = y moves more than `sigmas` of P (n, n); biases do not count."""
    dx, moved = local(x, y), False
    for i in range(_G):
        moved = moved or abs(dx[i]) > sigmas * math.sqrt(cov[i, i])
    return moved


def carried(cov: Array, jacobian: Array) -> Array:
    """J P J^T about another attitude; jacobian (3, 3): of one attitude error by the other."""
    out = cov.copy()
    out[E.THETA, :] = jacobian @ out[E.THETA, :]
    out[:, E.THETA] = out[:, E.THETA] @ jacobian.T
    return out


@njit(cache=True, error_model="numpy")
def sound(x: Array, cov: Array) -> bool:
    """Publishable: finite, variances positive (considered: >= 0).

    Only the diagonal is checked: it is cheap, and errors elsewhere reach the next state.
    """
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i]
    for i in range(cov.shape[0]):
        if not (cov[i, i] > 0.0 or (i >= _N and cov[i, i] == 0.0)):
            return False
        total += cov[i, i]
    return math.isfinite(total)
