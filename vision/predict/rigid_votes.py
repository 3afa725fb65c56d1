"""Votes of landmarks moved by whole pixels, many shifts at once.

    S_e(d) = sum_i f(x_i + d),    f = (g . n_e, |g . n_e|^2, |g|, |g|^2, 1)
    c_e = (|S_1|^2 - S_2) / (S_3^2 - S_4),        support_l = sum_{e of l} length_e c_e

As votes.py (pairs: square of the sum less sum of squares); f is computed once a pixel.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.image.reduced import Field
from vision.predict.votes import LEAST_POINTS, WRONG_SIDE

Indices = NDArray[np.int64]
Planes = NDArray[np.float32]
Window = tuple[int, int, int, int]  # from, to in u, from, to in v [px], all of them with both ends
_PLANES = 7  # of f: g . n in three channels, and the four numbers
_STRAIGHT = 1e-6  # 1 - cosine of normals that differ by rounding only


@njit(cache=True)
def rigid_votes(
    field: Field, pixel: Indices, normal: Array, first: Indices, mark: Indices, length: Array, chroma: Array, marks: int,
    floor: float, expected: float, window: Window,
) -> Array:  # fmt: skip
    """support - expected * length in view (L, V, U) px of each landmark at every d of the window.

    pixel (N, 2): column, row; normal (N, 2): of their edges; the rest as vote().
    """
    wide, high = window[1] - window[0] + 1, window[3] - window[2] + 1
    votes = np.zeros((marks, high, wide))
    one, total = np.zeros((_PLANES, 4 * wide * high), np.float32), np.empty((_PLANES, 2 * wide * high), np.float32)
    of_edge = np.empty(2 * wide * high, np.float32)
    for e in range(len(mark)):
        own, way = pixel[first[e] : first[e + 1]], normal[first[e] : first[e + 1]]
        moves = _into_view(field.shape[0], field.shape[1], own, window)
        if moves[0] > moves[1] or moves[2] > moves[3]:
            continue
        columns = _summed(field, own, way, moves, floor, one, total)
        across = moves[1] - moves[0] + 1
        _edge_votes(total, (moves[3] - moves[2]) * columns + across, length[e], chroma[e], expected, of_edge)
        for y in range(moves[3] - moves[2] + 1):
            left = moves[0] - window[0]
            _add(votes[mark[e], moves[2] - window[2] + y, left : left + across], of_edge[y * columns : y * columns + across])
    return votes


@njit(cache=True)
def _around(pixel: Indices) -> Window:
    left = right = pixel[0, 0]
    top = bottom = pixel[0, 1]
    for i in range(1, len(pixel)):
        u, v = pixel[i, 0], pixel[i, 1]
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    return left, right, top, bottom


@njit(cache=True)
def _into_view(rows: int, columns: int, pixel: Indices, window: Window) -> Window:
    """The window's part that brings points at pixel (N, 2) into an image; empty: from > to."""
    left, right, top, bottom = _around(pixel)
    first, last = max(window[0], 1 - right), min(window[1], columns - 2 - left)
    return first, last, max(window[2], 1 - bottom), min(window[3], rows - 2 - top)


@njit(cache=True)
def _summed(field: Field, pixel: Indices, normal: Array, window: Window, floor: float, one: Planes, total: Planes) -> int:
    """total (7, S) = S_e of all d, row by row; returns columns per row, noise beyond the window.

    one (7, B): room for f around points of one normal, no farther apart than the window.
    """
    wide, high = window[1] - window[0] + 1, window[3] - window[2] + 1
    left, right, top, bottom = _around(pixel)
    columns = wide + min(right - left, wide - 1)
    size, i = (high - 1) * columns + wide, 0
    for plane in range(_PLANES):
        total[plane, :size] = 0.0
    while i < len(pixel):
        left = right = pixel[i, 0]
        top = bottom = pixel[i, 1]
        stop = i + 1
        while stop < len(pixel) and normal[i, 0] * normal[stop, 0] + normal[i, 1] * normal[stop, 1] > 1.0 - _STRAIGHT:
            u, v = pixel[stop]
            if max(right, u) - min(left, u) >= wide or max(bottom, v) - min(top, v) >= high:
                break
            left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
            stop += 1
        _across(field, normal[i], (left + window[0], right + window[1], top + window[2], bottom + window[3]), columns, floor, one)
        for k in range(i, stop):
            at = (pixel[k, 1] - top) * columns + pixel[k, 0] - left
            for plane in range(_PLANES):
                _add(total[plane, :size], one[plane, at : at + size])
        i = stop
    return columns


@njit(cache=True)
def _across(field: Field, normal: Array, box: Window, columns: int, floor: float, one: Planes) -> None:
    """one (7, B) = f of a box' pixels, rows `columns` apart, 0 where unseen."""
    rows, widest = field.shape[0], field.shape[1]
    u, v, least, each = np.float32(normal[0]), np.float32(normal[1]), np.float32(floor), np.float32(1.0)
    for y in range(box[2], box[3] + 1):
        for x in range(box[0], box[1] + 1):
            at = (y - box[2]) * columns + x - box[0]
            if x < 1 or x >= widest - 1 or y < 1 or y >= rows - 1 or field[y, x, 6] < np.float32(0.0):
                for plane in range(_PLANES):
                    one[plane, at] = 0.0
                continue
            here = field[y, x]
            g0, g1, g2 = here[0] * u + here[3] * v, here[1] * u + here[4] * v, here[2] * u + here[5] * v
            size = here[6] + least
            one[0, at], one[1, at], one[2, at], one[3, at] = g0, g1, g2, g0 * g0 + g1 * g1 + g2 * g2
            one[4, at], one[5, at], one[6, at] = size, size * size, each


@njit(cache=True)
def _add(total: Array | Planes, more: Planes) -> None:
    for k in range(len(total)):
        total[k] += more[k]


@njit(cache=True, error_model="numpy")
def _edge_votes(total: Planes, size: int, length: float, chroma: Array, expected: float, of_edge: Planes) -> None:
    """of_edge (S,) = (c_e - expected) times length in view, 0 where too short; branchless for SIMD."""
    c0, c1, c2 = np.float32(chroma[0]), np.float32(chroma[1]), np.float32(chroma[2])
    each, tau = np.float32(length), np.float32(expected)
    none, whole, wrong, least = np.float32(0.0), np.float32(1.0), np.float32(WRONG_SIDE), np.float32(LEAST_POINTS)
    for k in range(size):
        g0, g1, g2, seen = total[0, k], total[1, k], total[2, k], total[6, k]
        c = (g0 * g0 + g1 * g1 + g2 * g2 - total[3, k]) / (total[4, k] * total[4, k] - total[5, k])
        c *= wrong if (g0 * c0 + g1 * c1 + g2 * c2 > none) & (c > none) else whole
        of_edge[k] = each * seen * (c - tau) if seen >= least else none
