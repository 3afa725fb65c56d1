"""Visible faces of solids, nearest first, as polygons and texture maps.

    (s w, t w, w) = H @ (x/z, y/z, 1),      range along the ray = k |(x/z, y/z, 1)| / w

H: camera ray to face position [m]; for a face through q of axes a, b, normal m, seen from p along r,
s w = (a.(p - q) m + m.(q - p) a).r,  w = m.r,  k = m.(q - p). Faces are cut to the image, and into short pieces for the lens.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order as ordering
from models.messages import Array
from vision.synthetic.texture import Scalar
from vision.synthetic.world import Columns

Indices = NDArray[np.int64]

_NEAR = 0.05  # m before the camera
_CUTS = 5  # planes of the frustum; each adds at most as many corners as a polygon has
SKY = 0.7  # share of the sky's light that a wall gets
_APART = 1e-6  # m; outlines that touch are apart

CONTRAST, RIDGE, RANGE, SHIFT_S, SHIFT_T, FLAT = range(6)  # columns of Faces.parameters


class View(NamedTuple):
    """Camera pose, and limits of x/z and y/z."""

    p_nc: Array
    R_nc: Array
    limits: Array
    piece: float  # longest piece of an edge on the normalised plane


class Faces(NamedTuple):
    """F faces of S solids, nearest first; vertices are rays (V, 3) of z = 1."""

    vertices: Array
    offsets: Indices  # (F + 1,) into vertices
    solids: Indices  # (S,) which solid
    solid_offsets: Indices  # (S + 1,) into faces
    H: Array  # (F, 3, 3)
    colour: Array  # (F, 3), lit
    texture: Indices  # (F,)
    parameters: Array  # (F, 6)


def visible_faces(columns: Columns, view: View, sun_n: Array, ambient: float) -> Faces:
    """Faces that may be seen; walls lit by the sun's angle, relative to level ground."""
    c = columns
    found = _collect(
        c.vertices, c.offsets, c.base_d, c.height_m, c.centre_n, c.radius_m, c.roof_bgr, c.wall_bgr, c.textures, c.contrasts,
        c.ridge, c.orientation_rad, *view, sun_n, ambient,
    )  # fmt: skip
    return Faces(*found)


@njit(cache=True)
def in_frustum(centre: Array, radius: float, p_nc: Array, R_nc: Array, limits: Array) -> bool:
    """Whether a sphere (centre in n) touches the view."""
    x = np.zeros(3)
    for k in range(3):
        for i in range(3):
            x[k] += R_nc[i, k] * (centre[i] - p_nc[i])
    z = x[2]
    if z + radius < _NEAR:
        return False
    for axis in range(2):
        c, low, high = x[axis], limits[2 * axis], limits[2 * axis + 1]
        if (c - low * z) / math.sqrt(1.0 + low * low) < -radius or (high * z - c) / math.sqrt(1.0 + high * high) < -radius:
            return False
    return True


