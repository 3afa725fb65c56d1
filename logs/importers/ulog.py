"""PX4 logs (.ulg), by pyulog.

    sensor_combined, else sensor_gyro with sensor_accel  ->  /imu            vehicle_air_data  ->  /baro
    vehicle_imu that sensor_selection does not name, if fast enough        ->  /imu2, /imu3
    vehicle_magnetometer, else sensor_mag                ->  /mag
    vehicle_gps_position, else sensor_gps                ->  /gnss, /gnss/velocity, with two antennas /heading
    *_groundtruth, else the autopilot's estimate       ->  /truth
    airspeed_validated, else airspeed: true airspeed     ->  /airspeed         distance_sensor, downwards  ->  /range
    vehicle_attitude                                     ->  /attitude
    vehicle_visual_odometry, else vehicle_mocap_odometry ->  /odometry: poses; a new frame at each reset_counter
    vehicle_optical_flow                                 ->  /optical_flow

Stamps: us since boot; date: time_utc_usec; field names by version (lat 1e-7 deg until v1.14).
"""

import io
from collections.abc import Mapping, Sequence
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from logs.importers import frames, recording, sensors, steps
from logs.importers.recording import DEFAULTS, EPOCH_NS, ImportOptions, Progress, Recording, Stream, Times
from logs.importers.settings import Settings
from logs.store.reader import LogError
from logs.wire.receiver import receiver_state
from models.messages import Array, Vec3
from models.untrusted.quiet import silence

Topic: TypeAlias = Mapping[str, Any]  # field -> column

_MAGIC = b"ULog\x01\x12\x35"
_HEADER_BYTES = 16
_WANTED = (
    "sensor_combined", "sensor_gyro", "sensor_accel", "vehicle_imu", "sensor_selection",
    "vehicle_air_data", "vehicle_magnetometer", "sensor_mag",
    "vehicle_gps_position", "sensor_gps",
    "airspeed_validated", "airspeed", "distance_sensor",
    "vehicle_attitude", "estimator_status", "vehicle_local_position", "vehicle_visual_odometry", "vehicle_mocap_odometry",
    "vehicle_optical_flow", "vehicle_land_detected",
    "vehicle_attitude_groundtruth", "vehicle_local_position_groundtruth",
)  # fmt: skip
_FLOW = (
    "pixel_flow[0]", "pixel_flow[1]", "delta_angle[0]", "delta_angle[1]", "delta_angle[2]",
    "distance_m", "integration_timespan_us", "quality",
)  # fmt: skip
_ATTITUDE_GAP_NS = 200_000_000
_SLOWEST_IMU_NS = 50_000_000  # of another IMU; PX4 logs them at 2 Hz by default
_FIX_3D = 3  # fix_type
_YAW_ALIGNED = np.uint64(1)  # bit of estimator_status.control_mode_flags
_SYNTHETIC = 4  # AirspeedValidated.airspeed_source: no sensor; below 1: ground speed less wind, none
_DOWNWARDS = 25  # ROTATION_DOWNWARD_FACING
_GROUND, _AIR = 1.0, 2.0  # MAV_LANDED_STATE
_FAR_US = np.uint64(4 * 10**15)  # beyond any date; a damaged stamp may be
_UNIX_US = 10**14  # stamps above it count from 1970


def read(source: Path, options: ImportOptions = DEFAULTS, progress: Progress | None = None) -> Recording:
    """The recording in a .ulg file. Raises LogError."""
    options.refuse_but("ulog")
    log = _open(source)
    if progress:
        progress(0.8)
    topics: dict[str, Topic] = {d.name: d.data for d in reversed(log.data_list)}  # of several instances the first
    notes: list[str] = []
    if log.file_corruption:
        notes.append(f"{source.name}: damaged in places; the rest was read")
    elif not log.has_data_appended and _ends_within_a_message(source):
        notes.append(f"{source.name}: torn; read as far as it goes")
    receiver = _receiver(log.data_list, notes)
    clock = _clock(receiver, notes)
    imu = _imu(source, topics, clock, notes)
    aids = [*(_gnss(source, receiver, clock, notes) if receiver else []), *_baro(topics, clock), *_field(topics, clock)]
    aids += [*_airspeed(topics, clock), *_range(log.data_list, clock)]
    aids += [*_attitude(topics, clock, notes), *_odometry(topics, clock, notes)]
    aids += _flow(topics, clock, [imu, *aids], notes) + _landed(topics, clock)
    others = _other_imus(log.data_list, clock, notes)
    truth, origin = _truth(topics, receiver, clock, notes)
    delay_s = float(log.initial_parameters.get("EKF2_GPS_DELAY", 0.0)) * 1e-3
    if receiver is not None and np.any(receiver.get("timestamp_sample", 0)):
        delay_s = 0.0  # the receiver's driver has already said when the fix was valid
    if truth and aids and aids[0].topic == "/gnss":
        origin = sensors.origin_of_truth(aids[0], truth, delay_s, origin)
    altitude = "above the ellipsoid where PX4 reports it, else above mean sea level"
    settings = Settings(gnss_delay_s=delay_s, origin=origin if receiver else None, altitude=altitude)
    reference = recording.AUTOPILOT if truth and not _simulated(topics) else ""
    return Recording.of((*aids, imu, *others, *([truth] if truth else [])), settings, notes, reference)


