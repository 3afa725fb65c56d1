"""Clocks: one that never steps, others whose offset is found out, and stamps that are used only where they are plausible."""

import numpy as np
import pytest

from estimator.service.base.clock import SECOND_NS, Clock, ClockConfig, Offset, Stamps
from logs.wire.codec import encode_input
from logs.wire.stamps import restamped, stamp_of
from models.messages import ImuSample

START_NS = 1_795_000_000 * SECOND_NS
HOUR_NS = 3600 * SECOND_NS
MS = 1_000_000


class World:
    """A wall clock that may step and a steady one that may not."""

    def __init__(self) -> None:
        self.steady_ns, self.step_ns = 77 * SECOND_NS, 0

    def wall(self) -> int:
        return START_NS + self.steady_ns + self.step_ns

    def steady(self) -> int:
        return self.steady_ns


@pytest.fixture
def world() -> World:
    return World()


@pytest.fixture
def clock(world: World) -> Clock:
    return Clock(wall=world.wall, steady=world.steady)


def _stamps(clock: Clock, **config: object) -> Stamps:
    return Stamps(clock, ClockConfig(**config))  # type: ignore[arg-type]


def test_the_clock_goes_on_steadily_when_the_wall_clock_steps(world: World, clock: Clock) -> None:
    assert clock.now_ns() == world.wall()
    world.step_ns, world.steady_ns = -HOUR_NS, world.steady_ns + 5
    assert clock.now_ns() == START_NS + world.steady_ns
    assert clock.wall_ahead_ns() == -HOUR_NS
    assert Clock(clock.anchor_ns, wall=world.wall, steady=world.steady).now_ns() == clock.now_ns()


@pytest.mark.parametrize("step_ns", [HOUR_NS, -HOUR_NS, 400 * MS, -400 * MS, 30 * MS])
def test_stamps_of_a_wall_clock_that_steps_go_on_as_before(world: World, clock: Clock, step_ns: int) -> None:
    stamps = _stamps(clock)
    rng = np.random.default_rng(1)
    for k in range(1000):
        if k == 500:
            world.step_ns = step_ns
        validity_ns = clock.now_ns()
        stamp_ns = world.wall()
        world.steady_ns += int(rng.integers(1, 3)) * MS
        assert stamps.validity_ns("/imu", stamp_ns, clock.now_ns()) == validity_ns
        late_ns = stamps.validity_ns("/gnss", stamp_ns - 180 * MS, clock.now_ns())
        assert late_ns == validity_ns - 180 * MS
    assert stamps.steps == 1


def test_a_sender_elsewhere_does_not_step_with_us(world: World, clock: Clock) -> None:
    stamps = _stamps(clock)
    for k in range(100):
        world.step_ns = HOUR_NS if k > 50 else 0
        world.steady_ns += 10 * MS
        stamp_ns = START_NS + world.steady_ns - 5 * MS
        assert stamps.validity_ns("/elsewhere", stamp_ns, clock.now_ns()) == stamp_ns


def test_a_boot_time_clock_is_found_out_by_its_quickest_messages(world: World, clock: Clock) -> None:
    stamps, rng = _stamps(clock, quickest_s=0.001), np.random.default_rng(2)
    errors = []
    for k in range(4000):
        world.steady_ns += 2_500_000
        delay_ns = int(MS + rng.exponential(2 * MS))
        stamp_ns = world.steady_ns - 70 * SECOND_NS - delay_ns
        t_ns = stamps.validity_ns("/imu", stamp_ns, clock.now_ns())
        if t_ns is None:
            assert k < 100
        else:
            errors.append(t_ns - (clock.now_ns() - delay_ns))
        gnss_ns = stamps.validity_ns("/gnss", stamp_ns - 150 * MS, clock.now_ns())
        if k > 1000:
            assert gnss_ns is not None
            assert abs(gnss_ns - (clock.now_ns() - delay_ns - 150 * MS)) < MS
    assert np.abs(errors[200:]).max() < 0.2 * MS
    assert len(stamps.report()) == 4  # one foreign clock, shared


def test_a_clock_that_is_reset_is_found_again(world: World, clock: Clock) -> None:
    """The autopilot reboots: its time since boot begins anew."""
    stamps, boot_ns = _stamps(clock), world.steady_ns - 500 * SECOND_NS
    refused = 0
    for k in range(2000):
        world.steady_ns += 5 * MS
        if k == 1000:
            boot_ns = world.steady_ns
        t_ns = stamps.validity_ns("/imu", world.steady_ns - boot_ns - MS, clock.now_ns())
        if t_ns is None:
            refused += 1
        else:
            assert abs(t_ns - (clock.now_ns() - MS)) < MS // 10
    assert 2 < refused <= 2 * 42


