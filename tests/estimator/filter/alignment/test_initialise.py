"""From nothing to a first estimate: at once from a pose fix; from GNSS, levelled at rest and with the heading from motion."""

import math

import numpy as np
import pytest

from estimator.filter.alignment.initialise import (
    MOVING_TILT,
    InitialiseConfig,
    Level,
    aligned,
    lacks,
    level,
    start_from_attitude,
    start_from_pose,
    start_from_position,
    weigh,
)
from estimator.fusion import Fusion, FusionConfig
from estimator.service.start import EVERY_S, Start
from estimator.sources.base.aid import Aid
from estimator.sources.gnss import GnssConfig, position_aid, velocity_aid
from models import so3
from models.frames import GRAVITY, Origin
from models.imu import Coast, ImuNoise, constants
from models.measurements import Pose, Position
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, Mode, PoseFix, Reason, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X
from tests import long
from tests.estimator.scenes import SECOND, Run, by_arrival, error, fly, hover, pose_fix, simulated

CONFIG = InitialiseConfig()
CONSTANTS = constants(ImuNoise(), Coast(), None)
HOME = (47.3977, 8.5456, 488.0)


def _stretch(roll: float, pitch: float, seed: int = 0, rate: float = 0.0, shake: float = 0.0) -> Array:
    """A second of IMU at rest in that attitude; rate: rad/s about body z; shake: m/s^2 of vibration."""
    rng = np.random.default_rng(seed)
    force = so3.matrix(so3.from_euler(roll, pitch, 0.7)).T @ [0.0, 0.0, -GRAVITY]
    u = np.tile([0.0, 0.0, rate, *force], (200, 1))
    return u + np.hstack([1e-3 * rng.standard_normal((200, 3)), (0.02 + shake) * rng.standard_normal((200, 3))])


# --- levelling -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, -0.3), (-2.5, 0.4), (0.1, 1.3)])
def test_levels_from_gravity_at_rest(roll: float, pitch: float) -> None:
    at = level(EPOCH_NS, _stretch(roll, pitch), CONFIG)
    assert at.still
    assert at.roll == pytest.approx(roll, abs=5e-3)
    assert at.pitch == pytest.approx(pitch, abs=2e-3)
    assert at.tilt_sigma == pytest.approx(CONFIG.accel_bias_sigma / GRAVITY, rel=0.01)


def test_the_mean_rate_at_rest_is_the_gyro_bias() -> None:
    u = _stretch(0.0, 0.0)
    u[:, :3] += (0.01, -0.02, 0.03)
    at = level(EPOCH_NS, u, CONFIG)
    np.testing.assert_allclose(at.gyro_bias, [0.01, -0.02, 0.03], atol=3e-4)
    assert at.gyro_bias_sigma < CONFIG.gyro_bias_sigma


@pytest.mark.parametrize("moving", [{"rate": 0.3}, {"shake": 0.5}])
def test_in_motion_neither_tilt_nor_gyro_bias_is_trusted(moving: dict[str, float]) -> None:
    at = level(EPOCH_NS, _stretch(0.0, 0.0, **moving), CONFIG)  # type: ignore[arg-type]
    assert not at.still
    assert at.tilt_sigma == MOVING_TILT
    np.testing.assert_array_equal(at.gyro_bias, 0.0)
    assert at.gyro_bias_sigma == CONFIG.gyro_bias_sigma


def test_what_feels_like_rest_is_none_where_something_else_reports_that_it_moves() -> None:
    at = level(EPOCH_NS, _stretch(0.2, 0.0), CONFIG, may_rest=False)
    assert not at.still
    assert at.tilt_sigma == MOVING_TILT
    np.testing.assert_array_equal(at.gyro_bias, 0.0)


def test_a_gentle_coordinated_turn_is_not_taken_for_rest() -> None:
    """15 degrees of bank at 20 m/s: gyro and accelerometer are as steady as on the ground; the positions are not."""
    bank, speed = math.radians(15.0), 20.0
    rate = GRAVITY * math.tan(bank) / speed
    R = so3.matrix(so3.from_euler(bank, 0.0, 0.0))
    gyro, force = R.T @ [0.0, 0.0, rate], np.array([0.0, 0.0, -GRAVITY / math.cos(bank)])
    origin, messages = Origin(*HOME), list[Input]()
    for k in range(600):
        t = EPOCH_NS + k * SECOND // 100
        messages.append(ImuSample(t, t, vec3(gyro), vec3(force)))
        if k % 20 == 10:
            psi = rate * k / 100
            place = origin.to_geodetic(speed / rate * np.array([math.sin(psi), 1.0 - math.cos(psi), 0.0]))
            messages.append(GnssFix(t + 1, t + 1, *place, np.eye(3)))
    run = Run(Fusion(FusionConfig(origin=HOME))).feed(messages)
    details = [s.detail for s in run.last_words("/gnss").values()]
    assert any("at rest" in detail for detail in details[:10])
    assert not any("at rest" in detail for detail in details[10:])


