"""A georeferenced image of the ground as the map.

(north, east) = A (u, v, 1) [m], (u, v) the pixel's centre;  down = D(north, east): heights, bilinear
"""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from vision.describe.survey import grey, to_8_bit
from vision.image.rectify import Image

Float = NDArray[np.float32]
_STANDING = 0.1  # share of the edges that do not lie on the ground: a mean height of a third of the unevenness
_LEAST_LEVEL_PX = 32  # of a pyramid's coarsest image


@dataclass(frozen=True, eq=False)
class Heights:
    """down (h, w) [m] on a raster, (north, east) = affine (u, v, 1).

    unevenness_m: roofs and trees; slope [rad]: where unknown.
    """

    down: Array
    affine: Array
    unevenness_m: float
    slope: float = 0.0

    @cached_property
    def _only(self) -> float | None:
        """The height of level ground."""
        first = float(self.down[0, 0])
        return first if (self.down == first).all() else None

    @classmethod
    def level(cls, down: float, unevenness_m: float = 3.0, slope: float = 0.05) -> "Heights":
        """The same everywhere."""
        return cls(np.full((2, 2), down), np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), unevenness_m, slope)

    def at(self, position_n: Array) -> Array:
        """Down (N,) of positions (N, 2) north, east."""
        if self._only is not None:
            return np.full(len(position_n), self._only)
        height, width = self.down.shape
        u, v = to_pixels(self.affine, position_n).T
        u, v = np.clip(u, 0.0, width - 1.0), np.clip(v, 0.0, height - 1.0)
        j, i = np.minimum(u.astype(np.int64), width - 2), np.minimum(v.astype(np.int64), height - 2)
        s, t, d = u - j, v - i, self.down
        upper, lower = (1.0 - s) * d[i, j] + s * d[i, j + 1], (1.0 - s) * d[i + 1, j] + s * d[i + 1, j + 1]
        down: Array = (1.0 - t) * upper + t * lower
        return down


@dataclass(frozen=True, eq=False)
class GroundImage:
    """image (H, W[, 3]), affine (2, 3), heights; sigma_m: position per axis; height_sigma_m: ground.

    Raises ValueError for a singular affine.
    """

    name: str
    image: Image
    affine: Array
    heights: Heights
    sigma_m: float = 0.0
    height_sigma_m: float = 0.0

    def __post_init__(self) -> None:
        if self.affine.shape != (2, 3) or not np.isfinite(self.affine).all() or abs(np.linalg.det(self.affine[:, :2])) < 1e-12:
            raise ValueError(f"{self.name}: its georeference is not usable")

    @cached_property
    def pixel_m(self) -> float:
        """Side of a pixel on the ground."""
        return float(np.sqrt(abs(np.linalg.det(self.affine[:, :2]))))

    @property
    def shared_sigma(self) -> tuple[float, float, float]:
        """Common sigmas: horizontal, height [m], ground slope."""
        mean = math.sqrt(_STANDING / (1.0 - _STANDING)) * self.heights.unevenness_m
        return self.sigma_m, math.hypot(self.height_sigma_m, mean), self.heights.slope

    @cached_property
    def pyramid(self) -> tuple[Image, ...]:
        """The image in grey, and halved again and again."""
        return pyramid(self.image)

    def to_pixels(self, position_n: Array) -> Array:
        """(u, v) (N, 2) of positions (N, 2) north, east."""
        return to_pixels(self.affine, position_n)

    def points(self, position_n: Array) -> Array:
        """Points of the ground (N, 3) in n at positions (N, 2)."""
        return np.column_stack((position_n, self.heights.at(position_n)))

    def contains(self, position_n: Array) -> NDArray[np.bool_]:
        """Positions (N, 2) within the image."""
        px, (height, width) = self.to_pixels(position_n), self.image.shape[:2]
        u, v = px.T
        inside: NDArray[np.bool_] = (u >= 0.0) & (u <= width - 1.0) & (v >= 0.0) & (v <= height - 1.0)
        return inside


def to_pixels(affine: Array, position_n: Array) -> Array:
    """The inverse of an affine (2, 3)."""
    inverse = np.linalg.inv(affine[:, :2])
    x, y = (position_n - affine[:, 2]).T
    return np.column_stack((inverse[0, 0] * x + inverse[0, 1] * y, inverse[1, 0] * x + inverse[1, 1] * y))


def pyramid(image: Image) -> tuple[Image, ...]:
    """A grey image halved repeatedly: pixel (u, v) of level k is (u, v) 2^k of level 0."""
    levels = [grey(to_8_bit(image))]
    while min(levels[-1].shape) >= 2 * _LEAST_LEVEL_PX:
        levels.append(cv2.pyrDown(levels[-1]).astype(np.uint8))
    return tuple(levels)


def sample(levels: tuple[Image, ...], px: Array, ratio: float) -> Float:
    """Grey values at px (h, w, 2) of level 0, `ratio` pixels apart, anti-aliased."""
    level = _level(levels, ratio)
    image = levels[level]
    height, width = image.shape
    u, v = np.moveaxis(px * 2.0**-level, -1, 0)
    u, v = np.clip(np.nan_to_num(u), 0.0, width - 1.0), np.clip(np.nan_to_num(v), 0.0, height - 1.0)
    left, top = int(u.min()), int(v.min())
    part = image[top : int(v.max()) + 2, left : int(u.max()) + 2].astype(np.float32)  # a map is far larger than what is seen
    at = (u - left).astype(np.float32), (v - top).astype(np.float32)
    return _smooth(cv2.remap(part, *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), ratio / 2.0**level)


def sample_affine(levels: tuple[Image, ...], affine: Array, shape: tuple[int, int], ratio: float) -> Float:
    """The same at px = affine (column, row, 1), of `shape` (h, w)."""
    level = _level(levels, ratio)
    image, (height, width) = levels[level], shape
    affine = affine * 2.0**-level
    corners = affine @ np.array([[0.0, width - 1.0, 0.0, width - 1.0], [0.0, 0.0, height - 1.0, height - 1.0], [1.0] * 4])
    last = np.array(image.shape[::-1]) - 1
    low, high = (np.clip(np.floor(end), 0, last).astype(int) for end in (corners.min(axis=1), corners.max(axis=1)))
    part = image[low[1] : high[1] + 2, low[0] : high[0] + 2].astype(np.float32)
    affine[:, 2] -= low
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    values = cv2.warpAffine(part, affine, (width, height), flags=how, borderMode=cv2.BORDER_REPLICATE)
    return _smooth(values, ratio / 2.0**level)


def _level(levels: tuple[Image, ...], ratio: float) -> int:
    return int(np.clip(np.floor(np.log2(max(ratio, 1.0))), 0, len(levels) - 1))


def _smooth(values: cv2.typing.MatLike, rest: float) -> Float:
    """Without what points `rest` pixels apart cannot show."""
    if rest > 1.2:
        values = cv2.GaussianBlur(values, (0, 0), 0.35 * float(np.sqrt(1.0 - rest**-2)))
    return values.astype(np.float32, copy=False)
