"""From nothing to an aligned filter.

From a whole pose, or a position with eight headings, an attitude prior, course or measured heading. Aligned: attitude and
velocity known, and confirmed by a second run.
"""

import math
from dataclasses import dataclass
from dataclasses import replace as replace_in

import numpy as np

from estimator.filter import contradiction
from estimator.filter.alignment import heading, initialise
from estimator.filter.alignment.core import FEWEST_SAMPLES, NEVER, Core, Decision
from estimator.filter.alignment.heading import Resting, WithoutSensor
from estimator.filter.alignment.initialise import Level
from estimator.filter.conflict import Conflicts
from estimator.filter.contradiction import NO_CONTRADICTION
from estimator.filter.eskf import Innovation
from estimator.filter.hypotheses import Hypotheses, Hypothesis, innovation
from estimator.filter.imu_buffer import ImuBuffer
from estimator.filter.relinearise import Stretch
from estimator.filter.variance_factor import LARGEST, LARGEST_AT_FIRST
from estimator.sources.base.aid import Aid
from estimator.sources.base.gating import gate
from estimator.sources.base.machine import Phase
from estimator.sources.imu.plausibility import Plausibility, stream_plausibility
from models import so3
from models.measurements import Heading, Measurement, Pose, Position, Velocity
from models.messages import Array, Reason
from models.state import XYZ, E, X

NO_POSITION = "waiting for a position"
WRONG_SENSOR = "its heading does not agree with the motion: wrong axes or mounting, or iron near it"
AT_REST = "at rest: the heading shows when the vehicle moves"
_NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
_NO_START = f"waiting for a position with {FEWEST_SAMPLES} IMU samples or more in the second before it"
_BEFORE_IMU = "before the first IMU sample"
_POSITIONS_FIRST = "positions align the filter first"
_STILL_MEMORY_NS = 3_000_000_000  # a levelling at rest holds for so long after the vehicle has moved
_PROVEN_NS = 900_000_000  # in so long an IMU shows that it is right; each time it was not, three times as long
_THRICE_AT_MOST = 2
_BESIDE_NS = 5_000_000_000
_WRONG_NS = 30_000_000_000  # a heading that motion has refuted is not asked for
_UNDECIDED_NS = 600_000_000_000  # nor are two that differ
_FRESH_NS = 2_000_000_000  # a prior attitude is of now
_TRIED_NS = 10_000_000_000  # a source of poses that has not aligned the filter by then lets another one try
_LARGEST_NOISE = math.radians(30.0)  # a larger innovation of attitude is not the noise of a fix
_MOVED_SIGMA = 4.0  # positions that differ by more are of a vehicle that moves


@dataclass(frozen=True, slots=True)
class Still:
    """Levelled at rest at a position fix; since: the first fix."""

    level: Level
    z: Position | Pose
    since: Position | Pose


