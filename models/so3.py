"""Unit quaternions (Hamilton, wxyz) and rotation vectors, compiled.

    exp: R^3 -> S^3, q = (cos |r|/2, r/|r| sin |r|/2);   R(q) x = q x q*        (Sola 2017, eq. 101, 115, 117)

float64, C-contiguous; a new array is returned; nothing is checked.
"""

import math

import numpy as np
from numba import njit

from models.messages import Array

_SMALL = 1e-8  # rad; below it the series' first term is exact to float64


@njit(cache=True, error_model="numpy")
def normalise(q: Array) -> Array:
    """q / |q|."""
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    r = np.empty(4)
    for k in range(4):
        r[k] = q[k] / norm
    return r


@njit(cache=True, error_model="numpy")
def multiply(p: Array, q: Array) -> Array:
    """Hamilton product p q."""
    r = np.empty(4)
    r[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    r[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    r[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    r[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]
    return r


@njit(cache=True, error_model="numpy")
def conjugate(q: Array) -> Array:
    """q*, the inverse of a unit quaternion."""
    r = np.empty(4)
    r[0], r[1], r[2], r[3] = q[0], -q[1], -q[2], -q[3]
    return r


@njit(cache=True, error_model="numpy")
def quat_exp(r: Array) -> Array:
    """Quaternion of the rotation vector r [rad]."""
    angle = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    scale = 0.5 if angle < _SMALL else math.sin(0.5 * angle) / angle
    q = np.empty(4)
    q[0] = math.cos(0.5 * angle)
    q[1], q[2], q[3] = scale * r[0], scale * r[1], scale * r[2]
    return q


@njit(cache=True, error_model="numpy")
def quat_log(q: Array) -> Array:
    """Rotation vector of q [rad], the shorter way round: |r| <= pi."""
    sign = -1.0 if q[0] < 0.0 else 1.0
    norm = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 2.0 * sign if norm < _SMALL else 2.0 * math.atan2(norm, sign * q[0]) / norm * sign
    r = np.empty(3)
    r[0], r[1], r[2] = scale * q[1], scale * q[2], scale * q[3]
    return r


@njit(cache=True, error_model="numpy")
def matrix(q: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    r = np.empty((3, 3))
    r[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    r[0, 1] = 2.0 * (x * y - w * z)
    r[0, 2] = 2.0 * (x * z + w * y)
    r[1, 0] = 2.0 * (x * y + w * z)
    r[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    r[1, 2] = 2.0 * (y * z - w * x)
    r[2, 0] = 2.0 * (x * z - w * y)
    r[2, 1] = 2.0 * (y * z + w * x)
    r[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return r


@njit(cache=True, error_model="numpy")
def from_matrix(m: Array) -> Array:
    """Quaternion of a matrix (3, 3), w >= 0 (Shepperd 1978: largest first)."""
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    q = np.empty(4)
    if trace > 0.0:
        s = 2.0 * math.sqrt(1.0 + trace)
        q[0] = 0.25 * s
        q[1], q[2], q[3] = (m[2, 1] - m[1, 2]) / s, (m[0, 2] - m[2, 0]) / s, (m[1, 0] - m[0, 1]) / s
    else:
        i = 0
        if m[1, 1] > m[0, 0]:
            i = 1
        if m[2, 2] > m[i, i]:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        s = 2.0 * math.sqrt(1.0 + m[i, i] - m[j, j] - m[k, k])
        q[0] = (m[k, j] - m[j, k]) / s
        q[1 + i] = 0.25 * s
        q[1 + j] = (m[j, i] + m[i, j]) / s
        q[1 + k] = (m[k, i] + m[i, k]) / s
    if q[0] < 0.0:
        for k in range(4):
            q[k] = -q[k]
    return q


@njit(cache=True, error_model="numpy")
def skew(v: Array) -> Array:
    """[v]x with [v]x w = v x w."""
    m = np.zeros((3, 3))
    m[0, 1], m[0, 2] = -v[2], v[1]
    m[1, 0], m[1, 2] = v[2], -v[0]
    m[2, 0], m[2, 1] = -v[1], v[0]
    return m


@njit(cache=True, error_model="numpy")
def product(a: Array, b: Array) -> Array:
    """a b of (3, 3) matrices, cheaper than BLAS."""
    c = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            c[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return c


@njit(cache=True, error_model="numpy")
def applied(a: Array, v: Array) -> Array:
    """a v, a (3, 3), v (3,)."""
    w = np.empty(3)
    for i in range(3):
        w[i] = a[i, 0] * v[0] + a[i, 1] * v[1] + a[i, 2] * v[2]
    return w


@njit(cache=True, error_model="numpy")
def right_jacobian_inverse(r: Array) -> Array:
    """J_r^-1(r): log(exp(r) exp(d)) = r + J_r^-1(r) d + O(d^2)   (Sola 2017, eq. 184)."""
    angle = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    w = skew(r)
    square = product(w, w)
    c = 0.0 if angle < 1e-5 else 1.0 / (angle * angle) - (1.0 + math.cos(angle)) / (2.0 * angle * math.sin(angle))
    for i in range(3):
        for j in range(3):
            w[i, j] = (1.0 if i == j else 0.0) + 0.5 * w[i, j] + c * square[i, j]
    return w


def from_euler(roll: float, pitch: float, yaw: float) -> Array:
    """q_nb of roll, pitch, yaw [rad]: R_nb = Rz(yaw) Ry(pitch) Rx(roll)."""
    qx = np.array([math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0])
    qy = np.array([math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0])
    qz = np.array([math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])
    return multiply(multiply(qz, qy), qx)


def to_euler(q: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of q_nb."""
    r = matrix(q)
    return math.atan2(r[2, 1], r[2, 2]), math.asin(max(-1.0, min(1.0, -r[2, 0]))), math.atan2(r[1, 0], r[0, 0])