# --- from a pose fix -------------------------------------------------------------------------------------------------------


def test_a_pose_fix_starts_the_filter_where_it_reports_with_its_covariance_about_the_bodys_axes() -> None:
    q = so3.from_euler(0.4, -0.3, 2.0)
    noise = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.05])
    noise[0, 5] = noise[5, 0] = 0.03
    z = Pose(np.array([1.0, 2.0, 3.0]), q, noise, np.arange(6))
    bank = start_from_pose(EPOCH_NS, z, CONSTANTS, CONFIG)
    assert len(bank.members) == 1
    lead, r_nb = bank.lead, so3.matrix(q)
    np.testing.assert_array_equal(lead.x[X.P], z.z_n)
    np.testing.assert_array_equal(lead.x[X.Q], q)
    np.testing.assert_allclose(r_nb @ lead.cov[E.THETA, E.THETA] @ r_nb.T, noise[3:, 3:], atol=1e-12)
    np.testing.assert_allclose(lead.cov[E.P, E.THETA] @ r_nb.T, noise[:3, 3:], atol=1e-12)
    np.testing.assert_array_equal(lead.cov, lead.cov.T)
    np.testing.assert_allclose(np.diag(lead.cov)[E.V], CONFIG.velocity_sigma_m_s**2)


def test_with_pose_fixes_the_estimate_begins_as_soon_as_the_velocity_is_known() -> None:
    simulation = simulated(
        'duration_s = 12.0\n[vehicle]\nkind = "fixed_wing"\n[imu]\nrate_hz = 100.0\n[pose_fix]\nrate_hz = 2.0\n'
    )
    run = fly(simulation)
    fixes = [m.t_ns for m in simulation.messages if isinstance(m, PoseFix)]
    assert fixes[1] <= run.estimates[0].t_ns <= fixes[3]
    first = error(run.estimates[0], simulation.truth)
    assert first @ np.linalg.solve(run.estimates[0].covariance, first) < 38.0  # 0.999 of chi-square, 15 degrees of freedom


def test_nothing_is_published_before_it_is_aligned() -> None:
    """The mode says starting, then aligning; the first estimate comes with its velocity known to velocity_m_s."""
    run = Run(Fusion(FusionConfig()))
    for message in hover(6.0):
        before = len(run.estimates)
        run.feed([message])
        if run.estimates and before == 0:
            sigma = np.sqrt(np.diag(run.estimates[0].covariance))
            assert sigma[E.V].max() < CONFIG.velocity_m_s
            assert math.degrees(sigma[E.THETA].max()) < CONFIG.heading_deg
    early = [h for h in run.health if h.t_ns < run.estimates[0].t_ns]
    assert {h.mode for h in early} <= {Mode.STARTING, Mode.ALIGNING}
    assert all(math.isinf(h.radius95_m) for h in early)
    assert math.isinf(early[0].absolute_age_s)


# --- from GNSS -------------------------------------------------------------------------------------------------------------


def _flight(kind: str, seed: int, duration_s: float = 40.0) -> Simulation:
    imu = '[imu]\nrate_hz = 100.0\ngrade = "industrial"\n'
    return simulated(f'duration_s = {duration_s}\n[vehicle]\nkind = "{kind}"\n{imu}[gnss]\nrate_hz = 5.0\n', seed)


@long.parametrize(("kind", "seed"), [("multirotor", 0), ("multirotor", 3), ("fixed_wing", 1), ("fixed_wing", 4)], one_in=2)
def test_heading_shows_in_motion_whichever_way_the_nose_points(kind: str, seed: int) -> None:
    simulation = _flight(kind, seed)
    run = fly(simulation)
    first, last = run.aligned[0], run.aligned[-1]
    off = error(first, simulation.truth)
    assert math.degrees(np.linalg.norm(off[E.THETA])) < 25.0
    assert np.linalg.norm(off[E.V]) < 1.0
    assert math.degrees(np.linalg.norm(error(last, simulation.truth)[E.THETA])) < 4.0
    assert not run.internal_errors()


def test_the_multirotor_among_them_flies_sideways() -> None:
    """Or the test above would let an estimator pass that takes the course for the heading."""
    truth = _flight("multirotor", 0).truth
    fast = np.linalg.norm(truth.v_n[:, :2], axis=1) > 3.0
    course = np.arctan2(truth.v_n[fast, 1], truth.v_n[fast, 0])
    nose = np.arctan2(truth.R_nb[fast, 1, 0], truth.R_nb[fast, 0, 0])
    assert np.degrees(np.abs(np.angle(np.exp(1j * (course - nose))))).mean() > 45.0


