"""Which edges of extruded landmarks a camera above them sees: roof outline, upright edges, and base edges of visible sides.

    X(t) = start + t (end - start),  0 <= t <= 1                                                           (NED, m)

A side is seen from its outer half-space: (p_c - X) . n_out > 0. A point X below a roof is hidden by that landmark if the
horizontal track of its line of sight, from where the sight crosses the roof's plane to X, meets the outline: exact for upright
prisms seen from above. Every point carries its derivatives by the landmark's own unknowns (MapError), so that errors of the map
can be weighed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

Indices = NDArray[np.int64]
_FLAT = 0.34  # sin(20 deg): two visible sides that meet at less than this angle make no edge to be found
_BACK_M = 0.02  # a point is looked at from this far before its wall, so that its own wall does not hide it


class Kind(IntEnum):
    """What an edge separates."""

    ROOF = 0
    BASE = 1
    UPRIGHT = 2


class MapError(IntEnum):
    """Unknowns of one landmark: shift north and east, rise of the roof, growth of the outline [m]."""

    NORTH = 0
    EAST = 1
    RISE = 2
    GROWTH = 3


class Extruded(Protocol):
    """What is needed of a landmark (models/landmarks.py)."""

    @property
    def outline_n(self) -> Array:
        """Roof edge, north and east, (K, 2) m."""

    @property
    def base_d(self) -> float:
        """Down coordinate of the ground, m."""

    @property
    def height_m(self) -> float:
        """Roof above ground, m; 0 is painted on the ground."""


@dataclass(frozen=True, slots=True)
class ModelEdges:
    """E edges of L landmarks as seen from one place.

    start_n, end_n: (E, 3) m; landmark: (E,) index; kind: (E,) Kind; partner: (E,) the base edge below a roof edge whose side is
    visible and the other way round, -1 without; map_start, map_end: (E, 3, 4) derivatives of the ends by MapError.
    """

    start_n: Array
    end_n: Array
    landmark: Indices
    kind: Indices
    partner: Indices
    map_start: Array
    map_end: Array


def visible_edges(landmarks: Sequence[Extruded], p_nc: Array) -> ModelEdges:
    """Edges of the landmarks seen from p_nc (3,) m; none of a landmark whose roof is not below the camera."""
    parts = [_landmark_edges(i, mark, p_nc) for i, mark in enumerate(landmarks)]
    offset, partners = 0, []
    for part in parts:
        partners.append(np.where(part.partner >= 0, part.partner + offset, -1))
        offset += len(part.partner)

    def join(name: str) -> NDArray[np.generic]:
        return np.concatenate([getattr(part, name) for part in parts])

    names = ("start_n", "end_n", "landmark", "kind", "map_start", "map_end")
    joined: dict[str, NDArray[np.generic]] = {name: join(name) for name in names}
    return ModelEdges(partner=np.concatenate(partners), **joined)  # type: ignore[arg-type]


def _landmark_edges(index: int, mark: Extruded, p_nc: Array) -> ModelEdges:
    outline = np.asarray(mark.outline_n, dtype=float)
    count, roof_d = len(outline), mark.base_d - mark.height_m
    along = np.roll(outline, -1, axis=0) - outline
    turn = np.sign(np.sum(outline[:, 0] * np.roll(outline[:, 1], -1) - np.roll(outline[:, 0], -1) * outline[:, 1]))
    outward = turn * np.column_stack((along[:, 1], -along[:, 0])) / np.linalg.norm(along, axis=1)[:, None]
    seen = np.sum((p_nc[:2] - outline) * outward, axis=1) > 0.0
    before = np.roll(seen, 1)
    flat = np.abs(_cross(np.roll(outward, 1, axis=0), outward)) < _FLAT
    following = (np.arange(count) + 1) % count
    roof = np.column_stack((outline, np.full(count, roof_d)))
    base = np.column_stack((outline, np.full(count, mark.base_d)))
    by_roof, by_base = _map_derivatives(outward)

    raised = mark.height_m > 0.0
    sides = np.flatnonzero(seen) if raised else np.empty(0, dtype=np.int64)
    uprights = np.flatnonzero((seen | before) & ~(seen & before & flat)) if raised else np.empty(0, dtype=np.int64)
    if p_nc[2] >= roof_d:
        count, sides, uprights = 0, sides[:0], uprights[:0]
    roofs = np.arange(count)
    partner = np.full(count + len(sides) + len(uprights), -1)
    partner[sides] = count + np.arange(len(sides))
    partner[count : count + len(sides)] = sides
    return ModelEdges(
        start_n=np.concatenate((roof[roofs], base[sides], roof[uprights])),
        end_n=np.concatenate((roof[following[roofs]], base[following[sides]], base[uprights])),
        landmark=np.full(len(partner), index),
        kind=np.repeat([Kind.ROOF, Kind.BASE, Kind.UPRIGHT], [count, len(sides), len(uprights)]).astype(np.int64),
        partner=partner,
        map_start=np.concatenate((by_roof[roofs], by_base[sides], by_roof[uprights])),
        map_end=np.concatenate((by_roof[following[roofs]], by_base[following[sides]], by_base[uprights])),
    )


def _map_derivatives(outward: Array) -> tuple[Array, Array]:
    """d(roof corner), d(base corner) / d MapError, (K, 3, 4) each: a corner grows along the mitre of its two sides."""
    before = np.roll(outward, 1, axis=0)
    mitre = (before + outward) / np.maximum(1.0 + np.sum(before * outward, axis=1), 0.2)[:, None]
    base = np.zeros((len(outward), 3, 4))
    base[:, 0, MapError.NORTH] = base[:, 1, MapError.EAST] = 1.0
    base[:, :2, MapError.GROWTH] = mitre
    roof = base.copy()
    roof[:, 2, MapError.RISE] = -1.0
    return roof, base


def _cross(a: Array, b: Array) -> Array:
    product: Array = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product


def hidden(points_n: Array, p_nc: Array, landmarks: Sequence[Extruded]) -> NDArray[np.bool_]:
    """Which of points_n (N, 3) are hidden by one of the landmarks from a camera at p_nc."""
    result = np.zeros(len(points_n), dtype=np.bool_)
    for mark in landmarks:
        if mark.height_m > 0.0:
            _hidden_by(points_n, p_nc, np.ascontiguousarray(mark.outline_n, dtype=float), mark.base_d - mark.height_m, result)
    return result


@njit(cache=True)
def _hidden_by(points: Array, p_c: Array, outline: Array, roof_d: float, result: NDArray[np.bool_]) -> None:
    count = outline.shape[0]
    for i in range(points.shape[0]):
        depth = points[i, 2] - roof_d
        if result[i] or depth <= 1e-9 or p_c[2] >= roof_d:
            continue
        share = depth / (points[i, 2] - p_c[2])
        n0, e0 = points[i, 0], points[i, 1]
        dn, de = share * (p_c[0] - n0), share * (p_c[1] - e0)  # from the point to where its sight leaves the roof's height
        length = np.sqrt(dn * dn + de * de)
        if length <= _BACK_M:
            continue
        n0 += dn / length * _BACK_M
        e0 += de / length * _BACK_M
        dn *= 1.0 - _BACK_M / length
        de *= 1.0 - _BACK_M / length
        inside = False
        for j in range(count):
            k = (j + 1) % count
            an, ae = outline[j, 0] - n0, outline[j, 1] - e0
            bn, be = outline[k, 0] - n0, outline[k, 1] - e0
            if (ae > 0.0) != (be > 0.0) and an + (bn - an) * ae / (ae - be) > 0.0:
                inside = not inside
            side_a, side_b = dn * ae - de * an, dn * be - de * bn
            if (side_a > 0.0) != (side_b > 0.0):
                s = side_a / (side_a - side_b)
                along = (an + s * (bn - an)) * dn + (ae + s * (be - ae)) * de
                if 0.0 < along < dn * dn + de * de:
                    result[i] = True
        if inside:
            result[i] = True
