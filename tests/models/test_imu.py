"""The motion model against simulated truth, against an integrator of the tests' own, and against numerical differentiation."""

from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from models import imu, sampling, so3
from models.frames import GRAVITY, Origin
from models.imu import Coast, ImuNoise
from models.messages import Array
from models.sim.sensors import feel
from models.sim.trajectory import FixedWing, Motion, Multirotor, build
from models.state import E, X, local, retract
from tests.models.sim.strapdown import integrate

NOISE, COAST, ORIGIN = ImuNoise(), Coast(), Origin(47.4, 8.5, 500.0)
EPOCH_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000
NOTHING = np.zeros(0)


class Record(NamedTuple):
    """What a perfect IMU on a trajectory measures, and the motion itself."""

    t_ns: NDArray[np.int64]
    u: Array
    motion: Motion

    def state(self, k: int = 0) -> Array:
        x = np.zeros(X.SIZE)
        x[X.P], x[X.V], x[X.Q] = self.motion.p_n[k], self.motion.v_n[k], self.motion.q_nb_wxyz[k]
        return x


def _record(vehicle: Multirotor | FixedWing, duration_s: float, origin: Origin | None, from_s: float = 0.0) -> Record:
    trajectory = build(vehicle, from_s + duration_s, np.random.default_rng(4))
    since_ns = np.arange(0, round(duration_s * 1e9) + 1, STEP_NS)
    motion = trajectory.at(np.asarray(from_s + since_ns * 1e-9, dtype=np.float64))
    return Record(EPOCH_NS + since_ns, np.hstack(feel(motion, origin)), motion)


AGILE = _record(Multirotor(seed=2), 12.0, ORIGIN, from_s=8.0)


def _covariance() -> Array:
    a = np.random.default_rng(1).normal(size=(E.SIZE, E.SIZE))
    scale = np.repeat([1.0, 0.3, 0.02, 1e-3, 0.05], 3)
    return (a @ a.T / E.SIZE) * np.outer(scale, scale)


def _propagate(
    record: Record,
    x: Array,
    cov: Array,
    stops_ns: list[int],
    origin: Origin | None = ORIGIN,
    slow: tuple[Array, Array] = (NOTHING, NOTHING),
) -> tuple[Array, Array]:
    """Copies of x and cov, taken from the first of the instants to each of the others in turn."""
    x, cov, c = x.copy(), cov.copy(), imu.constants(NOISE, COAST, origin)
    for begin, end in pairwise(stops_ns):
        i = int(np.searchsorted(record.t_ns, begin, side="right"))
        unknown = np.zeros((len(record.t_ns), sampling.SIZE))
        assert imu.propagate(x, cov, record.t_ns, record.u, unknown, len(record.t_ns), i, begin, end, c, *slow)
    return x, cov


# --- the nominal state ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("vehicle", [Multirotor(seed=1), FixedWing(seed=1)])
def test_perfect_samples_lead_back_to_the_true_motion(vehicle: Multirotor | FixedWing) -> None:
    record = _record(vehicle, 60.0, ORIGIN)
    end, _ = _propagate(record, record.state(), _covariance(), [int(record.t_ns[0]), int(record.t_ns[-1])])
    error = local(end, record.state(-1))
    assert np.linalg.norm(error[E.P]) < 0.05
    assert np.linalg.norm(error[E.V]) < 2e-3
    assert np.linalg.norm(error[E.THETA]) < 1e-5


def test_without_the_earth_the_same_samples_lead_metres_away() -> None:
    record = _record(FixedWing(seed=1), 60.0, ORIGIN)
    end, _ = _propagate(record, record.state(), _covariance(), [int(record.t_ns[0]), int(record.t_ns[-1])], origin=None)
    assert np.linalg.norm(local(end, record.state(-1))[E.P]) > 3.0


