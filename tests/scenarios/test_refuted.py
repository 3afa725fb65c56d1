"""A sensor that positions refute is not fused, nor in the dark, where the covariance grows until anything passes the gate."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.fusion import Fusion, FusionConfig
from estimator.sources.beacon import BeaconConfig
from estimator.sources.rest import RestConfig
from models import so3
from models.messages import Array, AttitudePrior, GnssFix, ImuSample, Input, Reading, Reason, vec3
from models.sim.beacons import Beacons, measure_ranges
from models.sim.scenario import EPOCH_NS, Simulation
from models.sim.sensors import GRADES, Imu
from models.state import E
from tests import long
from tests.estimator.filter.relative.odometers import poses
from tests.estimator.scenes import Run, by_arrival, error, fly, position_errors, radii, simulated, within
from tests.scenarios.senses import HOME, Ride, barometer, loops, ride, velocity_body

CONFIG = FusionConfig(imu=GRADES["hobby"].noise, origin=HOME.lla)
BEACONS = Beacons()
FAULT_S, DARK_S, END_S = 22.0, 40.0, 65.0


def _seconds(t_ns: int) -> float:
    return (t_ns - EPOCH_NS) * 1e-9


def _dark(messages: list[Input], dark_s: float = DARK_S) -> list[Input]:
    return [m for m in messages if isinstance(m, ImuSample) or _seconds(m.t_ns) < dark_s]


def _overconfident(run: Run, journey: Ride, begin_s: float) -> float:
    """Share of the time that the position is beyond three times its 95 % radius."""
    beyond = []
    for e in within(run.aligned, begin_s, END_S, every=10):
        radius = math.sqrt(7.815 * float(np.linalg.eigvalsh(e.covariance[E.P, E.P])[-1]))
        beyond.append(np.linalg.norm(error(e, journey.truth)[E.P]) > 3.0 * radius)
    return float(np.mean(beyond))


@pytest.fixture(scope="module")
def journey() -> Ride:
    return ride(5.0, END_S - 5.0, seed=1, imu=Imu(grade="hobby", rate_hz=50.0))


def test_given_beacons_that_go_wrong_together_then_the_dark_is_bridged_by_the_imu(journey: Ride) -> None:
    """Followed, they lead it 13 m off, with overconfidence for a fifth of the time."""
    t = journey.truth
    ranges = measure_ranges(BEACONS, t.t_ns, EPOCH_NS, t.p_n, t.R_nb, np.random.default_rng(51))
    wrong: list[Input] = [replace(r, values=(r.values[0] + 5.0 * (_seconds(r.t_ns) > FAULT_S),)) for r in ranges]
    config = replace(CONFIG, beacon=BeaconConfig(at_n_m=BEACONS.at_n_m))
    run = Run(Fusion(config)).feed(by_arrival([*_dark(journey.messages), *wrong]))
    assert run.internal_errors() == []
    assert _overconfident(run, journey, FAULT_S) == 0.0
    dark = [s for s in run.last_words("/beacon/1").values() if _seconds(s.t_ns) > DARK_S + 6.0]
    assert {s.reason for s in dark} <= {Reason.STOPPED, Reason.GATED, Reason.THINNED}


@pytest.mark.long
def test_given_beacons_that_were_wrong_for_a_moment_then_they_are_used_in_the_dark(journey: Ride) -> None:
    t = journey.truth
    ranges = measure_ranges(BEACONS, t.t_ns, EPOCH_NS, t.p_n, t.R_nb, np.random.default_rng(51))
    wrong: list[Input] = [replace(r, values=(r.values[0] + 5.0 * (FAULT_S < _seconds(r.t_ns) < FAULT_S + 2.0),)) for r in ranges]
    config = replace(CONFIG, beacon=BeaconConfig(at_n_m=BEACONS.at_n_m))
    run = Run(Fusion(config)).feed(by_arrival([*_dark(journey.messages), *wrong]))
    assert np.linalg.norm(error(within(run.aligned, END_S - 1.0, END_S)[-1], t)[E.P]) < 2.0


@pytest.mark.long
def test_given_a_raft_that_drifts_then_it_is_not_taken_for_resting_with_gnss_or_later_without() -> None:
    def path(t: Array) -> Array:
        drift = np.column_stack([0.3 * np.maximum(t - 25.0, 0.0), np.zeros((len(t), 3))])
        return loops(np.minimum(t, 25.0)) + drift

    adrift = ride(2.0, 88.0, seed=1, path=path, imu=Imu(grade="hobby", rate_hz=50.0))
    run = Run(Fusion(replace(CONFIG, rest=RestConfig(enabled=True)))).feed(_dark(adrift.messages, 42.0))
    words = [s for s in run.last_words("rest").values() if _seconds(s.t_ns) > 29.0]
    assert Reason.FUSED not in {s.reason for s in words}
    assert any("but moves at 0." in s.detail for s in words)
    assert _overconfident(run, adrift, 29.0) == 0.0  # up to 65 s; taken for resting in the dark: 76 % of the time


def test_given_an_attitude_of_the_autopilot_a_quarter_turn_off_then_motion_refutes_it(journey: Ride) -> None:
    """Believed, it leads the estimate 88 m off in the dark."""
    sigma = np.radians([2.0, 2.0, 4.0])
    turn = so3.from_euler(0.0, 0.0, 0.5 * math.pi)
    priors: list[Input] = []
    for k in range(25, len(journey.truth.t_ns), 25):
        w, x, y, z = so3.multiply(turn, journey.truth.q_nb_wxyz[k]).tolist()
        t = int(journey.truth.t_ns[k])
        priors.append(AttitudePrior(t, t, (w, x, y, z), np.diag(sigma**2)))
    run = Run(Fusion(CONFIG)).feed(by_arrival([*_dark(journey.messages), *priors]))
    assert Reason.STOPPED in run.reasons("/attitude")
    moving = within(run.aligned, 15.0, DARK_S)
    assert np.degrees(max(np.linalg.norm(error(e, journey.truth)[E.THETA]) for e in moving)) < 3.0
    assert np.linalg.norm(error(within(run.aligned, END_S - 1.0, END_S)[-1], journey.truth)[E.P]) < 20.0


FIXES = """
duration_s = 60.0
geographic = false
[vehicle]
kind = "multirotor"
seed = 0
[imu]
rate_hz = 50.0
[pose_fix]
outages_s = [[40.0, 50.0]]
"""
RECEIVER = FIXES.replace("geographic = false", "").replace("[[40.0, 50.0]]", "[[10.0, 60.0]]") + "[gnss]\n"
FALSE_VELOCITIES: dict[str, Callable[[Array, float], Array]] = {
    "half of it": lambda v, _: 0.5 * v,
    "biased": lambda v, _: v + np.array([0.5, 0.3, 0.0]),
    "drifts": lambda v, t_s: v + np.array([0.05 * t_s, 0.0, 0.0]),
    "drifts since 25 s": lambda v, t_s: v + np.array([0.05 * max(t_s - 25.0, 0.0), 0.0, 0.0]),
    "swings": lambda v, t_s: v + np.array([0.5 * math.sin(t_s), 0.5 * math.cos(t_s), 0.0]),
    "turned": lambda v, _: np.array([v[1], -v[0], v[2]]),
}


@pytest.fixture(scope="module")
def lit() -> Simulation:
    return simulated(FIXES)


def _velocities(flight: Simulation, false: Callable[[Array, float], Array], late_s: float = 0.0) -> list[Input]:
    readings: list[Input] = []
    for r in velocity_body(flight.truth):
        assert isinstance(r, Reading)
        x, y, z = false(np.array(r.values), _seconds(r.t_ns)).tolist()
        t_ns = r.t_ns + round(late_s * 1e9)
        readings.append(replace(r, t_ns=t_ns, arrived_ns=t_ns, values=(x, y, z)))
    return readings


def _flown(flight: Simulation, readings: list[Input]) -> tuple[float, float, float]:
    """RMS error beside fixes, largest error in the dark [m], share of the time inside the 95 % radius."""
    run = fly(flight, messages=by_arrival([*flight.messages, *readings]))
    assert run.internal_errors() == []
    beside = [*within(run.aligned, 10.0, 40.0, every=5), *within(run.aligned, 52.0, 60.0, every=5)]
    dark = within(run.aligned, 40.0, 50.0, every=5)
    off = position_errors([*beside, *dark], flight.truth)
    inside = float(np.mean(off < radii([*beside, *dark])))
    return float(np.sqrt(np.mean(off[: len(beside)] ** 2))), float(off[len(beside) :].max()), inside


@long.parametrize("kind", FALSE_VELOCITIES, one_in=3)
def test_given_a_velocity_that_is_wrong_then_fixes_refute_it(lit: Simulation, kind: str) -> None:
    """Half of it was followed in the dark: 31 m off at a radius of 10 m."""
    without_m, dark_m, _ = _flown(lit, [])
    rms_m, wrong_m, inside = _flown(lit, _velocities(lit, FALSE_VELOCITIES[kind]))
    assert rms_m < 2.0 * without_m
    assert wrong_m < dark_m + 5.0
    assert inside > 0.9


def test_given_a_velocity_that_is_late_then_fixes_are_not_locked_out(lit: Simulation) -> None:
    """Half a second: true fixes were refused, 4 m off."""
    without_m, _, _ = _flown(lit, [])
    rms_m, _, inside = _flown(lit, _velocities(lit, lambda v, _: v, late_s=0.5))
    assert rms_m < 2.0 * without_m
    assert inside > 0.9


def test_given_a_right_velocity_then_it_bridges_the_dark(lit: Simulation) -> None:
    without_m, dark_m, _ = _flown(lit, [])
    rms_m, with_m, inside = _flown(lit, _velocities(lit, lambda v, _: v))
    assert (rms_m, with_m) < (without_m, dark_m)
    assert inside > 0.9


def _drifting(flight: Simulation) -> list[Input]:
    """An odometry that drifts by 0.2 m/s since 25 s."""
    found: list[Input] = []
    for o in poses(flight, 5.0, 59.9):
        x, y, z = o.p_o
        found.append(replace(o, p_o=(x + 0.2 * max(_seconds(o.t_ns) - 25.0, 0.0), y, z)))
    return found


def test_given_an_odometry_that_drifts_then_fixes_refute_it(lit: Simulation) -> None:
    """Followed, it moves the estimate between fixes by twice their error, and by 1.4 m in the dark."""
    without_m, dark_m, _ = _flown(lit, [])
    rms_m, wrong_m, inside = _flown(lit, _drifting(lit))
    assert rms_m < 1.5 * without_m
    assert wrong_m < dark_m + 1.0
    assert inside > 0.9


@pytest.mark.parametrize("scale", [0.5, 0.7, 1.5])
def test_given_an_odometry_whose_scale_is_wrong_then_fixes_teach_it(scale: float) -> None:
    """Left out, it gave the IMU's errors with hobby sensors."""
    flight = simulated(FIXES.replace("rate_hz = 50.0", 'grade = "hobby"\nrate_hz = 50.0'))
    scaled = [replace(o, p_o=vec3(scale * np.array(o.p_o))) for o in poses(flight, 5.0, 59.9)]
    without_m, dark_m, _ = _flown(flight, [])
    rms_m, with_m, inside = _flown(flight, [*scaled])
    assert (rms_m, with_m) < (0.8 * without_m, dark_m)
    assert inside > 0.9


