"""A filter with the logarithm of its weight, and what it takes for false."""

import math
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from estimator.filter.eskf import Eskf
from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import IMU_M_S2
from models import imu
from models.messages import Array
from models.state import E, X

IMU_WRONG, RECEIVER_WRONG, FIX_FALSE, POSITION_WRONG = "IMU wrong", "receiver wrong", "fix false", "position wrong"
SENSOR_WRONG, SENSORS = "sensor wrong", "sensors"  # left out together: all but positions and receivers
MARGIN = 3.0  # ln: by which another must be better
FORGET = 20.0  # ln: further behind the leading one than this, a hypothesis is dropped
_SHOWS = 9.2  # ln 10,000: further behind, the covariance leaves it out; a gate refuses one in as many good readings
_SETTLED_S = 20.0  # a hypothesis that has agreed with the leading one for so long goes
RUN_ENDS_S = 5.0  # without a fix for so long, a run of consistent fixes ends
MORE = 3  # a run of fixes wins that is longer by so many of them
_LEAST_IMU_S = 3.75  # and lasts for so long at least, where a wrong IMU explains them: eight false ones at 2 Hz do not
_LEAST_S = 4.5  # where nothing does
_ENOUGH_S, _ENOUGH = 5.0, 11  # longer than both, it wins against any other one
_LEAST_SHARE, _TWO_SIGMA = 0.1, 2.0  # a contradicted run matters whose share in both is larger; a jump that is further
_PERIOD_S = 2.0  # between fixes, where it is not known


class Doubt(msgspec.Struct):
    """A source taken for false since last_ns; deliberate: although the fix passed the gate."""

    last_ns: int
    deliberate: bool


class Past(NamedTuple):
    """A run of run_s whose fixes the next ones contradict since since_ns by a jump off (3,) [m] that no IMU explains.

    o = off t / (t + t'): their mean, weighted by the durations t, t' of the two runs, is so far away. In the covariance: o o^T.
    """

    off: Array
    run_s: float
    since_ns: int

    def share(self, t_ns: int) -> float:
        """t / (t + t')."""
        return self.run_s / (self.run_s + (t_ns - self.since_ns) * 1e-9)

    def added(self, t_ns: int) -> Array:
        """To the covariance of the position, (3, 3)."""
        off = self.share(t_ns) * self.off
        return np.outer(off, off)


