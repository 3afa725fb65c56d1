"""A receiver that is misled: left for fixes that contradict it, covered meanwhile, and fused again when it is right."""

import math
import re

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.hypotheses import Doubt, Hypotheses, Hypothesis, left_out
from estimator.sources.base.aid import Aid
from estimator.sources.gnss import GnssConfig, position_aid, velocity_aid
from models.frames import Origin
from models.imu import Coast, ImuNoise, constants
from models.measurements import Measurement
from models.messages import GnssFix, GnssVelocity, Input, PoseFix, Reason, Vec3, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import E, X
from tests import long
from tests.estimator.scenes import SECOND, aid_of, config_of, fly, pose_fix, position_errors, radii, simulated

ORIGIN = Origin(47.0, 8.0, 500.0)
TOPIC = "/gnss"


def _member(p_n: Vec3, weight: float = 0.0, *, fused_ago_s: float = 0.0, variance: float = 0.01) -> Hypothesis:
    x = np.zeros(X.SIZE)
    x[X.P], x[X.Q] = p_n, (1.0, 0.0, 0.0, 0.0)
    noise = constants(ImuNoise(), Coast(), None)
    fused_ns = EPOCH_NS - round(fused_ago_s * SECOND)
    return Hypothesis(Eskf(EPOCH_NS, x, variance * np.eye(E.SIZE), noise), weight, fused_ns, EPOCH_NS - 60 * SECOND, EPOCH_NS)


def _without(p_n: Vec3, weight: float = 0.0, *, fused_ago_s: float = 0.0) -> Hypothesis:
    member = _member(p_n, weight, fused_ago_s=fused_ago_s)
    member.without, member.least = TOPIC, weight
    member.doubts[TOPIC] = Doubt(EPOCH_NS - SECOND, deliberate=True)
    return member


def _judge_fix(bank: Hypotheses, p_n: Vec3) -> Aid:
    """A pose fix at p_n, judged."""
    aid = aid_of(pose_fix(EPOCH_NS, p_n))
    assert isinstance(aid, Aid)
    z = aid.measurement(None)
    assert z is not None
    assert not isinstance(z, tuple)
    bank.judge(aid, z, np.zeros(3), trusted=True)
    return aid


def _gnss(p_n: Vec3) -> tuple[Aid, Measurement]:
    fix = GnssFix(EPOCH_NS, EPOCH_NS, *ORIGIN.to_geodetic(np.array(p_n)), np.eye(3))
    aid = position_aid(fix, GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(ORIGIN)
    assert z is not None
    assert not isinstance(z, tuple)
    return aid, z


def test_the_last_fix_of_a_receiver_is_no_evidence_for_the_next_one_which_shares_its_error() -> None:
    """A receiver that wanders was followed; with a source whose fixes are independent the new hypothesis would weigh -1.2."""
    lead, earlier = _member((0.0, 0.0, 0.0)), _member((40.0, 0.0, 0.0), -1.2)
    lead.doubts[TOPIC] = Doubt(EPOCH_NS - SECOND, deliberate=False)
    aid, z = _gnss((50.0, 0.0, 0.0))
    bank = Hypotheses([lead, earlier])
    assert not bank.judge(aid, z, np.zeros(3), trusted=True).passed
    (newest,) = (m for m in bank.members if TOPIC not in m.doubts)
    assert newest is not earlier
    assert newest.weight < -2.0


@pytest.mark.parametrize(("fused_ago_s", "follows"), [(5.0, False), (15.0, True)])
def test_the_leading_one_follows_the_receiver_again_when_nothing_else_confirms_it(fused_ago_s: float, follows: bool) -> None:
    bank = Hypotheses([_without((0.0, 0.0, 0.0), fused_ago_s=fused_ago_s), _member((0.2, 0.0, 0.0), -3.0)])
    verdict = bank.judge(*_gnss((0.1, 0.0, 0.0)), np.zeros(3), trusted=True)
    assert verdict.passed
    assert verdict.fused == follows
    assert (bank.members[0].without == "") == follows


@pytest.mark.parametrize(("fused_ago_s", "members"), [(5.0, 1), (15.0, 2)])
def test_the_position_of_a_receiver_that_was_left_has_no_say_while_fixes_confirm_the_leading_one(
    fused_ago_s: float, members: int
) -> None:
    """Afterwards it fails, and a hypothesis begins that follows it; the leading one still goes without it."""
    bank = Hypotheses([_without((0.0, 0.0, 0.0), fused_ago_s=fused_ago_s)])
    verdict = bank.judge(*_gnss((20.0, 0.0, 0.0)), np.zeros(3), trusted=True)
    assert not verdict.fused
    assert len(bank.members) == members
    assert bank.members[0].without == TOPIC


def test_the_velocity_of_a_receiver_that_was_left_is_not_fused_before_its_positions_agree() -> None:
    """For 15 s without a fix the own velocity is so uncertain that any other passes its gate."""
    bank = Hypotheses([_without((0.0, 0.0, 0.0), fused_ago_s=15.0)])
    bank.lead.cov[E.V, E.V] = 4.0 * np.eye(3)
    aid = velocity_aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (3.0, 0.0, 0.0), 0.01 * np.eye(3)), GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(ORIGIN)
    assert z is not None
    before = bank.lead.x.copy()
    verdict = bank.judge(aid, z, np.zeros(3), trusted=True)
    assert verdict.passed
    assert not verdict.fused
    np.testing.assert_array_equal(bank.lead.x, before)


