"""Hostile files, arguments and configurations against landfix: one row a cell.

    python -m benchmarks.attacks [--areas log import ...] [--count 10000] [--cases ../shared/cases] [--out FILE.jsonl] [--resume]

A cell is held where the command ends by itself, within 10 s of CPU and 1 GB, with the right exit code and one line that says
why; degraded where that is so but for the words; failed otherwise. Damaged files are drawn by seed (damaged.py): a row counts so
many files of a format.
"""

import argparse
import importlib
import os
import pkgutil
import re
import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path

import cv2
import msgspec

import calib
import estimator
import logs
import models
import vision
from benchmarks.attacks import damaged, files, limited, typed
from benchmarks.attacks.cell import Cell, Row
from estimator.version import version

AREAS = {
    "log": files.logs, "import": files.importers, "map": files.maps, "image": files.images,
    "configuration": typed.configurations, "argument": typed.arguments,
}  # fmt: skip
EVERY = [*AREAS, damaged.AREA]
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
        if area == damaged.AREA:
            yield from damaged.rows(folder, count, wanted)
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
    lines = given.out.read_bytes().splitlines() if given.resume and given.out.is_file() else []
    done = [*map(msgspec.json.Decoder(Row).decode, lines)]
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
