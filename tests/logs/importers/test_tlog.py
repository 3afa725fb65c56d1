"""MAVLink telemetry logs: every value against pymavlink on a flight full of radio errors; MAVLink 2 written here."""

import struct
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega, development
from pymavlink.dialects.v20 import common as mavlink2

from estimator.config import parse
from logs.importers import tlog
from logs.importers.recording import ImportOptions, Recording, Truth
from logs.store.reader import LogError
from models import so3
from models.messages import AttitudePrior, GnssFix, GnssVelocity, ImuSample, OdometryDelta, OdometryPose, Reading, ReceiverState


@pytest.fixture(scope="module")
def flown(landfix_data: Path) -> Path:
    return landfix_data / "native_logs/ardupilot_flight.tlog"


@pytest.fixture(scope="module")
def recording(flown: Path) -> Recording:
    return tlog.read(flown)


@pytest.fixture(scope="module")
def rows(flown: Path) -> dict[str, list[Any]]:
    """All messages, by pymavlink alone."""
    found: dict[str, list[Any]] = {}
    with closing(mavutil.mavlogfile(str(flown))) as log:
        while (message := log.recv_msg()) is not None:
            found.setdefault(message.get_type(), []).append(message)
    return found


def test_fixes_are_as_old_as_the_autopilot_takes_them_for(recording: Recording) -> None:
    assert recording.settings.gnss_delay_s == 0.2


def test_every_imu_sample(recording: Recording, rows: dict[str, list[Any]]) -> None:
    got = [m for m in recording if isinstance(m, ImuSample)]
    assert len(got) == 2856
    raw = rows["RAW_IMU"]
    np.testing.assert_allclose([m.gyro_b for m in got], [(r.xgyro * 1e-3, r.ygyro * 1e-3, r.zgyro * 1e-3) for r in raw])
    g = 9.80665e-3
    np.testing.assert_allclose([m.accel_b for m in got], [(r.xacc * g, r.yacc * g, r.zacc * g) for r in raw])
    np.testing.assert_allclose([m.arrived_ns * 1e-9 for m in got], [r._timestamp for r in raw], rtol=0, atol=1e-6)
    boots = np.flatnonzero(np.diff([r.time_usec for r in raw]) < 0) + 1
    assert len(boots) == 1  # the vehicle was switched off and on again
    for part in (slice(0, boots[0]), slice(boots[0], None)):
        np.testing.assert_array_equal(np.diff([m.t_ns for m in got[part]]), np.diff([r.time_usec * 1000 for r in raw[part]]))


def test_damage_does_not_disturb_and_is_reported(recording: Recording, rows: dict[str, list[Any]]) -> None:
    assert len(rows["BAD_DATA"]) == 1314
    assert "ardupilot_flight.tlog: 1314 damaged messages passed over" in recording.notes
    assert any("IMU from RAW_IMU" in note for note in recording.notes)
    assert any("too few to navigate by" in note for note in recording.notes)


def test_nothing_arrives_before_it_was(recording: Recording) -> None:
    latency = np.concatenate([s.arrived_ns - s.t_ns for s in recording.streams if s.topic != "/truth"]) * 1e-9
    assert latency.min() >= -0.002  # a stamp may be rounded to 1 ms
    assert np.median(latency) < 1.5


def test_every_fix(recording: Recording, rows: dict[str, list[Any]]) -> None:
    got, raw = [m for m in recording if isinstance(m, GnssFix)], rows["GPS_RAW_INT"]
    assert len(got) == len(raw) == 2858
    by_place = {(round(m.lat_deg * 1e7), round(m.lon_deg * 1e7), round(m.alt_m * 1e3), m.status >= 0) for m in got}
    assert by_place == {(r.lat, r.lon, r.alt, r.fix_type >= 3) for r in raw}
    assert sum(m.status >= 0 for m in got) == sum(r.fix_type >= 3 for r in raw)
    hdop = raw[-1].eph * 1e-2
    assert got[-1].covariance_n is not None
    np.testing.assert_allclose(np.diag(got[-1].covariance_n), np.array([0.5, 0.5, 2.25]) * (3.0 * hdop) ** 2)
    first = next(m for m, r in zip(got, raw, strict=True) if r.time_usec == 0)
    assert first.t_ns == first.arrived_ns  # not stamped by the vehicle