@pytest.mark.parametrize(("lead_n_m", "begins_again"), [(0.05, True), (0.25, False)])
def test_after_a_fix_the_hypothesis_without_the_receiver_begins_again_where_the_leading_one_predicted_it_better(
    lead_n_m: float, begins_again: bool
) -> None:
    """A receiver that pulls slowly moves the leading one within its gate: the fix is nearer to the other."""
    bank = Hypotheses([_member((lead_n_m, 0.0, 0.0)), _without((-0.1, 0.0, 0.0), -4.6)])
    bank.members[1].filter.cov[E.P, E.P] *= 2.0
    other = bank.members[1].filter.x[0]
    fix = aid_of(pose_fix(EPOCH_NS, (0.0, 0.0, 0.0)))
    z = fix.measurement(None)
    assert z is not None
    assert bank.judge(fix, z, np.zeros(3), trusted=True).fused
    without = next(m for m in bank.members if m.without)
    assert (without.filter.x[0] == bank.lead.x[0]) == begins_again
    assert without.filter.x[0] != other


def test_the_velocity_of_a_receiver_that_was_left_is_not_fused_while_fixes_confirm_the_leading_one() -> None:
    bank = Hypotheses([_without((0.0, 0.0, 0.0), fused_ago_s=5.0)])
    aid = velocity_aid(GnssVelocity(EPOCH_NS, EPOCH_NS, (0.1, 0.0, 0.0), 0.01 * np.eye(3)), GnssConfig())
    assert isinstance(aid, Aid)
    z = aid.measurement(ORIGIN)
    assert z is not None
    assert not isinstance(z, tuple)
    verdict = bank.judge(aid, z, np.zeros(3), trusted=True)
    assert verdict.passed
    assert not verdict.fused


def test_a_receiver_that_is_found_out_is_left_only_for_a_hypothesis_that_other_fixes_have_confirmed() -> None:
    sound = _without((1.0, 0.0, 0.0), -4.6)
    unconfirmed, refuted = sound.copy(), sound.copy()
    unconfirmed.begun_at_fix = True
    refuted.doubts["/pose_fix"] = Doubt(EPOCH_NS, deliberate=False)
    for other, leads in ((sound, True), (unconfirmed, False), (refuted, False)):
        bank = Hypotheses([_member((0.0, 0.0, 0.0)), other])
        bank.leave(TOPIC)
        assert (bank.members[0] is other) == leads
        assert bank.switches == leads


