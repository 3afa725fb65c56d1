"""MAVLink telemetry logs (.tlog), by pymavlink.

    HIGHRES_IMU, else RAW_IMU, SCALED_IMU, SCALED_IMU2 (coarse: noted)  ->  /imu, /mag
    SCALED_IMU2, SCALED_IMU3 at 20 Hz or more  ->  /imu2, /imu3
    GPS_RAW_INT, GPS2_RAW         ->  /gnss, /gnss/velocity, /gnss2, /gnss2/velocity
    SCALED_PRESSURE               ->  /baro, indicated /airspeed                       DISTANCE_SENSOR, downwards  ->  /range
    SIM_STATE                     ->  /truth: of ArduPilot's simulator
    LOCAL_POSITION_NED, ATTITUDE  ->  /truth where there is no SIM_STATE: the autopilot's own estimate, for reference only;
                                      ATTITUDE  ->  /attitude
    WHEEL_DISTANCE                ->  /velocity_body: forward, of all wheels
    ODOMETRY                      ->  /odometry: poses of a camera or lidar; a new frame at each reset_counter
    VISION_POSITION_DELTA         ->  /odometry_delta: a camera's steps      OPTICAL_FLOW_RAD  ->  /optical_flow

The vehicle with most messages counts. Stamps are since boot; the fastest message dates it.
"""

import re
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from logs.importers import frames, recording, sensors, simulator, steps
from logs.importers.recording import DEFAULTS, ImportOptions, Progress, Recording, Stream, Times
from logs.importers.settings import Settings
from logs.store.reader import LogError
from logs.wire.increments import SEEN_FROM_OUTSIDE
from models.frames import GRAVITY
from models.messages import Array, Vec3
from models.untrusted.file import opened

