"""The MAVLink link, with an autopilot of pymavlink at the other end of real sockets and a pseudo terminal."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common as mavlink

from benchmarks.service.vehicle import ORIGIN, truth
from estimator.config import parse
from estimator.service.autopilot.local_frame import LocalOrigin
from estimator.service.autopilot.output_policy import AutopilotConfig, OutputPolicy
from estimator.service.base.clock import Clock
from estimator.service.daemon import Daemon
from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.mavlink.link import MavlinkLink
from estimator.strict_toml import ConfigError
from logs.wire.codec import Topics
from models import so3
from models.messages import (
    AidStatus,
    Alert,
    Estimate,
    GnssFix,
    GnssVelocity,
    ImuSample,
    Input,
    Integrity,
    Mode,
    OdometryPose,
    Reading,
    Reason,
)  # fmt: skip
from models.state import X
from tests.estimator.service.autopilots import ARDUPILOT, PASSPHRASE, PX4, Flight, SerialAutopilot, UdpAutopilot
from tests.estimator.service.flying import (
    assert_replay_says_the_same,
    errors_in_sigma,
    in_thread,
    logs_of,
    odometry,
    records,
    toml,
)

SECOND = 1_000_000_000
IMU, GPS, GPS2, SYSTEM_TIME, RAW, ATTITUDE, EKF_ORIGIN = 105, 24, 124, 2, 27, 30, 49
said: list[str] = []  # to the person at the terminal
TOPICS = Topics(gnss=("/gnss", "/gnss2"), gnss_velocity=("/gnss/velocity",))


class _Inbox:
    """Keeps what it is given, and when."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.got: list[tuple[Input, int]] = []

    def put(self, message: Input) -> None:
        self.got.append((message, self._clock.now_ns()))

    def put_bytes(self, topic: str, schema: str, data: bytes) -> None:
        raise AssertionError((topic, schema, data))

    def of(self, kind: type) -> list[Any]:
        return [m for m, _ in self.got if isinstance(m, kind)]


@contextmanager
def _linked(
    config: MavlinkConfig, folder: Path = Path(), topics: Topics = TOPICS, own_gnss: bool = True
) -> Iterator[tuple[MavlinkLink, _Inbox, Clock]]:
    clock = Clock()
    said.clear()
    link = MavlinkLink(config, folder, topics, clock, OutputPolicy(AutopilotConfig(own_gnss=own_gnss)), 30.0, 47.5, said.append)
    inbox = _Inbox(clock)
    link.open_inputs(inbox)
    try:
        yield link, inbox, clock
    finally:
        link.close()


@contextmanager
def _px4(**settings: Any) -> Iterator[tuple[MavlinkLink, _Inbox, Clock, UdpAutopilot]]:
    """Linked over UDP and known to each other."""
    kind = settings.pop("kind", PX4)
    with (
        closing(UdpAutopilot(kind)) as autopilot,
        _linked(MavlinkConfig(endpoint=f"udpout:127.0.0.1:{autopilot.port}", **settings)) as (link, inbox, clock),
    ):
        lat, lon, alt_m = ORIGIN.lla
        here = mavlink.MAVLink_gps_global_origin_message(round(lat * 1e7), round(lon * 1e7), round((alt_m - 47.5) * 1e3))
        autopilot.origin = here if kind == PX4 else None
        autopilot.until(lambda: link.report()["autopilot"] != "unknown" and autopilot.of("COMMAND_LONG"), "the link knows it")
        yield link, inbox, clock, autopilot


def _requested(messages: list[Any]) -> dict[int, float]:
    return {int(m.param1): m.param2 for m in messages if m.get_type() == "COMMAND_LONG" and m.command == 511}


def _estimate(t_ns: int) -> Estimate:
    nav = np.zeros(16)
    nav[X.P], nav[X.Q] = (10.0, 20.0, -30.0), so3.from_euler(0.1, -0.2, 2.0)
    return Estimate(t_ns, t_ns, nav, np.eye(15), (0.1, 0.2, 0.3), Mode.AIDED, 3, t_ns, ORIGIN.lla)


def _fused(t_ns: int, kind: str = "pose") -> AidStatus:
    return AidStatus(t_ns, t_ns, f"/{kind}", kind, Reason.FUSED)


def _has_come(autopilot: UdpAutopilot, number: int) -> bool:
    return len(autopilot.of("ODOMETRY")) == number


