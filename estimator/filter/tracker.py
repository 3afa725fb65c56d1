"""State of the estimator at one instant: all that a checkpoint keeps.

It changes by measurements in order of validity alone.
"""

import math
from collections.abc import Mapping

import numpy as np
from msgspec.structs import replace

from estimator.filter import contradiction, remarks
from estimator.filter.alignment import (
    AT_REST,
    NEVER,
    NO_POSITION,
    WRONG_SENSOR,
    Alignment,
    Core,
    Decision,
    TrackerConfig,
    lacks,
    widen_unaligned,
)  # fmt: skip
from estimator.filter.bounds import limits
from estimator.filter.conflict import Conflicts
from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.hypotheses import Hypotheses, Hypothesis, Verdict
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.imu_evidence import FELT, ImuEvidence
from estimator.filter.mismatch import (
    CONSTANTS,
    DELAY,
    BiasWalk,
    Frame,
    Means,
    Scatter,
    Scatters,
    Scores,
    between,
    delay,
    scatter,
    score,
    speed_step,
)  # fmt: skip
from estimator.filter.relative import steps
from estimator.filter.relinearise import Stretch
from estimator.filter.variance_factor import NO_EXCESS
from estimator.sources.air.through_air import AirVelocity, DragForce
from estimator.sources.base import held
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.base.faults import LONG_NS, RECENT_NS
from estimator.sources.base.machine import Phase, SourceState
from estimator.sources.gnss_anchor import GnssAnchor
from estimator.sources.imu.choice import ImuAid
from estimator.sources.landmark import position_innovation
from estimator.sources.odometry import Kept, OdometryAid
from models import imu
from models.frames import Origin
from models.measurements import Conditional, Heading, Measurement, PartialPose, Pose, Position, Velocity
from models.messages import Array, Checkpoint, Mode, Reason
from models.state import XYZ, E, X

_ALWAYS_NS = 2**62
_NO_PLACE = "give [map] origin to use GNSS or a magnetometer together with fixes on a local map"
_UNKNOWN = SourceState()
_SPOOFED = "its receiver reports spoofing"
_NO_RATE = np.zeros(3)
_FOR_ALIGNED = "odometry is used once aligned"
_NOT_YET = "used once the attitude is known: false axes would mislead the alignment"
_REFUTED = 2  # positions in a row
_CURRENT_NS = 1_200_000_000  # a position of a receiver at 1 Hz is compared with a fix


