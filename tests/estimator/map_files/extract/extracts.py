"""Small extracts of three buildings in every format: a house, one with a courtyard, one of two parts; and a house far away.

The OpenStreetMap files are written by the formats' own definitions (OSM XML 0.6; PBF: fileformat.proto, osmformat.proto).
"""

import json
import math
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio.raw
import pyproj

LAT, LON = 47.37, 8.54
Ring = list[tuple[float, float]]


def square(lon: float, lat: float, metres: float) -> Ring:
    """Closed, its south-west corner at the place."""
    dlat = metres / 111_320.0
    dlon = dlat / math.cos(math.radians(lat))
    return [(lon, lat), (lon + dlon, lat), (lon + dlon, lat + dlat), (lon, lat + dlat), (lon, lat)]


HOUSE = square(LON, LAT, 10.0)
COURT, YARD = square(LON + 0.001, LAT, 30.0), square(LON + 0.0011, LAT + 0.00005, 8.0)
PARTS = [square(LON, LAT + 0.001, 12.0), square(LON + 0.0005, LAT + 0.001, 14.0)]
FAR = square(LON + 1.0, LAT, 10.0)
POLYGONS: list[tuple[str, list[list[Ring]], dict[str, Any]]] = [
    ("1", [[HOUSE]], {"height": 8.5}),
    ("2", [[COURT, YARD]], {"height": 12.0}),
    ("3", [[ring] for ring in PARTS], {}),
    ("4", [[FAR]], {"height": 5.0}),
]


def feature(name: str, polygons: list[list[Ring]], properties: dict[str, Any], heights: bool = False) -> dict[str, Any]:
    """Of GeoJSON; heights: with a third coordinate."""
    given = [[[[*p, 400.0] if heights else list(p) for p in ring] for ring in rings] for rings in polygons]
    geometry = {"type": "MultiPolygon", "coordinates": given} if len(given) > 1 else {"type": "Polygon", "coordinates": given[0]}
    return {"type": "Feature", "id": name, "properties": properties, "geometry": geometry}


def moved(epsg: int) -> list[tuple[str, list[list[Ring]], dict[str, Any]]]:
    """The polygons in another coordinate system."""
    convert = pyproj.Transformer.from_crs(4326, epsg, always_xy=True).transform
    return [(n, [[[convert(*p) for p in ring] for ring in rings] for rings in q], given) for n, q, given in POLYGONS]


def geojson(path: Path, epsg: int = 4326, heights: bool = False) -> Path:
    """One document."""
    crs = {} if epsg == 4326 else {"crs": {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}}
    polygons = POLYGONS if epsg == 4326 else moved(epsg)
    path.write_text(
        json.dumps({"type": "FeatureCollection", **crs, "features": [feature(*p, heights=heights) for p in polygons]})
    )
    return path


def lines(path: Path) -> Path:
    """A feature a line."""
    path.write_text("".join(json.dumps(feature(*p)) + "\n" for p in POLYGONS))
    return path


def wkb(polygons: list[list[Ring]]) -> bytes:
    """A multipolygon with heights (ISO)."""
    parts = []
    for rings in polygons:
        points = [struct.pack("<I", len(r)) + b"".join(struct.pack("<3d", *p, 400.0) for p in r) for r in rings]
        parts.append(struct.pack("<BII", 1, 1003, len(rings)) + b"".join(points))
    return struct.pack("<BII", 1, 1006, len(parts)) + b"".join(parts)


def gdal(path: Path, driver: str, epsg: int) -> Path:
    """A layer of a library."""
    polygons = POLYGONS if epsg == 4326 else moved(epsg)
    pyogrio.raw.write(
        path, np.array([wkb(p) for _, p, _ in polygons], dtype=object),
        [np.array([q.get("height", np.nan) for *_, q in polygons]), np.array([n for n, *_ in polygons], dtype=object)],
        ["height", "id"], geometry_type="MultiPolygon Z", crs=f"EPSG:{epsg}", driver=driver,
    )  # fmt: skip
    return path


def parquet(path: Path, epsg: int = 4326) -> Path:
    """As Overture publishes it: WKB, a bbox, names.primary."""
    polygons = POLYGONS if epsg == 4326 else moved(epsg)
    crs = {} if epsg == 4326 else {"crs": json.loads(pyproj.CRS(epsg).to_json())}
    about = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": {"encoding": "WKB", **crs}}}
    corners = [np.array([p for rings in q for ring in rings for p in ring]) for _, q, _ in polygons]
    box = [dict(zip(("xmin", "ymin", "xmax", "ymax"), (*c.min(0), *c.max(0)), strict=True)) for c in corners]
    table = pa.table(
        {
            "id": [n for n, *_ in polygons],
            "geometry": [wkb(p) for _, p, _ in polygons],
            "height": [q.get("height") for *_, q in polygons],
            "num_floors": [None, None, 4, None],
            "names": [{"primary": f"house {n}"} for n, *_ in polygons],
            **({"bbox": box} if epsg == 4326 else {}),
        }
    )
    pq.write_table(table.replace_schema_metadata({"geo": json.dumps(about)}), path)
    return path


# --------------------------------------------------------------------------------------------------------------- OpenStreetMap


