"""Exact area coverage of pixels by polygons.

    coverage[v, u] = area of  polygon ∩ [u - 1/2, u + 1/2] x [v - 1/2, v + 1/2]

Edges add signed areas to a difference grid; running sums give coverage (Green's theorem).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

Grid = NDArray[np.float32]
Box = tuple[int, int, int, int]  # first and last + 1 of rows, first and last + 1 of columns

_NOTHING = 1e-4  # rounding of a row's running sum, not an area


def coverage(polygon_px: Array, width: int, height: int) -> Grid:
    """Coverage (height, width) in 0..1 of a simple polygon (K, 2) of either orientation, in pixels."""
    result = np.zeros((height, width), dtype=np.float32)
    differences = np.zeros((height, width + 2), dtype=np.float32)
    add_polygon(np.ascontiguousarray(polygon_px, dtype=np.float64), differences)
    box = bounds(polygon_px, width, height)
    if box[0] < box[1] and box[2] < box[3]:
        integrate(differences, box, result)
    return result


@njit(cache=True)
def bounds(polygon_px: Array, width: int, height: int) -> Box:
    """Pixels a polygon may touch: rows [r0, r1), columns [c0, c1); 0 for none."""
    if len(polygon_px) == 0:
        return 0, 0, 0, 0
    u0, v0 = polygon_px[0]
    u1, v1 = u0, v0
    for k in range(1, len(polygon_px)):
        u, v = polygon_px[k, 0], polygon_px[k, 1]
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    if not (u1 > -0.5 and u0 < width - 0.5 and v1 > -0.5 and v0 < height - 0.5):  # so that NaN is empty too
        return 0, 0, 0, 0
    r0, r1 = int(max(v0 + 0.5, 0.0)), min(int(min(v1 + 0.5, float(height))) + 1, height)
    c0, c1 = int(max(u0 + 0.5, 0.0)), min(int(min(u1 + 0.5, float(width))) + 1, width)
    return r0, r1, c0, c1


@njit(cache=True)
def add_polygon(polygon_px: Array, differences: Grid) -> None:
    """Add a polygon's signed area to `differences` (height, width + 2)."""
    n = len(polygon_px)
    for k in range(n):
        m = k + 1 if k + 1 < n else 0
        _add_edge(polygon_px[k, 0] + 0.5, polygon_px[k, 1] + 0.5, polygon_px[m, 0] + 0.5, polygon_px[m, 1] + 0.5, differences)


@njit(cache=True)
def integrate(differences: Grid, box: Box, covered: Grid) -> None:
    """Running sums of the box into `covered`, |sum| <= 1; clears its differences."""
    r0, r1, c0, c1 = box
    for r in range(r0, r1):
        total = np.float32(0.0)
        for c in range(c0, c1):
            total += differences[r, c]
            differences[r, c] = 0.0
            a = abs(total)
            covered[r, c] = 0.0 if a < _NOTHING else min(a, np.float32(1.0))
        for c in range(c1, min(c1 + 2, differences.shape[1])):
            differences[r, c] = 0.0


@njit(cache=True)
def _add_edge(x0: float, y0: float, x1: float, y1: float, differences: Grid) -> None:
    """One edge, pixel (u, v) being [u, u + 1] x [v, v + 1], cut to the grid.

    Beyond left and right borders it is laid on the border.
    """
    height, width = differences.shape[0], differences.shape[1] - 2
    if y0 == y1:
        return
    sign = 1.0
    if y0 > y1:
        x0, y0, x1, y1, sign = x1, y1, x0, y0, -1.0
    if y1 <= 0.0 or y0 >= height:
        return
    slope = (x1 - x0) / (y1 - y0)
    if y0 < 0.0:
        x0, y0 = x0 - y0 * slope, 0.0
    if y1 > height:
        x1, y1 = x1 + (height - y1) * slope, float(height)
    # Where it crosses the side borders it is split; three pieces at most, from top to bottom.
    cut_a, cut_b = y1, y1
    if slope != 0.0:
        left, right = y0 + (0.0 - x0) / slope, y0 + (width - x0) / slope
        cut_a, cut_b = min(max(min(left, right), y0), y1), min(max(left, right, y0), y1)
    top, x_top = y0, x0
    for piece in range(3):
        bottom = cut_a if piece == 0 else (cut_b if piece == 1 else y1)
        if bottom > top:
            x_bottom = x0 + (bottom - y0) * slope
            xa, xb = min(max(x_top, 0.0), float(width)), min(max(x_bottom, 0.0), float(width))
            _add_inside(xa, top, xb, bottom, sign, differences)
            top, x_top = bottom, x_bottom


@njit(cache=True)
def _add_inside(x0: float, y0: float, x1: float, y1: float, sign: float, differences: Grid) -> None:
    """An edge inside the grid, y0 < y1: `dy` to its right, a part on its pixels."""
    slope, least, most = (x1 - x0) / (y1 - y0), min(x0, x1), max(x0, x1)
    row, y, x = int(y0), y0, x0
    while y < y1 and row < differences.shape[0]:
        y_next = min(row + 1.0, y1)
        x_next = x1 if y_next == y1 else min(max(x0 + (y_next - y0) * slope, least), most)  # rounding stays on the grid
        dy = sign * (y_next - y)
        left, right = min(x, x_next), max(x, x_next)
        first, last = int(left), int(right)
        if first == last:  # a trapezoid in one pixel: its mean distance from the right side
            part = dy * (first + 1.0 - 0.5 * (left + right))
            differences[row, first] += part
            differences[row, first + 1] += dy - part
        else:  # a triangle, trapezoids of equal steps, and the rest
            per_px = dy / (right - left)
            done, before = 0.0, 0.0
            for c in range(first, last + 1):
                reach = min(c + 1.0, right) - max(float(c), left)  # length of the edge's shadow in this pixel
                done_next = done + per_px * reach
                # covered area of pixel c: what earlier pixels let in, plus the triangle under the edge here
                area = done + per_px * reach * (c + 1.0 - 0.5 * (max(float(c), left) + min(c + 1.0, right)))
                differences[row, c] += area - before
                done, before = done_next, area
            differences[row, last + 1] += dy - before
        row, y, x = row + 1, y_next, x_next
