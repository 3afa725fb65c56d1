from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from estimator.config import parse
from estimator.filter.smoother import Link, Node, Smoothed, backward, smooth
from estimator.fusion import Fusion
from models import so3
from models.messages import Array, Estimate, ImuSample, Input
from models.sim.scenario import EPOCH_NS, Simulation, simulate
from models.sim.scenario_file import loads
from models.state import E, NavState, X, local, retract
from tests.estimator.filter.relative.odometers import increments, poses

SEEDS = range(20)
OUTAGE_S = (12.0, 24.0)
FLIGHT = """
duration_s = 36.0
geographic = false
[imu]
rate_hz = 50.0
[pose_fix]
outages_s = [[12.0, 24.0]]
"""


@cache
def flight(seed: int, more: str = "") -> Simulation:
    return simulate(loads(FLIGHT + more), seed)


@cache
def smoothed(seed: int, more: str = "") -> Smoothed:
    simulation = flight(seed, more)
    return smooth(simulation.messages, parse(simulation.config_toml).fusion())


@cache
def filtered(seed: int, more: str = "") -> dict[int, Estimate]:
    simulation = flight(seed, more)
    fusion = Fusion(parse(simulation.config_toml).fusion())
    return {o.t_ns: o for message in simulation.messages for o in fusion.handle(message) if isinstance(o, Estimate)}


def seconds(s: Smoothed) -> Array:
    return np.asarray((s.t_ns - EPOCH_NS) * 1e-9)


def truth_at(simulation: Simulation, t_ns: int) -> Array:
    truth, k = simulation.truth, int(np.searchsorted(simulation.truth.t_ns, t_ns))
    assert truth.t_ns[k] == t_ns
    return NavState(truth.p_n[k], truth.v_n[k], truth.q_nb_wxyz[k], truth.gyro_bias[k], truth.accel_bias[k]).pack()


def errors(simulation: Simulation, nav_at: dict[int, Array]) -> Array:
    return np.array([local(nav, truth_at(simulation, t_ns)) for t_ns, nav in nav_at.items()])


def inside_outage(seed: int) -> list[int]:
    """Rows of the smoothed flight inside the outage that stand at IMU samples."""
    s, stamps = smoothed(seed), flight(seed).truth.t_ns
    at_sample = np.isin(s.t_ns, stamps)
    return np.flatnonzero(at_sample & (seconds(s) > OUTAGE_S[0] + 0.5) & (seconds(s) < OUTAGE_S[1] - 0.5)).tolist()


# --- the equations ------------------------------------------------------------------------------------------------------


def linear_flight(rng: np.random.Generator, steps: int) -> tuple[list[Node], Array, Array]:
    """A Kalman filter on a linear problem in all 15 states, attitude zero; and the batch solution of it: mean and covariance."""
    n = E.SIZE
    level = NavState(np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)).pack()
    moving = np.r_[E.P, E.V, E.BG, E.BA]  # attitude has no part: its error is small, so the manifold is flat
    phi = np.eye(n)
    phi[np.ix_(moving, moving)] += 0.1 * rng.standard_normal((len(moving), len(moving)))
    noise = np.diag(rng.uniform(0.05, 0.2, n))
    h = np.zeros((3, n))
    h[:, moving] = rng.standard_normal((3, len(moving)))
    r = 0.3 * np.eye(3)
    # Batch: information of prior, motion and measurements over the stacked states.
    information, vector = np.zeros((steps * n, steps * n)), np.zeros(steps * n)
    information[:n, :n] = np.eye(n)
    q_inverse = np.linalg.inv(noise)
    x, cov = np.zeros(n), np.eye(n)
    nodes: list[Node] = []
    for k in range(steps):
        link = None
        if k:
            predicted, p_predicted = phi @ x, phi @ cov @ phi.T + noise
            link = Link(nodes[-1], phi, retract(level, predicted), p_predicted)
            x, cov = predicted, p_predicted
            a, b = slice((k - 1) * n, k * n), slice(k * n, (k + 1) * n)
            information[a, a] += phi.T @ q_inverse @ phi
            information[b, b] += q_inverse
            information[a, b] -= phi.T @ q_inverse
            information[b, a] -= q_inverse @ phi
        z = rng.standard_normal(3)
        gain = cov @ h.T @ np.linalg.inv(h @ cov @ h.T + r)
        x, cov = x + gain @ (z - h @ x), cov - gain @ h @ cov
        here = slice(k * n, (k + 1) * n)
        information[here, here] += h.T @ np.linalg.inv(r) @ h
        vector[here] += h.T @ np.linalg.inv(r) @ z
        nodes.append(Node(k, retract(level, x), cov, link))
    joint: Array = np.linalg.inv(information).astype(np.float64)
    mean = (joint @ vector).reshape(steps, n)
    return nodes, np.array([retract(level, m) for m in mean]), joint.reshape(steps, n, steps, n)[range(steps), :, range(steps)]


