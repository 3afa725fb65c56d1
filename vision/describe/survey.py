"""Regions of a pair in metres."""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from vision.describe import epipolar
from vision.describe.correspond import Match, Search, Unmatched, correspond
from vision.describe.measure import Accuracy, Level, Measured, Unmeasured, measure
from vision.describe.regions import Limits, Region, find_regions
from vision.describe.segment import (
    Labels,
    Space,
    Tolerance,
    classes,
    colour_table,
    segment_colours,
    segment_intensity,
    segment_seeds,
)
from vision.image import check, enhance
from vision.image.rectify import Image, Mask, Rectification, rectify


@dataclass(frozen=True, slots=True)
class Settings:
    """How a pair is surveyed; colours_bgr empty: seed segmentation."""

    colours_bgr: tuple[tuple[float, float, float], ...] = ()
    space: Space = "hsv"
    tolerance: Tolerance = field(default_factory=Tolerance)
    median_window: int = 3
    limits: Limits = field(default_factory=Limits)
    search: Search = field(default_factory=Search)
    accuracy: Accuracy = field(default_factory=Accuracy)
    level: Level | None = None


@dataclass(frozen=True, slots=True)
class Survey:
    """left: rectified left image, 8 bit; problem: why distances are invalid, or None."""

    left: Image
    measured: tuple[Measured, ...]
    unmeasured: tuple[Unmeasured, ...]
    residual: epipolar.Residual | None
    problem: str | None


def survey(left: Image, right: Image, rectification: Rectification, settings: Settings | None = None) -> Survey | str:
    """What the pair shows, or why unusable; left, right: raw, uint8 or uint16, grey or BGR."""
    settings = settings or Settings()
    for name, image in (("left", left), ("right", right)):
        if flaw := check.image_flaw(image):
            return f"{name} image: {flaw}"
    if flaw := check.pair_flaw(left, right):
        return flaw
    size = (rectification.rig.left.width, rectification.rig.left.height)
    if left.shape[1::-1] != size:
        return f"images are {left.shape[1]} x {left.shape[0]}, the rig's cameras {size[0]} x {size[1]}"
    seen, other = rectify(to_8_bit(left), rectification.left), rectify(grey(to_8_bit(right)), rectification.right)
    regions = segment_regions(seen, rectification.left.valid if rectification.left else None, settings)
    matches = correspond(grey(seen), other, regions, rectification.rig, settings.search)
    residual = epipolar.region_residual(matches) or epipolar.edge_residual(grey(seen), other, rectification.rig)
    results = [_measured(m, rectification, settings) for m in matches]
    measured = tuple(r for r in results if isinstance(r, Measured))
    unmeasured = tuple(r for r in results if isinstance(r, Unmeasured))
    return Survey(seen, measured, unmeasured, residual, epipolar.pair_reason(matches, residual))


def _measured(match: Match | Unmatched, rectification: Rectification, settings: Settings) -> Measured | Unmeasured:
    if isinstance(match, Unmatched):
        return Unmeasured(match.region, match.reason)
    return measure(match, rectification.rig, settings.accuracy, settings.level)


def segment_regions(image: Image, valid: Mask | None, settings: Settings) -> list[Region]:
    """Regions of a rectified 8-bit image; by intensity where it has one channel."""
    image = grey(image) if settings.space == "grey" else image
    smooth = enhance.median(image, settings.median_window) if settings.median_window else image
    if image.ndim == 2:
        labels = segment_intensity(smooth)
    elif settings.colours_bgr:
        labels = segment_colours(enhance.unveil(smooth), _table(settings.colours_bgr, settings.space, settings.tolerance))
    else:
        labels = segment_seeds(smooth, settings.space)
    return find_regions(image, labels, settings.limits, valid)


def to_8_bit(image: Image) -> Image:
    """16-bit images stretched over their range less 1 % at either end (thesis eq. 4.60)."""
    return enhance.stretch(image, 0.01, 0.25) if image.dtype == np.uint16 else image


def grey(image: Image) -> Image:
    """One channel."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


@lru_cache(maxsize=8)
def _table(colours_bgr: tuple[tuple[float, float, float], ...], space: Space, tolerance: Tolerance) -> Labels:
    return colour_table(classes(colours_bgr, space), space, tolerance)