@njit(cache=True)
def _collect(
    vertices: Array, offsets: Indices, base_d: Array, height_m: Array, centre_n: Array, radius_m: Array, roof_bgr: Array,
    wall_bgr: Array, textures: Indices, contrasts: Array, ridge: Array, orientation: Array,
    p_nc: Array, R_nc: Array, limits: Array, piece: float, sun_n: Array, ambient: float,
) -> tuple[Array, Indices, Indices, Indices, Array, Array, Indices, Array]:  # fmt: skip
    solids = nearest_first(
        _in_view(base_d, height_m, centre_n, radius_m, p_nc, R_nc, limits), vertices, offsets, height_m, centre_n, radius_m, p_nc
    )
    most = len(solids)
    for i in solids:
        most += offsets[i + 1] - offsets[i]
    H, colour = np.empty((most, 3, 3)), np.empty((most, 3))
    texture, parameters = np.empty(most, dtype=np.int64), np.zeros((most, 6))
    axes = np.empty((4, 3))
    face_offsets, solid_offsets = np.zeros(most + 1, dtype=np.int64), np.zeros(len(solids) + 1, dtype=np.int64)
    points, face = np.empty((4096, 3)), 0
    for position, i in enumerate(solids):
        outline, roof_d = vertices[offsets[i] : offsets[i + 1]], base_d[i] - height_m[i]
        for wall in _order_of_walls(outline, p_nc, height_m[i] > 0.0):
            if wall < 0:
                which, light, paint = 0, 1.0, roof_bgr[i]
                polygon = _roof(outline, roof_d, centre_n[i], orientation[i], axes)
            else:
                polygon = _wall(outline[wall], outline[(wall + 1) % len(outline)], roof_d, base_d[i], axes)
                which, light, paint = 1, _light(axes[3], sun_n, ambient), wall_bgr[i]
            reach = 0.0
            for k in range(3):
                reach += axes[3, k] * (axes[0, k] - p_nc[k])
            if reach <= 0.0:  # a roof above the camera
                continue
            points, end = append(points, face_offsets[face], clip(in_camera(polygon, p_nc, R_nc), limits), piece)
            if end == face_offsets[face]:
                continue
            _to_plane(axes, p_nc, R_nc, reach, H[face])
            texture[face] = textures[i, which]
            for k in range(3):
                colour[face, k] = paint[k] * light
            parameters[face, CONTRAST], parameters[face, RANGE] = contrasts[i, which], reach
            if which == 0:
                parameters[face, RIDGE], parameters[face, SHIFT_T] = ridge[i], 0.02 * ((i * 104729) % 503)
            parameters[face, SHIFT_S] = 0.02 * ((i * 7919) % 509)  # so that no two roofs are laid alike
            parameters[face, FLAT] = 1.0 if height_m[i] == 0.0 else 0.0
            face += 1
            face_offsets[face] = end
        solid_offsets[position + 1] = face
    return (
        points[: face_offsets[face]], face_offsets[: face + 1], solids, solid_offsets, H[:face], colour[:face], texture[:face],
        parameters[:face],
    )  # fmt: skip


@njit(cache=True)
def _in_view(
    base_d: Array, height_m: Array, centre_n: Array, radius_m: Array, p_nc: Array, R_nc: Array, limits: Array
) -> Indices:
    seen, count, middle = np.empty(len(base_d), dtype=np.int64), 0, np.empty(3)
    for i in range(len(base_d)):
        middle[0], middle[1], middle[2] = centre_n[i, 0], centre_n[i, 1], base_d[i] - 0.5 * height_m[i]
        if in_frustum(middle, math.hypot(radius_m[i], 0.5 * height_m[i]), p_nc, R_nc, limits):
            seen[count] = i
            count += 1
    return seen[:count]


@njit(cache=True)
def in_camera(polygon: Array, p_nc: Array, R_nc: Array) -> Array:
    """R_nc^T (x - p_nc) of corners (K, 3)."""
    turned = np.zeros((len(polygon), 3))
    for i in range(len(polygon)):
        for k in range(3):
            for j in range(3):
                turned[i, k] += (polygon[i, j] - p_nc[j]) * R_nc[j, k]
    return turned


@njit(cache=True)
def _roof(outline: Array, roof_d: float, centre_n: Array, orientation: float, axes: Array) -> Array:
    polygon = np.empty((len(outline), 3))
    for k in range(len(outline)):
        polygon[k, 0], polygon[k, 1], polygon[k, 2] = outline[k, 0], outline[k, 1], roof_d
    axes[:] = 0.0
    axes[0, 0], axes[0, 1], axes[0, 2] = centre_n[0], centre_n[1], roof_d
    axes[1, 0], axes[1, 1] = math.cos(orientation), math.sin(orientation)
    axes[2, 0], axes[2, 1] = -axes[1, 1], axes[1, 0]
    axes[3, 2] = 1.0
    return polygon


