"""GeoJSON features, decoded one by one: ours fast, any others too."""

import functools
import json
from array import array
from collections.abc import Sequence
from itertools import chain
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.maps import colours
from models.maps import properties as map_properties
from models.maps.properties import UNKNOWN, Attributes, Properties
from models.maps.strips import strips
from models.maps.table import Defaults, Finding, MapError, Weights
from models.messages import Vec3

DEFAULTED = ("height_m", "sigma_m", "ground_alt_m", "colour")  # properties that have a default
FEW = "fewer than 3 corners"
MOST_POINTS = 100_000  # of an outline that is looked at: the largest roofs have some hundred corners
TOO_MANY = f"more than {MOST_POINTS} points: simplify the outline"
_NO_LINE = "a line of longitude and latitude in degrees is needed: ogr2ogr -t_srs EPSG:4326 map.geojson FILE"

_UNUSED_HEIGHT = "the third coordinate ({:g}) is not used: give ground_alt_m (above the ellipsoid) and height_m (above it)"
_Height = Annotated[float, msgspec.Meta(ge=0, le=1e3)]
_Sigma = Annotated[float, msgspec.Meta(ge=0, le=1e3)]
_Ring: TypeAlias = Sequence[Sequence[float]]


class OurPolygon(msgspec.Struct, tag_field="type", tag="Polygon"):
    """Outer ring and holes."""

    coordinates: list[list[tuple[float, float]]]


class OurProperties(msgspec.Struct, omit_defaults=True):
    """Properties as we write them."""

    height_m: _Height
    height_sigma_m: _Sigma
    sigma_m: _Sigma
    outline_sigma_m: _Sigma
    ground_alt_m: Annotated[float, msgspec.Meta(ge=-1e3, le=1e4)]
    corner_sigma_m: _Sigma
    size_m2: float = 0.0
    width_m: float = 0.0
    length_m: float = 0.0
    fill_ratio: float = 0.0
    orientation_deg: float = -1.0
    look_alikes: int = 0
    look_alike_m: float = 0.0
    repeats_m: float = 0.0
    name: str = ""
    colour: str = ""
    weights: Weights | None = None


class OurFeature(msgspec.Struct):
    """A feature as we write it."""

    id: str
    geometry: OurPolygon
    properties: OurProperties
    type: str = "Feature"


class _Polygon(msgspec.Struct, tag_field="type", tag="Polygon"):
    coordinates: list[list[list[float]]]


class _MultiPolygon(msgspec.Struct, tag_field="type", tag="MultiPolygon"):
    coordinates: list[list[list[list[float]]]]


class _LineString(msgspec.Struct, tag_field="type", tag="LineString"):
    coordinates: list[list[float]]


class _MultiLineString(msgspec.Struct, tag_field="type", tag="MultiLineString"):
    coordinates: list[list[list[float]]]


class _Feature(msgspec.Struct):
    geometry: _Polygon | _MultiPolygon | _LineString | _MultiLineString | None = None
    properties: Properties | None = None
    id: str | float | None = None


class _Own(msgspec.Struct):
    origin: Vec3 | None = None
    common_sigma_m: tuple[_Sigma, _Sigma] = (0.0, 0.0)
    automatic: bool = False


class File(msgspec.Struct):
    """The file around the features."""

    type: str = ""
    features: list[msgspec.Raw] | None = None
    crs: Any = None
    landfix: _Own | None = None


_decode_ours = msgspec.json.Decoder(OurFeature).decode
_decode_feature = msgspec.json.Decoder(_Feature).decode
_decode_file = msgspec.json.Decoder(File).decode
_parse_colour = functools.lru_cache(4096)(colours.parse)
_UNDECODABLE = (msgspec.DecodeError, UnicodeDecodeError, RecursionError)


