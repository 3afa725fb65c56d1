"""Bias walk of the IMU beyond its configuration (docs/decision.md), with z = nu / sigma, (dof,):

    e <- e + a (nu^T S^-1 nu / dof - e),   m <- m + a (z - m)
    wrong where e1 < e < e2 and |m|^2 (2 - a) / a > e chi2_99.5(dof);  surely wrong where beyond e chi2_99.99(dof)

Then the bias variance per second grows tenfold, a hundredfold where surely wrong or wrong two seconds before, also for the
averages' last seconds. (Kailath 1968; Mehra 1972; Sage and Husa 1969; Roberts 1959.)
"""

import math
from collections.abc import Mapping
from types import MappingProxyType

import msgspec
import numpy as np
from msgspec.structs import replace

from estimator.filter import contradiction
from estimator.filter.eskf import Innovation
from estimator.sources.base.gating import SURE, gate
from models.imu import ImuNoise
from models.messages import Array

_SHARE = 0.15  # a: of one innovation
_LARGER, _NOISE = 1.3, 8.0  # e1, e2: larger than any wrong motion makes them
_LARGEST = 10.0  # of one innovation, which may be false
_LIKELY = 0.995
_FIRST, _STEP, _STEP_S = 10.0, 100.0, 2.0
_BACK_S = 15.0  # time constant
_MEMORY_S = 5.0  # of the averages, for a few innovations a second
_MOST = 1e6
_MOST_GYRO, _MOST_ACCEL = 1e-3, 0.03  # rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz): no IMU is worse


class Whiteness(msgspec.Struct, frozen=True, eq=False):
    """Of the innovations of one source: e and m."""

    size: float = 1.0
    mean: Array = np.zeros(0)

    def also(self, seen: Innovation, variance_factor: float) -> "Whiteness":
        """With one more."""
        dof = len(seen.nu)
        size = min(seen.distance2 * variance_factor / dof, _LARGEST)
        before = self.mean if len(self.mean) == dof else np.zeros(dof)
        z = math.sqrt(size * dof) * contradiction.direction(seen.nu, seen.s)
        return Whiteness(self.size + _SHARE * (size - self.size), before + _SHARE * (z - before))

    def is_wrong(self, probability: float) -> bool:
        """Whether they show a wrong motion; white ones do with 1 - probability."""
        squared = float(self.mean @ self.mean) * (2.0 - _SHARE) / _SHARE
        return _LARGER < self.size < _NOISE and squared > self.size * gate(probability, len(self.mean))


_WHITE = Whiteness()


class BiasWalk(msgspec.Struct, frozen=True, eq=False):
    """Innovations by topic, factor on the variance per second."""

    sources: Mapping[str, Whiteness] = MappingProxyType({})
    factor: float = 1.0
    t_ns: int = 0
    was_wrong: bool = False

    def also(self, topic: str, t_ns: int, seen: Innovation, variance_factor: float) -> "BiasWalk":
        """After a reading of an absolute source."""
        now = self.sources.get(topic, _WHITE).also(seen, variance_factor)
        sources = {**self.sources, topic: now}
        if (t_ns - self.t_ns) * 1e-9 < _STEP_S:
            return BiasWalk(sources, self.factor, self.t_ns, self.was_wrong)
        if now.is_wrong(_LIKELY):
            factor = min((_STEP if self.was_wrong or now.is_wrong(SURE) else _FIRST) * self.factor, _MOST)
        else:
            factor = 1.0 + (self.factor - 1.0) * math.exp(-_STEP_S / _BACK_S)
        return BiasWalk(sources, factor if factor > 1.1 else 1.0, t_ns, now.is_wrong(_LIKELY))

    def of_noise(self, noise: ImuNoise) -> ImuNoise:
        """The IMU with the larger walks."""
        times = math.sqrt(self.factor)
        gyro, accel = (
            max(walk, min(times * walk, most)) for walk, most in ((noise.gyro_walk, _MOST_GYRO), (noise.accel_walk, _MOST_ACCEL))
        )
        return replace(noise, gyro_walk=gyro, accel_walk=accel)

    def walked(self, before: "BiasWalk", noise: ImuNoise) -> Array:
        """Sigma (6,) of the walk beyond `before`, over the averages' time."""
        now, then = self.of_noise(noise), before.of_noise(noise)
        gyro, accel = now.gyro_walk**2 - then.gyro_walk**2, now.accel_walk**2 - then.accel_walk**2
        sigmas: Array = np.sqrt(_MEMORY_S * np.maximum(np.repeat((gyro, accel), 3), 0.0))
        return sigmas