_MILLI_G = GRAVITY * 1e-3
_RAW = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "xmag", "ymag", "zmag")
_SAME_HEIGHT_MM = 10  # ArduPilot counts in cm
_GPS = ("fix_type", "lat", "lon", "alt", "eph", "epv", "vel", "cog", "alt_ellipsoid", "h_acc", "v_acc", "vel_acc", "yaw")
_WHEELS = 16
_TURN, _WAY, _Q = (tuple(f"{name}{k}" for k in range(n)) for name, n in (("angle", 3), ("position", 3), ("q", 4)))
_FIELDS = {
    "HIGHRES_IMU": _RAW, "RAW_IMU": _RAW, "SCALED_IMU": _RAW, "SCALED_IMU2": _RAW, "SCALED_IMU3": _RAW,
    "GPS_RAW_INT": _GPS, "GPS2_RAW": _GPS,
    "SCALED_PRESSURE": ("press_abs", "press_diff"),
    "DISTANCE_SENSOR": ("orientation", "min_distance", "max_distance", "current_distance"),
    "ATTITUDE": ("roll", "pitch", "yaw"),
    "SIM_STATE": ("lat_int", "lon_int", "alt", "vn", "ve", "vd", "q1", "q2", "q3", "q4"),
    "LOCAL_POSITION_NED": ("x", "y", "z", "vx", "vy", "vz"),
    "WHEEL_DISTANCE": ("count", *(f"distance{k}" for k in range(_WHEELS))),
    "ODOMETRY": ("frame_id", "child_frame_id", "reset_counter", "quality", "x", "y", "z", *_Q),
    "VISION_POSITION_DELTA": ("time_delta_usec", "confidence", *_TURN, *_WAY),
    "OPTICAL_FLOW_RAD": (
        "integration_time_us", "integrated_x", "integrated_y", "integrated_xgyro", "integrated_ygyro", "integrated_zgyro",
        "quality", "distance",
    ),
    "GPS_GLOBAL_ORIGIN": ("latitude", "longitude", "altitude"),
}  # fmt: skip
_RECEIVERS = {"GPS_RAW_INT": "/gnss", "GPS2_RAW": "/gnss2"}
_ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA: its RAW_IMU is in mG and mrad/s
_DELAY_S = {_ARDUPILOT: 0.2, 12: 0.11}  # what the autopilots (12: PX4) take by default for the age of a fix at its stamp
_NOT_A_VEHICLE = 8  # MAV_AUTOPILOT_INVALID
_IMUS = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2")  # the best first
_OTHER_IMUS = ("SCALED_IMU2", "SCALED_IMU3")
_SLOWEST_IMU_NS = 50_000_000  # of another IMU, that can take over
_UNKNOWN = 65535
_UNIX_US = 1e14  # stamps above it count from 1970
_FAR_US = 4e15  # beyond any date; a damaged stamp may be
_CLOCK_SET_US = 30e6
_LEFT_UP = (mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_LOCAL_ENU)  # the body's axes stay FRD
_AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
_REBOOT_US = 5e6  # stamps that fall by more
_BEGINNING = 1 << 24  # bytes: a file may begin with a block of zeros, as one does that was not written to its end
_FRAME = re.compile(rb"\x00[\x03-\x07][\x00-\xff]{6}[\xfd\xfe]")  # time of arrival [us] of 1997 to 2041, then a frame
_GAP_NS = 2_000_000_000  # attitudes further apart are not interpolated
_SPEED_SIGMA = 0.5  # m/s, where the receiver reports none
_NO_VERTICAL_SIGMA = 100.0  # m/s: GPS_RAW_INT has no vertical speed; 0 with this says nothing


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Messages of a name: t_ns, arrived_ns, fields as columns."""

    t_ns: Times
    arrived_ns: Times
    fields: Mapping[str, Array]

    def __getitem__(self, field: str) -> Array:
        return self.fields[field]

    def vector(self, *fields: str) -> Array:
        return np.stack([self.fields[field] for field in fields], axis=1)


def read(source: Path, options: ImportOptions = DEFAULTS, progress: Progress | None = None) -> Recording:
    """The recording in a .tlog file. Raises LogError."""
    options.refuse_but("tlog", "imu")
    messages, autopilot, damaged = _messages(source, progress)
    notes = [f"{source.name}: {damaged} damaged messages passed over"] if damaged else []
    tables = _dated(messages, notes)
    imu = _imu(source, tables, options.imu.upper(), autopilot, notes)
    gnss = [stream for name, topic in _RECEIVERS.items() for stream in _gnss(source, tables.get(name), topic)]
    own = _own_estimate(tables)
    truth, origin = _simulated(tables) or (own, None)
    notes.append(simulator.about(truth, own, "LOCAL_POSITION_NED with ATTITUDE"))
    delay_s = _DELAY_S.get(autopilot, 0.0)
    if gnss:
        if not any(_has_ellipsoid(tables[name]).any() for name in _RECEIVERS if name in tables):
            notes.append("GNSS heights are above sea level; set [map] geoid_m to have them above the ellipsoid")
        if truth and not origin:
            origin = sensors.origin_of_truth(gnss[0], truth, delay_s, _known_origin(tables))
    aids = [*gnss, *_odometry(tables, notes), *_camera(tables), *_flow(tables, imu, notes)]
    altitude = "above the ellipsoid where the log holds it, else above mean sea level"
    settings = Settings(
        gnss_delay_s=delay_s,
        origin=origin,
        altitude=altitude,
        wheels="WHEEL_DISTANCE" in tables,
        airspeed={"indicated": True},
    )
    return Recording.of(
        (
            *aids,
            *_baro(tables),
            *_airspeed(tables),
            *_range(tables),
            *_field(tables, autopilot),
            *_heading(tables),
            *_attitude(tables),
            *_wheels(tables),
            imu,
            *_other_imus(tables, imu, notes),
            *([truth] if truth else []),
        ),
        settings,
        notes,
        recording.AUTOPILOT if truth and truth is own else "",
    )


def _messages(source: Path, progress: Progress | None) -> tuple[dict[str, Array], int, int]:
    """Rows (arrived_us, stamp_us, number, *fields) of the vehicle; its autopilot; number damaged."""
    rows: dict[int, dict[str, dict[int, list[list[float]]]]] = {}  # system, message, component
    autopilots: dict[int, tuple[int, int]] = {}  # system -> component, kind
    total = damaged = 0
    with closing(_open(source)) as log:
        while (message := log.recv_msg()) is not None:
            name, total = message.get_type(), total + 1
            if name == "BAD_DATA":
                damaged += 1
            elif name == "HEARTBEAT" and message.autopilot != _NOT_A_VEHICLE:
                autopilots[message.get_srcSystem()] = message.get_srcComponent(), message.autopilot
            elif name in _FIELDS and not (name == "ODOMETRY" and message.estimator_type not in SEEN_FROM_OUTSIDE):
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


def _values(message: Any) -> list[float]:
    match message.get_type():
        case "WHEEL_DISTANCE":
            return [message.count, *message.distance]
        case "VISION_POSITION_DELTA":
            return [message.time_delta_usec, message.confidence, *message.angle_delta, *message.position_delta]
        case "ODOMETRY":
            own = message.frame_id, message.child_frame_id, message.reset_counter, message.quality
            return [*own, message.x, message.y, message.z, *message.q]
    return [getattr(message, f, 0) for f in _FIELDS[message.get_type()]]


def _of(component: int, rows: Mapping[int, list[list[float]]]) -> list[list[float]]:
    return rows[component] if component in rows else max(rows.values(), key=len)


def _open(source: Path) -> Any:
    """pymavlink's reader at the first frame, which decides the MAVLink version."""
    try:
        with opened(source) as file:
            frame = _FRAME.search(file.read(_BEGINNING))
        log: Any = mavutil.mavlogfile(str(source))
    except OSError as error:
        raise LogError(f"{source}: {error.strerror}") from None
    if frame is not None:
        log.f.seek(frame.start())
    return log


