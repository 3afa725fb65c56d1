"""The report of a flight in one HTML file.

    write(Path("estimate.mcap"), Path("report.html"))

One pass; errors are thinned beyond 50 000 estimates, extremes kept.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from logs.evaluation.collected import TRUTH_TOPIC, Collected, NoEstimateError, read
from logs.evaluation.evaluate import assess, find_outages
from logs.evaluation.records import Evaluation
from logs.report import no_estimate
from logs.report.gather import Gathered
from logs.report.page import Illustrations, Material, page
from logs.report.words import at_fault, findings
from logs.store.reader import LogError, check_output

_MOST: Final = 50_000

Illustrate = Callable[[Collected, Gathered], Illustrations]


def no_illustrations(_: Collected, __: Gathered) -> Illustrations:
    """Neither landmarks nor images."""
    return Illustrations()


class Page(msgspec.Struct, frozen=True):
    """File written, and verdict."""

    report: str
    size: int
    verdict: str
    findings: list[str]


class Written(Page, frozen=True):
    """The page of an estimate."""

    evaluation: Evaluation


def write(
    log: Path,
    out: Path,
    *,
    truth_topic: str = TRUTH_TOPIC,
    outage_s: float | None = None,
    without_odometry: Path | None = None,
    illustrate: Illustrate = no_illustrations,
    progress: Callable[[float], None] | None = None,
) -> Page:
    """Write a log's report to `out`, also without an estimate. Raises LogError."""
    check_output(out, log)
    gathered = Gathered()
    try:
        collected = _read(log, truth_topic, progress, gathered)
    except NoEstimateError as missing:
        size = _save(out, no_estimate.page(log.name, missing, gathered))
        return Page(str(out), size, "no estimate", [*(cause.text for cause in at_fault(missing.attachments)), str(missing)])
    return compose(
        collected, gathered, log.name, out, outage_s=outage_s, without_odometry=without_odometry, illustrate=illustrate
    )


def gather(
    log: Path, truth_topic: str = TRUTH_TOPIC, progress: Callable[[float], None] | None = None
) -> tuple[Collected, Gathered]:
    """Report data in one pass. Raises LogError."""
    gathered = Gathered()
    return _read(log, truth_topic, progress, gathered), gathered


def _read(log: Path, truth_topic: str, progress: Callable[[float], None] | None, gathered: Gathered) -> Collected:
    collected = read(log, truth_topic, progress, most=_MOST, see=gathered.see)
    gathered.close()
    return collected


def compose(
    collected: Collected,
    gathered: Gathered,
    name: str,
    out: Path,
    *,
    outage_s: float | None = None,
    without_odometry: Path | None = None,
    illustrate: Illustrate = no_illustrations,
) -> Written:
    """Write the report to `out`; without_odometry: the same flight without. Raises LogError."""
    without = read(without_odometry).estimate if without_odometry else None
    evaluation = assess(collected, name, outage_s=outage_s, without_odometry=without)
    outages = find_outages(collected.aids, collected.health, collected.estimate, outage_s)["all"].spans
    found = findings(evaluation, collected, gathered)
    material = Material(collected, gathered, evaluation, outages, found, illustrate(collected, gathered))
    size = _save(out, page(material))
    return Written(str(out), size, material.level.word, [f.text for f in found], evaluation)


def _save(out: Path, content: str) -> int:
    data = content.encode()
    try:
        out.write_bytes(data)
    except OSError as error:
        raise LogError(f"{out}: cannot be written ({(error.strerror or 'unknown error').lower()})") from None
    return len(data)
