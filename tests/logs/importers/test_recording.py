"""Columns become messages in the order of arrival."""

import numpy as np
import pytest

from logs.importers import recording
from logs.importers.recording import DEFAULTS, ImportOptions, Recording, Times, Truth
from logs.importers.settings import Settings
from logs.store.reader import LogError
from models.messages import GnssFix, ImuSample


def stamps(*t: int) -> Times:
    return np.array(t, dtype=np.int64)


def numbers(n: int, m: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.arange(n * m, dtype=np.float64).reshape(n, m)


def test_messages_come_in_the_order_of_arrival_and_fixes_before_the_imu() -> None:
    t = stamps(0, 10, 20)
    fixes = recording.gnss(stamps(0, 5), stamps(10, 15), numbers(2, 3), numbers(2, 3), np.zeros(2))
    r = Recording(
        (fixes, recording.imu(t, t, numbers(3, 3), numbers(3, 3)), recording.truth(t, *(numbers(3, k) for k in (3, 3, 4)))),
        Settings(),
    )
    got = [(type(m), m.arrived_ns, m.t_ns) for m in r]
    assert got == [
        (ImuSample, 0, 0), (Truth, 0, 0),
        (GnssFix, 10, 0), (ImuSample, 10, 10), (Truth, 10, 10),
        (GnssFix, 15, 5),
        (ImuSample, 20, 20), (Truth, 20, 20),
    ]  # fmt: skip
    assert len(r) == 8


def test_values_arrive_in_their_messages_as_plain_floats() -> None:
    t = stamps(7)
    (sample,) = recording.imu(t, t, numbers(1, 3), -numbers(1, 3), "/imu2")
    assert isinstance(sample, ImuSample)
    assert (sample.gyro_b, sample.accel_b, sample.topic) == ((0.0, 1.0, 2.0), (-0.0, -1.0, -2.0), "/imu2")
    assert type(sample.t_ns) is int
    assert type(sample.gyro_b[0]) is float


def test_a_covariance_that_is_not_given_is_none() -> None:
    t = stamps(0, 1)
    known, unknown = recording.gnss(t, t, numbers(2, 3), np.array([[1.0, 2.0, 3.0], [1.0, np.nan, 3.0]]), np.array([0.0, -1.0]))
    assert isinstance(known, GnssFix)
    assert isinstance(unknown, GnssFix)
    np.testing.assert_array_equal(known.covariance_n, np.diag([1.0, 2.0, 3.0]))
    assert unknown.covariance_n is None
    assert (known.status, unknown.status) == (0, -1)


def test_arrival_follows_the_order_in_which_messages_stand() -> None:
    assert recording.arrival(stamps(1, 2, 2, 1, 3)).tolist() == [1, 2, 2, 2, 3]  # a step back arrived after what stands before
    assert recording.arrival(stamps(1, 2, 900, 3, 4)).tolist() == [1, 2, 3, 3, 4]  # one wild stamp does not hold up the rest
    assert recording.arrival(stamps()).tolist() == []


def test_backward_stamps_keep_their_place_and_their_value() -> None:
    t = stamps(0, 10, 5, 20)
    r = Recording((recording.imu(t, recording.arrival(t), numbers(4, 3), numbers(4, 3)),), Settings())
    assert [m.t_ns for m in r] == [0, 10, 5, 20]


def test_many_blocks_of_rows() -> None:
    n = 10_001
    t = np.arange(n, dtype=np.int64)
    got = list(recording.imu(t, t[::-1].copy(), numbers(n, 3), numbers(n, 3)))
    assert [m.t_ns for m in got] == t[::-1].tolist()


def test_messages_whose_stamps_no_log_can_hold_are_left_out_and_reported() -> None:
    t, arrived = stamps(-5, 10, 20, 2**61 + 2**60), stamps(0, 10, 2**62, 2**62)
    r = Recording.of((recording.imu(t, arrived, numbers(4, 3), numbers(4, 3)),), Settings(), ["first"])
    assert [(m.t_ns, m.gyro_b) for m in r if isinstance(m, ImuSample)] == [(10, (3.0, 4.0, 5.0))]
    assert r.notes == ("first", "3 messages stamped outside 1970-2038 left out")


def test_options_that_mean_nothing_are_refused() -> None:
    DEFAULTS.refuse_but("ulog")
    ImportOptions(axes="flu").refuse_but("csv", "axes")
    with pytest.raises(LogError, match="--pose-fix-hz means nothing for ulog logs"):
        ImportOptions(pose_fix_hz=2.0).refuse_but("ulog", "axes")
