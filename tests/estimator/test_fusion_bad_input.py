"""Bad input is a value: every message gets its reason, the good ones around it are fused, only finite numbers come out."""

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from estimator.fusion import Fusion, FusionConfig
from models import state
from models.messages import (
    AidStatus,
    Array,
    AttitudePrior,
    Estimate,
    GnssFix,
    GnssVelocity,
    Health,
    ImuSample,
    Input,
    LandmarkFix,
    Mode,
    PoseFix,
    Reading,
    Reason,
    Tick,
    Unusable,
    Vec3,
    vec3,
)
from models.sim.scenario import EPOCH_NS
from models.state import X
from tests.estimator.scenes import SECOND, Run, arriving, by_arrival, hover, pose_fix, same

NOW = EPOCH_NS + 5 * SECOND + 3
HOME = (47.0, 8.0, 500.0)
CONFIG = FusionConfig(origin=HOME)
HUGE, TINY = 1e150, 5e-324  # the square of HUGE is still a number


def _pose(**changes: object) -> PoseFix:
    return msgspec.structs.replace(pose_fix(NOW), **changes)


def _gnss(**changes: object) -> GnssFix:
    return msgspec.structs.replace(GnssFix(NOW, NOW, *HOME, np.eye(3)), **changes)


def _velocity(**changes: object) -> GnssVelocity:
    return msgspec.structs.replace(GnssVelocity(NOW, NOW, (0.0, 0.0, 0.0), np.eye(3) * 0.01), **changes)


def _imu(**changes: object) -> ImuSample:
    return msgspec.structs.replace(ImuSample(NOW, NOW, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665)), **changes)


def _full(value: float, n: int = 6) -> Array:
    return np.full((n, n), value)


def _asymmetric(n: int) -> Array:
    a = np.eye(n)
    a[0, 1] = 0.5
    return a


