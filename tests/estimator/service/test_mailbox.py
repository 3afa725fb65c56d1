"""Nothing is lost in normal operation, and a flood delays no topic but its own."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from estimator.service.base.clock import Clock
from estimator.service.base.mailbox import Mailbox
from estimator.service.log.writer import LogConfig, LogWriter
from logs.wire import schemas
from logs.wire.codec import Decoder, ImuMounting, encode_input
from models.messages import ImuSample

T0 = 1_795_000_000_000_000_000


@pytest.fixture
def log(tmp_path: Path) -> Iterator[LogWriter]:
    with closing(LogWriter(LogConfig(enabled=False), lambda n: tmp_path / f"{n}.mcap", {})) as writer:
        yield writer


def _mailbox(log: LogWriter) -> Mailbox:
    return Mailbox(Clock(), log, ["/left/image"], ImuMounting())


def test_what_waits_for_the_loop_has_an_end_by_bytes_and_what_is_lost_is_counted(log: LogWriter) -> None:
    mailbox = _mailbox(log)
    for k in range(400):
        mailbox.put_bytes("/pose_fix", schemas.POSE_FIX, _numbered(k, 60_000))
    waiting = mailbox.report()["waiting"]
    assert 10_000_000 < 60_000 * waiting < 20_000_000
    assert mailbox.report() == {"waiting": waiting, "lost_inputs": 400 - waiting, "dropped /pose_fix": 400 - waiting}
    for _ in range(2):
        assert mailbox.get(0.0) is not None
    for k in range(20):
        mailbox.put_bytes("/pose_fix", schemas.POSE_FIX, _numbered(k, 60_000))
    assert mailbox.report()["dropped /pose_fix"] == 400 - waiting + 18


def test_a_flooded_topic_takes_no_room_from_the_others_and_its_turn_comes_last(log: LogWriter) -> None:
    mailbox = _mailbox(log)
    for k in range(30_000):
        mailbox.put_bytes("/gnss", schemas.NAV_SAT_FIX, _numbered(k, 8))
        if k % 100 == 0:
            mailbox.put_bytes("/imu", schemas.IMU, bytes(300))
        if k % 1000 == 0:
            mailbox.put_bytes("/pose_fix", schemas.POSE_FIX, bytes(300))
    came = _taken(mailbox)
    assert came[:330].count("/imu") == 300
    assert came[:330].count("/pose_fix") == 30
    assert set(came[330:]) == {"/gnss"}
    assert 4000 < len(came) - 330 < 4100
    dropped = 30_330 - len(came)
    assert mailbox.report() == {"waiting": 0, "lost_inputs": dropped, "dropped /gnss": dropped}
    mailbox.put_bytes("/gnss", schemas.NAV_SAT_FIX, b"")
    assert mailbox.get(0.0) is not None, "after the flood its topic is heard again"


def test_short_and_long_messages_crowd_a_line_alike(log: LogWriter) -> None:
    """Sixty large messages take as long to handle as many small ones: what comes later on other topics goes before them."""
    mailbox = _mailbox(log)
    for k in range(60):
        mailbox.put_bytes("/landfix/fix", schemas.LANDMARK_FIX, _numbered(k, 60_000))
    mailbox.put_bytes("/imu", schemas.IMU, bytes(300))
    assert _taken(mailbox)[0] == "/imu"


def test_what_a_vehicle_sends_while_the_loop_stands_still_is_handled_in_the_order_of_arrival(log: LogWriter) -> None:
    """A second of a 400 Hz IMU and of everything else, and a burst of late fixes."""
    mailbox = _mailbox(log)
    sent = []
    for k in range(400):
        sent += ["/imu"] + ["/gnss", "/gnss/velocity"] * (k % 40 == 0) + ["/baro"] * (k % 8 == 0)
        sent += ["/pose_fix"] * (100 if k == 200 else k % 80 == 0)
    for topic in sent:
        mailbox.put_bytes(topic, schemas.IMU, bytes(400))  # a frozen sensor, too: all of it is for the estimator to check
    assert _taken(mailbox) == sent
    for k in range(3500):  # eight seconds more: nothing is lost
        mailbox.put_bytes("/imu", schemas.IMU, _numbered(k, 330))
    assert mailbox.report() == {"waiting": 3500, "lost_inputs": 0}


def test_a_driver_that_repeats_one_sample_leaves_room_for_those_that_it_still_takes(log: LogWriter) -> None:
    mailbox, stuck = _mailbox(log), _numbered(10**6, 330)
    samples = [_numbered(k, 330) for k in range(1000)]
    for sample in samples:
        for _ in range(100):
            mailbox.put_bytes("/imu", schemas.IMU, stuck)
        mailbox.put_bytes("/imu", schemas.IMU, sample)
    taken = []
    while (arrival := mailbox.get(0.0)) is not None:
        taken.append(arrival.data)
    assert [data for data in taken if data != stuck] == samples
    assert len(taken) < 3000
    assert mailbox.report()["dropped /imu"] == 101_000 - len(taken)


def _numbered(k: int, size: int) -> bytes:
    return k.to_bytes(size, "little")


def _taken(mailbox: Mailbox) -> list[str]:
    """The topics of all that waits, in the order in which the loop gets them."""
    came = []
    while (arrival := mailbox.get(0.0)) is not None:
        came.append(arrival.topic)
    return came


def test_a_link_without_cdr_puts_measurements_and_the_log_holds_what_is_handled(log: LogWriter) -> None:
    """As mavlink/link.py does: the loop gets bytes, axes and mounting of the configuration included."""
    mounting = ImuMounting("frd", 0.0, 0.0, 90.0)
    mailbox = Mailbox(Clock(), log, ["/left/image"], mounting)
    sample = ImuSample(T0, 1, (0.1, 0.2, 0.3), (1.0, 2.0, -9.0))
    mailbox.put(sample)
    arrival = mailbox.get(0.1)
    assert arrival is not None
    assert arrival[:3] == encode_input(sample, mounting)
    assert arrival.arrived_ns > T0 - 1
    read = Decoder(mounting=mounting).decode(*arrival[:4])
    assert isinstance(read, ImuSample)
    np.testing.assert_allclose(read.gyro_b, sample.gyro_b, atol=1e-12)
    mailbox.put_bytes("/left/image", schemas.IMAGE, b"")
    assert mailbox.get(0.0) is None
