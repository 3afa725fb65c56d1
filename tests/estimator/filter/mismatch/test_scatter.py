"""Noise of a source from its readings alone."""

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.eskf import Innovation
from estimator.filter.mismatch import Scatter
from models.messages import Array, PoseFix, vec3
from models.sim.scenario import EPOCH_NS
from models.state import E
from tests.estimator.scenes import SECOND, fly, position_errors, simulated

SIGMA = 0.2
NOISY_NS = EPOCH_NS + 20 * SECOND


def _after(nus: Array) -> Scatter:
    """After innovations (k, 6) of a pose twice a second, of SIGMA in all components, whose noise is widened as found."""
    scatter = Scatter(EPOCH_NS)
    for k, nu in enumerate(nus):
        noise = scatter.widened(SIGMA**2 * np.eye(6)) if scatter.factors else SIGMA**2 * np.eye(6)
        s = noise + 1e-4 * np.eye(6)
        seen = Innovation(nu, np.eye(6), np.eye(6), noise, s, float(nu @ np.linalg.solve(s, nu)), 0.0)
        scatter = scatter.also(EPOCH_NS + k * SECOND // 2, seen, SIGMA**2 * np.eye(6), fused=False)
    return scatter


def _noise(readings: int, times: float) -> Array:
    sigma: Array = SIGMA * np.array([times] * 3 + [1.0] * 3)
    return np.random.default_rng(5).normal(scale=sigma, size=(readings, 6))


def test_the_noise_of_positions_is_found_and_that_of_attitudes_left() -> None:
    of_position, of_attitude = _after(_noise(60, 25.0)).factors
    assert 0.5 * 25.0**2 < of_position < 2.0 * 25.0**2
    assert of_attitude == 1.0


@pytest.mark.parametrize(("fused", "by_chance"), [(0, 0), (2, 2), (5, 0)])
def test_one_or_two_that_were_fused_passed_by_chance(fused: int, by_chance: int) -> None:
    noisy = _after(_noise(30, 25.0))
    last = tuple(replace(reading, fused=k >= len(noisy.last) - fused) for k, reading in enumerate(noisy.last))
    assert replace(noisy, last=last).by_chance == by_chance


@pytest.mark.parametrize("way", ["constant", "drifts", "three outliers"])
def test_an_error_that_is_no_noise_widens_nothing(way: str) -> None:
    nus = _noise(40, 1.0)
    if way == "three outliers":
        nus[[28, 32, 36], :3] += 30.0
    else:
        nus[:, 0] += 30.0 if way == "constant" else np.linspace(5.0, 60.0, 40)
    assert _after(nus).factor == 1.0


@pytest.mark.parametrize(("readings", "ends"), [(4, False), (8, True), (40, True)])
def test_four_usual_second_differences_end_it(readings: int, *, ends: bool) -> None:
    factor = _after(np.concatenate((_noise(30, 25.0), _noise(readings, 1.0)))).factor
    assert (factor == 1.0) == ends


def test_noise_that_goes_on_does_not_end() -> None:
    assert min(_after(_noise(k, 10.0)).factor for k in range(20, 200, 3)) > 10.0


def test_it_fades_in_a_gap() -> None:
    noisy = _after(_noise(30, 25.0))
    seen = Innovation(np.zeros(6), np.eye(6), np.eye(6), np.eye(6), np.eye(6), 0.0, 0.0)
    later = noisy.also(noisy.t_ns + 5 * SECOND, seen, SIGMA**2 * np.eye(6), fused=False)
    assert later.factor == pytest.approx(noisy.factor ** np.exp(-1.0))


def test_readings_that_are_far_apart_in_time_are_not_compared() -> None:
    noisy = _after(_noise(30, 25.0))
    seen = Innovation(np.ones(6), np.eye(6), np.eye(6), np.eye(6), np.eye(6), 6.0, 0.0)
    after = noisy.also(noisy.t_ns + 3 * SECOND, seen, np.eye(6), fused=False)
    assert len(after.last) == 1
    assert after.factor == pytest.approx(noisy.factor ** np.exp(-3.0 / 5.0))
    assert noisy.also(noisy.t_ns + 60 * SECOND, seen, np.eye(6), fused=False).factor == 1.0


def test_fixes_that_become_noisy_for_good_are_weighed_by_their_noise() -> None:
    """25 times the reported sigma, and nothing else: neither followed as motion nor left for the IMU alone."""
    simulation = simulated("duration_s = 60.0\n[imu]\nrate_hz = 50.0\n[pose_fix]\nrate_hz = 2.0\n", seed=3)
    rng = np.random.default_rng(7)
    noisy = [
        replace(m, p_n=vec3(np.add(m.p_n, 5.0 * rng.normal(size=3)))) if isinstance(m, PoseFix) and m.t_ns > NOISY_NS else m
        for m in simulation.messages
    ]
    run = fly(simulation, messages=noisy)
    errors = position_errors(run.estimates, simulation.truth)
    sigma = np.array([np.sqrt(e.covariance[E.P, E.P].trace()) for e in run.estimates])
    assert run.estimates[-1].t_ns > EPOCH_NS + 59 * SECOND
    assert np.sqrt(np.mean(errors[len(errors) // 3 :] ** 2)) < 5.0 * np.sqrt(3.0)  # the error of the fixes
    assert np.mean(errors > 3.0 * sigma) < 0.01
