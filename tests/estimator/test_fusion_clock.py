"""Stamps that are off: one is refused, a clock that has stepped for good is followed within seconds."""

import msgspec
import pytest

from estimator.fusion import Fusion, FusionConfig
from logs.wire.codec import encode
from models.messages import Input, Reason
from models.sim.scenario import EPOCH_NS
from tests.estimator.scenes import SECOND, Run, hover

HOUR = 3600 * SECOND


def _restamped(message: Input, by_ns: int) -> Input:
    """The message stamped by another clock; it arrives when it did."""
    return msgspec.structs.replace(message, t_ns=message.t_ns + by_ns)


@pytest.mark.parametrize("by_ns", [HOUR, -HOUR])
def test_one_stamp_that_is_off_is_refused_and_changes_nothing(by_ns: int) -> None:
    messages = hover(8.0)
    run = Run(Fusion(FusionConfig())).feed([*messages[:500], _restamped(messages[500], by_ns), *messages[501:]])
    assert sum(run.reasons("/imu").values()) == 1
    assert run.estimates[-1].t_ns == EPOCH_NS + 8 * SECOND


@pytest.mark.parametrize("by_ns", [HOUR, -HOUR])
def test_a_step_of_the_stamping_clock_is_survived(by_ns: int) -> None:
    messages = hover(12.0)
    run = Run(Fusion(FusionConfig())).feed([*messages[:300], *(_restamped(m, by_ns) for m in messages[300:])])
    assert run.estimates[-1].t_ns == EPOCH_NS + 12 * SECOND + by_ns
    assert run.health[-1].t_ns > EPOCH_NS + 11 * SECOND + by_ns
    before = [e.reset_counter for e in run.estimates if e.arrived_ns < EPOCH_NS + 3 * SECOND]
    assert set(before) == {0}
    assert {e.reset_counter for e in run.estimates[len(before) :]} == {1}  # a reader that goes on from the last one sees it
    assert Reason.INTERNAL not in run.reasons("/imu")


def test_first_samples_stamped_before_the_clock_was_set_are_left_behind() -> None:
    messages = hover(8.0)
    run = Run(Fusion(FusionConfig())).feed([*(_restamped(m, -EPOCH_NS) for m in messages[:20]), *messages[20:]])
    assert run.estimates[-1].t_ns == EPOCH_NS + 8 * SECOND


def test_after_samples_that_were_long_on_their_way_punctual_ones_are_not_in_the_future() -> None:
    """A link that stood still delivers old samples, drops some, and goes on: nothing is wrong with any stamp."""
    messages = hover(10.0)
    stalled, lost_ns, freed_ns = EPOCH_NS + 4 * SECOND, EPOCH_NS + 5 * SECOND, EPOCH_NS + 7 * SECOND
    delivered = [m for m in messages if not lost_ns <= m.t_ns < freed_ns]
    late = [
        msgspec.structs.replace(m, arrived_ns=freed_ns - SECOND // 100) if stalled <= m.t_ns < lost_ns else m for m in delivered
    ]
    run = Run(Fusion(FusionConfig())).feed(late)
    assert not run.reasons("/imu")
    assert run.estimates[-1].t_ns == EPOCH_NS + 10 * SECOND


def test_after_a_minute_without_imu_the_alignment_begins_again() -> None:
    later = [msgspec.structs.replace(m, t_ns=m.t_ns + 90 * SECOND, arrived_ns=m.arrived_ns + 90 * SECOND) for m in hover(6.0)]
    run = Run(Fusion(FusionConfig())).feed([*hover(6.0), *later])
    gap = [e for e in run.estimates if EPOCH_NS + 6 * SECOND < e.t_ns < EPOCH_NS + 90 * SECOND]
    assert not gap
    assert run.estimates[-1].t_ns == EPOCH_NS + 96 * SECOND
    assert abs(run.estimates[-1].nav[:3]).max() < 1.0


def test_one_stamp_that_runs_ahead_by_less_than_future_s_silences_nothing() -> None:
    messages = hover(8.0)
    ahead = _restamped(messages[500], SECOND * 4 // 5)
    run = Run(Fusion(FusionConfig())).feed([*messages[:500], ahead, *messages[501:]])
    straight = Run(Fusion(FusionConfig())).feed([*messages[:500], *messages[501:]])
    assert run.reasons("/imu") == {Reason.IN_FUTURE: 1}
    assert [encode(e) for e in run.estimates] == [encode(e) for e in straight.estimates]


def test_stamps_that_all_run_ahead_from_now_on_are_followed_with_the_second() -> None:
    messages = hover(8.0)
    by_ns = SECOND * 4 // 5
    run = Run(Fusion(FusionConfig())).feed([*messages[:500], *(_restamped(m, by_ns) for m in messages[500:])])
    assert not run.reasons("/imu")
    assert run.estimates[-1].t_ns == EPOCH_NS + 8 * SECOND + by_ns
