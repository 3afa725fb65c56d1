"""Segmentation: a class number per pixel, 0 for none (thesis sections 4.1, 4.4, 5.2.2; docs/vision.md).

colours known from the map      double threshold on hue, saturation, lightness, eq. 4.68
nothing known                   seed segmentation: good peaks of the histogram, thresholds in the valleys
one channel (grey, thermal)     double threshold about the surroundings, darker or brighter
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.image.rectify import Image

Space: TypeAlias = Literal["hsv", "hsi", "lab", "yuv", "grey"]
Labels: TypeAlias = NDArray[np.uint8]

_BINS = 64  # per channel of the table, and of lightness in a histogram: steps of 4 levels
_HUES = 90  # of hue in a histogram: steps of 4 degrees
_REDUCED = 8  # times smaller than the image: where the level around is taken
_LIGHT = 128  # codes: 0..89 a hue, 128..191 a lightness


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Tolerances of a colour: light changes lightness, haze saturation, neither hue (benchmarks/results/recognition.json)."""

    hue_deg: float = 18.0
    saturation_ratio: float = 2.2  # between 1/2.2 and 2.2 times
    lightness_ratio: float = 6.0  # two stops and a half: a shadow, or a camera that exposes for something else
    grey_saturation: float = 0.22  # below it a colour counts as grey: hue means nothing
    grey_lightness_ratio: float = 1.35

    def scaled(self, by: float) -> "Tolerance":
        """All widths times `by` (logarithmic ratios), except the limit of grey."""
        return Tolerance(
            self.hue_deg * by,
            self.saturation_ratio**by,
            self.lightness_ratio**by,
            self.grey_saturation,
            self.grey_lightness_ratio**by,
        )


@dataclass(frozen=True, slots=True)
class Seeds:
    """Peaks of seed segmentation, and the least saturation of a hue."""

    peakiness: float = 0.15
    least_part: float = 0.002  # of the pixels under a peak
    grey_saturation: float = 0.22
    dark: float = 0.12  # lightness below which there is no hue


@dataclass(frozen=True, slots=True)
class Intensity:
    """Thresholds of segmentation by intensity."""

    sigmas: float = 1.5  # from the level around, in robust standard deviations of the image about it
    least: float = 6.0  # levels of 256: less is noise
    window: float = 1.0 / 3.0  # of the shorter side: what is larger is not a thing but ground


def cylinder(bgr: NDArray[np.uint8], space: Space) -> NDArray[np.uint8]:
    """(hue in steps of 2 degrees, saturation, lightness 0..255) of (N, M, 3) colours; eq. 4.9-4.11, 4.26-4.51."""
    if space == "hsv":
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), dtype=np.uint8)
    b, g, r = np.moveaxis(bgr.astype(np.float64), 2, 0)
    if space == "grey":
        light = 0.07 * b + 0.72 * g + 0.21 * r  # eq. 4.4
        return _packed(np.zeros_like(light), np.zeros_like(light), light)
    if space == "hsi":
        total = np.maximum(b + g + r, 1.0)
        hue = np.arctan2(np.sqrt(3.0) * (g - b), 2.0 * r - g - b)  # the angle of eq. 4.31-4.32, without its cases
        return _packed(hue, 255.0 * (1.0 - 3.0 * np.minimum(np.minimum(b, g), r) / total), total / 3.0)
    if space == "yuv":
        y = 0.299 * r + 0.587 * g + 0.114 * b
        x1, x2 = -0.147 * r - 0.289 * g + 0.436 * b, 0.615 * r - 0.515 * g - 0.100 * b
        return _packed(np.arctan2(x2, x1), 1.8 * np.hypot(x1, x2), y)
    lab = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2LAB)).astype(np.float64)
    x1, x2 = lab[..., 1] - 128.0, lab[..., 2] - 128.0
    return _packed(np.arctan2(x2, x1), 2.2 * np.hypot(x1, x2), lab[..., 0])


def classes(colours_bgr: Sequence[tuple[float, float, float]], space: Space = "hsv") -> list[tuple[float, float, float]]:
    """Distinct colours as classes: one within half the tolerance of an earlier one joins it."""
    kept: list[tuple[float, float, float]] = []
    for colour in colours_bgr:
        if all(_distance(_cylinder_of(colour, space), _deviations(other, space, Tolerance())) > 0.5 for other in kept):
            kept.append(colour)
    return kept


