"""A barometer: height above its first reading.

    z = h + s_0 + s_1 h + v,   h = -p_d

Estimated: s_0, set by the first reading, drifting; s_1: air temperature, 0.4 % per degree.
"""

import math
from typing import Annotated

import numpy as np
from msgspec import Meta

from estimator.sources.base.aid import Aid, Refusal, SensorConfig, SlowError, of_reading
from models.measurements import Height
from models.messages import Array, Reading, Reason
from models.state import X

_LOWEST_PA, _HIGHEST_PA = 1_000.0, 120_000.0  # 31 km up; 1.4 km below the sea
_SEA_LEVEL_PA, _EXPONENT, _SCALE_M = 101_325.0, 0.190263, 44_330.8
_FALSE_HEIGHT_M = 50.0


class BaroConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[baro]: noise and slow errors; off without [inputs] baro."""

    sigma_m: Annotated[
        float, Meta(ge=1e-3, le=1e4, description="m: error by gusts and airspeed; a message's own noise is added")
    ] = 2.0
    drift_m_sqrt_s: Annotated[float, Meta(ge=1e-6, le=1000, description="m/sqrt(s): drift of the zero")] = 0.1
    temperature_sigma_k: Annotated[
        float, Meta(ge=0, le=100, description="K: how far the air is from the standard atmosphere")
    ] = 15.0

    def aid(self, reading: Reading) -> Aid | Refusal:
        """A pressure [Pa] as a measurement of height."""
        pressure, variance = reading.values[0], 0.0 if reading.covariance is None else float(reading.covariance[0, 0])
        if not _LOWEST_PA < pressure < _HIGHEST_PA:
            return Refusal(Reason.IMPLAUSIBLE, f"{pressure:.4g} Pa is no air pressure: pascal are expected")
        metres_per_pa = _SCALE_M * _EXPONENT / pressure * (pressure / _SEA_LEVEL_PA) ** _EXPONENT
        given = variance * metres_per_pa**2 if math.isfinite(variance) and variance > 0 else 0.0
        z = Height(height_m(pressure), np.array([[self.sigma_m**2 + given]]))
        walk = np.array([self.drift_m_sqrt_s**2, 0.0])
        slow = np.diag([0.0, (self.temperature_sigma_k / 288.15) ** 2])
        return of_reading(
            reading,
            z,
            (pressure, variance),
            [_FALSE_HEIGHT_M],
            slow_errors=(SlowError(reading.topic, slow, math.inf, _slow_jacobian, walk),),
        )


def height_m(pressure_pa: float) -> float:
    """h = 44330.8 (1 - (p / 101325 Pa)^0.190263), m: pressure height."""
    return float(_SCALE_M * (1.0 - (pressure_pa / _SEA_LEVEL_PA) ** _EXPONENT))


def _slow_jacobian(x: Array) -> Array:
    return np.array([[1.0, -x[X.P][2]]])
