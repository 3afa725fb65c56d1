"""UTM and web Mercator coordinates <-> longitude and latitude, WGS-84."""

import math

import numpy as np

from models.messages import Array

_A = 6_378_137.0  # m, WGS-84 semi-major axis
_N = 1.0 / (2.0 * 298.257223563 - 1.0)  # third flattening n = f / (2 - f)
_N2, _N3, _N4 = _N**2, _N**3, _N**4
_RADIUS = _A / (1.0 + _N) * (1.0 + _N2 / 4.0 + _N4 / 64.0)  # of the rectifying sphere
_ALPHA = (
    _N / 2 - 2 * _N2 / 3 + 5 * _N3 / 16 + 41 * _N4 / 180,
    13 * _N2 / 48 - 3 * _N3 / 5 + 557 * _N4 / 1440,
    61 * _N3 / 240 - 103 * _N4 / 140,
    49_561 * _N4 / 161_280,
)
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
    """Longitude, latitude [deg] (N, 2) of EPSG 4326, 32601-32660, 32701-32760 or 3857; else None."""
    if epsg in _DEGREES:
        return xy
    if epsg == 3857:
        mercator: Array = np.degrees(np.column_stack((xy[:, 0] / _A, np.arctan(np.sinh(xy[:, 1] / _A)))))
        return mercator
    zone = _zone(epsg)
    return None if zone is None else _inverse(xy, *zone)


def from_lonlat(epsg: int, lonlat: Array) -> Array | None:
    """The inverse of to_lonlat."""
    if epsg in _DEGREES:
        return lonlat
    if epsg == 3857:
        lon, lat = np.radians(lonlat.T)
        return _A * np.column_stack((lon, np.arcsinh(np.tan(lat))))
    zone = _zone(epsg)
    return None if zone is None else _forward(lonlat, *zone)


def _zone(epsg: int) -> tuple[float, float] | None:
    """Central meridian [rad] and false northing [m] of a UTM zone."""
    number, south = epsg % 100, epsg // 100 == 327
    if epsg // 100 not in (326, 327) or not 1 <= number <= 60:
        return None
    return math.radians(6.0 * number - 183.0), 10_000_000.0 if south else 0.0


def _inverse(xy: Array, lon0: float, false_north: float) -> Array:
    """Krueger's series (Karney 2011, eq. 11-15, 35-36): below 1 mm."""
    xi, eta = (xy[:, 1] - false_north) / (0.9996 * _RADIUS), (xy[:, 0] - 500_000.0) / (0.9996 * _RADIUS)
    waves = [(beta, 2.0 * (j + 1)) for j, beta in enumerate(_BETA)]
    xi_sphere = xi - sum(beta * np.sin(m * xi) * np.cosh(m * eta) for beta, m in waves)
    eta_sphere = eta - sum(beta * np.cos(m * xi) * np.sinh(m * eta) for beta, m in waves)
    chi = np.arcsin(np.sin(xi_sphere) / np.cosh(eta_sphere))
    lat = chi + sum(delta * np.sin(2.0 * (j + 1) * chi) for j, delta in enumerate(_DELTA))
    lon = lon0 + np.arctan2(np.sinh(eta_sphere), np.cos(xi_sphere))
    lonlat: Array = np.degrees(np.column_stack((lon, lat)))
    return lonlat


def _forward(lonlat: Array, lon0: float, false_north: float) -> Array:
    """Transverse Mercator, by way of the conformal latitude (Karney 2011, eq. 7-11, 35)."""
    lon, lat = np.radians(lonlat[:, 0]) - lon0, np.radians(lonlat[:, 1])
    tau, e = np.tan(lat), 2.0 * math.sqrt(_N) / (1.0 + _N)
    sigma = np.sinh(e * np.arctanh(e * np.sin(lat)))
    tau_sphere = tau * np.hypot(1.0, sigma) - sigma * np.hypot(1.0, tau)
    xi_sphere, eta_sphere = np.arctan2(tau_sphere, np.cos(lon)), np.arcsinh(np.sin(lon) / np.hypot(tau_sphere, np.cos(lon)))
    waves = [(alpha, 2.0 * (j + 1)) for j, alpha in enumerate(_ALPHA)]
    xi = xi_sphere + sum(alpha * np.sin(m * xi_sphere) * np.cosh(m * eta_sphere) for alpha, m in waves)
    eta = eta_sphere + sum(alpha * np.cos(m * xi_sphere) * np.sinh(m * eta_sphere) for alpha, m in waves)
    xy: Array = 0.9996 * _RADIUS * np.column_stack((eta, xi)) + np.array([500_000.0, false_north])
    return xy