def colour_table(
    colours_bgr: Sequence[tuple[float, float, float]], space: Space = "hsv", tolerance: Tolerance | None = None
) -> Labels:
    """Double threshold around each colour (eq. 4.68): (64, 64, 64) labels by blue, green, red.

    Label k + 1 is colours_bgr[k], the nearer of overlapping ones; at most 255.
    """
    deviations = [_deviations(c, space, tolerance or Tolerance()) for c in colours_bgr]
    nearest: Labels = _nearest(_all_colours(space), np.array(deviations).reshape(-1, 3, 256))
    return nearest.reshape(_BINS, _BINS, _BINS)


def segment_colours(image: Image, table: Labels) -> Labels:
    """The class of every pixel of a BGR or grey image (uint8)."""
    return _look_up(image, table) if image.ndim == 3 else np.asarray(cv2.LUT(image, _grey_diagonal(table)), dtype=np.uint8)


def segment_seeds(image: Image, space: Space = "hsv", seeds: Seeds | None = None) -> Labels:
    """Seed segmentation (thesis section 4.5.3) by valleys of the image's histograms, uint8.

    By hue where there is one, else by lightness.
    """
    seeds = seeds or Seeds()
    codes = _look_up(image, _codes(space, seeds)) if image.ndim == 3 else _LIGHT + (image >> 2)
    histogram = np.bincount(codes[::2, ::2].ravel(), minlength=_LIGHT + _BINS).astype(np.float64)
    hues = _between(valleys(histogram[:_HUES], seeds, circular=True), _HUES, 1, circular=True)
    lights = _between(valleys(histogram[_LIGHT:], seeds), _BINS, 1 + int(hues.max()))
    label_of_code = np.zeros(256, dtype=np.uint8)
    label_of_code[:_HUES], label_of_code[_LIGHT : _LIGHT + _BINS] = hues, lights
    return np.asarray(cv2.LUT(codes, label_of_code), dtype=np.uint8)


def segment_intensity(image: NDArray[np.uint8], intensity: Intensity | None = None) -> Labels:
    """Double threshold (eq. 4.68) about the surroundings: 1 darker, 2 brighter, 0 neither.

        |f - b| > t,    b = median over a window,    t = max(sigmas 1.4826 median |f - b|, least)

    For images (H, W) of unknown polarity (thermal).
    """
    i = intensity or Intensity()
    small = cv2.resize(image, None, fx=1.0 / _REDUCED, fy=1.0 / _REDUCED, interpolation=cv2.INTER_AREA)
    around = cv2.medianBlur(small, max(3, int(i.window * min(small.shape)) | 1))
    off = image - cv2.resize(around, image.shape[::-1], interpolation=cv2.INTER_LINEAR).astype(np.int16)
    threshold = max(i.sigmas * 1.4826 * float(np.median(np.abs(off[::4, ::4]))), i.least)
    return np.asarray((off < -threshold) + 2 * (off > threshold), dtype=np.uint8)


def valleys(histogram: Array, seeds: Seeds | None = None, circular: bool = False) -> NDArray[np.int64]:
    """Valleys between good peaks of a histogram smoothed over three (thesis section 4.4.1.2).

        peakiness = (1 - (Va + Vb) / 2P) (1 - N / (P W))                                                   (eq. 4.72-4.74)

    A peak that fails is joined over its higher valley, and the test repeated.
    """
    seeds = seeds or Seeds()
    turn = int(np.argmin(histogram)) if circular else 0  # a circle is cut where there is least
    h = np.roll(histogram, -turn)
    padded = np.concatenate((h[-1:], h, h[:1])) if circular else np.pad(h, 1, mode="edge")
    smooth = (padded[:-2] + padded[1:-1] + padded[2:]) / 3.0
    found = _valleys(smooth, seeds.peakiness, seeds.least_part * max(h.sum(), 1.0))
    inner = np.append(found, 0) if circular and len(found) else found
    return np.sort((inner + turn) % len(h)) if circular else found


