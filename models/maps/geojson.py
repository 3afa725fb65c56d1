"""The map's file: GeoJSON roof edges in WGS-84 or a `crs` member's system (docs/map.md)."""

import math
import re
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pymap3d
from numpy.typing import NDArray

from models.maps import colours, projection
from models.maps import outline as polygon
from models.maps.features import FEW, OurFeature, OurPolygon, OurProperties, Parts, features
from models.maps.table import Alike, Columns, Defaults, MapError, MapReport
from models.messages import Array, Vec3

TOLERANCE_M = 0.005  # corners nearer than this to the line between their neighbours are none
MIN_M2 = 0.01
MAX_CORNERS = polygon.LONG
MAX_LENGTH_M = 2000.0
MAX_DISTANCE_M = 100_000.0  # further out, "down" is 1 degree off the origin's

_ENOUGH = 2000  # outlines, to see what angles they have
_EXCHANGED = (
    "corners are right angles only with latitude and longitude exchanged: is it [latitude, longitude]? (GeoJSON: longitude first)"
)
_VERDICTS = {
    polygon.FEW: FEW,
    polygon.SMALL: f"smaller than {MIN_M2:g} m2",
    polygon.MANY: f"more than {MAX_CORNERS} corners: simplify the outline",
    polygon.CROSSED: "the outline crosses itself",
}


def read(data: bytes, defaults: Defaults) -> tuple[Vec3, Columns, MapReport, tuple[float, float], bool]:
    """Origin (lat_deg, lon_deg, alt_m), landmarks, findings. Raises MapError."""
    head, raw_features = features(data.removeprefix(b"\xef\xbb\xbf"))
    parts = Parts(defaults)
    for number, raw in enumerate(raw_features, 1):
        parts.add(number, raw)
    with np.errstate(over="ignore", invalid="ignore"):  # what is no place is rejected next
        lonlat = _lonlat(head.crs, np.array(parts.coordinates).reshape(-1, 2))
    counts = np.array(parts.counts, dtype=np.int64)
    offsets = np.concatenate(([0], np.cumsum(counts)))
    good = _in_range(parts, lonlat, offsets)
    table = np.array(parts.numbers).reshape(-1, 6)  # as in Attributes.numbers
    origin = defaults.origin or (head.landfix and head.landfix.origin) or _middle(lonlat, offsets, good, table[:, 4])
    if not _on_earth(origin):
        raise MapError(f"the origin {origin} is not a latitude, longitude and height")
    table[np.isnan(table[:, 4]), 4] = origin[2]
    vertices, base_d = _to_ned(origin, lonlat, offsets, ground=table[:, 4], roof=table[:, 4] + table[:, 0])
    good &= _in_reach(parts, origin, lonlat, vertices, offsets, good)
    vertices, ends, verdicts = polygon.repair(vertices, offsets, TOLERANCE_M, MIN_M2, MAX_CORNERS)
    for verdict, text in _VERDICTS.items():
        parts.reject(good & (verdicts == verdict), text)
    good &= (verdicts == polygon.GOOD) & _unique(parts, good & (verdicts == polygon.GOOD))
    kept = np.flatnonzero(good)
    columns = Columns(
        ids=[parts.ids[i] for i in kept.tolist()],
        vertices=vertices[np.repeat(good, np.diff(ends))],
        offsets=np.concatenate(([0], np.cumsum(np.diff(ends)[kept]))),
        base_d=base_d[kept],
        height_m=table[kept, 0],
        height_sigma_m=table[kept, 1],
        sigma_m=table[kept, 2],
        outline_sigma_m=table[kept, 3],
        corner_sigma_m=table[kept, 5],
        colour_bgr=np.array(parts.colours, dtype=np.int16).reshape(-1, 3)[kept],
        weights={row: parts.weights[i] for row, i in enumerate(kept.tolist()) if i in parts.weights},
        names={row: parts.names[i] for row, i in enumerate(kept.tolist()) if i in parts.names},
    )
    rejected = tuple(sorted(parts.rejected, key=lambda finding: finding.feature))
    doubt = _EXCHANGED if exchanged(lonlat[np.repeat(good, counts)], np.concatenate(([0], np.cumsum(counts[good])))) else ""
    common = defaults.common_sigma_m or (head.landfix.common_sigma_m if head.landfix else (0.0, 0.0))
    report = MapReport(len(raw_features), rejected, tuple(parts.remarks), parts.missed(kept), doubt)
    return origin, columns, report, common, head.landfix is not None and head.landfix.automatic


