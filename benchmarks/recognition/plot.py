"""A recognition run as a picture."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.recognition.experiments import TITLES, Recognition, Row
from benchmarks.recognition.recognisers import METHODS
from logs.evaluation.plots import BLUE, ORANGE, SKY, VERMILLION
from models.messages import Array

_COLOURS: Final = dict(zip(METHODS, (BLUE, "#8A8A8A", SKY, ORANGE), strict=True))
_WIDTH: Final = 0.2  # of a bar


def draw(result: Recognition) -> Figure:
    """Bars of each method by experiment and roof."""
    figure = Figure(figsize=(10.0, 6.2), layout="constrained", dpi=110)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
    groups = list(dict.fromkeys((r.experiment, r.roof) for r in result.rows))
    for k, method in enumerate(METHODS):
        rows = [next(r for r in result.rows if (r.experiment, r.roof, r.method) == (*g, method)) for g in groups]
        x = np.arange(len(groups)) + (k - 1.5) * _WIDTH
        _shares(upper, np.asarray(x, np.float64), rows, method)
        lower.bar(x, [r.cpu_ms_p50 or 0.0 for r in rows], 0.9 * _WIDTH, color=_COLOURS[method])
    upper.bar([0.0], [0.0], color="white", edgecolor=VERMILLION, hatch="////", label="wrong")
    upper.set_ylabel(f"recognised, {result.pairs} pairs at most [%]")
    upper.set_ylim(0.0, 104.0)
    upper.set_yticks(range(0, 101, 20))
    upper.axhline(95.0, color="black", linewidth=0.7, linestyle=":")
    lower.set_ylabel("time a frame [ms]")
    lower.set_xticks(np.arange(len(groups)), [f"{roof} roofs" for _, roof in groups], fontsize=8)
    lower.tick_params(axis="x", length=0.0)
    for experiment in dict.fromkeys(e for e, _ in groups):
        members = [x for x, (e, _) in enumerate(groups) if e == experiment]
        upper.set_xlim(-0.5, len(groups) - 0.5)
        upper.text(float(np.mean(members)), 108.0, TITLES[experiment], ha="center", fontsize=9, weight="bold")
        for axes in (upper, lower):
            axes.axvline(members[-1] + 0.5, color="#BBBBBB", linewidth=0.7)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper center", ncols=5, frameon=False)
    return figure


def _shares(axes: Axes, x: Array, rows: Sequence[Row], method: str) -> None:
    n = np.maximum([r.samples for r in rows], 1)
    good, bad = (100.0 * np.array([getattr(r, name) for r in rows]) / n for name in ("recognised", "wrong"))
    least = 100.0 * np.array([r.recognised_above for r in rows])
    axes.bar(x, good, 0.9 * _WIDTH, color=_COLOURS[method], label=method)
    some = bad > 0.0
    axes.bar(
        x[some], bad[some], 0.9 * _WIDTH, bottom=good[some], color="white", edgecolor=VERMILLION, hatch="////", linewidth=0.8
    )
    axes.vlines(x, least, good, color="black", linewidth=0.8)
