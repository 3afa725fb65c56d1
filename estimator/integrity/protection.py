"""Protection levels by multiple-hypothesis solution separation: the bound that nominal errors and all faults together exceed
with the risk that is allowed.

Of fault modes i with probability p_i, in which the error of what is published is an offset b_i and a random part of sigma_i,

    sum_i p_i Q((PL - b_i) / sigma_i)  =  risk_per_hour  correlation_s / 3600

    vertical:    Q(z) = P(|x| > z) = erfc(z / sqrt 2)                      x ~ N(0, 1)
    horizontal:  Q(z) = P(|x| > z) = exp(-z^2 / 2)                         x ~ N(0, I_2), sigma_i^2 the larger eigenvalue

with Q = 1 where PL < b_i, and where sigma_i is infinite: nothing bounds that fault. An hour holds 3600 / correlation_s
independent errors, so the right side is the risk of one. (Blanch et al., Baseline advanced RAIM user algorithm, IEEE Trans.
AES 51, 2015, eq. 28-30, with the separation measured in place of its threshold. For visual fixes: Li and Waslander,
arXiv 1909.08537; for runway features: arXiv 2508.09732.)

Errors have heavier tails than a Gaussian, so Q is that of two: of each hundred errors some are `tail_scale` times as large,

    Q(z) = (1 - e) Q(z / c) + e Q(z / t),   e = tail_share, c = core_scale, t = tail_scale

(overbounding by a Gaussian mixture; Gupta and Gao, NAVIGATION 68, 2021, navi.445, bound the error of a camera on a 3-D map so.)
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

_EXACT: Final = 2e-3  # of a protection level, relative; rounded up
_TINY, _TINY_M = 1e-300, 1e-9
_MOST_STEPS: Final = 40
_HOUR_S: Final = 3600.0


class Mode(NamedTuple):
    """What may be wrong, seen along one direction: probability now, offset [m] and sigma [m] of the published error then."""

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


def protection_level(modes: Sequence[Mode], probability: float, tail: Tail, exceeds: Callable[[float], float]) -> float:
    """PL [m], not below the exact solution and at most two thousandths above it; inf where no distance is enough.

    In a bracket, by regula falsi on the logarithm (Illinois rule; Dowell and Jarratt 1971). Its upper end comes from
    Q(z) <= exp(-(z / t)^2 / 2): each of n bounded modes gets an equal share of what the unbounded ones leave.
    """
    bounded = [(m.probability, m.offset, max(m.sigma, _TINY_M)) for m in modes if math.isfinite(m.offset + m.sigma)]
    left = probability - sum(m.probability for m in modes if not math.isfinite(m.offset + m.sigma))
    if left <= 0.0:
        return math.inf
    if sum(p for p, _, _ in bounded) <= left:
        return 0.0
    core, c, e, t = 1.0 - tail.tail_share, tail.core_scale, tail.tail_share, tail.tail_scale

    def reach(p: float, offset: float, sigma: float) -> float:
        share = min(1.0, left / max(len(bounded) * p, _TINY))
        return offset + sigma * max(c, t) * math.sqrt(-2.0 * math.log(share)) if share < 1.0 else 0.0

    def excess(level_m: float) -> float:
        """ln of the sum over what is allowed; most of the time of all this goes by here."""
        total = 0.0
        for p, offset, sigma in bounded:
            z = (level_m - offset) / sigma
            total += p * (core * exceeds(z / c) + e * exceeds(z / t)) if z > 0.0 else p
        return math.log(max(total, _TINY) / left)

    low, high = 0.0, max(reach(*mode) for mode in bounded)
    at_low, at_high = excess(low), excess(high)
    for _ in range(_MOST_STEPS):
        if high - low <= _EXACT * high:
            break
        middle = (low * at_high - high * at_low) / (at_high - at_low)
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
