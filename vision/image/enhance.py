"""Image enhancement (thesis section 4.2) of uint8 or uint16, grey or BGR."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import DTypeLike, NDArray

from vision.image.rectify import Image

_SAMPLE = 4  # every fourth pixel each way is enough for a percentile


def median(image: Image, window: int = 5) -> Image:
    """Median of window x window neighbours (thesis section 4.2.2.2)."""
    return cv2.medianBlur(image, window)


def limits(image: Image, clip: float = 0.01) -> tuple[float, float]:
    """c, d of the stretch: a part `clip` of the pixels is beyond."""
    low, high = np.percentile(image[::_SAMPLE, ::_SAMPLE], (100.0 * clip, 100.0 * (1.0 - clip)))
    return float(low), float(high)


def stretch(image: Image, clip: float = 0.01, margin: float = 0.0) -> NDArray[np.uint8]:
    """s = (r - c) (b - a) / (d - c) + a, a = 0, b = 255 (thesis eq. 4.60); flat: middle grey."""
    c, d = limits(image, clip)
    if d <= c:
        return np.full(image.shape, 128, dtype=np.uint8)
    c, d = c - margin * (d - c), d + margin * (d - c)
    levels = np.arange(np.iinfo(image.dtype).max + 1)
    return _look_up(image, np.clip((levels - c) * (255.0 / (d - c)), 0.0, 255.0), np.uint8)


def unveil(image: NDArray[np.uint8], least: float = 0.72) -> NDArray[np.uint8]:
    """r - dark in each channel, (H, W, 3): haze removal (Chavez 1988).

    dark: 0.9 of the darkest hundredth's level, where above `least` of the median.
    """
    dark, middle = np.percentile(image[::_SAMPLE, ::_SAMPLE].reshape(-1, 3), (1.0, 50.0), axis=0)
    if dark.mean() < least * middle.mean():
        return image
    return np.asarray(cv2.subtract(image, np.append(0.9 * dark, 0.0)), dtype=np.uint8)


def _look_up(image: Image, levels: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    table = np.rint(levels).astype(dtype)
    return np.asarray(cv2.LUT(np.asarray(image, dtype=np.uint8), table)) if image.dtype == np.uint8 else table[image]
