"""Key-frame corners: FAST on a grid, so that they cover the image and not the best texture alone.

Rosten, Drummond 2006 (FAST-9 with non-maximum suppression); the strongest few of each cell are kept.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from vision.image.rectify import Image, Mask

_THRESHOLDS: Final = (24, 12, 6)  # grey levels, strongest first: the first that gives enough is used
_ENOUGH: Final = 4.0  # times the wanted number
_COLUMNS, _ROWS = 12, 8


def corners(image: Image, mask: Mask | None, wanted: int) -> Array:
    """(N, 2) pixels (u, v), N <= wanted: at most a few of each grid cell, strongest first within it.

    image (H, W) uint8; mask: 0 where no corner may be. The order is that of the cells: the same image gives the same corners.
    """
    keypoints: list[cv2.KeyPoint] = []
    for threshold in _THRESHOLDS:
        detector = cv2.FastFeatureDetector.create(threshold)
        keypoints = list(detector.detect(image, mask))
        if len(keypoints) >= _ENOUGH * wanted:
            break
    if not keypoints:
        return np.empty((0, 2))
    px = np.array([k.pt for k in keypoints])
    strength = np.array([k.response for k in keypoints])
    return px[_strongest_of_cells(px, strength, image.shape[:2], wanted)]


def _strongest_of_cells(px: Array, strength: Array, shape: tuple[int, ...], wanted: int) -> NDArray[np.intp]:
    """Indices of the strongest corners of each cell; slots that empty cells leave go to the second, third ... of the others."""
    height, width = shape
    column = (px[:, 0] * (_COLUMNS / width)).astype(np.intp)
    row = (px[:, 1] * (_ROWS / height)).astype(np.intp)
    cell = row * _COLUMNS + column
    order = np.lexsort((px[:, 0], px[:, 1], -strength, cell))
    first = np.r_[True, np.diff(cell[order]) != 0]
    start = np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    rank = np.arange(len(order)) - start  # within its cell
    kept = np.lexsort((cell[order], rank))[:wanted]
    return order[np.sort(kept)]
