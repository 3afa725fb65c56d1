"""Plots of a calibration: corners, residuals by view; no pyplot."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from calib.board.chessboard import View
from calib.cameras.mono import Mono
from calib.cameras.selection import coverage
from calib.cameras.stereo import Stereo, row_errors
from models.messages import Array

BLUE, VERMILLION, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#888888"
_VECTOR_PART = 0.05  # of the image's width that the 95th percentile of the residuals is drawn


def mono_figure(result: Mono) -> Figure:
    """Coverage and residuals."""
    residuals = [view[0] for view in result.solution.residuals if view[0] is not None]
    figure = Figure(figsize=(12.0, 8.6), layout="constrained")
    axes = figure.subplots(2, 2)
    draw_coverage(axes[0, 0], result.views, "where the corners were")
    draw_vectors(axes[0, 1], result.views, residuals, "residual of each corner")
    draw_views(axes[1, 0], [[v.name for v in result.views]], [result.solution.view_rms()], [""])
    draw_scatter(axes[1, 1], np.concatenate(residuals))
    return figure


def stereo_figure(result: Stereo) -> Figure:
    """Coverage, residuals, rectified row errors."""
    figure = Figure(figsize=(12.0, 12.6), layout="constrained")
    axes = figure.subplots(3, 2)
    rms = []
    for side, name in ((0, "left"), (1, "right")):
        views = [pair[side] for pair in result.pairs]
        residuals = [r for view in result.solution.residuals if (r := view[side]) is not None]
        draw_coverage(axes[0, side], views, f"{name}: where the corners were")
        draw_vectors(axes[1, side], views, residuals, f"{name}: residual of each corner")
        rms.append([float(np.sqrt(np.mean(np.sum(r * r, axis=1)))) for r in residuals])
    draw_views(axes[2, 0], [[p.left.name for p in result.pairs]], rms, ["left", "right"])
    rows = np.concatenate(row_errors(result.rig, result.pairs))
    axes[2, 1].hist(rows, bins=41, color=BLUE)
    axes[2, 1].set_xlabel("row in the left minus row in the right rectified image [px]")
    axes[2, 1].set_ylabel("corners")
    axes[2, 1].set_title(
        f"rectified row error: RMS {result.epipolar_after_px:.3f} px (not rectified: {result.epipolar_before_px:.2f} px)",
        fontsize=10,
    )
    return figure


def draw_coverage(axes: Axes, views: Sequence[View], title: str) -> None:
    """Corners over image cells; empty cells shaded."""
    width, height = views[0].width, views[0].height
    counts = coverage(views)
    rows, columns = counts.shape
    for i, j in np.argwhere(counts == 0):
        corner = (j * width / columns - 0.5, i * height / rows - 0.5)
        axes.add_patch(Rectangle(corner, width / columns, height / rows, facecolor=VERMILLION, alpha=0.18, linewidth=0))
    for v in views:
        axes.plot(*v.px.T, ".", color=BLUE, markersize=2.5)
    _frame(axes, width, height)
    axes.set_title(f"{title}: {100.0 * np.mean(counts > 0):.0f} % of the cells (shaded: none)", fontsize=10)


def draw_vectors(axes: Axes, views: Sequence[View], residuals: Sequence[Array], title: str) -> None:
    """Magnified residual vectors; orange beyond the 95th percentile."""
    px, r = np.concatenate([v.px for v in views]), np.concatenate(residuals)
    length = np.linalg.norm(r, axis=1)
    usual = max(float(np.percentile(length, 95)), 1e-9)
    scale = _VECTOR_PART * views[0].width / usual
    large = length > usual
    for some, colour in ((~large, BLUE), (large, VERMILLION)):
        axes.quiver(
            *px[some].T, *(scale * r[some]).T, color=colour, angles="xy", scale_units="xy", scale=1.0, width=0.0018, headwidth=4.0
        )
    _frame(axes, views[0].width, views[0].height)
    axes.set_title(f"{title}, x {scale:.0f} (orange: beyond {usual:.2f} px)", fontsize=10)


def draw_views(axes: Axes, names: Sequence[Sequence[str]], rms: Sequence[Sequence[float]], labels: Sequence[str]) -> None:
    """A bar for each view."""
    width = 0.8 / len(rms)
    for k, (values, label) in enumerate(zip(rms, labels, strict=True)):
        at = np.arange(len(values)) + (k - (len(rms) - 1) / 2) * width
        axes.bar(at, values, width, color=(BLUE, GREEN)[k], label=label)
    shown = [name if len(name) <= 18 else "..." + name[-15:] for name in names[0]]
    axes.set_xticks(range(len(shown)), shown, rotation=60, ha="right", fontsize=7)
    axes.set_ylabel("RMS [px]")
    axes.set_title("residual of each view", fontsize=10)
    axes.grid(axis="y", alpha=0.25)
    if len(rms) > 1:
        axes.legend(fontsize=8)


def draw_scatter(axes: Axes, r: Array) -> None:
    """All residuals about zero."""
    limit = 1.1 * float(np.abs(r).max())
    axes.plot(*r.T, ".", color=BLUE, markersize=2.5)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.axvline(0.0, color=GREY, linewidth=0.6)
    axes.set_xlim(-limit, limit)
    axes.set_ylim(limit, -limit)
    axes.set_aspect("equal")
    axes.set_xlabel("right [px]")
    axes.set_ylabel("down [px]")
    axes.set_title(f"residuals: RMS {np.sqrt(np.mean(np.sum(r * r, axis=1))):.3f} px", fontsize=10)


def _frame(axes: Axes, width: int, height: int) -> None:
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")