class Alignment:
    """State of the alignment; filters are the core's."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self.still: Still | None = None
        self.prior: tuple[int, Pose, str] | None = None  # and its topic; "": the course
        self.sensed: tuple[Aid, Heading] | None = None  # the newest heading that was measured, until it is aligned
        self.without_sensor: WithoutSensor | None = None
        self.wrong_until_ns: dict[str, int] = {}  # topics whose heading motion, or another sensor, has refuted
        self.two_headings: tuple[str, str] | None = None  # that differed last
        self.resting: Resting | None = None
        self.waits_since_ns: int | None = None  # for its heading
        self.shows_unaligned = False
        self.contradiction = NO_CONTRADICTION
        self.given_up = 0  # how often a filter was
        self.positions_until_ns = NEVER  # without velocities, after a filter that they may have misled
        self.begun_by, self.begun_ns = "", NEVER  # the source at whose position the newest filter begins, and its newest pose
        self.since_ns = NEVER  # when it was another one
        self.direction = np.zeros(0)  # of the newest innovation of an absolute source during the alignment
        self.persisted = False  # it and the one before point the same way
        self.plausibility = Plausibility(Phase.STARTING, _NO_START)

    def copy(self, core: Core) -> "Alignment":
        """Independent copy with another core; immutable parts are shared."""
        other = object.__new__(Alignment)
        other.__dict__ = self.__dict__.copy()
        other.core = core
        other.resting = self.resting.copy() if self.resting else None
        other.without_sensor = self.without_sensor.copy() if self.without_sensor else None
        return other

    def lose(self) -> None:
        """Too long without an IMU."""
        self.core.hypotheses, self.core.stretch, self.core.is_aligned, self.without_sensor = None, None, False, None
        self.resting, self.waits_since_ns, self.shows_unaligned = None, None, False

    @property
    def bank(self) -> Hypotheses | None:
        """All filters, aligned or not."""
        return self.core.hypotheses or (self.resting.bank if self.resting is not None else None)

    @property
    def members(self) -> list[Hypothesis]:
        """All filters."""
        bank, beside = self.bank, self.without_sensor
        members = bank.members if bank is not None else []
        return members if beside is None else members + beside.bank.members

    @property
    def shown(self) -> Hypotheses | None:
        """The filters to publish from; None: nothing may be published yet."""
        return self.bank if self.core.is_aligned or self.shows_unaligned else None

    def align(self, aid: Aid, z: Measurement, samples: ImuBuffer, gyro_b: Array) -> Decision:
        """Start the filter, or go on finding the heading."""
        core = self.core
        config = core.config.initialise
        if isinstance(z, Velocity) and (core.t_ns < self.positions_until_ns or core.t_ns - self.begun_ns < _FRESH_NS):
            return Decision(Reason.ALIGNING, detail=_POSITIONS_FIRST)
        if core.hypotheses is None and not (samples.count and core.t_ns > samples.t_ns[0] - core.gap_ns):
            return Decision(Reason.ALIGNING, detail=_BEFORE_IMU)
        whole = isinstance(z, Pose) and z.attitude == "full" and aid.absolute
        if whole and core.hypotheses is not None and aid.topic != self.begun_by and core.t_ns - self.begun_ns < _FRESH_NS:
            if core.t_ns - self.since_ns < _TRIED_NS:
                return Decision(Reason.ALIGNING, detail=f"{self.begun_by} aligns first")  # the two may contradict each other
            self.begin_again()
        if whole or core.hypotheses is None:
            stretch = core.recent(samples)
            at = None
            if stretch is not None:
                self.plausibility = stream_plausibility(stretch)
                if self.plausibility.phase is not Phase.ACTIVE:
                    return Decision(Reason.ALIGNING, detail=self.plausibility.detail)
                at = initialise.level(core.t_ns, stretch, config, may_rest=not (aid.absolute and self._has_moved(z)))
            if whole and isinstance(z, Pose):
                if at is not None and initialise.is_turned(z, at):
                    if self.begun_by == aid.topic:  # with fewer IMU samples
                        self.begin_again()
                    self.plausibility = Plausibility(Phase.ACTIVE, contradiction.SAYS)
                    return Decision(Reason.ALIGNING, detail=contradiction.SAYS)
                if core.hypotheses is None or len(core.hypotheses.members) > 1:
                    if aid.topic != self.begun_by:
                        self.since_ns = core.t_ns
                    self.begun_by, self.begun_ns = aid.topic, core.t_ns
                    core.hypotheses = initialise.start_from_pose(core.t_ns, z, core.constants, config, aid)
                    core.stretch = Stretch.of(core.hypotheses.lead)
                    return Decision(Reason.ALIGNING)
            elif not aid.absolute or not isinstance(z, Pose | Position):
                return Decision(Reason.ALIGNING, detail=NO_POSITION)
            elif at is None:
                return Decision(Reason.ALIGNING, detail=_NO_START)
            else:
                self.begun_by = aid.topic
                return self._find_heading(aid, z, at, samples, gyro_b)
        elif aid.absolute and isinstance(z, Position | Pose) and self._may_begin_again and self._end_search(aid, z, samples):
            self.begun_by = aid.topic
            return Decision(Reason.ALIGNING)
        self._go_on(aid, z, samples, gyro_b)
        if whole and aid.topic == self.begun_by:
            self.begun_ns = core.t_ns
        return Decision(Reason.ALIGNING)

    def take_prior(self, aid: Aid, z: Measurement) -> Decision:
        """Use a waiting prior at a position."""
        if self.core.hypotheses is not None and not (self._seeks_heading or self._has_blurred):
            return Decision(Reason.THINNED, detail="for the alignment alone")
        if aid.t_ns < self.wrong_until_ns.get(aid.topic, NEVER):
            return Decision(Reason.STOPPED, detail=WRONG_SENSOR)
        self.prior = (aid.t_ns, z, aid.topic) if isinstance(z, Pose) else None
        return Decision(Reason.ALIGNING, detail=NO_POSITION)

    def note_course(self, z: Velocity, samples: ImuBuffer) -> None:
        """Use the course as a prior without a better one."""
        core = self.core
        may = core.config.initialise.course_sigma_deg and core.t_ns >= self.positions_until_ns
        stretch = core.recent(samples) if may else None
        if stretch is None or (self.prior is not None and core.t_ns - self.prior[0] <= _FRESH_NS):
            return
        at = initialise.level(core.t_ns, stretch, core.config.initialise, may_rest=False)
        course = heading.from_course(z, at, core.config.initialise)
        self.prior = (core.t_ns, course, "") if course else None

    def wait_for_heading(self, aid: Aid, z: Measurement, gyro_b: Array) -> None:
        """What may be published without a heading."""
        core = self.core
        if core.is_aligned or core.hypotheses is not None or self.still is None:
            self.resting = None
        elif self.resting is not None and not isinstance(z, Heading):
            self.resting.take(aid, z, gyro_b)
            self.resting = None if self.resting.is_refuted else self.resting
        elif self.resting is None and self.still.level.t_ns == core.t_ns:
            begun = initialise.start_from_position(
                core.t_ns, self.still.z, self.still.level, core.constants, core.config.initialise
            )
            self.resting = Resting(begun)
        if core.is_aligned or self.bank is None:
            self.waits_since_ns, self.shows_unaligned = None, False
            return
        if self.waits_since_ns is None:
            self.waits_since_ns = core.t_ns
        config = core.config.initialise
        has_waited = (core.t_ns - self.waits_since_ns) * 1e-9 >= config.publish_after_s
        self.shows_unaligned |= has_waited and self._is_proven() and initialise.lacks_attitude_alone(self.bank, config)
        if self.resting is not None and aid.absolute:
            core.last_absolute_ns = core.t_ns

    def _go_on(self, aid: Aid, z: Measurement, samples: ImuBuffer, gyro_b: Array) -> None:
        core = self.core
        assert core.hypotheses is not None
        core.hypotheses.scale(core.variance_factor.value)
        if waits := self._contradicts_start(aid):  # what the stretch leaves out is not fused
            seen = innovation(core.hypotheses.lead, aid, z, gyro_b)
        else:
            seen = initialise.weigh(core.hypotheses, aid, z, gyro_b)
        limit = gate(aid.rules.gate_probability, len(seen.nu))
        foreseen, follows = seen.distance2 * core.variance_factor.value <= limit, False
        if aid.absolute:
            before, self.direction = self.direction, contradiction.direction(seen.nu, seen.s)
            persists = contradiction.persists(before, self.direction)
            lasts, self.persisted = persists and (self.persisted or _contradicts_attitude(z, seen)), persists
            foreseen |= seen.distance2 <= limit and not persists
            if len(core.hypotheses.members) == 1:
                follows = self._follows(aid, seen, limit, lasts=lasts)
                core.note_variance(aid, seen, LARGEST if lasts else LARGEST_AT_FIRST)
            disagrees = seen.distance2 * core.variance_factor.value > limit
            if persists or not disagrees:
                core.conflicts = core.conflicts.compared(aid, z, core.hypotheses.lead.x[X.P], disagrees=disagrees)
        self._note_contradiction(aid, z, foreseen=foreseen)
        if core.hypotheses is None:
            return
        before_it = core.stretch
        if core.stretch is not None and not waits and not self._contradicts_start(aid):
            core.stretch = core.stretch.also(aid, z, gyro_b, follows=follows)
        known = self._is_proven() and self._is_known()
        if known:
            del core.hypotheses.members[1:]
        if core.stretch is None or core.stretch.is_long(core.t_ns):  # the heading took too long to show
            core.stretch = Stretch.of(core.hypotheses.lead) if known else None
            core.is_aligned = known
        elif len(core.hypotheses.members) == 1 and core.stretch is not before_it and core.stretch.has_grown:  # a run ends now
            confirmed = core.relinearise(core.stretch, samples).is_confirmed
            core.is_aligned = known and confirmed and self._is_known()

    def _follows(self, aid: Aid, seen: Innovation, limit: float, *, lasts: bool) -> bool:
        """Fuse a second measurement that the filter did not predict.

        Not where innovations persist in one direction (three in a row, two at an attitude 30 degrees off), nor after a filter was
        given up: then the IMU is wrong.
        """
        core = self.core
        assert core.hypotheses is not None
        is_alone = core.absolute <= {aid.topic}  # else the two may be in conflict
        has_followed = core.stretch is not None and core.stretch.has_followed
        if self.given_up or not is_alone or not self.contradiction.unforeseen or (lasts and has_followed):
            return False
        if seen.distance2 > limit and seen.log_likelihood <= aid.log_false:  # what weigh() has not fused
            core.hypotheses.lead.update(seen)
        return True

    def _note_contradiction(self, aid: Aid, z: Measurement, *, foreseen: bool) -> None:
        if not aid.absolute:
            return
        own_too = aid.topic == self.begun_by and self.core.conflicts.apart
        if not foreseen and own_too and self.contradiction.is_late(aid.t_ns):  # the filter began at a false position
            self.begin_again()
            return
        if not foreseen and self.contradiction.unforeseen and self._contradicts_start(aid):
            return  # the source that it began with has the next word, and nothing is said of the IMU
        self.contradiction = NO_CONTRADICTION if foreseen else self.contradiction.also(aid.t_ns, z)
        if self.contradiction.is_shown:
            self.begin_again()
            self.given_up += 1
            self.positions_until_ns = self.core.t_ns + _TRIED_NS

    def _contradicts_start(self, aid: Aid) -> bool:
        return aid.topic != self.begun_by and aid.topic in self.core.conflicts.apart

    def begin_again(self) -> None:
        """Align anew: the state rests on wrong readings."""
        core = self.core
        core.hypotheses, core.stretch, self.still, core.is_aligned, self.without_sensor = None, None, None, False, None
        self.contradiction, core.conflicts = NO_CONTRADICTION, Conflicts()

    def _is_known(self) -> bool:
        core = self.core
        assert core.hypotheses is not None
        return initialise.aligned(core.hypotheses, core.config.initialise, sensed=self._senses_heading)

    def _is_proven(self) -> bool:
        core = self.core
        since_ns = core.stretch.t_ns if core.stretch is not None else NEVER
        return not self.contradiction.unforeseen and core.t_ns - since_ns >= _PROVEN_NS * 3 ** min(self.given_up, _THRICE_AT_MOST)

    def _find_heading(self, aid: Aid, z: Position | Pose, at: Level, samples: ImuBuffer, gyro_b: Array) -> Decision:
        core, z = self.core, initialise.with_slow_errors(aid, z)
        config = core.config.initialise
        if self._start_from_prior(z, at, samples) or self._start_from_sensed(z, at, samples):
            return Decision(Reason.ALIGNING)
        if at.still:
            self.still = Still(at, z, self.still.since if self.still else z)
            return Decision(Reason.ALIGNING, detail=AT_REST)
        if self.still is None or core.t_ns - self.still.level.t_ns > _STILL_MEMORY_NS:
            core.hypotheses, core.stretch = self._all_headings(z, at)
            return Decision(Reason.ALIGNING)
        last = self.still
        core.hypotheses = initialise.start_from_position(last.level.t_ns, last.z, last.level, core.constants, config)
        core.stretch = Stretch.of(initialise.heading_unknown(last.level.t_ns, last.z, last.level, core.constants, config))
        index = samples.first_after(last.level.t_ns)
        for member in core.hypotheses.members:
            member.filter.propagate(samples, index, core.t_ns)
        self._go_on(aid, z, samples, gyro_b)
        return Decision(Reason.ALIGNING)

    @property
    def _seeks_heading(self) -> bool:
        core = self.core
        return not core.is_aligned and core.hypotheses is not None and len(core.hypotheses.members) > 1

    @property
    def _has_blurred(self) -> bool:
        core = self.core
        if core.is_aligned or core.hypotheses is None or len(core.hypotheses.members) > 1:
            return False
        attitude = float(core.hypotheses.lead.cov.diagonal()[E.THETA].max())
        return attitude > math.radians(core.config.initialise.heading_deg) ** 2

    @property
    def _may_begin_again(self) -> bool:
        return self._seeks_heading or (self.prior is not None and bool(self.prior[2]) and self._has_blurred)

    def _end_search(self, aid: Aid, z: Position | Pose, samples: ImuBuffer) -> bool:
        core, z = self.core, initialise.with_slow_errors(aid, z)
        stretch = core.recent(samples)
        return stretch is not None and self._start_from_prior(
            z, initialise.level(core.t_ns, stretch, core.config.initialise, may_rest=False), samples
        )

    def _start_from_prior(self, z: Position | Pose, at: Level, samples: ImuBuffer) -> bool:
        core = self.core
        if self.prior is None or core.t_ns - self.prior[0] > _FRESH_NS:
            return False
        since_ns, given, topic = self.prior
        prior = Pose(given.z_n, samples.turned(given.q_nb_wxyz, since_ns, core.t_ns), given.noise, given.rows)
        if core.hypotheses is not None and not initialise.agrees(core.hypotheses, prior):
            return False
        begun = initialise.start_from_attitude(core.t_ns, z, at, prior, core.constants, core.config.initialise)
        if begun is not None:
            core.hypotheses, core.stretch = begun, Stretch.of(begun.lead)
            beside = self.without_sensor
            if topic and (at.still or beside is not None):  # nothing has shown yet whether its heading is right
                self.without_sensor = WithoutSensor(*self._all_headings(z, at), topic, core.t_ns, z if at.still else None)
                self.without_sensor.odds = beside.odds if beside is not None else self.without_sensor.odds
        return begun is not None

    def _start_from_sensed(self, z: Position | Pose, at: Level, samples: ImuBuffer) -> bool:
        core = self.core
        if not at.still or not self._senses_heading or self.sensed is None:
            return False
        aid, seen = self.sensed
        turn = so3.matrix(samples.turned(_NO_TURN, aid.t_ns, core.t_ns))
        now = replace_in(seen, direction_b=turn.T @ seen.direction_b)
        config = core.config.initialise
        begun = initialise.start_from_heading(core.t_ns, z, at, aid, now, core.constants, config)
        if begun is not None:
            core.hypotheses, core.stretch = begun, Stretch.of(begun.lead)
            self.without_sensor = WithoutSensor(*self._all_headings(z, at), aid.topic, core.t_ns, z)
        return begun is not None

    def check_sensor(self, aid: Aid, z: Measurement, samples: ImuBuffer, gyro_b: Array) -> None:
        """A bank without the heading sensor, until motion judges."""
        core = self.core
        beside, config = self.without_sensor, core.config.initialise
        if core.hypotheses is None:
            self.without_sensor = None
        elif isinstance(z, Heading):
            if beside is None and not core.is_aligned:
                self.without_sensor = WithoutSensor(core.hypotheses.copy(), core.stretch, aid.topic, core.t_ns)
            elif beside is not None and aid.topic != beside.topic and beside.differs(aid, z, core.hypotheses.lead):
                self.two_headings = beside.topic, aid.topic
                self.wrong_until_ns = self.wrong_until_ns | dict.fromkeys(self.two_headings, core.t_ns + _UNDECIDED_NS)
                self.sensed = self.prior = None
                self.begin_again()
        elif beside is not None and isinstance(z, Position | Pose | Velocity):
            beside.take(aid, z, gyro_b, core.hypotheses, at_rest=self._rests(beside, z, samples))
            known = core.is_aligned and initialise.aligned(beside.bank, config)
            if beside.is_shown or (known and beside.disagrees(core.hypotheses.lead)):
                core.hypotheses, core.is_aligned, self.shows_unaligned = beside.bank, False, self.shown is not None
                core.stretch, self.sensed, self.prior, self.without_sensor = beside.stretch, None, None, None
                self.wrong_until_ns = self.wrong_until_ns | {beside.topic: core.t_ns + _WRONG_NS}
            elif known and beside.knows_heading:
                self.without_sensor = None
            elif aid.absolute and isinstance(z, Position | Pose) and core.t_ns - beside.began_ns > _BESIDE_NS:
                self._begin_beside(beside, z, samples)

    def _rests(self, beside: WithoutSensor, z: Measurement, samples: ImuBuffer) -> bool:
        core = self.core
        if beside.since is None:
            return False
        if isinstance(z, Position | Pose) and _differ(z, beside.since):
            beside.since = None
            return False
        stretch = core.recent(samples)
        return stretch is not None and initialise.level(core.t_ns, stretch, core.config.initialise).still

    def _begin_beside(self, beside: WithoutSensor, z: Position | Pose, samples: ImuBuffer) -> None:
        core = self.core
        beside.began_ns, stretch = core.t_ns, core.recent(samples)
        if stretch is None:
            return
        at = initialise.level(core.t_ns, stretch, core.config.initialise)
        if at.still and beside.since is not None:
            beside.bank, beside.stretch = self._all_headings(z, at)
            if core.hypotheses is not None:
                for member in core.hypotheses.members:
                    heading.level_again(member.filter, at, core.config.initialise)
                core.stretch = Stretch.of(core.hypotheses.lead)
        beside.since = z if at.still else None

    def _all_headings(self, z: Position | Pose, at: Level) -> tuple[Hypotheses, Stretch]:
        core = self.core
        start = core.t_ns, z, at, core.constants, core.config.initialise
        return initialise.start_from_position(*start), Stretch.of(initialise.heading_unknown(*start))

    @property
    def _senses_heading(self) -> bool:
        return self.sensed is not None and self.core.t_ns - self.sensed[0].t_ns <= _FRESH_NS

    def _has_moved(self, z: Measurement) -> bool:
        if self.still is None or not isinstance(z, Pose | Position):
            return False
        if not _differ(z, self.still.since):
            return False
        self.still = None
        return True


def _contradicts_attitude(z: Measurement, seen: Innovation) -> bool:
    return isinstance(z, Pose) and z.attitude == "full" and float(np.linalg.norm(seen.nu[XYZ:])) > _LARGEST_NOISE


def _differ(z: Position | Pose, first: Position | Pose) -> bool:
    axes = slice(0, XYZ)
    sigma = np.sqrt(np.diag(z.noise)[axes] + np.diag(first.noise)[axes])
    return not bool((np.abs(z.z_n - first.z_n) < _MOVED_SIGMA * sigma).all())
