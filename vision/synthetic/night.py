"""The world by night for a thermal camera: warmth, no shadows or colours."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from vision.synthetic.camera_effects import Image
from vision.synthetic.faces import SKY
from vision.synthetic.world import Appearance, Solid, Sun, World

_GROUND: Final = 110.0  # level of the ground in the middle
_COLD, _HEATED, _WALL, _THING = (0.5, 0.8), (1.25, 1.8), (1.05, 1.25), (0.6, 1.5)  # levels relative to the ground's
_HEATED_SHARE: Final = 0.4
_SMOOTH: Final = 0.35  # of the ground's daylight contrast: grass is nearly as warm as stones
_NO_SUN: Final = Sun(ambient=1.0)
_ZERO: Final = 7000  # counts of a bolometer at no light
_COUNTS: Final = 4  # a level and channel


def night(world: World, rng: np.random.Generator) -> World:
    """The world's warmth, drawn roof by roof, in three equal channels."""
    appearances = tuple(_roof(appearance, rng) for appearance in world.appearances)
    clutter = tuple(Solid(s.outline_n, s.base_d, s.height_m, _thing(s.appearance, rng)) for s in world.clutter)
    ground = replace(world.ground, detail_contrast=_SMOOTH * world.ground.detail_contrast)
    return World(world.landmarks, appearances, clutter, ground, _NO_SUN)


def counts(image: Image) -> NDArray[np.uint16]:
    """14 bits in 16 (h, w) of a rendered image (h, w, 3)."""
    return np.asarray(_ZERO + _COUNTS * image.sum(axis=2, dtype=np.uint16), dtype=np.uint16)


def _roof(appearance: Appearance, rng: np.random.Generator) -> Appearance:
    level = rng.uniform(*(_HEATED if rng.random() < _HEATED_SHARE else _COLD))
    return replace(
        appearance, roof_bgr=_warmth(level), wall_bgr=_wall(rng.uniform(*_WALL)), contrast=0.5 * appearance.contrast, ridge=0.0
    )


def _thing(appearance: Appearance, rng: np.random.Generator) -> Appearance:
    level = rng.uniform(*_THING)
    return replace(appearance, roof_bgr=_warmth(level), wall_bgr=_wall(level), contrast=0.5 * appearance.contrast)


def _wall(level: float) -> tuple[float, float, float]:
    return _warmth(level / SKY)


def _warmth(level: float) -> tuple[float, float, float]:
    return (_GROUND * level,) * 3
