"""Protection levels against true errors: regions of a Stanford plot (Walter, Hansen and Enge 1999).

    error e, protection level PL, alert limit AL        PL <= AL          PL > AL
    e <= PL                                             nominal           unavailable
    PL < e <= AL                                        misleading        unavailable
    AL < e                                              hazardous         unavailable

A level holds until the next, a second at most.
"""

from collections import Counter
from collections.abc import Sequence
from typing import Final, NamedTuple

import msgspec
import numpy as np

from logs.evaluation.metrics import Times
from models.messages import Array, Integrity

_HOLDS_NS: Final = 1_000_000_000


class Regions(msgspec.Struct, frozen=True):
    """exceeded: errors above levels at the fixed risks, then the configured one."""

    compared: int
    nominal: int
    misleading: int
    hazardous: int
    unavailable: int
    exceeded: tuple[int, ...]
    median_level_m: float | None  # None: infinite

    @property
    def available(self) -> float:
        """Share of the time within the alert limit."""
        return 1.0 - self.unavailable / self.compared if self.compared else 0.0


class IntegritySummary(msgspec.Struct, frozen=True):
    """states: shares; limits_m: horizontal, vertical; horizontal, vertical: None without truth."""

    evaluations: int
    hours: float
    risk_per_hour: float
    risks_per_hour: tuple[float, ...]
    limits_m: tuple[float | None, float | None]
    states: dict[str, float]
    horizontal: Regions | None
    vertical: Regions | None


class Compared(NamedTuple):
    """m levels with a truth: row, horizontal and vertical error [m], each (m,)."""

    row: Times
    horizontal: Array
    vertical: Array


def against_truth(levels: Sequence[Integrity], t_ns: Times, p_error: Array) -> Compared:
    """t_ns (n,), p_error (n, 3), ENU or NED."""
    horizontal, vertical = np.hypot(p_error[:, 0], p_error[:, 1]), np.abs(p_error[:, 2])
    stamps = np.array([i.t_ns for i in levels], np.int64)
    row = np.searchsorted(stamps, t_ns, side="right") - 1
    held = (row >= 0) & (t_ns - stamps[np.maximum(row, 0)] <= _HOLDS_NS) if len(levels) else np.zeros(len(t_ns), bool)
    rows, group = np.unique(row[held], return_inverse=True)
    worst = np.zeros((2, len(rows)))
    for k, error in enumerate((horizontal, vertical)):
        np.maximum.at(worst[k], group, error[held])
    return Compared(rows, worst[0], worst[1])


def regions(error: Array, level: Array, limit_m: float, others: Sequence[Array]) -> Regions:
    """Counts of errors (n,), levels (n,), limit; others: levels at other risks, (n,)."""
    within = level <= limit_m
    above = error > level
    return Regions(
        compared=len(error),
        nominal=int(np.sum(within & ~above)),
        misleading=int(np.sum(within & above & (error <= limit_m))),
        hazardous=int(np.sum(within & above & (error > limit_m))),
        unavailable=int(np.sum(~within)),
        exceeded=tuple(int(np.sum(error > other)) for other in (*others, level)),
        median_level_m=_limit(float(np.median(level))) if len(level) else None,
    )


def summarise(levels: Sequence[Integrity], t_ns: Times, p_error: Array) -> IntegritySummary | None:
    """None without protection levels; errors as against_truth."""
    if not levels:
        return None
    last, found = levels[-1], against_truth(levels, t_ns, p_error)
    at = [levels[k] for k in found.row.tolist()]
    many = np.array([(*i.hpls_m, i.hpl_m, *i.vpls_m, i.vpl_m) for i in at]).reshape(len(at), 2 * len(last.hpls_m) + 2).T
    half = len(many) // 2
    counted = Counter(str(i.state) for i in levels)
    return IntegritySummary(
        evaluations=len(levels),
        hours=(last.t_ns - levels[0].t_ns) / 3.6e12,
        risk_per_hour=last.risk_per_hour,
        risks_per_hour=last.risks_per_hour,
        limits_m=(_limit(last.hal_m), _limit(last.val_m)),
        states={state: n / len(levels) for state, n in counted.items()},
        horizontal=regions(found.horizontal, many[half - 1], last.hal_m, list(many[: half - 1])) if at else None,
        vertical=regions(found.vertical, many[-1], last.val_m, list(many[half:-1])) if at else None,
    )


def _limit(of: float) -> float | None:
    return of if np.isfinite(of) else None