BAD: dict[str, tuple[Input, Reason]] = {
    "torn message": (Unusable(NOW, NOW, "/pose_fix", "12 bytes are missing"), Reason.MALFORMED),
    "pressure NaN": (Reading(NOW, NOW, "/baro", "baro", (math.nan,)), Reason.NOT_FINITE),
    "pressure in hPa": (Reading(NOW, NOW, "/baro", "baro", (1013.25 / 2,)), Reason.IMPLAUSIBLE),
    "pressure negative": (Reading(NOW, NOW, "/baro", "baro", (-101325.0,)), Reason.IMPLAUSIBLE),
    "IMU NaN": (_imu(gyro_b=(math.nan, 0.0, 0.0)), Reason.NOT_FINITE),
    "IMU Inf": (_imu(accel_b=(0.0, 0.0, math.inf)), Reason.NOT_FINITE),
    "IMU huge": (_imu(accel_b=(0.0, 1e308, 0.0)), Reason.IMPLAUSIBLE),
    "IMU duplicate": (_imu(t_ns=EPOCH_NS + 4 * SECOND), Reason.DUPLICATE),
    "IMU future": (_imu(t_ns=NOW + 30 * SECOND), Reason.IN_FUTURE),
    "pose NaN": (_pose(p_n=(0.0, math.nan, 0.0)), Reason.NOT_FINITE),
    "pose Inf": (_pose(p_n=(0.0, 0.0, -math.inf)), Reason.NOT_FINITE),
    "pose huge": (_pose(p_n=(1e308, 0.0, 0.0)), Reason.IMPLAUSIBLE),
    "quaternion zero": (_pose(q_nb_wxyz=(0.0, 0.0, 0.0, 0.0)), Reason.IMPLAUSIBLE),
    "quaternion denormal": (_pose(q_nb_wxyz=(TINY, TINY, TINY, TINY)), Reason.IMPLAUSIBLE),
    "quaternion NaN": (_pose(q_nb_wxyz=(math.nan, 0.0, 0.0, 1.0)), Reason.NOT_FINITE),
    "pose covariance asymmetric": (_pose(covariance=_asymmetric(6)), Reason.NOT_PSD),
    "pose covariance of rank one": (_pose(covariance=_full(1.0)), Reason.NOT_PSD),
    "pose covariance NaN": (_pose(covariance=_full(math.nan)), Reason.UNSUPPORTED),
    "pose covariance of wrong shape": (_pose(covariance=np.eye(3)), Reason.MALFORMED),
    "pose roll alone": (_pose(covariance=np.diag([1.0, 1.0, 1.0, 0.1, -1.0, -1.0])), Reason.UNSUPPORTED),
    "pose future": (_pose(t_ns=NOW + 10 * SECOND), Reason.IN_FUTURE),
    "pose before history": (_pose(t_ns=EPOCH_NS - 60 * SECOND), Reason.TOO_OLD),
    "pose at time zero": (_pose(t_ns=0), Reason.TOO_OLD),
    "pose in feet": (_pose(p_n=(300.0, 200.0, -100.0)), Reason.GATED),
    "GNSS NaN": (_gnss(lat_deg=math.nan), Reason.NOT_FINITE),
    "GNSS in 1e-7 deg": (_gnss(lat_deg=470_000_000.0), Reason.IMPLAUSIBLE),
    "GNSS at null island": (_gnss(lat_deg=0.0, lon_deg=0.0), Reason.NO_FIX),
    "GNSS without fix": (_gnss(status=-1), Reason.NO_FIX),
    "GNSS covariance negative": (_gnss(covariance_n=-np.eye(3)), Reason.NOT_PSD),
    "GNSS covariance Inf": (_gnss(covariance_n=_full(math.inf, 3)), Reason.NOT_FINITE),
    "GNSS covariance of wrong shape": (_gnss(covariance_n=np.eye(2)), Reason.MALFORMED),
    "velocity covariance of wrong shape": (_velocity(covariance_n=np.eye(6)), Reason.MALFORMED),
    "attitude covariance of wrong shape": (AttitudePrior(NOW, NOW, (1.0, 0.0, 0.0, 0.0), np.eye(6)), Reason.MALFORMED),
    "velocity NaN": (_velocity(v_n=(math.nan, 0.0, 0.0)), Reason.NOT_FINITE),
    "velocity in mm/s": (_velocity(v_n=(15_000.0, 0.0, 0.0)), Reason.IMPLAUSIBLE),
    "tick far ahead": (Tick(NOW + 60 * SECOND, NOW), Reason.IN_FUTURE),
}


@pytest.fixture(scope="module")
def undisturbed() -> Run:
    return Run(Fusion(CONFIG)).feed(hover(8.0))


def _is_finite(run: Run) -> bool:
    return all(np.isfinite(part).all() for e in run.estimates for part in (e.nav, e.covariance, e.gyro_b))


@pytest.mark.parametrize("what", BAD)
def test_bad_input_has_its_reason_and_changes_no_bit(what: str, undisturbed: Run) -> None:
    message, reason = BAD[what]
    run = Run(Fusion(CONFIG)).feed(by_arrival([*hover(8.0), message]))
    said = [s.reason for s in run.statuses if s.t_ns == message.t_ns and s.topic == message.topic]
    assert said == [reason]
    assert not run.internal_errors()
    assert run.reasons("/pose_fix").get(Reason.FUSED, 0) == undisturbed.reasons("/pose_fix")[Reason.FUSED]
    if reason is not Reason.GATED:  # what fails the gate leaves a doubt
        assert same(run.estimates[-1], undisturbed.estimates[-1])
    assert _is_finite(run)


