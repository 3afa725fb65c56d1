"""Stanford plots, a panel for each group of flights: error against protection level, counts of the four regions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from benchmarks.integrity.rows import INFINITE, LIMITS, STEP, Row

_LOW_M, _HIGH_M = 0.01, 2000.0
_LIMIT_M: Final = LIMITS.hal_m or np.inf
_COLUMNS, _SIDE_IN = 4, 3.1
_BAD, _OFF, _INK = "#d55e00", "#e69f00", "#5d666e"
_BEHIND: Final = {"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 1.0}  # text over points
_NORM: Final = LogNorm(1.0, 1e4)
_COLOURS: Final = mpl.colormaps["Blues"].resampled(256)


def draw(groups: Mapping[str, Sequence[Row]], path: Path) -> None:
    """The panels that have flights, PNG."""
    panels = [(name, some) for name, some in groups.items() if some]
    if not panels:
        return
    columns = min(_COLUMNS, len(panels))
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(columns * _SIDE_IN + 0.8, lines * _SIDE_IN + 0.3), layout="constrained", dpi=120)
    axes = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    for ax in axes.flat[len(panels) :]:
        ax.set_visible(False)
    for ax, (name, some) in zip(axes.flat, panels, strict=False):
        _panel(ax, name, some)
    for ax in axes[:, 0]:
        ax.set_ylabel("HPL at 1e-5 per hour, m")
    for ax in axes[-1]:
        ax.set_xlabel("horizontal error, m")
    scale = mpl.cm.ScalarMappable(_NORM, _shades())
    figure.colorbar(scale, ax=axes, label="levels in a cell", shrink=0.6, pad=0.01)
    figure.savefig(path)


def _shades() -> mpl.colors.Colormap:
    """Blues without the palest, which would not be seen."""
    return mpl.colors.LinearSegmentedColormap.from_list("counts", _COLOURS(np.linspace(0.35, 1.0, 256)))


def _panel(ax: Axes, name: str, rows: Sequence[Row]) -> None:
    counts: dict[tuple[float, float], int] = {}
    for e, level, n in (cell for r in rows for cell in r.cells):
        at = (
            float(np.clip(10.0 ** (STEP * e), _LOW_M, _HIGH_M)),
            _HIGH_M if level == INFINITE else min(10.0 ** (STEP * level), _HIGH_M),
        )
        counts[at] = counts.get(at, 0) + n
    x, y = np.array(list(counts)).reshape(-1, 2).T
    ax.fill_between([_LOW_M, _HIGH_M], _LOW_M, [_LOW_M, _HIGH_M], color=_BAD, alpha=0.12, linewidth=0)
    ax.fill_between([_LOW_M, _HIGH_M], _LIMIT_M, _HIGH_M, color=_OFF, alpha=0.10, linewidth=0)
    ax.plot([_LOW_M, _HIGH_M], [_LOW_M, _HIGH_M], color=_INK, linewidth=0.8)
    ax.axhline(_LIMIT_M, color=_OFF, linewidth=0.8)
    ax.scatter(x, y, s=5, marker="s", c=list(counts.values()), cmap=_shades(), norm=_NORM, linewidths=0, clip_on=False, zorder=2)
    ax.set(xscale="log", yscale="log", xlim=(_LOW_M, _HIGH_M), ylim=(_LOW_M, _HIGH_M), aspect="equal")
    hours, sides = sum(r.hours for r in rows), [r.horizontal for r in rows if r.horizontal]
    ax.set_title(f"{name}: {len(rows)} flights, {hours:.2f} h", fontsize=9)
    shown = {region: sum(getattr(s, region) for s in sides) for region in ("unavailable", "nominal", "misleading", "hazardous")}
    places = {
        "unavailable": (0.04, 0.95, "left", "top"), "nominal": (0.04, 0.36, "left", "top"),
        "misleading": (0.55, 0.04, "right", "bottom"), "hazardous": (0.97, 0.04, "right", "bottom"),
    }  # fmt: skip
    for region, (u, v, align, base) in places.items():
        ax.text(
            u,
            v,
            f"{region}\n{shown[region]}",
            transform=ax.transAxes,
            fontsize=7.5,
            ha=align,
            va=base,
            color="#222",
            bbox=_BEHIND,
        )
