"""Periodic textures with mip pyramids and trilinear lookup.

    value(s, t) = (1 - f) bilinear(level l; s, t) + f bilinear(level l + 1; s, t),   l + f = log2(texels per pixel)

(Williams 1983.) Made once a process from fixed seeds; worlds differ by placement.
"""

import math
from functools import cache
from typing import Any, Final, TypeAlias

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from models.messages import Array

Grid: TypeAlias = NDArray[np.float32]
Scalar: TypeAlias = Any  # a float32 or int32: the lookup computes in what it is given
Taps: TypeAlias = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]

SURFACES: Final = ("paint", "shingles", "gravel", "metal", "wall", "leaves")  # the textures of roofs and sides
SURFACE_SIZE: Final = 512  # texels
SURFACE_TEXEL_M: Final = 0.02

_FINE_ENOUGH = 0.03  # share of the next level that is not worth its lookup


def pyramid(image: Grid) -> Grid:
    """All levels of a square image of 2^k texels (n, n[, channels]): (sum of n^2[, channels])."""
    n = image.shape[0]
    if image.shape[1] != n or n & (n - 1):
        raise ValueError(f"a texture must be square, with a power of two of texels a side: {image.shape}")
    level = image.astype(np.float32)
    levels = [level.reshape(n * n, *level.shape[2:])]
    while level.shape[0] > 1:
        level = np.float32(0.25) * (level[0::2, 0::2] + level[1::2, 0::2] + level[0::2, 1::2] + level[1::2, 1::2])
        levels.append(level.reshape(-1, *level.shape[2:]))
    return np.concatenate(levels)


def texels_a_side(levels: Grid) -> int:
    """n of the finest level, from n^2 + n^2 / 4 + ... + 1 = (4 n^2 - 1) / 3."""
    return math.isqrt(3 * len(levels) // 4 + 1)


@njit(cache=True, fastmath=True, inline="always")
def level_of(size: int, lod: float) -> tuple[Scalar, Scalar, Scalar]:
    """Start and size of the level below `lod`, and share of the next (small: 0)."""
    start = 0
    while lod >= 1.0 and size > 2:
        start += size * size
        size >>= 1
        lod -= 1.0
    share = 0.0 if lod < _FINE_ENOUGH else min(lod, 1.0)
    return np.int32(start), np.int32(size), np.float32(share)


@njit(cache=True, fastmath=True, inline="always")
def _taps(start: Scalar, size: Scalar, s: Scalar, t: Scalar) -> Taps:
    """Four texels around (s, t) (texel i centred at i + 1/2), and fractions."""
    s, t = s - np.float32(0.5), t - np.float32(0.5)
    fs, ft = np.floor(s), np.floor(t)
    mask, si, ti = np.int32(size - 1), np.int32(fs), np.int32(ft)
    # Unsigned, so that the compiled lookup need not ask whether an index counts from the end.
    s0, s1 = np.uint32(si & mask), np.uint32((si + np.int32(1)) & mask)
    row0, row1 = np.uint32(start + (ti & mask) * size), np.uint32(start + ((ti + np.int32(1)) & mask) * size)
    return row0 + s0, row0 + s1, row1 + s0, row1 + s1, s - fs, t - ft


@njit(cache=True, fastmath=True, inline="always")
def bilinear(data: Grid, start: Scalar, size: Scalar, s: Scalar, t: Scalar) -> Scalar:
    """A texture of one channel."""
    i, j, k, m, a, b = _taps(start, size, s, t)
    top, low = data[i] + a * (data[j] - data[i]), data[k] + a * (data[m] - data[k])
    return top + b * (low - top)


@njit(cache=True, fastmath=True, inline="always")
def bilinear_bgr(data: Grid, start: Scalar, size: Scalar, s: Scalar, t: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """A texture of three channels."""
    i, j, k, m, a, b = _taps(start, size, s, t)
    wm, wj, wk = a * b, a - a * b, b - a * b
    wi = np.float32(1.0) - a - wk
    return (
        data[i, 0] * wi + data[j, 0] * wj + data[k, 0] * wk + data[m, 0] * wm,
        data[i, 1] * wi + data[j, 1] * wj + data[k, 1] * wk + data[m, 1] * wm,
        data[i, 2] * wi + data[j, 2] * wj + data[k, 2] * wk + data[m, 2] * wm,
    )


def noise(size: int, slope: float, rng: np.random.Generator, finest: float = 2.0, coarsest: float = np.inf) -> Grid:
    """Periodic Gaussian noise of spectrum f^-slope between two wavelengths [texels]; mean 0, variance 1."""
    f = np.hypot(fft.fftfreq(size)[:, None], fft.rfftfreq(size)[None, :])
    f[0, 0] = 1.0
    gain = np.where((f * finest <= 1.0) & (f * coarsest >= 1.0), f**-slope, 0.0).astype(np.float32)
    gain[0, 0] = 0.0
    field = fft.irfft2(fft.rfft2(rng.standard_normal((size, size), dtype=np.float32)) * gain, s=(size, size), overwrite_x=True)
    return np.asarray(field / field.std(), dtype=np.float32)


@cache
def surfaces() -> Grid:
    """The pyramids of SURFACES (len, texels): contrast, 0 +- about 1."""
    rng = np.random.default_rng(20140)
    made = {
        "paint": 0.5 * noise(SURFACE_SIZE, 1.2, rng) + 0.25 * noise(SURFACE_SIZE, 0.0, rng),
        "shingles": _shingles(rng),
        "gravel": _gravel(rng),
        "metal": _metal(rng),
        "wall": _wall(rng),
        "leaves": 0.9 * noise(SURFACE_SIZE, 0.8, rng, finest=6.0, coarsest=90.0),
    }
    return np.stack([pyramid(bounded(made[name])) for name in SURFACES])


def bounded(field: Grid | Array) -> Grid:
    """A contrast without outliers."""
    return np.clip(field, -2.6, 2.6).astype(np.float32)


def _shingles(rng: np.random.Generator) -> Array:
    n, width, height = SURFACE_SIZE, 16, 16
    row, column = np.mgrid[:n, :n]
    course = row // height
    tile = (column + (course % 2) * (width // 2)) // width % (n // width)
    shade = rng.normal(0.0, 0.55, (n // height, n // width))[course, tile]
    shade -= 1.1 * (row % height < 2) + 0.5 * ((column + (course % 2) * (width // 2)) % width < 1)
    return np.asarray(shade + 0.35 * noise(n, 0.3, rng) + 0.4 * noise(n, 1.5, rng))


def _gravel(rng: np.random.Generator) -> Array:
    n = SURFACE_SIZE
    row = np.arange(n)[:, None] % 128
    return np.asarray(0.7 * noise(n, 0.2, rng) + 0.7 * noise(n, 1.6, rng, finest=16.0) - 0.8 * (row < 3))


def _metal(rng: np.random.Generator) -> Array:
    n = SURFACE_SIZE
    rib = np.cos(2 * np.pi * np.arange(n) / 16)[None, :] ** 3
    streaks = cv2.blur(np.tile(noise(n, 0.5, rng), (3, 1)), (1, 129))[n : 2 * n]
    return np.asarray(0.5 * rib + 0.5 * streaks / streaks.std() + 0.2 * noise(n, 0.0, rng))


def _wall(rng: np.random.Generator) -> Array:
    n = SURFACE_SIZE
    row, column = np.mgrid[:n, :n]
    window = (row % 128 > 40) & (row % 128 < 105) & (column % 128 > 36) & (column % 128 < 92)
    return np.asarray(0.3 * noise(n, 1.0, rng) - 1.6 * window)
