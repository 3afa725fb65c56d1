"""A map drawn: outlines filled in their colours, names where there is room, scale bar, north arrow."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrow, Rectangle

from models import outline as polygon
from models.landmarks import LandmarkMap
from models.messages import Array

_SIDE_IN, _DPI = 9.0, 150
_GROUND, _UNKNOWN, _EDGE = "#f4f2ec", "#c9c5bb", "#3a3a3a"
_FONT_PT = 7.0
_MOST_NAMES = 400


def draw(the_map: LandmarkMap, title: str) -> Figure:
    """The whole map, north up, in metres from the origin. The map must not be empty."""
    columns = the_map.columns
    low, high = _frame(columns.vertices)
    figure = Figure(figsize=_figure_size(high - low), layout="constrained", dpi=_DPI)
    axes = figure.add_subplot(
        aspect="equal", facecolor=_GROUND, xlabel="east of the origin [m]", ylabel="north of the origin [m]"
    )
    axes.set_xlim(low[1], high[1])
    axes.set_ylim(low[0], high[0])
    outlines = np.split(columns.vertices[:, ::-1], columns.offsets[1:-1])
    fills = np.where(columns.colour_bgr[:, :1] >= 0, columns.colour_bgr[:, ::-1] / 255.0, _rgb(_UNKNOWN))
    order = np.argsort(-the_map.description[:, polygon.SIZE])  # small ones on top
    width = float(np.clip(30.0 / np.sqrt(len(the_map)), 0.1, 0.8))
    axes.add_collection(
        PolyCollection([outlines[i] for i in order.tolist()], facecolors=fills[order], edgecolors=_EDGE, linewidths=width)
    )
    if low[0] < 0.0 < high[0] and low[1] < 0.0 < high[1]:
        axes.plot(0.0, 0.0, "+", color="#0072B2", markersize=10, markeredgewidth=1.5, zorder=3)
    figure.canvas.draw()  # the layout decides how many pixels a metre has
    _names(axes, the_map, fills)
    _scale_bar(axes)
    _north_arrow(axes)
    lat, lon, alt = the_map.origin
    unknown = int(np.sum(columns.colour_bgr[:, 0] < 0))
    grey = f"; grey: colour not known ({unknown})" if unknown else ""
    axes.set_title(
        f"{title}\n{len(the_map)} landmarks, origin {lat:.6f}, {lon:.6f}, {alt:.0f} m (+){grey}", fontsize=9, loc="left"
    )
    axes.tick_params(labelsize=7, color=_EDGE)
    axes.grid(color="white", linewidth=0.8)
    axes.set_axisbelow(True)
    return figure


def _rgb(colour: str) -> Array:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def _frame(vertices: Array) -> tuple[Array, Array]:
    """South-west and north-east corner (north, east) with a margin; never narrower than a third of its length."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half * 1.06 + 2.0, half.max() / 3.0)
    return middle - half, middle + half


def _figure_size(extent: Array) -> tuple[float, float]:
    north, east = extent / extent.max() * _SIDE_IN
    return float(east) + 0.6, float(north) + 0.8


