"""Is an IMU sample usable, the stream plausible?

Refused: a mean specific force near 1 (unit g) or far from gravity, rates that are degrees per second.
"""

import math
from typing import NamedTuple

import numpy as np

from estimator.sources.base.aid import Refusal
from estimator.sources.base.machine import Phase
from models.messages import Array, ImuSample, Reason

_FASTEST_RAD_S = 100.0  # beyond any MEMS gyroscope (5700 deg/s)
_STRONGEST_M_S2 = 1000.0  # beyond any MEMS accelerometer (100 g)
_GRAVITY_BAND = (5.0, 20.0)  # m/s^2, of a mean over a second in flight
_UNIT_G_BAND = (0.5, 2.0)
_SWIFT_RAD_S = 20.0  # a rate whose mean magnitude is above this is degrees


class Plausibility(NamedTuple):
    """Whether the stream can be used, and why not."""

    phase: Phase
    detail: str = ""


def sample_refusal(sample: ImuSample) -> Refusal | None:
    """Why one sample cannot be used."""
    (p, q, r), (x, y, z) = sample.gyro_b, sample.accel_b
    w, f = _FASTEST_RAD_S, _STRONGEST_M_S2
    if -w < p < w and -w < q < w and -w < r < w and -f < x < f and -f < y < f and -f < z < f:
        return None
    if not all(map(math.isfinite, sample.gyro_b + sample.accel_b)):
        return Refusal(Reason.NOT_FINITE)
    return Refusal(Reason.IMPLAUSIBLE, "beyond any sensor of this kind: rad/s and m/s^2 are expected")


def stream_plausibility(u: Array) -> Plausibility:
    """Judge about a second of samples u (k, 6), gyro then accel."""
    force = float(np.linalg.norm(u[:, 3:].mean(axis=0)))
    rate = float(np.linalg.norm(u[:, :3], axis=1).mean())
    if _UNIT_G_BAND[0] < force < _UNIT_G_BAND[1]:
        return Plausibility(Phase.STOPPED, f"specific force averages {force:.2f}: unit g? m/s^2 are expected")
    if not _GRAVITY_BAND[0] < force < _GRAVITY_BAND[1]:
        return Plausibility(Phase.STOPPED, f"specific force averages {force:.2f} m/s^2: gravity is missing or the unit is wrong")
    if rate > _SWIFT_RAD_S:
        return Plausibility(Phase.STOPPED, f"angular rate averages {rate:.0f} rad/s: degrees per second?")
    return Plausibility(Phase.ACTIVE)
