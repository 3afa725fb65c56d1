"""One filter: update, injection and reset on the manifold, errors that are considered but never corrected."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.filter.eskf import Eskf, Innovation, inject
from estimator.filter.imu_buffer import ImuBuffer
from models import so3
from models.imu import Coast, ImuNoise, constants
from models.measurements import Height, Pose, Position
from models.messages import Array, ImuSample
from models.state import E, X, local, retract

GYRO = np.zeros(3)
CONSTANTS = constants(ImuNoise(), Coast(), None)
SIGMA = np.repeat([2.0, 0.5, 0.05, 1e-3, 0.1], 3)


def _truth() -> Array:
    x = np.random.default_rng(8).normal(size=X.SIZE)
    x[X.Q] = so3.normalise(x[X.Q])
    return x


def _covariance(seed: int = 1) -> Array:
    a = np.random.default_rng(seed).normal(size=(E.SIZE, 3 * E.SIZE))
    return (a @ a.T / (3 * E.SIZE)) * np.outer(SIGMA, SIGMA)


def _filter(x: Array | None = None) -> Eskf:
    return Eskf(0, (_truth() if x is None else x).copy(), _covariance(), CONSTANTS)


def _pose_of(x: Array, sigma: float) -> Pose:
    return Pose(x[X.P].copy(), x[X.Q].copy(), np.eye(6) * sigma**2, np.arange(6))


def test_a_precise_pose_takes_the_estimate_to_the_truth() -> None:
    truth = _truth()
    dx = np.random.default_rng(2).multivariate_normal(np.zeros(E.SIZE), _covariance())
    eskf = _filter(retract(truth, dx))
    eskf.update(eskf.innovation(_pose_of(truth, 1e-5), GYRO))
    left = local(eskf.x, truth)
    np.testing.assert_allclose(left[E.P], 0.0, atol=1e-3)
    np.testing.assert_allclose(left[E.THETA], 0.0, atol=1e-3)
    assert eskf.sound
    np.testing.assert_array_equal(eskf.cov, eskf.cov.T)
    assert np.sqrt(np.diag(eskf.cov)[E.P]).max() < 2e-5


@pytest.mark.parametrize("scale", [1.0, 1e6])
@pytest.mark.parametrize("least", [1e-150, 1e-15])
@pytest.mark.parametrize("largest", [1.0, 1e19])
def test_a_covariance_stays_positive_definite_however_exact_a_reading_is(scale: float, least: float, largest: float) -> None:
    x, rng = _truth(), np.random.default_rng(0)
    eskf = Eskf(0, x.copy(), scale * _covariance(), CONSTANTS)
    for _ in range(20):
        noise = np.diag(np.where(rng.random(6) < 0.5, least, largest))
        eskf.update(eskf.innovation(Pose(x[X.P].copy(), x[X.Q].copy(), noise, np.arange(6)), GYRO))
        np.linalg.cholesky(eskf.cov)
    assert eskf.sound


def test_the_errors_are_as_large_as_the_covariance_reports_before_and_after_an_update() -> None:
    """NEES over draws of prior and measurement; every bound two-sided."""
    rng, truth, lever = np.random.default_rng(3), _truth(), np.array([0.5, 0.0, 0.2])
    antenna = truth[X.P] + so3.matrix(truth[X.Q]) @ lever
    nees = []
    for _ in range(400):
        eskf = _filter(retract(truth, rng.multivariate_normal(np.zeros(E.SIZE), _covariance())))
        read = antenna + 0.7 * rng.standard_normal(3)
        eskf.update(eskf.innovation(Position(read, np.eye(3) * 0.49, np.arange(3), lever), GYRO))
        error = local(eskf.x, truth)
        nees.append(error @ np.linalg.solve(eskf.cov, error))
    assert 14.2 < float(np.mean(nees)) < 15.8  # mean of 400 chi-squares of 15 degrees of freedom: 15 +- 0.27


def test_injection_is_the_retraction_and_turns_the_covariance_with_it() -> None:
    x, cov, dx = _truth(), _covariance(), 0.2 * np.random.default_rng(4).normal(size=E.SIZE)
    injected, turned = x.copy(), cov.copy()
    assert inject(injected, turned, dx)
    np.testing.assert_allclose(local(injected, retract(x, dx)), 0.0, atol=1e-12)
    g = np.eye(E.SIZE)
    g[E.THETA, E.THETA] -= so3.skew(0.5 * dx[E.THETA])
    np.testing.assert_allclose(turned, g @ cov @ g.T, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(turned, turned.T)


def test_reset_jacobian_is_the_derivative_of_the_error_after_injection() -> None:
    """theta' = log(exp(-d) exp(theta)) near theta = d: to first order in d, I - [d/2]x."""
    d, step = np.array([0.02, -0.03, 0.01]), 1e-6
    columns = [
        (
            so3.quat_log(so3.multiply(so3.quat_exp(-d), so3.quat_exp(d + step * unit)))
            - so3.quat_log(so3.multiply(so3.quat_exp(-d), so3.quat_exp(d - step * unit)))
        )
        / (2.0 * step)
        for unit in np.eye(3)
    ]
    x, cov = _truth(), np.zeros((E.SIZE, E.SIZE))
    cov[E.THETA, E.THETA] = np.diag([1.0, 2.0, 3.0])
    dx = np.zeros(E.SIZE)
    dx[E.THETA] = d
    inject(x, cov, dx)
    g = np.array(columns).T
    np.testing.assert_allclose(cov[E.THETA, E.THETA], g @ np.diag([1.0, 2.0, 3.0]) @ g.T, atol=3.0 * float(d @ d))
    assert np.abs(cov[E.THETA, E.THETA] - np.diag([1.0, 2.0, 3.0])).max() > 5e-3


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_update_that_ruins_the_state_is_reported(bad: float) -> None:
    eskf = _filter()
    seen = eskf.innovation(_pose_of(_truth(), 0.1), GYRO)
    with np.errstate(invalid="ignore"):
        eskf.update(Innovation(np.full(6, bad), seen.h, seen.hp, seen.noise, seen.s, seen.distance2, seen.logdet))
    assert not eskf.sound


