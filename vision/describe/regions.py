"""Labels to regions: connected components with sub-pixel outlines.

Outline points move to the steepest change across the edge, within a pixel or two (thesis sections 4.3, 5.3).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order
from models.messages import Array
from vision.describe.components import components
from vision.describe.polygon import fit_polygon
from vision.describe.refine import tighten
from vision.describe.segment import Labels
from vision.image.rectify import Image, Mask

_REACH = 3.0  # px from the pixels' border within which the edge is sought
_STEP = 0.5  # px along the normal
_LEAST_CONTRAST = 4.0  # levels: less is no edge, the pixels' border stays
_POINTS = 400  # of a contour at most; a longer one is thinned out


@dataclass(frozen=True, slots=True)
class Region:
    """One connected region of the left image; pixel centres at integer (u, v).

    contour         (N, 2) closed outline, sub-pixel, anticlockwise in the image, open
    corners         (K, 2) of the fitted polygon, same sense; None: not a polygon
    area_px         inside the contour, px^2
    bbox            (u0, v0, width, height) of the mask, px
    mask            (height, width) bool
    touches_border  cut off: sizes are lower bounds
    colour_bgr      mean colour inside, 0..255
    edge_sigma_px   of the contour's points across the edge, px
    label           colour class of the segmentation
    """

    contour: Array
    corners: Array | None
    area_px: float
    bbox: tuple[int, int, int, int]
    mask: NDArray[np.bool_]
    touches_border: bool
    colour_bgr: tuple[float, float, float]
    edge_sigma_px: float
    label: int

    @property
    def outline(self) -> Array:
        """Corners, else the contour, (K, 2)."""
        return self.contour if self.corners is None else self.corners


@dataclass(frozen=True, slots=True)
class Limits:
    """Which components become regions: the `most` largest within these shares of the image."""

    least_px: int = 60
    least_side_px: int = 6  # of the bounding box
    largest_part: float = 0.4
    most: int = 40
    clean_window: int = 5  # of the median over the labels, 0 for none


def find_regions(image: Image, labels: Labels, limits: Limits | None = None, valid: Mask | None = None) -> list[Region]:
    """Regions of a labelled image, largest first.

    image (H, W) or (H, W, 3) uint8; labels (H, W), 0 = nothing; valid: 0 where a rectified image is empty, which cuts regions
    off.
    """
    limits = limits or Limits()
    if limits.clean_window:
        labels = np.asarray(cv2.medianBlur(labels, limits.clean_window), dtype=np.uint8)
    if valid is not None:
        labels = np.where(valid > 0, labels, 0).astype(np.uint8)
    table, runs, run_component = components(labels, limits.least_px, int(limits.largest_part * labels.size))
    regions = []
    for number in np.argsort(-table[:, 5])[: limits.most]:
        label, u0, v0, width, height, _ = (int(x) for x in table[number])
        if min(width, height) < limits.least_side_px:
            continue
        mask = _fill(runs, run_component, number, u0, v0, width, height)
        mask, bbox = tighten(image, mask, (u0, v0, width, height))
        region = _region(image, mask, bbox, _cut_off(bbox, labels.shape, valid), label)
        if region is not None:
            regions.append(region)
    return regions


def _cut_off(bbox: tuple[int, int, int, int], shape: tuple[int, ...], valid: Mask | None) -> bool:
    u0, v0, width, height = bbox
    if u0 <= 1 or v0 <= 1 or u0 + width >= shape[1] - 1 or v0 + height >= shape[0] - 1:
        return True
    return valid is not None and not valid[v0 - 1 : v0 + height + 1, u0 - 1 : u0 + width + 1].all()


def _region(image: Image, mask: NDArray[np.uint8], bbox: tuple[int, int, int, int], cut: bool, label: int) -> Region | None:
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=bbox[:2])
    pixels = max(outlines, key=len).reshape(-1, 2)
    if len(pixels) < 8:
        return None
    pixels = pixels[:: -(-len(pixels) // _POINTS)]
    u0, v0, width, height = bbox
    patch = image[v0 : v0 + height, u0 : u0 + width]
    colour = cv2.mean(patch, mask)[: 1 if image.ndim == 2 else 3]
    contour, sigma = sharpen(image, np.asarray(pixels, dtype=np.float64))
    area = _area(contour)
    if area <= 0.0:
        return None
    b, g, r = colour * 3 if len(colour) == 1 else colour
    corners = fit_polygon(contour)
    return Region(contour, corners, area, bbox, mask.astype(np.bool_), cut, (b, g, r), sigma, label)


def sharpen(image: Image, outline: Array) -> tuple[Array, float]:
    """Points of an outline (N, 2) moved along its normal to the steepest change of colour; sigma [px].

    outline: centres of the outermost pixels, anticlockwise in the image. The change is along the colour difference of inside and
    outside; sigma: scatter about the neighbours' line.
    """
    moved, found = _sharpen(image if image.ndim == 3 else image[..., None], outline, _normals(outline))
    return moved, _scatter(moved) if found >= 8 else 0.5


@njit(cache=True)
def _normals(outline: Array) -> Array:
    """Outward unit normals (N, 2) of a closed outline, anticlockwise in the image (v down)."""
    n = outline.shape[0]
    normals = np.empty_like(outline)
    for i in range(n):
        du, dv = 0.0, 0.0
        for k in range(1, 4):  # over three neighbours each way
            after, before = outline[(i + k) % n], outline[(i - k) % n]
            du += after[0] - before[0]
            dv += after[1] - before[1]
        length = max(np.hypot(du, dv), 1e-9)
        normals[i, 0], normals[i, 1] = -dv / length, du / length
    return normals


@njit(cache=True)
def _scatter(outline: Array) -> float:
    """Standard deviation [px] across an outline: each point against its second neighbours' chord."""
    n = outline.shape[0]
    normals = _normals(outline)
    across = np.empty(n)
    for i in range(n):
        after, before = outline[(i + 2) % n], outline[(i - 2) % n]
        du, dv = outline[i, 0] - 0.5 * (after[0] + before[0]), outline[i, 1] - 0.5 * (after[1] + before[1])
        across[i] = abs(du * normals[i, 0] + dv * normals[i, 1])
    return float(min(max(1.4826 * order.median(across) / np.sqrt(1.5), 0.02), 1.0))


