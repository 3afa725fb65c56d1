"""PX4 logs: every value against pyulog, on logs of v1.8, v1.14 and v1.15."""

import math
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyulog", reason="the extra tools is not installed")

from pyulog import ULog

from logs.importers import ulog
from logs.importers.recording import EPOCH_NS, ImportOptions, Recording, Times, Truth
from logs.store.reader import LogError
from models import so3
from models.messages import (
    Array,
    AttitudePrior,
    GnssFix,
    GnssVelocity,
    ImuSample,
    OdometryDelta,
    OdometryPose,
    Reading,
    ReceiverState,
)

LOGS = ["px4_fmuv6c_6s.ulg", "px4_sitl_groundtruth_28s.ulg", "px4_sitl_v115_31s.ulg"]  # v1.14.3, v1.8, v1.15


class Case:
    """A log as imported, and as pyulog has it."""

    def __init__(self, path: Path) -> None:
        self.recording: Recording = ulog.read(path)
        self.log = ULog(str(path))
        self.messages = list(self.recording)
        self.version = path.name

    def topic(self, name: str) -> dict[str, Array]:
        data: dict[str, Array] = next(d for d in self.log.data_list if d.name == name).data
        return data

    def t_ns(self, name: str, field: str = "timestamp") -> Times:
        """Stamps of a topic on the clock of the recording, from the first IMU sample."""
        first = int(self.topic("sensor_combined")["timestamp"][0])
        imu = self.recording.stream("/imu")
        assert imu is not None
        stamps: Times = (self.topic(name)[field].astype(np.int64) - first) * 1000 + imu.t_ns[0]
        return stamps


def stack(topic: dict[str, Array], *names: str) -> Array:
    return np.stack([topic[name] for name in names], axis=1).astype(np.float64)


@pytest.fixture(scope="module", params=LOGS)
def case(request: pytest.FixtureRequest, landfix_data: Path) -> Case:
    return Case(landfix_data / "native_logs" / request.param)


def test_every_imu_sample(case: Case) -> None:
    topic = case.topic("sensor_combined")
    got = [m for m in case.messages if isinstance(m, ImuSample)]
    np.testing.assert_array_equal([m.gyro_b for m in got], stack(topic, *(f"gyro_rad[{k}]" for k in range(3))))
    np.testing.assert_array_equal([m.accel_b for m in got], stack(topic, *(f"accelerometer_m_s2[{k}]" for k in range(3))))
    np.testing.assert_array_equal([m.t_ns for m in got], case.t_ns("sensor_combined"))


def test_the_date_is_that_of_the_receiver(case: Case) -> None:
    start = {
        "px4_fmuv6c_6s.ulg": 1765331252_249561_000 - (27704335 - 27329869) * 1000,  # the first fix's UTC, less the time to it
        "px4_sitl_groundtruth_28s.ulg": EPOCH_NS + 375484685_000,  # no date in it
        "px4_sitl_v115_31s.ulg": 1710773350354000_000,  # its stamps count from 1970
    }[case.version]
    imu = case.recording.stream("/imu")
    assert imu is not None
    assert imu.t_ns[0] == start


def test_every_fix(case: Case) -> None:
    topic = case.topic("vehicle_gps_position")
    got = [m for m in case.messages if isinstance(m, GnssFix)]
    if "lat" in topic:
        place = stack(topic, "lat", "lon", "alt") * [1e-7, 1e-7, 1e-3]
        if case.version == "px4_fmuv6c_6s.ulg":
            place[:, 2] = topic["alt_ellipsoid"] * 1e-3
    else:
        place = stack(topic, "latitude_deg", "longitude_deg", "altitude_ellipsoid_m")
    np.testing.assert_allclose([(m.lat_deg, m.lon_deg, m.alt_m) for m in got], place, rtol=0, atol=1e-9)
    assert [m.status >= 0 for m in got] == (topic["fix_type"] >= 3).tolist()
    np.testing.assert_array_equal([m.arrived_ns for m in got], case.t_ns("vehicle_gps_position"))
    sigma = [np.sqrt(np.diag(m.covariance_n)) for m in got if m.covariance_n is not None]
    np.testing.assert_allclose(sigma, stack(topic, "eph", "eph", "epv"), rtol=1e-6)