def test_innovation_has_a_likelihood() -> None:
    eskf = _filter()
    z = Position(_truth()[X.P] + [0.5, -0.3, 0.2], np.eye(3), np.arange(3), np.zeros(3))
    seen = eskf.innovation(z, GYRO)
    s = seen.h @ eskf.cov @ seen.h.T + np.eye(3)
    density = math.exp(-0.5 * seen.nu @ np.linalg.solve(s, seen.nu)) / math.sqrt((2.0 * math.pi) ** 3 * np.linalg.det(s))
    assert seen.log_likelihood == pytest.approx(math.log(density), rel=1e-12)
    assert seen.distance2 == pytest.approx(seen.nu @ np.linalg.solve(s, seen.nu), rel=1e-12)


# --- considered errors -----------------------------------------------------------------------------------------------------


def _schmidt(cov: Array, seen: Innovation) -> tuple[Array, Array]:
    """Schmidt's gain: that of the optimal filter for the estimated part, zero for the considered; then Joseph's form."""
    gain = cov @ seen.h.T @ np.linalg.inv(seen.h @ cov @ seen.h.T + seen.noise)
    gain[E.SIZE :] = 0.0
    keep = np.eye(len(cov)) - gain @ seen.h
    return gain @ seen.nu, keep @ cov @ keep.T + gain @ seen.noise @ gain.T


def test_consideration_is_the_schmidt_kalman_filter() -> None:
    eskf = _filter()
    eskf.consider("map", np.eye(6) * 0.09, 1e9)
    for offset in (0.3, -0.2):
        z = _pose_of(retract(_truth(), np.full(E.SIZE, offset) * SIGMA), 0.1)
        seen = eskf.innovation(z, GYRO, [("map", None)])
        dx, expected = _schmidt(eskf.cov, seen)
        before = eskf.x.copy()
        eskf.update(seen)
        np.testing.assert_allclose(local(before, eskf.x), dx[: E.SIZE], atol=1e-9)
        g = np.eye(len(expected))
        g[E.THETA, E.THETA] -= so3.skew(0.5 * dx[E.THETA])
        np.testing.assert_allclose(eskf.cov, g @ expected @ g.T, atol=1e-9)
        np.testing.assert_array_equal(eskf.cov[E.SIZE :, E.SIZE :], np.eye(6) * 0.09)
        assert np.linalg.eigvalsh(eskf.cov)[0] > 0.0