class Parts:
    """Outlines gathered one by one, before they become columns."""

    def __init__(self, defaults: Defaults) -> None:
        self.defaults = defaults
        self.features: list[int] = []
        self.ids: list[str] = []
        self.coordinates = array("d")
        self.counts = array("q")
        self.numbers = array("d")
        self.colours = array("h")
        self.names: dict[int, str] = {}
        self.weights: dict[int, Weights] = {}
        self.rejected: list[Finding] = []
        self.remarks: list[Finding] = []
        self.missing = array("B")  # bit k: DEFAULTED[k]

    def add(self, number: int, raw: msgspec.Raw) -> None:
        """Add a feature, ours (fast) or another's."""
        try:
            ours = _decode_ours(raw)
        except _UNDECODABLE:
            self._add_any(number, raw)
            return
        p = ours.properties
        colour = _parse_colour(p.colour)
        if (p.colour and not colour) or p.weights or not ours.id.strip():
            self._add_any(number, raw)
            return
        numbers = (p.height_m, p.height_sigma_m, p.sigma_m, p.outline_sigma_m, p.ground_alt_m, p.corner_sigma_m)
        attributes = Attributes(numbers, colour or UNKNOWN, p.name, missing=() if colour else ("colour",))
        self._outline(number, ours.id, ours.geometry.coordinates, attributes)

    def _add_any(self, number: int, raw: msgspec.Raw) -> None:
        """Several polygons become landmarks id/1, id/2, ..."""
        try:
            feature = _decode_feature(raw)
        except _UNDECODABLE as error:
            self.rejected.append(Finding(number, f"#{number}", _why(raw, str(error))))
            return
        properties = feature.properties or Properties()
        name = map_properties.identity(properties, feature.id, number)
        if feature.geometry is None:
            self.rejected.append(Finding(number, name, "it has no geometry"))
            return
        shape, side_sigma_m = feature.geometry, None
        if isinstance(shape, _LineString | _MultiLineString):
            width = map_properties.line_width_m(properties)
            if isinstance(width, str) or not _in_degrees(shape):
                self.rejected.append(Finding(number, name, width if isinstance(width, str) else _NO_LINE))
                return
            polygons, side_sigma_m = _strips(shape, width[0]), width[1]
            if not polygons:
                self.rejected.append(Finding(number, name, "it has no length"))
                return
        else:
            polygons = [shape.coordinates] if isinstance(shape, _Polygon) else shape.coordinates
        attributes = map_properties.read(properties, self.defaults, side_sigma_m)
        self.remarks += [Finding(number, name, text) for text in attributes.remarks]
        positions = chain.from_iterable(chain.from_iterable(polygons))
        height = next((position[2] for position in positions if len(position) > 2 and position[2] != 0.0), None)
        if height is not None:
            self.remarks.append(Finding(number, name, _UNUSED_HEIGHT.format(height)))
        for k, rings in enumerate(polygons, 1):
            if sum(map(len, rings)) > MOST_POINTS:
                self.rejected.append(Finding(number, name, TOO_MANY))
            elif any(len(position) < 2 for ring in rings for position in ring):
                self.rejected.append(Finding(number, name, "a position has fewer than two coordinates"))
            else:
                flat = [[position[:2] for position in ring] for ring in rings]
                self._outline(number, name if len(polygons) == 1 else f"{name}/{k}", flat, attributes)

    def _outline(self, number: int, name: str, rings: Sequence[_Ring], attributes: Attributes) -> None:
        ring = rings[0] if rings else []
        if len(ring) > 1 and ring[0] == ring[-1]:
            ring = ring[:-1]
        if len(ring) < 3:
            self.rejected.append(Finding(number, name, FEW))
            return
        if len(rings) > 1:
            self.remarks.append(Finding(number, name, f"{len(rings) - 1} holes are left out: the outer edge is the landmark"))
        if attributes.name:
            self.names[len(self.ids)] = attributes.name
        if attributes.weights:
            self.weights[len(self.ids)] = attributes.weights
        self.features.append(number)
        self.ids.append(name)
        self.numbers.extend(attributes.numbers)
        self.colours.extend(attributes.colour_bgr)
        self.missing.append(sum(1 << DEFAULTED.index(name) for name in attributes.missing))
        self.counts.append(len(ring))
        self.coordinates.extend(chain.from_iterable(ring))

    def missed(self, kept: NDArray[np.intp]) -> dict[str, int]:
        """How many of the kept outlines took the default of a property."""
        bits = np.array(self.missing, dtype=np.uint8)[kept]
        return {name: int(np.sum(bits >> k & 1)) for k, name in enumerate(DEFAULTED)}

    def reject(self, bad: NDArray[np.bool_], text: str | list[str]) -> None:
        """Findings for bad parts."""
        for k, i in enumerate(np.flatnonzero(bad).tolist()):
            self.rejected.append(Finding(self.features[i], self.ids[i], text if isinstance(text, str) else text[k]))


