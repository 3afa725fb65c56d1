"""Kernels of correspond: correlation coefficient at whole disparities, sub-pixel maximum.

A template is a list of pixels: neighbours of a region have another disparity.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.image.rectify import Image

Pixels = NDArray[np.int32]  # (N, 2) u, v
_CELL_PIXELS = 160  # of a cell are used at most, whole rows left out
_LEAST_PIXELS = 12
_STEPS = 8


@njit(cache=True)
def padded(mask: NDArray[np.bool_], rim: int) -> NDArray[np.bool_]:
    """The mask grown by `rim` px (square), in an array larger by rim on every side."""
    height, width = mask.shape
    rows = np.zeros((height, width + 2 * rim), np.bool_)
    for v in range(height):
        reach = 0
        for u in range(width + 2 * rim):
            if u < width and mask[v, u]:
                reach = 2 * rim + 1
            rows[v, u] = reach > 0
            reach -= 1
    grown = np.zeros((height + 2 * rim, width + 2 * rim), np.bool_)
    for u in range(width + 2 * rim):
        reach = 0
        for v in range(height + 2 * rim):
            if v < height and rows[v, u]:
                reach = 2 * rim + 1
            grown[v, u] = reach > 0
            reach -= 1
    return grown


@njit(cache=True)
def template(mask: NDArray[np.bool_], u0: int, v0: int, level: int, rim: int) -> Pixels:
    """Pixels (N, 2) of the region with a rim at a pyramid level; (u0, v0): mask's first pixel at level 0."""
    size = 2**level
    first_u, first_v = u0 // size, v0 // size
    height = (v0 + mask.shape[0] - 1) // size - first_v + 1
    width = (u0 + mask.shape[1] - 1) // size - first_u + 1
    small = np.zeros((height, width), np.bool_)
    for v in range(mask.shape[0]):
        for u in range(mask.shape[1]):
            if mask[v, u]:
                small[(v0 + v) // size - first_v, (u0 + u) // size - first_u] = True
    grown = padded(small, rim)
    count = 0
    for v in range(grown.shape[0]):
        for u in range(grown.shape[1]):
            count += grown[v, u]
    pixels = np.empty((count, 2), np.int32)
    n = 0
    for v in range(grown.shape[0]):
        for u in range(grown.shape[1]):
            if grown[v, u]:
                pixels[n, 0], pixels[n, 1] = first_u - rim + u, first_v - rim + v
                n += 1
    return pixels


@njit(cache=True)
def scan(left: Image, right: Image, pixels: Pixels, low: int, high: int, dv: int) -> Array:
    """R(d) for d = low..high: correlation coefficient of left(u, v) and right(u - d, v + dv) (eq. 4.80).

    -1 where more than a quarter of the pixels fall outside, or nothing varies.
    """
    scores = np.full(high - low + 1, -1.0)
    for k in range(high - low + 1):
        n, vx, vy, vxy = _moments(left, right, pixels, low + k, dv)
        if 4 * n >= 3 * pixels.shape[0] and vx > 1e-6 * n and vy > 1e-6 * n:
            scores[k] = vxy / np.sqrt(vx * vy)
    return scores


@njit(cache=True)
def gain(left: Image, right: Image, pixels: Pixels, disparity: int, dv: int) -> float:
    """g of right = g left + o: ratio of standard deviations; regression is biased, as both are noisy."""
    _, vx, vy, _ = _moments(left, right, pixels, disparity, dv)
    return float(np.sqrt(vy / vx)) if vx > 0.0 and vy > 0.0 else 1.0


@njit(cache=True)
def _moments(left: Image, right: Image, pixels: Pixels, d: int, dv: int) -> tuple[int, float, float, float]:
    """n, sum (x - mx)^2, sum (y - my)^2, sum (x - mx)(y - my) of x = left(u, v), y = right(u - d, v + dv)."""
    height, width = left.shape
    n, sx, sy, sxx, syy, sxy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(pixels.shape[0]):
        u, v = pixels[i, 0], pixels[i, 1]
        ur, vr = u - d, v + dv
        if u < 0 or v < 0 or u >= width or v >= height or ur < 0 or ur >= width or vr < 0 or vr >= height:
            continue
        x, y = float(left[v, u]), float(right[vr, ur])
        n += 1
        sx += x
        sy += y
        sxx += x * x
        syy += y * y
        sxy += x * y
    if n == 0:
        return 0, 0.0, 0.0, 0.0
    return n, sxx - sx * sx / n, syy - sy * sy / n, sxy - sx * sy / n


@njit(cache=True)
def cells(
    left: Image, right: Image, mask: NDArray[np.bool_], corner: tuple[int, int], size: int, plane: Array, dv: int, g: float,
    floor: float,
) -> tuple[Array, float, float]:  # fmt: skip
    """Per cell of a region (u, v, disparity, sigma); the remaining vertical offset, and its information.

        sum j (I_r(u - d_i - p (u - u_i) - q (v - v_i), v + dv) - g I_l(u, v) - o) = 0,   j = dI_l / du

    plane = (c, p, q, u_c, v_c): initial disparity c + p (u - u_c) + q (v - v_c); corner (u, v): mask's first pixel; size: of a
    cell, px; g: gain; floor: least noise, levels. The gradient is the left image's: the interpolated right one's would pull
    disparities towards half pixels. A disparity belongs to the centroid of its information; sigma includes noise correlated by
    rectification.
    """
    height, width = left.shape
    rows, columns = -(-mask.shape[0] // size), -(-mask.shape[1] // size)
    found = np.empty((rows * columns, 4))
    count = 0
    stride = max(1, size * size // _CELL_PIXELS)
    cell = np.empty((size * size, 5))  # u, v, g I_l, g dI_l/du, g dI_l/dv
    sums = np.zeros(4)  # of products of neighbouring remainders, of their squares; vertical offset: right side, normal
    for row in range(rows):
        for column in range(columns):
            n, texture = 0, 0.0
            for y in range(row * size, min((row + 1) * size, mask.shape[0]), stride):
                for x in range(column * size, min((column + 1) * size, mask.shape[1])):
                    u, v = corner[0] + x, corner[1] + y
                    if mask[y, x] and 1 <= u < width - 1 and 1 <= v < height - 1 and 1 <= v + dv < height - 1:
                        here = cell[n]
                        here[0], here[1], here[2] = u, v, g * left[v, u]
                        here[3], here[4] = _gradient(left, u, v, g)
                        texture += here[3] * here[3]
                        n += 1
            if n < _LEAST_PIXELS or texture < floor * floor * n * 0.25:
                continue
            if _cell(right, cell[:n], plane, dv, floor, found[count], sums):
                count += 1
    correlation = min(max(sums[0] / max(sums[1], 1e-12), 0.0), 0.6)
    inflation = 1.0 + 2.0 * correlation
    if stride == 1:
        inflation *= inflation
    for i in range(count):
        found[i, 3] *= np.sqrt(inflation)
    step = sums[2] / sums[3] if sums[3] > 0.0 else 0.0
    return found[:count].copy(), step, sums[3] / inflation


@njit(cache=True)
def _gradient(image: Image, u: int, v: int, g: float) -> tuple[float, float]:
    """g dI/du, g dI/dv by Sobel's kernels, per pixel."""
    a, b, c = float(image[v - 1, u - 1]), float(image[v - 1, u]), float(image[v - 1, u + 1])
    d, e = float(image[v, u - 1]), float(image[v, u + 1])
    f, h, i = float(image[v + 1, u - 1]), float(image[v + 1, u]), float(image[v + 1, u + 1])
    return g * 0.125 * (c - a + 2.0 * (e - d) + i - f), g * 0.125 * (f - a + 2.0 * (h - b) + i - c)


@njit(cache=True)
def _cell(right: Image, cell: Array, plane: Array, dv: int, floor: float, found: Array, sums: Array) -> bool:
    n, width = cell.shape[0], right.shape[1]
    j, remainder, mean3, mean4 = np.empty(n), np.empty(n), 0.0, 0.0
    shift, slope, squares = 0.0, 0.0, 0.0
    for i in range(n):
        mean3 += cell[i, 3]
        mean4 += cell[i, 4]
    for i in range(n):
        j[i] = -(cell[i, 3] - mean3 / n)
        squares += j[i] * j[i]
    converged = False
    for _ in range(_STEPS):
        slope, error = 1e-12, 0.0
        for i in range(n):
            u, v = cell[i, 0], cell[i, 1]
            ur = u - (plane[0] + shift + plane[1] * (u - plane[3]) + plane[2] * (v - plane[4]))
            k = int(np.floor(ur))
            if k < 1 or k + 2 >= width:
                return False
            y, derivative = _catmull_rom(right, int(v) + dv, k, ur - k)
            remainder[i] = y - cell[i, 2]
            slope -= j[i] * derivative
            error += j[i] * remainder[i]
        if slope < 0.3 * squares:  # the gradients of the two images do not even resemble each other
            return False
        step = -error / slope
        shift += step
        if abs(shift) > 1.6:
            return False
        if abs(step) < 0.004:
            converged = True
            break
    if not converged:
        return False
    mean = noise = 0.0
    for i in range(n):
        mean += remainder[i]
    for i in range(n):
        remainder[i] -= mean / n
        noise += remainder[i] * remainder[i]
    noise = noise / max(n - 2, 1) + floor * floor
    sigma = np.sqrt(noise * squares) / slope
    if sigma > 1.0:
        return False
    u = v = left_over = 0.0
    for i in range(n):
        u += j[i] * j[i] * cell[i, 0]
        v += j[i] * j[i] * cell[i, 1]
        left_over += (cell[i, 4] - mean4 / n) * j[i]
    found[0], found[1] = u / squares, v / squares
    found[2] = plane[0] + shift + plane[1] * (found[0] - plane[3]) + plane[2] * (found[1] - plane[4])
    found[3] = sigma
    for i in range(1, n):
        if cell[i, 0] == cell[i - 1, 0] + 1.0:
            sums[0] += remainder[i] * remainder[i - 1]
            sums[1] += remainder[i] * remainder[i]
    with_remainder = with_itself = 0.0
    for i in range(n):
        across = (cell[i, 4] - mean4 / n) - j[i] * (left_over / squares)  # what a disparity does not explain
        with_remainder += across * remainder[i]
        with_itself += across * across
    sums[2] -= with_remainder / noise
    sums[3] += with_itself / noise
    return True


@njit(cache=True)
def _catmull_rom(image: Image, v: int, k: int, t: float) -> tuple[float, float]:
    """Value and derivative of a row at k + t, 0 <= t < 1, by cubic interpolation."""
    a, b, c, d = float(image[v, k - 1]), float(image[v, k]), float(image[v, k + 1]), float(image[v, k + 2])
    c1, c2, c3 = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * d, 0.5 * (d - a) + 1.5 * (b - c)
    return b + t * (c1 + t * (c2 + t * c3)), c1 + t * (2.0 * c2 + 3.0 * t * c3)
