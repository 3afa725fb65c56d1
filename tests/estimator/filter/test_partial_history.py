"""Fixes in part through Fusion: late = punctual to the bit, gates in their degrees of freedom, smoother, alignment."""

import math

import msgspec
import numpy as np
import pytest

from estimator.filter.smoother import smooth
from estimator.sources.base.gating import gate
from models.messages import AidStatus, Array, ImuSample, Input, LandmarkFix, Mode, PoseFix, Reason, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from tests.estimator.partial import in_part, not_measured, orthonormal, point_rows
from tests.estimator.scenes import (
    SECOND,
    Run,
    arriving,
    by_arrival,
    config_of,
    error,
    fly,
    position_errors,
    same,
    simulated,
    true_state,
    within,
)

FLIGHT = """
duration_s = 25.0
[vehicle]
kind = "multirotor"
seed = 3
[imu]
rate_hz = 50.0
[gnss]
rate_hz = 2.0
outages_s = [[7.0, 25.0]]
[pose_fix]
rate_hz = 3.0
outlier_share = 0.3
outages_s = [[4.0, 5.0]]
"""
TOPIC = "/landfix/fix"
WHOLE_S, AIDS_END_S = 6.0, 20.0  # fixes are whole before, and end at


def _directions(k: int) -> Array:
    """A point and the heading, a point alone, or two edges: other directions each time."""
    point = point_rows(np.array([6.0 * math.cos(k), 6.0 * math.sin(k), 30.0]))
    return orthonormal((np.vstack((point, np.eye(6)[5])), point, point[1:])[k % 3])


def _in_part(messages: list[Input]) -> list[Input]:
    """After WHOLE_S every pose fix tells a part only; off by metres and degrees in the rest."""
    rng, told = np.random.default_rng(7), list[Input]()
    for k, m in enumerate(messages):
        if isinstance(m, PoseFix) and m.t_ns > EPOCH_NS + WHOLE_S * SECOND:
            directions = _directions(k)
            told.append(in_part(m, directions, rng.normal(0.0, 1.0, 6 - len(directions))))
        else:
            told.append(m)
    return [m for m in told if isinstance(m, ImuSample) or m.t_ns < EPOCH_NS + AIDS_END_S * SECOND]


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulated(FLIGHT)


@pytest.fixture(scope="module")
def messages(flight: Simulation) -> list[Input]:
    return _in_part(list(flight.messages))


@pytest.fixture(scope="module")
def punctual(flight: Simulation, messages: list[Input]) -> Run:
    return fly(flight, messages=messages)


def _reasons(run: Run) -> dict[tuple[str, int, str], Reason]:
    words = {(t, *k): s.reason for t in ("/gnss", "/pose_fix", TOPIC) for k, s in run.last_words(t).items()}
    return {key: reason for key, reason in words.items() if reason is not Reason.DUPLICATE}


def test_some_are_fused_and_false_ones_are_gated(punctual: Run) -> None:
    reasons = punctual.reasons(TOPIC)
    assert reasons[Reason.FUSED] >= 10
    assert reasons[Reason.GATED] >= 2
    assert not punctual.internal_errors()
    assert max(h.hypotheses for h in punctual.health) > 1


def test_status_reports_the_degrees_of_freedom(punctual: Run) -> None:
    for status in punctual.last_words(TOPIC).values():
        dof = len(status.innovation)
        assert dof == len(status.innovation_sigma) in (2, 3, 4)
        assert status.detail.partition("; ")[0] == f"{dof} of 6 directions"
        if status.reason is Reason.FUSED:
            assert status.test_ratio <= 1.0