class Hypothesis(msgspec.Struct, eq=False):
    """One filter and the logarithm of its weight.

    fused_ns: last fused position; known_ns: the last of a run that was established; run, run_ns: number fused without a long
    break, since when; parted_ns: last difference from the leading one; doubts: false sources by topic; benefit: ln, added
    weight in the covariance; without: receiver left out for good; least: ln, lower bound of the weight; decided: topics
    rejected since a won conflict; receiver: last fused, and its ln(1 - trust); begun_at_fix: unconfirmed; refuted_ns: last
    refutation of such; agreed_ns: since when the omitted receiver passes; right: constants of a right IMU, where it is taken
    for wrong; past: where an earlier run of fixes had it; turned: when the attitude of a source was last taken for false.
    """

    filter: Eskf
    weight: float = 0.0
    fused_ns: int = 0
    known_ns: int = 0
    run: int = 0
    run_ns: int = 0
    parted_ns: int = 0
    doubts: dict[str, Doubt] = {}
    benefit: float = 0.0
    without: str = ""
    least: float = -math.inf
    decided: frozenset[str] = frozenset()
    receiver: tuple[str, float] | None = None
    begun_at_fix: bool = False
    refuted_ns: int = -(2**62)
    agreed_ns: int | None = None
    right: Array | None = None
    past: "Past | None" = None
    turned: dict[str, int] = {}

    def copy(self) -> "Hypothesis":
        """An independent hypothesis in the same state."""
        doubts = {topic: Doubt(d.last_ns, d.deliberate) for topic, d in self.doubts.items()} if self.doubts else {}
        return replace(self, filter=self.filter.copy(), doubts=doubts)

    @property
    def doubts_imu(self) -> bool:
        """It takes the IMU for wrong."""
        return self.right is not None

    def adopt(self, constants: Array, *, doubts_imu: bool) -> None:
        """Constants of the motion, others where the IMU is taken for wrong."""
        self.right = constants if doubts_imu else None
        self.filter.constants = imu.in_doubt(constants) if doubts_imu else constants

    def note_fused(self, t_ns: int) -> None:
        """A position was fused."""
        if not self.run or (t_ns - self.fused_ns) * 1e-9 > RUN_ENDS_S:
            self.run, self.run_ns = 0, t_ns
        self.run += 1
        self.fused_ns = t_ns
        if self.is_established(t_ns):
            self.known_ns = t_ns
        if self.past and self.past.share(t_ns) < _LEAST_SHARE:
            self.past = None

    def is_established(self, t_ns: int) -> bool:
        """Its run of fixes is longer than a false one."""
        return (t_ns - self.run_ns) * 1e-9 >= _LEAST_IMU_S

    def unproven_s(self, t_ns: int) -> float:
        """Time since the last fix of an established run, or of any."""
        return (t_ns - (self.known_ns or self.fused_ns)) * 1e-9

    def note_jump(self, from_n: Array, t_ns: int) -> None:
        """A fix that its last ones contradict has moved it from from_n (3,) [m]: more than two sigma and a wrong IMU explain."""
        run_s, off = (self.fused_ns - self.run_ns) * 1e-9, from_n - self.filter.x[X.P]
        covered = _TWO_SIGMA**2 * self.filter.variance_factor * self.filter.cov[E.P, E.P].trace()
        covered += self.past.added(t_ns).trace() if self.past else 0.0
        dark_s = max((t_ns - self.fused_ns) * 1e-9 - _ENOUGH_S, 0.0)  # in which no fix was even refused
        covered += (0.5 * IMU_M_S2 * dark_s**2) ** 2
        if run_s > 0.0 and off @ off > covered:
            self.past = Past(off, run_s, t_ns)

    @property
    def rejected(self) -> set[str]:
        """Topics whose last reading was false, or that it leaves out."""
        return {topic for topic, doubt in self.doubts.items() if not doubt.deliberate or topic == self.without}

    @property
    def assumes(self) -> str:
        """Its assumption: what is wrong if it is right."""
        if self.without:
            return SENSOR_WRONG if self.without == SENSORS else RECEIVER_WRONG
        if self.doubts_imu:
            return IMU_WRONG
        return FIX_FALSE if any(doubt.deliberate for doubt in self.doubts.values()) else POSITION_WRONG

    def omits(self, aid: Aid) -> bool:
        """It leaves out the source of this reading."""
        return self.without == aid.witness or (self.without == SENSORS and aid.is_sensor)

    def omits_more_than(self, lead: "Hypothesis") -> bool:
        """It leaves out a receiver that the leading hypothesis uses."""
        return bool(self.without) and self.without != lead.without

    def matters_beside(self, lead: "Hypothesis") -> bool:
        """It may still lead, or it shows in the covariance."""
        return self.weight > lead.weight - FORGET or self.shows_beside(lead)

    def shows_beside(self, lead: "Hypothesis") -> bool:
        """Likely enough for the covariance."""
        if self.omits_more_than(lead) and not self.benefit:
            return False
        return self.weight + self.benefit > lead.weight - _SHOWS

    def has_settled(self, t_ns: int) -> bool:
        """It has agreed with the leading hypothesis long enough to be dropped."""
        return (t_ns - self.parted_ns) * 1e-9 >= _SETTLED_S

    def holds_s(self, t_ns: int, *, imu_may_be_wrong: bool) -> float:
        """Duration after which consistent refused fixes win, the first at t_ns: that of its own run and of three fixes.

        Against an error of a wrong IMU three fixes suffice.
        """
        run_s = (self.fused_ns - self.run_ns) * 1e-9
        period_s = min((t_ns - self.fused_ns) * 1e-9, run_s / (self.run - 1) if self.run > 1 else _PERIOD_S)
        if imu_may_be_wrong:
            return max(_LEAST_IMU_S, (MORE - 1) * period_s) - 0.1 * period_s
        most_s = max(_ENOUGH_S, (_ENOUGH - 1) * period_s)
        return min(max(_LEAST_S, run_s + MORE * period_s), most_s) - 0.1 * period_s
