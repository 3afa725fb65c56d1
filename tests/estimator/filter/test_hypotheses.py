"""False fixes, alone and in company: the truth leads again within seconds, and a filter that is wrong is not locked in for long.

A vehicle at rest at the origin, so the true position is zero; fixes at 2 Hz with 0.1 m of noise.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest

from estimator.filter.eskf import Eskf
from estimator.filter.hypotheses import Doubt, Hypotheses, Hypothesis
from estimator.filter.hypotheses.follower import AGAIN_S
from estimator.fusion import Fusion, FusionConfig
from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import lasts_s
from estimator.sources.gnss import GnssConfig, velocity_aid
from models.imu import Coast, ImuNoise, constants
from models.messages import Array, Estimate, GnssVelocity, ImuSample, Input, Reason, Vec3, vec3
from models.sim.scenario import EPOCH_NS
from models.state import E, X, retract
from tests.estimator.scenes import SECOND, Run, aid_of, by_arrival, pose_fix

NOWHERE: Vec3 = (0.0, 0.0, 0.0)
LIE: Vec3 = (6.0, -4.0, 1.0)
NOISE = ImuNoise(gyro_noise=5e-4, accel_noise=0.02, gyro_walk=1e-5, accel_walk=5e-4)
CONFIG = FusionConfig(imu=NOISE)
ATTITUDE = np.array([1.0, 0.0, 0.0, 0.0])


def _fly(duration_s: float, fix_at: Callable[[float], Vec3 | None], seed: int = 0, config: FusionConfig = CONFIG) -> Run:
    """At rest for so long; fix_at(t): by how much the fix of that time is off, None where there is none."""
    rng = np.random.default_rng(seed)
    rate_hz = 50.0
    messages: list[Input] = []
    for k in range(round(duration_s * rate_hz) + 1):
        t_ns = EPOCH_NS + round(k * SECOND / rate_hz)
        gyro = NOISE.gyro_noise * math.sqrt(rate_hz) * rng.standard_normal(3)
        accel = NOISE.accel_noise * math.sqrt(rate_hz) * rng.standard_normal(3) - (0.0, 0.0, 9.80665)
        messages.append(ImuSample(t_ns, t_ns, vec3(gyro), vec3(accel)))
    for k in range(1, round(2.0 * duration_s)):
        off = fix_at(0.5 * k)
        noise = 0.1 * rng.standard_normal(3)
        if off is not None:
            yaw = 0.02 * rng.standard_normal()
            messages.append(pose_fix(EPOCH_NS + k * SECOND // 2 + 7_000_000, vec3(noise + off), yaw=yaw))
    return Run(Fusion(config)).feed(by_arrival(messages))


def _distance(run: Run, start_s: float, end_s: float) -> Array:
    """Of the estimates from the truth, m, at 50 Hz."""
    begin, end = EPOCH_NS + round(start_s * 1e9), EPOCH_NS + round(end_s * 1e9)
    return np.array([np.linalg.norm(e.nav[X.P]) for e in run.estimates if begin <= e.t_ns < end])


def _reason(run: Run, t_s: float) -> Reason:
    return run.last_words("/pose_fix")[EPOCH_NS + round(t_s * 1e9) + 7_000_000, "pose"].reason


@pytest.mark.parametrize("seed", range(3))
def test_an_isolated_false_fix_is_refused(seed: int) -> None:
    run = _fly(20.0, lambda t: LIE if t == 15.0 else NOWHERE, seed)
    assert _reason(run, 15.0) is Reason.GATED
    assert _distance(run, 10.0, 20.0).max() < 0.5
    assert sum(s.reason is Reason.GATED for s in run.statuses) == 1
    assert all(reset.t_ns < EPOCH_NS + 10 * SECOND for reset in run.resets)


@pytest.mark.parametrize("outage_s", [10.0, 30.0])
@pytest.mark.parametrize("seed", range(2))
def test_after_an_outage_one_false_fix_does_not_keep_the_true_ones_out(outage_s: float, seed: int) -> None:
    back_s = 15.0 + outage_s
    run = _fly(back_s + 10.0, lambda t: None if 15.0 <= t < back_s else LIE if t == back_s else NOWHERE, seed)
    assert _distance(run, back_s + 8.0, back_s + 10.0).max() < 0.6
    assert {_reason(run, back_s + 8.0 + 0.5 * k) for k in range(4)} == {Reason.FUSED}


@pytest.mark.parametrize("outage_s", [10.0, 30.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_after_an_outage_three_lies_that_agree_are_left_within_seconds(outage_s: float, seed: int) -> None:
    back_s = 15.0 + outage_s
    run = _fly(back_s + 12.0, lambda t: None if 15.0 <= t < back_s else LIE if t < back_s + 1.5 else NOWHERE, seed)
    assert _distance(run, back_s + 10.0, back_s + 12.0).max() < 0.6
    assert {_reason(run, back_s + 10.0 + 0.5 * k) for k in range(4)} == {Reason.FUSED}


@pytest.mark.parametrize("seed", range(3))
def test_eight_lies_that_agree_are_never_followed_by_a_settled_filter(seed: int) -> None:
    run = _fly(40.0, lambda t: LIE if 25.0 <= t < 29.0 else NOWHERE, seed)
    assert {_reason(run, 25.0 + 0.5 * k) for k in range(8)} == {Reason.GATED}
    assert _distance(run, 20.0, 40.0).max() < 0.8
    assert {_reason(run, 31.0 + 0.5 * k) for k in range(16)} == {Reason.FUSED}
    assert all(np.linalg.norm(reset.delta_p_n) < 1.0 for reset in run.resets)


def test_a_filter_that_is_wrong_follows_fixes_that_are_more_than_enough() -> None:
    """False for 30 s, then true: eleven fixes in a row win against any run."""
    run = _fly(70.0, lambda t: LIE if t < 40.0 else NOWHERE)
    moved_s = next((e.t_ns - EPOCH_NS) * 1e-9 for e in run.estimates if e.t_ns > EPOCH_NS + 40 * SECOND and _near_truth(e.nav))
    assert 4.0 < moved_s - 40.0 <= 5.6
    assert _distance(run, moved_s + 1.0, 70.0).max() < 0.6
    assert [r.counter for r in run.resets] == list(range(1, len(run.resets) + 1))
    assert len(run.resets) >= 1


def _near_truth(x: Array) -> bool:
    return bool(np.linalg.norm(x[X.P]) < 1.0)


def test_a_filter_that_started_wrong_is_left_quickly() -> None:
    """One false fix at boot has not stood for long: the few seconds of least patience are enough."""
    run = _fly(15.0, lambda t: LIE if t == 0.5 else NOWHERE)
    assert _distance(run, 9.0, 15.0).max() < 0.6


def test_after_a_long_outage_true_fixes_are_fused_at_once() -> None:
    run = _fly(80.0, lambda t: None if 15.0 <= t < 75.0 else NOWHERE)
    assert [_reason(run, 75.0 + 0.5 * k) for k in range(8)] == [Reason.FUSED] * 8


def test_while_it_is_open_which_fixes_are_true_the_covariance_covers_both() -> None:
    run = _fly(46.0, lambda t: None if 15.0 <= t < 45.0 else LIE)
    end = run.estimates[-1]
    sigma = np.sqrt(np.diag(end.covariance)[E.P])
    assert run.fusion._history.tracker.core.hypotheses is not None
    lead = run.fusion._history.tracker.core.hypotheses.lead
    assert np.all(np.sqrt(np.diag(lead.cov)[E.P]) <= sigma)
    assert len(run.fusion._history.tracker.core.hypotheses.members) > 1
    assert not np.array_equal(lead.cov[: E.SIZE, : E.SIZE], end.covariance)


def test_health_reports_the_radius_of_what_is_published_while_it_is_open() -> None:
    run = _fly(46.0, lambda t: None if 15.0 <= t < 45.0 else LIE)
    published = {e.t_ns: e.covariance for e in run.estimates}
    told = [(h, published[h.t_ns]) for h in run.health if h.t_ns > EPOCH_NS + 10 * SECOND and h.t_ns in published]
    assert any(h.hypotheses > 1 for h, _ in told)
    for health, cov in told:
        assert health.radius95_m == pytest.approx(2.4477 * math.sqrt(np.linalg.eigvalsh(cov[:2, :2])[-1]), rel=1e-3)
        assert health.attitude_sigma_deg == pytest.approx(math.degrees(math.sqrt(np.diag(cov)[E.THETA].max())), rel=1e-6)


def _overconfidence(run: Run, start_s: float, end_s: float) -> float:
    """The largest e^T P^-1 e / 3 of the published positions."""
    begin, end = EPOCH_NS + round(start_s * 1e9), EPOCH_NS + round(end_s * 1e9)
    told = [(e.nav[X.P], e.covariance[E.P, E.P]) for e in run.estimates if begin <= e.t_ns < end]
    return max(float(p @ np.linalg.solve(cov, p)) / 3.0 for p, cov in told)


@pytest.mark.parametrize("seed", range(3))
def test_a_false_fix_that_is_accepted_after_an_outage_is_not_reported_as_certain(seed: int) -> None:
    """One reading in twenty is false: that is what the first ones after an outage are told with, however well they fit."""
    run = _fly(36.5, lambda t: None if 15.0 <= t < 35.0 else LIE if t >= 35.0 else NOWHERE, seed)
    assert _distance(run, 35.1, 36.5).max() > 5.0  # it is believed
    assert 0.5 < _overconfidence(run, 35.1, 36.5) < 20.0


@pytest.mark.parametrize("seed", range(3))
def test_the_doubt_of_the_first_fixes_after_an_outage_passes(seed: int) -> None:
    run = _fly(46.0, lambda t: None if 15.0 <= t < 35.0 else NOWHERE, seed)
    sigma = [math.sqrt(np.trace(_told(run, t_s).covariance[E.P, E.P])) for t_s in (34.9, 35.2, 38.2, 45.9)]
    assert 0.15 * sigma[0] < sigma[1] < 0.7 * sigma[0]
    assert sigma[3] < 0.15 < sigma[2] < 0.9 * sigma[1]


def _told(run: Run, t_s: float) -> Estimate:
    return next(e for e in run.estimates if e.t_ns >= EPOCH_NS + round(t_s * 1e9))


@pytest.mark.parametrize(
    ("first_s", "second_s"), [((15.0, 20.0), (25.0, 50.0)), ((15.0, 30.0), (34.0, 49.0)), ((15.0, 35.0), (38.0, 50.0))]
)
def test_a_doubt_of_the_last_outage_does_not_stand_for_one_of_the_next(
    first_s: tuple[float, float], second_s: tuple[float, float]
) -> None:
    """However soon after the last one it begins."""
    back_s = second_s[1]
    out = [first_s, second_s]
    run = _fly(back_s + 1.5, lambda t: None if any(a <= t < b for a, b in out) else LIE if t >= back_s else NOWHERE)
    assert _distance(run, back_s + 0.1, back_s + 1.5).max() > 5.0
    assert _overconfidence(run, back_s + 0.1, back_s + 1.5) < 20.0


# --- the parts ---------------------------------------------------------------------------------------------------------------


def _state(*p: float) -> Array:
    x = np.zeros(X.SIZE)
    x[X.P], x[X.Q] = p, ATTITUDE
    return x


def _member(x: Array, sigma: float = 0.1, weight: float = 0.0) -> Hypothesis:
    filt = Eskf(EPOCH_NS, x, np.eye(E.SIZE) * sigma**2, constants(NOISE, Coast(), None))
    return Hypothesis(filt, weight, EPOCH_NS, run=120, run_ns=EPOCH_NS - 60 * SECOND, parted_ns=EPOCH_NS)


def test_covariance_is_that_of_the_mixture_about_the_leading_state() -> None:
    a, b = _member(_state(0.0, 0.0, 0.0), 0.1), _member(retract(_state(3.0, 0.0, 0.0), _turn(0.2)), 0.2, math.log(0.25))
    mixed = Hypotheses([a, b]).covariance()
    off = np.zeros(E.SIZE)
    off[E.P] = (3.0, 0.0, 0.0)
    off[E.THETA] = (0.0, 0.0, 0.2)
    expected = 0.8 * np.eye(E.SIZE) * 0.01 + 0.2 * (np.eye(E.SIZE) * 0.04 + np.outer(off, off))
    np.testing.assert_allclose(mixed, expected, atol=1e-12)


def _turn(yaw: float) -> Array:
    dx = np.zeros(E.SIZE)
    dx[E.THETA] = (0.0, 0.0, yaw)
    return dx


@pytest.mark.parametrize(
    ("weight", "benefit", "told"), [(-9.1, 0.0, True), (-9.3, 0.0, False), (-12.0, 2.9, True), (-12.0, 2.7, False)]
)
def test_covariance_does_not_tell_of_what_is_less_likely_than_one_in_ten_thousand(
    weight: float, benefit: float, told: bool
) -> None:
    """The variance of 500 m with a chance of one in a million is (0.5 m)^2, though nothing is half a metre away."""
    lead, other = _member(_state(0.0, 0.0, 0.0)), _member(_state(500.0, 0.0, 0.0), weight=weight)
    other.benefit = benefit
    sigma = math.sqrt(Hypotheses([lead, other]).covariance()[0, 0])
    assert (sigma > 4.0) if told else sigma == pytest.approx(0.1)


def test_covariance_of_one_is_its_own_and_a_copy() -> None:
    one = Hypotheses([_member(_state(1.0, 2.0, 3.0))])
    cov = one.covariance()
    np.testing.assert_array_equal(cov, one.lead.cov)
    cov[:] = 0.0
    assert one.lead.cov[0, 0] == pytest.approx(0.01)


def test_a_source_that_is_not_trusted_is_judged_and_not_fused() -> None:
    bank = Hypotheses([_member(_state(0.0, 0.0, 0.0))])
    aid = aid_of(pose_fix(EPOCH_NS, (0.1, 0.0, 0.0)))
    z = aid.measurement(None)
    assert z is not None
    verdict = bank.judge(aid, z, np.zeros(3), trusted=False)
    assert verdict.passed
    assert not verdict.fused
    np.testing.assert_array_equal(bank.lead.x, _state(0.0, 0.0, 0.0))
    assert len(bank.members) == 1


def test_a_fix_that_passes_is_fused_and_one_that_fails_leaves_a_hypothesis_with_it() -> None:
    bank = Hypotheses([_member(_state(0.0, 0.0, 0.0))])
    near, far = aid_of(pose_fix(EPOCH_NS, (0.1, 0.0, 0.0))), aid_of(pose_fix(EPOCH_NS, (9.0, 0.0, 0.0)))
    for aid, fused in ((near, True), (far, False)):
        z = aid.measurement(None)
        assert z is not None
        verdict = bank.judge(aid, z, np.zeros(3), trusted=True)
        assert (verdict.passed, verdict.fused) == (fused, fused)
        assert verdict.gate == pytest.approx(27.856, abs=1e-2)  # 0.9999 of chi-square, six degrees of freedom
    assert 0.04 < bank.lead.x[X.P][0] < 0.06
    believer = bank.members[1]
    assert 8.0 < believer.filter.x[X.P][0] < 9.0
    assert believer.weight < -5.0


def test_hypotheses_stay_few_and_the_leading_one_weighs_nothing() -> None:
    bank = Hypotheses([_member(_state(0.0, 0.0, 0.0))])
    rng = np.random.default_rng(0)
    for k in range(40):
        aid = aid_of(pose_fix(EPOCH_NS + k * SECOND // 2, vec3(rng.uniform(-20.0, 20.0, 3))))
        z = aid.measurement(None)
        assert z is not None
        bank.judge(aid, z, np.zeros(3), trusted=True)
        assert 1 <= len(bank.members) <= 4
        assert bank.members[0].weight == 0.0
        assert all(math.isfinite(m.weight) for m in bank.members)


def test_a_copy_is_independent() -> None:
    bank = Hypotheses([_member(_state(0.0, 0.0, 0.0))])
    copy = bank.copy()
    for k, p in enumerate(((9.0, 0.0, 0.0), (0.1, 0.0, 0.0))):
        aid = aid_of(pose_fix(EPOCH_NS + k, p))
        z = aid.measurement(None)
        assert z is not None
        copy.judge(aid, z, np.zeros(3), trusted=True)
    assert len(bank.members) == 1
    assert bank.members[0].doubts == {}
    np.testing.assert_array_equal(bank.lead.x, _state(0.0, 0.0, 0.0))


def test_a_velocity_accepted_again_is_no_news_that_its_doubter_alone_pays_for() -> None:
    """The leading filter takes a receiver's velocity for false, and so, just now, did the one that follows it.

    When that one foresees the next, both have explained it: one as true, one as the same false fix.
    """
    honest, follower = _member(_state(0.0, 0.0, 0.0)), _member(_state(0.0, 0.0, 0.0), weight=-6.0)
    follower.filter.x[X.V] = (8.0, 0.0, 0.0)
    for member in (honest, follower):
        member.doubts["/gnss/velocity"] = Doubt(EPOCH_NS - SECOND // 5, deliberate=False)
    bank = Hypotheses([honest, follower])
    aid = velocity_aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (8.1, 0.0, 0.0), None), GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    bank.judge(aid, z, np.zeros(3), trusted=True)
    assert bank.members[0] is honest
    assert bank.members[1].weight == pytest.approx(-6.0 + 0.2 / lasts_s("gnss_velocity"))
    assert "/gnss/velocity" not in follower.doubts


def test_a_velocity_that_both_foresee_is_true_for_both() -> None:
    """Both refused the one before; neither calls this one the same false fix because the other foresaw it a little better."""
    one, other = _member(_state(0.0, 0.0, 0.0)), _member(_state(0.0, 0.0, 0.0), weight=-1.0)
    other.filter.x[X.V] = (0.3, 0.0, 0.0)
    for member in (one, other):
        member.doubts["/gnss/velocity"] = Doubt(EPOCH_NS - SECOND // 5, deliberate=False)
    bank = Hypotheses([one, other])
    aid = velocity_aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (0.3, 0.0, 0.0), None), GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    assert bank.judge(aid, z, np.zeros(3), trusted=True).fused
    assert [member.doubts for member in bank.members] == [{}, {}]


def test_a_hypothesis_without_the_fix_does_not_gain_by_what_a_hopeless_one_predicts() -> None:
    """A velocity fits the leading filter poorly and a third one, of next to no weight, well: no evidence for a doubter."""
    lead, doubter, hopeless = (_member(_state(0.0, 0.0, 0.0), weight=w) for w in (0.0, -2.0, -16.0))
    doubter.doubts["/gnss/velocity"] = Doubt(EPOCH_NS - SECOND // 5, deliberate=False)
    doubter.filter.x[X.V] = (-30.0, 0.0, 0.0)
    hopeless.filter.x[X.V] = (1.2, 0.0, 0.0)
    bank = Hypotheses([lead, doubter, hopeless])
    aid = velocity_aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (1.2, 0.0, 0.0), None), GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    assert bank.judge(aid, z, np.zeros(3), trusted=True).fused
    assert bank.members[0] is lead
    assert doubter.weight == pytest.approx(-2.0 - 0.2 / lasts_s("gnss_velocity"), abs=1e-3)
    assert hopeless.weight > -16.0


def test_a_sceptic_gains_nothing_on_the_leading_one_by_a_fix_that_both_reject() -> None:
    """A third hypothesis predicts the fix well: to the sceptic that is the false source again, but that does not part the two."""
    lead, sceptic = _member(_state(0.0, 0.0, 0.0)), _member(_state(40.0, 0.0, 0.0), weight=-6.0)
    believer = _member(_state(3.0, 0.0, 0.0), sigma=0.01, weight=-8.0)
    sceptic.doubts["/pose_fix"] = Doubt(EPOCH_NS - SECOND // 2, deliberate=True)
    bank = Hypotheses([lead, sceptic, believer])
    aid = aid_of(pose_fix(EPOCH_NS, (3.0, 0.0, 0.0)))
    z = aid.measurement(None)
    assert z is not None
    assert not bank.judge(aid, z, np.zeros(3), trusted=True).fused
    assert sceptic.weight - lead.weight == pytest.approx(-6.0)
    assert believer.weight - lead.weight > -8.0


def _judge(bank: Hypotheses, p_n: Vec3) -> None:
    aid = aid_of(pose_fix(EPOCH_NS, p_n))
    z = aid.measurement(None)
    assert z is not None
    bank.judge(aid, z, np.zeros(3), trusted=True)


def _rejecting(*p: float, weight: float = 0.0) -> Hypothesis:
    member = _member(_state(*p), weight=weight)
    member.doubts["/pose_fix"] = Doubt(EPOCH_NS - SECOND // 2, deliberate=False)
    return member


def test_a_follower_takes_the_place_of_the_last_of_too_many_that_reject_the_fix() -> None:
    """Before, four that had all gone wrong left no place for one that is right."""
    bank = Hypotheses([_rejecting(0.0, 0.0, 0.0), *(_rejecting(20.0 * k, 0.0, 0.0, weight=2.5 - 0.1 * k) for k in (1, 2, 3))])
    _judge(bank, (0.0, 90.0, 0.0))
    assert [round(float(m.filter.x[X.P][0])) for m in bank.members] == [0, 20, 40, 0]
    assert bank.members[-1].filter.x[X.P][1] > 80.0


@pytest.mark.parametrize(("run", "run_s", "period_s", "by_imu", "expected_s"), [
    (1, 0.0, 0.5, False, 4.45),
    (3, 1.0, 0.5, False, 4.45),
    (8, 3.5, 0.5, False, 4.95),  # eight, and three more
    (100, 60.0, 0.5, False, 4.95),  # ten more: enough against any run
    (100, 60.0, 0.5, True, 3.7),
    (3, 4.0, 2.0, False, 9.8),  # rare fixes: three, and three more
    (100, 60.0, 2.0, True, 3.69),
    (100, 60.0, 0.05, False, 4.995),
])  # fmt: skip
def test_a_run_of_fixes_is_decided_by_a_longer_one(
    run: int, run_s: float, period_s: float, by_imu: bool, expected_s: float
) -> None:
    lead = _member(_state(0.0, 0.0, 0.0))
    lead.run, lead.run_ns, lead.fused_ns = run, EPOCH_NS - round(run_s * 1e9), EPOCH_NS
    holds_s = lead.holds_s(EPOCH_NS + round(period_s * 1e9), imu_may_be_wrong=by_imu)
    assert holds_s == pytest.approx(expected_s, abs=0.1)


def test_an_unlikely_hypothesis_that_fuses_what_the_leading_one_rejects_stands_for_the_follower() -> None:
    lead, unlikely = _member(_state(0.0, 0.0, 0.0)), _member(_state(25.0, 0.0, 0.0), sigma=30.0, weight=-60.0)
    lead.run, lead.run_ns, lead.fused_ns = 100, EPOCH_NS - 60 * SECOND, EPOCH_NS - SECOND // 2
    bank = Hypotheses([lead, unlikely])
    for k in range(2):
        aid = aid_of(pose_fix(EPOCH_NS + k * SECOND // 2, (20.0, 0.0, 0.0)))
        z = aid.measurement(None)
        assert z is not None
        assert not bank.judge(aid, z, np.zeros(3), trusted=True).fused
        assert bank.members[1].weight - lead.weight == pytest.approx(3.0 - (4.95 - 0.5 * k) / AGAIN_S, abs=0.3)
    np.testing.assert_allclose(unlikely.filter.x[X.P], (20.0, 0.0, 0.0), atol=0.5)


def test_once_a_follower_leads_the_imu_is_trusted_again_by_a_branch_that_the_next_fixes_confirm() -> None:
    bank = Hypotheses([_member(_state(0.0, 0.0, 0.0))])
    bank.members[0].fused_ns = EPOCH_NS - SECOND // 2
    constants = bank.lead.constants
    for k in range(14):
        aid = aid_of(pose_fix(EPOCH_NS + k * SECOND // 2, (20.0, 0.0, 0.0)))
        z = aid.measurement(None)
        assert z is not None
        bank.judge(aid, z, np.zeros(3), trusted=True)
        for member in bank.members:
            member.filter.cov[: E.SIZE, : E.SIZE] += 0.01 * np.eye(E.SIZE) * (1.0 + 100.0 * member.doubts_imu)
    assert abs(bank.lead.x[X.P][0] - 20.0) < 0.1
    assert not bank.members[0].doubts_imu
    assert bank.lead.constants is constants


def test_a_hypothesis_that_rejects_a_reading_it_predicts_does_not_predict_the_next_one() -> None:
    """The leading filter and another doubt a velocity that a third one foresees; that the second foresees it too is no news."""
    lead, doubter, believer = (_member(_state(0.0, 0.0, 0.0), weight=w) for w in (0.0, -6.0, -14.0))
    doubter.filter.x[X.V], believer.filter.x[X.V] = (11.2, 0.0, 0.0), (10.0, 0.0, 0.0)
    for member in (lead, doubter):
        member.doubts["/gnss/velocity"] = Doubt(EPOCH_NS - SECOND // 5, deliberate=False)
    bank = Hypotheses([lead, doubter, believer])
    aid = velocity_aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (10.0, 0.0, 0.0), None), GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    assert not bank.judge(aid, z, np.zeros(3), trusted=True).fused
    assert bank.members[0] is lead
    assert doubter.weight == pytest.approx(-6.0)


def test_a_fix_that_passes_again_is_fused_and_who_foretold_it_better_leads() -> None:
    """The last one failed its gate: by chance, or because it was false."""
    lead, other = _member(_state(0.0, 0.0, 0.0)), _member(_state(0.6, 0.0, 0.0), weight=-2.0)
    lead.doubts["/pose_fix"] = Doubt(EPOCH_NS - SECOND // 2, deliberate=False)
    bank = Hypotheses([lead, other])
    aid = aid_of(pose_fix(EPOCH_NS, (0.6, 0.0, 0.0)))
    z = aid.measurement(None)
    assert z is not None
    verdict = bank.judge(aid, z, np.zeros(3), trusted=True)
    assert verdict.passed
    assert verdict.fused
    assert bank.members[0] is other


def test_a_hypothesis_that_took_the_last_fix_for_false_foretells_none_so_a_follower_begins_beside_it() -> None:
    """It has not been aided for long and takes almost anything."""
    lead, stale = _member(_state(0.0, 0.0, 0.0)), _member(_state(25.0, 0.0, 0.0), sigma=30.0, weight=-10.0)
    stale.doubts["/pose_fix"] = Doubt(EPOCH_NS - 20 * SECOND, deliberate=True)
    lead.fused_ns = EPOCH_NS - SECOND // 2
    bank = Hypotheses([lead, stale])
    aid = aid_of(pose_fix(EPOCH_NS, (20.0, 0.0, 0.0)))
    z = aid.measurement(None)
    assert z is not None
    verdict = bank.judge(aid, z, np.zeros(3), trusted=True)
    assert not verdict.fused
    assert [m.doubts_imu for m in bank.members].count(True) == 1
