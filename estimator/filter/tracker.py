"""What the estimator knows at one instant: everything that a checkpoint has to keep.

A tracker takes measurements in the order of their validity and changes by nothing else: no clock, no arrival, no randomness.
"""

import math
from dataclasses import dataclass
from dataclasses import replace as replace_in
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from estimator.filter import contradiction, heading, initialise
from estimator.filter.bounds import BoundsConfig
from estimator.filter.contradiction import NO_CONTRADICTION
from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.heading import Resting, WithoutSensor
from estimator.filter.hypotheses import Hypotheses, Hypothesis
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.initialise import InitialiseConfig, Level
from estimator.filter.relative import steps
from estimator.filter.relinearise import Stretch, relinearise
from estimator.filter.variance_factor import LARGEST, NO_EXCESS
from estimator.sources import rest
from estimator.sources.aids import SourcesConfig
from estimator.sources.gating import gate
from estimator.sources.imu import Plausibility, stream_plausibility
from estimator.sources.odometry import Kept, OdometryAid
from estimator.sources.rest import Rest, RestConfig
from estimator.sources.source import Aid, Phase, Refusal, SourceState
from models import imu, so3
from models.frames import Origin
from models.imu import Coast, ImuNoise
from models.measurements import Conditional, Heading, Measurement, PartialPose, Pose, Position, Velocity
from models.messages import Array, Checkpoint, LastGnss, Mode, Reason
from models.state import E, X

_NEVER = -(2**62)
_AT_REST = "at rest: the heading shows when the vehicle moves"
_NO_POSITION = "waiting for a position"
_NO_PLACE = "give [map] origin to use GNSS or a magnetometer beside fixes on a local map"
_UNKNOWN = SourceState()
_NO_RATE = np.zeros(3)
_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
_FEWEST_SAMPLES = 5  # of IMU, to level with
_NO_START = f"waiting for a position with {_FEWEST_SAMPLES} IMU samples or more in the second before it"
_BEFORE_IMU = "before the first IMU sample"
_FOR_ALIGNED = "odometry is used once aligned"
_LOST_NS = 60_000_000_000  # an IMU gap after which the alignment begins again
_STILL_MEMORY_NS = 3_000_000_000  # a levelling at rest holds for so long after the vehicle has moved
_PROVEN_NS = 900_000_000  # in so long an IMU shows that it is right; each time it was not, three times as long
_THRICE_AT_MOST = 2
_BESIDE_NS = 5_000_000_000
_WRONG_NS = 30_000_000_000  # a heading that motion has refuted is not asked for
_WRONG_SENSOR = "its heading does not agree with the motion: wrong axes or mounting, or iron near it"
_FRESH_NS = 2_000_000_000  # a prior attitude is of now
_VOUCHED_NS = 60_000_000_000  # a source that was fused since then is one to compare a receiver with
_XYZ = 3
_WORTH_SAYING = 2.0  # of the variance of unit weight
_LARGEST_ALIGNING = (
    1e4  # ratio of an innovation to its prediction that may be noise, where it points another way than the last one
)
_MOVED_SIGMA = 4.0  # positions that differ by more are of a vehicle that moves


class FilterConfig(SourcesConfig, frozen=True, kw_only=True):
    """What filter and smoother are configured with; origin is (lat_deg, lon_deg, alt_m) or None."""

    imu: ImuNoise = ImuNoise()
    coast: Coast = Coast()
    initialise: InitialiseConfig = InitialiseConfig()
    origin: tuple[float, float, float] | None = None


class TrackerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """What a tracker is made with; origin None: the first GNSS fix becomes the origin."""

    imu: ImuNoise
    coast: Coast
    initialise: InitialiseConfig
    origin: Origin | None
    dead_reckoning_after_s: Annotated[float, Meta(gt=0)] = 3.0
    bounds: BoundsConfig = BoundsConfig()