@njit(cache=True)
def _area(outline: Array) -> float:
    """Area inside a closed outline, positive if anticlockwise in the image (v down)."""
    twice, n = 0.0, outline.shape[0]
    for i in range(n):
        a, b = outline[i - 1], outline[i]
        twice += a[1] * b[0] - a[0] * b[1]
    return 0.5 * twice


@njit(cache=True)
def _fill(
    runs: NDArray[np.int32], component: NDArray[np.int32], number: int, u0: int, v0: int, width: int, height: int
) -> NDArray[np.uint8]:
    mask = np.zeros((height, width), np.uint8)
    for k in range(len(runs)):
        if component[k] == number and v0 <= runs[k, 0] < v0 + height:
            for u in range(runs[k, 1], runs[k, 2]):
                mask[runs[k, 0] - v0, u - u0] = 1
    return mask


@njit(cache=True)
def _sharpen(planes: NDArray[np.uint8], outline: Array, normals: Array) -> tuple[Array, int]:
    height, width, channels = planes.shape
    steps = int(2 * _REACH / _STEP) + 1
    profile = np.empty((steps, channels))
    change = np.empty(steps)
    moved = np.empty_like(outline)
    found = 0
    for i in range(outline.shape[0]):
        nu, nv = normals[i]
        moved[i, 0], moved[i, 1] = outline[i, 0] + 0.5 * nu, outline[i, 1] + 0.5 * nv
        inside_image = True
        for k in range(steps):
            s = 0.5 - _REACH + k * _STEP
            u, v = outline[i, 0] + s * nu, outline[i, 1] + s * nv
            a, b = int(np.floor(u)), int(np.floor(v))
            if a < 0 or b < 0 or a + 1 >= width or b + 1 >= height:
                inside_image = False
                break
            fu, fv = u - a, v - b
            for c in range(channels):
                top = (1.0 - fu) * planes[b, a, c] + fu * planes[b, a + 1, c]
                low = (1.0 - fu) * planes[b + 1, a, c] + fu * planes[b + 1, a + 1, c]
                profile[k, c] = (1.0 - fv) * top + fv * low
        if not inside_image:
            continue
        contrast = 0.0
        change[:] = 0.0
        for c in range(channels):
            step = 0.0
            for k in range(3):
                step += profile[steps - 1 - k, c] - profile[k, c]
            contrast += step * step / 9.0
            for k in range(2, steps - 2):  # derivative over +-1 px, +-0.5 px
                slope = 2.0 * (profile[k + 2, c] - profile[k - 2, c]) + profile[k + 1, c] - profile[k - 1, c]
                change[k] += step * slope
        if contrast < _LEAST_CONTRAST * _LEAST_CONTRAST:
            continue
        best = 3
        for k in range(3, steps - 3):
            if change[k] > change[best]:
                best = k
        bend = change[best - 1] - 2.0 * change[best] + change[best + 1]
        shift = 0.5 * (change[best - 1] - change[best + 1]) / bend if bend < 0.0 else 0.0
        if abs(shift) > 1.0:
            continue
        s = 0.5 - _REACH + (best + shift) * _STEP
        moved[i, 0], moved[i, 1] = outline[i, 0] + s * nu, outline[i, 1] + s * nv
        found += 1
    return moved, found
