"""Every message as pymavlink reads it at the other end, against the record it was made of."""

import math
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from estimator.service.mavlink import codec
from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.mavlink.inputs import Inputs
from logs.wire.codec import Topics
from models import so3
from models.frames import GRAVITY
from models.messages import (
    Alert,
    Array,
    AttitudePrior,
    Estimate,
    GnssFix,
    GnssVelocity,
    ImuSample,
    Integrity,
    Mode,
    Reading,
    vec3,
)
from models.state import E, X

T0 = 1_795_000_000_000_000_000


def _over_the_wire(message: Any) -> Any:
    there, here = mavlink.MAVLink(None, 1, 197), mavlink.MAVLink(None, 1, 1)
    (read,) = here.parse_buffer(bytes(message.pack(there)))
    return read


def _estimate() -> Estimate:
    rng = np.random.default_rng(3)
    nav, root = np.arange(1.0, 17.0), rng.normal(size=(15, 15))
    nav[X.Q] = so3.from_euler(0.1, -0.2, 2.0)
    return Estimate(T0, T0, nav, root @ root.T, (0.1, 0.2, 0.3), Mode.AIDED, 258, T0)


def _pose(e: Estimate) -> codec.Pose:
    return vec3(e.nav[X.P]), np.array(e.nav[X.Q])


def _full(upper: list[float]) -> Array:
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = upper
    return full + np.triu(full, 1).T


def test_odometry_for_px4_is_ned_with_velocity_in_the_body() -> None:
    e = _estimate()
    read = _over_the_wire(codec.odometry(e, _pose(e), 123_456, 2, 87, codec.PX4))
    assert (read.time_usec, read.frame_id, read.child_frame_id, read.estimator_type) == (123_456, 1, 12, 2)
    assert (read.reset_counter, read.quality) == (2, 87)
    R_nb = so3.matrix(np.array(e.nav[X.Q]))
    np.testing.assert_allclose([read.x, read.y, read.z], e.nav[X.P], rtol=1e-6)
    np.testing.assert_allclose(R_nb @ [read.vx, read.vy, read.vz], e.nav[X.V], rtol=1e-5)
    np.testing.assert_allclose(read.q, e.nav[X.Q], rtol=1e-6)
    np.testing.assert_allclose([read.rollspeed, read.pitchspeed, read.yawspeed], e.gyro_b, rtol=1e-6)
    pose, velocity = _full(read.pose_covariance), _full(read.velocity_covariance)[:3, :3]
    np.testing.assert_allclose(pose[:3, :3], e.covariance[E.P, E.P], rtol=1e-5)
    np.testing.assert_allclose(pose[3:, 3:], e.covariance[E.THETA, E.THETA], rtol=1e-5)
    np.testing.assert_allclose(pose[:3, 3:], e.covariance[E.P, E.THETA], rtol=1e-5)
    np.testing.assert_allclose(R_nb @ velocity @ R_nb.T, e.covariance[E.V, E.V], rtol=1e-4, atol=1e-4)
    assert [read.pose_covariance[k] for k in (0, 6, 11, 15, 18, 20)] == pytest.approx(np.diag(pose).tolist())


@pytest.mark.parametrize("sigma", [0.1, 0.5, 2.0, 10.0])
def test_ardupilot_makes_our_sigma_of_what_it_is_reported(sigma: float) -> None:
    e = _estimate()
    covariance = np.diag(np.repeat([sigma**2, 1.0, (0.1 * sigma) ** 2, 1.0, 1.0], 3))
    e = Estimate(T0, T0, e.nav, covariance, e.gyro_b, Mode.AIDED, 1, T0)
    read = _over_the_wire(codec.odometry(e, _pose(e), 1, 7, 50, codec.ARDUPILOT))
    assert (read.frame_id, read.child_frame_id, read.quality, read.reset_counter) == (20, 12, 50, 7)
    np.testing.assert_allclose([read.x, read.y, read.z], e.nav[X.P], rtol=1e-6)
    c = read.pose_covariance
    assert math.cbrt(c[0] ** 2 + c[6] ** 2 + c[11] ** 2) == pytest.approx(sigma, rel=1e-5)
    assert math.cbrt(c[15] ** 2 + c[18] ** 2 + c[20] ** 2) == pytest.approx(0.1 * sigma, rel=1e-5)


