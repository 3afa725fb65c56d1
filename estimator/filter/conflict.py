"""A source in lasting conflict with the estimate: the map may be wrong (docs/decision.md).

    P <- P + w (S + d d^T),     w = w_0 exp(-(|d| / d_0)^2)                    (Bar-Shalom, Li, Kirubarajan 2001, 1.4.16)

d (3,) [m]: to the source's position, of covariance S (3, 3); w_0: share of conflicts by a wrong map; d_0 [m]: its errors.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import MAP_ELSEWHERE, MAP_ELSEWHERE_M
from estimator.sources.base.gating import gate
from models.measurements import Measurement, Pose, Position
from models.messages import Array

_XYZ = 3
_SHOWS = 2.0  # times d_0: w is a fiftieth of w_0
_LASTS_NS = 1_000_000_000  # shorter ones are outliers
_NEAR = 0.1  # share of the positions of a receiver that is right which are nearer


class Apart(NamedTuple):
    """A source away from the estimate by off (3,) [m] of covariance s (3, 3) at last_ns."""

    since_ns: int
    last_ns: int
    off: Array
    s: Array

    @property
    def lasts(self) -> bool:
        """It lasts longer than an outlier."""
        return self.last_ns - self.since_ns >= _LASTS_NS

    @property
    def may_be_right(self) -> bool:
        """It shows in the covariance."""
        return float(self.off @ self.off) < (_SHOWS * MAP_ELSEWHERE_M) ** 2

    @property
    def added(self) -> Array:
        """To the covariance of the position, (3, 3)."""
        weight = MAP_ELSEWHERE * math.exp(-float(self.off @ self.off) / MAP_ELSEWHERE_M**2)
        return weight * (self.s + np.outer(self.off, self.off))

    @property
    def is_near(self) -> bool:
        """Whether it is near the estimate: small d^T S^-1 d."""
        return bool(self.off @ np.linalg.solve(self.s, self.off) <= gate(_NEAR, _XYZ))


@dataclass(frozen=True, slots=True)
class Conflicts:
    """apart: sources in lasting disagreement, by topic.

    contrary_ns: last rejected velocity of a receiver, by the topic of its positions.
    """

    apart: dict[str, Apart] = field(default_factory=dict)
    contrary_ns: dict[str, int] = field(default_factory=dict)

    def compared(self, aid: Aid, z: Measurement, position_n: Array, *, disagrees: bool, lingers: bool = False) -> "Conflicts":
        """After a reading, estimate at position_n (3,) [m]; lingers: until the source is near."""
        before = self.apart.get(aid.topic)
        if (disagrees or (lingers and before)) and isinstance(z, Position | Pose) and len(z.z_n) == len(z.rows[:_XYZ]):
            slow = sum(error.covariance for error in aid.slow_errors if len(error.covariance) == _XYZ)
            since_ns = before.since_ns if before else aid.t_ns
            now = Apart(since_ns, aid.t_ns, z.z_n - position_n, z.noise[:_XYZ, :_XYZ] + slow)
            if disagrees or not now.is_near:
                return Conflicts({**self.apart, aid.topic: now}, self.contrary_ns)
        return Conflicts({t: a for t, a in self.apart.items() if t != aid.topic}, self.contrary_ns) if before else self

    def judged(self, aid: Aid, z: Measurement, position_n: Array, *, is_rejected: bool) -> "Conflicts":
        """Once aligned: sources whose positions are rejected, receivers whose velocities are."""
        if aid.receiver and is_rejected:
            return Conflicts(self.apart, self.contrary_ns | {aid.receiver: aid.t_ns})
        if not aid.absolute:
            return self
        is_receiver, contrary_ns = aid.log_misled is not None, self.contrary_ns.get(aid.topic)
        is_contrary = is_rejected or (contrary_ns is not None and aid.t_ns - contrary_ns < _LASTS_NS)
        return self.compared(aid, z, position_n, disagrees=is_contrary, lingers=is_receiver)

    def added(self, *, is_decided: bool) -> Array:
        """Added covariance of the position, (3, 3)."""
        total = np.zeros((_XYZ, _XYZ))
        for apart in self.apart.values():
            if not is_decided:
                total += np.outer(apart.off, apart.off)
            elif apart.lasts:
                total += apart.added
        return total
