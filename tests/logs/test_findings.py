"""Each fault of stamps or axes is named at the stream that has it; sound streams are not accused."""

from collections.abc import Callable

import numpy as np
import pytest

from logs.findings import Stream, findings
from models.messages import Array

Fault = Callable[[Stream, np.random.Generator], tuple[Stream, str]]


def _sound(seed: int) -> dict[str, Stream]:
    rng = np.random.default_rng(seed)

    def stream(rate_hz: float, width: int) -> Stream:
        t_s = 1e9 + np.arange(0.0, 30.0, 1.0 / rate_hz)
        return Stream(t_s, t_s + 0.02 + rng.exponential(0.005, len(t_s)), rng.normal(size=(len(t_s), width)))

    return {"/imu": stream(rng.uniform(50.0, 400.0), 6), "/gnss": stream(5.0, 0), "/gnss/velocity": stream(5.0, 0)}


def _step(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    step = rng.choice([-1.0, 1.0]) * round(rng.uniform(0.3, 50.0), 1)
    at = rng.uniform(5.0, 25.0)
    return s._replace(t_s=s.t_s + step * (s.t_s - s.t_s[0] > at)), f"jump by {step:+.2f}"


def _speed(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    k = rng.choice([0.5, 0.9, 1.1, 2.0])
    return s._replace(t_s=s.t_s[0] + k * (s.t_s - s.t_s[0])), f"runs at {k:.1f}"


def _batched(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    size = int(rng.integers(4, 30))
    last = np.minimum(np.arange(len(s.t_s)) // size * size + size - 1, len(s.t_s) - 1)
    t_s = s.t_s[last] + 1e-5 * (np.arange(len(s.t_s)) % size)
    return Stream(t_s, t_s + 0.01, s.imu), f"batches of {size}"


def _digits(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(t_s=s.t_s.astype(np.float32).astype(float)), "stamps have"


def _dead(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    axis, imu = int(rng.integers(6)), s.imu.copy()
    rows = slice(int(rng.uniform(0.05, 0.8) * len(imu)), None)
    imu[rows, axis] = rng.choice([0.0, imu[rows.start, axis]])
    return s._replace(imu=imu), f"{'gyroscope' if axis < 3 else 'accelerometer'} {'xyz'[axis % 3]} reads"


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("fault", [_step, _speed, _batched, _digits, _dead])
def test_the_stream_at_fault_is_named_with_its_cause(fault: Fault, seed: int) -> None:
    streams = _sound(seed)
    streams["/imu"], words = fault(streams["/imu"], np.random.default_rng(100 + seed))
    found = findings(streams)
    assert [f.who for f in found] == ["/imu"]
    assert words in found[0].what


@pytest.mark.parametrize("seed", range(40))
def test_sound_streams_are_not_accused(seed: int) -> None:
    assert findings(_sound(seed)) == []


@pytest.mark.parametrize("axis", range(6))
def test_an_axis_that_reads_0_from_the_start_is_not_accused(axis: int) -> None:
    streams = _sound(2)
    streams["/imu"].imu[:, axis] = 0.0
    assert findings(streams) == []


def test_a_log_recorded_at_half_speed_accuses_nobody() -> None:
    def slow(t_s: Array) -> Array:
        return 1e9 + 2.0 * (t_s - 1e9)

    assert findings({name: s._replace(arrived_s=slow(s.arrived_s)) for name, s in _sound(0).items()}) == []


def test_when_it_began_is_said() -> None:
    streams = _sound(1)
    imu = streams["/imu"]
    streams["/imu"] = imu._replace(t_s=imu.t_s - 1.43 * (imu.t_s - imu.t_s[0] > 12.0))
    assert findings(streams)[0].since_s == pytest.approx(12.0, abs=0.1)