def test_one_fix_raises_the_hypothesis_without_the_receiver_by_its_share_of_false_fixes_at_most() -> None:
    bank = Hypotheses([_member((0.0, 0.0, 0.0)), _without((5.0, 0.0, 0.0), -4.6)])
    aid = _judge_fix(bank, (5.0, 0.0, 0.0))
    without = next(m for m in bank.members if m.without)
    assert without.weight - bank.members[0].weight == pytest.approx(-4.6 - math.log(aid.rules.false_share))
    reach = 2.8 * math.sqrt(np.linalg.eigvalsh(bank.covariance()[E.P, E.P])[-1])
    assert 5.0 < reach < 10.0, "both count alike"


@pytest.mark.parametrize("goes_without", [True, False])
def test_a_fix_that_nothing_predicted_shows_in_the_covariance_until_the_next_one(goes_without: bool) -> None:
    """It is false, or the receiver has been misled from the start: one is as likely as the other."""
    lead = _member((0.0, 0.0, 0.0))
    lead.receiver = TOPIC, -4.6
    bank = Hypotheses([lead, *([_without((0.0, 0.0, 0.0), -4.6, fused_ago_s=10.0)] if goes_without else [])])
    for p_n, least_m, most_m in (((50.0, 0.0, 0.0), 50.0, 150.0), ((0.0, 0.0, 0.0), 0.0, 1.0)):
        _judge_fix(bank, p_n)
        for at in range(2):  # readings of the receiver change nothing about it
            bank.judge(*_gnss((0.01 * at, 0.0, 0.0)), np.zeros(3), trusted=True)
        assert least_m < 2.8 * math.sqrt(np.linalg.eigvalsh(bank.covariance()[E.P, E.P])[-1]) < most_m


@pytest.mark.parametrize("fused", [True, False])
def test_a_jump_between_two_fixes_is_no_fault_of_the_receiver(*, fused: bool) -> None:
    """The hypothesis without the receiver fused, or refused, the last fix a second ago: the fixes contradict one another."""
    without = _without((0.0, 0.0, 0.0), -4.6, fused_ago_s=1.0 if fused else 10.0)
    bank = Hypotheses([_member((0.0, 0.0, 0.0)), without])
    bank.members[0].receiver = TOPIC, -4.6
    if not fused:
        without.doubts[aid_of(pose_fix(EPOCH_NS, (50.0, 0.0, 0.0))).topic] = Doubt(EPOCH_NS - SECOND, deliberate=False)
    _judge_fix(bank, (50.0, 0.0, 0.0))
    without = next(m for m in bank.members if m.without)
    assert not without.begun_at_fix
    assert np.linalg.norm(without.filter.x[X.P]) < 1.0


BOOT = """
duration_s = 120.0
[imu]
rate_hz = 100.0
[gnss]
rate_hz = 5.0
[pose_fix]
rate_hz = 0.5
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
"""


def test_a_gnss_that_is_wrong_from_boot_is_left_and_meanwhile_the_covariance_covers_both() -> None:
    flight = simulated(BOOT, seed=3)

    def spoofed(m: Input) -> Input | None:
        if isinstance(m, PoseFix) and m.t_ns < EPOCH_NS + 25 * SECOND:
            return None
        return replace(m, lat_deg=m.lat_deg + 200.0 / 111_320.0) if isinstance(m, GnssFix) else m

    run = fly(flight, messages=[m for m in map(spoofed, flight.messages) if m is not None])
    late = [e for e in run.estimates if e.t_ns > EPOCH_NS + 28 * SECOND][::20]
    off = position_errors(late, flight.truth)
    radius = radii(late)
    assert off[-1] < 1.0
    assert (off > 3.0 * radius).mean() < 0.01
    assert radius[-1] < 2.0  # decided
    wide = radius > 50.0
    assert np.count_nonzero(wide[1:] != wide[:-1]) == 1  # and not in question again
    said = [h.detail for h in run.health if h.t_ns > EPOCH_NS + 28 * SECOND]
    assert any(re.match(r"/pose_fix and /gnss disagree by 199\.\d m for \d+ s: ", text) for text in said)


