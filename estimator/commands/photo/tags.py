"""Tags of a photo: EXIF (CIPA DC-008) and the makers' XMP.

    angles   DJI, Autel: Gimbal*Degree; Parrot: Camera*Degree           pitch 0 at the horizon, -90 straight down
             senseFly, Sentera, Pix4D: Camera:Yaw, Pitch, Roll          pitch 0 straight down
    height   RelativeAltitude: above the take-off point; AboveGroundAltitude; GPSAltitude, AbsoluteAltitude: above the sea

Output: R_nb = Rz(yaw) Ry(pitch) Rx(roll); straight down is pitch -90, the photo's upper edge towards `yaw`.
"""

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from calib.errors import CalibrationError
from models.untrusted.boundary import refusing

_EXIF_IFD, _GPS_IFD = 0x8769, 0x8825
_MAKE, _MODEL, _SOFTWARE = 0x010F, 0x0110, 0x0131
_TAKEN, _FOCAL_MM, _FOCAL_35_MM, _ZOOM = 0x9003, 0x920A, 0xA405, 0xA404
_PLANE_RESOLUTION, _PLANE_UNIT = 0xA20E, 0xA210
_TAKEN_WIDTH, _TAKEN_HEIGHT = 0xA002, 0xA003
_UNIT_MM: Final = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
_LAT_REF, _LAT, _LON_REF, _LON, _ALT_REF, _ALT, _STATUS = 1, 2, 3, 4, 5, 6, 9
_BELOW, _ABOVE_ELLIPSOID, _BELOW_ELLIPSOID = 1, 2, 3  # GPSAltitudeRef of EXIF 3.0
_MOST_XMP = 1_000_000  # bytes
_CAMERA_SPACE = re.compile(r"camera/1\.0/?$", re.IGNORECASE)
_RTK: Final = {16.0, 34.0, 50.0}  # DJI's RtkFlag: single point, float, fixed; heights are above the ellipsoid then
_DEWARP_NUMBERS: Final = 9  # fx fy cx cy k1 k2 p1 p2 k3
_PARROT: Final = "parrot"
_EDITORS: Final = ("microsoft", "adobe", "gimp", "photos", "picasa", "lightroom", "snapseed", "paint", "acdsee", "irfan")


@dataclass(frozen=True, slots=True)
class Tags:
    """Tags, None where unusable.

    altitude_m: above sea or ellipsoid; attitude_deg: roll, pitch, yaw; sigma_m: horizontal, vertical; taken_s: local clock;
    dewarp: fx fy cx cy k1 k2 p1 p2 k3, (cx, cy) from the middle; zoom: digital.
    """

    width: int
    height: int
    taken_px: tuple[int, int]
    make: str = ""
    model: str = ""
    taken_s: float | None = None
    lat_lon_deg: tuple[float, float] | None = None
    altitude_m: float | None = None
    above_ellipsoid: bool = False
    above_takeoff_m: float | None = None
    above_ground_m: float | None = None
    attitude_deg: tuple[float, float, float] | None = None
    flight_yaw_deg: float | None = None
    sigma_m: tuple[float, float] | None = None
    focal_mm: float | None = None
    focal_35_mm: float | None = None
    focal_px: float | None = None
    px_per_mm: float | None = None
    dewarp: tuple[float, ...] | None = None
    dewarped: bool = False
    zoom: float = 1.0
    edited_by: str = ""


def read(path: Path) -> Tags:
    """Tags of a photo. Raises CalibrationError where it is no image."""
    from PIL import Image

    with warnings.catch_warnings(action="ignore"), refusing(CalibrationError, path), Image.open(path) as photo:
        try:
            every = photo.getexif()
            exif: Mapping[int, Any] = {**every, **every.get_ifd(_EXIF_IFD)}
            gps: Mapping[int, Any] = every.get_ifd(_GPS_IFD)
        except Exception:  # torn tags are no tags
            exif, gps = {}, {}
        return _tags(photo.size, exif, gps, _xmp(photo.info.get("xmp", b"")))


def _tags(size: tuple[int, int], exif: Mapping[int, Any], gps: Mapping[int, Any], xmp: Mapping[str, str]) -> Tags:
    make, software = _text(exif.get(_MAKE)), _text(exif.get(_SOFTWARE))
    altitude, above_ellipsoid = _altitude(gps, xmp)
    plane, unit = _number(exif.get(_PLANE_RESOLUTION)), _UNIT_MM.get(exif.get(_PLANE_UNIT, 0))
    taken = int(_above_0(exif.get(_TAKEN_WIDTH)) or size[0]), int(_above_0(exif.get(_TAKEN_HEIGHT)) or size[1])
    return Tags(
        *size,
        taken_px=taken,
        make=make,
        model=_text(exif.get(_MODEL)),
        taken_s=_taken(_text(exif.get(_TAKEN))),
        lat_lon_deg=_place(gps, xmp),
        altitude_m=altitude,
        above_ellipsoid=above_ellipsoid,
        above_takeoff_m=_of(xmp, "RelativeAltitude"),
        above_ground_m=_of(xmp, "Camera:AboveGroundAltitude"),
        attitude_deg=_attitude(xmp, make),
        flight_yaw_deg=_of(xmp, "FlightYawDegree"),
        sigma_m=_sigma(xmp),
        focal_mm=_above_0(exif.get(_FOCAL_MM)),
        focal_35_mm=_above_0(exif.get(_FOCAL_35_MM)),
        focal_px=_above_0(xmp.get("CalibratedFocalLength")),
        px_per_mm=plane / unit if plane and unit and plane > 0.0 else None,
        dewarp=_dewarp(xmp.get("DewarpData", "")),
        dewarped=_of(xmp, "DewarpFlag") == 1.0,
        zoom=_above_0(exif.get(_ZOOM)) or 1.0,
        edited_by=software if any(word in software.lower() for word in _EDITORS) else "",
    )