@pytest.mark.parametrize("origin", [None, ORIGIN])
def test_agrees_with_an_independent_integrator(origin: Origin | None) -> None:
    record = _record(Multirotor(seed=2), 4.0, origin, from_s=8.0)
    m = record.motion
    end, _ = _propagate(record, record.state(), _covariance(), [int(record.t_ns[0]), int(record.t_ns[-1])], origin=origin)
    p, v, r = integrate((m.p_n[0], m.v_n[0], m.R_nb[0]), record.u[:, :3], record.u[:, 3:], STEP_NS * 1e-9, origin)
    np.testing.assert_allclose(end[X.P], p, atol=2e-4)
    np.testing.assert_allclose(end[X.V], v, atol=2e-4)
    np.testing.assert_allclose(so3.matrix(end[X.Q]), r, atol=1e-6)


def test_biases_are_taken_out_of_the_samples() -> None:
    biased = AGILE._replace(u=AGILE.u + np.array([0.01, -0.02, 0.03, 0.2, -0.1, 0.3]))
    x = AGILE.state()
    x[X.BG], x[X.BA] = (0.01, -0.02, 0.03), (0.2, -0.1, 0.3)
    stops = [int(AGILE.t_ns[0]), int(AGILE.t_ns[-1])]
    with_bias, _ = _propagate(biased, x, _covariance(), stops)
    without, _ = _propagate(AGILE, AGILE.state(), _covariance(), stops)
    np.testing.assert_allclose(local(without, with_bias)[: E.BG.start], 0.0, atol=1e-9)


def test_turning_about_a_turning_axis_is_exact_to_third_order() -> None:
    """Coning: the mean rate alone would be 8e-4 rad off in this one step of 50 ms."""
    w0, w1, fine = np.array([2.0, 0.0, 0.5]), np.array([0.0, 2.0, -0.5]), 2000
    t_ns = EPOCH_NS + np.array([0, 50_000_000])
    step = Record(t_ns, np.array([[*w0, 0.0, 0.0, -GRAVITY], [*w1, 0.0, 0.0, -GRAVITY]]), AGILE.motion)
    start = AGILE.state(0)
    end, _ = _propagate(step, start, _covariance(), t_ns.tolist(), origin=None)
    q = start[X.Q]
    for k in range(fine):
        q = so3.multiply(q, so3.quat_exp((w0 + (k + 0.5) / fine * (w1 - w0)) * 0.05 / fine))
    np.testing.assert_allclose(so3.quat_log(so3.multiply(so3.conjugate(q), end[X.Q])), 0.0, atol=2e-5)


# --- a batch, and any split of it ------------------------------------------------------------------------------------------


@given(st.sets(st.integers(1, 399), max_size=30))
def test_stops_at_samples_change_no_bit(at: set[int]) -> None:
    ends = [0, *sorted(at), 400]
    whole = _propagate(AGILE, AGILE.state(), _covariance(), AGILE.t_ns[[0, 400]].tolist())
    parts = _propagate(AGILE, AGILE.state(), _covariance(), AGILE.t_ns[ends].tolist())
    np.testing.assert_array_equal(whole[0], parts[0])
    np.testing.assert_array_equal(whole[1], parts[1])


def test_single_steps_change_no_bit_with_slow_errors_and_gaps() -> None:
    holed = Record(np.delete(AGILE.t_ns, np.s_[100:180]), np.delete(AGILE.u, np.s_[100:180], axis=0), AGILE.motion)
    slow = (np.array([30.0, np.inf]), np.array([0.03, 0.2]))
    cov = np.eye(E.SIZE + 2) * 0.1
    whole = _propagate(holed, holed.state(), cov, holed.t_ns[[0, 300]].tolist(), slow=slow)
    parts = _propagate(holed, holed.state(), cov, holed.t_ns[:301].tolist(), slow=slow)
    np.testing.assert_array_equal(whole[0], parts[0])
    np.testing.assert_array_equal(whole[1], parts[1])


