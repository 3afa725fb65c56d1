"""The variance of unit weight: how much larger the errors are than P and R say, learnt from the innovations.

    r_k = nu^T S^-1 nu / m_50(m),   f_k = max(median(r_k-6 ... r_k), 1 + (f_k-1 - 1) exp(-dt / tau))

m_50(m): the median of chi-square with m degrees of freedom; the median of r counts where 4 % of good readings at most are above
it (2.5 for six components, 3.5 for three: the median of seven good ones is there in one case of 10,000). The covariance of the
state's error is f P, that of an innovation f S. The gain K = P H^T S^-1 does not depend on f: where the world differs from the
model, the estimate is that of an ungated filter, while gates and published covariance remain consistent. What is published
keeps f for four times as long: a frame that drifts, or a mount, has errors that no later innovation shows. The median does not
follow three outliers of seven. Once the innovations have been usual for 20 readings in a row, a ratio that is larger than noise
is a false fix, and does not count; before, it is rather the model that is wrong. f is never below 1. Where several sources are
heard, it is the least of their medians: an excess that all show is the filter's, one that a single source shows is a conflict,
and left to the hypotheses.
(A-posteriori variance factor of least squares: Koch 1999, Parameter Estimation and Hypothesis Testing, sec. 3.2.5.)
"""

import math
from typing import NamedTuple

from estimator.sources.base.gating import gate

_WINDOW, _FEWEST = 7, 5  # readings of a topic
_USUAL = 0.96  # share of good readings
LARGEST = 20.0  # more is no noise: a false fix, or an IMU whose axes are wrong
LARGEST_AT_FIRST = 1e4  # before the model has been right for a while, it is what may be wrong
_ENOUGH = 20  # readings in a row
_FADES_S, _LASTS_S, _GONE = 30.0, 120.0, 1.01
_SILENT_S = 10.0  # a source that is silent for longer has no say


class Recent(NamedTuple):
    """The newest ratios r of a topic, the last at t_ns, and the largest median that is usual."""

    t_ns: int
    ratios: tuple[float, ...]
    usual: float

    @property
    def excess(self) -> float:
        """The median, 1 where it is usual or of too few."""
        if len(self.ratios) < _FEWEST:
            return 1.0
        middle = sorted(self.ratios)[(len(self.ratios) - 1) // 2]
        return middle if middle > self.usual else 1.0


class VarianceFactor(NamedTuple):
    """value: f at t_ns; recent: by topic; usual: readings in a row whose median is usual, until they are enough.

    lasting: f of what is published.
    """

    value: float = 1.0
    t_ns: int = 0
    recent: tuple[tuple[str, Recent], ...] = ()
    usual: int = 0
    lasting: float = 1.0

    def also(self, topic: str, t_ns: int, distance2: float, dof: int, largest: float | None = None) -> "VarianceFactor":
        """With one more innovation, of squared Mahalanobis distance distance2 with f = 1, unless r is larger than `largest`.

        None: than noise, once the innovations have been usual for a while.
        """
        by_topic = {name: r for name, r in self.recent if name == topic or (t_ns - r.t_ns) * 1e-9 < _SILENT_S}
        if largest is None:
            largest = LARGEST if self.usual >= _ENOUGH else LARGEST_AT_FIRST
        ratio, usual = distance2 / gate(0.5, dof), gate(_USUAL, dof) / gate(0.5, dof)
        ratios = by_topic[topic].ratios if topic in by_topic else ()
        by_topic[topic] = Recent(t_ns, (*ratios[1 - _WINDOW :], ratio) if ratio <= largest else ratios, usual)
        excess = min(r.excess for r in by_topic.values())
        seconds = (t_ns - self.t_ns) * 1e-9
        value = max(excess, _faded(self.value, seconds, _FADES_S))
        lasting = max(excess, _faded(self.lasting, seconds, _LASTS_S))
        in_a_row = self.usual if self.usual >= _ENOUGH else self.usual + 1 if excess == 1.0 else 0
        return VarianceFactor(value, t_ns, tuple(sorted(by_topic.items())), in_a_row, lasting)


def _faded(factor: float, seconds: float, over_s: float) -> float:
    faded = 1.0 + (factor - 1.0) * math.exp(-seconds / over_s)
    return faded if faded > _GONE else 1.0


NO_EXCESS = VarianceFactor()
