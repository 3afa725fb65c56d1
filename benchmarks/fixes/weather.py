"""What light and weather do to segmentation, and what helps: `python -m benchmarks.fixes.weather`.

Rendered views of painted roofs in eleven conditions, the map's colours known, fourteen ways to tell colours. Recognised: share
of the roofs wholly in view that one region covers (intersection over union at least 0.8). Wrong: regions an image that agree
with the description of a landmark (eq. 5.5, 75 %) and are none. The edges are always taken from the image as it came.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.tables import Table, number
from estimator.bench.views import Sample, draw
from models.maps.colours import Colour
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.describe.regions import Limits, Region, find_regions
from vision.describe.segment import Labels, Space, Tolerance, classes, colour_table, segment_colours
from vision.identify import sightings
from vision.identify.catalogue import catalogue
from vision.identify.likelihood import similarities
from vision.image import enhance
from vision.image.rectify import Image, rectification, rectify
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render
from vision.synthetic.world import Sun

COVERED, SIMILAR, LEVEL = 0.8, 0.75, 105.0
PLAIN = Conditions(psf_sigma_px=0.6)
NARROW, WIDE = Tolerance(lightness_ratio=2.2), 6.0
LOW_SUN = Sun(1.0, math.radians(18.0), 0.3)


@dataclass(frozen=True)
class Weather:
    """How an image is taken; cloud: light that its shadow leaves on one side of the image."""

    conditions: Conditions = PLAIN
    sun: Sun | None = None
    cloud: float = 1.0


@dataclass(frozen=True)
class Way:
    """How an image is prepared for its colours, and how wide the thresholds are."""

    prepare: Callable[[Image], Image] = lambda image: image
    space: Space = "hsv"
    tolerance: Tolerance = NARROW


WEATHER = {
    "as the map": Weather(),
    "-2 stops": Weather(replace(PLAIN, exposure=0.25)),
    "-1 stop": Weather(replace(PLAIN, exposure=0.5)),
    "+1 stop": Weather(replace(PLAIN, exposure=2.0)),
    "+2 stops": Weather(replace(PLAIN, exposure=4.0)),
    "haze": Weather(replace(PLAIN, haze_per_m=0.006)),
    "fog": Weather(replace(PLAIN, haze_per_m=0.015)),
    "low sun": Weather(sun=LOW_SUN),
    "cloud's shadow": Weather(cloud=0.35),
    "noise": Weather(replace(PLAIN, read_sigma=10.0, shot=0.3)),
    "evening": Weather(replace(PLAIN, cast_bgr=(0.75, 0.97, 1.2))),
}


def level(image: Image) -> Image:
    """The median brought to where the map's colours were taken."""
    return scaled(image, np.full(3, LEVEL / max(float(np.median(image[::4, ::4])), 1.0)))


def balance(image: Image) -> Image:
    """Grey world: the medians of the three channels made equal."""
    return scaled(image, LEVEL / np.maximum(np.median(image[::4, ::4].reshape(-1, 3), axis=0), 1.0))


def clear(image: Image) -> Image:
    """What haze adds to every pixel taken away: the darkest part in a hundred, as much from each channel; then the level."""
    dark = np.percentile(image[::4, ::4].reshape(-1, 3), 1.0, axis=0)
    return level(np.clip(image - 0.9 * dark, 0.0, 255.0).astype(np.uint8))


def scaled(image: Image, gain: Array) -> Image:
    return np.clip(image * gain + 0.5, 0.0, 255.0).astype(np.uint8)


WAYS = {
    "as it comes": Way(),
    "stretch": Way(enhance.stretch),
    "stretch by blocks": Way(enhance.stretch_blocks),
    "level": Way(level),
    "level and balance": Way(balance),
    "haze off, level": Way(clear),
    "Lab": Way(space="lab"),
    "HSI": Way(space="hsi"),
    "lightness free": Way(tolerance=Tolerance(lightness_ratio=WIDE)),
    "and level": Way(level, tolerance=Tolerance(lightness_ratio=WIDE)),
    "and in HSI": Way(space="hsi", tolerance=Tolerance(lightness_ratio=WIDE)),
    "and saturation wide": Way(tolerance=Tolerance(lightness_ratio=WIDE, saturation_ratio=3.5)),
    "and hue wide": Way(tolerance=Tolerance(lightness_ratio=WIDE, hue_deg=26.0)),
    "and fog off (default)": Way(enhance.unveil, tolerance=Tolerance(lightness_ratio=WIDE)),
}


