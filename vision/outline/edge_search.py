"""Where all points of an edge together leave the roof, to a pixel; profiles that cross another edge."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_BOX = 3  # samples on either side of a step that the search compares
_AGREE = 3.0  # samples that a point's edge may lie from the edge's common offset
_SECOND = 0.75  # a rival that has this share of the best vote makes an edge ambiguous
_STANDS_OUT = 3.0  # standard deviations of the mean of its points that a step has: by chance the largest of a dozen has no more
_OTHER = 0.4  # of the contrast: farther off is not the roof
_LEAST_CONTRAST = 3.0  # grey values; below it an edge is not examined
_SLACK_PX = 1.0  # more than rounding


@njit(cache=True)
def search(distance: Array, edge: Indices, edges: int, step: float, usable: Mask) -> Array:
    """Offsets (N,) px at which a roof edge's points leave the roof; NaN for none.

    distance (N, S): from the roof's colour. Box differences are summed over an edge; the largest wins, if the roof is inside and
    no far second one is nearly as large.
    """
    n, size = distance.shape
    last = size - _BOX
    response, vote, square = np.zeros((n, size)), np.zeros((edges, size)), np.zeros((edges, size))
    mean, count = np.zeros((edges, size)), np.zeros(edges)
    for i in range(n):
        if usable[i]:
            e = edge[i]
            count[e] += 1.0
            for j in range(size):
                mean[e, j] += distance[i, j]
            for j in range(_BOX, last):
                total = 0.0
                for k in range(1, _BOX + 1):
                    total += distance[i, j + k] - distance[i, j - k]
                response[i, j] = total / _BOX
                vote[e, j] += response[i, j]
                square[e, j] += response[i, j] ** 2
    best = _elect(vote, square, mean, count)
    offsets = np.full(n, np.nan)
    for i in range(n):
        e = edge[i]
        if not usable[i] or best[e] < 0:
            continue
        low, high = max(_BOX + 1, int(best[e] - _AGREE)), min(last - 2, int(best[e] + _AGREE))
        top, at = 0.0, -1
        for j in range(low, high + 1):
            value = response[i, j]
            if value > top and value >= response[i, j - 1] and value >= response[i, j + 1]:
                top, at = value, j
        if at >= 0 and top > 0.4 * vote[e, int(best[e])] / count[e]:
            before, after = response[i, at - 1], response[i, at + 1]
            curvature = before - 2.0 * top + after
            shift = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
            offsets[i] = (at + shift - size // 2) * step
    return offsets


@njit(cache=True)
def _elect(vote: Array, square: Array, mean: Array, count: Array) -> Array:
    """Best position (E,), -1 for none or ambiguous, of votes and squares (E, S).

    mean (E, S): summed distances. A step exceeds the scatter of its points, texture does not.
    """
    edges, size = vote.shape
    best = np.full(edges, -1.0)
    for e in range(edges):
        if count[e] < 2:
            continue
        top, rival, at = _LEAST_CONTRAST * count[e], 0.0, -1
        for j in range(_BOX + 1, size - _BOX - 1):
            value = vote[e, j]
            if value < top * _SECOND or value <= vote[e, j - 1] or value < vote[e, j + 1]:
                continue
            if value**2 < _STANDS_OUT**2 * (square[e, j] - value**2 / count[e]):
                continue
            if mean[e, max(j - 4, 0)] > _OTHER * mean[e, min(j + 4, size - 1)] + 8.0 * count[e]:
                continue
            if value > top:
                rival = top if at >= 0 and j - at > _BOX else rival
                top, at = value, j
            elif at >= 0 and j - at > _BOX:
                rival = max(rival, value)
        if at >= 0 and rival < _SECOND * top:
            best[e] = at
    return best


@njit(cache=True)
def crossed(px: Array, normal: Array, edge: Indices, partner: Indices, start: Array, end: Array, reach: float) -> Mask:
    """Points (N,) whose profile within reach px meets the chord start-end (E, 2) of another edge than its own and the partner
    (E,); in order of edges.
    """
    n, first = px.shape[0], 0
    result = np.zeros(n, dtype=np.bool_)
    near = np.empty(len(start), np.int64)
    while first < n:
        own, stop = edge[first], first
        while stop < n and edge[stop] == own:
            stop += 1
        count = 0
        for e in _chords_near(px[first:stop], start, end, reach + _SLACK_PX, near):
            if e != own and e != partner[own]:
                near[count] = e
                count += 1
        for i in range(first, stop):
            u, v, nu, nv = px[i, 0], px[i, 1], normal[i, 0], normal[i, 1]
            for e in near[:count]:
                au, av, bu, bv = start[e, 0] - u, start[e, 1] - v, end[e, 0] - u, end[e, 1] - v
                side_a, side_b = nu * av - nv * au, nu * bv - nv * bu
                if (side_a > 0.0) == (side_b > 0.0):
                    continue
                s = side_a / (side_a - side_b)
                along = (au + s * (bu - au)) * nu + (av + s * (bv - av)) * nv
                if abs(along) < reach:
                    result[i] = True
                    break
        first = stop
    return result


@njit(cache=True)
def _chords_near(px: Array, start: Array, end: Array, reach: float, near: Indices) -> Indices:
    """Chords start-end (E, 2) near points px (N, 2) by boxes; near (E,): room for them."""
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(px)):
        left, right = min(left, px[i, 0] - reach), max(right, px[i, 0] + reach)
        top, bottom = min(top, px[i, 1] - reach), max(bottom, px[i, 1] + reach)
    count = 0
    for e in range(len(start)):
        across = max(start[e, 0], end[e, 0]) >= left and min(start[e, 0], end[e, 0]) <= right
        if across and max(start[e, 1], end[e, 1]) >= top and min(start[e, 1], end[e, 1]) <= bottom:
            near[count] = e
            count += 1
    return near[:count]
