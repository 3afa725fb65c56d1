"""A source in lasting conflict with the estimate (docs/decision.md).

    P <- P + w (S + d d^T)                                                     (Bar-Shalom, Li, Kirubarajan 2001, 1.4.16)
    w = n / (n + m)  where n >= m: nothing decides,     w_0 exp(-(|d| / d_0)^2)  elsewhere: the map may be wrong

d (3,) [m]: to the source's position, of covariance S (3, 3); n, m: sources nearer to it and to the estimate, n also the IMU where
it contradicts the estimate, m where the source has jumped; w_0: share of conflicts by a wrong map; d_0 [m]: its errors. One
receiver does not outweigh fixes, unless its path is that of the estimate, turned and scaled: a wrong map.
"""

import math
from collections.abc import Mapping

import msgspec
import numpy as np
from msgspec.structs import replace

from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import MAP_ELSEWHERE, MAP_ELSEWHERE_M, RECENT_NS
from estimator.sources.base.gating import gate
from estimator.sources.base.similarity import Similarity
from models.measurements import Measurement, Pose, Position
from models.messages import Array
from models.state import XYZ

_STEADY = 0.5  # change of d from one reading to the next, of its size, of a source that agrees with itself
_ENOUGH = 3  # such readings
_RESOLVES = 3.0  # a source distinguishes two positions whose distance squared is larger than so many times its variance
_CLEARLY = 3.0  # so many times nearer to one position than to the other
_JUMPS = 100.0  # d^T S^-1 d: a source that drifts off is refused long before
_SHOWS = 2.0  # times d_0: w is a fiftieth of w_0
_LASTS_NS = 1_000_000_000  # shorter ones are outliers
_NEAR = 0.1  # share of the positions of a receiver that is right which are nearer


class Apart(msgspec.Struct, frozen=True, eq=False):
    """A source away from the estimate by off (3,) [m] of covariance s (3, 3) at last_ns.

    steady: readings in a row that agree; jumped: it was near just before, so that the IMU contradicts it.
    """

    since_ns: int
    last_ns: int
    off: Array
    s: Array
    steady: int
    jumped: bool

    @property
    def lasts(self) -> bool:
        """It lasts longer than an outlier."""
        return self.last_ns - self.since_ns >= _LASTS_NS

    @property
    def agrees(self) -> bool:
        """It lasts, and agrees with itself."""
        return self.lasts and self.steady >= _ENOUGH

    @property
    def may_be_right(self) -> bool:
        """It shows in the covariance."""
        return float(self.off @ self.off) < (_SHOWS * MAP_ELSEWHERE_M) ** 2

    @property
    def by_map(self) -> float:
        """Weight of an error of the map."""
        return MAP_ELSEWHERE * math.exp(-float(self.off @ self.off) / MAP_ELSEWHERE_M**2)

    def added(self, weight: float) -> Array:
        """To the covariance of the position, (3, 3)."""
        return weight * (self.s + np.outer(self.off, self.off))

    @property
    def is_near(self) -> bool:
        """Whether it is near the estimate: small d^T S^-1 d."""
        return self.distance2 <= gate(_NEAR, XYZ)

    @property
    def distance2(self) -> float:
        """d^T S^-1 d."""
        return float(self.off @ np.linalg.solve(self.s, self.off))


class Offset(msgspec.Struct, frozen=True, eq=False):
    """Newest position of a source, off (3,) [m] from the estimate, of variance (trace) [m^2]; path: of a receiver."""

    t_ns: int
    off: Array
    variance: float
    is_receiver: bool
    path: Similarity = Similarity()


