"""While the heading is unknown an estimate reports it, consistently; where the nose shows the course, it begins with that."""

import math
from functools import cache

import numpy as np
import pytest

from estimator.filter.alignment.heading import from_course
from estimator.filter.alignment.initialise import InitialiseConfig, level
from estimator.frontend.requests import Track
from estimator.fusion import Fusion, FusionConfig
from estimator.service.autopilot.output_policy import newest
from logs.wire.encoding import encode_slow
from models import so3
from models.frames import GRAVITY, Origin
from models.measurements import Velocity
from models.messages import Array, Estimate, GnssFix, ImuSample, Input, Mode, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X
from tests.estimator.scenes import SECOND, Run, config_of, error, fly, simulated

HOVER = 'duration_s = 25.0\n[vehicle]\nkind = "multirotor"\nhover_share = 1.0\nspeed_m_s = 0.5\nclimb_m_s = 0.5\n'
WING = 'duration_s = 12.0\n[vehicle]\nkind = "fixed_wing"\nbank_deg = 5.0\narea_m = 5000.0\n'
SENSORS = "[imu]\nrate_hz = 50.0\n[gnss]\nrate_hz = 5.0\n"
HOME = Origin(46.0, 7.0, 500.0)


@cache
def _hover(seed: int) -> tuple[Simulation, Run]:
    simulation = simulated(HOVER + SENSORS, seed)
    return simulation, fly(simulation)


def _heading_sigma(e: Estimate) -> float:
    down_b = so3.matrix(e.nav[X.Q])[2]
    return float(np.sqrt(down_b @ e.covariance[E.THETA, E.THETA] @ down_b))


def test_a_hover_is_published_without_its_heading_and_consistently() -> None:
    nees = []
    for seed in range(1, 5):
        simulation, run = _hover(seed)
        first_fix = next(m for m in simulation.messages if isinstance(m, GnssFix))
        assert run.estimates[0].t_ns - first_fix.t_ns < 5 * SECOND
        unknown = [e for e in run.estimates if e.mode is Mode.ALIGNING_HEADING]
        assert len(unknown) > 500
        assert _heading_sigma(unknown[0]) > math.radians(20.0)
        for e in unknown[::25]:
            off = error(e, simulation.truth)
            nees.append([off[s] @ np.linalg.solve(e.covariance[s, s], off[s]) / 3 for s in (E.P, E.V, E.THETA, E.BG, E.BA)])
    assert (np.mean(nees, axis=0) < 2.0).all()


def test_a_heading_that_is_unknown_is_no_reset_and_health_reports_it() -> None:
    _, run = _hover(1)
    unknown = [h for h in run.health if h.mode is Mode.ALIGNING_HEADING]
    assert unknown
    assert all(math.isfinite(h.radius95_m) and h.attitude_sigma_deg > 5.0 and h.detail for h in unknown)
    assert not [r for r in run.resets if r.t_ns < (run.aligned[0].t_ns if run.aligned else 2**62)]


def test_nobody_takes_it_for_one_with_a_heading() -> None:
    _, run = _hover(1)
    e = run.estimates[0]
    assert e.mode is Mode.ALIGNING_HEADING
    assert newest([e]) is None  # what the flight stack is sent
    track = Track()
    track.note([e])
    assert not track.mode
    assert [m.topic for m in encode_slow(e)] == ["/landfix/global"]


def _at_rest(duration_s: float, jump_m: float = 0.0) -> list[Input]:
    """Level, facing north, GNSS alone at 5 Hz, which is `jump_m` further north in the second half."""
    rng = np.random.default_rng(0)
    messages = list[Input]()
    for k in range(round(duration_s * 50)):
        t = EPOCH_NS + k * SECOND // 50
        gyro, force = rng.normal(scale=2e-3, size=3), rng.normal(scale=0.02, size=3) - [0.0, 0.0, GRAVITY]
        messages.append(ImuSample(t, t, vec3(gyro), vec3(force)))
        if k % 10 == 5:
            north = jump_m if k > 25 * duration_s else 0.0
            place = HOME.to_geodetic(rng.normal(scale=0.5, size=3) + np.array([north, 0.0, 0.0]))
            messages.append(GnssFix(t + 1, t + 1, *place, np.eye(3) * 0.25))
    return messages


