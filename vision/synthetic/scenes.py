"""Worlds from a seed: truth, map, true and calibrated rig.

    make_world(seed, spec) -> Scene(world, map, rig, rig_calibrated)

Once a world each landmark shifts by N(0, sigma_m), grows by N(0, outline_sigma_m), rises by N(0, height_sigma_m).
"""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from models.camera import StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from vision.synthetic.ground import Ground
from vision.synthetic.rigs import draw_rig, make_rig
from vision.synthetic.shapes import car, grow, house, lookalike, patch, road, tree
from vision.synthetic.world import Appearance, Solid, Sun, World

Layout = Literal["village", "grid", "lookalikes"]

_PAINTS = (
    (38, 40, 205), (205, 110, 25), (30, 190, 225), (25, 125, 235), (70, 165, 35), (170, 40, 160), (190, 190, 40), (235, 235, 235),
)  # fmt: skip
_GAP_M = 3.0  # between any two things


@dataclass(frozen=True)
class WorldSpec:
    """area_m: side; spacing_m: between buildings; painted: share in strong colours; flat: on the ground; unmapped: buildings not
    in the map; gone: mapped without building; clear_m: free radius; cars, trees, patches: per hectare. "lookalikes": one outline
    and colour, +-10 % in size, 25 m apart.
    """

    layout: Layout = "village"
    area_m: float = 300.0
    spacing_m: float = 25.0
    painted: float = 0.5
    flat: float = 0.1
    unmapped: float = 0.0
    gone: float = 0.0
    clear_m: float = 0.0
    cars: float = 10.0
    trees: float = 25.0
    patches: float = 8.0
    sigma_m: float = 0.0
    height_sigma_m: float = 0.0
    outline_sigma_m: float = 0.0
    origin: tuple[float, float, float] = (47.3977, 8.5456, 488.0)
    rig: StereoRig = field(default_factory=make_rig)


class Scene(NamedTuple):
    """The truth, and map and rig with their errors."""

    world: World
    map: LandmarkMap
    rig: StereoRig
    rig_calibrated: StereoRig


def make_world(seed: int, spec: WorldSpec | None = None, ground: Ground | None = None) -> Scene:
    """A world of the spec (default: a village with a perfect map), procedural ground by default."""
    spec = spec or WorldSpec()
    for_ground, for_layout, for_errors, for_clutter, for_rig = np.random.default_rng(seed).spawn(5)
    taken: list[tuple[float, float, float]] = []  # north, east, radius of what stands already
    streets = _streets(spec) if spec.layout == "grid" else []
    built = [_landmark(str(k + 1), position, spec, for_layout) for k, position in enumerate(_positions(spec, for_layout))]
    if spec.clear_m > 0.0:
        taken.append((0.0, 0.0, spec.clear_m))
        built = [b for b in built if math.hypot(*b[0].centre_n) > spec.clear_m + _radius(b[0].outline_n, np.array(b[0].centre_n))]
    on_map, marks, appearances, clutter = [], [], [], [Solid(o, 0.0, 0.0, appearance) for o, appearance in streets]
    for mark, appearance in built:
        taken.append((*mark.centre_n, _radius(mark.outline_n, np.array(mark.centre_n))))
        mapped, stands = for_errors.random() >= spec.unmapped, for_errors.random() >= spec.gone
        true = _err(mark, for_errors)
        if mapped:
            on_map.append(mark)
            if stands:
                marks.append(true)
                appearances.append(appearance)
        else:
            clutter.append(Solid(mark.outline_n, mark.base_d, mark.height_m, appearance))
    clutter += _clutter(spec, taken, for_clutter)
    sun = Sun(for_clutter.uniform(-math.pi, math.pi), math.radians(for_clutter.uniform(30.0, 65.0)))
    world = World(tuple(marks), tuple(appearances), tuple(clutter), ground or Ground.procedural(for_ground), sun)
    return Scene(world, LandmarkMap.from_landmarks(spec.origin, on_map), draw_rig(spec.rig, for_rig), spec.rig)


def _positions(spec: WorldSpec, rng: np.random.Generator) -> list[tuple[float, float, float]]:
    n = max(1, int(spec.area_m / spec.spacing_m))
    steps = (np.arange(n) - 0.5 * (n - 1)) * spec.spacing_m
    positions = []
    for north in steps:
        for east in steps:
            if spec.layout == "village":
                shake = rng.uniform(-0.22, 0.22, 2) * spec.spacing_m
                positions.append((north + shake[0], east + shake[1], rng.uniform(0.0, math.pi)))
            elif spec.layout == "lookalikes":
                shake = rng.uniform(-0.06, 0.06, 2) * spec.spacing_m
                positions.append((north + shake[0], east + shake[1], rng.normal(0.0, 0.05)))
            else:
                positions.append((north + rng.normal(0.0, 0.4), east + rng.normal(0.0, 0.8), rng.integers(2) * 0.5 * math.pi))
    return positions