def _at_rest_with_gnss(duration_s: float) -> list[Input]:
    rng, origin = np.random.default_rng(0), Origin(*HOME)
    samples = [m for m in hover(duration_s) if isinstance(m, ImuSample)]
    aids: list[Input] = []
    for k in range(1, round(duration_s * 5)):
        t = EPOCH_NS + k * SECOND // 5 + 1
        place = origin.to_geodetic(rng.normal(scale=0.5, size=3))
        aids.append(GnssFix(t, t, *place, np.eye(3) * 0.25))
        aids.append(GnssVelocity(t, t, tuple(rng.normal(scale=0.05, size=3)), np.eye(3) * 0.0025))
    return by_arrival([*samples, *aids])


def test_at_rest_it_waits_and_reports_it() -> None:
    run = Run(Fusion(FusionConfig(origin=HOME))).feed(_at_rest_with_gnss(20.0))
    assert not run.aligned
    assert run.health[-1].mode is Mode.ALIGNING_HEADING
    words = run.last_words("/gnss")
    assert {s.reason for s in words.values()} == {Reason.ALIGNING}
    assert "at rest" in list(words.values())[-1].detail
    assert "at rest" in run.health[-1].detail


def test_until_it_is_aligned_health_reports_in_numbers_what_is_missing() -> None:
    """A hover without acceleration, GNSS alone: the heading never shows."""
    rng, origin = np.random.default_rng(0), Origin(*HOME)
    messages = list[Input]()
    for k in range(2000):
        t = EPOCH_NS + k * SECOND // 100
        gyro = rng.normal(scale=0.1, size=3)  # shaken: not taken for rest
        messages.append(ImuSample(t, t, vec3(gyro), (0.0, 0.0, -GRAVITY)))
        if k % 20 == 10:
            messages.append(GnssFix(t + 1, t + 1, *origin.to_geodetic(rng.normal(scale=0.5, size=3)), np.eye(3) * 0.25))
    run = Run(Fusion(FusionConfig(origin=HOME))).feed(messages)
    assert not run.aligned
    assert run.health[0].detail.startswith("waiting for a position with 5 IMU samples")
    assert run.health[-1].detail.startswith("heading unknown")
    assert "pose fix with attitude" in run.health[-1].detail


def test_a_pose_fix_ends_the_wait() -> None:
    messages = _at_rest_with_gnss(10.0)
    fix = pose_fix(EPOCH_NS + 5 * SECOND + 3, sigma_m=0.2)
    run = Run(Fusion(FusionConfig(origin=HOME))).feed(by_arrival([*messages, fix]))
    waited_ns = run.aligned[0].t_ns - fix.t_ns
    assert SECOND // 2 < waited_ns < SECOND + SECOND // 5  # so long the IMU has to show that it is right
    assert np.linalg.norm(run.estimates[-1].nav[X.P]) < 1.0


def test_gnss_without_imu_starts_nothing() -> None:
    aids = [m for m in _at_rest_with_gnss(5.0) if not isinstance(m, ImuSample)]
    run = Run(Fusion(FusionConfig(origin=HOME))).feed(aids)
    assert not run.estimates
    assert not run.internal_errors()


# --- the bank of headings --------------------------------------------------------------------------------------------------


LEVEL = Level(EPOCH_NS, 0.1, -0.05, 0.03, np.array([0.001, 0.002, 0.003]), 0.01, still=True)
Z = Position(np.array([1.0, 2.0, 3.0]), np.eye(3) * 2.0, np.arange(3), np.zeros(3))


def test_an_antenna_ahead_of_the_imu_begins_ahead_of_it() -> None:
    """P against drawn attitudes: p = z - R exp(theta) l - n, for each of the headings and for a prior attitude."""
    z, rng = Position(np.zeros(3), np.eye(3) * 0.3**2, np.arange(3), np.array([2.0, -1.0, -3.0])), np.random.default_rng(1)
    prior = Pose(np.zeros(3), so3.from_euler(0.01, -0.02, 1.0), np.diag([0.02, 0.02, 0.05]) ** 2, np.arange(3, 6))
    from_prior = start_from_attitude(EPOCH_NS, z, LEVEL, prior, CONSTANTS, CONFIG)
    assert from_prior is not None
    for member in (*start_from_position(EPOCH_NS, z, LEVEL, CONSTANTS, CONFIG).members, *from_prior.members):
        x, cov = member.filter.x, member.filter.cov
        r_nb, of_attitude = so3.matrix(x[X.Q]), 1e-4 * cov[E.THETA, E.THETA]  # small: it is linear
        np.testing.assert_allclose(x[X.P], -r_nb @ z.lever_b, atol=1e-12)
        theta = rng.multivariate_normal(np.zeros(3), of_attitude, 1000)
        off = np.array([-r_nb @ (so3.matrix(so3.quat_exp(t)) - np.eye(3)) @ z.lever_b for t in theta])
        drawn = off.T @ np.hstack([off, theta]) / 1000
        found = 1e-4 * np.hstack([cov[E.P, E.P] - z.noise, cov[E.P, E.THETA]])
        assert np.abs(drawn - found).max() < 0.15 * np.abs(found).max()


