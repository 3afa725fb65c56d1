"""The two kernels of correspond: the correlation coefficient at whole disparities, and its maximum to a fraction of a pixel.

A template is a list of pixels, not a rectangle: what lies beside a region has another disparity and must not be compared.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.rectify import Image

Pixels = NDArray[np.int32]  # (N, 2) u, v
_CELL_PIXELS = 160  # of a cell are used at most, whole rows left out
_LEAST_PIXELS = 12
_STEPS = 8


@njit(cache=True)
def padded(mask: NDArray[np.bool_], rim: int) -> NDArray[np.bool_]:
    """The mask grown by `rim` px (square neighbourhood), in an array larger by rim on every side."""
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
    """Pixels (N, 2) of the region at a pyramid level, with a rim; mask's first pixel is (u0, v0) at level 0."""
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
    pixels = np.empty((grown.sum(), 2), np.int32)
    n = 0
    for v in range(grown.shape[0]):
        for u in range(grown.shape[1]):
            if grown[v, u]:
                pixels[n, 0], pixels[n, 1] = first_u - rim + u, first_v - rim + v
                n += 1
    return pixels


@njit(cache=True)
def scan(left: Image, right: Image, pixels: Pixels, low: int, high: int, dv: int) -> Array:
    """R(d) for d = low..high: correlation coefficient of left(u, v) and right(u - d, v + dv) over the pixels (eq. 4.80).

    -1 where more than a quarter of the pixels fall outside a picture, or nothing varies.
    """
    height, width = left.shape
    scores = np.full(high - low + 1, -1.0)
    for k in range(high - low + 1):
        d = low + k
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
        if 4 * n < 3 * pixels.shape[0] or n < 2:
            continue
        vx, vy = sxx - sx * sx / n, syy - sy * sy / n
        if vx > 1e-6 * n and vy > 1e-6 * n:
            scores[k] = (sxy - sx * sy / n) / np.sqrt(vx * vy)
    return scores


@njit(cache=True)
def _solve(n00: float, n01: float, n02: float, n11: float, n12: float, n22: float) -> tuple[float, float, float, float]:
    """First row of the inverse of a symmetric 3 x 3 matrix, and its determinant; zeros where there is none."""
    c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
    det = n00 * c00 + n01 * c01 + n02 * c02
    if det <= 1e-9 * n00 * n11 * n22:
        return 0.0, 0.0, 0.0, 0.0
    return c00 / det, c01 / det, c02 / det, det


