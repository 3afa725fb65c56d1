"""How fast the biases of the IMU walk: warm-up, a temperature ramp, a scale that is off, vibration that comes and goes.

The innovations of a filter that is right are white, and of the size of their covariance (Kailath 1968). Where those of a source
are larger and follow one another in direction, the filter is wrong about the motion, not the source about its noise:

    e <- e + a (nu^T S^-1 nu / m - e),   r <- r + a (cos(nu_k, nu_k-1) - r),      wrong where e > e1 and r > r1

Then the variance that the biases gain per second is taken as ten times larger, and a hundred times every two seconds while that
lasts; afterwards it comes back. A source of too small a covariance has large innovations, but without a direction.
(Mehra, Approaches to adaptive filtering, 1972; covariance inflation as in Sage and Husa 1969.)
"""

import math
from typing import NamedTuple

from msgspec.structs import replace

from estimator.filter import contradiction
from estimator.filter.eskf import Innovation
from models.imu import ImuNoise

_SHARE = 0.15  # a: of one innovation
_LARGER, _SAME_WAY = 1.3, 0.3  # e1, r1
_FIRST, _STEP, _STEP_S = 10.0, 100.0, 2.0
_BACK_S = 15.0  # time constant
_MOST = 1e6
_MOST_GYRO, _MOST_ACCEL = 1e-3, 0.03  # rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz): no IMU is worse


class Whiteness(NamedTuple):
    """Of the innovations of one source: e, r and the direction of the last one."""

    size: float = 1.0
    correlation: float = 0.0
    last: tuple[float, ...] = ()

    def also(self, seen: Innovation, variance_factor: float) -> "Whiteness":
        """With one more."""
        now = contradiction.direction(seen.nu, seen.s)
        size = seen.distance2 * variance_factor / len(seen.nu)
        same = sum(a * b for a, b in zip(self.last, now, strict=True)) if len(self.last) == len(now) else 0.0
        return Whiteness(
            self.size + _SHARE * (min(size, 10.0) - self.size), self.correlation + _SHARE * (same - self.correlation), now
        )

    @property
    def is_wrong(self) -> bool:
        """Whether they show that the motion is wrong."""
        return self.size > _LARGER and self.correlation > _SAME_WAY


class BiasWalk(NamedTuple):
    """The innovations by topic, and what the variance per second is multiplied by, since t_ns."""

    sources: tuple[tuple[str, Whiteness], ...] = ()
    factor: float = 1.0
    t_ns: int = 0
    was_wrong: bool = False

    def also(self, topic: str, t_ns: int, seen: Innovation, variance_factor: float) -> "BiasWalk":
        """After a reading of an absolute source."""
        known = dict(self.sources)
        now = known.get(topic, Whiteness()).also(seen, variance_factor)
        sources, seconds = tuple({**known, topic: now}.items()), (t_ns - self.t_ns) * 1e-9
        if seconds < _STEP_S:
            return self._replace(sources=sources)
        if now.is_wrong:
            factor = min((_STEP if self.was_wrong else _FIRST) * self.factor, _MOST)
        else:
            factor = 1.0 + (self.factor - 1.0) * math.exp(-_STEP_S / _BACK_S)
        return BiasWalk(sources, factor if factor > 1.1 else 1.0, t_ns, now.is_wrong)

    def of_noise(self, noise: ImuNoise) -> ImuNoise:
        """The IMU with the larger walks."""
        times = math.sqrt(self.factor)
        gyro, accel = (
            max(walk, min(times * walk, most)) for walk, most in ((noise.gyro_walk, _MOST_GYRO), (noise.accel_walk, _MOST_ACCEL))
        )
        return replace(noise, gyro_walk=gyro, accel_walk=accel)