@pytest.mark.long
def test_a_gnss_that_is_wrong_from_boot_and_has_led_for_a_minute_is_left_for_fixes_each_four_seconds() -> None:
    flight = simulated(BOOT, seed=3)
    messages: list[Input] = []
    for m in flight.messages:
        if isinstance(m, GnssFix):
            messages.append(replace(m, lat_deg=m.lat_deg + 200.0 / 111_320.0))
        elif not isinstance(m, PoseFix) or (m.t_ns > EPOCH_NS + 60 * SECOND and (m.t_ns - EPOCH_NS) % (4 * SECOND) < 2 * SECOND):
            messages.append(m)
    run = fly(flight, messages=messages)
    late = [e for e in run.estimates if e.t_ns > EPOCH_NS + 66 * SECOND][::20]
    off = position_errors(late, flight.truth)
    radius = radii(late)
    assert (off > 3.0 * radius).mean() < 0.01
    assert off[-1] < 1.0
    assert radius[-1] < 2.0


PULL_NS, BACK_NS = EPOCH_NS + 20 * SECOND, EPOCH_NS + 50 * SECOND


def _pulled(flight: Simulation, m_s: float) -> list[Input]:
    """From PULL_NS to BACK_NS GNSS moves off at m_s to the north, its velocity with it; a pose fix each 4 s."""
    found: list[Input] = []
    for m in flight.messages:
        pull = PULL_NS < m.t_ns < BACK_NS
        if isinstance(m, GnssFix) and pull:
            found.append(replace(m, lat_deg=m.lat_deg + m_s * (m.t_ns - PULL_NS) * 1e-9 / 111_320.0))
        elif isinstance(m, GnssVelocity) and pull:
            found.append(replace(m, v_n=(m.v_n[0] + m_s, *m.v_n[1:])))
        elif not isinstance(m, PoseFix) or (m.t_ns - EPOCH_NS) % (4 * SECOND) < 2 * SECOND:
            found.append(m)
    return found


@long.parametrize("m_s", [0.5, 2.0])
def test_a_gnss_that_is_pulled_off_is_left_by_fixes_each_four_seconds_and_fused_again_when_it_is_right(m_s: float) -> None:
    flight = simulated(BOOT, seed=3)
    run = fly(flight, messages=_pulled(flight, m_s))
    decided = [e for e in run.estimates if e.t_ns > PULL_NS + 20 * SECOND][::20]
    off = position_errors(decided, flight.truth)
    assert off.max() < 1.0
    found = [e for e in run.estimates if e.t_ns > EPOCH_NS + 10 * SECOND][::20]
    radius = radii(found)
    assert (position_errors(found, flight.truth) > 3.0 * radius).mean() < 0.05
    last = [s for s in run.statuses if s.topic == "/gnss" and s.kind == "gnss_position"][-10:]
    assert [s.reason for s in last] == [Reason.FUSED] * 10


@long.parametrize("m_s", [1.0, 3.0])
def test_a_pull_that_begins_at_once_is_covered_until_the_next_fix(m_s: float) -> None:
    """The step of the velocity shows it, ten seconds and more before a fix does."""
    flight = simulated(BOOT, seed=3)
    no_fix = range(PULL_NS - 5 * SECOND, PULL_NS + 14 * SECOND)
    run = fly(flight, messages=[m for m in _pulled(flight, m_s) if not isinstance(m, PoseFix) or m.t_ns not in no_fix])
    found = [e for e in run.estimates if PULL_NS < e.t_ns < PULL_NS + 14 * SECOND][::5]
    radius = radii(found)
    off = position_errors(found, flight.truth)
    assert (off > 3.0 * radius).mean() < 0.02
    assert "disagree" in run.health[-1].detail or any("disagree" in h.detail for h in run.health)


