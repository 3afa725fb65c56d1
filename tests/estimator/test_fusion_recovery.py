"""No input ends the estimator, and nothing absurd leaves it."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.alignment import Decision
from estimator.filter.bounds import BoundsConfig
from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.history import History
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.tracker import Tracker
from estimator.fusion import Fusion, FusionConfig
from estimator.sources.base.aid import Aid
from models.messages import AttitudePrior, GnssFix, GnssVelocity, ImuSample, Input, Mode, PoseFix, Reason
from models.sim.scenario import EPOCH_NS
from models.state import E, X
from tests import long
from tests.estimator.scenes import SECOND, Run, displaced, hover, pose_fix, same

CONFIG = FusionConfig()
ORIGIN = (47.3977, 8.5456, 488.0)
STEP_NS = SECOND // 200


# --- late fixes at an unlucky moment ---------------------------------------------------------------------------------------


class Rest:
    """A vehicle at rest, IMU at 200 Hz, GNSS position and velocity at gnss_hz, its messages driven through a Fusion."""

    def __init__(self, gnss_hz: float) -> None:
        self.run = Run(Fusion(FusionConfig(origin=ORIGIN)))
        self.every = round(200 / gnss_hz)
        self.now_ns, self.k = EPOCH_NS, 0
        self.rng = np.random.default_rng(0)

    def step(self) -> None:
        self.now_ns += STEP_NS
        self.k += 1
        t = self.now_ns
        messages: list[Input] = [ImuSample(t, t, (0.0, 0.0, 0.01), (0.01, 0.0, -9.81))]
        if self.k % self.every == 0:
            messages.append(GnssFix(t, t, *ORIGIN, np.eye(3)))
            messages.append(GnssVelocity(t, t, (0.0, 0.0, 0.0), np.eye(3) * 0.01))
        self.run.feed(messages)
        self.run.fusion.catch_up()

    def fix(self, late_s: float) -> None:
        p_n = tuple((0.03 * self.rng.standard_normal(3)).tolist())
        t_ns = self.now_ns - round(late_s * 1e9)
        self.run.feed([PoseFix(t_ns, self.now_ns, p_n, (1.0, 0.0, 0.0, 0.0), np.eye(6) * 0.001)])

    def flown(self, seconds: float) -> "Rest":
        for _ in range(round(200 * seconds)):
            if self.k % 400 == 0:
                self.fix(0.0)
            self.step()
        return self


def test_a_burst_of_late_fixes_and_one_later_still() -> None:
    rest = Rest(gnss_hz=5.0).flown(15.0)
    for k in range(100):
        rest.fix(0.5 + 4.5 * k / 100)
    rest.step()
    rest.fix(5.8)
    before = len(rest.run.estimates)
    rest.flown(3.0)
    assert len(rest.run.estimates) == before + 600
    assert not rest.run.internal_errors()


@long.parametrize("gnss_hz", [20.0, 5.0])
def test_a_fix_source_that_falls_behind(gnss_hz: float) -> None:
    """Its delay grows until its fixes are too old."""
    rest = Rest(gnss_hz).flown(8.0)
    before = len(rest.run.estimates)
    for k in range(200 * 20):
        if k % 20 == 0:
            rest.fix(5.0 + k / 200 * 0.075)
        rest.step()
    assert len(rest.run.estimates) == before + 200 * 20
    assert not rest.run.internal_errors()
    assert rest.run.reasons("/pose_fix")[Reason.TOO_OLD] > 50


@pytest.mark.long
def test_work_that_is_late_ends_at_any_rate_of_measurements() -> None:
    """More come in a second than one slice for each sample holds; the tracker keeps pace all the same."""
    rest = Rest(gnss_hz=5.0).flown(8.0)
    for k in range(200 * 4):
        for n in range(5):
            rest.fix(2.0 + 1e-4 * n)
        rest.step()
        if k == 200 * 3:
            ahead = rest.run.fusion._history
            assert rest.now_ns - ahead.tracker.core.t_ns < 3 * SECOND
    rest.flown(4.0)
    assert rest.run.fusion._history._ahead is None
    assert not rest.run.internal_errors()


def test_a_late_fix_from_before_the_first_imu_sample_takes_no_estimate_away() -> None:
    messages = hover(8.0)
    early = [displaced(pose_fix(EPOCH_NS - SECOND // 2, yaw=2.0), (5.0, 0.0, 0.0)), pose_fix(EPOCH_NS - SECOND // 5)]
    run = Run(Fusion(CONFIG)).feed([*messages[:500], *early, *messages[500:]])
    undisturbed = Run(Fusion(CONFIG)).feed(messages)
    assert len(run.estimates) == len(undisturbed.estimates)
    assert same(run.estimates[-1], undisturbed.estimates[-1])
    assert same(Run(Fusion(CONFIG)).feed([*early, *messages]).estimates[-1], undisturbed.estimates[-1])


def test_a_late_first_sample_lets_a_fix_shortly_before_it_begin_the_alignment_after_all() -> None:
    samples = [m for m in hover(6.0) if isinstance(m, ImuSample) and m.t_ns >= EPOCH_NS + SECOND // 5]
    first, fix = samples[0], displaced(pose_fix(EPOCH_NS + 6 * SECOND // 100), (0.3, 0.0, 0.0))
    earlier = replace(first, t_ns=EPOCH_NS + SECOND // 10)
    fixes = [m for m in hover(6.0) if isinstance(m, PoseFix)]
    rest: list[Input] = [*samples[5:], *fixes]
    late = Run(Fusion(CONFIG)).feed([fix, *samples[:5], earlier, *sorted(rest, key=lambda m: m.t_ns)])
    punctual = Run(Fusion(CONFIG)).feed([fix, earlier, *sorted([*samples[:5], *rest], key=lambda m: m.t_ns)])
    assert same(late.estimates[-1], punctual.estimates[-1])


def _prior(t_ns: int, now_ns: int, sigma: float) -> AttitudePrior:
    return AttitudePrior(t_ns, now_ns, (1.0, 0.0, 0.0, 0.0), np.eye(3) * sigma**2)


def test_a_late_measurement_that_would_prevent_the_alignment_does_not_end_a_published_estimate() -> None:
    """At rest the first attitude is all that shows the heading; a vaguer one, late, takes its place and shows too little."""
    rest = Rest(gnss_hz=5.0)
    for k in range(14 * 200):
        if k == 180:
            rest.run.feed([_prior(rest.now_ns, rest.now_ns, 0.03)])
        if k == 4 * 200:
            assert rest.run.estimates
            rest.run.feed([_prior(EPOCH_NS + 190 * STEP_NS, rest.now_ns, 0.3)])
        rest.step()
    stamps = np.array([e.t_ns for e in rest.run.estimates])
    assert np.diff(stamps).max() == STEP_NS
    assert stamps[-1] == rest.now_ns
    assert rest.run.health[-1].mode is Mode.AIDED  # and fixes are fused again
    assert rest.run.fusion._history._ahead is None


# --- defects of ours ------------------------------------------------------------------------------------------------------


def _poisoned(monkeypatch: pytest.MonkeyPatch, poison: PoseFix, act: Callable[[Tracker], None]) -> list[int]:
    """Let the processing of one measurement do something; how often it was tried."""
    tried: list[int] = []
    process = Tracker.process

    def processing(tracker: Tracker, aid: Aid, samples: ImuBuffer) -> Decision:
        if aid.t_ns == poison.t_ns:
            tried.append(aid.t_ns)
            act(tracker)
        return process(tracker, aid, samples)

    monkeypatch.setattr(Tracker, "process", processing)
    return tried


def _raise(tracker: Tracker) -> None:
    assert tracker.core.hypotheses is not None
    tracker.core.hypotheses.lead.x[X.P] = 1e9  # what was half done must not stay
    raise np.linalg.LinAlgError("not positive definite")


@pytest.mark.parametrize("late_s", [0.0, 0.7, 4.0])
def test_a_measurement_that_raises_is_judged_once_and_leaves_no_trace(late_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for rounding: where a measurement stands the IMU interval is split, whatever became of it."""
    messages = hover(12.0)
    poison = pose_fix(EPOCH_NS + 4 * SECOND + 7, late_s=late_s)
    tried = _poisoned(monkeypatch, poison, _raise)
    run = Run(Fusion(CONFIG)).feed(sorted([*messages, poison], key=lambda m: m.arrived_ns))
    undisturbed = Run(Fusion(CONFIG)).feed(messages)
    assert run.internal_errors() == ["internal error: LinAlgError: not positive definite"]
    assert len(tried) == 1
    np.testing.assert_allclose(run.estimates[-1].nav, undisturbed.estimates[-1].nav, atol=1e-12)
    np.testing.assert_allclose(run.estimates[-1].covariance, undisturbed.estimates[-1].covariance, atol=1e-12)
    assert len(run.estimates) == len(undisturbed.estimates)
    assert run.health[-1].counts[Reason.INTERNAL] == 1