@njit(cache=True)
def _valleys(h: Array, peakiness: float, least: float) -> NDArray[np.int64]:
    """Indices of valleys left when all peaks are good; the ends of h are valleys of height 0."""
    n = h.shape[0]
    bounds = [0]
    for i in range(1, n - 1):  # the last of equal lowest values is the valley
        if h[i] < h[i + 1]:
            j = i
            while j > 0 and h[j] == h[j - 1]:
                j -= 1
            if j > 0 and h[j - 1] > h[i]:
                bounds.append((i + j) // 2)
    bounds.append(n)
    while len(bounds) > 2:
        worst, where = 2.0, -1
        for k in range(len(bounds) - 1):
            a, b = bounds[k], bounds[k + 1]
            part = h[a:b]
            top, total = part.max(), part.sum()
            va, vb = h[a] if a > 0 else 0.0, h[b] if b < n else 0.0
            good = 0.0
            if total >= least and top - max(va, vb) > 4.0 * np.sqrt(top):  # deeper than counting makes it by chance
                good = (1.0 - (va + vb) / (2.0 * top)) * (1.0 - total / (top * (b - a)))
            if good < worst:
                worst, where = good, k
        if worst >= peakiness:
            break
        left = h[bounds[where]] if where > 0 else -1.0
        right = h[bounds[where + 1]] if where + 1 < len(bounds) - 1 else -1.0
        bounds.pop(where if left >= right else where + 1)
    return np.array(bounds[1:-1], dtype=np.int64)


def _deviations(colour_bgr: tuple[float, float, float], space: Space, tolerance: Tolerance) -> Array:
    every = np.arange(256.0)
    h0, s0, light0 = _cylinder_of(colour_bgr, space).tolist()
    grey = tolerance.grey_saturation * 255.0
    dark = np.abs(np.log((every + 8.0) / (light0 + 8.0)))
    if s0 < grey or space == "grey":
        return np.stack((np.zeros(256), every / (1.3 * grey), dark / np.log(tolerance.grey_lightness_ratio)))
    hue = np.abs((every - h0 + 90.0) % 180.0 - 90.0) * 2.0 / tolerance.hue_deg
    pale = np.abs(np.log((every + 1.0) / (s0 + 1.0))) / np.log(tolerance.saturation_ratio)
    return np.stack((hue, pale, dark / np.log(tolerance.lightness_ratio)))


@njit(cache=True)
def _distance(coordinates: Labels, deviations: Array) -> float:
    h, s, light = coordinates
    return float(max(deviations[0, h], deviations[1, s], deviations[2, light]))


@njit(cache=True)
def _nearest(coordinates: Labels, deviations: Array) -> Labels:
    """Labels (N,) of colours (N, 3): 1 + the nearest with deviations (K, 3, 256), 0 outside all."""
    labels = np.zeros(len(coordinates), np.uint8)
    for i in range(len(coordinates)):
        least = 1.0
        for k in range(len(deviations)):
            distance = _distance(coordinates[i], deviations[k])
            if distance < least:
                least, labels[i] = distance, k + 1
    return labels


def _packed(hue_rad: Array, saturation: Array, lightness: Array) -> NDArray[np.uint8]:
    hue = np.rint(np.degrees(hue_rad) % 360.0 / 2.0) % 180
    return np.stack((hue, np.clip(np.rint(saturation), 0, 255), np.clip(np.rint(lightness), 0, 255)), axis=-1).astype(np.uint8)


def _cylinder_of(colour: tuple[float, float, float], space: Space) -> Labels:
    bgr = np.clip(np.rint(np.array(colour)), 0, 255).astype(np.uint8)
    return np.asarray(cylinder(bgr[None, None], space)[0, 0])


@lru_cache(maxsize=8)
def _all_colours(space: Space) -> Labels:
    levels = (np.arange(_BINS) * (256 // _BINS) + 2).astype(np.uint8)
    bgr = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    return cylinder(bgr.reshape(_BINS * _BINS, _BINS, 3), space).reshape(-1, 3)


@lru_cache(maxsize=8)
def _codes(space: Space, seeds: Seeds) -> Labels:
    h, s, light = np.moveaxis(_all_colours(space), 1, 0)
    has_hue = (s >= seeds.grey_saturation * 255.0) & (light >= seeds.dark * 255.0) & (space != "grey")
    codes: Labels = np.where(has_hue, h // 2, _LIGHT + light // 4).astype(np.uint8)
    return codes.reshape(_BINS, _BINS, _BINS)


def _between(thresholds: NDArray[np.int64], levels: int, first: int, circular: bool = False) -> Labels:
    """Label per level: first + thresholds at or below it; on a circle the last class is the first."""
    count = np.searchsorted(thresholds, np.arange(levels), side="right")
    if circular and len(thresholds):
        count %= len(thresholds)
    return (first + count).astype(np.uint8)


def _grey_diagonal(table: Labels) -> Labels:
    cell = np.arange(256) * _BINS // 256
    return table[cell, cell, cell]


@njit(cache=True)
def _look_up(image: NDArray[np.uint8], table: Labels) -> Labels:
    height, width = image.shape[0], image.shape[1]
    labels = np.empty((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            labels[v, u] = table[image[v, u, 0] >> 2, image[v, u, 1] >> 2, image[v, u, 2] >> 2]
    return labels