def _stamp_us(message: Any) -> float:
    """Since boot or 1970; 0: not given."""
    time_usec = getattr(message, "time_usec", None)
    return float(getattr(message, "time_boot_ms", 0) * 1000 if time_usec is None else time_usec)


def _clock_steps(everything: Array) -> tuple[Array, Array]:
    """First message after each ground clock step, the step [us]; arrival [us], stamp [us since boot]."""
    booting = everything[(everything[:, 1] > 0) & (everything[:, 1] < _UNIX_US)]
    arrived, stamped = np.diff(booting[:, 0]), np.diff(booting[:, 1])
    steps = np.flatnonzero((np.abs(arrived - stamped) > _CLOCK_SET_US) & (np.abs(stamped) < _REBOOT_US))
    return booting[steps + 1, 2], (arrived - stamped)[steps]


def _dated(messages: Mapping[str, Array], notes: list[str]) -> dict[str, _Table]:
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
        columns = dict(zip(_FIELDS[name], rows[:, 3:].T, strict=True))
        tables[name] = _Table(_ns(t_us), _ns(arrived_us), columns)
    return tables


def _ns(t_us: Array) -> Times:
    return np.rint(np.clip(t_us, 0.0, _FAR_US)).astype(np.int64) * 1000


def _imu(source: Path, tables: Mapping[str, _Table], wanted: str, autopilot: int, notes: list[str]) -> Stream:
    usable = _usable(tables, autopilot)
    name = next((n for n in ([wanted] if wanted else usable) if n in usable), None)
    if name is None:
        there = ", ".join(usable) or "none in physical units"
        raise LogError(f"{source.name}: no IMU messages {wanted or ', '.join(_IMUS)} in it (there are: {there})")
    table = tables[name]
    gyro_b, accel_b = table.vector("xgyro", "ygyro", "zgyro"), table.vector("xacc", "yacc", "zacc")
    if name != "HIGHRES_IMU":
        gyro_b, accel_b = gyro_b * 1e-3, accel_b * _MILLI_G
        notes.append(f"{source.name}: IMU from {name}, in steps of 0.001 rad/s and 0.01 m/s^2; HIGHRES_IMU is better")
    notes += sensors.check_imu(gyro_b, accel_b, source.name) + sensors.check_rate(table.t_ns, source.name)
    return recording.imu(table.t_ns, table.arrived_ns, gyro_b, accel_b)


def _other_imus(tables: Mapping[str, _Table], imu: Stream, notes: list[str]) -> list[Stream]:
    streams: list[Stream] = []
    for name in (n for n in _OTHER_IMUS if n in tables):
        table = tables[name]
        gyro_b = 1e-3 * table.vector("xgyro", "ygyro", "zgyro")
        accel_b = _MILLI_G * table.vector("xacc", "yacc", "zacc")
        if len(gyro_b) == len(imu) and np.array_equal(gyro_b, imu.columns[0]):
            continue
        if not (gyro_b.any() and accel_b.any()):
            continue
        if len(gyro_b) < 2 or np.median(np.diff(np.sort(table.t_ns))) > _SLOWEST_IMU_NS:
            notes.append(f"another IMU ({name}) is too slow to take over: ask for it at 20 Hz or more (SRx_RAW_SENS)")
            continue
        streams.append(recording.imu(table.t_ns, table.arrived_ns, gyro_b, accel_b, f"/imu{len(streams) + 2}"))
    if streams:
        notes.append("other IMUs (SCALED_IMU2, 3) are /imu2 and so on; [imu] others_rpy_deg and others_noise say how they differ")
    return streams


def _has_ellipsoid(table: _Table) -> Array:
    """Whether alt_ellipsoid is given: not 0, and not the height above the sea."""
    height = table["alt_ellipsoid"]
    known: Array = (height != 0) & (np.abs(height - table["alt"]) > _SAME_HEIGHT_MM)
    return known


