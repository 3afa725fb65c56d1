"""Pictures for the coarse search: reduced, without lens distortion, and how they change from pixel to pixel.

    u_s = (u + 1/2) / s - 1/2                         (pixel of the picture reduced s times, pixel centres at integers)

A field (H, W, 8) holds dI/du of three channels, dI/dv of three channels, and the length of all six together; the last one is
empty, so that a pixel is half a line of the cache.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from models.camera import CameraModel
from vision.rectify import Image

Field = NDArray[np.float32]
Plane = NDArray[np.float32]
_UNSEEN = -1.0  # length where the camera saw nothing
_SOBEL = 0.125  # kernel -> grey values per pixel


@dataclass(frozen=True, slots=True)
class Level:
    """A picture reduced `size` times as a camera without distortion would have taken it, and its field."""

    size: int
    camera: CameraModel
    field: Field


def levels(picture: Image, camera: CameraModel, sizes: tuple[int, ...]) -> list[Level]:
    """One level for each size, sizes rising and each a multiple of the one before. picture: uint8, grey or BGR."""
    made, reduced, before = [], picture, 1
    for size in sizes:
        shape = (camera.width // size, camera.height // size)
        reduced = cv2.resize(reduced, shape, interpolation=cv2.INTER_AREA) if size > before else reduced
        before = size
        small, maps, unseen = _straight(camera, size)
        straight = reduced if maps is None else cv2.remap(reduced, maps[0], maps[1], cv2.INTER_LINEAR)
        made.append(Level(size, small, _field(straight, unseen)))
    return made


def _field(picture: Image, unseen: NDArray[np.bool_] | None) -> Field:
    image = picture if picture.ndim == 3 else picture[:, :, None]
    channels = min(image.shape[2], 3)
    field = np.zeros((*image.shape[:2], 8), dtype=np.float32)
    for k, (du, dv) in enumerate(((1, 0), (0, 1))):
        slope = cv2.Sobel(picture, cv2.CV_32F, du, dv, ksize=3, scale=_SOBEL)
        field[:, :, 3 * k : 3 * k + channels] = slope.reshape(*image.shape[:2], -1)[:, :, :channels]
    field[:, :, 6] = np.sqrt(sum(field[:, :, k] ** 2 for k in range(6)))
    if unseen is not None:
        field[unseen, 6] = _UNSEEN
    return field


@lru_cache(maxsize=16)
def _straight(camera: CameraModel, size: int) -> tuple[CameraModel, tuple[Plane, Plane] | None, NDArray[np.bool_] | None]:
    """The reduced camera without distortion, where in the reduced picture its pixels come from, and which nobody saw."""
    width, height = camera.width // size, camera.height // size
    small = CameraModel(
        width, height, camera.fx / size, camera.fy / size, (camera.cx + 0.5) / size - 0.5, (camera.cy + 0.5) / size - 0.5
    )
    if not any(camera.distortion):
        return small, None, None
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    px = camera.project(small.ray(np.column_stack((u.ravel(), v.ravel()))))
    unseen = ~camera.contains(px, 2.0 * size).reshape(height, width)
    place = ((px + 0.5) / size - 0.5).astype(np.float32).reshape(height, width, 2)
    return small, (np.ascontiguousarray(place[:, :, 0]), np.ascontiguousarray(place[:, :, 1])), unseen