def _streets(spec: WorldSpec) -> list[tuple[Array, Appearance]]:
    half, every = 0.5 * spec.area_m, 2.0 * spec.spacing_m
    lines = np.arange(-half, half + 1.0, every)
    roads = []
    for line in lines:
        roads += road((line, -half), (line, half)) + road((-half, line), (half, line))
    return roads


def _landmark(
    name: str, position: tuple[float, float, float], spec: WorldSpec, rng: np.random.Generator
) -> tuple[Landmark, Appearance]:
    if spec.layout == "lookalikes":
        outline, height, paint = lookalike(rng), 4.0, _PAINTS[0]
        painted, flat = spec.painted > 0.0, False
    else:
        outline, height = house(rng, 0.62 * spec.spacing_m)
        paint = _PAINTS[rng.integers(len(_PAINTS))]
        painted, flat = rng.random() < spec.painted, rng.random() < spec.flat
    c, s = math.cos(position[2]), math.sin(position[2])
    outline = outline @ np.array([[c, s], [-s, c]]) + position[:2]
    mark = Landmark.of(
        name,
        outline,
        0.0,
        0.0 if flat else height,
        paint if painted or flat else None,
        spec.sigma_m,
        spec.height_sigma_m,
        spec.outline_sigma_m,
    )
    return mark, _painted(paint, rng) if painted or flat else _pale(rng)


def _painted(paint: tuple[int, int, int], rng: np.random.Generator) -> Appearance:
    b, g, r = (np.array(paint) * rng.uniform(0.92, 1.05) * rng.uniform(0.96, 1.04, 3)).tolist()
    return Appearance((b, g, r), _wall(rng), "paint", rng.uniform(0.03, 0.08), rng.uniform(0.0, 0.05))


def _pale(rng: np.random.Generator) -> Appearance:
    grey, brown = np.array([122.0, 126.0, 128.0]), np.array([84.0, 102.0, 132.0])
    b, g, r = ((grey + rng.random() * (brown - grey)) * rng.uniform(0.75, 1.2)).tolist()
    texture = str(rng.choice(["shingles", "shingles", "gravel", "metal"]))
    ridge = 0.0 if texture == "gravel" else rng.uniform(0.0, 0.12)
    return Appearance((b, g, r), _wall(rng), texture, rng.uniform(0.08, 0.16), ridge)


def _wall(rng: np.random.Generator) -> tuple[float, float, float]:
    b, g, r = (np.array([158.0, 172.0, 180.0]) * rng.uniform(0.7, 1.15) * rng.uniform(0.93, 1.07, 3)).tolist()
    return b, g, r


def _err(mark: Landmark, rng: np.random.Generator) -> Landmark:
    north, east, growth, rise = rng.standard_normal(4)
    outline = grow(mark.outline_n, growth * mark.outline_sigma_m) + mark.sigma_m * np.array([north, east])
    height, base = mark.height_m + rise * mark.height_sigma_m, mark.base_d
    if mark.height_m == 0.0:  # painted on the ground, which is lower or higher than mapped
        height, base = 0.0, mark.base_d - rise * mark.height_sigma_m
    return Landmark.of(
        mark.id, outline, base, max(height, 0.0), mark.colour_bgr, mark.sigma_m, mark.height_sigma_m, mark.outline_sigma_m
    )


def _clutter(spec: WorldSpec, taken: list[tuple[float, float, float]], rng: np.random.Generator) -> list[Solid]:
    hectares = spec.area_m**2 * 1e-4
    solids = []
    for make, per_hectare in ((car, spec.cars), (tree, spec.trees), (patch, spec.patches)):
        for _ in range(rng.poisson(per_hectare * hectares)):
            solid = make(rng)
            radius = _radius(solid.outline_n, np.zeros(2))
            for _ in range(20):
                position = rng.uniform(-0.5 * spec.area_m, 0.5 * spec.area_m, 2)
                if all(math.hypot(position[0] - n, position[1] - e) > radius + r + _GAP_M for n, e, r in taken):
                    taken.append((float(position[0]), float(position[1]), radius))
                    solids.append(Solid(solid.outline_n + position, solid.base_d, solid.height_m, solid.appearance))
                    break
    return solids


def _radius(outline_n: Array, centre_n: Array) -> float:
    return float(np.hypot(*(outline_n - centre_n).T).max())
