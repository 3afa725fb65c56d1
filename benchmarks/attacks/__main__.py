"""Hostile files, arguments, configurations, states and messages against landfix: one row a cell.

    python -m benchmarks.attacks [--areas log import ...] [--cases ../shared/cases] [--out benchmarks/results/attacks.json]

A cell is held where the command ends by itself, within 10 s of CPU and 1 GB, with the right exit code and one line that says
why; degraded where that is so but for the words; failed otherwise. The last three areas are a daemon's: it starts whatever its
state file is, loses at most 0.1 s of its log when it is killed, and goes on after each hostile message with estimates in time,
within 5 m of the truth. Failed: more than 1 m and more than 5 sigma off. Degraded: more than 5 m off, which its sigma says;
late; as much of the log lost as was underway on a busy machine.
"""

import argparse
import importlib
import json
import os
import pkgutil
import re
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import msgspec

import calib
import estimator
import logs
import models
import vision
from benchmarks.attacks import files, limited, live, typed
from benchmarks.attacks.cell import Cell, Row
from estimator.service.warm_up import warm_up
from estimator.version import version

AREAS = {
    "log": files.logs, "import": files.importers, "map": files.maps, "image": files.images,
    "configuration": typed.configurations, "argument": typed.arguments,
}  # fmt: skip
LIVE = {  # last, in this order: after messages nothing can be forked
    "state file": live.state_files, "kills": live.kills, "messages": live.messages,
}  # fmt: skip
_RARE = re.compile(r"__main__|bench|fleet|plot|report|evidence|tune|overlay")
_CASES = Path(os.environ.get("LANDFIX_DATA", "../shared/data")).parent / "cases"


def rows(folder: Path, cases: Path, areas: Iterable[str], only: Sequence[str] = (), *, shared: bool = False) -> Iterator[Row]:
    """The cells whose name contains one of `only`, in turn; shared: of those, the ones with a file of the shared cases."""
    _load()
    files.prepare(folder)
    known = [path.name.removesuffix(".xz") for part in ("attacks", "turn3") for path in (cases / part).glob("*.*")]
    for area in areas:
        if area in LIVE:
            warm_up()  # before a daemon is forked
            yield from LIVE[area](folder)
            continue
        for cell in AREAS[area](folder, cases):
            wanted = not only or any(part in cell.name for part in only)
            if wanted and (not shared or any(name in cell.name for name in known)):
                yield _row(cell, folder)


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
    parser.add_argument("--areas", nargs="*", choices=[*AREAS, *LIVE], default=[*AREAS, *LIVE])
    parser.add_argument("--only", nargs="*", default=[], help="cells whose name contains one of these")
    parser.add_argument("--shared", action="store_true", help="cells with a file of the shared cases")
    parser.add_argument("--cases", type=Path, default=_CASES, help="folder of shared cases")
    parser.add_argument("--out", type=Path, help="rows as JSON")
    given = parser.parse_args()
    done: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        for row in rows(Path(name), given.cases.resolve(), given.areas, given.only, shared=given.shared):
            done.append(row)
            if row.verdict != "held" or given.only:
                print(row.verdict, row.area, row.name, f"{row.cpu_s} s", row.reason, "|", row.said, flush=True)
    counts = Counter(row.verdict for row in done)
    print(f"{len(done)} cells: {dict(counts)}")
    if given.out:
        document = {"version": version(), "command": "python -m benchmarks.attacks", "counts": counts}
        lines = ",\n".join(json.dumps(msgspec.to_builtins(row)) for row in done)
        given.out.write_text(f'{json.dumps(document, indent=1)[:-2]},\n "rows": [\n{lines}\n]}}\n')
    raise SystemExit(bool(counts["failed"]))


if __name__ == "__main__":
    main()
