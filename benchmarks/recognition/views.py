"""Samples for the thesis' four experiments.

draw(experiment, roof, seed, number) -> Sample
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.recognition.partly_seen import cut, hide, shares, whole
from models import so3
from models.camera import CameraModel
from models.maps import colours
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from vision.image.rectify import Image
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render, render_pair
from vision.synthetic.scenes import Scene, WorldSpec, make_world
from vision.synthetic.shapes import rectangle
from vision.synthetic.world import Appearance, Solid, Sun, World

Experiment: TypeAlias = Literal["accuracy", "size", "partial", "description"]
Roof: TypeAlias = Literal["painted", "pale"]

EXPERIMENTS: Final[tuple[Experiment, ...]] = ("accuracy", "size", "partial", "description")
ROOFS: Final[tuple[Roof, ...]] = ("painted", "pale")
PARTLY: Final = (0.3, 0.7)  # share of a roof that is seen in the experiment "partial"
PRIOR_SIGMA: Final = np.array([3.0, 3.0, 2.0, *np.radians([0.5, 0.5, 2.0])])  # m, rad: some minutes after the last fix

_SPEC: Final = WorldSpec(area_m=150.0, unmapped=0.2, gone=0.05, sigma_m=0.3, height_sigma_m=0.2, outline_sigma_m=0.1)
_WORDS: Final = ("firebrick", "royalblue", "gold", "darkorange", "green", "purple", "turquoise", "white")
_SIZES: Final = (0.7, 0.84, 1.0, 1.19, 1.4)  # of one roof, each step a factor of 2^(1/4)
_SAME_M: Final = (11.0, 7.5)  # length and width of size 1
_HEIGHTS_M: Final = {"accuracy": (45.0, 80.0), "size": (45.0, 80.0), "partial": (35.0, 60.0), "description": (45.0, 80.0)}
_LEAST: Final = 2  # landmarks of the map that are seen well enough: one alone may always be something else
_WAY_SIGMA_M: Final = np.array([1.0, 1.0, 0.2])  # from a pair to the next
_TURN_SIGMA_RAD: Final = math.radians(0.7)
_SLIP_SIGMA: Final = np.array([0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-3])  # of odometry between them
_POSES: Final = 8  # tried in a world
_EDGE_PX: Final = 6.0  # a roof that is whole keeps this distance from the image's border
_REFERENCE: Final = CameraModel(256, 256, 600.0, 600.0, 127.5, 127.5)


@dataclass(frozen=True)
class Reference:
    """The landmark from above on another day."""

    image: Image
    mask: NDArray[np.uint8]
    centre_px: Array


@dataclass(frozen=True)
class Sample:
    """One sample: scene: truth, map, rig with errors; seen: visible share."""

    numbers: tuple[int, ...]
    scene: Scene
    left: Image
    right: Image
    p_n: Array
    R_nb: Array
    prior: Prior
    target: str
    seen: float
    reference: Reference | None

    @cached_property
    def next(self) -> "Sample":
        """The next pair; drawn once, for all callers."""
        return later(self)


def draw(experiment: Experiment, roof: Roof, seed: int, number: int, attempt: int = 0) -> Sample:
    """Sample `number`, redrawn until it fits the experiment."""
    numbers = (seed, EXPERIMENTS.index(experiment), ROOFS.index(roof), number, attempt)
    rng = np.random.default_rng(numbers)
    scene, p_n, R_nb, seen = _shown(experiment, roof, rng)
    target = str(rng.choice(sorted(seen)))
    left, right = render_pair(scene.world, scene.rig, p_n, R_nb, _conditions(rng), rng)
    reference = None if experiment == "description" else _reference(scene.world, target, -float(p_n[2]), rng)
    return Sample(numbers, scene, left, right, p_n, R_nb, _prior(p_n, R_nb, rng), target, seen[target], reference)


def later(sample: Sample) -> Sample:
    """The next pair, farther on."""
    numbers = (*sample.numbers, 1)
    rng = np.random.default_rng(numbers)
    way, slip = rng.normal(size=3) * _WAY_SIGMA_M, rng.normal(size=6) * _SLIP_SIGMA
    turn = so3.quat_exp(rng.normal(size=3) * _TURN_SIGMA_RAD)
    p_n, R_nb = sample.p_n + way, so3.matrix(turn) @ sample.R_nb
    left, right = render_pair(sample.scene.world, sample.scene.rig, p_n, R_nb, _conditions(rng), rng)
    q = so3.multiply(so3.quat_exp(slip[3:]), so3.multiply(turn, sample.prior.q_nb_wxyz))
    prior = Prior(sample.prior.p_n + way + slip[:3], so3.normalise(q), sample.prior.covariance + np.diag(_SLIP_SIGMA**2))
    return replace(sample, numbers=numbers, left=left, right=right, p_n=p_n, R_nb=R_nb, prior=prior)


def _shown(experiment: Experiment, roof: Roof, rng: np.random.Generator) -> tuple[Scene, Array, Array, dict[str, float]]:
    while True:
        world = _scene(experiment, roof, rng)
        for _ in range(_POSES):
            p_n, R_nb = _pose(experiment, rng)
            shown = _partly(world, p_n, R_nb, rng) if experiment == "partial" else _whole(world, p_n, R_nb)
            if shown is not None:
                return shown[0], p_n, R_nb, shown[1]


def _scene(experiment: Experiment, roof: Roof, rng: np.random.Generator) -> Scene:
    spec = replace(_SPEC, painted=float(roof == "painted"), flat=0.1 if roof == "painted" else 0.0)
    if experiment == "description":
        spec = replace(spec, sigma_m=0.5, height_sigma_m=0.5, outline_sigma_m=0.2)  # what a person writes down is less exact
        return _described(make_world(int(rng.integers(1 << 31)), spec))
    scene = make_world(int(rng.integers(1 << 31)), spec)
    return _one_texture(scene, rng) if experiment == "size" else _measured_colours(scene, rng)


def _measured_colours(scene: Scene, rng: np.random.Generator) -> Scene:
    appearances = {m.id: appearance for m, appearance in zip(scene.world.landmarks, scene.world.appearances, strict=True)}
    return scene._replace(map=_recoloured(scene.map, {k: _noted(appearance, rng) for k, appearance in appearances.items()}))


def _described(scene: Scene) -> Scene:
    words = [w for w in map(colours.parse, _WORDS) if w is not None]
    named = {
        m.id: min(words, key=lambda w, c=m.colour_bgr: math.dist(w, c))  # type: ignore[misc]
        for m in scene.map
        if m.colour_bgr is not None
    }
    return scene._replace(map=_recoloured(scene.map, named))


def _noted(appearance: Appearance, rng: np.random.Generator) -> colours.Colour:
    b, g, r = np.clip(np.array(appearance.roof_bgr) * rng.normal(1.0, 0.04, 3), 0.0, 255.0).round().astype(int).tolist()
    return b, g, r


def _recoloured(the_map: LandmarkMap, colour_of: dict[str, colours.Colour]) -> LandmarkMap:
    marks = [_with(m, m.outline_n, colour_of.get(m.id, m.colour_bgr)) for m in the_map]
    return LandmarkMap.from_landmarks(the_map.origin, marks)


def _with(m: Landmark, outline_n: Array, colour: colours.Colour | None) -> Landmark:
    return Landmark.of(m.id, outline_n, m.base_d, m.height_m, colour, m.sigma_m, m.height_sigma_m, m.outline_sigma_m)


def _one_texture(scene: Scene, rng: np.random.Generator) -> Scene:
    appearance = scene.world.appearances[int(rng.integers(len(scene.world.appearances)))]
    colour = _noted(appearance, rng)
    mapped = {m.id: m for m in scene.map}
    mapped_marks, marks, clutter = [], [], list(scene.world.clutter)
    for true in scene.world.landmarks:
        old = mapped[true.id]
        centre, shift = np.array(old.centre_n), np.array(true.centre_n) - np.array(old.centre_n)
        turn, size = rng.uniform(0.0, math.pi), float(rng.choice(_SIZES))
        c, s = math.cos(turn), math.sin(turn)
        outline = size * rectangle(*_SAME_M) @ np.array([[c, s], [-s, c]]) + centre
        if rng.random() < _SPEC.unmapped:
            clutter.append(Solid(outline + shift, true.base_d, true.height_m, appearance))
        else:
            mapped_marks.append(_with(old, outline, colour))
            marks.append(_with(true, outline + shift, colour))
    world = replace(scene.world, landmarks=tuple(marks), appearances=(appearance,) * len(marks), clutter=tuple(clutter))
    return scene._replace(world=world, map=LandmarkMap.from_landmarks(scene.map.origin, mapped_marks))


def _pose(experiment: Experiment, rng: np.random.Generator) -> tuple[Array, Array]:
    roll, pitch = rng.normal(0.0, math.radians(3.0), 2)
    p_n = np.array([*rng.uniform(-25.0, 25.0, 2), -rng.uniform(*_HEIGHTS_M[experiment])])
    return p_n, so3.matrix(so3.from_euler(float(roll), float(pitch), float(rng.uniform(-math.pi, math.pi))))


def _whole(scene: Scene, p_n: Array, R_nb: Array) -> tuple[Scene, dict[str, float]] | None:
    seen = {m.id: 1.0 for m in scene.world.landmarks if whole(scene.rig, p_n, R_nb, m, _EDGE_PX)}
    return (scene, seen) if len(seen) >= _LEAST else None


def _partly(scene: Scene, p_n: Array, R_nb: Array, rng: np.random.Generator) -> tuple[Scene, dict[str, float]] | None:
    if rng.random() < 0.5:
        scene = scene._replace(world=hide(scene.world, scene.rig, p_n, R_nb, rng))
    elif sum(cut(scene.rig, p_n, R_nb, m) for m in scene.world.landmarks) < _LEAST:
        return None  # cheaper to find out than the shares
    share = shares(scene.world, scene.rig, p_n, R_nb)
    seen = {name: s for name, s in share.items() if PARTLY[0] <= s <= PARTLY[1]}
    if len(seen) < _LEAST:
        return None
    return _without(scene, {name for name, s in share.items() if s > PARTLY[1]}), seen


def _without(scene: Scene, names: set[str]) -> Scene:
    world = scene.world
    kept = [(m, appearance) for m, appearance in zip(world.landmarks, world.appearances, strict=True) if m.id not in names]
    left = World(tuple(m for m, _ in kept), tuple(appearance for _, appearance in kept), world.clutter, world.ground, world.sun)
    mapped_marks = [m for m in scene.map if m.id not in names]
    return scene._replace(world=left, map=LandmarkMap.from_landmarks(scene.map.origin, mapped_marks))


def _conditions(rng: np.random.Generator) -> Conditions:
    angle, way = rng.uniform(0.0, math.pi), rng.uniform(0.0, 1.5)
    cast = tuple(rng.uniform(0.96, 1.04, 3).tolist())
    return Conditions(
        exposure=rng.uniform(0.75, 1.2),
        cast_bgr=(cast[0], cast[1], cast[2]),
        haze_per_m=3e-4,
        psf_sigma_px=rng.uniform(0.45, 0.7),
        blur_px=(way * math.cos(angle), way * math.sin(angle)),
        read_sigma=rng.uniform(1.0, 2.5),
    )


def _reference(world: World, target: str, height_m: float, rng: np.random.Generator) -> Reference:
    mark = next(m for m in world.landmarks if m.id == target)
    hour = Sun(rng.uniform(-math.pi, math.pi), math.radians(rng.uniform(30.0, 65.0)))
    p_nc = np.array([*mark.centre_n, -height_m * rng.uniform(0.8, 1.25)])
    R_nc = so3.matrix(so3.from_euler(0.0, 0.0, float(rng.uniform(-math.pi, math.pi))))
    image = render(replace(world, sun=hour), _REFERENCE, p_nc, R_nc, _conditions(rng), rng)
    roof = np.column_stack([mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)])
    corners = _REFERENCE.project((roof - p_nc) @ R_nc)
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [corners.round().astype(np.int32)], 255)
    centre = _REFERENCE.project(((np.array([*mark.centre_n, mark.roof_d]) - p_nc) @ R_nc)[None])[0]
    return Reference(image, mask, centre)


def _prior(p_n: Array, R_nb: Array, rng: np.random.Generator) -> Prior:
    error = rng.normal(size=6) * PRIOR_SIGMA
    q = so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(np.ascontiguousarray(R_nb)))
    return Prior(p_n - error[:3], so3.normalise(q), np.diag(PRIOR_SIGMA**2))
