"""Footprints around a place as a landmark map, without holes."""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from estimator.map_files.extract import tables, text
from estimator.map_files.extract.footprint import Footprint, Place, wrapped
from estimator.map_files.terrain import Terrain
from models.maps.features import MOST_POINTS, TOO_MANY
from models.maps.landmarks import LandmarkMap
from models.maps.table import Defaults, MapError
from models.untrusted.boundary import refusing

_TEXT: Final = (".geojson", ".json", ".geojsonl", ".geojsons", ".ndjson", ".jsonl")
_GDAL: Final = (".gpkg", ".shp", ".osm", ".pbf", ".fgb", ".kml", ".kmz", ".gml")
_PARQUET: Final = (".parquet", ".geoparquet")
_SUFFIXES: Final = (*_TEXT, *_GDAL, *_PARQUET)
_COMMON_M: Final = (1.5, 2.0)  # shift of a whole map that was traced from images, horizontal and vertical
MOST: Final = 1_000_000  # landmarks of a map


class Source(NamedTuple):
    """A data set; sigma: of a footprint, horizontally [m]."""

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


class Ground(NamedTuple):
    """A height model and its sigma [m]."""

    terrain: Terrain
    sigma_m: float = 2.0


class Got(msgspec.Struct, frozen=True):
    """read: polygons; sources: landmarks by data set; attribution: required by licences."""

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
    ground: Ground | None = None,
) -> tuple[LandmarkMap, Got]:
    """The map and what was found. Raises MapError without a footprint.

    ground_alt_m: above the ellipsoid; sigma_m: replaces the sources'.
    """
    files = _files(source)
    features: list[dict[str, Any]] = []
    found: Counter[str] = Counter()
    attributions: dict[str, None] = {}
    ids: Counter[str] = Counter()
    read, beyond, crowded = 0, 0, 0
    spread_m: dict[str, float] = {}
    if ground is not None:
        ground_alt_m = round(float(ground.terrain.at(np.array([[place.lon_deg, place.lat_deg]]))[0]), 2)
        if not np.isfinite(ground_alt_m):
            raise MapError(f"the height model does not reach {place.lat_deg:g}, {place.lon_deg:g}, the middle of the map")
    for k, path in enumerate(files):
        for footprint in _footprints(path, place):
            read += 1
            if not place.holds(footprint.ring) or len(features) >= MOST:
                continue
            if len(footprint.ring) > MOST_POINTS:
                crowded += 1
                continue
            properties: dict[str, Any] = {}
            if ground is not None:
                heights = ground.terrain.at(footprint.ring)
                if not np.isfinite(heights).all():
                    beyond += 1
                    continue
                properties = {"ground_alt_m": round(float(heights.mean()), 2)}
            known = _source(footprint)
            found[known.name] += 1
            attributions |= {known.attribution: None} if known.attribution else {}
            features.append(_feature(footprint, known, sigma_m, ids, properties))
            if ground is not None:
                spread_m[features[-1]["properties"]["id"]] = math.hypot(ground.sigma_m, float(heights.std()))
        if progress:
            progress((k + 1) / len(files))
    if beyond and not features:
        raise MapError(f"the height model reaches none of the {beyond} landmarks")
    if crowded and not features:
        raise MapError(f"{source}: its outline there has {TOO_MANY}")
    if not features:
        where = f"within {place.radius_m / 1000:g} km of {place.lat_deg:g}, {place.lon_deg:g}"
        raise MapError(f"{source}: none of its {read} polygons lies {where}" if read else f"{source}: holds no polygon {where}")
    credit = "; ".join(attributions)
    document = json.dumps({"type": "FeatureCollection", "features": features}, ensure_ascii=False).encode()
    origin = (round(place.lat_deg, 6), round(place.lon_deg, 6), ground_alt_m)
    common = (0.0, 0.0) if sigma_m is not None else _COMMON_M
    if ground is not None:
        common = (common[0], math.hypot(common[1], ground.sigma_m))
    the_map = LandmarkMap.from_geojson(document, Defaults(origin=origin, common_sigma_m=common))
    notes = [f"only the first {MOST} landmarks are taken: ask for fewer kilometres"] if len(features) >= MOST else []
    if UNKNOWN.name in found:
        notes.append("the data set does not say what it is: name it yourself where you publish the map, and give --sigma-m")
    if ground is not None:
        the_map = _uncertain(the_map, spread_m)
    if beyond:
        notes.append(f"{beyond} landmarks are left out: the height model does not reach them")
    if crowded:
        notes.append(f"{crowded} polygons are left out: {TOO_MANY}")
    with_height = len(the_map) - the_map.report.missing.get("height_m", 0)
    return the_map, Got(len(the_map), read, with_height, dict(found), credit, tuple(notes))


def credited(data: bytes, attribution: str) -> bytes:
    """A map's file with the attribution of its data."""
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
    with refusing(MapError, path):
        for footprint in _reader(path, place):
            if np.isfinite(footprint.ring).all() and len(footprint.ring) > 0:
                yield footprint


def _reader(path: Path, place: Place) -> Iterator[Footprint]:
    name = path.name.lower().removesuffix(".gz")
    if name.endswith(_PARQUET):
        return tables.read_parquet(path, place)
    if name.endswith(_GDAL):
        return tables.read_gdal(path, place)
    if name.endswith(_TEXT):
        return text.read(path)
    raise MapError(f"{path}: its format is not known by its name; known are {', '.join(_SUFFIXES)}")


def _source(footprint: Footprint) -> Source:
    names = footprint.properties.keys()
    if footprint.id.startswith(("way/", "relation/")):
        return OSM
    return next((_KNOWN[name] for name, own in _SOURCES.items() if names & set(own)), UNKNOWN)


def _uncertain(the_map: LandmarkMap, spread_m: dict[str, float]) -> LandmarkMap:
    c = the_map.columns
    sigma = np.hypot(c.height_sigma_m, [spread_m[name] for name in c.ids])
    columns = msgspec.structs.replace(c, height_sigma_m=sigma)
    return LandmarkMap(the_map.origin, columns, the_map.report, the_map.common_sigma_m, the_map.automatic)


def _feature(
    footprint: Footprint, known: Source, sigma_m: float | None, ids: Counter[str], more: dict[str, Any]
) -> dict[str, Any]:
    name = footprint.id or f"{known.name.split()[0].lower()}/{sum(ids.values()) + 1}"
    ids[name] += 1
    properties = {**footprint.properties, **more}
    properties["id"] = name if ids[name] == 1 else f"{name}/{ids[name]}"
    properties.setdefault("sigma_m", known.sigma_m)
    if sigma_m is not None:
        properties["sigma_m"] = sigma_m
    ring = np.column_stack((wrapped(footprint.ring[:, 0]), footprint.ring[:, 1])).tolist()
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