def _elements() -> tuple[dict[int, tuple[float, float]], dict[int, tuple[list[int], dict[str, str]]], list[Any]]:
    """Nodes, ways, relations: the house, the courtyard as a relation whose outer ring is two ways, a road, the far house."""
    nodes: dict[int, tuple[float, float]] = {}

    def way(points: Sequence[tuple[float, float]]) -> list[int]:
        numbers = []
        for p in points:
            number = next((k for k, known in nodes.items() if known == p), len(nodes) + 1)
            nodes[number] = p
            numbers.append(number)
        return numbers

    ways = {
        11: (way(HOUSE), {"building": "house", "building:levels": "2"}),
        21: (way(COURT[:3]), {}),
        22: (way(COURT[2:]), {}),
        23: (way(YARD), {}),
        31: (way([(LON, LAT), (LON + 0.01, LAT)]), {"highway": "residential"}),
        41: (way(FAR), {"building": "yes"}),
    }
    members = [(21, "outer"), (22, "outer"), (23, "inner")]
    return nodes, ways, [(51, members, {"type": "multipolygon", "building": "yes", "height": "12 m"})]


def overpass(path: Path, geometry: bool) -> Path:
    """The answer of Overpass; geometry: `out geom;`, else `out body; >; out skel;`."""
    nodes, ways, relations = _elements()

    def at(refs: list[int]) -> list[dict[str, float]]:
        return [{"lon": nodes[r][0], "lat": nodes[r][1]} for r in refs]

    elements: list[dict[str, Any]] = []
    for number, (refs, tags) in ways.items():
        elements.append(
            {"type": "way", "id": number, "nodes": refs, "tags": tags, **({"geometry": at(refs)} if geometry else {})}
        )
    for number, members, tags in relations:
        listed = [
            {"type": "way", "ref": r, "role": role, **({"geometry": at(ways[r][0])} if geometry else {})} for r, role in members
        ]
        elements.append({"type": "relation", "id": number, "members": listed, "tags": tags})
    if not geometry:
        elements += [{"type": "node", "id": k, "lon": lon, "lat": lat} for k, (lon, lat) in nodes.items()]
    path.write_text(json.dumps({"version": 0.6, "elements": elements}))
    return path


def osm_xml(path: Path) -> Path:
    """.osm"""
    nodes, ways, relations = _elements()

    def tag(tags: dict[str, str]) -> str:
        return "".join(f'<tag k="{k}" v="{v}"/>' for k, v in tags.items())

    text = "".join(f'<node id="{k}" lat="{lat!r}" lon="{lon!r}" version="1"/>\n' for k, (lon, lat) in nodes.items())
    for number, (refs, tags) in ways.items():
        text += f'<way id="{number}" version="1">' + "".join(f'<nd ref="{r}"/>' for r in refs) + tag(tags) + "</way>\n"
    for number, members, tags in relations:
        listed = "".join(f'<member type="way" ref="{r}" role="{role}"/>' for r, role in members)
        text += f'<relation id="{number}" version="1">{listed}{tag(tags)}</relation>\n'
    path.write_text(f'<?xml version="1.0"?>\n<osm version="0.6">\n{text}</osm>\n')
    return path


def osm_pbf(path: Path) -> Path:
    """.osm.pbf: a header block and one primitive block."""
    nodes, ways, relations = _elements()
    strings = [""]

    def word(text: str) -> int:
        if text not in strings:
            strings.append(text)
        return strings.index(text)

    def tags(given: dict[str, str]) -> bytes:
        return _packed(2, [word(k) for k in given]) + _packed(3, [word(v) for v in given.values()]) if given else b""

    group_nodes, group_ways, group_relations = b"", b"", b""
    for k, (lon, lat) in nodes.items():
        group_nodes += _bytes(1, _int(1, _zigzag(k)) + _int(8, _zigzag(round(lat * 1e7))) + _int(9, _zigzag(round(lon * 1e7))))
    for k, (refs, given) in ways.items():
        group_ways += _bytes(3, _int(1, k) + tags(given) + _packed(8, [_zigzag(d) for d in np.diff(refs, prepend=0).tolist()]))
    for k, members, given in relations:
        refs = np.diff([r for r, _ in members], prepend=0).tolist()
        body = (
            _packed(8, [word(role) for _, role in members])
            + _packed(9, [_zigzag(d) for d in refs])
            + _packed(10, [1] * len(refs))
        )
        group_relations += _bytes(4, _int(1, k) + tags(given) + body)
    table = _bytes(1, b"".join(_bytes(1, s.encode()) for s in strings))
    groups = b"".join(_bytes(2, g) for g in (group_nodes, group_ways, group_relations))
    header = _bytes(4, b"OsmSchema-V0.6")
    path.write_bytes(_blob(b"OSMHeader", header) + _blob(b"OSMData", table + groups))
    return path


def _blob(kind: bytes, content: bytes) -> bytes:
    blob = _int(2, len(content)) + _bytes(3, zlib.compress(content))
    head = _bytes(1, kind) + _int(3, len(blob))
    return struct.pack(">I", len(head)) + head + blob


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _zigzag(value: int) -> int:
    return 2 * value if value >= 0 else -2 * value - 1


def _int(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(value)) + value


def _packed(field: int, values: list[int]) -> bytes:
    return _bytes(field, b"".join(map(_varint, values)))