def test_on_a_linear_problem_it_is_the_batch_solution() -> None:
    nodes, nav, covariance = linear_flight(np.random.default_rng(1), steps=12)
    smoothed_nav, smoothed_cov = backward(nodes)
    np.testing.assert_allclose(smoothed_nav, nav, atol=1e-9)
    np.testing.assert_allclose(smoothed_cov, covariance, atol=1e-9)


def test_a_large_correction_of_the_attitude_carries_the_covariance_along() -> None:
    """GIVEN no noise between two nodes WHEN the later is known better THEN the earlier is the same rotation, known the same."""
    rng = np.random.default_rng(2)
    level = NavState(np.zeros(3), np.zeros(3), so3.quat_exp(rng.standard_normal(3)), np.zeros(3), np.zeros(3)).pack()
    turn = np.zeros(E.SIZE)
    turn[E.THETA] = 0.6, -0.5, 0.4
    better = retract(level, turn)
    spread = rng.standard_normal((E.SIZE, E.SIZE))
    cov = 1e-4 * spread @ spread.T
    before = Node(0, level, np.eye(E.SIZE))
    nav, covariance = backward([before, Node(1, better, cov, Link(before, np.eye(E.SIZE), level, np.eye(E.SIZE)))])
    np.testing.assert_allclose(nav[0], better, atol=1e-12)
    np.testing.assert_allclose(covariance[0], cov, atol=1e-9)


# --- flights ------------------------------------------------------------------------------------------------------------


def test_it_ends_as_the_filter_does() -> None:
    s, last = smoothed(0), filtered(0)[max(filtered(0))]
    assert s.t_ns[-1] == last.t_ns
    np.testing.assert_array_equal(s.nav[-1], last.nav)
    np.testing.assert_array_equal(s.covariance[-1], last.covariance)
    np.testing.assert_allclose(s.gyro_b[-1], last.gyro_b, atol=1e-15)


def test_odometry_is_left_out() -> None:
    """An increment links two nodes, which a backward pass over 15 states cannot take."""
    simulation = flight(1)
    odometry: list[Input] = [*increments(simulation, 2.0, 8.0), *poses(simulation, 2.0, 8.0)]
    with_odometry = smooth([*simulation.messages, *odometry], parse(simulation.config_toml).fusion())
    assert with_odometry.nav.tobytes() == smoothed(1).nav.tobytes()


def test_nodes_stand_at_every_fix_and_every_tenth_of_a_second() -> None:
    s = smoothed(0)
    assert len(set(s.segment.tolist())) == 1
    assert (np.diff(s.t_ns) > 0).all()
    assert np.diff(s.t_ns).max() <= 120_000_000
    fixes = {m.t_ns for m in flight(0).messages if m.topic == "/pose_fix" and s.t_ns[0] <= m.t_ns <= s.t_ns[-1]}
    assert fixes <= set(s.t_ns.tolist())


def test_inside_an_outage_it_is_several_times_better_than_the_filter() -> None:
    ratios = []
    for seed in SEEDS:
        s, estimates, rows = smoothed(seed), filtered(seed), inside_outage(seed)
        stamps = s.t_ns[rows].tolist()
        ours = errors(flight(seed), dict(zip(stamps, s.nav[rows], strict=True)))[:, E.P]
        theirs = errors(flight(seed), {t: estimates[t].nav for t in stamps})[:, E.P]
        ratios.append(np.sqrt(np.mean(ours**2) / np.mean(theirs**2)))
    assert np.median(ratios) < 0.25
    assert max(ratios) < 1.0


@pytest.mark.parametrize("part", [slice(E.P.start, E.THETA.stop), slice(0, E.SIZE)], ids=["pose and velocity", "full state"])
@pytest.mark.parametrize("fraction", [0.0, 0.5, 1.0], ids=["begin", "middle", "end"])
def test_inside_an_outage_it_is_consistent(part: slice, fraction: float) -> None:
    total = 0.0
    for seed in SEEDS:
        s, rows = smoothed(seed), inside_outage(seed)
        row = rows[round(fraction * (len(rows) - 1))]
        error = local(s.nav[row], truth_at(flight(seed), int(s.t_ns[row])))[part]
        total += float(error @ np.linalg.solve(s.covariance[row][part, part], error))
    dof = len(SEEDS) * (part.stop - part.start)
    assert chi2.ppf(0.005, dof) < total < chi2.ppf(0.995, dof)


