"""Two changes made on purpose, and whether the comparison finds their flights first.

noise: the gyroscope's noise x 3 in the configuration of one vehicle. bug: in a copy of the program a pose fix is never older
than 0.1 s. again: nothing is changed.
"""

import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
from distributed import Client

from benchmarks.fleet.logs import LATE, logs
from benchmarks.flights.tasks import ROOT
from estimator.config import parse
from estimator.tools.fleet.compare import compare
from estimator.tools.fleet.engine import cluster
from estimator.tools.fleet.results import read
from estimator.tools.fleet.run import run, settings_of
from estimator.tools.fleet.store import Flight, flights
from logs.store.reader import LogReader
from logs.store.recorder import CONFIG_ATTACHMENT

PACKAGES = ("estimator", "vision", "models", "calib", "logs", "landfix")
FILE = "logs/wire/decoding.py"
LINE = "    return PoseFix(_t_ns(message.header.stamp), arrived_ns, p_n"
BUG = "    return PoseFix(max(_t_ns(message.header.stamp), arrived_ns - 100_000_000), arrived_ns, p_n"


COLUMNS = ("changed", "of them moved", "others that moved", "of them worse", "of them first")


def table(count: int, jobs: int, out: Path) -> dict[str, Any]:
    """Each change over `count` flights."""
    found = flights([str(file) for file in logs(out / "logs", count)])
    results = str(out / "changes")
    late = {flight.log for flight in found if int(Path(flight.log).stem) % LATE == 0}
    with cluster(jobs) as client:
        for label in ("before", "again"):
            run(found, settings_of(label, None, "/truth"), results, client)
        noisy = of_one_vehicle(found, results, client)
    with_bug([flight.log for flight in found], results, jobs)
    rows = [[label, *judged(results, label, changed)] for label, changed in (("again", set()), ("noise", noisy), ("bug", late))]
    return {"section": "Two changes made on purpose", "columns": ["change", *COLUMNS], "rows": rows}


def of_one_vehicle(found: list[Flight], results: str, client: Client) -> set[str]:
    """The logs with the configuration of the first, run with its noise x 3, the others as before."""
    texts = {flight.log: configuration(Path(flight.log)) for flight in found}
    text = texts[found[0].log]
    config = parse(text)
    wrong = msgspec.structs.replace(config.imu, gyro_noise=3.0 * config.imu.gyro_noise)
    changed = msgspec.structs.replace(config, imu=wrong).toml()
    settings = settings_of("noise", None, "/truth")
    run([f for f in found if texts[f.log] == text], msgspec.structs.replace(settings, configuration=changed), results, client)
    run([f for f in found if texts[f.log] != text], settings, results, client)
    return {log for log in texts if texts[log] == text}


def configuration(log: Path) -> str:
    """That which is attached."""
    with LogReader(log) as reader:
        next(iter(reader), None)
        return next(a.data.decode() for a in reader.attachments if a.name == CONFIG_ATTACHMENT)


def with_bug(logs_: list[str], results: str, jobs: int) -> None:
    """The copy of the program over the same logs, as its user would do it."""
    with TemporaryDirectory() as folder:
        for package in PACKAGES:
            copytree(ROOT / package, Path(folder) / package)
        file = Path(folder) / FILE
        text = file.read_text()
        if LINE not in text:
            raise SystemExit(f"{FILE}: the line to change is another now")
        file.write_text(text.replace(LINE, BUG))
        (Path(folder) / "logs.txt").write_text("\n".join(logs_))
        command = [sys.executable, "-m", "estimator", "fleet", "run", f"{folder}/logs.txt", "-o", str(Path(results).resolve())]
        environment = {**os.environ, "PYTHONPATH": folder}
        subprocess.run([*command, "--label", "bug", "--jobs", str(jobs)], check=True, cwd=folder, env=environment)


def judged(results: str, label: str, changed: set[str]) -> list[int]:
    """COLUMNS: where the flights of the change stand in the comparison."""
    compared = compare(read(results), ("before", label))
    moved = [change.log for change in compared.changes if change.worse != 0.0]
    worse = [change.log for change in compared.changes if change.worse > 0.0]
    return [
        len(changed),
        sum(log in changed for log in moved),
        sum(log not in changed for log in moved),
        sum(log in changed for log in worse),
        sum(change.log in changed for change in compared.changes[: len(worse)]),
    ]
