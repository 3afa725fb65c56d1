"""Outlines and bodies about (0, 0)."""

import math

import numpy as np

from models.messages import Array
from vision.synthetic.world import Appearance, Solid

_CARS = ((40, 40, 45), (225, 225, 225), (150, 150, 155), (35, 35, 170), (140, 70, 30), (60, 60, 60), (30, 160, 200))
_ASPHALT = Appearance((92.0, 92.0, 94.0), texture="gravel", contrast=0.06)
_LINE = Appearance((215.0, 218.0, 220.0), texture="gravel", contrast=0.06)
_ROAD_M, _LINE_M = 6.5, 0.15


def rectangle(length_m: float, width_m: float) -> Array:
    """Corners anticlockwise seen from above; the length runs north."""
    return 0.5 * np.array([[length_m, width_m], [length_m, -width_m], [-length_m, -width_m], [-length_m, width_m]])


def house(rng: np.random.Generator, longest_m: float) -> tuple[Array, float]:
    """Outline and height of a building: mostly rectangles, also L, T and octagons."""
    length = rng.uniform(0.5, 1.0) * longest_m
    width = length * rng.uniform(0.45, 0.9)
    plan = rng.choice(["rectangle", "L", "T", "octagon"], p=[0.6, 0.22, 0.1, 0.08])
    a, b = 0.5 * length, 0.5 * width
    if plan == "rectangle":
        outline = rectangle(length, width)
    elif plan == "L":
        n, e = a * rng.uniform(-0.2, 0.4), b * rng.uniform(-0.3, 0.3)
        outline = np.array([[a, b], [a, e], [n, e], [n, -b], [-a, -b], [-a, b]])
    elif plan == "T":
        w, n = 0.5 * b * rng.uniform(0.8, 1.2), a * rng.uniform(0.1, 0.5)
        outline = np.array([[a, b], [a, -b], [n, -b], [n, -w], [-a, -w], [-a, w], [n, w], [n, b]])
    else:
        outline = _regular(8, b)
    return outline, float(rng.uniform(2.8, 8.0))


def lookalike(rng: np.random.Generator) -> Array:
    """A rectangle of 12 m by 8 m, either side +-10 %."""
    return rectangle(12.0 * rng.uniform(0.9, 1.1), 8.0 * rng.uniform(0.9, 1.1))


def grow(outline_n: Array, by_m: float) -> Array:
    """Edges moved outwards by by_m: corners along bisectors by by_m / sin(half angle)."""
    before, after = outline_n - np.roll(outline_n, 1, axis=0), np.roll(outline_n, -1, axis=0) - outline_n
    n0, n1 = _outward(before), _outward(after)
    bisector = n0 + n1
    grown: Array = outline_n + 2.0 * by_m * bisector / np.sum(bisector**2, axis=1, keepdims=True)
    return grown


def _outward(edge: Array) -> Array:
    return np.column_stack([-edge[:, 1], edge[:, 0]]) / np.hypot(edge[:, 0], edge[:, 1])[:, None]


def car(rng: np.random.Generator) -> Solid:
    """A box 4.3 m by 1.8 m by 1.4 m, darker below."""
    b, g, r = (float(x) for x in _CARS[rng.integers(len(_CARS))])
    appearance = Appearance((b, g, r), (0.6 * b, 0.6 * g, 0.6 * r), "paint", 0.05, 0.0, "paint", 0.05)
    return Solid(_turned(rectangle(4.3 * rng.uniform(0.9, 1.15), 1.8), rng), 0.0, 1.4, appearance)


def tree(rng: np.random.Generator) -> Solid:
    """A crown of 2 to 7 m across: ten ragged sides, leaves all over."""
    radius, height = rng.uniform(1.0, 3.5), rng.uniform(2.5, 7.0)
    outline = _regular(10, radius) * rng.uniform(0.82, 1.1, (10, 1))
    b, g, r = (np.array([36.0, 72.0, 50.0]) * rng.uniform(0.7, 1.35) * rng.uniform(0.9, 1.1, 3)).tolist()
    return Solid(outline, 0.0, height, Appearance((b, g, r), (0.8 * b, 0.8 * g, 0.8 * r), "leaves", 0.3, 0.0, "leaves", 0.3))


def patch(rng: np.random.Generator) -> Solid:
    """Something flat in any colour: a tarpaulin, a bed of flowers, a concrete slab, a puddle."""
    b, g, r = rng.uniform(30.0, 220.0, 3).tolist()
    size = rng.uniform(1.0, 6.0)
    outline = rectangle(size, size * rng.uniform(0.4, 1.0)) if rng.random() < 0.6 else _regular(9, 0.5 * size)
    return Solid(_turned(outline, rng), 0.0, 0.0, Appearance((b, g, r), texture="gravel", contrast=rng.uniform(0.03, 0.15)))


def road(start: tuple[float, float], end: tuple[float, float]) -> list[tuple[Array, Appearance]]:
    """Asphalt from start to end (north, east) and dashes of 3 m along its middle."""
    along = np.subtract(end, start)
    length = float(np.hypot(*along))
    along = along / length
    axes = np.array([along, [-along[1], along[0]]])
    strips = [(rectangle(length, _ROAD_M) @ axes + 0.5 * np.add(start, end), _ASPHALT)]
    dashes = np.arange(4.0, length - 4.0, 9.0)
    return strips + [(rectangle(3.0, _LINE_M) @ axes + start + d * along, _LINE) for d in dashes]


def _regular(corners: int, radius_m: float) -> Array:
    angle = -2.0 * math.pi * np.arange(corners) / corners
    return np.asarray(radius_m * np.column_stack([np.cos(angle), np.sin(angle)]))


def _turned(outline_n: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(0.0, math.pi)
    c, s = math.cos(angle), math.sin(angle)
    turned: Array = outline_n @ np.array([[c, s], [-s, c]])
    return turned