def test_at_rest_no_heading_is_ever_found() -> None:
    run = Run(Fusion(FusionConfig(origin=HOME.lla))).feed(_at_rest(60.0))
    assert run.estimates[0].t_ns < EPOCH_NS + 5 * SECOND
    assert {e.mode for e in run.estimates} == {Mode.ALIGNING_HEADING}
    last = run.estimates[-1]
    assert _heading_sigma(last) > math.radians(95.0)
    assert np.linalg.norm(last.nav[X.P]) < 1.0
    assert np.linalg.norm(last.nav[X.V]) < 0.2
    assert run.health[-1].absolute_age_s < 1.0
    assert "at rest" in run.health[-1].detail


def test_a_position_that_moves_for_good_is_followed_at_rest() -> None:
    run = Run(Fusion(FusionConfig(origin=HOME.lla))).feed(_at_rest(20.0, jump_m=3.5))
    assert abs(run.estimates[-1].nav[X.P][0] - 3.5) < 1.0


def _sample_level() -> Array:
    return np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY], (50, 1))


@pytest.mark.parametrize(
    ("v_n", "yaw"), [((0.0, 5.0, 0.0), 0.5 * math.pi), ((-3.0, 0.0, 1.0), math.pi), ((2.0, -2.0, 0.0), -0.25 * math.pi)]
)
def test_the_nose_points_along_the_course(v_n: tuple[float, float, float], yaw: float) -> None:
    config = InitialiseConfig(course_sigma_deg=6.0)
    velocity = Velocity(np.array(v_n), np.eye(3) * 0.04, np.zeros(3))
    pose = from_course(velocity, level(EPOCH_NS, _sample_level(), config, may_rest=False), config)
    assert pose is not None
    assert abs(math.remainder(so3.to_euler(pose.q_nb_wxyz)[2] - yaw, 2.0 * math.pi)) < 1e-9
    speed = math.hypot(*v_n[:2])
    assert math.sqrt(pose.noise[2, 2]) == pytest.approx(math.hypot(math.radians(6.0), 0.2 / speed))


@pytest.mark.parametrize(("speed", "sigma", "course_deg"), [(0.9, 0.1, 6.0), (2.0, 0.8, 6.0), (20.0, 0.1, 0.0)])
def test_a_slow_or_uncertain_course_is_none(speed: float, sigma: float, course_deg: float) -> None:
    config = InitialiseConfig(course_sigma_deg=course_deg)
    velocity = Velocity(np.array([speed, 0.0, 0.0]), np.eye(3) * sigma**2, np.zeros(3))
    assert from_course(velocity, level(EPOCH_NS, _sample_level(), config, may_rest=False), config) is None


def test_straight_flight_begins_with_its_course() -> None:
    simulation = simulated(WING + SENSORS, 3)
    off = fly(simulation)
    on = fly(simulation, _with_course(simulation, 4.0))
    at = EPOCH_NS + 5 * SECOND
    without, begun = (next(e for e in run.estimates if e.t_ns >= at) for run in (off, on))
    assert _heading_sigma(without) > math.radians(20.0)
    assert _heading_sigma(begun) < math.radians(20.0)
    heading_error = math.remainder(
        so3.to_euler(begun.nav[X.Q])[2] - so3.to_euler(_true_q(simulation, begun.t_ns))[2], 2.0 * math.pi
    )
    assert abs(heading_error) < 3.0 * _heading_sigma(begun)


def _with_course(simulation: Simulation, sigma_deg: float) -> FusionConfig:
    config = config_of(simulation)
    return FusionConfig(
        imu=config.imu, gnss=config.gnss, origin=config.origin, initialise=InitialiseConfig(course_sigma_deg=sigma_deg)
    )


def _true_q(simulation: Simulation, t_ns: int) -> Array:
    q: Array = simulation.truth.q_nb_wxyz[int(np.searchsorted(simulation.truth.t_ns, t_ns))]
    return q