@njit(cache=True)
def cells(
    left: Image, right: Image, mask: NDArray[np.bool_], u0: int, v0: int, cell: int, plane: Array, dv: int, floor: float
) -> tuple[Array, float, float]:
    """Per cell of a region (u, v, disparity, sigma); then the vertical offset beyond dv that is left, and its information.

        minimise  sum (I_r(u - d_i - p (u - u_i) - q (v - v_i), v + dv) - g I_l(u, v) - o)^2   over d_i, g, o

    plane = (c, p, q, u_c, v_c): the disparity c + p (u - u_c) + q (v - v_c) to begin with. A cell's disparity belongs to the
    place where its information lies. Its sigma is that of least squares, with the noise found and its correlation
    from pixel to pixel (white noise would be correlated by the rectification's interpolation alone); floor: least noise, levels.
    """
    height, width = left.shape
    rows, columns = -(-mask.shape[0] // cell), -(-mask.shape[1] // cell)
    result = np.empty((rows * columns, 4))
    count = 0
    stride = max(1, cell * cell // _CELL_PIXELS)
    us, vs, x = np.empty(cell * cell), np.empty(cell * cell), np.empty(cell * cell)
    product, square = 0.0, 1e-12  # of neighbouring remainders, for the correlation of the noise
    vertical_right, vertical_normal = 0.0, 0.0
    for row in range(rows):
        for column in range(columns):
            n = 0
            texture = 0.0
            for v in range(row * cell, min((row + 1) * cell, mask.shape[0]), stride):
                for u in range(column * cell, min((column + 1) * cell, mask.shape[1])):
                    a, b = u0 + u, v0 + v
                    if mask[v, u] and 1 <= a < width - 1 and 1 <= b < height - 1 and 1 <= b + dv < height - 1:
                        us[n], vs[n], x[n] = a, b, left[b, a]
                        texture += (float(left[b, a + 1]) - float(left[b, a - 1])) ** 2
                        n += 1
            if n < _LEAST_PIXELS or texture < 16.0 * floor * floor * n * 0.5:
                continue
            done, d, sigma, ub, vb, pr, sq, vr, vn = _cell(right, us[:n], vs[:n], x[:n], plane, dv, floor)
            if done:
                result[count, 0], result[count, 1], result[count, 2], result[count, 3] = ub, vb, d, sigma
                count += 1
                product += pr
                square += sq
                vertical_right += vr
                vertical_normal += vn
    correlation = min(max(product / square, 0.0), 0.6)
    inflation = 1.0 + 2.0 * correlation
    if stride == 1:
        inflation *= inflation
    result[:count, 3] *= np.sqrt(inflation)
    step = vertical_right / vertical_normal if vertical_normal > 0.0 else 0.0
    return result[:count].copy(), step, vertical_normal / inflation


@njit(cache=True)
def _cell(
    right: Image, us: Array, vs: Array, x: Array, plane: Array, dv: int, floor: float
) -> tuple[bool, float, float, float, float, float, float, float, float]:
    """One cell: (whether it converged, disparity, sigma, u, v, sums for noise correlation and vertical offset)."""
    nothing = (False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    n, width = us.shape[0], right.shape[1]
    mean_x = x.mean()
    y, gradient, across = np.empty(n), np.empty(n), np.empty(n)
    shift, g, o = 0.0, 1.0, 0.0
    inverse, converged = 0.0, False
    for _ in range(_STEPS):
        n00, n01, n02, n11, r0, r1, r2 = 1e-12, 0.0, 0.0, 1e-12, 0.0, 0.0, 0.0
        for i in range(n):
            ur = us[i] - (plane[0] + shift + plane[1] * (us[i] - plane[3]) + plane[2] * (vs[i] - plane[4]))
            k = int(np.floor(ur))
            if k < 1 or k + 2 >= width:
                return nothing
            v, t = int(vs[i]) + dv, ur - k
            a, b, c, e = float(right[v, k - 1]), float(right[v, k]), float(right[v, k + 1]), float(right[v, k + 2])
            c1, c2, c3 = 0.5 * (c - a), a - 2.5 * b + 2.0 * c - 0.5 * e, 0.5 * (e - a) + 1.5 * (b - c)  # Catmull-Rom
            y[i] = b + t * (c1 + t * (c2 + t * c3))
            j = -(c1 + t * (2.0 * c2 + 3.0 * t * c3))  # d y / d disparity
            gradient[i] = j
            dx = x[i] - mean_x
            r = y[i]
            n00 += j * j
            n01 += j * dx
            n02 += j
            n11 += dx * dx
            r0 += j * r
            r1 += dx * r
            r2 += r
        # y + j delta = g dx + o: normal equations of (-delta, g, o) with columns (j, dx, 1)
        i00, i01, i02, det = _solve(n00, n01, n02, n11, 0.0, float(n))
        if det == 0.0:
            return nothing
        delta = -(i00 * r0 + i01 * r1 + i02 * r2)
        g = (r1 + delta * n01) / n11
        o = (r2 + delta * n02) / n
        inverse = i00
        shift += delta
        if abs(shift) > 1.6:
            return nothing
        if abs(delta) < 0.003:
            converged = True
            break
    if not converged or g < 0.3 or g > 3.0:
        return nothing
    total, wu, wv, squares, product = 1e-12, 0.0, 0.0, 0.0, 0.0
    n00, n01, n02, n11, m0, m1, m2, mm, mr = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    previous = 0.0
    for i in range(n):
        r = y[i] - g * (x[i] - mean_x) - o
        squares += r * r
        if i > 0 and us[i] == us[i - 1] + 1.0:
            product += r * previous
        previous = r
        w = gradient[i] * gradient[i]
        total += w
        wu += w * us[i]
        wv += w * vs[i]
        ur = us[i] - (plane[0] + shift + plane[1] * (us[i] - plane[3]) + plane[2] * (vs[i] - plane[4]))
        k, v = int(np.floor(ur + 0.5)), int(vs[i]) + dv
        across[i] = 0.5 * (float(right[v + 1, k]) - float(right[v - 1, k]))
        j, dx = gradient[i], x[i] - mean_x
        m0 += j * across[i]
        m1 += dx * across[i]
        m2 += across[i]
        mm += across[i] * across[i]
        mr += across[i] * r
        n00 += j * j
        n01 += j * dx
        n02 += j
        n11 += dx * dx
    noise = squares / max(n - 3, 1) + floor * floor
    sigma = np.sqrt(noise * inverse)
    if sigma > 1.0:
        return nothing
    ub, vb = wu / total, wv / total
    d = plane[0] + shift + plane[1] * (ub - plane[3]) + plane[2] * (vb - plane[4])
    free = mm - _explained(n00, n01, n02, n11, float(n), m0, m1, m2)
    return True, d, sigma, ub, vb, product, squares, -mr / noise, max(free, 0.0) / noise


@njit(cache=True)
def _explained(n00: float, n01: float, n02: float, n11: float, n22: float, m0: float, m1: float, m2: float) -> float:
    """m^T N^-1 m: what of the vertical gradient the disparity, gain and offset explain."""
    N = np.array([[n00, n01, n02], [n01, n11 + 1e-9, 0.0], [n02, 0.0, n22]])
    m = np.array([m0, m1, m2])
    return float((m * np.linalg.solve(N, m)).sum())
