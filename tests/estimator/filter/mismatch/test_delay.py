"""The delay of a source: found where there is one, with its sigma, and never where there is none."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.mismatch import DELAY, delay, score
from estimator.filter.mismatch.score import Sums
from models import so3
from models.imu import Coast, ImuNoise, constants
from models.measurements import Measurement, PartialPose, Pose, Position, Velocity
from models.messages import Array, GnssFix, GnssVelocity, Input, PoseFix
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X
from tests.estimator.scenes import SECOND, Run, fly, position_errors, radii, simulated, within

U = np.array([0.2, -0.1, 0.4, 1.0, -0.5, -9.0])  # rate, specific force
LEVER = np.array([0.3, -0.2, 0.1])
POSE_ROWS = np.arange(6)


def _state(t_s: float) -> Array:
    """A motion of constant rate and specific force in n, at t_s, exact to the second order."""
    q0 = np.array([0.9, 0.1, -0.2, 0.3])
    q0 /= np.linalg.norm(q0)
    x = np.zeros(X.SIZE)
    a_n = so3.matrix(q0) @ U[3:] + np.array([0.0, 0.0, 9.80665])
    v0 = np.array([5.0, -3.0, 1.0])
    x[X.P], x[X.V] = v0 * t_s + 0.5 * a_n * t_s**2, v0 + a_n * t_s
    x[X.Q] = so3.multiply(q0, so3.quat_exp(U[:3] * t_s))
    return x


MEASUREMENTS: dict[str, Measurement] = {
    "position": Position(np.zeros(3), np.eye(3), np.arange(3), LEVER),
    "velocity": Velocity(np.zeros(3), np.eye(3), np.zeros(3)),
    "pose": Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.eye(6), POSE_ROWS),
    "directions": PartialPose(
        np.zeros(3), _state(0.0)[X.Q], np.random.default_rng(1).normal(size=(4, 6)), np.zeros(4), np.eye(4)
    ),
}


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_the_jacobian_is_how_the_reading_of_an_earlier_state_differs(name: str) -> None:
    z, late = MEASUREMENTS[name], 1e-4
    if isinstance(z, Pose):
        z = replace_pose(z, _state(0.0)[X.Q])
    now, before = (z.evaluate(_state(t), U[:3])[0] for t in (0.0, -late))  # nu = z - h(x)
    np.testing.assert_allclose(_jacobian(z, _state(0.0)), (now - before) / late, atol=5e-3)


def _jacobian(z: Measurement, x: Array) -> Array:
    j = delay.jacobian(z, x, U)
    assert j is not None
    return j


def replace_pose(z: Pose, q: Array) -> Pose:
    """The small attitude error is linear about the state's own."""
    return Pose(z.z_n, q, z.noise, z.rows)


@pytest.mark.parametrize("name", ["position", "velocity", "pose"])
def test_a_filter_that_was_aligned_with_late_readings_foresees_late_readings(name: str) -> None:
    eskf = Eskf(EPOCH_NS, _state(0.0), 0.01 * np.eye(E.SIZE), constants(ImuNoise(), Coast(), None))
    score.begin(DELAY, eskf, "/fix", U)
    z = MEASUREMENTS[name]
    if isinstance(z, Pose):
        z = replace_pose(z, eskf.x[X.Q])
    seen = eskf.innovation(z, U[:3], [(DELAY.block("/fix"), _jacobian(z, eskf.x)[:, None])])
    lever_free = 0.02 if name == "position" else 1e-12  # the lever's own speed is not in the state
    assert np.abs(seen.hp[:, -1]).max() < lever_free * 1e-8 * 10.0


FLIGHT = """
duration_s = 90.0
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
sigma_m = [0.5, 0.5, 0.8]
[pose_fix]
rate_hz = 2.0
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
"""


RECEIVER, FIXES = (GnssFix, GnssVelocity), (PoseFix,)


def _flown(late_ms: float, late: tuple[type, ...], *, without: tuple[type, ...] = (), seed: int) -> tuple[Simulation, Run]:
    flight, by_ns = simulated(FLIGHT, seed=seed), round(late_ms * 1e6)

    def delayed(m: Input) -> Input:
        return replace(m, t_ns=m.t_ns + by_ns, arrived_ns=m.arrived_ns + by_ns) if isinstance(m, late) else m

    messages = sorted((delayed(m) for m in flight.messages if not isinstance(m, without)), key=lambda m: m.arrived_ns)
    return flight, fly(flight, messages=messages)


