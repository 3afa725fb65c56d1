"""Hostile files, arguments, configurations, states and messages against landfix: one row a cell.

    python -m benchmarks.attacks [--areas log import ...] [--count 10000] [--cases ../shared/cases] [--out FILE.jsonl] [--resume]

A cell is held where the command ends by itself, within 10 s of CPU and 1 GB, with the right exit code and one line that says
why; degraded where that is so but for the words; failed otherwise. Damaged files and spoiled messages are drawn by seed
(damaged.py, flown.py): a row counts so many files of a format, or a quarter of 100 times as many messages. The last three areas
are a daemon's: it starts whatever its state file is, loses at most 0.1 s of its log when it is killed, and goes on after each
hostile message with estimates in time, within 5 m of the truth. Failed: more than 1 m and more than 5 sigma off. Degraded: more
than 5 m off, which its sigma says; late; as much of the log lost as was underway on a busy machine.
"""

import argparse
import importlib
import os
import pkgutil
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import cv2
import msgspec

import calib
import estimator
import logs
import models
import vision
from benchmarks.attacks import damaged, files, flown, limited, live, typed
from benchmarks.attacks.cell import Cell, Row
from estimator.service.warm_up import warm_up
from estimator.version import version


class Live(NamedTuple):
    """What is done to a daemon; rows: the areas of its rows."""

    of: Callable[[Path], Iterator[Row]]
    rows: tuple[str, ...]


AREAS = {
    "log": files.logs, "import": files.importers, "map": files.maps, "image": files.images,
    "configuration": typed.configurations, "argument": typed.arguments,
}  # fmt: skip
DRAWN = {damaged.AREA: damaged.rows, flown.AREA: flown.rows}
LIVE = {  # last, in this order: after messages nothing can be forked
    "state file": Live(live.state_files, ("state file",)),
    "kills": Live(live.kills, ("kill -9",)),
    "messages": Live(live.messages, ("zenoh", "mavlink", "burst")),
}
EVERY = [*AREAS, *DRAWN, *LIVE]
_RARE = re.compile(r"__main__|bench|fleet|plot|report|evidence|tune|overlay")
_CASES = Path(os.environ.get("LANDFIX_DATA", "../shared/data")).parent / "cases"


def rows(
    folder: Path,
    cases: Path,
    areas: Iterable[str],
    count: int,
    only: Sequence[str],
    known: Collection[tuple[str, str]],
    shared: bool,
) -> Iterator[Row]:
    """The cells whose name contains one of `only`, in turn, but for `known` areas and names; shared: those with a shared file."""
    _load()
    files.prepare(folder)
    files_shared = [path.name.removesuffix(".xz") for part in ("attacks", "turn3") for path in (cases / part).glob("*.*")]

    def wanted(area: str, name: str) -> bool:
        has_file = not shared or any(file in name for file in files_shared)
        return (area, name) not in known and (not only or any(part in name for part in only)) and has_file

    for area in areas:
        if area in LIVE:
            warm_up()  # before a daemon is forked
            yield from LIVE[area].of(folder)
        elif area in DRAWN:
            yield from DRAWN[area](folder, count, wanted)
        else:
            yield from (_row(cell, folder) for cell in AREAS[area](folder, cases) if wanted(cell.area, cell.name))


def _row(cell: Cell, folder: Path) -> Row:
    ended = limited.run(cell.words, folder)
    verdict, reason = limited.flaw(ended, cell.codes)
    said = (ended.stderr.strip() or ended.stdout.strip() or " ").splitlines()[-1].replace(str(folder), "")
    return Row(cell.area, cell.name, verdict, reason.replace(str(folder), ""), ended.code, ended.cpu_s, said[:300])


def _load() -> None:
    """What most commands import, once, before their processes are forked."""
    for package in (calib, estimator, logs, models, vision):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not _RARE.search(module.name):
                importlib.import_module(module.name)
    cv2.setNumThreads(1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--areas", nargs="*", choices=EVERY, default=EVERY)
    parser.add_argument("--count", type=int, default=1000, help="damaged files of each format")
    parser.add_argument("--only", nargs="*", default=[], help="cells whose name contains one of these")
    parser.add_argument("--shared", action="store_true", help="cells with a file of the shared cases")
    parser.add_argument("--cases", type=Path, default=_CASES, help="folder of shared cases")
    parser.add_argument("--out", type=Path, default=Path("out/attacks.jsonl"), help="a line a row, as it comes")
    parser.add_argument("--resume", action="store_true", help="the files' cells in --out are kept")
    given = parser.parse_args()
    again = {area for name in given.areas if name in LIVE for area in LIVE[name].rows}
    lines = given.out.read_bytes().splitlines() if given.resume and given.out.is_file() else []
    done = [row for row in map(msgspec.json.Decoder(Row).decode, lines) if row.area not in again]
    known = {(row.area, row.name) for row in done}
    given.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name, given.out.open("wb") as file:
        cells = rows(Path(name), given.cases.resolve(), given.areas, given.count, given.only, known, given.shared)
        for row in chain(done[:], (msgspec.structs.replace(row, version=version()) for row in cells)):
            file.write(msgspec.json.encode(row) + b"\n")
            file.flush()
            if (row.area, row.name) not in known:
                done.append(row)
                if row.verdict != "held" or given.only:
                    print(row.verdict, row.area, row.name, f"{row.cpu_s} s", row.reason, "|", row.said, flush=True)
    counts = Counter(row.verdict for row in done)
    print(f"{len(done)} cells: {dict(counts)}")
    raise SystemExit(bool(counts["failed"]))


if __name__ == "__main__":
    main()
