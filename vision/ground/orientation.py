"""Agreement of edge directions: evidence independent of edge positions.

    o = s (cos 2 theta, sin 2 theta),   rho(d) = sum o_t o_i(d) / sqrt(sum o_t^2 sum o_i(d)^2),   o less its mean

s, theta: of the gradient. Subtracting the mean removes a common direction (streets).
"""

import cv2
import numpy as np

from vision.ground.image import Float

_BLUR_PX = 1.0
_BESIDE_PX = 1  # as far from the peak the coefficient is sought, each way


def directions(view: Float, structure: Float) -> Float:
    """o (h, w, 2)."""
    smooth = cv2.GaussianBlur(view, (0, 0), _BLUR_PX)
    x, y = (cv2.Sobel(smooth, cv2.CV_32F, *order) for order in ((1, 0), (0, 1)))
    norm = np.maximum(x * x + y * y, np.float32(1e-6))
    o: Float = structure[..., None] * np.stack(((x * x - y * y) / norm, 2.0 * x * y / norm), axis=-1)
    return o


def coefficient(image: Float, template: Float, mask: Float, at: tuple[int, int]) -> float:
    """rho at (row, column) of all shifts, or near it; image, template: directions."""
    (row, column), (height, width) = at, mask.shape
    top, left = max(row - _BESIDE_PX, 0), max(column - _BESIDE_PX, 0)
    image = image[top : row + _BESIDE_PX + height, left : column + _BESIDE_PX + width]
    count = float(mask.sum())
    t = mask[..., None] * (template - (mask[..., None] * template).sum(axis=(0, 1)) / count)
    product = cv2.matchTemplate(image, t, cv2.TM_CCORR)
    planes = [np.ascontiguousarray(image[..., k]) for k in range(image.shape[-1])]
    mean_squared = sum(cv2.matchTemplate(plane, mask, cv2.TM_CCORR) ** 2 / count for plane in planes)
    energy = cv2.matchTemplate(np.ascontiguousarray((image * image).sum(axis=-1)), mask, cv2.TM_CCORR) - mean_squared
    return float((product / np.sqrt(np.maximum(energy, np.float32(1e-6)) * float((t * t).sum()))).max())