def test_fixes_with_a_common_error_never_make_the_filter_more_certain_than_that_error() -> None:
    considered, white = _filter(), _filter()
    considered.consider("map", np.eye(6) * 0.3**2, 1e9)
    for _ in range(60):
        considered.update(considered.innovation(_pose_of(_truth(), 0.1), GYRO, [("map", None)]))
        white.update(white.innovation(_pose_of(_truth(), math.hypot(0.1, 0.3)), GYRO))
    assert np.sqrt(np.diag(considered.cov)[E.P]).min() > 0.27
    assert np.sqrt(np.diag(white.cov)[E.P]).max() < 0.05


def test_a_block_shifts_only_the_components_that_were_given() -> None:
    eskf = _filter()
    eskf.consider("gnss", np.diag([1.0, 2.0, 3.0]), 60.0)
    eskf.consider("map", np.diag([4.0, 5.0, 6.0, 7.0, 8.0, 9.0]), 1e9)
    x = _truth()
    rows = np.array([1, 2, 5])
    seen = eskf.innovation(Pose(x[X.P], x[X.Q], np.eye(3), rows), GYRO, [("map", None)])
    assert seen.h.shape == (3, E.SIZE + 9)
    np.testing.assert_array_equal(seen.h[:, E.SIZE + 3 :], np.eye(6)[rows])
    np.testing.assert_array_equal(seen.h[:, E.SIZE : E.SIZE + 3], 0.0)
    plain = eskf.innovation(Pose(x[X.P], x[X.Q], np.eye(3), rows), GYRO)
    np.testing.assert_array_equal(plain.h[:, E.SIZE :], 0.0)


def test_a_block_once_known_stays_as_it_is() -> None:
    eskf = _filter()
    eskf.consider("map", np.eye(6) * 0.09, 1e9)
    eskf.consider("map", np.eye(6) * 4.0, 10.0)
    assert eskf.cov.shape == (E.SIZE + 6, E.SIZE + 6)
    np.testing.assert_array_equal(eskf.slow.psd, np.full(6, 2.0 * 0.09 / 1e9))
    np.testing.assert_array_equal(eskf.slow.tau_s, np.full(6, 1e9))


def _moved(k: int) -> Array:
    """How a pose is moved by four errors of landmark k."""
    return np.random.default_rng(k).standard_normal((6, 4)) * 0.1


def test_what_is_forgotten_leaves_the_others_as_they_were() -> None:
    both, one = _filter(), _filter()
    for eskf, blocks in ((both, "abc"), (one, "ac")):
        for name in blocks:
            eskf.consider(name, np.eye(4), 1e9)
    for name in "ac":
        for eskf in (both, one):
            eskf.update(eskf.innovation(_pose_of(_truth(), 0.1), GYRO, [(name, _moved(ord(name)))]))
    both.forget("b")
    assert both.slow.columns == one.slow.columns
    np.testing.assert_allclose(both.cov, one.cov, atol=1e-15)
    for eskf in (both, one):
        eskf.update(eskf.innovation(_pose_of(_truth(), 0.1), GYRO, [("a", _moved(9)), ("c", _moved(8))]))
    np.testing.assert_allclose(both.cov, one.cov, atol=1e-15)
    np.testing.assert_allclose(both.x, one.x, atol=1e-15)


# --- slow errors that are estimated ----------------------------------------------------------------------------------------


def _zero_and_slope(x: Array) -> Array:
    return np.array([[1.0, -x[X.P][2]]])


def test_an_unknown_zero_is_set_by_the_first_reading_which_then_does_not_measure_the_state() -> None:
    eskf, z = _filter(), Height(240.0, np.array([[0.5]]))
    x, cov = eskf.x.copy(), eskf.cov.copy()
    eskf.consider("baro", np.diag([0.0, 0.04**2]), math.inf, walk=np.array([0.01, 0.0]))
    eskf.zero("baro", eskf.innovation(z, GYRO, [("baro", _zero_and_slope(x))]))
    seen = eskf.innovation(z, GYRO, [("baro", _zero_and_slope(x))])
    assert seen.nu[0] == pytest.approx(0.0, abs=1e-12)
    assert eskf.slow.mean[0] == pytest.approx(240.0 + x[X.P][2])
    eskf.update(seen)
    np.testing.assert_allclose(eskf.x, x, atol=1e-12)
    np.testing.assert_allclose(eskf.cov[: E.SIZE, : E.SIZE], cov, atol=1e-12)


