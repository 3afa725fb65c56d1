"""Light at each pixel, nearest face first.

    image = sum_i T_i a_i c_i + T_ground c_ground,     T_i+1 = T_i (1 - a_i)

a: share of the pixel covered. Shares of one solid's faces add up, to 1 at most.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.synthetic.coverage import Grid, add_polygon, bounds, integrate
from vision.synthetic.faces import CONTRAST, FLAT, RANGE, RIDGE, SHIFT_S, SHIFT_T, Indices
from vision.synthetic.texture import SURFACE_SIZE, SURFACE_TEXEL_M, Scalar, bilinear, bilinear_bgr, level_of

Labels = NDArray[np.int32]

NOTHING = -1  # label of the ground
_RUN = 16  # px over which haze and level of detail are taken as linear
_RIDGE_M = np.float32(0.1)  # from the ridge to where its half has its full shade
_HORIZON = 1e-3  # sine of the flattest ray that still meets a plane
_OPAQUE = 1e-3  # light that still comes through


@njit(cache=True)
def paint_solids(
    image: Grid, through: Grid, labels: Labels, shadow: Grid, shadow_light: float, rays: Grid, vertices_px: Array,
    offsets: Indices, solids: Indices, solid_offsets: Indices, H: Array, colour: Array, texture: Indices, parameters: Array,
    surfaces: Grid, focal: float, haze: Array,
) -> None:  # fmt: skip
    """Add the solids' light to `image` (h, w, 3); `through` (h, w): light left from behind.

    shadow: share of ground in shadow, of light shadow_light; haze: extinction per m, colour.
    """
    height, width = through.shape
    differences = np.zeros((height, width + 2), dtype=np.float32)
    covered, taken = np.zeros((height, width), dtype=np.float32), np.zeros((height, width), dtype=np.float32)
    for s in range(len(solids)):
        low_r, high_r, low_c, high_c = height, 0, width, 0
        for f in range(solid_offsets[s], solid_offsets[s + 1]):
            polygon = vertices_px[offsets[f] : offsets[f + 1]]
            box = bounds(polygon, width, height)
            if box[0] >= box[1]:
                continue
            add_polygon(polygon, differences)
            integrate(differences, box, covered)
            low_r, high_r, low_c, high_c = min(low_r, box[0]), max(high_r, box[1]), min(low_c, box[2]), max(high_c, box[3])
            _paint(
                image, through, taken, covered, box, shadow, shadow_light, rays, H[f], colour[f], parameters[f],
                surfaces[texture[f]], focal, haze,
            )  # fmt: skip
        for r in range(low_r, high_r):
            for c in range(low_c, high_c):
                if taken[r, c] > 0.0:
                    if taken[r, c] > 0.5 and through[r, c] > 0.5:
                        labels[r, c] = solids[s]
                    through[r, c] *= np.float32(1.0) - taken[r, c]
                    taken[r, c] = 0.0


@njit(cache=True, fastmath=True)
def _paint(
    image: Grid, through: Grid, taken: Grid, covered: Grid, box: tuple[int, int, int, int], shadow: Grid, shadow_light: float,
    rays: Grid, H: Array, colour: Array, parameters: Array, surface: Grid, focal: float, haze: Array,
) -> None:  # fmt: skip
    (r0, r1, c0, c1), to_plane = box, H.astype(np.float32)
    contrast, ridge = np.float32(parameters[CONTRAST]), np.float32(parameters[RIDGE] / _RIDGE_M)
    dim = np.float32((1.0 - shadow_light) * parameters[FLAT])
    shift_s, shift_t = np.float32(parameters[SHIFT_S]), np.float32(parameters[SHIFT_T])
    for r in range(r0, r1):
        for c in range(c0, c1, _RUN):
            end = min(c + _RUN, c1)
            x, y = rays[r, c, 0], rays[r, c, 1]
            start, size, coarser = level_of(SURFACE_SIZE, _lod(H, x, y, focal, SURFACE_TEXEL_M))
            scale = np.float32(size / (SURFACE_SIZE * SURFACE_TEXEL_M))
            clear = _clear(H, x, y, parameters[RANGE], haze[0])
            for k in range(c, end):
                share = min(covered[r, k], np.float32(1.0) - taken[r, k])
                taken[r, k] += share
                share *= through[r, k]
                if share < _OPAQUE:
                    continue
                s, t = _place(to_plane, rays[r, k, 0], rays[r, k, 1])
                a, b = (s + shift_s) * scale, (t + shift_t) * scale
                value = bilinear(surface, start, size, a, b)
                if coarser > 0.0:
                    coarse = bilinear(surface, start + size * size, size >> np.int32(1), np.float32(0.5) * a, np.float32(0.5) * b)
                    value += coarser * (coarse - value)
                shade = np.float32(1.0) + contrast * value
                shade *= np.float32(1.0) + ridge * min(max(t, -_RIDGE_M), _RIDGE_M)
                shade *= (np.float32(1.0) - dim * shadow[r, k]) * clear * share
                veil = share * (np.float32(1.0) - clear)
                for i in range(3):
                    image[r, k, i] += shade * colour[i] + veil * haze[1 + i]


@njit(cache=True, fastmath=True)
def paint_ground(
    image: Grid, through: Grid, shadow: Grid, shadow_light: float, rays: Grid, H: Array, reach: float, cover: Grid,
    cover_size: int, cover_texel: float, detail: Grid, detail_size: int, detail_texel: float, tint: Array, contrast: float,
    focal: float, haze: Array,
) -> None:  # fmt: skip
    """Add the ground's or sky's light where `through` passes; H: rays to ground axes [m]."""
    (height, width), to_plane = through.shape, H.astype(np.float32)
    dim, strength, half, one = np.float32(1.0 - shadow_light), np.float32(contrast), np.float32(0.5), np.float32(1.0)
    tint_b, tint_g, tint_r = np.float32(tint[0]), np.float32(tint[1]), np.float32(tint[2])
    haze_b, haze_g, haze_r = np.float32(haze[1]), np.float32(haze[2]), np.float32(haze[3])
    for r in range(height):
        for c in range(0, width, _RUN):
            end = min(c + _RUN, width)
            x, y = rays[r, c, 0], rays[r, c, 1]
            if _slope(H, x, y) < _HORIZON or _slope(H, rays[r, end - 1, 0], rays[r, end - 1, 1]) < _HORIZON:
                for k in range(c, end):
                    for i in range(3):
                        image[r, k, i] += through[r, k] * haze[1 + i]
                continue
            clear = _clear(H, x, y, reach, haze[0])
            d_start, d_size, d_coarser = level_of(detail_size, _lod(H, x, y, focal, detail_texel))
            c_start, c_size, c_coarser = level_of(cover_size, _lod(H, x, y, focal, cover_texel))
            d_scale, c_scale = np.float32(d_size / (detail_size * detail_texel)), np.float32(c_size / (cover_size * cover_texel))
            d_next, c_next = d_start + d_size * d_size, c_start + c_size * c_size
            for k in range(c, end):
                light = through[r, k]
                if light < _OPAQUE:
                    continue
                s, t = _place(to_plane, rays[r, k, 0], rays[r, k, 1])
                value = bilinear(detail, d_start, d_size, s * d_scale, t * d_scale)
                if d_coarser > 0.0:
                    coarse = bilinear(detail, d_next, d_size >> np.int32(1), half * s * d_scale, half * t * d_scale)
                    value += d_coarser * (coarse - value)
                paint_b, paint_g, paint_r = bilinear_bgr(cover, c_start, c_size, s * c_scale, t * c_scale)
                if c_coarser > 0.0:
                    b, g, red = bilinear_bgr(cover, c_next, c_size >> np.int32(1), half * s * c_scale, half * t * c_scale)
                    paint_b, paint_g = paint_b + c_coarser * (b - paint_b), paint_g + c_coarser * (g - paint_g)
                    paint_r += c_coarser * (red - paint_r)
                shade = (one + strength * value) * (one - dim * shadow[r, k]) * light * clear
                veil = light * (one - clear)
                image[r, k, 0] += shade * tint_b * paint_b + veil * haze_b
                image[r, k, 1] += shade * tint_g * paint_g + veil * haze_g
                image[r, k, 2] += shade * tint_r * paint_r + veil * haze_r


@njit(cache=True, fastmath=True, inline="always")
def _place(H: Grid, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar]:
    w = np.float32(1.0) / (H[2, 0] * x + H[2, 1] * y + H[2, 2])
    return (H[0, 0] * x + H[0, 1] * y + H[0, 2]) * w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) * w


@njit(cache=True, inline="always")
def _slope(H: Array, x: Scalar, y: Scalar) -> Scalar:
    return (H[2, 0] * x + H[2, 1] * y + H[2, 2]) / math.sqrt(1.0 + x * x + y * y)


@njit(cache=True, inline="always")
def _clear(H: Array, x: Scalar, y: Scalar, reach: float, extinction: float) -> Scalar:
    """Share of light that haze lets through between plane and camera (Koschmieder 1924)."""
    return np.float32(math.exp(-extinction * reach / max(_slope(H, x, y), _HORIZON)))


@njit(cache=True, inline="always")
def _lod(H: Array, x: Scalar, y: Scalar, focal: float, texel_m: float) -> float:
    """log2 of texels per pixel: RMS of the derivatives of (s, t)."""
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    s, t = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
    a, b = (H[0, 0] - s * H[2, 0]) / w, (H[0, 1] - s * H[2, 1]) / w
    c, d = (H[1, 0] - t * H[2, 0]) / w, (H[1, 1] - t * H[2, 1]) / w
    return math.log2(max(math.sqrt(0.5 * (a * a + b * b + c * c + d * d)) / (focal * texel_m), 1e-9))
