"""The world: WGS-84 <-> local NED, gravity and Earth rate at a place, NED/FRD <-> ENU/FLU.

n is tangent to the ellipsoid at the map origin and stays parallel to itself: at a place away from the origin "down" is not
exactly n's z (1 km: 0.16 mrad), so gravity is computed at the place and turned into n's axes.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import pymap3d

from models.messages import Array, Vec3

EARTH_RATE = 7.292115e-5  # rad/s, WGS-84
GRAVITY = 9.80665  # m/s^2, standard gravity, where the place on Earth is unknown
_EARTH_RADIUS = 6_378_137.0  # m, WGS-84 semi-major axis

ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # its own inverse
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])  # its own inverse


@dataclass(frozen=True, slots=True)
class Origin:
    """Where n touches the Earth: geodetic latitude and longitude [deg], height above the WGS-84 ellipsoid [m]."""

    lat_deg: float
    lon_deg: float
    alt_m: float

    @classmethod
    def of(cls, lla: tuple[float, float, float] | None) -> Self | None:
        """An Origin from a (lat, lon, alt) tuple, None from None."""
        return None if lla is None else cls(*lla)

    def to_ned(self, lat_deg: float, lon_deg: float, alt_m: float) -> Vec3:
        """Position in n [m] of a geodetic place, exactly (by way of ECEF)."""
        n, e, d = pymap3d.geodetic2ned(lat_deg, lon_deg, alt_m, self.lat_deg, self.lon_deg, self.alt_m)
        return float(n), float(e), float(d)

    def to_geodetic(self, p_n: Array | Vec3) -> Vec3:
        """Latitude [deg], longitude [deg], ellipsoid height [m] of a position in n."""
        lat, lon, alt = pymap3d.ned2geodetic(p_n[0], p_n[1], p_n[2], self.lat_deg, self.lon_deg, self.alt_m)
        return float(lat), float(lon), float(alt)

    @property
    def earth_rate_n(self) -> Array:
        """Rotation rate of the Earth in n's axes, rad/s (Groves 2013, eq. 5.41)."""
        lat = math.radians(self.lat_deg)
        return np.array([EARTH_RATE * math.cos(lat), 0.0, -EARTH_RATE * math.sin(lat)])

    @property
    def gravity(self) -> float:
        """Magnitude of gravity at the origin, m/s^2."""
        return normal_gravity(math.radians(self.lat_deg), self.alt_m)


def normal_gravity(lat_rad: float, alt_m: float) -> float:
    """Gravity on and above the WGS-84 ellipsoid, m/s^2.

        g0 = 9.7803253359 (1 + 0.001931853 s^2) / sqrt(1 - e^2 s^2),  s = sin(lat)         (Somigliana; Groves 2013, eq. 2.134)
        g(h) = g0 (1 - 2 h / a)                                                      (first term of Groves 2013, eq. 2.139)
    """
    s2 = math.sin(lat_rad) ** 2
    g0 = 9.7803253359 * (1.0 + 0.001931853 * s2) / math.sqrt(1.0 - 6.69437999014e-3 * s2)
    return g0 * (1.0 - 2.0 * alt_m / _EARTH_RADIUS)
