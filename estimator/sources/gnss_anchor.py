"""The last-known GPS, and how far the vehicle may be from it by now."""

from dataclasses import dataclass

import numpy as np

from models.messages import LastGnss


@dataclass(frozen=True, slots=True)
class GnssAnchor:
    """The last trusted GNSS fix: (lat, lon, alt), time, 1-sigma radius [m], speed [m/s]."""

    place: tuple[float, float, float]
    t_ns: int
    sigma_m: float
    speed_m_s: float

    def at(self, t_ns: int) -> LastGnss:
        """Grown with age."""
        age_s = (t_ns - self.t_ns) * 1e-9
        return LastGnss(*self.place, age_s=age_s, sigma_m=float(np.hypot(self.sigma_m, self.speed_m_s * age_s)))