def _xmp(packet: bytes | str) -> dict[str, str]:
    """Names without namespace, except "Camera:"; empty for invalid XML or entities."""
    data = packet.encode() if isinstance(packet, str) else packet
    data = data.strip(b"\0 \r\n\t")
    if not 0 < len(data) <= _MOST_XMP or b"<!" in data:
        return {}
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError:
        return {}
    found: dict[str, str] = {}
    for element in root.iter():
        for name, value in (*element.attrib.items(), (element.tag, element.text or "")):
            space, _, local = name.rpartition("}")
            key = f"Camera:{local}" if _CAMERA_SPACE.search(space) else local
            if value.strip():
                found.setdefault(key, value.strip())
    return found


def _attitude(xmp: Mapping[str, str], make: str) -> tuple[float, float, float] | None:
    for group in ("Gimbal{}Degree", "Camera{}Degree"):
        roll, pitch, yaw = (_of(xmp, group.format(axis)) for axis in ("Roll", "Pitch", "Yaw"))
        if pitch is not None and yaw is not None:
            return roll or 0.0, pitch, yaw
    roll, pitch, yaw = (_of(xmp, f"Camera:{axis}") for axis in ("Roll", "Pitch", "Yaw"))
    if pitch is None or yaw is None:
        return None
    from_horizon = make.lower() == _PARROT or pitch <= -45.0  # straight down and half backwards: it is the other convention
    return roll or 0.0, pitch if from_horizon else pitch - 90.0, yaw


def _place(gps: Mapping[int, Any], xmp: Mapping[str, str]) -> tuple[float, float] | None:
    """Degrees, XMP's first (more digits); None: no fix, written as zeros or V."""
    lat, lon = _of(xmp, "GpsLatitude"), _of(xmp, "GpsLongitude")
    if lon is None:
        lon = _of(xmp, "GpsLongtitude")  # as DJI spells it
    if lat is None or lon is None:
        lat, lon = _degrees(gps.get(_LAT), gps.get(_LAT_REF), "S"), _degrees(gps.get(_LON), gps.get(_LON_REF), "W")
    if lat is None or lon is None or not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
        return None
    void = _text(gps.get(_STATUS)).upper() == "V" or xmp.get("GpsStatus", "").lower() in {"invalid", "unlocked"}
    return None if void or (lat == 0.0 and lon == 0.0) else (lat, lon)


def _altitude(gps: Mapping[int, Any], xmp: Mapping[str, str]) -> tuple[float | None, bool]:
    dji, rtk = _of(xmp, "AbsoluteAltitude"), _of(xmp, "RtkFlag") in _RTK
    if dji is not None:
        return dji, rtk
    height, reference = _number(gps.get(_ALT)), gps.get(_ALT_REF, b"\0")
    kind = reference[0] if isinstance(reference, bytes) and reference else reference
    if height is None:
        return None, False
    return (-height if kind in {_BELOW, _BELOW_ELLIPSOID} else height), kind in {_ABOVE_ELLIPSOID, _BELOW_ELLIPSOID}


def _sigma(xmp: Mapping[str, str]) -> tuple[float, float] | None:
    if _of(xmp, "RtkFlag") in _RTK:
        north, east, up = (_of(xmp, f"RtkStd{axis}") for axis in ("Lat", "Lon", "Hgt"))
        across, up = max(north or 0.0, east or 0.0), up or 0.0
    else:
        across, up = (_of(xmp, f"Camera:GPS{axis}Accuracy") or 0.0 for axis in ("XY", "Z"))
    return (across, up) if across > 0.0 and up > 0.0 else None


def _dewarp(text: str) -> tuple[float, ...] | None:
    """DJI's DewarpData, "date;fx,fy,cx,cy,k1,k2,p1,p2,k3"."""
    numbers = [_number(part) for part in text.rpartition(";")[2].split(",")]
    found = tuple(n for n in numbers if n is not None)
    return found if len(found) == len(numbers) == _DEWARP_NUMBERS and min(found[:2]) > 0.0 else None


def _taken(text: str) -> float | None:
    try:
        return datetime.strptime(text, "%Y:%m:%d %H:%M:%S").replace(tzinfo=UTC).timestamp()
    except ValueError:
        return None


def _degrees(parts: Any, reference: Any, negative: str) -> float | None:
    try:
        numbers = [_number(part) for part in parts]
    except TypeError:
        return None
    if len(numbers) != 3 or None in numbers:
        return None
    degrees = sum(n / 60.0**k for k, n in enumerate(numbers) if n is not None)
    return -degrees if _text(reference).upper() == negative else degrees


def _of(xmp: Mapping[str, str], name: str) -> float | None:
    return _number(xmp.get(name))


def _above_0(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0.0 else None


def _number(value: Any) -> float | None:
    try:
        if isinstance(value, str) and "/" in value:
            above, below = value.split("/")
            number = float(above) / float(below)
        else:
            number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _text(value: Any) -> str:
    text = value.decode("ascii", "ignore") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    return text.partition("\0")[0].strip()
