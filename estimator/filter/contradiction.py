"""Fixes that agree with one another but no hypothesis: a wrong IMU (docs/decision.md).

Their path is flyable where

    |(p2 - p1) / h2 - (p1 - p0) / h1|  <  a (h1 + h2) / 2 + k sigma (1 / h1 + 1 / h2)
"""

import math
from typing import NamedTuple

import numpy as np

from models.measurements import Measurement, Pose, Position
from models.messages import Array

SAYS = (
    "the IMU contradicts fixes that agree with one another: check [imu] axes, mounting_rpy_deg and units, the frames of the "
    "fixes (north, east, down; forward, right, down), and whether they are as good as they claim ([pose_fix] noise_scale)"
)
_SHOWN_S, _SHOWN_FIXES = 3.0, 5
_APART_S = 2.0  # fixes further apart show nothing
_AGILE_M_S2 = 40.0  # no vehicle accelerates more
_SIGMAS = 3.0
_XYZ = slice(0, 3)
_SAME_WAY, _TINY = 0.5, 1e-30  # cosine: two directions at random in six dimensions are nearer in one case of ten


class Contradiction(NamedTuple):
    """unforeseen: consecutive unpredicted fixes; last: two."""

    unforeseen: int = 0
    since_ns: int = 0
    last: tuple[tuple[int, Array], ...] = ()

    def also(self, t_ns: int, z: Measurement) -> "Contradiction":
        """With one more unpredicted fix."""
        if not isinstance(z, Pose | Position):
            return self
        here = (t_ns, z.z_n)
        if not self.unforeseen or not self._leads_to(t_ns, z):
            return Contradiction(1, t_ns, (here,))
        return Contradiction(self.unforeseen + 1, self.since_ns, (*self.last[-1:], here))

    @property
    def is_shown(self) -> bool:
        """Whether it has lasted long enough."""
        return self.unforeseen >= _SHOWN_FIXES and (self.last[-1][0] - self.since_ns) * 1e-9 >= _SHOWN_S

    def is_late(self, t_ns: int) -> bool:
        """Whether a fix is too late to be compared with the last."""
        return bool(self.last) and (t_ns - self.last[-1][0]) * 1e-9 > _APART_S

    def _leads_to(self, t_ns: int, z: Pose | Position) -> bool:
        (t1_ns, p1), h2 = self.last[-1], (t_ns - self.last[-1][0]) * 1e-9
        if not 0.0 < h2 <= _APART_S:
            return False
        if len(self.last) == 1:
            return True
        t0_ns, p0 = self.last[0]
        h1 = (t1_ns - t0_ns) * 1e-9
        change = np.linalg.norm((z.z_n - p1) / h2 - (p1 - p0) / h1)
        sigma = np.sqrt(np.trace(z.noise[_XYZ, _XYZ]))
        return bool(change < _AGILE_M_S2 * 0.5 * (h1 + h2) + _SIGMAS * sigma * (1.0 / h1 + 1.0 / h2))


NO_CONTRADICTION = Contradiction()


def direction(nu: Array, s: Array) -> Array:
    """Unit vector (m,) of an innovation nu (m,) of covariance s (m, m) in units of its sigma."""
    scaled = nu / np.sqrt(s.diagonal())
    return scaled / max(math.hypot(*scaled.tolist()), _TINY)


def persists(before: Array, now: Array) -> bool:
    """Whether two innovations point the same way, as those of a wrong IMU."""
    return len(before) == len(now) and float(before @ now) > _SAME_WAY
