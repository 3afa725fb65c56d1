"""Messages at IMU rate packed by hand: Imu in, Odometry out.

CDR (XCDR1, little endian): 4 bytes of encapsulation, stamp (int32 s, uint32 ns), frame_id (uint32 length with closing zero,
characters), doubles aligned to 8 bytes from behind the encapsulation.
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
_N_TO_M, _B_TO_M, _N_TO_F, _TURN_TO_F, _BIAS_TO_F = range(5)
_BLOCKS: Final = (  # of pose (from 7 on) and twist (from 49 on): row, column, which matrix A, where in P, which B, of A P B^T
    (7, 0, 0, _N_TO_M, _P, _P, _N_TO_M),
    (7, 0, 3, _N_TO_M, _P, _TH, _B_TO_M),
    (7, 3, 3, _B_TO_M, _TH, _TH, _B_TO_M),
    (49, 0, 0, _N_TO_F, _V, _V, _N_TO_F),
    (49, 0, 0, _N_TO_F, _V, _TH, _TURN_TO_F),
    (49, 0, 0, _TURN_TO_F, _TH, _V, _N_TO_F),
    (49, 0, 0, _TURN_TO_F, _TH, _TH, _TURN_TO_F),
    (49, 0, 3, _N_TO_F, _V, _BG, _BIAS_TO_F),
    (49, 0, 3, _TURN_TO_F, _TH, _BG, _BIAS_TO_F),
    (49, 3, 3, _BIAS_TO_F, _BG, _BG, _BIAS_TO_F),
)


def imu(data: bytes) -> tuple[int, Vec3, Vec3] | None:
    """(t_ns, angular velocity, linear acceleration) of a sensor_msgs/msg/Imu, own axes.

    None for another layout: the general decoder decides.
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
    """nav_msgs/msg/Odometry, map to base_link; values (85,): p xyz, q xyzw, covariance 36, v, w, covariance 36."""
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return _ODOMETRY_HEAD.pack(b"\0\1\0\0", sec, nanosec, 4, b"map\0", 10, b"base_link\0") + values.tobytes()


@njit(cache=True, error_model="numpy")
def odometry_values(nav: Array, covariance: Array, gx: float, gy: float, gz: float) -> Array:
    """The 85 doubles of an Odometry from the packed state, its covariance and the angular rate in FRD, rad/s.

        pose error in map        dp_m = T dp_n,        dtheta_m = T R_nb theta                         T: NED -> ENU
        twist error in base_link dv_f = F (R_nb^T dv_n + [v_b]x theta),  dw_f = -F db_g                F: FRD -> FLU

    theta: local attitude error, R_true = R_nb exp(theta), so v_b,true = exp(-theta) R_nb^T v_n,true (Sola 2017, table 4). The
    rate's covariance is that of the bias, without gyro noise.
    """
    out = np.zeros(_ODOMETRY_SIZE)
    q = nav[_XQ : _XQ + 4]
    R_nb, by = so3.matrix(q), np.zeros((5, 3, 3))
    v_b = np.zeros(3)
    for i in range(3):
        for k in range(3):
            out[i] += ENU_FROM_NED[i, k] * nav[_XP + k]
            v_b[i] += R_nb[k, i] * nav[_XV + k]
    across = so3.skew(v_b)
    for i in range(3):
        for j in range(3):
            by[_N_TO_M, i, j], by[_BIAS_TO_F, i, j] = ENU_FROM_NED[i, j], -FLU_FROM_FRD[i, j]
            for k in range(3):
                by[_B_TO_M, i, j] += ENU_FROM_NED[i, k] * R_nb[k, j]
                by[_N_TO_F, i, j] += FLU_FROM_FRD[i, k] * R_nb[j, k]
                by[_TURN_TO_F, i, j] += FLU_FROM_FRD[i, k] * across[k, j]
    s = np.sqrt(0.5)  # the quaternion, as logs.wire.axes.attitude turns it
    out[3], out[4] = s * (q[1] + q[2]), s * (q[1] - q[2])
    out[5], out[6] = s * (q[0] - q[3]), s * (q[0] + q[3])
    out[43], out[44], out[45] = v_b[0], -v_b[1], -v_b[2]
    out[46], out[47], out[48] = gx, -gy, -gz

    for n in range(len(_BLOCKS)):
        at, row, column, left, i0, j0, right = _BLOCKS[n]
        _add(out[at : at + 36].reshape(6, 6), row, column, by[left], covariance, i0, j0, by[right])
    for at in (7, 49):  # the lower triangle becomes the upper one: symmetric to the bit
        for i in range(6):
            for j in range(i):
                out[at + 6 * i + j] = out[at + 6 * j + i]
    return out


@njit(cache=True, error_model="numpy")
def _add(out: Array, row: int, column: int, a: Array, p: Array, i0: int, j0: int, b: Array) -> None:
    """out[row.., column..] += a P[i0.., j0..] b^T with (3, 3) blocks."""
    for i in range(3):
        for m in range(3):
            ap = a[i, 0] * p[i0, j0 + m] + a[i, 1] * p[i0 + 1, j0 + m] + a[i, 2] * p[i0 + 2, j0 + m]
            for j in range(3):
                out[row + i, column + j] += ap * b[j, m]
