"""Numbers that no field holds: what goes to an autopilot is right or left out; what comes from one is taken or refused."""

import math
import socket
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink
from pymavlink.generator.mavcrc import x25crc
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from benchmarks.service.vehicle import ORIGIN
from estimator.config import Config, parse
from estimator.fusion import Fusion
from estimator.service.autopilot import px4_messages as px4
from estimator.service.autopilot.output_policy import AutopilotConfig, OutputPolicy, is_sound
from estimator.service.base.clock import Clock
from estimator.service.base.mailbox import Mailbox
from estimator.service.mavlink import codec
from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.mavlink.link import MavlinkLink
from estimator.service.run import _NoLog
from models import so3
from models.messages import AidStatus, Estimate, Mode, Reason, vec3
from models.state import X

SECOND = 1_000_000_000
T0 = 1_795_000_000 * SECOND
MANY = settings(max_examples=300, deadline=None, suppress_health_check=list(HealthCheck))
WIDTHS = {"int8_t": 8, "int16_t": 16, "int32_t": 32, "int64_t": 64}
RANGES = {name: (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for name, n in WIDTHS.items()} | {
    f"u{name}": (0, 2**n - 1) for name, n in WIDTHS.items()
}
STORE = get_typestore(Stores.EMPTY)
for name, text in px4.DEFINITIONS.items():
    STORE.register(get_types_from_msg(text, name))
INPUTS = parse('[inputs]\nattitude = "/attitude"\nbaro = "/baro"\ngnss = ["/gnss", "/gnss2"]').inputs

_absurd = st.one_of(
    st.floats(), st.sampled_from([0.0, -1.0, 1e9, 1e13, 3.5e38, 1e38, 1e154, 1e308, math.nan, math.inf, -math.inf, 5e-324])
)
_times = st.one_of(st.integers(-(2**70), 2**70), st.sampled_from([0, -1, T0, 300_000_000_000_000_000, 2**63 * 1000, 1_000]))


def _estimate(t_ns: int = T0) -> Estimate:
    nav = np.zeros(16)
    nav[X.P], nav[X.Q] = (10.0, 20.0, -30.0), so3.from_euler(0.1, -0.2, 2.0)
    return Estimate(t_ns, t_ns, nav, np.eye(15), (0.1, 0.2, 0.3), Mode.AIDED, 3, t_ns, ORIGIN.lla)


@st.composite
def _estimates(draw: st.DrawFn) -> Estimate:
    """A sound one, of which some numbers are anything."""
    e = _estimate(draw(_times))
    nav, cov, gyro, lla = e.nav.copy(), e.covariance.copy(), list(e.gyro_b), list(ORIGIN.lla)
    for numbers in (nav, cov.reshape(-1), gyro, lla):
        for k in draw(st.lists(st.integers(0, len(numbers) - 1), max_size=2)):
            numbers[k] = draw(_absurd)
    counter, absolute_ns = draw(st.integers(-(2**65), 2**65)), draw(_times)
    origin = draw(st.sampled_from([None, tuple(lla)]))
    return Estimate(e.t_ns, e.t_ns, nav, cov, tuple(gyro), draw(st.sampled_from(list(Mode))), counter, absolute_ns, origin)  # type: ignore[arg-type]


@pytest.fixture(scope="module", params=["px4", "ardupilot"])
def linked(request: pytest.FixtureRequest) -> Iterator[tuple[MavlinkLink, socket.socket]]:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as there:
        there.bind(("127.0.0.1", 0))
        there.settimeout(1.0)
        link = _link(there, autopilot=request.param)
        yield link, there
        link.close()


def _link(there: socket.socket, **keys: Any) -> MavlinkLink:
    config = MavlinkConfig(endpoint=f"udpout:127.0.0.1:{there.getsockname()[1]}", attitude_sigma_deg=(2.0, 4.0), **keys)
    return MavlinkLink(config, Path(), INPUTS, Clock(), OutputPolicy(AutopilotConfig(own_gnss=False)), 1000.0, 47.5)


@MANY
@given(e=_estimates(), unix_us=st.integers(0, 2**64 - 1))
def test_whatever_the_estimate_and_the_date_the_autopilot_gets_it_or_nothing(
    linked: tuple[MavlinkLink, socket.socket], e: Estimate, unix_us: int
) -> None:
    link, there = linked
    link._take(mavlink.MAVLink_heartbeat_message(2, link._autopilot, 0, 0, 4, 3), link._clock.now_ns(), None)  # type: ignore[arg-type]
    link._take(mavlink.MAVLink_system_time_message(unix_us, 0), link._clock.now_ns(), None)  # type: ignore[arg-type]
    before = link.sent_odometry + link.sent_fixes
    link.send([AidStatus(e.t_ns, e.t_ns, "/pose_fix", "pose", Reason.FUSED), e], [])
    parser = mavlink.MAVLink(None)
    for _ in range(link.sent_odometry + link.sent_fixes - before):
        (read,) = parser.parse_buffer(there.recv(1000))
        assert is_sound(e)
        assert read.time_usec == e.t_ns // 1000
        if read.get_type() == "ODOMETRY":
            np.testing.assert_allclose([read.x, read.y, read.z], e.nav[X.P], rtol=1e-6, atol=1e-40)
        else:
            lat, lon, _ = ORIGIN.lla if e.origin is None else type(ORIGIN)(*e.origin).to_geodetic(e.nav[X.P])
            assert (read.lat, read.lon) == (round(lat * 1e7), round(lon * 1e7))
        assert getattr(read, "time_week", 0) < 6300  # of the year 2100


def test_what_is_left_out_is_counted() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as there:
        there.bind(("127.0.0.1", 0))
        link = _link(there, autopilot="ardupilot")
        link._take(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), link._clock.now_ns(), None)  # type: ignore[arg-type]
        broken = _estimate()
        broken.nav[0] = math.nan
        for k, estimate in enumerate((_estimate(-SECOND), broken)):
            assert link.report()["out_of_range"] == k
            link.send([estimate], [])
            assert link.report()["out_of_range"] == k + 1
        impossible = 0
        for unix_us in (0, 1, T0 // 1000, 2**64 - 1):
            impossible += unix_us in {1, 2**64 - 1}
            link._take(mavlink.MAVLink_system_time_message(unix_us, 0), link._clock.now_ns(), None)  # type: ignore[arg-type]
            assert link.report()["impossible_dates"] == impossible
        link.close()


@pytest.mark.parametrize("utc_ns", [1_000, 300_000_000_000_000_000, 4_102_444_800 * SECOND, 2**63 * 1000, -(2**80)])
def test_an_impossible_date_is_no_date(utc_ns: int) -> None:
    message = codec.gps_input(_estimate(), codec.Place(47.0, 8.0, 400.0, 350.0), 1, 1, utc_ns)
    assert (message.time_week, message.time_week_ms) == (0, 0)
    assert len(message.pack(mavlink.MAVLink(None))) > 50


@MANY
@given(e=_estimates(), sent_us=_times, sample_us=_times, lla=st.tuples(_absurd, _absurd, _absurd))
def test_whatever_the_numbers_px4_gets_them_or_nothing(
    e: Estimate, sent_us: int, sample_us: int, lla: tuple[float, float, float]
) -> None:
    if not is_sound(e):
        e = _estimate()
    pose = vec3(e.nav[X.P]), so3.normalise(e.nav[X.Q])
    for data, schema in (
        (px4.vehicle_odometry(e, pose, sent_us, sample_us, 7, 100), px4.VEHICLE_ODOMETRY),
        (px4.aux_global_position(e, lla, 47.5, sent_us, sample_us, 1), px4.AUX_GLOBAL_POSITION),
        (px4.vehicle_global_position(e, lla, 47.5, sent_us, sample_us), px4.VEHICLE_GLOBAL_POSITION),
    ):
        fits = 0 <= sent_us < 2**64 and 0 <= sample_us < 2**64
        if data is None:
            assert not fits or not all(abs(x) < 3.4e38 for x in lla)
            continue
        read: Any = STORE.deserialize_cdr(data, schema)
        assert (read.timestamp, read.timestamp_sample) == (sent_us, sample_us)
        numbers = (value for value in vars(read).values() if isinstance(value, float | np.ndarray))
        assert all(np.isfinite(x).all() for x in numbers)


def _message(draw: st.DrawFn, number: int, stamp: dict[str, int]) -> Any:
    made = mavlink.mavlink_map[number]
    values: dict[str, Any] = {}
    counts = dict(zip(made.ordered_fieldnames, made.array_lengths, strict=True))
    for field, kind in zip(made.fieldnames, made.fieldtypes, strict=True):
        single = st.sampled_from([0.0, 1e38, -3.4e38, 1e-45, math.nan, math.inf, -math.inf, 1.0, 7.0])
        if kind == "char":
            values[field] = draw(st.binary(max_size=counts[field]))
            continue
        number_of = single if kind == "float" else st.integers(*RANGES[kind])
        values[field] = draw(st.lists(number_of, min_size=n, max_size=n) if (n := counts[field]) else number_of)
    return made(**(values | {key: value for key, value in stamp.items() if key in values}))


class _Rig:
    """A link without its thread, which a datagram is put into; behind it the daemon's own way into a Fusion."""

    def __init__(self, there: socket.socket) -> None:
        self.there, self.clock = there, Clock()
        self.link, self.booted_ns = _link(there), self.clock.now_ns() - 500 * SECOND
        config = Config(inputs=INPUTS)
        self.inbox = Mailbox(self.clock, _NoLog(), [], config.mounting())
        self.decoder, self.fusion = config.decoder(), Fusion(config.fusion())
        self.sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.to: Any = self.link._endpoint._socket.getsockname()  # type: ignore[attr-defined]

    def put(self, data: bytes) -> list[Any]:
        """What the estimator gets of a datagram."""
        self.there.sendto(data, self.to)
        self.link._turn(self.inbox)  # an exception is a failure here
        records = []
        while (arrival := self.inbox.get(0.0)) is not None:
            record = self.decoder.decode(*arrival[:4])
            assert record is not None
            records.append(record)
            for output in self.fusion.handle(record):
                assert getattr(output, "reason", None) is not Reason.INTERNAL, output
        return records

    def boot_us(self) -> int:
        return (self.clock.now_ns() - self.booted_ns) // 1000

    def imu(self) -> bytes:
        motion, field = (0.1, 0.2, -9.8, 0.01, 0.02, 0.03), (0.2, 0.0, 0.4)
        message = mavlink.MAVLink_highres_imu_message(self.boot_us(), *motion, *field, *(0.0,) * 4, 511)
        return bytes(message.pack(self.sender))


@pytest.fixture(scope="module")
def rig() -> Iterator[_Rig]:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as there:
        there.bind(("127.0.0.1", 0))
        made = _Rig(there)
        yield made
        made.link.close()


_TAKEN = sorted({0, 2, 49, 77, 111, 24, 124, 26, 27, 30, 105, 245, 253, 441, 514})


def test_these_are_all_that_the_link_takes(rig: _Rig) -> None:
    assert rig.link._in._wanted == set(_TAKEN)


@MANY
@given(data=st.data())
def test_a_message_of_any_numbers_costs_none_of_those_that_came_with_it(rig: _Rig, data: st.DataObject) -> None:
    now_us = rig.boot_us()
    stamp = {"time_usec": now_us, "time_boot_ms": now_us // 1000}
    draw: Any = data.draw
    first = _message(draw, draw(st.sampled_from([n for n in _TAKEN if n not in {2, 26, 30, 111}])), stamp)
    got = rig.put(bytes(first.pack(rig.sender)) + rig.imu())
    assert any(getattr(r, "accel_b", ())[2:] == (pytest.approx(-9.8),) for r in got)


@MANY
@given(data=st.data())
def test_any_stamps_and_any_numbers_end_no_turn_of_the_link(rig: _Rig, data: st.DataObject) -> None:
    draw: Any = data.draw
    message = _message(draw, draw(st.sampled_from(_TAKEN)), {})
    rig.put(bytes(message.pack(rig.sender)))


@MANY
@given(number=st.sampled_from(_TAKEN), payload=st.binary(max_size=255), v1=st.booleans())
def test_a_payload_of_any_length_costs_none_of_those_that_came_with_it(rig: _Rig, number: int, payload: bytes, v1: bool) -> None:
    v1 = v1 and number < 256  # the id of a MAVLink 1 frame is a byte
    head = (
        struct.pack("<BBBBB", len(payload), 7, 1, 1, number)
        if v1
        else struct.pack("<BBBBBBHB", len(payload), 0, 0, 7, 1, 1, number, 0)
    )
    crc = x25crc(head + payload + bytes([mavlink.mavlink_map[number].crc_extra])).crc
    frame = (b"\xfe" if v1 else b"\xfd") + head + payload + struct.pack("<H", crc)
    heartbeat = bytes(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(rig.sender))
    before = rig.link._heartbeat_ns
    rig.put(frame + heartbeat)
    assert rig.link._heartbeat_ns > before


@MANY
@given(junk=st.binary(max_size=2000))
def test_junk_ends_no_turn_of_the_link(rig: _Rig, junk: bytes) -> None:
    rig.put(junk)


def test_an_attitude_that_is_none_is_refused_with_its_numbers() -> None:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as there:
        there.bind(("127.0.0.1", 0))
        rig = _Rig(there)
        rig.put(rig.imu())
        for k, angle in enumerate((1e38, math.nan, math.inf, 7.0)):
            got = rig.put(
                bytes(mavlink.MAVLink_attitude_message(rig.boot_us() // 1000, 0.0, angle, 0.0, 0, 0, 0).pack(rig.sender))
                + rig.imu()
            )
            assert len(got) == 1
            report = rig.link.report()
            assert report["refused"] == k + 1
            assert report["refusal"].startswith(f"ATTITUDE: roll, pitch, yaw = 0, {np.float32(angle):g}, 0 rad: are no angles")
        assert (
            len(rig.put(bytes(mavlink.MAVLink_attitude_message(rig.boot_us() // 1000, 0.1, 0.2, -3.0, 0, 0, 0).pack(rig.sender))))
            == 1
        )
        rig.link.close()
