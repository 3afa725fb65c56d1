"""Upright prisms on level ground under one sun; a Solid is a landmark's body or clutter."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.maps import outline as polygon
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.synthetic.ground import Ground
from vision.synthetic.texture import SURFACES

Bgr = tuple[float, float, float]


@dataclass(frozen=True)
class Appearance:
    """Sunlit colours (0..255), roof texture (texture.SURFACES); contrast: per unit; ridge: lighter half of a gable."""

    roof_bgr: Bgr
    wall_bgr: Bgr = (150.0, 160.0, 165.0)
    texture: str = "paint"
    contrast: float = 0.03
    ridge: float = 0.0
    wall_texture: str = "wall"
    wall_contrast: float = 0.25


@dataclass(frozen=True)
class Solid:
    """An upright prism: outline_n (K, 2) north, east, anticlockwise from above."""

    outline_n: Array
    base_d: float
    height_m: float
    appearance: Appearance


@dataclass(frozen=True)
class Sun:
    """azimuth from north over east, elevation; ambient: sky's share of light."""

    azimuth_rad: float = math.radians(160.0)
    elevation_rad: float = math.radians(48.0)
    ambient: float = 0.4

    @property
    def direction_n(self) -> Array:
        """Unit vector towards the sun, NED."""
        c = math.cos(self.elevation_rad)
        return np.array([c * math.cos(self.azimuth_rad), c * math.sin(self.azimuth_rad), -math.sin(self.elevation_rad)])

    @property
    def shadow(self) -> float:
        """Light in a shadow on level ground, as a share of the light beside it."""
        return self.ambient / (self.ambient + (1.0 - self.ambient) * math.sin(self.elevation_rad))


@dataclass(frozen=True)
class Columns:
    """N solids: vertices (V, 2) and offsets (N + 1,), one row each in the others."""

    vertices: Array
    offsets: NDArray[np.int64]
    base_d: Array
    height_m: Array
    centre_n: Array
    radius_m: Array
    roof_bgr: Array
    wall_bgr: Array
    textures: NDArray[np.int64]  # (N, 2) of roof and wall
    contrasts: Array  # (N, 2)
    ridge: Array
    orientation_rad: Array  # long side, from north to east


@dataclass(frozen=True, eq=False)
class World:
    """A label is the landmark's index, then clutter."""

    landmarks: tuple[Landmark, ...]
    appearances: tuple[Appearance, ...]
    clutter: tuple[Solid, ...]
    ground: Ground
    sun: Sun = field(default_factory=Sun)

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """The landmarks' bodies, then the clutter."""
        bodies = (
            Solid(mark.outline_n, mark.base_d, mark.height_m, appearance)
            for mark, appearance in zip(self.landmarks, self.appearances, strict=True)
        )
        return (*bodies, *self.clutter)

    @cached_property
    def columns(self) -> Columns:
        """All solids for the kernels."""
        solids = self.solids
        outlines = [np.ascontiguousarray(_anticlockwise(s.outline_n)) for s in solids]
        offsets = np.concatenate(([0], np.cumsum([len(o) for o in outlines], dtype=np.int64)))
        vertices = np.concatenate([np.empty((0, 2)), *outlines])
        described = polygon.describe(vertices, offsets) if solids else np.empty((0, 8))
        centres = np.array([0.5 * (o.min(axis=0) + o.max(axis=0)) for o in outlines]).reshape(-1, 2)
        return Columns(
            vertices=vertices,
            offsets=offsets,
            base_d=np.array([s.base_d for s in solids], dtype=np.float64),
            height_m=np.array([s.height_m for s in solids], dtype=np.float64),
            centre_n=centres,
            radius_m=np.array([np.hypot(*(o - c).T).max() for o, c in zip(outlines, centres, strict=True)], dtype=np.float64),
            roof_bgr=np.array([s.appearance.roof_bgr for s in solids], dtype=np.float64).reshape(-1, 3),
            wall_bgr=np.array([s.appearance.wall_bgr for s in solids], dtype=np.float64).reshape(-1, 3),
            textures=np.array(
                [(SURFACES.index(s.appearance.texture), SURFACES.index(s.appearance.wall_texture)) for s in solids],
                dtype=np.int64,
            ).reshape(-1, 2),
            contrasts=np.array([(s.appearance.contrast, s.appearance.wall_contrast) for s in solids], dtype=np.float64).reshape(
                -1, 2
            ),
            ridge=np.array([s.appearance.ridge for s in solids], dtype=np.float64),
            orientation_rad=np.ascontiguousarray(described[:, polygon.ORIENTATION]),
        )


def _anticlockwise(outline_n: Array) -> Array:
    return outline_n if polygon.area(outline_n) >= 0.0 else outline_n[::-1]