def _found_ms(run: Run, topic: str) -> tuple[float, float]:
    tracker = run.fusion._history.advance(run.estimates[-1].t_ns)
    assert tracker.core.hypotheses is not None
    assert tracker.scores[DELAY.block(topic)].is_state
    lead = tracker.core.hypotheses.lead
    at = lead.slow.columns[DELAY.block(topic)].start
    return 1e3 * float(lead.slow.mean[at - E.SIZE]), 1e3 * math.sqrt(lead.cov[at, at])


@pytest.mark.parametrize("late_ms", [80.0, -80.0, 200.0])
def test_fixes_that_are_late_are_found_to_be_and_no_longer_mislead(late_ms: float) -> None:
    flight, run = _flown(late_ms, FIXES, without=RECEIVER, seed=2)
    found, sigma = _found_ms(run, "/pose_fix")
    assert abs(found - late_ms) < max(3.0 * sigma, 10.0)
    assert sigma < 15.0
    off = position_errors(within(run.estimates, 60.0, 90.0), flight.truth)
    assert math.sqrt((off**2).mean()) < 0.35
    side = "late" if late_ms > 0.0 else "early"
    assert f"stamps of /pose_fix are {abs(found):.0f} ms {side}" in run.health[-1].detail


def test_a_receiver_that_is_late_is_found_to_be() -> None:
    _, run = _flown(150.0, RECEIVER, without=FIXES, seed=2)
    found, sigma = _found_ms(run, "/gnss")
    assert abs(found - 150.0) < max(3.0 * sigma, 20.0)


@pytest.mark.parametrize("seed", range(4))
def test_no_constant_is_found_where_there_is_none(seed: int) -> None:
    _, run = _flown(0.0, FIXES, seed=seed)
    tracker = run.fusion._history.advance(run.estimates[-1].t_ns)
    assert set(tracker.scores) == {"/gnss.delay", "/pose_fix.delay", "/pose_fix.heading"}
    for found in tracker.scores.values():
        assert not found.is_state
        assert found.score**2 < 16.0 * found.information
    assert "(sigma" not in run.health[-1].detail
    assert run.estimates[-1].t_ns > EPOCH_NS + 89 * SECOND


def test_what_the_sums_have_found_becomes_a_state_with_its_variance_and_moves_the_rest_by_their_covariance() -> None:
    eskf = Eskf(EPOCH_NS, _state(0.0), 0.01 * np.eye(E.SIZE), constants(ImuNoise(), Coast(), None))
    score.begin(DELAY, eskf, "/fix", U)
    v_n, before = _state(0.0)[X.V], eskf.cov[E.P, E.P].copy()
    information, tau_s = 1e4, 0.08  # a sigma of 10 ms; taken as 20 ms
    score.estimate(DELAY, eskf, "/fix", Sums(EPOCH_NS, information, tau_s * information, is_state=True))
    variance = 1.0 / (information / 4.0 + 1.0 / 0.1**2)  # the prior is 0.1 s
    found_s = tau_s * variance * information / 4.0
    assert eskf.slow.mean[-1] == pytest.approx(found_s, rel=1e-6)
    assert eskf.cov[-1, -1] == pytest.approx(variance, rel=1e-6)
    assert eskf.slow.estimated[-1] == 1.0
    np.testing.assert_allclose(eskf.x[X.P], v_n * found_s, rtol=1e-6)
    of_linear = tau_s**2 * (v_n @ v_n) * np.eye(3)
    np.testing.assert_allclose(eskf.cov[E.P, E.P], before + variance * np.outer(v_n, v_n) + of_linear, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("speed_m_s", "is_state"), [(0.1, False), (100.0, True)])
def test_a_delay_that_is_known_badly_is_no_state_however_unlikely_the_innovations(speed_m_s: float, is_state: bool) -> None:
    found, one = Sums(EPOCH_NS), np.eye(1)
    for k in range(20):
        hp = speed_m_s * 1e-4**2 * one  # E[nu tau]: the innovation would be speed x tau
        found = found.also(DELAY, EPOCH_NS + k * SECOND, Innovation(np.array([3.0]), one, hp, one, one, 9.0, 0.0), 0)
    assert found.score**2 > 36.0 * found.information
    assert found.is_state == is_state