def test_the_gate_is_that_of_the_directions(flight: Simulation, messages: list[Input]) -> None:
    """A reading of one direction, so far off that one degree of freedom refuses it and six would not."""
    config = config_of(flight)
    one = next(m for m in messages if isinstance(m, LandmarkFix) and m.t_ns > EPOCH_NS + 8 * SECOND)
    before = [m for m in messages if m.t_ns < one.t_ns]
    after = [m for m in messages if isinstance(m, ImuSample) and one.t_ns <= m.t_ns < one.t_ns + SECOND // 5]
    up = orthonormal(np.eye(6)[[2]])
    truth = true_state(flight.truth, int(flight.truth.t_ns[np.searchsorted(flight.truth.t_ns, one.t_ns)]))
    limits = gate(0.9999, 1), gate(0.9999, 6)

    def status(height_m: float) -> AidStatus:
        told = msgspec.structs.replace(one, p_n=vec3(truth[:3] + height_m * np.eye(3)[2]), directions=up)
        return fly(flight, config, [*before, told, *after]).last_words(TOPIC)[one.t_ns, "pose"]

    middle = math.sqrt(0.5 * (limits[0] + limits[1]))
    near = status(0.0)
    sigma, at = near.innovation_sigma[0], near.innovation[0]
    far = status((middle * sigma - at) if at >= 0 else -(middle * sigma + at))
    assert near.reason is Reason.FUSED
    assert limits[0] < (far.innovation[0] / far.innovation_sigma[0]) ** 2 < limits[1]
    assert far.reason is Reason.GATED


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("most_s", [0.3, 2.5])
def test_any_order_of_arrival_ends_in_the_same_bits(
    seed: int, most_s: float, flight: Simulation, messages: list[Input], punctual: Run
) -> None:
    rng = np.random.default_rng(seed)
    late = [m if isinstance(m, ImuSample) else arriving(m, rng.uniform(0.0, most_s)) for m in messages]
    run = fly(flight, messages=by_arrival(late))
    assert max(s.replayed for s in run.statuses) > 0
    assert same(run.estimates[-1], punctual.estimates[-1])
    assert _reasons(run) == _reasons(punctual)


def test_fixes_in_part_hold_the_position_where_gnss_is_gone(flight: Simulation, messages: list[Input], punctual: Run) -> None:
    without = fly(flight, messages=[m for m in messages if not isinstance(m, LandmarkFix)])
    held = position_errors(within(punctual.estimates, 14.0, AIDS_END_S), flight.truth)
    lost = position_errors(within(without.estimates, 14.0, AIDS_END_S), flight.truth)
    assert np.sqrt(np.mean(held**2)) < 0.3 * np.sqrt(np.mean(lost**2))
    assert _nees(punctual, flight) < 1.6


def _nees(run: Run, flight: Simulation) -> float:
    """Of position, velocity and attitude, over their number."""
    kept, pose = within(run.estimates, 8.0, AIDS_END_S), slice(0, 9)
    errors = [error(e, flight.truth)[pose] for e in kept]
    covs = [e.covariance[pose, pose] for e in kept]
    return float(np.mean([d @ np.linalg.solve(c, d) for d, c in zip(errors, covs, strict=True)])) / 9.0


def test_taking_them_for_whole_gates_good_ones(flight: Simulation, messages: list[Input], punctual: Run) -> None:
    """The control: the covariance without directions, as if the prior's part had been measured too.

    What the fixes scatter saves the estimate, not the fixes that are refused before that is seen.
    """

    def whole(m: LandmarkFix) -> LandmarkFix:
        assert m.directions is not None
        across = not_measured(m.directions)
        return msgspec.structs.replace(m, directions=None, covariance=m.covariance - 1e4 * across.T @ across)

    run = fly(flight, messages=[whole(m) if isinstance(m, LandmarkFix) else m for m in messages])
    assert run.reasons("/landfix/fix").get(Reason.GATED, 0) > punctual.reasons("/landfix/fix").get(Reason.GATED, 0) + 3


def test_the_smoother_takes_them_and_is_no_worse_than_the_filter(
    flight: Simulation, messages: list[Input], punctual: Run
) -> None:
    smoothed = smooth(messages, config_of(flight))
    filtered = {e.t_ns: e for e in punctual.estimates}
    rows = [k for k, t in enumerate(smoothed.t_ns.tolist()) if t in filtered and t > EPOCH_NS + 7 * SECOND]
    rows = [k for k in rows if smoothed.t_ns[k] < EPOCH_NS + (AIDS_END_S - 1.0) * SECOND]
    assert len(rows) > 30
    truth = np.array([true_state(flight.truth, int(t))[:3] for t in smoothed.t_ns[rows]])
    after = smoothed.nav[rows, :3] - truth
    before = np.array([filtered[int(t)].nav[:3] for t in smoothed.t_ns[rows]]) - truth
    assert np.sqrt(np.mean(after**2)) < np.sqrt(np.mean(before**2))
    nees = [d @ np.linalg.solve(smoothed.covariance[k][:3, :3], d) for k, d in zip(rows, after, strict=True)]
    assert np.mean(nees) / 3.0 < 3.0


def test_before_there_is_a_position_they_wait(flight: Simulation, messages: list[Input]) -> None:
    """A part of a pose starts no filter."""
    start = EPOCH_NS + WHOLE_S * SECOND
    parts = [m for m in messages if m.t_ns > start and isinstance(m, ImuSample | LandmarkFix)]
    run = fly(flight, messages=parts)
    assert set(run.reasons(TOPIC)) == {Reason.ALIGNING}
    assert all(h.mode in (Mode.STARTING, Mode.ALIGNING) for h in run.health)
    assert not run.estimates
