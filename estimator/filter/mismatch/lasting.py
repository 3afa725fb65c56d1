"""Share of a fix's error that the next one still has: fixes that scatter less about one another than they claim.

    d_k = nu_k - 2 nu_{k-1} + nu_{k-2},     r_k = d_k^T (R_k + 4 R_{k-1} + R_{k-2})^-1 d_k / 3
    y <- y + a (ln r_k - E ln (chi2_3 / 3) - y),     rho = 2 - sqrt(1 + 3 min(b e^y, 1))

by blocks of three components. A Gauss-Markov error of correlation rho from fix to fix has E r = (3 - 4 rho + rho^2) / 3. A share
rho of R becomes a considered error that lasts; b covers the uncertainty of y. (By the correlation of innovations: Mehra 1970)
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace as replace_in
from typing import NamedTuple, TypeGuard

import numpy as np
from msgspec.structs import replace

from estimator.sources.base.aid import Aid
from estimator.sources.pose import lasting
from models.measurements import Measurement, Pose, mahalanobis
from models.messages import Array

_GAIN = 0.03
_LN_MEAN = -0.369  # E ln (chi2_3 / 3)
_BOUND = 1.65  # three sigmas of y
_LEAST_LN, _MOST_LN = -6.0, 2.0
_APART_S = 1.1  # fixes further apart are not compared
_XYZ, _P, _THETA = 3, slice(0, 3), slice(3, 6)


class Lasting(NamedTuple):
    """Of a source at t_ns: nu (6,) and R (6, 6) of its last two fixes; y of position and attitude."""

    t_ns: int
    last: tuple[tuple[Array, Array], ...] = ()
    ln: tuple[float, float] = (0.0, 0.0)

    @property
    def shares(self) -> tuple[float, float]:
        """rho of position and attitude, zero where they scatter as they claim."""
        position, attitude = (max(2.0 - math.sqrt(1.0 + 3.0 * min(_BOUND * math.exp(y), 1.0)), 0.0) for y in self.ln)
        return position, attitude

    @property
    def weight(self) -> float:
        """Independent fixes in one, (1 - rho) / (1 + rho)."""
        rho = max(self.shares)
        return (1.0 - rho) / (1.0 + rho)

    def also(self, t_ns: int, nu: Array, reported: Array) -> "Lasting":
        """With one more innovation (6,) of a fix that reports R (6, 6)."""
        last = (*self.last, (nu, reported))
        if (t_ns - self.t_ns) * 1e-9 > _APART_S:
            return Lasting(t_ns, last[-1:], self.ln)
        if len(last) < _XYZ:
            return Lasting(t_ns, last, self.ln)
        (a, r_a), (b, r_b), (c, r_c) = last
        d, r = a - 2.0 * b + c, r_a + 4.0 * r_b + r_c
        position, attitude = _ln(mahalanobis(d[_P], r[_P, _P])[0]), _ln(mahalanobis(d[_THETA], r[_THETA, _THETA])[0])
        before = self.ln
        ln = before[0] + _GAIN * (position - _LN_MEAN - before[0]), before[1] + _GAIN * (attitude - _LN_MEAN - before[1])
        return Lasting(t_ns, last[1:], ln)


def carried(aid: Aid, z: Measurement, known: Mapping[str, Lasting]) -> tuple[Aid, Measurement]:
    """The fix with the share of R that lasts among its slow errors: R = E R E + D R D, D^2 = rho, E^2 = 1 - rho."""
    if (of := known.get(aid.topic)) is None or not _is_whole(z) or not any(of.shares):
        return aid, z
    shares = np.repeat(of.shares, _XYZ)
    lasts, own = np.sqrt(shares), np.sqrt(1.0 - shares)
    error = lasting(aid.topic, lasts[:, None] * z.noise * lasts)
    return replace(aid, slow_errors=(*aid.slow_errors, error)), replace_in(z, noise=own[:, None] * z.noise * own)


def noted(aid: Aid, z: Measurement, nu: Sequence[float], known: Mapping[str, Lasting]) -> Mapping[str, Lasting]:
    """After a fix with the innovation nu, as it came."""
    block = f"{aid.topic}.look"
    if not (aid.absolute and _is_whole(z) and nu) or any(e.block == block for e in aid.slow_errors):
        return known
    return {**known, aid.topic: known.get(aid.topic, Lasting(aid.t_ns)).also(aid.t_ns, np.array(nu), z.noise)}


def _is_whole(z: Measurement) -> TypeGuard[Pose]:
    return isinstance(z, Pose) and len(z.rows) == 2 * _XYZ


def _ln(distance2: float) -> float:
    return min(max(math.log(max(distance2 / _XYZ, 1e-9)), _LEAST_LN), _MOST_LN)
