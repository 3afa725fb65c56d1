"""Reports of the flights that moved most, replayed with their rows' configuration."""

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from estimator.tools.fleet.compare import Change, Rows
from estimator.tools.fleet.flight import Settings, code, estimate
from estimator.tools.fleet.results import configuration
from estimator.tools.fleet.store import flights
from logs.report.write import no_illustrations, write
from logs.store.reader import LogError


def reports_of(
    changes: Sequence[Change], results: str, folder: Path, progress: Callable[[float], None]
) -> dict[str, list[tuple[str, str]]]:
    """Log -> label and file of reports; other programs' rows are left out."""
    folder.mkdir(exist_ok=True)
    made: dict[str, list[tuple[str, str]]] = {}
    for k, change in enumerate(changes):
        for side, row in (("before", change.before), ("after", change.after)):
            out = folder / f"{k + 1}-{side}.html"
            if row["code"] == code() and not row["from_images"] and _write(row, results, out):
                made.setdefault(change.log, []).append((row["label"], f"{folder.name}/{out.name}"))
        progress((k + 1) / len(changes))
    return made


def _write(row: Rows, results: str, out: Path) -> bool:
    (flight,) = flights([row["log"] if row["parts"] == 1 else f"{row['log']}-*.mcap"])
    settings = Settings(row["label"], configuration(results, row["configuration_sha256"]))
    with TemporaryDirectory(prefix="landfix-") as scratch:
        try:
            write(estimate(flight, settings, Path(scratch)), out, illustrate=no_illustrations)
        except LogError:
            return False
    return True
