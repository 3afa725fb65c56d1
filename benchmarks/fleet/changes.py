"""Two changes made on purpose, and whether the comparison finds their flights first.

python -m benchmarks.fleet.changes --flights 40 --jobs 1 --out out/fleet

noise: the gyroscope's noise x 3 in the configuration of one vehicle. bug: in a copy of the program a pose fix is never older
than 0.1 s. again: nothing is changed.
"""

import argparse
import json
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
from estimator.version import version
from logs.store.reader import LogReader
from logs.store.recorder import CONFIG_ATTACHMENT

PACKAGES = ("estimator", "vision", "models", "calib", "logs", "landfix")
FILE = "logs/wire/decoding.py"
LINE = "    return PoseFix(_t_ns(message.header.stamp), arrived_ns, p_n"
BUG = "    return PoseFix(max(_t_ns(message.header.stamp), arrived_ns - 100_000_000), arrived_ns, p_n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fleet")
    args = parser.parse_args()
    (args.out / "logs").mkdir(parents=True, exist_ok=True)
    found = flights([str(file) for file in logs(args.out / "logs", args.flights)])
    results = str(args.out / "changes")
    late = {flight.log for flight in found if int(Path(flight.log).stem) % LATE == 0}
    with cluster(args.jobs) as client:
        for label in ("before", "again"):
            run(found, settings_of(label, None, "/truth"), results, client)
        noisy = of_one_vehicle(found, results, client)
    with_bug([flight.log for flight in found], results, args.jobs)
    report = {
        "version": version(),
        "command": f"python -m benchmarks.fleet.changes --flights {args.flights} --jobs {args.jobs}",
        "flights": len(found),
        **{label: judged(results, label, changed) for label, changed in (("again", set()), ("noise", noisy), ("bug", late))},
    }
    (args.out / "changes.json").write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report, indent=1))


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


def judged(results: str, label: str, changed: set[str]) -> dict[str, Any]:
    """Where the flights of the change stand in the comparison."""
    compared = compare(read(results), ("before", label))
    moved = [change.log for change in compared.changes if change.worse != 0.0]
    worse = [change.log for change in compared.changes if change.worse > 0.0]
    return {
        "changed": len(changed),
        "of them moved": sum(log in changed for log in moved),
        "others that moved": sum(log not in changed for log in moved),
        "of them worse": sum(log in changed for log in worse),
        "of them first": sum(change.log in changed for change in compared.changes[: len(worse)]),
        "p": {m.metric: m.p for m in compared.metrics if m.metric in {"rmse_m", "nees_position", "nis_per_dof"}},
    }


if __name__ == "__main__":
    main()
