"""Light to grey values: blur, vignetting, exposure, cast, noise, rounding.

    value = exposure * cast * vignette(r) * (psf (*) motion (*) light),     sigma^2 = read^2 + shot * value

Linear sensor (no gamma).
"""

import math
from dataclasses import dataclass
from functools import cache, lru_cache

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.synthetic.coverage import Grid

Image = NDArray[np.uint8]

_BANK = 1 << 20  # normal numbers that all images draw from, each row beginning elsewhere


@dataclass(frozen=True)
class Conditions:
    """Conditions of an image.

    exposure: factor; cast_bgr: channel factors; vignetting: loss in the corners; haze_per_m: extinction (0.001: 4 km visual
    range); psf_sigma_px; blur_px: image motion (u, v) during exposure, centred; read_sigma: dark noise; shot: variance per grey
    value.
    """

    exposure: float = 1.0
    cast_bgr: tuple[float, float, float] = (1.0, 1.0, 1.0)
    vignetting: float = 0.12
    haze_per_m: float = 0.0
    haze_bgr: tuple[float, float, float] = (205.0, 198.0, 190.0)
    psf_sigma_px: float = 0.45
    blur_px: tuple[float, float] = (0.0, 0.0)
    read_sigma: float = 1.2
    shot: float = 0.02


IDEAL = Conditions(vignetting=0.0, psf_sigma_px=0.0, read_sigma=0.0, shot=0.0)  # light as it comes, rounded


def blur_of_motion(focal_px: float, velocity_c: Array, rate_c: Array, depth_m: float, exposure_s: float) -> tuple[float, float]:
    """blur_px = -f exposure (v_xy / depth + (w_y, -w_x)) at the middle, ground at depth_m.

    velocity_c [m/s], rate_c [rad/s]: camera axes.
    """
    du = -(velocity_c[0] / depth_m + rate_c[1])
    dv = -(velocity_c[1] / depth_m - rate_c[0])
    return focal_px * exposure_s * float(du), focal_px * exposure_s * float(dv)


def expose(light: Grid, conditions: Conditions, vignette: Grid, rng: np.random.Generator) -> Image:
    """Image (h, w, 3) of light (h, w, 3); vignette (h, w): squared radius, 1 in the corners."""
    c = conditions
    if c.psf_sigma_px > 0.0:
        lens = _gauss(c.psf_sigma_px)
        light = np.asarray(cv2.sepFilter2D(light, -1, lens, lens, borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
    if math.hypot(*c.blur_px) > 0.05:
        light = np.asarray(cv2.filter2D(light, -1, _line(*c.blur_px), borderType=cv2.BORDER_REPLICATE), dtype=np.float32)
    gain = (c.exposure * np.array(c.cast_bgr)).astype(np.float32)
    starts = np.asarray(rng.integers(0, _BANK, size=light.shape[0], dtype=np.int64))
    image = np.empty(light.shape, dtype=np.uint8)
    _read_out(light, gain, vignette, np.array([c.vignetting, c.read_sigma**2, c.shot], dtype=np.float32), _bank(), starts, image)
    return image


@njit(cache=True)
def _read_out(
    light: Grid, gain: Grid, vignette: Grid, numbers: Grid, bank: Grid, starts: NDArray[np.int64], image: Image
) -> None:
    height, width, _ = light.shape
    vignetting, dark, shot = numbers
    zero, most = np.float32(0.0), np.float32(255.0)
    for r in range(height):
        normal = bank[starts[r] : starts[r] + 3 * width]
        for c in range(width):
            fall = np.float32(1.0) - vignetting * vignette[r, c]
            for b in range(3):
                value = light[r, c, b] * gain[b] * fall
                value += math.sqrt(dark + shot * value) * normal[3 * c + b] + np.float32(0.5)
                image[r, c, b] = np.uint8(min(max(value, zero), most))


@cache
def _bank() -> Grid:
    numbers = np.random.default_rng(20143).standard_normal(_BANK, dtype=np.float32)
    return np.concatenate([numbers, numbers[: 1 << 15]])


@lru_cache(maxsize=64)
def _gauss(sigma: float) -> Grid:
    half = math.ceil(3.0 * sigma - 0.5)
    edges = (np.arange(-half, half + 2) - 0.5) / (sigma * math.sqrt(2.0))
    weights = np.diff([math.erf(x) for x in edges])
    return np.asarray(weights / weights.sum(), dtype=np.float32)


@lru_cache(maxsize=64)
def _line(du: float, dv: float) -> Grid:
    half = math.ceil(0.5 * max(abs(du), abs(dv)))
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    n = 8 * (2 * half + 1)
    for k in range(n):
        u, v = du * ((k + 0.5) / n - 0.5) + half, dv * ((k + 0.5) / n - 0.5) + half
        i, j = min(int(v), 2 * half - 1), min(int(u), 2 * half - 1)
        a, b = v - i, u - j
        kernel[i : i + 2, j : j + 2] += [[(1 - a) * (1 - b), (1 - a) * b], [a * (1 - b), a * b]]
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)
