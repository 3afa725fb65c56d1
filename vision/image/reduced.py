"""Images for the coarse search: reduced, undistorted, with gradients.

    u_s = (u + 1/2) / s - 1/2                         (pixel of the image reduced s times, pixel centres at integers)

A field (H, W, 8): dI/du and dI/dv of three channels, their length, one unused (cache alignment). Tiles are computed on demand.
"""

import math
from functools import lru_cache

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.camera import CameraModel
from models.messages import Array
from vision.image.rectify import Image

Field = NDArray[np.float32]
Plane = NDArray[np.float32]
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]
_NONE = np.float32(0.0)
_UNSEEN = np.float32(-1.0)  # length where the camera saw nothing
_SOBEL = np.float32(0.125)  # kernel -> grey values per pixel
_TILE = 16  # px
_SAMPLE = 5000  # pixels, about, that tell the typical gradient


class Level:
    """An undistorted image reduced `size` times, and its field."""

    def __init__(self, size: int, camera: CameraModel, image: Image, unseen: Mask) -> None:
        self.size, self.camera, self._unseen = size, camera, unseen
        self._image = np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None])
        height, width = image.shape[:2]
        self._field = np.empty((height, width, 8), dtype=np.float32)
        self._made = np.zeros((-(-height // _TILE), -(-width // _TILE)), dtype=np.bool_)

    def typical(self) -> float:
        """Median length of the gradient, of some thousand pixels."""
        step = max(2, math.isqrt(self._made.size * _TILE**2 // _SAMPLE))
        return float(np.median(_lengths(self._image, self._unseen, step)))

    def whole(self) -> Field:
        """All of the field."""
        for y, x in np.argwhere(~self._made):
            _fill(self._field, self._image, self._unseen, y * _TILE, x * _TILE)
        self._made[:] = True
        return self._field

    def field(self, aimed: Array, u: tuple[float, float], v: tuple[float, float]) -> Field:
        """The field at points aimed (N, 11) (vote()) for shifts u[0] to u[1], v[0] to v[1]."""
        c, (height, width) = self.camera, self._field.shape[:2]
        return self.around(_reached(np.array([c.fx, c.fy, c.cx, c.cy]), width, height, aimed, u, v))

    def around(self, boxes: Indices) -> Field:
        """The field in boxes (N, 4) of pixels: from and to, inclusive, in u, then v."""
        _make(self._field, self._made, self._image, self._unseen, boxes)
        return self._field


def levels(image: Image, camera: CameraModel, sizes: tuple[int, ...]) -> list[Level]:
    """A level per size (rising multiples); image: uint8, grey or BGR."""
    made, reduced, before = [], image, 1
    for size in sizes:
        shape = (camera.width // size, camera.height // size)
        reduced = cv2.resize(reduced, shape, interpolation=cv2.INTER_AREA) if size > before else reduced
        before = size
        small, maps, unseen = _straight(camera, size)
        straight = reduced if maps is None else cv2.remap(reduced, maps[0], maps[1], cv2.INTER_LINEAR)
        made.append(Level(size, small, straight, unseen))
    return made


@njit(cache=True)
def _reached(camera: Array, width: int, height: int, aimed: Array, su: tuple[float, float], sv: tuple[float, float]) -> Indices:
    """Boxes (N, 4) reached by points; quotients linear in the shifts peak at corners."""
    boxes = np.empty((len(aimed), 4), np.int64)
    for i in range(len(aimed)):
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        for a in su:
            for b in sv:
                z = aimed[i, 2] + a * aimed[i, 5] + b * aimed[i, 8]
                if z <= 0.0:  # nobody knows where to
                    left, right, top, bottom = -np.inf, np.inf, -np.inf, np.inf
                    continue
                u = camera[0] * (aimed[i, 0] + a * aimed[i, 3] + b * aimed[i, 6]) / z + camera[2]
                v = camera[1] * (aimed[i, 1] + a * aimed[i, 4] + b * aimed[i, 7]) / z + camera[3]
                left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        boxes[i, 0], boxes[i, 1] = int(min(max(left - 0.5, -1.0), width)), int(max(min(right + 1.5, width - 1.0), -1.0))
        boxes[i, 2], boxes[i, 3] = int(min(max(top - 0.5, -1.0), height)), int(max(min(bottom + 1.5, height - 1.0), -1.0))
    return boxes


@njit(cache=True)
def _make(field: Field, made: Mask, image: Image, unseen: Mask, boxes: Indices) -> None:
    rows, columns = field.shape[0], field.shape[1]
    for left, right, top, bottom in boxes:
        if right < 0 or left >= columns or bottom < 0 or top >= rows:
            continue
        for y in range(max(top, 0) // _TILE, min(bottom, rows - 1) // _TILE + 1):
            for x in range(max(left, 0) // _TILE, min(right, columns - 1) // _TILE + 1):
                if not made[y, x]:
                    made[y, x] = True
                    _fill(field, image, unseen, y * _TILE, x * _TILE)


@njit(cache=True)
def _fill(field: Field, image: Image, unseen: Mask, top: int, left: int) -> None:
    rows, columns, channels = image.shape
    for y in range(top, min(top + _TILE, rows)):
        above, below = _beside(y, rows)
        for x in range(left, min(left + _TILE, columns)):
            before, after = _beside(x, columns)
            square = np.float32(0.0)
            for c in range(3):
                du, dv = gradient(image, above, y, below, before, x, after, c) if c < channels else (_NONE, _NONE)
                field[y, x, c], field[y, x, 3 + c] = du, dv
                square += du * du + dv * dv
            field[y, x, 6] = _UNSEEN if unseen[y, x] else np.sqrt(square)


@njit(cache=True)
def _beside(at: int, size: int) -> tuple[int, int]:
    return max(at - 1, 1 - at) if size > 1 else 0, at + 1 if at < size - 1 else max(size - 2, 0)


@njit(cache=True)
def gradient(
    image: Image, above: int, y: int, below: int, before: int, x: int, after: int, c: int
) -> tuple[np.float32, np.float32]:
    """Sobel's derivatives of one channel at a pixel."""
    nw, n, ne = np.int32(image[above, before, c]), np.int32(image[above, x, c]), np.int32(image[above, after, c])
    w, e = np.int32(image[y, before, c]), np.int32(image[y, after, c])
    sw, s, se = np.int32(image[below, before, c]), np.int32(image[below, x, c]), np.int32(image[below, after, c])
    return _SOBEL * np.float32(ne + 2 * e + se - nw - 2 * w - sw), _SOBEL * np.float32(sw + 2 * s + se - nw - 2 * n - ne)


@njit(cache=True)
def _lengths(image: Image, unseen: Mask, step: int) -> Plane:
    rows, columns, channels = image.shape
    lengths = np.empty(((rows + step - 1) // step, (columns + step - 1) // step), dtype=np.float32)
    for y in range(0, rows, step):
        above, below = _beside(y, rows)
        for x in range(0, columns, step):
            before, after = _beside(x, columns)
            square = np.float32(0.0)
            for c in range(channels):
                du, dv = gradient(image, above, y, below, before, x, after, c)
                square += du * du + dv * dv
            lengths[y // step, x // step] = _UNSEEN if unseen[y, x] else np.sqrt(square)
    return lengths


@lru_cache(maxsize=16)
def _straight(camera: CameraModel, size: int) -> tuple[CameraModel, tuple[Plane, Plane] | None, Mask]:
    """Reduced undistorted camera, source pixels of its image, and which do not exist."""
    width, height = camera.width // size, camera.height // size
    small = CameraModel(
        width, height, camera.fx / size, camera.fy / size, (camera.cx + 0.5) / size - 0.5, (camera.cy + 0.5) / size - 0.5
    )
    if not any(camera.distortion):
        return small, None, np.zeros((height, width), dtype=np.bool_)
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    px = camera.project(small.ray(np.column_stack((u.ravel(), v.ravel()))))
    unseen = ~camera.contains(px, 2.0 * size).reshape(height, width)
    position = ((px + 0.5) / size - 0.5).astype(np.float32).reshape(height, width, 2)
    return small, (np.ascontiguousarray(position[:, :, 0]), np.ascontiguousarray(position[:, :, 1])), unseen
