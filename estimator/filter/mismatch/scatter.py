"""A source of fixes noisier than it reports: they scatter about one another.

    d_k = nu_k - 2 nu_{k-1} + nu_{k-2},   r_k = d_k^T (R_k + 4 R_{k-1} + R_{k-2})^-1 d_k
    R <- s R,   s = r_(6) / m_50 where r_(3) > chi2_0.96,   from where most nu_k^T S_k^-1 nu_k > chi2_0.9999 on

by blocks of three components. r_(k): k-th smallest of the last twelve; m_50: median of chi-square. The error of the estimate
changes slowly, and cancels; an outlier makes three large.
"""

from typing import NamedTuple

import numpy as np

from estimator.filter.eskf import Innovation
from estimator.sources.base.gating import gate
from models.measurements import mahalanobis
from models.messages import Array

_WINDOW, _RANK, _MIDDLE = 12, 3, 6
_USUAL, _FAR = 0.96, 0.9999
_USELESS = 1e4
_APART_S = 1.1  # readings further apart are not compared
_XYZ = 3


class Reading(NamedTuple):
    """nu (m,) and reported R (m, m); whether it was far off, and whether it was fused."""

    nu: Array
    noise: Array
    far: bool
    fused: bool


class Scatter(NamedTuple):
    """Factors s of a source at t_ns, by block; last: its readings."""

    t_ns: int
    last: tuple[Reading, ...] = ()
    factors: tuple[float, ...] = ()

    @property
    def factor(self) -> float:
        """The largest."""
        return max(self.factors) if self.factors else 1.0

    def widened(self, noise: Array) -> Array:
        """R (m, m) of a reading as it scatters."""
        return noise if self.factor == 1.0 else noise * self._squared(len(noise))

    @property
    def by_chance(self) -> int:
        """How many of the last readings were fused with too small an R; more than one or two are no chance."""
        fused = sum([reading.fused for reading in self.last[2 + _RANK :]])
        return fused if fused < _RANK else 0

    @property
    def is_aid(self) -> bool:
        """Whether its readings are worth their noise."""
        return self.factor < _USELESS

    def also(self, t_ns: int, seen: Innovation, *, fused: bool) -> "Scatter":
        """With one more innovation, whose noise is widened."""
        m = len(seen.nu)
        if self.last and (m != len(self.last[-1].nu) or (t_ns - self.t_ns) * 1e-9 > _APART_S):
            return Scatter(t_ns).also(t_ns, seen, fused=fused) if self.factor == 1.0 else Scatter(t_ns)  # this noise is widened
        reported = seen.noise if self.factor == 1.0 else seen.noise / self._squared(m)
        last = (*self.last[-1 - _WINDOW :], Reading(seen.nu, reported, seen.distance2 > gate(_FAR, m), fused))
        if len(last) < _WINDOW + 2 or (self.factor == 1.0 and 2 * sum([reading.far for reading in last[2:]]) <= _WINDOW):
            return Scatter(t_ns, last, self.factors)
        return Scatter(t_ns, last, tuple([_factor(last, slice(k, k + _XYZ)) for k in range(0, m, _XYZ)]))

    def _squared(self, m: int) -> Array:
        root = np.sqrt(np.repeat(self.factors, _XYZ)[:m])
        return np.outer(root, root)


def _factor(last: tuple[Reading, ...], rows: slice) -> float:
    triples, dof = zip(last, last[1:], last[2:], strict=False), len(last[-1].nu[rows])
    r = sorted(
        [mahalanobis((a.nu - 2.0 * b.nu + c.nu)[rows], (a.noise + 4.0 * b.noise + c.noise)[rows, rows])[0] for a, b, c in triples]
    )
    return r[_MIDDLE - 1] / gate(0.5, dof) if r[_RANK - 1] > gate(_USUAL, dof) else 1.0