def _gnss(source: Path, table: _Table | None, topic: str) -> list[Stream]:
    if table is None:
        return []
    height = np.where(_has_ellipsoid(table), table["alt_ellipsoid"], table["alt"]) * 1e-3
    lla = np.stack([table["lat"] * 1e-7, table["lon"] * 1e-7, height], axis=1)
    sensors.check_place(lla, source.name)
    status = sensors.navsat_status(table["fix_type"])
    arrived_ns = table.arrived_ns
    t_ns = np.where(status < 0, arrived_ns, table.t_ns)  # without a fix ArduPilot repeats the stamp of the last one
    streams = [recording.gnss(t_ns, arrived_ns, lla, _position_variance(table), status, topic)]
    moving = np.flatnonzero((status >= 0) & (table["vel"] != _UNKNOWN) & (table["cog"] != _UNKNOWN))
    if len(moving):
        speed, course = table["vel"][moving] * 1e-2, np.deg2rad(table["cog"][moving] * 1e-2)
        v_n = np.stack([speed * np.cos(course), speed * np.sin(course), np.zeros(len(moving))], axis=1)
        sigma = np.where(table["vel_acc"] > 0, table["vel_acc"] * 1e-3, _SPEED_SIGMA)[moving]
        variance = np.stack([sigma**2, sigma**2, np.full(len(moving), _NO_VERTICAL_SIGMA**2)], axis=1)
        streams.append(recording.gnss_velocity(t_ns[moving], arrived_ns[moving], v_n, variance, f"{topic}/velocity"))
    return streams


def _position_variance(table: _Table) -> Array:
    """(n, 3) m^2: h_acc, v_acc [mm], else eph, epv [100 x HDOP, VDOP]; nan: not given."""
    hdop, vdop = (np.where(table[name] == _UNKNOWN, np.nan, table[name] * 1e-2) for name in ("eph", "epv"))
    accuracy = table.vector("h_acc", "h_acc", "v_acc") * 1e-3
    return np.where((accuracy > 0.0).all(axis=1, keepdims=True), accuracy**2, sensors.variance_from_dop(hdop, vdop))


def _baro(tables: Mapping[str, _Table]) -> list[Stream]:
    table = tables.get("SCALED_PRESSURE")
    if table is None:
        return []
    return [recording.sensor("baro", table.t_ns, table.arrived_ns, table.vector("press_abs") * 100.0)]


def _airspeed(tables: Mapping[str, _Table]) -> list[Stream]:
    """Indicated airspeed of dynamic pressure, hPa; 0: no pitot tube."""
    table = tables.get("SCALED_PRESSURE")
    if table is None or not len(rows := np.flatnonzero(table["press_diff"])):
        return []
    speed = sensors.indicated_airspeed(100.0 * table["press_diff"][rows])
    return [recording.sensor("airspeed", table.t_ns[rows], table.arrived_ns[rows], speed[:, np.newaxis])]


def _range(tables: Mapping[str, _Table]) -> list[Stream]:
    table = tables.get("DISTANCE_SENSOR")
    if table is None or not len(rows := np.flatnonzero(table["orientation"] == mavlink.MAV_SENSOR_ROTATION_PITCH_270)):
        return []
    distance = table["current_distance"][rows]
    is_within = (table["min_distance"][rows] <= distance) & (distance <= table["max_distance"][rows])
    z_m = np.where(is_within, 1e-2 * distance, np.inf)
    return [recording.sensor("range", table.t_ns[rows], table.arrived_ns[rows], z_m[:, np.newaxis])]


def _field(tables: Mapping[str, _Table], autopilot: int) -> list[Stream]:
    for name in _usable(tables, autopilot):
        table = tables[name]
        field_b = table.vector("xmag", "ymag", "zmag")
        field_b = sensors.highres_field(field_b) if name == "HIGHRES_IMU" else 1e-3 * sensors.GAUSS_T * field_b
        new = np.flatnonzero(np.any(np.diff(field_b, axis=0, prepend=0.0) != 0.0, axis=1))
        if field_b.any():
            return [recording.sensor("magnetometer", table.t_ns[new], table.arrived_ns[new], field_b[new])]
    return []


def _heading(tables: Mapping[str, _Table]) -> list[Stream]:
    for table in (tables[name] for name in _RECEIVERS if name in tables):
        rows = np.flatnonzero((table["yaw"] != 0.0) & (table["yaw"] != _UNKNOWN))
        if len(rows):
            azimuth = np.deg2rad(np.remainder(1e-2 * table["yaw"] + 180.0, 360.0) - 180.0)[rows]
            return [recording.sensor("heading", table.t_ns[rows], table.arrived_ns[rows], azimuth[:, np.newaxis])]
    return []