def test_every_velocity_of_a_fix_that_has_one(case: Case) -> None:
    topic = case.topic("vehicle_gps_position")
    good = (topic["vel_ned_valid"] != 0) & (topic["fix_type"] >= 3)
    got = [m for m in case.messages if isinstance(m, GnssVelocity)]
    assert [m.v_n for m in got] == list(map(tuple, stack(topic, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s")[good].tolist()))
    assert len(got) == {"px4_fmuv6c_6s.ulg": 13, "px4_sitl_groundtruth_28s.ulg": 0, "px4_sitl_v115_31s.ulg": 423}[case.version]


def test_every_magnetic_field_is_in_tesla(case: Case) -> None:
    name, axes = "vehicle_magnetometer", ("magnetometer_ga[0]", "magnetometer_ga[1]", "magnetometer_ga[2]")
    if all(d.name != name for d in case.log.data_list):
        name, axes = "sensor_mag", ("x", "y", "z")
    got = [m.values for m in case.messages if isinstance(m, Reading) and m.kind == "magnetometer"]
    np.testing.assert_allclose(got, 1e-4 * stack(case.topic(name), *axes), rtol=1e-9)


def test_every_pressure(case: Case) -> None:
    topic = case.topic("vehicle_air_data")
    got = [m for m in case.messages if isinstance(m, Reading) and m.kind == "baro"]
    np.testing.assert_array_equal([m.values[0] for m in got], topic["baro_pressure_pa"].astype(np.float64))
    np.testing.assert_array_equal([m.arrived_ns for m in got], case.t_ns("vehicle_air_data"))
    if "timestamp_sample" in topic:
        np.testing.assert_array_equal([m.t_ns for m in got], case.t_ns("vehicle_air_data", "timestamp_sample"))
        assert any(m.t_ns < m.arrived_ns for m in got)


def test_truth_is_ground_truth_where_there_is_one_else_the_estimate(case: Case) -> None:
    suffix = "_groundtruth" if case.version == "px4_sitl_groundtruth_28s.ulg" else ""
    topic, attitude = case.topic(f"vehicle_local_position{suffix}"), case.topic(f"vehicle_attitude{suffix}")
    valid = (topic["xy_valid"] != 0) & (topic["z_valid"] != 0) & (topic["ref_timestamp"] == topic["ref_timestamp"][-1])
    assert valid.sum() > 50
    got = [m for m in case.messages if isinstance(m, Truth)]
    np.testing.assert_array_equal([m.p_n for m in got], stack(topic, "x", "y", "z")[valid])
    np.testing.assert_array_equal([m.v_n for m in got], stack(topic, "vx", "vy", "vz")[valid])
    q = np.array([m.q_nb_wxyz for m in got])
    stamps = case.t_ns(f"vehicle_attitude{suffix}")
    nearest = np.clip(np.searchsorted(stamps, [m.t_ns for m in got]), 0, len(stamps) - 1)
    near = stack(attitude, "q[0]", "q[1]", "q[2]", "q[3]")[nearest]
    given = np.isfinite(q).all(axis=1)
    assert given.mean() > 0.95
    assert np.abs(np.sum(q * near, axis=1))[given].min() > np.cos(np.deg2rad(3.0))  # half angle: within 6 degrees of a neighbour
    assert any("autopilot's own estimate" in note for note in case.recording.notes) == (not suffix)


def test_the_attitude_to_begin_with_is_the_autopilots_even_where_there_is_ground_truth(case: Case) -> None:
    topic = case.topic("vehicle_attitude")
    stamps = case.t_ns("vehicle_attitude", "timestamp_sample" if "timestamp_sample" in topic else "timestamp")
    known = dict(zip(stamps.tolist(), stack(topic, *(f"q[{k}]" for k in range(4))).tolist(), strict=True))
    got = [m for m in case.messages if isinstance(m, AttitudePrior)]
    assert len(got) >= 10
    assert all(list(m.q_nb_wxyz) == known[m.t_ns] for m in got)


def test_the_origin_is_above_the_same_surface_as_the_fixes(case: Case) -> None:
    origin = case.recording.settings.origin
    assert origin is not None
    expected = {
        "px4_fmuv6c_6s.ulg": (36.3691643, 127.3683646, 51.5585 + 19.992),  # sea level + what ellipsoid and sea level differ by
        "px4_sitl_groundtruth_28s.ulg": (40.7423005, -74.1793004, 28.5),  # the log's own height, 0, contradicts its fixes
        "px4_sitl_v115_31s.ulg": (47.3977418, 8.5455939, 487.957),
    }[case.version]
    np.testing.assert_allclose(origin, expected, atol=2e-2)
    np.testing.assert_allclose(origin[:2], expected[:2], atol=1e-7)


def test_the_delay_of_gnss_is_the_autopilots(case: Case) -> None:
    assert case.recording.settings.gnss_delay_s == pytest.approx(0.11)


# --- logs written here -------------------------------------------------------------------------------------------------------


def message(kind: bytes, content: bytes) -> bytes:
    return struct.pack("<Hc", len(content), kind) + content


def written(folder: Path, **topics: list[dict[str, float]]) -> Path:
    """A log of these topics, all fields but the stamps double."""
    log = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    for name, rows in topics.items():
        fields = ";".join(f"{'uint64_t' if 'timestamp' in field else 'double'} {field}" for field in rows[0])
        log += message(b"F", f"{name}:{fields};".encode())
    for k, name in enumerate(topics):
        log += message(b"A", struct.pack("<BH", 0, k) + name.encode())
    for k, rows in enumerate(topics.values()):
        for row in rows:
            form = "<H" + "".join("Q" if "timestamp" in field else "d" for field in row)
            log += message(b"D", struct.pack(form, k, *row.values()))
    path = folder / "log.ulg"
    path.write_bytes(log)
    return path


GYROS = [{"timestamp": 1000 + 2500 * k, "timestamp_sample": 900 + 2500 * k, "x": 0.1 * k, "y": 0.2, "z": 0.3} for k in range(8)]
ACCELS = [{"timestamp": 2000 + 5000 * k, "timestamp_sample": 900 + 5000 * k, "x": 1.0 * k, "y": 0.0, "z": -9.8} for k in range(5)]


def test_gyro_and_accelerometer_of_their_own_are_brought_together(tmp_path: Path) -> None:
    recording = ulog.read(written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS))
    got = [m for m in recording if isinstance(m, ImuSample)]
    assert [m.t_ns - EPOCH_NS for m in got] == [(900 + 2500 * k) * 1000 for k in range(8)]
    assert [m.arrived_ns - m.t_ns for m in got] == [100_000] * 8
    np.testing.assert_allclose([m.gyro_b for m in got], [[0.1 * k, 0.2, 0.3] for k in range(8)])
    np.testing.assert_allclose([m.accel_b for m in got], [[0.5 * k, 0.0, -9.8] for k in range(8)])
    assert any("sensor_accel interpolated" in note for note in recording.notes)


@pytest.mark.parametrize("period_us", [10_000, 500_000])
def test_an_imu_that_the_autopilot_did_not_choose_is_one_more_where_it_is_logged_fast_enough(
    tmp_path: Path, period_us: int
) -> None:
    stamps = [1000 + period_us * k for k in range(6)]
    first = [
        {"timestamp": t, **{f"gyro_rad[{k}]": 0.1 for k in range(3)}, **{f"accelerometer_m_s2[{k}]": -9.8 for k in range(3)}}
        for t in stamps
    ]
    increments = {**{f"delta_angle[{k}]": 2e-4 * k for k in range(3)}, **{f"delta_velocity[{k}]": 1e-2 * k for k in range(3)}}
    second = [
        {"timestamp": t, "gyro_device_id": 7.0, **increments, "delta_angle_dt": 4000.0, "delta_velocity_dt": 5000.0}
        for t in stamps
    ]
    selection = [{"timestamp": 900, "gyro_device_id": 3.0}]
    recording = ulog.read(written(tmp_path, sensor_combined=first, vehicle_imu=second, sensor_selection=selection))
    other = recording.stream("/imu2")
    if period_us > 50_000:
        assert other is None
        assert any("too slowly to take over" in note for note in recording.notes)
        return
    assert other is not None
    leading = recording.stream("/imu")
    assert leading is not None
    np.testing.assert_array_equal(leading.t_ns - other.t_ns, 2_000_000)  # half of the 4 ms of the increment
    got = next(m for m in recording if isinstance(m, ImuSample) and m.topic == "/imu2")
    np.testing.assert_allclose(got.gyro_b, [0.0, 0.05, 0.1])
    np.testing.assert_allclose(got.accel_b, [0.0, 2.0, 4.0])
    assert 'imu = ["/imu", "/imu2"]' in recording.settings.toml("ulog", tmp_path, tuple(s.topic for s in recording.streams))


@pytest.mark.parametrize("names", [("position[0]", "position[1]", "position[2]"), ("x", "y", "z")])
def test_poses_from_outside_are_an_odometry_that_begins_anew_at_a_reset(tmp_path: Path, names: tuple[str, ...]) -> None:
    attitude = {"q[0]": 1.0, "q[1]": 0.0, "q[2]": 0.0, "q[3]": 0.0}
    rows = [
        {
            "timestamp": 5000 * k + 300,
            "timestamp_sample": 5000 * k,
            **dict.fromkeys(names, 1.0 * k),
            **attitude,
            "reset_counter": k // 2,
        }
        for k in range(1, 4)
    ]
    rows.append({**rows[-1], names[0]: math.nan})
    recording = ulog.read(written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS, vehicle_visual_odometry=rows))
    poses = [m for m in recording if isinstance(m, OdometryPose)]
    assert [m.t_ns - EPOCH_NS for m in poses] == [5_000_000, 10_000_000, 15_000_000]
    assert [m.p_o for m in poses] == [(1.0 * k,) * 3 for k in (1, 2, 3)]
    assert [m.frame for m in poses] == ["odom 0", "odom 1", "odom 1"]
    assert not [m for m in ulog.read(written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS)) if isinstance(m, OdometryPose)]