def test_an_accuracy_of_zero_ends_no_estimate_and_is_said() -> None:
    fixes = [pose_fix(EPOCH_NS + k * SECOND // 2 + 1, yaw=0.3) for k in range(1, 16)]
    forgetful = [msgspec.structs.replace(fix, covariance=np.zeros((6, 6))) for fix in fixes]
    gnss = [GnssFix(fix.t_ns + 1, fix.t_ns + 1, *HOME, np.zeros((3, 3))) for fix in fixes]
    samples = [m for m in hover(8.0) if isinstance(m, ImuSample)]
    run = Run(Fusion(CONFIG)).feed(by_arrival([*samples, *forgetful, *gnss]))
    assert run.estimates[-1].mode is Mode.AIDED
    for topic, key in (("/pose_fix", "position_sigma_m"), ("/gnss", "horizontal_sigma_m")):
        assert run.reasons(topic)[Reason.FUSED] > 2
        assert all(key in s.detail for s in run.statuses if s.topic == topic)
        assert f"{topic}: " in run.health[-1].detail


def test_a_message_of_no_known_kind_is_reported() -> None:
    run = Run(Fusion(CONFIG)).feed([_Alien(NOW, NOW, "/elsewhere")])  # type: ignore[list-item]
    assert [s.reason for s in run.statuses] == [Reason.UNKNOWN_TOPIC]


class _Alien(msgspec.Struct, frozen=True):
    t_ns: int
    arrived_ns: int
    topic: str


def test_what_comes_twice_is_counted_once() -> None:
    fix = _pose()
    run = Run(Fusion(CONFIG)).feed(by_arrival([*hover(8.0), fix, fix, arriving(fix, 0.7)]))
    assert [s.reason for s in run.statuses if s.t_ns == fix.t_ns] == [Reason.DUPLICATE, Reason.FUSED, Reason.DUPLICATE]


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda w, f: (w, (0.0, 0.0, f[2] / 9.80665)), "unit g"),
        (lambda w, f: (w, (0.0, 0.0, f[2] + 9.80665)), "gravity is missing"),
        (lambda _, f: ((40.0, -30.0, 20.0), f), "degrees per second"),
    ],
)
def test_a_stream_in_wrong_units_is_never_integrated_and_health_reports_why(
    change: Callable[[Vec3, Vec3], tuple[Vec3, Vec3]], word: str
) -> None:
    wrong = [ImuSample(m.t_ns, m.t_ns, *change(m.gyro_b, m.accel_b)) if isinstance(m, ImuSample) else m for m in hover(6.0)]
    run = Run(Fusion(CONFIG)).feed(m for m in wrong if isinstance(m, ImuSample) or m.t_ns > EPOCH_NS + SECOND)
    assert not run.estimates
    assert run.health[-1].mode is Mode.STARTING
    assert word in run.health[-1].detail
    assert {s.reason for s in run.statuses} == {Reason.ALIGNING}


def test_one_stamp_far_in_the_future_does_not_stop_the_rest() -> None:
    jumped = [m if k % 50 else msgspec.structs.replace(m, t_ns=m.t_ns + 3600 * SECOND) for k, m in enumerate(hover(8.0)) if k]
    run = Run(Fusion(CONFIG)).feed(jumped)
    assert run.estimates[-1].t_ns > EPOCH_NS + 7 * SECOND
    assert run.estimates[-1].t_ns < EPOCH_NS + 9 * SECOND
    assert sum(s.reason is Reason.IN_FUTURE for s in run.statuses) > 10
    assert run.estimates[-1].mode is Mode.AIDED


def test_a_defect_of_ours_is_reported_and_the_flight_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    fusion = Fusion(CONFIG)
    run = Run(fusion).feed(m for m in hover(4.0))
    with monkeypatch.context() as broken:
        broken.setattr("estimator.fusion.aid_of", lambda *_: 1 / 0)
        run.feed([pose_fix(NOW - SECOND)])
    assert run.internal_errors() == ["internal error: ZeroDivisionError: division by zero"]
    run.feed(hover(3.0, start_ns=EPOCH_NS + 4 * SECOND + 10_000_000))
    assert run.estimates[-1].t_ns == EPOCH_NS + 7 * SECOND + 10_000_000
    assert run.health[-1].counts[Reason.INTERNAL] == 1
    assert "ZeroDivisionError" in run.health[-1].detail


