"""Fixes of several sources that are fused, and whose innovations do not average out: the sources differ.

    m_k <- m_k + a (nu - m_k),     E|m|^2 = a / (2 - a) tr R
    P <- P + sum_k max(1 - 3 E|m|^2 / |m_k|^2, 0) m_k m_k^T / K

nu (3,) [m]: innovation of the position; R (3, 3) [m^2]: reported; K: sources fused in the last 10 s. (After the variance between
studies of DerSimonian and Laird 1986.)
"""

from collections.abc import Container, Mapping
from typing import TypeAlias

import msgspec
import numpy as np

from estimator.sources.base.faults import RECENT_NS
from models.messages import Array
from models.state import XYZ

_GAIN = 0.1
_NOISE = _GAIN / (2.0 - _GAIN)
_SHOWN = 3.0  # times the noise of a mean
_TINY = 1e-12


class Mean(msgspec.Struct, frozen=True, eq=False):
    """m (3,) [m] of a source at t_ns; variance: tr R of its newest fix, m^2."""

    t_ns: int
    m: Array
    variance: float

    @property
    def differs(self) -> Array:
        """What noise does not explain of m m^T, (3, 3)."""
        return max(1.0 - _SHOWN * _NOISE * self.variance / max(float(self.m @ self.m), _TINY), 0.0) * np.outer(self.m, self.m)


Means: TypeAlias = Mapping[str, Mean]  # by topic


def noted(means: Means, topic: str, t_ns: int, nu: Array, noise: Array) -> Means:
    """After a fix with the innovation nu (m,) and R (m, m)."""
    before = means.get(topic)
    m = before.m if before is not None and t_ns - before.t_ns < RECENT_NS else np.zeros(XYZ)
    return {**means, topic: Mean(t_ns, m + _GAIN * (nu[:XYZ] - m), sum(noise.diagonal().tolist()[:XYZ]))}


def covariance(means: Means, without: Container[str]) -> Array | None:
    """Of the position, (3, 3), without sources that are in conflict; None of fewer than two, or where they agree."""
    if len(means) < 2:  # most of the time
        return None
    now_ns = max(mean.t_ns for mean in means.values())
    fused = [mean for topic, mean in means.items() if topic not in without and now_ns - mean.t_ns < RECENT_NS]
    added = np.mean([mean.differs for mean in fused], axis=0) if len(fused) > 1 else np.zeros(XYZ)
    return added if added.any() else None
