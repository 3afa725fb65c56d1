"""A polygon through a noisy closed contour: fitted sides, corners at their intersections."""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order
from models.maps.outline import crosses_itself
from models.messages import Array

_TOLERANCES = (0.012, 0.025, 0.045)  # of the perimeter, for the first guess of the corners; coarser if too many sides come out
_MOST_SIDES = 12
_LEAST_TURN = 0.26  # rad between two sides (15 degrees): less is one side
_RMS_PX = 0.7  # of the points about their sides: more is not this polygon
_LEAST_POINTS = 6  # of a side
_MOST_SHIFT_PX = 4.0  # of a corner from the contour's nearest point
_CLEAR_PX = 2.0  # points nearer than this to a corner are rounded off by the optics


def fit_polygon(contour: Array) -> Array | None:
    """Corners (K, 2), 3 <= K <= 12, in the contour's (N, 2) sense; None where none fits."""
    closed = np.ascontiguousarray(contour, dtype=np.float32)
    perimeter = cv2.arcLength(closed, True)
    for tolerance in _TOLERANCES:
        guess = cv2.approxPolyDP(closed, max(tolerance * perimeter, 1.2), True).reshape(-1, 2).astype(np.float64)
        if 3 <= len(guess) <= _MOST_SIDES:
            corners = _fit(contour, np.unique(_indices(contour, guess)))
            if corners is not None and not crosses_itself(corners):
                return corners
    return None


@njit(cache=True)
def _indices(contour: Array, guess: Array) -> NDArray[np.int64]:
    found = np.empty(guess.shape[0], np.int64)
    for i in range(guess.shape[0]):
        least = np.inf
        for k in range(contour.shape[0]):
            square = (contour[k, 0] - guess[i, 0]) ** 2 + (contour[k, 1] - guess[i, 1]) ** 2
            if square < least:
                least, found[i] = square, k
    return found


@njit(cache=True)
def _apart(p: Array, q: Array) -> float:
    return float(np.hypot(p[0] - q[0], p[1] - q[1]))


@njit(cache=True)
def _line(points: Array) -> Array:
    """(n_u, n_v, d) with n . p = d, |n| = 1: total least squares, two biweight iterations."""
    n = points.shape[0]
    weights, residual, line = np.ones(n), np.empty(n), np.zeros(3)
    for _ in range(3):
        total = mu = mv = uu = uv = vv = 0.0
        for i in range(n):
            total += weights[i]
            mu += weights[i] * points[i, 0]
            mv += weights[i] * points[i, 1]
        if total < 2.0:
            break
        mu, mv = mu / total, mv / total
        for i in range(n):
            du, dv = points[i, 0] - mu, points[i, 1] - mv
            uu += weights[i] * du * du
            uv += weights[i] * du * dv
            vv += weights[i] * dv * dv
        angle = 0.5 * np.arctan2(2.0 * uv, uu - vv) + 0.5 * np.pi  # of the normal
        line[0], line[1] = np.cos(angle), np.sin(angle)
        line[2] = line[0] * mu + line[1] * mv
        for i in range(n):
            residual[i] = abs(line[0] * points[i, 0] + line[1] * points[i, 1] - line[2])
        scale = max(4.685 * 1.4826 * order.median(residual), 0.3)
        for i in range(n):
            weights[i] = (1.0 - (residual[i] / scale) ** 2) ** 2 if residual[i] < scale else 0.0
    return line


@njit(cache=True)
def _fit(contour: Array, corner_at: NDArray[np.int64]) -> Array | None:
    n, k = contour.shape[0], corner_at.shape[0]
    if k < 3:
        return None
    lines = np.empty((k, 3))
    square, counted = 0.0, 0
    for i in range(k):
        a, b = corner_at[i], corner_at[(i + 1) % k]
        length = (b - a) % n
        side = np.empty((length + 1, 2))
        used = 0
        for j in range(length + 1):
            p = contour[(a + j) % n]
            if _apart(p, contour[a]) > _CLEAR_PX and _apart(p, contour[b]) > _CLEAR_PX:
                side[used, 0], side[used, 1] = p[0], p[1]
                used += 1
        if used < _LEAST_POINTS:
            return None
        u, v, d = _line(side[:used])
        lines[i, 0], lines[i, 1], lines[i, 2] = u, v, d
        for j in range(used):
            square += min((side[j, 0] * u + side[j, 1] * v - d) ** 2, 9.0)
        counted += used
    if np.sqrt(square / counted) > _RMS_PX:
        return None
    corners = np.empty((k, 2))
    for i in range(k):  # corner i: where side i - 1 meets side i
        a, b = lines[i - 1 if i else k - 1], lines[i]
        det = a[0] * b[1] - a[1] * b[0]
        if abs(det) < np.sin(_LEAST_TURN):
            return None
        corners[i, 0] = (a[2] * b[1] - a[1] * b[2]) / det
        corners[i, 1] = (a[0] * b[2] - a[2] * b[0]) / det
        if _apart(corners[i], contour[corner_at[i]]) > _MOST_SHIFT_PX:
            return None
    return corners
