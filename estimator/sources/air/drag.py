"""Drag of a multirotor: specific force across the thrust shows the air flow (through_air.py).

    u(f - b_a - d) = (1 + s) (R_nb^T (v - w))_xy + n

f: mean specific force; d: misalignment of thrust and IMU z, s: error of the coefficient, both estimated. Ten times a second in
flight.
"""

import math
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace

from estimator.sources.air.through_air import SEA_LEVEL_KG_M3, DragForce, scale_of
from estimator.sources.air.wind import WindConfig, estimated, wind_errors
from estimator.sources.base.aid import FALSE_VELOCITY_M_S, Aid, asked
from models.frames import GRAVITY
from models.messages import Array

TOPIC = "drag"
EVERY_NS: Final = 100_000_000  # between two readings, each the mean over that time
_TILT: Final = math.radians(1.0)  # of the thrust against the IMU's z, which is estimated
_ACROSS = slice(3, 5)  # specific force along x and y, of gyro and accelerometer


class DragConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[drag]: of a multirotor in flight; PX4's EKF2_MCOEF and EKF2_BCOEF."""

    enabled: Annotated[bool, Meta(description="whether drag shows a multirotor's velocity through the air")] = False
    momentum_1_s: Annotated[
        float, Meta(ge=0.01, le=10, description="1/s: drag of the rotors, force per mass and m/s (PX4 EKF2_MCOEF)")
    ] = 0.15
    ballistic_kg_m2: Annotated[
        float, Meta(ge=0, le=1e4, description="kg/m^2: mass over drag area of the hull (PX4 EKF2_BCOEF_X); 0: no such drag")
    ] = 0.0
    sigma_m_s2: Annotated[float, Meta(ge=1e-3, le=100, description="m/s^2: of a reading: vibration, manoeuvres")] = 0.5
    coefficient_sigma: Annotated[float, Meta(ge=1e-3, le=1, description="ratio: of the coefficients, which is estimated")] = 0.2


def drag_aid(t_ns: int, wind: WindConfig) -> Aid:
    """Drag at t_ns, asked of the IMU samples before it."""
    return asked(t_ns, TOPIC, [FALSE_VELOCITY_M_S] * 2, wind_errors(wind, 2))


def felt(aid: Aid, u: Array, config: DragConfig) -> tuple[Aid, DragForce]:
    """The measurement in samples u (k, 6), with own errors."""
    square = 0.5 * SEA_LEVEL_KG_M3 / config.ballistic_kg_m2 if config.ballistic_kg_m2 else 0.0
    z = DragForce(u[:, _ACROSS].mean(axis=0), config.sigma_m_s2, config.momentum_1_s, square)
    through_air, by_force = z.velocity(z.f_b)
    tilt = estimated(f"{TOPIC}.tilt", np.full(2, GRAVITY * _TILT), by_force)
    scale = estimated(scale_of(TOPIC), np.array([config.coefficient_sigma]), through_air[:, np.newaxis])
    return replace(aid, slow_errors=(tilt, scale, *aid.slow_errors)), z
