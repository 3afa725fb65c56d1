"""The map's file: GeoJSON, so that any map program opens it. docs/map.md says what stands in it.

Outlines are roof edges in WGS-84 longitude and latitude, or in the system a `crs` member names. A feature is judged by itself:
a bad one gets its reason and the others go on.
"""

import json
import math
import re
from itertools import chain, pairwise
from typing import Any

import msgspec
import numpy as np
import pymap3d
from numpy.typing import NDArray

from models import colours, map_properties, projection
from models import outline as polygon
from models.map_properties import Attributes, Properties
from models.map_table import Columns, Defaults, Finding, MapError, MapReport, Weights
from models.messages import Array, Vec3

TOLERANCE_M = 0.005  # corners nearer than this to the line between their neighbours are none
MIN_M2 = 0.01
MAX_CORNERS = 1000
MAX_LENGTH_M = 2000.0
MAX_DISTANCE_M = 100_000.0  # further out, "down" is 1 degree off the origin's

_VERDICTS = {
    polygon.FEW: "fewer than 3 corners",
    polygon.SMALL: f"smaller than {MIN_M2:g} m2",
    polygon.MANY: f"more than {MAX_CORNERS} corners: simplify the outline",
    polygon.CROSSED: "the outline crosses itself",
}

_Ring = list[list[float]]


class _Polygon(msgspec.Struct, tag_field="type", tag="Polygon"):
    coordinates: list[_Ring]


class _MultiPolygon(msgspec.Struct, tag_field="type", tag="MultiPolygon"):
    coordinates: list[list[_Ring]]


class _Feature(msgspec.Struct):
    geometry: _Polygon | _MultiPolygon | None = None
    properties: Properties | None = None
    id: str | float | None = None


class _Own(msgspec.Struct):
    origin: Vec3 | None = None


class _File(msgspec.Struct):
    type: str = ""
    features: list[msgspec.Raw] | None = None
    crs: Any = None
    landfix: _Own | None = None


_decode_feature = msgspec.json.Decoder(_Feature).decode
_decode_file = msgspec.json.Decoder(_File).decode


class _Parts:
    """Outlines gathered one by one, before they become columns."""

    def __init__(self, defaults: Defaults) -> None:
        self.defaults = defaults
        self.features: list[int] = []
        self.ids: list[str] = []
        self.attributes: list[Attributes] = []
        self.flat: list[float] = []
        self.counts: list[int] = []
        self.rejected: list[Finding] = []
        self.remarks: list[Finding] = []
        self.missing: dict[str, int] = {"height_m": 0, "sigma_m": 0, "ground_alt_m": 0, "colour": 0}

    def add(self, number: int, raw: msgspec.Raw) -> None:
        """One feature; several polygons in it become landmarks of their own, id/1, id/2, ..."""
        try:
            feature = _decode_feature(raw)
        except msgspec.ValidationError as error:
            self.rejected.append(Finding(number, f"#{number}", _why(raw, str(error))))
            return
        properties = feature.properties or Properties()
        name = map_properties.identity(properties, feature.id, number)
        if feature.geometry is None:
            self.rejected.append(Finding(number, name, "it has no geometry"))
            return
        one = isinstance(feature.geometry, _Polygon)
        polygons = [feature.geometry.coordinates] if isinstance(feature.geometry, _Polygon) else feature.geometry.coordinates
        attributes = map_properties.read(properties, self.defaults)
        self.remarks += [Finding(number, name, text) for text in attributes.remarks]
        for k, rings in enumerate(polygons):
            self._outline(number, name if one or len(polygons) == 1 else f"{name}/{k + 1}", rings, attributes)

    def _outline(self, number: int, name: str, rings: list[_Ring], attributes: Attributes) -> None:
        ring = rings[0] if rings else []
        if any(len(position) < 2 for position in ring):
            self.rejected.append(Finding(number, name, "a position has fewer than two coordinates"))
            return
        if len(ring) > 1 and ring[0] == ring[-1]:
            ring.pop()
        if len(ring) < 3:
            self.rejected.append(Finding(number, name, _VERDICTS[polygon.FEW]))
            return
        if len(rings) > 1:
            self.remarks.append(Finding(number, name, f"{len(rings) - 1} holes are left out: the outer edge is the landmark"))
        for text in attributes.missing:
            self.missing[text] += 1
        self.features.append(number)
        self.ids.append(name)
        self.attributes.append(attributes)
        self.counts.append(len(ring))
        self.flat.extend(chain.from_iterable(position[:2] for position in ring))

    def reject(self, bad: NDArray[np.bool_], text: str | list[str]) -> None:
        """Findings for the parts that are bad."""
        for k, i in enumerate(np.flatnonzero(bad).tolist()):
            self.rejected.append(Finding(self.features[i], self.ids[i], text if isinstance(text, str) else text[k]))


