"""The kept pose in the filter: a clone of the state's pose, corrected by what comes later, gone where the filter jumps."""

import msgspec
import numpy as np
import pytest

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import Hypotheses, Hypothesis, clone_of
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.relative import drift, steps
from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.base.machine import Phase, SourceState
from estimator.sources.odometry import OdometryAid, OdometryConfig, drift_block
from models import imu
from models.imu import Coast, ImuNoise
from models.measurements import Position
from models.messages import Array, ImuSample, OdometryDelta, OdometryPose, Reason
from models.state import E, X

SECOND = 10**9
TOPIC = "/odometry"
BLOCK = clone_of(TOPIC)
CONFIG = OdometryConfig(scale_sigma=0.0, lasting_share=0.0, position_sigma_m=0.01, attitude_sigma_deg=0.1)
_NO_RATE = np.zeros(3)


def _filter() -> Eskf:
    x = np.zeros(X.SIZE)
    x[X.Q] = [1.0, 0.0, 0.0, 0.0]
    x[X.V] = [2.0, 0.0, 0.0]
    a = np.random.default_rng(1).standard_normal((E.SIZE, E.SIZE)) * 0.001
    cov = a @ a.T + np.diag([0.5**2] * 3 + [0.3**2] * 3 + [0.01**2] * 3 + [1e-3**2] * 3 + [1e-2**2] * 3)
    return Eskf(0, x, cov, imu.constants(ImuNoise(), Coast(), None))


def _samples() -> ImuBuffer:
    buffer = ImuBuffer()
    for t in range(0, 3 * SECOND, SECOND // 100):
        buffer.insert(ImuSample(t, t, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665)))
    return buffer


def _aid(dp: tuple[float, float, float], t0_ns: int = 0, t1_ns: int = SECOND) -> OdometryAid:
    delta = OdometryDelta(t1_ns, t1_ns, t0_ns, dp, (1.0, 0.0, 0.0, 0.0), np.diag([1e-4] * 3 + [1e-6] * 3), topic=TOPIC)
    aid = aid_of(delta, SourcesConfig(odometry=CONFIG))
    assert isinstance(aid, OdometryAid)
    return aid


def _begin(end: OdometryAid) -> OdometryAid:
    assert isinstance(end.begin, OdometryAid)
    return end.begin


def _errors(cov: Array) -> Array:
    return np.asarray(cov[np.ix_(np.r_[E.P, E.THETA], np.r_[E.P, E.THETA])])


def test_a_clone_has_the_errors_of_the_pose_and_shares_them() -> None:
    f = _filter()
    f.keep_pose(BLOCK)
    at = f.slow.columns[BLOCK]
    np.testing.assert_array_equal(f.cov[at, at], _errors(f.cov))
    np.testing.assert_array_equal(f.cov[at, E.P], f.cov[np.r_[E.P, E.THETA], E.P])
    f.keep_pose(BLOCK)
    assert len(f.cov) == E.SIZE + 6  # the new one is in its place


def test_a_position_now_corrects_the_kept_pose_too() -> None:
    """Over a second the position's error stays mostly what it was."""
    f = _filter()
    f.keep_pose(BLOCK)
    samples = _samples()
    f.propagate(samples, samples.first_after(0), SECOND)
    before = f.clones[BLOCK].copy()
    z = Position(np.array([3.0, 1.0, 0.0]), np.eye(3) * 1e-4, np.arange(3), np.zeros(3))
    f.update(f.innovation(z, _NO_RATE))
    moved = f.clones[BLOCK] - before
    assert 0.3 < moved[0] < 1.0
    assert 0.3 < moved[1] < 1.0
    np.testing.assert_array_equal(f.slow.mean, np.zeros(6))
    assert np.linalg.eigvalsh(f.cov).min() > -1e-12


def test_an_increment_tells_of_the_velocity_and_not_of_the_position() -> None:
    f = _filter()
    bank, samples = Hypotheses([Hypothesis(f)]), _samples()
    end = _aid((2.3, 0.0, 0.0))
    kept = steps.take(bank, _begin(end), None, SourceState(), alone=True).kept
    f.propagate(samples, samples.first_after(0), SECOND)
    step = steps.take(bank, end, kept, SourceState(), alone=True)
    assert step.reason is Reason.FUSED
    assert abs(f.x[X.V][0] - 2.3) < 0.05
    assert abs(f.x[X.P][0] - 2.0) < 0.5
    assert f.cov[0, 0] > 0.4**2
    assert f.cov[3, 3] < 0.15**2
    assert BLOCK not in f.clones
    assert BLOCK not in f.slow.columns


