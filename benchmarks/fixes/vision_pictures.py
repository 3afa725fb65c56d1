"""Draws the images of docs/vision.md, one per stage, from a rendered pair:  python -m benchmarks.fixes.vision_pictures"""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import msgspec
import numpy as np
from numpy.typing import NDArray

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from models import so3
from models.messages import Array
from tests.vision import roofs
from vision.describe import correlation
from vision.describe.correspond import Match, correspond, sobel
from vision.describe.measure import QUANTITIES
from vision.describe.regions import Region, find_regions
from vision.describe.segment import classes, colour_table, cylinder, segment_colours, segment_seeds, valleys
from vision.describe.survey import Settings, Survey, grey, survey
from vision.image import enhance
from vision.image.check import image_flaw, pair_flaw
from vision.image.rectify import Image, rectification, rectify
from vision.show.annotate import annotate

FOLDER = Path(__file__).parents[2] / "docs/images"
INK, GOOD, BAD = "#263238", "#1565c0", "#c62828"
RIG = roofs.nadir_rig(lens=(-0.28, 0.09, 0.001, -0.001), squint_rad=0.02)
MADE = rectification(RIG)
VIEW = roofs.view(3, 25.0, rig=RIG)
LEFT, RIGHT = rectify(VIEW.left, MADE.left), rectify(VIEW.right, MADE.right)
TABLE = colour_table(classes(roofs.COLOURS))
PALETTE = np.array([(40, 40, 40), (60, 60, 220), (220, 120, 40), (70, 190, 70), (40, 190, 240), (200, 70, 190)], np.uint8)


def main() -> None:
    """All of them."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for draw in (check, rectified, enhanced, segmented, regions, corresponded, measured, epipolar):
        figure = draw()
        path = FOLDER / f"vision_{draw.__name__}.jpg"
        figure.savefig(path, dpi=80, facecolor="white", pil_kwargs={"quality": 85, "optimize": True})
        plt.close(figure)
        print(path)


def show(ax: Axes, image: Image, title: str) -> None:
    """A BGR, grey or label image without axes."""
    ax.imshow(image if image.ndim == 2 else image[..., ::-1], cmap="gray", interpolation="nearest", aspect="equal")
    ax.set_title(title, fontsize=10, color=INK)
    ax.axis("off")


def sheet(rows: int, columns: int, width: float = 12.0, height: float = 4.6) -> tuple[Figure, NDArray[Any]]:
    """An empty figure."""
    figure, axes = plt.subplots(rows, columns, figsize=(width, height), layout="constrained", squeeze=False)
    return figure, axes


def check() -> Figure:
    """Bad images and what is said of them."""
    torn, stuck = VIEW.left.copy(), VIEW.left.copy()
    torn[300:] = 128
    stuck[260:] = stuck[260]
    bright = np.clip(VIEW.left.astype(int) + 200, 0, 255).astype(np.uint8)
    images = [VIEW.left, VIEW.left // 30, bright, torn, stuck, VIEW.left[:300]]
    figure, axes = sheet(1, len(images), 14.0, 2.6)
    for ax, image in zip(axes[0], images, strict=True):
        said = image_flaw(image, RIG.left) or pair_flaw(image, VIEW.right) or "good"
        show(ax, image, said.replace(", ", ",\n"))
    return figure


def rectified() -> Figure:
    """The pair as taken and rectified, with rows across both."""
    figure, axes = sheet(2, 1, 11.0, 8.4)
    for ax, pair, title in (
        (axes[0, 0], (VIEW.left, VIEW.right), "as taken: lenses bend, the right camera squints by 1.5 degrees and rolls by 1.4"),
        (axes[1, 0], (LEFT, RIGHT), "rectified: a point stands in the same row of both images"),
    ):
        show(ax, np.hstack(pair), title)
        for row in range(40, 480, 80):
            ax.axhline(row, color="#ffee58", lw=0.7)
    return figure


def enhanced() -> Figure:
    """A dim, hazy, noisy image and what each operation makes of it."""
    rng = np.random.default_rng(1)
    noisy = np.clip(0.22 * LEFT + 60 + rng.normal(0, 2.5, LEFT.shape), 0, 255).astype(np.uint8)
    noisy[rng.random(noisy.shape[:2]) < 0.01] = 255
    half = noisy.copy()
    half[:, 320:] = np.clip(half[:, 320:] * 0.35, 0, 255)
    clean, clouded = enhance.median(noisy, 5), enhance.median(half, 5)
    figure, axes = sheet(2, 4, 13.0, 5.4)
    for ax, image, title in zip(
        axes.ravel(),
        (noisy, clean, enhance.stretch(clean), enhance.gamma(clean, 0.5),
         half, enhance.stretch(clouded), enhance.stretch_blocks(clouded), enhance.logarithm(clouded)),
        ("haze, noise, hot pixels", "median 5", "contrast stretch", "gamma 0.5",
         "one half in a cloud's shadow", "stretch of the whole", "stretch by blocks", "log"),
        strict=True,
    ):  # fmt: skip
        show(ax, image, title)
    return figure


def segmented() -> Figure:
    """Known colours, seeds, and the histogram that the seeds were cut from."""
    smooth = enhance.median(LEFT, 3)
    known, seeds = segment_colours(smooth, TABLE), segment_seeds(smooth)
    figure, axes = sheet(1, 4, 15.0, 3.4)
    show(axes[0, 0], LEFT, "rectified left image")
    show(axes[0, 1], PALETTE[known], "colours known from a map: double threshold")
    colours = np.random.default_rng(11).integers(50, 255, (256, 3)).astype(np.uint8)
    show(axes[0, 2], colours[seeds], "nothing known: seeds")
    h, s, _ = np.moveaxis(cylinder(smooth, "hsv"), 2, 0)
    histogram = np.bincount(h[s > 56].ravel() // 2, minlength=90).astype(float)
    ax = axes[0, 3]
    ax.bar(4 * np.arange(90), histogram, 4.0, color=[tuple(np.array(c)) for c in plt.get_cmap("hsv")(np.arange(90) / 90)])
    for k, valley in enumerate(valleys(histogram, circular=True)):
        ax.axvline(4 * valley, color=INK, lw=1.0, label="valleys between good peaks" if k == 0 else None)
    ax.set(yscale="log", ylim=(1, None), xlabel="hue, degrees", ylabel="pixels", title="histogram of hue")
    ax.legend(fontsize=8, loc="upper right")
    return figure


def found_regions() -> list[Region]:
    """Of the left image, by the map's colours."""
    assert MADE.left is not None
    return find_regions(LEFT, segment_colours(enhance.median(LEFT, 3), TABLE), valid=MADE.left.valid)


