"""Edges of extruded landmarks seen from above: roof outline, uprights, base edges.

    X(t) = start + t (end - start),  0 <= t <= 1                                                           (NED, m)

A side is seen from outside: (p_c - X) . n_out > 0. X is hidden where its line of sight, below the roof's plane, crosses the
outline on the map: exact for upright prisms.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.maps.landmarks import Landmark
from models.messages import Array

Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
_FLAT = 0.34  # sin(20 deg): two visible sides that meet at less than this angle make no edge to be found
_BACK_M = 0.02  # a point is examined from this far before its wall, so that its own wall does not hide it


class Kind(IntEnum):
    """Kind of an edge."""

    ROOF = 0
    BASE = 1
    UPRIGHT = 2
    SMALL = 3  # the whole roof of a landmark too small to have edges (small_landmarks.py)


class MapError(IntEnum):
    """Unknowns of a landmark [m]: shift north, east, rise of the roof, growth of the outline, tilt: rise towards north and east
    over the outline's RMS radius.
    """

    NORTH = 0
    EAST = 1
    RISE = 2
    GROWTH = 3
    TILT_NORTH = 4
    TILT_EAST = 5


_ROOF, _BASE, _UPRIGHT = int(Kind.ROOF), int(Kind.BASE), int(Kind.UPRIGHT)  # compiled code reads plain integers
_NORTH, _EAST, _RISE, _GROWTH, _TILT_NORTH, _TILT_EAST = (int(error) for error in MapError)
_ERRORS = len(MapError)


@dataclass(frozen=True, slots=True)
class Prisms:
    """L landmarks: vertices (V, 2) anticlockwise from above, offsets (L + 1,), base_d and height_m (L,)."""

    vertices: Array
    offsets: Indices
    base_d: Array
    height_m: Array

    @classmethod
    def of(cls, landmarks: Sequence[Landmark]) -> "Prisms":
        """The landmarks' bodies."""
        return cls(
            np.concatenate([np.empty((0, 2)), *(mark.outline_n for mark in landmarks)]),
            np.cumsum([0, *(len(mark.outline_n) for mark in landmarks)], dtype=np.int64),
            np.array([mark.base_d for mark in landmarks], dtype=np.float64),
            np.array([mark.height_m for mark in landmarks], dtype=np.float64),
        )

    @property
    def roofs(self) -> Array:
        """Corners (V, 3) of the roofs."""
        return np.column_stack((self.vertices, np.repeat(self.base_d - self.height_m, np.diff(self.offsets))))

    def moved(self, shift_m: Array) -> "Prisms":
        """Moved by map errors shift_m (L, M), as they hide and are hidden."""
        vertices = _moved(self.vertices, self.offsets, shift_m)
        return Prisms(vertices, self.offsets, self.base_d, self.height_m + shift_m[:, _RISE] * (self.height_m > 0.0))


@dataclass(frozen=True, slots=True)
class ModelEdges:
    """E edges of L landmarks from one position.

    start_n, end_n: (E, 3) m, roof and base edges anticlockwise; landmark: (E,); kind: (E,) Kind; partner: (E,) base edge below a
    roof edge of a visible side and reverse, -1 without; map_start, map_end: (E, 3, M) derivatives by MapError; raised: (E,) not
    painted on the ground.
    """

    start_n: Array
    end_n: Array
    landmark: Indices
    kind: Indices
    partner: Indices
    map_start: Array
    map_end: Array
    raised: Mask


def visible_edges(landmarks: Prisms | Sequence[Landmark], p_nc: Array, shift_m: Array | None = None) -> ModelEdges:
    """Edges seen from p_nc (3,) m, landmarks off the map by shift_m (L, M); roofs must be below."""
    prisms = landmarks if isinstance(landmarks, Prisms) else Prisms.of(landmarks)
    count = len(prisms.base_d)
    shift = np.zeros((count, len(MapError))) if shift_m is None else shift_m
    edges = _visible_edges(prisms.vertices, prisms.offsets, prisms.base_d, prisms.height_m, p_nc, shift)
    return ModelEdges(*edges, raised=prisms.height_m[edges[2]] > 0.0)