def test_the_bank_covers_the_circle_levelled() -> None:
    bank = start_from_position(EPOCH_NS, Z, LEVEL, CONSTANTS, CONFIG)
    euler = np.array([so3.to_euler(m.filter.x[X.Q]) for m in bank.members])
    np.testing.assert_allclose(euler[:, 0], 0.1, atol=1e-9)
    np.testing.assert_allclose(euler[:, 1], -0.05, atol=1e-9)
    gaps = np.diff(np.sort(euler[:, 2] % (2.0 * math.pi)))
    np.testing.assert_allclose(gaps, 2.0 * math.pi / len(bank.members), atol=1e-9)
    for member in bank.members:
        cov, r_nb = member.filter.cov, so3.matrix(member.filter.x[X.Q])
        about_n = r_nb @ cov[E.THETA, E.THETA] @ r_nb.T
        assert math.sqrt(about_n[2, 2]) >= 0.5 * gaps[0]  # neighbours overlap at one sigma
        assert math.sqrt(about_n[0, 0]) == pytest.approx(0.03)
        np.testing.assert_array_equal(member.filter.x[X.BG], LEVEL.gyro_bias)
        np.testing.assert_array_equal(cov[E.P, E.P], Z.noise)
    assert not aligned(bank, CONFIG)


def _aid(message: GnssFix | GnssVelocity) -> Aid:
    aid = position_aid(message, GnssConfig()) if isinstance(message, GnssFix) else velocity_aid(message, GnssConfig())
    assert isinstance(aid, Aid)
    return aid


def test_a_single_implausible_measurement_does_not_decide_the_heading() -> None:
    bank = start_from_position(EPOCH_NS, Z, LEVEL, CONSTANTS, CONFIG)
    aid = _aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (300.0, 0.0, 0.0), np.eye(3) * 0.01))
    z = aid.measurement(None)
    assert z is not None
    before = [m.filter.x.copy() for m in bank.members]
    weigh(bank, aid, z, np.zeros(3))
    assert [m.weight for m in bank.members] == [0.0] * len(before)
    for member, x in zip(bank.members, before, strict=True):
        np.testing.assert_array_equal(member.filter.x, x)


def test_it_is_aligned_when_attitude_and_velocity_are_known_and_the_headings_agree() -> None:
    fix = Pose(np.zeros(3), np.array([1.0, 0, 0, 0]), np.eye(6) * 1e-3, np.arange(6))
    bank = start_from_pose(EPOCH_NS, fix, CONSTANTS, CONFIG)
    assert not aligned(bank, CONFIG)
    assert lacks(bank, CONFIG).startswith("velocity known to 10.00 m/s, 3 wanted:")
    bank.lead.cov[E.V, E.V] = np.eye(3) * 0.1
    assert aligned(bank, CONFIG)
    assert "being confirmed" in lacks(bank, CONFIG)
    bank.lead.cov[E.THETA, E.THETA] = np.eye(3) * math.radians(11.0) ** 2
    assert lacks(bank, CONFIG).startswith("attitude known to 11.0 deg, 5 wanted:")
    bank.lead.cov[E.THETA, E.THETA] = np.eye(3) * 1e-3
    other = bank.members[0].copy()
    other.filter.x[X.Q] = so3.from_euler(0.0, 0.0, 1.0)
    bank.members.append(other)
    assert not aligned(bank, CONFIG)
    other.weight = -10.0  # one in e^10
    assert aligned(bank, CONFIG)


def test_all_fixes_of_one_typed_position_are_worth_one() -> None:
    start = Start((3.0, 4.0, 0.0), sigma_m=2.0, heading=1.0, heading_sigma=math.radians(2.0))
    rest: list[Input] = [m for m in hover(7.0, 50.0) if isinstance(m, ImuSample)]
    fixes: list[Input] = [start.fix(EPOCH_NS + SECOND + round(k * EVERY_S * SECOND)) for k in range(25)]
    run = Run(Fusion(FusionConfig(origin=HOME))).feed(by_arrival([*rest, *fixes]))
    assert run.aligned[0].t_ns < EPOCH_NS + 3 * SECOND
    for estimate in run.aligned:
        assert np.sqrt(np.diag(estimate.covariance)[E.P]).min() > 1.98
        np.testing.assert_allclose(estimate.nav[X.P], [3.0, 4.0, 0.0], atol=0.2)
        assert math.degrees(math.sqrt(estimate.covariance[E.THETA, E.THETA][2, 2])) > 1.9
