"""Outer rings in degrees with properties."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from models.messages import Array

METRES_A_DEGREE = 111_320.0  # of latitude; of longitude at the equator


class Footprint(NamedTuple):
    """ring (n, 2): longitude, latitude [deg]; id: of the source, or empty."""

    ring: Array
    properties: Mapping[str, Any]
    id: str


class Place(NamedTuple):
    """A circle on Earth."""

    lat_deg: float
    lon_deg: float
    radius_m: float

    def holds(self, ring: Array) -> bool:
        """Whether a ring's middle lies inside, also across the 180th meridian."""
        if not np.isfinite(ring).all() or np.abs(ring[:, 1]).max() > 90.0:
            return False
        east = wrapped(ring[:, 0] - self.lon_deg).mean() * math.cos(math.radians(self.lat_deg))
        return math.hypot(east, ring[:, 1].mean() - self.lat_deg) * METRES_A_DEGREE <= self.radius_m

    @property
    def boxes(self) -> list[tuple[float, float, float, float]]:
        """West, south, east, north [deg]: one box, or two at the 180th meridian."""
        high = 1.1 * self.radius_m / METRES_A_DEGREE
        wide = min(180.0, high / max(math.cos(math.radians(min(89.0, abs(self.lat_deg) + high))), 1e-3))
        south, north = max(-90.0, self.lat_deg - high), min(90.0, self.lat_deg + high)
        west, east = self.lon_deg - wide, self.lon_deg + wide
        if west < -180.0:
            return [(-180.0, south, east, north), (west + 360.0, south, 180.0, north)]
        if east > 180.0:
            return [(west, south, 180.0, north), (-180.0, south, east - 360.0, north)]
        return [(west, south, east, north)]


def wrapped(lon_deg: Array) -> Array:
    """Differences of longitude within 180 degrees."""
    return np.asarray(np.mod(lon_deg + 180.0, 360.0) - 180.0)


def rings(kind: str, coordinates: Any) -> list[Array]:
    """Outer rings (n, 2) of a GeoJSON geometry, without heights. Raises ValueError."""
    polygons: Sequence[Any] = {"Polygon": [coordinates], "MultiPolygon": coordinates}.get(kind, [])
    return [_ring([point[:2] for point in polygon[0]]) for polygon in polygons if polygon and polygon[0]]


def _ring(points: Sequence[Sequence[float]]) -> Array:
    ring = np.array(points, dtype=float)
    if ring.ndim != 2 or ring.shape[1] != 2:
        raise ValueError("a corner is not two numbers")
    return ring
