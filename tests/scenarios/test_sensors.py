"""The optional sensors on a vehicle that rests and then moves: what each is worth, and what its faults cost."""

import math

import numpy as np
import pytest

from estimator.fusion import Fusion, FusionConfig
from models import so3
from models.messages import Array, Estimate, Input, Mode, Reason
from models.sim.scenario import EPOCH_NS, Truth
from models.sim.sensors import GRADES
from models.state import E, X
from tests import long
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, heading, magnetometer, ride

REST_S, MOVING_S = 12.0, 25.0
CONFIG = FusionConfig(imu=GRADES["flight_controller"].noise, origin=HOME.lla)


@pytest.fixture(scope="module")
def journey() -> Ride:
    return ride(REST_S, MOVING_S, seed=1)


def _run(journey: Ride, readings: list[Input], config: FusionConfig = CONFIG) -> Run:
    run = Run(Fusion(config)).feed(by_arrival([*journey.messages, *readings]))
    assert run.internal_errors() == []
    return run


def _seconds(e: Estimate) -> float:
    return (e.t_ns - EPOCH_NS) * 1e-9


def _yaw(estimates: list[Estimate], truth: Truth) -> tuple[Array, Array]:
    """Error of the heading and its sigma, degrees, (n,)."""
    errors, sigmas = [], []
    for e in estimates:
        r_nb = so3.matrix(e.nav[X.Q])
        errors.append((r_nb @ error(e, truth)[E.THETA])[2])
        sigmas.append(math.sqrt((r_nb @ e.covariance[E.THETA, E.THETA] @ r_nb.T)[2, 2]))
    return np.degrees(errors), np.degrees(sigmas)


def _nees(estimates: list[Estimate], truth: Truth, part: slice) -> float:
    """Mean squared error of position or attitude in sigma, per component."""
    each = []
    for e in estimates:
        off = error(e, truth)[part]
        each.append(float(off @ np.linalg.solve(e.covariance[part, part], off)) / len(off))
    return float(np.mean(each))


def test_given_a_magnetometer_then_the_heading_is_known_at_rest_and_a_hundred_readings_are_no_hundred_witnesses(
    journey: Ride,
) -> None:
    without, run = _run(journey, []), _run(journey, magnetometer(journey.truth, seed=1, rate_hz=25.0))
    assert _seconds(without.aligned[0]) > REST_S
    assert _seconds(run.aligned[0]) < 3.0
    rest = within(run.aligned, 3.0, REST_S)
    off, sigma = _yaw(rest, journey.truth)
    assert np.abs(off / sigma).max() < 3.0
    assert sigma.min() > 5.0
    assert {e.mode for e in rest} == {Mode.AIDED}
    assert _nees(within(run.aligned, REST_S, REST_S + MOVING_S), journey.truth, E.THETA) < 2.5
    assert "heading is that of /mag alone" in next(h for h in run.health if h.t_ns > EPOCH_NS + 5 * 10**9).detail
    assert "alone" not in run.health[-1].detail


@pytest.mark.long
def test_given_a_long_rest_then_the_noise_of_gnss_refutes_no_magnetometer() -> None:
    """Compared reading by reading, eight headings that begin anew are better by chance within 15 s of this rest."""
    rest_s = 42.0
    long = ride(rest_s, 5.0, seed=2, yaw=0.0)
    later = [m for m in by_arrival([*long.messages, *magnetometer(long.truth, seed=2)]) if m.t_ns > EPOCH_NS + 5 * 10**9]
    run = Run(Fusion(CONFIG)).feed(later)
    rest = within(run.estimates, 8.0, rest_s)
    assert {e.mode for e in rest} == {Mode.AIDED}
    off, sigma = _yaw(rest, long.truth)
    assert sigma.max() < 10.0
    assert np.abs(off / sigma).max() < 3.0
    assert _nees(within(run.aligned, rest_s + 2.0, rest_s + 5.0), long.truth, E.THETA) < 2.0


