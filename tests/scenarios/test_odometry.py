"""GIVEN a flight that loses its positions, WHEN odometry goes on, THEN it carries the estimate, and a fault is held."""

from collections.abc import Iterable

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.fusion import FusionConfig
from estimator.sources.odometry import OdometryConfig, Row
from models import so3
from models.messages import ImuSample, Input, Mode, Reason, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E
from tests.estimator.filter.relative.odometers import TOPIC, increments, poses, quat
from tests.estimator.scenes import SECOND, Run, by_arrival, config_of, error, fly, position_errors, simulated, within

FLIGHT = """
duration_s = 80.0
[vehicle]
kind = "multirotor"
[imu]
rate_hz = 100.0
grade = "hobby"
[gnss]
[pose_fix]
rate_hz = 2.0
"""
LOST_S, END_S = 35.0, 80.0


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulated(FLIGHT, seed=4)


def _with(simulation: Simulation, odometry: Iterable[Input] = (), config: FusionConfig | None = None) -> Run:
    """The flight without positions since LOST_S."""
    lost_ns = EPOCH_NS + round(LOST_S * 1e9)
    kept = [m for m in simulation.messages if isinstance(m, ImuSample) or m.t_ns < lost_ns]
    return fly(simulation, config, by_arrival([*kept, *odometry]))


def _ratio(run: Run, simulation: Simulation, start_s: float, end_s: float) -> float:
    """The largest NEES/3 of the position in a time span."""
    largest = 0.0
    for e in within(run.estimates, start_s, end_s):
        off = error(e, simulation.truth)[E.P]
        largest = max(largest, float(off @ np.linalg.solve(e.covariance[E.P, E.P], off)) / 3.0)
    return largest


def test_odometry_carries_the_estimate_through_an_outage(simulation: Simulation) -> None:
    alone, carried = _with(simulation), _with(simulation, increments(simulation, 15.0, END_S))
    assert position_errors(alone.estimates[-1:], simulation.truth)[0] > 15.0
    assert position_errors(within(carried.estimates, LOST_S, END_S), simulation.truth).max() < 2.0
    assert _ratio(carried, simulation, LOST_S, END_S) < 5.4  # 99.9 %
    assert {e.mode for e in within(carried.estimates, LOST_S + 3.1, END_S)} == {Mode.ODOMETRY}
    assert {e.mode for e in within(alone.estimates, LOST_S + 3.1, END_S)} == {Mode.DEAD_RECKONING}
    assert carried.reasons(TOPIC)[Reason.FUSED] >= 120
    assert not carried.internal_errors()


@pytest.mark.long
def test_poses_in_a_frame_of_their_own_do_the_same(simulation: Simulation) -> None:
    run = _with(simulation, poses(simulation, 15.0, END_S))
    assert position_errors(within(run.estimates, LOST_S, END_S), simulation.truth).max() < 2.0
    fused = [s for s in run.statuses if s.topic == TOPIC and s.reason is Reason.FUSED]
    assert 110 <= len(fused) <= 130  # of 650 poses
    assert not run.internal_errors()


@pytest.mark.long
def test_some_components_alone_help_as_far_as_they_go(simulation: Simulation) -> None:
    """Translation without rotation, as wheels or optical flow give it, and its forward component alone."""
    alone = position_errors(_with(simulation).estimates[-1:], simulation.truth)[0]
    rows: tuple[Row, ...] = ("x", "y", "z")
    for given, limit in ((rows, 2.0), (rows[:1], 0.8 * alone)):
        config = replace(config_of(simulation), odometry=OdometryConfig(rows=given))
        run = _with(simulation, poses(simulation, 15.0, END_S), config)
        fused = [s for s in run.statuses if s.topic == TOPIC and s.reason is Reason.FUSED]
        assert {len(s.innovation) for s in fused} == {len(given)}
        assert position_errors(run.estimates[-1:], simulation.truth)[0] < limit
        assert _ratio(run, simulation, LOST_S, END_S) < 5.4


def test_another_frame_begins_anew(simulation: Simulation) -> None:
    """Nothing is made of two poses in different frames, though they would say that the vehicle has jumped."""
    frames = lambda t_s: f"odom{int(t_s // 7)}"  # noqa: E731
    moved = [
        type(p)(p.t_ns, p.arrived_ns, (p.p_o[0] + 100.0 * int(p.frame[4:]), p.p_o[1], p.p_o[2]), p.q_ob_wxyz, p.frame, p.topic)
        for p in poses(simulation, 15.0, END_S, frame=frames)
    ]
    run = _with(simulation, moved)
    assert Reason.GATED not in run.reasons(TOPIC)
    assert Reason.IMPLAUSIBLE not in run.reasons(TOPIC)
    assert position_errors(within(run.estimates, LOST_S, END_S), simulation.truth).max() < 2.0


