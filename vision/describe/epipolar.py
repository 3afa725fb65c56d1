"""Vertical residual v_l - v_r of matched regions or edges."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.camera import StereoRig
from models.messages import Array
from vision.describe import correlation
from vision.describe.correspond import Match, Unmatched, disparity_offset
from vision.image.rectify import Image

_LIMIT_PX = 1.0  # of the median: more is not a good calibration
_FLOOR_PX = 0.1  # of a region's vertical residual: interpolation
_WINDOW = 7  # px, half of the window around a corner
_CORNERS = 120


@dataclass(frozen=True, slots=True)
class Residual:
    """Median of v_r - v_l [px], its standard deviation, number of regions or corners."""

    vertical_px: float
    sigma_px: float
    count: int


def region_residual(matches: Sequence[Match | Unmatched]) -> Residual | None:
    """From matched regions; None without."""
    found = [(m.vertical_px, np.hypot(m.vertical_sigma_px, _FLOOR_PX)) for m in matches if isinstance(m, Match)]
    return _median(np.array(found)) if found else None


def edge_residual(
    left: Image, right: Image, rig: StereoRig, nearest_m: float = 4.0, vertical_px: int = 8, corners: int = _CORNERS
) -> Residual | None:
    """From strong corners; None with fewer than eight matches."""
    positions = cv2.goodFeaturesToTrack(left, corners, 0.02, 2.0 * _WINDOW)
    if positions is None:
        return None
    offset = disparity_offset(rig)
    low, high = int(np.floor(offset)) - 4, int(np.ceil(offset + rig.left.fx * rig.baseline_m / nearest_m))
    grid = np.stack(np.meshgrid(*2 * [np.arange(-_WINDOW, _WINDOW + 1)]), axis=-1).reshape(-1, 2)
    found = []
    for position in np.rint(positions.reshape(-1, 2)).astype(np.int32):
        pixels = np.ascontiguousarray(position + grid, dtype=np.int32)
        rows = range(-vertical_px, vertical_px + 1)
        scores = np.stack([correlation.scan(left, right, pixels, low, high, dv) for dv in rows])
        row, column = np.unravel_index(int(scores.argmax()), scores.shape)
        others = scores.copy()
        others[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3] = -1.0
        if scores[row, column] < 0.85 or others.max() > scores[row, column] - 0.03 or not 0 < row < len(rows) - 1:
            continue
        a, b, c = scores[row - 1 : row + 2, column]
        found.append((rows[row] + 0.5 * (a - c) / (a - 2.0 * b + c), 0.2))
    return _median(np.array(found)) if len(found) >= 8 else None


def pair_reason(matches: Sequence[Match | Unmatched], residual: Residual | None) -> str | None:
    """Why the pair's distances are invalid, or None."""
    behind = sum(isinstance(m, Unmatched) and m.behind for m in matches)
    found = sum(isinstance(m, Match) for m in matches)
    misfit = residual is not None and abs(residual.vertical_px) > max(_LIMIT_PX, 3.0 * residual.sigma_px)
    if behind > max(found, int(misfit)):  # one region on a wrong row is found anywhere
        return f"left and right are swapped: {behind} of {behind + found} regions lie behind the camera (or both are upside down)"
    if residual is not None and misfit:
        return (
            f"rows do not fit by {residual.vertical_px:+.1f} +- {residual.sigma_px:.1f} px: "
            "wrong calibration, or images not taken together"
        )
    return None


def _median(found: Array) -> Residual:
    order = np.argsort(found[:, 0])
    cumulated = np.cumsum(1.0 / found[order, 1] ** 2)
    median = float(found[order[int(np.searchsorted(cumulated, 0.5 * cumulated[-1]))], 0])
    stated = 1.2533 / np.sqrt(cumulated[-1])
    seen = 1.2533 * 1.4826 * np.median(np.abs(found[:, 0] - median)) / np.sqrt(len(found))
    return Residual(median, float(max(stated, seen)), len(found))
