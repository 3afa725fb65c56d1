"""The autopilot's local frame, metres from its EKF's origin (lat, lon in degrees, h above the sea):

    ArduPilot (Location.cpp, get_distance_NE)      north = k (lat - lat0),  k = 111318.845 m
                                                   east  = k (lon - lon0) max(cos((lat + lat0) / 2), 0.01)
    PX4 (geo.cpp, MapProjection::project)          azimuthal equidistant, R = 6371000 m:
                                                   c = arccos(sin lat0 sin lat + cos lat0 cos lat cos(lon - lon0))
                                                   north = R c / sin c (cos lat0 sin lat - sin lat0 cos lat cos(lon - lon0))
                                                   east  = R c / sin c  cos lat sin(lon - lon0)
    both                                           down  = h0 - h

North and down are those at the vehicle: R = C_place C_origin^T R_nb, C the rows north, east, down in ECEF.
"""

import math
from typing import Final

import numpy as np

from models import so3
from models.frames import Origin
from models.messages import Array, Estimate, Vec3, vec3
from models.state import X

_METRES_PER_DEGREE: Final = 111_318.845_021_450_34
_LEAST_SCALE: Final = 0.01  # of a degree of longitude
_PX4_RADIUS_M: Final = 6_371_000.0
_MOST_LAT_DEG, _MOST_LON_DEG = 90.0, 180.0


class LocalOrigin:
    """As the autopilot has sent it."""

    def __init__(self) -> None:
        self.place: Vec3 | None = None  # degrees, and m above the sea

    def hear(self, lat_deg: float, lon_deg: float, sea_m: float) -> None:
        """Set its origin; sea_m: height above the sea. Raises ValueError."""
        is_place = abs(lat_deg) <= _MOST_LAT_DEG and abs(lon_deg) <= _MOST_LON_DEG and math.isfinite(sea_m)
        if not is_place or lat_deg == lon_deg == 0.0:
            raise ValueError(f"latitude, longitude = {lat_deg:g}, {lon_deg:g} deg, height {sea_m:g} m: is no place")
        self.place = lat_deg, lon_deg, sea_m

    def forget(self) -> None:
        """There may be another one by now."""
        self.place = None

    def pose(self, e: Estimate, geoid_m: float, *, is_px4: bool = False) -> tuple[Vec3, Array] | None:
        """Position in that frame [m] and q_nb; None: an origin is unknown."""
        origin, place = Origin.of(e.origin), self.place  # another thread may forget it meanwhile
        if place is None or origin is None:
            return None
        lat0, lon0, sea0 = place
        lat, lon, ellipsoid = origin.to_geodetic(e.nav[X.P])
        north, east = (_px4_plane if is_px4 else _ardupilot_plane)(lat0, lon0, lat, lon)
        turn = Origin(lat, lon, ellipsoid).axes_e @ origin.axes_e.T
        return (north, east, sea0 - (ellipsoid - geoid_m)), so3.multiply(so3.from_matrix(turn), so3.normalise(e.nav[X.Q]))

    def report(self, ours: tuple[float, float, float] | None, geoid_m: float, *, from_ours: bool = False) -> str:
        """Distance from our origin; ours: deg, deg, m."""
        place = self.place
        if place is None:
            return "not known: ODOMETRY " + ("is from ours" if from_ours else "has quality -1")
        if ours is None:
            return "known, but not ours: ODOMETRY has quality -1; set [map] origin"
        lat, lon, sea = place
        north, east, down = vec3(np.round(Origin(*ours).to_ned(lat, lon, sea + geoid_m), 1))
        return f"{north:g} m north, {east:g} m east, {0.0 - down:g} m above the map's"


def _ardupilot_plane(lat0: float, lon0: float, lat: float, lon: float) -> tuple[float, float]:
    scale = max(math.cos(math.radians(0.5 * (lat + lat0))), _LEAST_SCALE)
    east_deg = (lon - lon0 + 180.0) % 360.0 - 180.0
    return _METRES_PER_DEGREE * (lat - lat0), _METRES_PER_DEGREE * scale * east_deg


def _px4_plane(lat0: float, lon0: float, lat: float, lon: float) -> tuple[float, float]:
    phi0, phi, turn = math.radians(lat0), math.radians(lat), math.radians(lon - lon0)
    north = math.cos(phi0) * math.sin(phi) - math.sin(phi0) * math.cos(phi) * math.cos(turn)
    east = math.cos(phi) * math.sin(turn)
    c = math.atan2(math.hypot(north, east), math.sin(phi0) * math.sin(phi) + math.cos(phi0) * math.cos(phi) * math.cos(turn))
    k = _PX4_RADIUS_M * (c / math.sin(c) if c > 0.0 else 1.0)
    return k * north, k * east
