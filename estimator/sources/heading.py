"""Azimuth of the baseline of two GNSS antennas.

    azimuth of R_nb b = z - e_0 - v

b: baseline in the body; e_0: mounting and multipath, lasting (considered).
"""

import math
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta

from estimator.sources.base.aid import Aid, Refusal, SensorConfig, SlowError, of_reading
from models.measurements import Heading
from models.messages import Reading, Reason

_TURN = 2.0 * math.pi
_Metres: TypeAlias = Annotated[float, Meta(ge=-100, le=100)]


class HeadingConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[heading]: two antennas and errors; off without [inputs] heading."""

    baseline_b_m: Annotated[
        tuple[_Metres, _Metres, _Metres],
        Meta(description="m: from the first antenna to the second, forward right down; along the nose if the heading is its"),
    ] = (1.0, 0.0, 0.0)
    delay_s: Annotated[float, Meta(ge=-1, le=5, description="s: stamps are later than validity by this much")] = 0.0
    sigma_deg: Annotated[float, Meta(ge=0.01, le=90, description="deg: where the receiver gives no accuracy")] = 1.0
    slow_sigma_deg: Annotated[float, Meta(ge=0, le=90, description="deg: of the mounting and of multipath; 0: none")] = 1.0
    slow_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: correlation time of the slow part")] = 60.0

    def aid(self, reading: Reading) -> Aid | Refusal:
        """An azimuth [rad], clockwise from north, as a measurement of heading."""
        azimuth, baseline_b = reading.values[0], np.array(self.baseline_b_m)
        if abs(azimuth) > _TURN:
            return Refusal(Reason.IMPLAUSIBLE, f"a heading of {azimuth:.4g} rad: radians are expected")
        if not baseline_b.any():
            return Refusal(Reason.UNSUPPORTED, "[heading] baseline_b_m is zero")
        given = 0.0 if reading.covariance is None else float(reading.covariance[0, 0])
        is_given = math.isfinite(given) and given > 0.0
        z = Heading(baseline_b, azimuth, np.array([[given if is_given else math.radians(self.sigma_deg) ** 2]]))
        slow = np.array([[math.radians(self.slow_sigma_deg) ** 2]])
        return of_reading(
            reading,
            z,
            (azimuth, given),
            [math.pi],
            delay_s=self.delay_s,
            slow_errors=(SlowError(f"{reading.topic}.slow", slow, self.slow_s),) * (self.slow_sigma_deg > 0),
            assumed="" if is_given else f"the receiver gives no accuracy: [heading] sigma_deg {self.sigma_deg:g} taken",
            weighs=False,
        )
