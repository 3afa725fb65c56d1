"""The page that answers after a flight: where was I, how sure, why, what went wrong.

    write(Path("estimate.mcap"), Path("report.html"))

One HTML file that needs nothing else: text and tables stand in it, a script draws what logs/report/charts.py describes. The log
is read in one pass. Of more than 50 000 estimates (4 minutes at 200 Hz) errors are computed from every 2nd, 4th, ...; plots of
the estimate itself keep the extremes of all.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from logs.evaluation.evaluate import assess, find_outages
from logs.evaluation.evidence import TRUTH_TOPIC, Evidence, read
from logs.evaluation.records import Evaluation
from logs.report.gather import Gathered
from logs.report.page import Illustrations, Material, page
from logs.report.words import findings
from logs.store.reader import LogError, check_output

_MOST: Final = 50_000

Illustrate = Callable[[Evidence, Gathered], Illustrations]


def no_illustrations(_: Evidence, __: Gathered) -> Illustrations:
    """Neither landmarks nor pictures."""
    return Illustrations()


class Written(msgspec.Struct, frozen=True):
    """What was written, and what it says."""

    report: str
    size: int
    verdict: str
    findings: list[str]
    evaluation: Evaluation


def write(
    log: Path,
    out: Path,
    *,
    truth_topic: str = TRUTH_TOPIC,
    outage_s: float | None = None,
    illustrate: Illustrate = no_illustrations,
    progress: Callable[[float], None] | None = None,
) -> Written:
    """Write the report of a log to `out`. Raises LogError where there is no estimate, `out` is the log, or cannot be written."""
    check_output(out, log)
    return compose(*gather(log, truth_topic, progress), log.name, out, outage_s=outage_s, illustrate=illustrate)


def gather(
    log: Path, truth_topic: str = TRUTH_TOPIC, progress: Callable[[float], None] | None = None
) -> tuple[Evidence, Gathered]:
    """What a report is made of, in one pass over the log. Raises LogError."""
    gathered = Gathered()
    evidence = read(log, truth_topic, progress, most=_MOST, see=gathered.see)
    gathered.close()
    return evidence, gathered


def compose(
    evidence: Evidence,
    gathered: Gathered,
    name: str,
    out: Path,
    *,
    outage_s: float | None = None,
    illustrate: Illustrate = no_illustrations,
) -> Written:
    """Write the report of what was gathered to `out`. Raises LogError where it cannot be written."""
    evaluation = assess(evidence, name, outage_s=outage_s)
    outages = find_outages(evidence.aids, evidence.health, evidence.estimate, outage_s)["all"].spans
    found = findings(evaluation, evidence, gathered)
    material = Material(evidence, gathered, evaluation, outages, found, illustrate(evidence, gathered))
    content = page(material).encode()
    try:
        out.write_bytes(content)
    except OSError as error:
        raise LogError(f"{out}: cannot be written ({(error.strerror or 'unknown error').lower()})") from None
    return Written(str(out), len(content), material.level.word, [f.text for f in found], evaluation)
