"""The IMU buffer holds what came in, by time of validity, whatever the order of arrival."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimator.filter.imu_buffer import ImuBuffer
from models.messages import ImuSample


def _sample(t_ns: int, value: float = 0.0) -> ImuSample:
    return ImuSample(t_ns, t_ns, (value, 1.0, 2.0), (3.0, 4.0, 5.0))


def _filled(stamps: list[int], capacity: int = 4096) -> ImuBuffer:
    buffer = ImuBuffer(capacity)
    for t in stamps:
        buffer.insert(_sample(t, float(t)))
    return buffer


@given(st.lists(st.integers(0, 50), max_size=60))
def test_any_order_of_arrival_gives_the_same_buffer(stamps: list[int]) -> None:
    buffer, expected = _filled(stamps, capacity=4), sorted(set(stamps))
    assert buffer.t_ns[: buffer.count].tolist() == expected
    assert buffer.u[: buffer.count, 0].tolist() == expected
    assert np.all(buffer.u[: buffer.count, 1:] == [1.0, 2.0, 3.0, 4.0, 5.0])
    assert buffer.known[: buffer.count].tobytes() == _filled(expected).known[: buffer.count].tobytes()
    for t in range(-1, 52):
        assert buffer.first_after(t) == int(np.searchsorted(expected, t, side="right"))


@given(st.permutations([3.0, 1.0, 2.0, 1.0]))
def test_of_two_samples_of_one_stamp_the_same_stays_whichever_came_first(values: list[float]) -> None:
    buffer, plain = ImuBuffer(), ImuBuffer()
    for t, v in [(10, 0.0), (20, values[0]), (30, 0.0), *((20, v) for v in values)]:
        buffer.insert(_sample(t, v))
    for t, v in [(10, 0.0), (20, 1.0), (30, 0.0)]:
        plain.insert(_sample(t, v))
    assert buffer.u[:3, 0].tolist() == [0.0, 1.0, 0.0]
    assert buffer.known[:3].tobytes() == plain.known[:3].tobytes()
    assert buffer.known[2, 1] > 0.0


def test_an_equal_sample_is_not_taken_twice() -> None:
    buffer = ImuBuffer()
    assert buffer.insert(_sample(10, 1.0))
    assert not buffer.insert(_sample(10, 1.0))
    assert not buffer.insert(_sample(10, 2.0))
    assert buffer.insert(_sample(10, 0.5))
    assert buffer.count == 1


def test_grows_and_keeps_what_it_had() -> None:
    buffer = _filled(list(range(100)), capacity=8)
    assert buffer.count == 100
    assert buffer.t_ns[:100].tolist() == buffer.u[:100, 0].tolist() == list(range(100))
    assert buffer.known[:100].tobytes() == _filled(list(range(100))).known[:100].tobytes()
    assert buffer.newest_ns == 99
    assert buffer.previous_ns == 98


@given(st.sets(st.integers(0, 40), min_size=1), st.integers(-1, 42), st.lists(st.integers(41, 60)))
def test_forgetting_drops_what_is_older_once_it_is_half_of_all_and_only_that(
    stamps: set[int], before: int, later: list[int]
) -> None:
    buffer = _filled(sorted(stamps), capacity=4)
    buffer.forget_before(before)
    kept = [t for t in sorted(stamps) if t >= before]
    if 2 * len(kept) > len(stamps):
        kept = sorted(stamps)
    assert buffer.t_ns[: buffer.count].tolist() == kept
    for t in later:
        buffer.insert(_sample(t, float(t)))
    everything = sorted({*kept, *later})
    assert buffer.t_ns[: buffer.count].tolist() == buffer.u[: buffer.count, 0].tolist() == everything


def test_what_is_known_outlives_the_samples_that_reported_it() -> None:
    rng = np.random.default_rng(3)
    samples = [ImuSample(t, t, tuple(rng.normal(size=3).tolist()), (3.0, 4.0, 5.0)) for t in range(0, 6_000_000_000, 10_000_000)]
    short, whole = ImuBuffer(), ImuBuffer()
    for s in samples:
        whole.insert(s)
        short.insert(s)
        if s.t_ns == 4_000_000_000:
            short.forget_before(3_500_000_000)
    assert short.count == 250
    assert short.known[: short.count].tobytes() == whole.known[350:600].tobytes()
