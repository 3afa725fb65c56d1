"""Rest: a vehicle that stands still keeps position and heading; what only looks at rest does not stop."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimator.fusion import Fusion, FusionConfig
from estimator.sources.rest import RestConfig
from models.messages import Array, Estimate, ImuSample, Input, Reading, Reason
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import GRADES, Imu
from models.state import E
from tests import long
from tests.estimator.scenes import Run, error, within
from tests.scenarios.senses import HOME, Ride, loops, ride

MOVES_S, STANDS_S = 25.0, 90.0
BEGINS_S = 2.0 + MOVES_S  # of the stand
ON = FusionConfig(imu=GRADES["hobby"].noise, origin=HOME.lla, rest=RestConfig(enabled=True))
OFF = FusionConfig(imu=GRADES["hobby"].noise, origin=HOME.lla)


def _stop_and_go(t: Array) -> Array:
    first, second = loops(np.minimum(t, MOVES_S)), loops(np.maximum(t - MOVES_S - STANDS_S, 0.0))
    return first + np.where((t > MOVES_S + STANDS_S)[:, np.newaxis], second, 0.0)


def _cruise(t: Array) -> Array:
    """Loops, then straight on at 3 m/s, with the nose held."""
    straight = np.column_stack([3.0 * np.maximum(t - MOVES_S, 0.0), np.zeros((len(t), 3))])
    return loops(np.minimum(t, MOVES_S)) + straight


def _flying(speed_m_s: float, sway_m: float) -> Callable[[Array], Array]:
    """Loops, then ahead at this speed within 10 s, swaying as a controller that holds its place in wind."""

    def path(t: Array) -> Array:
        s = np.maximum(t - MOVES_S - 3.0, 0.0)
        ahead = speed_m_s * np.where(s < 10.0, s**2 / 20.0, s - 5.0)
        sway = sway_m * np.minimum(s / 5.0, 1.0)
        sways = [ahead + sway * np.sin(1.3 * s), sway * np.cos(0.9 * s), 0.3 * sway * np.sin(0.7 * s), np.zeros(len(t))]
        return loops(np.minimum(t, MOVES_S)) + np.column_stack(sways)

    return path


def _imu() -> Imu:
    return Imu(grade="hobby", rate_hz=50.0)


@pytest.fixture(scope="module")
def journey() -> Ride:
    return ride(2.0, MOVES_S + STANDS_S + 20.0, seed=3, path=_stop_and_go, imu=_imu())


def _dark(messages: list[Input], begin_s: float, end_s: float) -> list[Input]:
    return [m for m in messages if isinstance(m, ImuSample) or not begin_s < (m.t_ns - EPOCH_NS) * 1e-9 < end_s]


def _landed(messages: list[Input], state: float, begin_s: float, end_s: float) -> list[Input]:
    """With an autopilot's word at 5 Hz."""
    times = EPOCH_NS + (np.arange(begin_s, end_s, 0.2) * 1e9).astype(np.int64)
    words = [Reading(t, t, "/landed", "rest", (state,)) for t in times.tolist()]
    return sorted([*messages, *words], key=lambda m: m.arrived_ns)


def _errors(run: Run, journey: Ride, begin_s: float, end_s: float) -> tuple[float, float]:
    """Largest error of position [m], and mean NEES of position and attitude per component."""
    some: list[Estimate] = within(run.aligned, begin_s, end_s)
    nees, worst = [], 0.0
    for e in some:
        off = error(e, journey.truth)
        worst = max(worst, float(np.linalg.norm(off[E.P])))
        nees += [off[k] @ np.linalg.solve(e.covariance[k, k], off[k]) / 3.0 for k in (E.P, E.THETA)]
    return worst, float(np.mean(nees))


def _heading_sigma_deg(e: Estimate) -> float:
    return math.degrees(math.sqrt(float(np.diag(e.covariance)[E.THETA].max())))