def regions() -> Figure:
    """Outlines, and one corner enlarged: pixels, contour, polygon, truth."""
    figure, axes = sheet(1, 2, 12.0, 4.6)
    show(axes[0, 0], LEFT, "contours (white), polygons (yellow)")
    found = found_regions()
    for region in found:
        closed = np.vstack((region.contour, region.contour[:1]))
        axes[0, 0].plot(*closed.T, color="white", lw=0.6)
        if region.corners is not None:
            axes[0, 0].plot(*np.vstack((region.corners, region.corners[:1])).T, color="#ffee00", lw=1.4)
    region = next(r for r in found if r.corners is not None and not r.touches_border)
    assert region.corners is not None
    corner = region.corners[0]
    ax = axes[0, 1]
    show(ax, LEFT, "one corner: contour points, fitted sides, true edge")
    ax.plot(*region.contour.T, "o", color="white", ms=4, label="contour, to a fraction of a pixel")
    ax.plot(*np.vstack((region.corners, region.corners[:1])).T, color="#ffee00", lw=2.0, label="polygon")
    for corners in VIEW.roofs_c:
        px = MADE.rig.left.project(corners @ (MADE.rig.R_bc.T @ RIG.R_bc).T)
        ax.plot(*np.vstack((px, px[:1])).T, "--", color="#00e5ff", lw=1.2)
    ax.plot([], [], "--", color="#00e5ff", label="truth")
    ax.set(xlim=(corner[0] - 10, corner[0] + 10), ylim=(corner[1] + 10, corner[1] - 10))
    ax.legend(fontsize=8, loc="lower left")
    return figure


def corresponded() -> Figure:
    """Edges, the strip of the right image, the coefficient along it, and the cells."""
    (match, *_) = [m for m in correspond(grey(LEFT), grey(RIGHT), found_regions(), MADE.rig) if isinstance(m, Match)]
    u0, v0, width, height = match.region.bbox
    figure, axes = sheet(1, 4, 15.0, 3.6)
    edges = sobel(grey(LEFT)), sobel(grey(RIGHT))
    show(
        axes[0, 0],
        np.clip(edges[0], 0, 400)[v0 - 15 : v0 + height + 15, u0 - 15 : u0 + width + 15],
        "Sobel edges, left: template",
    )
    strip = np.clip(edges[1], 0, 400)[v0 - 15 : v0 + height + 15, max(u0 - 60, 0) : u0 + width + 40]
    show(axes[0, 1], strip, "right: only along the same rows")
    pixels = correlation.template(match.region.mask, u0, v0, 0, 2)
    disparities = np.arange(-20, 38)
    ax = axes[0, 2]
    ax.plot(disparities, correlation.scan(*edges, pixels, -20, 37, 0), color=GOOD)
    ax.axvline(match.plane.coefficients[0], color=BAD, lw=0.9)
    ax.set(xlabel="disparity, px", title=f"correlation coefficient: {match.plane.coefficients[0]:.2f} px")
    ax = axes[0, 3]
    show(ax, LEFT, "cells: deviation from the plane, px")
    deviation = match.disparities - match.plane.at(match.points)
    dots = ax.scatter(*match.points.T, c=deviation, cmap="coolwarm", vmin=-0.3, vmax=0.3, s=60, edgecolor="k", lw=0.5)
    ax.set(xlim=(u0 - 8, u0 + width + 8), ylim=(v0 + height + 8, v0 - 8))
    figure.colorbar(dots, ax=ax, shrink=0.8)
    return figure