def test_what_is_not_to_be_used_has_ardupilots_largest_sigmas() -> None:
    """VISO_QUAL_MIN -1 takes all."""
    e = _estimate()
    c = _over_the_wire(codec.odometry(e, _pose(e), 1, 7, -1, codec.ARDUPILOT)).pose_covariance
    assert math.cbrt(c[0] ** 2 + c[6] ** 2 + c[11] ** 2) == pytest.approx(100.0, rel=1e-5)
    assert math.cbrt(c[15] ** 2 + c[18] ** 2 + c[20] ** 2) >= 1.5


def test_fixes_are_read_as_they_were_meant() -> None:
    e = _estimate()
    e.covariance[E.P, E.P] = [[5.0, 3.0, 0.0], [3.0, 5.0, 0.0], [0.0, 0.0, 3.0]]
    at = codec.place((47.1234567, -8.7654321, 500.0), 47.5)
    position = _over_the_wire(codec.global_position(e, at, 77, 3, 1))
    assert (position.time_usec, position.id, position.source, position.flags) == (77, 3, 2, 0)
    assert (position.target_system, position.target_component) == (1, 1)
    assert (position.lat, position.lon) == (471_234_567, -87_654_321)
    assert (position.alt_ellipsoid, position.alt) == (500.0, 452.5)
    assert (position.eph, position.epv) == (pytest.approx(math.sqrt(8.0)), pytest.approx(math.sqrt(3.0)))
    # 2026-01-01T00:00:00Z is a Thursday: 4 days and 18 leap seconds into GPS week 2399
    fix = _over_the_wire(codec.gps_input(e, at, 77, 1, 1_767_225_600 * 10**9))
    assert (fix.time_week, fix.time_week_ms) == (2399, 4 * 86_400_000 + 18_000)
    assert (fix.gps_id, fix.fix_type, fix.ignore_flags) == (1, 3, 2 | 4 | 8 | 16 | 32)
    assert (fix.lat, fix.lon, fix.alt) == (471_234_567, -87_654_321, 452.5)
    assert (fix.horiz_accuracy, fix.vert_accuracy) == (pytest.approx(math.sqrt(8.0)), pytest.approx(math.sqrt(3.0)))
    undated = _over_the_wire(codec.gps_input(e, at, 77, 1, None))
    assert (undated.time_week, undated.time_week_ms) == (0, 0)


def test_highres_imu_is_si_and_needs_both_triads() -> None:
    values = 0.1, 0.2, -9.8, 0.01, 0.02, 0.03, 0, 0, 0, 0, 0, 0, 0
    read = codec.imu(_over_the_wire(mavlink.MAVLink_highres_imu_message(5, *values, 63)), T0, "/imu")
    assert read is not None
    np.testing.assert_allclose([*read.accel_b, *read.gyro_b], values[:6], rtol=1e-6)
    assert (read.t_ns, read.topic) == (T0, "/imu")
    assert codec.imu(_over_the_wire(mavlink.MAVLink_highres_imu_message(5, *values, 0b11_1110)), T0, "/imu") is None
    assert codec.imu(_over_the_wire(mavlink.MAVLink_highres_imu_message(5, *values, 63, id=1)), T0, "/imu") is None


