"""Images of another size: u' + 1/2 = s (u + 1/2)."""

from typing import Final

import cv2
import numpy as np

from models.camera import CameraModel
from vision.image.rectify import Image

_SAME_ASPECT: Final = 3e-3  # one row of an image of 480, for which sizes are rounded


def fits(width: int, height: int, camera: CameraModel) -> bool:
    """Whether a size has the camera's aspect ratio."""
    return bool(abs(width * camera.height / (height * camera.width) - 1.0) < _SAME_ASPECT)


def scaled(image: Image, camera: CameraModel) -> Image:
    """The image at the camera's size; unchanged for another aspect ratio."""
    height, width = image.shape[:2]
    if (width, height) == (camera.width, camera.height) or not fits(width, height, camera):
        return image
    way = cv2.INTER_AREA if width > camera.width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=way), dtype=image.dtype)