def errors_in_sigmas(views: int = 40) -> Array:
    """Of QUANTITIES (N, 5) over rendered views at 20 to 40 m."""
    errors = []
    turn = (MADE.rig.R_bc.T @ RIG.R_bc).T
    for seed in range(100, 100 + views):
        view = roofs.view(seed, 20.0 + seed % 3 * 10.0, rig=RIG)
        turned = roofs.View(view.left, view.right, RIG, view.landmarks, tuple(c @ turn for c in view.roofs_c), view.level)
        found = survey(view.left, view.right, MADE, Settings(colours_bgr=roofs.COLOURS))
        assert isinstance(found, Survey)
        for m in found.measured:
            k = roofs.roof_at(turned, m.region.contour, MADE.rig)
            if k is not None and not m.region.touches_border:
                mark = view.landmarks[k]
                true = (
                    np.linalg.norm(turned.roofs_c[k].mean(axis=0)),
                    mark.width_m,
                    mark.length_m,
                    mark.size_m2,
                    mark.fill_ratio,
                )
                errors.append([(getattr(m, q) - t) / m.sigma(q) for q, t in zip(QUANTITIES, true, strict=True)])
    return np.array(errors)


def measured() -> Figure:
    """The annotated image, and errors against the stated sigmas over many views."""
    found = survey(VIEW.left, VIEW.right, MADE, Settings(colours_bgr=roofs.COLOURS))
    assert isinstance(found, Survey)
    errors = errors_in_sigmas()
    figure, axes = sheet(1, 2, 15.0, 5.6)
    show(axes[0, 0], annotate(found.left, found.measured, found.unmeasured)[260:, 420:], "landfix measure -o (a part)")
    ax, x = axes[0, 1], np.linspace(-4, 4, 200)
    for k, (quantity, name) in enumerate(zip(QUANTITIES, ("distance", "width", "length", "size", "fill ratio"), strict=True)):
        column = np.clip(errors[:, k], -4, 4)
        rms = np.sqrt(np.mean(np.square(errors[:, k])))
        ax.hist(column, np.linspace(-4, 4, 33), density=True, histtype="step", lw=1.6, label=f"{name}: rms {rms:.2f}")
        assert quantity
    ax.plot(x, np.exp(-0.5 * x * x) / np.sqrt(2 * np.pi), "--", color=INK, label="what it should be")
    ax.set(xlabel="error / stated standard deviation", title=f"{len(errors)} roofs of known size, rendered")
    ax.legend(fontsize=8)
    return figure


def epipolar() -> Figure:
    """The vertical residual of regions: good calibration, wrong pitch, images not taken together."""
    pitch = msgspec.structs.replace(RIG, R_rc=so3.matrix(so3.quat_exp(np.array([0.004, 0.0, 0.0]))) @ RIG.R_rc)
    cases = (
        ("as calibrated", VIEW.right, MADE),
        ("right camera 0.23 degrees off in pitch", VIEW.right, rectification(pitch)),
        ("right image taken later", np.roll(VIEW.right, 4, axis=0), MADE),
    )
    figure, axes = sheet(1, 3, 14.0, 4.2)
    for ax, (title, right, made) in zip(axes[0], cases, strict=True):
        left, other = rectify(VIEW.left, made.left), rectify(right, made.right)
        matches = correspond(grey(left), grey(other), found_regions(), made.rig)
        show(ax, left, title)
        good = [m for m in matches if isinstance(m, Match)]
        for m in good:
            u, v = m.region.contour.mean(axis=0)
            ax.annotate("", (u, v + 12 * m.vertical_px), (u, v), arrowprops={"arrowstyle": "->", "color": "yellow", "lw": 2})
            ax.text(u, v - 10, f"{m.vertical_px:+.2f} px", color="white", fontsize=11, ha="center", weight="bold")
    return figure


if __name__ == "__main__":
    main()
