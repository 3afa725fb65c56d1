"""First pass over a bag's sensor topics."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

from logs.store.reader import Record
from logs.wire import schemas
from logs.wire.schemas import STORE
from models.messages import Array

TWIST_STAMPED: Final = "geometry_msgs/msg/TwistStamped"
_MOST: Final = 3000  # messages of a topic that are looked at, evenly: of the first, every 2nd, 4th, ...


def _imu(m: Any) -> tuple[float, ...]:
    w, f = m.angular_velocity, m.linear_acceleration
    given = m.angular_velocity_covariance[0] != -1.0 and m.linear_acceleration_covariance[0] != -1.0  # -1: not given
    return (w.x, w.y, w.z, f.x, f.y, f.z) if given else (np.nan,) * 6


def _twist(m: Any) -> tuple[float, ...]:
    twist = m.twist.twist if hasattr(m.twist, "twist") else m.twist
    return twist.linear.x, twist.linear.y, twist.linear.z


def _field(m: Any) -> tuple[float, ...]:
    return m.magnetic_field.x, m.magnetic_field.y, m.magnetic_field.z


VALUES: Final[Mapping[str, Callable[[Any], tuple[float, ...]]]] = {  # what is looked at, by type
    schemas.IMU: _imu,
    schemas.NAV_SAT_FIX: lambda m: (float(m.status.status), m.latitude, m.longitude, m.altitude),
    schemas.TWIST: _twist,
    TWIST_STAMPED: _twist,
    schemas.PRESSURE: lambda m: (m.fluid_pressure,),
    schemas.MAGNETIC_FIELD: _field,
    schemas.RANGE: lambda m: (m.range,),
}
STAMPED: Final = frozenset({  # types that begin with a std_msgs/Header
    *VALUES, schemas.ODOMETRY, schemas.POSE_FIX, schemas.POSE, schemas.IMAGE, schemas.COMPRESSED_IMAGE, schemas.CAMERA_INFO,
})  # fmt: skip


@dataclass
class Survey:
    """One topic: t_ns: stamps, arrived_ns: recording times, values: rows of VALUES; every: thinning."""

    schema: str
    messages: int = 0
    every: int = 1
    first_ns: int = 0
    last_ns: int = 0
    t_ns: list[int] = field(default_factory=list)
    arrived_ns: list[int] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, record: Record) -> None:
        """The next message."""
        self.first_ns = self.first_ns if self.messages else record.log_time_ns
        self.last_ns = record.log_time_ns
        if self.messages % self.every == 0 and self.schema in STAMPED and len(record.data) >= 12:
            self._look(record)
        self.messages += 1
        if len(self.t_ns) > _MOST:
            self.every *= 2
            del self.t_ns[1::2], self.arrived_ns[1::2], self.values[1::2]

    def _look(self, record: Record) -> None:
        parse = VALUES.get(self.schema)
        try:
            row = parse(STORE.deserialize_cdr(record.data, self.schema)) if parse else ()
        except Exception:  # whatever bytes from outside trip over; the estimator has a reason for them
            return
        self.t_ns.append(stamp(record.data))
        self.arrived_ns.append(record.log_time_ns)
        self.values.append(row)

    @property
    def rate_hz(self) -> float:
        """Messages a second."""
        return (self.messages - 1) / (1e-9 * (self.last_ns - self.first_ns)) if self.last_ns > self.first_ns else 0.0

    @property
    def rows(self) -> Array:
        """(n, k) of the values."""
        return np.array(self.values, float).reshape(len(self.values), -1)

    @property
    def unstamped(self) -> bool:
        """Whether most stamps were left at zero."""
        return bool(self.t_ns) and float(np.mean(np.array(self.t_ns) == 0)) > 0.5

    @property
    def ahead_ns(self) -> int:
        """Median of stamp - time of recording."""
        return int(np.median(np.array(self.t_ns) - np.array(self.arrived_ns))) if self.t_ns else 0


def survey(records: Iterable[Record]) -> dict[str, Survey]:
    """Of each topic."""
    found: dict[str, Survey] = {}
    for record in records:
        if record.topic not in found:
            found[record.topic] = Survey(record.schema)
        found[record.topic].add(record)
    return found


def stamp(data: bytes) -> int:
    """header.stamp [ns] of a CDR message with a leading Header."""
    order = _order(data)
    sec, nanosec = int.from_bytes(data[4:8], order, signed=True), int.from_bytes(data[8:12], order)
    return sec * 1_000_000_000 + nanosec


def stamped(data: bytes, t_ns: int) -> bytes:
    """The message with another header.stamp."""
    order = _order(data)
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return data[:4] + sec.to_bytes(4, order, signed=True) + nanosec.to_bytes(4, order) + data[12:]


def _order(data: bytes) -> Literal["little", "big"]:
    return "little" if data[1] & 1 else "big"