def _soon(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, f"waited 60 s for: {what}"
        time.sleep(0.01)


def test_it_reports_who_it_is_and_asks_for_what_it_needs() -> None:
    with _px4(imu_hz=250.0, gnss_hz=8.0) as (_, _, _, autopilot):
        autopilot.until(lambda: len(_requested(autopilot.heard)) == 7, "all are asked for")
        beat = autopilot.of("HEARTBEAT")[0]
        assert (beat.get_srcSystem(), beat.get_srcComponent(), beat.type, beat.autopilot) == (1, 197, 18, 8)
        wanted = {IMU: 4000.0, GPS: 125_000.0, GPS2: 125_000.0, SYSTEM_TIME: 1e6, ATTITUDE: 500_000.0, EKF_ORIGIN: 1e6}
        wanted[mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] = 1e6
        assert _requested(autopilot.heard) == wanted
        command = autopilot.of("COMMAND_LONG")[0]
        assert (command.target_system, command.target_component) == (1, 1)


def test_its_sensors_are_measurements_on_our_clock() -> None:
    with _px4() as (link, inbox, clock, autopilot):
        autopilot.until(lambda: link.report()["timesync_answers"] >= 3, "clocks are in step")
        before_ns = clock.now_ns()
        autopilot.imu()
        place = 3, 473_977_000, 85_456_000, 488_000, 120, 150, 500, 9000, 12
        accuracy = {"alt_ellipsoid": 535_500, "h_acc": 1500, "v_acc": 2500, "vel_acc": 300}
        late_us = autopilot.boot_us() - 100_000
        autopilot.say(mavlink.MAVLink_gps_raw_int_message(late_us, *place, **accuracy))
        autopilot.say(mavlink.MAVLink_gps2_raw_message(late_us, *place, 0, 0, **accuracy))
        after_ns = clock.now_ns()
        autopilot.until(lambda: len(inbox.got) == 4, "four measurements")
    (sample,), fixes, (velocity,) = inbox.of(ImuSample), inbox.of(GnssFix), inbox.of(GnssVelocity)
    np.testing.assert_allclose([*sample.accel_b, *sample.gyro_b], [0.1, 0.2, -9.8, 0.01, 0.02, 0.03], rtol=1e-6)
    assert before_ns - SECOND // 50 < sample.t_ns < after_ns + SECOND // 50
    assert [f.topic for f in fixes] == ["/gnss", "/gnss2"]
    for fix in fixes:
        assert (fix.lat_deg, fix.lon_deg, fix.alt_m) == pytest.approx((47.3977, 8.5456, 535.5))
        assert fix.t_ns - sample.t_ns == pytest.approx(-SECOND // 10, abs=SECOND // 100)
    assert velocity.v_n == pytest.approx((0.0, 5.0, 0.0), abs=1e-9)


def test_questions_of_the_autopilot_are_answered_with_our_time_and_those_of_others_are_not_ours() -> None:
    with _px4() as (link, _, clock, autopilot):
        before_ns = clock.now_ns()
        autopilot.say(mavlink.MAVLink_timesync_message(0, 4711))
        autopilot.until(lambda: any(m.ts1 == 4711 for m in autopilot.of("TIMESYNC")), "an answer")
        (answer,) = [m for m in autopilot.of("TIMESYNC") if m.ts1 == 4711]
        assert before_ns <= answer.tc1 <= clock.now_ns()
        autopilot.answers_timesync = False
        autopilot.listen(0.1)
        answers = link.report()["timesync_answers"]
        autopilot.say(mavlink.MAVLink_timesync_message(autopilot.boot_us() * 1000, clock.now_ns()))
        autopilot.listen(0.2)
        assert link.report()["timesync_answers"] == answers
        assert (link.report()["implausible_stamps"], link.report()["defects"]) == (0, 0)


@pytest.mark.parametrize(("kind", "frame"), [(PX4, 1), (ARDUPILOT, 20)])
def test_odometry_goes_out_in_the_convention_of_who_is_there(kind: int, frame: int) -> None:
    with _px4(kind=kind) as (link, _, clock, autopilot):
        t_ns = clock.now_ns()
        link.send([_fused(t_ns, "gnss_position"), _estimate(t_ns)], [])
        link.send([_estimate(t_ns + SECOND)], [])
        link.send([_estimate(t_ns + SECOND + 1000)], [])  # too soon
        autopilot.until(lambda: len(autopilot.of("ODOMETRY")) == 2, "odometry")
        autopilot.listen(0.1)
        first, second = autopilot.of("ODOMETRY")
    quality = 0 if kind == PX4 else -1  # nothing but its own GNSS; its origin is not known
    assert (first.frame_id, first.child_frame_id, first.quality, first.reset_counter) == (frame, 12, quality, 3)
    assert (first.time_usec, second.time_usec) == (t_ns // 1000, (t_ns + SECOND) // 1000)


def test_a_landed_state_is_passed_on_unless_of_a_boat() -> None:
    with _px4() as (_, inbox, clock, autopilot):

        def say(kind: int, state: int) -> None:
            autopilot.say(mavlink.MAVLink_heartbeat_message(kind, PX4, 0, 0, 4, 3))
            autopilot.say(mavlink.MAVLink_extended_sys_state_message(0, state))

        say(mavlink.MAV_TYPE_SURFACE_BOAT, 3)
        say(mavlink.MAV_TYPE_QUADROTOR, 1)
        _soon(lambda: inbox.of(Reading), "the state")
        (landed,) = inbox.of(Reading)
        assert (landed.topic, landed.kind, landed.values) == ("/landed", "rest", (1.0,))
        assert abs(landed.t_ns - clock.now_ns()) < 60 * SECOND


def _say_origin(autopilot: UdpAutopilot, away_n: tuple[float, float, float]) -> None:
    """EKF's, so far from the map's; its height is above the sea."""
    lat, lon, alt_m = ORIGIN.to_geodetic(away_n)
    there = mavlink.MAVLink_gps_global_origin_message(round(lat * 1e7), round(lon * 1e7), round((alt_m - 47.5) * 1e3))
    autopilot.origin = there if autopilot.kind == PX4 else None  # it is asked again
    autopilot.say(there)


def test_odometry_for_ardupilot_counts_from_its_origin_and_is_not_to_be_used_before_that_is_known() -> None:
    """EKF3 takes ODOMETRY relative to its own origin: with that of the map, 360 m away, the vehicle left at the switch."""
    with _px4(kind=ARDUPILOT) as (link, _, clock, autopilot):
        t_ns, sent = clock.now_ns(), 0

        def answer() -> Any:
            nonlocal sent
            sent += 1
            estimate = _estimate(t_ns + sent * SECOND)
            link.send([replace(estimate, covariance=0.01 * estimate.covariance)], [])
            autopilot.until(lambda: len(autopilot.of("ODOMETRY")) == sent, "odometry")
            return autopilot.of("ODOMETRY")[-1]

        autopilot.until(lambda: EKF_ORIGIN in _requested(autopilot.heard), "its origin is asked for")
        first = answer()
        assert (first.quality, first.reset_counter, link.report()["quality"]) == (-1, 3, -1)
        assert "not known" in link.report()["ekf_origin"]
        _say_origin(autopilot, (-216.0, 288.0, 10.0))
        autopilot.until(lambda: "not known" not in link.report()["ekf_origin"], "its origin is known")
        second, third = answer(), answer()
        assert min(second.quality, third.quality) > 90
        shifted = [10.0 + 216.0, 20.0 - 288.0, -30.0 - 10.0]
        assert [second.x, second.y, second.z] == pytest.approx(shifted, abs=1.0)  # 0.3 % of its sphere
        assert second.reset_counter == third.reset_counter == 4  # it was of no use, now it is
        assert link.report()["ekf_origin"] == "-216 m north, 288 m east, -10 m above the map's"
        _say_origin(autopilot, (-216.0, 388.0, 10.0))
        autopilot.until(lambda: "388 m east" in link.report()["ekf_origin"], "it has moved")
        moved = answer()
        wide = replace(_estimate(t_ns + (sent + 1) * SECOND), covariance=100.0 * np.eye(15))
        link.send([wide], [])
        assert [line.removeprefix("ardupilot: odometry ") for line in said] == [
            "is not to be used: the origin of EKF3 is not known: ODOMETRY has quality -1",
            "may be used",
            "is not to be used: its 95 % radius is above 15 m",
        ]
        assert (moved.y - third.y, moved.reset_counter, moved.quality) == (pytest.approx(-100.0, abs=0.5), 5, third.quality)
        assert link.report()["refused"] == link.report()["defects"] == 0


def test_odometry_for_px4_counts_from_its_origin_which_is_asked_for() -> None:
    """EKF2 takes it so as well: in the simulator it jumped by the 337 m between the origins, and the vehicle left."""
    with _px4() as (link, _, clock, autopilot):
        autopilot.until(lambda: "not known" not in link.report()["ekf_origin"], "its origin is known")
        t_ns = clock.now_ns()
        link.send([_estimate(t_ns - SECOND)], [])
        _say_origin(autopilot, (-216.0, 288.0, 10.0))
        autopilot.until(lambda: "-216 m north, 288 m east" in link.report()["ekf_origin"], "it has moved")
        link.send([_fused(t_ns), _estimate(t_ns)], [])
        autopilot.until(lambda: len(autopilot.of("ODOMETRY")) == 2, "odometry")
        sent = autopilot.of("ODOMETRY")[-1]
        assert sent.quality > 0
        assert [sent.x, sent.y, sent.z] == pytest.approx([226.0, -268.0, -40.0], abs=1.0)  # 0.3 % of its sphere


def test_until_px4_has_had_time_to_answer_odometry_is_not_to_be_used() -> None:
    with _px4() as (link, _, clock, autopilot):
        autopilot.origin, link._local = None, LocalOrigin()
        t_ns = clock.now_ns()
        link.send([_fused(t_ns), _estimate(t_ns)], [])
        autopilot.until(lambda: autopilot.of("ODOMETRY"), "odometry")
        assert autopilot.of("ODOMETRY")[-1].quality == -1
        link._since_ns -= 6 * SECOND  # indoors it has none, and takes odometry as it is
        link.send([_fused(t_ns + SECOND), _estimate(t_ns + SECOND)], [])
        autopilot.until(lambda: len(autopilot.of("ODOMETRY")) == 2, "odometry")
        last = autopilot.of("ODOMETRY")[-1]
        assert (last.quality > 0, last.x, last.y, last.z) == (True, 10.0, 20.0, -30.0)


@pytest.mark.parametrize("kind", [PX4, ARDUPILOT])
def test_where_the_position_is_of_no_use_px4_is_told_the_velocity_alone(kind: int) -> None:
    with _px4(kind=kind) as (link, _, clock, autopilot):
        _say_origin(autopilot, (0.0, 0.0, 0.0))
        autopilot.until(lambda: "not known" not in link.report()["ekf_origin"], "its origin is known")
        t_ns = clock.now_ns()
        wide = replace(_estimate(t_ns), covariance=np.diag([400.0] * 3 + [0.01] * 12), mode=Mode.ODOMETRY)
        link.send([_fused(t_ns), wide], [])
        autopilot.until(lambda: autopilot.of("ODOMETRY"), "odometry")
        sent = autopilot.of("ODOMETRY")[-1]
        assert np.isfinite([sent.vx, sent.vy, sent.vz, *sent.q, *sent.velocity_covariance]).all()
        if kind == PX4:
            assert np.isnan([sent.x, sent.y, sent.z]).all()
            assert sent.quality == 76  # 95 % within 0.24 of 1 m/s
            assert said == ["px4: of odometry the velocity may be used, not the position"]
        else:
            assert np.isfinite([sent.x, sent.y, sent.z]).all()
            assert sent.quality == -1


@pytest.mark.parametrize("own", [False, True], ids=["without-gnss", "with-its-gnss"])
def test_an_ardupilot_without_an_origin_is_given_its_place_where_no_gnss_of_its_own_was_fused(own: bool) -> None:
    """EKF3 counts heights from the zero of the barometer: given another, its height swings, and the copter may not lift off."""
    with _px4(kind=ARDUPILOT) as (link, _, clock, autopilot):
        t_ns = clock.now_ns()
        link._since_ns -= 6 * SECOND  # it has had time to answer
        link.send([*([_fused(t_ns, "gnss_position")] if own else []), _fused(t_ns), _estimate(t_ns)], [])
        autopilot.until(lambda: autopilot.of("ODOMETRY"), "odometry")
        autopilot.listen(0.05)
        given = [(m.latitude, m.longitude, m.altitude) for m in autopilot.of("SET_GPS_GLOBAL_ORIGIN")]
        lat, lon, alt_m = ORIGIN.to_geodetic((10.0, 20.0, -30.0))
        assert given == ([] if own else [(round(lat * 1e7), round(lon * 1e7), round(1e3 * (alt_m - 47.5)))])
        assert autopilot.of("ODOMETRY")[-1].quality == -1


@pytest.mark.parametrize("own", [False, True], ids=["without-gnss", "with-its-gnss"])
def test_a_px4_without_an_origin_is_given_ours_at_its_height_once_it_has_our_odometry(own: bool) -> None:
    """Without one it has no global position: "Resolve system health failures first", and a take-off that stays on the ground."""
    with _px4() as (link, _, clock, autopilot):
        autopilot.origin, link._local = None, LocalOrigin()
        link._since_ns -= 6 * SECOND
        t_ns = clock.now_ns()
        for k in range(5):
            link.send(
                [*([_fused(t_ns, "gnss_position")] if own else []), _fused(t_ns + k * SECOND), _estimate(t_ns + k * SECOND)], []
            )
            autopilot.until(partial(_has_come, autopilot, k + 1), "odometry")
            autopilot.listen(0.02)
            given = [(m.latitude, m.longitude, m.altitude) for m in autopilot.of("SET_GPS_GLOBAL_ORIGIN")]
            height_m = ORIGIN.to_geodetic((10.0, 20.0, -30.0))[2] - 47.5
            ours = [(round(ORIGIN.lat_deg * 1e7), round(ORIGIN.lon_deg * 1e7), round(1e3 * height_m))]
            assert given == (ours if k >= 3 and not own else [])
        assert [autopilot.of("ODOMETRY")[-1].x, autopilot.of("ODOMETRY")[-1].z] == [10.0, -30.0]


def test_a_change_of_integrity_is_said_once_and_ends_the_use_of_the_odometry() -> None:
    with _px4() as (link, _, clock, autopilot):
        for k, state in enumerate([Alert.USABLE, Alert.DO_NOT_USE, Alert.DO_NOT_USE, Alert.USABLE]):
            t_ns = clock.now_ns() + k * SECOND
            reason = f"HPL {30 + k}.4 m, limit 10 m: /pose_fix wrong for long" if state is Alert.DO_NOT_USE else ""
            integrity = Integrity(t_ns, t_ns, state, reason, 1e-5, 3.0, 3.0, 10.0, 10.0, (), (), (), 0.1, 0.1)
            link.send([_estimate(t_ns), _fused(t_ns), integrity], ())
        autopilot.until(lambda: len(autopilot.of("ODOMETRY")) == 4, "four estimates")
        parts = [(m.severity, m.id, m.chunk_seq, m.text) for m in autopilot.of("STATUSTEXT")]
        assert [severity for severity, *_ in parts] == [6, 2, 2, 6]
        assert parts[1] == (2, 2, 0, "landfix: do not use, HPL 31.4 m, limit 10 m: /pose")
        assert parts[2] == (2, 2, 1, "_fix wrong for long")
        assert [number for _, number, *_ in parts] == [0, 2, 2, 0]
        assert [m.quality for m in autopilot.of("ODOMETRY")] == [84, -1, -1, 84]
        assert said == [
            f"px4: odometry {line}" for line in ("may be used", "is not to be used: so says integrity", "may be used")
        ]  # not once more for another number


def test_after_a_reboot_of_ardupilot_its_old_origin_is_not_used() -> None:
    with _px4(kind=ARDUPILOT) as (link, _, clock, autopilot):
        _say_origin(autopilot, (0.0, 0.0, 0.0))
        autopilot.until(
            lambda: "not known" not in link.report()["ekf_origin"] and link.report()["timesync_answers"], "all is known"
        )
        autopilot.imu()
        autopilot.booted_ns = time.monotonic_ns() - SECOND

        def rebooted() -> bool:
            autopilot.imu()
            return bool(link.report()["reboots"] == 1 and "not known" in link.report()["ekf_origin"])

        autopilot.until(rebooted, "the reboot is noticed", beats=False)
        link.send([_estimate(clock.now_ns())], [])
        autopilot.until(lambda: autopilot.of("ODOMETRY"), "odometry")
        assert autopilot.of("ODOMETRY")[-1].quality == -1


def test_an_origin_that_is_no_place_is_refused_and_without_an_origin_of_the_map_it_is_of_no_use() -> None:
    with _px4(kind=ARDUPILOT) as (link, _, clock, autopilot):
        autopilot.say(mavlink.MAVLink_gps_global_origin_message(0, 0, 0))
        autopilot.until(lambda: link.report()["refused"] == 1, "it is refused")
        _say_origin(autopilot, (0.0, 0.0, 0.0))
        autopilot.until(lambda: "not known" not in link.report()["ekf_origin"], "it is known")
        link.send([replace(_estimate(clock.now_ns()), origin=None)], [])
        autopilot.until(lambda: autopilot.of("ODOMETRY"), "odometry")
        assert autopilot.of("ODOMETRY")[-1].quality == -1
        assert "[map] origin" in link.report()["ekf_origin"]


@pytest.mark.parametrize(("kind", "name"), [(PX4, "GLOBAL_POSITION_SENSOR"), (ARDUPILOT, "GPS_INPUT")])
def test_a_fix_goes_out_when_one_entered_and_not_what_rests_on_its_own_receiver(kind: int, name: str) -> None:
    with _px4(kind=kind) as (link, _, clock, autopilot):
        t_ns = clock.now_ns()
        link.send([_fused(t_ns, "gnss_position"), _fused(t_ns), _estimate(t_ns)], [])
        link.send([_estimate(t_ns + 7 * SECOND)], [])
        link.send([_fused(t_ns + 8 * SECOND), _estimate(t_ns + 8 * SECOND)], [])
        link.send([_estimate(t_ns + 8 * SECOND + 1)], [])
        autopilot.until(lambda: autopilot.of(name), "a fix")
        autopilot.listen(0.1)
        (fix,) = autopilot.of(name)
        assert autopilot.of("ODOMETRY")[-1].quality == (84 if kind == PX4 else -1)  # 95 % within 2.4 of 15 m; no origin
    lat, lon, alt_m = ORIGIN.to_geodetic((10.0, 20.0, -30.0))
    assert fix.time_usec == (t_ns + 8 * SECOND) // 1000
    assert (fix.lat * 1e-7, fix.lon * 1e-7) == pytest.approx((lat, lon), abs=1e-7)
    assert fix.alt == pytest.approx(alt_m - 47.5, abs=1e-3)


def test_nothing_that_is_not_a_number_is_reported_and_nothing_to_nobody() -> None:
    with _px4() as (link, _, clock, autopilot):
        torn = _estimate(clock.now_ns())
        torn.nav[0] = np.nan
        link.send([torn], [])
        autopilot.listen(0.1)
        assert (autopilot.of("ODOMETRY"), link.report()["odometry"]) == ([], 0)
    with _linked(MavlinkConfig(endpoint="udpin:127.0.0.1:0")) as (link, _, clock):
        link.send([_estimate(clock.now_ns())], [])
        assert link.report()["odometry"] == 0


@pytest.mark.parametrize("messages", [("SYSTEM_TIME",), ("HIGHRES_IMU",)])
def test_after_a_reboot_it_asks_again_and_finds_the_new_clock(messages: tuple[str]) -> None:
    with _px4() as (link, inbox, _, autopilot):
        autopilot.until(lambda: link.report()["timesync_answers"] and len(_requested(autopilot.heard)) == 7, "all is set up")
        autopilot.imu()
        autopilot.booted_ns = time.monotonic_ns() - SECOND
        autopilot.heard.clear()

        def rebooted() -> bool:
            if "SYSTEM_TIME" in messages:
                autopilot.say(mavlink.MAVLink_system_time_message(0, autopilot.boot_us() // 1000))
            else:
                autopilot.imu()
            return link.report()["reboots"] == 1 and len(_requested(autopilot.heard)) == 7

        autopilot.until(rebooted, "the reboot is noticed", beats=False)
        got = len(inbox.got)
        autopilot.imu()
        autopilot.until(lambda: len(inbox.got) > got, "the next sample")
        sample, arrived_ns = inbox.got[-1]
        assert abs(arrived_ns - sample.t_ns) < SECOND // 10


def test_after_a_silence_it_asks_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimator.service.mavlink.link._GONE_NS", SECOND // 2)
    with _px4() as (link, _, _, autopilot):
        autopilot.until(lambda: len(_requested(autopilot.heard)) == 7, "all are asked for")
        autopilot.listen(0.7)
        autopilot.heard.clear()
        autopilot.heartbeat()
        autopilot.listen(0.2)
        assert len(_requested(autopilot.heard)) == 7
        assert link.report()["reboots"] == 0


def test_a_single_implausible_stamp_is_not_used() -> None:
    with _px4() as (link, inbox, _, autopilot):
        autopilot.until(lambda: link.report()["timesync_answers"], "clocks are in step")
        autopilot.imu(boot_us=2**62)
        autopilot.imu(boot_us=0)
        autopilot.imu()
        autopilot.until(lambda: inbox.got, "the good one")
        autopilot.listen(0.1)
        assert len(inbox.got) == 1
        assert (link.report()["implausible_stamps"], link.report()["reboots"]) == (2, 0)


def test_a_receiver_without_a_fix_is_heard_and_its_old_stamps_are_no_reboot() -> None:
    with _px4(kind=ARDUPILOT) as (link, inbox, clock, autopilot):
        autopilot.until(lambda: link.report()["timesync_answers"], "clocks are in step")
        for stamp_us in [0] * 6 + [autopilot.boot_us() - 60_000_000] * 6:
            autopilot.say(mavlink.MAVLink_gps_raw_int_message(stamp_us, 1, 0, 0, 0, 65535, 65535, 0, 0, 0))
        autopilot.until(lambda: len(inbox.got) == 12, "twelve without a fix")
        assert all(fix.status < 0 and abs(fix.t_ns - clock.now_ns()) < 10 * SECOND for fix in inbox.of(GnssFix))
        assert (link.report()["implausible_stamps"], link.report()["reboots"]) == (0, 0)


def test_raw_imu_stands_in_with_a_warning_until_the_good_one_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("estimator.service.mavlink.inputs._MISSING_NS", SECOND // 2)
    with _px4(kind=ARDUPILOT) as (link, inbox, _, autopilot):

        def raw() -> bool:
            autopilot.say(mavlink.MAVLink_raw_imu_message(autopilot.boot_us(), 100, 200, -1000, 10, 20, 30, 0, 0, 0))
            return bool(inbox.got)

        autopilot.until(raw, "the coarse one is taken")
        autopilot.until(lambda: RAW in _requested(autopilot.heard), "it is asked for, though it comes by itself: at which rate?")
        assert "coarse" in link.report()["imu"]
        autopilot.imu()
        autopilot.until(lambda: link.report()["imu"] == "HIGHRES_IMU", "the good one is taken")
        got = len(inbox.got)
        raw()
        autopilot.listen(0.1)
        assert len(inbox.got) == got


def test_a_flood_of_garbage_costs_no_message() -> None:
    rng = np.random.default_rng(7)
    with _px4() as (link, inbox, _, autopilot):
        good = autopilot.pack(mavlink.MAVLink_heartbeat_message(2, PX4, 0, 0, 4, 3))
        for k in range(1000):  # in one second
            torn = bytearray(good)
            torn[int(rng.integers(len(torn)))] ^= 1 << int(rng.integers(8))
            kinds = (
                bytes(rng.integers(0, 256, 60, np.uint8)),
                bytes(torn),
                b"\xfd\xff" + bytes(rng.integers(0, 256, 40, np.uint8)),
            )
            autopilot.write(kinds[k % 3])
            if k % 10 == 0:
                autopilot.imu()
                autopilot.listen(0.01)
        autopilot.until(lambda: len(inbox.of(ImuSample)) == 100, "every sample")
        assert link.report()["damaged"] > 900
        assert link.report()["defects"] == 0


def test_others_are_not_listened_to() -> None:
    with _linked(MavlinkConfig(endpoint="udpin:127.0.0.1:0")) as (link, inbox, _):
        port = link._endpoint.port  # type: ignore[attr-defined]
        autopilot, camera, stranger = UdpAutopilot(to=port), UdpAutopilot(to=port, component=100), UdpAutopilot(to=port)
        autopilot.heartbeat()
        autopilot.until(lambda: link.report()["autopilot"] == "px4", "it is known")
        camera.imu()
        stranger.imu(z=9.8)
        autopilot.say(mavlink.MAVLink_vfr_hud_message(0, 0, 0, 0, 0, 0))
        autopilot.imu()
        autopilot.until(lambda: inbox.got and link.report()["strangers"] == 1, "the sample")
        assert [s.accel_b[2] for s in inbox.of(ImuSample)] == pytest.approx([-9.8])
        assert link.report()["passed_over"] >= 2  # of the camera; VFR_HUD
        assert stranger.listen(0.1) == []
        for end in (autopilot, camera, stranger):
            end.close()


def _camera_pose(t_us: int) -> Any:
    zeros = [0.0] * 21
    return mavlink.MAVLink_odometry_message(t_us, 20, 12, 1, 2, 3, [1, 0, 0, 0], *[0] * 6, zeros, zeros, estimator_type=3)


def test_odometry_of_a_companion_comes_in_on_its_clock_or_the_autopilots_and_the_autopilots_own_does_not() -> None:
    topics = Topics(odometry=("/odometry",))
    with (
        closing(UdpAutopilot()) as autopilot,
        _linked(MavlinkConfig(f"udpout:127.0.0.1:{autopilot.port}", odometry_from=(198,)), topics=topics) as (link, inbox, clock),
    ):
        autopilot.until(lambda: link.report()["timesync_answers"] >= 3, "clocks are in step")
        camera = mavlink.MAVLink(None, srcSystem=1, srcComponent=198)
        now_ns = clock.now_ns()
        for t_us in (now_ns // 1000, autopilot.boot_us(), now_ns // 1000 - 60_000_000):
            autopilot.write(bytes(_camera_pose(t_us).pack(camera)))
        autopilot.say(_camera_pose(autopilot.boot_us()))
        autopilot.imu()
        autopilot.until(lambda: inbox.of(ImuSample), "the sample after them")
        poses = inbox.of(OdometryPose)
        assert [abs(p.t_ns - now_ns) < SECOND // 50 for p in poses] == [True, True]
        assert (link.report()["implausible_stamps"], link.report()["defects"]) == (1, 0)


@pytest.mark.parametrize("component", [1, 197])
def test_odometry_of_the_autopilot_or_of_ourselves_is_refused(component: int) -> None:
    with (
        pytest.raises(ConfigError, match="is the autopilot or landfix itself"),
        _linked(MavlinkConfig("udpin:127.0.0.1:0", odometry_from=(component,))),
    ):
        pass


def test_signed_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "key").write_text(PASSPHRASE + "\n")
    (tmp_path / "key").chmod(0o600)
    unsigned, forger, friend = UdpAutopilot(), UdpAutopilot(passphrase="a guess"), UdpAutopilot(passphrase=PASSPHRASE)
    config = MavlinkConfig(endpoint="udpin:127.0.0.1:0", signing_key_file="key")
    with _linked(config, tmp_path) as (link, inbox, _):
        for end in (unsigned, forger, friend):
            end._to = "127.0.0.1", link._endpoint.port  # type: ignore[attr-defined]
        unsigned.heartbeat()
        forger.codec.signing.timestamp += 10**9
        forger.heartbeat()
        unsigned.listen(0.1)
        assert (link.report()["autopilot"], link.report()["refused_signatures"]) == ("unknown", 2)
        friend.heartbeat()
        friend.until(lambda: link.report()["autopilot"] == "px4", "the friend is heard, whatever time the forger claimed")
        recorded = friend.imu()
        friend.until(lambda: inbox.got, "a sample")
        refused = link.report()["refused_signatures"]
        for _ in range(3):
            friend.write(recorded)
        friend.until(lambda: link.report()["refused_signatures"] == refused + 3, "replays are refused")
        assert len(inbox.got) == 1
        friend.until(lambda: friend.of("TIMESYNC"), "we are heard, signed")
        assert friend.of("TIMESYNC")[-1].get_signed()
    for end in (unsigned, forger, friend):
        end.close()


def test_the_same_over_a_serial_line_that_is_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    device, autopilot = tmp_path / "ttyAutopilot", SerialAutopilot()
    device.symlink_to(autopilot.path)
    with _linked(MavlinkConfig(endpoint=str(device), baud=57600)) as (link, inbox, clock):
        autopilot.until(lambda: link.report()["timesync_answers"], "clocks are in step")
        torn = autopilot.pack(mavlink.MAVLink_heartbeat_message(2, PX4, 0, 0, 4, 3))[:-3]
        for k in range(300):
            autopilot.imu()
            if k == 100:
                autopilot.write(b"\x00" * 50)
            if k == 200:
                autopilot.write(torn)
        autopilot.until(lambda: len(inbox.of(ImuSample)) == 300, "all samples: a torn frame costs only itself")
        link.send([_estimate(clock.now_ns())], [])
        autopilot.until(lambda: autopilot.of("ODOMETRY"), "odometry")
        autopilot.close()
        _soon(lambda: link.report()["state"] != "open", "the loss is noticed")
        again = SerialAutopilot()
        device.unlink()
        device.symlink_to(again.path)
        got = len(inbox.got)
        again.until(lambda: link.report()["state"] == "open", "it is open again")
        again.imu()
        again.booted_ns = autopilot.booted_ns

        def sampled() -> bool:
            again.imu()
            return len(inbox.got) > got

        again.until(sampled, "samples come again")
        again.close()


def test_sending_never_waits_for_a_line_that_is_stuck() -> None:
    autopilot = SerialAutopilot()
    with _linked(MavlinkConfig(endpoint=autopilot.path)) as (link, _, clock):
        autopilot.until(lambda: link.report()["autopilot"] == "px4", "it is known")
        finished = threading.Event()

        def flood() -> None:
            for k in range(500):
                link.send([_estimate(clock.now_ns() + k * SECOND)], [])
                autopilot.heartbeat()
            finished.set()

        threading.Thread(target=flood, daemon=True).start()
        assert finished.wait(60.0)
        assert link.report()["unsent"] > 0
        autopilot.until(lambda: autopilot.of("ODOMETRY"), "what was on the line")
        autopilot.listen(0.2)
        t_ns = clock.now_ns() + 1000 * SECOND
        for k in range(10):  # the line runs again: whole frames only
            link.send([_estimate(t_ns + k * SECOND)], [])
            autopilot.listen(0.02)
        autopilot.until(lambda: autopilot.of("ODOMETRY")[-1].time_usec == (t_ns + 9 * SECOND) // 1000, "the last")
        assert autopilot.of("BAD_DATA") == []
    autopilot.close()


def test_a_flight_over_mavlink_is_flown_sent_logged_and_replayed_to_the_same_bytes(tmp_path: Path) -> None:
    """Its receiver falls silent on the way: from then on the fixes from outside are news to it."""
    with closing(UdpAutopilot()) as autopilot:
        section = f'[mavlink]\nendpoint = "udpout:127.0.0.1:{autopilot.port}"\nattitude_sigma_deg = [1.0, 3.0]\n'
        section += '[inputs]\nattitude = "/attitude"\n[autopilot]\ngnss_quiet_s = 2.0\n'
        text = toml(tmp_path, 1, more=section, zenoh_keys="enabled = false")
        with in_thread(parse(text), tmp_path) as daemon:
            autopilot.until(lambda: len(autopilot.of("TIMESYNC")) > 3, "clocks are in step")
            flight = Flight(autopilot, daemon, np.random.default_rng(2))
            # whichever aligns the estimator is trusted at once; a receiver that comes second is on probation
            flight.until(lambda: _are_active(daemon, "/gnss", "/pose_fix"), "all are fused")
            autopilot.heard.clear()
            flight.until(lambda: len(autopilot.of("ODOMETRY")) > 20, "it is reported")
            assert {m.quality for m in autopilot.of("ODOMETRY")} <= {-1, 0}  # -1: its IMU was not heard for a moment
            assert autopilot.of("GLOBAL_POSITION_SENSOR") == []
            flight.has_gnss = False
            flight.until(lambda: len(autopilot.of("GLOBAL_POSITION_SENSOR")) > 3, "fixes from outside are sent")
            flight.until(lambda: any(m.quality > 80 for m in autopilot.of("ODOMETRY")), "its quality is sent")
        sent, fixes = autopilot.of("ODOMETRY"), autopilot.of("GLOBAL_POSITION_SENSOR")
    (log,) = logs_of(tmp_path)
    assert errors_in_sigma(odometry(log)).max() < 5.0
    assert len(records(log, "/attitude")) > 10
    assert max(m.quality for m in sent) > 80
    assert 20 < len(sent) <= 30e-6 * (sent[-1].time_usec - sent[0].time_usec) + 2  # 30 a second
    assert len(fixes) <= flight.samples / 20  # fixes from outside
    for heard in sent:
        error = np.subtract([heard.x, heard.y, heard.z], truth(heard.time_usec * 1000)[0])
        assert (np.abs(error) < 5.0 * np.sqrt([heard.pose_covariance[k] for k in (0, 6, 11)])).all()
    for fix in fixes:
        error = np.subtract(ORIGIN.to_ned(fix.lat * 1e-7, fix.lon * 1e-7, fix.alt_ellipsoid), truth(fix.time_usec * 1000)[0])
        assert (np.abs(error) < 5.0 * np.array([fix.eph, fix.eph, fix.epv])).all()
    assert_replay_says_the_same(log, text)


def _are_active(daemon: Daemon, *topics: str) -> bool:
    health = daemon._status.health
    return health is not None and all(health.sources.get(topic) == "active" for topic in topics)
