import itertools
import math

import numpy as np
import pytest

from models import so3
from models.frames import Origin
from models.messages import Array, GnssFix, GnssVelocity, PoseFix
from models.sim.aids import FalseSpan, Gnss, PoseFixes, make_pose_fixes, receive_gnss
from models.sim.trajectory import Motion, Multirotor, Trajectory, build

ORIGIN = Origin(47.4, 8.5, 450.0)
EPOCH_NS = 1_700_000_000_000_000_000
DURATION_S = 400.0
SILENT = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    return build(Multirotor(), DURATION_S, np.random.default_rng(2))


def truth_at(trajectory: Trajectory, messages: list[GnssFix] | list[GnssVelocity] | list[PoseFix]) -> Motion:
    return trajectory.at(np.array([(m.t_ns - EPOCH_NS) * 1e-9 for m in messages]))


def receive(trajectory: Trajectory, gnss: Gnss, seed: int = 1) -> tuple[list[GnssFix], list[GnssVelocity]]:
    messages = receive_gnss(gnss, trajectory, ORIGIN, EPOCH_NS, np.random.default_rng(seed))
    return [m for m in messages if isinstance(m, GnssFix)], [m for m in messages if isinstance(m, GnssVelocity)]


def fixes_of(trajectory: Trajectory, source: PoseFixes, seed: int = 1) -> list[PoseFix]:
    return make_pose_fixes(source, trajectory, EPOCH_NS, np.random.default_rng(seed))[0]


def position_errors(trajectory: Trajectory, fixes: list[GnssFix]) -> Array:
    return np.array([ORIGIN.to_ned(f.lat_deg, f.lon_deg, f.alt_m) for f in fixes]) - truth_at(trajectory, fixes).p_n


def attitude_errors(trajectory: Trajectory, fixes: list[PoseFix]) -> Array:
    """dtheta_n with R_true = exp(dtheta_n) R_measured."""
    true = truth_at(trajectory, fixes).q_nb_wxyz
    return np.array(
        [so3.quat_log(so3.multiply(q, so3.conjugate(np.array(f.q_nb_wxyz)))) for q, f in zip(true, fixes, strict=True)]
    )


def is_covariance(covariance: Array | None, expected: Array) -> None:
    assert covariance is not None
    np.testing.assert_allclose(covariance, expected)


def mean_square_is(x: Array, variance: float) -> None:
    assert np.mean(np.square(x)) / variance == pytest.approx(1.0, abs=4.5 * math.sqrt(2.0 / x.size))


def test_gnss_errors_have_the_reported_covariance(trajectory: Trajectory) -> None:
    gnss = Gnss(rate_hz=10.0, sigma_m=(0.5, 1.0, 2.0), velocity_sigma_m_s=(0.1, 0.2, 0.3))
    fixes, velocities = receive(trajectory, gnss)
    assert len(fixes) == len(velocities) == 4000
    errors = position_errors(trajectory, fixes)
    speed_errors = np.array([v.v_n for v in velocities]) - truth_at(trajectory, velocities).v_n
    for k in range(3):
        mean_square_is(errors[:, k], gnss.sigma_m[k] ** 2)
        mean_square_is(speed_errors[:, k], gnss.velocity_sigma_m_s[k] ** 2)
    is_covariance(fixes[0].covariance_n, np.diag([0.25, 1.0, 4.0]))
    is_covariance(velocities[0].covariance_n, np.diag([0.01, 0.04, 0.09]))


