"""A filter with the logarithm of its weight, and what it takes for false."""

import math

import msgspec
from msgspec.structs import replace

from estimator.filter.eskf import Eskf
from models import imu
from models.messages import Array

IMU_WRONG, RECEIVER_WRONG, FIX_FALSE, POSITION_WRONG = "IMU wrong", "receiver wrong", "fix false", "position wrong"
MARGIN = 3.0  # ln: by which another must be better
FORGET = 20.0  # ln: further behind the leading one than this, a hypothesis is dropped
_SHOWS = 9.2  # ln 10,000: further behind, the covariance leaves it out; a gate refuses one in as many good readings
_SETTLED_S = 20.0  # a hypothesis that has agreed with the leading one for so long goes
_RUN_ENDS_S = 5.0  # without a fix for so long, a run of consistent fixes ends
_MORE = 3  # a run of fixes wins that is longer by so many of them
_LEAST_IMU_S, _LEAST_S = 3.0, 4.5  # and lasts for so long at least: where a wrong IMU explains them, where nothing does
_ENOUGH_S, _ENOUGH = 5.0, 11  # longer than both, it wins against any other one
_PERIOD_S = 2.0  # between fixes, where it is not known


class Doubt(msgspec.Struct):
    """A hypothesis takes a source for false: since the fix at last_ns at least; deliberate: though the fix passed the gate."""

    last_ns: int
    deliberate: bool


class Hypothesis(msgspec.Struct, eq=False):
    """One filter and the logarithm of its weight.

    fused_ns: when it last fused a position; run, run_ns: how many it has fused without a long break, and since when; parted_ns:
    when it last differed from the leading one; doubts: what it takes for false, by topic; benefit: ln, of the doubt that a
    sceptic stands for: it counts for so much more in the covariance than in the decision; without: the topic of the receiver that
    it leaves out for good; least: ln, below which its weight does not fall, for that receiver may be misled at any time; decided:
    topics that it rejects since a conflict that it has won; receiver: the last one that it fused, and ln(1 - trust) of it;
    begun_at_fix: and nothing has confirmed it yet; refuted_ns: when one such was last refuted; agreed_ns: since when the
    positions of the receiver that it leaves out pass its gate; right: the constants of an IMU that is right, where
    it takes the IMU for wrong.
    """

    filter: Eskf
    weight: float = 0.0
    fused_ns: int = 0
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

    def copy(self) -> "Hypothesis":
        """An independent hypothesis in the same state."""
        doubts = {topic: Doubt(d.last_ns, d.deliberate) for topic, d in self.doubts.items()} if self.doubts else {}
        return replace(self, filter=self.filter.copy(), doubts=doubts)

    @property
    def doubts_imu(self) -> bool:
        """It takes the IMU for wrong."""
        return self.right is not None

    def adopt(self, constants: Array, *, doubts_imu: bool) -> None:
        """The constants of the motion, which are others where the IMU is taken for wrong."""
        self.right = constants if doubts_imu else None
        self.filter.constants = imu.in_doubt(constants) if doubts_imu else constants

    def note_fused(self, t_ns: int) -> None:
        """A position was fused."""
        if not self.run or (t_ns - self.fused_ns) * 1e-9 > _RUN_ENDS_S:
            self.run, self.run_ns = 0, t_ns
        self.run += 1
        self.fused_ns = t_ns

    @property
    def rejected(self) -> set[str]:
        """Topics whose last reading was false to it, or that it leaves out."""
        return {topic for topic, doubt in self.doubts.items() if not doubt.deliberate or topic == self.without}

    @property
    def assumes(self) -> str:
        """What is wrong if it is right."""
        if self.without:
            return RECEIVER_WRONG
        if self.doubts_imu:
            return IMU_WRONG
        return FIX_FALSE if any(doubt.deliberate for doubt in self.doubts.values()) else POSITION_WRONG

    def matters_beside(self, lead: "Hypothesis") -> bool:
        """It may still lead, or it shows in the covariance."""
        return self.weight > lead.weight - FORGET or self.shows_beside(lead)

    def shows_beside(self, lead: "Hypothesis") -> bool:
        """It is likely enough to be in the covariance."""
        if self.without and not self.benefit:
            return False
        return self.weight + self.benefit > lead.weight - _SHOWS

    def has_settled(self, t_ns: int) -> bool:
        """It has agreed with the leading hypothesis for so long that there is no question any more."""
        return (t_ns - self.parted_ns) * 1e-9 >= _SETTLED_S

    def holds_s(self, t_ns: int, *, imu_may_be_wrong: bool) -> float:
        """For how long consistent fixes that it refuses, the first at t_ns, have to last until they win.

        A run is decided by a longer one: its length and three fixes more. An error that a wrong IMU makes needs the three alone.
        """
        run_s = (self.fused_ns - self.run_ns) * 1e-9
        period_s = min((t_ns - self.fused_ns) * 1e-9, run_s / (self.run - 1) if self.run > 1 else _PERIOD_S)
        if imu_may_be_wrong:
            return max(_LEAST_IMU_S, (_MORE - 1) * period_s) - 0.1 * period_s
        most_s = max(_ENOUGH_S, (_ENOUGH - 1) * period_s)
        return min(max(_LEAST_S, run_s + _MORE * period_s), most_s) - 0.1 * period_s
