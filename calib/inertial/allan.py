"""Noise of an IMU at rest by Allan deviation.

    sigma^2(tau) = 1 / (2 (K - 2m)) sum_k ((theta_{k+2m} - 2 theta_{k+m} + theta_k) / tau)^2      (overlapping, tau = m h)
    sigma^2(tau) = N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3              (IEEE Std 952-1997, annex C)

theta: integrated signal; N: noise density [unit / sqrt(Hz)], B: bias instability, K: random walk [unit / s / sqrt(Hz)]. Otherwise
N = sigma(tau) sqrt(tau) at the longest tau.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import nnls

from calib.errors import CalibrationError
from models.messages import Array

_FEWEST: Final = 200  # samples
_FEWEST_CLUSTERS: Final = 9  # of the longest time: fewer are all noise
_FEWEST_POINTS: Final = 4  # that three unknowns are fitted to
_FITS: Final = 2.5  # sigma of the worst point, up to which the curve is of the three kinds
_SEEN: Final = 2.0  # sigma
_INSTABILITY = 2.0 * np.log(2.0) / np.pi


@dataclass(frozen=True)
class Noise:
    """One axis; tau_s, adev: curve; white_from_s: shortest fitted time, nan: N of the longest."""

    density: float
    instability: float
    walk: float
    density_sigma: float
    instability_sigma: float
    walk_sigma: float
    white_from_s: float
    tau_s: Array
    adev: Array
    adev_sigma: Array

    @property
    def walk_seen(self) -> bool:
        """Whether the walk differs from none."""
        return self.walk > _SEEN * self.walk_sigma

    def model(self, tau_s: Array) -> Array:
        """The fitted Allan deviation."""
        variance = self.density**2 / tau_s + _INSTABILITY * self.instability**2 + self.walk**2 * tau_s / 3.0
        return np.asarray(np.sqrt(variance))


def allan_deviation(x: Array, rate_hz: float) -> tuple[Array, Array]:
    """tau [s] and overlapping Allan deviation of x (K,), up to a ninth of the record."""
    theta = np.concatenate(([0.0], np.cumsum(x - np.mean(x)))) / rate_hz
    longest = (len(x) - 1) // _FEWEST_CLUSTERS
    m = 2 ** np.arange(int(np.log2(max(longest, 1))) + 1)  # octaves: points nearer to each other tell the same
    tau = m / rate_hz
    variance = [
        np.mean((theta[2 * k :] - 2.0 * theta[k:-k] + theta[: -2 * k]) ** 2) / (2.0 * t * t) for k, t in zip(m, tau, strict=True)
    ]
    return tau, np.sqrt(variance)


def noise(x: Array, rate_hz: float) -> Noise:
    """Noise of one axis at rest, x (K,) evenly sampled. Raises CalibrationError for a short record."""
    if len(x) < _FEWEST:
        raise CalibrationError(f"{len(x)} samples at rest are too few, {_FEWEST} are the least: log faster, or let it lie longer")
    if np.ptp(x) == 0.0:
        raise CalibrationError("an axis of the IMU always reads the same: dead, or rounded too coarsely")
    tau, adev = allan_deviation(x, rate_hz)
    # Relative error of a point: 1 / sqrt(2 (clusters - 1)) (IEEE 952, eq. C.24); overlapping gains little at long times.
    relative = 1.0 / np.sqrt(2.0 * np.maximum(len(x) / (tau * rate_hz) - 1.0, 1.0))
    last = len(tau) - _FEWEST_POINTS
    first = next((k for k in range(last + 1) if _fit(tau[k:], adev[k:], relative[k:])[2] < _FITS), None)
    if first is None:
        squares = np.array([adev[-1] ** 2 * tau[-1], 0.0, 0.0])
        C = np.diag([(2.0 * relative[-1] * squares[0]) ** 2, np.inf, np.inf])
    else:
        first = min(first + 1, last) if first else 0  # an octave beyond what still bends the curve
        squares, C, _ = _fit(tau[first:], adev[first:], relative[first:])
    n, b, k = np.sqrt(squares)
    spread = np.sqrt(np.diagonal(C))  # of the squares; where one is 0 within it, of the root it is its fourth root
    sigma = np.minimum(spread / (2.0 * np.maximum(np.sqrt(squares), 1e-30)), np.sqrt(spread))
    return Noise(
        float(n), float(b), float(k), float(sigma[0]), float(sigma[1]), float(sigma[2]),
        float("nan") if first is None else float(tau[first]), tau, adev, relative * adev,
    )  # fmt: skip


def _fit(tau: Array, adev: Array, relative: Array) -> tuple[Array, Array, float]:
    A = np.column_stack((1.0 / tau, np.full(len(tau), _INSTABILITY), tau / 3.0))
    weight = 1.0 / (2.0 * relative * adev**2)
    squares, _ = nnls(A * weight[:, None], adev**2 * weight)
    C = np.asarray(np.linalg.pinv((A * weight[:, None]).T @ (A * weight[:, None])), dtype=np.float64)
    return squares, C, float(np.abs((A @ squares - adev**2) * weight).max())