def _names(axes: Axes, the_map: LandmarkMap, fills: Array) -> None:
    """Inside its outline where a name fits, else under it where nothing else is; the largest landmarks first."""
    px_per_m = axes.get_window_extent().width / float(np.ptp(axes.get_xlim()))
    height = 1.25 * _FONT_PT * _DPI / 72 / px_per_m
    letter = 0.62 * _FONT_PT * _DPI / 72 / px_per_m
    d = the_map.description
    candidates = np.argsort(-d[:, polygon.SIZE])[:_MOST_NAMES].tolist()
    around = _boxes(the_map, np.array(candidates)) if len(the_map) <= _MOST_NAMES else np.empty((0, 4))
    taken: list[tuple[float, float, float, float]] = []
    for i in candidates:
        name = the_map.columns.names.get(i) or the_map.columns.ids[i]
        half, (north, east) = letter * len(name) / 2, d[i, [polygon.NORTH, polygon.EAST]]
        box = (north - height / 2, east - half, north + height / 2, east + half)
        inside = 2 * half < d[i, polygon.LENGTH] and height < d[i, polygon.WIDTH] and _within(box, the_map, i)
        if not inside:
            bottom = float(the_map.columns.vertices[slice(*the_map.columns.offsets[i : i + 2]), 0].min()) - 0.2 * height
            box = (bottom - height, east - half, bottom, east + half)
            if len(around) == 0 or _meets(box, around):
                continue
        if taken and _meets(box, np.array(taken)):
            continue
        taken.append(box)
        dark = inside and float(fills[i] @ (0.3, 0.59, 0.11)) < 0.5
        axes.text(
            east,
            (box[0] + box[2]) / 2,
            name,
            ha="center",
            va="center",
            fontsize=_FONT_PT,
            color="white" if dark else "black",
            zorder=4,
        )


def _boxes(the_map: LandmarkMap, rows: Any) -> Array:
    """South, west, north, east of the outlines (R, 4)."""
    columns = the_map.columns
    parts = [columns.vertices[columns.offsets[i] : columns.offsets[i + 1]] for i in rows.tolist()]
    return np.array([[*part.min(axis=0), *part.max(axis=0)] for part in parts])


def _meets(box: tuple[float, float, float, float], others: Array) -> bool:
    south, west, north, east = others.T
    return bool(np.any((box[0] < north) & (south < box[2]) & (box[1] < east) & (west < box[3])))


def _within(box: tuple[float, float, float, float], the_map: LandmarkMap, i: int) -> bool:
    """Whether the box lies inside outline i: no corner of the outline in the box, its own corners and sides inside."""
    outline = the_map.columns.vertices[slice(*the_map.columns.offsets[i : i + 2])]
    n, e = np.meshgrid(np.linspace(box[0], box[2], 3), np.linspace(box[1], box[3], 9))
    a, b = outline, np.roll(outline, -1, axis=0)
    points_n, points_e = n.ravel()[:, None], e.ravel()[:, None]
    across = (a[:, 0] <= points_n) != (b[:, 0] <= points_n)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 1] + (points_n - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    return bool(np.all(np.sum(across & (at > points_e), axis=1) % 2 == 1))


def _scale_bar(axes: Axes) -> None:
    """A round length, a fifth to a tenth of the width, below on the left."""
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    fifth = (east - west) / 5
    power = 10.0 ** np.floor(np.log10(fifth))
    length = max(k * power for k in (1, 2, 5) if k * power <= fifth)
    x, y, thick = west + 0.03 * (east - west), south + 0.03 * (north - south), 0.006 * (north - south)
    back = Rectangle(
        (x - 0.01 * (east - west), y - 2 * thick), length + 0.02 * (east - west), 8 * thick, color="white", alpha=0.8
    )
    axes.add_patch(back).set_zorder(5)
    for k, colour in enumerate((_EDGE, "white")):
        axes.add_patch(Rectangle((x + k * length / 2, y), length / 2, thick, facecolor=colour, edgecolor=_EDGE, zorder=6))
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    axes.text(x + length / 2, y + 1.6 * thick, text, ha="center", va="bottom", fontsize=8, zorder=6)


def _north_arrow(axes: Axes) -> None:
    arrow = FancyArrow(
        0.965, 0.915, 0.0, 0.04, width=0.004, head_width=0.02, head_length=0.025, length_includes_head=False,
        color=_EDGE, transform=axes.transAxes, zorder=6,
    )  # fmt: skip
    axes.add_patch(arrow)
    axes.text(
        0.965, 0.905, "N", transform=axes.transAxes, ha="center", va="top", fontsize=10, weight="bold", color=_EDGE, zorder=6
    )