def test_no_node_is_less_certain_than_the_filter() -> None:
    s, estimates = smoothed(0), filtered(0)
    for t_ns, cov in zip(s.t_ns.tolist(), s.covariance, strict=True):
        np.testing.assert_array_equal(cov, cov.T)
        assert np.linalg.eigvalsh(cov / np.sqrt(np.outer(np.diag(cov), np.diag(cov))))[0] > 0
        if t_ns in estimates:
            position = np.diag(cov)[E.P] / np.diag(estimates[t_ns].covariance)[E.P]
            assert (position < 1.01).all()


def test_arrival_plays_no_part() -> None:
    """GIVEN fixes that are up to 5 s late, overtake each other and come twice THEN the smoothed flight is the same."""
    late = simulate(loads(FLIGHT + "delay_s = [0.0, 5.0]\n"), seed=0)
    twice = [m for m in late.messages if m.topic == "/pose_fix"][10:]
    s = smooth([*late.messages, *twice], parse(late.config_toml).fusion())
    here = s.t_ns >= smoothed(0).t_ns[0]
    np.testing.assert_array_equal(s.nav[here], smoothed(0).nav)


def test_a_false_fix_at_the_end_of_an_outage_does_not_bend_what_was_before() -> None:
    """GIVEN three fixes after the outage that are off by the same 4.7 m, so that the filter believes them at first."""
    lie = "false_spans = [{start_s = 24.0, end_s = 25.6, offset_n_m = [3.0, -2.0, 3.0]}]\n"
    s, simulation, estimates = smoothed(3, lie), flight(3, lie), filtered(3, lie)
    stamps = [t for t in s.t_ns.tolist() if 24.9 < (t - EPOCH_NS) * 1e-9 < 25.6 and t in estimates]
    believed = errors(simulation, {t: estimates[t].nav for t in stamps})[:, E.P]
    assert np.linalg.norm(believed, axis=1).min() > 2.0
    seen = (seconds(s) > 10.0) & np.isin(s.t_ns, simulation.truth.t_ns)
    ours = errors(simulation, dict(zip(s.t_ns[seen].tolist(), s.nav[seen], strict=True)))[:, E.P]
    assert np.linalg.norm(ours, axis=1).max() < 0.5
    assert s.segment.max() == 0


def test_nothing_is_smoothed_across_a_silent_imu() -> None:
    silent = '\n[[faults]]\nkind = "imu_dropout"\nstart_s = 30.0\nend_s = 31.0\n'
    s, simulation = smoothed(0, silent), flight(0, silent)
    before = int((seconds(s) < 29.95).sum())
    assert s.segment[before - 1] < s.segment[-1]
    assert (seconds(s) > 31.0).sum() > 40
    shorter = [m for m in simulation.messages if m.t_ns < EPOCH_NS + 30_000_000_000]
    alone = smooth(shorter, parse(simulation.config_toml).fusion())
    np.testing.assert_allclose(s.nav[:before], alone.nav[:before], rtol=0, atol=1e-14)


def test_progress_is_reported() -> None:
    told: list[float] = []
    simulation = flight(0)
    smooth(simulation.messages, parse(simulation.config_toml).fusion(), told.append)
    assert told == sorted(told)
    assert told[-1] == 1.0


@pytest.mark.parametrize("messages", [[], flight(0).messages[:40]], ids=["none", "too few"])
def test_without_an_alignment_there_is_nothing(messages: list[Input]) -> None:
    s = smooth(messages, parse(flight(0).config_toml).fusion())
    assert s.nav.shape == (0, X.SIZE)
    assert s.covariance.shape == (0, E.SIZE, E.SIZE)
    assert s.gyro_b.shape == (0, 3)


def test_a_stamp_from_far_ahead_is_left_out() -> None:
    simulation = flight(0)
    good = next(m for m in simulation.messages[200:] if isinstance(m, ImuSample))
    strange = ImuSample(good.t_ns + 10**15, good.arrived_ns, good.gyro_b, good.accel_b)
    s = smooth([*simulation.messages[:200], strange, *simulation.messages[200:]], parse(simulation.config_toml).fusion())
    np.testing.assert_array_equal(s.nav, smoothed(0).nav)