def test_velocity_of_fixes_reports_nothing_about_the_vertical(recording: Recording, rows: dict[str, list[Any]]) -> None:
    got = [m for m in recording if isinstance(m, GnssVelocity)]
    raw = [r for r in rows["GPS_RAW_INT"] if r.fix_type >= 3 and r.vel != 65535 and r.cog != 65535]
    speed, course = np.array([r.vel * 1e-2 for r in raw]), np.deg2rad([r.cog * 1e-2 for r in raw])
    np.testing.assert_allclose(
        [m.v_n[:2] for m in got], np.stack([speed * np.cos(course), speed * np.sin(course)], axis=1), atol=1e-9
    )
    assert got[0].covariance_n is not None
    np.testing.assert_allclose(np.diag(got[0].covariance_n), [0.25, 0.25, 1e4])


def test_pressure_and_reference(recording: Recording, rows: dict[str, list[Any]]) -> None:
    assert [m.values[0] for m in recording if isinstance(m, Reading) and m.kind == "baro"] == [
        r.press_abs * 100.0 for r in rows["SCALED_PRESSURE"]
    ]
    truths = [m for m in recording if isinstance(m, Truth)]
    assert [m.p_n for m in truths] == [(r.x, r.y, r.z) for r in rows["LOCAL_POSITION_NED"]]
    assert [m.v_n for m in truths] == [(r.vx, r.vy, r.vz) for r in rows["LOCAL_POSITION_NED"]]
    position, attitude = rows["LOCAL_POSITION_NED"][700], rows["ATTITUDE"]
    near = min(attitude, key=lambda r: abs(r.time_boot_ms - position.time_boot_ms))
    np.testing.assert_allclose(so3.to_euler(np.array(truths[700].q_nb_wxyz)), [near.roll, near.pitch, near.yaw], atol=0.15)


def test_the_autopilots_attitude(recording: Recording, rows: dict[str, list[Any]]) -> None:
    got = [m for m in recording if isinstance(m, AttitudePrior)]
    known = {round(r._timestamp * 1e6): r for r in rows["ATTITUDE"]}
    assert 1000 < len(got) <= len(known)
    for m in got:
        r = known[round(m.arrived_ns * 1e-3)]
        np.testing.assert_allclose(so3.to_euler(np.array(m.q_nb_wxyz)), [r.roll, r.pitch, r.yaw], atol=1e-9)


def test_a_torn_log_is_read_as_far_as_it_goes(flown: Path, tmp_path: Path) -> None:
    path = tmp_path / "torn.tlog"
    path.write_bytes(flown.read_bytes()[:1_000_003])
    stream = tlog.read(path).stream("/imu")
    assert stream is not None
    assert 500 < len(stream) < 2000


# --- written here ------------------------------------------------------------------------------------------------------------

START_US = 1_700_000_000_000_000


class Ground:
    """A ground station that logs what it hears."""

    def __init__(self, autopilot: int = 12, system: int = 7) -> None:
        self.vehicle = mavlink2.MAVLink(BytesIO(), srcSystem=system, srcComponent=1)
        self.data = b""
        self.hear(0, mavlink2.MAVLink_heartbeat_message(2, autopilot, 0, 0, 4, 3))

    def hear(self, after_us: int, message: Any) -> None:
        self.data += struct.pack(">Q", START_US + after_us) + message.pack(self.vehicle)

    def imu(self, after_us: int, boot_us: int, z: float = -9.8) -> None:
        message = mavlink2.MAVLink_highres_imu_message(boot_us, 0.1, 0.2, z, 0.01, 0.02, 0.03, 0, 0, 0, 950.0, 0, 0, 20.0, 63)
        self.hear(after_us, message)

    def write(self, folder: Path) -> Path:
        path = folder / "log.tlog"
        path.write_bytes(self.data)
        return path


def fix(boot_us: int, *, kind: int = 3, h_acc: int = 0, vel: int = 300, cog: int = 9000, ellipsoid: int = 0) -> Any:
    return mavlink2.MAVLink_gps_raw_int_message(
        boot_us, kind, 473977420, 85455940, 488000, 150, 200, vel, cog, 12, ellipsoid, h_acc, 2 * h_acc, 400 if h_acc else 0
    )


