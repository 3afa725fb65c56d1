"""Noise of an IMU at rest: Allan deviation -> noise density, bias instability, random walk.

    sigma^2(tau) = 1 / (2 (K - 2m)) sum_k ((theta_{k+2m} - 2 theta_{k+m} + theta_k) / tau)^2      (overlapping, tau = m h)
    sigma^2(tau) = N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3              (IEEE Std 952-1997, annex C)

with theta the integrated signal, N the noise density [unit / sqrt(Hz)], B the bias instability, K the random walk
[unit / s / sqrt(Hz)]. N and K have the units of the configuration: [imu] gyro_noise, accel_noise, gyro_walk, accel_walk.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import nnls

from calib.errors import CalibrationError
from models.messages import Array

_FEWEST: Final = 200  # samples
_FEWEST_CLUSTERS: Final = 9  # of the longest time: fewer are all noise
_INSTABILITY = 2.0 * np.log(2.0) / np.pi


@dataclass(frozen=True)
class Noise:
    """One axis: density N, instability B, walk K with the standard deviations of N and K; tau_s and adev: the curve."""

    density: float
    instability: float
    walk: float
    density_sigma: float
    walk_sigma: float
    tau_s: Array
    adev: Array
    adev_sigma: Array

    def model(self, tau_s: Array) -> Array:
        """The fitted Allan deviation."""
        variance = self.density**2 / tau_s + _INSTABILITY * self.instability**2 + self.walk**2 * tau_s / 3.0
        return np.asarray(np.sqrt(variance))


def allan_deviation(x: Array, rate_hz: float) -> tuple[Array, Array]:
    """tau [s] and overlapping Allan deviation of evenly sampled x (K,), from one sample to a ninth of the record."""
    theta = np.concatenate(([0.0], np.cumsum(x - np.mean(x)))) / rate_hz
    longest = (len(x) - 1) // _FEWEST_CLUSTERS
    m = 2 ** np.arange(int(np.log2(max(longest, 1))) + 1)  # octaves: points nearer to each other tell the same
    tau = m / rate_hz
    variance = [
        np.mean((theta[2 * k :] - 2.0 * theta[k:-k] + theta[: -2 * k]) ** 2) / (2.0 * t * t) for k, t in zip(m, tau, strict=True)
    ]
    return tau, np.sqrt(variance)


def noise(x: Array, rate_hz: float) -> Noise:
    """The noise of one axis at rest, x (K,) evenly sampled. Raises CalibrationError where the record is too short."""
    if len(x) < _FEWEST:
        raise CalibrationError(f"{len(x)} samples at rest are too few for the Allan deviation")
    if np.ptp(x) == 0.0:
        raise CalibrationError("an axis of the IMU always reads the same: dead, or rounded too coarsely")
    tau, adev = allan_deviation(x, rate_hz)
    # Relative error of a point: 1 / sqrt(2 (clusters - 1)) (IEEE 952, eq. C.24); overlapping gains little at long times.
    relative = 1.0 / np.sqrt(2.0 * np.maximum(len(x) / (tau * rate_hz) - 1.0, 1.0))
    A = np.column_stack((1.0 / tau, np.full(len(tau), _INSTABILITY), tau / 3.0))
    weight = 1.0 / (2.0 * relative * adev**2)
    squares, _ = nnls(A * weight[:, None], adev**2 * weight)
    C = np.linalg.pinv((A * weight[:, None]).T @ (A * weight[:, None]))
    n, b, k = np.sqrt(squares)
    spread = np.sqrt(np.diagonal(C))  # of the squares; where one is 0 within it, of the root it is its fourth root
    sigma = np.minimum(spread / (2.0 * np.maximum(np.sqrt(squares), 1e-30)), np.sqrt(spread))
    return Noise(float(n), float(b), float(k), float(sigma[0]), float(sigma[2]), tau, adev, relative * adev)
