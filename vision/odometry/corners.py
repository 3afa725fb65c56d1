"""Key-frame corners: FAST-9 (Rosten, Drummond 2006), the strongest of each grid cell."""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from vision.image.rectify import Image, Mask
from vision.odometry.views import reduced, scaled_px

_THRESHOLDS: Final = (96, 48, 24, 12, 6)  # grey levels, strongest first: the first that gives enough is used
_FILLED: Final = 0.8  # of the cells: enough at each threshold (on grass 12 gives 40,000 corners)
_ORDINARY, _ENOUGH = 24, 4.0  # from this threshold on it is enough to have so many times the wanted number
_WIDE_PX: Final = 1000  # wider images are halved: a corner need not be known to a pixel
_COLUMNS, _ROWS = 12, 8


def corners(image: Image, mask: Mask | None, wanted: int) -> Array:
    """(N, 2) pixels (u, v), N <= wanted, by cells.

    image (H, W) uint8; mask: 0 where no corner may be.
    """
    if image.shape[1] > _WIDE_PX:
        small = reduced(image, 2)
        seen = (
            None if mask is None else np.asarray(cv2.resize(mask, small.shape[::-1], interpolation=cv2.INTER_NEAREST), np.uint8)
        )
        return scaled_px(corners(small, seen, wanted), 2.0)
    px = np.empty((0, 2))
    for threshold in _THRESHOLDS:
        keypoints = list(cv2.FastFeatureDetector.create(threshold).detect(image, mask))
        if not keypoints:
            continue
        px = np.asarray(cv2.KeyPoint.convert(keypoints), np.float64)
        cell = _cells(px, image.shape)
        many = threshold <= _ORDINARY and len(px) >= _ENOUGH * wanted
        if many or len(np.unique(cell)) >= _FILLED * _COLUMNS * _ROWS or threshold == _THRESHOLDS[-1]:
            strength = np.array([k.response for k in keypoints])
            return px[_strongest_of_cells(px, strength, cell, wanted)]
    return px


def _cells(px: Array, shape: tuple[int, ...]) -> NDArray[np.intp]:
    height, width = shape[:2]
    column = (px[:, 0] * (_COLUMNS / width)).astype(np.intp)
    row = (px[:, 1] * (_ROWS / height)).astype(np.intp)
    cell: NDArray[np.intp] = row * _COLUMNS + column
    return cell


def _strongest_of_cells(px: Array, strength: Array, cell: NDArray[np.intp], wanted: int) -> NDArray[np.intp]:
    order = np.lexsort((px[:, 0], px[:, 1], -strength, cell))
    first = np.r_[True, np.diff(cell[order]) != 0]
    start = np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
    rank = np.arange(len(order)) - start  # within its cell
    kept = np.lexsort((cell[order], rank))[:wanted]
    return order[np.sort(kept)]