def test_the_zero_is_as_uncertain_as_height_and_reading_and_goes_with_the_height() -> None:
    eskf, z = _filter(), Height(240.0, np.array([[0.5]]))
    slope = _zero_and_slope(eskf.x)
    down, zero, temperature = E.P.stop - 1, E.SIZE, E.SIZE + 1
    eskf.consider("baro", np.diag([0.0, 0.04**2]), math.inf, walk=np.array([0.01, 0.0]))
    eskf.zero("baro", eskf.innovation(z, GYRO, [("baro", slope)]))
    height = eskf.cov[down, down]
    assert eskf.cov[zero, zero] == pytest.approx(height + 0.5 + (0.04 * slope[0, 1]) ** 2)
    assert eskf.cov[zero, down] == pytest.approx(height)  # too deep by as much as the zero is too high
    assert eskf.cov[zero, temperature] == pytest.approx(-slope[0, 1] * 0.04**2)


def test_estimation_is_the_kalman_filter_of_the_larger_state() -> None:
    eskf, z = _filter(), Height(240.0, np.array([[0.5]]))
    slope = _zero_and_slope(eskf.x)
    eskf.consider("map", np.eye(6) * 0.09, 1e9)
    eskf.consider("baro", np.diag([0.0, 0.04**2]), math.inf, walk=np.array([0.01, 0.0]))
    eskf.zero("baro", eskf.innovation(z, GYRO, [("baro", slope)]))
    seen = eskf.innovation(Height(243.0, np.array([[0.5]])), GYRO, [("baro", slope)])
    assert seen.nu[0] == pytest.approx(3.0)
    gain = (eskf.cov @ seen.h.T / seen.s)[:, 0]
    mean, block = eskf.slow.mean.copy(), eskf.cov[-2:, -2:] - np.outer(gain, gain)[-2:, -2:] * seen.s
    eskf.update(seen)
    np.testing.assert_allclose(eskf.slow.mean[-2:], mean[-2:] + 3.0 * gain[-2:], rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(eskf.slow.mean[:-2], 0.0)  # the map's error is considered
    np.testing.assert_allclose(eskf.cov[-2:, -2:], block, atol=1e-12)


def test_only_what_is_considered_is_put_back_not_its_correlation_with_what_is_estimated() -> None:
    eskf, z = _filter(), Height(240.0, np.array([[0.5]]))
    slope = _zero_and_slope(eskf.x)
    eskf.consider("map", np.eye(6) * 0.09, 1e9)
    eskf.update(eskf.innovation(_pose_of(_truth(), 0.1), GYRO, [("map", None)]))  # from now on the state knows of the map
    eskf.consider("baro", np.diag([0.0, 0.04**2]), math.inf, walk=np.array([0.01, 0.0]))
    eskf.zero("baro", eskf.innovation(z, GYRO, [("baro", slope)]))
    before, seen = eskf.cov.copy(), eskf.innovation(_pose_of(_truth(), 0.2), GYRO, [("map", None)])
    full = before - before @ seen.h.T @ np.linalg.solve(seen.s, seen.h @ before)
    by_filterpy = eskf.copy()
    assert inject(by_filterpy.x, by_filterpy.cov, by_filterpy.correct(seen))
    eskf.update(seen)
    np.testing.assert_allclose(by_filterpy.x, eskf.x, atol=1e-12)
    np.testing.assert_allclose(by_filterpy.cov, eskf.cov, atol=1e-12)
    np.testing.assert_allclose(by_filterpy.slow.mean, eskf.slow.mean, atol=1e-12)
    mapped, baro = slice(E.SIZE, E.SIZE + 6), slice(E.SIZE + 6, E.SIZE + 8)
    np.testing.assert_array_equal(eskf.cov[mapped, mapped], before[mapped, mapped])
    np.testing.assert_allclose(eskf.cov[mapped, baro], full[mapped, baro], atol=1e-12)
    np.testing.assert_array_equal(eskf.cov[baro, mapped], eskf.cov[mapped, baro].T)
    assert np.abs(full - before)[mapped, baro].max() > 1e-4


def test_an_estimated_error_walks() -> None:
    eskf, samples = _filter(), _at_rest(2001)
    eskf.consider("baro", np.diag([1.0, 0.04**2]), math.inf, walk=np.array([0.01, 0.0]))
    eskf.propagate(samples, 1, 10 * 10**9)
    assert eskf.cov[E.SIZE, E.SIZE] == pytest.approx(1.1, rel=1e-6)
    assert eskf.cov[E.SIZE + 1, E.SIZE + 1] == pytest.approx(0.04**2, rel=1e-6)


_SMOOTH = ImuNoise(gyro_noise=1e-3, gyro_walk=1e-9)


# --- propagation, copies ---------------------------------------------------------------------------------------------------


def _at_rest(count: int) -> ImuBuffer:
    buffer = ImuBuffer()
    for k in range(count):
        buffer.insert(ImuSample(k * 5_000_000, k * 5_000_000, (0.0, 0.0, 0.1), (0.1, 0.0, -9.8)))
    return buffer


def _drifted(shaken: float, *, gap: bool) -> float:
    """Variance per second that attitude gains at 50 Hz, in units of the gyroscope's, from 10 s to 20 s.

    shaken: standard deviation of samples that were not averaged, rad/s; gap: one sample in ten is missing, so a fifth of the time
    is bridged.
    """
    rng, samples = np.random.default_rng(4), ImuBuffer()
    for k in range(1001):
        if not (gap and k % 10 == 5):
            gyro, t_ns = rng.normal(0.0, shaken, 3), k * 20_000_000
            samples.insert(ImuSample(t_ns, t_ns, tuple(gyro.tolist()), (0.0, 0.0, -9.8)))
    x = np.zeros(X.SIZE)
    x[X.Q] = 1.0, 0.0, 0.0, 0.0
    eskf = Eskf(0, x, 1e-12 * np.eye(E.SIZE), constants(_SMOOTH, Coast(), None))
    variances = []
    for t_ns in (10**10, 2 * 10**10):
        eskf.propagate(samples, samples.first_after(eskf.t_ns), t_ns)
        variances.append(float(np.trace(eskf.cov[E.THETA, E.THETA])) / 3.0)
    return (variances[1] - variances[0]) / 10.0 / _SMOOTH.gyro_noise**2


def test_shaking_that_the_rate_does_not_resolve_is_noise_of_the_turn() -> None:
    assert _drifted(0.0, gap=False) == pytest.approx(1.0, rel=1e-3)
    assert _drifted(0.5 * _SMOOTH.gyro_noise * 50**0.5, gap=False) == pytest.approx(1.0, rel=1e-3)
    assert _drifted(4.0 * _SMOOTH.gyro_noise * 50**0.5, gap=False) == pytest.approx(16.0, rel=0.2)
    assert _drifted(0.9 * _SMOOTH.gyro_noise * 50**0.5, gap=True) == pytest.approx(1.0 + 0.2 * 0.9**2, rel=0.06)


def test_a_copy_goes_its_own_way() -> None:
    eskf, samples = _filter(), _at_rest(201)
    other = eskf.copy()
    other.propagate(samples, 1, 10**9)
    other.consider("map", np.eye(6), 1e9)
    assert (eskf.t_ns, other.t_ns) == (0, 10**9)
    np.testing.assert_array_equal(eskf.x, _truth())
    np.testing.assert_array_equal(eskf.cov, _covariance())
    assert eskf.slow.columns == {}


def test_widening_adds_an_error_of_position_velocity_and_attitude_that_nothing_else_knows_of() -> None:
    eskf = _filter()
    eskf.widen(3.0)
    added = eskf.cov - _covariance()
    np.testing.assert_allclose(added[:9, :9], 8.0 * _covariance()[:9, :9], rtol=1e-12)
    assert not added[9:].any()
    assert not added[:, 9:].any()


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), factor=st.floats(1.0, 100.0))
def test_no_error_becomes_less_likely_by_widening(seed: int, factor: float) -> None:
    """e^T P^-1 e of any error, however strongly the biases are correlated with the rest, is no larger than before."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((E.SIZE, E.SIZE)) * np.geomspace(1.0, 1e-2, E.SIZE)
    eskf, error = _filter(), rng.standard_normal(E.SIZE)
    eskf.cov = root @ root.T
    before = error @ np.linalg.solve(eskf.cov, error)
    eskf.widen(factor)
    assert error @ np.linalg.solve(eskf.cov, error) <= before * (1.0 + 1e-6)
