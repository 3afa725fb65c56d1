"""A receiver noisier than it reports: jammed. Its errors are correlated, so beyond 100 times the variance it is no aid.

    d_k = nu_k - 2 nu_{k-1} + nu_{k-2},   r_k = d_k^T (S_k + 4 S_{k-1} + S_{k-2})^-1 d_k
    R <- s R,   s = max(r_(8) / m_50 where r_(3) > chi2_0.96 and most nu_k^T S_k^-1 nu_k > chi2_0.9999, s^exp(-dt / tau))

r_(k): k-th smallest of the last twelve; m_50: median of chi-square. An outlier makes three large.
"""

import math
from typing import NamedTuple

from estimator.filter.eskf import Innovation
from estimator.sources.base.gating import gate
from models.measurements import mahalanobis
from models.messages import Array

_WINDOW, _RANK, _SIZE_RANK = 12, 3, 8
_USELESS = 100.0
_LARGEST, _GONE = 1e6, 1.1
_USUAL, _FAR = 0.96, 0.9999
_APART_S = 1.1  # readings further apart are not compared
_FADES_S = 5.0


class Jamming(NamedTuple):
    """Factor s of a source at t_ns; nu (m,), S (m, m) of its last readings, and whether they were far from their prediction."""

    t_ns: int
    last: tuple[tuple[Array, Array, bool], ...] = ()
    factor: float = 1.0

    @property
    def is_aid(self) -> bool:
        """Whether its readings are worth their noise."""
        return self.factor < _USELESS

    def widened(self, noise: Array) -> Array:
        """R (m, m) of a reading as it scatters."""
        return noise if self.factor == 1.0 else self.factor * noise

    def also(self, t_ns: int, seen: Innovation, variance_factor: float) -> "Jamming":
        """With one more innovation, noise taken as self.factor times the claim; variance_factor: f in S, which explains no
        scatter.
        """
        s = seen.s if self.factor == 1.0 else seen.s - variance_factor * (1.0 - 1.0 / self.factor) * seen.noise
        dof, seconds = len(seen.nu), (t_ns - self.t_ns) * 1e-9
        distance2 = seen.distance2 if s is seen.s else mahalanobis(seen.nu, s)[0]
        now = seen.nu, s, distance2 > gate(_FAR, dof)
        if self.last and (dof != len(self.last[-1][0]) or seconds > _APART_S):
            return Jamming(t_ns, (now,))
        faded = self.factor ** math.exp(-seconds / _FADES_S)
        factor, last = faded if faded > _GONE else 1.0, (*self.last[-1 - _WINDOW :], now)
        if len(last) == _WINDOW + 2 and 2 * sum([far for _, _, far in last[2:]]) > _WINDOW:
            ordered = sorted(_bends(last))
            if ordered[_RANK - 1] > gate(_USUAL, dof):
                factor = max(factor, min(ordered[_SIZE_RANK - 1] / gate(0.5, dof), _LARGEST))
        return Jamming(t_ns, last, factor)


def _bends(last: tuple[tuple[Array, Array, bool], ...]) -> list[float]:
    """r of each reading but the first two."""
    triples = zip(last, last[1:], last[2:], strict=False)
    return [mahalanobis(nu - 2.0 * nu_1 + nu_2, s + 4.0 * s_1 + s_2)[0] for (nu_2, s_2, _), (nu_1, s_1, _), (nu, s, _) in triples]
