"""The estimator, messages in, estimates out: one object for daemon, replay, simulation, tests."""

import math
from collections.abc import Callable
from itertools import chain
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from estimator.filter.alignment import FilterConfig, TrackerConfig
from estimator.filter.bounds import BoundsConfig
from estimator.filter.eskf import Eskf
from estimator.filter.history import Entry, History
from estimator.filter.quiet import Quiet
from estimator.filter.tracker import Tracker
from estimator.integrity.config import IntegrityConfig
from estimator.integrity.faults import sigmas
from estimator.integrity.monitor import Monitor
from estimator.sources.aids import aid_of
from estimator.sources.air.drag import EVERY_NS as DRAG_EVERY_NS
from estimator.sources.air.drag import drag_aid
from estimator.sources.air.wind import WIND
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.base.covariance import covariance_refusal
from estimator.sources.base.held import HeldImu
from estimator.sources.imu.choice import Choice, imu_aid
from estimator.sources.imu.plausibility import sample_refusal
from estimator.sources.rest import EVERY_NS as REST_EVERY_NS
from estimator.sources.rest import rest_aid
from models import imu, so3, state
from models.frames import Origin
from models.messages import (
    AidStatus,
    Array,
    Checkpoint,
    Estimate,
    Health,
    ImuSample,
    Input,
    LastGnss,
    Mode,
    Output,
    Reason,
    Reset,
    Tick,
    Unusable,
    Vec3,
    on_earth,
    vec3,
)
from models.state import E, X

_OUT_OF_SYNC_SAMPLES, _OUT_OF_SYNC_NS = 20, 1_000_000_000  # of IMU stamps that are off, before they are taken for the new clock
_FAILURES = 2  # in a row, after which the estimator restarts itself
_FUTURE_NS: Final = 1_000_000_000  # by which a stamp may run ahead of its stream's clock
# Of a checkpoint: position [m], half way round the Earth, velocity [m/s], quaternion, biases [rad/s, m/s^2]
_MOST: Final = np.repeat([2e7, 2e3, 1.1, 10.0, 100.0], [3, 3, 4, 3, 3])
_UNIT: Final = 1e-6  # by which |q|^2 may differ from 1
_OLDEST_S: Final = 1e9  # age of the last GNSS
_RESET_SIGMA: Final = 5.0  # a larger jump is reported as a reset
_BIASES = [f"{sensor}_{axis}{end}" for sensor in ("gyro", "accel") for axis in "xyz" for end in ("", "_sigma")]
_RADIUS95 = 2.4477468  # sqrt of the 95 % point of chi-square with 2 degrees of freedom


class EstimatorConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[estimator]: how far back it looks, and how it speaks."""

    history_s: Annotated[float, Meta(ge=0.01, le=60, description="s: measurements may be late by this much")] = 6.0
    health_hz: Annotated[float, Meta(ge=0.01, le=10, description="Hz: rate of /landfix/health")] = 2.0


class FusionConfig(FilterConfig, frozen=True, kw_only=True):
    """All parameters of the estimator."""

    estimator: EstimatorConfig = EstimatorConfig()
    bounds: BoundsConfig = BoundsConfig()
    integrity: IntegrityConfig = IntegrityConfig()
    imu_topics: tuple[str, ...] = ()
    imu_factors: tuple[float, ...] = ()  # noise of the others, in that of the first


class Fusion:
    """The estimator: `handle(message)` never raises; defects are counted and reported."""

    def __init__(self, config: FusionConfig) -> None:
        self._config = config
        self._history = self._begin()
        self._questions = self._asked()
        self._imus = Choice(config.imu_topics)
        self._held = HeldImu()
        self._counts: dict[str, int] = {}
        self._integrity = Monitor(config.integrity)
        self._detail = ""
        self._assumed: dict[str, str] = {}  # topic -> what was taken in place of what it does not give
        self._health_period_ns = round(1e9 / config.estimator.health_hz)
        self._next_health_ns: int | None = None
        self._out_of_sync: tuple[int, int, int] | None = None  # count, first arrival, last stamp of samples off our clock
        self._gap_ns = round(config.coast.gap_s * 1e9)
        self._early_ns = min(self._gap_ns, _FUTURE_NS)
        self._early: dict[str, ImuSample] = {}  # by topic: further ahead than a gap, until a second one is as well
        self._lead: tuple[int, int] | None = None  # stamps of IMU and ticks ahead of their arrivals, and as of when
        self._failures = 0  # in a row, of what moves the state
        self._reset_counter = 0
        self._published: Estimate | None = None
        self._publisher: Tracker | None = None  # of the last estimate

    def handle(self, message: Input) -> list[Output]:
        """Take one message; outputs in order."""
        moves = True  # the state, rather than a measurement that is to take its place
        try:
            quiet = self._history.quiet
            if type(message) is ImuSample:
                out = None if quiet is None else self._next(message, quiet)
                if out is None:
                    self._history.catch_up()
                    out = self._imu(message)
            else:
                self._history.catch_up()
                moves = type(message) is Tick
                out = self._other(message)
        except Exception as error:
            self._history.quiet = None
            self._detail = f"internal error: {type(error).__name__}: {error}"
            out = [self._refuse(message, Refusal(Reason.INTERNAL, self._detail))]
            if moves:
                self._failures += 1
                if self._failures % _FAILURES == 0:
                    out.append(self._recover(message))
        else:
            if moves:
                self._failures = 0
        return out

    def _recover(self, message: Input) -> AidStatus:
        """Go on from the last sound checkpoint, the next time from nothing."""
        sound = self._history.from_last_sound() if self._failures == _FAILURES else None
        if sound is None:
            return self._restart(None, message.t_ns, message.arrived_ns, Reason.INTERNAL, self._detail)
        self._history = sound
        return self._state_status(
            message.t_ns, message.arrived_ns, Reason.INTERNAL, f"{self._detail}; restarted from the last sound state"
        )

    def catch_up(self) -> None:
        """Work in late measurements; the result is that of the next message."""
        self._history.catch_up()

    def _begin(self, checkpoint: Checkpoint | None = None) -> History:
        config = self._config
        tracker = Tracker(
            TrackerConfig(
                imu=config.imu,
                coast=config.coast,
                initialise=config.initialise,
                origin=Origin.of(config.origin),
                bounds=config.bounds,
                rest=config.rest,
                drag=config.drag,
            )
        )
        if checkpoint is not None:
            tracker.resume(checkpoint)
        return History(tracker, config.estimator.history_s)

    def _asked(self) -> list[tuple[int, Callable[[int], Aid]]]:
        """Questions to the IMU, at stamps independent of the samples."""
        rest, drag, wind = self._config.rest, self._config.drag, self._config.wind
        asked: list[tuple[int, Callable[[int], Aid]]] = []
        if rest.enabled:
            asked.append((REST_EVERY_NS, rest_aid))
        if drag.enabled:
            asked.append((DRAG_EVERY_NS, lambda t_ns: drag_aid(t_ns, wind)))
        return asked

    # --- inputs ---------------------------------------------------------------------------------------------------------

    def _next(self, sample: ImuSample, quiet: Quiet) -> list[Output] | None:
        t_ns, newest_ns, last = sample.t_ns, quiet.samples.newest_ns, self._published
        if (
            not newest_ns < t_ns <= min(quiet.until_ns, newest_ns + self._gap_ns)
            or last is None
            or t_ns <= last.t_ns
            or quiet.tracker is not self._publisher
            or self._early
            or self._imus.is_used
            or (self._questions and self._is_asked(t_ns, newest_ns))
            or self._ahead_ns(sample) > self._early_ns
            or sample_refusal(sample) is not None
        ):
            return None
        if held := self._held.note(sample):
            return self._hold(sample, held)
        self._out_of_sync = None
        self._note_lead(sample)
        tracker, shown = quiet.tracker, self._history.take_next(sample, quiet)
        if shown is None:  # out of bounds
            return self._publish(tracker, t_ns, sample.arrived_ns, sample.gyro_b)
        nav, covariance = shown
        self._published = estimate = self._estimate(tracker, t_ns, sample.arrived_ns, nav, covariance, sample.gyro_b, quiet.mode)
        return [estimate, *self._periodic(tracker, t_ns, sample.arrived_ns)]

    def _imu(self, sample: ImuSample) -> list[Output]:
        ahead_ns = self._ahead_ns(sample)
        refusal = sample_refusal(sample) or (self._future(sample) if ahead_ns > self._early_ns else None)
        if refusal is not None:
            return self._refuse_sample(sample, refusal)
        if self._early and (early := self._early.pop(sample.topic, None)) is not None:
            if sample.t_ns <= early.t_ns:  # the stamps go on where they were
                return [self._refuse(early, Refusal(Reason.IN_FUTURE, "no other sample is as far ahead")), *self._imu(sample)]
            return [*self._take_sample(early), *self._take_sample(sample)]
        if ahead_ns > self._early_ns:
            self._early[sample.topic] = sample
            return []
        return self._take_sample(sample)

    def _take_sample(self, sample: ImuSample) -> list[Output]:
        if self._imus.is_used:
            changed = self._change_imu(sample)
            if not self._imus.leads(sample):
                return []
            if changed:
                return self._advance(sample)
        elif held := self._held.note(sample):
            return self._hold(sample, held)
        if (reason := self._history.insert_sample(sample)) is not None:
            return self._refuse_sample(sample, Refusal(reason))
        self._out_of_sync = None
        return self._advance(sample)

    def _hold(self, sample: ImuSample, why: str) -> list[Output]:
        return [self._refuse(sample, Refusal(Reason.HELD, why)), *self._tick(Tick(sample.t_ns, sample.arrived_ns))]

    def _refuse_sample(self, sample: ImuSample, refusal: Refusal) -> list[Output]:
        return [self._refuse(sample, refusal), *self._clock_stepped(sample, refusal)]

    def _change_imu(self, sample: ImuSample) -> bool:
        change = self._imus.note(sample, is_refuted=self._history.tracker.is_refuted)
        if change is None:
            return False
        since_ns = self._history.change_imu(change.since_ns, change.samples)
        initial = self._config.initialise
        unknown = initial.gyro_bias_sigma, initial.accel_bias_sigma
        factors = dict(zip(self._config.imu_topics[1:], self._config.imu_factors, strict=False))
        self._history.insert_aid(imu_aid(change, since_ns, sample.arrived_ns, unknown, factors.get(change.topic, 1.0)))
        return True

    def _advance(self, sample: ImuSample) -> list[Output]:
        if sample.t_ns != self._history.samples.newest_ns:  # late: what it changes shows in the next output
            return []
        self._note_lead(sample)
        for period_ns, question in self._questions:
            asked_ns = sample.t_ns // period_ns * period_ns
            if asked_ns > self._history.samples.previous_ns:
                self._history.insert_aid(question(asked_ns))
        tracker = self._history.advance(sample.t_ns)
        return self._publish(tracker, sample.t_ns, sample.arrived_ns, sample.gyro_b)

    def _is_asked(self, t_ns: int, since_ns: int) -> bool:
        return any(t_ns // period_ns * period_ns > since_ns for period_ns, _ in self._questions)

    def _other(self, message: Input) -> list[Output]:
        match message:
            case Tick():
                return self._tick(message)
            case Checkpoint():
                return self._resume(message)
            case Unusable():
                return [self._refuse(message, Refusal(Reason.MALFORMED, message.detail))]
            case _:
                aid = aid_of(message, self._config)
                return self._aid(message, Refusal(Reason.UNKNOWN_TOPIC) if aid is None else aid)

    def _aid(self, message: Input, aid: Aid | Refusal) -> list[Output]:
        refusal = aid if isinstance(aid, Refusal) else self._future(message)
        if refusal is None and isinstance(aid, Aid) and (reason := self._history.insert_aid(aid)) is not None:
            refusal = Refusal(reason)
        if refusal is None and isinstance(aid, Aid) and aid.assumed:
            self._assumed[aid.topic] = aid.assumed
        return [] if refusal is None else [self._refuse(message, refusal)]

    def _tick(self, tick: Tick) -> list[Output]:
        if refusal := self._future(tick):
            return [self._refuse(tick, refusal)]
        self._note_lead(tick)
        samples = self._history.samples
        if not samples.count or (tick.t_ns - samples.newest_ns) * 1e-9 <= self._config.coast.gap_s:
            return []
        tracker = self._history.advance(tick.t_ns, coast=True).copy()
        tracker.propagate(samples, tick.t_ns)
        return self._publish(tracker, tick.t_ns, tick.arrived_ns, vec3(samples.u[samples.count - 1]))

    def _resume(self, checkpoint: Checkpoint) -> list[Output]:
        refusal = None
        if self._history.samples.count:
            refusal = Refusal(Reason.TOO_OLD, "the estimate has begun already")
        elif not _is_whole(checkpoint):
            refusal = Refusal(Reason.MALFORMED, "a state of 16 numbers, its covariance of 15 x 15 and the last GNSS are expected")
        elif not state.sound(checkpoint.nav, checkpoint.covariance):
            refusal = Refusal(Reason.NOT_FINITE)
        elif not _is_plausible(checkpoint):
            refusal = Refusal(Reason.IMPLAUSIBLE, "a place, velocity, attitude or bias that no vehicle and no IMU has")
        elif flawed := covariance_refusal(checkpoint.covariance):
            refusal = flawed
        elif self._config.origin not in {None, checkpoint.origin}:
            refusal = Refusal(Reason.NO_ORIGIN, "the map had another origin")
        if refusal is not None:
            return [self._refuse(checkpoint, refusal)]
        if self._imus.is_used:  # it does not say which of them led
            initial = self._config.initialise
            sigma = np.repeat([initial.gyro_bias_sigma, initial.accel_bias_sigma], 3)
            covariance = checkpoint.covariance + np.diag(np.concatenate([np.zeros(E.BG.start), 2.0 * sigma**2]))
            checkpoint = replace(checkpoint, covariance=covariance)
        self._history = self._begin(checkpoint)
        self._reset_counter = checkpoint.reset_counter
        return []

    def _note_lead(self, message: ImuSample | Tick) -> None:
        """Bound the clock offset by the quickest message, relaxed by 0.1 s in a second."""
        lead_ns = message.t_ns - message.arrived_ns
        if self._lead is not None:
            quickest_ns, noted_ns = self._lead
            if message.arrived_ns > noted_ns:
                quickest_ns -= (message.arrived_ns - noted_ns) // 10
            lead_ns = max(lead_ns, quickest_ns)
        self._lead = lead_ns, message.arrived_ns

    def _future(self, message: Input) -> Refusal | None:
        """A stamp ahead of the stamps' clock, by arrivals, by more than 1 s."""
        ahead_ns = self._ahead_ns(message)
        return Refusal(Reason.IN_FUTURE, f"{ahead_ns * 1e-9:.1f} s ahead") if ahead_ns > _FUTURE_NS else None

    def _ahead_ns(self, message: Input) -> int:
        if self._lead is None:
            return 0
        lead_ns, noted_ns = self._lead
        return message.t_ns - max(message.arrived_ns, noted_ns) - lead_ns

    # --- outputs --------------------------------------------------------------------------------------------------------

    def _publish(self, tracker: Tracker, t_ns: int, arrived_ns: int, gyro: Vec3) -> list[Output]:
        out: list[Output] = []
        changed = self._history.changed()
        last = self._published
        shown = tracker.alignment.shown
        if shown is not None and (last is None or t_ns > last.t_ns):
            lead = shown.lead
            if not lead.sound:
                return [self._restart(tracker, t_ns, arrived_ns, Reason.INTERNAL, "internal error: the state is not finite")]
            if violation := tracker.violation(lead):
                return [self._restart(tracker, t_ns, arrived_ns, Reason.IMPLAUSIBLE, violation)]
            redone = tracker is not self._publisher
            self._publisher = tracker
            covariance = tracker.shown_covariance()
            jump = None
            if last is not None and (changed or redone):
                jump = self._jump(last, lead, covariance, t_ns, is_aligned=tracker.core.is_aligned)
            if jump is not None:
                self._reset_counter += 1
                self._integrity.at_once()
                p, v, theta = vec3(jump[E.P]), vec3(jump[E.V]), vec3(so3.matrix(lead.x[X.Q]) @ jump[E.THETA])
                out.append(Reset(t_ns, arrived_ns, self._reset_counter, p, v, theta))
            mode = tracker.mode(self._history.samples.newest_ns, t_ns)
            self._published = self._estimate(tracker, t_ns, arrived_ns, lead.x.copy(), covariance, gyro, mode)
            out.append(self._published)
        if changed:
            out += [self._aid_status(entry) for entry in changed]
        return out + self._periodic(tracker, t_ns, arrived_ns)

    def _estimate(
        self, tracker: Tracker, t_ns: int, arrived_ns: int, nav: Array, covariance: Array, gyro: Vec3, mode: Mode
    ) -> Estimate:
        bx, by, bz = nav[X.BG].tolist()
        rate, absolute_ns = (gyro[0] - bx, gyro[1] - by, gyro[2] - bz), tracker.core.last_absolute_ns
        return Estimate(t_ns, arrived_ns, nav, covariance, rate, mode, self._reset_counter, absolute_ns, tracker.place)

    def _periodic(self, tracker: Tracker, t_ns: int, arrived_ns: int) -> list[Output]:
        out: list[Output] = []
        levels, health = self._integrity.due(t_ns), self._next_health_ns is None or t_ns >= self._next_health_ns
        if levels or health:
            tracker.propagate(self._history.samples, tracker.core.t_ns)  # hypotheses that do not show
        if levels:
            out.append(self._integrity.at(tracker, t_ns, arrived_ns))
        if health:
            self._next_health_ns = t_ns + self._health_period_ns
            out.append(self._health(tracker, t_ns, arrived_ns))
        return out

    def _jump(self, last: Estimate, lead: Eskf, published: Array, t_ns: int, *, is_aligned: bool) -> Array | None:
        """Step from the last published estimate, None within noise; published (15, 15): used without a heading."""
        doubt = lead.cov if is_aligned else published
        sigmas = _RESET_SIGMA * (math.sqrt(lead.variance_factor) if is_aligned else 1.0)
        samples = self._history.samples
        first = samples.first_after(last.t_ns)
        went_to = imu.moved(last.nav, samples.t_ns, samples.u, samples.count, first, last.t_ns, t_ns, lead.constants)
        return state.local(went_to, lead.x) if state.has_moved(went_to, lead.x, doubt, sigmas) else None

    def _clock_stepped(self, sample: ImuSample, refusal: Refusal) -> list[Output]:
        if refusal.reason not in {Reason.IN_FUTURE, Reason.TOO_OLD}:
            return []
        count, since_ns, last_ns = self._out_of_sync or (0, sample.arrived_ns, sample.t_ns)
        if not 0 <= sample.t_ns - last_ns < _FUTURE_NS:
            count, since_ns = 0, sample.arrived_ns
        self._out_of_sync = (count + 1, since_ns, sample.t_ns)
        if count < _OUT_OF_SYNC_SAMPLES or sample.arrived_ns - since_ns < _OUT_OF_SYNC_NS:
            return []
        self._out_of_sync = self._lead = self._next_health_ns = None
        self._early.clear()
        self._imus.forget()
        return [self._restart(None, sample.t_ns, sample.arrived_ns, Reason.IN_FUTURE, "the clock of the IMU has stepped")]

    def _restart(self, tracker: Tracker | None, t_ns: int, arrived_ns: int, reason: Reason, detail: str) -> AidStatus:
        """Align anew, a jump of unknown size.

        tracker: keeps its map and sources; None: times are of another clock.
        """
        self._history = History(tracker.restarted(), self._config.estimator.history_s) if tracker else self._begin()
        self._integrity.begin_again()
        self._reset_counter += self._published is not None
        self._published = None
        return self._state_status(t_ns, arrived_ns, reason, f"{detail}; aligning again")

    def _state_status(self, t_ns: int, arrived_ns: int, reason: Reason, detail: str) -> AidStatus:
        self._detail = detail
        self._count(reason)
        return AidStatus(t_ns, arrived_ns, "", "state", reason, detail=detail)

    def _aid_status(self, entry: Entry) -> AidStatus:
        aid, decision = entry.aid, entry.decision
        assert decision is not None
        if entry.counted is not None:
            self._counts[entry.counted] -= 1
        entry.counted = decision.reason
        self._count(decision.reason)
        status = AidStatus(
            aid.t_ns,
            aid.arrived_ns,
            aid.topic,
            aid.kind,
            decision.reason,
            entry.revision,
            decision.innovation,
            decision.innovation_sigma,
            decision.test_ratio,
            (aid.arrived_ns - aid.t_ns) * 1e-9,
            entry.replayed,
            "; ".join(filter(None, (decision.detail, aid.assumed))),
        )
        self._integrity.note(status, decision.position)
        return status

    def _refuse(self, message: Input, refusal: Refusal) -> AidStatus:
        self._count(refusal.reason)
        delay_s = (message.arrived_ns - message.t_ns) * 1e-9
        kind = type(message).__name__
        return AidStatus(
            message.t_ns, message.arrived_ns, message.topic, kind, refusal.reason, delay_s=delay_s, detail=refusal.detail
        )

    def _count(self, reason: Reason) -> None:
        self._counts[reason] = self._counts.get(reason, 0) + 1

    def _say(self, tracker: Tracker) -> str:
        said = self._detail or (tracker.detail if not tracker.core.is_aligned else "")
        said = "; ".join(filter(None, (said, self._imus.remark(self._history.samples.newest_ns), self._held.says)))
        return "; ".join(
            filter(None, (said, *tracker.remarks, *(f"{topic}: {text}" for topic, text in sorted(self._assumed.items()))))
        )

    def _health(self, tracker: Tracker, t_ns: int, arrived_ns: int) -> Health:
        hypotheses = tracker.alignment.bank
        radius = attitude = math.inf
        biases: dict[str, float] = {}
        if hypotheses is not None and tracker.alignment.shown is not None and self._published is not None:
            cov = self._published.covariance
            radius = _RADIUS95 * sigmas(cov[E.P, E.P])[0]
            attitude = math.degrees(math.sqrt(max(cov.diagonal().tolist()[E.THETA])))
            biases = _biases(hypotheses.lead.x, cov) | _wind(hypotheses.lead)
        never = tracker.core.last_absolute_ns < 0
        return Health(
            t_ns,
            arrived_ns,
            tracker.mode(self._history.samples.newest_ns, t_ns),
            math.inf if never else (t_ns - tracker.core.last_absolute_ns) * 1e-9,
            radius,
            attitude,
            self._reset_counter,
            {topic: source.phase_at(t_ns).value for topic, source in sorted(tracker.sources.items())} | self._imus.states(t_ns),
            dict(sorted(self._counts.items())),
            len(hypotheses.members) if hypotheses is not None else 0,
            tracker.anchor.at(t_ns) if tracker.anchor else None,
            self._say(tracker),
            biases,
            self._integrity.summary,
            hypotheses.weights if hypotheses is not None and tracker.core.is_aligned else {},
        )


