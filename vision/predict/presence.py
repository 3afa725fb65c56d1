"""Odds that a landmark stands where a fit says, side by side of the roof (docs/vision_identify.md).

    a = |sum_i u_i| / n,   u_i = g_i n_i / |g_i|,        z = a (2 n)^(1/2)
    LR = prod_e ((1 - h) A(a) + h C(z)) / (q A(a) + (1 - q) C(z))

g_i: gradients at point i of a side, n_i the outline's normal. A(a) = 2 a: an edge; C: half-normal, texture. h: a standing side is
hidden; q: a vanished one lies on another edge. Wall feet and corners: h = q = 0.2; the rim of a small landmark: h = 0.15, q =
0.05.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.outline.visibility import Kind

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_HIDDEN, _ELSEWHERE = 0.1, 0.1  # h, q
_WALL_HIDDEN, _WALL_ELSEWHERE = 0.2, 0.2  # the same of feet and corners of walls
_SPOT_HIDDEN, _SPOT_ELSEWHERE = 0.15, 0.05  # and of small landmarks
_ROOF, _SMALL = int(Kind.ROOF), int(Kind.SMALL)  # compiled code reads plain integers
_LEAST_POINTS = 2.0  # that have a direction in common


@njit(cache=True)
def across(image: NDArray[np.uint8], px: Array, normal: Array, edge: Indices, edges: int, usable: Mask) -> Array:
    """Sum of u_i per edge and channel, and points (E, C + 1), in an image (H, W, C).

    px, normal (N, 2), edge (N,); usable points inside the image only.
    """
    rows, columns, channels = image.shape
    total, g = np.zeros((edges, channels + 1)), np.empty(channels)
    for i in range(len(px)):
        if not usable[i]:
            continue
        x, y = int(px[i, 0] + 0.5), int(px[i, 1] + 0.5)
        if x < 1 or y < 1 or x >= columns - 1 or y >= rows - 1:
            continue
        square = 0.0
        for c in range(channels):
            nw, n, ne = float(image[y - 1, x - 1, c]), float(image[y - 1, x, c]), float(image[y - 1, x + 1, c])
            w, e = float(image[y, x - 1, c]), float(image[y, x + 1, c])
            sw, s, se = float(image[y + 1, x - 1, c]), float(image[y + 1, x, c]), float(image[y + 1, x + 1, c])
            du, dv = ne + 2.0 * e + se - nw - 2.0 * w - sw, sw + 2.0 * s + se - nw - 2.0 * n - ne
            g[c] = du * normal[i, 0] + dv * normal[i, 1]
            square += du * du + dv * dv
        total[edge[i], channels] += 1.0
        if square > 0.0:
            for c in range(channels):
                total[edge[i], c] += g[c] / math.sqrt(square)
    return total


def log_likelihood_ratio(sums: list[Array], landmark: Indices, landmarks: int, kind: Indices) -> Array:
    """log LR (L,), standing against gone; sums: across() of each image; landmark, kind (E,).

    Points count once per pair: its images show the same texture.
    """
    return np.asarray(_log_ratio(np.array(sums), landmark, landmarks, kind))


@njit(cache=True)
def _log_ratio(sums: Array, landmark: Indices, landmarks: int, kind: Indices) -> Array:
    log_ratio, channels = np.zeros(landmarks), sums.shape[2] - 1
    for e in range(len(landmark)):
        if kind[e] == _SMALL:
            h, q = _SPOT_HIDDEN, _SPOT_ELSEWHERE
        else:
            h, q = (_HIDDEN, _ELSEWHERE) if kind[e] == _ROOF else (_WALL_HIDDEN, _WALL_ELSEWHERE)
        points, images, square = 0.0, 0, 0.0
        for k in range(len(sums)):
            points += sums[k, e, channels]
            images += sums[k, e, channels] != 0.0
        n = points / max(images, 1)
        if n >= _LEAST_POINTS:
            for c in range(channels):
                total = 0.0
                for k in range(len(sums)):
                    total += sums[k, e, c]
                square += total**2
            a = math.sqrt(square) / points
            edge = a / math.sqrt(n) * math.sqrt(2.0)  # density of z where a has 2 a: 2 a da/dz
            chance = math.sqrt(2.0 / math.pi) * math.exp(-(a**2) * n)
            log_ratio[landmark[e]] += math.log(((1.0 - h) * edge + h * chance) / (q * edge + (1.0 - q) * chance))
    return log_ratio


def small_missed(log_ratio: Array, share: Array) -> Array:
    """log LR (N,) of small landmarks, from that of their rims; share (N,) found in place."""
    return np.where(share < 0.5, math.log(_SPOT_HIDDEN / (1.0 - _SPOT_ELSEWHERE)), log_ratio)