class Decision(NamedTuple):
    """What became of a measurement (the part of AidStatus that does not depend on arrival)."""

    reason: Reason
    innovation: tuple[float, ...] = ()
    innovation_sigma: tuple[float, ...] = ()
    test_ratio: float = 0.0
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Still:
    """The vehicle at rest: levelled, at a position fix; since: the first fix of this rest."""

    level: Level
    z: Position | Pose
    since: Position | Pose


@dataclass(frozen=True, slots=True)
class GnssAnchor:
    """The last trusted GNSS fix: place (lat, lon, alt), time, 1-sigma radius [m] and speed then [m/s]."""

    place: tuple[float, float, float]
    t_ns: int
    sigma_m: float
    speed_m_s: float

    def at(self, t_ns: int) -> LastGnss:
        """Grown with its age: the vehicle may have gone on at the speed it had."""
        age_s = (t_ns - self.t_ns) * 1e-9
        return LastGnss(*self.place, age_s=age_s, sigma_m=float(np.hypot(self.sigma_m, self.speed_m_s * age_s)))


class Tracker:
    """Hypotheses, alignment, source machines and what was last known, at t_ns."""

    def __init__(self, config: TrackerConfig) -> None:
        self.config = config
        self._gap_ns, self._aided_ns = round(config.coast.gap_s * 1e9), round(config.dead_reckoning_after_s * 1e9)
        self.t_ns = _NEVER
        self.origin = config.origin
        self.place = config.origin.lla if config.origin else None
        self.constants = imu.constants(config.imu, config.coast, config.origin)
        self.hypotheses: Hypotheses | None = None
        self.is_aligned = False
        self.still: Still | None = None
        self.prior: tuple[int, Pose] | None = None
        self.sensed: tuple[Aid, Heading] | None = None  # the newest heading that was measured, until it is aligned
        self.rest_since: tuple[int, float] | None = None  # and the heading then
        self.without_sensor: WithoutSensor | None = None
        self.wrong_until_ns: dict[str, int] = {}  # topics whose heading motion has refuted
        self.resting: Resting | None = None
        self.waits_since_ns: int | None = None  # for its heading
        self.shows_unaligned = False
        self.stretch: Stretch | None = None
        self.contradiction = NO_CONTRADICTION
        self.given_up = 0  # how often a filter was
        self.variance_factor = NO_EXCESS
        self.direction: tuple[float, ...] = ()  # of the newest innovation of an absolute source during the alignment
        self.plausibility = Plausibility(Phase.STARTING, _NO_START)
        self.sources: dict[str, SourceState] = {}
        self.absolute: frozenset[str] = frozenset()  # topics that have given positions
        self.last_absolute_ns = _NEVER
        self.last_odometry_ns = _NEVER
        self.kept: dict[str, Kept] = {}  # poses that the filters keep, by topic of odometry
        self.anchor: GnssAnchor | None = None

    def copy(self) -> "Tracker":
        """An independent tracker in the same state; what never changes in place is shared."""
        other = object.__new__(Tracker)
        other.__dict__.update(self.__dict__)
        other.hypotheses = self.hypotheses.copy() if self.hypotheses else None
        other.resting = self.resting.copy() if self.resting else None
        other.without_sensor = self.without_sensor.copy() if self.without_sensor else None
        other.sources, other.kept = self.sources.copy(), self.kept.copy()
        return other

    def restarted(self) -> "Tracker":
        """A tracker without estimate, on the same map and with the same trust in the sources."""
        other = Tracker(self.config)
        other.origin, other.place, other.constants = self.origin, self.place, self.constants
        other.sources, other.absolute = self.sources.copy(), self.absolute
        other.last_absolute_ns, other.anchor, other.given_up = self.last_absolute_ns, self.anchor, self.given_up
        return other

    @property
    def bank(self) -> Hypotheses | None:
        """The filters there are, aligned or not."""
        if self.hypotheses is not None or self.resting is None:  # nearly every call
            return self.hypotheses
        return self.resting.bank

    @property
    def shown(self) -> Hypotheses | None:
        """The filters to publish from; None: nothing may be published yet."""
        return self.bank if self.is_aligned or self.shows_unaligned else None

    @property
    def standing(self) -> int:
        """How much of an estimate there is: 2 aligned, 1 published without a heading, 0 none."""
        return 2 if self.is_aligned else int(self.shown is not None)

    def shown_covariance(self) -> Array:
        """Of what is shown."""
        bank = self.bank
        assert bank is not None
        if self.is_aligned and self.without_sensor is not None:
            return self.without_sensor.mixed(bank.covariance(), bank.lead.x)
        return bank.covariance() if self.is_aligned else heading.covariance(bank, self.config.initialise)

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
            self.constants = imu.constants(self.config.imu, self.config.coast, self.origin)
        lead = Eskf(checkpoint.t_ns, checkpoint.nav.copy(), checkpoint.covariance.copy(), self.constants)
        since_ns = max(checkpoint.last_absolute_ns, checkpoint.t_ns - _LOST_NS)
        self.hypotheses = Hypotheses([Hypothesis(lead, fused_ns=since_ns, established_ns=since_ns)])
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
            return "" if self.is_aligned else initialise.lacks(self.hypotheses, self.config.initialise)
        return _AT_REST if self.still else _NO_POSITION

    @property
    def remarks(self) -> list[str]:
        """What makes an estimate that is published less certain than configured."""
        found: list[str] = []
        if self.shown is None:
            return found
        if conflict := self._conflict():
            found.append(conflict)
        if self.is_aligned and self.without_sensor is not None:
            found.append(f"the heading is that of {self.without_sensor.topic} alone until the vehicle accelerates")
        found += [
            f"{topic} and the IMU have contradicted each other: each may be wrong by {s.drift_m_s:.2g} m/s"
            for topic, s in sorted(self.sources.items())
            if s.drift_m_s
        ]
        if (f := self.variance_factor.value) >= _WORTH_SAYING:
            found.append(f"innovations are {math.sqrt(f):.1f} times as large as configured: the covariance is widened")
        return found

    def _conflict(self) -> str:
        """Which absolute sources disagree, by how much and for how long; "" where none do."""
        hypotheses = self.hypotheses
        if hypotheses is None or hypotheses.conflict_ns is None or (found := hypotheses.conflict) is None:
            return ""
        (rejected, distance_m), since_s = found, (self.t_ns - hypotheses.conflict_ns) * 1e-9
        used = {topic for topic in self.absolute - rejected if self.t_ns - self.sources[topic].fused_ns < _VOUCHED_NS}
        sides = ", ".join(sorted(rejected)), ", ".join(sorted(used)) or "the estimate"
        return f"{sides[0]} and {sides[1]} disagree by {distance_m:.1f} m for {since_s:.0f} s: the covariance covers both"

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
            self.constants = imu.constants(self.config.imu, self.config.coast, self.origin)
        if isinstance(aid, OdometryAid):
            return self._odometry(aid)
        if aid.check is not None and (refusal := aid.check(self.origin)) is not None:
            return Decision(refusal.reason, detail=refusal.detail)
        z = self._rest(aid, samples) if aid.kind == rest.TOPIC else aid.measurement(self.origin)
        if z is None:
            waits = self.hypotheses is None and not aid.geodetic
            return Decision(Reason.ALIGNING, detail=_NO_POSITION) if waits else Decision(Reason.NO_ORIGIN, detail=_NO_PLACE)
        if isinstance(z, Refusal):
            return Decision(z.reason, detail=z.detail)
        if isinstance(z, Conditional) and (bank := self.bank) is not None and (why := z.objection(bank.lead.x)):
            return Decision(Reason.IMPLAUSIBLE, detail=why)
        if aid.alignment_only:
            return self._believe(aid, z)
        if isinstance(z, Heading):
            if aid.t_ns < self.wrong_until_ns.get(aid.topic, _NEVER):
                return Decision(Reason.STOPPED, detail=_WRONG_SENSOR)
            self.sensed = None if self.is_aligned else (aid, z)
        state = self.sources.get(aid.topic, _UNKNOWN)
        if aid.t_ns - state.last_ns < aid.rules.spacing_s * 1e9:
            return Decision(Reason.THINNED)
        alone = self._alone(aid)
        state = state.arrive(aid.rules, aid.t_ns, alone=alone)
        if aid.absolute:
            self.absolute |= {aid.topic}
        gyro_b = self._gyro(samples) if aid.uses_rate else _NO_RATE  # no other measurement asks for it
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
            decision, state = self._judge(aid, z, gyro_b, state, alone=alone)
            if self.hypotheses is not hypotheses or hypotheses.switches != switches:
                self.stretch = None  # another filter leads, with another past, or none
            elif self.stretch is not None and decision.reason is Reason.FUSED:
                self._settle(self.stretch.also(aid, z, gyro_b), samples)
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

    def _rest(self, aid: Aid, samples: ImuBuffer) -> Rest | Refusal:
        """The vehicle at rest, as the last second of the IMU shows it and the estimate confirms."""
        rules, u = aid.rules, self._stretch(samples)
        assert isinstance(rules, RestConfig)
        if u is None or not self.is_aligned or self.hypotheses is None or not rest.is_quiet(u, rules):
            if self.rest_since is not None and self.is_aligned and self.hypotheses is not None:
                self.hypotheses.forget(rest.BLOCK)
                self.stretch = Stretch.of(self.hypotheses.lead)
            self.rest_since = None
            return Refusal(Reason.THINNED, "in motion" if self.is_aligned else _NO_POSITION)
        lead = self.hypotheses.lead
        if self.rest_since is None:
            self.rest_since = self.t_ns, so3.to_euler(lead.x[X.Q])[2]
        since_ns, azimuth = self.rest_since
        if self.t_ns - since_ns < rules.after_s * 1e9:
            return Refusal(Reason.THINNED, "at rest for a moment")
        if not rest.is_known(lead.cov, rules):
            return Refusal(Reason.GATED, "looks at rest, but the velocity is not known well enough to confirm it")
        self.stretch = None  # a run would leave out what rest has shown, and rest is linear
        earth_n = self.origin.earth_rate_n if self.origin is not None else _NO_RATE
        return rest.at_rest(u, azimuth, earth_n, rules)

    def _judge(self, aid: Aid, z: Measurement, gyro_b: Array, state: SourceState, *, alone: bool) -> tuple[Decision, SourceState]:
        """Gate and fuse, once aligned."""
        assert self.hypotheses is not None
        receiver = self.sources.get(aid.receiver or "", _UNKNOWN)  # of a velocity: it stands and falls with its positions
        trusted = state.phase is Phase.ACTIVE and (receiver.phase is Phase.ACTIVE or aid.t_ns > receiver.silent_ns)
        verdict = self.hypotheses.judge(aid, z, gyro_b, trusted=trusted, vouched=aid.absolute and self._vouched(aid))
        if trusted and aid.absolute:
            self._note_variance(aid, verdict.seen)
        self.hypotheses.drop(lambda member: bool(self.violation(member.filter)))
        if trusted:
            self._note_contradiction(aid, z, foreseen=verdict.foreseen)
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
        ratio = verdict.seen.distance2 / verdict.gate
        detail = aid.detail if reason is not Reason.GATED else "; ".join(filter(None, (aid.detail, self._conflict())))
        return Decision(reason, tuple(verdict.seen.nu.tolist()), tuple(sigma.tolist()), ratio, detail), state

    def _align(self, aid: Aid, z: Measurement, samples: ImuBuffer, gyro_b: Array) -> Decision:
        """Start the filter, or go on finding the heading."""
        config = self.config.initialise
        if self.hypotheses is None and not (samples.count and self.t_ns > samples.t_ns[0] - self._gap_ns):
            return Decision(Reason.ALIGNING, detail=_BEFORE_IMU)
        whole = isinstance(z, Pose) and z.attitude == "full" and aid.absolute
        if whole or self.hypotheses is None:
            stretch = self._stretch(samples)
            at = None
            if stretch is not None:
                self.plausibility = stream_plausibility(stretch)
                if self.plausibility.phase is not Phase.ACTIVE:
                    return Decision(Reason.ALIGNING, detail=self.plausibility.detail)
                at = initialise.level(self.t_ns, stretch, config, may_rest=not (aid.absolute and self._has_moved(z)))
            if whole and isinstance(z, Pose):
                if self.hypotheses is None or len(self.hypotheses.members) > 1:
                    self.hypotheses = initialise.start_from_pose(self.t_ns, z, self.constants, config)
                    self.stretch = Stretch.of(self.hypotheses.lead)
                    return Decision(Reason.ALIGNING)
            elif not aid.absolute or not isinstance(z, Pose | Position):
                return Decision(Reason.ALIGNING, detail=_NO_POSITION)
            elif at is None:
                return Decision(Reason.ALIGNING, detail=_NO_START)
            else:
                return self._find_heading(aid, z, at, samples, gyro_b)
        elif aid.absolute and isinstance(z, Position | Pose) and self._seeks_heading and self._end_search(z, samples):
            return Decision(Reason.ALIGNING)
        self._go_on(aid, z, samples, gyro_b)
        return Decision(Reason.ALIGNING)

    def _believe(self, aid: Aid, z: Measurement) -> Decision:
        """A prior waits for the position to begin with. Its errors repeat, so once begun it is no news."""
        if self.hypotheses is not None and not self._seeks_heading:
            return Decision(Reason.THINNED, detail="for the alignment alone")
        self.prior = (aid.t_ns, z) if isinstance(z, Pose) else None
        return Decision(Reason.ALIGNING, detail=_NO_POSITION)

    def _note_course(self, z: Velocity, samples: ImuBuffer) -> None:
        """The course is a prior where nobody gives a better one."""
        stretch = self._stretch(samples) if self.config.initialise.course_sigma_deg else None
        if stretch is None or (self.prior is not None and self.t_ns - self.prior[0] <= _FRESH_NS):
            return
        at = initialise.level(self.t_ns, stretch, self.config.initialise, may_rest=False)
        course = heading.from_course(z, at, self.config.initialise)
        self.prior = (self.t_ns, course) if course else None

    def _wait_for_heading(self, aid: Aid, z: Measurement, gyro_b: Array) -> None:
        """Keep what may be published without a heading: the bank that seeks it, or at rest one that does not."""
        if self.is_aligned or self.hypotheses is not None or self.still is None:
            self.resting = None
        elif self.resting is not None and not isinstance(z, Heading):
            self.resting.take(aid, z, gyro_b)
            self.resting = None if self.resting.is_refuted else self.resting
        elif self.resting is None and self.still.level.t_ns == self.t_ns:
            begun = initialise.start_from_position(
                self.t_ns, self.still.z, self.still.level, self.constants, self.config.initialise
            )
            self.resting = Resting(begun)
        if self.is_aligned or self.bank is None:
            self.waits_since_ns, self.shows_unaligned = None, False
            return
        if self.waits_since_ns is None:
            self.waits_since_ns = self.t_ns
        config = self.config.initialise
        has_waited = (self.t_ns - self.waits_since_ns) * 1e-9 >= config.publish_after_s
        self.shows_unaligned |= has_waited and self._is_proven() and initialise.lacks_attitude_alone(self.bank, config)
        if self.resting is not None and aid.absolute:
            self.last_absolute_ns = self.t_ns

    def _go_on(self, aid: Aid, z: Measurement, samples: ImuBuffer, gyro_b: Array) -> None:
        """Aligned when enough is known, and the stretch, run again, confirms the filter."""
        assert self.hypotheses is not None
        self.hypotheses.scale(self.variance_factor.value)
        seen = initialise.weigh(self.hypotheses, aid, z, gyro_b)
        limit = gate(aid.rules.gate_probability, len(seen.nu))
        foreseen = seen.distance2 * self.variance_factor.value <= limit
        if aid.absolute:
            before, self.direction = self.direction, contradiction.direction(seen.nu, seen.s)
            persists = contradiction.persists(before, self.direction)
            foreseen |= seen.distance2 <= limit and not persists
            if len(self.hypotheses.members) == 1:
                self._note_variance(aid, seen, LARGEST if persists else _LARGEST_ALIGNING)
        self._note_contradiction(aid, z, foreseen=foreseen)
        if self.hypotheses is None:
            return
        if self.stretch is not None:
            self.stretch = self.stretch.also(aid, z, gyro_b)
        known = self._is_proven() and self._is_known()
        if known:
            del self.hypotheses.members[1:]
        if self.stretch is None or self.stretch.is_long(self.t_ns):  # the heading took too long to show
            self.stretch = Stretch.of(self.hypotheses.lead) if known else None
            self.is_aligned = known
        elif len(self.hypotheses.members) == 1 and self.stretch.has_grown:
            confirmed = self._relinearise(self.stretch, samples).is_confirmed
            self.is_aligned = known and confirmed and self._is_known()

    def _note_contradiction(self, aid: Aid, z: Measurement, *, foreseen: bool) -> None:
        """A position was foreseen by some filter or by none; the alignment begins again where the IMU turns out to be wrong."""
        if not aid.absolute:
            return
        self.contradiction = NO_CONTRADICTION if foreseen else self.contradiction.also(aid.t_ns, z)
        if self.contradiction.is_shown:
            self.hypotheses, self.stretch, self.still, self.is_aligned, self.without_sensor = None, None, None, False, None
            self.contradiction, self.given_up = NO_CONTRADICTION, self.given_up + 1

    def _note_variance(self, aid: Aid, seen: Innovation, largest: float = LARGEST) -> None:
        """One more innovation of an absolute source, of the leading filter."""
        assert self.hypotheses is not None
        distance2 = seen.distance2 * self.variance_factor.value
        self.variance_factor = self.variance_factor.also(aid.topic, aid.t_ns, distance2, len(seen.nu), largest)
        self.hypotheses.scale(self.variance_factor.value, aid.topic)

    def _is_known(self) -> bool:
        """Attitude and velocity are known well enough."""
        assert self.hypotheses is not None
        return initialise.aligned(self.hypotheses, self.config.initialise, sensed=self._senses_heading)

    def _is_proven(self) -> bool:
        """The newest position was foreseen, by a filter that has gone on for a while."""
        since_ns = self.stretch.t_ns if self.stretch is not None else _NEVER
        return not self.contradiction.unforeseen and self.t_ns - since_ns >= _PROVEN_NS * 3 ** min(self.given_up, _THRICE_AT_MOST)

    def _settle(self, stretch: Stretch, samples: ImuBuffer) -> None:
        """Once aligned, run the stretch again where that is worth it, until the linear filter can go on alone.

        Not in dead reckoning: without absolute positions nothing confirms where a run ends.
        """
        assert self.hypotheses is not None
        is_long, is_aided = stretch.is_long(self.t_ns), self.t_ns - self.last_absolute_ns <= self._aided_ns
        if is_aided and (is_long or stretch.due(self.hypotheses.lead)):
            stretch = self._relinearise(stretch, samples)
        self.stretch = stretch
        if stretch.is_settled:
            self.stretch = None
        elif is_long:
            self.stretch = Stretch.of(self.hypotheses.lead)

    def _relinearise(self, stretch: Stretch, samples: ImuBuffer) -> Stretch:
        """The leading filter, linearised about what is known now, goes on; the stretch with the run noted, where it succeeded."""
        assert self.hypotheses is not None
        try:
            result = relinearise(stretch, self.hypotheses.lead, samples)
        except np.linalg.LinAlgError:  # a covariance is singular to rounding: no better than not to converge
            result = None
        if result is not None:
            self.hypotheses.members[0].filter, stretch = result
        self.stretch = stretch
        return stretch

    def _find_heading(self, aid: Aid, z: Position | Pose, at: Level, samples: ImuBuffer, gyro_b: Array) -> Decision:
        """Wait while the vehicle rests; start the bank of headings, from the last rest if it was just now, when it moves."""
        config = self.config.initialise
        if self._start_from_prior(z, at, samples) or self._start_from_sensed(z, at, samples):
            return Decision(Reason.ALIGNING)
        if at.still:
            self.still = Still(at, z, self.still.since if self.still else z)
            return Decision(Reason.ALIGNING, detail=_AT_REST)
        if self.still is None or self.t_ns - self.still.level.t_ns > _STILL_MEMORY_NS:
            self.hypotheses, self.stretch = self._all_headings(z, at)
            return Decision(Reason.ALIGNING)
        last = self.still
        self.hypotheses = initialise.start_from_position(last.level.t_ns, last.z, last.level, self.constants, config)
        self.stretch = Stretch.of(initialise.heading_unknown(last.level.t_ns, last.z, last.level, self.constants, config))
        index = samples.first_after(last.level.t_ns)
        for member in self.hypotheses.members:
            member.filter.propagate(samples, index, self.t_ns)
        self._go_on(aid, z, samples, gyro_b)
        return Decision(Reason.ALIGNING)

    @property
    def _seeks_heading(self) -> bool:
        """Several headings are left, none decided."""
        return not self.is_aligned and self.hypotheses is not None and len(self.hypotheses.members) > 1

    def _end_search(self, z: Position | Pose, samples: ImuBuffer) -> bool:
        """Whether a prior that came during the search took its place."""
        stretch = self._stretch(samples)
        return stretch is not None and self._start_from_prior(
            z, initialise.level(self.t_ns, stretch, self.config.initialise, may_rest=False), samples
        )

    def _start_from_prior(self, z: Position | Pose, at: Level, samples: ImuBuffer) -> bool:
        """Whether there is an attitude to begin with: fresh, not against gravity, and none that a search has ruled out."""
        if self.prior is None or self.t_ns - self.prior[0] > _FRESH_NS:
            return False
        since_ns, believed = self.prior
        prior = Pose(believed.z_n, samples.turned(believed.q_nb_wxyz, since_ns, self.t_ns), believed.noise, believed.rows)
        if self.hypotheses is not None and not initialise.agrees(self.hypotheses, prior):
            return False
        begun = initialise.start_from_attitude(self.t_ns, z, at, prior, self.constants, self.config.initialise)
        if begun is not None:
            self.hypotheses, self.stretch = begun, Stretch.of(begun.lead)
        return begun is not None

    def _start_from_sensed(self, z: Position | Pose, at: Level, samples: ImuBuffer) -> bool:
        """Whether it began at rest with the heading that is measured now; in motion, that weighs the headings of the bank."""
        if not at.still or not self._senses_heading or self.sensed is None:
            return False
        aid, seen = self.sensed
        turn = so3.matrix(samples.turned(_NO_TURN, aid.t_ns, self.t_ns))
        now = replace_in(seen, direction_b=turn.T @ seen.direction_b)
        config = self.config.initialise
        begun = initialise.start_from_heading(self.t_ns, z, at, aid, now, self.constants, config)
        if begun is not None:
            self.hypotheses, self.stretch = begun, Stretch.of(begun.lead)
            self.without_sensor = WithoutSensor(*self._all_headings(z, at), aid.topic, self.t_ns)
        return begun is not None

    def _check_sensor(self, aid: Aid, z: Measurement, samples: ImuBuffer, gyro_b: Array) -> None:
        """Go on without the sensor that measures the heading, too, until motion has shown it to be right or wrong."""
        beside, config = self.without_sensor, self.config.initialise
        if self.hypotheses is None:
            self.without_sensor = None
        elif isinstance(z, Heading):
            if beside is None and not self.is_aligned:
                self.without_sensor = WithoutSensor(self.hypotheses.copy(), self.stretch, aid.topic, self.t_ns)
        elif beside is not None and isinstance(z, Position | Pose | Velocity):
            beside.take(aid, z, gyro_b, self.hypotheses)
            known = self.is_aligned and initialise.aligned(beside.bank, config)
            if beside.is_shown or (known and beside.disagrees(self.hypotheses.lead)):
                self.hypotheses, self.is_aligned, self.shows_unaligned = beside.bank, False, self.shown is not None
                self.stretch, self.sensed, self.without_sensor = beside.stretch, None, None
                self.wrong_until_ns = self.wrong_until_ns | {beside.topic: self.t_ns + _WRONG_NS}
            elif known and beside.knows_heading:
                self.without_sensor = None
            elif aid.absolute and isinstance(z, Position | Pose) and self.t_ns - beside.began_ns > _BESIDE_NS:
                self._begin_beside(beside, z, samples)

    def _begin_beside(self, beside: WithoutSensor, z: Position | Pose, samples: ImuBuffer) -> None:
        """At rest the headings begin anew, before they blur."""
        beside.began_ns, stretch = self.t_ns, self._stretch(samples)
        if stretch is None:
            return
        at = initialise.level(self.t_ns, stretch, self.config.initialise)
        if at.still:
            beside.bank, beside.stretch = self._all_headings(z, at)

    def _all_headings(self, z: Position | Pose, at: Level) -> tuple[Hypotheses, Stretch]:
        """The bank of headings at a position fix, and the stretch that will confirm one of them."""
        start = self.t_ns, z, at, self.constants, self.config.initialise
        return initialise.start_from_position(*start), Stretch.of(initialise.heading_unknown(*start))

    @property
    def _senses_heading(self) -> bool:
        """A magnetometer or two antennas gave a heading just now."""
        return self.sensed is not None and self.t_ns - self.sensed[0].t_ns <= _FRESH_NS

    def _has_moved(self, z: Measurement) -> bool:
        """Whether a position fix is elsewhere than the first one of what was taken for rest; then it was none."""
        if self.still is None or not isinstance(z, Pose | Position):
            return False
        first, axes = self.still.since, slice(0, _XYZ)
        sigma = np.sqrt(np.diag(z.noise)[axes] + np.diag(first.noise)[axes])
        if (np.abs(z.z_n - first.z_n) < _MOVED_SIGMA * sigma).all():
            return False
        self.still = None
        return True

    def _stretch(self, samples: ImuBuffer) -> Array | None:
        """The last `level_s` of IMU samples up to now (k, 6); None where there is no such stretch yet."""
        span_ns = int(self.config.initialise.level_s * 1e9)
        end = samples.first_after(self.t_ns)
        begin = int(np.searchsorted(samples.t_ns[:end], self.t_ns - span_ns))
        if end - begin < _FEWEST_SAMPLES or samples.t_ns[end - 1] - samples.t_ns[begin] < 0.5 * span_ns:
            return None
        return samples.u[begin:end]

    def _gyro(self, samples: ImuBuffer) -> Array:
        """The raw angular rate now, (3,)."""
        if not samples.count:
            return _NO_RATE
        index = samples.first_after(self.t_ns)
        return imu.interpolate(samples.t_ns, samples.u, samples.count, index, self.t_ns)[:3]

    def _alone(self, aid: Aid) -> bool:
        """No other absolute source is active that could vouch for this one."""
        return not any(
            topic not in {aid.topic, aid.witness}
            and topic in self.absolute
            and (aid.t_ns - s.fused_ns) * 1e-9 < aid.rules.timeout_s
            for topic, s in self.sources.items()
        )

    def _vouched(self, aid: Aid) -> bool:
        """Another absolute source has been fused lately."""
        return any(
            topic != aid.topic and topic in self.absolute and aid.t_ns - s.fused_ns < _VOUCHED_NS
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
