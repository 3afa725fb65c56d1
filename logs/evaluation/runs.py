"""Evaluations side by side: terminal, Markdown, CSV.

print_runs(compare_runs([evaluate(a), evaluate(b)]))
"""

import csv
import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from logs.evaluation.records import Evaluation
from logs.evaluation.table import number
from models.messages import Reason


class Run(msgspec.Struct, frozen=True):
    """outage_end_m: RMS; nees_*: mean / dof; inside95: share of time."""

    run: str
    duration_s: float
    distance_m: float
    without_absolute_s: float
    longest_outage_s: float
    position_m: float | None
    aided_m: float | None
    max_m: float | None
    outage_end_m: float | None
    attitude_deg: float | None
    velocity_m_s: float | None
    nees_position: float | None
    nees_attitude: float | None
    inside95: float | None
    radius95_max_m: float | None
    fused: int
    not_fused: int
    resets: int


_TITLES: Final = {  # short, as in speech
    "run": ("run", "run"),
    "duration_s": ("s", "duration, s"),
    "distance_m": ("m", "distance, m"),
    "without_absolute_s": ("no fix s", "without absolute fix, s"),
    "longest_outage_s": ("gap s", "  the longest, s"),
    "position_m": ("RMSE m", "position error, RMS, m"),
    "aided_m": ("aided m", "  outside outages, m"),
    "max_m": ("max m", "  largest, m"),
    "outage_end_m": ("end m", "  at the ends of outages, m"),
    "attitude_deg": ("att deg", "attitude error, RMS, deg"),
    "velocity_m_s": ("vel m/s", "velocity error, RMS, m/s"),
    "nees_position": ("NEES p", "NEES / dof, position"),
    "nees_attitude": ("NEES att", "NEES / dof, attitude"),
    "inside95": ("in 95 %", "inside the 95 % radius"),
    "radius95_max_m": ("radius m", "largest 95 % radius, m"),
    "fused": ("fused", "measurements fused"),
    "not_fused": ("not fused", "  not fused"),
    "resets": ("resets", "resets"),
}
_CORE: Final = (
    "run",
    "duration_s",
    "longest_outage_s",
    "position_m",
    "aided_m",
    "max_m",
    "attitude_deg",
    "nees_position",
    "inside95",
)
_SIDE_BY_SIDE: Final = 3  # runs that fit side by side on a terminal; more stand below each other, the core of them
_BADNESS: Final[dict[str, Callable[[float], float]]] = {  # by which the best of a column is chosen
    **dict.fromkeys(("position_m", "aided_m", "max_m", "outage_end_m", "attitude_deg", "velocity_m_s"), lambda x: x),
    **dict.fromkeys(("nees_position", "nees_attitude"), lambda x: abs(float(np.log(max(x, 1e-9))))),
    "inside95": lambda x: abs(x - 0.95),
}
MEDIAN: Final = "median"
_MEDIAN_FROM: Final = 3  # runs


def compare_runs(evaluations: Sequence[Evaluation]) -> list[Run]:
    """A row each, named by what distinguishes the logs."""
    return [_run(name, e) for name, e in zip(_names([e.log for e in evaluations]), evaluations, strict=True)]


def _run(name: str, e: Evaluation) -> Run:
    a, h = e.accuracy, e.consistency
    outages = [o for o in e.outages if o.source == "all"]
    ends = [o.drift.end_m for o in outages if o.drift]
    fused = sum(aid.reasons.get(Reason.FUSED, 0) for aid in e.aids)
    return Run(
        run=name,
        duration_s=e.duration_s,
        distance_m=e.distance_m,
        without_absolute_s=e.without_absolute_s,
        longest_outage_s=max((o.duration_s for o in outages), default=0.0),
        position_m=_finite(a.position_m.rmse) if a else None,
        aided_m=_finite(a.aided_position_m.rmse) if a else None,
        max_m=_finite(a.position_m.max) if a else None,
        outage_end_m=float(np.sqrt(np.mean(np.square(ends)))) if ends else None,
        attitude_deg=_finite(a.attitude_deg.rmse) if a else None,
        velocity_m_s=_finite(a.velocity_m_s.rmse) if a else None,
        nees_position=_finite(h.position.mean) if h else None,
        nees_attitude=_finite(h.attitude.mean) if h else None,
        inside95=h.radius95_covered if h else None,
        radius95_max_m=h.radius95_max_m if h else None,
        fused=fused,
        not_fused=sum(n for aid in e.aids for n in aid.reasons.values()) - fused,
        resets=len(e.resets),
    )


def print_runs(runs: Sequence[Run], console: Console | None = None) -> None:
    """Print the table, the best of each quantity highlighted."""
    few = len(runs) <= _SIDE_BY_SIDE
    fields, rows, best = _cells(runs, Run.__struct_fields__ if few else _CORE)
    lines = [[_TITLES[f][few] for f in fields], *rows]
    styled = [
        [Text(cell, "bold green" if (row - 1, k) in best else "") for k, cell in enumerate(r)] for row, r in enumerate(lines)
    ]
    if few:
        styled = [list(column) for column in zip(*styled, strict=True)]
    table = Table(header_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for k, title in enumerate(styled[0]):
        table.add_column(title, justify="right" if k else "left", overflow="fold", no_wrap=few and not k)
    for cells in styled[1:]:
        table.add_row(*cells)
    (console or Console()).print(table)


def markdown(runs: Sequence[Run]) -> str:
    """Markdown table, best values bold."""
    fields, rows, best = _cells(runs, Run.__struct_fields__)
    lines = [[_TITLES[f][0] for f in fields], ["---"] + ["---:"] * (len(fields) - 1)]
    for row, cells in enumerate(rows):
        lines.append([f"**{c}**" if (row, k) in best else c.replace("|", "\\|") for k, c in enumerate(cells)])
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def comma_separated(runs: Sequence[Run]) -> str:
    """Field names and all digits; empty for None."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(Run.__struct_fields__)
    writer.writerows(["" if v is None else v for v in msgspec.structs.astuple(run)] for run in runs)
    return out.getvalue()


def _cells(runs: Sequence[Run], wanted: Sequence[str]) -> tuple[list[str], list[list[str]], set[tuple[int, int]]]:
    fields = [f for f in wanted if any(getattr(run, f) is not None for run in runs)]
    rows = [[_cell(f, getattr(run, f)) for f in fields] for run in runs]
    if len(runs) >= _MEDIAN_FROM:
        rows.append([MEDIAN if f == "run" else _cell(f, _median(runs, f)) for f in fields])
    best = {(row, k) for k, f in enumerate(fields) if f in _BADNESS and (row := _best(runs, f)) is not None}
    return fields, rows, best


def _cell(field: str, value: float | str | None) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.1%}" if field == "inside95" and value is not None else number(value)


def _median(runs: Sequence[Run], field: str) -> float | None:
    values = [getattr(run, field) for run in runs if getattr(run, field) is not None]
    return float(np.median(values)) if values else None


def _best(runs: Sequence[Run], field: str) -> int | None:
    badness = {row: _BADNESS[field](x) for row, run in enumerate(runs) if (x := getattr(run, field)) is not None}
    return min(badness, key=lambda row: badness[row]) if len(set(badness.values())) > 1 else None


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _names(paths: Sequence[str]) -> list[str]:
    whole = [Path(os.path.realpath(path.removesuffix(".mcap"))) for path in paths]
    if len({path.name for path in whole}) == len(paths):
        return [path.name for path in whole]
    folder = os.path.commonpath([path.parent for path in whole])
    return [str(path.relative_to(folder)) for path in whole]
