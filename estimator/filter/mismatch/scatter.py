"""How a source's readings scatter about one another: more than they report is noise, less is an error that lasts.

    d_k = nu_k - 2 nu_{k-1} + nu_{k-2},   r_k = d_k^T (R_k + 4 R_{k-1} + R_{k-2})^-1 d_k
    R <- s R,   s <- max(r_(6) / m_50 where r_(3) > chi2_0.96, s^exp(-dt / tau)),   once most nu_k^T S_k^-1 nu_k > chi2_0.9999
    y <- y + a (ln r_k - E ln chi2_3 - y),     rho = 2 - sqrt(1 + 3 min(b e^y, 1))

by blocks of three components. r_(k): k-th smallest of the last twelve; four usual ones in a row end it; m_50: median of
chi-square. The error of the estimate changes slowly, and cancels; an outlier makes three large. A Gauss-Markov error of
correlation rho from reading to reading has E r = 3 - 4 rho + rho^2: a share rho of R becomes a considered error. b covers the
uncertainty of y. (By the correlation of innovations: Mehra 1970)
"""

import math
from collections.abc import Mapping
from typing import TypeAlias

import msgspec
import numpy as np
from msgspec.structs import replace
from numba import njit

from estimator.filter.eskf import Innovation
from estimator.sources import pose
from estimator.sources.base.aid import Aid
from estimator.sources.base.gating import SURE, USUAL, gate
from models.measurements import Measurement, Pose, Position, Velocity, mahalanobis
from models.messages import Array
from models.state import XYZ

_WINDOW, _RANK, _MIDDLE = 12, 3, 6
_CALM = 4
_USELESS, _GONE = 1e4, 1.1  # s of a source that is no aid, and of one that is as it reports
_FADES_S = 5.0  # tau
_APART_S = 1.1  # readings further apart are not compared
_GAIN, _LN_MEAN, _BOUND = 0.03, 0.73, 1.65  # a; E ln chi2_3; b: three sigmas of y
_LEAST_LN, _MOST_LN = -5.6, 2.0  # of ln r - E ln chi2_3


class Reading(msgspec.Struct, frozen=True, eq=False):
    """nu (m,), reported R (m, m), r by block, () for the first two; whether it was far off, and whether it was fused."""

    nu: Array
    noise: Array
    r: tuple[float, ...]
    far: bool
    fused: bool


class Scatter(msgspec.Struct, frozen=True, eq=False):
    """Factors s, y and rho of a source at t_ns, by block; last: its readings."""

    t_ns: int
    last: tuple[Reading, ...] = ()
    factors: tuple[float, ...] = ()
    ln: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()

    @property
    def factor(self) -> float:
        """The largest."""
        return max(self.factors, default=1.0)

    def widened(self, noise: Array) -> Array:
        """R (m, m) of a reading as it scatters."""
        root = np.sqrt(np.repeat(self.factors, XYZ)[: len(noise)])
        return noise * np.outer(root, root)

    @property
    def weight(self) -> float:
        """Independent readings of a pose in one, (1 - rho) / (1 + rho)."""
        rho = max(self.shares, default=0.0)
        return (1.0 - rho) / (1.0 + rho)

    @property
    def by_chance(self) -> int:
        """How many of the last readings were fused with too small an R; more than one or two are no chance."""
        fused = sum([reading.fused for reading in self.last[_RANK:]])
        return fused if fused < _RANK else 0

    @property
    def is_aid(self) -> bool:
        """Whether its readings are worth their noise."""
        return self.factor < _USELESS

    def also(self, t_ns: int, seen: Innovation, reported: Array, *, fused: bool) -> "Scatter":
        """With one more innovation of a reading that reports R (m, m)."""
        m, last, ln = len(seen.nu), self.last[1 - _WINDOW :], self.ln
        seconds = (t_ns - self.t_ns) * 1e-9
        factors = [factor ** math.exp(-seconds / _FADES_S) for factor in self.factors]
        if last and m != len(last[-1].nu):
            last, factors = (), []
        elif seconds > _APART_S:
            last = ()
        r = _bends(last[-2], last[-1], seen.nu, reported) if len(last) > 1 else ()
        last = (*last, Reading(seen.nu, reported, r, seen.distance2 > gate(SURE, m), fused))
        if m == 2 * XYZ and r:
            ln = tuple([y + _GAIN * (_ln(r_k) - y) for y, r_k in zip(ln or (0.0,) * len(r), r, strict=True)])
        if factors and all(one.r and _usual(one.r, m) for one in last[-_CALM:]):
            factors = []
        if len(last) == _WINDOW and last[0].r and (factors or 2 * sum([one.far for one in last]) > _WINDOW):
            found = [_factor([one.r[k] for one in last], min(XYZ, m - XYZ * k)) for k in range(len(r))]
            factors = [max(pair) for pair in zip(found, factors, strict=True)] if factors else found
        shares = tuple([max(2.0 - math.sqrt(1.0 + 3.0 * min(_BOUND * math.exp(y), 1.0)), 0.0) for y in ln])
        return Scatter(t_ns, last, tuple(factors) if max(factors, default=1.0) > _GONE else (), ln, shares)


Scatters: TypeAlias = Mapping[str, Scatter]  # by topic of positions and velocities


def taken(aid: Aid, z: Measurement, known: Scatter | None) -> tuple[Aid, Measurement]:
    """A reading with its noise as it scatters, or what lasts of it among its slow errors: R = E R E + D R D, D^2 = rho."""
    if known is None or not isinstance(z, Pose | Position | Velocity):
        return aid, z
    if known.factors:
        return aid, replace(z, noise=known.widened(z.noise))
    if len(z.rows) != 2 * XYZ or not any(known.shares) or pose.look(aid.topic) in [e.block for e in aid.slow_errors]:
        return aid, z
    shares = np.repeat(known.shares, XYZ)
    lasts, own = np.sqrt(shares), np.sqrt(1.0 - shares)
    error = pose.lasting(aid.topic, lasts[:, None] * z.noise * lasts)
    return replace(aid, slow_errors=(*aid.slow_errors, error)), replace(z, noise=own[:, None] * z.noise * own)


def _bends(a: Reading, b: Reading, nu: Array, noise: Array) -> tuple[float, ...]:
    return tuple([_bend(a.nu, b.nu, nu, a.noise, b.noise, noise, k) for k in range(0, len(nu), XYZ)])


@njit(cache=True, error_model="numpy")
def _bend(a: Array, b: Array, c: Array, r_a: Array, r_b: Array, r_c: Array, k: int) -> float:
    n = min(XYZ, a.shape[0] - k)
    d, r = np.empty(n), np.empty((n, n))
    for i in range(n):
        d[i] = a[k + i] - 2.0 * b[k + i] + c[k + i]
        for j in range(n):
            r[i, j] = r_a[k + i, k + j] + 4.0 * r_b[k + i, k + j] + r_c[k + i, k + j]
    return mahalanobis(d, r)[0]


def _usual(r: tuple[float, ...], m: int) -> bool:
    return all(r_k <= gate(USUAL, min(XYZ, m - XYZ * k)) for k, r_k in enumerate(r))


def _factor(r: list[float], dof: int) -> float:
    r.sort()
    return max(r[_MIDDLE - 1] / gate(0.5, dof), 1.0) if r[_RANK - 1] > gate(USUAL, dof) else 1.0


def _ln(r: float) -> float:
    return min(max(math.log(max(r, 1e-9)) - _LN_MEAN, _LEAST_LN), _MOST_LN)