def test_highres_imu_of_mavlink_2(tmp_path: Path) -> None:
    ground = Ground()
    for k, latency in enumerate([30_000, 20_000, 90_000, 20_000]):
        ground.imu(k * 10_000 + latency, 5_000_000 + k * 10_000)
    recording = tlog.read(ground.write(tmp_path))
    got = [m for m in recording if isinstance(m, ImuSample)]
    np.testing.assert_allclose([m.accel_b for m in got], [[0.1, 0.2, -9.8]] * 4, rtol=1e-6)
    np.testing.assert_allclose([m.gyro_b for m in got], [[0.01, 0.02, 0.03]] * 4, rtol=1e-6)
    assert sorted(m.t_ns - got[0].t_ns for m in got) == [0, 10_000_000, 20_000_000, 30_000_000]
    assert sorted((m.arrived_ns - m.t_ns) // 1000 for m in got) == [0, 0, 10_000, 70_000]
    assert not any("coarse" in note or "IMU from" in note for note in recording.notes)


@pytest.mark.parametrize(("period_us", "count"), [(20_000, 50), (200_000, 5)], ids=["50 Hz", "5 Hz"])
def test_other_imus_are_imported_where_they_are_fast_enough_to_take_over(tmp_path: Path, period_us: int, count: int) -> None:
    ground = Ground(autopilot=3)
    for k in range(50):
        ground.imu(k * 20_000, 5_000_000 + k * 20_000)
    for k in range(count):
        at = k * period_us + 1000
        ground.hear(at, mavlink2.MAVLink_scaled_imu2_message(5000 + at // 1000, 0, 0, -1000, 10, 20, -30, 1, 2, 3))
        ground.hear(at, mavlink2.MAVLink_scaled_imu3_message(5000 + at // 1000, 5, 0, -1000, 40, 50, 60, 1, 2, 3))
    recording = tlog.read(ground.write(tmp_path))
    got = {topic: [m for m in recording if isinstance(m, ImuSample) and m.topic == topic] for topic in ("/imu2", "/imu3")}
    if period_us > 50_000:
        assert not any(got.values())
        assert sum("too slow to take over" in note for note in recording.notes) == 2
        return
    assert {topic: len(samples) for topic, samples in got.items()} == {"/imu2": 50, "/imu3": 50}
    np.testing.assert_allclose(got["/imu2"][7].gyro_b, [0.01, 0.02, -0.03])
    np.testing.assert_allclose(got["/imu3"][7].accel_b, [5 * 9.80665e-3, 0.0, -9.80665])
    config = parse(recording.settings.toml("tlog", tmp_path, ("/imu", "/imu2", "/imu3")))
    assert config.inputs.imu == ("/imu", "/imu2", "/imu3")


def test_accuracies_and_ellipsoid_height_of_mavlink_2(tmp_path: Path) -> None:
    ground = Ground()
    for k in range(3):
        ground.imu(k * 10_000, 5_000_000 + k * 10_000)
    ground.hear(35_000, fix(5_030_000, h_acc=1500, ellipsoid=535_000))
    ground.hear(45_000, fix(5_040_000, vel=65535))
    first, second = (m for m in tlog.read(ground.write(tmp_path)) if isinstance(m, GnssFix))
    assert (first.lat_deg, first.lon_deg, first.alt_m) == pytest.approx((47.397742, 8.545594, 535.0))
    assert first.covariance_n is not None
    assert second.covariance_n is not None
    np.testing.assert_allclose(np.diag(first.covariance_n), [2.25, 2.25, 9.0])
    np.testing.assert_allclose(np.diag(second.covariance_n), [0.5 * 4.5**2, 0.5 * 4.5**2, 36.0])
    (velocity,) = (m for m in tlog.read(tmp_path / "log.tlog") if isinstance(m, GnssVelocity))
    np.testing.assert_allclose(velocity.v_n, [0.0, 3.0, 0.0], atol=1e-12)
    assert velocity.covariance_n is not None
    np.testing.assert_allclose(np.diag(velocity.covariance_n), [0.16, 0.16, 1e4])


def test_an_ellipsoid_height_that_is_that_above_the_sea_is_none(tmp_path: Path) -> None:
    """ArduPilot's simulator, and receivers without a geoid, send it in both fields."""
    ground = Ground()
    for k in range(3):
        ground.imu(k * 10_000, 5_000_000 + k * 10_000)
    ground.hear(35_000, fix(5_030_000, h_acc=1500, ellipsoid=488_000))
    recording = tlog.read(ground.write(tmp_path))
    assert [m.alt_m for m in recording if isinstance(m, GnssFix)] == pytest.approx([488.0])
    assert any("above sea level" in note for note in recording.notes)


def test_without_a_fix_a_stamp_that_is_repeated_is_not_taken(tmp_path: Path) -> None:
    """ArduPilot sends that of its last fix for as long as there is no other one."""
    ground = Ground()
    for k in range(1000):
        ground.imu(k * 10_000, 5_000_000 + k * 10_000)
    ground.hear(30_000, fix(5_030_000, kind=3))
    ground.hear(9_996_000, fix(5_030_000, kind=1))
    with_fix, without = (m for m in tlog.read(ground.write(tmp_path)) if isinstance(m, GnssFix))
    assert (with_fix.status, without.status) == (0, -1)
    assert without.t_ns - with_fix.t_ns == 9_966_000_000


def test_of_a_simulated_flight_the_truth_is_that_of_the_simulator(tmp_path: Path) -> None:
    ground, q = Ground(), so3.from_euler(0.1, -0.2, 1.5)
    ground.hear(10_000, mavlink2.MAVLink_gps_global_origin_message(473977400, 85455900, 487_000))
    for k in range(2):
        ground.imu(20_000 + k * 10_000, 5_000_000 + k * 10_000)
        ground.hear(25_000 + k * 10_000, mavlink2.MAVLink_attitude_message(5000 + k * 10, 0.0, 0.0, 1.4, 0.0, 0.0, 0.0))
        ground.hear(26_000 + k * 10_000, mavlink2.MAVLink_local_position_ned_message(5000 + k * 10, 7.0, 7.0, 7.0, 0.0, 0.0, 0.0))
    coarse = 473977490.0, 85455900.0  # float32: not to be used
    rest = *q.tolist(), *[0.0] * 9, *coarse, 488.0, 0.0, 0.0, 1.0, 2.0, 3.0, 473977490, 85455900
    ground.hear(40_000, mavlink2.MAVLink_sim_state_message(*rest))
    recording = tlog.read(ground.write(tmp_path))
    (truth,) = (m for m in recording if isinstance(m, Truth))
    np.testing.assert_allclose(truth.p_n, [1.0, 0.0, -1.0], atol=2e-3)  # 9e-6 degrees north of the origin
    assert truth.v_n == (1.0, 2.0, 3.0)
    np.testing.assert_allclose(truth.q_nb_wxyz, q, atol=1e-6)
    assert recording.reference == ""
    np.testing.assert_allclose(np.array(recording.settings.origin), [47.39774, 8.54559, 487.0])
    assert "/truth is the state of the simulator" in recording.notes


def test_stamps_that_count_from_1970_are_taken_as_they_are(tmp_path: Path) -> None:
    ground = Ground()
    ground.imu(80_000, START_US + 10_000)
    ground.imu(90_000, START_US + 20_000)
    assert [(m.t_ns // 1000 - START_US, m.arrived_ns // 1000 - START_US) for m in tlog.read(ground.write(tmp_path))] == [
        (10_000, 80_000),
        (20_000, 90_000),
    ]


def test_of_several_vehicles_the_one_with_the_most_messages_is_taken(tmp_path: Path) -> None:
    ground = Ground(system=7)
    other = Ground(system=9)
    for k in range(5):
        ground.imu(k * 10_000, 1_000_000 + k * 10_000)
    other.imu(60_000, 77_000_000, z=-9.7)
    ground.data += other.data
    assert len(tlog.read(ground.write(tmp_path))) == 5


def test_a_damaged_stamp_costs_its_own_message_only(tmp_path: Path) -> None:
    ground = Ground()
    for k in range(4):
        ground.imu(k * 10_000, 1_000_000 + k * 10_000)
    ground.imu(40_000, 2**63 + 5)
    recording = tlog.read(ground.write(tmp_path))
    assert len(recording) == 4
    assert "1 messages stamped outside 1970-2038 left out" in recording.notes


def test_a_reboot_in_flight_starts_a_new_clock(tmp_path: Path) -> None:
    ground = Ground()
    for k in range(10):
        ground.imu(k * 10_000, 60_000_000 + k * 10_000)
    for k in range(10):
        ground.imu(20_000_000 + k * 10_000, 1_000_000 + k * 10_000)
    stamps = [m.t_ns for m in tlog.read(ground.write(tmp_path))]
    assert stamps == [(START_US + after * 10_000) * 1000 for after in (*range(10), *range(2000, 2010))]


def test_wheels_are_a_velocity_forward(tmp_path: Path) -> None:
    """Two of sixteen wheels count: 1.5 m/s, every 50 ms."""
    ground = Ground(autopilot=3)
    for k in range(5):
        ground.imu(k * 50_000, 1_000_000 + k * 50_000)
        way = [0.07 * k, 0.08 * k, *[0.0] * 14]
        ground.hear(k * 50_000 + 5_000, mavlink2.MAVLink_wheel_distance_message(1_000_000 + k * 50_000, 2, way))
    recording = tlog.read(ground.write(tmp_path))
    got = [m for m in recording if isinstance(m, Reading) and m.kind == "velocity_body"]
    assert [m.t_ns // 1000 - START_US for m in got] == [50_000, 150_000]
    assert [m.arrived_ns - m.t_ns for m in got] == [55_000_000] * 2
    np.testing.assert_allclose([m.values for m in got], [(1.5, 0.0, 0.0)] * 2, atol=1e-9)
    assert "across_sigma_m_s = 0.1" in recording.settings.toml("tlog", tmp_path, ("/imu", "/velocity_body"))


def test_airspeed_is_indicated_and_range_is_that_of_the_sensor_that_looks_down(tmp_path: Path) -> None:
    ground = Ground(autopilot=3)
    for k, (pressure_hpa, down, distance_cm) in enumerate([(2.45, 25, 450), (0.0, 25, 5000), (2.45, 0, 700)]):
        boot_ms = 1000 + 50 * k
        ground.imu(k * 50_000, 1000 * boot_ms)
        ground.hear(k * 50_000, mavlink2.MAVLink_scaled_pressure_message(boot_ms, 950.0, pressure_hpa, 2000))
        ground.hear(k * 50_000, mavlink2.MAVLink_distance_sensor_message(boot_ms, 20, 4000, distance_cm, 0, 0, down, 0))
    recording = tlog.read(ground.write(tmp_path))
    values: dict[str, list[float]] = {"airspeed": [], "range": []}
    for m in recording:
        if isinstance(m, Reading) and m.kind in values:
            values[m.kind].append(m.values[0])
    np.testing.assert_allclose(values["airspeed"], [20.0, 20.0], rtol=1e-6)  # 245 Pa = 1.225 / 2 * 20^2
    np.testing.assert_allclose(values["range"], [4.5, np.inf])
    assert "indicated = true" in recording.settings.toml("tlog", tmp_path, ("/imu", "/airspeed"))


def odometry(boot_us: int, x: float, *, estimator: int = 3, reset: int = 0, quality: int = 80, child: int = 12) -> Any:
    nothing = [float("nan")] * 21
    return mavlink2.MAVLink_odometry_message(
        boot_us, 20, child, x, 0.2, -0.3, [1.0, 0.0, 0.0, 0.0], 0, 0, 0, 0, 0, 0, nothing, nothing, reset, estimator, quality
    )


def test_poses_from_outside_are_odometry(tmp_path: Path) -> None:
    """Those of the autopilot itself (estimator 8) and in other axes are not; where the camera is lost, the log says so."""
    ground = Ground()
    for k in range(8):
        ground.imu(k * 50_000, 1_000_000 + k * 50_000)
        ground.hear(k * 50_000 + 5_000, odometry(1_000_000 + k * 50_000, 0.1 * k, reset=int(k > 2), quality=-1 if k == 1 else 80))
    ground.hear(410_000, odometry(1_400_000, 9.0, estimator=8))
    ground.hear(460_000, odometry(1_450_000, 9.0, child=8))
    recording = tlog.read(ground.write(tmp_path))
    got = [m for m in recording if isinstance(m, OdometryPose)]
    np.testing.assert_allclose([m.p_o for m in got], [(0.1 * k, 0.2, -0.3) for k in range(8)], atol=1e-6)
    assert [m.t_ns // 1000 - START_US for m in got] == [k * 50_000 for k in range(8)]
    assert [m.is_lost for m in got] == [k == 1 for k in range(8)]
    assert len({m.frame for m in got}) == 2
    assert any("1 of 9 ODOMETRY left out" in note for note in recording.notes)
    assert '# odometry = "/odometry"' in recording.settings.toml("tlog", tmp_path, ("/imu", "/odometry"))


def test_a_cameras_steps_are_increments(tmp_path: Path) -> None:
    """1 m/s forward (seen at the end of each step) and 0.5 rad/s, every 50 ms: an arc, in increments of half a second."""
    ground = Ground(autopilot=3)
    for k in range(21):
        boot_us = 1_000_000 + k * 50_000
        ground.imu(k * 50_000, boot_us)
        turn, moved = [0.0, 0.0, 0.025], [0.05, 0.0, 0.0]
        step = ardupilotmega.MAVLink_vision_position_delta_message(boot_us, 50_000, turn, moved, 90.0)
        ground.hear(k * 50_000 + 5_000, step)
    recording = tlog.read(ground.write(tmp_path))
    got = [m for m in recording if isinstance(m, OdometryDelta)]
    assert len(got) == 2
    assert {m.t_ns - m.t0_ns for m in got} == {500_000_000}
    for m in got:
        np.testing.assert_allclose(m.dp_b, (2.0 * np.sin(0.25), 2.0 * (1.0 - np.cos(0.25)), 0.0), atol=0.01)
        np.testing.assert_allclose(m.dq_wxyz, (np.cos(0.125), 0.0, 0.0, np.sin(0.125)), atol=1e-6)
    assert 'odometry_delta = ["/odometry_delta"]' in recording.settings.toml("tlog", tmp_path, ("/imu", "/odometry_delta"))


def test_flow_over_the_range_of_its_message(tmp_path: Path) -> None:
    """2 m/s forward at 10 m: 0.2 rad/s about y. A quality of 0 is none, and without a range there is a note."""
    ground = Ground()
    for k in range(13):
        boot_us = 1_000_000 + k * 50_000
        ground.imu(k * 50_000, boot_us)
        metres, quality = (10.0 if k < 9 else -1.0), (0 if k == 8 else 200)
        flow = mavlink2.MAVLink_optical_flow_rad_message(boot_us, 0, 50_000, 0.0, 0.01, 0.0, 0.0, 0.0, 0, quality, 0, metres)
        ground.hear(k * 50_000 + 5_000, flow)
    recording = tlog.read(ground.write(tmp_path))
    got = [m for m in recording if isinstance(m, OdometryDelta)]
    assert len(got) == 2
    for m in got:
        np.testing.assert_allclose(m.dp_b, (0.4, 0.0, 0.0), atol=1e-6)
        assert m.topic == "/optical_flow"
    assert "4 of 12 messages of optical flow left out: no range to the ground at that time" in recording.notes


def test_raw_counts_of_other_autopilots_are_no_imu(tmp_path: Path) -> None:
    ground = Ground(autopilot=12)
    ground.hear(0, mavlink2.MAVLink_raw_imu_message(1000, 0, 0, -1000, 1, 2, 3, 0, 0, 0))
    with pytest.raises(LogError, match=r"log\.tlog: no IMU messages .* \(there are: none in physical units\)"):
        tlog.read(ground.write(tmp_path))
    ground = Ground(autopilot=3)
    ground.hear(0, mavlink2.MAVLink_raw_imu_message(1000, 0, 0, -1000, 1, 2, 3, 0, 0, 0))
    (sample,) = tlog.read(ground.write(tmp_path))
    assert isinstance(sample, ImuSample)
    assert sample.accel_b == pytest.approx((0.0, 0.0, -9.80665))


def test_the_flags_of_a_receiver_are_in_its_fixes_for_three_seconds(tmp_path: Path) -> None:
    ground, boot_us = Ground(), 5_000_000
    for k in range(12):
        ground.imu(500_000 * k, boot_us + 500_000 * k)
        if k == 2:  # of a second receiver, which sends no fixes, and of the first
            unknown = [65535, 65535, *[255] * 4]
            for number, jamming, spoofing in ((1, 1, 3), (0, 3, 1)):
                flags = development.MAVLink_gnss_integrity_message(number, 0, 3 - number, jamming, spoofing, 0, *unknown)
                ground.hear(500_000 * k, flags)
        ground.hear(500_000 * k + 1000, fix(boot_us + 500_000 * k))
    recording = tlog.read(ground.write(tmp_path))
    states = [m.state for m in recording if isinstance(m, GnssFix)]
    assert states == [0] * 2 + [ReceiverState.JAMMED] * 6 + [0] * 4
    assert "/gnss: the receiver reports jamming or spoofing in 6 of 12 fixes" in recording.notes
    assert [note for note in recording.notes if "authenti" in note] == ["/gnss: authenticated in 1 of 1"]


def test_whether_it_is_landed(tmp_path: Path) -> None:
    ground = Ground()
    for k, state in enumerate((1, 3, 2)):
        ground.imu(500_000 * k, 5_000_000 + 500_000 * k)
        ground.hear(500_000 * k, mavlink2.MAVLink_extended_sys_state_message(0, state))
    recording = tlog.read(ground.write(tmp_path))
    assert [m.values for m in recording if isinstance(m, Reading)] == [(1.0,), (3.0,), (2.0,)]
    assert 'rest = ["/landed"]' in recording.settings.toml("tlog", tmp_path, ("/imu", "/landed"))


@pytest.mark.parametrize(("field", "origin_s", "count"), [(0.0, 0.0, 0), (0.3, 0.0, 10), (0.3, 2.0, 6)])
def test_a_heading_that_may_be_anything_is_not_taken(tmp_path: Path, field: float, origin_s: float, count: int) -> None:
    """A dead compass, or ArduPilot before its origin: 1 s later it would be taken."""
    ground = Ground(autopilot=3)
    for k in range(10):
        at, boot_ms = 500_000 * k, 5000 + 500 * k
        numbers = 0.1, 0.2, -9.8, 0.01, 0.02, 0.03, field, 0.0, field, 950.0, 0.0, 0.0, 20.0
        ground.hear(at, mavlink2.MAVLink_highres_imu_message(1000 * boot_ms, *numbers, 511))
        if k == 2.0 * origin_s:
            ground.hear(at, mavlink2.MAVLink_gps_global_origin_message(473_977_000, 85_456_000, 488_000))
        ground.hear(at, mavlink2.MAVLink_attitude_message(boot_ms, 0.1, -0.2, 2.5, 0, 0, 0))
    recording = tlog.read(ground.write(tmp_path))
    assert sum(isinstance(m, AttitudePrior) for m in recording) == count
    assert any("the heading may be anything" in note for note in recording.notes) == (count == 0)


def test_another_imu_on_request(flown: Path, rows: dict[str, list[Any]]) -> None:
    stream = tlog.read(flown, ImportOptions(imu="scaled_imu2")).stream("/imu")
    assert stream is not None
    np.testing.assert_allclose(stream.columns[0][:, 0], [r.xgyro * 1e-3 for r in rows["SCALED_IMU2"]])


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"", "the file is empty"),
        (b"ULog\x01\x12\x35" + bytes(500), "not a MAVLink telemetry log"),
        (bytes(range(256)) * 20, "not a MAVLink telemetry log"),
        (Ground().data, "not a MAVLink telemetry log (.tlog), or one without IMU, GPS and attitude"),
    ],
)
def test_what_is_no_telemetry_log_is_reported_in_one_line(tmp_path: Path, content: bytes, line: str) -> None:
    path = tmp_path / "log.tlog"
    path.write_bytes(content)
    with pytest.raises(LogError) as raised:
        tlog.read(path)
    assert str(raised.value).startswith("log.tlog: ")
    assert line in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"gone\.tlog: No such file"):
        tlog.read(tmp_path / "gone.tlog")


def test_a_file_of_a_terabyte_of_zeros_comes_to_an_end(tmp_path: Path) -> None:
    path = tmp_path / "zeros.tlog"
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(LogError, match="not a MAVLink telemetry log"):
        tlog.read(path)


def test_a_log_with_a_terabyte_of_zeros_behind_it_is_read(tmp_path: Path) -> None:
    """The reader seeks the next stamp byte by byte."""
    ground = Ground()
    for k in range(50):
        ground.imu(k * 10_000, 5_000_000 + k * 10_000)
    path = ground.write(tmp_path)
    with path.open("r+b") as file:
        file.truncate(2**40)
    assert len(tlog.read(path)) == 50


@pytest.mark.parametrize("size", [1, 53_000])
def test_a_block_of_zeros_before_the_first_frame_is_passed_over(size: int, tmp_path: Path) -> None:
    """Of MAVLink 2, whose version the reader takes from the first bytes of the file."""
    ground = Ground()
    for k in range(50):
        ground.imu(k * 10_000, 5_000_000 + k * 10_000)
    path = ground.write(tmp_path)
    whole = [m.t_ns for m in tlog.read(path)]
    path.write_bytes(bytes(size) + path.read_bytes())
    assert [m.t_ns for m in tlog.read(path)] == whole
    assert len(whole) == 50