@given(st.lists(st.integers(1, 2 * 10**9 - 1), min_size=1, max_size=20))
def test_stops_between_samples_agree_to_the_order_of_the_integrator(at_ns: list[int]) -> None:
    begin = int(AGILE.t_ns[0])
    stops = [begin, *sorted(begin + t for t in at_ns), begin + 2 * 10**9]
    whole = _propagate(AGILE, AGILE.state(), _covariance(), [stops[0], stops[-1]])
    parts = _propagate(AGILE, AGILE.state(), _covariance(), stops)
    np.testing.assert_allclose(local(whole[0], parts[0]), 0.0, atol=1e-6)
    scale = np.sqrt(np.diag(whole[1]))
    np.testing.assert_allclose((whole[1] - parts[1]) / np.outer(scale, scale), 0.0, atol=2e-5)


def test_an_instant_between_samples_uses_the_interpolated_sample() -> None:
    t_ns, u = AGILE.t_ns[:3], AGILE.u[:3]
    quarter = int(t_ns[1]) + STEP_NS // 4
    np.testing.assert_allclose(imu.interpolate(t_ns, u, 3, 2, quarter), 0.75 * u[1] + 0.25 * u[2], rtol=1e-12)
    np.testing.assert_array_equal(imu.interpolate(t_ns, u, 3, 0, int(t_ns[0]) - 1), u[0])
    np.testing.assert_array_equal(imu.interpolate(t_ns, u, 3, 3, int(t_ns[2]) + 1), u[2])


# --- the error transition ------------------------------------------------------------------------------------------------


def _differentiated(record: Record, x: Array, begin: int, end: int) -> Array:
    """d x1 / d dx by central differences on the manifold, of the kernel itself."""
    step = np.repeat([1e-2, 1e-3, 1e-5, 1e-5, 1e-4], 3)
    columns = []
    for k in range(E.SIZE):
        dx = np.zeros(E.SIZE)
        dx[k] = step[k]
        ahead, _ = _propagate(record, retract(x, dx), np.eye(E.SIZE), [begin, end])
        behind, _ = _propagate(record, retract(x, -dx), np.eye(E.SIZE), [begin, end])
        columns.append(local(behind, ahead) / (2.0 * step[k]))
    return np.array(columns).T


@pytest.mark.parametrize(
    ("start", "span_ns"), [(0, STEP_NS), (700, STEP_NS), (700, 3 * STEP_NS + STEP_NS // 3), (400, 400 * STEP_NS)]
)
def test_error_transition_is_the_derivative_of_the_kernel(start: int, span_ns: int) -> None:
    x = AGILE.state(start)
    x[X.BG], x[X.BA] = (0.01, -0.02, 0.03), (0.2, -0.1, 0.3)
    begin = int(AGILE.t_ns[start])
    c = imu.constants(NOISE, COAST, ORIGIN)
    phi = imu.transition(x, AGILE.t_ns, AGILE.u, len(AGILE.t_ns), start + 1, begin, begin + span_ns, c)
    numeric = _differentiated(AGILE, x, begin, begin + span_ns)
    dt = span_ns * 1e-9
    size = np.maximum(np.abs(numeric), 1e-3 * dt)  # blocks differ by powers of dt: each element is judged by its own size
    np.testing.assert_allclose((phi - numeric) / size.max(axis=1, keepdims=True), 0.0, atol=1e-4)
    np.testing.assert_allclose(phi[E.P, E.V], dt * np.eye(3), atol=2e-4 * dt)
    moved_by_gyro_bias = numeric[E.V, E.BG]
    np.testing.assert_allclose(phi[E.V, E.BG], moved_by_gyro_bias, atol=0.02 * np.abs(moved_by_gyro_bias).max() + 1e-9)


def test_covariance_is_carried_by_that_transition() -> None:
    begin, end = int(AGILE.t_ns[0]), int(AGILE.t_ns[200])
    cov = _covariance()
    x, with_p = _propagate(AGILE, AGILE.state(), cov, [begin, end])
    _, noise_alone = _propagate(AGILE, AGILE.state(), np.eye(E.SIZE) * 1e-300, [begin, end])
    phi = imu.transition(AGILE.state(), AGILE.t_ns, AGILE.u, len(AGILE.t_ns), 1, begin, end, imu.constants(NOISE, COAST, ORIGIN))
    expected = phi @ cov @ phi.T + noise_alone
    np.testing.assert_allclose(with_p, expected, rtol=1e-9, atol=1e-12)
    assert x.shape == (X.SIZE,)


def test_process_noise_is_that_of_the_continuous_model() -> None:
    """At rest the error model is constant: van Loan's integral (1978) of it must come out of two seconds of steps."""
    at_rest = Record(AGILE.t_ns[:401], np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY], (401, 1)), AGILE.motion)
    x = np.zeros(X.SIZE)
    x[X.Q] = (1.0, 0.0, 0.0, 0.0)
    _, cov = _propagate(at_rest, x, np.eye(E.SIZE) * 1e-300, at_rest.t_ns[[0, 400]].tolist(), origin=None)
    f, q = np.zeros((E.SIZE, E.SIZE)), np.zeros((E.SIZE, E.SIZE))
    f[E.P, E.V], f[E.V, E.THETA] = np.eye(3), -so3.skew(np.array([0.0, 0.0, -GRAVITY]))
    f[E.V, E.BA], f[E.THETA, E.BG] = -np.eye(3), -np.eye(3)
    q[E.V, E.V], q[E.THETA, E.THETA] = np.eye(3) * NOISE.accel_noise**2, np.eye(3) * NOISE.gyro_noise**2
    q[E.BG, E.BG], q[E.BA, E.BA] = np.eye(3) * NOISE.gyro_walk**2, np.eye(3) * NOISE.accel_walk**2
    block = expm(np.block([[-f, q], [np.zeros_like(f), f.T]]) * 2.0)
    expected = block[E.SIZE :, E.SIZE :].T @ block[: E.SIZE, E.SIZE :]
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose((cov - expected) / np.outer(scale, scale), 0.0, atol=5e-3)