def _landed(topics: Mapping[str, Topic], clock_us: int) -> list[Stream]:
    topic = topics.get("vehicle_land_detected")
    if topic is None:
        return []
    return [recording.sensor("rest", *_times(topic, clock_us), np.where(topic["landed"] > 0, _GROUND, _AIR)[:, np.newaxis])]


def _receiver(data: Sequence[Any], notes: list[str]) -> Topic | None:
    receivers = [d for name in ("vehicle_gps_position", "sensor_gps") for d in data if d.name == name]
    if not receivers:
        return None
    fixes = [int(np.count_nonzero(d.data["fix_type"] >= _FIX_3D)) for d in receivers]
    k = int(np.argmax(fixes))
    if k:
        notes.append(
            f"GNSS of {receivers[k].name} {receivers[k].multi_id}: {receivers[0].name} has {fixes[0]} fixes, it has {fixes[k]}"
        )
    topic: Topic = receivers[k].data
    return topic


class _Finite(io.BufferedReader):
    """A file that ends after twice its size: pyulog loops on some damage."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._furthest, self._standing, self._patience = 0, 0, 1000 + 2 * path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        self._standing += 1
        if (place := self.tell()) > self._furthest:
            self._furthest, self._standing = place, 0
        if self._standing > self._patience:
            raise LogError("damaged beyond reading")
        return super().read(size)


def _open(source: Path) -> Any:
    try:
        from pyulog import ULog  # noqa: PLC0415 (an extra)
    except ModuleNotFoundError:
        raise LogError("reading PX4 logs needs pyulog: pip install 'landfix[tools]'") from None
    try:
        file = _Finite(source)
    except OSError as error:
        raise LogError(f"{source}: {error.strerror}") from None
    with file:
        magic = file.read(len(_MAGIC))
        if magic != _MAGIC:
            raise LogError(f"{source.name}: {'not a PX4 log (.ulg)' if magic else 'the file is empty'}")
        file.seek(0)
        try:
            with silence():
                return ULog(file, list(_WANTED))
        except Exception as error:  # pyulog raises whatever a damaged header makes it stumble over
            raise LogError(f"{source.name}: cannot be read as a PX4 log: {_words(error)}") from None


def _words(error: Exception) -> str:
    return "damaged" if isinstance(error, OSError) else str(error)


def _ends_within_a_message(source: Path) -> bool:
    """Message: size (2 bytes), kind (1), content."""
    with source.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        at, end = _HEADER_BYTES, len(data)
        while at + 3 <= end:
            at += 3 + data[at] + 256 * data[at + 1]
        return at != end


def _clock(receiver: Topic | None, notes: list[str]) -> int:
    if receiver is not None and receiver["timestamp"][0] > _UNIX_US:
        return 0
    if receiver is not None:
        dated = np.flatnonzero(receiver.get("time_utc_usec", np.zeros(1)) > _UNIX_US)
        if len(dated):
            k = dated[0]
            return int(receiver["time_utc_usec"][k]) - int(receiver["timestamp"][k])
    notes.append("the log does not know the date: stamps count from 2023-11-14T22:13:20Z")
    return EPOCH_NS // 1000


def _odometry(topics: Mapping[str, Topic], clock_us: int, notes: list[str]) -> list[Stream]:
    topic = topics.get("vehicle_visual_odometry", topics.get("vehicle_mocap_odometry"))
    names = [f"{field}[{k}]" for field, size in (("position", 3), ("q", 4)) for k in range(size)]
    names = names if topic is None or names[0] in topic else ["x", "y", "z", *names[3:]]
    if topic is None or any(name not in topic for name in names):
        return []
    t_ns, arrived_ns = _times(topic, clock_us)
    p, q = (np.stack([topic[name] for name in part], axis=1).astype(float) for part in (names[:3], names[3:]))
    run = np.asarray(topic.get("reset_counter", np.zeros(len(t_ns))), dtype=float)
    stream = recording.odometry(t_ns, arrived_ns, p, q, run)
    if len(stream):
        notes.append("poses from outside (vehicle_visual_odometry) are /odometry; the configuration says how to use them")
    return [stream] if len(stream) else []


def _flow(topics: Mapping[str, Topic], clock_us: int, streams: Sequence[Stream], notes: list[str]) -> list[Stream]:
    topic = topics.get("vehicle_optical_flow")
    if topic is None or any(name not in topic for name in _FLOW):
        return []
    rows = np.flatnonzero(topic["quality"] > 0)
    t_ns, arrived_ns = (times[rows] for times in _times(topic, clock_us))
    dt_ns = topic["integration_timespan_us"][rows].astype(np.int64) * 1000
    seen, turn = _vector(topic, *_FLOW[:2])[rows], _vector(topic, *_FLOW[2:5])[rows]
    return steps.flow(t_ns, arrived_ns, dt_ns, seen, turn, topic["distance_m"][rows].astype(float), streams, notes)


def _times(topic: Topic, clock_us: int) -> tuple[Times, Times]:
    published = np.minimum(topic["timestamp"], _FAR_US).astype(np.int64)
    sampled = np.minimum(topic["timestamp_sample"], _FAR_US).astype(np.int64) if "timestamp_sample" in topic else published
    sampled = np.where(sampled > 0, sampled, published)
    return (sampled + clock_us) * 1000, recording.arrival((published + clock_us) * 1000)


def _vector(topic: Topic, *names: str) -> Array:
    return np.stack([topic[name] for name in names], axis=1).astype(np.float64)


def _imu(source: Path, topics: Mapping[str, Topic], clock_us: int, notes: list[str]) -> Stream:
    if "sensor_combined" in topics:
        topic = topics["sensor_combined"]
        gyro_b = _vector(topic, "gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]")
        accel_b = _vector(topic, "accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]")
        t_ns, arrived_ns = _times(topic, clock_us)
    elif "sensor_gyro" in topics and "sensor_accel" in topics:
        topic = topics["sensor_gyro"]
        gyro_b = _vector(topic, "x", "y", "z")
        t_ns, arrived_ns = _times(topic, clock_us)
        accel = _vector(topics["sensor_accel"], "x", "y", "z")
        t_accel, _ = _times(topics["sensor_accel"], clock_us)
        accel_b = np.stack([np.interp(t_ns - t_ns[0], t_accel - t_ns[0], column) for column in accel.T], axis=1)
        notes.append("no sensor_combined: raw sensor_gyro, with sensor_accel interpolated to its stamps")
    else:
        raise LogError(f"{source.name}: no IMU in it (sensor_combined, or sensor_gyro with sensor_accel)")
    notes += sensors.check_imu(gyro_b, accel_b, source.name) + sensors.check_rate(t_ns, source.name)
    return recording.imu(t_ns, arrived_ns, gyro_b, accel_b)


def _other_imus(data: Sequence[Any], clock_us: int, notes: list[str]) -> list[Stream]:
    chosen = [d.data["gyro_device_id"][0] for d in data if d.name == "sensor_selection" and "gyro_device_id" in d.data]
    if not chosen:
        return []
    streams: list[Stream] = []
    for topic in (d.data for d in data if d.name == "vehicle_imu" and d.data["gyro_device_id"][0] != chosen[0]):
        t_ns, arrived_ns = _times(topic, clock_us)
        turn_us, push_us = (topic[f"delta_{part}_dt"].astype(np.int64) for part in ("angle", "velocity"))
        rows = (turn_us > 0) & (push_us > 0)
        if np.count_nonzero(rows) < 2 or np.median(np.diff(t_ns[rows])) > _SLOWEST_IMU_NS:
            notes.append("another IMU (vehicle_imu) is logged too slowly to take over: SDLOG_PROFILE with bit 4 (high rate)")
            continue
        gyro_b = _vector(topic, *(f"delta_angle[{k}]" for k in range(3)))[rows] / (1e-6 * turn_us[rows, np.newaxis])
        accel_b = _vector(topic, *(f"delta_velocity[{k}]" for k in range(3)))[rows] / (1e-6 * push_us[rows, np.newaxis])
        middle_ns = t_ns[rows] - 500 * turn_us[rows]
        streams.append(recording.imu(middle_ns, arrived_ns[rows], gyro_b, accel_b, f"/imu{len(streams) + 2}"))
    return streams


def _place(topic: Topic) -> tuple[Array, Array]:
    """(n, 3) deg, deg, m above the ellipsoid, else the sea; and (n,) their difference."""
    if "latitude_deg" in topic:
        lla, ellipsoid = _vector(topic, "latitude_deg", "longitude_deg", "altitude_msl_m"), _vector(topic, "altitude_ellipsoid_m")
    else:
        lla, ellipsoid = _vector(topic, "lat", "lon", "alt") * [1e-7, 1e-7, 1e-3], _vector(topic, "alt_ellipsoid") * 1e-3
    geoid = np.where(ellipsoid[:, 0] != 0.0, ellipsoid[:, 0] - lla[:, 2], 0.0)
    lla[:, 2] += geoid
    return lla, geoid


def _gnss(source: Path, topic: Topic, clock_us: int, notes: list[str]) -> list[Stream]:
    lla, geoid = _place(topic)
    sensors.check_place(lla, source.name)
    if not geoid.any():
        notes.append("GNSS heights are above sea level (no other known); set [map] geoid_m to have them above the ellipsoid")
    t_ns, arrived_ns = _times(topic, clock_us)
    status = sensors.navsat_status(topic["fix_type"])
    variance = _squared(_vector(topic, "eph", "eph", "epv"))  # PX4 takes eph as one sigma per axis
    moving = np.flatnonzero((topic["vel_ned_valid"] != 0) & (status >= 0))
    v_n = _vector(topic, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s")[moving]
    speed_sigma = topic["s_variance_m_s"][moving].astype(np.float64)  # m/s, despite its name
    speed_variance = np.repeat(_squared(speed_sigma)[:, np.newaxis], 3, axis=1)
    unknown = np.zeros(len(t_ns))
    flags = receiver_state(topic.get("jamming_state", unknown), topic.get("spoofing_state", unknown))
    if flags.any():
        notes.append(f"the receiver reports jamming or spoofing in {np.count_nonzero(flags)} of {len(flags)} fixes")
    signal = (topic.get(f, unknown) for f in ("noise_per_ms", "automatic_gain_control", "jamming_indicator"))
    notes += sensors.reception("/gnss", *signal) + sensors.authentication("/gnss", topic.get("authentication_state", unknown))
    streams = [recording.gnss(t_ns, arrived_ns, lla, variance, status, flags=flags)]
    if len(moving):
        streams.append(recording.gnss_velocity(t_ns[moving], arrived_ns[moving], v_n, speed_variance))
    return [*streams, *_heading(topic, clock_us)]


def _squared(sigma: Array) -> Array:
    """Variance; nan for sigma 0 (unknown)."""
    return np.where(sigma > 0.0, np.square(sigma), np.nan)


def _baro(topics: Mapping[str, Topic], clock_us: int) -> list[Stream]:
    topic = topics.get("vehicle_air_data")
    if topic is None or "baro_pressure_pa" not in topic:
        return []
    t_ns, arrived_ns = _times(topic, clock_us)
    return [recording.sensor("baro", t_ns, arrived_ns, _vector(topic, "baro_pressure_pa"))]


def _heading(topic: Topic, clock_us: int) -> list[Stream]:
    """Two-antenna heading; heading_offset: their line from the nose."""
    if "heading" not in topic:
        return []
    azimuth = topic["heading"].astype(np.float64) - topic.get("heading_offset", 0.0)
    rows = np.flatnonzero(np.isfinite(azimuth) & (topic["heading"] != 0.0))
    t_ns, arrived_ns = _times(topic, clock_us)
    azimuth = np.remainder(azimuth[rows] + np.pi, 2.0 * np.pi) - np.pi
    return [recording.sensor("heading", t_ns[rows], arrived_ns[rows], azimuth[:, np.newaxis])] if len(rows) else []


def _field(topics: Mapping[str, Topic], clock_us: int) -> list[Stream]:
    topic, names = topics.get("vehicle_magnetometer"), ("magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]")
    if topic is None:
        topic, names = topics.get("sensor_mag"), ("x", "y", "z")
    if topic is None or names[0] not in topic:
        return []
    return [recording.sensor("magnetometer", *_times(topic, clock_us), sensors.GAUSS_T * _vector(topic, *names))]


def _airspeed(topics: Mapping[str, Topic], clock_us: int) -> list[Stream]:
    topic = topics.get("airspeed_validated", topics.get("airspeed"))
    if topic is None or "true_airspeed_m_s" not in topic:
        return []
    source = topic.get("airspeed_source", topic.get("airspeed_sensor_measurement_valid", np.ones(1)))
    rows = np.flatnonzero(np.isfinite(topic["true_airspeed_m_s"]) & (source >= 1) & (source < _SYNTHETIC))
    t_ns, arrived_ns = _times(topic, clock_us)
    values = _vector(topic, "true_airspeed_m_s")[rows]
    return [recording.sensor("airspeed", t_ns[rows], arrived_ns[rows], values)] if len(rows) else []


def _range(data: Sequence[Any], clock_us: int) -> list[Stream]:
    topic = next((d.data for d in data if d.name == "distance_sensor" and (d.data["orientation"] == _DOWNWARDS).all()), None)
    if topic is None:
        return []
    z_m = topic["current_distance"].astype(np.float64)
    is_within = (z_m >= topic["min_distance"]) & (z_m <= topic["max_distance"]) & (topic.get("signal_quality", -1) != 0)
    return [recording.sensor("range", *_times(topic, clock_us), np.where(is_within, z_m, np.inf)[:, np.newaxis])]


def _attitude(topics: Mapping[str, Topic], clock_us: int, notes: list[str]) -> list[Stream]:
    """Where EKF2's yaw is aligned: before, and without a compass, its heading may be anything."""
    topic, status = topics.get("vehicle_attitude"), topics.get("estimator_status")
    if topic is None:
        return []
    q_nb = _vector(topic, "q[0]", "q[1]", "q[2]", "q[3]")
    if status is not None and "control_mode_flags" in status:
        newest = np.searchsorted(status["timestamp"], topic["timestamp"], side="right") - 1
        aligned = (status["control_mode_flags"].astype(np.uint64) >> _YAW_ALIGNED & 1)[np.maximum(newest, 0)] > 0
        if not aligned.any():
            notes.append("PX4's attitude is left out: its yaw is never aligned (no compass?), and the heading may be anything")
            return []
        q_nb = np.where(aligned[:, np.newaxis], q_nb, np.nan)
    return [recording.attitude(*_times(topic, clock_us), q_nb)]


