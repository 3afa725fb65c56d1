"""Protection levels by multiple-hypothesis solution separation (docs/integrity.md; Blanch et al. 2015, eq. 28-30).

    sum_i p_i Q((PL - b_i) / sigma_i)  =  risk_per_hour  correlation_s / 3600

    vertical:    Q(z) = P(|x| > z) = erfc(z / sqrt 2)                      x ~ N(0, 1)
    horizontal:  Q(z) = P(|x| > z) = exp(-z^2 / 2)                         x ~ N(0, I_2), sigma_i^2 the larger eigenvalue

p_i, b_i, sigma_i: probability, offset, random error of fault i; Q = 1 where PL < b_i or sigma_i is infinite. Heavy tails (Gupta
and Gao 2021): Q(z) = (1 - e) Q(z / c) + e Q(z / t), e = tail_share, c = core_scale, t = tail_scale.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from models.messages import Array

_EXACT: Final = 2e-3  # of a protection level, relative; rounded up
_TINY, _TINY_M = 1e-300, 1e-9
_MOST_STEPS: Final = 200
_HALF: Final = math.sqrt(0.5)
_HOUR_S: Final = 3600.0


class Mode(NamedTuple):
    """A fault along one direction: probability, offset [m], sigma [m] of the published error."""

    name: str
    probability: float
    offset: float
    sigma: float


class Tail(NamedTuple):
    """How far real errors exceed the Gaussian of the reported sigma."""

    core_scale: float
    tail_scale: float
    tail_share: float

    def level(self, exceeds: Callable[[float], float], z: float) -> float:
        """P(|x| > z) of the mixture; z < 0: 1."""
        if z <= 0.0:
            return 1.0
        return (1.0 - self.tail_share) * exceeds(z / self.core_scale) + self.tail_share * exceeds(z / self.tail_scale)


def one_axis(z: float) -> float:
    """P(|x| > z), x ~ N(0, 1)."""
    return math.erfc(z * _HALF)


def in_plane(z: float) -> float:
    """P(|x| > z), x ~ N(0, I_2)."""
    return math.exp(-0.5 * z * z)


def allowed(risk_per_hour: float, correlation_s: float) -> float:
    """Of one independent error: the probability to exceed the protection level."""
    return min(1.0, risk_per_hour * correlation_s / _HOUR_S)


def exceeded(modes: Sequence[Mode], level_m: float, tail: Tail, exceeds: Callable[[float], float]) -> list[float]:
    """p_i Q((PL - b_i) / sigma_i) of each mode, PL = level_m."""
    return [m.probability * tail.level(exceeds, _reduced(level_m - m.offset, m.sigma)) for m in modes]


def protection_levels(modes: Array, probabilities: Array, tail: Tail) -> tuple[list[float], list[float]]:
    """HPL and VPL [m] at each probability (m,); inf where unbounded.

    modes (n, 5): rows p, horizontal b and sigma, vertical b and sigma. At most .002 above the exact solution, never below.
    """
    h, v = _solutions(modes, probabilities, *tail).tolist()
    return h, v


def protection_level(modes: Sequence[Mode], probability: float, tail: Tail, exceeds: Callable[[float], float]) -> float:
    """Of one direction, at one probability."""
    alike = np.array([(p, b, sigma, b, sigma) for _, p, b, sigma in modes]).reshape(-1, 5)
    h, v = protection_levels(alike, np.array([probability]), tail)
    return (h if exceeds is in_plane else v)[0]


@njit(cache=True, error_model="numpy")
def _solutions(modes: Array, allowed: Array, core_scale: float, tail_scale: float, tail_share: float) -> Array:
    """(2, m), by regula falsi on the logarithm (Illinois rule; Dowell and Jarratt 1971).

    Upper end from Q(z) <= exp(-(z / t)^2 / 2), an equal share for each of n bounded modes.
    """
    levels = np.empty((2, len(allowed)))
    for axis, k in np.ndindex(levels.shape):
        p, b = modes[:, 0], modes[:, 1 + 2 * axis]
        sigma = np.maximum(modes[:, 2 + 2 * axis], _TINY_M)
        bounded = np.isfinite(b + sigma)
        left = allowed[k] - p[~bounded].sum()
        p, b, sigma = p[bounded], b[bounded], sigma[bounded]
        low, high, at_high = 0.0, 0.0, 0.0
        if left <= 0.0 or p.sum() <= left:
            levels[axis, k] = np.inf if left <= 0.0 else 0.0
            continue
        for i in range(len(p)):
            share = left / max(len(p) * p[i], _TINY)
            if share < 1.0:
                high = max(high, b[i] + sigma[i] * max(core_scale, tail_scale) * math.sqrt(-2.0 * math.log(share)))
        level, at_low = high, 2.0 * math.log(p.sum() / left)
        for _ in range(_MOST_STEPS):
            total = 0.0
            for i in range(len(p)):
                z = max(level - b[i], 0.0) / sigma[i]
                core, tail = z / core_scale, z / tail_scale
                if axis == 0:
                    total += p[i] * ((1.0 - tail_share) * math.exp(-0.5 * core**2) + tail_share * math.exp(-0.5 * tail**2))
                else:
                    total += p[i] * ((1.0 - tail_share) * math.erfc(core * _HALF) + tail_share * math.erfc(tail * _HALF))
            value = math.log(max(total, _TINY) / left)  # of the sum over what is allowed
            if value > 0.0:
                low, at_low, at_high = level, value, 0.5 * at_high
            else:
                high, at_high, at_low = level, value, 0.5 * at_low
            if high - low <= _EXACT * high:
                break
            level = (low * at_high - high * at_low) / (at_high - at_low)
            if not low < level < high:
                level = 0.5 * (low + high)
        levels[axis, k] = high
    return levels


def _reduced(distance_m: float, sigma_m: float) -> float:
    if math.isinf(sigma_m):
        return 0.0
    return distance_m / sigma_m if sigma_m > 0.0 else math.copysign(math.inf, distance_m)
