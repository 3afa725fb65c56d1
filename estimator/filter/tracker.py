"""What the estimator knows at one instant: everything that a checkpoint has to keep.

A tracker takes measurements in the order of their validity and changes by nothing else: no clock, no arrival, no randomness.
"""

import math
from dataclasses import replace as replace_in

import numpy as np
from msgspec.structs import replace

from estimator.filter import contradiction, remarks
from estimator.filter.alignment import (
    AT_REST,
    NEVER,
    NO_POSITION,
    WRONG_SENSOR,
    Alignment,
    Decision,
    TrackerConfig,
    covariance,
    lacks,
)  # fmt: skip
from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.gnss_anchor import GnssAnchor
from estimator.filter.hypotheses import Hypotheses, Hypothesis
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.mismatch import BiasWalk, Delays, PathScale, Scatter, delay
from estimator.filter.relative import steps
from estimator.filter.relinearise import Stretch
from estimator.filter.variance_factor import NO_EXCESS
from estimator.sources import rest
from estimator.sources.air import drag
from estimator.sources.air.through_air import AirVelocity, DragForce
from estimator.sources.base import held
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.base.machine import Phase, SourceState
from estimator.sources.imu.choice import ImuAid
from estimator.sources.landmark import position_innovation
from estimator.sources.odometry import Kept, OdometryAid
from estimator.sources.rest import Rest, RestConfig
from models import imu, so3
from models.frames import Origin
from models.measurements import Conditional, Heading, Measurement, PartialPose, Pose, Position, Velocity
from models.messages import Array, Checkpoint, Mode, Reason
from models.state import E, X

_NO_PLACE = "give [map] origin to use GNSS or a magnetometer together with fixes on a local map"
_UNKNOWN = SourceState()
_NO_RATE = np.zeros(3)
_NO_IMU = np.zeros(6)
_FOR_ALIGNED = "odometry is used once aligned"
_LOST_NS = 60_000_000_000  # an IMU gap after which the alignment begins again
_NOT_YET = "used once the attitude is known: false axes would mislead the alignment"
_XYZ = 3
_MOVES = 2  # velocities, seconds apart, that are not zero: what looks at rest goes on so
_ON_THE_GROUND = RestConfig()
_USELESS = 100.0  # times the variance that a source claims, and it is no aid
_FELT = frozenset({rest.TOPIC, drag.TOPIC})


