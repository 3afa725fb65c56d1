"""Level ground, textured or an image.

    colour(n, e) = tint * cover(n, e) (1 + contrast * detail(n, e))

`cover`: 0.2 m a texel, period 205 m; `detail`: 1.5 cm, 31 m.
"""

import math
from dataclasses import dataclass, field
from functools import cache
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from vision.synthetic.texture import Grid, bounded, noise, pyramid, texels_a_side

DETAIL_SIZE, DETAIL_TEXEL_M = 2048, 0.015
COVER_SIZE, COVER_TEXEL_M = 1024, 0.2

# What grows on a field, and how it looks in the sun (B, G, R): the ground is dull, which is what lets painted roofs stand out.
_COVERS = np.array(
    [
        (72, 122, 116),
        (80, 134, 126),
        (62, 108, 98),
        (106, 148, 158),
        (92, 124, 144),
        (112, 152, 170),
        (70, 106, 112),
        (84, 138, 118),
    ],
    dtype=np.float64,
)
_PATH = np.array([138.0, 162.0, 176.0])
_BUSH = np.array([34.0, 62.0, 46.0])


@dataclass(frozen=True)
class Ground:
    """Level ground at `down_m`; turn_rad, shift_m: of textures; tint_bgr: factors; detail_contrast: per unit."""

    cover: Grid = field(repr=False)
    detail: Grid = field(repr=False)
    cover_texel_m: float = COVER_TEXEL_M
    down_m: float = 0.0
    turn_rad: float = 0.0
    shift_m: tuple[float, float] = (0.0, 0.0)
    tint_bgr: tuple[float, float, float] = (1.0, 1.0, 1.0)
    detail_contrast: float = 0.3

    @classmethod
    def procedural(cls, rng: np.random.Generator) -> Self:
        """Countryside with random textures and tint."""
        turn, shift = rng.uniform(-math.pi, math.pi), rng.uniform(0.0, 200.0, 2)
        tint = rng.uniform(0.92, 1.12) * rng.uniform(0.93, 1.07, 3)
        return cls(
            _cover(),
            _detail(),
            turn_rad=turn,
            shift_m=(float(shift[0]), float(shift[1])),
            tint_bgr=(float(tint[0]), float(tint[1]), float(tint[2])),
        )

    @classmethod
    def of_image(cls, image: NDArray[np.uint8], metres_per_px: float, detail_contrast: float = 0.0) -> Self:
        """An image (H, W, 3) from above, north up, mirrored on all sides."""
        side = min(image.shape[:2])
        top, left = (image.shape[0] - side) // 2, (image.shape[1] - side) // 2
        size = 1 << (side - 1).bit_length()
        square = cv2.resize(image[top : top + side, left : left + side], (size, size), interpolation=cv2.INTER_CUBIC)
        north_up = square[::-1]  # image rows run south
        eastward = np.hstack([north_up, north_up[:, ::-1]])
        mirrored = np.vstack([eastward, eastward[::-1]])
        laid = np.ascontiguousarray(np.transpose(mirrored, (1, 0, 2)), dtype=np.float32)  # s is north, t is east
        return cls(pyramid(laid), _detail(), metres_per_px * side / size, detail_contrast=detail_contrast)

    @property
    def cover_size(self) -> int:
        """Texels a side of the cover's finest level."""
        return texels_a_side(self.cover)

    @property
    def axes_n(self) -> Array:
        """Directions of the textures' s and t on the ground, rows of (2, 3)."""
        c, s = math.cos(self.turn_rad), math.sin(self.turn_rad)
        return np.array([[c, s, 0.0], [-s, c, 0.0]])


@cache
def _detail() -> Grid:
    rng = np.random.default_rng(20141)
    n = DETAIL_SIZE
    tufts = np.tanh(1.5 * noise(n, 0.6, rng, finest=6.0, coarsest=40.0))
    texture = 0.45 * noise(n, 1.0, rng) + 0.3 * noise(n, 0.2, rng) + 0.55 * tufts
    return pyramid(bounded(_stones(texture, 6000, rng)))


def _stones(texture: Grid, count: int, rng: np.random.Generator) -> Grid:
    n = len(texture)
    spots = np.zeros((n, n), dtype=np.float32)
    for s, t, radius, shade in zip(
        *rng.integers(0, n, (2, count)), _sizes(1.0, 10.0, count, rng), rng.normal(0.3, 1.2, count), strict=True
    ):
        cv2.circle(spots, (int(s), int(t)), round(radius), float(shade), -1, cv2.LINE_AA)
    return texture + spots


def _sizes(least: float, most: float, count: int, rng: np.random.Generator) -> Array:
    u = rng.random(count)
    return np.asarray(1.0 / (1.0 / least + u * (1.0 / most - 1.0 / least)))


@cache
def _cover() -> Grid:
    rng = np.random.default_rng(20142)
    n = COVER_SIZE
    owner, border = _fields(26, rng)
    colour = _COVERS[rng.integers(0, len(_COVERS), 26)][owner]
    shade = 1.0 + 0.11 * noise(n, 1.3, rng) + 0.05 * noise(n, 0.3, rng)
    colour = colour * shade[:, :, None]
    earthy = np.clip(noise(n, 1.6, rng, coarsest=200.0) - 1.0, 0.0, 1.0)[:, :, None]
    colour += earthy * (_PATH * 0.8 - colour)
    path = np.clip(2.2 - border + 0.6 * noise(n, 1.0, rng), 0.0, 1.0)[:, :, None] * (owner % 3 == 0)[:, :, None]
    colour += 0.8 * path * (_PATH - colour)
    bushes = np.zeros((n, n), dtype=np.float32)
    for s, t, radius in zip(*rng.integers(0, n, (2, 1100)), _sizes(1.0, 7.0, 1100, rng), strict=True):
        cv2.circle(bushes, (int(s), int(t)), round(radius), float(rng.uniform(0.35, 0.9)), -1, cv2.LINE_AA)
    cover = np.clip(bushes * (1.0 + 0.4 * noise(n, 0.3, rng)), 0.0, 1.0)[:, :, None]
    colour += cover * (_BUSH - colour)
    return pyramid(np.clip(colour, 0.0, 255.0).astype(np.float32))


def _fields(count: int, rng: np.random.Generator) -> tuple[NDArray[np.int64], Grid]:
    n = COVER_SIZE
    positions = rng.uniform(0, n, (count, 2))
    wander = 7.0 * np.stack([noise(n, 1.6, rng), noise(n, 1.6, rng)])
    at = (np.mgrid[:n, :n] + wander).astype(np.float32)
    nearest, second = np.full((2, n, n), np.inf, dtype=np.float32)
    owner = np.zeros((n, n), dtype=np.int64)
    for k, position in enumerate(positions.astype(np.float32)):
        d = np.abs(at - position[:, None, None]) % n
        distance = np.hypot(*np.minimum(d, n - d))
        closer = distance < nearest
        second = np.where(closer, nearest, np.minimum(second, distance))
        nearest, owner = np.where(closer, distance, nearest), np.where(closer, k, owner)
    return owner, second - nearest