@pytest.mark.parametrize("own", [True, False])
def test_flow_over_its_range_or_the_range_finders_is_motion_over_the_ground(tmp_path: Path, own: bool) -> None:
    """3 m/s forward, 1 to the right, 10 m above ground; pitching at 0.2 and turning at 0.5 rad/s: its gyroscope or the IMU."""
    imu = [{"timestamp": 5000 * k, "timestamp_sample": 5000 * k, "x": 0.0, "y": 0.2, "z": 0.5} for k in range(1, 100)]
    accel = [{**row, "y": 0.0, "z": -9.8} for row in imu]
    turn = np.array([0.0, 0.01, 0.025])
    rows = [
        {
            "timestamp": 50_000 * k + 400,
            "timestamp_sample": 50_000 * k,
            "pixel_flow[0]": -0.05 / 10.0,
            "pixel_flow[1]": 0.15 / 10.0 + 0.01,
            **{f"delta_angle[{axis}]": turn[axis] if own else math.nan for axis in range(3)},
            "distance_m": 10.0 if own else math.nan,
            "integration_timespan_us": 50_000,
            "quality": 0 if k == 1 else 180,
        }
        for k in range(1, 6)
    ]
    finder = [
        {
            "timestamp": 20_000 * k,
            "current_distance": 10.0,
            "min_distance": 0.1,
            "max_distance": 40.0,
            "signal_quality": 80,
            "orientation": 25,
        }
        for k in range(1, 20)
    ]
    topics = {} if own else {"distance_sensor": finder}
    path = written(tmp_path, sensor_gyro=imu, sensor_accel=accel, vehicle_optical_flow=rows, **topics)
    (delta,) = (m for m in ulog.read(path) if isinstance(m, OdometryDelta))
    assert [(t - EPOCH_NS) // 1000 for t in (delta.t0_ns, delta.t_ns, delta.arrived_ns)] == [50_000, 250_000, 250_400]
    dp, R = np.zeros(3), np.eye(3)
    for _ in range(4):
        dp += R @ so3.matrix(so3.quat_exp(0.5 * turn)) @ np.array([0.15, 0.05, 0.0])
        R = R @ so3.matrix(so3.quat_exp(turn))
    np.testing.assert_allclose(delta.dp_b, dp, atol=1e-6)
    np.testing.assert_allclose(so3.matrix(np.array(delta.dq_wxyz)), R, atol=1e-6)
    np.testing.assert_allclose(np.diag(delta.covariance)[:2], 4 * (10.0 * 0.15 * 0.05) ** 2)


def test_of_a_reference_whose_origin_moved_the_last_part_is_taken(tmp_path: Path) -> None:
    place = {"xy_valid": 1.0, "z_valid": 1.0, "ref_lat": 47.0, "ref_lon": 8.0, "ref_alt": 500.0, "vx": 0.0, "vy": 0.0, "vz": 0.0}
    positions = [
        {"timestamp": 1000 * k, "ref_timestamp": 5 * (k > 3), "x": 1.0 * k, "y": 0.0, "z": 0.0, **place} for k in range(1, 9)
    ]
    positions[-1]["xy_valid"] = 0.0
    attitudes = [{"timestamp": 2000 * k, "q[0]": 1.0, "q[1]": 0.0, "q[2]": 0.0, "q[3]": 0.0} for k in range(10)]
    path = written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS, vehicle_local_position=positions, vehicle_attitude=attitudes)
    truths = [m for m in ulog.read(path) if isinstance(m, Truth)]
    assert [m.p_n for m in truths] == [(float(k), 0.0, 0.0) for k in (4, 5, 6, 7)]
    assert [m.q_nb_wxyz for m in truths] == [(1.0, 0.0, 0.0, 0.0)] * 4


