"""For how long true positions are locked out after the last faulty reading.

    bound  true ones lead again after three more of them than there were false ones, or 3 s, whichever is longer

They lead where the error is within twice the largest one of the same flight without a fault (1 m at least), and stays so for two
seconds.
"""

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from benchmarks.drawn.faults import KINDS, Fault
from benchmarks.integrity.runs import flown
from benchmarks.stress.cell import errors
from benchmarks.stress.flights import Flight
from benchmarks.tables import Table, number
from models.messages import Array, Estimate, GnssFix, Input, PoseFix

_LEAST_M, _TWICE, _SETTLED_S = 1.0, 2.0, 12.0  # errors count from _SETTLED_S on
_MORE, _LEAST_S, _STAYS_S = 3, 3.0, 2.0
_SAMPLE_S: Final = 0.02


class Lockout(msgspec.Struct, frozen=True):
    """false: positions while a fault lasted; bound_s, locked_s: from the end of the last one on, None: to the end."""

    false: int
    bound_s: float
    locked_s: float | None

    @property
    def missed(self) -> bool:
        """Whether true positions are locked out for longer than the bound."""
        return self.locked_s is None or self.locked_s > self.bound_s + _SAMPLE_S


def lockout(flight: Flight, faults: Sequence[Fault], messages: Sequence[Input], estimates: dict[int, Estimate]) -> Lockout | None:
    """Of a flight whose faults end, with true positions for longer than the bound behind; None of another."""
    if not faults:
        return None
    last_s = max(f.to_s for f in faults)
    kind = PoseFix if any(isinstance(m, PoseFix) for m in messages) else GnssFix
    stamps = np.array([(m.t_ns - flight.start_ns) * 1e-9 for m in messages if isinstance(m, kind)])
    wrong = [f for f in faults if KINDS[f.kind].cause != "imu"]
    false = int(np.sum([(stamps >= f.from_s) & (stamps < f.to_s) for f in wrong])) if wrong else 0
    true_s = stamps[stamps > last_s]
    t_s, off, _ = errors(list(estimates.values()), flight, _SETTLED_S)
    if len(true_s) < false + _MORE or not len(t_s) or last_s < _SETTLED_S:
        return None
    bound_s = max(_LEAST_S, float(true_s[false + _MORE - 1]) - last_s)
    limit_m = _LEAST_M
    if off[t_s >= last_s].max(initial=0.0) > _LEAST_M:  # else it does not matter what is usual
        _, usual, _ = errors(list(flown(flight, flight.messages)[0].values()), flight, _SETTLED_S)
        limit_m = max(_LEAST_M, _TWICE * float(usual.max()))
    return Lockout(false, bound_s, locked_s(t_s, off, limit_m, last_s))


def locked_s(t_s: Array, off: Array, limit_m: float, last_s: float) -> float | None:
    """From last_s on, until the error is within the limit and stays there."""
    after = t_s >= last_s
    t, wrong = t_s[after], off[after] > limit_m
    for k in np.flatnonzero(~wrong):
        if not wrong[k : np.searchsorted(t, t[k] + _STAYS_S)].any():
            return float(max(t[k] - last_s, 0.0))
    return None


def table(found: Sequence[tuple[str, Lockout]]) -> Table:
    """One row a name of faults: how many, within the bound, the longest beyond it."""
    by_name: dict[str, list[Lockout]] = {}
    for name, row in found:
        by_name.setdefault(name, []).append(row)
    rows = [
        (
            name, str(len(some)), str(sum(not r.missed for r in some)),
            number(max((r.locked_s - r.bound_s for r in some if r.locked_s is not None and r.missed), default=None)),
            str(sum(r.locked_s is None for r in some)),
        )
        for name, some in sorted(by_name.items())
    ]  # fmt: skip
    missed = sum(r.missed for _, r in found)
    columns = ("fault", "flights", "within the bound", "longest beyond it, s", "never")
    return Table(f"Lock-out: {len(found) - missed} of {len(found)} within the bound", columns, rows)
