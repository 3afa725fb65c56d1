"""Does a landmark stand where a fit says, or does its outline lie on edges of something else? The odds, side by side of the roof.

    a = |sum_i u_i| / n,   u_i = g_i n_i / |g_i|,        z = a (2 n)^(1/2)
    LR = prod_e ((1 - h) A(a) + h C(z)) / (q A(a) + (1 - q) C(z))

g_i: gradients of all channels at point i of a side, n_i the outline's normal there. Along an edge all gradients point across it,
to the same side, and a is near 1. Texture's point anywhere: their sum is a walk of n random steps, of variance 1/2 each, and z
is half-normal, C. A side of a roof that stands is hidden, or of the ground's colour, with probability h; one of a roof that is
gone lies on an edge of something else (a kerb, a shadow, a field) with q. Two sides on the corner of two streets are as likely a
house as not, and three points of a side at the border prove nothing. A(a) = 2 a: edges are mostly, but need not be, plain.

The feet and corners of the walls in view tell as well, each of them less, as bushes hide them and light may leave a corner no
contrast: h = q = 0.2. An outline that lies on edges of something else seldom has more of these where its walls would end.

A landmark too small to have edges (small_landmarks.py) has one side, its whole rim: a stain has all of a rim as well. One is
missed with h = 0.15. Without a small landmark there, one of that size is found in 58 % within 8 px (2700 positions each in
photos of grass and woods and in rendered images); lying anywhere there, it is as near as 2.5 px to the very position in 9 %: q =
0.05. One that is found elsewhere, or nowhere within these 8 px, is missed whatever its position shows: a rim beside a stone
crosses the stone's edges.
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
    """Sum of u_i of every edge, channel by channel, and the number of its points (E, C + 1), in an image (H, W, C).

    px, normal (N, 2) of the points, edge (N,) theirs; those that are not usable or not in the image do not count.
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
    """log LR (L,) of standing against gone; sums: what across() gave of each image; of the edges: landmark and Kind (E,).

    Images of one pair show the same texture, so their points count once.
    """
    return np.asarray(_log_ratio(np.array(sums), landmark, landmarks, kind))


@njit(cache=True)
def _log_ratio(sums: Array, landmark: Indices, landmarks: int, kind: Indices) -> Array:
    """log_likelihood_ratio (L,) of the sums (K, E, C + 1) of all images."""
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
    """log LR (N,) of small landmarks, so far (N,) from their rims; share (N,): of each that is found where the fit says."""
    return np.where(share < 0.5, math.log(_SPOT_HIDDEN / (1.0 - _SPOT_ELSEWHERE)), log_ratio)
