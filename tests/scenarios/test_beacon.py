"""Ranges to beacons while there is no GNSS: what one and three are worth, and that the estimate stays consistent."""

from functools import cache

import numpy as np

from models.messages import Reason
from models.sim.aids import Gnss
from models.sim.beacons import Beacons
from models.sim.scenario import Scenario, Simulation, simulate
from models.sim.sensors import Imu
from models.sim.trajectory import Multirotor
from models.state import E
from tests import long
from tests.estimator.scenes import Run, error, fly, within

DARK_S, END_S = 45.0, 95.0
ALL = Beacons().at_n_m


@cache
def _flight(count: int) -> Simulation:
    scenario = Scenario(
        duration_s=END_S,
        vehicle=Multirotor(hover_share=0.0),
        imu=Imu(grade="hobby", rate_hz=50.0),
        gnss=Gnss(rate_hz=5.0, outages_s=((DARK_S, END_S),)),
        beacons=Beacons(at_n_m=ALL[:count]) if count else None,
    )
    return simulate(scenario, 2)


def _level(run: Run, simulation: Simulation) -> tuple[float, float]:
    """Largest error of position in the dark [m], mean NEES/3 of position and attitude."""
    worst, nees = 0.0, []
    for e in within(run.aligned, DARK_S + 5.0, END_S):
        off = error(e, simulation.truth)
        worst = max(worst, float(np.linalg.norm(off[E.P])))
        nees += [off[k] @ np.linalg.solve(e.covariance[k, k], off[k]) / 3.0 for k in (E.P, E.THETA)]
    return worst, float(np.mean(nees))


@long.parametrize(("count", "most_m"), [(1, 9.5), (3, 1.5)])
def test_given_ranges_to_beacons_then_a_dark_stretch_costs_little(count: int, most_m: float) -> None:
    simulation = _flight(count)
    run = fly(simulation)
    assert run.internal_errors() == []
    worst, nees = _level(run, simulation)
    assert worst < most_m < 0.7 * _level(fly(_flight(0)), _flight(0))[0]
    assert nees < 2.0
    reasons = run.reasons("/beacon/1")
    assert reasons[Reason.FUSED] > 0.9 * (sum(reasons.values()) - reasons[Reason.ALIGNING])
