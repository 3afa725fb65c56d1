"""MAVLink telemetry logs (.tlog), by pymavlink.

    HIGHRES_IMU, else RAW_IMU, SCALED_IMU, SCALED_IMU2 (coarse: noted)  ->  /imu, /mag
    SCALED_IMU2, SCALED_IMU3 at 20 Hz or more  ->  /imu2, /imu3
    GPS_RAW_INT, GPS2_RAW         ->  /gnss, /gnss/velocity, /gnss2, /gnss2/velocity; GNSS_INTEGRITY: their state
    SCALED_PRESSURE               ->  /baro, indicated /airspeed                       DISTANCE_SENSOR, downwards  ->  /range
    SIM_STATE                     ->  /truth: of ArduPilot's simulator
    LOCAL_POSITION_NED, ATTITUDE  ->  /truth without SIM_STATE: the autopilot's estimate, a reference only;
                                      ATTITUDE  ->  /attitude
    WHEEL_DISTANCE                ->  /velocity_body: forward, of all wheels             EXTENDED_SYS_STATE  ->  /landed
    ODOMETRY                      ->  /odometry: poses of a camera or lidar; a new frame at each reset_counter
    VISION_POSITION_DELTA         ->  /odometry_delta: a camera's steps      OPTICAL_FLOW_RAD  ->  /optical_flow

Stamps: telemetry.py.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from logs.importers import frames, recording, sensors, simulator, steps
from logs.importers.recording import DEFAULTS, ImportOptions, Progress, Recording, Stream, Times
from logs.importers.settings import Settings
from logs.importers.telemetry import FIELDS, TURN, WAY, Q, Table, dated, messages_of, nanoseconds
from logs.store.reader import LogError
from logs.wire.receiver import receiver_state
from models.frames import GRAVITY
from models.messages import Array, Vec3

_MILLI_G = GRAVITY * 1e-3
_SAME_HEIGHT_MM = 10  # ArduPilot counts in cm
_RECEIVERS = {"GPS_RAW_INT": "/gnss", "GPS2_RAW": "/gnss2"}
_ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA: its RAW_IMU is in mG and mrad/s
_DELAY_S = {_ARDUPILOT: 0.2, 12: 0.11}  # what the autopilots (12: PX4) take by default for the age of a fix at its stamp
_IMUS = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2")  # the best first
_OTHER_IMUS = ("SCALED_IMU2", "SCALED_IMU3")
_SLOWEST_IMU_NS = 50_000_000  # of another IMU, that can take over
_UNKNOWN = 65535
_LEFT_UP = (mavlink.MAV_FRAME_LOCAL_FLU, mavlink.MAV_FRAME_LOCAL_ENU)  # the body's axes stay FRD
_FLAGS_NS = 3_000_000_000  # flags older than this are of the past
_GAP_NS = 2_000_000_000  # attitudes further apart are not interpolated
_SPEED_SIGMA = 0.5  # m/s, where the receiver reports none
_NO_VERTICAL_SIGMA = 100.0  # m/s: GPS_RAW_INT has no vertical speed; 0 with this says nothing


def read(source: Path, options: ImportOptions = DEFAULTS, progress: Progress | None = None) -> Recording:
    """The recording in a .tlog file. Raises LogError."""
    options.refuse_but("tlog", "imu")
    messages, autopilot, damaged = messages_of(source, progress)
    notes = [f"{source.name}: {damaged} damaged messages passed over"] if damaged else []
    tables = dated(messages, notes)
    imu = _imu(source, tables, options.imu.upper(), autopilot, notes)
    integrity = tables.get("GNSS_INTEGRITY")
    gnss = [stream for name in _RECEIVERS for stream in _gnss(source, tables.get(name), name, integrity, notes)]
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
            *_attitude(tables, autopilot, notes),
            *_wheels(tables),
            *_landed(tables),
            imu,
            *_other_imus(tables, imu, notes),
            *([truth] if truth else []),
        ),
        settings,
        notes,
        recording.AUTOPILOT if truth and truth is own else "",
    )


def _imu(source: Path, tables: Mapping[str, Table], wanted: str, autopilot: int, notes: list[str]) -> Stream:
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


def _other_imus(tables: Mapping[str, Table], imu: Stream, notes: list[str]) -> list[Stream]:
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


def _has_ellipsoid(table: Table) -> Array:
    """Whether alt_ellipsoid is given: not 0, and not the height above the sea."""
    height = table["alt_ellipsoid"]
    known: Array = (height != 0) & (np.abs(height - table["alt"]) > _SAME_HEIGHT_MM)
    return known


def _gnss(source: Path, table: Table | None, name: str, integrity: Table | None, notes: list[str]) -> list[Stream]:
    if table is None:
        return []
    topic = _RECEIVERS[name]
    height = np.where(_has_ellipsoid(table), table["alt_ellipsoid"], table["alt"]) * 1e-3
    lla = np.stack([table["lat"] * 1e-7, table["lon"] * 1e-7, height], axis=1)
    sensors.check_place(lla, source.name)
    status = sensors.navsat_status(table["fix_type"])
    arrived_ns = table.arrived_ns
    t_ns = np.where(status < 0, arrived_ns, table.t_ns)  # without a fix ArduPilot repeats the stamp of the last one
    flags = _flags(integrity, list(_RECEIVERS).index(name), arrived_ns)
    if flags.any():
        notes.append(f"{topic}: the receiver reports jamming or spoofing in {np.count_nonzero(flags)} of {len(flags)} fixes")
    if integrity:
        mine = integrity["id"] == list(_RECEIVERS).index(name)
        notes += sensors.authentication(topic, integrity["authentication_state"][mine])
    streams = [recording.gnss(t_ns, arrived_ns, lla, _position_variance(table), status, topic, flags)]
    moving = np.flatnonzero((status >= 0) & (table["vel"] != _UNKNOWN) & (table["cog"] != _UNKNOWN))
    if len(moving):
        speed, course = table["vel"][moving] * 1e-2, np.deg2rad(table["cog"][moving] * 1e-2)
        v_n = np.stack([speed * np.cos(course), speed * np.sin(course), np.zeros(len(moving))], axis=1)
        sigma = np.where(table["vel_acc"] > 0, table["vel_acc"] * 1e-3, _SPEED_SIGMA)[moving]
        variance = np.stack([sigma**2, sigma**2, np.full(len(moving), _NO_VERTICAL_SIGMA**2)], axis=1)
        streams.append(recording.gnss_velocity(t_ns[moving], arrived_ns[moving], v_n, variance, f"{topic}/velocity"))
    return streams


def _flags(integrity: Table | None, number: int, arrived_ns: Times) -> Array:
    """(n,) ReceiverState of receiver `number` as its newest GNSS_INTEGRITY of at most 3 s ago says."""
    rows = np.flatnonzero(integrity["id"] == number) if integrity else np.array([], int)
    if integrity is None or not len(rows):
        return np.zeros(len(arrived_ns))
    rows = rows[np.argsort(integrity.arrived_ns[rows], kind="stable")]
    states = receiver_state(integrity["jamming_state"][rows], integrity["spoofing_state"][rows])
    heard_ns = integrity.arrived_ns[rows]
    newest = np.searchsorted(heard_ns, arrived_ns, side="right") - 1
    fresh = (newest >= 0) & (arrived_ns - heard_ns[newest] <= _FLAGS_NS)
    return np.where(fresh, states[newest], 0)


def _position_variance(table: Table) -> Array:
    """(n, 3) m^2: h_acc, v_acc [mm], else eph, epv [100 x HDOP, VDOP]."""
    hdop, vdop = (np.where(table[name] == _UNKNOWN, np.nan, table[name] * 1e-2) for name in ("eph", "epv"))
    accuracy = table.vector("h_acc", "h_acc", "v_acc") * 1e-3
    return np.where((accuracy > 0.0).all(axis=1, keepdims=True), accuracy**2, sensors.variance_from_dop(hdop, vdop))


def _landed(tables: Mapping[str, Table]) -> list[Stream]:
    table = tables.get("EXTENDED_SYS_STATE")
    return [recording.sensor("rest", table.t_ns, table.arrived_ns, table.vector("landed_state"))] if table else []


def _baro(tables: Mapping[str, Table]) -> list[Stream]:
    table = tables.get("SCALED_PRESSURE")
    if table is None:
        return []
    return [recording.sensor("baro", table.t_ns, table.arrived_ns, table.vector("press_abs") * 100.0)]


def _airspeed(tables: Mapping[str, Table]) -> list[Stream]:
    """Indicated airspeed of dynamic pressure, hPa; 0: no pitot tube."""
    table = tables.get("SCALED_PRESSURE")
    if table is None or not len(rows := np.flatnonzero(table["press_diff"])):
        return []
    speed = sensors.indicated_airspeed(100.0 * table["press_diff"][rows])
    return [recording.sensor("airspeed", table.t_ns[rows], table.arrived_ns[rows], speed[:, np.newaxis])]


def _range(tables: Mapping[str, Table]) -> list[Stream]:
    table = tables.get("DISTANCE_SENSOR")
    if table is None or not len(rows := np.flatnonzero(table["orientation"] == mavlink.MAV_SENSOR_ROTATION_PITCH_270)):
        return []
    distance = table["current_distance"][rows]
    is_within = (table["min_distance"][rows] <= distance) & (distance <= table["max_distance"][rows])
    z_m = np.where(is_within, 1e-2 * distance, np.inf)
    return [recording.sensor("range", table.t_ns[rows], table.arrived_ns[rows], z_m[:, np.newaxis])]


def _field(tables: Mapping[str, Table], autopilot: int) -> list[Stream]:
    for name in _usable(tables, autopilot):
        table = tables[name]
        field_b = table.vector("xmag", "ymag", "zmag")
        field_b = sensors.highres_field(field_b) if name == "HIGHRES_IMU" else 1e-3 * sensors.GAUSS_T * field_b
        new = np.flatnonzero(np.any(np.diff(field_b, axis=0, prepend=0.0) != 0.0, axis=1))
        if field_b.any():
            return [recording.sensor("magnetometer", table.t_ns[new], table.arrived_ns[new], field_b[new])]
    return []


def _heading(tables: Mapping[str, Table]) -> list[Stream]:
    for table in (tables[name] for name in _RECEIVERS if name in tables):
        rows = np.flatnonzero((table["yaw"] != 0.0) & (table["yaw"] != _UNKNOWN))
        if len(rows):
            azimuth = np.deg2rad(np.remainder(1e-2 * table["yaw"] + 180.0, 360.0) - 180.0)[rows]
            return [recording.sensor("heading", table.t_ns[rows], table.arrived_ns[rows], azimuth[:, np.newaxis])]
    return []


def _wheels(tables: Mapping[str, Table]) -> list[Stream]:
    table = tables.get("WHEEL_DISTANCE")
    if table is None:
        return []
    names = FIELDS["WHEEL_DISTANCE"][1 : 1 + int(table["count"][0])]
    return steps.wheels(table.t_ns, table.arrived_ns, table.vector(*names)) if names else []


def _odometry(tables: Mapping[str, Table], notes: list[str]) -> list[Stream]:
    table = tables.get("ODOMETRY")
    if table is None:
        return []
    other_axes = (table["child_frame_id"] != mavlink.MAV_FRAME_BODY_FRD) | np.isin(table["frame_id"], _LEFT_UP)
    if other_axes.any():
        notes.append(
            f"{other_axes.sum()} of {len(other_axes)} ODOMETRY left out: only BODY_FRD in LOCAL_FRD or LOCAL_NED is read"
        )
    rows = np.flatnonzero(~other_axes)
    if not len(rows):
        return []
    notes.append("poses from outside (ODOMETRY) are /odometry; the configuration says how to use them")
    run = 1000.0 * table["frame_id"] + table["reset_counter"]
    p, q = table.vector("x", "y", "z")[rows], table.vector(*Q)[rows]
    return [recording.odometry(table.t_ns[rows], table.arrived_ns[rows], p, q, run[rows], table["quality"][rows])]


def _camera(tables: Mapping[str, Table]) -> list[Stream]:
    table = tables.get("VISION_POSITION_DELTA")
    if table is None:
        return []
    rows = np.flatnonzero(table["confidence"] > 0.0)
    dt_ns = nanoseconds(table["time_delta_usec"])[rows]
    return steps.camera(table.t_ns[rows], table.arrived_ns[rows], dt_ns, table.vector(*TURN)[rows], table.vector(*WAY)[rows])


def _flow(tables: Mapping[str, Table], imu: Stream, notes: list[str]) -> list[Stream]:
    table = tables.get("OPTICAL_FLOW_RAD")
    if table is None:
        return []
    rows = np.flatnonzero(table["quality"] > 0.0)
    seen = table.vector("integrated_x", "integrated_y")[rows]
    turn = table.vector("integrated_xgyro", "integrated_ygyro", "integrated_zgyro")[rows]
    t_ns, arrived_ns, dt_ns = table.t_ns[rows], table.arrived_ns[rows], nanoseconds(table["integration_time_us"])[rows]
    return steps.flow(t_ns, arrived_ns, dt_ns, seen, turn, table["distance"][rows], [imu], notes)


def _usable(tables: Mapping[str, Table], autopilot: int) -> list[str]:
    return [n for n in _IMUS if n in tables and (n != "RAW_IMU" or autopilot == _ARDUPILOT)]


def _simulated(tables: Mapping[str, Table]) -> tuple[Stream, Vec3] | None:
    """SIM_STATE is stamped by arrival."""
    table = tables.get("SIM_STATE")
    if table is None:
        return None
    lla = table.vector("lat_int", "lon_int", "alt") * (1e-7, 1e-7, 1.0)
    q_nb = table.vector("q1", "q2", "q3", "q4")
    return simulator.truth(table.t_ns, lla, table.vector("vn", "ve", "vd"), q_nb, _known_origin(tables))


def _own_estimate(tables: Mapping[str, Table]) -> Stream | None:
    position, attitude = tables.get("LOCAL_POSITION_NED"), tables.get("ATTITUDE")
    if position is None or attitude is None:
        return None
    order = np.argsort(attitude.t_ns, kind="stable")
    q_nb = frames.attitude_at(position.t_ns, attitude.t_ns[order], _q_nb(attitude)[order], _GAP_NS)
    return recording.truth(position.t_ns, position.vector("x", "y", "z"), position.vector("vx", "vy", "vz"), q_nb)


def _attitude(tables: Mapping[str, Table], autopilot: int, notes: list[str]) -> list[Stream]:
    """None with a dead compass; ArduPilot's from its first origin on, if that was sent: before, its heading is magnetic."""
    table, origins = tables.get("ATTITUDE"), tables.get("GPS_GLOBAL_ORIGIN")
    if table is None:
        return []
    if not _field(tables, autopilot):
        notes.append("the autopilot's attitude is left out: its magnetometer reads zero, and the heading may be anything")
        return []
    since_ns = origins.arrived_ns.min() if origins and autopilot == _ARDUPILOT else 0
    q_nb = np.where((table.arrived_ns >= since_ns)[:, np.newaxis], _q_nb(table), np.nan)
    return [recording.attitude(table.t_ns, table.arrived_ns, q_nb)]


def _q_nb(attitude: Table) -> Array:
    return frames.attitude_from_euler(attitude["roll"], attitude["pitch"], attitude["yaw"])


def _known_origin(tables: Mapping[str, Table]) -> Vec3 | None:
    table = tables.get("GPS_GLOBAL_ORIGIN")
    if table is None:
        return None
    return float(table["latitude"][-1]) * 1e-7, float(table["longitude"][-1]) * 1e-7, float(table["altitude"][-1]) * 1e-3
