"""Azimuth of the baseline of two GNSS antennas.

    azimuth of R_nb b = z - e_0 - v

b: baseline in the body; e_0: mounting and multipath, lasting (considered).
"""

import math
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta

from estimator.sources.base.aid import Aid, Refusal, SensorConfig, SlowError, log_false, order
from estimator.sources.base.rules import RULES
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
        t_ns = reading.t_ns - round(self.delay_s * 1e9)
        slow = np.array([[math.radians(self.slow_sigma_deg) ** 2]])
        return Aid(
            t_ns=t_ns,
            arrived_ns=reading.arrived_ns,
            topic=reading.topic,
            kind=reading.kind,
            order=order(t_ns, reading.kind, reading.topic, azimuth, given),
            rules=RULES["heading"],
            absolute=False,
            log_false=log_false(RULES["heading"], [math.pi]),
            measurement=lambda _: z,
            slow_errors=(SlowError(f"{reading.topic}.slow", slow, self.slow_s),) * (self.slow_sigma_deg > 0),
            assumed="" if is_given else f"the receiver gives no accuracy: [heading] sigma_deg {self.sigma_deg:g} taken",
            weighs=False,
        )
