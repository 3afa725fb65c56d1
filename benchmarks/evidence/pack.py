"""The evidence pack of `landfix evidence`.

pack.md is the document; drawn.json, campaign.json, looks.json and versions.json hold its numbers, stanford.png and fault_tree.svg
its pictures. The drawn campaign is flown for so many hours of flight (its seeds make the same flights on any machine of one
type); docs/integrity_runs.csv and benchmarks/results/looks.json are counted as they stand there.
"""

import json
import platform
import re
import shutil
from collections.abc import Sequence
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from benchmarks.drawn.__main__ import SECONDS, fly_all, summary
from benchmarks.drawn.__main__ import report as drawn_report
from benchmarks.drawn.faults import FAULTS_A_FLIGHT, KINDS, RATES
from benchmarks.drawn.rates import AIDS, NONE, Flown
from benchmarks.flights.tasks import ROOT
from benchmarks.integrity.pictures import draw
from benchmarks.integrity.record import RECORD, added
from benchmarks.integrity.report import summary as campaign_summary
from benchmarks.tables import Table
from estimator.integrity.config import IntegrityConfig
from estimator.tools.fleet.flight import code
from estimator.version import version

_PAGE = ROOT / "docs" / "integrity.md"
_TREE = ROOT / "docs" / "images" / "integrity_faults.svg"
_LOOKS = ROOT / "benchmarks" / "results" / "looks.json"


class Requirement(NamedTuple):
    """tests: file::function under tests/; result: a file of the pack, or empty where the tests are the result."""

    name: str
    text: str
    tests: tuple[str, ...]
    result: str = ""


_DATA = json.loads((ROOT / "benchmarks" / "data" / "evidence.json").read_text(encoding="utf-8"))
REQUIREMENTS = tuple(Requirement(**one) for one in _DATA["requirements"])
_STANDARDS = [tuple(line) for line in _DATA["standards"]]


def write(folder: Path, hours: float, jobs: int | None = 1, scheduler: str = "", record: Path = RECORD) -> Path:
    """Fly so many hours, those that stand in `folder` already taken from there, and write the pack; its document."""
    folder.mkdir(parents=True, exist_ok=True)
    seeds = range(max(1, round(hours * 3600.0 / SECONDS)))
    flown = fly_all(seeds, folder / "flights.jsonl", jobs, scheduler)
    campaign = campaign_summary(added([], record))
    _save(folder / "drawn.json", summary(flown))
    _save(folder / "campaign.json", {"record_sha256": _digest(record), "summary": campaign.splitlines()})
    _save(folder / "versions.json", versions())
    draw(_panels(flown), folder / "stanford.png")
    shutil.copy(_TREE, folder / "fault_tree.svg")
    shutil.copy(_LOOKS, folder)
    (folder / "pack.md").write_text(document(flown, campaign, hours), encoding="utf-8")
    return folder / "pack.md"


def _panels(flown: Sequence[Flown]) -> dict[str, list[Any]]:
    parts = {
        f"{said}, {sources}": [f.row for f in flown if f.aids == aids and bool(f.faults) is faulty and f.is_bounded is bounded]
        for aids, sources in AIDS.items()
        for said, faulty, bounded in (("no fault", False, True), ("in the table", True, True), ("beyond it", True, False))
    }
    return {name: rows for name, rows in parts.items() if any(r.cells for r in rows)}


