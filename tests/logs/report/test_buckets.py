import numpy as np
import pytest

from logs.report.buckets import Buckets

S = 1_000_000_000


def test_a_peak_of_one_sample_stays_however_long_the_flight() -> None:
    """GIVEN an hour at 200 Hz in batches, one sample high and one low, THEN both are there, in as few spans as asked for."""
    buckets = Buckets(1, 0, spans=100)
    t_ns = np.arange(720_000, dtype=np.int64) * 5_000_000
    x = np.sin(1e-9 * t_ns / 60.0)
    x[123_457], x[500_001] = 50.0, -40.0
    for part in np.array_split(np.arange(len(t_ns)), 300):
        buckets.add(t_ns[part], x[part, None])
    low, high = buckets.low[:, 0], buckets.high[:, 0]
    assert 50 <= len(low) <= 100
    first = np.arange(0, len(t_ns), buckets.step_ns // 5_000_000)
    np.testing.assert_array_equal(low, np.minimum.reduceat(x, first))
    np.testing.assert_array_equal(high, np.maximum.reduceat(x, first))
    assert (high.max(), low.min()) == (50.0, -40.0)
    assert int(np.argmax(high)) == t_ns[123_457] // buckets.step_ns
    assert int(np.argmin(low)) == t_ns[500_001] // buckets.step_ns
    others = np.delete(high, np.argmax(high))
    assert 0.9 < others.max() <= 1.0


def test_extremes_of_each_span_are_those_of_its_samples_in_any_order() -> None:
    rng = np.random.default_rng(4)
    t_ns = rng.integers(5 * S, 95 * S, 4000)
    x = rng.normal(size=(4000, 3))
    x[rng.random((4000, 3)) < 0.2] = np.nan
    buckets = Buckets(3, 5 * S, spans=16)
    for part in np.array_split(rng.permutation(4000), 7):
        buckets.add(t_ns[part], x[part])
    span = (t_ns - 5 * S) // buckets.step_ns
    assert len(buckets.low) == span.max() + 1
    for k in np.unique(span).tolist():
        np.testing.assert_array_equal(buckets.low[k], np.nanmin(x[span == k], axis=0))
        np.testing.assert_array_equal(buckets.high[k], np.nanmax(x[span == k], axis=0))


def test_spans_without_samples_are_not_there_and_what_is_before_the_start_is_left_out() -> None:
    buckets = Buckets(1, 10 * S, spans=8)
    buckets.add(np.array([9 * S, 10 * S, 14 * S], np.int64), np.array([[7.0], [1.0], [2.0]]))
    buckets.add(np.empty(0, np.int64), np.empty((0, 1)))
    assert buckets.high[0, 0] == 1.0
    assert buckets.high[-1, 0] == 2.0
    assert np.isnan(buckets.low[1:-1]).all()
    assert len(buckets.low) > 3


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_no_sample(value: float) -> None:
    buckets = Buckets(2, 0)
    buckets.add(np.array([0, 0], np.int64), np.array([[value, 1.0], [3.0, 2.0]]))
    assert buckets.low.tolist() == [[3.0, 1.0]]
    assert buckets.high.tolist() == [[3.0, 2.0]]
