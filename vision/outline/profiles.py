"""Profiles across a projected outline, their contrast, and shadows between roof and ground.

Along the edge's normal n; offset s [px], + outwards, is the outline's residual. Images stay distorted: the outline is bent
instead.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_CLIPPED = 253.0  # grey values from here on may have been cut off by the sensor
_UNCLIPPED = 0.36  # share of the squared contrast that channels must keep which are not clipped
_STRIP, _LEAST_STRIP = 0.3, 10.0  # of the contrast, and grey values: farther from both sides there is something between them
_ALIKE, _DARKER = 0.96, 0.8  # the same colour (cosine), in a shadow


@njit(cache=True)
def profiles(image: Image, px: Array, normal: Array, half: int, step: float, width: int, usable: Mask) -> Array:
    """Values (N, 2 half + 1, C) of image (H, W, C) at px + s normal, s = -half step ... half step; bilinear.

    px, normal: (N, 2); width: neighbours averaged along the edge; usable (N,) is cleared outside the image.
    """
    rows, columns, channels = image.shape
    n, size = px.shape[0], 2 * half + 1
    values = np.zeros((n, size, channels), dtype=np.float64)
    for i in range(n):
        if not usable[i]:
            continue
        nu, nv = normal[i, 0], normal[i, 1]
        reach, aside = half * step, 0.5 * (width - 1)
        eu, ev = abs(nu) * reach + abs(nv) * aside, abs(nv) * reach + abs(nu) * aside
        u0, v0 = px[i, 0], px[i, 1]
        if not (u0 - eu >= 0.0 and v0 - ev >= 0.0 and u0 + eu < columns - 1 and v0 + ev < rows - 1):
            usable[i] = False
            continue
        for j in range(size):
            s = (j - half) * step
            for k in range(width):
                t = k - aside
                u, v = u0 + s * nu - t * nv, v0 + s * nv + t * nu
                column, row = int(u), int(v)
                fu, fv = u - column, v - row
                w00, w01, w10, w11 = (1.0 - fv) * (1.0 - fu), (1.0 - fv) * fu, fv * (1.0 - fu), fv * fu
                for c in range(channels):
                    values[i, j, c] += (
                        w00 * image[row, column, c]
                        + w01 * image[row, column + 1, c]
                        + w10 * image[row + 1, column, c]
                        + w11 * image[row + 1, column + 1, c]
                    )
            for c in range(channels):
                values[i, j, c] /= width
    return values


@njit(cache=True)
def along_contrast(values: Array, edge: Indices, shaded: Mask, usable: Mask) -> tuple[Array, Mask]:
    """Profiles (N, S): colour along each edge's contrast; clipped edges (E,).

    Contrast: between the sides, or middle and sides (dark wall), or inside and shadow where one lies between (shaded, (E,)),
    whose far side ends no roof. Saturated channels are omitted if another has contrast.
    """
    n, size, channels = values.shape
    edges, third = len(shaded), size // 3
    mean, count = np.zeros((edges, size, channels)), np.zeros(edges)
    bright = np.zeros((edges, channels))
    for i in range(n):
        if usable[i]:
            e = edge[i]
            count[e] += 1.0
            for j in range(size):
                for c in range(channels):
                    mean[e, j, c] += values[i, j, c]
                    bright[e, c] += 1.0 if values[i, j, c] >= _CLIPPED else 0.0
    direction, clipped = np.empty((edges, channels)), np.zeros(edges, dtype=np.bool_)
    for e in range(edges):
        for j in range(size):
            for c in range(channels):
                mean[e, j, c] /= max(count[e], 1.0)
        clipped[e] = _contrast(mean[e], bright[e], 0.1 * third * count[e], shaded[e], direction[e])
    result = np.zeros((n, size))
    for i in range(n):
        if usable[i]:
            for j in range(size):
                total = 0.0
                for c in range(channels):
                    total += values[i, j, c] * direction[edge[i], c]
                result[i, j] = total
    return result, clipped


@njit(cache=True)
def _contrast(profile: Array, bright: Array, most_bright: float, may_be_shaded: bool, direction: Array) -> bool:
    """Unit contrast (C,) of a mean profile (S, C), into direction; whether too much is clipped."""
    size, channels = profile.shape
    third = size // 3
    inside, d, shadow = np.empty(channels), np.empty(channels), np.empty(channels)
    outside, middle, free = np.empty(channels), np.empty(channels), np.empty(channels)
    across2 = middle2 = 0.0
    for c in range(channels):
        inside[c], outside[c] = _average(profile, 0, third, c), _average(profile, size - third, size, c)
        d[c] = outside[c] - inside[c]
        middle[c] = _average(profile, third, 2 * third, c) - 0.5 * (inside[c] + outside[c])
        across2 += d[c] ** 2
        middle2 += middle[c] ** 2
    is_shaded = may_be_shaded and _shadow_between(profile, inside, outside, shadow)
    square = free2 = 0.0
    for c in range(channels):
        if is_shaded:
            d[c] = shadow[c] - inside[c]
        elif not across2 >= middle2:
            d[c] = middle[c]
        free[c] = 0.0 if bright[c] > most_bright else d[c]
        square += d[c] ** 2
        free2 += free[c] ** 2
    clipped = free2 < _UNCLIPPED * square
    norm = math.sqrt(square if clipped else free2)
    for c in range(channels):
        part = d[c] if clipped else free[c]
        direction[c] = part / norm if norm > 0.0 else 1.0 / math.sqrt(channels)
    return bool(clipped)


@njit(cache=True)
def _average(colours: Array, begin: int, end: int, c: int) -> float:
    total = 0.0
    for j in range(begin, end):
        total += colours[j, c]
    return total / (end - begin)


@njit(cache=True)
def _shadow_between(profile: Array, inside: Array, outside: Array, shadow: Array) -> bool:
    """Colour (C,) of a profile (S, C) farthest from a blurred step, outside its inner third, into shadow; False unless it is the
    outer side's in shadow, or black.

        r = |c - a - t (b - a)|,  0 <= t <= 1:    r > 0.3 |b - a|,    c b / (|c| |b|) > 0.96,    |c| < 0.8 |b|

    a: inside, b: outside.
    """
    size, channels = profile.shape
    square, farthest, at = 0.0, 0.0, -1
    for c in range(channels):
        square += (outside[c] - inside[c]) ** 2
    for j in range(size // 3, size):
        along = r = 0.0
        for c in range(channels):
            along += (profile[j, c] - inside[c]) * (outside[c] - inside[c])
        t = min(max(along / max(square, 1e-9), 0.0), 1.0)
        for c in range(channels):
            r += ((profile[j, c] - inside[c]) - t * (outside[c] - inside[c])) ** 2
        if r > farthest:
            farthest, at = r, j
    if farthest < max(_STRIP**2 * square, _LEAST_STRIP**2):
        return False
    total = 0.0
    for c in range(channels):
        shadow[c] = profile[at, c]
        total += shadow[c]
    return shaded(shadow, outside) and total > 0.0


@njit(cache=True)
def shaded(colour: Array, ground: Array) -> bool:
    """Whether colour (C,) c is ground b in shadow:  c b > 0.96 |c| |b|,  |c| < 0.8 |b|."""
    dark = light = both = 0.0
    for c in range(len(colour)):
        dark += colour[c] ** 2
        light += ground[c] ** 2
        both += colour[c] * ground[c]
    dark, light = math.sqrt(dark), math.sqrt(light)
    return both > _ALIKE * dark * light and dark < _DARKER * light
