"""Where the edges of a projected outline lie in one picture, to a fraction of a pixel.

Along the normal n of a projected edge the grey value is a blurred step,

    g(s) = a + c Phi((s - s0) / sigma),

whose place s0 is the residual of the outline there: + is in the direction of n. Profiles are read in the picture as it is; lens
distortion bends the outline, not the picture. A search votes for one offset per edge with one sign of contrast; the fit takes
step and blur from the edge's mean profile and then one linear least-squares estimate per point.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array

Picture = NDArray[np.uint8]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_BOX = 3  # samples on either side of a step that the search compares
_AGREE = 3.0  # samples that a point's edge may lie from the edge's common offset
_SECOND = 0.75  # a rival that has this share of the best vote makes an edge ambiguous
_LEAST_CONTRAST = 3.0  # grey values; below it an edge is not looked at
_SQRT2, _SQRT2PI = math.sqrt(2.0), math.sqrt(2.0 * math.pi)


@njit(cache=True)
def profiles(picture: Picture, px: Array, normal: Array, half: int, step: float, width: int, usable: Mask) -> Array:
    """Values (N, 2 half + 1, C) of picture (H, W, C) at px + s normal, s = -half step ... half step; bilinear.

    px, normal: (N, 2); width: neighbours along the edge, 1 px apart, that are averaged. usable (N,) is cleared where a profile
    leaves the picture.
    """
    rows, columns, channels = picture.shape
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
                        w00 * picture[row, column, c]
                        + w01 * picture[row, column + 1, c]
                        + w10 * picture[row + 1, column, c]
                        + w11 * picture[row + 1, column + 1, c]
                    )
            for c in range(channels):
                values[i, j, c] /= width
    return values


@njit(cache=True)
def along_contrast(values: Array, edge: Indices, edges: int, usable: Mask) -> Array:
    """Profiles (N, S) of one value: the colour difference between the two sides of each edge, as a unit vector, times colour."""
    n, size, channels = values.shape
    third = size // 3
    difference = np.zeros((edges, channels))
    for i in range(n):
        if usable[i]:
            for j in range(third):
                for c in range(channels):
                    difference[edge[i], c] += values[i, size - 1 - j, c] - values[i, j, c]
    for e in range(edges):
        norm = math.sqrt(np.sum(difference[e] ** 2))
        if norm > 0.0:
            difference[e] /= norm
        else:
            difference[e] = 1.0 / math.sqrt(channels)
    result = np.zeros((n, size))
    for i in range(n):
        for j in range(size):
            for c in range(channels):
                result[i, j] += values[i, j, c] * difference[edge[i], c]
    return result


@njit(cache=True)
def search(grey: Array, edge: Indices, edges: int, step: float, usable: Mask) -> Array:
    """Offsets (N,) px of the step nearest to what all points of an edge vote for; NaN where there is none.

    Box differences D_i(s) of all points are added with their sign; the offset of the largest |sum| wins, unless a second one,
    farther off than a slope could explain, is nearly as large: such an edge stays out of this round.
    """
    n, size = grey.shape
    last = size - _BOX
    response = np.zeros((n, size))
    vote = np.zeros((edges, size))
    count = np.zeros(edges)
    for i in range(n):
        if usable[i]:
            count[edge[i]] += 1.0
            for j in range(_BOX, last):
                total = 0.0
                for k in range(1, _BOX + 1):
                    total += grey[i, j + k] - grey[i, j - k]
                response[i, j] = total / _BOX
                vote[edge[i], j] += response[i, j]
    best, sign = _elect(vote, count)
    offsets = np.full(n, np.nan)
    for i in range(n):
        e = edge[i]
        if not usable[i] or best[e] < 0:
            continue
        low, high = max(_BOX + 1, int(best[e] - _AGREE)), min(last - 2, int(best[e] + _AGREE))
        top, at = 0.0, -1
        for j in range(low, high + 1):
            value = sign[e] * response[i, j]
            if value > top and value >= sign[e] * response[i, j - 1] and value >= sign[e] * response[i, j + 1]:
                top, at = value, j
        if at >= 0 and top > 0.4 * sign[e] * vote[e, int(best[e])] / count[e]:
            before, after = sign[e] * response[i, at - 1], sign[e] * response[i, at + 1]
            curvature = before - 2.0 * top + after
            shift = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
            offsets[i] = (at + shift - size // 2) * step
    return offsets


@njit(cache=True)
def _elect(vote: Array, count: Array) -> tuple[Array, Array]:
    """Best place (E,), -1 where none or ambiguous, and sign (E,) of the edges' votes (E, S)."""
    edges, size = vote.shape
    best, sign = np.full(edges, -1.0), np.ones(edges)
    for e in range(edges):
        if count[e] < 2:
            continue
        at = int(np.argmax(np.abs(vote[e])))
        top = abs(vote[e, at])
        if top < _LEAST_CONTRAST * count[e]:
            continue
        rival = 0.0
        for j in range(1, size - 1):
            value = abs(vote[e, j])
            if abs(j - at) > _BOX and value > abs(vote[e, j - 1]) and value >= abs(vote[e, j + 1]):
                rival = max(rival, value)
        if rival < _SECOND * top:
            best[e] = at
            sign[e] = 1.0 if vote[e, at] > 0.0 else -1.0
    return best, sign