class Tracker(Alignment):
    """Hypotheses, alignment, source machines and what was last known, at t_ns."""

    def __init__(self, config: TrackerConfig) -> None:
        super().__init__(config)
        self._aided_ns = round(config.dead_reckoning_after_s * 1e9)
        self.place = config.origin.lla if config.origin else None
        self.rest_since: tuple[int, float] | None = None  # and the heading then
        self.rest_refuted = 0  # how often positions have shown that it moves, since the IMU showed motion
        self.sources: dict[str, SourceState] = {}
        self.same: dict[str, tuple[bytes, int]] = {}  # what a sensor reads, and since when, by topic
        self.held_ns: dict[str, int] = {}  # when a source last repeated a reading; never changed in place
        self.last_odometry_ns = NEVER
        self.kept: dict[str, Kept] = {}  # poses that the filters keep, by topic of odometry
        self.anchor: GnssAnchor | None = None
        self.path_scale = PathScale()
        self.delays: Delays = {}
        self.late_cov: Array | None = None  # (15, 15), by a delay that the newest fix may have
        self.bias_walk = BiasWalk()
        self.scatter: dict[str, Scatter] = {}  # of sources of positions, and their velocities; never changed in place

    def copy(self) -> "Tracker":
        """An independent tracker in the same state; what never changes in place is shared."""
        other = object.__new__(Tracker)
        other.__dict__.update(self.__dict__)
        other.hypotheses = self.hypotheses.copy() if self.hypotheses else None
        other.resting = self.resting.copy() if self.resting else None
        other.without_sensor = self.without_sensor.copy() if self.without_sensor else None
        other.sources, other.kept, other.same = self.sources.copy(), self.kept.copy(), self.same.copy()
        return other

    def restarted(self) -> "Tracker":
        """A tracker without estimate, on the same map and with the same trust in the sources."""
        other = Tracker(self.config)
        other.origin, other.place, other.constants, other.noise = self.origin, self.place, self.constants, self.noise
        other.sources, other.absolute = self.sources.copy(), self.absolute
        other.last_absolute_ns, other.anchor, other.given_up = self.last_absolute_ns, self.anchor, self.given_up
        other.path_scale, other.delays, other.bias_walk = self.path_scale, self.delays, self.bias_walk
        return other

    @property
    def standing(self) -> int:
        """How much of an estimate there is: 2 aligned, 1 published without a heading, 0 none."""
        return 2 if self.is_aligned else int(self.shown is not None)

    def shown_covariance(self) -> Array:
        """Of what is shown."""
        bank = self.bank
        assert bank is not None
        cov = bank.covariance() if self.is_aligned else covariance(bank, self.config.initialise)
        if self.variance_factor.lasting > self.variance_factor.value:
            cov *= self.variance_factor.lasting / self.variance_factor.value
        if self.conflicts.apart:
            cov[E.P, E.P] += self.conflicts.added(is_decided=self.is_aligned)
        if self.late_cov is not None:
            cov += self.late_cov
        if self.is_aligned and self.without_sensor is not None:
            return self.without_sensor.mixed(cov, bank.lead.x)
        return cov

    @property
    def is_sound(self) -> bool:
        """Every number of the leading filter is finite, every variance positive."""
        return self.bank is None or self.bank.lead.sound

    def violation(self, eskf: Eskf) -> str:
        """What of the state is beyond any vehicle's; '' where nothing is."""
        return self.config.bounds.violation(eskf.x, eskf.cov, self.place[2] if self.place else 0.0)

    def resume(self, checkpoint: Checkpoint) -> None:
        """Begin aligned, in the state in which an earlier run was interrupted."""
        self.t_ns, self.last_absolute_ns = checkpoint.t_ns, checkpoint.last_absolute_ns
        if checkpoint.origin is not None:
            self.origin, self.place = Origin(*checkpoint.origin), checkpoint.origin
            self.constants = imu.constants(self.noise, self.config.coast, self.origin)
        lead = Eskf(checkpoint.t_ns, checkpoint.nav.copy(), checkpoint.covariance.copy(), self.constants)
        since_ns = max(checkpoint.last_absolute_ns, checkpoint.t_ns - _LOST_NS)
        self.hypotheses = Hypotheses([Hypothesis(lead, fused_ns=since_ns, run=1, run_ns=since_ns)])
        self.is_aligned = True
        if (last := checkpoint.last_gnss) is not None:
            place, fixed_ns = (last.lat_deg, last.lon_deg, last.alt_m), checkpoint.t_ns - round(last.age_s * 1e9)
            self.anchor = GnssAnchor(place, fixed_ns, last.sigma_m, float(np.linalg.norm(lead.x[X.V])))

    @property
    def detail(self) -> str:
        """What keeps it from an estimate."""
        if self.plausibility.detail or self.given_up:
            return self.plausibility.detail or contradiction.SAYS
        if self.hypotheses is not None:
            return "" if self.is_aligned else lacks(self.hypotheses, self.config.initialise)
        return AT_REST if self.still else NO_POSITION

    @property
    def remarks(self) -> list[str]:
        """What makes an estimate that is published less certain than configured."""
        if self.shown is None:
            return []
        beside = self.without_sensor if self.is_aligned else None
        return [
            *filter(None, (self._conflict(), remarks.heading(beside.topic) if beside is not None else "")),
            *(remarks.apart(self.conflicts.apart) if self.is_aligned and not self._conflict() else ()),
            *remarks.units(self.path_scale, self.absolute),
            *remarks.drifts(self.sources),
            *remarks.delays(self.delays, self.hypotheses),
            *remarks.variance(self.variance_factor.lasting),
            *remarks.held(self.held_ns, self.t_ns),
            *remarks.scatter(self.scatter, self.t_ns),
            *remarks.imu(self.hypotheses if self.is_aligned else None),
        ]

    def _conflict(self) -> str:
        return remarks.conflict(self.hypotheses, self.absolute, self.sources, self.t_ns)

    @property
    def needs_from_ns(self) -> int:
        """The oldest IMU sample that may be gone through again."""
        beside = self.without_sensor.stretch if self.without_sensor is not None else None
        return min((s.t_ns for s in (self.stretch, beside) if s is not None), default=2**62)

    def propagate(self, samples: ImuBuffer, to_ns: int) -> None:
        """Through the IMU samples to `to_ns`; after a minute without any, nothing is left to go on with."""
        if to_ns - self.t_ns > _LOST_NS:
            self.hypotheses, self.stretch, self.is_aligned, self.without_sensor = None, None, False, None
            self.resting, self.waits_since_ns, self.shows_unaligned = None, None, False
        bank = self.bank
        if bank is not None and self.t_ns < to_ns:
            index = samples.first_after(self.t_ns)
            beside = self.without_sensor.bank.members if self.without_sensor is not None else ()
            for member in (*bank.members, *beside):
                member.filter.propagate(samples, index, to_ns)
        self.t_ns = to_ns

    def mode(self, newest_imu_ns: int, t_ns: int) -> Mode:
        """What an estimate for t_ns rests on."""
        if self.hypotheses is None or not self.is_aligned:
            if self.shown is not None:
                return Mode.ALIGNING_HEADING
            return Mode.STARTING if self.plausibility.phase is not Phase.ACTIVE else Mode.ALIGNING
        if t_ns - newest_imu_ns > self._gap_ns:
            return Mode.COASTING
        if t_ns - self.last_absolute_ns <= self._aided_ns:
            return Mode.AIDED
        return Mode.ODOMETRY if t_ns - self.last_odometry_ns <= self._aided_ns else Mode.DEAD_RECKONING

    def process(self, aid: Aid, samples: ImuBuffer) -> Decision:
        """Take a measurement valid now (t_ns is aid.t_ns)."""
        if aid.geodetic and self.origin is None and self.hypotheses is None:
            self.origin, self.place = Origin(*aid.geodetic), aid.geodetic
            self.constants = imu.constants(self.noise, self.config.coast, self.origin)
        if isinstance(aid, OdometryAid):
            return self._odometry(aid)
        if isinstance(aid, ImuAid):
            return self._change_imu(aid)
        if aid.check is not None and (refusal := aid.check(self.origin)) is not None:
            return Decision(refusal.reason, detail=refusal.detail)
        aid, z = self._felt(aid, samples) if aid.kind in _FELT else (aid, aid.measurement(self.origin))
        if z is None:
            waits = self.hypotheses is None and not aid.geodetic
            return Decision(Reason.ALIGNING, detail=NO_POSITION) if waits else Decision(Reason.NO_ORIGIN, detail=_NO_PLACE)
        if isinstance(z, Refusal):
            return Decision(z.reason, detail=z.detail)
        if isinstance(z, Conditional) and (bank := self.bank) is not None and (why := z.objection(bank.lead.x)):
            return Decision(Reason.IMPLAUSIBLE, detail=why)
        if aid.alignment_only:
            return self._take_prior(aid, z)
        if aid.kind not in _FELT and self._is_held(aid, z, samples):
            if not aid.weighs:
                self.sources[aid.topic] = self.sources.get(aid.topic, _UNKNOWN).held(aid.rules, aid.t_ns)
            self._forget_estimated(aid, z)
            self.held_ns = {**self.held_ns, aid.topic: aid.t_ns}
            return Decision(Reason.HELD, detail=held.SAYS)
        self.path_scale = self.path_scale.also(aid, z)
        if why := self.path_scale.objection(aid.topic):
            if self.sources.get(aid.topic, _UNKNOWN).fused_ns > NEVER and self.path_scale.last is not None:
                self._leave(self.path_scale.last[1])
            self.sources[aid.topic] = _UNKNOWN
            return Decision(Reason.IMPLAUSIBLE, detail=why)
        if isinstance(z, Heading):
            if aid.t_ns < self.wrong_until_ns.get(aid.topic, NEVER):
                return Decision(Reason.STOPPED, detail=WRONG_SENSOR)
            self.sensed = None if self.is_aligned else (aid, z)
        elif not aid.weighs and not self.is_aligned:
            return Decision(Reason.ALIGNING, detail=_NOT_YET)
        state = self.sources.get(aid.topic, _UNKNOWN)
        if aid.t_ns - state.last_ns < aid.rules.spacing_s * 1e9:
            return Decision(Reason.THINNED)
        alone = self._alone(aid)
        state = state.arrive(aid.rules, aid.t_ns, alone=alone)
        if aid.absolute:
            self.absolute |= {aid.topic}
        gyro_b = self._imu(samples)[:_XYZ] if aid.uses_rate else _NO_RATE  # no other measurement asks for it
        self._check_sensor(aid, z, samples, gyro_b)
        if self.hypotheses is None or not self.is_aligned:
            if isinstance(z, Velocity):
                self._note_course(z, samples)
            decision = self._align(aid, z, samples, gyro_b)
            if self.hypotheses is not None:
                state = replace(state, fused_ns=aid.t_ns)
                self._note_absolute(aid, z)
            self._wait_for_heading(aid, z, gyro_b)
        else:
            hypotheses, switches = self.hypotheses, self.hypotheses.switches
            aid = delay.carried(aid, z, self._last_imu(samples), self.delays, hypotheses.members, alone=alone)
            decision, state = self._judge(aid, z, gyro_b, state, alone=alone)
            if decision.reason is Reason.GATED:
                self._forget_estimated(aid, z)
            if self.hypotheses is not hypotheses or hypotheses.switches != switches:
                self.stretch = None  # another filter leads, with another past, or none
            elif self.stretch is not None and decision.reason is Reason.FUSED:
                longer = self.stretch.also(aid, z, gyro_b)
                if longer is not self.stretch:  # a run ends at the newest measurement that is in it, which has to be this one
                    self._settle(longer, samples, aid.witness if alone else "")
        self.sources[aid.topic] = state
        return decision

    def _odometry(self, aid: OdometryAid) -> Decision:
        """Keep the pose, or fuse the motion since the one that was kept."""
        if self.hypotheses is None or not self.is_aligned:
            self.kept.pop(aid.topic, None)
            return Decision(Reason.ALIGNING, detail=_FOR_ALIGNED)
        state, switches = self.sources.get(aid.topic, _UNKNOWN), self.hypotheses.switches
        step = steps.take(self.hypotheses, aid, self.kept.get(aid.topic), state, alone=self._alone(aid))
        if step.kept is not None:
            self.kept[aid.topic] = step.kept
        if step.seen is None:
            return Decision(step.reason, detail=step.detail)
        self.sources[aid.topic] = step.state
        self.hypotheses.drop(lambda member: bool(self.violation(member.filter)))
        if self.hypotheses.switches != switches:
            self.stretch = None
        if step.reason is Reason.FUSED:
            self.last_odometry_ns = aid.t_ns
        nu, sigma = step.seen.nu.tolist(), np.sqrt(step.seen.s.diagonal()).tolist()
        return Decision(step.reason, tuple(nu), tuple(sigma), step.seen.distance2 / step.gate, step.detail)

    def _change_imu(self, aid: ImuAid) -> Decision:
        """The samples that follow are those of another IMU, with biases of its own; no run goes across the change."""
        self.noise = self.config.imu.scaled(aid.factor)
        self.constants = imu.constants(self.bias_walk.of_noise(self.noise), self.config.coast, self.origin)
        beside = self.without_sensor.bank.members if self.without_sensor is not None else ()
        for member in (*(self.bank.members if self.bank is not None else ()), *beside):
            member.filter.change_imu(aid.shift, aid.sigma)
            member.adopt(self.constants, doubts_imu=False)
        if self.without_sensor is not None:
            self.without_sensor.stretch = None
        self.stretch = None
        return Decision(Reason.FUSED, detail=aid.detail)

    def _felt(self, aid: Aid, samples: ImuBuffer) -> tuple[Aid, Measurement | Refusal]:
        """What the IMU itself shows: rest, or the drag of a multirotor."""
        if aid.kind == rest.TOPIC:
            return aid, self._rest(samples)
        config = self.config.drag
        second, begin = self._stretch(samples), samples.first_after(self.t_ns - round(config.every_s * 1e9))
        u = samples.u[begin : samples.first_after(self.t_ns)]
        if second is None or not len(u) or not self.is_aligned:
            return aid, Refusal(Reason.THINNED, NO_POSITION)
        if rest.is_quiet(second, _ON_THE_GROUND):
            return aid, Refusal(Reason.THINNED, "at rest")
        return drag.felt(aid, u, config)

    def _rest(self, samples: ImuBuffer) -> Rest | Refusal:
        """The vehicle at rest, as the last second of the IMU shows it and the estimate confirms."""
        rules, u = self.config.rest, self._stretch(samples)
        if u is None or not self.is_aligned or self.hypotheses is None or not rest.is_quiet(u, rules):
            if self.rest_since is not None and self.is_aligned and self.hypotheses is not None:
                self.hypotheses.forget(rest.BLOCK)
                self.stretch = Stretch.of(self.hypotheses.lead)
            self.rest_since, self.rest_refuted = None, 0
            return Refusal(Reason.THINNED, "in motion" if self.is_aligned else NO_POSITION)
        lead = self.hypotheses.lead
        if self.rest_since is None:
            self.rest_since = self.t_ns, so3.to_euler(lead.x[X.Q])[2]
        since_ns, azimuth = self.rest_since
        if self.t_ns - since_ns < rules.after_s * 1e9:
            return Refusal(Reason.THINNED, "at rest for a moment")
        why = rest.objection(lead.x, lead.cov, rules)
        if why or self.rest_refuted >= _MOVES:
            self.rest_since = None  # it has to look at rest for as long again
            self.rest_refuted += self.t_ns - self.last_absolute_ns <= self._aided_ns
            return Refusal(Reason.GATED, why or "looks at rest, but positions have shown that it moves")
        self.stretch = None  # a run would leave out what rest has shown, and rest is linear
        earth_n = self.origin.earth_rate_n if self.origin is not None else _NO_RATE
        return rest.at_rest(u, azimuth, earth_n, rules)

    def _judge(self, aid: Aid, z: Measurement, gyro_b: Array, state: SourceState, *, alone: bool) -> tuple[Decision, SourceState]:
        """Gate and fuse, once aligned."""
        assert self.hypotheses is not None
        receiver = self.sources.get(aid.receiver or "", _UNKNOWN)  # of a velocity: it stands and falls with its positions
        trusted = state.phase is Phase.ACTIVE and (receiver.phase is Phase.ACTIVE or aid.t_ns > receiver.silent_ns)
        known = self.scatter.get(aid.topic) or Scatter(aid.t_ns, ())
        trusted = trusted and known.factor < _USELESS
        if known.factor > 1.0 and isinstance(z, Pose | Position | Velocity):
            z = replace_in(z, noise=known.factor * z.noise)
        verdict = self.hypotheses.judge(aid, z, gyro_b, trusted=trusted, vouched=aid.absolute and self._vouched(aid))
        if (aid.absolute or aid.receiver) and isinstance(z, Pose | Position | Velocity):
            now = known.also(aid.t_ns, verdict.seen, self.variance_factor.value)
            self.scatter = {**self.scatter, aid.topic: now}
        if trusted and aid.absolute:
            self._note_variance(aid, verdict.seen)
        if verdict.fused and aid.absolute and alone and not aid.geodetic:  # two sources that disagree are no motion
            self._note_biases(aid, verdict.seen)
        if aid.absolute or aid.receiver:
            self.failed = {**self.failed, aid.topic: 0 if verdict.passed else self.failed.get(aid.topic, 0) + 1}
        apart = self.conflicts.apart.get(aid.witness)
        may_be_late = apart is None or delay.explains(apart.off, apart.s, self.hypotheses.lead.x)
        if trusted and may_be_late and (aid.absolute or aid.receiver):
            self.delays = delay.noted(aid, verdict.seen, verdict.gate, self.delays, self.hypotheses.members)
            if aid.absolute and (aid.delay_sigma_s or alone):
                self.late_cov = self.delays[aid.witness].covariance(aid.delay_sigma_s, self.hypotheses.lead.x[X.V])
            if self.delays[aid.witness].is_state:
                self.stretch = None  # a run would leave the delay out
        is_rejected = aid.topic in self.hypotheses.members[0].rejected
        self.conflicts = self.conflicts.judged(aid, z, self.hypotheses.lead.x[X.P], is_rejected=is_rejected)
        if (found := self.conflicts.apart.get(aid.witness)) and found.lasts and aid.receiver:
            self.hypotheses.cover(aid.witness)
        self.hypotheses.drop(lambda member: bool(self.violation(member.filter)))
        sigma = np.sqrt(verdict.seen.s.diagonal())
        if verdict.fused:
            reason = Reason.FUSED
            self._note_absolute(aid, z)
        elif trusted or not verdict.passed:
            reason = Reason.GATED
        else:
            reason = Reason.PROBATION if state.phase is Phase.STARTING else Reason.STOPPED
        alone = alone or isinstance(z, PartialPose)  # directions change from fix to fix: their sum is of nothing
        state = state.judge(
            aid.rules, aid.t_ns, alone=alone, passed=verdict.passed, fused=verdict.fused, nu=verdict.seen.nu, sigma=sigma
        )
        if state.held_until_ns > aid.t_ns and trusted:
            self.hypotheses.leave(aid.witness)
        if not aid.weighs and not verdict.passed:
            state = state.held(aid.rules, aid.t_ns, alone=alone)
        ratio = verdict.seen.distance2 / verdict.gate
        detail = aid.detail if reason is not Reason.GATED else "; ".join(filter(None, (aid.detail, self._conflict())))
        position = position_innovation(z, verdict.seen.nu, verdict.seen.s) if aid.absolute else None
        return Decision(reason, tuple(verdict.seen.nu.tolist()), tuple(sigma.tolist()), ratio, detail, position), state

    def _is_held(self, aid: Aid, z: Measurement, samples: ImuBuffer) -> bool:
        """It reads the same as before, though the vehicle moves."""
        reading = held.content(z, aid.order[-1])
        known, since_ns = self.same.get(aid.topic, (b"", 0))
        if known != reading:
            self.same[aid.topic] = reading, aid.t_ns
            return False
        if aid.t_ns - since_ns < held.spares_ns(z, aid.kind):
            return False
        second = self._stretch(samples)
        if second is None:
            return False
        bank = self.hypotheses if self.is_aligned else None
        return not rest.is_quiet(second, _ON_THE_GROUND) or (bank is not None and held.moves(bank.lead.x, bank.lead.cov))

    def _forget_estimated(self, aid: Aid, z: Measurement) -> None:
        """Wind or sensor have changed: what is estimated of them is unknown again, while positions show the motion."""
        if not isinstance(z, AirVelocity | DragForce):
            return
        if self.hypotheses is not None and self.t_ns - self.last_absolute_ns <= self._aided_ns:
            for slow in aid.slow_errors:
                if slow.walk is not None:
                    self.hypotheses.forget(slow.block)

    def _settle(self, stretch: Stretch, samples: ImuBuffer, alone: str) -> None:
        """Once aligned, run the stretch again where that is worth it, until the linear filter can go on alone.

        Not in dead reckoning: without absolute positions nothing confirms where a run ends. alone: the topic of the only source.
        """
        assert self.hypotheses is not None
        lead = self.hypotheses.lead
        is_long, is_aided = stretch.is_long(self.t_ns), self.t_ns - self.last_absolute_ns <= self._aided_ns
        if is_aided and (is_long or stretch.due(lead)):
            stretch = self._relinearise(stretch, samples)
            if self.hypotheses.lead is not lead:
                delay.begin_again(self.hypotheses.lead, alone, self._last_imu(samples))
        self.stretch = stretch
        if stretch.is_settled:
            self.stretch = None
        elif is_long:
            self.stretch = Stretch.of(self.hypotheses.lead)

    def _last_imu(self, samples: ImuBuffer) -> Array | None:
        """The last sample up to now, (6,), which none that comes later changes; None in a gap."""
        last = samples.first_after(self.t_ns) - 1
        return samples.u[last] if last >= 0 and self.t_ns - samples.t_ns[last] <= self._gap_ns else None

    def _imu(self, samples: ImuBuffer) -> Array:
        """The raw angular rate and specific force now, (6,)."""
        if not samples.count:
            return _NO_IMU
        index = samples.first_after(self.t_ns)
        return imu.interpolate(samples.t_ns, samples.u, samples.count, index, self.t_ns)

    def _note_biases(self, aid: Aid, seen: Innovation) -> None:
        """Whether they walk faster than configured."""
        assert self.hypotheses is not None
        before = self.bias_walk
        self.bias_walk = before.also(aid.topic, aid.t_ns, seen, self.variance_factor.value)
        if self.bias_walk.factor != before.factor:
            self.constants = imu.constants(self.bias_walk.of_noise(self.noise), self.config.coast, self.origin)
            walked = self.bias_walk.walked(before, self.noise)
            for member in self.hypotheses.members:
                member.adopt(self.constants, doubts_imu=member.doubts_imu)
                member.filter.widen_biases(walked)

    def _alone(self, aid: Aid) -> bool:
        """No other absolute source is active to compare this one with."""
        return not any(
            topic not in {aid.topic, aid.witness}
            and topic in self.absolute
            and (aid.t_ns - s.fused_ns) * 1e-9 < aid.rules.timeout_s
            for topic, s in self.sources.items()
        )

    def _leave(self, position_n: Array) -> None:
        """A source that has been fused turns out to be wrong; a position of GNSS (3,) shows by how much it may have misled."""
        self.variance_factor = NO_EXCESS
        if not self.is_aligned or self.hypotheses is None:
            self._begin_again()
            return
        del self.hypotheses.members[1:]
        lead, self.stretch = self.hypotheses.lead, None
        off = position_n - lead.x[X.P]
        self.hypotheses.members[0].doubts.clear()
        self.hypotheses.members[0].without = ""
        lead.widen(max(1.0, float(np.linalg.norm(off) / np.sqrt(np.trace(lead.cov[E.P, E.P])))))

    def _vouched(self, aid: Aid) -> bool:
        """Another absolute source has been fused lately."""
        return any(
            topic != aid.topic and topic in self.absolute and aid.t_ns - s.fused_ns < remarks.VOUCHED_NS
            for topic, s in self.sources.items()
        )

    def _note_absolute(self, aid: Aid, z: Measurement) -> None:
        """An absolute position was fused; a geodetic one is the last-known GPS."""
        if not aid.absolute:
            return
        self.last_absolute_ns = aid.t_ns
        if aid.geodetic and self.hypotheses is not None:
            lead = self.hypotheses.lead
            sigma = math.sqrt(max(z.noise.diagonal().tolist()[: _XYZ - 1]))
            speed = math.hypot(*lead.x[X.V].tolist()) + math.sqrt(sum(lead.cov.diagonal()[E.V].tolist()))
            self.anchor = GnssAnchor(aid.geodetic, aid.t_ns, sigma, speed)
