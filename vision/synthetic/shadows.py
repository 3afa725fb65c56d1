"""Shadows of standing solids on level ground.

Footprint swept along s = height * (away from the sun) / tan(elevation): union of footprint, shifted roof and a quadrilateral per
edge, all of one orientation, so areas add to >= 1 inside.
"""

import math

import numpy as np
from numba import njit

from models.messages import Array
from vision.synthetic.coverage import Grid, add_polygon, bounds, integrate
from vision.synthetic.faces import Indices, View, append, clip, in_camera, in_frustum
from vision.synthetic.world import Columns, Sun


def shadow_polygons(columns: Columns, view: View, sun: Sun, ground_d: float) -> tuple[Array, Indices, Indices]:
    """Rays (V, 3) of z = 1, polygon offsets, solid offsets."""
    away = -sun.direction_n[:2] / math.tan(sun.elevation_rad) / math.cos(sun.elevation_rad)
    c = columns
    return _collect(c.vertices, c.offsets, c.height_m, c.centre_n, c.radius_m, away, ground_d, *view)


@njit(cache=True)
def _collect(
    vertices: Array, offsets: Indices, height_m: Array, centre_n: Array, radius_m: Array, away: Array, ground_d: float,
    p_nc: Array, R_nc: Array, limits: Array, piece: float,
) -> tuple[Array, Indices, Indices]:  # fmt: skip
    points, end, fall, middle = np.empty((4096, 3)), int(np.int64(0)), np.empty(2), np.empty(3)
    polygons, n_polygons = np.zeros(len(vertices) + 2 * len(height_m) + 1, dtype=np.int64), 0
    groups, n_groups = np.zeros(len(height_m) + 1, dtype=np.int64), 0
    for i in range(len(height_m)):
        for k in range(2):
            fall[k] = away[k] * height_m[i]
            middle[k] = centre_n[i, k] + 0.5 * fall[k]
        middle[2] = ground_d
        reach = radius_m[i] + 0.5 * math.hypot(fall[0], fall[1])
        if height_m[i] <= 0.0 or p_nc[2] >= ground_d or not in_frustum(middle, reach, p_nc, R_nc, limits):
            continue
        outline = vertices[offsets[i] : offsets[i + 1]]
        k = len(outline)
        for part in range(k + 2):
            polygon = np.empty((k if part < 2 else 4, 3))
            for j in range(len(polygon)):
                polygon[j, 2] = ground_d
            if part < 2:
                for j in range(k):
                    for axis in range(2):
                        polygon[j, axis] = outline[j, axis] + part * fall[axis]
            else:
                a, b = outline[part - 2], outline[(part - 1) % k]
                # Which way round a, b, b + fall, a + fall runs depends on whether the edge faces the sun.
                if (b[1] - a[1]) * fall[0] - (b[0] - a[0]) * fall[1] < 0.0:
                    a, b = b, a
                for axis in range(2):
                    polygon[0, axis], polygon[1, axis] = a[axis], b[axis]
                    polygon[2, axis], polygon[3, axis] = b[axis] + fall[axis], a[axis] + fall[axis]
            points, end = append(points, end, clip(in_camera(polygon, p_nc, R_nc), limits), piece)
            n_polygons += 1
            polygons[n_polygons] = end
        n_groups += 1
        groups[n_groups] = n_polygons
    return points[:end], polygons[: n_polygons + 1], groups[: n_groups + 1]


@njit(cache=True)
def cast(shadow: Grid, vertices_px: Array, polygons: Indices, groups: Indices) -> None:
    """Share of each pixel's ground that lies in shadow, into `shadow` (h, w)."""
    height, width = shadow.shape
    differences = np.zeros((height, width + 2), dtype=np.float32)
    covered = np.zeros((height, width), dtype=np.float32)
    for g in range(len(groups) - 1):
        r0, r1, c0, c1 = height, 0, width, 0
        for p in range(groups[g], groups[g + 1]):
            polygon = vertices_px[polygons[p] : polygons[p + 1]]
            box = bounds(polygon, width, height)
            if box[0] < box[1]:
                add_polygon(polygon, differences)
                r0, r1, c0, c1 = min(r0, box[0]), max(r1, box[1]), min(c0, box[2]), max(c1, box[3])
        if r0 < r1:
            integrate(differences, (r0, r1, c0, c1), covered)
            for r in range(r0, r1):
                for c in range(c0, c1):
                    shadow[r, c] = max(shadow[r, c], covered[r, c])