def test_antenna_is_carried_and_swung_by_the_body(trajectory: Trajectory) -> None:
    lever = (0.5, -0.3, -0.2)
    fixes, velocities = receive(trajectory, Gnss(sigma_m=SILENT[0], velocity_sigma_m_s=SILENT[0], antenna_b_m=lever))
    motion = truth_at(trajectory, fixes)
    np.testing.assert_allclose(position_errors(trajectory, fixes), motion.R_nb @ np.array(lever), atol=1e-6)
    # The velocity is the derivative of the antenna's place.
    t, h = np.array([(v.t_ns - EPOCH_NS) * 1e-9 for v in velocities[1:-1]]), 1e-4
    later, earlier = trajectory.at(t + h), trajectory.at(t - h)
    place = (later.p_n + later.R_nb @ np.array(lever) - earlier.p_n - earlier.R_nb @ np.array(lever)) / (2 * h)
    np.testing.assert_allclose([v.v_n for v in velocities[1:-1]], place, atol=1e-5)


def test_slow_gnss_error_is_gauss_markov_and_reported(trajectory: Trajectory) -> None:
    gnss = Gnss(rate_hz=10.0, sigma_m=SILENT[0], slow_sigma_m=2.0, slow_tau_s=5.0)
    slow = np.concatenate([position_errors(trajectory, receive(trajectory, gnss, seed)[0]) for seed in range(4)], axis=1)
    # 400 s of 5 s correlation in 12 axes: about 480 independent draws.
    assert np.mean(slow**2) == pytest.approx(4.0, rel=0.25)
    kept = math.exp(-0.1 / 5.0)
    mean_square_is(slow[1:] - kept * slow[:-1], 4.0 * (1 - kept**2))
    is_covariance(receive(trajectory, gnss)[0][0].covariance_n, 4.0 * np.eye(3))


def test_delay_moves_arrival_only_and_nothing_arrives_after_the_end(trajectory: Trajectory) -> None:
    punctual, late = (fixes_of(trajectory, PoseFixes(delay_s=d)) for d in (0.0, (0.5, 3.0)))
    assert [f.p_n for f in punctual] == [f.p_n for f in late]
    assert [f.t_ns for f in punctual] == [f.t_ns for f in late]
    assert all(f.t_ns == f.arrived_ns for f in punctual)
    end_ns = EPOCH_NS + round(DURATION_S * 1e9)
    delays = np.array([(f.arrived_ns - f.t_ns) * 1e-9 for f in late if f.t_ns < end_ns - 3 * 10**9])
    assert 0.5 <= delays.min() < 0.6
    assert 2.9 < delays.max() <= 3.0
    assert delays.mean() == pytest.approx(1.75, abs=0.15)
    assert max(f.arrived_ns for f in late) == end_ns
    assert any(b.arrived_ns < a.arrived_ns for a, b in itertools.pairwise(late))  # they overtake each other


def test_constant_delay_and_stamp_lag(trajectory: Trajectory) -> None:
    plain, _ = receive(trajectory, Gnss())
    lagging, _ = receive(trajectory, Gnss(delay_s=0.2, stamp_lag_s=0.12))
    assert {f.arrived_ns - p.arrived_ns for f, p in zip(lagging[:-2], plain, strict=False)} == {200_000_000}
    assert {f.t_ns - p.t_ns for f, p in zip(lagging, plain, strict=True)} == {120_000_000}


def test_outages_are_silent(trajectory: Trajectory) -> None:
    outages = ((50.0, 80.0), (200.0, 230.5))
    gnss, _ = receive(trajectory, Gnss(outages_s=outages))
    for messages, rate in ((gnss, 5.0), (fixes_of(trajectory, PoseFixes(outages_s=outages)), 2.0)):
        t = np.array([(m.t_ns - EPOCH_NS) * 1e-9 for m in messages])
        assert not any(((t >= a) & (t < b)).any() for a, b in outages)
        assert len(t) == pytest.approx(rate * (DURATION_S - 60.5), abs=3)