class Conflicts(msgspec.Struct, frozen=True, eq=False):
    """apart: sources in lasting disagreement, by topic; newest: positions of all.

    contrary_ns: last rejected velocity of a receiver, by the topic of its positions; moved_ns: since when this hypothesis leads.
    """

    apart: Mapping[str, Apart] = {}
    contrary_ns: Mapping[str, int] = {}
    newest: Mapping[str, Offset] = {}
    moved_ns: int = -(2**62)

    def compared(self, aid: Aid, z: Measurement, position_n: Array, *, disagrees: bool, lingers: bool = False) -> "Conflicts":
        """After a reading, estimate at position_n (3,) [m]; lingers: until the source is near."""
        before = self.apart.get(aid.topic)
        if not (isinstance(z, Position | Pose) and len(z.z_n) == len(z.rows[:XYZ])):
            return self.without(aid.topic)
        off, s = z.z_n - position_n, z.noise[:XYZ, :XYZ]
        last = self.newest.get(aid.topic)
        path = last.path if last is not None else Similarity()
        if is_receiver := aid.geodetic is not None:
            path = path.also(complex(*position_n[:2].tolist()), complex(*z.z_n[:2].tolist()), aid.t_ns * 1e-9)
        newest = {**self.newest, aid.topic: Offset(aid.t_ns, off, sum(s.diagonal().tolist()), is_receiver, path)}
        here = replace(self, newest=newest)
        if disagrees or (lingers and before):
            s = s + sum(error.covariance for error in aid.slow_errors if len(error.covariance) == XYZ)
            is_steady = before is not None and np.linalg.norm(off - before.off) < _STEADY * np.linalg.norm(off)
            now = Apart(aid.t_ns, aid.t_ns, off, s, 0, False)
            if before is not None:
                now = replace(now, since_ns=before.since_ns, steady=before.steady + 1 if is_steady else 0, jumped=before.jumped)
            elif last is not None and aid.t_ns - last.t_ns < RECENT_NS:
                if last.t_ns <= self.moved_ns:  # it was near the former estimate: no outlier, and no jump
                    now = replace(now, since_ns=aid.t_ns - _LASTS_NS)
                else:
                    now = replace(now, jumped=now.distance2 > _JUMPS)
            if disagrees or not now.is_near:
                return replace(here, apart={**self.apart, aid.topic: now})
        return here._agrees(aid.topic)

    def without(self, topic: str) -> "Conflicts":
        """Nothing of this source."""
        newest = {t: at for t, at in self.newest.items() if t != topic} if topic in self.newest else self.newest
        return replace(self._agrees(topic), newest=newest)

    def _agrees(self, topic: str) -> "Conflicts":
        return replace(self, apart={t: a for t, a in self.apart.items() if t != topic}) if topic in self.apart else self

    def judged(self, aid: Aid, z: Measurement, position_n: Array, *, is_rejected: bool) -> "Conflicts":
        """Once aligned: sources whose positions are rejected, receivers whose velocities are."""
        if aid.receiver and is_rejected:
            return replace(self, contrary_ns={**self.contrary_ns, aid.receiver: aid.t_ns})
        if not aid.absolute:
            return self
        is_receiver, contrary_ns = aid.log_misled is not None, self.contrary_ns.get(aid.topic)
        is_contrary = is_rejected or (contrary_ns is not None and aid.t_ns - contrary_ns < _LASTS_NS)
        return self.compared(aid, z, position_n, disagrees=is_contrary, lingers=is_receiver)

    def shares(self, *, doubts_imu: bool, turned: bool = False) -> dict[str, float]:
        """n / (n + m) of the sources against which nothing decides, by topic; turned: the paths of fixes against a receiver's."""
        found = dict[str, float]()
        for topic, apart in self.apart.items():
            nearer, by = self._votes(topic, apart, 1.0)
            n, m = 1 + nearer + doubts_imu, len(by) + apart.jumped
            is_outweighed = self.newest[topic].is_receiver and not (by and all(self.newest[t].is_receiver for t in by))
            is_outweighed &= not (turned or self.newest[topic].path.is_turned)
            is_alone = n == 1 and (is_outweighed or not apart.agrees)
            if n >= m and not is_alone:
                found[topic] = n / (n + m)
        return found

    def outvotes(self, topic: str) -> bool:
        """Whether fixes of a source, and others that are clearly near them, are more than those that the estimate rests on."""
        apart = self.apart.get(topic)
        if apart is None or not apart.agrees:
            return False
        nearer, by = self._votes(topic, apart, _CLEARLY)
        return 1 + nearer > len(by) + apart.jumped and nearer > 0

    def _votes(self, topic: str, apart: Apart, times: float) -> tuple[int, set[str]]:
        """Number of other sources so many times nearer to this one than to the estimate; those that the estimate rests on."""
        distance2, nearer, by = float(apart.off @ apart.off), 0, set[str]()
        for t, other in self.newest.items():
            if t == topic or apart.last_ns - other.t_ns >= RECENT_NS or distance2 <= times**2 * _RESOLVES * other.variance:
                continue
            if times**2 * np.sum((other.off - apart.off) ** 2) < other.off @ other.off:
                nearer += 1
            elif t not in self.apart:
                by.add(t)
        return nearer, by

    def added(self, shares: Mapping[str, float]) -> Array:
        """Added covariance of the position, (3, 3)."""
        total = np.zeros((XYZ, XYZ))
        for topic, apart in self.apart.items():
            if topic in shares or apart.lasts:
                total += apart.added(shares.get(topic, apart.by_map))
        return total
