"""Draws docs/images/frames.png, the picture of docs/conventions.md:  python docs/draw_frames.py"""

from pathlib import Path
from typing import TypeAlias

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Polygon

Point: TypeAlias = tuple[float, float]

X, Y, Z = "#c62828", "#2e7d32", "#1565c0"  # first, second, third axis of every frame
INK, GREY = "#263238", "#90a4ae"


def moved(p: Point, d: Point, k: float = 1.0) -> Point:
    """P + k d, in pixels of the sheet (y down)."""
    return p[0] + k * d[0], p[1] + k * d[1]


def arrow(ax: Axes, tail: Point, tip: Point, colour: str, style: str = "-") -> None:
    """One axis of a frame, or a vector between two."""
    properties = {"arrowstyle": "-|>", "color": colour, "lw": 2.0, "ls": style, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 14}
    ax.annotate("", tip, tail, arrowprops=properties)


def label(ax: Axes, p: Point, text: str, colour: str = INK, size: float = 10, align: str = "left") -> None:
    """A word next to a line."""
    ax.text(*p, text, color=colour, fontsize=size, ha=align, va="center")


def name(ax: Axes, p: Point, letter: str) -> None:
    """The letter of a frame."""
    ax.text(*p, letter, color=INK, fontsize=16, ha="center", va="center", fontweight="bold", fontstyle="italic")


def earth(ax: Axes) -> None:
    """Left: e in the Earth, n touching it."""
    centre, origin = (190.0, 230.0), (262.0, 146.0)
    ax.add_patch(Ellipse(centre, 290, 270, fc="#e3f2fd", ec=GREY))
    ax.add_patch(Ellipse(centre, 290, 70, fc="none", ec=GREY, ls=":"))
    for tip, colour, text, where in (
        ((95.0, 296.0), X, "x  0°N 0°E", (72.0, 310.0)),
        ((362.0, 242.0), Y, "y  0°N 90°E", (342.0, 262.0)),
        ((190.0, 60.0), Z, "z  North Pole", (84.0, 60.0)),
    ):
        arrow(ax, centre, tip, colour)
        label(ax, where, text, colour)
    name(ax, (174, 220), "e")
    ax.add_patch(
        Polygon([moved(origin, d) for d in ((-58, -6), (-14, -50), (68, 6), (24, 50))], fc="#fff8e1", ec="#f9a825", alpha=0.9)
    )
    for tip, colour, text in (((-32, -34), X, "N"), ((56, 34), Y, "E"), ((-40, 44), Z, "D")):
        arrow(ax, origin, moved(origin, tip), colour)
        label(ax, moved(origin, tip, 1.22), text, colour, align="center")
    name(ax, moved(origin, (12, -14)), "n")
    label(ax, (300, 92), "n touches the ellipsoid")
    label(ax, (300, 110), "at the map origin")


def scene(ax: Axes) -> None:
    """Middle: a vehicle above the ground sees a landmark."""
    ground, body, landmark = (530.0, 356.0), (640.0, 132.0), (806.0, 350.0)
    ax.add_patch(Polygon([(455, 392), (575, 292), (890, 322), (850, 440)], fc="#f1f8e9", ec="#aed581"))
    for tip, colour, text in (((52, -40), X, "N"), ((80, 9), Y, "E"), ((0, 62), Z, "D")):
        arrow(ax, ground, moved(ground, tip), colour)
        label(ax, moved(ground, tip, 1.18), text, colour, align="center")
    name(ax, moved(ground, (-16, 0)), "n")
    vehicle(ax, body)
    camera = moved(body, (104, 46))
    for corner in ((-26, -6), (6, -26), (30, -8), (-2, 14)):
        ax.plot(*zip(camera, moved(landmark, corner), strict=True), color=GREY, lw=0.7)
    box(ax, landmark)
    name(ax, moved(landmark, (44, 4)), "l")
    arrow(ax, ground, moved(body, (-4, 8)), INK, "--")
    label(ax, (566, 246), "p_n", size=12, align="right")
    ax.plot(*zip(body, camera, strict=True), color=INK, lw=1, ls=":")
    eye(ax, camera)


