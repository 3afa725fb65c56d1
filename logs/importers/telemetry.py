"""A MAVLink telemetry log (.tlog) as tables, by pymavlink.

Of the vehicle with most messages. The fastest message dates the boot.
"""

import re
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega, development

from logs.importers.recording import Progress, Times
from logs.store.reader import LogError
from logs.wire.increments import SEEN_FROM_OUTSIDE
from models.messages import Array
from models.untrusted.file import opened

ardupilotmega.mavlink_map.setdefault(development.MAVLINK_MSG_ID_GNSS_INTEGRITY, development.MAVLink_gnss_integrity_message)
_RAW = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "xmag", "ymag", "zmag")
_GPS = ("fix_type", "lat", "lon", "alt", "eph", "epv", "vel", "cog", "alt_ellipsoid", "h_acc", "v_acc", "vel_acc", "yaw")
_WHEELS = 16
TURN, WAY, Q = (tuple(f"{name}{k}" for k in range(n)) for name, n in (("angle", 3), ("position", 3), ("q", 4)))
FIELDS = {
    "HIGHRES_IMU": _RAW, "RAW_IMU": _RAW, "SCALED_IMU": _RAW, "SCALED_IMU2": _RAW, "SCALED_IMU3": _RAW,
    "GPS_RAW_INT": _GPS, "GPS2_RAW": _GPS,
    "SCALED_PRESSURE": ("press_abs", "press_diff"),
    "DISTANCE_SENSOR": ("orientation", "min_distance", "max_distance", "current_distance"),
    "ATTITUDE": ("roll", "pitch", "yaw"),
    "SIM_STATE": ("lat_int", "lon_int", "alt", "vn", "ve", "vd", "q1", "q2", "q3", "q4"),
    "LOCAL_POSITION_NED": ("x", "y", "z", "vx", "vy", "vz"),
    "WHEEL_DISTANCE": ("count", *(f"distance{k}" for k in range(_WHEELS))),
    "ODOMETRY": ("frame_id", "child_frame_id", "reset_counter", "quality", "x", "y", "z", *Q),
    "VISION_POSITION_DELTA": ("time_delta_usec", "confidence", *TURN, *WAY),
    "OPTICAL_FLOW_RAD": (
        "integration_time_us", "integrated_x", "integrated_y", "integrated_xgyro", "integrated_ygyro", "integrated_zgyro",
        "quality", "distance",
    ),
    "GPS_GLOBAL_ORIGIN": ("latitude", "longitude", "altitude"),
    "EXTENDED_SYS_STATE": ("landed_state",),
    "GNSS_INTEGRITY": ("id", "jamming_state", "spoofing_state", "authentication_state"),
}  # fmt: skip
_NOT_A_VEHICLE = 8  # MAV_AUTOPILOT_INVALID
_UNIX_US = 1e14  # stamps above it count from 1970
_FAR_US = 4e15  # beyond any date; a damaged stamp may be
_CLOCK_SET_US = 30e6
_AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
_REBOOT_US = 5e6  # stamps that fall by more
_MOST_DAMAGED = 1 << 20  # bytes without a message, as a block of zeros has
_BEGINNING = 1 << 24  # bytes: a file may begin with a block of zeros, as one does that was not written to its end
_FRAME = re.compile(rb"\x00[\x03-\x07][\x00-\xff]{6}[\xfd\xfe]")  # time of arrival [us] of 1997 to 2041, then a frame


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Messages of a name: t_ns, arrived_ns, fields as columns."""

    t_ns: Times
    arrived_ns: Times
    fields: Mapping[str, Array]

    def __getitem__(self, field: str) -> Array:
        return self.fields[field]

    def vector(self, *fields: str) -> Array:
        """Fields side by side (n, k)."""
        return np.stack([self.fields[field] for field in fields], axis=1)


def messages_of(source: Path, progress: Progress | None) -> tuple[dict[str, Array], int, int]:
    """Rows (arrived_us, stamp_us, number, *fields); autopilot; number damaged. A MiB without a message ends the log."""
    rows: dict[int, dict[str, dict[int, list[list[float]]]]] = {}  # system, message, component
    autopilots: dict[int, tuple[int, int]] = {}  # system -> component, kind
    total = damaged = 0
    with closing(_open(source)) as log:
        while (message := log.recv_msg()) is not None:
            name, total = message.get_type(), total + 1
            if name == "BAD_DATA":
                damaged += 1
                continue
            log.f.unread = 0
            if name == "HEARTBEAT" and message.autopilot != _NOT_A_VEHICLE:
                autopilots[message.get_srcSystem()] = message.get_srcComponent(), message.autopilot
            elif name in FIELDS and not (name == "ODOMETRY" and message.estimator_type not in SEEN_FROM_OUTSIDE):
                fields = _values(message)
                row = [round(message._timestamp * 1e6), _stamp_us(message), total, *fields]
                components = rows.setdefault(message.get_srcSystem(), {}).setdefault(name, {})
                components.setdefault(message.get_srcComponent(), []).append(row)
            if progress and total % 5000 == 0:
                progress(log.percent / 100.0)
    if total == 0:
        raise LogError(f"{source.name}: the file is empty")
    if not rows:
        raise LogError(f"{source.name}: not a MAVLink telemetry log (.tlog), or one without IMU, GPS and attitude")
    system = max(rows, key=lambda s: sum(len(r) for components in rows[s].values() for r in components.values()))
    component, autopilot = autopilots.get(system, (_AUTOPILOT, _NOT_A_VEHICLE))
    return {name: np.array(_of(component, r), float) for name, r in rows[system].items()}, autopilot, damaged


class _Watched:
    """A file that ends where _MOST_DAMAGED bytes are read without a message: pymavlink seeks the next one byte by byte."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self.unread = file, 0

    def read(self, size: int) -> bytes:
        data = b"" if self.unread > _MOST_DAMAGED else self._file.read(size)
        self.unread += len(data)
        return data

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _values(message: Any) -> list[float]:
    match message.get_type():
        case "WHEEL_DISTANCE":
            return [message.count, *message.distance]
        case "VISION_POSITION_DELTA":
            return [message.time_delta_usec, message.confidence, *message.angle_delta, *message.position_delta]
        case "ODOMETRY":
            own = message.frame_id, message.child_frame_id, message.reset_counter, message.quality
            return [*own, message.x, message.y, message.z, *message.q]
    return [getattr(message, f, 0) for f in FIELDS[message.get_type()]]