def document(flown: Sequence[Flown], campaign: str, hours: float) -> str:
    """The pack as one page of Markdown."""
    page = _PAGE.read_text(encoding="utf-8").splitlines()
    beyond = sorted({f"{' and '.join(x.kind for x in f.faults) or NONE} ({AIDS[f.aids]})" for f in flown if f.has_event})
    causes = [(kind, k.cause, f"{RATES[k.cause]:g}", f"{k.sizes[0]:g} to {k.sizes[1]:g} {k.unit}") for kind, k in KINDS.items()]
    traced = [(r.name, r.text, ", ".join(r.tests), r.result or "the tests") for r in REQUIREMENTS]
    return "\n".join((
        "# Evidence for the protection levels",
        f"landfix {version()}, program {code()}. Drawn: {len(flown)} flights of {SECONDS:g} s.\n",
        "## Claim",
        "While the state is `usable`, the position error exceeds the protection level at most at the configured risk per hour, "
        "for the faults and rates below. Counting does not show 1e-5 per hour: the claim rests on the fault table and its rates. "
        "The flights test it, and what they contradict is named here.\n",
        f"**Not covered**: {', '.join(beyond) if beyond else 'nothing that these few flights had'}; "
        "kinds that were not drawn; sizes beyond the ranges drawn; sources that fail together; and by the fault table itself:\n",
        part(page, "- ", after="## What is not covered"),
        "## Assumptions",
        assumptions().markdown(),
        "## Fault tree and rates",
        "![Fault tree](fault_tree.svg)\n",
        part(page, "|", after="## What may be wrong"),
        "## Faults drawn",
        Table("The rate of a cause is shared by its kinds", ("kind", "cause", "1/h of the cause", "sizes"), causes).markdown(),
        "## Method",
        f"Vehicle, manoeuvres, sources, rate of the fixes, an outage, and faults ({FAULTS_A_FLIGHT:g} on average, far more than "
        "nominally) are drawn from a flight's seed. Its weight is the ratio of the nominal and the drawn probability of what "
        "it has: w = product of p/q of each kind that it has and (1 - p)/(1 - q) of each that it has not. The sum of the weights "
        "of flights with an event, divided by the number of flights, is the nominal share. The bound is by strata: nominal "
        "probability times the Clopper-Pearson bound (95 %) of the share with an event (about 3 / flights where there is none). "
        "By hand: 1e-4 an hour are 3.3e-6 a flight of 120 s; 60 flights with the cause had no event, so at most "
        "3.3e-6 x 0.049 = 1.6e-7 a flight, 4.9e-6 an hour.\n",
        "## Results: drawn faults",
        drawn_report(flown),
        "![Stanford plots: error against protection level](stanford.png)\n",
        "## Results: the campaign so far",
        "Each line of its record is by the code of its time.\n",
        campaign,
        "## Results: identification among look-alikes",
        "Looks: the numbers stage alone, at whose position outlines are then searched. Pairs: rendered, through all stages. "
        "Wrong: off by more than 3 m and outside the 99.99 % ellipsoid, which one of 10,000 right positions is too. "
        "Claimed: how many should have a wrong identity, by their posteriors; surer: those that claim less than 1e-5.\n",
        looks(),
        "## Traceability",
        Table("Requirement, test, result", ("requirement", "text", "tests", "result"), traced).markdown(),
        "## Standards",
        Table("Use", ("document", "use", "not claimed"), _STANDARDS).markdown(),
        "## Again",
        f"`landfix evidence --hours {hours:g} -o FOLDER` makes these numbers again, "
        "`python -m benchmarks.integrity` those of the campaign, `python -m benchmarks.identification` those of identification; "
        "`pytest tests/estimator/integrity tests/benchmarks` runs the tests; versions.json has hashes.",
        "",
    ))  # fmt: skip


def looks() -> str:
    """What benchmarks.identification has counted so far."""
    found, before = (json.loads((_LOOKS.parent / name).read_text(encoding="utf-8")) for name in (_LOOKS.name, "integrity.json"))
    made_by = "\n".join(f"- {program}: {seeds}" for program, seeds in found["seeds"].items())
    table = f"{made_by}\n\n{Table('Today', tuple(found['columns']), found['rows']).markdown()}"
    old = next(one for one in before["tables"] if "--looks" in str(one["command"]))
    return "\n".join((table, old["note"] + "\n", Table("Before", tuple(old["columns"]), old["rows"]).markdown()))


def part(page: Sequence[str], mark: str, after: str) -> str:
    """The first table or list behind a heading of docs/integrity.md."""
    begin = next(k for k, line in enumerate(page) if line.startswith(after))
    begin = next(k for k in range(begin, len(page)) if page[k].startswith(mark))
    end = next(k for k in range(begin, len(page)) if not page[k].strip())
    return re.sub(r"\[(.+?)\]\(#.+?\)", r"\1 in docs/integrity.md", "\n".join([*page[begin:end], ""]))


def assumptions() -> Table:
    """The parameters of the levels, as configured by default."""
    config = IntegrityConfig()
    rows = [(field.name, f"{getattr(config, field.name)}") for field in msgspec.structs.fields(IntegrityConfig)]
    return Table("[integrity], defaults; reasons: docs/integrity.md", ("parameter", "value"), rows)


def versions() -> dict[str, Any]:
    """What made the numbers."""
    names = ("numpy", "scipy", "numba", "msgspec", "filterpy", "pymap3d")
    return {
        "landfix": version(),
        "program": code(),
        "python": platform.python_version(),
        "machine": platform.machine(),
        "packages": {name: metadata.version(name) for name in names},
        "lock_sha256": _digest(ROOT / "requirements.lock"),
    }


def _digest(file: Path) -> str:
    return sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


def _save(file: Path, value: object) -> None:
    file.write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")
