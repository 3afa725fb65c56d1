"""The evidence pack of `landfix evidence`.

pack.md is the document; drawn.json, alerts.json, campaign.json and versions.json hold its numbers. The drawn campaign is flown
for so many hours of flight (its seeds make the same flights on any machine of one type); the campaign of docs/integrity_runs.csv
is counted as it stands there.
"""

import json
import platform
from collections.abc import Sequence
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.drawn.__main__ import fly
from benchmarks.drawn.__main__ import report as report_of
from benchmarks.drawn.alerts import alerts
from benchmarks.drawn.faults import FAULTS_A_FLIGHT, KINDS, RATES
from benchmarks.drawn.rates import Flown, Rate, rate
from benchmarks.evidence.requirements import REQUIREMENTS
from benchmarks.flights.tasks import ROOT
from benchmarks.integrity.record import RECORD, added
from benchmarks.integrity.report import summary
from benchmarks.jobs import run_jobs
from benchmarks.tables import Table
from estimator.integrity.config import IntegrityConfig
from estimator.tools.fleet.flight import code
from estimator.version import version

_SECONDS = 120.0
_STANDARDS = (
    (
        "SORA (JARUS)",
        "integrity and assurance of a mitigation are argued by the operator, from PL-1 to PL-6",
        "nothing is assessed",
    ),
    (
        "EUROCAE ED-12C / RTCA DO-178C",
        "requirements, tests and their tracing have its form",
        "a level; independence, structural coverage, tool qualification",
    ),
    (
        "EUROCAE ED-324 / SAE ARP6983",
        "for machine-learned parts: the estimator and its levels have none",
        "landfix[learned], to which it applies",
    ),
    (
        "RTCA DO-229 (SBAS), ARAIM",
        "terms, Stanford diagram and multiple-hypothesis levels follow them",
        "their threat models, which are of satellites",
    ),
)


def write(folder: Path, hours: float, jobs: int | None = 1, scheduler: str = "", record: Path = RECORD) -> Path:
    """Fly so many hours, those that stand in `folder` already taken from there, and write the pack; its document."""
    folder.mkdir(parents=True, exist_ok=True)
    seeds = [(seed, _SECONDS) for seed in range(max(1, round(hours * 3600.0 / _SECONDS)))]
    flown = run_jobs(seeds, fly, Flown, folder / "flights.jsonl", processes=jobs, resume=True, scheduler=scheduler)
    found = rate(flown)
    campaign = summary(added([], record))
    _save(folder / "drawn.json", msgspec.to_builtins(found))
    _save(folder / "alerts.json", msgspec.to_builtins(alerts(flown)))
    _save(folder / "campaign.json", {"record_sha256": _digest(record), "summary": campaign.splitlines()})
    _save(folder / "versions.json", versions())
    (folder / "pack.md").write_text(document(found, flown, campaign, hours), encoding="utf-8")
    return folder / "pack.md"


def document(found: Rate, flown: Sequence[Flown], campaign: str, hours: float) -> str:
    """The pack as one page of Markdown."""
    beyond = sorted({f.stratum for f in flown if f.has_event})
    causes = [(kind, k.cause, f"{RATES[k.cause]:g}", f"{k.sizes[0]:g} to {k.sizes[1]:g} {k.unit}") for kind, k in KINDS.items()]
    traced = [(r.name, r.text, ", ".join(r.tests), r.result or "the tests") for r in REQUIREMENTS]
    return "\n".join((
        "# Evidence for the protection levels",
        f"landfix {version()}, program {code()}. Drawn: {found.flights} flights, {found.hours:.2f} h.",
        "## Claim",
        "While the state is `usable`, the position error exceeds the protection level at most at the configured risk per hour, "
        "for the faults and rates below. Counting does not show 1e-5 per hour; the claim rests on the fault table and its rates, "
        "and the flights fail or do not fail to contradict it.",
        f"**Not covered**: {', '.join(beyond) if beyond else 'no stratum of the drawn flights had an event'}; "
        "kinds that were not drawn; sizes beyond the ranges drawn; sources that fail together.",
        "## Assumptions",
        assumptions().markdown(),
        "## Faults and rates",
        Table("The rate of a cause is shared by its kinds", ("kind", "cause", "1/h of the cause", "sizes"), causes).markdown(),
        "## Method",
        f"Each flight has {FAULTS_A_FLIGHT:g} faults on average, far more than nominally. Its weight is the ratio of the nominal "
        "and the drawn probability of what it has; the weighted share of flights with an event is the nominal one. The bound is "
        "by strata: nominal probability times the Clopper-Pearson bound (95 %) of the share with an event.",
        "## Results: drawn faults",
        report_of(found, flown),
        "## Results: the campaign so far",
        campaign,
        "## Traceability",
        Table("Requirement, test, result", ("requirement", "text", "tests", "result"), traced).markdown(),
        "## Standards",
        Table("Use", ("document", "use", "not claimed"), _STANDARDS).markdown(),
        "## Again",
        f"`landfix evidence --hours {hours:g} -o FOLDER` makes these numbers again, "
        "`python -m benchmarks.integrity` those of the campaign; `pytest tests/estimator/integrity tests/benchmarks` runs "
        "the tests; versions.json has hashes.",
        "",
    ))  # fmt: skip


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
