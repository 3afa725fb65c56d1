"""Pitot airspeed along the nose, with small sideslip of a fixed wing.

    z_x = (1 + k) e_x^T R_nb^T (v - w) + n,   0 = e_y^T R_nb^T (v - w) + n_beta

k: estimated; second row: where sideslip_deg is given.
"""

import math
from functools import cache
from typing import Annotated, Final

import numpy as np
from msgspec import Meta

from estimator.sources.air.through_air import AirVelocity, density_ratio, scale_of
from estimator.sources.air.wind import WindConfig, estimated, wind_errors
from estimator.sources.base.aid import FALSE_VELOCITY_M_S, Aid, Refusal, SensorConfig, SlowError, of_reading
from models.frames import Origin
from models.messages import Reading, Reason

_FASTEST_M_S = 350.0
_SIDESLIP_S: Final = 3.0  # duration of one
_NOSE, _AND_SIDE = np.arange(1), np.arange(2)
_USUAL = WindConfig()


class AirspeedConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[airspeed]: pitot tube and errors; off without [inputs] airspeed."""

    delay_s: Annotated[float, Meta(ge=-1, le=5, description="s: stamps are later than validity by this much")] = 0.0
    indicated: Annotated[
        bool, Meta(description="whether readings are indicated airspeed, as of the density at sea level, or true airspeed")
    ] = False
    sigma_m_s: Annotated[float, Meta(ge=1e-3, le=100, description="m/s: of a reading, where the message gives no accuracy")] = 0.5
    scale_sigma: Annotated[float, Meta(ge=0, le=1, description="ratio: of its scale, which is estimated; 0: none")] = 0.05
    sideslip_deg: Annotated[
        float, Meta(ge=0, le=45, description="deg: sideslip of a fixed wing; 0: it is not taken to fly along its nose")
    ] = 0.0
    least_m_s: Annotated[
        float, Meta(ge=0, le=100, description="m/s: below, the tube measures nothing, or the vehicle does not fly")
    ] = 6.0

    def aid(self, reading: Reading, wind: WindConfig = _USUAL) -> Aid | Refusal:
        """An airspeed [m/s] as a velocity through the air."""
        speed = reading.values[0]
        if abs(speed) > _FASTEST_M_S:
            return Refusal(Reason.IMPLAUSIBLE, f"{speed:.4g} m/s: metres per second are expected")
        if speed < self.least_m_s:
            return Refusal(
                Reason.IMPLAUSIBLE, f"{speed:.1f} m/s is below [airspeed] least_m_s: on the ground, or the tube is closed"
            )
        given = 0.0 if reading.covariance is None else float(reading.covariance[0, 0])
        sigma = math.sqrt(given) if math.isfinite(given) and given > 0.0 else self.sigma_m_s

        @cache  # a measurement that comes late has others done again
        def measurement(origin: Origin | None) -> AirVelocity:
            return self._velocity(speed, sigma, origin)

        z = self._velocity(speed, sigma, None)
        scale = estimated(scale_of(reading.topic), np.array([self.scale_sigma]), np.eye(len(z.rows))[:, :1] * speed)
        slip = speed * math.radians(self.sideslip_deg)
        sideslip = SlowError(f"{reading.topic}.sideslip", np.array([[slip**2]]), _SIDESLIP_S, np.array([[0.0], [1.0]]))
        return of_reading(
            reading,
            measurement,
            (speed, given),
            [FALSE_VELOCITY_M_S] * len(z.rows),
            delay_s=self.delay_s,
            slow_errors=(
                *(scale,) * (self.scale_sigma > 0),
                *(sideslip,) * (self.sideslip_deg > 0),
                *wind_errors(wind, len(z.rows)),
            ),
            weighs=False,
        )

    def _velocity(self, speed: float, sigma: float, origin: Origin | None) -> AirVelocity:
        if self.indicated and origin is not None:
            speed /= math.sqrt(density_ratio(origin.alt_m))
        if not self.sideslip_deg:
            return AirVelocity(np.array([speed]), np.array([[sigma**2]]), _NOSE)
        return AirVelocity(np.array([speed, 0.0]), np.diag([sigma**2, sigma**2]), _AND_SIDE)
