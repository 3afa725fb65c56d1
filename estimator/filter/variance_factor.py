"""Variance of unit weight: ratio of actual errors to P and R (docs/decision.md; Koch 1999, sec. 3.2.5).

    r_k = nu^T S^-1 nu / m_50(m),   e_k = min(median(r_k-6 ... r_k), r_(2) m_50 / m_2),
    f_k = max(e_k, 1 + (f_k-1 - 1) exp(-dt / tau))

m_50(m), m_2(m): quantiles of chi-square, m degrees of freedom; r_(2): second smallest of the seven, which is that small only if
false fixes are among them. Covariances become f P and f S; K is the same. After 20 usual readings a ratio beyond noise does not
count. f >= 1; published, it lasts four times as long. Of several sources the least e counts.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType

import msgspec

from estimator.sources.base.faults import RECENT_S
from estimator.sources.base.gating import USUAL, gate

_WINDOW, _FEWEST = 7, 5  # readings of a topic
_RARE = 0.02  # share of good readings below what two of seven hardly are
LARGEST = 20.0  # more is no noise: a false fix, or an IMU whose axes are wrong
LARGEST_AT_FIRST = 1e4  # before the model has been right for a while, it is what may be wrong
_ENOUGH = 20  # readings in a row
_FADES_S, _LASTS_S, _GONE = 30.0, 120.0, 1.01


class Recent(msgspec.Struct, frozen=True, eq=False):
    """Newest ratios r of a topic, and e."""

    t_ns: int
    ratios: tuple[float, ...]
    excess: float


class VarianceFactor(msgspec.Struct, frozen=True, eq=False):
    """value: f at t_ns; recent: by topic; usual: consecutive readings with a usual median; lasting: published f."""

    value: float = 1.0
    t_ns: int = 0
    recent: Mapping[str, Recent] = MappingProxyType({})
    usual: int = 0
    lasting: float = 1.0

    @property
    def is_proven(self) -> bool:
        """The model has been right for a while: what contradicts it then is a false fix, or a wrong IMU."""
        return self.usual >= _ENOUGH

    def also(self, topic: str, t_ns: int, distance2: float, dof: int, largest: float | None = None) -> "VarianceFactor":
        """With one more squared Mahalanobis distance, at f = 1; r above `largest` does not count."""
        if largest is None:
            largest = LARGEST if self.is_proven else LARGEST_AT_FIRST
        before = self.recent.get(topic)
        ratio, ratios = distance2 / gate(0.5, dof), before.ratios if before else ()
        if ratio <= largest:
            ratios = (*ratios[1 - _WINDOW :], ratio)
        recent = {name: r for name, r in self.recent.items() if (t_ns - r.t_ns) * 1e-9 < RECENT_S}
        recent[topic] = Recent(t_ns, ratios, _excess(ratios, dof))
        excess = min([r.excess for r in recent.values()])
        seconds = (t_ns - self.t_ns) * 1e-9
        value = max(excess, _faded(self.value, seconds, _FADES_S))
        lasting = max(excess, _faded(self.lasting, seconds, _LASTS_S))
        in_a_row = self.usual if self.is_proven else self.usual + 1 if excess == 1.0 else 0
        return VarianceFactor(value, t_ns, recent, in_a_row, lasting)


def _excess(ratios: tuple[float, ...], dof: int) -> float:
    """e, 1 if the median is usual or of too few."""
    if len(ratios) < _FEWEST:
        return 1.0
    ordered, m_50 = sorted(ratios), gate(0.5, dof)
    middle = ordered[(len(ordered) - 1) // 2]
    return max(min(middle, ordered[1] / (gate(_RARE, dof) / m_50)), 1.0) if middle > gate(USUAL, dof) / m_50 else 1.0


def _faded(factor: float, seconds: float, over_s: float) -> float:
    if factor == 1.0:  # most of the time
        return factor
    faded = 1.0 + (factor - 1.0) * math.exp(-seconds / over_s)
    return faded if faded > _GONE else 1.0


NO_EXCESS = VarianceFactor()
