"""Plots of a flight.

matplotlib Figures; s from the first estimate; colours of Okabe & Ito.
"""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import LogLocator, NullFormatter

from logs.evaluation.collected import Collected
from logs.evaluation.evaluate import compare
from logs.evaluation.metrics import Indices, Times, within
from models.messages import Array
from models.radius import horizontal_radius

BLACK, BLUE, GREEN, VERMILLION, SKY, ORANGE = "#000000", "#0072B2", "#009E73", "#D55E00", "#56B4E9", "#E69F00"
_BAND: Final = "#CDE7F7"  # a light SKY, opaque: the same inside an outage's shade
_SIGMAS_95_PLANE: Final = 2.447747  # of an ellipse
_MOST_POINTS: Final = 20_000  # of a line; more are not seen
_ELLIPSES: Final = 24

Spans = list[tuple[int, int]]


def overview(collected: Collected, outages: Spans) -> Figure:
    """From above, and horizontal error (or radius alone)."""
    figure = _figure(13.0, 6.0)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    _draw_from_above(left, collected, outages)
    _draw_horizontal_error(right, collected, outages)
    _legend_below(figure, left, right)
    return figure


def _draw_from_above(axes: Axes, collected: Collected, outages: Spans) -> None:
    """The flight on the map plane."""
    estimate, truth = collected.estimate, collected.truth
    p = np.where(within(estimate.t_ns, outages)[:, None], np.nan, estimate.p)
    blind = np.where(within(estimate.t_ns, outages)[:, None], estimate.p, np.nan)
    few, few_true = _thinned(len(estimate)), _thinned(len(truth))
    half_view = _set_limits(axes, np.vstack([estimate.p[:, :2], truth.p[:, :2]]))
    for row in _ellipse_rows(estimate.t_ns, outages):
        ellipse = _ellipse(estimate.p[row, :2], estimate.covariance[row, :2, :2])
        if ellipse.get_height() < 2.0 * half_view:  # a larger one would be a line across the picture
            axes.add_patch(ellipse)
    if len(truth):
        _line(axes, truth.p[few_true, 0], truth.p[few_true, 1], BLACK, collected.yardstick, linewidth=0.8, zorder=5)
    if np.isfinite(p).any():
        _line(axes, p[few, 0], p[few, 1], BLUE, "estimate, aided" if outages else "estimate", linewidth=2.2, zorder=4)
    if outages:
        _line(axes, blind[few, 0], blind[few, 1], ORANGE, "estimate in an outage", linewidth=2.2, zorder=4)
    _draw_fixes_from_above(axes, collected)
    axes.plot(*estimate.p[:1, :2].T, "o", markersize=9, markerfacecolor="white", markeredgecolor=BLACK, label="start", zorder=7)
    axes.plot([], [], color=SKY, linewidth=0.8, label="95 % ellipse")
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.grid(alpha=0.25)


def _draw_horizontal_error(axes: Axes, collected: Collected, outages: Spans) -> None:
    """Horizontal error and 95 % radius, logarithmic."""
    c, start = compare(collected.estimate, collected.truth), int(collected.estimate.t_ns[0])
    reported = collected.estimate if not len(c) else c.estimate
    t, few = _seconds(reported.t_ns, start), _thinned(len(reported))
    radius = horizontal_radius(c.p_covariance[:, :2, :2] if len(c) else reported.covariance[:, :2, :2])
    t_whole, radius_whole = _broken_at_holes(t[few], radius[few])
    axes.fill_between(t_whole, radius_whole, 1e-9, color=_BAND, linewidth=0, zorder=1)
    _line(axes, t_whole, radius_whole, BLUE, "95 % radius", linewidth=1.2)
    lowest = float(np.nanmin(radius))
    if len(c):
        error = np.linalg.norm(c.p_error[:, :2], axis=1)
        lowest = min(lowest, float(np.percentile(error, 2)))
        _line(axes, *_broken_at_holes(t[few], error[few]), BLACK, "horizontal error", linewidth=0.9)
        beyond = few[error[few] > radius[few]]
        if len(beyond):
            axes.plot(t[beyond], error[beyond], ".", color=VERMILLION, markersize=3, label="error beyond the radius")
        axes.set_title(f"inside the 95 % radius {100.0 * np.mean(error <= radius):.1f} % of the time", fontsize=10)
    _draw_events(axes, collected, outages)
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(0.7 * lowest, None)
    axes.set_xlim(0.0, _seconds(collected.estimate.t_ns[-1:], start)[0])
    axes.set_xlabel("time [s]")
    axes.set_ylabel("horizontal error [m]")
    axes.grid(alpha=0.25, which="both")