def test_a_measurement_after_which_the_state_is_not_finite_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    messages = hover(6.0)
    poison = pose_fix(EPOCH_NS + 4 * SECOND + 7)
    update = Eskf.update

    def ruining(eskf: Eskf, seen: Innovation) -> None:
        update(eskf, seen)
        if eskf.t_ns == poison.t_ns:
            eskf.x[X.P], eskf.sound = math.nan, False

    monkeypatch.setattr(Eskf, "update", ruining)
    run = Run(Fusion(CONFIG)).feed(sorted([*messages, poison], key=lambda m: m.arrived_ns))
    assert run.internal_errors() == ["internal error: ArithmeticError: the state is not finite after it"]
    assert len(run.estimates) == len(Run(Fusion(CONFIG)).feed(messages).estimates)
    assert np.isfinite(run.estimates[-1].nav).all()


@pytest.mark.parametrize(("failures", "word"), [(2, "restarted from the last sound state"), (4, "aligning again")])
def test_what_moves_the_state_fails_again_and_again(failures: int, word: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fusion = Fusion(CONFIG)
    run = Run(fusion).feed(hover(4.0))
    advance, calls = History.advance, itertools.count()

    def failing(history: History, to_ns: int, *, coast: bool = False) -> Tracker:
        if next(calls) < failures:
            raise IndexError("list index out of range")
        return advance(history, to_ns, coast=coast)

    monkeypatch.setattr(History, "advance", failing)
    published = len(run.estimates)
    run.feed(hover(4.0, start_ns=EPOCH_NS + 4 * SECOND + 10_000_000))
    assert word in run.internal_errors()[-1]
    assert len(run.estimates) >= published + 400 - failures - (160 if failures == 4 else 0)
    assert run.estimates[-1].mode is Mode.AIDED
    assert "internal error: IndexError" in run.health[-1].detail


def test_an_input_that_raises_outside_of_the_state_restarts_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    fusion = Fusion(CONFIG)
    run = Run(fusion).feed(hover(4.0))
    history = fusion._history
    with monkeypatch.context() as broken:
        broken.setattr("estimator.fusion.aid_of", lambda *_: 1 / 0)
        run.feed(pose_fix(EPOCH_NS + 4 * SECOND - k) for k in range(20))
    assert fusion._history is history
    assert len(run.internal_errors()) == 20


# --- bounds ----------------------------------------------------------------------------------------------------------------


def _state() -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    x = np.zeros(X.SIZE)
    x[X.Q] = 1.0, 0.0, 0.0, 0.0
    return x, np.eye(E.SIZE)


@pytest.mark.parametrize(
    ("part", "value", "word"),
    [
        (X.V, (150.0, 150.0, 0.0), "speed of 212 m/s"),
        (X.V, (math.nan, 0.0, 0.0), "speed of nan"),
        (X.P, (0.0, 0.0, -30_000.0), "height of 30100 m"),
        (X.P, (0.0, 0.0, 2_000.0), "height of -1900 m"),
    ],
)
def test_a_state_beyond_any_vehicle_is_a_violation(part: slice, value: tuple[float, ...], word: str) -> None:
    x, cov = _state()
    assert BoundsConfig().violation(x, cov, 100.0) == ""
    x[part] = value
    assert word in BoundsConfig().violation(x, cov, 100.0)


def test_bounds_of_a_vehicle_and_of_the_configuration() -> None:
    x, cov = _state()
    x[X.V] = 0.0, 100.0, 0.0
    assert "speed_m_s = 60" in BoundsConfig(vehicle="multirotor").violation(x, cov, 0.0)
    assert BoundsConfig(vehicle="fixed_wing").violation(x, cov, 0.0) == ""
    assert BoundsConfig(vehicle="multirotor", speed_m_s=110.0).violation(x, cov, 0.0) == ""
    cov[0, 0] = 1e12
    assert "position sigma of 1e+06 m" in BoundsConfig(vehicle="fixed_wing").violation(x, cov, 0.0)


def test_an_unknown_heading_is_no_violation_but_an_unknown_tilt_is() -> None:
    x, cov = _state()
    cov[E.THETA, E.THETA] = np.diag([0.01, 0.01, 10.0])
    assert BoundsConfig().violation(x, cov, 0.0) == ""
    cov[E.THETA, E.THETA] = np.diag([10.0, 0.01, 0.01])
    assert "roll and pitch" in BoundsConfig().violation(x, cov, 0.0)


def test_a_state_out_of_bounds_is_not_published_and_the_estimator_begins_again() -> None:
    fusion = Fusion(CONFIG)
    run = Run(fusion).feed(hover(4.0))
    bank = fusion._history.tracker.core.hypotheses
    assert bank is not None
    bank.lead.x[X.V] = 0.0, 0.0, -500.0
    counter = run.estimates[-1].reset_counter
    run.feed(hover(6.0, start_ns=EPOCH_NS + 4 * SECOND + 10_000_000))
    assert max(float(np.linalg.norm(e.nav[X.V])) for e in run.estimates) < 10.0
    (status,) = [s for s in run.statuses if s.kind == "state"]
    assert status.reason is Reason.IMPLAUSIBLE
    assert "speed of 500 m/s exceeds [bounds] speed_m_s = 200; aligning again" in status.detail
    assert run.estimates[-1].reset_counter == counter + 1
    assert run.estimates[-1].mode is Mode.AIDED
    assert run.health[-1].counts[Reason.IMPLAUSIBLE] == 1
    assert not run.internal_errors()


def test_a_gnss_that_diverges_leaves_the_state_finite_bounded_and_uncertain() -> None:
    """A receiver whose position and velocity wander by tens of metres a second next to a vehicle at rest."""
    rng = np.random.default_rng(3)
    rest = Rest(gnss_hz=5.0).flown(12.0)
    offset, speed = np.zeros(3), np.zeros(3)
    for k in range(200 * 40):
        rest.now_ns += STEP_NS
        t = rest.now_ns
        messages: list[Input] = [ImuSample(t, t, (0.0, 0.0, 0.01), (0.01, 0.0, -9.81))]
        if k % 40 == 0:
            speed = 0.9 * speed + 12.0 * rng.standard_normal(3)
            offset += 0.2 * speed
            lat, lon = ORIGIN[0] + offset[0] / 111_000.0, ORIGIN[1] + offset[1] / 75_000.0
            messages.append(GnssFix(t, t, lat, lon, ORIGIN[2] - offset[2], np.eye(3) * 16.0))
            messages.append(GnssVelocity(t, t, (float(speed[0]), float(speed[1]), float(speed[2])), None))
        rest.run.feed(messages)
    wild = [e for e in rest.run.estimates if e.t_ns > EPOCH_NS + 12 * SECOND]
    assert len(wild) > 200
    assert len(wild) > 200 * 38 or "contradicts" in rest.run.health[-1].detail
    assert np.isfinite([e.nav for e in wild]).all()
    assert max(float(np.linalg.norm(e.nav[X.V])) for e in wild) <= 200.0
    sigma = np.array([np.sqrt(np.diag(e.covariance)) for e in wild])
    assert np.isfinite(sigma).all()
    assert sigma[:, E.THETA].max() < math.pi
    assert not rest.run.internal_errors()
