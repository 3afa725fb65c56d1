"""Report section: protection levels, states, Stanford plots."""

from collections.abc import Sequence
from itertools import groupby
from typing import Final

import numpy as np

from logs.evaluation.evaluate import Comparison
from logs.evaluation.integrity import against_truth
from logs.evaluation.metrics import Times
from logs.report.buckets import Buckets
from logs.report.charts import Chart, Colour, Level, Stay, StripChart, TimeChart, line
from logs.report.stanford import stanford
from models.messages import Alert, Array, Integrity

_STATES: Final[dict[str, Colour]] = {
    Alert.NOT_JUDGED: "grey",
    Alert.USABLE: "green",
    Alert.CAUTION: "orange",
    Alert.DO_NOT_USE: "vermillion",
}
_COLOURS: Final[tuple[Colour, Colour]] = ("blue", "sky")
_POINTS: Final = 4000  # more than a plot has spans
_USUAL: Final = 3  # times the median: longer is a pause
_SIDE: Final = "width:26em;max-width:100%"


def charts(levels: Sequence[Integrity], c: Comparison, start_ns: int) -> dict[str, Chart]:
    """Levels with errors (if a truth exists), and the state."""
    t_ns = np.array([i.t_ns for i in levels], np.int64)
    errors = np.hypot(c.p_error[:, 0], c.p_error[:, 1]), np.abs(c.p_error[:, 2])
    found: dict[str, Chart] = {}
    sides = (
        ("Horizontal", [i.hpl_m for i in levels], [i.hpls_m[0] for i in levels], levels[-1].hal_m),
        ("Vertical", [i.vpl_m for i in levels], [i.vpls_m[0] for i in levels], levels[-1].val_m),
    )
    for (side, level, first, limit), error in zip(sides, errors, strict=True):
        risks = f"{levels[-1].risk_per_hour:g} per hour", f"{levels[-1].risks_per_hour[0]:g} per hour"
        both = _buckets(*_held(t_ns, np.array([level, first]).T))
        parts = [line(f"level, {risks[k]}", _COLOURS[k], both, k, start_ns) for k in range(len(risks))]
        if len(c):
            parts.append(line("error", "black", _buckets(c.t_ns, error[:, None]), 0, start_ns))
        limits = [Level(limit, "alert limit")] if np.isfinite(limit) else []
        found[f"level {side}"] = TimeChart(f"{side} error and protection level", "m", [*parts], limits, scale="log", height=230)
    found["alerts"] = StripChart("State of integrity", {"state": _stays(levels, start_ns)})
    return found


def plots(levels: Sequence[Integrity], c: Comparison) -> str:
    """Stanford plots, or nothing without truth."""
    compared = against_truth(levels, c.t_ns, c.p_error)
    at = [levels[k] for k in compared.row.tolist()]
    if not at:
        return ""
    sides = (
        stanford(compared.horizontal, np.array([i.hpl_m for i in at]), at[-1].hal_m, "horizontal"),
        stanford(compared.vertical, np.array([i.vpl_m for i in at]), at[-1].val_m, "vertical"),
    )
    return '<div class="beside">' + "".join(f'<div style="{_SIDE}">{side}</div>' for side in sides) + "</div>"


def _held(t_ns: Times, values: Array) -> tuple[Times, Array]:
    holds_ns = _USUAL * int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0
    between = np.arange(t_ns[0], t_ns[-1], max(int(t_ns[-1] - t_ns[0]) // _POINTS, 1))
    row = np.searchsorted(t_ns, between, side="right") - 1
    held = between - t_ns[row] <= holds_ns
    return np.concatenate([t_ns, between[held]]), np.concatenate([values, values[row[held]]])


def _buckets(t_ns: Times, values: Array) -> Buckets:
    buckets = Buckets(values.shape[1], int(t_ns[0]))
    buckets.add(t_ns, np.where(np.isfinite(values), values, np.nan))
    return buckets


def _stays(levels: Sequence[Integrity], start_ns: int) -> list[Stay]:
    runs = [next(group) for _, group in groupby(levels, key=lambda i: i.state)]
    ends = [i.t_ns for i in runs[1:]] + [levels[-1].t_ns]
    return [
        Stay(
            round((i.t_ns - start_ns) * 1e-9, 3),
            round((end - start_ns) * 1e-9, 3),
            _STATES[i.state],
            f"{i.state}: {i.reason}" if i.reason else str(i.state),
            str(i.state),
        )
        for i, end in zip(runs, ends, strict=True)
    ]
