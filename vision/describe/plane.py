"""A plane in disparity, fitted robustly.

n . x_c = h,  d - offset = f b / Z    =>    d(u, v) = c + p (u - u0) + q (v - v0)          exactly affine
"""

import math
from dataclasses import dataclass

import numpy as np

from models.messages import Array

_TUKEY = 4.685  # sigmas beyond which a point counts nothing (95 % efficiency)
_PRIOR_DOF = 4.0  # degrees of freedom of the stated sigmas against the scatter found
_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class DisparityPlane:
    """d = coefficients @ (1, u - u0, v - v0); origin (u0, v0); covariance (3, 3), px; scatter: rms of residual / sigma."""

    origin: Array
    coefficients: Array
    covariance: Array
    scatter: float
    used: int

    def at(self, px: Array) -> Array:
        """Disparity (N,) at pixels (N, 2)."""
        return np.asarray(self.coefficients[0] + (px - self.origin) @ self.coefficients[1:])


def fit_plane(points: Array, disparities: Array, sigmas: Array, slope: Array, slope_sigma: float) -> DisparityPlane | None:
    """The plane through disparities (N,), sigmas (N,) at pixels (N, 2) by Tukey's biweight; None without points.

    slope (2,), slope_sigma: prior of (p, q) [px/px]. Factor on the sigmas: s^2 = (m + sum w r^2 / sigma^2) / (m + sum w - 3).
    """
    if len(points) == 0:
        return None
    weights = 1.0 / sigmas**2
    origin = (weights[:, None] * points).sum(axis=0) / weights.sum()
    x, covariance, scatter, used = _fit(points - origin, disparities, sigmas, slope, slope_sigma)
    if not np.isfinite(x).all():
        return None
    return DisparityPlane(origin, x, covariance, scatter, used)


def _fit(uv: Array, d: Array, sigma: Array, slope: Array, slope_sigma: float) -> tuple[Array, Array, float, int]:
    order = np.argsort(d, kind="stable")
    cumulated = np.cumsum((1.0 / sigma**2)[order])
    x = np.array([d[order[min(np.searchsorted(cumulated, 0.5 * cumulated[-1]), len(d) - 1)]], *slope])
    weight_of_prior = np.array([1e-12, slope_sigma**-2, slope_sigma**-2])
    scale, rows = 1.0, np.column_stack((np.ones(len(d)), uv))
    for _ in range(_ROUNDS):
        residual = (d - rows @ x) / sigma
        ratio = residual / (_TUKEY * max(1.4826 * float(np.median(np.abs(residual))), 1.0))
        robust = np.where(np.abs(ratio) < 1.0, (1.0 - ratio * ratio) ** 2, 0.0)
        weighted = rows.T * (robust / (sigma * sigma * scale))
        normal = np.diag(weight_of_prior) + weighted @ rows
        x = np.linalg.solve(normal, weight_of_prior * (x[0], *slope) + weighted @ d)
        residual = (d - rows @ x) / sigma
        scale = float((_PRIOR_DOF + (robust * residual**2).sum()) / (_PRIOR_DOF + max(robust.sum() - 3.0, 0.0)))
    return (
        np.asarray(x, dtype=np.float64),
        np.asarray(np.linalg.inv(normal), dtype=np.float64),
        math.sqrt(scale),
        int((robust > 0.25).sum()),
    )