def _draw_events(axes: Axes, collected: Collected, outages: Spans) -> None:
    start, edge = int(collected.estimate.t_ns[0]), axes.get_xaxis_transform()
    for k, span in enumerate(outages):
        label = None if k else "outage"
        axes.axvspan(*_seconds(np.array(span), start), color=ORANGE, alpha=0.18, linewidth=0, zorder=0, label=label)
    if collected.fixes:
        t = np.concatenate([_seconds(f.t_ns, start) for f in collected.fixes.values()])
        used = np.concatenate([f.used for f in collected.fixes.values()])
        low, high = np.full(int(used.sum()), 0.015), np.ones(int((~used).sum()))
        axes.plot(t[used], low, "|", color=GREEN, markersize=6, label="fix used", transform=edge)
        if len(high):
            axes.plot(t[~used], high, "x", color=VERMILLION, markersize=5, label="fix not used", transform=edge, clip_on=False)


def _draw_fixes_from_above(axes: Axes, collected: Collected) -> None:
    if not collected.fixes:
        return
    p = np.vstack([f.p for f in collected.fixes.values()])
    used = np.concatenate([f.used for f in collected.fixes.values()])
    axes.plot(*p[used, :2].T, "o", color=GREEN, markersize=4, markeredgewidth=0, label="fix used", zorder=6)
    if not used.all():
        axes.plot(*p[~used, :2].T, "x", color=VERMILLION, markersize=5, label="fix not used", zorder=6)


def _ellipse_rows(t_ns: Times, outages: Spans) -> list[int]:
    even = np.linspace(int(t_ns[0]), int(t_ns[-1]), _ELLIPSES).astype(np.int64)
    wanted = np.concatenate([even, [end - 1 for _, end in outages]]).astype(np.int64)
    return sorted({int(k) for k in np.clip(np.searchsorted(t_ns, wanted, side="right") - 1, 0, len(t_ns) - 1)})


def _ellipse(centre: Array, covariance: Array) -> Ellipse:
    values, vectors = np.linalg.eigh(np.where(np.isfinite(covariance), covariance, 0.0))
    width, height = 2.0 * _SIGMAS_95_PLANE * np.sqrt(np.clip(values, 0.0, None))
    angle = float(np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0])))
    return Ellipse((float(centre[0]), float(centre[1])), width, height, angle=angle, fill=False, edgecolor=SKY, linewidth=0.8)


def _line(axes: Axes, x: Array, y: Array, color: str, label: str, **style: Any) -> None:
    axes.plot(x, y, color=color, label=label, **style)


def _broken_at_holes(t: Array, y: Array) -> tuple[Array, Array]:
    if len(t) < 2:
        return t, y
    step = np.diff(t)
    leap = np.flatnonzero(step > max(0.5, 20.0 * float(np.median(step)))) + 1
    return np.insert(t, leap, t[leap - 1]), np.insert(y, leap, np.nan)


def _seconds(t_ns: Times, start_ns: int) -> Array:
    return np.asarray((t_ns - start_ns) * 1e-9, float)


def _thinned(n: int) -> Indices:
    return np.arange(0, n, max(1, -(-n // _MOST_POINTS)))


def _set_limits(axes: Axes, p: Array) -> float:
    p = p[np.isfinite(p).all(axis=1)]
    low, high = p.min(axis=0), p.max(axis=0)
    middle, half = 0.5 * (low + high), 0.55 * float((high - low).max()) + 0.5
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    return half


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), dpi=120, layout="constrained", facecolor="white")


def _legend_below(figure: Figure, *axes: Axes) -> None:
    named: dict[str, Any] = {}
    for a in axes:
        for handle, label in zip(*a.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=5, frameon=False, fontsize=9)