@pytest.mark.parametrize("says", [True, False])
def test_a_pose_that_stands_still_while_it_is_lost_is_no_motion(simulation: Simulation, says: bool) -> None:
    """As ZED's does, which goes on from where it was lost; without a word the motion in between is missed."""
    true = list(poses(simulation, 15.0, END_S))
    is_lost = np.array([2.0 < (p.t_ns - EPOCH_NS) * 1e-9 % 10.0 < 2.8 for p in true])
    steps = np.diff([p.p_o for p in true], axis=0, prepend=[true[0].p_o])
    paths = np.add(true[0].p_o, np.cumsum(np.where(is_lost[:, None], 0.0, steps), axis=0))
    seen = [replace(p, p_o=vec3(at)) for p, at in zip(true, paths, strict=True)]
    lost = [
        replace(p, arrived_ns=p.arrived_ns + SECOND // 100, is_lost=True) for p, is_it in zip(seen, is_lost, strict=True) if is_it
    ]
    run = _with(simulation, [*seen, *lost] if says else seen)
    assert (Reason.NO_FIX in run.reasons(TOPIC)) == says
    assert (Reason.GATED in run.reasons(TOPIC)) != says
    if says:
        assert position_errors(within(run.estimates, LOST_S, END_S), simulation.truth).max() < 2.0
        assert _ratio(run, simulation, LOST_S, END_S) < 5.4


def test_a_jump_is_seen_and_left_out(simulation: Simulation) -> None:
    """By 2 m, and by 0.5 m, in an outage."""

    def jumps(t_s: float) -> float:
        return 2.0 * (t_s > LOST_S + 10.0) + 0.5 * (t_s > LOST_S + 25.0)

    moved = [
        type(p)(p.t_ns, p.arrived_ns, (p.p_o[0] + jumps((p.t_ns - EPOCH_NS) * 1e-9), *p.p_o[1:]), p.q_ob_wxyz, p.frame, p.topic)
        for p in poses(simulation, 15.0, END_S)
    ]
    run = _with(simulation, moved)
    assert run.reasons(TOPIC).keys() & {Reason.IMPLAUSIBLE, Reason.GATED}
    assert position_errors(within(run.estimates, LOST_S, END_S), simulation.truth).max() < 2.0
    assert _ratio(run, simulation, LOST_S, END_S) < 5.4


@pytest.mark.long
def test_a_wrong_scale_is_estimated_while_positions_show_it(simulation: Simulation) -> None:
    run = _with(simulation, increments(simulation, 10.0, END_S, scale=lambda _: 1.1))
    assert position_errors(within(run.estimates, LOST_S, END_S), simulation.truth).max() < 4.0
    assert _ratio(run, simulation, LOST_S, END_S) < 5.4


def test_a_scale_that_goes_wrong_in_an_outage_widens_the_covariance_and_is_reported(simulation: Simulation) -> None:
    run = _with(simulation, increments(simulation, 15.0, END_S, scale=lambda t_s: 1.1 if t_s > LOST_S + 10.0 else 1.0))
    found = [s for s in run.statuses if s.topic == TOPIC and "has contradicted" in s.detail]
    assert found
    assert {h.sources[TOPIC] for h in run.health if h.t_ns > found[0].t_ns} == {"active"}
    assert run.statuses[-1].reason is Reason.FUSED
    assert "taken to be wrong by" in run.statuses[-1].detail
    assert "contradicted each other" in run.health[-1].detail
    assert _ratio(run, simulation, LOST_S, END_S) < 5.4


@pytest.mark.parametrize("turned", [so3.from_euler(0.0, 0.0, np.pi / 2.0), so3.from_euler(0.0, np.pi, 0.0)])
def test_increments_in_other_axes_are_not_used_and_health_says_so(simulation: Simulation, turned: np.ndarray) -> None:
    wrong = [replace(p, q_ob_wxyz=quat(so3.multiply(np.array(p.q_ob_wxyz), turned))) for p in poses(simulation, 15.0, END_S)]
    run = _with(simulation, wrong)
    late = [s for s in run.statuses if s.topic == TOPIC and s.t_ns > EPOCH_NS + round((LOST_S - 5.0) * 1e9)]
    assert Reason.FUSED not in {s.reason for s in late}
    assert "off by more than noise" in run.health[-1].detail
    assert _ratio(run, simulation, LOST_S, END_S) < 5.4


@pytest.mark.long
def test_a_scene_that_moves_slowly_is_never_overconfident_and_wrong(simulation: Simulation) -> None:
    """Half of the ground drifts: every increment is wrong by 0.2 m/s downwards, and every third one says that it may be."""
    moved = []
    for k, d in enumerate(increments(simulation, 15.0, END_S, sigma=(0.05, 0.0, 1e-3))):
        e = 0.1 if (d.t_ns - EPOCH_NS) * 1e-9 > LOST_S + 2.0 else 0.0
        covariance = d.covariance * (30.0 if e and k % 3 == 0 else 1.0)
        moved.append(replace(d, dp_b=(d.dp_b[0], d.dp_b[1], d.dp_b[2] + e), covariance=covariance, systematic=np.zeros((6, 1))))
    run = _with(simulation, moved)
    assert position_errors(run.estimates[-1:], simulation.truth)[0] > 1.0  # the fault is one
    assert _ratio(run, simulation, LOST_S, END_S) < 5.4


@pytest.mark.long
def test_lost_steps_and_darkness_are_bridged_by_the_imu(simulation: Simulation) -> None:
    rng = np.random.default_rng(3)
    kept = [
        d
        for d in increments(simulation, 15.0, END_S)
        if rng.random() > 0.2 and not LOST_S + 20.0 < (d.t_ns - EPOCH_NS) * 1e-9 < LOST_S + 24.0
    ]
    run = _with(simulation, kept)
    assert position_errors(within(run.estimates, LOST_S, END_S), simulation.truth).max() < 4.0
    assert _ratio(run, simulation, LOST_S, END_S) < 5.4


@pytest.mark.long
def test_odometry_before_there_is_an_estimate_does_no_harm(simulation: Simulation) -> None:
    run = _with(simulation, increments(simulation, 0.0, 25.0))
    assert Reason.ALIGNING in run.reasons(TOPIC)
    assert position_errors(within(run.estimates, 15.0, LOST_S), simulation.truth).max() < 2.0
    assert not run.internal_errors()