@pytest.mark.parametrize("landed", [False, True], ids=["enabled", "landed"])
def test_given_a_stand_without_gnss_then_position_and_heading_stay(journey: Ride, *, landed: bool) -> None:
    dark = _dark(journey.messages, BEGINS_S + 10.0, BEGINS_S + STANDS_S)
    off = Run(Fusion(OFF)).feed(dark)
    on = Run(Fusion(OFF)).feed(_landed(dark, 1.0, BEGINS_S, BEGINS_S + STANDS_S)) if landed else Run(Fusion(ON)).feed(dark)
    assert on.internal_errors() == []
    (kept_m, nees), (lost_m, _) = (_errors(run, journey, BEGINS_S + 70.0, BEGINS_S + 85.0) for run in (on, off))
    assert kept_m < 1.5 < lost_m
    assert nees < 2.5
    assert on.reasons("rest")[Reason.FUSED] > STANDS_S - 10.0
    begin, end = within(on.aligned, BEGINS_S + 8.0, BEGINS_S + 9.0)[0], within(on.aligned, BEGINS_S + 80.0, BEGINS_S + 85.0)[-1]
    assert _heading_sigma_deg(end) < 1.1 * _heading_sigma_deg(begin)


def test_given_that_it_moves_again_then_nothing_holds_it_back(journey: Ride) -> None:
    run = Run(Fusion(ON)).feed(journey.messages)
    worst, nees = _errors(run, journey, BEGINS_S + STANDS_S, BEGINS_S + STANDS_S + 18.0)
    assert worst < 1.0
    assert nees < 2.5
    assert "rest" in run.health[-1].sources


@long.parametrize("is_dark", [False, True], ids=["with GNSS", "without"])
def test_given_a_straight_cruise_that_feels_like_rest_then_it_is_not_stopped(is_dark: bool) -> None:
    cruise = ride(2.0, MOVES_S + 40.0, seed=4, path=_cruise, imu=_imu())
    messages = _dark(cruise.messages, BEGINS_S + 5.0, 1e9) if is_dark else cruise.messages
    run = Run(Fusion(ON)).feed(messages)
    assert run.internal_errors() == []
    cruising = [s for s in run.last_words("rest").values() if s.t_ns > EPOCH_NS + (BEGINS_S + 5.0) * 1e9]
    assert Reason.FUSED not in {s.reason for s in cruising}
    assert Reason.GATED in {s.reason for s in cruising}
    _, nees = _errors(run, cruise, BEGINS_S + 5.0, BEGINS_S + 38.0)
    assert nees < 2.5


@long.parametrize("is_dark", [False, True], ids=["with GNSS", "without"])
@long.parametrize(
    ("speed_m_s", "sway_m"), [(0.3, 0.1), (0.0, 0.1), (0.0, 0.3), (3.0, 0.0)], ids=["drift", "hover", "wind", "cruise"]
)
def test_given_a_false_landed_in_flight_then_the_estimate_is_as_without_it(
    speed_m_s: float, sway_m: float, is_dark: bool
) -> None:
    """The IMU shows the sway, and the velocity the cruise. 1e-3: propagation in other steps, to the time of each word."""
    flight = ride(2.0, MOVES_S + 40.0, seed=4, path=_flying(speed_m_s, sway_m), imu=_imu())
    messages = _dark(flight.messages, BEGINS_S + 15.0, 1e9) if is_dark else flight.messages
    landed, without = (
        Run(Fusion(OFF)).feed(_landed(messages, 1.0, BEGINS_S + 6.0, BEGINS_S + 38.0)),
        Run(Fusion(OFF)).feed(messages),
    )
    said = landed.reasons("rest")
    assert sum(said.values()) > 100
    assert Reason.FUSED not in said
    begin_s, end_s = BEGINS_S + 5.0, BEGINS_S + 38.0
    assert _errors(landed, flight, begin_s, end_s) == pytest.approx(_errors(without, flight, begin_s, end_s), rel=1e-3)


@long.parametrize("is_dark", [False, True], ids=["with GNSS", "without"])
def test_given_a_false_landed_in_a_drift_without_vibration_then_no_harm_beyond_what_is_said(is_dark: bool) -> None:
    """0.3 m/s: neither the IMU nor the velocity shows it."""
    flight = ride(2.0, MOVES_S + 40.0, seed=4, path=_flying(0.3, 0.0), imu=_imu())
    messages = _dark(flight.messages, BEGINS_S + 5.0, 1e9) if is_dark else flight.messages
    run = Run(Fusion(OFF)).feed(_landed(messages, 1.0, BEGINS_S, BEGINS_S + 38.0))
    worst, nees = _errors(run, flight, BEGINS_S + 5.0, BEGINS_S + 38.0)
    assert worst < (12.0 if is_dark else 2.5)
    assert nees < 2.5


@pytest.mark.long
def test_switched_off_nothing_is_asked(journey: Ride) -> None:
    assert not Run(Fusion(OFF)).feed(journey.messages[:1000]).reasons("rest")
