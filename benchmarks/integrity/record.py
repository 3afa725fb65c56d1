"""What the campaign has counted so far, one line a job, in docs/integrity_runs.csv: added to by every run, no job twice.

A job is a flight with its seed, so the same one on another machine is no new evidence. The line of a job that was run
again replaces the one before; the commit that changed the line names the code that it was run with.
"""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from benchmarks.flights.tasks import ROOT
from benchmarks.integrity.rows import Row

RECORD: Final = ROOT / "docs" / "integrity_runs.csv"
_OTHERS: Final = ("group", "flight", "kind", "size", "seed", "hours", "hazards", "worst")
_EVENTS: Final = ("above_1e-3", "above_1e-5", "above_1e-7")
COLUMNS: Final = (*_OTHERS, *_EVENTS)
_JOB: Final = 5  # columns that name it


def added(rows: Sequence[Row], record: Path = RECORD) -> list[Row]:
    """The rows put into the record; all that it holds, without the cells of plots."""
    lines = {tuple(line[:_JOB]): line for line in _read(record)}
    for row in rows:
        shown = [f"{v:.5g}" if isinstance(v, float) else str(v) for v in (getattr(row, name) for name in _OTHERS)]
        lines[tuple(shown[:_JOB])] = [*shown, *map(str, row.events)]
    with record.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(lines[job] for job in sorted(lines))
    return [_row(lines[job]) for job in sorted(lines)]


def _read(record: Path) -> list[list[str]]:
    if not record.is_file():
        return []
    with record.open(newline="", encoding="utf-8") as file:
        return [line for line in list(csv.reader(file))[1:] if len(line) == len(COLUMNS)]


def _row(line: Sequence[str]) -> Row:
    named = dict(zip(COLUMNS, line, strict=True))
    events = [named.pop(name) for name in _EVENTS]
    return msgspec.convert({**named, "events": events}, Row, strict=False)