def test_pose_fix_errors_are_about_the_axes_of_n_and_have_the_covariance(trajectory: Trajectory) -> None:
    source = PoseFixes(rate_hz=10.0, sigma_m=(0.1, 0.2, 0.3), sigma_deg=(0.5, 1.0, 3.0))
    fixes = fixes_of(trajectory, source)
    p_errors = np.array([f.p_n for f in fixes]) - truth_at(trajectory, fixes).p_n
    theta = attitude_errors(trajectory, fixes)
    for k in range(3):
        mean_square_is(p_errors[:, k], source.sigma_m[k] ** 2)
        mean_square_is(theta[:, k], math.radians(source.sigma_deg[k]) ** 2)
    np.testing.assert_allclose(np.sqrt(np.diag(fixes[0].covariance)), [0.1, 0.2, 0.3, *np.radians(source.sigma_deg)])
    assert fixes[0].covariance_common is None


@pytest.mark.parametrize("reported", [True, False])
def test_common_error_is_the_same_for_all_fixes_of_a_run(trajectory: Trajectory, reported: bool) -> None:
    source = PoseFixes(
        rate_hz=0.5, sigma_m=SILENT[0], sigma_deg=SILENT[0], common_sigma_m=0.5, common_sigma_deg=2.0, common_reported=reported
    )
    draws = []
    for seed in range(100):
        fixes = fixes_of(trajectory, source, seed)[::40]
        p, theta = np.array([f.p_n for f in fixes]) - truth_at(trajectory, fixes).p_n, attitude_errors(trajectory, fixes)
        np.testing.assert_allclose(p, np.tile(p[0], (len(p), 1)), atol=1e-9)
        np.testing.assert_allclose(theta, np.tile(theta[0], (len(p), 1)), atol=1e-9)
        draws.append([p[0], theta[0]])
    mean_square_is(np.array(draws)[:, 0], 0.25)
    mean_square_is(np.array(draws)[:, 1], math.radians(2.0) ** 2)
    common = fixes[0].covariance_common
    if reported:
        assert common is not None
        np.testing.assert_allclose(common, np.diag(np.square([0.5] * 3 + [math.radians(2.0)] * 3)))
    else:
        assert common is None


def test_outliers_have_their_share_and_sizes_and_are_reported(trajectory: Trajectory) -> None:
    source = PoseFixes(rate_hz=10.0, outlier_share=0.1, outlier_m=(5.0, 20.0), outlier_deg=(10.0, 40.0))
    fixes, false = make_pose_fixes(source, trajectory, EPOCH_NS, np.random.default_rng(4))
    assert 320 < len(false) < 480
    p = np.linalg.norm(np.array([f.p_n for f in fixes]) - truth_at(trajectory, fixes).p_n, axis=1)
    angle = np.degrees(np.linalg.norm(attitude_errors(trajectory, fixes), axis=1))
    is_false = np.array([f.t_ns in false for f in fixes])
    assert 4.0 < p[is_false].min() < 6.0
    assert 19.0 < p[is_false].max() < 21.0
    assert angle[is_false].min() > 7.0
    assert 36.0 < angle[is_false].max() < 44.0
    assert p[~is_false].max() < 1.0
    assert angle[~is_false].max() < 7.0


def test_false_spans_agree_with_each_other(trajectory: Trajectory) -> None:
    span = FalseSpan(start_s=38.0, end_s=42.0, offset_n_m=(3.0, -4.0, 0.0), rotation_n_deg=(0.0, 0.0, 8.0))
    source = PoseFixes(sigma_m=SILENT[0], sigma_deg=SILENT[0], false_spans=(span,))
    fixes, false = make_pose_fixes(source, trajectory, EPOCH_NS, np.random.default_rng(4))
    assert len(false) == 8
    p, theta = np.array([f.p_n for f in fixes]) - truth_at(trajectory, fixes).p_n, attitude_errors(trajectory, fixes)
    for k, f in enumerate(fixes):
        is_false = f.t_ns in false
        assert is_false == (38.0 <= (f.t_ns - EPOCH_NS) * 1e-9 < 42.0)
        np.testing.assert_allclose(p[k], [3.0, -4.0, 0.0] if is_false else 0.0, atol=1e-9)
        np.testing.assert_allclose(theta[k], [0.0, 0.0, math.radians(8.0)] if is_false else 0.0, atol=1e-9)
