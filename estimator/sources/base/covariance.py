"""Covariances of messages: defaults and refusals."""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from estimator.sources.base.aid import Refusal
from models.messages import Array, Reason


def with_default(cov: Array, sigmas: Sequence[float] | Array) -> tuple[Array, bool]:
    """cov (k, k) with sigma_i^2 for unknown components, and whether there were any.

    Unknown: row and column all 0 (ROS COVARIANCE_TYPE_UNKNOWN; drivers, ArduPilot, PX4 and MAVLink send 0 so).
    """
    if cov.shape != (len(sigmas), len(sigmas)) or 0.0 not in cov.diagonal().tolist():  # nearly every call
        return cov, False
    unknown = ~(cov.any(axis=0) | cov.any(axis=1))
    return cov + np.diag(np.where(unknown, np.square(sigmas), 0.0)), bool(unknown.any())


_FLAWS = {
    1: Refusal(Reason.NOT_FINITE, "covariance: not finite, or 1e30 and more"),
    2: Refusal(Reason.NOT_PSD, "a variance is not positive"),
    3: Refusal(Reason.NOT_PSD, "covariance is not symmetric"),
    4: Refusal(Reason.NOT_PSD, "covariance is not positive definite"),
}
_ASYMMETRY, _SMALLEST_PIVOT = 1e-6, 1e-12  # of the correlation matrix
_LARGEST = 1e30  # squared units: with the factors of the filter its determinant would overflow


def covariance_refusal(cov: Array, size: int | None = None) -> Refusal | None:
    """Why `cov` (k, k) is no covariance (not below 1e30, asymmetric, not positive definite), or None; size: wanted k."""
    if size is not None and cov.shape != (size, size):
        return Refusal(Reason.MALFORMED, f"covariance: {size} x {size} is expected")
    return _FLAWS.get(_flaw(np.ascontiguousarray(cov)))


@njit(cache=True)
def _flaw(cov: Array) -> int:
    """First flaw of a covariance, a key of _FLAWS, or 0: Cholesky of the correlation matrix."""
    n = cov.shape[0]
    for i in range(n):
        for j in range(n):
            if not abs(cov[i, j]) < _LARGEST:
                return 1
    for i in range(n):
        if not cov[i, i] > 0.0:
            return 2
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            scale = math.sqrt(cov[i, i]) * math.sqrt(cov[j, j])
            if abs(cov[i, j] - cov[j, i]) > _ASYMMETRY * scale:
                return 3
            total = cov[i, j] / scale
            for k in range(j):
                total -= low[i, k] * low[j, k]
            if i == j:
                if total < _SMALLEST_PIVOT:
                    return 4
                low[i, i] = math.sqrt(total)
            else:
                low[i, j] = total / low[j, j]
    return 0