def test_a_turn_is_uncertain_by_the_share_that_scale_and_axes_are_wrong() -> None:
    """Ten seconds at 30 and 40 degrees a second about two axes, the gyroscope's bias not counted: sigma^2 = s^2 |w|^2 T t."""
    w, bias = np.radians([30.0, 0.0, 40.0]), np.array([0.02, -0.01, 0.03])
    t_ns = EPOCH_NS + np.arange(2001) * 5_000_000
    unknown, x = np.zeros((len(t_ns), sampling.SIZE)), np.zeros(X.SIZE)
    x[X.Q], x[X.BG] = (1.0, 0.0, 0.0, 0.0), bias
    u = np.tile([*(w + bias), 0.0, 0.0, -GRAVITY], (len(t_ns), 1))
    variances = []
    for share in (0.0, 0.01):
        c, cov = imu.constants(msgspec.structs.replace(NOISE, gyro_scale=share), COAST, None), np.eye(E.SIZE) * 1e-300
        assert imu.propagate(x.copy(), cov, t_ns, u, unknown, len(t_ns), 1, int(t_ns[0]), int(t_ns[-1]), c, NOTHING, NOTHING)
        variances.append(np.diag(cov)[E.THETA])
    np.testing.assert_allclose(variances[1] - variances[0], 0.01**2 * (w @ w) * 1.0 * 10.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("axis", "at_end", "block", "coasting"), [(3, 20.0, E.V, COAST.accel_noise), (0, 5.0, E.THETA, COAST.gyro_noise)]
)
def test_a_saturated_sample_is_as_uncertain_as_a_missing_one(axis: int, at_end: float, block: slice, coasting: float) -> None:
    """An axis that goes from one end of its range to the other, so that it repeats the size of its largest reading to the bit."""
    t_ns = EPOCH_NS + np.arange(401) * STEP_NS
    unknown, x = np.zeros((len(t_ns), sampling.SIZE)), np.zeros(X.SIZE)
    x[X.Q] = (1.0, 0.0, 0.0, 0.0)
    c, variances = imu.constants(NOISE, COAST, None), []
    saturated = np.where(np.arange(401) % 2, at_end, -at_end)
    shaken = saturated * (1.0 + 1e-12 * np.arange(401))  # as large, never the same
    for readings in (saturated, shaken, 0.8 * saturated):  # the last: nobody's range ends there
        u = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY], (401, 1))
        u[:, axis] = readings
        cov = np.eye(E.SIZE) * 1e-300
        assert imu.propagate(x.copy(), cov, t_ns, u, unknown, 401, 1, int(t_ns[0]), int(t_ns[-1]), c, NOTHING, NOTHING)
        variances.append(max(np.diag(cov)[block]))
    assert variances[0] == pytest.approx(coasting**2 * 2.0, rel=0.05)  # over two seconds
    assert max(variances[1:]) < 0.1 * variances[0]


