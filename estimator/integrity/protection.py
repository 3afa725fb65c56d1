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

from models.messages import Array

_EXACT: Final = 2e-3  # of a protection level, relative; rounded up
_TINY, _TINY_M = 1e-300, 1e-9
_MOST_STEPS: Final = 40
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
    return math.erfc(z * math.sqrt(0.5))


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
    rows, at = modes.tolist(), probabilities.tolist()
    h, v = [(p, b, sigma) for p, b, sigma, _, _ in rows], [(p, b, sigma) for p, _, _, b, sigma in rows]
    return [_solution(h, allowed, tail, in_plane) for allowed in at], [_solution(v, allowed, tail, one_axis) for allowed in at]


def protection_level(modes: Sequence[Mode], probability: float, tail: Tail, exceeds: Callable[[float], float]) -> float:
    """Of one direction, at one probability."""
    alike = np.array([(p, b, sigma, b, sigma) for _, p, b, sigma in modes]).reshape(-1, 5)
    h, v = protection_levels(alike, np.array([probability]), tail)
    return (h if exceeds is in_plane else v)[0]


def _solution(
    modes: Sequence[tuple[float, float, float]], allowed: float, tail: Tail, exceeds: Callable[[float], float]
) -> float:
    """PL [m] of modes (p, b, sigma), by regula falsi on the logarithm (Illinois rule; Dowell and Jarratt 1971).

    Upper end from Q(z) <= exp(-(z / t)^2 / 2), an equal share for each of n bounded modes.
    """
    bounded = [(p, b, max(sigma, _TINY_M)) for p, b, sigma in modes if math.isfinite(b + sigma)]
    left = allowed - sum(p for p, b, sigma in modes if not math.isfinite(b + sigma))
    if left <= 0.0:
        return math.inf
    if sum(p for p, _, _ in bounded) <= left:
        return 0.0

    def excess(level_m: float) -> float:
        """Ln of the sum over what is allowed."""
        total = sum([p * tail.level(exceeds, (level_m - b) / sigma) for p, b, sigma in bounded])
        return math.log(max(total, _TINY) / left)

    low, high, widest = 0.0, 0.0, max(tail.core_scale, tail.tail_scale)
    for p, b, sigma in bounded:
        share = left / max(len(bounded) * p, _TINY)
        if share < 1.0:
            high = max(high, b + sigma * widest * math.sqrt(-2.0 * math.log(share)))
    at_low, at_high = excess(low), excess(high)
    for _ in range(_MOST_STEPS):
        if high - low <= _EXACT * high:
            break
        middle = (low * at_high - high * at_low) / ((at_high - at_low) or math.inf)
        if not low < middle < high:
            middle = 0.5 * (low + high)
        value = excess(middle)
        if value > 0.0:
            low, at_low, at_high = middle, value, 0.5 * at_high
        else:
            high, at_high, at_low = middle, value, 0.5 * at_low
    return high


def _reduced(distance_m: float, sigma_m: float) -> float:
    if math.isinf(sigma_m):
        return 0.0
    return distance_m / sigma_m if sigma_m > 0.0 else math.copysign(math.inf, distance_m)
