"""Two labels compared, flight by flight.

    d_i = c_i(after) - c_i(before)         c: the cost of a metric (metrics.py), i: a flight with both rows

A change exceeds the largest |d| of two labels of equal runs; the fleet is judged by Wilcoxon's signed-rank test.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import pyarrow as pa
from scipy.stats import wilcoxon

from estimator.tools.fleet.errors import FleetError
from estimator.tools.fleet.metrics import METRICS, RANKED, cost, is_ratio, percent, value_of

_BUDGET: Final = re.compile(r"\s*(\w+)\s+worse\s+([\d.]+)\s*%?\s+on\s+([\d.]+)\s*%\s*")
_FEWEST: Final = 6  # pairs with a difference, for the test to be able to say anything

Rows = Mapping[str, Any]


class Change(NamedTuple):
    """worse: largest cost difference of a metric; inf: no result."""

    log: str
    metric: str
    worse: float
    before: Rows
    after: Rows


class MetricChange(msgspec.Struct, frozen=True):
    """One metric over all pairs; median_percent: of the changes; p: of the test, None for too few."""

    metric: str
    pairs: int
    better: int
    worse: int
    noise: float
    median_percent: float
    p: float | None


class GroupChange(msgspec.Struct, frozen=True):
    """Flights with one value of a column."""

    value: str
    pairs: int
    better: int
    worse: int
    median_percent: float


class Broken(msgspec.Struct, frozen=True):
    """A budget and the share of flights beyond it, percent."""

    budget: str
    share_percent: float


class Comparison(msgspec.Struct, frozen=True):
    """changes: flights with both rows, worst first; least: cost that counts; only: with one row; differing: other inputs."""

    labels: tuple[str, str]
    pairs: int
    differing: int
    only_before: int
    only_after: int
    least: float
    better: int
    worse: int
    metrics: tuple[MetricChange, ...]
    by: str
    groups: tuple[GroupChange, ...]
    broken: tuple[Broken, ...]
    changes: list[Change]


def compare(
    rows: pa.Table,
    labels: tuple[str, str],
    noise: tuple[str, str] | None = None,
    by: str = "",
    budgets: Sequence[str] = (),
    least_percent: float = 1.0,
) -> Comparison:
    """least_percent: smaller changes do not count; by: a column. Raises FleetError."""
    if by and by not in rows.column_names:
        raise FleetError(f"--by {by}: no such column; there are {', '.join(rows.column_names)}")
    found = {label: _by_log(rows, label) for label in {*labels, *(noise or ())}}
    before, after = found[labels[0]], found[labels[1]]
    both = sorted(before.keys() & after.keys())
    if not both:
        raise FleetError(f"no flight has a row under both {labels[0]} and {labels[1]}")
    spread = {metric: _noise(found[noise[0]], found[noise[1]], metric) if noise else 0.0 for metric in METRICS}
    least = math.log1p(least_percent / 100.0)
    changes = sorted((_change(log, before[log], after[log], spread) for log in both), key=lambda c: (-c.worse, c.log))
    return Comparison(
        labels=labels,
        pairs=len(both),
        differing=sum(before[log]["inputs_sha256"] != after[log]["inputs_sha256"] for log in both),
        only_before=len(before) - len(both),
        only_after=len(after) - len(both),
        least=least,
        better=sum(c.worse < -least for c in changes),
        worse=sum(c.worse > least for c in changes),
        metrics=tuple(_metric(m, [(before[log], after[log]) for log in both], spread[m]) for m in METRICS),
        by=by,
        groups=tuple(_groups(changes, by, least)) if by else (),
        broken=tuple(b for text in budgets if (b := _broken(text, changes)) is not None),
        changes=changes,
    )


def _by_log(rows: pa.Table, label: str) -> dict[str, Rows]:
    return {row["log"]: row for row in rows.filter(pa.compute.field("label") == label).to_pylist()}


def difference(metric: str, before: Rows, after: Rows) -> float | None:
    """Difference of costs; inf: value lost, -inf: value gained, None: neither has one."""
    was, now = cost(metric, value_of(before, metric)), cost(metric, value_of(after, metric))
    if was is None or now is None:
        return None if was is now else math.copysign(math.inf, -1.0 if was is None else 1.0)
    return now - was


def _noise(one: Mapping[str, Rows], other: Mapping[str, Rows], metric: str) -> float:
    differences = [difference(metric, one[log], other[log]) for log in one.keys() & other.keys()]
    return max((abs(d) for d in differences if d is not None and math.isfinite(d)), default=0.0)


def _change(log: str, before: Rows, after: Rows, noise: Mapping[str, float]) -> Change:
    if bool(after["error"]) != bool(before["error"]):
        return Change(log, "error", math.inf if after["error"] else -math.inf, before, after)
    moved = [(d, m) for m in RANKED if (d := difference(m, before, after)) is not None and abs(d) > noise[m]]
    worst = max(moved, default=(0.0, ""))
    worse, metric = worst if worst[0] > 0.0 else min(moved, default=(0.0, ""))
    return Change(log, metric, worse, before, after)


def _metric(metric: str, pairs: Iterable[tuple[Rows, Rows]], noise: float) -> MetricChange:
    differences = [
        (x, value_of(before, metric)) for before, after in pairs if (x := difference(metric, before, after)) is not None
    ]
    d = np.array([x for x, _ in differences])
    moved = d[np.isfinite(d) & (d != 0.0)]
    changes = [percent(metric, x, was) for x, was in differences]
    return MetricChange(
        metric=metric,
        pairs=len(d),
        better=int(np.sum(d < -noise)),
        worse=int(np.sum(d > noise)),
        noise=noise,
        median_percent=float(np.median(changes)) if changes else 0.0,
        p=float(wilcoxon(moved).pvalue) if len(moved) >= _FEWEST else None,
    )


def _groups(changes: Iterable[Change], by: str, least: float) -> list[GroupChange]:
    groups: dict[str, list[float]] = {}
    for change in changes:
        groups.setdefault(str(change.after[by]), []).append(change.worse)
    table = [
        GroupChange(
            value=value,
            pairs=len(worse),
            better=sum(w < -least for w in worse),
            worse=sum(w > least for w in worse),
            median_percent=percent(RANKED[0], float(np.median(worse)), None),
        )
        for value, worse in groups.items()
    ]
    return sorted(table, key=lambda g: (-g.worse / g.pairs, g.value))


def _broken(text: str, changes: Sequence[Change]) -> Broken | None:
    match = _BUDGET.fullmatch(text)
    if match is None or match[1] not in METRICS:
        raise FleetError(f'--fail-if "{text}": write METRIC worse X % on Y %, METRIC one of {", ".join(METRICS)}')
    metric, most, share = match[1], float(match[2]), float(match[3])
    beyond = 0
    for change in changes:
        d = difference(metric, change.before, change.after)
        lost = change.metric == "error" and change.worse > 0.0
        beyond += lost or (d is not None and percent(metric, d, value_of(change.before, metric)) > most)
    found = 100.0 * beyond / len(changes)
    return Broken(text, found) if found > share else None


def words(change: Change) -> str:
    """The change of a flight as a person reads it."""
    if change.metric == "error":
        return change.after["error"] or f"had failed: {change.before['error']}"
    if not change.metric:
        return "equal"
    was, now = value_of(change.before, change.metric), value_of(change.after, change.metric)
    shown = " -> ".join("none" if x is None else f"{x:.4g}" for x in (was, now))
    ratio = f" (x {math.exp(abs(change.worse)):.3g} {'worse' if change.worse > 0 else 'better'})"
    return f"{change.metric} {shown}{ratio if is_ratio(change.metric) and math.isfinite(change.worse) else ''}"
