"""An IMU from a recording: rest, noise, accelerometer scale and bias from six positions.

|S^-1 (f_k - b)| = g,   S = diag(s),   for the mean specific force f_k of each position k   (Skog & Haendel 2006)
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calib.errors import CalibrationError
from calib.inertial.allan import Noise, noise
from models.frames import GRAVITY
from models.messages import Array

_WINDOW_S: Final = 0.5
_RESTLESS: Final = 3.0  # times the quietest windows' scatter
_MOST_ACCEL, _MOST_GYRO = 0.6, 0.08  # m/s^2, rad/s: more scatter than this is motion, however even
_SHORTEST_S: Final = 2.0  # of a rest that noise is taken from: enough for the density, for nothing else
_POSITION_S: Final = 2.0
_SAME_DIRECTION: Final = np.cos(np.deg2rad(20.0))
_NOISE_PART: Final = 0.05  # of the variance at the shortest time that must be white
_AXIS_REACHED: Final = 0.7  # of g, up and down on each axis


@dataclass(frozen=True)
class Static:
    """Noise of the six axes at rest, and the mean there."""

    duration_s: float
    rate_hz: float
    gyro: tuple[Noise, Noise, Noise]
    accel: tuple[Noise, Noise, Noise]
    gyro_mean: Array
    accel_mean: Array

    def config(self) -> dict[str, float]:
        """Values of [imu]: the worst axis; unseen walks are left out."""
        noises = (("gyro", self.gyro), ("accel", self.accel))
        density = {f"{name}_noise": max(n.density for n in axes) for name, axes in noises}
        seen = {f"{name}_walk": [n.walk for n in axes if n.walk_seen] for name, axes in noises}
        return density | {name: max(walks) for name, walks in seen.items() if walks}

    @property
    def longest_tau_s(self) -> float:
        """Longest averaging time with known noise."""
        return float(min(n.tau_s[-1] for n in (*self.gyro, *self.accel)))

    @property
    def white_from_s(self) -> float:
        """Averaging time from which on all axes are white, or nan."""
        return float(np.max([n.white_from_s for n in (*self.gyro, *self.accel)]))


@dataclass(frozen=True)
class SixPosition:
    """f_true = (f - bias) / scale; covariance (6, 6) of (bias, scale); residual of |f_true| - g [m/s^2]."""

    bias: Array
    scale: Array
    covariance: Array
    residual: float
    positions: Array


def rests(t_ns: NDArray[np.int64], gyro: Array, accel: Array) -> list[slice]:
    """Rests longer than 2 s; gyro [rad/s], accel [m/s^2] (N, 3)."""
    rate = _rate(t_ns)
    n = max(int(_WINDOW_S * rate), 3)
    windows = len(t_ns) // n
    if windows < 2:
        return []
    scatter = [np.linalg.norm(x[: windows * n].reshape(windows, n, 3).std(axis=1), axis=1) for x in (gyro, accel)]
    mean = accel[: windows * n].reshape(windows, n, 3).mean(axis=1)
    quiet = [
        min(_RESTLESS * float(np.percentile(s, 10)), most) for s, most in zip(scatter, (_MOST_GYRO, _MOST_ACCEL), strict=True)
    ]
    still = (scatter[0] <= max(quiet[0], 1e-9)) & (scatter[1] <= max(quiet[1], 1e-9))
    # A slow turn is even, too: gravity must stay where it is from window to window.
    moved = np.linalg.norm(np.diff(mean, axis=0), axis=1) > max(quiet[1], 0.03)
    breaks = np.concatenate(([True], moved | ~still[1:] | ~still[:-1], [True]))
    found = []
    for a, b in zip(np.flatnonzero(breaks)[:-1], np.flatnonzero(breaks)[1:], strict=True):
        if still[a] and (b - a) * n >= _POSITION_S * rate:
            found.append(slice(int(a * n), int(b * n)))
    return found


def static_noise(t_ns: NDArray[np.int64], gyro: Array, accel: Array) -> Static:
    """Noise in the longest rest. Raises CalibrationError below two seconds."""
    check(t_ns, gyro, accel)
    found = rests(t_ns, gyro, accel)
    lengths = [1e-9 * float(t_ns[r.stop - 1] - t_ns[r.start]) for r in found]
    if not found or max(lengths) < _SHORTEST_S:
        longest = max(lengths, default=0.0)
        raise CalibrationError(
            f"the IMU rests for {longest:.0f} s at most: let it lie still, ten minutes for the noise, hours for the walk"
        )
    best = found[int(np.argmax(lengths))]
    rate = _rate(t_ns[best])
    even = _evenly(t_ns[best], rate)
    g0, g1, g2, a0, a1, a2 = noises = [noise(x[best, k][even], rate) for x in (gyro, accel) for k in range(3)]
    if not all(_is_noise(n) for n in noises):
        raise CalibrationError("where the IMU moved least its signal is still motion, not noise: let it lie still")
    return Static(
        max(lengths), rate, (g0, g1, g2), (a0, a1, a2), gyro[best].mean(axis=0), accel[best].mean(axis=0)
    )  # fmt: skip


def _evenly(t_ns: NDArray[np.int64], rate: float) -> NDArray[np.int64]:
    """Nearest samples: interpolation would smooth noise."""
    since = 1e-9 * (t_ns - t_ns[0])  # small numbers: a float of the epoch's nanoseconds is good to 256 of them
    ticks = np.arange(int(since[-1] * rate) + 1) / rate
    return np.searchsorted(0.5 * (since[1:] + since[:-1]), ticks)


def six_position(t_ns: NDArray[np.int64], gyro: Array, accel: Array, gravity: float = GRAVITY) -> SixPosition:
    """Scale and bias from six rests or more. Raises CalibrationError."""
    check(t_ns, gyro, accel)
    means: list[Array] = []
    sigmas = []
    for r in rests(t_ns, gyro, accel):
        mean = accel[r].mean(axis=0)
        if all(mean @ m < _SAME_DIRECTION * np.linalg.norm(mean) * np.linalg.norm(m) for m in means):
            means.append(mean)
            sigmas.append(float(np.sqrt(np.mean(accel[r].var(axis=0)) / (r.stop - r.start))))
    f = np.array(means).reshape(-1, 3)
    missing = [
        f"{axis} {end}" for k, axis in enumerate("xyz") for end, sign in (("up", 1.0), ("down", -1.0))
        if not np.any(sign * f[:, k] > _AXIS_REACHED * gravity)
    ]  # fmt: skip
    if missing:
        raise CalibrationError(
            f"{len(f)} positions at rest; missing: axis {', '.join(missing)}: "
            "lay the IMU on each of its six sides for five seconds"
        )
    return _solve(f, max(float(np.mean(sigmas)), 1e-6), gravity)


def check(t_ns: NDArray[np.int64], gyro: Array, accel: Array) -> None:
    """Raises CalibrationError: short, non-finite, wrong unit."""
    if len(t_ns) < 100:
        raise CalibrationError(f"{len(t_ns)} IMU samples are no recording")
    if np.any(np.diff(t_ns) <= 0):
        raise CalibrationError("the IMU's stamps do not increase")
    if not (np.isfinite(gyro).all() and np.isfinite(accel).all()):
        raise CalibrationError("the IMU's samples are not all finite")
    level = float(np.median(np.linalg.norm(accel, axis=1)))
    if not 0.7 * GRAVITY < level < 1.4 * GRAVITY:
        raise CalibrationError(f"the accelerometer reads {level:.2f} in the median, not {GRAVITY:.1f} m/s^2: wrong units?")


def _solve(f: Array, sigma: float, gravity: float) -> SixPosition:
    b, s = np.zeros(3), np.ones(3)
    for _ in range(20):
        x = (f - b) / s
        norm = np.linalg.norm(x, axis=1, keepdims=True)
        J = np.hstack((-x / norm / s, -x * x / norm / s))
        step = np.linalg.lstsq(J, gravity - norm[:, 0], rcond=None)[0]
        b, s = b + step[:3], s + step[3:]
        if np.abs(step).max() < 1e-12:
            break
    residual = np.linalg.norm((f - b) / s, axis=1) - gravity
    spare = len(f) - 6
    scatter = max(sigma, float(np.sqrt(residual @ residual / spare)) if spare > 0 else 0.0)
    covariance = np.asarray(scatter**2 * np.linalg.pinv(J.T @ J))
    return SixPosition(b, s, covariance, float(np.sqrt(np.mean(residual**2))), f)


def _is_noise(n: Noise) -> bool:
    first = n.adev[n.tau_s == n.white_from_s]
    return not len(first) or bool(n.density**2 >= _NOISE_PART * n.white_from_s * first[0] ** 2)


def _rate(t_ns: NDArray[np.int64]) -> float:
    return 1e9 / float(np.median(np.diff(t_ns)))