def take(sample: Sample, weather: Weather, rng: np.random.Generator) -> Image:
    """The sample's left image in that weather."""
    scene = sample.scene
    world = scene.world if weather.sun is None else replace(scene.world, sun=weather.sun)
    image = render(world, scene.rig.left, *scene.rig.camera_pose(sample.p_n, sample.R_nb), weather.conditions, rng)
    if weather.cloud < 1.0:
        side = 1.0 / (1.0 + np.exp(-(np.arange(image.shape[1]) - 0.5 * image.shape[1]) / 12.0))
        image = (image * (weather.cloud + (1.0 - weather.cloud) * side)[None, :, None]).astype(np.uint8)
    return image


def regions(image: Image, near: list[Landmark], way: Way, valid: NDArray[np.uint8] | None) -> list[Region]:
    colours = tuple(sorted({m.colour_bgr for m in near if m.colour_bgr is not None}))
    labels = segment_colours(way.prepare(enhance.median(image, 3)), table(colours, way.space, way.tolerance))
    return find_regions(image, labels, Limits(most=40), valid)


@lru_cache(maxsize=64)
def table(colours: tuple[Colour, ...], space: Space, tolerance: Tolerance) -> Labels:
    return colour_table(classes(colours, space), space, tolerance)


def judge(sample: Sample, image: Image, way: Way) -> tuple[int, int, int]:
    """Roofs wholly in view, those recognised, regions that are wrong."""
    made = rectification(sample.scene.rig)
    near = list(sample.scene.map)
    found = [
        r for r in regions(rectify(image, made.left), near, way, made.left.valid if made.left else None) if not r.touches_border
    ]
    p_nc, R_nc = made.rig.camera_pose(sample.p_n, sample.R_nb)
    whole, best = 0, np.zeros(len(found))
    recognised = 0
    for mark in sample.scene.world.landmarks:
        px = made.rig.left.project((np.column_stack([mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)]) - p_nc) @ R_nc)
        if not (np.isfinite(px).all() and made.rig.left.contains(px, 8.0).all()):
            continue
        roof = np.zeros(image.shape[:2], np.uint8)
        cv2.fillPoly(roof, [px.round().astype(np.int32)], 1)
        overlap = np.array([covered(r, roof) for r in found])
        best = np.maximum(best, overlap) if found else best
        whole, recognised = whole + 1, recognised + bool((overlap >= COVERED).any())
    prior = Prior(sample.p_n, sample.prior.q_nb_wxyz, 1e-4 * np.eye(6))
    roof_d = float(np.mean([m.roof_d for m in near]))
    alien = [s for s in (sightings.from_one_camera(r, prior, made.rig, roof_d) for r in np.array(found, object)[best < 0.5]) if s]
    known = catalogue(near)
    like = similarities(alien, known, np.ones((len(alien), len(near))))
    return whole, recognised, int((like.max(axis=1) >= SIMILAR).sum()) if alien else 0


def covered(region: Region, roof: NDArray[np.uint8]) -> float:
    """Intersection over union."""
    u, v, w, h = region.bbox
    both = float((roof[v : v + h, u : u + w] * region.mask).sum())
    return both / (float(roof.sum()) + float(region.mask.sum()) - both)


def main() -> None:
    cv2.setNumThreads(1)
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("out/weather"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    samples = [draw("accuracy", "painted", args.seed, k) for k in range(args.samples)]
    counts = np.zeros((len(WAYS), len(WEATHER), 3))
    for k, sample in enumerate(samples):
        for j, weather in enumerate(WEATHER.values()):
            image = take(sample, weather, np.random.default_rng([args.seed, k, j]))
            counts[:, j] += [judge(sample, image, way) for way in WAYS.values()]
    columns = ("", *WEATHER, "mean")
    share, wrong = 100.0 * counts[..., 1] / counts[..., 0], counts[..., 2] / len(samples)
    tables = [
        Table(
            title,
            columns,
            [(name, *(number(x) for x in row), number(float(row.mean()))) for name, row in zip(WAYS, v, strict=True)],
        )
        for title, v in (("Roofs recognised [%]", share), ("Wrong regions an image", wrong))
    ]
    text = "\n".join(t.markdown() for t in tables) + f"\n{int(counts[0, 0, 0])} roofs in {len(samples)} images\n"
    print(text)
    (args.out / "weather.md").write_text(text)


if __name__ == "__main__":
    main()
