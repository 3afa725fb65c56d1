"""The images of docs/map.md, from a rendered village: `python -m benchmarks.maps.pictures`.

Prints the figures that the text quotes.
"""

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.flights.tasks import ROOT
from estimator.tools.maps.ambiguity import marked
from estimator.tools.maps.draw import draw
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.so3 import from_euler, matrix
from vision.show.overlay import draw_overlay, outline_residuals
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render
from vision.synthetic.rigs import make_rig
from vision.synthetic.scenes import Scene, WorldSpec, make_world

IMAGES = ROOT / "docs" / "images"
BLUE, VERMILLION, GREY = "#0072B2", "#D55E00", "#b5b0a4"
OFF_M = 0.3
NAMES = {"85": "blue hall", "64": "red barn", "46": "mill", "47": "pad", "59": "school"}


def described() -> Figure:
    """Outlines, their least rectangles, and the numbers a landmark is recognised by."""
    ell = [(0.0, 0.0), (0.0, 14.0), (6.0, 14.0), (6.0, 6.0), (16.0, 6.0), (16.0, 0.0)]
    t = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False) + np.pi / 8
    octagon = 7.0 * np.column_stack((np.cos(t), -np.sin(t)))
    c, s = np.cos(0.5), np.sin(0.5)
    barn = np.array([(-10.0, -5.0), (-10.0, 5.0), (10.0, 5.0), (10.0, -5.0)]) @ np.array([[c, s], [-s, c]])
    figure = Figure(figsize=(11.0, 4.2), layout="constrained", dpi=120)
    for axes, (name, points) in zip(
        figure.subplots(1, 3), (("barn", barn), ("L", np.array(ell)), ("tank", octagon)), strict=True
    ):
        _describe(axes, Landmark.of(name, points))
    return figure


def _describe(axes: Axes, landmark: Landmark) -> None:
    outline = landmark.outline_n
    axes.fill(outline[:, 1], outline[:, 0], facecolor=GREY, edgecolor="black", linewidth=1.0)
    along = np.array([np.cos(landmark.orientation_rad), np.sin(landmark.orientation_rad)])
    across = np.array([-along[1], along[0]])
    u, v = outline @ along, outline @ across
    corners = np.array(
        [a * along + b * across for a, b in ((u.min(), v.min()), (u.max(), v.min()), (u.max(), v.max()), (u.min(), v.max()))]
    )
    closed = np.vstack((corners, corners[:1]))
    axes.plot(closed[:, 1], closed[:, 0], "--", color=BLUE, linewidth=1.5)
    middle = corners.mean(axis=0)
    tip = middle + 0.5 * landmark.length_m * along
    axes.annotate(
        "",
        xy=(tip[1], tip[0]),
        xytext=(middle[1], middle[0]),
        arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 2.0},
    )
    axes.set_title(
        f"{landmark.size_m2:.0f} m², {landmark.width_m:.1f} x {landmark.length_m:.1f} m\n"
        f"fill ratio {landmark.fill_ratio:.2f}, orientation {np.degrees(landmark.orientation_rad):.0f}°",
        fontsize=11,
    )
    axes.set(aspect="equal", xlabel="east [m]", ylabel="north [m]")
    axes.margins(0.15)


def overlays(scene: Scene, village: LandmarkMap) -> Array:
    """The same image with the map drawn from the true pose and from one beside it."""
    p_n, R_nb = np.array([-60.0, 10.0, -50.0]), matrix(from_euler(0.1, 0.05, 0.2))
    p_nc, R_nc = scene.rig.camera_pose(p_n, R_nb)
    image = render(scene.world, scene.rig.left, p_nc, R_nc, Conditions(), np.random.default_rng(0))
    landmarks = village.near(p_n[0], p_n[1], 150.0)
    panels = []
    for title, off in (("true pose", 0.0), (f"pose {OFF_M} m too far east", OFF_M)):
        place = p_nc + np.array([0.0, off, 0.0])
        residuals = [r for r in outline_residuals(image, scene.rig.left, place, R_nc, landmarks) if len(r.px) > 25]
        spread = float(np.median([r.spread_px for r in residuals]))
        print(f"{title}: median residual {spread:.2f} px over {len(residuals)} landmarks")
        panels.append(
            draw_overlay(
                image,
                scene.rig.left,
                place,
                R_nc,
                landmarks,
                {r.id for r in residuals},
                residuals,
                [f"{title}: residual {spread:.2f} px"],
            )
        )
    return np.hstack(panels)


def terraces_and_village() -> LandmarkMap:
    """Three rows of equal houses north of a village in which two look alike."""
    rng = np.random.default_rng(0)
    paints = (38, 40, 205), (205, 110, 25), (30, 190, 225), (70, 165, 35), (170, 40, 160), (235, 235, 235)
    rows = [_box(f"t{r}{c}", (70.0 + 25.0 * r, 24.0 * c), (14.0, 9.0), (60, 70, 150)) for r in range(3) for c in range(8)]
    others = [
        _box(f"v{k}", (42.0 * (k // 7) + rng.uniform(-8, 8), 26.0 * (k % 7) + rng.uniform(-6, 6)),
             (rng.uniform(8, 20), rng.uniform(6, 10)), paints[k % 6])
        for k in range(14)
    ]  # fmt: skip
    return LandmarkMap.from_landmarks((47.3977, 8.5456, 488.0), [*rows, *others])


def _box(name: str, place: tuple[float, float], sides: tuple[float, float], colour: tuple[int, int, int]) -> Landmark:
    corners = 0.5 * np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * sides
    return Landmark.of(name, corners + place, 0.0, 4.0, colour, 0.5)


def main() -> None:
    """Draws them all."""
    described().savefig(IMAGES / "map_description.png")
    rig = make_rig(pitch_deg=-50.0, exact=True)
    scene = make_world(3, WorldSpec(area_m=260.0, painted=0.8, rig=rig))
    village = LandmarkMap.from_landmarks(scene.map.origin, map(_named, scene.map))
    draw(village, "village.geojson").savefig(IMAGES / "map_show.png")
    rows = terraces_and_village()
    draw(rows, "terraces.geojson", marked(rows)).savefig(IMAGES / "map_alike.png")
    cv2.imwrite(str(IMAGES / "map_overlay.jpg"), overlays(scene, village), [cv2.IMWRITE_JPEG_QUALITY, 90])


def _named(mark: Landmark) -> Landmark:
    return Landmark.of(mark.id, mark.outline_n, mark.base_d, mark.height_m, mark.colour_bgr, name=NAMES.get(mark.id, ""))


if __name__ == "__main__":
    main()
