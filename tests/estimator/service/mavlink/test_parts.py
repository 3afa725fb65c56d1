"""The MAVLink link's parts: frames, the autopilot's clock, endpoints that are refused."""

import os
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from estimator.service.autopilot.clock import AutopilotClock
from estimator.service.mavlink.config import MavlinkConfig, address_of, signing_key
from estimator.service.mavlink.io import opened
from estimator.service.mavlink.wire import Wire
from estimator.strict_toml import ConfigError
from tests.estimator.service.autopilots import PX4, UdpAutopilot

SECOND = 1_000_000_000


def test_memory_does_not_grow_with_a_stream_that_never_ends_between_frames() -> None:
    sender = mavlink.MAVLink(None, 1, 1)
    frame = bytes(mavlink.MAVLink_heartbeat_message(2, PX4, 0, 0, 4, 3).pack(sender))
    wire = Wire(1, 197, frozenset({1}), frozenset({0}), None, 0)
    stream, read = frame * 20_000, 0
    for k in range(0, len(stream), 1000):  # 1000 is no multiple of the 21 bytes of a frame
        read += len(list(wire.messages(stream[k : k + 1000], whole=False)))
        assert len(wire.buf) < 10_000
    assert read == 20_000


@pytest.mark.parametrize(("garbage", "lost"), [("torn", 2), ("noise", 4), ("starts", 30)])
def test_a_damaged_stream_costs_hardly_a_whole_frame(garbage: str, lost: int) -> None:
    """Every false start claims up to 280 bytes, in which true frames are; one of 100 ends where a frame begins."""
    rng, sender = np.random.default_rng(5), mavlink.MAVLink(None, 1, 1)
    stream = b""
    for k in range(2000):
        values = (float(x) for x in rng.normal(size=13))
        frame = bytes(mavlink.MAVLink_highres_imu_message(500_000_000 + k * 5000, *values, 63).pack(sender))
        torn = frame[: int(rng.integers(1, len(frame)))]
        noise = rng.integers(0, 256, int(rng.integers(1, 60)), np.uint8).tobytes()
        starts = bytes([int(rng.choice([0xFD, 0xFE])), int(rng.integers(256)), 0, 0, 0, 1, 1])
        stream += {"torn": torn, "noise": noise, "starts": starts}[garbage] * (k % 5 == 0) + frame
        sender.seq = (sender.seq + 1) % 256
    wire, read = Wire(1, 197, frozenset({1}), frozenset({105}), None, 0), 0
    stream += frame * 4
    for k in range(0, len(stream), 333):
        read += sum(m.get_type() == "HIGHRES_IMU" for m in wire.messages(stream[k : k + 333], whole=False))
    assert 2004 - lost <= read <= 2004
    assert wire.damaged > 300


def test_offset_from_round_trips_is_within_its_bound() -> None:
    clock, ahead_ns = AutopilotClock(), -1_700_000_000 * SECOND
    rng = np.random.default_rng(1)
    now_ns = 1_795_000_000 * SECOND
    assert clock.t_ns(now_ns + ahead_ns - 5_000_000, now_ns) is not None  # one way: late by what it took
    for _ in range(100):
        out_ns, back_ns = (int(x) for x in rng.uniform(200_000, 5_000_000, 2))
        clock.answer(clock.ask(now_ns), now_ns + out_ns + ahead_ns, now_ns + out_ns + back_ns)
        now_ns += SECOND // 4
    assert clock.answers == 100
    error_ns = abs((clock.offset.ahead_ns or 0) - ahead_ns)
    assert error_ns <= clock.offset.bound_ns < 1_500_000


@pytest.mark.parametrize(
    ("endpoint", "says"),
    [
        ("tcp:1.2.3.4:5", "is not udpin"),
        ("udpin:127.0.0.1", "is not udpin"),
        ("udpin:127.0.0.1:70000", "is not udpin"),
        ("udpin:0.0.0.0:14540", "anybody in reach"),
        ("udpout:192.168.1.7:14540", "anybody in reach"),
        ("udpin:127.0.0.1:PORT", "in use"),
    ],
)
def test_endpoints_that_are_refused_say_why(endpoint: str, says: str) -> None:
    taken = UdpAutopilot()
    with pytest.raises(ConfigError, match=says):
        opened(address_of(MavlinkConfig(endpoint=endpoint.replace("PORT", str(taken.port)))))
    taken.close()


def test_a_key_or_speed_that_is_not_there_reports_it(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        signing_key(MavlinkConfig("/dev/null", signing_key_file="none"), tmp_path)
    (tmp_path / "empty").write_text("\n")
    (tmp_path / "empty").chmod(0o600)
    with pytest.raises(ConfigError, match="is empty"):
        signing_key(MavlinkConfig("/dev/null", signing_key_file="empty"), tmp_path)
    with pytest.raises(ConfigError, match="is not a speed"):
        opened(address_of(MavlinkConfig("/dev/null", baud=12345)))
    device = opened(address_of(MavlinkConfig(os.devnull)))
    assert device.state == "not a serial device"
    device.close()
