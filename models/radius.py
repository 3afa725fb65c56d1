"""Chi-square quantile, radius of the circle, reach of the ellipsoid, of a probability."""

import math
from functools import cache, lru_cache
from typing import Final

import numpy as np
from scipy.special import gammaincinv

from models.messages import Array

_RATIOS: Final = 1025  # of the table: linear between them, error below 1e-6
_ANGLES: Final = 64


@lru_cache(maxsize=256)
def chi_square(probability: float, dof: float) -> float:
    """Quantile of chi-square of dof: 2 P^-1(dof / 2, probability), P the regularised lower incomplete gamma function."""
    return 2.0 * float(gammaincinv(0.5 * dof, probability))


def horizontal_radius(covariance: Array, probability: float = 0.95) -> Array:
    """Radius [m] (n,) of the circle that holds an error of covariance (n, 2, 2); nan: not finite.

        P(x^2 + y^2 > r^2) = 1/2pi int_0^2pi exp( -r^2 / (2 (s1^2 cos^2 a + s2^2 sin^2 a)) ) da = 1 - probability

    s1 >= s2: semi-axes; in polar coordinates with tan(a) = s1 / s2 tan(angle).
    """
    radius = np.full(len(covariance), np.nan)
    finite = np.isfinite(covariance).all(axis=(1, 2))
    sigma = np.sqrt(np.clip(np.linalg.eigvalsh(covariance[finite]), 0.0, None))
    small, large = sigma[:, 0], sigma[:, 1]
    ratio = np.divide(small, large, out=np.zeros_like(small), where=large > 0.0)
    radius[finite] = large * np.interp(ratio, *_table(probability))
    return radius


def reach(covariance: Array, probability: float = 0.95) -> float:
    """Longest half axis [m] of the ellipsoid of covariance (3, 3); nan: not finite.

    r = sqrt( q max eig(P) ),    P(chi^2_3 < q) = probability
    """
    if not np.isfinite(covariance).all():
        return math.nan
    return math.sqrt(chi_square(probability, 3) * max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))


@cache
def _table(probability: float) -> tuple[Array, Array]:
    """r / s1 over s2 / s1 in 0..1, by Newton's method (convex in r^2)."""
    ratios = np.linspace(0.0, 1.0, _RATIOS)
    angle = (np.arange(_ANGLES) + 0.5) * (0.5 * np.pi / _ANGLES)  # a quarter is like the others
    variance = np.cos(angle) ** 2 + np.outer(ratios, np.sin(angle)) ** 2
    squared = np.zeros(_RATIOS)
    for _ in range(50):
        tail = np.exp(-0.5 * squared[:, None] / variance)
        squared += (tail.mean(axis=1) - (1.0 - probability)) / (0.5 * tail / variance).mean(axis=1)
    return ratios, np.sqrt(squared)