@pytest.mark.parametrize("sensor", ["baro", "velocity_body", "odometry"])
def test_given_a_sensor_that_contradicts_the_receiver_alone_then_the_covariance_covers_both(sensor: str) -> None:
    """Either may be wrong. Followed, the barometer led 12 m off, outside a quarter of the time; odometry 4 m, three quarters."""
    flight = simulated(RECEIVER)
    if sensor == "odometry":
        readings = _drifting(flight)
    elif sensor == "velocity_body":
        readings = _velocities(flight, FALSE_VELOCITIES["drifts since 25 s"])
    else:
        readings = [
            replace(r, values=(r.values[0] - 12.0 * max(_seconds(r.t_ns) - 25.0, 0.0),))  # 1 m/s up
            for r in barometer(flight.truth)
            if isinstance(r, Reading)
        ]
    run = fly(flight, messages=by_arrival([*flight.messages, *readings]))
    assert run.internal_errors() == []
    late = within(run.aligned, 25.0, 59.9, every=5)
    assert np.mean(position_errors(late, flight.truth) < radii(late)) > 0.9


def test_given_a_right_velocity_beside_the_receiver_alone_then_the_covariance_is_as_small_as_the_sensor_makes_it() -> None:
    """The hypothesis without it fits the receiver's lasting error better: counted as evidence, that made the radius as large."""
    flight = simulated(RECEIVER)
    readings = _velocities(flight, lambda v, _: v)
    runs = [fly(flight, messages=by_arrival([*flight.messages, *some])) for some in ([], readings)]
    without, late = (within(run.aligned, 30.0, 59.9, every=5) for run in runs)
    assert np.mean(radii(late)) < 0.5 * np.mean(radii(without))
    assert (position_errors(late, flight.truth) < 2.0 * radii(late)).all()