def _on_earth(origin: Vec3) -> bool:
    return abs(origin[0]) <= 90.0 and abs(origin[1]) <= 180.0 and math.isfinite(origin[2])


def exchanged(lonlat: Array, offsets: NDArray[np.int64]) -> bool:
    """Whether right angles need latitude and longitude exchanged."""
    lonlat, offsets = lonlat[: offsets[_ENOUGH]] if len(offsets) > _ENOUGH else lonlat, offsets[: _ENOUGH + 1]
    if len(lonlat) < 40 or np.abs(lonlat).max() > 90.0:
        return False
    after = np.arange(1, len(lonlat) + 1)
    after[offsets[1:] - 1] = offsets[:-1]
    sides = lonlat[after] - lonlat
    right = [_right_angles(sides * scale, after) for scale in (_metres(lonlat), _metres(lonlat[:, ::-1])[:, ::-1])]
    return right[1] > 0.5 and right[1] > right[0] + 0.25


def _metres(lonlat: Array) -> Array:
    return np.column_stack((np.cos(np.radians(lonlat[:, 1])), np.ones(len(lonlat))))


def _right_angles(sides: Array, after: NDArray[np.int64]) -> float:
    a, b = sides, sides[after]
    length = np.hypot(*a.T) * np.hypot(*b.T)
    dot = np.abs(np.sum(a * b, axis=1))
    return float(np.mean(dot[length > 0.0] < 0.05 * length[length > 0.0])) if np.any(length > 0.0) else 0.0


def _lonlat(crs: Any, xy: Array) -> Array:
    name = str(crs["properties"].get("name", "")) if isinstance(crs, dict) and isinstance(crs.get("properties"), dict) else ""
    if not name or "CRS84" in name:
        return xy
    epsg = re.search(r"EPSG:+(\d+)$", name)
    lonlat = projection.to_lonlat(int(epsg[1]), xy) if epsg else None
    if lonlat is None:
        raise MapError(f"coordinate system {name!r} is not known here: convert it with ogr2ogr -t_srs EPSG:4326 map.geojson FILE")
    return lonlat


def _any(condition: NDArray[np.bool_], offsets: NDArray[np.int64]) -> NDArray[np.bool_]:
    return np.logical_or.reduceat(condition, offsets[:-1]) if len(offsets) > 1 else np.empty(0, bool)


def _in_range(parts: Parts, lonlat: Array, offsets: NDArray[np.int64]) -> NDArray[np.bool_]:
    lon, lat = lonlat.T
    bad = _any(~((np.abs(lat) <= 90.0) & (np.abs(lon) <= 180.0)), offsets)
    swapped = bad & ~_any(~((np.abs(lon) <= 90.0) & (np.abs(lat) <= 180.0)), offsets)
    parts.reject(swapped, "latitude beyond 90 degrees: latitude and longitude exchanged? (GeoJSON has longitude first)")
    parts.reject(bad & ~swapped, "its coordinates are not longitude and latitude in degrees")
    return ~bad


