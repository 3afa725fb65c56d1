"""PX4's receiver over Zenoh: the bytes of SensorGps of each release, from its own definition, through a real session."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from estimator.service.autopilot import px4_messages as px4
from estimator.service.autopilot.output_policy import AutopilotConfig, OutputPolicy, Px4Config
from estimator.service.base.clock import Clock
from estimator.service.base.mailbox import Mailbox
from estimator.service.log.writer import LogConfig, LogWriter
from estimator.service.zenoh.keys import attachment
from estimator.service.zenoh.px4_link import GNSS_TOPIC, Px4Link
from logs.wire.axes import ImuMounting
from logs.wire.codec import Decoder, Topics
from models.messages import GnssFix, GnssVelocity, Reading, ReceiverState
from tests.estimator.service.flying import free_port, until

SECOND, BOOT_US = 1_000_000_000, 90_000_000
SCHEMA = "px4_msgs/msg/SensorGps"
HEAD = """uint64 timestamp
uint64 timestamp_sample
uint32 device_id
float64 latitude_deg
float64 longitude_deg
float64 altitude_msl_m
float64 altitude_ellipsoid_m
float32 s_variance_m_s
float32 c_variance_rad
uint8 fix_type
float32 eph
float32 epv
float32 hdop
float32 vdop
int32 noise_per_ms
uint16 automatic_gain_control
uint8 jamming_state
int32 jamming_indicator
uint8 spoofing_state
"""
MIDDLE = """float32 vel_m_s
float32 vel_n_m_s
float32 vel_e_m_s
float32 vel_d_m_s
float32 cog_rad
bool vel_ned_valid
int32 timestamp_time_relative
uint64 time_utc_usec
uint8 satellites_used
"""
TAIL = "float32 heading\nfloat32 heading_offset\nfloat32 heading_accuracy\nfloat32 rtcm_injection_rate\n"
TAIL += "uint8 selected_rtcm_instance\nbool rtcm_crc_failed\nuint8 rtcm_msg_used\n"
ANTENNA = "float32 antenna_offset_x\nfloat32 antenna_offset_y\nfloat32 antenna_offset_z\n"
RELEASES = {
    "1.15": HEAD + MIDDLE + TAIL,
    "1.17": HEAD + "uint8 authentication_state\n" + MIDDLE + "uint32 system_error\n" + TAIL,
    "1.18": HEAD + "uint8 authentication_state\n" + MIDDLE + "uint32 system_error\n" + TAIL + ANTENNA,
}
LANDED = bytes([0, 1, 0, 0]) + bytes(8) + bytes([0, 0, 0, 1]) + bytes(8)  # of a VehicleLandDetected, from the encapsulation on
FIX = {
    "timestamp": BOOT_US,
    "timestamp_sample": BOOT_US - 100_000,
    "latitude_deg": 47.1,
    "longitude_deg": 8.2,
    "altitude_msl_m": 450.0,
    "altitude_ellipsoid_m": 497.5,
    "s_variance_m_s": 0.5,
    "fix_type": 3,
    "eph": 2.0,
    "epv": 3.0,
    "vel_m_s": 9.0,
    "vel_n_m_s": 1.0,
    "vel_e_m_s": 2.0,
    "vel_d_m_s": -3.0,
    "vel_ned_valid": True,
}


def _bytes(release: str, **changes: float) -> bytes:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(RELEASES[release], SCHEMA))
    values: dict[str, Any] = dict.fromkeys((line.split()[1] for line in RELEASES[release].splitlines()), 0)
    values["rtcm_crc_failed"] = False
    return bytes(store.serialize_cdr(store.types[SCHEMA](**(values | FIX | changes)), SCHEMA))


@pytest.mark.parametrize("release", RELEASES)
def test_the_fields_of_each_release_are_read_as_they_were_meant(release: str) -> None:
    read = px4.receiver(_bytes(release, noise_per_ms=77, automatic_gain_control=9, jamming_indicator=5), 40.0, "/x")
    assert read is not None
    fix, velocity, signal = read
    assert velocity is not None
    assert signal == "jamming indicator 5 of 255, gain 0 %, noise 77"
    assert (fix.t_ns, fix.lat_deg, fix.lon_deg, fix.alt_m, fix.status) == (89_900_000_000, 47.1, 8.2, 497.5, 0)
    assert fix.state is ReceiverState.UNKNOWN
    assert velocity.v_n == (1.0, 2.0, -3.0)
    np.testing.assert_array_equal(fix.covariance_n, np.diag([4.0, 4.0, 9.0]))
    np.testing.assert_array_equal(velocity.covariance_n, 0.25 * np.eye(3))
    elsewhere = px4.receiver(_bytes(release, latitude_deg=214.7), 40.0, "/x")
    assert elsewhere is not None
    assert elsewhere[1] is None, "a velocity beside a position that is no place on Earth"


@pytest.mark.parametrize(
    ("jamming", "spoofing", "state"), [(1, 1, 0), (2, 1, 0), (3, 1, 1), (0, 2, 1), (1, 3, 2), (3, 3, 2), (255, 255, 0)]
)
def test_its_flags_are_those_of_mavlink(jamming: int, spoofing: int, state: int) -> None:
    read = px4.receiver(_bytes("1.18", jamming_state=jamming, spoofing_state=spoofing), 0.0, "/x")
    assert read is not None
    assert read[0].state is ReceiverState(state)


def test_what_is_not_given_is_not_made_up() -> None:
    read = px4.receiver(_bytes("1.17", eph=0.0, vel_ned_valid=False, altitude_ellipsoid_m=0.0), 47.5, "/x")
    assert read is not None
    assert (read[0].covariance_n, read[0].alt_m, read[1]) == (None, 497.5, None)
    assert read[2] == ""
    assert px4.receiver(_bytes("1.17")[:100], 0.0, "/x") is None


@pytest.mark.parametrize("release", ["1.17", "1.18"])
def test_authentication_is_shown(release: str) -> None:
    read = px4.receiver(_bytes(release, authentication_state=3, automatic_gain_control=8191), 0.0, "/x")
    assert read is not None
    assert (read[0].state, read[2]) == (ReceiverState.UNKNOWN, "gain 100 %, authenticated")


def test_its_fixes_come_over_zenoh_in_our_time(tmp_path: Path) -> None:
    port, clock = free_port(), Clock()
    topics = Topics(gnss=(GNSS_TOPIC,), gnss_velocity=(f"{GNSS_TOPIC}/velocity",))
    with contextlib.ExitStack() as stack:
        log = stack.enter_context(contextlib.closing(LogWriter(LogConfig(enabled=False), lambda n: tmp_path / f"{n}", {})))
        ours, theirs = (stack.enter_context(zenoh.open(_peer(port, role))) for role in ("listen", "connect"))
        mailbox = Mailbox(clock, log, [], ImuMounting())
        link = Px4Link(Px4Config(), ours, 0, clock, OutputPolicy(AutopilotConfig()), 30.0, 0.0)
        link.open_inputs(mailbox, topics)
        key = f"0{GNSS_TOPIC}/px4_msgs::msg::dds_::SensorGps_/RIHS01_{'0' * 64}"

        def arrives() -> bool:
            theirs.put(key, _bytes("1.18", spoofing_state=3, jamming_indicator=7), attachment=attachment(1, BOOT_US, bytes(16)))
            theirs.put(
                key.replace(GNSS_TOPIC, "/fmu/out/vehicle_land_detected"), LANDED, attachment=attachment(1, BOOT_US, bytes(16))
            )
            return len(mailbox) > 3

        until(arrives, "a fix arrives", 20.0)
        assert link.report()["receiver"] == "jamming indicator 7 of 255"
        now_ns, decoder = clock.now_ns(), Decoder(topics)
        arrivals = [a for _ in range(len(mailbox)) if (a := mailbox.get(1.0)) is not None]
        measured = [decoder.decode(a.topic, a.schema, a.data, a.arrived_ns) for a in arrivals]
    fix = next(m for m in measured if isinstance(m, GnssFix))
    velocity = next(m for m in measured if isinstance(m, GnssVelocity))
    assert fix.state is ReceiverState.SPOOFED
    assert velocity.topic == f"{fix.topic}/velocity"
    assert abs(now_ns - 100_000_000 - fix.t_ns) < 20 * SECOND
    assert fix.t_ns == velocity.t_ns
    assert {(m.topic, m.kind, m.values) for m in measured if isinstance(m, Reading)} == {("/landed", "rest", (1.0,))}
    assert px4.landed(LANDED[:15] + bytes(9)) == 2.0
    assert px4.landed(LANDED[:15]) is None


def _peer(port: int, role: str) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{role}/endpoints", f'["tcp/127.0.0.1:{port}"]')
    return config
