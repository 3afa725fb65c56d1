"""Noise of the sensors while the vehicle stands, against what is configured or reported.

    sigma = MAD(third differences) / (0.6745 sqrt(20)),   density = sigma sqrt(dt)

Third differences are blind to a steady motion; MAD: median of the absolute values.
"""

import math
from typing import Final

import numpy as np

from estimator.config import Config
from estimator.sources.base.aid import Aid, Refusal
from estimator.tools.doctor.machine import Check, judge
from models.frames import Origin
from models.measurements import Pose, Position, Velocity
from models.messages import Array, ImuSample, Input

_ORDER: Final = 3
_SCALE: Final = 0.6745 * math.sqrt(20.0)
_FEWEST: Final = 20
_MUCH: Final = 2.0  # times what is configured or reported
_UNITS: Final = {Position: "m", Pose: "m", Velocity: "m/s"}


class Noise:
    """Collects the readings of each topic; origin: of n, or the first GNSS fix."""

    def __init__(self, origin: Origin | None) -> None:
        self._origin = origin
        self._imu: dict[str, list[tuple[float, ...]]] = {}  # seconds, rate, force
        self._read: dict[str, list[Array]] = {}  # what was measured and its variances, (6,)
        self._units: dict[str, str] = {}

    def add(self, message: Input, made: Aid | Refusal | None) -> None:
        """One message; made: the measurement that it is."""
        if isinstance(message, ImuSample):
            self._imu.setdefault(message.topic, []).append((message.t_ns * 1e-9, *message.gyro_b, *message.accel_b))
        elif isinstance(made, Aid):
            if self._origin is None and made.geodetic:
                self._origin = Origin(*made.geodetic)
            z = made.measurement(self._origin)
            if isinstance(z, Position | Pose | Velocity) and len(z.rows) >= _ORDER:
                self._units[message.topic] = _UNITS[type(z)]
                self._read.setdefault(message.topic, []).append(np.r_[z.z_n, z.noise.diagonal()[:_ORDER]])

    def checks(self, config: Config) -> list[Check]:
        """A line for each topic with enough readings."""
        found = []
        for topic, samples in self._imu.items():
            if len(samples) >= _FEWEST:
                found += self._of_imu(topic, np.array(samples), config)
        for topic, readings in self._read.items():
            if len(readings) >= _FEWEST:
                found.append(self._of_reading(topic, np.array(readings)))
        return found

    def _of_imu(self, topic: str, samples: Array, config: Config) -> list[Check]:
        dt_s = float(np.median(np.diff(samples[:, 0])))
        return [
            _density(topic, key, _sigma(samples[:, part]) * math.sqrt(max(dt_s, 0.0)), unit, getattr(config.imu, key))
            for key, part, unit in (
                ("gyro_noise", slice(1, 4), "rad/s/sqrt(Hz)"),
                ("accel_noise", slice(4, 7), "m/s^2/sqrt(Hz)"),
            )
        ]

    def _of_reading(self, topic: str, rows: Array) -> Check:
        measured, reported = _sigma(rows[:, :_ORDER]), math.sqrt(float(np.median(rows[:, _ORDER:].max(axis=1))))
        found = f"{measured:.2g} {self._units[topic]} from one to the next, {reported:.2g} reported"
        advice = "its covariance is too small: let its driver report more"
        return judge(f"{topic} noise", found, warn=measured > _MUCH * reported, advice=advice)


def _density(topic: str, key: str, measured: float, unit: str, configured: float) -> Check:
    found = f"{measured:.2g} {unit}, {configured:.2g} configured"
    return judge(f"{topic} {key}", found, warn=measured > _MUCH * configured, advice=f"set [imu] {key} = {measured:.1g}")


def _sigma(values: Array) -> float:
    """The largest of the columns (n, k)."""
    steps = np.diff(values, _ORDER, axis=0)
    return float(np.median(np.abs(steps), axis=0).max()) / _SCALE
