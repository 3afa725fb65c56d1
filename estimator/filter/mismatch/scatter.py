"""A source noisier than claimed: its readings scatter about one another.

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
_LARGEST, _GONE = 1e6, 1.1
_USUAL, _FAR = 0.96, 0.9999
_APART_S = 1.1  # readings further apart are not compared
_FADES_S = 5.0


class Scatter(NamedTuple):
    """Factor s of a source; last r; nu (m,), S (m, m) of the newest two, at t_ns."""

    t_ns: int
    last: tuple[tuple[Array, Array], ...]
    ratios: tuple[tuple[float, bool], ...] = ()  # and whether the reading was far from its prediction
    factor: float = 1.0

    def also(self, t_ns: int, seen: Innovation, variance_factor: float) -> "Scatter":
        """With one more innovation, noise taken as self.factor times the claim; variance_factor: f in S, which explains no
        scatter.
        """
        s = seen.s if self.factor == 1.0 else seen.s - variance_factor * (1.0 - 1.0 / self.factor) * seen.noise
        seconds = (t_ns - self.t_ns) * 1e-9
        if self.last and (len(seen.nu) != len(self.last[-1][0]) or seconds > _APART_S):
            return Scatter(t_ns, ((seen.nu, s),))
        faded = self.factor ** math.exp(-seconds / _FADES_S)
        factor, ratios, last = faded if faded > _GONE else 1.0, self.ratios, (*self.last[-1:], (seen.nu, s))
        if len(self.last) == 2:
            (nu_2, s_2), (nu_1, s_1) = self.last
            dof, distance2 = len(seen.nu), seen.distance2 if s is seen.s else mahalanobis(seen.nu, s)[0]
            bend, _ = mahalanobis(seen.nu - 2.0 * nu_1 + nu_2, s + 4.0 * s_1 + s_2)
            ratios = (*ratios[1 - _WINDOW :], (bend, distance2 > gate(_FAR, dof)))
            many = len(ratios) == _WINDOW and 2 * sum([far for _, far in ratios]) > _WINDOW
            ordered = sorted(ratio for ratio, _ in ratios) if many else []
            if many and ordered[_RANK - 1] > gate(_USUAL, dof):
                factor = max(factor, min(ordered[_SIZE_RANK - 1] / gate(0.5, dof), _LARGEST))
        return Scatter(t_ns, last, ratios, factor)
