"""Footprints around a place, of a file or a folder of extracts, as a map of landmarks.

Each polygon is a landmark: the parts of a multipolygon each its own, holes and heights of corners left out. What a data set does
not say of its accuracy is taken from the table of sources.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from estimator.map_files.extract import tables, text
from estimator.map_files.extract.footprint import Footprint, Place, wrapped
from models.maps.landmarks import LandmarkMap
from models.maps.table import Defaults, MapError

_TEXT: Final = (".geojson", ".json", ".geojsonl", ".geojsons", ".ndjson", ".jsonl")
_GDAL: Final = (".gpkg", ".shp", ".osm", ".pbf", ".fgb", ".kml", ".kmz", ".gml")
_PARQUET: Final = (".parquet", ".geoparquet")
_SUFFIXES: Final = (*_TEXT, *_GDAL, *_PARQUET)
_COMMON_M: Final = (1.5, 2.0)  # shift of a whole map that was traced from images, horizontal and vertical
MOST: Final = 1_000_000  # landmarks of a map


class Source(NamedTuple):
    """A data set: its name, what must be said of where data are from, horizontal standard deviation of a footprint [m]."""

    name: str
    attribution: str
    sigma_m: float


OSM: Final = Source("OpenStreetMap", "© OpenStreetMap contributors, ODbL 1.0 (openstreetmap.org/copyright)", 2.0)
OVERTURE: Final = Source("Overture Maps", "© OpenStreetMap contributors, Overture Maps Foundation, ODbL 1.0", 2.0)
MICROSOFT: Final = Source("Microsoft building footprints", "Microsoft Global ML Building Footprints, ODbL 1.0", 2.0)
UNKNOWN: Final = Source("unknown", "", 2.0)
_SOURCES: Final[dict[str, tuple[str, ...]]] = {  # the data set's own properties
    "OVERTURE": ("sources", "num_floors", "has_parts", "is_underground"),
    "MICROSOFT": ("capture_dates_range", "confidence", "release"),
    "OSM": ("osm_id", "osm_way_id", "@id", "building", "building:levels"),
}
_KNOWN: Final = {"OVERTURE": OVERTURE, "MICROSOFT": MICROSOFT, "OSM": OSM}


class Got(msgspec.Struct, frozen=True):
    """What the map is made from. read: polygons in the files, or near the place where the file has an index; sources: landmarks
    of each data set; attribution: what a publication of the map must say.
    """

    landmarks: int
    read: int
    with_height: int
    sources: dict[str, int]
    attribution: str
    notes: tuple[str, ...]


def get(
    source: Path,
    place: Place,
    ground_alt_m: float = 0.0,
    sigma_m: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[LandmarkMap, Got]:
    """The map, and what was found. ground_alt_m: of the place above the ellipsoid; sigma_m: instead of the
    sources', and of the shift that what is traced from one image has in common.

    Raises MapError where there is no footprint.
    """
    files = _files(source)
    features: list[dict[str, Any]] = []
    found: Counter[str] = Counter()
    attributions: dict[str, None] = {}
    ids: Counter[str] = Counter()
    read = 0
    for k, path in enumerate(files):
        for footprint in _footprints(path, place):
            read += 1
            if not place.holds(footprint.ring) or len(features) >= MOST:
                continue
            known = _source(footprint)
            found[known.name] += 1
            attributions |= {known.attribution: None} if known.attribution else {}
            features.append(_feature(footprint, known, sigma_m, ids))
        if progress:
            progress((k + 1) / len(files))
    if not features:
        where = f"within {place.radius_m / 1000:g} km of {place.lat_deg:g}, {place.lon_deg:g}"
        raise MapError(f"{source}: none of its {read} polygons lies {where}" if read else f"{source}: holds no polygon {where}")
    credit = "; ".join(attributions)
    document = json.dumps({"type": "FeatureCollection", "features": features}, ensure_ascii=False).encode()
    origin = (round(place.lat_deg, 6), round(place.lon_deg, 6), ground_alt_m)
    common = (0.0, 0.0) if sigma_m is not None else _COMMON_M
    the_map = LandmarkMap.from_geojson(document, Defaults(origin=origin, common_sigma_m=common))
    notes = [f"only the first {MOST} landmarks are taken: ask for fewer kilometres"] if len(features) >= MOST else []
    if UNKNOWN.name in found:
        notes.append("the data set does not say what it is: name it yourself where you publish the map, and give --sigma-m")
    heights = len(the_map) - the_map.report.missing.get("height_m", 0)
    return the_map, Got(len(the_map), read, heights, dict(found), credit, tuple(notes))


def credited(data: bytes, attribution: str) -> bytes:
    """A map's file with the attribution of its data as a member of its own, which the licences ask for."""
    head = b'{"type":"FeatureCollection",'
    member = b'"attribution":' + msgspec.json.encode(attribution) + b"," if attribution else b""
    return head + member + data.removeprefix(head)


def _files(source: Path) -> list[Path]:
    if not source.exists():
        raise MapError(f"{source}: no such file or folder")
    if not source.is_dir():
        return [source]
    found = sorted(p for p in source.rglob("*") if p.is_file() and p.name.lower().removesuffix(".gz").endswith(_SUFFIXES))
    if not found:
        raise MapError(f"{source}: holds no extract ({', '.join(_SUFFIXES)})")
    return found


def _footprints(path: Path, place: Place) -> Iterator[Footprint]:
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(_PARQUET):
        return tables.read_parquet(path, place)
    if name.endswith(_GDAL):
        return tables.read_gdal(path, place)
    if name.endswith(_TEXT):
        return text.read(path)
    raise MapError(f"{path}: its format is not known by its name; known are {', '.join(_SUFFIXES)}")


def _source(footprint: Footprint) -> Source:
    """By the properties that only it has."""
    names = footprint.properties.keys()
    if footprint.id.startswith(("way/", "relation/")):
        return OSM
    return next((_KNOWN[name] for name, own in _SOURCES.items() if names & set(own)), UNKNOWN)


def _feature(footprint: Footprint, known: Source, sigma_m: float | None, ids: Counter[str]) -> dict[str, Any]:
    """As the map's file has it; the parts of one feature are numbered."""
    name = footprint.id or f"{known.name.split()[0].lower()}/{sum(ids.values()) + 1}"
    ids[name] += 1
    properties = dict(footprint.properties)
    properties["id"] = name if ids[name] == 1 else f"{name}/{ids[name]}"
    properties.setdefault("sigma_m", known.sigma_m)
    if sigma_m is not None:
        properties["sigma_m"] = sigma_m
    ring = np.column_stack((wrapped(footprint.ring[:, 0]), footprint.ring[:, 1])).tolist()
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
