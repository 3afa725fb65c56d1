"""A filter with the logarithm of its weight, and what it takes for false."""

import math
from dataclasses import dataclass, field, replace

from estimator.filter.eskf import Eskf

FORGET = 20.0  # ln: further behind the leading one than this, a hypothesis is dropped
_SHOWS = 9.2  # ln 10,000: further behind, the covariance leaves it out; a gate refuses one in as many good readings
LEAST_PATIENCE_S = 5.0  # contradiction shorter than this never wins against a hypothesis that is being aided
_TRUST_FADES_S = 10.0  # without an absolute fix for so long, the filter itself is doubted twice as fast
_SETTLED_S = 20.0  # a hypothesis that has agreed with the leading one for so long goes


@dataclass(slots=True)
class Doubt:
    """A hypothesis takes a source for false: since the fix at last_ns at least; deliberate: though the fix passed the gate."""

    last_ns: int
    deliberate: bool


@dataclass(slots=True, eq=False)
class Hypothesis:
    """One filter and the logarithm of its weight.

    fused_ns: when it last fused a position; established_ns: since when it has done so without a long break; parted_ns: when it
    last differed from the leading one; doubts: what it takes for false, by topic; benefit: ln, of the doubt that a sceptic
    stands for: it counts for so much more in the covariance than in the decision; without: the topic of the receiver that it
    leaves out for good; least: ln, below which its weight does not fall, for that receiver may be misled at any time; decided:
    topics that it rejects since a conflict that it has won; receiver: the last one that it fused, and ln(1 - trust) of it;
    begun_at_fix: and nothing has confirmed it yet; refuted_ns: when one such was last refuted; agreed_ns: since when the
    positions of the receiver that it leaves out pass its gate.
    """

    filter: Eskf
    weight: float = 0.0
    fused_ns: int = 0
    established_ns: int = 0
    parted_ns: int = 0
    doubts: dict[str, Doubt] = field(default_factory=dict)
    benefit: float = 0.0
    without: str = ""
    least: float = -math.inf
    decided: frozenset[str] = frozenset()
    receiver: tuple[str, float] | None = None
    begun_at_fix: bool = False
    refuted_ns: int = -(2**62)
    agreed_ns: int | None = None

    def copy(self) -> "Hypothesis":
        """An independent hypothesis in the same state."""
        doubts = {topic: Doubt(d.last_ns, d.deliberate) for topic, d in self.doubts.items()}
        return replace(self, filter=self.filter.copy(), doubts=doubts)

    def note_fused(self, t_ns: int) -> None:
        """A position was fused."""
        if (t_ns - self.fused_ns) * 1e-9 > LEAST_PATIENCE_S:
            self.established_ns = t_ns
        self.fused_ns = t_ns

    @property
    def rejected(self) -> set[str]:
        """Topics whose last reading was false to it, or that it leaves out."""
        return {topic for topic, doubt in self.doubts.items() if not doubt.deliberate or topic == self.without}

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

    def patience_s(self, t_ns: int, most_s: float) -> float:
        """How long consistent contradiction must last: as long as the hypothesis itself has stood, less when it is unaided."""
        stood_s = (self.fused_ns - self.established_ns) * 1e-9
        unaided_s = (t_ns - self.fused_ns) * 1e-9
        return min(max(stood_s, LEAST_PATIENCE_S), most_s) / (1.0 + unaided_s / _TRUST_FADES_S)