def test_covariance_stays_symmetric_and_positive() -> None:
    record = _record(Multirotor(seed=3), 120.0, ORIGIN)
    _, cov = _propagate(record, record.state(), _covariance(), record.t_ns[::7].tolist())
    np.testing.assert_array_equal(cov, cov.T)
    assert np.linalg.eigvalsh(cov / np.sqrt(np.outer(np.diag(cov), np.diag(cov))))[0] > 0.0


# --- slow errors that are considered ---------------------------------------------------------------------------------------


def test_considered_errors_stay_steady_and_forget_what_they_were_correlated_with() -> None:
    tau, sigma2 = np.array([2.0, np.inf]), np.array([0.25, 0.04])
    cov = np.zeros((E.SIZE + 2, E.SIZE + 2))
    cov[: E.SIZE, : E.SIZE] = np.eye(E.SIZE)
    cov[E.SIZE, E.SIZE], cov[E.SIZE + 1, E.SIZE + 1] = sigma2
    cov[E.BA.start, E.SIZE :] = cov[E.SIZE :, E.BA.start] = 0.1
    _, after = _propagate(AGILE, AGILE.state(), cov, AGILE.t_ns[[0, 400]].tolist(), slow=(tau, 2.0 * sigma2 / tau))
    np.testing.assert_allclose(np.diag(after)[E.SIZE :], sigma2, rtol=1e-9)
    np.testing.assert_allclose(after[E.BA.start, E.SIZE :], [0.1 * np.exp(-1.0), 0.1], rtol=1e-7)
    np.testing.assert_array_equal(after, after.T)
    _, plain = _propagate(AGILE, AGILE.state(), cov[: E.SIZE, : E.SIZE], AGILE.t_ns[[0, 400]].tolist())
    np.testing.assert_allclose(after[: E.SIZE, : E.SIZE], plain, rtol=1e-12)


def test_what_state_and_slow_errors_have_in_common_is_carried_by_the_transition() -> None:
    rng, begin, end = np.random.default_rng(3), int(AGILE.t_ns[0]), int(AGILE.t_ns[300])
    shared = rng.normal(size=(E.SIZE, 9)) * 0.01
    cov = np.block([[_covariance(), shared], [shared.T, np.eye(9)]])
    tau = np.where(np.arange(9) < 4, np.inf, 1.5)
    _, after = _propagate(AGILE, AGILE.state(), cov, [begin, end], slow=(tau, 2.0 / tau))
    phi = imu.transition(AGILE.state(), AGILE.t_ns, AGILE.u, len(AGILE.t_ns), 1, begin, end, imu.constants(NOISE, COAST, ORIGIN))
    expected = phi @ shared * np.exp(-(end - begin) * 1e-9 / tau)
    np.testing.assert_allclose(after[: E.SIZE, E.SIZE :], expected, atol=1e-12)
    np.testing.assert_array_equal(after[E.SIZE :, : E.SIZE], after[: E.SIZE, E.SIZE :].T)
    np.testing.assert_allclose(after[E.SIZE :, E.SIZE :], np.eye(9), atol=1e-12)


# --- without IMU ---------------------------------------------------------------------------------------------------------


def _silent_after(k: int) -> Record:
    return Record(AGILE.t_ns[: k + 1], AGILE.u[: k + 1], AGILE.motion)


