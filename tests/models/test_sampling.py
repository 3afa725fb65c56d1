"""What is claimed of the time between two samples, against signals of which everything is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from models import sampling
from models.messages import Array

FINE_S = 5e-4  # between these nothing happens any more
GYRO, ACCEL = 0, 1
SENSOR_PSD = 4e-6  # (rad/s)^2/Hz


def _white(duration_s: float, step_s: float, sigma: float, seed: int = 1) -> Array:
    return np.random.default_rng(seed).normal(0.0, sigma, (round(duration_s / step_s), 6))


def _wobble(duration_s: float, hz: float, sigma: float, seed: int = 2) -> Array:
    """White noise through a resonance at `hz` with a quarter of critical damping, every FINE_S, (n, 6)."""
    w, x, v = 2.0 * np.pi * hz, np.zeros(6), np.zeros(6)
    out = _white(duration_s, FINE_S, 1.0, seed)
    for row in out:
        v += FINE_S * (-w * w * x - 0.5 * w * v) + row
        x += FINE_S * v
        row[:] = x
    scaled: Array = out * (sigma / out.std())
    return scaled


def _stamps(count: int, step_s: float) -> NDArray[np.int64]:
    return np.round(1e9 * step_s * np.arange(1, count + 1)).astype(np.int64)


def _known(t_ns: NDArray[np.int64], u: Array) -> Array:
    known = np.zeros((len(t_ns), sampling.SIZE))
    sampling.learn(t_ns, u, known, 0, len(t_ns))
    return known


def _claimed(u: Array, step_s: float, psd: float = SENSOR_PSD, span_s: float | None = None, sensor: int = GYRO) -> float:
    """Mean over the last half of what is claimed."""
    known = _known(_stamps(len(u), step_s), u)[len(u) // 2 :: 20]
    return float(np.mean([sampling.density(row, sensor, span_s or step_s, psd) for row in known]))


def _left_out(fine: Array, steps: int, lines: int) -> float:
    """Density of the error of straight lines over `steps` fine steps each: squared error of so many of them over their length."""
    line = np.repeat(0.5 * (fine[:-steps:steps] + fine[steps::steps]), steps, axis=0)
    window = lines * steps
    both = 0.5 * (fine[1:] + fine[:-1])[: len(line)] - line
    sums = both[: len(both) // window * window].reshape(-1, window, fine.shape[1]).sum(axis=1) * FINE_S
    return float(np.mean(sums**2) / (window * FINE_S))


@pytest.mark.parametrize("rate_hz", [50.0, 200.0])
@pytest.mark.parametrize("sensor", [GYRO, ACCEL])
def test_noise_that_is_known_is_not_added_again(rate_hz: float, sensor: int) -> None:
    u = _white(120.0, 1.0 / rate_hz, np.sqrt(SENSOR_PSD * rate_hz))
    assert _claimed(u, 1.0 / rate_hz, sensor=sensor) < 0.05 * SENSOR_PSD


@pytest.mark.parametrize("sensor", [GYRO, ACCEL])
def test_of_noise_in_the_samples_all_that_is_not_known_is_added(sensor: int) -> None:
    u = _white(120.0, 0.01, np.sqrt(5.0 * SENSOR_PSD * 100.0))
    assert _claimed(u, 0.01, sensor=sensor) == pytest.approx(4.0 * SENSOR_PSD, rel=0.1)


def test_vibration_from_far_above_the_rate_is_added_as_large_as_it_is() -> None:
    fine, steps = _white(400.0, FINE_S, 0.2), 40  # to 1 kHz, every fortieth sample kept: 50 Hz
    claimed = _claimed(fine[steps::steps], steps * FINE_S)
    assert claimed == pytest.approx(_left_out(fine, steps, 100), rel=0.25)
    assert claimed > 100 * SENSOR_PSD


def test_motion_that_the_rate_resolves_adds_nothing() -> None:
    t = 0.005 * np.arange(12_000)[:, None]
    u = 2.0 * np.sin(2.0 * np.pi * 2.0 * t + np.arange(6))  # 115 deg/s twice a second
    differences = 0.005 * np.diff(u, 2, axis=0).var() / 6.0  # as of white noise
    assert _claimed(u, 0.005, psd=1e-12) < 0.02 * differences


def test_a_vibration_near_half_the_rate_is_left_to_the_sensor() -> None:
    t = 0.005 * np.arange(12_000)[:, None]
    assert _claimed(0.2 * np.sin(2.0 * np.pi * 92.0 * t + np.arange(6)), 0.005) == 0.0


@pytest.mark.parametrize(("rate_hz", "gap_s"), [(200.0, 0.08), (200.0, 0.015), (100.0, 0.05), (50.0, 0.04)])
def test_what_a_gap_hides_is_added_as_large_as_it_is(rate_hz: float, gap_s: float) -> None:
    fine, steps = _wobble(120.0, 6.0, 1.0), round(1.0 / (rate_hz * FINE_S))
    claimed = _claimed(fine[steps::steps], 1.0 / rate_hz, span_s=gap_s)
    assert 0.7 < claimed / _left_out(fine, round(gap_s / FINE_S), 1) < 2.0
    assert claimed > 2.0 * _claimed(fine[steps::steps], 1.0 / rate_hz)


def test_gaps_and_jitter_do_not_count_as_vibration() -> None:
    fine, steps = _wobble(60.0, 3.0, 1.0), 10
    t_ns, u = _stamps(len(fine), FINE_S)[::steps], fine[::steps]
    kept = (t_ns % 1_000_000_000 < 300_000_000) | (t_ns % 1_000_000_000 > 380_000_000)
    whole, holed = _known(t_ns, u)[-1], _known(t_ns[kept], u[kept])[-1]
    assert holed[0] == pytest.approx(0.005, rel=0.01)
    np.testing.assert_allclose(holed[1:], whole[1:], rtol=0.35)


def test_what_is_known_grows_sample_by_sample() -> None:
    t_ns, u = _stamps(400, 0.01), _white(4.0, 0.01, 1.0)
    known = np.full((400, sampling.SIZE), np.nan)
    for i in range(400):
        sampling.learn(t_ns, u, known, i, i + 1)
    assert known.tobytes() == _known(t_ns, u).tobytes()


@pytest.mark.parametrize("stamps", [[7], [7, 8], [1, 2, 10**18], [5, 6, 8, 9, 11, 12]])
def test_a_short_or_uneven_stream_claims_nothing_but_numbers(stamps: list[int]) -> None:
    known = _known(np.array(stamps), _white(1.0, 0.1, 1.0)[: len(stamps)])
    assert np.isfinite(known).all()
    for row in known:
        assert np.isfinite(sampling.density(row, GYRO, 0.05, SENSOR_PSD))
