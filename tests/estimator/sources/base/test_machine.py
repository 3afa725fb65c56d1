"""What all sources share: the order of measurements, the check of covariances, the machine that trusts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.sources.base.aid import log_false, order
from estimator.sources.base.covariance import covariance_refusal
from estimator.sources.base.machine import Phase, SourceState
from estimator.sources.base.rules import Rules
from models.messages import Array, Reason

SECOND = 10**9
RULES = Rules(timeout_s=5.0, probation=3, hold_s=10.0)
GOOD, SIGMA = np.zeros(3), np.ones(3)


# --- order ---------------------------------------------------------------------------------------------------------------


def test_time_comes_before_kind_topic_and_content() -> None:
    early, late = order(1, "pose", "/z", 9.0), order(2, "gnss_position", "/a", 1.0)
    assert early < late
    assert order(1, "gnss_position", "/z", 9.0) < order(1, "pose", "/a", 1.0)
    assert order(1, "pose", "/a", 9.0) < order(1, "pose", "/b", 1.0)


@given(st.floats(allow_nan=False), st.floats(allow_nan=False))
def test_equal_content_has_an_equal_position_and_other_content_another(a: float, b: float) -> None:
    same_bits = np.float64(a).tobytes() == np.float64(b).tobytes()
    assert (order(1, "pose", "/a", a) == order(1, "pose", "/a", b)) is same_bits


def test_log_false_is_the_logarithm_of_share_and_density() -> None:
    assert log_false(Rules(false_share=0.1), [50.0, 50.0, 1.0]) == pytest.approx(math.log(0.1 / (100.0 * 100.0 * 2.0)))


# --- covariances -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_a_covariance_is_accepted_whatever_its_size(scale: float) -> None:
    a = np.random.default_rng(0).normal(size=(3, 3))
    assert covariance_refusal(scale * (a @ a.T)) is None
    assert covariance_refusal(np.diag([scale, 1.0, 1.0])) is None


@pytest.mark.parametrize(
    ("cov", "reason"),
    [
        (np.zeros((3, 3)), Reason.NOT_PSD),
        (np.diag([1.0, 0.0, 1.0]), Reason.NOT_PSD),
        (np.diag([1.0, -1.0, 1.0]), Reason.NOT_PSD),
        (np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), Reason.NOT_PSD),
        (np.array([[1.0, 0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 1.0]]), Reason.NOT_PSD),
        (np.full((3, 3), 1.0), Reason.NOT_PSD),
        (np.diag([1.0, math.nan, 1.0]), Reason.NOT_FINITE),
        (np.diag([1.0, math.inf, 1.0]), Reason.NOT_FINITE),
        (np.diag([1.0, 5e-324, 1.0]), None),
        (np.diag([1.0, 1e29, 1.0]), None),
        (np.diag([1.0, 1e308, 1.0]), Reason.NOT_FINITE),  # the filter's factors would make it infinite
    ],
)
def test_what_is_no_covariance_is_refused_with_its_reason(cov: Array, reason: Reason | None) -> None:
    refusal = covariance_refusal(cov)
    assert (refusal.reason if refusal else None) is reason


# --- the machine -----------------------------------------------------------------------------------------------------------


def _meet(state: SourceState, t_s: float, *, passed: bool = True, alone: bool = False, nu: Array = GOOD) -> SourceState:
    t_ns = round(t_s * SECOND)
    state = state.arrive(RULES, t_ns, alone=alone)
    fused = passed and state.phase is Phase.ACTIVE
    return state.judge(RULES, t_ns, alone=alone, passed=passed, fused=fused, nu=nu, sigma=SIGMA)


def _active(at_s: float) -> SourceState:
    state = SourceState()
    for k in range(4):
        state = _meet(state, at_s - 3 + k)
    assert state.phase is Phase.ACTIVE
    return state


def test_a_new_source_beside_another_is_active_after_its_probation() -> None:
    state, phases = SourceState(), []
    for k in range(5):
        state = _meet(state, 100.0 + k)
        phases.append(state.phase)
    assert phases == [Phase.STARTING] * 3 + [Phase.ACTIVE] * 2


def test_probation_counts_measurements_that_pass_in_a_row() -> None:
    state, phases = SourceState(), []
    for k, passed in enumerate([True, True, False, True, True, True, True]):
        state = _meet(state, 100.0 + k, passed=passed)
        phases.append(state.phase)
    assert phases == [Phase.STARTING] * 6 + [Phase.ACTIVE]


def test_a_source_that_is_alone_needs_no_probation() -> None:
    assert _meet(SourceState(), 100.0, alone=True).phase is Phase.ACTIVE


def test_silence_stops_a_source_and_its_return_is_on_probation() -> None:
    assert _meet(_active(100.0), 104.9).phase is Phase.ACTIVE
    back = _meet(_active(100.0), 105.1)
    assert back.phase is Phase.STARTING
    assert back.passed == 1


def test_a_silent_source_is_reported_as_stopped_though_nothing_comes_to_stop_it() -> None:
    state = _active(100.0)
    assert [state.phase_at(t * SECOND) for t in (100, 105, 106)] == [Phase.ACTIVE, Phase.ACTIVE, Phase.STOPPED]
    assert SourceState().phase_at(0) is Phase.STOPPED
    starting = _meet(SourceState(), 100.0)
    assert [starting.phase_at(t * SECOND) for t in (101, 106)] == [Phase.STARTING, Phase.STOPPED]


@pytest.mark.parametrize("alone", [True, False])
def test_a_source_that_drifts_beside_another_is_held_off_and_then_on_probation_again(alone: bool) -> None:
    """alone: the other has gone meanwhile, so that no independent source is left."""
    state, t = _active(100.0), 100.0
    while state.phase is Phase.ACTIVE:
        t += 1.0
        state = _meet(state, t, nu=np.array([0.0, 3.0, 0.0]))
    assert 102.0 <= t <= 106.0  # 2 sigma beyond the slack at each, limit 10
    assert state.phase is Phase.STOPPED
    held_until = t + RULES.hold_s
    while t < held_until - 1.0:
        t += 1.0
        state = _meet(state, t, alone=alone)
        assert state.phase is Phase.STOPPED
    state = _meet(state, held_until, alone=alone)
    assert state.phase is (Phase.ACTIVE if alone else Phase.STARTING)


def test_a_source_that_is_alone_is_not_blamed_for_a_drift() -> None:
    state = _active(100.0)
    for k in range(1, 50):
        state = _meet(state, 100.0 + k, nu=np.array([0.0, 3.0, 0.0]), alone=True)
    assert state.phase is Phase.ACTIVE


def test_without_hold_off_no_drift_stops_it() -> None:
    rules = Rules(hold_s=0.0)
    state = SourceState(phase=Phase.ACTIVE, last_ns=0, silent_ns=SECOND)
    for k in range(100):
        state = state.arrive(rules, k * SECOND, alone=False)
        state = state.judge(rules, k * SECOND, alone=False, passed=True, fused=True, nu=np.full(3, 9.0), sigma=SIGMA)
    assert state.phase is Phase.ACTIVE


def test_the_time_of_its_last_fusion_is_kept() -> None:
    state = _active(100.0)
    assert state.fused_ns == 100 * SECOND
    assert _meet(state, 101.0, passed=False).fused_ns == 100 * SECOND