@njit(cache=True)
def _wall(a: Array, b: Array, roof_d: float, base_d: float, axes: Array) -> Array:
    polygon, length = np.empty((4, 3)), math.hypot(b[0] - a[0], b[1] - a[1])
    axes[:] = 0.0
    for k in range(2):
        polygon[0, k], polygon[1, k], polygon[2, k], polygon[3, k] = a[k], b[k], b[k], a[k]
        axes[0, k], axes[1, k] = a[k], (b[k] - a[k]) / length
    for k in range(4):
        polygon[k, 2] = roof_d if k < 2 else base_d
    axes[0, 2], axes[2, 2] = base_d, 1.0
    axes[3, 0], axes[3, 1] = axes[1, 1], -axes[1, 0]  # inwards
    return polygon


@njit(cache=True)
def _light(inwards: Array, sun_n: Array, ambient: float) -> float:
    sunlit = max(0.0, -(inwards[0] * sun_n[0] + inwards[1] * sun_n[1]))
    level = ambient - (1.0 - ambient) * sun_n[2]
    return float((SKY * ambient + (1.0 - ambient) * sunlit) / level)


@njit(cache=True)
def _order_of_walls(outline: Array, p_nc: Array, stands: bool) -> Indices:
    k = len(outline)
    order, far = np.full(k + 1, -1, dtype=np.int64), np.full(k + 1, -1.0)
    count = 1
    if stands:
        for i in range(k):
            a, b = outline[i], outline[(i + 1) % k]
            if _outside(a, b, p_nc) > 0.0:
                order[count] = i
                far[count] = math.hypot(0.5 * (a[0] + b[0]) - p_nc[0], 0.5 * (a[1] + b[1]) - p_nc[1])
                count += 1
    for i in range(2, count):
        wall, away, j = order[i], far[i], i
        while j > 1 and far[j - 1] > away:
            order[j], far[j] = order[j - 1], far[j - 1]
            j -= 1
        order[j], far[j] = wall, away
    return order[:count]


@njit(cache=True, inline="always")
def _outside(a: Array, b: Array, x: Array) -> Scalar:
    """Distance of x outside edge a to b of an anticlockwise outline, times its length."""
    return (b[0] - a[0]) * (x[1] - a[1]) - (b[1] - a[1]) * (x[0] - a[0])


@njit(cache=True)
def _to_plane(axes: Array, p: Array, R: Array, reach: float, H: Array) -> None:
    """Fill H (3, 3): ray in the camera (axes R) to (s w, t w, w); reach: m . (q - p)."""
    for row in range(3):
        off = 0.0
        for i in range(3):
            off += axes[1 + row, i] * (p[i] - axes[0, i])
        for k in range(3):
            H[row, k] = 0.0
            for i in range(3):
                part = axes[3, i] if row == 2 else off * axes[3, i] + reach * axes[1 + row, i]
                H[row, k] += part * R[i, k]


@njit(cache=True)
def clip(polygon_c: Array, limits: Array) -> Array:
    """A polygon (K, 3) before the camera within its limits (Sutherland and Hodgman 1974)."""
    kept = polygon_c
    for plane in range(_CUTS):
        n = len(kept)
        if n == 0:
            break
        side = np.empty(n)
        for i in range(n):
            x, y, z = kept[i, 0], kept[i, 1], kept[i, 2]
            if plane == 0:
                side[i] = z - _NEAR
            elif plane < 3:
                side[i] = x - limits[0] * z if plane == 1 else limits[1] * z - x
            else:
                side[i] = y - limits[2] * z if plane == 3 else limits[3] * z - y
        cut, count = np.empty((2 * n, 3)), 0
        for i in range(n):
            j = i + 1 if i + 1 < n else 0
            if side[i] >= 0.0:
                for k in range(3):
                    cut[count, k] = kept[i, k]
                count += 1
            if (side[i] >= 0.0) != (side[j] >= 0.0):
                part = side[i] / (side[i] - side[j])
                for k in range(3):
                    cut[count, k] = kept[i, k] + part * (kept[j, k] - kept[i, k])
                count += 1
        kept = cut[:count]
    return kept