def test_a_pressure_is_in_pascal_and_reported_once() -> None:
    def highres(hpa: float, fields: int = 63 | 512, number: int = 0) -> Any:
        return _over_the_wire(
            mavlink.MAVLink_highres_imu_message(5, 0, 0, -9.8, 0, 0, 0, 0, 0, 0, hpa, 0, 0, 20.0, fields, id=number)
        )

    inputs = Inputs(MavlinkConfig(), Topics(baro=("/baro",)), 0.0)
    heard = [
        [m for m in inputs.measured(message, T0 + k, T0, codec.PX4) if isinstance(m, Reading) and m.kind == "baro"]
        for k, message in enumerate(
            [highres(950.25), highres(950.25), highres(950.5, 63), highres(950.5), highres(951.0, number=1)]
        )
    ]
    assert [[(m.t_ns - T0, m.values[0], m.topic) for m in some] for some in heard] == [
        [(0, 95_025.0, "/baro")], [], [], [(3, 95_050.0, "/baro")], [],
    ]  # fmt: skip
    for off in (Inputs(MavlinkConfig(baro=False), Topics(baro=("/baro",)), 0.0), Inputs(MavlinkConfig(), Topics(), 0.0)):
        assert not any(isinstance(m, Reading) and m.kind == "baro" for m in off.measured(highres(950.25), T0, T0, codec.PX4))


