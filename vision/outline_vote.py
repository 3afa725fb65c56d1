"""One outline from many of the same thing: what at least half of them contain (Vorob'ev's median of random sets)."""

from collections.abc import Sequence

import cv2
import numpy as np

from models import outline as polygon
from models.messages import Array
from vision.polygon import fit_polygon

_MOST_CELLS = 1500  # along a side of the grid
_WOBBLE_CELLS = 2.0  # of an outline that is no polygon


def merged_outline(outlines: Sequence[Array], cell_m: float) -> Array | None:
    """(K, 2) about its centroid, anticlockwise seen from above; outlines (K_i, 2) north, east, each laid on its own centroid.

    cell_m: of the grid on which they vote. None where no half of them has anything in common.
    """
    laid = [outline - _centroid(outline) for outline in outlines]
    half = float(np.max([np.abs(outline).max() for outline in laid]))
    cell = max(cell_m, 2.0 * half / _MOST_CELLS)
    middle = int(np.ceil(half / cell)) + 3
    votes = np.zeros((2 * middle + 1, 2 * middle + 1), np.uint16)
    for outline in laid:
        one = np.zeros(votes.shape, np.uint8)
        cv2.fillPoly(one, [np.rint(outline[:, ::-1] / cell + middle).astype(np.int32)], 1)
        votes += one
    common = np.asarray(2 * votes >= len(laid), dtype=np.uint8)
    contours, _ = cv2.findContours(common, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return None
    contour = max(contours, key=cv2.contourArea)[:, 0].astype(np.float64)
    corners = fit_polygon(contour) if len(contour) >= 8 else None
    if corners is None:
        corners = cv2.approxPolyDP(contour.astype(np.float32), _WOBBLE_CELLS, True)[:, 0].astype(np.float64)
    if len(corners) < 3 or polygon.crosses_itself(corners):
        return None
    outline = np.ascontiguousarray((corners - middle)[:, ::-1] * cell)
    if polygon.area(outline) < 0.0:
        outline = np.ascontiguousarray(outline[::-1])
    return outline - _centroid(outline)


def _centroid(outline: Array) -> Array:
    described: Array = polygon.describe(np.ascontiguousarray(outline), np.array([0, len(outline)]))[0]
    return described[[polygon.NORTH, polygon.EAST]]