def test_given_a_receiver_that_is_off_for_a_while_then_a_right_velocity_is_not_refuted() -> None:
    flight = simulated(RECEIVER)
    off: list[Input] = [
        replace(m, lat_deg=m.lat_deg + 1e-4) if isinstance(m, GnssFix) and 30.0 < _seconds(m.t_ns) < 45.0 else m  # 11 m
        for m in flight.messages
    ]
    run = fly(flight, messages=by_arrival([*off, *_velocities(flight, lambda v, _: v)]))
    late = position_errors(within(run.aligned, 25.0, 59.9, every=5), flight.truth)
    assert np.sqrt(np.mean(late**2)) < 1.0
    assert Reason.PROBATION not in {s.reason for s in run.last_words("/velocity_body").values()}


def test_given_a_barometer_that_climbs_then_it_does_not_outweigh_the_receiver_of_a_wing() -> None:
    """Otherwise it is 11 m off."""
    flight = simulated(RECEIVER.replace("multirotor", "fixed_wing"), seed=2)
    readings: list[Input] = [
        replace(r, values=(r.values[0] - 12.0 * max(_seconds(r.t_ns) - 25.0, 0.0),))
        for r in barometer(flight.truth)
        if isinstance(r, Reading)
    ]
    run = fly(flight, messages=by_arrival([*flight.messages, *readings]))
    late = position_errors(within(run.aligned, 25.0, 59.9, every=5), flight.truth)
    assert np.sqrt(np.mean(late**2)) < 3.0
