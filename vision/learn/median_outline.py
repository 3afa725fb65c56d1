"""Outline that at least half of many contain (Vorob'ev median)."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from models.maps import outline as polygon
from models.messages import Array
from vision.describe.polygon import fit_polygon

_MOST_CELLS = 1500  # along a side of the grid
_WOBBLE_CELLS = 2.0  # of an outline that is no polygon


class Merged(NamedTuple):
    """outline (K, 2) about its centroid, anticlockwise from above; agreement: mean intersection over union."""

    outline: Array
    agreement: float


def merged_outline(outlines: Sequence[Array], cell_m: float) -> Merged | None:
    """Of outlines (K_i, 2) about centroids, by votes on a grid of cell_m, or None."""
    laid = [outline - _centroid(outline) for outline in outlines]
    half = float(np.max([np.abs(outline).max() for outline in laid]))
    cell = max(cell_m, 2.0 * half / _MOST_CELLS)
    middle = int(np.ceil(half / cell)) + 3
    drawn = [_drawn(outline / cell + middle, 2 * middle + 1) for outline in laid]
    common = np.asarray(2 * np.sum(drawn, axis=0) >= len(drawn), dtype=np.uint8)
    corners = _corners(common)
    if corners is None:
        return None
    outline = np.ascontiguousarray((corners - middle)[:, ::-1] * cell)
    if polygon.area(outline) < 0.0:
        outline = np.ascontiguousarray(outline[::-1])
    agreement = float(np.mean([np.sum(one & common) / np.sum(one | common) for one in drawn]))
    return Merged(outline - _centroid(outline), agreement)


def _drawn(outline: Array, side: int) -> NDArray[np.uint8]:
    mask = np.zeros((side, side), np.uint8)
    cv2.fillPoly(mask, [np.rint(outline[:, ::-1]).astype(np.int32)], 1)
    return mask


def _corners(mask: NDArray[np.uint8]) -> Array | None:
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    contour = max(contours, key=cv2.contourArea)[:, 0].astype(np.float64)
    corners = fit_polygon(contour) if len(contour) >= 8 else None
    if corners is None:
        corners = cv2.approxPolyDP(contour.astype(np.float32), _WOBBLE_CELLS, True)[:, 0].astype(np.float64)
    return None if len(corners) < 3 or polygon.crosses_itself(corners) else corners


def _centroid(outline: Array) -> Array:
    described: Array = polygon.describe(np.ascontiguousarray(outline), np.array([0, len(outline)]))[0]
    return described[[polygon.NORTH, polygon.EAST]]
