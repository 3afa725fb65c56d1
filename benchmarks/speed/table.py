"""The table of speeds: what each piece of work took, how that compares to the plain filter timed in the same rounds, the target.

Targets are for a machine on which the plain filter takes 37 us for an IMU sample; the column "here" scales them to this one.
"""

from pathlib import Path

import msgspec
import numpy as np

from benchmarks.flights.tasks import ROOT
from benchmarks.tables import Table, number

NAIVE_TARGET_US = 37.0


class Result(msgspec.Struct, frozen=True):
    """One piece of work. seconds: per unit, each round; naive_s: the plain filter's IMU sample, timed before each round.

    target_us: on the reference machine, None where none is set; real_time: per second of flight, shown as a multiple of it.
    """

    name: str
    unit: str
    seconds: list[float]
    naive_s: list[float]
    target_us: float | None = None
    real_time: bool = False

    @property
    def ratio(self) -> float:
        """Plain filter's IMU samples per unit, median of the rounds."""
        return float(np.median(np.array(self.seconds) / np.array(self.naive_s)))


RESULTS: list[Result] = []


def table() -> Table:
    """All results so far."""
    columns = ("work", "unit", "median", "minimum", "in naive IMU samples", "target", "target here", "met")
    return Table("Speed", columns, [_row(r) for r in RESULTS])


def _row(r: Result) -> tuple[str, ...]:
    median, least = float(np.median(r.seconds)), min(r.seconds)
    here = None if r.target_us is None else r.target_us * float(np.median(r.naive_s)) * 1e6 / NAIVE_TARGET_US
    met = "" if r.target_us is None else "yes" if r.ratio <= r.target_us / NAIVE_TARGET_US else "no"
    times = [None if us is None else us * 1e-6 for us in (r.target_us, here)]
    shown = [_shown(s, r.real_time) for s in (median, least, *times)]
    return (r.name, r.unit, shown[0], shown[1], number(r.ratio), shown[2], shown[3], met)


def _shown(seconds: float | None, real_time: bool) -> str:
    if seconds is None:
        return "-"
    if real_time:
        return f"{1.0 / seconds:.0f} x real time"
    return f"{number(seconds * 1e6)} us" if seconds < 1e-3 else f"{number(seconds * 1e3)} ms"


def text() -> str:
    """The table, kept in out/bench/speed.md too."""
    path = ROOT / "out" / "bench" / "speed.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(table().markdown())
    (path.with_suffix(".json")).write_bytes(msgspec.json.encode(RESULTS))
    return f"{table().markdown()}\n{Path('out/bench/speed.md')}"
