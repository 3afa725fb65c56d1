"""Sub-pixel position of blurred steps on profiles.

    g(s) = a + c1 Phi((s - s0) / sigma) + c2 Phi((s - s0 - gap) / sigma)

Two steps where a narrow wall, or a shadow strip of estimated width, lies between roof and ground. The edge's mean profile gives
shape (Levenberg-Marquardt), then each point one linear estimate of gain and shift.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import cholesky
from models.messages import Array

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_STANDS_OUT = 4.0  # standard deviations of the mean profile that a contrast has, at least: what texture makes has less
_LEAST_CONTRAST = 3.0  # grey values; below it an edge is not examined
_FINENESS, _TAIL = 128, 6.0  # entries per sigma of the table of Phi, and how far it reaches
_PHI = np.array([0.5 * (1.0 + math.erf((i / _FINENESS - _TAIL) / math.sqrt(2.0))) for i in range(int(2 * _TAIL * _FINENESS) + 2)])
_STRIP_MISFIT = 6.0  # grey values^2; a mean profile that one step fits worse than this has a second one
_WIDTHS = 0.5 * np.arange(4, 15)  # px, of strips that are tried,
_STRIP_POSITIONS, _STRIP_BLUR = 7, 0.7  # at so many positions of the first step, and how blurred [px]
_START_BLUR = 0.8  # px, with which a step is sought first
_FIRST = 0.35  # share of the larger contrast that the first of two steps has at least: else it might be taken for the second


@njit(cache=True)
def fit(grey: Array, edge: Indices, gap: Array, farthest: float, step: float, usable: Mask) -> tuple[Array, Array, Array]:
    """Offsets (N,) px, NaN for none; blur (E,) px; variance (E,) px^2 by gaps.

    gap: (E,) px to a second step (a narrow wall's foot), 0 without; the variance is what the division of contrast leaves open.
    farthest: largest mean offset, px.
    """
    n, size = grey.shape
    edges, half = len(gap), size // 2
    offsets, blur, opened, centre = np.empty(n), np.empty(edges), np.zeros(edges), np.empty(edges)
    for i in range(n):
        offsets[i] = np.nan
    for e in range(edges):
        blur[e] = centre[e] = np.nan
    mean, square, count = np.zeros((edges, size)), np.zeros(edges), np.zeros(edges)
    for i in range(n):
        if usable[i]:
            e, own = edge[i], 0.0
            for j in range(size):
                mean[e, j] += grey[i, j]
                own += grey[i, j] / size
            for j in range(size):
                square[e] += (grey[i, j] - own) ** 2
            count[e] += 1.0
    position = np.empty(size)
    for j in range(size):
        position[j] = (j - half) * step
    starts, strips = _steps(position, _starts(farthest), _START_BLUR), np.empty((0, 0, 0))
    rows = np.zeros((edges, 2, size))
    for e in range(edges):
        if count[e] < 2:
            continue
        second, g, level, power = gap[e], mean[e], 0.0, 0.0
        for j in range(size):
            g[j] /= count[e]
            level += g[j]
        for j in range(size):
            g[j] -= level / size
            power += g[j] * g[j]
        x, variance, misfit = _fit_mean(position, g, second, farthest, starts)
        if second == 0.0 and misfit > _STRIP_MISFIT:
            if not len(strips):
                strips = _strip_columns(position, farthest)
            second = _strip(strips, g, misfit)
            if second > 0.0:
                x, variance, misfit = _fit_mean(position, g, second, farthest, starts)
        contrast = max(abs(x[1]), abs(x[2]))
        scatter = max(square[e] / count[e] - power, 0.0) / (size - 1.0)  # of single profiles about their mean
        if (
            contrast < max(_LEAST_CONTRAST, _STANDS_OUT * math.sqrt(scatter / count[e]))
            or abs(x[3]) > farthest
            or abs(x[1]) < _FIRST * contrast
        ):
            continue
        if _point_rows(position, x, second, rows[e]):
            centre[e], blur[e], opened[e] = x[3], x[4], variance
    for i in range(n):
        e = edge[i]
        if not usable[i] or math.isnan(centre[e]):
            continue
        gain = shift = 0.0
        for j in range(size):
            gain += rows[e, 0, j] * grey[i, j]
            shift += rows[e, 1, j] * grey[i, j]
        if gain < 0.3:
            continue
        shift /= min(max(gain, 0.6), 1.6)
        if abs(shift) < 0.6 * half * step:
            offsets[i] = centre[e] + shift
    return offsets, blur, opened


@njit(cache=True)
def _normal(z: float) -> tuple[float, float]:
    if z <= -_TAIL:
        return 0.0, 0.0
    if z >= _TAIL:
        return 1.0, 0.0
    at = (z + _TAIL) * _FINENESS
    i = int(at)
    low, high = _PHI[i], _PHI[i + 1]
    return low + (at - i) * (high - low), (high - low) * _FINENESS


@njit(cache=True)
def _basis(position: Array, s0: float, sigma: float, gap: float, basis: Array) -> None:
    """Columns 1, Phi, Phi of the second step, two densities, at each position: (S, 5)."""
    for j in range(position.shape[0]):
        z = (position[j] - s0) / sigma
        basis[j, 0] = 1.0
        basis[j, 1], density = _normal(z)
        basis[j, 3] = density / sigma
        if gap > 0.0:
            basis[j, 2], density = _normal(z - gap / sigma)
            basis[j, 4] = density / sigma
        else:
            basis[j, 2], basis[j, 4] = 0.0, 0.0


@njit(cache=True)
def _levels(gg: float, g1: float, g2: float, a11: float, a12: float, a22: float, weight: float) -> tuple[float, float, float]:
    """Least |g - c1 f1 - c2 f2|^2 + weight (c1 - c2)^2, and c1, c2, from inner products."""
    b11, b12, b22 = a11 + weight, a12 - weight, a22 + weight
    det = b11 * b22 - b12 * b12
    if det <= 1e-9 * b11 * b22:
        return np.inf, 0.0, 0.0
    c1, c2 = (b22 * g1 - b12 * g2) / det, (b11 * g2 - b12 * g1) / det
    return max(gg - c1 * g1 - c2 * g2, 0.0), c1, c2


@njit(cache=True)
def _split(position: Array, g: Array, gap: float, weight: float, s0: float, sigma: float, x: Array, basis: Array) -> float:
    """x = (a, c1, c2, s0, sigma), levels by linear least squares at s0, sigma; returns the cost; g: mean-free."""
    _basis(position, s0, sigma, gap, basis)
    size = position.shape[0]
    m1 = m2 = gg = g1 = g2 = a11 = a12 = a22 = 0.0
    for j in range(size):
        f1, f2 = basis[j, 1], basis[j, 2]
        m1 += f1 / size
        m2 += f2 / size
        gg += g[j] * g[j]
        g1 += f1 * g[j]
        g2 += f2 * g[j]
        a11 += f1 * f1
        a12 += f1 * f2
        a22 += f2 * f2
    a11 -= size * m1 * m1
    if gap > 0.0:
        cost, x[1], x[2] = _levels(gg, g1, g2, a11, a12 - size * m1 * m2, a22 - size * m2 * m2, weight)
    elif a11 > 1e-9:
        x[1], x[2] = g1 / a11, 0.0
        cost = max(gg - x[1] * g1, 0.0)
    else:
        cost = np.inf
    x[0], x[3], x[4] = -x[1] * m1 - x[2] * m2, s0, sigma
    return cost


@njit(cache=True)
def _fit_mean(position: Array, g: Array, gap: float, farthest: float, starts: Array) -> tuple[Array, float, float]:
    """(a, c1, c2, s0, sigma) of the mean profile g (mean-free), variance of s0, mean squared misfit; levels optimal.

    Levenberg-Marquardt from the best of starts, _steps() of a single step.
    """
    size = position.shape[0]
    reach = position[size - 1]
    across = (g[size - 1] + g[size - 2] + g[size - 3] - g[0] - g[1] - g[2]) / 3.0
    weight = _unevenness(max(abs(across), 0.5 * _range(g)))
    basis, x, trial = np.empty((size, 5)), np.zeros(5), np.zeros(5)
    normal, right, room, step = np.zeros((5, 5)), np.zeros(5), np.zeros((5, 5)), np.zeros(5)
    cost, positions = np.inf, _starts(farthest)
    if gap == 0.0:
        cost = _split(position, g, gap, weight, positions[_best_start(starts, g)], _START_BLUR, x, basis)
    else:
        for k in range(len(positions)):
            value = _split(position, g, gap, weight, positions[k], _START_BLUR, trial, basis)
            if value < cost and abs(trial[1]) > _FIRST * abs(trial[2]):
                cost = value
                _put(trial, x)
    if cost == np.inf or x[1] == 0.0:
        return x, 0.0, 0.0
    if gap > 0.0:
        _basis(position, x[3], x[4], gap, basis)
    damping, fresh = 1e-3, True
    for _ in range(10):
        if fresh:
            _normal_equations(position, g, gap, weight, x, basis, normal, right)
        for k in range(5):
            for m in range(5):
                room[k, m] = normal[k, m]
            room[k, k] += damping * normal[k, k] + 1e-9
        if not cholesky.factor(room, room):
            break
        _put(right, step)
        cholesky.substitute(room, step)
        s0, sigma = min(max(x[3] + step[3], -reach), reach), min(max(x[4] + step[4], 0.35), 0.6 * reach)
        value = _split(position, g, gap, weight, s0, sigma, trial, basis)
        fresh = value < cost
        if fresh:
            done = cost - value < 1e-3 * cost
            cost = value
            _put(trial, x)
            damping *= 0.2
            if done:
                break
        else:
            damping *= 8.0
    if gap == 0.0:
        return x, 0.0, cost / size
    _basis(position, x[3], x[4], gap, basis)
    _normal_equations(position, g, gap, weight, x, basis, normal, right)
    for k in range(5):
        normal[k, k] += 1e-9
    if not cholesky.factor(normal, normal):
        return x, np.inf, cost / size
    step[:] = 0.0
    step[3] = 1.0
    cholesky.substitute(normal, step)
    return x, max(cost / max(size - 5, 1), 1.0) * step[3], cost / size


@njit(cache=True)
def _put(values: Array, into: Array) -> None:
    for k in range(len(values)):
        into[k] = values[k]


@njit(cache=True)
def _range(g: Array) -> float:
    least = most = g[0]
    for j in range(1, len(g)):
        least, most = min(least, g[j]), max(most, g[j])
    return float(most - least)


@njit(cache=True)
def _unevenness(contrast: float) -> float:
    """Weight of (c1 - c2)^2: noise over unevenness of two steps, squared."""
    return (2.0 / (1.5 * max(contrast, 1.0))) ** 2


@njit(cache=True)
def _starts(farthest: float) -> Array:
    positions = np.empty(9)
    for k in range(9):
        positions[k] = 0.25 * farthest * (k - 4.0)
    return positions


@njit(cache=True)
def _steps(position: Array, s0: Array, sigma: float) -> Array:
    """Steps Phi((s - s0) / sigma) (P, S) at s0 (P,), mean-free."""
    steps = np.empty((len(s0), len(position)))
    for p in range(len(s0)):
        total = 0.0
        for j in range(len(position)):
            steps[p, j], _ = _normal((position[j] - s0[p]) / sigma)
            total += steps[p, j]
        for j in range(len(position)):
            steps[p, j] -= total / len(position)
    return steps


@njit(cache=True)
def _best_start(starts: Array, g: Array) -> int:
    best, found = 0.0, 0
    for p in range(len(starts)):
        inner = square = 0.0
        for j in range(len(g)):
            inner += starts[p, j] * g[j]
            square += starts[p, j] * starts[p, j]
        if inner * inner > best * square:
            best, found = inner * inner / square, p
    return found


@njit(cache=True)
def _strip_columns(position: Array, farthest: float) -> Array:
    """_steps (1 + W, P, S): the first at P positions, the second for each of W widths."""
    columns = np.empty((1 + len(_WIDTHS), _STRIP_POSITIONS, position.shape[0]))
    s0 = np.empty(_STRIP_POSITIONS)
    for w in range(columns.shape[0]):
        for p in range(_STRIP_POSITIONS):
            s0[p] = farthest * (2.0 * p / (_STRIP_POSITIONS - 1) - 1.0) + (_WIDTHS[w - 1] if w > 0 else 0.0)
        steps = _steps(position, s0, _STRIP_BLUR)
        for p in range(_STRIP_POSITIONS):
            _put(steps[p], columns[w, p])
    return columns


@njit(cache=True)
def _strip(columns: Array, g: Array, misfit: float) -> float:
    """Width [px] of a strip (a shadow's rim) that explains the misfit of one step, or 0."""
    weight, gg = _unevenness(_range(g)), 0.0
    for j in range(len(g)):
        gg += g[j] * g[j]
    best, found = 0.3 * misfit * len(g), 0.0
    for p in range(columns.shape[1]):
        first = columns[0, p]
        g1 = a11 = 0.0
        for j in range(len(g)):
            g1 += first[j] * g[j]
            a11 += first[j] * first[j]
        for w in range(len(_WIDTHS)):
            second = columns[1 + w, p]
            g2 = a12 = a22 = 0.0
            for j in range(len(g)):
                g2 += second[j] * g[j]
                a12 += second[j] * first[j]
                a22 += second[j] * second[j]
            cost, c1, c2 = _levels(gg, g1, g2, a11, a12, a22, weight)
            if cost < best and abs(c1) > _FIRST * abs(c2):
                best, found = cost, _WIDTHS[w]
    return found


@njit(cache=True)
def _normal_equations(
    position: Array, g: Array, gap: float, weight: float, x: Array, basis: Array, normal: Array, right: Array
) -> None:
    """Lower half of J^T J, and J^T r at x = (a, c1, c2, s0, sigma), with _basis() there."""
    normal[:] = 0.0
    right[:] = 0.0
    row = np.empty(5)
    for j in range(position.shape[0]):
        z = (position[j] - x[3]) / x[4]
        row[0], row[1], row[2] = 1.0, basis[j, 1], basis[j, 2]
        row[3] = -x[1] * basis[j, 3] - x[2] * basis[j, 4]
        row[4] = -x[1] * basis[j, 3] * z - x[2] * basis[j, 4] * (z - gap / x[4])
        residual = g[j] - x[0] - x[1] * basis[j, 1] - x[2] * basis[j, 2]
        for k in range(5):
            right[k] += row[k] * residual
            for m in range(k + 1):
                normal[k, m] += row[k] * row[m]
    if gap > 0.0:
        normal[1, 1] += weight
        normal[2, 2] += weight
        normal[2, 1] -= weight
        right[1] -= weight * (x[1] - x[2])
        right[2] += weight * (x[1] - x[2])
    else:
        normal[2, 2] = 1.0


@njit(cache=True)
def _point_rows(position: Array, x: Array, gap: float, rows: Array) -> bool:
    """Rows that give gain and gain * shift of a profile: least squares on 1, the edge's steps and derivative."""
    size = position.shape[0]
    basis, jacobian = np.empty((size, 5)), np.empty((size, 3))
    _basis(position, x[3], x[4], gap, basis)
    scale = np.zeros(3)
    for j in range(size):
        jacobian[j, 0], jacobian[j, 1] = 1.0, x[1] * basis[j, 1] + x[2] * basis[j, 2]
        jacobian[j, 2] = -x[1] * basis[j, 3] - x[2] * basis[j, 4]
        for k in range(3):
            scale[k] += jacobian[j, k] ** 2
    for k in range(3):
        scale[k] = math.sqrt(scale[k]) + 1e-12
    normal, gain, shift = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for j in range(size):
        for k in range(3):
            for m in range(3):
                normal[k, m] += jacobian[j, k] * jacobian[j, m] / (scale[k] * scale[m])
    if not cholesky.factor(normal, normal) or normal[2, 2] < 3e-3 or normal[1, 1] < 3e-3:
        return False
    gain[1] = shift[2] = 1.0
    cholesky.substitute(normal, gain)
    cholesky.substitute(normal, shift)
    for j in range(size):
        rows[0, j] = rows[1, j] = 0.0
        for k in range(3):
            rows[0, j] += gain[k] * jacobian[j, k] / (scale[k] * scale[1])
            rows[1, j] += shift[k] * jacobian[j, k] / (scale[k] * scale[2])
    return True