def test_further_imus_have_topics_of_their_own_and_are_asked_for() -> None:
    second = _over_the_wire(mavlink.MAVLink_scaled_imu2_message(5, 0, 0, -1000, 100, 200, 300, 0, 0, 0))
    third = _over_the_wire(mavlink.MAVLink_scaled_imu3_message(5, 0, 0, -1000, 100, 200, 300, 0, 0, 0))
    inputs = Inputs(MavlinkConfig(), Topics(imu=("/imu", "/imu2")), 0.0)
    asked = dict(inputs.requests(T0, codec.ARDUPILOT))
    assert mavlink.MAVLINK_MSG_ID_SCALED_IMU2 in asked
    assert mavlink.MAVLINK_MSG_ID_SCALED_IMU3 not in asked
    (sample,) = inputs.measured(second, T0, T0, codec.ARDUPILOT)
    assert isinstance(sample, ImuSample)
    assert sample.topic == "/imu2"
    np.testing.assert_allclose(sample.gyro_b, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(sample.accel_b, (0.0, 0.0, -9.80665))
    assert list(inputs.measured(third, T0, T0, codec.ARDUPILOT)) == []


@pytest.mark.parametrize("unit", [1.0, 1e6])  # gauss; ArduPilot 4.7.0-dev sends microgauss
def test_a_magnetic_field_is_in_tesla_whichever_message_has_it(unit: float) -> None:
    field = 0.2 * unit, -0.1 * unit, 0.4 * unit
    highres = _over_the_wire(mavlink.MAVLink_highres_imu_message(5, 0, 0, -9.8, 0, 0, 0, *field, 0, 0, 0, 20.0, 63 | 448, id=0))
    coarse = _over_the_wire(mavlink.MAVLink_raw_imu_message(5, 0, 0, -1000, 0, 0, 0, 200, -100, 400))
    none = _over_the_wire(mavlink.MAVLink_raw_imu_message(6, 0, 0, -1000, 0, 0, 0, 0, 0, 0))
    inputs = Inputs(MavlinkConfig(imu=False), Topics(magnetometer=("/mag",)), 0.0)
    assert mavlink.MAVLINK_MSG_ID_HIGHRES_IMU in dict(inputs.requests(T0, codec.ARDUPILOT))
    (read,) = inputs.measured(highres, T0, T0, codec.ARDUPILOT)
    assert isinstance(read, Reading)
    assert (read.topic, read.kind) == ("/mag", "magnetometer")
    np.testing.assert_allclose(read.values, [2e-5, -1e-5, 4e-5], rtol=1e-6)
    late = T0 + 4 * 10**9
    assert mavlink.MAVLINK_MSG_ID_RAW_IMU in dict(inputs.requests(late, codec.ARDUPILOT))
    inputs = Inputs(MavlinkConfig(), Topics(magnetometer=("/mag",)), 0.0)
    list(inputs.requests(T0, codec.ARDUPILOT))
    _, read = inputs.measured(coarse, late, late, codec.ARDUPILOT)
    assert isinstance(read, Reading)
    np.testing.assert_allclose(read.values, [2e-5, -1e-5, 4e-5], rtol=1e-6)
    assert [type(m) for m in inputs.measured(none, late, late, codec.ARDUPILOT)] == [ImuSample]


def test_a_dynamic_pressure_is_an_indicated_airspeed() -> None:
    highres = _over_the_wire(
        mavlink.MAVLink_highres_imu_message(5, 0, 0, -9.8, 0, 0, 0, 0, 0, 0, 0, 2.45, 0, 20.0, 63 | 1024, id=0)
    )
    scaled = _over_the_wire(mavlink.MAVLink_scaled_pressure_message(5, 950.0, 2.45, 2000))
    none = _over_the_wire(mavlink.MAVLink_scaled_pressure_message(6, 950.0, 0.0, 2000))
    for message in (highres, scaled):
        inputs = Inputs(MavlinkConfig(imu=False), Topics(airspeed=("/airspeed",)), 0.0)
        assert mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE in dict(inputs.requests(T0, codec.PX4))
        (read,) = inputs.measured(message, T0, T0, codec.PX4)
        assert isinstance(read, Reading)
        np.testing.assert_allclose(read.values, [20.0], rtol=1e-6)  # 245 Pa = 1.225 / 2 * 20^2
        assert list(inputs.measured(none, T0, T0, codec.PX4)) == []


def test_ardupilots_airspeed_is_not_in_highres_imu() -> None:
    """Its diff_pressure is the static pressure less that on the ground: 70 hPa below in a simulator, 106 m/s backwards."""
    highres = _over_the_wire(
        mavlink.MAVLink_highres_imu_message(5, 0, 0, -9.8, 0, 0, 0, 0, 0, 0, 944.0, -69.4, 0, 20.0, 63 | 1024, id=0)
    )
    scaled = _over_the_wire(mavlink.MAVLink_scaled_pressure_message(5, 950.0, 2.45, 2000))
    inputs = Inputs(MavlinkConfig(imu=False), Topics(airspeed=("/airspeed",)), 0.0)
    assert list(inputs.measured(highres, T0, T0, codec.ARDUPILOT)) == []
    assert [m.values for m in inputs.measured(scaled, T0, T0, codec.ARDUPILOT) if isinstance(m, Reading)] == [
        pytest.approx((20.0,))
    ]


@pytest.mark.parametrize(("yaw", "degrees"), [(0, None), (65535, None), (36000, 360.0), (4500, 45.0)])
def test_the_heading_of_two_antennas_is_given_or_not(yaw: int, degrees: float | None) -> None:
    message = _over_the_wire(
        mavlink.MAVLink_gps_raw_int_message(5, 6, 473977000, 85456000, 488000, 80, 120, 0, 0, 14, 536000, 0, 0, 0, 0, yaw=yaw)
    )
    inputs = Inputs(MavlinkConfig(gnss=False), Topics(heading=("/heading",)), 0.0)
    assert mavlink.MAVLINK_MSG_ID_GPS_RAW_INT in dict(inputs.requests(T0, codec.ARDUPILOT))
    read = [m for m in inputs.measured(message, T0, T0, codec.ARDUPILOT) if isinstance(m, Reading)]
    assert [m.values[0] for m in read] == pytest.approx([] if degrees is None else [math.radians(degrees)])


def test_an_attitude_is_of_the_body_in_ned_and_as_accurate_as_configured() -> None:
    message = _over_the_wire(mavlink.MAVLink_attitude_message(7000, 0.1, -0.2, 2.5, 0, 0, 0))
    config, topics = MavlinkConfig(attitude_sigma_deg=(2.0, 10.0)), Topics(attitude=("/attitude",))
    inputs = Inputs(config, topics, 0.0)
    list(inputs.measured(_field((0.2, 0.0, 0.4)), T0, T0, codec.PX4))
    (read,) = inputs.measured(message, T0, T0, codec.PX4)
    assert isinstance(read, AttitudePrior)
    np.testing.assert_allclose(so3.to_euler(np.array(read.q_nb_wxyz)), [0.1, -0.2, 2.5], rtol=1e-6)
    np.testing.assert_allclose(np.degrees(np.sqrt(np.diag(read.covariance))), [2.0, 2.0, 10.0])
    assert (read.t_ns, read.topic, codec.stamp_ns(message)) == (T0, "/attitude", 7_000_000_000)
    assert dict(inputs.requests(T0, codec.ARDUPILOT))[30] == 500_000
    assert 30 in inputs.wanted


def test_an_imu_that_is_denied_is_asked_for_less_often() -> None:
    """ArduRover answers 200 Hz with MAV_RESULT_DENIED: its loop has 50, and it sends at most 40."""
    inputs, period_us = Inputs(MavlinkConfig(imu_hz=200.0), Topics(), 0.0), list[int]()
    for second in range(0, 40, 4):
        asked = dict(inputs.requests(T0 + second * 10**9, codec.ARDUPILOT))
        if 105 in asked:
            period_us.append(asked[105])
            if asked[105] < 25_000:
                inputs.deny()
            else:
                inputs.hear(_over_the_wire(mavlink.MAVLink_highres_imu_message(5, *[0.0] * 13, 63)), T0 + second * 10**9 + 1)
    assert period_us[:4] == [5_000, 6_250, 12_500, 25_000]
    assert set(period_us[4:]) <= {25_000}
    inputs.ask_again()  # another autopilot, or the same with another rate of its loop
    assert dict(inputs.requests(T0 + 50 * 10**9, codec.ARDUPILOT))[105] == 5_000


def test_ardupilots_heading_is_of_magnetic_north_until_it_has_an_origin() -> None:
    message = _over_the_wire(mavlink.MAVLink_attitude_message(7000, 0.1, -0.2, 2.5, 0, 0, 0))
    inputs = Inputs(MavlinkConfig(odometry=False), Topics(attitude=("/attitude",)), 0.0)
    list(inputs.measured(_field((0.2, 0.0, 0.4)), T0, T0, codec.ARDUPILOT))
    assert not list(inputs.measured(message, T0, T0, codec.ARDUPILOT))
    assert mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN in dict(inputs.requests(T0, codec.ARDUPILOT))
    inputs.hear(_over_the_wire(mavlink.MAVLink_gps_global_origin_message(473_977_000, 85_456_000, 488_000)), T0)
    assert len(list(inputs.measured(message, T0, T0, codec.ARDUPILOT))) == 1
    inputs.ask_again()  # it was booted again
    assert not list(inputs.measured(message, T0, T0, codec.ARDUPILOT))


def _field(field_gauss: tuple[float, float, float], updated: int = 0x1FF) -> Any:
    numbers = 0.0, 0.0, -9.8, 0.0, 0.0, 0.0, *field_gauss, 1013.0, 0.0, 0.0, 20.0
    return _over_the_wire(mavlink.MAVLink_highres_imu_message(7_000_000, *numbers, updated))


def test_the_heading_of_an_autopilot_with_a_dead_compass_or_none_is_not_taken_and_named() -> None:
    attitude = _over_the_wire(mavlink.MAVLink_attitude_message(7000, 0.1, -0.2, 2.5, 0, 0, 0))
    inputs = Inputs(MavlinkConfig(), Topics(attitude=("/attitude",)), 0.0)

    def after(message: Any, t_ns: int = T0) -> int:
        list(inputs.measured(message, t_ns, t_ns, codec.PX4))
        return len(list(inputs.measured(attitude, t_ns, t_ns, codec.PX4)))

    assert after(_field((0.0, 0.0, 0.0), 0x3F)) == 0  # it has never sent a field
    assert after(_field((0.2, 0.0, 0.4))) == 1
    assert after(_field((0.0, 0.0, 0.0), 0x3F), T0 + 10**9) == 1  # between two readings
    assert "attitude" not in inputs.report()
    assert after(_field((0.0, 0.0, 0.0))) == 0
    assert inputs.report()["attitude"] == "not taken: the autopilot's magnetometer reads zero or nothing"
    assert after(_field((0.2, 0.0, 0.4))) == 1
    assert after(_field((0.0, 0.0, 0.0), 0x3F), T0 + 4 * 10**9) == 0
    elsewhere = Inputs(MavlinkConfig(imu=False), Topics(attitude=("/attitude",)), 0.0)  # nothing is known of the compass
    assert len(list(elsewhere.measured(attitude, T0, T0, codec.PX4))) == 1


def test_an_attitude_is_asked_for_unless_it_has_no_topic() -> None:
    assert 30 in Inputs(MavlinkConfig(), Topics(), 0.0).wanted
    off = Inputs(MavlinkConfig(), Topics(attitude=()), 0.0)
    assert 30 not in {*off.wanted, *dict(off.requests(T0, codec.PX4))}
    message = _over_the_wire(mavlink.MAVLink_attitude_message(7000, 0.1, -0.2, 2.5, 0, 0, 0))
    assert not list(off.measured(message, T0, T0, codec.ARDUPILOT))


@pytest.mark.parametrize("imu", [True, False])
def test_the_message_with_the_pressure_is_asked_for(imu: bool) -> None:
    inputs = Inputs(MavlinkConfig(imu=imu, imu_hz=100.0, gnss_hz=5.0), Topics(baro=("/baro",)), 0.0)
    asked = dict(inputs.requests(T0, codec.PX4))
    assert asked[mavlink.MAVLINK_MSG_ID_HIGHRES_IMU] == (10_000 if imu else 200_000)
    assert mavlink.MAVLINK_MSG_ID_HIGHRES_IMU in inputs.wanted


@pytest.mark.parametrize("kind", [mavlink.MAVLink_raw_imu_message, mavlink.MAVLink_scaled_imu_message])
def test_the_coarse_ones_are_in_thousandths(kind: Any) -> None:
    read = codec.imu(_over_the_wire(kind(5, 100, 200, -1000, 10, 20, 30, 0, 0, 0)), T0, "/imu")
    assert read is not None
    np.testing.assert_allclose(read.accel_b, np.array([0.1, 0.2, -1.0]) * GRAVITY)
    np.testing.assert_allclose(read.gyro_b, [0.01, 0.02, 0.03])


def _gps(fix_type: int = 3, vel: int = 500, cog: int = 9000, **more: int) -> Any:
    return _over_the_wire(
        mavlink.MAVLink_gps_raw_int_message(9, fix_type, 473_977_000, 85_456_000, 488_000, 120, 65535, vel, cog, 12, **more)
    )


def _covariance(fix: GnssFix | GnssVelocity | None) -> Array:
    assert fix is not None
    assert fix.covariance_n is not None
    return fix.covariance_n


def test_a_receiver_that_reports_its_accuracy() -> None:
    message = _gps(alt_ellipsoid=535_500, h_acc=1500, v_acc=2500, vel_acc=300)
    fix, velocity = codec.gnss_fix(message, T0, 99.0, "/gnss"), codec.gnss_velocity(message, T0, "/gnss/velocity")
    assert (fix.lat_deg, fix.lon_deg, fix.alt_m) == pytest.approx((47.3977, 8.5456, 535.5))
    assert (fix.status, fix.topic) == (0, "/gnss")
    np.testing.assert_allclose(_covariance(fix), np.diag([2.25, 2.25, 6.25]))
    assert velocity is not None
    np.testing.assert_allclose(velocity.v_n, [0.0, 5.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(_covariance(velocity), np.diag([0.09, 0.09, 1e4]))


def test_a_receiver_that_knows_only_its_geometry_and_the_sea() -> None:
    fix = codec.gnss_fix(_gps(), T0, 47.5, "/gnss")
    assert fix.alt_m == pytest.approx(535.5)
    assert fix.covariance_n is not None
    assert np.trace(fix.covariance_n[:2, :2]) == pytest.approx((1.2 * 3.0) ** 2)  # HDOP, not metres
    assert 3.0 < math.sqrt(fix.covariance_n[2, 2]) < 9.0


@pytest.mark.parametrize(
    ("ellipsoid_mm", "height_m"), [(0, 535.5), (488_000, 535.5), (488_010, 535.5), (535_500, 535.5), (487_000, 487.0)]
)
def test_a_height_above_the_ellipsoid_that_is_that_above_the_sea_is_none(ellipsoid_mm: int, height_m: float) -> None:
    """ArduPilot's simulator: its receiver has no geoid, and says 488 m for both."""
    assert codec.gnss_fix(_gps(alt_ellipsoid=ellipsoid_mm), T0, 47.5, "/gnss").alt_m == pytest.approx(height_m)


@pytest.mark.parametrize(("fix_type", "status"), [(0, -1), (2, -1), (3, 0), (4, 1), (6, 2)])
def test_fix_types(fix_type: int, status: int) -> None:
    assert codec.gnss_fix(_gps(fix_type), T0, 0.0, "/gnss").status == status
    assert (codec.gnss_velocity(_gps(fix_type), T0, "/v") is None) == (status < 0)


def test_an_unknown_course_or_speed_is_no_velocity() -> None:
    assert codec.gnss_velocity(_gps(cog=65535), T0, "/v") is None
    assert codec.gnss_velocity(_gps(vel=65535), T0, "/v") is None


def test_beside_a_position_that_is_no_place_on_earth_a_velocity_is_none() -> None:
    message = mavlink.MAVLink_gps_raw_int_message(5, 3, 2**31 - 1, -(2**31), 0, 0, 0, 0, 0, 12)
    assert codec.gnss_velocity(_over_the_wire(message), T0, "/v") is None


def test_the_second_receiver_is_read_like_the_first() -> None:
    message = mavlink.MAVLink_gps2_raw_message(
        9, 3, 473_977_000, 85_456_000, 488_000, 120, 150, 500, 0, 9, 0, 0, alt_ellipsoid=1000, h_acc=1000, v_acc=2000
    )
    fix = codec.gnss_fix(_over_the_wire(message), T0, 0.0, "/gnss2")
    assert (fix.alt_m, fix.topic) == (1.0, "/gnss2")
    np.testing.assert_allclose(_covariance(fix), np.diag([1.0, 1.0, 4.0]))


@pytest.mark.parametrize(("length", "chunks"), [(26, 1), (50, 1), (51, 2), (100, 3), (128, 3)])
def test_the_text_of_an_alert_comes_whole_through_chunks(length: int, chunks: int) -> None:
    """From the bytes, as a ground station puts it together: by the number, in their order, until a zero byte."""
    head = "landfix: do not use, "
    reason = ("HPL 31.4 m, limit 10 m: " + "x" * length)[: length - len(head)]
    integrity = Integrity(1, 1, Alert.DO_NOT_USE, reason, 1e-5, 31.4, 3.0, 10.0, 10.0, (), (), (), 0.1, 0.1)
    sender, receiver = mavlink.MAVLink(None, 1, 197), mavlink.MAVLink(None)
    sent = b"".join(message.pack(sender) for message in codec.alert(integrity, 7))
    got = receiver.parse_buffer(sent)
    assert [(m.id, m.chunk_seq) for m in got] == [(7 if chunks > 1 else 0, k) for k in range(chunks)]
    assert "".join(m.text for m in got) == head + reason
    assert all(len(m.text) == 50 for m in got[:-1])
    assert len(got[-1].text) < 50 or chunks == 1  # a zero byte ends it
    assert all(m.severity == mavlink.MAV_SEVERITY_CRITICAL for m in got)