@pytest.mark.parametrize("ruin", ["x", "cov"])
def test_a_state_that_is_lost_is_not_published_and_alignment_begins_again(ruin: str) -> None:
    fusion = Fusion(CONFIG)
    run = Run(fusion).feed(hover(4.0))
    bank = fusion._history.tracker.core.hypotheses
    assert bank is not None
    getattr(bank.lead, ruin)[0] = math.nan
    published = len(run.estimates)
    run.feed(hover(6.0, start_ns=EPOCH_NS + 4 * SECOND + 10_000_000))
    assert _is_finite(run)
    assert len(run.internal_errors()) == 1
    assert "aligning again" in run.internal_errors()[0]
    assert len(run.estimates) > published + 300
    assert run.estimates[-1].mode is Mode.AIDED


# --- anything at all -------------------------------------------------------------------------------------------------------

FOUND_IS_ENOUGH = [Phase.explicit, Phase.reuse, Phase.generate]  # a flight per try: to search for the smallest takes minutes

special = [0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, HUGE, -HUGE, TINY, 1e9, 9e4, 10.0]
numbers = st.one_of(st.sampled_from(special), st.floats(-1e3, 1e3))
triples = st.tuples(numbers, numbers, numbers)
stamps = st.one_of(
    st.integers(EPOCH_NS, EPOCH_NS + 4 * SECOND), st.sampled_from([0, -1, 2**62, EPOCH_NS - 10 * SECOND, EPOCH_NS + 100 * SECOND])
)
delays = st.sampled_from([0, 1, SECOND // 3, -SECOND])


@st.composite
def matrices(draw: st.DrawFn, n: int) -> Array:
    kind = draw(st.sampled_from(["diagonal", "good", "any"]))
    if kind == "good":
        a = np.random.default_rng(draw(st.integers(0, 99))).normal(size=(n, n))
        return a @ a.T * draw(st.sampled_from([1e-12, 1e-3, 1.0, 1e3]))
    if kind == "diagonal":
        return np.diag(draw(st.lists(numbers, min_size=n, max_size=n)))
    return np.array(draw(st.lists(numbers, min_size=n * n, max_size=n * n))).reshape(n, n)


def _stamped(t_ns: int, delay_ns: int) -> tuple[int, int]:
    return t_ns, t_ns + delay_ns


times = st.builds(_stamped, stamps, delays)
poses = st.tuples(triples, st.tuples(numbers, numbers, numbers, numbers) | st.just((1.0, 0.0, 0.0, 0.0)), matrices(6))
covariances = st.none() | matrices(3)
anything: st.SearchStrategy[Input] = st.one_of(
    st.builds(lambda t, w, f: ImuSample(t[0], t[1], w, f), times, triples, triples),
    st.builds(lambda t, p, c: PoseFix(t[0], t[1], p[0], p[1], p[2], c), times, poses, st.none() | matrices(6)),
    st.builds(lambda t, p, c: LandmarkFix(t[0], t[1], p[0], p[1], p[2], c, (), 0.9, 0.5), times, poses, st.none() | matrices(6)),
    st.builds(
        lambda t, p, c, s: GnssFix(t[0], t[1], p[0], p[1], p[2], c, s), times, triples, covariances, st.sampled_from([-1, 0])
    ),
    st.builds(lambda t, v, c: GnssVelocity(t[0], t[1], v, c), times, triples, covariances),
    st.builds(lambda t: Tick(t[0], t[1]), times),
    st.builds(lambda t, p: Reading(t[0], t[1], "/baro", "baro", (p,), np.array([[p]])), times, numbers),
    st.builds(lambda t: Unusable(t[0], t[1], "/left/image", "torn"), times),
)


def test_a_fix_that_reports_its_common_error_may_follow_those_that_do_not() -> None:
    with_common = msgspec.structs.replace(pose_fix(EPOCH_NS + 4 * SECOND - 1, sigma_m=0.2), covariance_common=np.eye(6) * 1e-3)
    run = Run(Fusion(CONFIG)).feed(by_arrival([*hover(4.0, rate_hz=50.0), with_common]))
    assert not run.internal_errors()
    assert run.reasons("/pose_fix")[Reason.FUSED] > 3


def test_a_landmark_may_be_reported_with_other_errors_than_before() -> None:
    def fix(t_ns: int, count: int) -> LandmarkFix:
        errors = 0.05 * np.eye(6)[None, :, :count]
        common = errors[0] @ errors[0].T
        return LandmarkFix(t_ns, t_ns, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.04 * np.eye(6), common, ("a",), 0.9, 0.4, errors)

    last_ns = EPOCH_NS + 4 * SECOND
    fixes = [fix(last_ns - 600_000_000, 4), fix(last_ns - 400_000_000, 2), fix(last_ns - 200_000_000, 6)]
    run = Run(Fusion(CONFIG)).feed(by_arrival([*hover(4.0, rate_hz=50.0), *fixes]))
    assert not run.internal_errors()
    assert run.reasons("/landfix/fix") == {Reason.FUSED: 3}


@settings(max_examples=60, phases=FOUND_IS_ENOUGH)
@given(st.lists(anything, min_size=1, max_size=12))
def test_whatever_comes_no_exception_leaves_and_no_number_that_is_none_is_published(messages: list[Input]) -> None:
    flight = hover(4.0, rate_hz=50.0)
    run = Run(Fusion(CONFIG)).feed(sorted([*flight, *messages], key=lambda m: m.arrived_ns))
    assert not run.internal_errors(), run.internal_errors()
    assert _is_finite(run)
    for e in run.estimates:
        assert state.sound(e.nav, e.covariance)
        assert np.linalg.norm(e.nav[X.Q]) == pytest.approx(1.0, abs=1e-9)
    good = [m for m in flight if isinstance(m, PoseFix)]
    kept = run.last_words("/pose_fix")
    assert all((m.t_ns, "pose") in kept for m in good)
    assert all(isinstance(s, AidStatus) for s in run.statuses)


def _is_refused(message: Input) -> bool:
    """A fresh Fusion refuses it outright."""
    return any(isinstance(out, AidStatus) for out in Fusion(CONFIG).handle(message))


@settings(max_examples=40, phases=FOUND_IS_ENOUGH)
@given(st.lists(anything.filter(_is_refused), min_size=1, max_size=12))
def test_what_is_refused_leaves_no_trace(undisturbed_4s: Run, messages: list[Input]) -> None:
    run = Run(Fusion(CONFIG)).feed(by_arrival([*hover(4.0, rate_hz=50.0), *messages]))
    refused = [s for s in run.statuses if s.topic != "/pose_fix" or s.reason is not Reason.FUSED]
    assert len(refused) >= len(messages)
    assert same(run.estimates[-1], undisturbed_4s.estimates[-1])
    assert run.reasons("/pose_fix")[Reason.FUSED] == undisturbed_4s.reasons("/pose_fix")[Reason.FUSED]


@pytest.fixture(scope="module")
def undisturbed_4s() -> Run:
    return Run(Fusion(CONFIG)).feed(hover(4.0, rate_hz=50.0))


def test_every_kind_of_output_was_seen(undisturbed: Run) -> None:
    """Guards the tests above: there were estimates to be finite and health to be read."""
    assert len(undisturbed.estimates) > 500
    assert all(isinstance(h, Health) for h in undisturbed.health)
    assert all(isinstance(e, Estimate) for e in undisturbed.estimates)
    assert len(undisturbed.health) == 17  # 2 Hz, both ends
    assert np.abs(vec3(undisturbed.estimates[-1].nav[X.P])).max() < 0.05