def _wheels(tables: Mapping[str, _Table]) -> list[Stream]:
    table = tables.get("WHEEL_DISTANCE")
    if table is None:
        return []
    names = _FIELDS["WHEEL_DISTANCE"][1 : 1 + int(table["count"][0])]
    return steps.wheels(table.t_ns, table.arrived_ns, table.vector(*names)) if names else []


def _odometry(tables: Mapping[str, _Table], notes: list[str]) -> list[Stream]:
    table = tables.get("ODOMETRY")
    if table is None:
        return []
    other_axes = (table["child_frame_id"] != mavlink.MAV_FRAME_BODY_FRD) | np.isin(table["frame_id"], _LEFT_UP)
    if other_axes.any():
        notes.append(
            f"{other_axes.sum()} of {len(other_axes)} ODOMETRY left out: only BODY_FRD in LOCAL_FRD or LOCAL_NED is read"
        )
    rows = np.flatnonzero(~other_axes & (table["quality"] >= 0.0))
    if not len(rows):
        return []
    notes.append("poses from outside (ODOMETRY) are /odometry; the configuration says how to use them")
    run = 1000.0 * table["frame_id"] + table["reset_counter"]
    p, q = table.vector("x", "y", "z")[rows], table.vector(*_Q)[rows]
    return [recording.odometry(table.t_ns[rows], table.arrived_ns[rows], p, q, run[rows])]


def _camera(tables: Mapping[str, _Table]) -> list[Stream]:
    table = tables.get("VISION_POSITION_DELTA")
    if table is None:
        return []
    rows = np.flatnonzero(table["confidence"] > 0.0)
    dt_ns = _ns(table["time_delta_usec"])[rows]
    return steps.camera(table.t_ns[rows], table.arrived_ns[rows], dt_ns, table.vector(*_TURN)[rows], table.vector(*_WAY)[rows])


def _flow(tables: Mapping[str, _Table], imu: Stream, notes: list[str]) -> list[Stream]:
    table = tables.get("OPTICAL_FLOW_RAD")
    if table is None:
        return []
    rows = np.flatnonzero(table["quality"] > 0.0)
    seen = table.vector("integrated_x", "integrated_y")[rows]
    turn = table.vector("integrated_xgyro", "integrated_ygyro", "integrated_zgyro")[rows]
    t_ns, arrived_ns, dt_ns = table.t_ns[rows], table.arrived_ns[rows], _ns(table["integration_time_us"])[rows]
    return steps.flow(t_ns, arrived_ns, dt_ns, seen, turn, table["distance"][rows], [imu], notes)


def _usable(tables: Mapping[str, _Table], autopilot: int) -> list[str]:
    return [n for n in _IMUS if n in tables and (n != "RAW_IMU" or autopilot == _ARDUPILOT)]


def _simulated(tables: Mapping[str, _Table]) -> tuple[Stream, Vec3] | None:
    """Truth and origin of a simulation; SIM_STATE is stamped by arrival."""
    table = tables.get("SIM_STATE")
    if table is None:
        return None
    lla = table.vector("lat_int", "lon_int", "alt") * (1e-7, 1e-7, 1.0)
    q_nb = table.vector("q1", "q2", "q3", "q4")
    return simulator.truth(table.t_ns, lla, table.vector("vn", "ve", "vd"), q_nb, _known_origin(tables))


def _own_estimate(tables: Mapping[str, _Table]) -> Stream | None:
    position, attitude = tables.get("LOCAL_POSITION_NED"), tables.get("ATTITUDE")
    if position is None or attitude is None:
        return None
    order = np.argsort(attitude.t_ns, kind="stable")
    q_nb = frames.attitude_at(position.t_ns, attitude.t_ns[order], _q_nb(attitude)[order], _GAP_NS)
    return recording.truth(position.t_ns, position.vector("x", "y", "z"), position.vector("vx", "vy", "vz"), q_nb)


def _attitude(tables: Mapping[str, _Table]) -> list[Stream]:
    table = tables.get("ATTITUDE")
    return [recording.attitude(table.t_ns, table.arrived_ns, _q_nb(table))] if table else []


def _q_nb(attitude: _Table) -> Array:
    return frames.attitude_from_euler(attitude["roll"], attitude["pitch"], attitude["yaw"])


def _known_origin(tables: Mapping[str, _Table]) -> Vec3 | None:
    table = tables.get("GPS_GLOBAL_ORIGIN")
    if table is None:
        return None
    return float(table["latitude"][-1]) * 1e-7, float(table["longitude"][-1]) * 1e-7, float(table["altitude"][-1]) * 1e-3