@pytest.mark.long
def test_given_a_rest_of_minutes_then_tilt_and_bias_are_not_told_apart_before_the_vehicle_moves() -> None:
    """They show together alone. A filter that learns one of them as its heading wanders is overconfident when it moves."""
    rest_s = 150.0
    long = ride(rest_s, 6.0, seed=3, yaw=0.0)
    run = Run(Fusion(CONFIG)).feed(by_arrival([*long.messages, *magnetometer(long.truth, seed=3)]))
    tilt = [np.sqrt(np.sort(e.covariance.diagonal()[E.THETA])[:2]) for e in within(run.estimates, 60.0, rest_s)]
    assert np.degrees(np.min(tilt)) > 0.8
    moved = within(run.aligned, rest_s + 4.0, rest_s + 6.0)
    assert len(moved) >= 5
    for part in (E.V, E.THETA):  # velocity 23, attitude 44 where they are told apart
        assert _nees(moved, long.truth, part) < 4.0


TURNED = {f"turned by {deg} deg": so3.matrix(so3.from_euler(0.0, 0.0, math.radians(deg))) for deg in (90.0, 180.0)}


@long.parametrize("turned", [*TURNED.values(), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])],
                         ids=[*TURNED, "x and y exchanged"])  # fmt: skip
def test_given_wrong_axes_in_the_plane_then_motion_finds_it_out(journey: Ride, turned: Array) -> None:
    run = _run(journey, magnetometer(journey.truth, seed=1, turned=turned))
    later = within(run.aligned, REST_S + 8.0, REST_S + MOVING_S)
    off, _ = _yaw(later, journey.truth)
    assert np.abs(off).max() < 3.0
    assert _nees(later, journey.truth, E.THETA) < 3.0
    moving = within(run.estimates, REST_S, REST_S + MOVING_S, every=5)
    assert _nees(moving, journey.truth, E.P) < 2.0
    words = run.last_words("/mag").values()
    assert sum(s.reason in {Reason.STOPPED, Reason.GATED, Reason.IMPLAUSIBLE} for s in words) > 50


@long.parametrize("sign", [-np.eye(3), np.diag([1.0, -1.0, -1.0])], ids=["negative", "flu for frd"])
def test_given_a_field_that_points_up_then_it_is_refused_and_the_heading_comes_from_motion(journey: Ride, sign: Array) -> None:
    run = _run(journey, magnetometer(journey.truth, seed=1, turned=sign))
    assert _seconds(run.aligned[0]) > REST_S
    assert any("above the horizon" in s.detail for s in run.last_words("/mag").values())
    assert Reason.FUSED not in run.reasons("/mag")


def test_given_two_antennas_then_the_heading_is_known_at_rest_to_their_accuracy(journey: Ride) -> None:
    run = _run(journey, heading(journey.truth, seed=1))
    assert _seconds(run.aligned[0]) < 3.0
    off, sigma = _yaw(within(run.aligned, 3.0, REST_S), journey.truth)
    assert np.abs(off / sigma).max() < 3.0
    assert 0.8 < sigma.mean() < 2.0
    assert _nees(within(run.aligned, REST_S, REST_S + MOVING_S), journey.truth, E.THETA) < 2.5
    assert Reason.GATED not in run.reasons("/heading")


@long.parametrize("off_deg", [90.0, 180.0])
def test_given_antennas_that_are_exchanged_or_across_then_motion_finds_it_out(journey: Ride, off_deg: float) -> None:
    run = _run(journey, heading(journey.truth, seed=1, off_deg=off_deg))
    later = within(run.aligned, REST_S + 8.0, REST_S + MOVING_S)
    assert np.abs(_yaw(later, journey.truth)[0]).max() < 3.0
    assert _nees(within(run.estimates, REST_S, REST_S + MOVING_S, every=5), journey.truth, E.P) < 2.0
    words = run.last_words("/heading").values()
    assert sum(s.reason in {Reason.STOPPED, Reason.GATED} for s in words) > 50