@pytest.mark.parametrize(("aligned", "count"), [((0, 0), 0), ((0, 1), 4), ((1, 1), 5)])
def test_a_heading_that_is_not_aligned_is_not_taken(tmp_path: Path, aligned: tuple[int, int], count: int) -> None:
    attitudes = [{"timestamp": 500_000 * k, "q[0]": 1.0, "q[1]": 0.0, "q[2]": 0.0, "q[3]": 0.0} for k in range(5)]
    states = [{"timestamp": 100_000 + 300_000 * k, "control_mode_flags": 1.0 + 2.0 * is_so} for k, is_so in enumerate(aligned)]
    path = written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS, vehicle_attitude=attitudes, estimator_status=states)
    recording = ulog.read(path)
    assert sum(isinstance(m, AttitudePrior) for m in recording) == count
    assert any("never aligned" in note for note in recording.notes) == (count == 0)


def test_an_autopilot_that_never_knew_its_position_is_no_reference(tmp_path: Path) -> None:
    place = {"xy_valid": 0.0, "z_valid": 1.0, "ref_lat": math.nan, "ref_lon": math.nan, "ref_alt": math.nan, "ref_timestamp": 0}
    positions = [
        {"timestamp": 1000 * k, "x": 0.0, "y": 0.0, "z": 0.0, "vx": 0.0, "vy": 0.0, "vz": 0.0, **place} for k in range(9)
    ]
    attitudes = [{"timestamp": 2000 * k, "q[0]": 1.0, "q[1]": 0.0, "q[2]": 0.0, "q[3]": 0.0} for k in range(10)]
    path = written(tmp_path, sensor_gyro=GYROS, sensor_accel=ACCELS, vehicle_local_position=positions, vehicle_attitude=attitudes)
    recording = ulog.read(path)
    assert not any(isinstance(m, Truth) for m in recording)
    assert [note for note in recording.notes if "/truth" in note or "reference" in note] == [
        "no reference in it: vehicle_local_position is never valid"
    ]


