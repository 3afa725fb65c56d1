"""The two messages that come and go at IMU rate, packed by hand: Imu in, Odometry out. All others go through rosbags.

CDR (XCDR1, little endian) of both: 4 bytes of encapsulation, stamp (int32 s, uint32 ns), frame_id (uint32 length with the
closing zero, characters), then doubles, aligned to 8 bytes counted from behind the encapsulation.
"""

import struct
from typing import Final

import numpy as np
from numba import njit

from models import so3
from models.frames import ENU_FROM_NED, FLU_FROM_FRD
from models.messages import Array, Vec3
from models.state import E, X

_LITTLE_ENDIAN: Final = b"\x00\x01"
_IMU_HEAD: Final = struct.Struct("<2s2xiII")  # encapsulation, sec, nanosec, length of frame_id
_IMU_BYTES: Final = 37 * 8  # orientation 4 + 9, angular velocity 3 + 9, linear acceleration 3 + 9
_IMU_RATES: Final = struct.Struct("<104x3d72x3d")  # angular velocity, linear acceleration

_ODOMETRY_HEAD: Final = struct.Struct("<4siII4sI10s2x")  # encapsulation, sec, nanosec, "map\0", "base_link\0"
_ODOMETRY_SIZE: Final = 85  # doubles: pose 7 + 36, twist 6 + 36

_P, _V, _TH, _BG = E.P.start, E.V.start, E.THETA.start, E.BG.start
_XP, _XV, _XQ = X.P.start, X.V.start, X.Q.start


def imu(data: bytes) -> tuple[int, Vec3, Vec3] | None:
    """(t_ns, angular velocity, linear acceleration) of a sensor_msgs/msg/Imu in its own axes.

    None where the bytes are not laid out exactly as expected; the general decoder then says what is wrong, if anything.
    """
    if len(data) < _IMU_HEAD.size:
        return None
    encapsulation, sec, nanosec, length = _IMU_HEAD.unpack_from(data)
    start = 4 + ((12 + length + 7) & -8)
    if encapsulation != _LITTLE_ENDIAN or nanosec >= 1_000_000_000 or len(data) != start + _IMU_BYTES:
        return None
    gx, gy, gz, ax, ay, az = _IMU_RATES.unpack_from(data, start)
    return sec * 1_000_000_000 + nanosec, (gx, gy, gz), (ax, ay, az)


def odometry(t_ns: int, values: Array) -> bytes:
    """A nav_msgs/msg/Odometry from map to base_link; values (85,): p xyz, q xyzw, covariance 36, v, w, covariance 36."""
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return _ODOMETRY_HEAD.pack(b"\0\1\0\0", sec, nanosec, 4, b"map\0", 10, b"base_link\0") + values.tobytes()


@njit(cache=True)
def odometry_values(nav: Array, covariance: Array, gx: float, gy: float, gz: float) -> Array:
    """The 85 doubles of an Odometry from the packed state, its covariance and the angular rate in FRD, rad/s.

        pose error in map        dp_m = T dp_n,        dtheta_m = T R_nb theta                         T: NED -> ENU
        twist error in base_link dv_f = F (R_nb^T dv_n + [v_b]x theta),  dw_f = -F db_g                F: FRD -> FLU

    theta: local attitude error, R_true = R_nb exp(theta), so v_b,true = exp(-theta) R_nb^T v_n,true (Sola 2017, table 4).
    The gyro's own noise is not part of the angular rate's covariance: only the bias is estimated.
    """
    out = np.zeros(_ODOMETRY_SIZE)
    q = nav[_XQ : _XQ + 4]
    R_nb = so3.matrix(q)
    rotate_b_to_m = _product(ENU_FROM_NED, R_nb)
    rotate_n_to_f = _product(FLU_FROM_FRD, R_nb.T)
    v_b = np.zeros(3)
    for i in range(3):
        for k in range(3):
            out[i] += ENU_FROM_NED[i, k] * nav[_XP + k]
            v_b[i] += R_nb[k, i] * nav[_XV + k]
    s = np.sqrt(0.5)  # the quaternion, as logs.axes.attitude turns it
    out[3], out[4] = s * (q[1] + q[2]), s * (q[1] - q[2])
    out[5], out[6] = s * (q[0] - q[3]), s * (q[0] + q[3])
    out[43], out[44], out[45] = v_b[0], -v_b[1], -v_b[2]
    out[46], out[47], out[48] = gx, -gy, -gz

    pose = out[7:43].reshape(6, 6)
    _add(pose, 0, 0, ENU_FROM_NED, covariance, _P, _P, ENU_FROM_NED)
    _add(pose, 0, 3, ENU_FROM_NED, covariance, _P, _TH, rotate_b_to_m)
    _add(pose, 3, 3, rotate_b_to_m, covariance, _TH, _TH, rotate_b_to_m)
    _mirror(pose)

    twist = out[49:85].reshape(6, 6)
    attitude_to_f = _product(FLU_FROM_FRD, so3.skew(v_b))
    bias_to_f = -FLU_FROM_FRD
    _add(twist, 0, 0, rotate_n_to_f, covariance, _V, _V, rotate_n_to_f)
    _add(twist, 0, 0, rotate_n_to_f, covariance, _V, _TH, attitude_to_f)
    _add(twist, 0, 0, attitude_to_f, covariance, _TH, _V, rotate_n_to_f)
    _add(twist, 0, 0, attitude_to_f, covariance, _TH, _TH, attitude_to_f)
    _add(twist, 0, 3, rotate_n_to_f, covariance, _V, _BG, bias_to_f)
    _add(twist, 0, 3, attitude_to_f, covariance, _TH, _BG, bias_to_f)
    _add(twist, 3, 3, bias_to_f, covariance, _BG, _BG, bias_to_f)
    _mirror(twist)
    return out


@njit(cache=True)
def _product(a: Array, b: Array) -> Array:
    """a b of two (3, 3); written out, for BLAS costs more than the product."""
    c = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                c[i, j] += a[i, k] * b[k, j]
    return c


@njit(cache=True)
def _add(out: Array, row: int, column: int, a: Array, p: Array, i0: int, j0: int, b: Array) -> None:
    """out[row.., column..] += a P[i0.., j0..] b^T with (3, 3) blocks."""
    for i in range(3):
        for m in range(3):
            ap = a[i, 0] * p[i0, j0 + m] + a[i, 1] * p[i0 + 1, j0 + m] + a[i, 2] * p[i0 + 2, j0 + m]
            for j in range(3):
                out[row + i, column + j] += ap * b[j, m]


@njit(cache=True)
def _mirror(p: Array) -> None:
    """The lower triangle becomes the upper one: symmetric to the bit."""
    for i in range(6):
        for j in range(i):
            p[i, j] = p[j, i]
