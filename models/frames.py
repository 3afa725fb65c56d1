"""WGS-84 <-> local NED, gravity, Earth rate, NED/FRD <-> ENU/FLU.

n is tangent at the map origin: elsewhere down differs from n's z (0.16 mrad per km), so gravity is computed at the position and
turned into n.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np
import pymap3d
from numba import njit

from models.messages import Array, Vec3

EARTH_RATE = 7.292115e-5  # rad/s, WGS-84
GRAVITY = 9.80665  # m/s^2, standard gravity, where the place on Earth is unknown
GRAVITY_N = np.array([0.0, 0.0, GRAVITY])
_EARTH_RADIUS = 6_378_137.0  # m, WGS-84 semi-major axis
_E2 = 6.69437999014e-3  # WGS-84 first eccentricity squared
_WGS84 = pymap3d.Ellipsoid.from_name("wgs84")

ENU_FROM_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # its own inverse
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])  # its own inverse


@dataclass(frozen=True, slots=True)
class Origin:
    """Origin of n: geodetic latitude, longitude [deg], height above WGS-84 [m]."""

    lat_deg: float
    lon_deg: float
    alt_m: float

    @classmethod
    def of(cls, lla: tuple[float, float, float] | None) -> Self | None:
        """An Origin from a (lat, lon, alt) tuple, None from None."""
        return None if lla is None else cls(*lla)

    def to_ned(self, lat_deg: float, lon_deg: float, alt_m: float) -> Vec3:
        """Position in n [m] of a geodetic position, exact (ECEF)."""
        x, y, z = _ecef(lat_deg, lon_deg, alt_m)
        x0, y0, z0 = _of_origin(*self.lla)
        e, n, u = pymap3d.ecef2enuv(x - x0, y - y0, z - z0, self.lat_deg, self.lon_deg)
        return float(n), float(e), -float(u)

    def to_geodetic(self, p_n: Array | Vec3) -> Vec3:
        """Latitude, longitude [deg], ellipsoid height [m] of a position in n."""
        lat, lon, alt = _geodetic(p_n[0], p_n[1], p_n[2], math.radians(self.lat_deg), math.radians(self.lon_deg), self.alt_m)
        return math.degrees(lat), math.degrees(lon), alt

    @property
    def lla(self) -> Vec3:
        """(lat_deg, lon_deg, alt_m)."""
        return self.lat_deg, self.lon_deg, self.alt_m

    @property
    def axes_e(self) -> Array:
        """C_ne (3, 3): north, east, down as rows in ECEF (Groves 2013, eq. 2.150)."""
        lat, lon = math.radians(self.lat_deg), math.radians(self.lon_deg)
        slat, clat, slon, clon = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
        return np.array([[-slat * clon, -slat * slon, clat], [-slon, clon, 0.0], [-clat * clon, -clat * slon, -slat]])

    @property
    def earth_rate_n(self) -> Array:
        """Earth rate in n, rad/s (Groves 2013, eq. 5.41)."""
        lat = math.radians(self.lat_deg)
        return np.array([EARTH_RATE * math.cos(lat), 0.0, -EARTH_RATE * math.sin(lat)])

    @property
    def gravity(self) -> float:
        """Magnitude of gravity at the origin, m/s^2."""
        return normal_gravity(math.radians(self.lat_deg), self.alt_m)


def _ecef(lat_deg: float, lon_deg: float, alt_m: float) -> Vec3:
    x, y, z = pymap3d.geodetic2ecef(lat_deg, lon_deg, alt_m, _WGS84)
    return float(x), float(y), float(z)


_of_origin = lru_cache(maxsize=8)(_ecef)


def normal_gravity(lat_rad: float, alt_m: float) -> float:
    """Gravity on and above the WGS-84 ellipsoid, m/s^2.

    g0 = 9.7803253359 (1 + 0.001931853 s^2) / sqrt(1 - e^2 s^2),  s = sin(lat)         (Somigliana; Groves 2013, eq. 2.134)
    g(h) = g0 (1 - 2 h / a)                                                      (first term of Groves 2013, eq. 2.139)
    """
    s2 = math.sin(lat_rad) ** 2
    g0 = 9.7803253359 * (1.0 + 0.001931853 * s2) / math.sqrt(1.0 - _E2 * s2)
    return g0 * (1.0 - 2.0 * alt_m / _EARTH_RADIUS)


@njit(cache=True)
def _geodetic(north: float, east: float, down: float, lat0: float, lon0: float, alt0: float) -> tuple[float, float, float]:
    """Latitude, longitude [rad], height [m] in n with origin lat0, lon0 [rad], alt0 [m].

    Bowring (1976), iterated: below 1e-9 m up to 100 km of height; pymap3d takes 200 us, too slow at 30 Hz.
    """
    slat, clat, slon, clon = math.sin(lat0), math.cos(lat0), math.sin(lon0), math.cos(lon0)
    radius = _EARTH_RADIUS / math.sqrt(1.0 - _E2 * slat * slat)
    outward = -slat * north - clat * down + (radius + alt0) * clat
    x, y = clon * outward - slon * east, slon * outward + clon * east
    z = clat * north - slat * down + (radius * (1.0 - _E2) + alt0) * slat
    p = math.hypot(x, y)
    flat = math.sqrt(1.0 - _E2)
    beta = math.atan2(z, flat * p)
    lat = 0.0
    for _ in range(3):
        s, c = math.sin(beta), math.cos(beta)
        lat = math.atan2(z + _E2 / (1.0 - _E2) * flat * _EARTH_RADIUS * s * s * s, p - _E2 * _EARTH_RADIUS * c * c * c)
        beta = math.atan2(flat * math.sin(lat), math.cos(lat))
    s, c = math.sin(lat), math.cos(lat)
    alt = p * c + z * s - _EARTH_RADIUS * math.sqrt(1.0 - _E2 * s * s)
    return lat, math.atan2(y, x), alt
