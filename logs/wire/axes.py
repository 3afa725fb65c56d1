"""Axes at the wire: map ENU <-> n NED, base_link FLU <-> body FRD, self-inverse permutations.

Covariances are permuted: NaN keeps its element.
"""

import math
from typing import Final, Literal

import msgspec
import numpy as np

from models import so3
from models.frames import ENU_FROM_NED, FLU_FROM_FRD
from models.messages import Array, Quat, Vec3

_ORDER: Final = np.argmax(np.abs(ENU_FROM_NED), axis=1)
_SIGN: Final = ENU_FROM_NED[np.arange(3), _ORDER]
_ORDER6: Final = np.concatenate([_ORDER, _ORDER + 3])
_SIGN6: Final = np.concatenate([_SIGN, _SIGN])
_BODY_SIGN6: Final = np.concatenate([np.diag(FLU_FROM_FRD), np.diag(FLU_FROM_FRD)])


def world(v: Vec3) -> Vec3:
    """ENU <-> NED: (x, y, z) -> (y, x, -z)."""
    return v[1], v[0], -v[2]


def body(v: Vec3) -> Vec3:
    """FLU <-> FRD: (x, y, z) -> (x, -y, -z)."""
    return v[0], -v[1], -v[2]


def attitude(q_wxyz: Quat) -> Quat:
    """q_nb <-> base_link in map: q' = q(ENU <- NED) q q(FRD <- FLU), up to sign; norm kept."""
    w, x, y, z = q_wxyz
    s = math.sqrt(0.5)
    return s * (w + z), s * (x + y), s * (x - y), s * (w - z)


def world_covariance(p: Array) -> Array:
    """ENU <-> NED of a covariance (3, 3), or (6, 6) of position and rotation."""
    order, sign = (_ORDER, _SIGN) if len(p) == 3 else (_ORDER6, _SIGN6)
    permuted: Array = p[np.ix_(order, order)] * np.outer(sign, sign)
    return permuted


def world_rows(j: Array) -> Array:
    """ENU <-> NED of rows x y z rx ry rz of (..., 6, k)."""
    permuted: Array = j[..., _ORDER6, :] * _SIGN6[:, None]
    return permuted


def world_columns(d: Array) -> Array:
    """ENU <-> NED of columns x y z rx ry rz of (k, 6)."""
    permuted: Array = d[:, _ORDER6] * _SIGN6
    return permuted


def body_attitude(q_wxyz: Quat) -> Quat:
    """FLU <-> FRD of a rotation between two bodies: half a turn about x on both sides."""
    w, x, y, z = q_wxyz
    return w, x, -y, -z


def body_rows(j: Array) -> Array:
    """FLU <-> FRD of rows of a (6, k) position and rotation Jacobian."""
    return np.asarray(_BODY_SIGN6[:, None] * j, dtype=np.float64)


def body_covariance(p: Array) -> Array:
    """FLU <-> FRD of a velocity and rate covariance (6, 6), or one (3, 3)."""
    sign = _BODY_SIGN6[: len(p)]
    turned: Array = p * np.outer(sign, sign)
    return turned


class ImuMounting(msgspec.Struct, frozen=True):
    """IMU in the body: x_b = Rz(yaw) Ry(pitch) Rx(roll) x_imu, FRD; others: by topic."""

    axes: Literal["flu", "frd"] = "flu"
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    others: dict[str, Vec3] = {}

    def of(self, topic: str) -> "ImuMounting":
        """Mounting of one IMU."""
        other = self.others.get(topic)
        return self if other is None else ImuMounting(self.axes, *other)

    def matrix(self) -> Array:
        """R (3, 3): x_b (FRD) = R x (driver)."""
        R_bi = so3.matrix(so3.from_euler(*np.deg2rad([self.roll_deg, self.pitch_deg, self.yaw_deg])))
        return R_bi @ FLU_FROM_FRD if self.axes == "flu" else R_bi

    @property
    def is_turned(self) -> bool:
        """Whether more than the naming of the axes separates IMU and body."""
        return (self.roll_deg, self.pitch_deg, self.yaw_deg) != (0.0, 0.0, 0.0)
