"""The walk of the biases is taken as larger while innovations show that the motion is wrong, and only then."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.eskf import Innovation
from estimator.filter.mismatch.bias_walk import BiasWalk, Whiteness
from models.imu import ImuNoise
from models.messages import Array, GnssFix, ImuSample, Input, PoseFix, vec3
from models.sim.scenario import EPOCH_NS
from models.state import E
from tests.estimator.scenes import SECOND, aid_of, error, fly, pose_fix, position_errors, simulated, within

NOISE = ImuNoise(gyro_walk=1e-5, accel_walk=1e-4)


def _seen(nu: Array) -> Innovation:
    identity = np.eye(len(nu))
    return Innovation(nu, identity, identity, identity, identity, float(nu @ nu), 0.0)


def _after(walk: BiasWalk, innovations: Array, *, variance_factor: float = 1.0, topic: str = "/fix") -> BiasWalk:
    for k, nu in enumerate(innovations):
        walk = walk.also(topic, max(walk.t_ns, EPOCH_NS) + (k % 5) * SECOND // 2, _seen(nu), variance_factor)
    return walk


def _white(n: int, sigma: float = 1.0, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(0.0, sigma, (n, 6))


@pytest.mark.parametrize("sigma", [0.3, 1.0])
def test_white_innovations_leave_the_walk_as_configured(sigma: float) -> None:
    walk = _after(BiasWalk(), _white(400, sigma))
    assert walk.factor == 1.0
    assert walk.of_noise(NOISE) == NOISE


def test_large_innovations_without_a_direction_are_the_noise_of_the_source() -> None:
    raised = sum(_after(BiasWalk(), _white(100, 4.0, seed)).factor > 1.0 for seed in range(20))
    assert raised <= 2


def test_innovations_that_follow_one_another_raise_it_and_it_comes_back() -> None:
    wrong = _after(BiasWalk(), _white(40, 0.5) + np.array([2.0, -1.5, 0.0, 0.0, 1.0, 0.0]))
    assert wrong.factor >= 1e4
    larger = wrong.of_noise(NOISE)
    assert larger.gyro_walk == pytest.approx(min(NOISE.gyro_walk * math.sqrt(wrong.factor), 1e-3))
    assert larger.accel_walk > 10.0 * NOISE.accel_walk
    right = _after(wrong, _white(2000, 1.0))
    assert right.factor == 1.0


def _first_rise(innovations: Array) -> float:
    """The first factor above one, with two innovations a second."""
    walk = BiasWalk()
    for k, nu in enumerate(innovations):
        walk = walk.also("/fix", EPOCH_NS + k * SECOND // 2, _seen(nu), 1.0)
        if walk.factor > 1.0:
            break
    return walk.factor


def test_what_is_surely_wrong_raises_it_a_hundred_times_at_once_and_what_is_likely_wrong_ten_times() -> None:
    off = np.array([2.0, -1.5, 0.0, 0.0, 1.0, 0.0])
    assert _first_rise(np.concatenate((_white(20), _white(30, 0.3) + 2.0 * off))) == 100.0
    gently = np.linspace(0.0, 1.0, 60)[:, None] * off
    assert sorted({_first_rise(_white(60, 0.9, seed) + gently) for seed in range(10)}) == [10.0, 100.0]


@pytest.mark.parametrize(("size", "wrong"), [(1.2, False), (1.4, True), (7.9, True), (8.1, False)])
def test_a_mean_counts_where_the_innovations_are_larger_than_noise_and_smaller_than_a_wrong_covariance(
    size: float, wrong: bool
) -> None:
    assert Whiteness(size, np.array([4.0, 0.0, 0.0, 0.0, 0.0, 0.0])).is_wrong(0.995) is wrong
    assert not Whiteness(size, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])).is_wrong(0.995)


def test_the_biases_have_walked_before_it_was_noticed() -> None:
    noticed = BiasWalk(factor=100.0).walked(BiasWalk(), NOISE)
    assert noticed[:3] == pytest.approx(math.sqrt(5.0 * 99.0) * NOISE.gyro_walk)
    assert noticed[3:] == pytest.approx(math.sqrt(5.0 * 99.0) * NOISE.accel_walk)
    assert not BiasWalk().walked(BiasWalk(factor=100.0), NOISE).any()


def test_small_innovations_in_one_direction_are_no_error() -> None:
    assert _after(BiasWalk(), np.tile([0.5, 0.3, 0.0, 0.0, 0.0, 0.0], (100, 1))).factor == 1.0


def test_what_is_seen_is_compared_with_the_covariance_before_it_was_widened() -> None:
    ramp = _white(40, 0.2) + np.array([0.6, -0.5, 0.0, 0.0, 0.4, 0.0])
    assert _after(BiasWalk(), ramp).factor == 1.0
    assert _after(BiasWalk(), ramp, variance_factor=16.0).factor > 1.0


def test_a_walk_that_is_configured_larger_is_never_made_smaller() -> None:
    rough = ImuNoise(gyro_walk=0.5, accel_walk=5.0)
    assert BiasWalk(factor=1e6).of_noise(rough) == rough


FLIGHT = """
duration_s = 90.0
[imu]
rate_hz = 100.0
[pose_fix]
rate_hz = 2.0
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
"""


def _walk_of(run_messages: list[Input], seed: int) -> tuple[float, float]:
    """The factor at the end, and the RMSE of the last 40 s."""
    flight = simulated(FLIGHT, seed=seed)
    run = fly(flight, messages=run_messages)
    factor = run.fusion._history.advance(run.estimates[-1].t_ns).bias_walk.factor
    off = position_errors(within(run.estimates, 50.0, 90.0), flight.truth)
    return factor, math.sqrt((off**2).mean())


@pytest.mark.parametrize("seed", range(3))
def test_a_flight_as_configured_keeps_its_walk(seed: int) -> None:
    factor, rmse_m = _walk_of([m for m in simulated(FLIGHT, seed=seed).messages if "gnss" not in type(m).__name__.lower()], seed)
    assert factor == 1.0
    assert rmse_m < 0.25


def test_a_gyroscope_that_warms_up_costs_decimetres_and_no_more() -> None:
    def warming(m: Input) -> Input:
        if not isinstance(m, ImuSample):
            return m
        bias = math.radians(2.0) * max((m.t_ns - EPOCH_NS) * 1e-9 - 10.0, 0.0) / 60.0
        return replace(m, gyro_b=vec3(np.array(m.gyro_b) + bias * np.array([0.6, 0.0, 0.8])))

    flight = simulated(FLIGHT, seed=1)
    factor, rmse_m = _walk_of([warming(m) for m in flight.messages if "gnss" not in type(m).__name__.lower()], 1)
    assert factor > 1e2
    assert rmse_m < 0.6


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_slow_ramp_is_found_before_an_outage_and_its_covariance_covers_the_error(seed: int) -> None:
    """0.5 degrees a second per minute, no fixes for the last 10 s."""
    axis = np.random.default_rng(seed).normal(size=3)
    ramp = math.radians(0.5) / 60.0 * axis / np.linalg.norm(axis)

    def warming(m: Input) -> Input:
        return replace(m, gyro_b=vec3(np.array(m.gyro_b) + (m.t_ns - EPOCH_NS) * 1e-9 * ramp)) if isinstance(m, ImuSample) else m

    flight = simulated(FLIGHT.replace("90.0", "50.0"), seed=seed)
    dark_ns = EPOCH_NS + 40 * SECOND
    run = fly(
        flight,
        messages=[
            warming(m) for m in flight.messages if isinstance(m, ImuSample) or (isinstance(m, PoseFix) and m.t_ns < dark_ns)
        ],
    )
    last = run.estimates[-1]
    off = error(last, flight.truth)[E.P]
    assert off @ np.linalg.solve(last.covariance[E.P, E.P], off) < 4.0


def test_readings_of_a_receiver_do_not_raise_it_for_a_receiver_may_be_pulled_off() -> None:
    def pulled(m: Input) -> Input:
        seconds = max((m.t_ns - EPOCH_NS) * 1e-9 - 20.0, 0.0)
        return replace(m, lat_deg=m.lat_deg + 3.0 * seconds / 111_320.0) if isinstance(m, GnssFix) else m

    flight = simulated(FLIGHT + "[gnss]\nrate_hz = 5.0\n", seed=1)
    run = fly(flight, messages=[pulled(m) for m in flight.messages])
    walk = run.fusion._history.advance(run.estimates[-1].t_ns).bias_walk
    assert set(walk.sources) == {"/pose_fix"}
    assert walk.factor == 1.0


def test_every_hypothesis_has_the_larger_biases_at_once_when_the_motion_is_found_to_be_wrong() -> None:
    flight = simulated(FLIGHT, seed=1)
    run = fly(flight, messages=flight.messages[:2000])
    t_ns = run.estimates[-1].t_ns
    tracker = run.fusion._history.advance(t_ns)
    assert tracker.core.hypotheses is not None
    lead = tracker.core.hypotheses.lead
    before = lead.cov.diagonal()[E.BG.start : E.BA.stop].copy()
    tracker.bias_walk = BiasWalk({"/pose_fix": Whiteness(3.0, np.array([4.0, 0.0, 0.0, 0.0, 0.0, 0.0]))}, t_ns=t_ns - 2 * SECOND)
    tracker._note_biases(aid_of(pose_fix(t_ns)), _seen(np.array([4.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
    walked = tracker.bias_walk.walked(BiasWalk(), tracker.core.noise)
    assert tracker.bias_walk.factor == 100.0
    np.testing.assert_allclose(lead.cov.diagonal()[E.BG.start : E.BA.stop] - before, walked**2, rtol=1e-6)


def test_a_restarted_estimate_keeps_what_was_estimated_of_the_sensors() -> None:
    flight = simulated(FLIGHT, seed=1)
    run = fly(flight, messages=flight.messages[:2000])
    tracker = run.fusion._history.advance(run.estimates[-1].t_ns)
    tracker.bias_walk = BiasWalk(factor=100.0)
    again = tracker.restarted()
    assert again.bias_walk.factor == 100.0
    assert again.frames is tracker.frames
    assert again.scores == tracker.scores


def test_beside_a_receiver_that_agrees_with_the_fixes_it_is_the_motion_too() -> None:
    flight = simulated(FLIGHT + '[gnss]\n[vehicle]\nkind = "fixed_wing"\n', seed=1)
    step = np.radians(0.2) * np.array([0.6, 0.0, 0.8])
    turned = [
        replace(m, gyro_b=vec3(m.gyro_b + step)) if isinstance(m, ImuSample) and m.t_ns > EPOCH_NS + 20 * SECOND else m
        for m in flight.messages
    ]
    run = fly(flight, messages=turned)
    assert position_errors(within(run.estimates, 20.0, 90.0), flight.truth).max() < 1.0