def test_where_a_filter_jumps_its_kept_pose_goes_and_the_increment_is_left_out() -> None:
    f = _filter()
    bank, samples, end = Hypotheses([Hypothesis(f)]), _samples(), _aid((2.0, 0.0, 0.0))
    kept = steps.take(bank, _begin(end), None, SourceState(), alone=True).kept
    f.widen(3.0)
    assert BLOCK not in f.clones
    f.propagate(samples, samples.first_after(0), SECOND)
    assert steps.take(bank, end, kept, SourceState(), alone=True).reason is Reason.THINNED


def test_increments_do_not_overlap() -> None:
    bank, first = Hypotheses([Hypothesis(_filter())]), _aid((2.0, 0.0, 0.0))
    second = _aid((2.0, 0.0, 0.0), SECOND // 2, SECOND + SECOND // 2)
    kept = steps.take(bank, _begin(first), None, SourceState(), alone=True).kept
    kept = steps.take(bank, _begin(second), kept, SourceState(), alone=True).kept
    lead, samples = bank.lead, _samples()
    lead.propagate(samples, samples.first_after(0), SECOND)
    step = steps.take(bank, first, kept, SourceState(), alone=True)
    lead.propagate(samples, samples.first_after(SECOND), second.t_ns)
    assert step.reason is Reason.FUSED
    assert steps.take(bank, second, step.kept, step.state, alone=True).reason is Reason.THINNED


@pytest.mark.parametrize("off_ns", [-500_000, 0, 500_000])
def test_a_lost_pose_ends_nothing_and_begins_nothing(off_ns: int) -> None:
    """The status may arrive later, and its stamp may differ by less than 1 ms."""
    f = _filter()
    bank, samples, kept, state, reasons = Hypotheses([Hypothesis(f)]), _samples(), None, SourceState(), []
    half = SECOND // 2
    poses = [OdometryPose(k * half, 0, (float(k), 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), topic=TOPIC) for k in range(5)]
    poses.append(msgspec.structs.replace(poses[2], t_ns=poses[2].t_ns + off_ns, frame="", is_lost=True))
    aids = [aid_of(pose, SourcesConfig(odometry=CONFIG)) for pose in poses]
    for aid in sorted((aid for aid in aids if isinstance(aid, OdometryAid)), key=lambda aid: aid.order):
        f.propagate(samples, samples.first_after(f.t_ns), aid.t_ns)
        step = steps.take(bank, aid, kept, state, alone=True)
        kept, state = step.kept, step.state
        reasons.append(step.reason)
    assert reasons == [Reason.THINNED, Reason.FUSED, Reason.NO_FIX, Reason.NO_FIX, Reason.THINNED, Reason.FUSED]


def test_hypotheses_are_separated_by_little_and_each_fuses_what_it_predicted() -> None:
    right, wrong = _filter(), _filter()
    for f in (right, wrong):
        f.cov[E.V, E.V] = np.eye(3) * 0.05**2
        f.cov[:3, 3:6] = f.cov[3:6, :3] = 0.0
    wrong.x[X.V] = [5.0, 0.0, 0.0]
    bank, samples = Hypotheses([Hypothesis(right), Hypothesis(wrong)]), _samples()
    end = _aid((2.0, 0.0, 0.0))
    kept = steps.take(bank, _begin(end), None, SourceState(), alone=False).kept
    for f in (right, wrong):
        f.propagate(samples, samples.first_after(0), SECOND)
    steps.take(bank, end, kept, SourceState(Phase.ACTIVE, silent_ns=2**62), alone=False)
    assert [m.weight for m in bank.members] == [0.0, -0.5]
    assert wrong.x[X.V][0] > 4.5


def test_where_it_contradicts_for_good_and_no_other_source_decides_the_covariance_covers_both() -> None:
    f = _filter()
    f.cov[E.V, E.V] = np.eye(3) * 0.02**2
    f.cov[:3, 3:6] = f.cov[3:6, :3] = 0.0
    bank, samples, state = Hypotheses([Hypothesis(f)]), _samples(), SourceState()
    for k in range(5):
        end = _aid((0.2, 0.0, 0.0), k * SECOND // 2, (k + 1) * SECOND // 2)
        kept = steps.take(bank, _begin(end), None, state, alone=True).kept
        f.propagate(samples, samples.first_after(f.t_ns), end.t_ns)
        step = steps.take(bank, end, kept, state, alone=True)
        state = step.state
    assert (state.phase, step.reason) == (Phase.ACTIVE, Reason.GATED)
    assert drift.sigma_m_s(f, drift_block(end.topic)) == pytest.approx(1.6, abs=0.02)
    assert abs(f.x[X.V][0] - 2.0) < 0.1  # the IMU's
    assert 3.0 * np.sqrt(f.cov[3, 3]) > 1.6  # the odometry's 0.4 m/s is within three sigma