def test_a_single_implausible_stamp_is_rejected_and_changes_nothing(world: World, clock: Clock) -> None:
    stamps = _stamps(clock)
    for k in range(200):
        world.steady_ns += 5 * MS
        if k % 10 == 7:
            wild_ns = [0, 2**31 * SECOND_NS - 1, START_NS - 3 * HOUR_NS, START_NS + k * HOUR_NS][k // 10 % 4]
            assert stamps.validity_ns("/imu", wild_ns, clock.now_ns()) is None
        assert stamps.validity_ns("/imu", clock.now_ns() - MS, clock.now_ns()) == clock.now_ns() - MS


def test_stamps_that_stand_still_are_always_rejected(world: World, clock: Clock) -> None:
    stamps = _stamps(clock)
    for _ in range(2000):
        world.steady_ns += 5 * MS
        if (t_ns := stamps.validity_ns("/imu", 0, clock.now_ns())) is not None:
            assert clock.now_ns() - t_ns < 7 * SECOND_NS


def test_what_is_merely_late_is_left_to_the_estimator(clock: Clock) -> None:
    stamps, now_ns = _stamps(clock), clock.now_ns()
    for late_s in (0, 3, 5.9, 8, 59):
        stamp_ns = now_ns - round(late_s * SECOND_NS)
        assert stamps.validity_ns("/pose_fix", stamp_ns, now_ns) == stamp_ns


def test_a_topic_called_foreign_is_never_taken_at_its_word(world: World, clock: Clock) -> None:
    stamps = _stamps(clock, foreign=("/imu",))
    t_ns = None
    for _ in range(200):
        world.steady_ns += 5 * MS
        t_ns = stamps.validity_ns("/imu", clock.now_ns() - 700 * MS, clock.now_ns())
    assert t_ns is not None
    assert abs(t_ns - (clock.now_ns() - MS)) < MS


def test_question_and_answer_bound_the_offset_by_half_of_their_time() -> None:
    rng, offset, ahead_ns = np.random.default_rng(4), Offset(MS), -12345 * SECOND_NS
    now_ns = START_NS
    for _ in range(50):
        now_ns += SECOND_NS // 10
        there_ns, back_ns = (int(MS // 10 + rng.exponential(MS)) for _ in range(2))
        offset.round_trip(now_ns, now_ns + there_ns + ahead_ns, now_ns + there_ns + back_ns)
        found_ns = offset.theirs(0)
        assert found_ns is not None
        assert abs(found_ns - ahead_ns) <= offset.bound_ns
        assert offset.ours(now_ns + found_ns) == now_ns
    assert offset.bound_ns < MS // 2


def _ask(offset: Offset, now_ns: int, ahead_ns: int, there_ms: int, back_ms: int) -> None:
    offset.round_trip(now_ns, now_ns + there_ms * MS + ahead_ns, now_ns + (there_ms + back_ms) * MS)


def test_a_simulated_clock_that_falls_behind_is_followed_by_the_second_answer() -> None:
    offset, now_ns = Offset(0), START_NS
    for _ in range(80):
        now_ns += SECOND_NS // 4
        _ask(offset, now_ns, -SECOND_NS, 1, 1)
    _ask(offset, now_ns + SECOND_NS // 4, -2 * SECOND_NS, 1, 1)
    assert (offset.ahead_ns, offset.steps) == (-SECOND_NS, 0)
    _ask(offset, now_ns + SECOND_NS // 2, -2 * SECOND_NS, 3, 1)
    assert (offset.ahead_ns, offset.steps) == (-2 * SECOND_NS + MS, 1)
    assert offset.bound_ns == 2 * MS


def test_a_simulated_clock_that_is_slow_by_1_percent_is_followed_in_steps() -> None:
    offset, now_ns = Offset(0), START_NS
    for k in range(400):
        now_ns += SECOND_NS // 4
        offset.round_trip(now_ns, now_ns - SECOND_NS - k * 2_500_000, now_ns)
        assert offset.ahead_ns is not None
        assert abs(offset.ahead_ns + SECOND_NS + k * 2_500_000) < 30 * MS


def test_answers_that_are_late_by_a_second_are_no_step() -> None:
    offset, now_ns = Offset(0), START_NS
    for k in range(80):
        now_ns += SECOND_NS // 4
        _ask(offset, now_ns, -SECOND_NS, 1, 1 if k < 60 else 1000)
    assert (offset.ahead_ns, offset.steps) == (-SECOND_NS, 0)


def test_a_foreign_clock_that_drifts_is_followed(world: World, clock: Clock) -> None:
    stamps, t_ns = _stamps(clock), None
    for k in range(40_000):
        world.steady_ns += 5 * MS
        t_ns = stamps.validity_ns("/imu", round(k * 5 * MS * (1 - 100e-6)), clock.now_ns() + MS)
    assert t_ns is not None
    assert abs(t_ns - clock.now_ns()) < 3 * MS  # of 20 ms that it has gone off


@pytest.mark.parametrize("drift", [200e-6, -200e-6])
def test_a_settled_offset_follows_a_drift_and_does_not_jump(drift: float) -> None:
    offset = Offset(0)
    stamps: list[int] = []
    for k in range(20_000):
        t_ns = START_NS + k * 5 * MS
        stamp_ns = t_ns + round(drift * (t_ns - START_NS))
        offset.one_way(stamp_ns, t_ns)
        stamps.append(offset.ours(stamp_ns) or 0)
    steps = np.diff(np.array(stamps, dtype=np.int64))
    assert abs(steps - 5 * MS).max() < 10_000
    assert abs(stamps[-1] - (START_NS + 19_999 * 5 * MS)) < 21 * abs(drift) * SECOND_NS  # of two windows at most


def test_stamps_are_read_and_written_in_the_message() -> None:
    data = encode_input(ImuSample(START_NS + 123, START_NS, (0.1, 0.2, 0.3), (1.0, 2.0, 3.0))).data
    assert stamp_of(data) == START_NS + 123
    other = restamped(data, 5 * SECOND_NS + 7)
    assert stamp_of(other) == 5 * SECOND_NS + 7
    assert restamped(other, START_NS + 123) == data
    assert stamp_of(data[:11]) is None
    assert stamp_of(data[:8] + b"\xff" * 4 + data[12:]) is None
