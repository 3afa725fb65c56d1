"""A region's pixels refined by its own colour.

    c = m k + e, e perpendicular to m;    D^2 = ((k - 1) |m| / 2)^2 + |e|^2    <    T^2,    T = a p75(D inside) + b

m: median colour inside. Light changes along m (k), paint across it, which counts double.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order
from models.messages import Array
from vision.image.rectify import Image

_GROW = 3  # px beyond the first mask
_INSIDE = np.ones((5, 5), np.uint8)
_OPEN = np.ones((3, 3), np.uint8)
_SAMPLE = 400  # pixels from which median and scatter are taken
_SCATTER = 2.3  # a: of a normal distribution's 75th percentile: 3.8 sigma
_LEVELS = 5.0  # b
_CHANGE = (0.5, 1.6)  # of the area; more is another object

Bbox = tuple[int, int, int, int]
Binary = NDArray[np.uint8]


def tighten(image: Image, mask: Binary, bbox: Bbox) -> tuple[Binary, Bbox]:
    """Mask (0, 1) and bbox of the region of that colour; unchanged where there is none.

    image: (H, W) or (H, W, 3) uint8; mask (h, w) 0 or 1, its first pixel at bbox[:2].
    """
    u0, v0, w, h = bbox
    left, top = max(u0 - _GROW, 0), max(v0 - _GROW, 0)
    right, bottom = min(u0 + w + _GROW, image.shape[1]), min(v0 + h + _GROW, image.shape[0])
    window = np.zeros((bottom - top, right - left), np.uint8)
    window[v0 - top : v0 - top + h, u0 - left : u0 - left + w] = mask
    patch = image[top:bottom, left:right]
    inside = cv2.erode(window, _INSIDE)
    if cv2.countNonZero(inside) < 30:
        inside = window
    near = cv2.dilate(window, np.ones((2 * _GROW + 1, 2 * _GROW + 1), np.uint8))
    alike = _alike(
        np.ascontiguousarray(patch if patch.ndim == 3 else patch[..., None]),
        np.asarray(inside, np.uint8),
        np.asarray(near, np.uint8),
    )
    chosen = cv2.morphologyEx(alike, cv2.MORPH_OPEN, _OPEN)
    count, numbers, stats, _ = cv2.connectedComponentsWithStats(chosen)
    if count < 2:
        return mask, bbox
    best = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())
    u, v, w, h, area = (int(x) for x in stats[best])
    if not _CHANGE[0] < area / cv2.countNonZero(mask) < _CHANGE[1]:
        return mask, bbox
    return (numbers[v : v + h, u : u + w] == best).astype(np.uint8), (left + u, top + v, w, h)


@njit(cache=True)
def _alike(patch: NDArray[np.uint8], inside: Binary, near: Binary) -> Binary:
    height, width, channels = patch.shape
    total = 0
    for v in range(height):
        for u in range(width):
            total += inside[v, u]
    stride = max(1, total // _SAMPLE)
    sample = np.empty((total // stride + 1, channels))
    seen, n = 0, 0
    for v in range(height):
        for u in range(width):
            if inside[v, u]:
                if seen % stride == 0:
                    for c in range(channels):
                        sample[n, c] = patch[v, u, c]
                    n += 1
                seen += 1
    median = np.empty(channels)
    for c in range(channels):
        median[c] = order.median(sample[:n, c])
    square = 0.0
    for c in range(channels):
        square += median[c] * median[c]
    norm = max(square, 1.0)
    scatter = np.empty(n)
    for i in range(n):
        scatter[i] = _squared(sample[i], median, norm)
    limit = (_SCATTER * np.sqrt(order.quantile(scatter, 0.75)) + _LEVELS) ** 2
    chosen = np.zeros((height, width), np.uint8)
    colour = np.empty(channels)
    for v in range(height):
        for u in range(width):
            if near[v, u]:
                for c in range(channels):
                    colour[c] = patch[v, u, c]
                chosen[v, u] = _squared(colour, median, norm) < limit
    return chosen


@njit(cache=True)
def _squared(colour: Array, median: Array, norm: float) -> float:
    """D^2 of a colour; a grey one has only a brightness, and no half of it."""
    square, along = 0.0, 0.0
    for c in range(colour.shape[0]):
        d = colour[c] - median[c]
        square += d * d
        along += d * median[c]
    return float(square - 0.75 * along * along / norm) if colour.shape[0] > 1 else float(square)