class Tracker:
    """Hypotheses, alignment, source machines, last known values."""

    def __init__(self, config: TrackerConfig) -> None:
        self.core = Core(config)
        self.alignment = Alignment(self.core)
        self.imu = ImuEvidence(self.core)
        self.place = config.origin.lla if config.origin else None
        self.sources: dict[str, SourceState] = {}
        self.failed: dict[str, int] = {}  # gates in a row, of sources of positions and their velocities; never changed in place
        self.held_ns: dict[str, int] = {}  # when a source last repeated a reading; never changed in place
        self.last_odometry_ns = NEVER
        self.kept: dict[str, Kept] = {}  # poses that the filters keep, by topic of odometry
        self.anchor: GnssAnchor | None = None
        self.frames: dict[str, Frame] = {}  # of pose sources; never changed in place
        self.receiver: tuple[str, int, Array] | None = None  # topic, time and position of the newest
        self.means: Means = {}  # of sources of fixes
        self.between: Array | None = None  # (3, 3) of the position, by what they differ by
        self.scores: Scores = {}  # of constants of the sources
        self.late_cov: Array | None = None  # (3, 3) of the position, by a delay that the newest fix may have
        self.speed_steps: speed_step.Steps = {}
        self.bias_walk = BiasWalk()
        self.scatter: Scatters = {}  # of sources of positions, and their velocities

    def copy(self) -> "Tracker":
        """An independent copy; immutable parts are shared."""
        other = object.__new__(Tracker)
        other.__dict__ = self.__dict__.copy()
        other.core = self.core.copy()
        other.alignment, other.imu = self.alignment.copy(other.core), self.imu.copy(other.core)
        other.sources, other.kept = self.sources.copy(), self.kept.copy()
        return other

    def restarted(self) -> "Tracker":
        """A tracker without estimate, same map and trust."""
        other, core = Tracker(self.core.config), self.core
        other.core.origin, other.core.constants, other.core.noise = core.origin, core.constants, core.noise
        other.core.absolute, other.core.last_absolute_ns = core.absolute, core.last_absolute_ns
        other.core.receivers = core.receivers
        other.sources, other.place, other.anchor = self.sources.copy(), self.place, self.anchor
        other.alignment.given_up = self.alignment.given_up
        other.frames, other.scatter = self.frames, self.scatter
        other.scores, other.bias_walk = self.scores, self.bias_walk
        return other

    @property
    def is_refuted(self) -> bool:
        """No hypothesis predicted the last positions, or a position source keeps failing its gate."""
        return self.alignment.contradiction.unforeseen >= _REFUTED or max(self.failed.values(), default=0) >= _REFUTED

    @property
    def standing(self) -> int:
        """2 aligned, 1 without a heading, 0 none."""
        return 2 if self.core.is_aligned else int(self.alignment.shown is not None)

    def shown_covariance(self, mixed: Array | None = None) -> Array:
        """Covariance shown; mixed: that of the hypotheses."""
        core = self.core
        bank = self.alignment.bank
        assert bank is not None
        cov = bank.covariance() if mixed is None else mixed
        if not core.is_aligned:
            widen_unaligned(cov, bank, core.config.initialise)
        if (ratio := self.lasting_ratio) > 1.0:
            cov *= ratio
        if (added := self.added) is not None:
            cov[E.P, E.P] += added
        if (stepped := self.step_covariance) is not None:
            cov += stepped
        if core.is_aligned and self.alignment.without_sensor is not None:
            return self.alignment.without_sensor.mixed(cov, bank.lead.x)
        return cov

    @property
    def lasting_ratio(self) -> float:
        """Of the published variance factor to the present one."""
        factor = self.core.variance_factor
        return max(factor.lasting / factor.value, 1.0)

    @property
    def added(self) -> Array | None:
        """(3, 3) of the position, by what no hypothesis has: former fixes, other sources, a delay; None: nothing."""
        core, bank = self.core, self.alignment.bank
        found = [] if self.late_cov is None else [self.late_cov]
        if core.is_aligned and self.between is not None:
            found.append(self.between)
        if core.conflicts.apart:
            found.append(core.conflicts.added(self._undecided))
        if bank is not None and (past := bank.members[0].past):
            found.append(past.added(bank.members[0].fused_ns))
        return sum(found[1:], start=found[0]) if found else None

    @property
    def _undecided(self) -> Mapping[str, float]:
        """Sources against which nothing decides, and their shares."""
        core, bank = self.core, self.alignment.bank
        if not core.is_aligned or bank is None:
            return dict.fromkeys(core.conflicts.apart, 1.0)
        turned = any(frame.is_turned(core.t_ns) for frame in self.frames.values())
        return core.conflicts.shares(doubts_imu=bank.members[0].doubts_imu, turned=turned)

    @property
    def step_covariance(self) -> Array | None:
        """(15, 15), by the steps of receivers' speeds that are followed against the IMU."""
        found = [c for c in (step.covariance for step in self.speed_steps.values()) if c is not None]
        return sum(found[1:], start=found[0]) if found else None

    @property
    def is_sound(self) -> bool:
        """Every number of the leading filter is finite, every variance positive."""
        bank = self.alignment.bank
        return bank is None or bank.lead.sound

    @property
    def shows_mixture(self) -> bool:
        """The covariance shown is the mixture of the hypotheses, but for a factor and what is added to the position."""
        steps = any(step.followed for step in self.speed_steps.values())
        return self.core.is_aligned and self.alignment.without_sensor is None and not steps

    @property
    def limits(self) -> tuple[float, float, float, float]:
        """Limits of what is published (bounds.is_within)."""
        return limits(self.core.config.bounds, self.place[2] if self.place else 0.0)

    def violation(self, eskf: Eskf) -> str:
        """Implausible parts of the state; '' for none."""
        return self.core.config.bounds.violation(eskf.x, eskf.cov, self.place[2] if self.place else 0.0)

    def resume(self, checkpoint: Checkpoint) -> None:
        """Begin aligned in an interrupted run's state."""
        core = self.core
        core.t_ns, core.last_absolute_ns = checkpoint.t_ns, checkpoint.last_absolute_ns
        if checkpoint.origin is not None:
            core.origin, self.place = Origin(*checkpoint.origin), checkpoint.origin
            core.constants = imu.constants(core.noise, core.config.coast, core.origin)
        lead = Eskf(checkpoint.t_ns, checkpoint.nav.copy(), checkpoint.covariance.copy(), core.constants)
        since_ns = max(checkpoint.last_absolute_ns, checkpoint.t_ns - LONG_NS)
        core.hypotheses = Hypotheses([Hypothesis(lead, fused_ns=since_ns, run=1, run_ns=since_ns)])
        core.is_aligned = True
        if (last := checkpoint.last_gnss) is not None:
            place, fixed_ns = (last.lat_deg, last.lon_deg, last.alt_m), checkpoint.t_ns - round(last.age_s * 1e9)
            self.anchor = GnssAnchor(place, fixed_ns, last.sigma_m, float(np.linalg.norm(lead.x[X.V])))

    @property
    def detail(self) -> str:
        """Why there is no estimate."""
        core = self.core
        if self.alignment.plausibility.detail or self.alignment.given_up:
            return self.alignment.plausibility.detail or contradiction.SAYS
        if core.hypotheses is not None:
            return "" if core.is_aligned else lacks(core.hypotheses, core.config.initialise)
        if wrong := remarks.frames(self.frames):
            return "; ".join(wrong)
        return AT_REST if self.alignment.still else NO_POSITION

    @property
    def remarks(self) -> list[str]:
        """Why a published estimate is less certain than configured."""
        core, conflict = self.core, self._conflict()
        if self.alignment.shown is None:
            return []
        other = self.alignment.without_sensor if core.is_aligned else None
        two = self.alignment.two_headings
        undecided = two is not None and core.t_ns < self.alignment.wrong_until_ns.get(two[0], NEVER)
        return [
            *([remarks.two_headings(two)] if two is not None and undecided else ()),
            *filter(None, (conflict, remarks.heading(other.topic) if other is not None else "")),
            *(remarks.apart(core.conflicts, self._undecided) if core.is_aligned and not conflict else ()),
            *remarks.turned(core.hypotheses),
            *remarks.frames(self.frames),
            *remarks.drifts(core.hypotheses),
            *remarks.wrong(self.sources),
            *remarks.refuted(self.sources, core.t_ns),
            *remarks.constants(self.scores, core.hypotheses),
            *remarks.variance(core.variance_factor.lasting),
            *remarks.held(self.held_ns, core.t_ns),
            *remarks.scatter(self.scatter, core.t_ns),
            *speed_step.remarks(self.speed_steps),
            *remarks.imu(core.hypotheses if core.is_aligned else None),
        ]

    def _conflict(self) -> str:
        core = self.core
        return remarks.conflict(core.hypotheses, core.absolute, self.sources, core.t_ns)

    @property
    def needs_from_ns(self) -> int:
        """Oldest IMU sample that may be needed again."""
        oldest, other = self.core.stretch, self.alignment.without_sensor
        if other is not None and other.stretch is not None and (oldest is None or other.stretch.t_ns < oldest.t_ns):
            oldest = other.stretch
        return _ALWAYS_NS if oldest is None else oldest.t_ns

    def propagate(self, samples: ImuBuffer, to_ns: int) -> None:
        """Propagate through the IMU samples to `to_ns`; the state is given up after a minute without any."""
        core = self.core
        if to_ns - core.t_ns > LONG_NS:
            self.alignment.lose()
        for member in self.alignment.members:
            if (since_ns := member.filter.t_ns) < to_ns:  # longer ago for one that does not show (Quiet)
                member.filter.propagate(samples, samples.first_after(since_ns), to_ns)
        core.t_ns = to_ns

    def mode(self, newest_imu_ns: int, t_ns: int) -> Mode:
        """Mode of an estimate for t_ns."""
        core = self.core
        is_coasting = core.is_aligned and core.hypotheses is not None and t_ns - newest_imu_ns > core.gap_ns
        return Mode.COASTING if is_coasting else self.mode_until(t_ns)[0]

    def mode_until(self, t_ns: int) -> tuple[Mode, int]:
        """Mode at t_ns, and how long it lasts."""
        core = self.core
        if core.hypotheses is None or not core.is_aligned:
            if self.alignment.shown is not None:
                return Mode.ALIGNING_HEADING, _ALWAYS_NS
            return Mode.STARTING if self.alignment.plausibility.phase is not Phase.ACTIVE else Mode.ALIGNING, _ALWAYS_NS
        for mode, since_ns in ((Mode.AIDED, core.last_absolute_ns), (Mode.ODOMETRY, self.last_odometry_ns)):
            if t_ns - since_ns <= core.aided_ns:
                return mode, since_ns + core.aided_ns
        return Mode.DEAD_RECKONING, _ALWAYS_NS

    def process(self, aid: Aid, samples: ImuBuffer) -> Decision:
        """Take a measurement valid now (t_ns is aid.t_ns)."""
        core = self.core
        if aid.geodetic and core.origin is None and core.hypotheses is None:
            core.origin, self.place = Origin(*aid.geodetic), aid.geodetic
            core.constants = imu.constants(core.noise, core.config.coast, core.origin)
        if core.hypotheses is not None:
            core.hypotheses.expire(aid.t_ns)
        if isinstance(aid, OdometryAid):
            return self._odometry(aid)
        if isinstance(aid, ImuAid):
            return self._change_imu(aid)
        if aid.check is not None and (refusal := aid.check(core.origin)) is not None:
            if refusal.reason is Reason.STOPPED:
                self._spoofed(aid)
            return Decision(refusal.reason, detail=refusal.detail)
        aid, z = self.imu.felt(aid, samples) if aid.kind in FELT else (aid, aid.measurement(core.origin))
        if z is None:
            waits = core.hypotheses is None and not aid.geodetic
            return Decision(Reason.ALIGNING, detail=NO_POSITION) if waits else Decision(Reason.NO_ORIGIN, detail=_NO_PLACE)
        if isinstance(z, Refusal):
            return Decision(z.reason, detail=z.detail)
        if (receiver := self.sources.get(aid.receiver or "")) is not None:
            if aid.t_ns - receiver.spoofed_ns < aid.rules.hold_s * 1e9:
                return Decision(Reason.STOPPED, detail=_SPOOFED)
            if receiver.false_share > aid.rules.false_share and aid.t_ns <= receiver.silent_ns:
                aid = aid.doubted(receiver.false_share)
        if isinstance(z, Conditional) and (bank := self.alignment.bank) is not None and (why := z.objection(bank.lead.x)):
            return Decision(Reason.IMPLAUSIBLE, detail=why)
        if aid.alignment_only:
            return self.alignment.take_prior(aid, z)
        if aid.kind not in FELT and self.imu.is_held(aid, z, samples):
            if not aid.weighs:
                self.sources[aid.topic] = self.sources.get(aid.topic, _UNKNOWN).held(aid.rules, aid.t_ns)
            self._forget_estimated(aid, z)
            self.held_ns = {**self.held_ns, aid.topic: aid.t_ns}
            return Decision(Reason.HELD, detail=held.SAYS)
        if aid.geodetic and isinstance(z, Position):
            self._note_receiver(aid, z)
        if why := self._in_other_frame(aid, z, samples):
            if self.sources.get(aid.topic, _UNKNOWN).fused_ns > NEVER:
                self._leave(aid)
            self.sources[aid.topic] = _UNKNOWN
            return Decision(Reason.IMPLAUSIBLE, detail=why)
        if isinstance(z, Heading):
            if aid.t_ns < self.alignment.wrong_until_ns.get(aid.topic, NEVER):
                return Decision(Reason.STOPPED, detail=WRONG_SENSOR)
            self.alignment.sensed = None if core.is_aligned else (aid, z)
        elif not aid.weighs and not core.is_aligned:
            return Decision(Reason.ALIGNING, detail=_NOT_YET)
        state = self.sources.get(aid.topic, _UNKNOWN)
        if aid.t_ns - state.last_ns < aid.rules.spacing_s * 1e9:
            return Decision(Reason.THINNED)
        alone = self._alone(aid)
        state = state.arrive(aid.rules, aid.t_ns, alone=alone)
        if aid.absolute:
            core.absolute |= {aid.topic}
            core.receivers |= {aid.topic} if aid.geodetic else set()
        gyro_b = core.sample_now(samples)[:XYZ] if aid.uses_rate else _NO_RATE  # no other measurement asks for it
        self.alignment.check_sensor(aid, z, samples, gyro_b)
        if core.hypotheses is None or not core.is_aligned:
            if isinstance(z, Velocity):
                self.alignment.note_course(z, samples)
            decision = self.alignment.align(aid, z, samples, gyro_b)
            if core.hypotheses is not None:
                state = replace(state, fused_ns=aid.t_ns)
                self._note_absolute(aid, z)
            self.alignment.wait_for_heading(aid, z, gyro_b)
        else:
            hypotheses, switches = core.hypotheses, core.hypotheses.switches
            aid = score.carried(CONSTANTS, aid, z, core.last_sample(samples), self.scores, hypotheses.members, alone=alone)
            reported = z
            aid, z = scatter.taken(aid, z, self.scatter.get(aid.topic))
            decision, state = self._judge(aid, z, reported, gyro_b, state, alone=alone)
            self._note_speed(aid, z, gyro_b, samples, fused=decision.reason is Reason.FUSED)
            if decision.reason is Reason.GATED:
                self._forget_estimated(aid, z)
            if core.hypotheses is not hypotheses or hypotheses.switches != switches:
                core.stretch = None  # another filter leads, with another past, or none
                core.conflicts = replace(core.conflicts, moved_ns=aid.t_ns)
            elif core.stretch is not None and decision.reason is Reason.FUSED:
                longer = core.stretch.also(aid, z, gyro_b)
                if longer is not core.stretch:  # a run ends at the newest measurement that is in it, which has to be this one
                    self._settle(longer, samples, aid.witness if alone else "")
        self.sources[aid.topic] = state
        return decision

    def _odometry(self, aid: OdometryAid) -> Decision:
        core = self.core
        if core.hypotheses is None or not core.is_aligned:
            self.kept.pop(aid.topic, None)
            return Decision(Reason.ALIGNING, detail=_FOR_ALIGNED)
        state, switches = self.sources.get(aid.topic, _UNKNOWN), core.hypotheses.switches
        step = steps.take(core.hypotheses, aid, self.kept.get(aid.topic), state, alone=self._alone(aid))
        if step.kept is not None:
            self.kept[aid.topic] = step.kept
        if step.seen is None:
            return Decision(step.reason, detail=step.detail)
        self.sources[aid.topic] = step.state
        core.hypotheses.drop(lambda member: bool(self.violation(member.filter)))
        if core.hypotheses.switches != switches:
            core.stretch = None
        if step.reason is Reason.FUSED:
            self.last_odometry_ns = aid.t_ns
        nu, sigma = step.seen.nu.tolist(), np.sqrt(step.seen.s.diagonal()).tolist()
        return Decision(step.reason, tuple(nu), tuple(sigma), step.seen.distance2 / step.gate, step.detail)

    def _change_imu(self, aid: ImuAid) -> Decision:
        core = self.core
        core.noise = core.config.imu.scaled(aid.factor)
        core.constants = imu.constants(self.bias_walk.of_noise(core.noise), core.config.coast, core.origin)
        for member in self.alignment.members:
            member.filter.change_imu(aid.shift, aid.sigma)
            member.adopt(core.constants, doubts_imu=False)
        if self.alignment.without_sensor is not None:
            self.alignment.without_sensor.stretch = None
        core.stretch = None
        return Decision(Reason.FUSED, detail=aid.detail)

    def _spoofed(self, aid: Aid) -> None:
        before = self.sources.get(aid.topic, _UNKNOWN)
        self.sources[aid.topic] = before.spoofed(aid.rules, aid.t_ns)
        if before.phase is Phase.ACTIVE and self.core.is_aligned and self.core.hypotheses is not None:
            switches = self.core.hypotheses.switches
            self.core.hypotheses.leave(aid.topic)
            if self.core.hypotheses.switches != switches:
                self.core.stretch = None

    def _judge(
        self, aid: Aid, z: Measurement, reported: Measurement, gyro_b: Array, state: SourceState, *, alone: bool
    ) -> tuple[Decision, SourceState]:
        core, bank, is_place = self.core, self.core.hypotheses, aid.absolute or bool(aid.receiver)
        assert bank is not None
        receiver = self.sources.get(aid.receiver or "", _UNKNOWN)  # of a velocity: it stands and falls with its positions
        known = self.scatter.get(aid.topic) or Scatter(aid.t_ns)
        trusted = state.phase is Phase.ACTIVE and (receiver.phase is Phase.ACTIVE or aid.t_ns > receiver.silent_ns)
        trusted = trusted and known.is_aid
        proven = core.variance_factor.is_proven
        vouched = aid.absolute and self._vouched(aid)
        verdict = bank.judge(aid, z, gyro_b, trusted=trusted, vouched=vouched, proven=proven)
        seen, used, lead = verdict.seen, verdict.used, bank.members[0]
        if is_place and isinstance(reported, Pose | Position | Velocity):
            self.scatter = {**self.scatter, aid.topic: self._scattered(known, aid, verdict, reported.noise, alone=alone)}
        if used is not seen:
            core.stretch = None  # a run would fuse the attitude
        for topic in verdict.wrong:
            self.sources[topic] = self.sources.get(topic, _UNKNOWN).refuted(aid.t_ns)
        if trusted and aid.absolute:
            core.note_variance(aid, used)
        agree = alone or not (core.conflicts.apart or self.between is not None)  # sources that disagree are no motion
        if verdict.fused and aid.absolute and agree and not aid.geodetic:
            self._note_biases(aid, used)
        if is_place:
            self.failed = {**self.failed, aid.topic: 0 if verdict.passed else self.failed.get(aid.topic, 0) + 1}
        core.conflicts = core.conflicts.judged(aid, z, lead.filter.x[X.P], is_rejected=aid.topic in lead.rejected)
        apart = core.conflicts.apart.get(aid.witness)
        may_be_late = apart is None or delay.explains(apart.off, apart.s, lead.filter.x)
        if trusted and may_be_late and is_place:
            self.scores = score.noted(CONSTANTS, aid, used, verdict.gate, self.scores, bank.members, known.weight, alone=alone)
            if aid.absolute and (aid.delay_sigma_s or alone) and (late := self.scores.get(DELAY.block(aid.witness))) is not None:
                self.late_cov = delay.covariance(late, aid.delay_sigma_s, lead.filter.x[X.V])
        if not aid.geodetic and core.conflicts.outvotes(aid.topic):
            bank.lead_from(aid, z, gyro_b)
            core.variance_factor, core.conflicts, self.means = NO_EXCESS, Conflicts(), {}
        self._note_between(aid, z, seen)
        bank.drop(lambda member: bool(self.violation(member.filter)))
        nu, sigma = seen.nu, np.sqrt(seen.s.diagonal())
        if verdict.fused:
            reason = Reason.FUSED
            self._note_absolute(aid, z)
        elif trusted or not verdict.passed:
            reason = Reason.GATED
        else:
            reason = Reason.PROBATION if state.phase is Phase.STARTING else Reason.STOPPED
        alone = alone or isinstance(z, PartialPose)  # directions change from fix to fix: their sum is of nothing
        alone = alone or (aid.geodetic is not None and self._alone(aid, core.receivers))  # receivers share their slow error
        state = state.judge(aid.rules, aid.t_ns, alone=alone, passed=verdict.passed, fused=verdict.fused, nu=nu, sigma=sigma)
        if state.held_until_ns > aid.t_ns and trusted:
            bank.leave(aid.witness)
        if not aid.weighs and not verdict.passed:
            state = state.held(aid.rules, aid.t_ns, alone=alone)
        detail = aid.detail if reason is not Reason.GATED else "; ".join(filter(None, (aid.detail, self._conflict())))
        off, sigmas = tuple(nu.tolist()), tuple(sigma.tolist())
        position = (off[:XYZ], sigmas[:XYZ]) if aid.absolute else None
        if isinstance(z, PartialPose):
            position = position_innovation(z, nu, seen.s)
        return Decision(reason, off, sigmas, used.distance2 / verdict.gate, detail, position), state

    def _note_between(self, aid: Aid, z: Measurement, seen: Innovation) -> None:
        apart = self.core.conflicts.apart
        if not aid.absolute or aid.geodetic or not isinstance(z, Pose | Position) or len(z.z_n) != len(z.rows[:XYZ]):
            return
        if aid.topic not in apart or apart[aid.topic].agrees:
            self.means = between.noted(self.means, aid.topic, aid.t_ns, seen.nu, z.noise)
        self.between = between.covariance(self.means, {topic for topic, other in apart.items() if other.agrees})

    def _scattered(self, known: Scatter, aid: Aid, verdict: Verdict, reported: Array, *, alone: bool) -> Scatter:
        core = self.core
        now = known.also(aid.t_ns, verdict.seen, reported, fused=verdict.fused and verdict.used is verdict.seen)
        if core.hypotheses is not None and alone and now.factors and not known.factors and now.by_chance:
            core.hypotheses.lead.admit_noise(verdict.seen, now.widened(reported), now.by_chance)
        return now

    def _note_speed(self, aid: Aid, z: Measurement, gyro_b: Array, samples: ImuBuffer, *, fused: bool) -> None:
        bank = self.core.hypotheses
        if bank is None:
            self.speed_steps = {}
        elif aid.receiver and isinstance(z, Velocity):
            scatter = self.scatter[aid.topic].factor
            self.speed_steps = speed_step.noted(
                self.speed_steps, aid, z, gyro_b, bank.members[0], samples, fused=fused, scatter=scatter
            )
        elif fused and aid.absolute:
            self.speed_steps = speed_step.positioned(self.speed_steps, aid)

    def _forget_estimated(self, aid: Aid, z: Measurement) -> None:
        core = self.core
        if not isinstance(z, AirVelocity | DragForce):
            return
        if core.hypotheses is not None and core.is_aided:
            for slow in aid.slow_errors:
                if slow.walk is not None:
                    core.hypotheses.forget(slow.block)

    def _settle(self, stretch: Stretch, samples: ImuBuffer, alone: str) -> None:
        """Run the stretch again until the linear filter can go on alone.

        Not in dead reckoning. alone: topic of the only source.
        """
        core = self.core
        assert core.hypotheses is not None
        lead = core.hypotheses.lead
        is_long, is_aided = stretch.is_long(core.t_ns), core.is_aided
        if is_aided and (is_long or stretch.due(lead)):
            stretch = core.relinearise(stretch, samples)
            if core.hypotheses.lead is not lead:
                score.begin_again(CONSTANTS, core.hypotheses.lead, alone, core.last_sample(samples))
        core.stretch = stretch
        if stretch.is_settled:
            core.stretch = None
        elif is_long:
            core.stretch = Stretch.of(core.hypotheses.lead)

    def _note_biases(self, aid: Aid, seen: Innovation) -> None:
        core = self.core
        assert core.hypotheses is not None
        before = self.bias_walk
        self.bias_walk = before.also(aid.topic, aid.t_ns, seen, core.variance_factor.value)
        if self.bias_walk.factor != before.factor:
            core.constants = imu.constants(self.bias_walk.of_noise(core.noise), core.config.coast, core.origin)
            walked = self.bias_walk.walked(before, core.noise)
            for member in core.hypotheses.members:
                member.adopt(core.constants, doubts_imu=member.doubts_imu)
                member.filter.widen_biases(walked)

    def _alone(self, aid: Aid, without: frozenset[str] = frozenset()) -> bool:
        others = self.core.absolute - {aid.topic, aid.witness} - without
        return not any((aid.t_ns - self.sources.get(topic, _UNKNOWN).fused_ns) * 1e-9 < aid.rules.timeout_s for topic in others)

    def _note_receiver(self, aid: Aid, z: Position) -> None:
        """The receiver with which fixes are compared: the first, another one where it is silent."""
        if self.receiver is None or self.receiver[0] == aid.topic or aid.t_ns - self.receiver[1] > RECENT_NS:
            self.receiver = aid.topic, aid.t_ns, z.z_n

    def _in_other_frame(self, aid: Aid, z: Measurement, samples: ImuBuffer) -> str:
        """What the fixes of the source give in place of north, east and down in metres; "" for nothing."""
        if not (aid.absolute and isinstance(z, Pose)):
            return ""
        known, is_whole = self.frames.get(aid.topic), z.attitude == "full" and len(z.rows) == 2 * XYZ
        now = Frame.of(aid.t_ns, z.z_n, z.q_nb_wxyz) if known is None else known
        if is_whole and known is not None:
            now = known.also(aid.t_ns, z.z_n, z.q_nb_wxyz, samples)
        is_level = z.rows[: XYZ - 1].tolist() == [0, 1]
        if is_level and self.receiver is not None and aid.t_ns - self.receiver[1] < _CURRENT_NS:
            now = now.compared(aid.t_ns, z.z_n, self.receiver[2])
        if now is not known:
            self.frames = {**self.frames, aid.topic: now}
        return now.says or ""

    def _leave(self, aid: Aid) -> None:
        """Go on as the hypothesis that is nearest to the newest position of another source, or begin again."""
        core = self.core
        core.variance_factor, core.conflicts = NO_EXCESS, core.conflicts.without(aid.topic)
        self.means, self.between = {}, None
        place = max(core.conflicts.newest.values(), key=lambda place: place.t_ns, default=None)
        if not core.is_aligned or core.hypotheses is None or place is None or aid.t_ns - place.t_ns > RECENT_NS:
            self.alignment.begin_again()
            return
        position_n = core.hypotheses.lead.x[X.P] + place.off
        nearest = min(core.hypotheses.members, key=lambda m: float(np.linalg.norm(position_n - m.filter.x[X.P])))
        core.hypotheses.drop(lambda member: member is not nearest)
        core.stretch = None
        nearest.doubts.clear()
        nearest.without, nearest.past = "", None

    def _vouched(self, aid: Aid) -> bool:
        """Whether another source gave positions lately, or since a receiver's speed has stepped: an IMU's error grows."""
        others, step = self.core.absolute - {aid.topic}, self.speed_steps.get(aid.topic)
        within_ns = LONG_NS if step is not None and step.is_open else RECENT_NS
        return any(aid.t_ns - self.sources.get(topic, _UNKNOWN).fused_ns < within_ns for topic in others)

    def _note_absolute(self, aid: Aid, z: Measurement) -> None:
        core = self.core
        if not aid.absolute:
            return
        core.last_absolute_ns = aid.t_ns
        if aid.geodetic and core.hypotheses is not None:
            lead = core.hypotheses.lead
            sigma = math.sqrt(max(z.noise.diagonal().tolist()[: XYZ - 1]))
            speed = math.hypot(*lead.x[X.V].tolist()) + math.sqrt(sum(lead.cov.diagonal()[E.V].tolist()))
            self.anchor = GnssAnchor(aid.geodetic, aid.t_ns, sigma, speed)