def read(data: bytes, defaults: Defaults) -> tuple[Vec3, Columns, MapReport]:
    """Origin (lat_deg, lon_deg, alt_m), landmarks and findings of a GeoJSON file. Raises MapError."""
    head, features = _features(data.removeprefix(b"\xef\xbb\xbf"))
    parts = _Parts(defaults)
    for number, raw in enumerate(features, 1):
        parts.add(number, raw)
    lonlat = _lonlat(head.crs, np.array(parts.flat).reshape(-1, 2))
    offsets = np.concatenate(([0], np.cumsum(parts.counts, dtype=np.int64)))
    good = _in_range(parts, lonlat, offsets)
    table = np.array([a[1:6] for a in parts.attributes]).reshape(
        -1, 5
    )  # height, its sigma, sigma, outline sigma, ground altitude
    origin = defaults.origin or (head.landfix and head.landfix.origin) or _middle(lonlat, offsets, good, table[:, 4])
    if not (abs(origin[0]) <= 90.0 and abs(origin[1]) <= 180.0 and math.isfinite(origin[2])):
        raise MapError(f"the origin {origin} is not a latitude, longitude and height")
    lonlat[np.repeat(~good, parts.counts)] = origin[1], origin[0]
    table[np.isnan(table[:, 4]), 4] = origin[2]
    vertices, base_d = _to_ned(origin, lonlat, offsets, ground=table[:, 4], roof=table[:, 4] + table[:, 0])
    good &= _in_reach(parts, origin, lonlat, vertices, offsets, good)
    vertices, ends, verdicts = polygon.repair(vertices, offsets, TOLERANCE_M, MIN_M2, MAX_CORNERS)
    for verdict, text in _VERDICTS.items():
        parts.reject(good & (verdicts == verdict), text)
    good &= (verdicts == polygon.GOOD) & _unique(parts, good & (verdicts == polygon.GOOD))
    kept = np.flatnonzero(good)
    attributes = [parts.attributes[i] for i in kept.tolist()]
    columns = Columns(
        ids=[parts.ids[i] for i in kept.tolist()],
        vertices=vertices[np.repeat(good, np.diff(ends))],
        offsets=np.concatenate(([0], np.cumsum(np.diff(ends)[kept]))),
        base_d=base_d[kept],
        height_m=table[kept, 0],
        height_sigma_m=table[kept, 1],
        sigma_m=table[kept, 2],
        outline_sigma_m=table[kept, 3],
        colour_bgr=np.array([a.colour_bgr for a in attributes], dtype=np.int16).reshape(-1, 3),
        weights={i: a.weights for i, a in enumerate(attributes) if a.weights},
        names={i: a.name for i, a in enumerate(attributes) if a.name},
    )
    rejected = tuple(sorted(parts.rejected, key=lambda finding: finding.feature))
    return origin, columns, MapReport(len(features), rejected, tuple(parts.remarks), parts.missing)


def _features(data: bytes) -> tuple[_File, list[msgspec.Raw]]:
    """The file's head and its features: a FeatureCollection, one Feature, or one feature a line."""
    try:
        head = _decode_file(data)
    except msgspec.DecodeError as error:
        if isinstance(error, msgspec.ValidationError):
            raise MapError(f"not a GeoJSON map: {error}") from None
        return _File(), _otherwise(data, str(error))
    if head.features is not None:
        return head, head.features
    if head.type == "Feature":
        return head, [msgspec.Raw(data)]
    raise MapError("not a GeoJSON map: it has no features (expected a FeatureCollection)")


def _otherwise(data: bytes, error: str) -> list[msgspec.Raw]:
    """Features of a file that is not one JSON text: one a line, or with the NaN that some programs write (read as null)."""
    try:
        lines = msgspec.json.Decoder(msgspec.Raw).decode_lines(data)
        if len(lines) > 1:
            return lines
    except msgspec.DecodeError:
        pass
    try:
        whole = json.loads(data)
        return [msgspec.Raw(msgspec.json.encode(feature)) for feature in whole["features"]]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise MapError(f"not a GeoJSON map: {error}") from None


def _why(raw: msgspec.Raw, error: str) -> str:
    """Why a feature could not be decoded, in terms of its geometry if that is the reason."""
    try:
        kind = msgspec.json.decode(raw)["geometry"]["type"]
    except (msgspec.DecodeError, KeyError, TypeError, RecursionError):
        kind = None
    if isinstance(kind, str) and kind not in ("Polygon", "MultiPolygon"):
        return f"its geometry is a {kind}, not a Polygon"
    return error.replace("`", "'")


def _lonlat(crs: Any, xy: Array) -> Array:
    """Longitude, latitude of the file's coordinates."""
    name = str(crs["properties"].get("name", "")) if isinstance(crs, dict) and isinstance(crs.get("properties"), dict) else ""
    if not name or "CRS84" in name:
        return xy
    epsg = re.search(r"EPSG:+(\d+)$", name)
    lonlat = projection.to_lonlat(int(epsg[1]), xy) if epsg else None
    if lonlat is None:
        raise MapError(f"coordinate system {name!r} is not known here: convert the file to WGS 84 (EPSG:4326) first")
    return lonlat


