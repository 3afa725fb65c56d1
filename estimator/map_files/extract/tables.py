"""Formats of landfix[geo]: by GDAL, GeoParquet by Arrow."""

import json
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from estimator.map_files.extract.crs import box_of, to_lonlat
from estimator.map_files.extract.footprint import Footprint, Place
from estimator.map_files.extract.wkb import outer_rings
from models.maps.table import MapError
from models.untrusted.file import opened
from models.untrusted.toml_text import one_line

_TAG = re.compile(r'"((?:[^"\\]|\\.)*)"=>"((?:[^"\\]|\\.)*)"')  # of the tags that GDAL keeps in one text

_MAGIC = {".gpkg": b"SQLite format 3\0", ".shp": b"\0\0\x27\x0a", ".fgb": b"fgb", ".kmz": b"PK"}
_HEAD = 65536  # bytes


def read_gdal(path: Path, place: Place) -> Iterator[Footprint]:
    """Polygons of all layers by GDAL. Raises MapError."""
    try:
        import pyogrio  # noqa: PLC0415  (an extra)
        import pyogrio.raw  # noqa: PLC0415
    except ImportError:
        raise MapError(f"{path}: {path.suffix} files need pyogrio: pip install 'landfix[geo]'") from None
    _check_head(path)
    try:
        for layer, kind in pyogrio.list_layers(path).tolist():
            if kind is not None and "Polygon" not in kind and kind != "Unknown":
                continue
            crs = pyogrio.read_info(path, layer=layer)["crs"]
            for box in place.boxes:
                with warnings.catch_warnings(action="ignore"):  # of GDAL, about single features; the map's report judges them
                    read = pyogrio.raw.read(path, layer=layer, bbox=box_of(crs, box, str(path)))
                yield from _rows(path, read, crs, with_tags="osm_id" in read[0]["fields"])
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as error:
        raise MapError(f"{path}: cannot be read ({one_line(str(error))})") from None


def _check_head(path: Path) -> None:
    """Raises MapError where content contradicts the name: a GDAL format may name other files."""
    try:
        with opened(path) as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise MapError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None
    wanted = _MAGIC.get(path.suffix.lower(), b"")
    if not head.startswith(wanted) or b"<OGRVRT" in head or b"<VRT" in head:
        raise MapError(f"{path}: is no {path.suffix} file by its first bytes")


def _rows(path: Path, read: Any, crs: Any, *, with_tags: bool) -> Iterator[Footprint]:
    meta, _, geometries, columns = read
    convert = to_lonlat(crs, str(path))
    for k, geometry in enumerate(geometries):
        properties = {name: _plain(column[k]) for name, column in zip(meta["fields"], columns, strict=True)}
        properties = {name: value for name, value in properties.items() if value is not None}
        if with_tags:
            properties |= _TAG.findall(str(properties.pop("other_tags", "")))
            if "building" not in properties:
                continue
        number = "relation/{osm_id}" if "osm_id" in properties else "way/{osm_way_id}" if "osm_way_id" in properties else ""
        for ring in outer_rings(bytes(geometry)) if geometry is not None else []:
            yield Footprint(convert(ring) if convert else ring, properties, number.format_map(properties))


def _plain(value: Any) -> Any:
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value if isinstance(value, str | int | float) and value != "" else None


def read_parquet(path: Path, place: Place) -> Iterator[Footprint]:
    """Polygons of a GeoParquet file (version 1.1: WKB). Raises MapError."""
    try:
        import pyarrow as pa  # noqa: PLC0415  (an extra)
        import pyarrow.parquet as pq  # noqa: PLC0415
    except ImportError:
        raise MapError(f"{path}: GeoParquet needs pyarrow: pip install 'landfix[geo]'") from None
    try:
        with pq.ParquetFile(path) as file:
            about = json.loads((file.schema_arrow.metadata or {}).get(b"geo", b"{}"))
            name = about.get("primary_column", "geometry")
            column = about.get("columns", {}).get(name, {})
            if name not in file.schema_arrow.names or column.get("encoding", "WKB") != "WKB":
                raise MapError(f"{path}: holds no geometry in WKB: is it GeoParquet?")
            convert = to_lonlat(column.get("crs"), str(path))
            boxed = "bbox" in file.schema_arrow.names and convert is None
            for batch in file.iter_batches():
                table = pa.Table.from_batches([batch])
                for row in _near(table, place) if boxed else range(len(table)):
                    properties = {n: _plain(table[n][row].as_py()) for n in table.column_names if n not in {name, "bbox"}}
                    properties |= _named(table, row)
                    geometry = table[name][row].as_py()
                    given = {n: value for n, value in properties.items() if value is not None}
                    for ring in outer_rings(geometry) if geometry else []:
                        yield Footprint(convert(ring) if convert else ring, given, str(given.get("id", "")))
    except (pa.ArrowException, OSError, ValueError) as error:
        raise error if isinstance(error, MapError) else MapError(f"{path}: cannot be read ({error})") from None


def _near(table: Any, place: Place) -> list[int]:
    boxes = table["bbox"].combine_chunks()
    west, south, east, north = (np.asarray(boxes.field(key), float) for key in ("xmin", "ymin", "xmax", "ymax"))
    near = np.zeros(len(west), bool)
    for w, s, e, n in place.boxes:
        near |= (east >= w) & (west <= e) & (north >= s) & (south <= n)
    return [int(k) for k in np.flatnonzero(near)]


def _named(table: Any, row: int) -> dict[str, Any]:
    names = table["names"][row].as_py() if "names" in table.column_names else None
    primary = names.get("primary") if isinstance(names, dict) else None
    return {"name": primary} if primary else {}
