"""From faces and ground to light: what reaches each pixel, nearest first.

    image = sum_i T_i a_i c_i + T_ground c_ground,     T_i+1 = T_i (1 - a_i)

a is the share of the pixel's square that a solid covers. Faces of one solid do not overlap where both are seen, so within a
solid shares add up, to 1 at most: no ground shines through where a roof meets a wall.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.synthetic.coverage import Grid, add_polygon, bounds, integrate
from vision.synthetic.faces import CONTRAST, FLAT, RANGE, RIDGE, SHIFT_S, SHIFT_T, Indices
from vision.synthetic.texture import SURFACE_SIZE, SURFACE_TEXEL_M, Bytes, bilinear, level_of

Labels = NDArray[np.int32]

NOTHING = -1  # label of the ground
_UNIT = 1.0 / 48.0  # of a texture's bytes
_RUN = 16  # px over which haze and level of detail are taken as linear
_RIDGE_M = 0.1  # from the ridge to where its half has its full shade
_OPAQUE = 1e-3  # light that still comes through


@njit(cache=True)
def paint_solids(
    image: Grid, through: Grid, labels: Labels, shadow: Grid, shadow_light: float, rays: Grid, vertices_px: Array,
    offsets: Indices, solids: Indices, solid_offsets: Indices, H: Array, colour: Array, texture: Indices, parameters: Array,
    surfaces: Bytes, focal: float, haze: Array,
) -> None:  # fmt: skip
    """Adds the solids' light to `image` (h, w, 3); `through` (h, w) is what they leave of the light from behind them.

    shadow: share of each pixel's ground in shadow, where light is shadow_light; haze: extinction per m and its colour.
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


@njit(cache=True)
def _paint(
    image: Grid, through: Grid, taken: Grid, covered: Grid, box: tuple[int, int, int, int], shadow: Grid, shadow_light: float,
    rays: Grid, H: Array, colour: Array, parameters: Array, surface: Bytes, focal: float, haze: Array,
) -> None:  # fmt: skip
    """One face: its share of each pixel, its texture there, dimmed by haze and, lying flat, by shadows."""
    r0, r1, c0, c1 = box
    contrast, ridge = parameters[CONTRAST] * _UNIT, parameters[RIDGE] / _RIDGE_M
    flat, shift_s, shift_t = parameters[FLAT] > 0.0, parameters[SHIFT_S], parameters[SHIFT_T]
    texel = 1.0 / SURFACE_TEXEL_M
    for r in range(r0, r1):
        c = c0
        while c < c1:
            end = min(c + _RUN, c1)
            x, y = rays[r, c, 0], rays[r, c, 1]
            start, size, finer = level_of(SURFACE_SIZE, _lod(H, x, y, focal, texel))
            scale = texel * size / SURFACE_SIZE
            w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
            clear = math.exp(-haze[0] * parameters[RANGE] / w * math.sqrt(1.0 + x * x + y * y)) if w > 0.0 else 0.0
            for k in range(c, end):
                share = min(covered[r, k], np.float32(1.0) - taken[r, k])
                if share <= 0.0:
                    continue
                taken[r, k] += share
                share *= through[r, k]
                if share < _OPAQUE:
                    continue
                x, y = rays[r, k, 0], rays[r, k, 1]
                w = 1.0 / (H[2, 0] * x + H[2, 1] * y + H[2, 2])
                s, t = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) * w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) * w
                a, b = (s + shift_s) * scale, (t + shift_t) * scale
                value = bilinear(surface, start, size, 0, a, b)
                value += finer * (bilinear(surface, start + size * size, size >> 1, 0, 0.5 * a, 0.5 * b) - value)
                shade = 1.0 + contrast * (value - 128.0)
                shade *= 1.0 + ridge * max(-_RIDGE_M, min(_RIDGE_M, t))
                if flat:
                    shade *= 1.0 - (1.0 - shadow_light) * shadow[r, k]
                shade *= clear * share
                for i in range(3):
                    image[r, k, i] += shade * colour[i] + share * (1.0 - clear) * haze[1 + i]
            c = end


@njit(cache=True)
def paint_ground(
    image: Grid, through: Grid, shadow: Grid, shadow_light: float, rays: Grid, H: Array, reach: float, cover: Bytes,
    cover_size: int, cover_texel: float, detail: Bytes, detail_size: int, detail_texel: float, tint: Array, contrast: float,
    focal: float, haze: Array,
) -> None:  # fmt: skip
    """Adds the ground's light, or the sky's, where `through` lets it pass. H maps rays to the ground's own axes [m]."""
    height, width = through.shape
    for r in range(height):
        for c in range(0, width, _RUN):
            end = min(c + _RUN, width)
            x, y = rays[r, c, 0], rays[r, c, 1]
            w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
            if not w > 1e-3 * reach / 1000.0:  # the horizon, or beyond it
                for k in range(c, end):
                    for b in range(3):
                        image[r, k, b] += through[r, k] * haze[1 + b]
                continue
            clear = np.float32(math.exp(-haze[0] * reach / w * math.sqrt(1.0 + x * x + y * y)))
            lod = _lod(H, x, y, focal, 1.0)
            d_start, d_size, d_finer = level_of(detail_size, lod - math.log2(detail_texel))
            c_start, c_size, c_finer = level_of(cover_size, lod - math.log2(cover_texel))
            d_scale, c_scale = d_size / (detail_size * detail_texel), c_size / (cover_size * cover_texel)
            d_next, c_next = d_start + d_size * d_size, c_start + c_size * c_size
            for k in range(c, end):
                if through[r, k] < _OPAQUE:
                    continue
                x, y = rays[r, k, 0], rays[r, k, 1]
                w = 1.0 / (H[2, 0] * x + H[2, 1] * y + H[2, 2])
                s, t = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) * w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) * w
                value = bilinear(detail, d_start, d_size, 0, s * d_scale, t * d_scale)
                coarse = bilinear(detail, d_next, d_size >> 1, 0, 0.5 * s * d_scale, 0.5 * t * d_scale)
                value += d_finer * (coarse - value)
                shade = (1.0 + contrast * _UNIT * (value - 128.0)) * (1.0 - (1.0 - shadow_light) * shadow[r, k])
                shade *= through[r, k] * clear
                veil = through[r, k] * (np.float32(1.0) - clear)
                for b in range(3):
                    paint = bilinear(cover, c_start, c_size, b, s * c_scale, t * c_scale)
                    paint += c_finer * (bilinear(cover, c_next, c_size >> 1, b, 0.5 * s * c_scale, 0.5 * t * c_scale) - paint)
                    image[r, k, b] += shade * tint[b] * paint + veil * haze[1 + b]


@njit(cache=True, inline="always")
def _lod(H: Array, x: float, y: float, focal: float, texels_per_m: float) -> float:
    """log2 of texels per pixel: root mean square of the four derivatives of (s, t) by pixels."""
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    s, t = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w, (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
    a, b = (H[0, 0] - s * H[2, 0]) / w, (H[0, 1] - s * H[2, 1]) / w
    c, d = (H[1, 0] - t * H[2, 0]) / w, (H[1, 1] - t * H[2, 1]) / w
    return math.log2(max(math.sqrt(0.5 * (a * a + b * b + c * c + d * d)) / focal * texels_per_m, 1e-9))