def test_pyulog_walking_in_a_circle_is_stopped(tmp_path: Path) -> None:
    """A message of an unknown type that claims more bytes than follow makes pyulog step back for ever."""
    path = tmp_path / "log.ulg"
    before = message(b"B", bytes(40)) + message(b"F", b"padding:" + b"double x;" * 7000)
    path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + before + struct.pack("<Hc", 60_000, b"?") + b"?" * 90)
    with pytest.raises(LogError, match=r"log\.ulg: cannot be read as a PX4 log: damaged beyond reading"):
        ulog.read(path)


def test_a_torn_log_is_read_as_far_as_it_goes(landfix_data: Path, tmp_path: Path) -> None:
    whole = landfix_data / "native_logs/px4_sitl_v115_31s.ulg"
    torn = tmp_path / "torn.ulg"
    data = whole.read_bytes()
    torn.write_bytes(data[: len(data) // 2 + 7])
    part, all_of_it = ulog.read(torn).stream("/imu"), ulog.read(whole).stream("/imu")
    assert part is not None
    assert all_of_it is not None
    assert 2000 < len(part) < len(all_of_it)
    for mine, theirs in zip(part.columns, all_of_it.columns, strict=True):
        np.testing.assert_array_equal(mine, theirs[: len(part)])


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "the file is empty"),
        (b"\xa3\x95\x80", "not a PX4 log"),
        (b"ULog\x01\x12\x35\x01" + bytes(8), "no IMU in it"),
        (b"ULog\x01\x12\x35", "cannot be read"),
    ],
)
def test_what_is_no_px4_log_is_reported_in_one_line(tmp_path: Path, content: bytes, line: str) -> None:
    path = tmp_path / "log.ulg"
    path.write_bytes(content)
    with pytest.raises(LogError) as raised:
        ulog.read(path)
    assert str(raised.value).startswith("log.ulg: ")
    assert line in str(raised.value)
    assert "\n" not in str(raised.value)


