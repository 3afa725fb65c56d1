"""An IMU that says something else than the fixes, which agree among themselves: no estimate rather than a wrong one."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from estimator.filter.contradiction import NO_CONTRADICTION, SAYS, Contradiction
from models.measurements import Pose, Position, Velocity
from models.messages import ImuSample, Input, Mode, PoseFix, Reason, Vec3
from models.sim.scenario import EPOCH_NS, Simulation
from tests.estimator.scenes import SECOND, Run, displaced, fly, position_errors, simulated

SIGMA_M = 0.1
FAILS_S = 20.0
QUIET = np.eye(3) * SIGMA_M**2


def _contradiction(positions: list[float], every_s: float = 0.5) -> Contradiction:
    """Fixes at these places along north, that nobody has foreseen."""
    found = NO_CONTRADICTION
    for k, north in enumerate(positions):
        found = found.also(round(k * every_s * 1e9), Position(np.array([north, 0.0, 0.0]), QUIET, np.arange(3), np.zeros(3)))
    return found


def test_fixes_along_a_path_that_can_be_flown_show_it_after_some_seconds() -> None:
    path = [4.0 * (0.5 * k) ** 2 for k in range(12)]
    assert [_contradiction(path[:n]).is_shown for n in (5, 6, 7, 8)] == [False, False, True, True]


def test_fixes_that_lie_about_show_nothing() -> None:
    assert not _contradiction([0.0, 25.0, -10.0, 5.0, 30.0, -20.0, 0.0, 15.0, -25.0, 20.0]).is_shown


def test_nor_do_few_fixes_or_those_too_far_apart() -> None:
    assert not _contradiction([0.0, 0.0, 0.0, 0.0], every_s=1.5).is_shown
    assert not _contradiction([0.0] * 12, every_s=3.0).is_shown


def test_a_velocity_reports_no_position() -> None:
    assert NO_CONTRADICTION.also(0, Velocity(np.zeros(3), QUIET, np.zeros(3))) == NO_CONTRADICTION


def test_a_pose_reports_its_place() -> None:
    pose = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.eye(6) * SIGMA_M**2, np.arange(6))
    assert NO_CONTRADICTION.also(0, pose).unforeseen == 1


# --- flights -----------------------------------------------------------------------------------------------------------------


def _flight(rate_hz: float = 2.0, duration_s: float = 40.0) -> Simulation:
    return simulated(f"duration_s = {duration_s}\n[imu]\nrate_hz = 100.0\n[pose_fix]\nrate_hz = {rate_hz}\n", seed=3)


def _with_imu(simulation: Simulation, change: Callable[[Vec3, Vec3], tuple[Vec3, Vec3]], from_s: float = 0.0) -> list[Input]:
    begin = EPOCH_NS + round(from_s * 1e9)
    return [
        ImuSample(m.t_ns, m.arrived_ns, *change(m.gyro_b, m.accel_b)) if isinstance(m, ImuSample) and m.t_ns >= begin else m
        for m in simulation.messages
    ]


def _turned(v: Vec3) -> Vec3:
    return v[0], -v[1], -v[2]


@pytest.mark.parametrize("rate_hz", [2.0, 10.0])
@pytest.mark.parametrize(
    "change",
    [
        lambda w, f: (_turned(w), _turned(f)),
        lambda w, f: (w, (-f[0], -f[1], -f[2])),
        lambda w, f: ((w[0] * 57.3, w[1] * 57.3, w[2] * 57.3), f),
    ],
    ids=["flu taken for frd", "accelerometer upside down", "degrees per second"],
)
def test_with_wrong_axes_or_units_nothing_is_published_and_health_reports_why(
    change: Callable[[Vec3, Vec3], tuple[Vec3, Vec3]], rate_hz: float
) -> None:
    simulation = _flight(rate_hz)
    run = fly(simulation, messages=_with_imu(simulation, change))
    assert len(run.estimates) < 0.1 * 40.0 * 100.0
    assert run.health[-1].mode is Mode.ALIGNING
    assert run.health[-1].detail == SAYS


@pytest.mark.parametrize(
    "change", [lambda _, f: ((1.0, 0.5, 0.0), f), lambda w, _: (w, (0.0, 0.0, 0.0))], ids=["gyro stuck", "accelerometer dead"]
)
def test_an_imu_of_which_a_sensor_is_held_in_flight_is_missing_and_the_fixes_lead_on(
    change: Callable[[Vec3, Vec3], tuple[Vec3, Vec3]],
) -> None:
    simulation = _flight()
    run = fly(simulation, messages=_with_imu(simulation, change, FAILS_S))
    held = [s for s in run.statuses if s.reason is Reason.HELD]
    assert (held[0].t_ns - EPOCH_NS) * 1e-9 < FAILS_S + 1.0
    last = [e for e in run.estimates if e.t_ns > EPOCH_NS + round((FAILS_S + 3.0) * 1e9)]
    assert position_errors(last, simulation.truth).max() < 3.0
    assert run.health[-1].mode is Mode.COASTING


def test_after_an_imu_that_failed_for_a_while_the_estimate_is_back() -> None:
    simulation = _flight(duration_s=60.0)
    begin, end = (EPOCH_NS + round(s * 1e9) for s in (FAILS_S, FAILS_S + 8.0))
    messages: list[Input] = [
        msgspec.structs.replace(m, gyro_b=(1.0, 0.5, 0.0)) if isinstance(m, ImuSample) and begin <= m.t_ns < end else m
        for m in simulation.messages
    ]
    run = fly(simulation, messages=messages)
    last = [e for e in run.estimates if e.t_ns > end + 16 * SECOND]
    assert len(last) > 500
    assert position_errors(last, simulation.truth).max() < 2.0
    assert run.resets


def test_false_fixes_that_lie_about_do_not_end_the_estimate() -> None:
    simulation, rng = _flight(), np.random.default_rng(1)
    begin = EPOCH_NS + round(FAILS_S * 1e9)
    messages: list[Input] = [
        displaced(m, tuple(rng.uniform(-200.0, 200.0, 3).tolist())) if isinstance(m, PoseFix) and m.t_ns >= begin else m
        for m in simulation.messages
    ]
    run = Run(fly(simulation, messages=[]).fusion).feed(messages)
    assert run.health[-1].mode is Mode.DEAD_RECKONING
    assert position_errors(run.estimates[-10:], simulation.truth).max() < 60.0
