"""A planned route, flown at constant speed with rounded corners.

GPX       tracks, routes, waypoints       GeoJSON   the first LineString       CSV, text   latitude, longitude a line
"""

import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.ndimage import gaussian_filter1d

from models.frames import GRAVITY_N, Origin
from models.maps.table import MapError
from models.messages import Array
from models.untrusted.file import content

RATE_HZ = 50.0
HOVER_S = 25.0  # with GNSS at the start: the estimate begins
_ROUND_S = 1.5  # standard deviation of what rounds corners
_MOST_POINTS, _MOST_BYTES = 100_000, 64 * 2**20
_MOST_S = 36_000.0


@dataclass(frozen=True, slots=True)
class Flight:
    """At RATE_HZ, hover below HOVER_S; s_m (n,): distance; p_n, v_n (n, 3); accel_b (n, 3) level; heading_rad: first leg."""

    t_s: Array
    s_m: Array
    p_n: Array
    v_n: Array
    accel_b: Array
    heading_rad: float


def read(path: Path) -> Array:
    """Latitudes and longitudes (n, 2). Raises MapError."""
    try:
        text = content(path, _MOST_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise MapError(f"{path}: cannot be read ({error})") from None
    try:
        points = {"<": _gpx, "{": _geojson}.get(text.lstrip()[:1], _lines)(text)
    except Exception:  # whatever a text that is none of the three trips over
        points = []
    places = np.array(points, float).reshape(-1, 2)
    if not 2 <= len(places) <= _MOST_POINTS or not np.isfinite(places).all() or (np.abs(places) > (90.0, 180.0)).any():
        raise MapError(f"{path}: holds no route: GPX, a GeoJSON LineString, or lines of latitude, longitude; two points or more")
    return places


def _gpx(text: str) -> list[tuple[float, float]]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("GPX has no entities of its own")
    found = [e for e in ElementTree.fromstring(text).iter() if e.tag.rpartition("}")[2] in {"trkpt", "rtept", "wpt"}]
    return [(float(e.attrib["lat"]), float(e.attrib["lon"])) for e in found]


def _geojson(text: str) -> list[tuple[float, float]]:
    document: Any = json.loads(text)
    features = document["features"] if document["type"] == "FeatureCollection" else [document]
    geometries = [f.get("geometry", f) for f in features]
    lines = [g for g in geometries if g["type"] == "LineString"]
    return [(float(p[1]), float(p[0])) for p in lines[0]["coordinates"]]


def _lines(text: str) -> list[tuple[float, float]]:
    numbers = (re.findall(r"-?\d+(?:\.\d+)?", line) for line in text.splitlines() if line[:1].isdigit() or line[:1] == "-")
    return [(float(n[0]), float(n[1])) for n in numbers if len(n) >= 2]


def fly(places: Array, origin: Origin, height_m: float, speed_m_s: float) -> Flight:
    """The flight at a height above the map's origin. Raises MapError.

    p(t) = (g * p_corners)(t), v = dp/dt,  f_b = R_nb^T (d2p/dt2 - g_n)         g: a Gaussian of 1.5 s
    """
    corners = np.array([origin.to_ned(lat, lon, origin.alt_m)[:2] for lat, lon in places])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    length_s = along[-1] / speed_m_s
    if not 5.0 < length_s < _MOST_S:
        raise MapError(f"the route takes {length_s:.0f} s at {speed_m_s:g} m/s: wanted are 5 s to {_MOST_S / 3600:g} hours")
    t_s = np.arange(0.0, HOVER_S + length_s + 3.0 * _ROUND_S, 1.0 / RATE_HZ)
    s_m = np.clip((t_s - HOVER_S) * speed_m_s, 0.0, along[-1])
    way = np.column_stack([np.interp(s_m, along, corners[:, k]) for k in range(2)])
    p_n = np.full((len(t_s), 3), -height_m)
    p_n[:, :2] = gaussian_filter1d(way, _ROUND_S * RATE_HZ, axis=0, mode="nearest")
    v_n = np.gradient(p_n, 1.0 / RATE_HZ, axis=0)
    force_n = np.gradient(v_n, 1.0 / RATE_HZ, axis=0) - GRAVITY_N
    first = corners[np.flatnonzero(along > 0.0)[0]] - corners[0]
    heading = math.atan2(first[1], first[0])
    c, s = math.cos(heading), math.sin(heading)
    accel_b = np.column_stack((c * force_n[:, 0] + s * force_n[:, 1], -s * force_n[:, 0] + c * force_n[:, 1], force_n[:, 2]))
    return Flight(t_s, s_m, p_n, v_n, accel_b, heading)
