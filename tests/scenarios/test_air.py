"""Airspeed and drag: what they are worth without GNSS, what their faults cost, and that lateness costs nothing."""

from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.config import parse
from estimator.fusion import Fusion, FusionConfig
from models.imu import ImuNoise
from models.messages import AidStatus, GnssFix, GnssVelocity, Health, Input, Reading, Reason
from models.sim.aids import Gnss
from models.sim.air import Airspeed, Wind, blow
from models.sim.scenario import EPOCH_NS, Scenario, Simulation, simulate
from models.sim.sensors import Imu
from models.sim.trajectory import FixedWing, Multirotor
from models.state import E
from tests import long
from tests.estimator.scenes import Run, error, same, within

DARK_S, END_S = 80.0, 130.0
WIND = Wind(speed_m_s=6.0, gust_m_s=0.8)
Fault = Callable[[Reading, float, int], Reading]


def _flown(vehicle: Multirotor | FixedWing, airspeed: Airspeed | None) -> Simulation:
    scenario = Scenario(
        duration_s=END_S,
        vehicle=vehicle,
        imu=Imu(grade="hobby", rate_hz=50.0, noise_multiplier=20.0),  # it vibrates, as [imu] says by default
        gnss=Gnss(rate_hz=2.0, outages_s=((DARK_S, END_S),)),
        wind=WIND,
        airspeed=airspeed,
    )
    return simulate(scenario, 4)


@pytest.fixture(scope="module")
def plane() -> Simulation:
    return _flown(FixedWing(), Airspeed())


@pytest.fixture(scope="module")
def copter() -> Simulation:
    return _flown(Multirotor(drag_1_s=0.15, hover_share=0.0), None)


def _config(simulation: Simulation) -> FusionConfig:
    return replace(parse(simulation.config_toml).fusion(), imu=ImuNoise())


def _run(messages: list[Input], config: FusionConfig) -> Run:
    run = Run(Fusion(config)).feed(messages)
    assert run.internal_errors() == []
    return run


def _level(run: Run, simulation: Simulation, begin_s: float) -> tuple[float, float]:
    """Horizontal: largest error of position [m], and mean NEES by component, in the dark."""
    worst, nees = 0.0, []
    for e in within(run.aligned, begin_s, END_S):
        off, cov = error(e, simulation.truth)[E.P][:2], e.covariance[E.P, E.P][:2, :2]
        worst = max(worst, float(np.linalg.norm(off)))
        nees.append(off @ np.linalg.solve(cov, off) / 2.0)
    return worst, float(np.mean(nees))


def _without_airspeed(simulation: Simulation) -> list[Input]:
    return [m for m in simulation.messages if not isinstance(m, Reading)]


def _wind(health: Health) -> tuple[float, float]:
    return health.biases["wind_north"], health.biases["wind_east"]


def _blows(seed: int) -> tuple[float, float]:
    """The mean wind of a simulated flight."""
    north, east = blow(WIND, np.random.default_rng(seed).spawn(5)[4]).mean_n.tolist()
    return north, east


def _true_wind(simulation: Simulation, config: FusionConfig) -> None:
    """Of the copter's own drag: f = -k R^T (v - w), the mean over the flight."""
    t = simulation.truth
    lit = (t.t_ns - EPOCH_NS) * 1e-9 < DARK_S
    assert config.drag.enabled
    drag_n = np.einsum("kij,kj->ki", t.R_nb[lit][:, :, :2], t.accel_b[lit, :2])
    assert np.linalg.norm(drag_n.mean(axis=0)) > 0.3


@pytest.mark.long
def test_given_drag_then_a_dark_stretch_costs_less_and_the_wind_is_known(copter: Simulation) -> None:
    config = _config(copter)
    _true_wind(copter, config)
    alone = _run(copter.messages, replace(config, drag=replace(config.drag, enabled=False)))
    run = _run(copter.messages, config)
    lost, kept = (_level(r, copter, DARK_S + 5.0) for r in (alone, run))
    assert kept[0] < 0.8 * lost[0]
    assert kept[1] < 2.0
    lit = [h for h in run.health if (h.t_ns - EPOCH_NS) * 1e-9 < DARK_S]
    assert _wind(lit[-1]) == pytest.approx(_blows(4), abs=1.5)  # 4 m/s off where the scale of the drag follows the noise
    assert not any("wind_north" in h.biases for h in alone.health)


