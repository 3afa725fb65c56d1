"""Counts and tables of benchmarks.integrity."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import beta

from benchmarks.integrity.rows import LIMITS, Row
from benchmarks.stress.perturbations import KINDS
from benchmarks.tables import Table, number
from estimator.integrity.monitor import RISKS

GROUPS = (
    "villages", "recorded flights", "rendered flights", "outages",
    "false fixes", "stress table", "conflicts", "beyond the fault table",
)  # fmt: skip
# kinds that the fault table does not have, and sizes from which they are above its own
BEYOND = {
    "IMU axes": 90.0, "fix scale": 0.2, "fix heading": 10.0, "fix units": 3.28,
    "map north": 10.0, "map shift": 5.0, "fix delay": 150.0, "fix clock steps": 300.0, "map turned": 1.0,
    "second map turned": 1.0, "second fixes shifted": 20.0, "second fixes shifted, with GNSS": 20.0,
}  # fmt: skip
_PER_HOUR = 3600.0 / LIMITS.correlation_s  # independent errors
_REGIONS = ("nominal", "misleading", "hazardous", "unavailable")
_TITLE = "Protection levels against true errors; events 10 s apart; regions: horizontal, 10 m, 1e-5 per hour; worst: at 1e-5"


def bound(events: int, trials: float, confidence: float = 0.95) -> float:
    """Upper end of the one-sided Clopper-Pearson interval of a share: with `events` in so many trials it is not larger."""
    if trials <= events:
        return 1.0
    return float(beta.ppf(confidence, events + 1, trials - events))


def summary(rows: Sequence[Row]) -> str:
    """How many hours, how often the error was above the level, and what that shows at 95 %."""
    parts = (("no fault injected", [r for r in rows if not is_faulty(r)]), ("with faults", [r for r in rows if is_faulty(r)]))
    lines = []
    for title, some in parts:
        flown = [r for r in some if r.hours]
        hours, hazards = sum(r.hours for r in flown), sum(r.hazards for r in flown)
        events = [sum(r.events[k] for r in flown) for k in range(len(RISKS))]
        most = [_PER_HOUR * bound(n, _PER_HOUR * hours) for n in events]
        shown = "; ".join(f"{r:g}: {n} (95 %: at most {m:.2g} per hour)" for r, n, m in zip(RISKS, events, most, strict=True))
        lines.append(f"{title}: {hours:.2f} h, {len(flown)} flights; events of error > PL at {shown}")
        lines.append(f"{title}: error > limit while usable: {hazards} evaluations")
    return "\n".join(f"- {line}" for line in lines) + "\n"


def group_of(row: Row) -> str:
    """Under which it is counted and drawn, if any."""
    if row.group in {"village", "rendered"}:
        return {"village": "villages", "rendered": "rendered flights"}[row.group]
    if row.group == "real":
        return "outages" if row.kind in "AB" else "false fixes"
    if row.group != "stress":
        return ""
    if row.kind.startswith("nothing"):
        return "recorded flights" if not row.flight.startswith("sim/") else "stress table"
    if row.kind in BEYOND and row.size >= BEYOND[row.kind]:
        return "beyond the fault table"
    return "conflicts" if KINDS[row.kind].aids == "both" else "stress table"


def groups_table(rows: Sequence[Row]) -> Table:
    """One line for each group; "at most per hour": events above PL(1e-5), upper end at 95 % (3 / hours where there are none)."""
    columns = ("group", "flights", "hours", *_REGIONS, *(f"vertical {r}" for r in _REGIONS), "HPL <= 10 m %", "> PL(1e-5)",
               "at most per hour", "worst e / PL", "far while usable")  # fmt: skip
    title = "Counts by group; levels at 1e-5 per hour, limits 10 m; the rate with 95 %"
    return Table(title, columns, [_group_line(name, some) for name, some in groups(rows).items() if some])


def groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The flights by group."""
    return {name: [r for r in rows if group_of(r) == name] for name in GROUPS}


def _group_line(name: str, rows: Sequence[Row]) -> tuple[str, ...]:
    hours, events = sum(r.hours for r in rows), sum(r.events[1] for r in rows)
    sides = [[s for s in side if s] for side in ([r.horizontal for r in rows], [r.vertical for r in rows])]
    compared = max(sum(s.compared for s in sides[0]), 1)
    return (
        *(name, str(len(rows)), f"{hours:.2f}"),
        *(str(sum(getattr(s, region) for s in side)) for side in sides for region in _REGIONS),
        f"{100.0 * sum(r.within_10_m for r in rows) / compared:.1f}",
        *(str(events), f"{_PER_HOUR * bound(events, _PER_HOUR * hours):.2g}"),
        *(number(max(r.worst for r in rows)), str(sum(r.hazards for r in rows))),
    )


def is_faulty(row: Row) -> bool:
    """Whether something in it is not as configured."""
    return (row.group == "stress" and not row.kind.startswith("nothing")) or (row.group == "real" and row.kind in "CX")


def table(rows: Sequence[Row]) -> Table:
    """One line for each kind and size."""
    above = tuple(f"> PL({risk:g})" for risk in RISKS)
    ends = ("worst e / PL", "over limit", "alert s, p50 / worst", "do not use s, p50 / worst", "far while usable")
    columns = ("flights", "kind", "size", "runs", "hours", "HPL <= 10 m %", *above, *_REGIONS, *ends)
    groups: dict[tuple[str, str, float], list[Row]] = {}
    for row in rows:
        if row.horizontal is not None:
            groups.setdefault((row.group, row.kind, row.size), []).append(row)
    return Table(_TITLE, columns, [_line(group) for group in groups.values()])


def _line(rows: list[Row]) -> tuple[str, ...]:
    first, sides = rows[0], [r.horizontal for r in rows if r.horizontal]
    compared = max(sum(s.compared for s in sides), 1)
    alerts, stops = [d for r in rows for d in r.alerts_s], [d for r in rows for d in r.stops_s]
    return (
        *(first.group, first.kind, f"{first.size:g}", str(len(rows)), f"{sum(r.hours for r in rows):.2f}"),
        f"{100.0 * sum(r.within_10_m for r in rows) / compared:.1f}",
        *(str(sum(r.events[k] for r in rows)) for k in range(len(RISKS))),
        *(str(sum(getattr(s, name) for s in sides)) for name in _REGIONS),
        *(number(max(r.worst for r in rows)), str(len(alerts)), _delay(alerts), _delay(stops), str(sum(r.hazards for r in rows))),
    )


def _delay(delays: Sequence[float | None]) -> str:
    """The median and the longest, one that never came the longest of all; how many never came."""
    if not delays:
        return "-"
    ordered = sorted(np.inf if d is None else d for d in delays)
    never = sum(d is None for d in delays)
    middle, longest = (f"{d:.1f}" if np.isfinite(d) else "never" for d in (ordered[(len(ordered) - 1) // 2], ordered[-1]))
    return f"{middle} / {longest}" + (f", {never} of {len(ordered)} never" if never else "")
