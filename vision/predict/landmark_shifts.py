"""Each landmark's shift in the image, and the resulting pose and map errors.

    y_l = D_l dx - D_l,p m_l + e_l,       dx ~ N(0, P),  m_l ~ N(0, s_l^2 I),  e_l ~ N(0, e^2 I)                        (px)
    dx = (P^-1 + sum_l D_l^T N_l^-1 D_l)^-1 sum_l D_l^T N_l^-1 y_l,    N_l = e^2 I + s_l^2 D_l,p D_l,p^T
    m_l = -s_l^2 D_l,p^T N_l^-1 (y_l - D_l dx)

D_l (2, 6): mean motion of landmark l with the pose; D_l,p: with position.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


class Shifted(NamedTuple):
    """Error of the prior (6,) and map errors north, east (L, 2) m."""

    error: Array
    shift_m: Array


def shifted(D: Array, found_px: Array, trusted: Mask, map_sigma: Array, position_px: float, error: Array, P: Array) -> Shifted:
    """D (L, 2, 6); found_px (L, 2): shift from where the prior's error (6,) puts each landmark.

    trusted (L,): those that count; map_sigma (L,) m; position_px: sigma of a found position.
    """
    y, W, information, weighted = _information(D, found_px, trusted, map_sigma, position_px, error)
    total = np.linalg.solve(np.eye(6) + P @ information, P @ weighted).astype(np.float64)
    return Shifted(total, _shifts(D, trusted, map_sigma, y, W, total))


@njit(cache=True)
def motions(points: Array, p_n: Array, p_nk: Array, R_nk: Array, mark: Indices, marks: int, fx: float, fy: float) -> Array:
    """D (L, 2, 6) px of points X (N, 3) of landmarks mark (N,), vehicle at p_n, undistorted camera at p_nk, axes R_nk.

    dx_c = R_nk^T (-dp + [X - p]x dtheta)
    """
    D, count = np.zeros((marks, 2, 6)), np.zeros(marks)
    row, x_c, lever = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(points)):
        for k in range(3):
            lever[k], x_c[k] = points[i, k] - p_n[k], 0.0
            for j in range(3):
                x_c[k] += R_nk[j, k] * (points[i, j] - p_nk[j])
        m, x, y, z = mark[i], x_c[0], x_c[1], x_c[2]
        count[m] += 1.0
        for k in range(2):
            a, b, c = (fx / z, 0.0, -fx * x / z**2) if k == 0 else (0.0, fy / z, -fy * y / z**2)
            for j in range(3):
                row[j] = R_nk[j, 0] * a + R_nk[j, 1] * b + R_nk[j, 2] * c
                D[m, k, j] -= row[j]
            D[m, k, 3] += row[1] * lever[2] - row[2] * lever[1]
            D[m, k, 4] += row[2] * lever[0] - row[0] * lever[2]
            D[m, k, 5] += row[0] * lever[1] - row[1] * lever[0]
    for m in range(marks):
        for i in range(2):
            for k in range(6):
                D[m, i, k] /= max(count[m], 1.0)
    return D


@njit(cache=True)
def _information(
    D: Array, found_px: Array, trusted: Mask, map_sigma: Array, position_px: float, error: Array
) -> tuple[Array, Array, Array, Array]:
    """y_l (L, 2), N_l^-1 (L, 2, 2), sums of D_l^T N_l^-1 D_l (6, 6), D_l^T N_l^-1 y_l (6,)."""
    information, weighted = np.zeros((6, 6)), np.zeros(6)
    y, W, WD = np.empty((len(D), 2)), np.empty((len(D), 2, 2)), np.empty((2, 6))
    for m in range(len(D)):
        if not trusted[m]:
            continue
        n00, n01, n11 = position_px**2, 0.0, position_px**2
        for k in range(2):
            d0, d1 = map_sigma[m] * D[m, 0, k], map_sigma[m] * D[m, 1, k]
            n00, n01, n11 = n00 + d0 * d0, n01 + d0 * d1, n11 + d1 * d1
        det = n00 * n11 - n01 * n01
        W[m, 0, 0], W[m, 0, 1], W[m, 1, 0], W[m, 1, 1] = n11 / det, -n01 / det, -n01 / det, n00 / det
        for i in range(2):
            y[m, i] = found_px[m, i] + _dot(D[m, i], error)
            for k in range(6):
                WD[i, k] = W[m, i, 0] * D[m, 0, k] + W[m, i, 1] * D[m, 1, k]
        for k in range(6):
            weighted[k] += WD[0, k] * y[m, 0] + WD[1, k] * y[m, 1]
            for j in range(6):
                information[k, j] += D[m, 0, k] * WD[0, j] + D[m, 1, k] * WD[1, j]
    return y, W, information, weighted


@njit(cache=True)
def _shifts(D: Array, trusted: Mask, map_sigma: Array, y: Array, W: Array, total: Array) -> Array:
    shift_m = np.zeros((len(D), 2))
    for m in range(len(D)):
        if trusted[m]:
            r0, r1 = y[m, 0] - _dot(D[m, 0], total), y[m, 1] - _dot(D[m, 1], total)
            w0, w1 = W[m, 0, 0] * r0 + W[m, 0, 1] * r1, W[m, 1, 0] * r0 + W[m, 1, 1] * r1
            for k in range(2):
                shift_m[m, k] = -(map_sigma[m] ** 2) * (D[m, 0, k] * w0 + D[m, 1, k] * w1)
    return shift_m


@njit(cache=True)
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total


@njit(cache=True)
def own_positions(votes: Array, common: Indices, free: Array) -> Array:
    """Sub-pixel row, column (L, 2) of the best votes (L, U, V), within free (L,) of common."""
    positions = np.empty((len(votes), 2))
    for k in range(len(votes)):
        one, radius = votes[k], int(free[k])
        a, b = common[0], common[1]
        best = -np.inf
        for i in range(max(common[0] - radius, 0), min(common[0] + radius + 1, one.shape[0])):
            for j in range(max(common[1] - radius, 0), min(common[1] + radius + 1, one.shape[1])):
                if one[i, j] > best:
                    best, a, b = one[i, j], i, j
        positions[k, 0], positions[k, 1] = a, b
        if 0 < a < one.shape[0] - 1:
            positions[k, 0] += _top(one[a - 1, b], one[a, b], one[a + 1, b])
        if 0 < b < one.shape[1] - 1:
            positions[k, 1] += _top(one[a, b - 1], one[a, b], one[a, b + 1])
    return positions


@njit(cache=True)
def _top(before: float, here: float, after: float) -> float:
    curvature = before - 2.0 * here + after
    return min(max(0.5 * (before - after) / curvature, -0.5), 0.5) if curvature < 0.0 else 0.0
