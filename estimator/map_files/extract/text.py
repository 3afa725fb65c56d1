"""GeoJSON, also a feature a line, and Overpass JSON (OSM wiki, "Relation:multipolygon")."""

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator
from io import BufferedReader
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimator.map_files.extract.crs import ToLonLat, to_lonlat
from estimator.map_files.extract.footprint import Footprint, rings
from models.maps.table import MapError
from models.messages import Array
from models.untrusted.file import content, opened
from models.untrusted.gzip import GzipFile

_LINES: Final = (".geojsonl", ".geojsons", ".ndjson", ".jsonl", ".csv")
_Point = tuple[float, float]


def read(path: Path) -> Iterator[Footprint]:
    """The polygons of a file, packed with gzip or not. Raises MapError."""
    name = path.name.removesuffix(".gz").lower()
    try:
        with BufferedReader(GzipFile(path)) if path.suffix == ".gz" else opened(path) as file:
            if name.endswith(_LINES):
                yield from _lines(path, file)
                _check_end(path, file.raw)
                return
            data = file.read() if isinstance(file.raw, GzipFile) else content(path)
            _check_end(path, file.raw)
    except MapError:
        raise
    except (OSError, ValueError) as error:
        raise MapError(f"{path}: cannot be read ({error})") from None
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        lines = data.strip().splitlines()
        if len(lines) > 1 and lines[0].lstrip(b"\x1e").startswith(b"{"):  # a feature a line under another name
            yield from _lines(path, lines)
            return
        raise MapError(f"{path}: is no JSON ({error})") from None
    yield from _document(path, document)


def _check_end(path: Path, file: object) -> None:
    if isinstance(file, GzipFile) and file.torn:
        raise MapError(f"{path}: cannot be read (its end is missing)")


def _lines(path: Path, lines: Iterable[bytes]) -> Iterator[Footprint]:
    bad = 0
    for line in lines:
        text = line.strip().lstrip(b"\x1e")  # of RFC 8142
        if not text:
            continue
        try:
            feature = json.loads(text)
        except (ValueError, RecursionError):
            bad += 1
            if bad > 100:
                raise MapError(f"{path}: its lines are no JSON") from None
            continue
        yield from _document(path, feature)


def _document(path: Path, document: Any) -> Iterator[Footprint]:
    if not isinstance(document, dict):
        raise MapError(f"{path}: is neither GeoJSON nor an answer of Overpass")
    match document.get("type"), document.get("features"), document.get("elements"):
        case _, _, list() as elements:
            yield from _overpass(elements)
        case "FeatureCollection", list() as features, _:
            crs = document.get("crs")
            name = crs.get("properties", {}).get("name") if isinstance(crs, dict) else None
            convert = to_lonlat(name, str(path))
            for feature in features:
                yield from _feature(feature, convert)
        case "Feature", _, _:
            yield from _feature(document, None)
        case _:
            raise MapError(f"{path}: is neither GeoJSON nor an answer of Overpass")


def _feature(feature: Any, convert: ToLonLat | None) -> Iterator[Footprint]:
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    if not isinstance(geometry, dict):
        return
    try:
        found = rings(str(geometry.get("type")), geometry.get("coordinates"))
    except (TypeError, ValueError, IndexError):
        return
    properties = feature.get("properties")
    for ring in found:
        yield Footprint(convert(ring) if convert else ring, properties if isinstance(properties, dict) else {}, _id(feature))


def _id(feature: dict[str, Any]) -> str:
    given = feature.get("id")
    return str(given) if isinstance(given, str | int | float) and not isinstance(given, bool) else ""


def _overpass(elements: list[Any]) -> Iterator[Footprint]:
    items = [e for e in elements if isinstance(e, dict)]
    nodes = {e["id"]: (e["lon"], e["lat"]) for e in items if e.get("type") == "node" and {"id", "lon", "lat"} <= e.keys()}
    ways = {e["id"]: _way(e, nodes) for e in items if e.get("type") == "way" and "id" in e}
    parts = set()
    for e in items:
        tags = e.get("tags", {})
        if e.get("type") != "relation" or not isinstance(tags, dict) or "building" not in tags:
            continue
        members = [m for m in e.get("members", []) if m.get("type") == "way" and m.get("role") in {"outer", ""}]
        parts |= {m.get("ref") for m in members}
        lines = [_points(m["geometry"]) if "geometry" in m else ways.get(m.get("ref"), []) for m in members]
        for ring in _joined([line for line in lines if line]):
            yield Footprint(ring, tags, f"relation/{e.get('id')}")
    for e in items:
        tags = e.get("tags", {})
        if e.get("type") == "way" and isinstance(tags, dict) and "building" in tags and e.get("id") not in parts:
            line = ways.get(e.get("id"), [])
            if len(line) > 3 and line[0] == line[-1]:
                yield Footprint(np.array(line, float), tags, f"way/{e['id']}")


def _way(e: dict[str, Any], nodes: dict[Any, _Point]) -> list[_Point]:
    return _points(e["geometry"]) if "geometry" in e else [nodes[n] for n in e.get("nodes", []) if n in nodes]


def _points(geometry: Iterable[Any]) -> list[_Point]:
    return [(float(p["lon"]), float(p["lat"])) for p in geometry if p]


def _joined(lines: list[list[_Point]]) -> Iterator[Array]:
    ends: dict[_Point, list[int]] = defaultdict(list)
    for k, line in enumerate(lines):
        for end in {line[0], line[-1]}:
            ends[end].append(k)
    free = set(range(len(lines)))
    for k, begin in enumerate(lines):
        if k not in free:
            continue
        free.remove(k)
        line = list(begin)
        while line[0] != line[-1]:
            at = ends[line[-1]]
            while at and at[-1] not in free:
                at.pop()
            if not at:
                break
            free.remove(at[-1])
            other = lines[at.pop()]
            line += (other if other[0] == line[-1] else other[::-1])[1:]
        if len(line) > 3 and line[0] == line[-1]:
            yield np.array(line, float)
