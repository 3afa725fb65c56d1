"""A receiver that the estimate rejects for long: what is left of the chance that the receiver is right and the fixes are not.

The filter has decided for the fixes of landmarks, because being spoofed is the commoner fault. But a map may stand in the wrong
place: a datum or a geoid is mixed up, an origin was taken from another tool. Nothing on board tells the two apart, so the
published covariance goes on to allow for the second, as a mixture of two means does (Bar-Shalom, Li, Kirubarajan 2001, 1.4.16):

    P <- P + w (S + d d^T),     w = w_0 exp(-(|d| / d_0)^2)

d (3,) [m]: from the estimate to the position of the receiver; S (3, 3) [m^2]: the covariance of that position; w_0: the share of
such conflicts in which the map is wrong; d_0 [m]: by how much maps are wrong. Beyond it the receiver alone is at fault, so a
spoofed receiver does not spoil the covariance for good.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.sources.gating import gate
from estimator.sources.source import Aid
from models.measurements import Pose, Position
from models.messages import Array

_XYZ = 3

_MAP_IS_WRONG = 0.05  # w_0
_MAP_OFF_M = 20.0  # d_0
_SHOWS = 2.0  # times d_0: w is a fiftieth of w_0
LASTS_NS = 1_000_000_000  # shorter ones are outliers
_NEAR = 0.1  # share of the positions of a receiver that is right which are nearer


class Apart(NamedTuple):
    """A source has been elsewhere than the estimate since since_ns, by off (3,) [m] of covariance s (3, 3) at last_ns."""

    since_ns: int
    last_ns: int
    off: Array
    s: Array

    @property
    def lasts(self) -> bool:
        """For so long that it is no outlier."""
        return self.last_ns - self.since_ns >= LASTS_NS

    @property
    def may_be_right(self) -> bool:
        """It shows in the covariance."""
        return float(self.off @ self.off) < (_SHOWS * _MAP_OFF_M) ** 2

    @property
    def added(self) -> Array:
        """To the covariance of the position, (3, 3)."""
        weight = _MAP_IS_WRONG * math.exp(-float(self.off @ self.off) / _MAP_OFF_M**2)
        return weight * (self.s + np.outer(self.off, self.off))

    @property
    def is_near(self) -> bool:
        """Whether it stands where the estimate is: d^T S^-1 d is small."""
        return bool(self.off @ np.linalg.solve(self.s, self.off) <= gate(_NEAR, _XYZ))


def apart(before: Apart | None, aid: Aid, z: Position | Pose, position_n: Array) -> Apart:
    """A source that stands elsewhere than the estimate at position_n (3,) [m]; before: what was known of it."""
    s = z.noise[:_XYZ, :_XYZ] + sum(slow.covariance for slow in aid.slow_errors if len(slow.covariance) == _XYZ)
    return Apart(before.since_ns if before else aid.t_ns, aid.t_ns, z.z_n - position_n, s)