@njit(cache=True)
def _visible_edges(
    vertices: Array, offsets: Indices, base_d: Array, height: Array, p_c: Array, shift: Array
) -> tuple[Array, Array, Indices, Indices, Indices, Array, Array]:
    most = 3 * len(vertices)
    ends, by_map = np.empty((2, most, 3)), np.zeros((2, most, 3, _ERRORS))
    landmark, kind, partner = np.empty(most, np.int64), np.empty(most, np.int64), np.full(most, -1)
    foot, n = np.zeros(3), int(np.int64(0))  # not a literal: _put would be compiled for both
    for m in range(len(base_d)):
        roof_d = base_d[m] - height[m] - shift[m, _RISE]
        if p_c[2] >= roof_d:
            continue
        outline = vertices[offsets[m] : offsets[m + 1]]
        corners, mitre, outward = _corners(outline, shift[m])
        lever = _levers(outline)
        count = len(corners)
        seen = np.empty(count, np.bool_)
        for j in range(count):
            towards = (p_c[0] - corners[j, 0]) * outward[j, 0] + (p_c[1] - corners[j, 1]) * outward[j, 1]
            seen[j] = towards > 0.0 and height[m] > 0.0
            after = (j + 1) % count
            for end in range(2):
                k = after if end else j
                _put(n, end, corners[k], mitre[k], roof_d, lever[k], shift[m], ends, by_map)
            landmark[n], kind[n] = m, _ROOF
            n += 1
        first = n - count
        for j in range(count):
            if seen[j]:
                after = (j + 1) % count
                for end in range(2):
                    k = after if end else j
                    _put(n, end, corners[k], mitre[k], base_d[m], foot, shift[m], ends, by_map)
                landmark[n], kind[n], partner[n], partner[first + j] = m, _BASE, first + j, n
                n += 1
        for j in range(count):
            b = j - 1 if j > 0 else count - 1
            turn = abs(outward[b, 0] * outward[j, 1] - outward[b, 1] * outward[j, 0])
            if (seen[j] or seen[b]) and not (seen[j] and seen[b] and turn < _FLAT):
                for end in range(2):
                    down, rise = (base_d[m], foot) if end else (roof_d, lever[j])
                    _put(n, end, corners[j], mitre[j], down, rise, shift[m], ends, by_map)
                landmark[n], kind[n] = m, _UPRIGHT
                n += 1
    return ends[0, :n].copy(), ends[1, :n].copy(), landmark[:n], kind[:n], partner[:n], by_map[0, :n].copy(), by_map[1, :n].copy()


@njit(cache=True)
def _moved(vertices: Array, offsets: Indices, shift: Array) -> Array:
    corners = np.empty_like(vertices)
    for m in range(len(offsets) - 1):
        moved = _corners(vertices[offsets[m] : offsets[m + 1]], shift[m])[0]
        for j in range(len(moved)):
            corners[offsets[m] + j, 0], corners[offsets[m] + j, 1] = moved[j, 0], moved[j, 1]
    return corners


@njit(cache=True)
def _corners(outline: Array, shift: Array) -> tuple[Array, Array, Array]:
    """True corners (K, 2), their mitre motion per metre of growth, outward normals."""
    count = len(outline)
    outward, mitre, corners = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2))
    for j in range(count):
        after = (j + 1) % count
        dn, de = outline[after, 0] - outline[j, 0], outline[after, 1] - outline[j, 1]
        length = np.sqrt(dn * dn + de * de)
        outward[j, 0], outward[j, 1] = -de / length, dn / length
    for j in range(count):
        before = j - 1 if j > 0 else count - 1
        cosine = outward[before, 0] * outward[j, 0] + outward[before, 1] * outward[j, 1]
        for k in range(2):
            mitre[j, k] = (outward[before, k] + outward[j, k]) / max(1.0 + cosine, 0.2)
        corners[j, 0] = outline[j, 0] + shift[_GROWTH] * mitre[j, 0] + shift[_NORTH]
        corners[j, 1] = outline[j, 1] + shift[_GROWTH] * mitre[j, 1] + shift[_EAST]
    return corners, mitre, outward


