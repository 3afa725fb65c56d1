"""Tables and the Stanford plot of benchmarks.integrity."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import beta

from benchmarks.integrity.runs import INFINITE, LIMITS, STEP, Row
from benchmarks.tables import Table, number
from estimator.integrity.monitor import RISKS
from logs.report.stanford import stanford

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
    fixes, wrong = sum(r.fixes for r in rows), sum(r.wrong for r in rows)
    if fixes:
        looks = sum(round(r.size) for r in rows if r.group == "looks")
        share = bound(wrong, fixes)
        lines.append(f"identification: {looks} frames, {fixes} fixes, {wrong} wrong (95 %: at most {share:.2g} of the fixes)")
    return "\n".join(f"- {line}" for line in lines) + "\n"


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


def plot(rows: Sequence[Row], title: str) -> str:
    """The Stanford plot of all rows, SVG."""
    cells = [cell for r in rows for cell in r.cells]
    error = np.repeat([10.0 ** (STEP * e) for e, _, _ in cells], [n for *_, n in cells])
    level = np.repeat([np.inf if v == INFINITE else 10.0 ** (STEP * v) for _, v, _ in cells], [n for *_, n in cells])
    return stanford(error, level, LIMITS.hal_m or np.inf, title)