def _any(condition: NDArray[np.bool_], offsets: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Per outline, whether the condition holds at one of its vertices."""
    return np.logical_or.reduceat(condition, offsets[:-1]) if len(offsets) > 1 else np.empty(0, bool)


def _in_range(parts: _Parts, lonlat: Array, offsets: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which outlines lie on the Earth."""
    lon, lat = lonlat.T
    bad = _any(~((np.abs(lat) <= 90.0) & (np.abs(lon) <= 180.0)), offsets)
    swapped = bad & ~_any(~((np.abs(lon) <= 90.0) & (np.abs(lat) <= 180.0)), offsets)
    parts.reject(swapped, "latitude beyond 90 degrees: latitude and longitude exchanged? (GeoJSON has longitude first)")
    parts.reject(bad & ~swapped, "its coordinates are not longitude and latitude in degrees")
    return ~bad


def _middle(lonlat: Array, offsets: NDArray[np.int64], good: NDArray[np.bool_], ground_alt: Array) -> Vec3:
    """An origin: the median place, at the median ground altitude (0 where no feature knows its own)."""
    lon, lat = lonlat[offsets[:-1][good]].T
    if len(lon) == 0:
        return 0.0, 0.0, 0.0
    known = ground_alt[~np.isnan(ground_alt)]
    alt = float(np.median(known)) if len(known) else 0.0
    return round(float(np.sort(lat)[len(lat) // 2]), 6), round(float(np.sort(lon)[len(lon) // 2]), 6), round(alt, 3)


def _to_ned(origin: Vec3, lonlat: Array, offsets: NDArray[np.int64], ground: Array, roof: Array) -> tuple[Array, Array]:
    """North, east (V, 2) of the roof's corners, and down (N,) of the ground under the first of each."""
    counts = np.diff(offsets)
    north, east, _ = pymap3d.geodetic2ned(lonlat[:, 1], lonlat[:, 0], np.repeat(roof, counts), *origin)
    first = lonlat[offsets[:-1]]
    _, _, down = pymap3d.geodetic2ned(first[:, 1], first[:, 0], ground, *origin)
    return np.column_stack((north, east)), np.asarray(down, dtype=np.float64)


def _in_reach(
    parts: _Parts, origin: Vec3, lonlat: Array, vertices: Array, offsets: NDArray[np.int64], good: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which outlines are of a landmark's size and near enough for one flat frame."""
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


def _unique(parts: _Parts, good: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The first of those with one id."""
    first: dict[str, int] = {}
    unique = np.ones(len(good), bool)
    texts = []
    for i in np.flatnonzero(good).tolist():
        if first.setdefault(parts.ids[i], parts.features[i]) != parts.features[i]:
            unique[i] = False
            texts.append(f"its id is that of feature {first[parts.ids[i]]}")
    parts.reject(~unique, texts)
    return unique


class _Ours(msgspec.Struct, omit_defaults=True):
    """The properties of a written feature; the last five are computed, for people, and not read back."""

    height_m: float
    ground_alt_m: float
    sigma_m: float
    height_sigma_m: float
    outline_sigma_m: float
    size_m2: float
    width_m: float
    length_m: float
    fill_ratio: float
    orientation_deg: float
    name: str = ""
    colour: str = ""
    weights: Weights | None = None


class _Written(msgspec.Struct):
    id: str
    geometry: _Polygon
    properties: _Ours
    type: str = "Feature"


def write(origin: Vec3, columns: Columns, description: Array) -> bytes:
    """The file of a map; one feature a line. Places to 0.1 mm, lengths to 1 mm."""
    counts = np.diff(columns.offsets)
    roof_d = np.repeat(columns.base_d - columns.height_m, counts)
    lat, lon, _ = pymap3d.ned2geodetic(columns.vertices[:, 0], columns.vertices[:, 1], roof_d, *origin)
    lonlat = np.column_stack((lon, lat)).round(9).tolist()
    first = columns.vertices[columns.offsets[:-1]]
    _, _, ground = pymap3d.ned2geodetic(first[:, 0], first[:, 1], columns.base_d, *origin)
    uncertain = (columns.sigma_m, columns.height_sigma_m, columns.outline_sigma_m)
    shape = np.column_stack((description[:, :4], np.degrees(description[:, polygon.ORIENTATION])))
    numbers = np.column_stack((columns.height_m, ground, *uncertain, shape)).round(3).tolist()
    colours_bgr = columns.colour_bgr.tolist()
    encode = msgspec.json.Encoder().encode
    lines = []
    for i, (a, b) in enumerate(pairwise(columns.offsets.tolist())):
        colour = colours.to_hex(colours_bgr[i]) if colours_bgr[i][0] >= 0 else ""
        ours = _Ours(*numbers[i], columns.names.get(i, ""), colour, columns.weights.get(i))
        lines.append(encode(_Written(columns.ids[i], _Polygon([[*lonlat[a:b], lonlat[a]]]), ours)))
    head = encode({"origin": origin, "version": 1})
    return b'{"type":"FeatureCollection","landfix":' + head + b',"features":[\n' + b",\n".join(lines) + b"\n]}\n"
