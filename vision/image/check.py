"""Is an image usable? A reason, or None."""

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.camera import CameraModel
from vision.image.rectify import Image

_DARK = 10.0  # of 255: night without a light
_BRIGHT = 247.0
_FLAT = 2.0  # standard deviation: no object, only noise
_FEW_COUNTS = 8.0  # of 65535
_SATURATED = 252.0
_SATURATED_PART = 0.6  # of the pixels
_LOST_PART = 0.04  # of the rows, one after the other without any change: a decoder's filling
_STEP = 12  # every twelfth pixel is used


def image_flaw(image: Image, camera: CameraModel | None = None) -> str | None:
    """Format, size, black, white, flat, saturated, torn; None if usable.

    image (H, W) or (H, W, 3), uint8 or uint16; camera: expected H, W.
    """
    if image.dtype not in (np.uint8, np.uint16):
        return "not an image of 8 or 16 bit"
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or min(image.shape) < 1:
        return f"not a grey or colour image: shape {image.shape}"
    height, width = image.shape[:2]
    if camera is not None and (width, height) != (camera.width, camera.height):
        return f"image is {width} x {height}, the camera {camera.width} x {camera.height}"
    return _brightness_flaw(image) or _torn_flaw(image)


def pair_flaw(left: Image, right: Image) -> str | None:
    """Why two good images are no pair: sizes or depths differ, or equal images."""
    if left.shape[:2] != right.shape[:2]:
        return f"left is {left.shape[1]} x {left.shape[0]}, right is {right.shape[1]} x {right.shape[0]}"
    if left.dtype != right.dtype:
        return "one image has 8 bit, the other 16"
    if left.ndim == right.ndim and np.array_equal(left[::_STEP, ::_STEP], right[::_STEP, ::_STEP]):
        return "left and right are the same image"
    return None


def _brightness_flaw(image: Image) -> str | None:
    sample = np.ascontiguousarray(image[::_STEP, ::_STEP])
    ranks = sample.size // 100, sample.size - 1 - sample.size // 100
    low, high = np.partition(sample, ranks, axis=None)[list(ranks)].astype(float).tolist()
    if image.dtype == np.uint16:  # which part of its range a thermal camera uses is its own affair
        return "black" if high < _FEW_COUNTS else "flat: no contrast" if high - low < _FEW_COUNTS else None
    if high < _DARK:
        return "black"
    if low > _BRIGHT:
        return "white"
    sigma, saturated = _spread(sample.reshape(sample.shape[0] * sample.shape[1], -1))
    if sigma < _FLAT:
        return "flat: no contrast"
    return f"saturated: {saturated:.0%} of the pixels" if saturated > _SATURATED_PART else None


@njit(cache=True)
def _spread(sample: Image) -> tuple[float, float]:
    """Standard deviation of grey, channel means, of pixels (N, C); saturated share."""
    total = square = saturated = 0.0
    for i in range(len(sample)):
        grey = 0.0
        for c in range(sample.shape[1]):
            grey += sample[i, c]
        grey /= sample.shape[1]
        total += grey
        square += grey * grey
        saturated += grey >= _SATURATED
    count = len(sample)
    return math.sqrt(max(square - total * total / count, 0.0) / count), saturated / count


def _torn_flaw(image: Image) -> str | None:
    """Constant or repeated rows at the lower end: the rest never arrived."""
    row = whole = len(image) - 1
    while row > 0 and (_same(image[row, ::_STEP], image[row, :1]) or _same(image[row, ::_STEP], image[row - 1, ::_STEP])):
        row -= 1
    if whole - row > _LOST_PART * len(image):
        return f"torn: nothing below row {row}"
    return None


def _same(a: NDArray[Any], b: NDArray[Any]) -> bool:
    return bool((a == b).all())
