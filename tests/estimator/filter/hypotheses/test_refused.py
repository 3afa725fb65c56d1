"""A measurement that is refused moves no published estimate; covariances may grow by what the hypotheses add."""

from functools import cache

import numpy as np
import pytest

from models.messages import Estimate, GnssFix, Input, PoseFix, Reason
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, local
from tests import long
from tests.estimator.scenes import Run, by_arrival, displaced, fly, simulated

FLIGHT = """
duration_s = 12.0
[vehicle]
kind = "multirotor"
seed = 3
[imu]
rate_hz = 50.0
[gnss]
rate_hz = 2.0
[pose_fix]
rate_hz = 2.0
"""
_POSE = np.r_[E.P, E.V, E.THETA]
REFUSALS = {Reason.GATED, Reason.PROBATION, Reason.STOPPED}


@cache
def _flight() -> tuple[Simulation, Run]:
    simulation = simulated(FLIGHT)
    return simulation, fly(simulation)


def _hostile(like: GnssFix | PoseFix, rng: np.random.Generator) -> Input:
    """It says 50 m to 10 km elsewhere, and arrives up to a second late."""
    away = rng.normal(size=3)
    away *= 10.0 ** rng.uniform(1.7, 4.0) / np.linalg.norm(away)
    t_ns = like.t_ns + int(rng.integers(1, 400_000_000))
    late_ns = t_ns + int(rng.choice([0, 100_000_000, 1_000_000_000]))
    if isinstance(like, PoseFix):
        x, y, z = away.tolist()
        moved = displaced(like, (x, y, z))
        return PoseFix(t_ns, late_ns, moved.p_n, moved.q_nb_wxyz, moved.covariance, topic=like.topic)
    north, east, down = (away / (111_000.0, 75_000.0, 1.0)).tolist()
    return GnssFix(t_ns, late_ns, like.lat_deg + north, like.lon_deg + east, like.alt_m - down, like.covariance_n)


@long.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [GnssFix, PoseFix])
def test_it_moves_nothing(kind: type[GnssFix | PoseFix], seed: int) -> None:
    simulation, without = _flight()
    rng = np.random.default_rng(seed)
    known = [m for m in simulation.messages if isinstance(m, kind) and m.t_ns > EPOCH_NS + 5_000_000_000]
    hostile = _hostile(known[int(rng.integers(0, len(known)))], rng)
    run = fly(simulation, messages=by_arrival([*simulation.messages, hostile]))
    said = [s for s in run.statuses if s.t_ns == hostile.t_ns]
    assert said
    assert {s.reason for s in said} <= REFUSALS, said
    assert len(run.estimates) == len(without.estimates)
    for a, b in zip(run.estimates, without.estimates, strict=True):
        _same(a, b)


def _same(a: Estimate, b: Estimate) -> None:
    """a is b, but for an IMU interval that the measurement splits; it may be less certain of the pose."""
    sigma = np.sqrt(np.diagonal(b.covariance))
    assert (np.abs(local(a.nav, b.nav)) < 1e-3 * sigma).all(), (a.t_ns - EPOCH_NS) * 1e-9
    assert (np.sqrt(np.diagonal(a.covariance)) > 0.999 * sigma)[_POSE].all(), (a.t_ns - EPOCH_NS) * 1e-9
