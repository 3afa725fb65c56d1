"""A barometer with GNSS: it keeps the height through an outage, and its unknown zero harms nothing."""

import numpy as np
import pytest

from estimator.fusion import Fusion, FusionConfig
from models.messages import Estimate, Input, Reading, Reason
from models.sim.aids import Gnss
from models.sim.scenario import EPOCH_NS, Simulation
from models.sim.sensors import GRADES, Imu
from models.state import E
from tests.estimator.scenes import Run, by_arrival, config_of, error, fly, simulated, within
from tests.scenarios.senses import HOME, ride

FLIGHT = """
duration_s = 150.0
[vehicle]
kind = "multirotor"
[imu]
grade = "hobby"
rate_hz = 100.0
[gnss]
sigma_m = [2.0, 2.0, 4.0]
velocity_sigma_m_s = [0.5, 0.5, 0.5]
[pose_fix]
rate_hz = 1.0
outages_s = [[10.0, 150.0]]
"""
OUTAGE_S = (60.0, 120.0)
RATE_HZ, SIGMA_M, ZERO_M, WARM = 10.0, 1.0, 263.0, 1.03  # the air is 9 K warmer than the standard atmosphere


def _pressure_pa(height_m: float) -> float:
    return float(101325.0 * (1.0 - height_m / 44330.8) ** (1.0 / 0.190263))


def _barometer(simulation: Simulation) -> list[Input]:
    """Readings of the true height: ten a second whose error stays for a second, an unknown zero, air that is too warm."""
    rng, truth = np.random.default_rng(5), simulation.truth
    gust = SIGMA_M * rng.standard_normal(200)
    readings: list[Input] = []
    for k in range(0, len(truth.t_ns), 10):
        t_ns = int(truth.t_ns[k])
        height = -truth.p_n[k, 2] / WARM + gust[(t_ns - EPOCH_NS) // 10**9] + ZERO_M
        readings.append(Reading(t_ns, t_ns, "/baro", "baro", (_pressure_pa(height),)))
    return readings


def _unaided(simulation: Simulation) -> list[Input]:
    """The messages of the flight without what would have fixed the position during the outage."""
    begin, end = (EPOCH_NS + round(s * 1e9) for s in OUTAGE_S)
    return [m for m in simulation.messages if not (_is_aid(m) and begin <= m.t_ns < end)]


def _is_aid(message: Input) -> bool:
    return not type(message).__name__.startswith("Imu")


def _heights(run: Run, simulation: Simulation) -> tuple[float, float]:
    """Largest error of height in the outage, m, and largest in sigma."""
    inside: list[Estimate] = within(run.estimates, *OUTAGE_S)
    down = E.P.stop - 1
    errors = np.array([error(e, simulation.truth)[down] for e in inside])
    sigma = np.sqrt([e.covariance[down, down] for e in inside])
    return float(np.abs(errors).max()), float(np.abs(errors / sigma).max())


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulated(FLIGHT)


def test_given_an_outage_of_a_minute_then_the_height_is_kept(flight: Simulation) -> None:
    config = config_of(flight)
    without = fly(flight, config, _unaided(flight))
    beside = fly(flight, config, by_arrival([*_unaided(flight), *_barometer(flight)]))
    lost_m, _ = _heights(without, flight)
    kept_m, sigmas = _heights(beside, flight)
    assert beside.internal_errors() == []
    assert kept_m < min(5.0, 0.5 * lost_m)
    assert sigmas < 4.0


@pytest.mark.long
def test_given_readings_ten_times_a_second_then_one_of_them_is_news(flight: Simulation) -> None:
    run = fly(flight, config_of(flight), by_arrival([*flight.messages, *_barometer(flight)]))
    reasons = run.reasons("/baro")
    assert 100 <= reasons[Reason.FUSED] <= 150
    assert reasons[Reason.THINNED] == pytest.approx(9 * reasons[Reason.FUSED], rel=0.1)


def test_given_a_barometer_whose_pressure_jumps_then_it_is_refused_and_the_height_stays(flight: Simulation) -> None:
    jump_ns = EPOCH_NS + 80 * 10**9
    readings = [
        Reading(m.t_ns, m.t_ns, "/baro", "baro", (m.values[0] - 3000.0 * (m.t_ns > jump_ns),))
        for m in _barometer(flight)
        if isinstance(m, Reading) and m.kind == "baro"
    ]
    run = fly(flight, config_of(flight), by_arrival([*flight.messages, *readings]))
    late = within(run.estimates, 85.0, 150.0)
    assert max(abs(error(e, flight.truth)[E.P.stop - 1]) for e in late) < 3.0
    assert run.reasons("/baro")[Reason.GATED] >= 50


def test_a_filter_that_is_run_again_stands_at_the_time_of_the_tracker() -> None:
    """A run leaves the barometer out: one that ended at the measurement before it would go on with a gap in the rotation."""
    flight = ride(3.0, 22.0, seed=3, imu=Imu(grade="hobby", rate_hz=50.0), gnss=Gnss(rate_hz=1.0))
    readings = [Reading(int(t), int(t), "/baro", "baro", (95_000.0 + k % 7,)) for k, t in enumerate(flight.truth.t_ns[::10])]
    fusion = Fusion(FusionConfig(imu=GRADES["hobby"].noise, origin=HOME.lla))
    for message in by_arrival([*flight.messages, *readings]):
        fusion.handle(message)
        tracker = fusion._history.tracker
        if tracker.core.hypotheses is not None:
            assert tracker.core.hypotheses.lead.t_ns == tracker.core.t_ns
