"""Pose of a photo from its tags, with sigmas.

    alt = ground + height above take-off,     or the height above the sea + N (EGM96), in this order
    sigma: 3 m north and east, 2 m and 5 % of the height (10 m of a height above the sea), 1.5 degrees of tilt, 3.5 of heading

Body = camera: R_nb = R(roll, pitch, yaw of the gimbal) Ry(90 deg). The 2 m: uneven ground. A camera's own sigma is doubled, at
least 0.5 m, for trigger, antenna, datum.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from calib.errors import CalibrationError
from calib.files.rig_yaml import FORWARD
from estimator.commands.photo.tags import Tags
from estimator.map_files import geoid
from models import so3
from models.frames import Origin
from models.prior import Prior

_ACROSS_M, _HEIGHT_M, _HEIGHT_SHARE, _SEA_M = 3.0, 2.0, 0.05, 10.0
_TILT_DEG, _HEADING_DEG = 1.5, 3.5
_CLAIMED: Final = 2.0
_BEST_M: Final = 0.5  # of an RTK position: trigger and antenna are not the camera's
DOWN: Final = so3.matrix(so3.from_euler(0.0, -0.5 * math.pi, 0.0)) @ FORWARD  # R_bc of the camera as the body
_LOWEST_M, _HIGHEST_M = 2.0, 5000.0  # above the ground, of a photo that can be located


def prior_of(
    tags: Tags, frame: Origin, ground_d: Callable[[float, float], float], height_m: float | None, where: str,
    camera_pitch_deg: float | None = None,
) -> Prior:  # fmt: skip
    """Prior pose in n; ground_d(north, east): down of the ground; height_m: above it; camera_pitch_deg: from the horizon. Raises
    CalibrationError.
    """
    if tags.lat_lon_deg is None:
        raise CalibrationError(f"{where}: no position in its tags (EXIF, XMP): give --prior LAT,LON,ALT,ROLL,PITCH,YAW")
    attitude_deg = _attitude(tags, camera_pitch_deg, where)
    lat, lon = tags.lat_lon_deg
    north, east, _ = frame.to_ned(lat, lon, frame.alt_m)
    ground_alt_m = frame.to_geodetic(np.array([north, east, ground_d(north, east)]))[2]
    height, height_sigma = _height(tags, ground_alt_m, height_m, where)
    if not _LOWEST_M < height < _HIGHEST_M:
        raise CalibrationError(
            f"{where}: {height:.0f} m above the map's ground, which is at {ground_alt_m:.0f} m above the ellipsoid: give the "
            "height above the ground, --height-m, or the map's, landfix map build --origin LAT,LON,ALT"
        )
    across = _ACROSS_M
    if tags.sigma_m is not None:
        across = max(_CLAIMED * tags.sigma_m[0], _BEST_M)
    sigma = np.array([across, across, height_sigma, *np.deg2rad([_TILT_DEG, _TILT_DEG, _HEADING_DEG])])
    p_n = np.array(frame.to_ned(lat, lon, ground_alt_m + height))
    gimbal = so3.from_euler(*(math.radians(a) for a in attitude_deg))
    return Prior(p_n, so3.normalise(so3.multiply(gimbal, so3.from_euler(0.0, 0.5 * math.pi, 0.0))), np.diag(sigma**2))


def _attitude(tags: Tags, camera_pitch_deg: float | None, where: str) -> tuple[float, float, float]:
    """0, 0, 0 is what a camera without a gimbal writes."""
    if camera_pitch_deg is not None:
        if tags.flight_yaw_deg is None:
            raise CalibrationError(f"{where}: no heading of the aircraft in its tags: give --prior LAT,LON,ALT,ROLL,PITCH,YAW")
        return 0.0, camera_pitch_deg, tags.flight_yaw_deg
    if tags.attitude_deg is None:
        raise CalibrationError(f"{where}: no camera angles in its tags (XMP): give --prior LAT,LON,ALT,ROLL,PITCH,YAW")
    if tags.attitude_deg == (0.0, 0.0, 0.0):
        raise CalibrationError(f"{where}: gimbal angles are 0: give --camera-pitch -90 if it looks down")
    return tags.attitude_deg


def _height(tags: Tags, ground_alt_m: float, height_m: float | None, where: str) -> tuple[float, float]:
    above = height_m if height_m is not None else tags.above_ground_m if tags.above_ground_m is not None else tags.above_takeoff_m
    if above is not None:
        return above, math.hypot(_HEIGHT_M, _HEIGHT_SHARE * above)
    if tags.altitude_m is None or tags.lat_lon_deg is None:
        raise CalibrationError(f"{where}: no height in its tags (EXIF, XMP): give the height above the ground, --height-m")
    if tags.above_ellipsoid:
        return tags.altitude_m - ground_alt_m, _SEA_M if tags.sigma_m is None else math.hypot(_HEIGHT_M, tags.sigma_m[1])
    return tags.altitude_m + geoid.geoid_m(*tags.lat_lon_deg) - ground_alt_m, math.hypot(_SEA_M, geoid.SIGMA_M)