@njit(cache=True)
def fit(grey: Array, edge: Indices, edges: int, step: float, usable: Mask) -> tuple[Array, Array]:
    """Offsets (N,) px of the blurred steps, NaN where there is none, and blur (E,) px of the edges."""
    n, size = grey.shape
    half = size // 2
    offsets, blur = np.full(n, np.nan), np.full(edges, np.nan)
    mean, count = np.zeros((edges, size)), np.zeros(edges)
    for i in range(n):
        if usable[i]:
            mean[edge[i]] += grey[i]
            count[edge[i]] += 1.0
    place = (np.arange(size) - half) * step
    rows = np.zeros((edges, 2, size))
    contrast = np.zeros(edges)
    centre = np.full(edges, np.nan)
    for e in range(edges):
        if count[e] < 2:
            continue
        ok, s0, sigma, c = _fit_mean(place, mean[e] / count[e])
        if ok and abs(c) >= _LEAST_CONTRAST:
            ok = _point_rows(place, s0, sigma, rows[e])
        if ok and abs(c) >= _LEAST_CONTRAST:
            centre[e], blur[e], contrast[e] = s0, sigma, c
    for i in range(n):
        e = edge[i]
        if not usable[i] or math.isnan(centre[e]):
            continue
        c = np.dot(rows[e, 0], grey[i])
        if c / contrast[e] < 0.3:
            continue
        c = contrast[e] * min(max(c / contrast[e], 0.6), 1.6)
        shift = np.dot(rows[e, 1], grey[i]) / c
        if abs(shift) < 0.6 * half * step:
            offsets[i] = centre[e] + shift
    return offsets, blur


@njit(cache=True)
def _fit_mean(place: Array, g: Array) -> tuple[bool, float, float, float]:
    """(found, s0, sigma, c) of a + c Phi((s - s0) / sigma) in g(place): Levenberg-Marquardt from the gradient's centroid."""
    size = g.shape[0]
    reach = place[size - 1]
    third = max(2, size // 4)
    a, b = np.mean(g[:third]), np.mean(g[size - third :])
    c = b - a
    if abs(c) < 1.0:
        return False, 0.0, 0.0, 0.0
    moment, total = 0.0, 0.0
    for j in range(1, size):
        d = (g[j] - g[j - 1]) * (1.0 if c > 0 else -1.0)
        if d > 0.0:
            moment += d * d * 0.5 * (place[j] + place[j - 1])
            total += d * d
    x = np.array([a, c, moment / total, 0.8])
    cost, damping = np.inf, 1e-3
    jacobian, residual = np.empty((size, 4)), np.empty(size)
    trial = x.copy()
    normal, gradient = np.zeros((4, 4)), np.zeros(4)
    for _ in range(12):
        new_cost = 0.0
        for j in range(size):
            z = (place[j] - trial[2]) / trial[3]
            residual[j] = g[j] - trial[0] - trial[1] * 0.5 * (1.0 + math.erf(z / _SQRT2))
            new_cost += residual[j] ** 2
        if new_cost < cost:
            done = cost - new_cost < 1e-4 * new_cost
            x[:] = trial
            cost = new_cost
            if done:
                break
            damping *= 0.2
            for j in range(size):
                z = (place[j] - x[2]) / x[3]
                density = math.exp(-0.5 * z * z) / _SQRT2PI / x[3]
                jacobian[j, 0], jacobian[j, 1] = 1.0, 0.5 * (1.0 + math.erf(z / _SQRT2))
                jacobian[j, 2], jacobian[j, 3] = -x[1] * density, -x[1] * density * z
            normal = jacobian.T @ jacobian
            gradient = jacobian.T @ residual
        else:
            damping *= 8.0
        damped = normal.copy()
        for k in range(4):
            damped[k, k] += damping * normal[k, k] + 1e-9
        trial = x + np.linalg.solve(damped, gradient)
        trial[3] = min(max(trial[3], 0.35), 0.6 * reach)
        trial[2] = min(max(trial[2], -reach), reach)
    return abs(x[2]) < 0.7 * reach, x[2], x[3], x[1]


@njit(cache=True)
def _point_rows(place: Array, s0: float, sigma: float, rows: Array) -> bool:
    """Rows that take contrast c and c * shift out of one profile: least squares on 1, Phi, -phi / sigma."""
    size = place.shape[0]
    jacobian = np.empty((size, 3))
    for j in range(size):
        z = (place[j] - s0) / sigma
        jacobian[j, 0], jacobian[j, 1] = 1.0, 0.5 * (1.0 + math.erf(z / _SQRT2))
        jacobian[j, 2] = -math.exp(-0.5 * z * z) / _SQRT2PI / sigma
    normal = jacobian.T @ jacobian
    if abs(np.linalg.det(normal)) < 1e-9:
        return False
    rows[:] = np.linalg.solve(normal, jacobian.T.copy())[1:]
    return True


@njit(cache=True)
def crossed(px: Array, normal: Array, edge: Indices, start: Array, end: Array, reach: float) -> Mask:
    """Points (N,) whose profile, within reach px, meets another edge's chord start-end (E, 2)."""
    n, edges = px.shape[0], start.shape[0]
    result = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        for e in range(edges):
            if e == edge[i]:
                continue
            au, av = start[e, 0] - px[i, 0], start[e, 1] - px[i, 1]
            bu, bv = end[e, 0] - px[i, 0], end[e, 1] - px[i, 1]
            side_a, side_b = normal[i, 0] * av - normal[i, 1] * au, normal[i, 0] * bv - normal[i, 1] * bu
            if (side_a > 0.0) == (side_b > 0.0):
                continue
            s = side_a / (side_a - side_b)
            along = (au + s * (bu - au)) * normal[i, 0] + (av + s * (bv - av)) * normal[i, 1]
            if abs(along) < reach:
                result[i] = True
                break
    return result