def test_options_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="--axes means nothing for ulog logs"):
        ulog.read(tmp_path, ImportOptions(axes="flu"))


def test_without_pyulog_the_user_learns_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(LogError, match=r"pip install 'landfix\[tools\]'"):
        ulog.read(tmp_path / "log.ulg")


@pytest.mark.parametrize(("jamming", "spoofing", "state"), [(0, 0, 0), (1, 1, 0), (3, 1, 1), (1, 2, 1), (0, 3, 2)])
def test_the_flags_of_the_receiver(landfix_data: Path, tmp_path: Path, jamming: int, spoofing: int, state: int) -> None:
    log = ULog(str(landfix_data / "native_logs" / LOGS[0]))
    topic = next(d for d in log.data_list if d.name == "vehicle_gps_position")
    topic.data["jamming_state"][:], topic.data["spoofing_state"][:] = jamming, spoofing
    (authentication,) = (field for field in topic.field_data if field.field_name == "selected_rtcm_instance")  # as wide
    authentication.field_name = "authentication_state"
    topic.data["authentication_state"] = topic.data.pop("selected_rtcm_instance")
    topic.data["authentication_state"][:3] = spoofing
    fields = log.message_formats[topic.name].fields
    fields[:] = [(kind, n, name.replace("selected_rtcm_instance", "authentication_state")) for kind, n, name in fields]
    log.write_ulog(str(tmp_path / "flagged.ulg"))
    recording = ulog.read(tmp_path / "flagged.ulg")
    assert {m.state for m in recording if isinstance(m, GnssFix)} == {ReceiverState(state)}
    assert any("jamming or spoofing" in note for note in recording.notes) == (state > 0)
    assert any("/gnss: authenticated in 3 of" in note for note in recording.notes) == (spoofing == 3)