@njit(cache=True)
def append(points: Array, start: int, polygon_c: Array, piece: float) -> tuple[Array, int]:
    """Corners and points between as rays of z = 1 from row `start`; the table, perhaps grown, its end."""
    n, end = len(polygon_c), start
    for i in range(n if n >= 3 else 0):
        j = i + 1 if i + 1 < n else 0
        x0, y0 = polygon_c[i, 0] / polygon_c[i, 2], polygon_c[i, 1] / polygon_c[i, 2]
        x1, y1 = polygon_c[j, 0] / polygon_c[j, 2], polygon_c[j, 1] / polygon_c[j, 2]
        pieces = max(1, math.ceil(max(abs(x1 - x0), abs(y1 - y0)) / piece))
        if end + pieces > len(points):
            grown = np.empty((2 * (end + pieces), 3))
            for k in range(end):
                grown[k, 0], grown[k, 1], grown[k, 2] = points[k, 0], points[k, 1], points[k, 2]
            points = grown
        for k in range(pieces):
            points[end, 0], points[end, 1], points[end, 2] = x0 + (x1 - x0) * k / pieces, y0 + (y1 - y0) * k / pieces, 1.0
            end += 1
    return points, end


@njit(cache=True)
def nearest_first(
    seen: Indices, vertices: Array, offsets: Indices, height_m: Array, centre_n: Array, radius_m: Array, p_nc: Array
) -> Indices:
    """Standing solids, occluders first, then flat ones, the last laid first.

    A separating line decides which of two is in front.
    """
    n = len(seen)
    order, distance = np.empty(n, dtype=np.int64), np.empty(n)
    for k in range(n):
        i = seen[k]
        distance[k] = math.hypot(centre_n[i, 0] - p_nc[0], centre_n[i, 1] - p_nc[1]) if height_m[i] > 0.0 else 1e9 - i
    ranked, near = np.empty(n, dtype=np.int64), ordering.ranked(distance)
    for k in range(n):
        ranked[k] = seen[near[k]]
    standing = 0
    while standing < n and height_m[ranked[standing]] > 0.0:
        standing += 1
    waits, hides = np.zeros(n, dtype=np.int64), np.zeros((standing, standing), dtype=np.bool_)
    for a in range(standing):
        for b in range(a + 1, standing):
            i, j = ranked[a], ranked[b]
            if _shadows_meet(centre_n[i], radius_m[i], centre_n[j], radius_m[j], p_nc):
                if _in_front(vertices[offsets[i] : offsets[i + 1]], vertices[offsets[j] : offsets[j + 1]], p_nc):
                    hides[a, b] = True
                    waits[b] += 1
                else:
                    hides[b, a] = True
                    waits[a] += 1
    done = np.zeros(n, dtype=np.bool_)
    for position in range(standing):
        best = -1
        for a in range(standing):  # the nearest that nothing hides; three in a circle: the nearest
            if not done[a] and (best < 0 or (waits[a] == 0 and waits[best] > 0)):
                best = a
        order[position], done[best] = ranked[best], True
        for b in range(standing):
            waits[b] -= hides[best, b]
    for k in range(standing, n):
        order[k] = ranked[k]
    return order


@njit(cache=True)
def _shadows_meet(a: Array, radius_a: float, b: Array, radius_b: float, p: Array) -> bool:
    an, ae, bn, be = a[0] - p[0], a[1] - p[1], b[0] - p[0], b[1] - p[1]
    far_a, far_b = math.hypot(an, ae), math.hypot(bn, be)
    if far_a <= radius_a or far_b <= radius_b:
        return True
    apart = math.acos(max(-1.0, min(1.0, (an * bn + ae * be) / (far_a * far_b))))
    return apart < math.asin(radius_a / far_a) + math.asin(radius_b / far_b)


@njit(cache=True)
def _in_front(first: Array, second: Array, p: Array) -> bool:
    for a, b, nearer_inside in ((first, second, True), (second, first, False)):
        for k in range(len(a)):
            start, end = a[k], a[(k + 1) % len(a)]
            separates = True
            for i in range(len(a)):
                separates = separates and _outside(start, end, a[i]) <= _APART
            for i in range(len(b)):
                separates = separates and _outside(start, end, b[i]) >= -_APART
            if separates:
                inside: bool = _outside(start, end, p) <= 0.0
                return inside == nearer_inside
    return True