@pytest.mark.parametrize("turn_deg_s", [0.0, 6.0])
@pytest.mark.parametrize("late", [True, False])
def test_with_another_source_a_constant_difference_is_no_delay(turn_deg_s: float, late: bool) -> None:
    """At 20 m/s, 1 m: as from a delay of 50 ms, which shows in turns alone."""
    noise, found, alone = 0.04 * np.eye(3), Sums(EPOCH_NS), Sums(EPOCH_NS)
    for k in range(60):
        course = math.radians(0.5 * turn_deg_s * k)
        v_n = 20.0 * np.array([math.cos(course), math.sin(course), 0.0])
        nu, hp = (-0.05 * v_n if late else np.array([-1.0, 0.0, 0.0])), -(1e-4**2) * v_n[:, None]
        seen = Innovation(nu, np.eye(3), hp, noise, noise, float(nu @ nu) / 0.04, 0.0)
        found = found.also(DELAY, EPOCH_NS + k * SECOND // 2, seen, 0, apart=True)
        alone = alone.also(DELAY, EPOCH_NS + k * SECOND // 2, seen, 0)
    assert alone.is_state
    assert found.is_state == (late and turn_deg_s > 0.0)
    if found.is_state:
        information, score = found.evidence
        assert score / information == pytest.approx(0.05, rel=0.05)


def test_a_reading_that_shares_errors_with_the_last_counts_less() -> None:
    seen = Innovation(np.array([3.0]), np.eye(1), 1e-7 * np.eye(1), np.eye(1), np.eye(1), 9.0, 0.0)
    whole, part = (Sums(EPOCH_NS).also(DELAY, EPOCH_NS, seen, 0, weight=weight) for weight in (1.0, 0.1))
    assert part.information == pytest.approx(0.1 * whole.information)
    assert part.score == pytest.approx(0.1 * whole.score)


@pytest.mark.parametrize(
    ("off", "counts"),
    [((6.0, 6.0), True), ((6.0, -6.0), False), ((60.0, 60.0), False)],
    ids=["explained", "not explained", "too long"],
)
def test_a_reading_beyond_the_gate_counts_where_it_shows_a_delay_and_nothing_else(off: tuple[float, float], counts: bool) -> None:
    hp, nu = 40.0 * 1e-4**2 * np.ones((2, 1)), np.array(off)  # 40 m/s x tau
    seen = Innovation(nu, np.eye(2), hp, np.eye(2), np.eye(2), float(nu @ nu), 0.0)
    found = Sums(EPOCH_NS)
    for k in range(3):
        assert not found.is_state
        found = found.also(DELAY, EPOCH_NS + k * SECOND, seen, 0, gate=11.6)
    assert found.readings == 3 * counts
    assert found.is_state == counts


LIVELY = """
duration_s = 50.0
[vehicle]
kind = "multirotor"
speed_m_s = 8.0
[imu]
rate_hz = 100.0
[pose_fix]
rate_hz = 2.0
sigma_m = [0.05, 0.05, 0.05]
sigma_deg = [0.3, 0.3, 0.3]
"""


def test_fixes_so_late_that_the_gate_refuses_them_are_found_to_be_late_and_not_refused_for_long() -> None:
    flight = simulated(LIVELY, seed=5)
    by_ns = 250_000_000
    messages = sorted(
        (
            replace(m, t_ns=m.t_ns + by_ns, arrived_ns=m.arrived_ns + by_ns) if isinstance(m, PoseFix) else m
            for m in flight.messages
        ),
        key=lambda m: m.arrived_ns,
    )
    run = fly(flight, messages=messages)
    found, sigma = _found_ms(run, "/pose_fix")
    assert abs(found - 250.0) < max(3.0 * sigma, 15.0)
    off = position_errors(within(run.estimates, 20.0, 50.0), flight.truth)
    assert math.sqrt((off**2).mean()) < 0.5


def test_what_is_left_of_the_configured_sigma_once_readings_have_shown_something() -> None:
    nothing, v_n = Sums(EPOCH_NS), np.array([20.0, 0.0, -5.0])
    vv = np.outer(v_n, v_n)
    np.testing.assert_allclose(_covariance(nothing, v_n), 0.02**2 * vv)
    assert delay.covariance(nothing, 0.0, v_n) is None
    assert delay.covariance(nothing, 0.02, 0.01 * v_n) is None  # 4 mm: less than counts
    a, b = 1e4, 1e2  # 10 ms, of a sigma of 10 ms
    some = Sums(EPOCH_NS, a, b)
    np.testing.assert_allclose(_covariance(some, v_n), (1.0 / 12500.0 + (100.0 / 12500.0) ** 2) * vv)
    assert delay.covariance(replace(some, is_state=True), 0.02, v_n) is None
    one = np.eye(1)
    later = some.also(DELAY, EPOCH_NS + 61 * SECOND, Innovation(np.zeros(1), one, 1e-12 * one, one, one, 0.0, 0.0), 0)
    assert later.information < a  # the sums are new; what the minute before has shown still counts
    np.testing.assert_array_equal(_covariance(later, v_n), _covariance(some, v_n))


def _covariance(found: Sums, v_n: Array) -> Array:
    cov = delay.covariance(found, 0.02, v_n)
    assert cov is not None
    assert np.count_nonzero(cov) == np.count_nonzero(cov[E.P, E.P])
    return cov[E.P, E.P]


STRAIGHT = """
duration_s = 60.0
[vehicle]
kind = "fixed_wing"
speed_m_s = [20.0, 24.0]
[imu]
rate_hz = 100.0
[pose_fix]
rate_hz = 2.0
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
"""


@pytest.mark.parametrize("seed", [1, 4])
def test_before_and_after_a_delay_is_found_the_radius_of_a_fast_vehicle_covers_it(seed: int) -> None:
    flight, by_ns = simulated(STRAIGHT, seed=seed), 80_000_000
    messages = [
        replace(m, t_ns=m.t_ns + by_ns, arrived_ns=m.arrived_ns + by_ns) if isinstance(m, PoseFix) else m for m in flight.messages
    ]
    run = fly(flight, messages=sorted(messages, key=lambda m: m.arrived_ns))
    found, sigma = _found_ms(run, "/pose_fix")
    assert abs(found - 80.0) < max(3.0 * sigma, 15.0)
    estimates = within(run.estimates, 2.0, 60.0)
    radius = radii(estimates)
    off = position_errors(estimates, flight.truth)
    assert off.max() > 1.0  # 80 ms at 22 m/s are 1.8 m
    assert (off < 3.0 * radius).all()


@pytest.mark.parametrize(("off_m", "is_explained"), [(6.0, True), (12.0, False)])
def test_a_receiver_that_is_farther_off_than_any_delay_explains_shows_none(off_m: float, is_explained: bool) -> None:
    x = _state(0.0)  # 5.9 m/s: 3 m in half a second, and 3 sigma of noise
    assert delay.explains(np.array([0.0, off_m, 0.0]), np.eye(3), x) == is_explained


def test_a_delay_that_fixes_may_have_stays_in_the_covariance_beside_gnss_and_goes_with_the_fixes() -> None:
    flight = simulated(STRAIGHT + "[gnss]\nrate_hz = 5.0\n", seed=2)
    end_ns = EPOCH_NS + 4 * SECOND
    run = fly(flight, messages=[m for m in flight.messages if not isinstance(m, PoseFix) or m.t_ns < end_ns])
    history = run.fusion._history
    assert history.tracker.late_cov is None  # GNSS alone since a minute, whose slow error covers its delay
    run = fly(flight, messages=[m for m in flight.messages if m.arrived_ns < end_ns])
    late_cov = run.fusion._history.tracker.late_cov
    assert late_cov is not None
    speed = 22.0
    assert 0.001 < late_cov.trace() <= (0.03 * speed) ** 2


def test_a_receiver_that_is_pulled_off_is_not_late() -> None:
    """From 20 s on by 5 m/s: its readings are beyond what a delay explains, but a part of them points along the motion."""
    flight, pull_ns = simulated(FLIGHT, seed=2), EPOCH_NS + 20 * SECOND

    def pulled(m: Input) -> Input:
        s = (m.t_ns - pull_ns) * 1e-9
        if isinstance(m, GnssFix) and s > 0.0:
            return replace(m, lat_deg=m.lat_deg + 5.0 * s / 111_320.0)
        return replace(m, v_n=(m.v_n[0] + 5.0, *m.v_n[1:])) if isinstance(m, GnssVelocity) and s > 0.0 else m

    messages = [pulled(m) for m in flight.messages if not isinstance(m, PoseFix) or m.t_ns < pull_ns]
    run = fly(flight, messages=messages)
    assert not any("stamps of /gnss" in h.detail for h in run.health)


def test_a_false_reading_of_a_vehicle_at_rest_shows_no_delay() -> None:
    """Where nothing moves, no reading depends on tau: the sums stay zero, and are divided by nothing."""
    one, nothing = np.ones((1, 1)), Sums(EPOCH_NS)
    seen = Innovation(np.array([50.0]), one, np.zeros((1, 1)), one, one, 2500.0, 0.0)
    assert nothing.also(DELAY, EPOCH_NS, seen, 0, gate=6.6) == nothing
