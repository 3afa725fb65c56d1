"""Polygons in well-known binary: outer rings only, without heights.

    byte order (1), type (uint32), then of a polygon: number of rings, of each the number of points and the points (doubles)

Types: 3 polygon, 6 multipolygon; + 1000 z, + 2000 m, + 3000 both (ISO), or top bits z, m, SRID (EWKB). OGC 06-103r4, section 8.
"""

import struct

import numpy as np

from models.messages import Array

_POLYGON, _MULTIPOLYGON = 3, 6
_Z, _M, _SRID = 0x8000_0000, 0x4000_0000, 0x2000_0000


def outer_rings(data: bytes) -> list[Array]:
    """(n, 2) of each polygon; none for others. Raises ValueError for torn bytes."""
    try:
        found, _ = _geometry(data, 0)
    except (struct.error, IndexError) as error:
        raise ValueError(f"torn geometry: {error}") from None
    return found


def _geometry(data: bytes, at: int) -> tuple[list[Array], int]:
    order = "<" if data[at] else ">"
    (code,) = struct.unpack_from(f"{order}I", data, at + 1)
    at += 5 + (4 if code & _SRID else 0)
    plain = code & 0x0FFF_FFFF
    kind, extra = plain % 1000, {0: 0, 1: 1, 2: 1, 3: 2}.get(plain // 1000, 0) + bool(code & _Z) + bool(code & _M)
    if kind == _POLYGON:
        return _polygon(data, at, order, 2 + extra)
    if kind != _MULTIPOLYGON:
        return [], at
    (count,) = struct.unpack_from(f"{order}I", data, at)
    at, found = at + 4, []
    for _ in range(count):
        part, at = _geometry(data, at)
        found += part
    return found, at


def _polygon(data: bytes, at: int, order: str, size: int) -> tuple[list[Array], int]:
    (count,) = struct.unpack_from(f"{order}I", data, at)
    at, outer = at + 4, []
    for k in range(count):
        (points,) = struct.unpack_from(f"{order}I", data, at)
        at += 4
        end = at + 8 * size * points
        if end > len(data):
            raise ValueError("torn geometry")
        if k == 0:
            outer.append(np.frombuffer(data[at:end], f"{order}f8").reshape(-1, size)[:, :2].astype(float))
        at = end
    return outer, at