def _is_whole(checkpoint: Checkpoint) -> bool:
    arrays: list[tuple[object, tuple[int, ...]]] = [(checkpoint.nav, (X.SIZE,)), (checkpoint.covariance, (E.SIZE, E.SIZE))]
    fits = all(isinstance(a, np.ndarray) and a.shape == shape and a.dtype == np.float64 for a, shape in arrays)
    last_gnss: object = checkpoint.last_gnss
    return fits and isinstance(last_gnss, LastGnss | None)


def _is_plausible(checkpoint: Checkpoint) -> bool:
    last, q = checkpoint.last_gnss, checkpoint.nav[X.Q]
    places = ([] if last is None else [(last.lat_deg, last.lon_deg, last.alt_m)]) + [checkpoint.origin or (0.0, 0.0, 0.0)]
    return (
        bool((np.abs(checkpoint.nav) <= _MOST).all())
        and abs(float(q @ q) - 1.0) < _UNIT
        and all(on_earth(*place) for place in places)
        and (last is None or (0.0 <= last.age_s < _OLDEST_S and 0.0 <= last.sigma_m < math.inf))
    )


def _biases(x: Array, cov: Array) -> dict[str, float]:
    known = zip(x.tolist()[X.BG.start :], np.sqrt(cov.diagonal()[E.BG.start :]).tolist(), strict=True)
    return dict(zip(_BIASES, chain.from_iterable(known), strict=True))


def _wind(lead: Eskf) -> dict[str, float]:
    if (at := lead.slow.columns.get(WIND)) is None:
        return {}
    known = zip(("north", "east"), lead.slow.of(WIND).tolist(), np.sqrt(lead.cov.diagonal()[at]).tolist(), strict=True)
    return {f"wind_{axis}{end}": number for axis, *pair in known for end, number in zip(("", "_sigma"), pair, strict=True)}