def _middle(lonlat: Array, offsets: NDArray[np.int64], good: NDArray[np.bool_], ground_alt: Array) -> Vec3:
    lon, lat = lonlat[offsets[:-1][good]].T
    if len(lon) == 0:
        return 0.0, 0.0, 0.0
    known = ground_alt[~np.isnan(ground_alt)]
    alt = float(np.median(known)) if len(known) else 0.0
    return round(float(np.sort(lat)[len(lat) // 2]), 6), round(float(np.sort(lon)[len(lon) // 2]), 6), round(alt, 3)


def _to_ned(origin: Vec3, lonlat: Array, offsets: NDArray[np.int64], ground: Array, roof: Array) -> tuple[Array, Array]:
    counts = np.diff(offsets)
    north, east, _ = pymap3d.geodetic2ned(lonlat[:, 1], lonlat[:, 0], np.repeat(roof, counts), *origin)
    first = lonlat[offsets[:-1]]
    _, _, down = pymap3d.geodetic2ned(first[:, 1], first[:, 0], ground, *origin)
    return np.column_stack((north, east)), np.asarray(down, dtype=np.float64)


def _in_reach(
    parts: Parts, origin: Vec3, lonlat: Array, vertices: Array, offsets: NDArray[np.int64], good: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    counts = np.diff(offsets)
    first = vertices[offsets[:-1]]
    far = good & (np.hypot(*first.T) > MAX_DISTANCE_M)
    texts = []
    for i in np.flatnonzero(far).tolist():
        lon, lat = lonlat[offsets[i]]
        text = f"it lies {math.hypot(*first[i]) / 1000:.0f} km or more from the map's origin"
        if abs(lon) <= 90.0 and math.hypot(*pymap3d.geodetic2ned(lon, lat, 0.0, *origin)[:2]) <= MAX_DISTANCE_M:
            text = "it is far away, but near the others with latitude and longitude exchanged (GeoJSON has longitude first)"
        texts.append(text)
    parts.reject(far, texts)
    long = _any(np.hypot(*(vertices - np.repeat(first, counts, axis=0)).T) > MAX_LENGTH_M, offsets) & good & ~far
    parts.reject(long, f"it is longer than {MAX_LENGTH_M:g} m")
    near: NDArray[np.bool_] = ~(far | long)
    return near


def _unique(parts: Parts, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    first: dict[str, int] = {}
    unique = np.ones(len(good), bool)
    texts = []
    for i in np.flatnonzero(good).tolist():
        if first.setdefault(parts.ids[i], parts.features[i]) != parts.features[i]:
            unique[i] = False
            texts.append(f"its id is that of feature {first[parts.ids[i]]}")
    parts.reject(~unique, texts)
    return unique


def write(
    origin: Vec3,
    columns: Columns,
    description: Array,
    common_sigma_m: tuple[float, float],
    automatic: bool = False,
    alike: Alike | None = None,
) -> bytes:
    """The file; positions to 0.1 mm, lengths to 1 mm."""
    counts = np.diff(columns.offsets)
    roof_d = np.repeat(columns.base_d - columns.height_m, counts)
    lat, lon, _ = pymap3d.ned2geodetic(columns.vertices[:, 0], columns.vertices[:, 1], roof_d, *origin)
    lonlat = np.column_stack((lon, lat)).round(9).tolist()
    first = columns.vertices[columns.offsets[:-1]]
    _, _, ground = pymap3d.ned2geodetic(first[:, 0], first[:, 1], columns.base_d, *origin)
    known = (columns.height_m, columns.height_sigma_m, columns.sigma_m, columns.outline_sigma_m, ground, columns.corner_sigma_m)
    shape = np.column_stack((description[:, :4], np.degrees(description[:, polygon.ORIENTATION]).round(3) % 180.0))
    numbers = np.column_stack((*known, shape)).round(3).tolist()
    colours_bgr = columns.colour_bgr.tolist()
    encode = msgspec.json.Encoder().encode
    lines = []
    for i, (a, b) in enumerate(pairwise(columns.offsets.tolist())):
        properties = OurProperties(*numbers[i])
        properties.name = columns.names.get(i, "")
        properties.colour = colours.to_hex(colours_bgr[i]) if colours_bgr[i][0] >= 0 else ""
        properties.weights = columns.weights.get(i)
        if alike is not None and alike.count[i]:
            properties.look_alikes, properties.look_alike_m = int(alike.count[i]), round(float(alike.nearest_m[i]), 1)
            properties.repeats_m = round(float(alike.repeats_m[i]), 1) if alike.repeats_m[i] < math.inf else 0.0
        lines.append(encode(OurFeature(columns.ids[i], OurPolygon([[*lonlat[a:b], lonlat[a]]]), properties)))
    common = {"common_sigma_m": [round(sigma, 3) for sigma in common_sigma_m]} if any(common_sigma_m) else {}
    head = encode({"origin": origin, "version": 1, **common, **({"automatic": True} if automatic else {})})
    return b'{"type":"FeatureCollection","landfix":' + head + b',"features":[\n' + b",\n".join(lines) + b"\n]}\n"
