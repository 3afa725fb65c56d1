"""What a flight with protection levels comes to: every level against the errors until the next one."""

import math
from typing import Final

import msgspec
import numpy as np

from estimator.integrity.config import IntegrityConfig
from logs.evaluation.integrity import Regions, against_truth, regions
from logs.evaluation.metrics import Mask, Times
from models.messages import Alert, Array, Integrity

LIMITS: Final = IntegrityConfig(hal_m=10.0, val_m=10.0)
STEP: Final = 0.05  # of the counts kept for the plot, decades
INFINITE: Final = 10**6  # stands for an infinite level there
_APART_NS: Final = round(LIMITS.correlation_s * 1e9)


class Row(msgspec.Struct, frozen=True):
    """Of one job. horizontal, vertical: None where there was no estimate.

    events: errors above the level at 1e-3, 1e-5, 1e-7 per hour, on either axis, those 10 s apart or more; hazards: errors above
    the alert limit while the state is usable; alerts_s, stops_s: from the error passing the limit to a state other than usable,
    and to "do not use" (None: not before it came back); false_alerts: times that it ceases to be usable while the error stays
    within the limit; misled: events at 1e-5 while the state is usable; worst: largest error / level at 1e-5; cells: error, level
    (in STEP decades), how many.
    """

    group: str
    flight: str
    kind: str
    size: float
    seed: int
    hours: float = 0.0
    horizontal: Regions | None = None
    vertical: Regions | None = None
    events: tuple[int, ...] = (0, 0, 0)
    within_10_m: int = 0
    hazards: int = 0
    alerts_s: tuple[float | None, ...] = ()
    stops_s: tuple[float | None, ...] = ()
    false_alerts: int = 0
    misled: int = 0
    worst: float = 0.0
    cells: tuple[tuple[int, int, int], ...] = ()


def row_of(levels: list[Integrity], t_ns: Times, error: Array) -> Row:
    """Levels in the order of their stamps; t_ns (n,), error (n, 3): stamps and errors of position, ENU or NED."""
    found = against_truth(levels, t_ns, error)
    at = [levels[k] for k in found.row.tolist()]
    if not at:
        return Row("", "", "", 0.0, 0)
    hpl, vpl = np.array([i.hpls_m for i in at]).T, np.array([i.vpls_m for i in at]).T
    stamps = np.array([i.t_ns for i in at], np.int64)
    above = [(found.horizontal > h) | (found.vertical > v) for h, v in zip(hpl, vpl, strict=True)]
    usable = np.array([i.state is Alert.USABLE for i in at])
    hal, val = LIMITS.hal_m or math.inf, LIMITS.val_m or math.inf
    too_far = (found.horizontal > hal) | (found.vertical > val)
    far = (np.hypot(error[:, 0], error[:, 1]) > hal) | (np.abs(error[:, 2]) > val)
    with np.errstate(divide="ignore"):
        ratio = np.maximum(found.horizontal / hpl[1], found.vertical / vpl[1])
    return Row(
        "", "", "", 0.0, 0,
        hours=float(stamps[-1] - stamps[0]) / 3.6e12,
        horizontal=regions(found.horizontal, np.array([i.hpl_m for i in at]), hal, list(hpl)),
        vertical=regions(found.vertical, np.array([i.vpl_m for i in at]), val, list(vpl)),
        events=tuple(_events(stamps[mask]) for mask in above),
        within_10_m=int(np.sum(hpl[1] <= 10.0)),
        hazards=int(np.sum(too_far & usable)),
        alerts_s=tuple(_delays(levels, t_ns, far, {Alert.CAUTION, Alert.DO_NOT_USE})),
        stops_s=tuple(_delays(levels, t_ns, far, {Alert.DO_NOT_USE})),
        false_alerts=_false_alerts(usable, too_far),
        misled=_events(stamps[above[1] & usable]),
        worst=float(ratio.max()),
        cells=_cells(found.horizontal, hpl[1]),
    )  # fmt: skip


def _events(stamps: Times) -> int:
    """How many, those nearer than 10 s to the one before not counted."""
    return int(np.sum(np.diff(stamps, prepend=-(2**62)) > _APART_NS)) if len(stamps) else 0


def _delays(levels: list[Integrity], t_ns: Times, far: Mask, states: set[Alert]) -> list[float | None]:
    """For each time that the error passes the limit: seconds to one of the states; None: not before the error came back."""
    edges = np.flatnonzero(np.diff(far.astype(int), prepend=0, append=0))
    delays: list[float | None] = []
    last_ns = -(2**62)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        from_ns, to_ns = int(t_ns[begin]), int(t_ns[end - 1])
        if from_ns - last_ns > _APART_NS:
            before = [i.state for i in levels if i.t_ns <= from_ns]
            alerted = [i.t_ns for i in levels if from_ns < i.t_ns <= to_ns and i.state in states]
            now = bool(before) and before[-1] in states
            delays.append(0.0 if now else (alerted[0] - from_ns) * 1e-9 if alerted else None)
        last_ns = to_ns
    return delays


def _false_alerts(usable: Mask, too_far: Mask) -> int:
    """Spells without use, behind one of use, in which the error never passes the limit; usable, too_far: (n,), at each level."""
    edges = np.flatnonzero(np.diff((~usable).astype(int), prepend=1, append=0))
    ends = edges[int(not usable[0]) :]  # a spell that begins with the flight is none
    return sum(not too_far[begin:end].any() for begin, end in zip(ends[::2], ends[1::2], strict=True))


def _cells(error: Array, level: Array) -> tuple[tuple[int, int, int], ...]:
    steps = np.round(np.log10(np.maximum(error, 1e-3)) / STEP).astype(int)
    rows = np.where(np.isfinite(level), np.round(np.log10(np.where(np.isfinite(level), level, 1.0)) / STEP), INFINITE).astype(int)
    pairs, counts = np.unique(np.stack([steps, rows], axis=1), axis=0, return_counts=True)
    return tuple((int(e), int(v), int(n)) for (e, v), n in zip(pairs, counts, strict=True))
