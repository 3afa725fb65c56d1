"""Each edge in each image as two numbers: offset a and tilt b.

    r_i = a + b tau_i + noise,   tau = -1 ... 1 over what is in view of the edge

A small landmark (small_landmarks.py) has its shift instead: r_i = n_i . (du, dv) + noise.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

Indices = NDArray[np.int64]
_TUKEY = 4.685  # 95 % efficiency on Gaussian noise
_FLOOR_PX = 0.02  # least scatter
_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class EdgeLines:
    """Lines of E edges in one image.

    line: (E, 2) offset and tilt, or shift, px; found: (E,); gain: (N, 2), line_e = sum_i gain_i r_i; weight (N,), 0 = not used;
    residual: (N,) px; unit: (E, 2, 2) covariance for white noise of 1 px; square: (E,) weighted sum of squares; points: (E,)
    effective number.
    """

    line: Array
    found: NDArray[np.bool_]
    gain: Array
    weight: Array
    residual: Array
    unit: Array
    square: Array
    points: Array

    def only(self, wanted: NDArray[np.bool_], edge: Indices) -> "EdgeLines":
        """Without the edges not wanted (E,); edge (N,): of the points."""
        found, used = self.found & wanted, wanted[edge]
        return replace(
            self, found=found, gain=self.gain * used[:, None], weight=self.weight * used, square=self.square * wanted,
            points=self.points * wanted,
        )  # fmt: skip


def fit_lines(offsets: Array, tau: Array, edge: Indices, edges: int, least: int) -> EdgeLines:
    """Robust lines through offsets (N,) px (NaN: missing); an edge needs `least` points; tau: as Samples."""
    return EdgeLines(*lines_of(offsets, np.column_stack((np.ones_like(tau), tau)), edge, edges, least))


@njit(cache=True)
def lines_of(
    offsets: Array, x: Array, edge: Indices, edges: int, least: int
) -> tuple[Array, NDArray[np.bool_], Array, Array, Array, Array, Array, Array]:
    """Fields of EdgeLines; x (N, 2): regressors, 1 and tau of an edge."""
    n = offsets.shape[0]
    line, unit, found = np.zeros((edges, 2)), np.zeros((edges, 2, 2)), np.zeros(edges, dtype=np.bool_)
    gain, weight, residual = np.zeros((n, 2)), np.zeros(n), np.zeros(n)
    square, points = np.zeros(edges), np.zeros(edges)
    start = int(np.int64(0))  # a literal would be another signature of what is called with it, as in other kernels
    while start < n:
        stop = start
        while stop < n and edge[stop] == edge[start]:
            stop += 1
        e = edge[start]
        given = 0
        for i in range(start, stop):
            if not math.isnan(offsets[i]):
                weight[i] = 1.0
                given += 1
        if given >= least:
            found[e] = _robust_line(offsets, x, start, stop, line[e], unit[e], weight, residual)
            for i in range(start, stop):
                if found[e] and weight[i] > 0.0:
                    gain[i, 0] = weight[i] * (unit[e, 0, 0] * x[i, 0] + unit[e, 0, 1] * x[i, 1])
                    gain[i, 1] = weight[i] * (unit[e, 1, 0] * x[i, 0] + unit[e, 1, 1] * x[i, 1])
                    square[e] += weight[i] * residual[i] ** 2
                    points[e] += weight[i]
            if points[e] < least - 0.5:
                found[e] = False
        if not found[e]:
            for i in range(start, stop):
                weight[i] = gain[i, 0] = gain[i, 1] = 0.0
            square[e] = points[e] = 0.0
        start = stop
    return line, found, gain, weight, residual, unit, square, points


@njit(cache=True)
def _robust_line(r: Array, x: Array, start: int, stop: int, line: Array, unit: Array, weight: Array, residual: Array) -> bool:
    values = np.empty(stop - start)
    for step in range(_ROUNDS):
        s0 = s1 = s2 = y0 = y1 = 0.0
        for i in range(start, stop):
            w = weight[i]
            if w > 0.0:
                s0 += w * x[i, 0] * x[i, 0]
                s1 += w * x[i, 0] * x[i, 1]
                s2 += w * x[i, 1] * x[i, 1]
                y0 += w * r[i] * x[i, 0]
                y1 += w * r[i] * x[i, 1]
        s2 += 1e-6 * s0
        det = s0 * s2 - s1 * s1
        if s0 <= 0.0 or det <= 1e-9 * s0 * s0:
            return False
        unit[0, 0], unit[1, 1] = s2 / det, s0 / det
        unit[0, 1] = unit[1, 0] = -s1 / det
        line[0] = (s2 * y0 - s1 * y1) / det
        line[1] = (s0 * y1 - s1 * y0) / det
        count = 0
        for i in range(start, stop):
            if not math.isnan(r[i]):
                residual[i] = r[i] - line[0] * x[i, 0] - line[1] * x[i, 1]
                values[count] = abs(residual[i])
                count += 1
        if step == _ROUNDS - 1:
            return True
        scale = max(1.4826 * _median(values[:count]) * math.sqrt(count / max(count - 2.0, 1.0)), _FLOOR_PX)
        for i in range(start, stop):
            if not math.isnan(r[i]):
                z = abs(residual[i]) / scale
                if step < 2:
                    weight[i] = 1.0 / max(z, 0.5)
                else:
                    weight[i] = (1.0 - (z / _TUKEY) ** 2) ** 2 if z < _TUKEY else 0.0
    return True


@njit(cache=True)
def _median(few: Array) -> float:
    n = len(few)
    for i in range(1, n):
        value, j = few[i], i
        while j > 0 and few[j - 1] > value:
            few[j] = few[j - 1]
            j -= 1
        few[j] = value
    return float(0.5 * (few[(n - 1) // 2] + few[n // 2]))


@njit(cache=True)
def compress(gain: Array, rows: Array, edge: Indices, edges: int) -> Array:
    """Rows (N, P) of the points as rows of the lines, (E, 2, P)."""
    columns = rows.shape[1]
    result = np.zeros((edges, 2, columns))
    for i in range(rows.shape[0]):
        e, g0, g1 = edge[i], gain[i, 0], gain[i, 1]
        if g0 != 0.0 or g1 != 0.0:
            for k in range(columns):
                result[e, 0, k] += g0 * rows[i, k]
                result[e, 1, k] += g1 * rows[i, k]
    return result
