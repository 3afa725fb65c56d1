"""Polygons on the ground: cleaning, self-crossing, description.

An outline is (K, 2) north, east [m], anticlockwise from above, open; outline i is vertices[offsets[i] : offsets[i + 1]].

    size = 1/2 sum (e_k n_k+1 - e_k+1 n_k)                                             (shoelace; > 0 anticlockwise)
    width <= length: sides of the rectangle of least area around the outline; one of its sides lies on a side of the convex
    hull (Freeman and Shapira 1975)
    fill ratio = size / (width length)                                                          (thesis section 5.4)
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order as ordering
from models.messages import Array

LONG, ROUNDS = 1000, 64
SIZE, WIDTH, LENGTH, FILL, ORIENTATION, NORTH, EAST, RADIUS = range(8)  # columns of describe


@njit(cache=True)
def area(outline: Array) -> float:
    """Signed size [m^2] of an outline (K, 2), positive if anticlockwise from above."""
    twice = 0.0
    n0, e0 = outline[0]
    for k in range(1, len(outline) - 1):
        twice += (outline[k, 1] - e0) * (outline[k + 1, 0] - n0) - (outline[k + 1, 1] - e0) * (outline[k, 0] - n0)
    return 0.5 * twice


@njit(cache=True)
def clean(outline: Array, tolerance_m: float) -> Array:
    """The outline without doubled, collinear or spike corners.

    A corner goes if its triangle is thinner than tolerance_m, never two neighbours in a round. After ROUNDS rounds an outline of
    more than LONG corners stays as it is.
    """
    rounds = 0
    while len(outline) > 3 and (rounds < ROUNDS or len(outline) <= LONG):
        rounds += 1
        kept = np.empty_like(outline)
        count, dropped_last, dropped_first = 0, False, False
        for k in range(len(outline)):
            before = outline[-1] if count == 0 else kept[count - 1]
            last_beside_first = k == len(outline) - 1 and dropped_first
            thin = _thickness(before, outline[k], outline[(k + 1) % len(outline)]) < tolerance_m
            dropped_last = thin and not dropped_last and not last_beside_first
            if dropped_last:
                dropped_first = dropped_first or k == 0
            else:
                kept[count, 0], kept[count, 1] = outline[k, 0], outline[k, 1]
                count += 1
        if count == len(outline) or count < 3:
            break
        outline = kept[:count].copy()
    return outline


@njit(cache=True)
def _side(a: Array, b: Array, c: Array) -> float:
    twice: float = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    return twice


@njit(cache=True)
def _thickness(a: Array, b: Array, c: Array) -> float:
    """Height of the triangle a b c over its longest side [m]."""
    longest = max(
        math.hypot(b[0] - a[0], b[1] - a[1]), math.hypot(c[0] - b[0], c[1] - b[1]), math.hypot(c[0] - a[0], c[1] - a[1])
    )
    return 0.0 if longest == 0.0 else abs(_side(a, b, c)) / longest


@njit(cache=True)
def crosses_itself(outline: Array) -> bool:
    """Whether two sides that are not neighbours meet."""
    n = len(outline)
    for i in range(n):
        for j in range(i + 2, n):
            if i == 0 and j == n - 1:
                continue
            if _meet(outline[i], outline[i + 1], outline[j], outline[(j + 1) % n]):
                return True
    return False


@njit(cache=True)
def _meet(a: Array, b: Array, c: Array, d: Array) -> bool:
    """Whether the closed segments a b and c d have a point in common."""
    for axis in range(2):
        if max(a[axis], b[axis]) < min(c[axis], d[axis]) or max(c[axis], d[axis]) < min(a[axis], b[axis]):
            return False
    return _side(a, b, c) * _side(a, b, d) <= 0.0 and _side(c, d, a) * _side(c, d, b) <= 0.0


@njit(cache=True)
def _hull(points: Array) -> Array:
    """Convex hull (H, 2), monotone chain (Andrew 1979)."""
    order = ordering.ranked(points[:, 0])
    for i in range(1, len(order)):  # equal north: by east
        j = i
        while j > 0 and points[order[j], 0] == points[order[j - 1], 0] and points[order[j], 1] < points[order[j - 1], 1]:
            order[j], order[j - 1] = order[j - 1], order[j]
            j -= 1
    hull = np.empty((2 * len(points) + 1, 2))
    count, floor = 0, 2
    for sweep in range(2):
        for i in range(sweep, len(order)):
            p = points[order[i] if sweep == 0 else order[len(order) - 1 - i]]
            while count >= floor and _side(hull[count - 2], hull[count - 1], p) <= 0.0:
                count -= 1
            hull[count, 0], hull[count, 1] = p[0], p[1]
            count += 1
        floor = count + 1
    return hull[: count - 1]


@njit(cache=True)
def _rectangle(outline: Array) -> tuple[float, float, float]:
    """Width, length [m], long side's orientation [rad, 0..pi north to east] of the least-area rectangle."""
    hull = _hull(outline)
    best, width, length, orientation = np.inf, 0.0, 0.0, 0.0
    for k in range(len(hull)):
        after = hull[(k + 1) % len(hull)]
        dn, de = after[0] - hull[k, 0], after[1] - hull[k, 1]
        side = math.hypot(dn, de)
        if side == 0.0:
            continue
        cos, sin = dn / side, de / side
        low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
        for i in range(len(hull)):
            n, e = hull[i, 0], hull[i, 1]
            u, v = cos * n + sin * e, cos * e - sin * n
            low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
        along, across = high_u - low_u, high_v - low_v
        if along * across < best:
            best, width, length = along * across, min(along, across), max(along, across)
            orientation = (math.atan2(sin, cos) + (0.0 if along >= across else 0.5 * math.pi)) % math.pi
    return width, length, orientation


