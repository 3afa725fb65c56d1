"""A drawn map: outlines in their colours, names, scale bar, north arrow."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from models.maps import outline as polygon
from models.maps.landmarks import LandmarkMap
from models.maps.table import Alike
from models.messages import Array

_SIDE_IN, _DPI = 9.0, 150
_GROUND, _UNKNOWN, _EDGE = "#ebe8df", "#b5b0a4", "#3a3a3a"
_ALIKE, _REPEATS = "#D55E00", "#CC00CC"
_FONT_PT = 7.0
_MOST_NAMES = 400
_MOST_EDGES = 2000  # more would hide the colours
_STRIP = 0.07  # of the height, along the lower edge


def draw(the_map: LandmarkMap, title: str, alike: Alike | None = None) -> Figure:
    """Draw the map, north up, in metres from the origin; look-alikes have marked edges."""
    columns = the_map.columns
    low, high = _frame(columns.vertices)
    figure = Figure(figsize=_figure_size(high - low), layout="constrained", dpi=_DPI)
    axes = figure.add_subplot(
        aspect="equal", facecolor=_GROUND, xlabel="east of the origin [m]", ylabel="north of the origin [m]"
    )
    axes.set_xlim(low[1], high[1])
    axes.set_ylim(low[0], high[0])
    outlines = np.split(columns.vertices[:, ::-1], columns.offsets[1:-1])
    fills = np.where(columns.colour_bgr[:, :1] >= 0, columns.colour_bgr[:, ::-1] / 255.0, to_rgb(_UNKNOWN))
    order = np.argsort(-the_map.description[:, polygon.SIZE])  # small ones on top
    edges, widths = _edges(len(the_map), alike)
    axes.add_collection(
        PolyCollection(
            [outlines[i] for i in order.tolist()], facecolors=fills[order], edgecolors=edges[order], linewidths=widths[order]
        )
    )
    if low[0] < 0.0 < high[0] and low[1] < 0.0 < high[1]:
        axes.plot(0.0, 0.0, "+", color="#0072B2", markersize=10, markeredgewidth=1.5, zorder=3)
    _legend(figure, alike)
    figure.canvas.draw()  # the layout decides how many pixels a metre has
    _names(axes, the_map, fills)
    _scale_bar(axes)
    _north_arrow(axes)
    axes.set_title(_title(the_map, title), fontsize=9, loc="left")
    axes.tick_params(labelsize=7, color=_EDGE)
    axes.grid(color="white", linewidth=0.8)
    axes.set_axisbelow(True)
    return figure


def _edges(count: int, alike: Alike | None) -> tuple[Array, Array]:
    colours = np.tile(to_rgba(_EDGE if count <= _MOST_EDGES else "none"), (count, 1))
    widths = np.full(count, 0.7)
    for colour, which, _ in _kinds(alike):
        colours[which], widths[which] = to_rgba(colour), 2.0 if count <= _MOST_EDGES else 0.7
    return colours, widths


def _kinds(alike: Alike | None) -> list[tuple[str, NDArray[np.bool_], str]]:
    if alike is None:
        return []
    repeats = alike.repeats_m < np.inf
    return [
        (_ALIKE, (alike.count > 0) & ~repeats, "looks like another one near by"),
        (_REPEATS, repeats, "the same arrangement exists nearby"),
    ]


def _legend(figure: Figure, alike: Alike | None) -> None:
    handles = [
        Patch(facecolor="white", edgecolor=colour, linewidth=2.0, label=f"{meaning} ({int(which.sum())})")
        for colour, which, meaning in _kinds(alike)
        if which.any()
    ]
    if handles:
        figure.legend(handles=handles, loc="outside lower left", ncols=2, fontsize=8, frameon=False)


def _title(the_map: LandmarkMap, title: str) -> str:
    lat, lon, alt = the_map.origin
    unknown = int(np.sum(the_map.columns.colour_bgr[:, 0] < 0))
    grey = f"; grey: colour not known ({unknown})" if unknown else ""
    count = "1 landmark" if len(the_map) == 1 else f"{len(the_map)} landmarks"
    return f"{title}: {count}{grey}\norigin (+) {lat:.6f}, {lon:.6f}, {alt:.0f} m"


def _frame(vertices: Array) -> tuple[Array, Array]:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half * 1.05 + 2.0, half.max() / 2.0)
    low, high = middle - half, middle + half
    low[0] -= _STRIP / (1.0 - _STRIP) * (high[0] - low[0])
    return low, high


def _figure_size(extent: Array) -> tuple[float, float]:
    north, east = extent / extent.max() * _SIDE_IN
    return float(east) + 0.6, float(north) + 0.8


def _names(axes: Axes, the_map: LandmarkMap, fills: Array) -> None:
    px_per_m = axes.get_window_extent().width / float(np.ptp(axes.get_xlim()))
    height, letter = (factor * _FONT_PT * _DPI / 72 / px_per_m for factor in (1.25, 0.62))
    d = the_map.description
    order = np.argsort(-d[:, polygon.SIZE])[:_MOST_NAMES]
    around = _boxes(the_map, order)
    taken = np.empty((0, 4))
    for rank, i in enumerate(order.tolist()):
        name = the_map.columns.names.get(i) or the_map.columns.ids[i]
        half, (north, east) = letter * len(name) / 2, d[i, [polygon.NORTH, polygon.EAST]]
        south, west, top, east_end = around[rank]
        inside, *outside = (
            np.array([n - height / 2, e - half, n + height / 2, e + half])
            for n, e in (
                (north, east),
                (south - 0.7 * height, east),
                (top + 0.7 * height, east),
                (north, east_end + half + letter),
                (north, west - half - letter),
            )
        )
        fits = _within(inside, the_map, i)
        free = [inside] if fits else [b for b in outside if len(the_map) <= _MOST_NAMES and not _meets(b, around)]
        free = [box for box in free if not _meets(box, taken)]
        if free:
            taken = np.vstack((taken, free[0]))
            dark = fits and float(fills[i] @ (0.3, 0.59, 0.11)) < 0.5
            n, e = (free[0][:2] + free[0][2:]) / 2
            colour = "white" if dark else "black"
            axes.text(e, n, name, ha="center", va="center", fontsize=_FONT_PT, color=colour, zorder=4, clip_on=True)


def _boxes(the_map: LandmarkMap, rows: NDArray[np.intp]) -> Array:
    columns = the_map.columns
    parts = [columns.vertices[columns.offsets[i] : columns.offsets[i + 1]] for i in rows.tolist()]
    return np.array([[*part.min(axis=0), *part.max(axis=0)] for part in parts])


def _meets(box: Array, others: Array) -> bool:
    south, west, north, east = others.T
    return bool(np.any((box[0] < north) & (south < box[2]) & (box[1] < east) & (west < box[3])))


def _within(box: Array, the_map: LandmarkMap, i: int) -> bool:
    outline = the_map.columns.vertices[slice(*the_map.columns.offsets[i : i + 2])]
    n, e = np.meshgrid(np.linspace(box[0], box[2], 3), np.linspace(box[1], box[3], 9))
    a, b = outline, np.roll(outline, -1, axis=0)
    points_n, points_e = n.ravel()[:, None], e.ravel()[:, None]
    across = (a[:, 0] <= points_n) != (b[:, 0] <= points_n)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 1] + (points_n - a[:, 0]) / (b[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    return bool(np.all(np.sum(across & (at > points_e), axis=1) % 2 == 1))


def _scale_bar(axes: Axes) -> None:
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    fifth = (east - west) / 5
    power = 10.0 ** np.floor(np.log10(fifth))
    length = max(k * power for k in (1, 2, 5) if k * power <= fifth)
    x, y, thick = west + 0.03 * (east - west), south + 0.25 * _STRIP * (north - south), 0.006 * (north - south)
    for k, colour in enumerate((_EDGE, "white")):
        axes.add_patch(Rectangle((x + k * length / 2, y), length / 2, thick, facecolor=colour, edgecolor=_EDGE, zorder=6))
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    axes.text(x + length / 2, y + 1.6 * thick, text, ha="center", va="bottom", fontsize=8, zorder=6)


def _north_arrow(axes: Axes) -> None:
    arrow = {"arrowstyle": "-|>,head_width=0.35,head_length=0.6", "color": _EDGE, "linewidth": 2.0}
    axes.annotate(
        "N", xy=(0.97, 0.9 * _STRIP), xytext=(0.97, 0.25 * _STRIP), xycoords="axes fraction", arrowprops=arrow,
        ha="center", va="center", fontsize=10, weight="bold", color=_EDGE, zorder=6,
    )  # fmt: skip
