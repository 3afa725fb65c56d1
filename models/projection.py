"""Plane coordinates of public map data -> longitude and latitude: UTM and the web's Mercator, both on WGS-84."""

import math

import numpy as np

from models.messages import Array

_A = 6_378_137.0  # m, WGS-84 semi-major axis
_N = 1.0 / (2.0 * 298.257223563 - 1.0)  # third flattening n = f / (2 - f)
_N2, _N3, _N4 = _N**2, _N**3, _N**4
_RADIUS = _A / (1.0 + _N) * (1.0 + _N2 / 4.0 + _N4 / 64.0)  # of the rectifying sphere
_BETA = (
    _N / 2 - 2 * _N2 / 3 + 37 * _N3 / 96 - _N4 / 360,
    _N2 / 48 + _N3 / 15 - 437 * _N4 / 1440,
    17 * _N3 / 480 - 37 * _N4 / 840,
    4397 * _N4 / 161_280,
)
_DELTA = (
    2 * _N - 2 * _N2 / 3 - 2 * _N3 + 116 * _N4 / 45,
    7 * _N2 / 3 - 8 * _N3 / 5 - 227 * _N4 / 45,
    56 * _N3 / 15 - 136 * _N4 / 35,
    4279 * _N4 / 630,
)
_DEGREES = (4326, 4979)  # WGS 84 in degrees, GeoJSON's own; the second has heights


def to_lonlat(epsg: int, xy: Array) -> Array | None:
    """Longitude and latitude [deg] (N, 2) of coordinates (N, 2) in an EPSG system; None where the system is not known here.

    Known: WGS 84 (4326), WGS 84 / UTM (32601-32660, 32701-32760), web Mercator (3857).
    """
    if epsg in _DEGREES:
        return xy
    if epsg == 3857:
        mercator: Array = np.degrees(np.column_stack((xy[:, 0] / _A, np.arctan(np.sinh(xy[:, 1] / _A)))))
        return mercator
    zone, south = epsg % 100, epsg // 100 == 327
    if epsg // 100 in (326, 327) and 1 <= zone <= 60:
        return _utm(xy, math.radians(6.0 * zone - 183.0), 10_000_000.0 if south else 0.0)
    return None


def _utm(xy: Array, lon0: float, false_north: float) -> Array:
    """Inverse transverse Mercator, Krueger's series in n to the fourth order (Karney 2011, eq. 11-15, 35-36): below 1 mm."""
    xi, eta = (xy[:, 1] - false_north) / (0.9996 * _RADIUS), (xy[:, 0] - 500_000.0) / (0.9996 * _RADIUS)
    waves = [(beta, 2.0 * (j + 1)) for j, beta in enumerate(_BETA)]
    xi_sphere = xi - sum(beta * np.sin(m * xi) * np.cosh(m * eta) for beta, m in waves)
    eta_sphere = eta - sum(beta * np.cos(m * xi) * np.sinh(m * eta) for beta, m in waves)
    chi = np.arcsin(np.sin(xi_sphere) / np.cosh(eta_sphere))
    lat = chi + sum(delta * np.sin(2.0 * (j + 1) * chi) for j, delta in enumerate(_DELTA))
    lon = lon0 + np.arctan2(np.sinh(eta_sphere), np.cos(xi_sphere))
    lonlat: Array = np.degrees(np.column_stack((lon, lat)))
    return lonlat