@njit(cache=True)
def describe(vertices: Array, offsets: NDArray[np.int64]) -> Array:
    """(N, 8): size, width, length, fill ratio, orientation, centroid north, east, radius about it."""
    table = np.zeros((len(offsets) - 1, 8))
    for i in range(len(offsets) - 1):
        outline = vertices[offsets[i] : offsets[i + 1]]
        row = table[i]
        row[SIZE] = area(outline)
        about_first = np.empty(outline.shape)
        for k in range(len(outline)):
            about_first[k, 0], about_first[k, 1] = outline[k, 0] - outline[0, 0], outline[k, 1] - outline[0, 1]
        row[WIDTH], row[LENGTH], row[ORIENTATION] = _rectangle(about_first)
        row[FILL] = row[SIZE] / (row[WIDTH] * row[LENGTH]) if row[WIDTH] > 0.0 else 0.0
        row[NORTH], row[EAST] = _centroid(outline, row[SIZE])
        for k in range(len(outline)):
            n, e = outline[k, 0], outline[k, 1]
            row[RADIUS] = max(row[RADIUS], math.hypot(n - row[NORTH], e - row[EAST]))
    return table


@njit(cache=True)
def _centroid(outline: Array, size: float) -> tuple[float, float]:
    n0, e0 = outline[0]
    north = east = 0.0
    for k in range(1, len(outline) - 1):
        n1, e1, n2, e2 = outline[k, 0] - n0, outline[k, 1] - e0, outline[k + 1, 0] - n0, outline[k + 1, 1] - e0
        twice = e1 * n2 - e2 * n1
        north += twice * (n1 + n2)
        east += twice * (e1 + e2)
    return (n0, e0) if size == 0.0 else (n0 + north / (6.0 * size), e0 + east / (6.0 * size))


@njit(cache=True)
def contains(outline: Array, north: float, east: float) -> bool:
    """Whether a place lies inside an outline (K, 2), even-odd rule."""
    inside = False
    for k in range(len(outline)):
        (n0, e0), (n1, e1) = outline[k - 1], outline[k]
        if (n0 <= north) != (n1 <= north) and e0 + (north - n0) / (n1 - n0) * (e1 - e0) > east:
            inside = not inside
    return inside


GOOD, FEW, SMALL, MANY, CROSSED = range(5)  # verdicts of repair


@njit(cache=True)
def repair(
    vertices: Array, offsets: NDArray[np.int64], tolerance_m: float, min_m2: float, max_corners: int
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Cleaned, anticlockwise outlines (vertices, offsets), empty unless the verdict (N,) is GOOD."""
    kept, ends = np.empty_like(vertices), np.zeros_like(offsets)
    verdicts = np.empty(len(offsets) - 1, np.int64)
    for i in range(len(verdicts)):
        outline, verdict = clean(vertices[offsets[i] : offsets[i + 1]], tolerance_m), GOOD
        if len(outline) < 3:
            verdict = FEW
        elif len(outline) > max_corners:
            verdict = MANY
        elif crosses_itself(outline):
            verdict = CROSSED
        elif abs(area(outline)) < min_m2:
            verdict = SMALL
        ends[i + 1] = ends[i]
        if verdict == GOOD:
            ends[i + 1] += len(outline)
            straight, last = area(outline) > 0.0, len(outline) - 1
            for k in range(len(outline)):
                for axis in range(2):
                    kept[ends[i] + k, axis] = outline[k if straight else last - k, axis]
        verdicts[i] = verdict
    return kept[: ends[-1]].copy(), ends, verdicts
