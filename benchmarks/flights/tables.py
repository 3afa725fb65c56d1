"""From the scores of many runs to the tables a person compares."""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from benchmarks.flights.runs import NAIVE, OURS
from benchmarks.tables import Table, number

Run = dict[str, Any]
Row: TypeAlias = dict[str, float]
PEERS: Final[dict[str, dict[str, Row]]] = json.loads((Path(__file__).parents[1] / "data" / "peers.json").read_text())["scenarios"]
COLUMNS = {
    "pos_m": "pos m",
    "att_deg": "att deg",
    **{f"{what}_{s}": f"{s} s {what}" for s in (5, 10, 30, 60) for what in ("rmse", "end")},
    "nees_p": "NEES/3 pos",
    "nees_a": "NEES/3 att",
    "nees_out": "NEES/3 pos outage",
    "inside95": "in 95 %",
}
SCENARIOS = {
    "N": "2 Hz pose fixes, no outage",
    "A": "outages 5, 10, 30 s",
    "B": "outage 60 s",
    "D": "as A, fixes 150 ms late",
    "L": "as A, fixes 0-5 s late, out of order",
    "F": "as A, 10 Hz fixes",
    "X": "as A, one fix in ten false",
    "C": "as A, consistent false fixes after each outage and within 38-42 s",
    "G": "position only, 5 Hz, outages 5, 10, 30 s",
    "V": "real vision estimates of EuRoC as fixes, 2 Hz, no outage",
    "W": "real vision estimates of EuRoC as fixes, outages as A",
}
ATTITUDE_GOOD = ("MH_", "V1_", "flight_a", "horiz_")  # flights whose true attitude is not tilted and does not lag


def row(run: Run) -> Row:
    """The scored figures of one run under the names of COLUMNS."""
    figures = {key: run[key] for key in ("pos_m", "att_deg", "nees_p", "nees_a", "inside95")}
    for o in run["out"]:
        figures |= {f"rmse_{o['s']:.0f}": o["rmse_m"], f"end_{o['s']:.0f}": o["end_m"]}
    inside = run["pool"]["inside"]
    if inside["n"]:
        figures["nees_out"] = inside["nees"] / inside["n"]
    return figures


def medians(runs: Iterable[Run]) -> Row:
    """Median of each figure over the runs that have it."""
    rows = [row(run) for run in runs if "pos_m" in run]
    keys = {key for r in rows for key in r}
    return {key: float(np.median([r[key] for r in rows if key in r])) for key in keys}


def scenario_table(scenario: str, runs: Sequence[Run]) -> Table:
    """Our medians per set, the naive filter's, and the peers' as published."""
    lines: list[tuple[str, str, Row]] = []
    for estimator in (OURS, NAIVE):
        for group in dict.fromkeys(run["set"] for run in runs):
            those = [run for run in runs if run["set"] == group and run["estimator"] == estimator]
            if those:
                lines.append((f"{estimator}, {group}", str(len(those)), medians(those)))
    lines += [(f"{name} (published)", "-", figures) for name, figures in PEERS.get(scenario, {}).items()]
    keys = [key for key in COLUMNS if any(key in figures for _, _, figures in lines)]
    rows = [(name, n, *(number(figures.get(key)) for key in keys)) for name, n, figures in lines]
    return Table(f"{scenario}: {SCENARIOS[scenario]} (medians)", ("estimator", "runs", *(COLUMNS[key] for key in keys)), rows)


def consistency_table(runs: Sequence[Run]) -> Table:
    """Position pooled over all samples of all flights and seeds; attitude over the flights whose truth allows it."""
    rows = []
    for estimator in (OURS, NAIVE):
        ours = [run for run in runs if run["estimator"] == estimator and "pool" in run]
        for scenario in dict.fromkeys(run["scenario"] for run in ours):
            those = [run for run in ours if run["scenario"] == scenario]
            attitude = [run["nees_a"] for run in those if run["flight"].startswith(ATTITUDE_GOOD)]
            cells = [number(_pooled(those, where, what)) for where in ("outside", "inside") for what in ("nees", "covered")]
            rows.append((scenario, estimator, str(len(those)), *cells, number(float(np.mean(attitude)) if attitude else None)))
    columns = ("scenario", "estimator", "runs", "NEES/3 pos", "in 95 %", "NEES/3 pos outage", "in 95 % outage")
    return Table("Consistency, pooled (aim: NEES/3 0.7-1.4, 0.90-0.99 in 95 %)", (*columns, "NEES/3 att MH V1 quad"), rows)


def _pooled(runs: Sequence[Run], where: str, what: str) -> float | None:
    n = sum(run["pool"][where]["n"] for run in runs)
    return sum(run["pool"][where][what] for run in runs) / n if n else None


def worst_table(runs: Sequence[Run], count: int = 15) -> Table:
    """Runs that are not complete, then those with the largest error outside outages."""
    ours = [run for run in runs if run["estimator"] == OURS]
    failed = [run for run in ours if not run["complete"]]
    largest = sorted((run for run in ours if run["complete"]), key=lambda run: -run["max_m"])[:count]
    columns = ("scenario", "flight", "seed", "complete", "max m outside outages", "pos m", "att deg", "NEES/3 pos", "fixes")
    rows = [
        (run["scenario"], run["flight"], str(run["seed"]), "yes" if run["complete"] else "NO", number(run.get("max_m")),
         number(run.get("pos_m")), number(run.get("att_deg")), number(run.get("nees_p")), _reasons(run))
        for run in failed + largest
    ]  # fmt: skip
    return Table(f"Worst runs ({len(failed)} of {len(ours)} not complete)", columns, rows)


def _reasons(run: Run) -> str:
    """Such as "120 fused, 3 gated", over the fixes of a run."""
    total: Counter[str] = Counter()
    for reasons in run.get("summary", {}).get("fixes", {}).values():
        total.update(reasons)
    return ", ".join(f"{n} {reason}" for reason, n in total.most_common())


def flight_table(scenario: str, runs: Sequence[Run], figure: str) -> Table:
    """One figure per flight, median over seeds."""
    estimators = list(dict.fromkeys(run["estimator"] for run in runs))
    rows = []
    for flight in dict.fromkeys(run["flight"] for run in runs):
        cells = [medians(r for r in runs if r["flight"] == flight and r["estimator"] == e).get(figure) for e in estimators]
        rows.append((flight, *(number(cell) for cell in cells)))
    return Table(f"{scenario}: {COLUMNS[figure]} per flight (median of seeds)", ("flight", *estimators), rows)
