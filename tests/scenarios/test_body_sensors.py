"""Velocity in the body and range to the ground: what they are worth without GNSS. Their faults: test_sensor_faults.py."""

import numpy as np
import pytest

from estimator.fusion import Fusion, FusionConfig
from estimator.sources.velocity_body import VelocityBodyConfig
from models.messages import AidStatus, Array, ImuSample, Input, Reason
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import GRADES, Imu
from models.state import E
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, range_down, ride, velocity_body

DARK_S, END_S = 35.0, 65.0
CONFIG = FusionConfig(imu=GRADES["hobby"].noise, origin=HOME.lla)


@pytest.fixture(scope="module")
def journey() -> Ride:
    return ride(5.0, END_S - 5.0, seed=2, imu=Imu(grade="hobby", rate_hz=50.0))


def _run(journey: Ride, readings: list[Input], config: FusionConfig = CONFIG) -> Run:
    lit = [m for m in journey.messages if isinstance(m, ImuSample) or (m.t_ns - EPOCH_NS) * 1e-9 < DARK_S]
    run = Run(Fusion(config)).feed(by_arrival([*lit, *readings]))
    assert run.internal_errors() == []
    return run


def _errors(run: Run, journey: Ride) -> Array:
    return np.array([error(e, journey.truth) for e in within(run.aligned, END_S - 10.0, END_S)])


def _nees(run: Run, journey: Ride, begin_s: float = 20.0) -> float:
    each = []
    for e in within(run.estimates, begin_s, END_S):
        off = error(e, journey.truth)
        each += [off[k] @ np.linalg.solve(e.covariance[k, k], off[k]) / 3.0 for k in (E.P, E.THETA)]
    return float(np.mean(each))


def _refused(run: Run) -> list[AidStatus]:
    return [s for s in run.last_words("/velocity_body").values() if s.reason in {Reason.GATED, Reason.STOPPED}]


def test_given_a_velocity_in_the_body_then_a_dark_stretch_costs_less(journey: Ride) -> None:
    without, run = _run(journey, []), _run(journey, velocity_body(journey.truth))
    lost, kept = (np.linalg.norm(_errors(r, journey)[:, E.P], axis=1).max() for r in (without, run))
    assert kept < min(0.7 * lost, 4.0)
    assert _nees(run, journey) < 2.0


@pytest.mark.long
def test_given_wheels_then_what_they_do_not_measure_is_zero_only_where_the_configuration_reports_it(journey: Ride) -> None:
    forward = velocity_body(journey.truth, wheels=True)
    run = _run(journey, forward[:100])
    assert {len(s.innovation) for s in run.last_words("/velocity_body").values()} <= {0, 1}
    constrained = FusionConfig(imu=CONFIG.imu, origin=CONFIG.origin, velocity_body=VelocityBodyConfig(across_sigma_m_s=0.1))
    run = _run(journey, forward, constrained)  # a copter that flies sideways: the constraint is false, and seen to be
    assert len(_refused(run)) > 100
    assert _nees(run, journey) < 3.0


def test_given_a_range_to_the_ground_then_the_height_is_kept(journey: Ride) -> None:
    run = _run(journey, range_down(journey.truth))
    assert np.abs(_errors(run, journey)[:, E.P.stop - 1]).max() < 1.5
    assert _nees(run, journey) < 2.0