@njit(cache=True)
def _levers(outline: Array) -> Array:
    """Rise (K, 3) of each corner per metre of RISE, TILT_NORTH and TILT_EAST."""
    count, north, east, square = len(outline), 0.0, 0.0, 0.0
    for j in range(count):
        north += outline[j, 0]
        east += outline[j, 1]
    lever = np.empty((count, 3))
    for j in range(count):
        lever[j, 0], lever[j, 1], lever[j, 2] = 1.0, outline[j, 0] - north / count, outline[j, 1] - east / count
        square += lever[j, 1] ** 2
        square += lever[j, 2] ** 2
    for j in range(count):
        lever[j, 1] /= np.sqrt(square / count)
        lever[j, 2] /= np.sqrt(square / count)
    return lever


@njit(cache=True)
def _put(
    n: int, end: int, corner: Array, mitre: Array, down: float, lever: Array, shift: Array, ends: Array, by_map: Array
) -> None:
    tilt = lever[1] * shift[_TILT_NORTH] + lever[2] * shift[_TILT_EAST]
    ends[end, n, 0], ends[end, n, 1], ends[end, n, 2] = corner[0], corner[1], down - tilt
    by_map[end, n, 0, _NORTH] = by_map[end, n, 1, _EAST] = 1.0
    by_map[end, n, 0, _GROWTH], by_map[end, n, 1, _GROWTH] = mitre[0], mitre[1]
    by_map[end, n, 2, _RISE] = -lever[0]
    by_map[end, n, 2, _TILT_NORTH], by_map[end, n, 2, _TILT_EAST] = -lever[1], -lever[2]


def hidden(points_n: Array, p_nc: Array, landmarks: Prisms | Sequence[Landmark]) -> NDArray[np.bool_]:
    """Which points_n (N, 3) landmarks hide from a camera at p_nc."""
    prisms = landmarks if isinstance(landmarks, Prisms) else Prisms.of(landmarks)
    result = np.zeros(len(points_n), dtype=np.bool_)
    hide(points_n, p_nc, prisms.vertices, prisms.offsets, prisms.base_d, prisms.height_m, result)
    return result


@njit(cache=True)
def hide(
    points: Array, p_c: Array, vertices: Array, offsets: Indices, base_d: Array, height: Array, result: NDArray[np.bool_]
) -> None:
    """Set result (N,) where a prism hides points (N, 3); set ones are skipped."""
    for m in range(len(base_d)):
        if height[m] > 0.0:
            _hidden_by(points, p_c, vertices[offsets[m] : offsets[m + 1]], base_d[m] - height[m], result)


@njit(cache=True)
def _hidden_by(points: Array, p_c: Array, outline: Array, roof_d: float, result: NDArray[np.bool_]) -> None:
    count = outline.shape[0]
    south, north, west, east = np.inf, -np.inf, np.inf, -np.inf
    for j in range(count):
        south, north = min(south, outline[j, 0]), max(north, outline[j, 0])
        west, east = min(west, outline[j, 1]), max(east, outline[j, 1])
    for i in range(points.shape[0]):
        depth = points[i, 2] - roof_d
        if result[i] or depth <= 1e-9 or p_c[2] >= roof_d:
            continue
        share = depth / (points[i, 2] - p_c[2])
        n0, e0 = points[i, 0], points[i, 1]
        dn, de = share * (p_c[0] - n0), share * (p_c[1] - e0)  # from the point to where its ray leaves the roof's height
        if max(n0, n0 + dn) < south or min(n0, n0 + dn) > north or max(e0, e0 + de) < west or min(e0, e0 + de) > east:
            continue
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