def vehicle(ax: Axes, body: Point) -> None:
    """A quadrotor and its axes: forward, right (towards the reader), down."""
    forward, right, down = (0.96, -0.20), (-0.42, 0.52), (0.0, 1.0)
    for s in (-1, 1):
        for t in (-1, 1):
            rotor = moved(moved(body, forward, 52 * s), right, 46 * t)
            ax.plot(*zip(body, rotor, strict=True), color="#78909c", lw=3)
            ax.add_patch(Ellipse(rotor, 46, 15, fc="#cfd8dc", ec=GREY))
    ax.add_patch(Ellipse(body, 40, 24, fc="#546e7a", ec=INK))
    for direction, length, colour, text, gap in (
        (forward, 128, X, "x forward", (38, -2)),
        (right, 130, Y, "y right", (-34, 0)),
        (down, 92, Z, "z down", (0, 13)),
    ):
        tip = moved(body, direction, length)
        arrow(ax, body, tip, colour)
        label(ax, moved(tip, gap), text, colour, align="center")
    name(ax, moved(body, (0, -30)), "b")


def eye(ax: Axes, camera: Point) -> None:
    """The left camera, looking forward and down: right is the vehicle's right, down is across the line of sight."""
    ax.add_patch(Ellipse(camera, 16, 16, fc=INK, ec=INK))
    for tip, colour, text, beside in (
        ((-40, 48), X, "x right", (-6, 12)),
        ((-10, 78), Y, "y down", (6, 13)),
        ((96, 62), Z, "z forward", (6, 13)),
    ):
        arrow(ax, camera, moved(camera, tip), colour)
        label(ax, moved(moved(camera, tip), beside), text, colour, align="center")
    name(ax, moved(camera, (20, -8)), "c")


def box(ax: Axes, at: Point) -> None:
    """A flat-roofed building."""
    base = [moved(at, d) for d in ((-26, 10), (6, -10), (30, 8), (-2, 30))]
    top = [moved(p, (0, -16)) for p in base]
    ax.add_patch(Polygon([base[0], base[3], top[3], top[0]], fc="#bf360c"))
    ax.add_patch(Polygon([base[3], base[2], top[2], top[3]], fc="#8d2b0b"))
    ax.add_patch(Polygon(top, fc="#ff8a65", ec="#bf360c"))


def wire(ax: Axes) -> None:
    """Right: the two halves of every conversion, seen from above, the vehicle heading north-east."""
    heading = np.deg2rad(40)
    nose, right = (float(np.sin(heading)), -float(np.cos(heading))), (float(np.cos(heading)), float(np.sin(heading)))
    for centre, title, world, body in (
        ((1010.0, 170.0), "inside: NED, FRD", (("N", X, (0.0, -1.0)), ("E", Y, (1.0, 0.0))), (("F", X, nose), ("R", Y, right))),
        (
            (1010.0, 370.0),
            "on the wire: ENU, FLU",
            (("N", Y, (0.0, -1.0)), ("E", X, (1.0, 0.0))),
            (("F", X, nose), ("L", Y, moved((0.0, 0.0), right, -1))),
        ),
    ):
        corner = moved(centre, (-58, 42))
        for text, colour, d in world:
            arrow(ax, corner, moved(corner, d, 52), colour)
            label(ax, moved(corner, d, 64), text, colour, align="center")
        for text, colour, d in body:
            arrow(ax, moved(centre, (40, -10)), moved(moved(centre, (40, -10)), d, 56), colour)
            label(ax, moved(moved(centre, (40, -10)), d, 68), text, colour, align="center")
        label(ax, moved(centre, (10, -96)), title, size=11, align="center")
        third = "z down, into the page" if "NED" in title else "z up, out of the page"
        label(ax, moved(centre, (10, 66)), third, Z, align="center")
    ax.plot([905, 905], [50, 450], color=GREY, lw=0.8)


def main() -> None:
    """One sheet of 1130 x 420 pixels, y down."""
    figure, ax = plt.subplots(figsize=(11.3, 4.2), dpi=110)
    figure.subplots_adjust(0, 0, 1, 1)
    ax.set(xlim=(0, 1130), ylim=(455, 35), aspect="equal")
    ax.axis("off")
    earth(ax)
    scene(ax)
    wire(ax)
    figure.savefig(Path(__file__).parent / "images/frames.png")


if __name__ == "__main__":
    main()