def _simulated(topics: Mapping[str, Topic]) -> bool:
    return "vehicle_local_position_groundtruth" in topics


def _truth(
    topics: Mapping[str, Topic], receiver: Topic | None, clock_us: int, notes: list[str]
) -> tuple[Stream | None, Vec3 | None]:
    suffix = "_groundtruth" if _simulated(topics) else ""
    position, attitude = topics.get(f"vehicle_local_position{suffix}"), topics.get(f"vehicle_attitude{suffix}")
    if position is None or attitude is None:
        notes.append("no reference in it (vehicle_local_position with vehicle_attitude)")
        return None, None
    valid = (position["xy_valid"] != 0) & (position["z_valid"] != 0)
    if not valid.any():
        notes.append("no reference in it: vehicle_local_position is never valid")
        return None, None
    if not suffix:
        notes.append(f"/truth is {recording.AUTOPILOT}, of the same sensors: a reference, no ground truth")
    origin = None
    if np.isfinite(position["ref_lat"][valid]).any():
        k = np.flatnonzero(valid & np.isfinite(position["ref_lat"]))[-1]
        valid &= position["ref_timestamp"] == position["ref_timestamp"][k]  # positions from before the origin moved are elsewhere
        geoid = float(np.median(_place(receiver)[1])) if receiver is not None else 0.0
        origin = (float(position["ref_lat"][k]), float(position["ref_lon"][k]), float(position["ref_alt"][k]) + geoid)
    rows = np.flatnonzero(valid)
    t_ns, t_attitude = _times(position, clock_us)[0][rows], _times(attitude, clock_us)[0]
    q_nb = frames.attitude_at(t_ns, t_attitude, _vector(attitude, "q[0]", "q[1]", "q[2]", "q[3]"), _ATTITUDE_GAP_NS)
    p_n, v_n = (_vector(position, *names)[rows] for names in (("x", "y", "z"), ("vx", "vy", "vz")))
    return recording.truth(t_ns, p_n, v_n, q_nb), origin
