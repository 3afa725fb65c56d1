"""Alerts of drawn flights: how soon after a fault, how often without need, how much of the time is left to use."""

from collections.abc import Sequence

import msgspec
import numpy as np

from benchmarks.drawn.faults import KINDS
from benchmarks.drawn.rates import AIDS, NONE, Flown
from benchmarks.integrity.rows import LIMITS
from benchmarks.tables import Table
from models.messages import Alert, Integrity


class Alerts(msgspec.Struct, frozen=True):
    """Of the flights that have a kind of fault.

    passed: times that the error passes the limit; alerted: of them within the time to alert; covered: flights with no error above
    the level; caution_s: median from a fault to a state other than usable, None: no fault led to one; available: share of the
    time within the limits; false_per_hour: alerts while the error stays within the limit.
    """

    kind: str
    aids: str
    flights: int
    passed: int
    alerted: int
    covered: int
    caution_s: float | None
    available: float
    false_per_hour: float


def alerts(flown: Sequence[Flown]) -> list[Alerts]:
    """A line a kind and sources, the flights without a fault first, by vehicle, rate of the fixes, and outage."""
    names = sorted({f.vehicle for f in flown})
    groups = {(f"{NONE}, {v}", a): [f for f in flown if (f.vehicle, f.aids, f.faults) == (v, a, ())] for a in AIDS for v in names}
    groups |= {(k, a): [f for f in flown if f.aids == a and any(x.kind == k for x in f.faults)] for k in KINDS for a in AIDS}
    return [_line(kind, aids, some) for (kind, aids), some in groups.items() if some]


def _line(kind: str, aids: str, some: Sequence[Flown]) -> Alerts:
    delays = [a for f in some for a in f.row.alerts_s]
    cautions = [s for f in some for fault, s in zip(f.faults, f.cautions_s, strict=False) if fault.kind == kind and s is not None]
    regions = [r for f in some for r in (f.row.horizontal, f.row.vertical) if r is not None]
    hours = sum(f.row.hours for f in some)
    return Alerts(
        kind=kind,
        aids=aids,
        flights=len(some),
        passed=len(delays),
        alerted=sum(_in_time(s) for s in delays),
        covered=sum(not f.has_event for f in some),
        caution_s=float(np.median(cautions)) if cautions else None,
        available=min(1.0, float(np.mean([r.available for r in regions]))) if regions else 0.0,
        false_per_hour=sum(f.row.false_alerts for f in some) / hours if hours else 0.0,
    )


def _in_time(delay_s: float | None) -> bool:
    return delay_s is not None and delay_s <= LIMITS.time_to_alert_s


def in_time_or_covered(flown: Sequence[Flown]) -> tuple[int, int]:
    """Faults on flights whose every error beyond the limit is alerted in time, or below the level; and all faults."""
    good = [f for f in flown if not f.has_event or (f.row.alerts_s and all(map(_in_time, f.row.alerts_s)))]
    return sum(len(f.faults) for f in good), sum(len(f.faults) for f in flown)


def cautions(levels: Sequence[Integrity], spans_ns: Sequence[tuple[int, int]]) -> tuple[float | None, ...]:
    """For each fault, from when to when: seconds to the first state other than usable, None: none before it ends."""
    worse = [i.t_ns for i in levels if i.state in {Alert.CAUTION, Alert.DO_NOT_USE}]
    return tuple(next(((t - begin) * 1e-9 for t in worse if begin <= t <= end), None) for begin, end in spans_ns)


def table(flown: Sequence[Flown]) -> Table:
    """As a person reads it."""
    parts = [[f for f in flown if f.is_bounded is covered] for covered in (True, False)]
    (good, faults), (others, unbounded) = map(in_time_or_covered, parts)
    rows = [
        (
            a.kind, AIDS[a.aids], str(a.flights), str(a.passed), str(a.alerted), str(a.covered),
            "-" if a.caution_s is None else f"{a.caution_s:.1f}", f"{100.0 * a.available:.1f}", f"{a.false_per_hour:.1f}",
        )
        for a in alerts(flown)
    ]  # fmt: skip
    columns = (
        "kind", "sources", "flights", "error passes 10 m", f"alert within {LIMITS.time_to_alert_s:g} s", "level covers all",
        "fault to caution, median s", "available, %", "false alerts an hour",
    )  # fmt: skip
    title = f"{good} of {faults} faults that the table bounds in time or covered, {others} of {unbounded} on flights with another"
    return Table(f"Alerts: {title}", columns, rows)