def test_given_airspeed_and_that_a_plane_hardly_slips_then_a_dark_stretch_costs_less(plane: Simulation) -> None:
    config = _config(plane)
    alone, run = _run(_without_airspeed(plane), config), _run(plane.messages, config)
    assert _level(run, plane, DARK_S + 5.0)[1] < 2.0  # along the nose alone; across it nothing is known
    slips = _run(plane.messages, replace(config, airspeed=replace(config.airspeed, sideslip_deg=3.0)))
    lost, kept = (_level(r, plane, DARK_S + 5.0) for r in (alone, slips))
    assert kept[0] < 0.7 * lost[0]
    assert kept[1] < 2.0


def _stuck(r: Reading, first: float, _: int) -> Reading:
    return replace(r, values=(first,))


def _biased(r: Reading, _: float, __: int) -> Reading:
    return replace(r, values=(r.values[0] + 8.0,))


def _negative(r: Reading, _: float, __: int) -> Reading:
    return replace(r, values=(-r.values[0],))


def _knots(r: Reading, _: float, __: int) -> Reading:
    return replace(r, values=(1.944 * r.values[0],))


def _late(r: Reading, _: float, late_ns: int) -> Reading:
    return replace(r, t_ns=r.t_ns + late_ns, arrived_ns=r.arrived_ns + late_ns)


@long.parametrize("fault", [_stuck, _biased, _negative, _knots, _late])
def test_given_an_airspeed_that_goes_wrong_in_flight_then_it_is_not_overconfident_and_wrong(
    plane: Simulation, fault: Fault
) -> None:
    begin_ns = EPOCH_NS + round(0.5 * DARK_S * 1e9)
    before = [m.values[0] for m in plane.messages if isinstance(m, Reading) and m.t_ns < begin_ns]
    messages = [
        fault(m, before[-1], 2_000_000_000) if isinstance(m, Reading) and m.t_ns >= begin_ns else m for m in plane.messages
    ]
    run = _run(sorted(messages, key=lambda m: m.arrived_ns), _config(plane))
    assert _level(run, plane, 20.0)[1] < 3.0
    assert len(_refused(run)) > 20 or fault is _late  # that is said; the speed of a plane hardly changes in 2 s


def _refused(run: Run) -> list[AidStatus]:
    wrong = {Reason.GATED, Reason.STOPPED, Reason.HELD, Reason.IMPLAUSIBLE}
    return [s for s in run.statuses if s.topic == "/airspeed" and s.reason in wrong]


@pytest.mark.long
def test_late_airspeed_and_late_gnss_make_the_same_estimate_as_punctual_ones(plane: Simulation) -> None:
    until_ns = EPOCH_NS + 45_000_000_000
    messages = [m for m in plane.messages if m.t_ns < until_ns]
    late = [
        replace(m, arrived_ns=m.arrived_ns + late_ns)
        if isinstance(m, GnssFix | GnssVelocity | Reading) and m.t_ns < until_ns - 5_000_000_000 and m.t_ns % 5 < 2
        else m
        for m, late_ns in zip(messages, np.random.default_rng(0).integers(0, 2 * 10**9, len(messages)).tolist(), strict=True)
    ]
    config = _config(plane)
    punctual, delayed = (_run(sorted(some, key=lambda m: m.arrived_ns), config) for some in (messages, late))
    assert same(punctual.estimates[-1], delayed.estimates[-1])
    assert punctual.health[-1].biases == delayed.health[-1].biases


@pytest.mark.long
def test_drag_too_is_the_same_when_gnss_comes_late(copter: Simulation) -> None:
    until_ns = EPOCH_NS + 45_000_000_000
    messages = [m for m in copter.messages if m.t_ns < until_ns]
    late = [
        replace(m, arrived_ns=m.arrived_ns + 1_500_000_000)
        if isinstance(m, GnssFix | GnssVelocity) and m.t_ns < until_ns - 5_000_000_000
        else m
        for m in messages
    ]
    config = _config(copter)
    punctual, delayed = (_run(sorted(some, key=lambda m: m.arrived_ns), config) for some in (messages, late))
    assert same(punctual.estimates[-1], delayed.estimates[-1])
