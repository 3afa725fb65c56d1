"""Colour of each roof along its rim, and profiles that leave it or are covered."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order
from models.messages import Array

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_ENDING, _MOST_CONTRAST = 0.5, 0.8  # what ends at a rim has so much of the contrast that is exceeded by one point in five
_OTHER, _SCATTER, _LEAST_OTHER = 0.4, 4.0, 4.0  # of the contrast; of the lower quartile; grey values: farther off is not the roof
_SHADOW = 0.5  # of the light that a roof has in the sun
_SHADE = 1.3  # by how much lighter or darker than the roof's colour a slope may be
_BESIDE = 2  # points on either side that tell its shade along


@njit(cache=True)
def _ends(values: Array) -> tuple[Array, Array]:
    """Colours (N, C) of the inner and the outer quarter of profiles (N, S, C)."""
    n, size, channels = values.shape
    quarter = size // 4
    inside, outside = np.zeros((n, channels)), np.zeros((n, channels))
    for i in range(n):
        for j in range(quarter):
            for c in range(channels):
                inside[i, c] += values[i, j, c] / quarter
                outside[i, c] += values[i, size - 1 - j, c] / quarter
    return inside, outside


@njit(cache=True)
def _rim(m: int, edge: Indices, landmark: Indices, roof: Mask, usable: Mask) -> Indices:
    rim, count = np.empty(len(edge), np.int64), 0
    for i in range(len(edge)):
        if usable[i] and roof[edge[i]] and landmark[edge[i]] == m:
            rim[count] = i
            count += 1
    return rim[:count]


@njit(cache=True)
def _marks(landmark: Indices) -> int:
    most = 0
    for e in range(len(landmark)):
        most = max(most, landmark[e])
    return most + 1


@njit(cache=True)
def roof_colours(values: Array, edge: Indices, landmark: Indices, roof: Mask, usable: Mask) -> Array:
    """Median rim colour (L, C) of each roof; NaN without usable points.

    values (N, S, C): outward profiles; roof: (E,).
    """
    inside, outside = _ends(values)
    n, channels = inside.shape
    contrast, of_rim, marks = np.empty(n), np.empty(n), _marks(landmark)
    for i in range(n):
        square = 0.0
        for c in range(channels):
            square += (outside[i, c] - inside[i, c]) ** 2
        contrast[i] = math.sqrt(square)
    colour = np.empty((marks, channels))
    for m in range(marks):
        rim = _rim(m, edge, landmark, roof, usable)
        for k in range(len(rim)):
            of_rim[k] = contrast[rim[k]]
        least = _ENDING * order.quantile(of_rim[: len(rim)], _MOST_CONTRAST)
        for c in range(channels):
            count = 0
            for k in range(len(rim)):
                if contrast[rim[k]] >= least:
                    of_rim[count] = inside[rim[k], c]
                    count += 1
            colour[m, c] = order.median(of_rim[:count])
    return colour


@njit(cache=True)
def roof_beside(
    values: Array, interior: Array, inside: Mask, edge: Indices, landmark: Indices, roof: Mask, usable: Mask
) -> Array:
    """Roof colour (N, C) beside each point, with the local brightness (gables have two).

    interior (N, S', C): farther inside than values (N, S, C), where inside (N,); neighbours on the edge count.
    """
    n, size, channels = interior.shape
    colour = roof_colours(values, edge, landmark, roof, usable)
    single, beside = np.empty(n), np.empty((n, channels))
    for i in range(n):
        single[i] = np.nan
        whole = total = 0.0
        for c in range(channels):
            whole += colour[landmark[edge[i]], c]
        if inside[i] and whole > 0.0:  # not where it is NaN
            for j in range(size):
                for c in range(channels):
                    total += interior[i, j, c]
            single[i] = total / size / whole
    for i in range(n):
        total = count = 0.0
        for k in range(max(i - _BESIDE, 0), min(i + _BESIDE + 1, n)):
            if edge[k] == edge[i] and not math.isnan(single[k]):
                total += single[k]
                count += 1.0
        shade = min(max(total / count, 1.0 / _SHADE), _SHADE) if count > 0.0 else 1.0
        for c in range(channels):
            beside[i, c] = shade * colour[landmark[edge[i]], c]
    return beside


@njit(cache=True)
def off_roof(values: Array, beside: Array, edge: Indices, roof: Mask, usable: Mask) -> Array:
    """Distance of outward profiles (N, S) from the roof's colour beside (N, C); 0 without."""
    n, size, channels = values.shape
    distance = np.zeros((n, size))
    for i in range(n):
        if usable[i] and roof[edge[i]]:
            for j in range(size):
                total = 0.0
                for c in range(channels):
                    total += (values[i, j, c] - beside[i, c]) ** 2
                distance[i, j] = math.sqrt(total)
    return distance


@njit(cache=True)
def alien(values: Array, beside: Array, edge: Indices, roof: Mask, usable: Mask) -> Mask:
    """Roof edges (E,) with another colour than beside (N, C) all along inside: a wall's foot.

        |inside - beside| > 0.4 |outside - inside| + 4

    of the means along the edge.
    """
    inside, outside = _ends(values)
    n, channels = inside.shape
    ours, ends, beyond = np.zeros((len(roof), channels)), np.zeros((len(roof), channels)), np.zeros((len(roof), channels))
    found, count = np.zeros(len(roof), dtype=np.bool_), np.zeros(len(roof))
    for i in range(n):
        if usable[i]:
            e = edge[i]
            count[e] += 1.0
            for c in range(channels):
                ours[e, c] += beside[i, c]
                ends[e, c] += inside[i, c]
                beyond[e, c] += outside[i, c]
    for e in range(len(roof)):
        if roof[e] and count[e] > 0.0:
            off = across = 0.0
            for c in range(channels):
                off += (ends[e, c] / count[e] - ours[e, c] / count[e]) ** 2
                across += (beyond[e, c] / count[e] - ends[e, c] / count[e]) ** 2
            found[e] = math.sqrt(off) > _OTHER * math.sqrt(across) + _LEAST_OTHER
    return found


@njit(cache=True)
def covered(values: Array, beside: Array, edge: Indices, landmark: Indices, roof: Mask, usable: Mask) -> Mask:
    """Points (N,) of roof edges covered inside by another colour than beside (N, C): trees, ground.

        d_i > max(0.4 median |outside - beside|, 4 quartile d) + 4,    d = min_k |inside - k beside|, k = 0.5 ... 1

    along a landmark's rim; shadows count as roof.
    """
    inside, outside = _ends(values)
    n, channels = inside.shape
    off, across, of_rim = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        both = square = off2 = across2 = 0.0
        for c in range(channels):
            both += inside[i, c] * beside[i, c]
            square += beside[i, c] ** 2
        shade = min(max(both / max(square, 1.0), _SHADOW), 1.0)
        for c in range(channels):
            off2 += (inside[i, c] - shade * beside[i, c]) ** 2
            across2 += (outside[i, c] - beside[i, c]) ** 2
        off[i], across[i] = math.sqrt(off2), math.sqrt(across2)
    found = np.zeros(n, dtype=np.bool_)
    for m in range(_marks(landmark)):
        rim = _rim(m, edge, landmark, roof, usable)
        for k in range(len(rim)):
            of_rim[k] = across[rim[k]]
        usual = _OTHER * order.median(of_rim[: len(rim)])
        for k in range(len(rim)):
            of_rim[k] = off[rim[k]]
        usual = max(usual, _SCATTER * order.quantile(of_rim[: len(rim)], 0.25))
        for k in range(len(rim)):
            found[rim[k]] = off[rim[k]] > usual + _LEAST_OTHER
    return found