def _lines(shape: _LineString | _MultiLineString) -> list[list[list[float]]]:
    return [shape.coordinates] if isinstance(shape, _LineString) else shape.coordinates


def _in_degrees(shape: _LineString | _MultiLineString) -> bool:
    return all(len(position) >= 2 and max(map(abs, position[:2])) <= 180.0 for line in _lines(shape) for position in line)


def _strips(shape: _LineString | _MultiLineString, width_m: float) -> list[list[list[list[float]]]]:
    return [[ring] for line in _lines(shape) for ring in strips(line, width_m)]


def head_of(data: bytes) -> File:
    """A file's head, or an empty one."""
    try:
        return _decode_file(data)
    except _UNDECODABLE:
        return File()


def features(data: bytes) -> tuple[File, list[msgspec.Raw]]:
    """Head and features of a file: FeatureCollection, Feature, or a feature a line."""
    if other := _other_form(data):
        raise MapError(f"not a GeoJSON map: {other}")
    try:
        head = _decode_file(data)
    except _UNDECODABLE as error:
        if isinstance(error, msgspec.ValidationError):
            raise MapError(f"not a GeoJSON map: {error}") from None
        return File(), _otherwise(data, str(error))
    if head.features is not None:
        return head, head.features
    if head.type == "Feature":
        return head, [msgspec.Raw(data)]
    raise MapError("not a GeoJSON map: it has no features (expected a FeatureCollection)")


def _other_form(data: bytes) -> str:
    head = data[:4096]
    xml = head.lstrip().startswith(b"<")
    for name, seen in (
        ("a GeoPackage", head.startswith(b"SQLite format 3\0")),
        ("a Shapefile", head.startswith(b"\x00\x00\x27\x0a")),
        ("KML", xml and b"<kml" in head),
        ("GML", xml and b"opengis.net/gml" in head),
        ("OpenStreetMap XML", xml and b"<osm" in head),
        ("a KMZ or another ZIP file, to be unpacked first", head.startswith(b"PK\x03\x04")),
    ):
        if seen:
            return f"{name}: convert it with ogr2ogr -t_srs EPSG:4326 map.geojson FILE, or use landfix map get"
    if b'"elements"' in head and b'"features"' not in head:
        return "Overpass JSON: export as GeoJSON in overpass-turbo.eu, or use landfix map get"
    return ""


def _otherwise(data: bytes, error: str) -> list[msgspec.Raw]:
    try:
        lines = msgspec.json.Decoder(msgspec.Raw).decode_lines(data)
        if len(lines) > 1:
            return lines
    except _UNDECODABLE:
        pass
    try:
        whole = json.loads(data)
        return [msgspec.Raw(msgspec.json.encode(feature)) for feature in whole["features"]]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise MapError(f"not a GeoJSON map: {error}") from None


def _why(raw: msgspec.Raw, error: str) -> str:
    try:
        kind = msgspec.json.decode(raw)["geometry"]["type"]
    except (*_UNDECODABLE, KeyError, TypeError):
        kind = None
    if isinstance(kind, str) and kind not in ("Polygon", "MultiPolygon", "LineString", "MultiLineString"):
        return f"its geometry is a {kind}, not a Polygon"
    return error.replace("`", "'")