def _of(component: int, rows: Mapping[int, list[list[float]]]) -> list[list[float]]:
    return rows[component] if component in rows else max(rows.values(), key=len)


def _open(source: Path) -> Any:
    """A reader at the first frame, which decides the MAVLink version."""
    try:
        with opened(source) as file:
            frame = _FRAME.search(file.read(_BEGINNING))
        log: Any = mavutil.mavlogfile(str(source))
    except OSError as error:
        raise LogError(f"{source}: {error.strerror}") from None
    log.f = _Watched(log.f)
    if frame is not None:
        log.f.seek(frame.start())
    return log


def _stamp_us(message: Any) -> float:
    """Since boot or 1970; 0: not given."""
    time_usec = getattr(message, "time_usec", None)
    return float(getattr(message, "time_boot_ms", 0) * 1000 if time_usec is None else time_usec)


def _clock_steps(everything: Array) -> tuple[Array, Array]:
    """First message after each step, and the step [us]."""
    booting = everything[(everything[:, 1] > 0) & (everything[:, 1] < _UNIX_US)]
    arrived, stamped = np.diff(booting[:, 0]), np.diff(booting[:, 1])
    steps = np.flatnonzero((np.abs(arrived - stamped) > _CLOCK_SET_US) & (np.abs(stamped) < _REBOOT_US))
    return booting[steps + 1, 2], (arrived - stamped)[steps]


def dated(messages: Mapping[str, Array], notes: list[str]) -> dict[str, Table]:
    """Columns by name with t_ns, arrived_ns; per boot the fastest message has no delay."""
    everything = np.concatenate([rows[:, :3] for rows in messages.values()])
    everything = everything[np.argsort(everything[:, 2], kind="stable")]
    numbers, lost_us = _clock_steps(everything)
    if len(numbers):
        notes.append(f"the ground station's clock was set {len(numbers)} times in the log; the vehicle's clock bridges it")
    since = np.concatenate([[0.0], np.cumsum(lost_us)])
    everything[:, 0] -= since[np.searchsorted(numbers, everything[:, 2], side="right")]
    everything = everything[np.argsort(everything[:, 0], kind="stable")]
    booting = everything[(everything[:, 1] > 0) & (everything[:, 1] < _UNIX_US)]
    reboots = booting[1:, 0][np.diff(booting[:, 1]) < -_REBOOT_US]
    boot = np.searchsorted(reboots, booting[:, 0], side="right")
    ahead = booting[:, 0] - booting[:, 1]
    shift = np.array([ahead[boot == k].min() if (boot == k).any() else 0.0 for k in range(len(reboots) + 1)])
    tables = {}
    for name, rows in messages.items():
        arrived_us, stamp_us = rows[:, 0] - since[np.searchsorted(numbers, rows[:, 2], side="right")], rows[:, 1]
        since_boot = stamp_us + shift[np.searchsorted(reboots, arrived_us, side="right")]
        t_us = np.select([stamp_us <= 0, stamp_us < _UNIX_US], [arrived_us, since_boot], stamp_us)
        columns = dict(zip(FIELDS[name], rows[:, 3:].T, strict=True))
        tables[name] = Table(nanoseconds(t_us), nanoseconds(arrived_us), columns)
    return tables


def nanoseconds(t_us: Array) -> Times:
    """t_ns of t_us, within any date."""
    return np.rint(np.clip(t_us, 0.0, _FAR_US)).astype(np.int64) * 1000