def test_a_gnss_that_was_left_and_is_right_again_is_fused_although_no_fix_comes_any_more() -> None:
    flight = simulated(BOOT, seed=3)
    last_fix_ns = EPOCH_NS + 48 * SECOND
    run = fly(flight, messages=[m for m in _pulled(flight, 2.0) if not isinstance(m, PoseFix) or m.t_ns < last_fix_ns])
    last = [s for s in run.statuses if s.topic == "/gnss" and s.kind == "gnss_position"][-10:]
    assert [s.reason for s in last] == [Reason.FUSED] * 10
    assert position_errors(run.estimates[-1:], flight.truth)[0] < 3.0


@long.parametrize("unit", [100.0, 3.28])
def test_fixes_in_a_wrong_unit_do_not_lead_beside_gnss(unit: float) -> None:
    flight = simulated(BOOT, seed=3)
    messages: list[Input] = []
    for m in flight.messages:
        if not isinstance(m, PoseFix):
            messages.append(m)
        elif m.t_ns > EPOCH_NS + 30 * SECOND:
            messages.append(replace(m, p_n=vec3(unit * np.array(m.p_n))))
    run = fly(flight, messages=messages)
    found = [e for e in run.estimates if e.t_ns > EPOCH_NS + 30 * SECOND][::20]
    off = position_errors(found, flight.truth)
    radius = radii(found)
    assert np.sqrt((off**2).mean()) < 3.0
    assert (off > 3.0 * radius).mean() < 0.01


def test_the_hypothesis_without_a_receiver_does_not_show_while_there_is_no_conflict() -> None:
    flight = simulated(BOOT, seed=3)
    config = config_of(flight)
    usual, never = (fly(flight, replace(config, gnss=replace(config.gnss, trust=trust))) for trust in (0.99, 1.0))
    members = [run.fusion._history.advance(run.estimates[-1].t_ns).core.hypotheses for run in (usual, never)]
    assert [{m.without for m in h.members} for h in members if h is not None] == [{"", "/gnss"}, {""}]
    for a, b in zip(usual.estimates, never.estimates, strict=True):
        np.testing.assert_array_equal(a.nav, b.nav)
        np.testing.assert_allclose(np.diag(a.covariance), np.diag(b.covariance), rtol=0.05)


def test_the_slow_error_of_a_receiver_is_no_new_evidence_at_every_measurement() -> None:
    """Both hypotheses agree with GNSS; the one that doubts the fixes knows only the sum of position and slow error."""
    lead, sceptic = _member((0.0, 0.0, 0.0)), _member((0.0, 0.0, 0.0), -5.0, variance=4.0)
    sceptic.doubts["/pose_fix"] = Doubt(EPOCH_NS, deliberate=True)
    bank = Hypotheses([lead, sceptic])
    for _ in range(200):
        assert bank.judge(*_gnss((0.2, 0.1, 0.0)), np.zeros(3), trusted=True).fused
    assert bank.members[0] is lead
    assert bank.switches == 0


@pytest.mark.parametrize(("distance2", "needs_none"), [(0.5, True), (5.0, False)])
def test_the_one_without_sensors_gains_by_a_variance_factor_that_it_does_not_need(distance2: float, *, needs_none: bool) -> None:
    """f = 9; squared distances of a position with it: 3 more from the leading one."""
    member = _member((0.0, 0.0, 0.0), fused_ago_s=0.0)
    member.run_ns, member.filter.variance_factor = EPOCH_NS - 60 * SECOND, 9.0
    aid, eye = aid_of(pose_fix(EPOCH_NS)), np.eye(3)
    lead, seen = (Innovation(np.ones(3), eye, eye, eye, eye, d2, 0.0) for d2 in (distance2 + 3.0, distance2))
    weight = left_out.unaided(member, aid, -5.0, 0.5, lead, seen)
    assert weight == pytest.approx(-5.0 + (-math.log(aid.rules.false_share) if needs_none else 0.5))
