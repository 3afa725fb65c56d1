"""The variance of unit weight: it follows errors that are larger than they claim, and neither false fixes nor good ones."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.hypotheses.mixture import scale
from estimator.filter.variance_factor import NO_EXCESS, VarianceFactor
from models.messages import Input, PoseFix, Reason, vec3
from models.sim.scenario import EPOCH_NS
from models.state import E
from tests.estimator.scenes import SECOND, Run, error, fly, simulated, within

FLIGHT = """
duration_s = 60.0
[pose_fix]
rate_hz = 2.0
sigma_m = [0.15, 0.15, 0.15]
sigma_deg = [1.0, 1.0, 1.0]
outages_s = [[30.0, 40.0]]
"""


def _noted(distances2: list[float], dof: int = 6) -> VarianceFactor:
    factor = NO_EXCESS
    for k, distance2 in enumerate(distances2):
        factor = factor.also("/pose_fix", k * SECOND // 2, distance2, dof)
    return factor


@pytest.mark.parametrize("excess", [1.0, 4.0, 9.0])
def test_it_is_the_ratio_of_the_errors_to_what_they_claim(excess: float) -> None:
    rng = np.random.default_rng(0)
    values = [_noted((excess * rng.chisquare(6, 20)).tolist()).value for _ in range(200)]
    assert np.median(values) == pytest.approx(excess, rel=0.7 if excess > 1.0 else 1e-9)
    assert np.mean(np.array(values) > 1.0) < 0.1 or excess > 1.0


def test_neither_five_false_fixes_of_seven_raise_it_far_nor_those_that_are_far_away() -> None:
    assert _noted([5.0, 70.0, 5.0, 70.0, 5.0, 70.0, 5.0]).value == 1.0
    assert _noted([5.0] * 5 + [1e5] * 8).value == 1.0
    assert _noted([5.0] * 5 + [1000.0] * 5).value < 5.0
    assert _noted([5.0] * 5 + [70.0] * 6).value > 10.0


@pytest.mark.parametrize("share", [0.3, 0.4])
def test_true_fixes_lead_although_many_are_false_at_random(share: float) -> None:
    flight, rng = simulated(FLIGHT, seed=1), np.random.default_rng(7)

    def at_random(m: Input) -> Input:
        if isinstance(m, PoseFix) and rng.random() < share:
            return replace(m, p_n=vec3(m.p_n + rng.normal(0.0, 20.0, 3)))
        return m

    run = fly(flight, messages=[at_random(m) for m in flight.messages])
    late = [*within(run.estimates, 12.0, 30.0), *within(run.estimates, 42.0, 60.0)]
    assert np.sqrt(np.mean([np.square(error(e, flight.truth)[E.P]).sum() for e in late])) < 0.4


def test_an_excess_that_one_of_two_sources_shows_is_left_to_the_hypotheses() -> None:
    alone, beside, both = NO_EXCESS, NO_EXCESS, NO_EXCESS
    for k in range(10):
        t_ns = k * SECOND
        alone = alone.also("/pose_fix", t_ns, 70.0, 6)
        beside = beside.also("/pose_fix", t_ns, 70.0, 6).also("/gnss", t_ns, 2.0, 3)
        both = both.also("/pose_fix", t_ns, 70.0, 6).also("/gnss", t_ns, 20.0, 3)
    assert alone.value > 10.0
    assert beside.value == 1.0
    assert 5.0 < both.value < 10.0
    for k in range(10, 30):  # /gnss is silent
        beside = beside.also("/pose_fix", k * SECOND, 70.0, 6)
    assert beside.value > 10.0


def test_a_large_excess_counts_until_the_innovations_have_been_usual_for_a_while() -> None:
    at_first, later = NO_EXCESS, _noted([5.0] * 30)
    for k in range(10):
        at_first = at_first.also("/pose_fix", k * SECOND, 600.0, 6)  # r = 112
        later = later.also("/pose_fix", later.t_ns + SECOND, 600.0, 6)
    assert at_first.value > 100.0
    assert later.value == 1.0


def test_the_innovations_have_to_be_usual_without_a_break() -> None:
    factor = NO_EXCESS
    for r in [5.0] * 15 + [70.0] * 8 + [5.0] * 15 + [600.0] * 8:
        factor = factor.also("/pose_fix", factor.t_ns + SECOND, r, 6)
    assert factor.value > 100.0


def test_it_fades() -> None:
    raised = factor = _noted([70.0] * 5)
    for k in range(200):
        factor = factor.also("/pose_fix", raised.t_ns + (1 + k) * SECOND, 5.0, 6)
        if k == 20:
            assert 2.0 < factor.value < 0.6 * raised.value
    assert factor.value < 1.02


def test_what_is_published_keeps_it_four_times_as_long() -> None:
    raised = _noted([70.0] * 5 + [5.0] * 8)  # the median is usual again
    factor = raised
    for k in range(60):
        factor = factor.also("/pose_fix", raised.t_ns + (1 + k) * SECOND, 5.0, 6)
    assert factor.value - 1.0 == pytest.approx((raised.value - 1.0) * math.exp(-60.0 / 30.0))
    assert factor.lasting - 1.0 == pytest.approx((raised.lasting - 1.0) * math.exp(-60.0 / 120.0))


def test_what_is_published_keeps_the_factor_for_longer_than_the_gate() -> None:
    run = fly(simulated(FLIGHT.replace("60.0", "20.0").replace("outages_s", "# outages_s"), seed=1))
    tracker = run.fusion._history.advance(run.estimates[-1].t_ns)
    assert tracker.core.hypotheses is not None
    tracker.core.variance_factor = VarianceFactor(value=2.0, lasting=5.0)
    tracker.core.hypotheses.scale(2.0)
    del tracker.core.hypotheses.members[1:]
    shown = np.trace(tracker.shown_covariance()[E.P, E.P])
    assert shown == pytest.approx(5.0 * np.trace(tracker.core.hypotheses.lead.cov[E.P, E.P]), rel=1e-6)


def _overconfident(fix: PoseFix, factor: float) -> PoseFix:
    return PoseFix(fix.t_ns, fix.arrived_ns, fix.p_n, fix.q_nb_wxyz, np.asarray(fix.covariance) / factor)


@pytest.mark.parametrize("factor", [4.0, 16.0])
def test_fixes_that_claim_too_small_a_covariance_are_fused_and_the_estimate_claims_what_it_is_worth(factor: float) -> None:
    """Without it, a sixteenth gave no estimate at all, and a quarter one that was refused half of its fixes."""
    flight = simulated(FLIGHT)
    run: Run = fly(flight, messages=[_overconfident(m, factor) if isinstance(m, PoseFix) else m for m in flight.messages])
    final = [s.reason for s in run.last_words("/pose_fix").values()]
    assert final.count(Reason.FUSED) > 0.85 * len(final)
    late = [*within(run.estimates, 12.0, 30.0), *within(run.estimates, 42.0, 60.0)]
    off = np.array([error(e, flight.truth)[E.P] for e in late])
    nees = np.array([d @ np.linalg.solve(e.covariance[E.P, E.P], d) / 3.0 for d, e in zip(off, late, strict=True)])
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.4
    assert 0.2 < nees.mean() < 1.4
    assert "times as large as configured" in run.health[-1].detail
    assert len(run.resets) < 10


def test_the_alignment_ends_however_small_the_reported_covariance_is() -> None:
    begins_s: list[float] = []
    pooled: list[float] = []
    for seed in (0, 1, 2, 8):
        flight = simulated(FLIGHT, seed=seed)
        run: Run = fly(flight, messages=[_overconfident(m, 100.0) if isinstance(m, PoseFix) else m for m in flight.messages])
        begins_s.append((run.estimates[0].t_ns - EPOCH_NS) * 1e-9)
        late = within(run.estimates, 42.0, 60.0)
        off = np.array([error(e, flight.truth)[E.P] for e in late])
        pooled += [float(d @ np.linalg.solve(e.covariance[E.P, E.P], d)) / 3.0 for d, e in zip(off, late, strict=True)]
        assert np.sqrt((off**2).sum(axis=1).mean()) < 0.5
    assert max(begins_s) < 9.0
    assert 0.1 < np.mean(pooled) < 1.5


@pytest.mark.parametrize(("sigma", "expected"), [(0.1, 0.3), (2.0, math.pi)])
def test_it_makes_no_attitude_less_certain_than_half_a_turn(sigma: float, expected: float) -> None:
    cov = np.eye(E.SIZE)
    cov[E.THETA, E.THETA] *= sigma**2
    scale(cov, 9.0)
    assert np.sqrt(np.diag(cov))[E.THETA] == pytest.approx([expected] * 3, abs=2e-3)
    assert np.diag(cov)[E.P] == pytest.approx([9.0] * 3)