def test_coasting_keeps_the_velocity_and_lets_the_turn_die_away() -> None:
    t_ns = EPOCH_NS + np.arange(3) * STEP_NS
    turning = Record(t_ns, np.tile([0.0, 0.0, 0.4, 0.0, 0.0, -GRAVITY], (3, 1)), AGILE.motion)
    x = np.zeros(X.SIZE)
    x[X.Q], x[X.V] = (1.0, 0.0, 0.0, 0.0), (10.0, 0.0, -1.0)
    end_ns = int(t_ns[-1])
    later, _ = _propagate(turning, x, _covariance(), [end_ns, end_ns + 60 * 10**9])
    yaw = 0.4 * COAST.turn_decay_s  # the integral of a rate that decays from 0.4 rad/s
    assert so3.to_euler(later[X.Q])[2] == pytest.approx(yaw, abs=1e-9)
    np.testing.assert_allclose(later[X.V], [10.0 * np.cos(yaw), 10.0 * np.sin(yaw), -1.0], atol=1e-9)


def test_coasting_noise_is_that_of_unknown_acceleration() -> None:
    record = _silent_after(100)
    begin = int(record.t_ns[-1])
    _, before = _propagate(record, record.state(100), _covariance(), [begin, begin + 1])
    _, after = _propagate(record, record.state(100), _covariance(), [begin, begin + 4 * 10**9])
    grown = np.diag(after)[E.V] - np.diag(before)[E.V]
    np.testing.assert_allclose(grown, 4.0 * COAST.accel_noise**2, rtol=0.05)
    np.testing.assert_array_equal(after, after.T)


def test_coasting_in_parts_ends_where_coasting_in_one_go_does() -> None:
    record = _silent_after(100)
    begin, end = int(record.t_ns[-1]), int(record.t_ns[-1]) + 2 * 10**9
    whole, _ = _propagate(record, record.state(100), _covariance(), [begin, end])
    parts, _ = _propagate(record, record.state(100), _covariance(), [begin, *range(begin + 10**8, end, 10**8), end])
    np.testing.assert_allclose(local(whole, parts)[E.THETA], 0.0, atol=0.05)  # rates about turned axes: equal to first order
    np.testing.assert_allclose(np.linalg.norm(whole[X.V]), np.linalg.norm(parts[X.V]), rtol=1e-12)


def test_a_gap_longer_than_configured_is_coasted_and_a_shorter_one_is_not() -> None:
    def noise_of_gap(samples: int) -> float:
        t_ns, u = np.delete(AGILE.t_ns, np.s_[1:samples]), np.delete(AGILE.u, np.s_[1:samples], axis=0)
        _, cov = _propagate(Record(t_ns, u, AGILE.motion), AGILE.state(), np.eye(E.SIZE) * 1e-9, t_ns[:2].tolist())
        return float(cov[E.V, E.V].trace() / (t_ns[1] - t_ns[0]))

    short, longer = noise_of_gap(round(COAST.gap_s * 1e9) // STEP_NS), noise_of_gap(round(COAST.gap_s * 1e9) // STEP_NS + 1)
    assert longer / short == pytest.approx((COAST.accel_noise / NOISE.accel_noise) ** 2, rel=0.05)


def test_before_the_first_sample_the_state_coasts_straight_on() -> None:
    x = AGILE.state()
    x[X.V] = (3.0, 2.0, 1.0)
    begin = int(AGILE.t_ns[0]) - 10**9
    at_first, _ = _propagate(AGILE, x, _covariance(), [begin, int(AGILE.t_ns[0])])
    np.testing.assert_allclose(at_first[X.P], x[X.P] + x[X.V], atol=1e-9)
    np.testing.assert_allclose(at_first[X.Q], x[X.Q], atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_state_that_is_not_finite_is_reported(bad: float) -> None:
    x, cov, c = AGILE.state(), _covariance(), imu.constants(NOISE, COAST, ORIGIN)
    x[X.V][0] = bad
    begin, end = AGILE.t_ns[:2].tolist()
    unknown = np.zeros((len(AGILE.t_ns), sampling.SIZE))
    assert not imu.propagate(x, cov, AGILE.t_ns, AGILE.u, unknown, len(AGILE.t_ns), 1, begin, end, c, NOTHING, NOTHING)
