"""The fleet engine measured on this machine; each part replaces its table in OUT/fleet.json.

python -m benchmarks.fleet failures --flights 2000 --jobs 2   a bucket that fails, workers killed; goes on where it ended
python -m benchmarks.fleet changes --flights 40               a noise x 3 and a bug: are their flights found first
python -m benchmarks.fleet cost                               a row, the commands, the estimator alone
python -m benchmarks.fleet scaling                            constants, and a million flights on 1,000 workers
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.fleet import changes, cost, failures, scaling
from benchmarks.flights.tasks import ROOT
from estimator.version import version

PARTS: dict[str, Callable[[int, int, Path], dict[str, Any]]] = {
    "failures": failures.table,
    "changes": changes.table,
    "cost": cost.table,
    "scaling": scaling.table,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fleet")
    args = parser.parse_args()
    (args.out / "logs").mkdir(parents=True, exist_ok=True)
    measured = PARTS[args.part](args.flights, args.jobs, args.out)
    file = args.out / "fleet.json"
    tables = msgspec.json.decode(file.read_bytes())["tables"] if file.exists() else []
    of_flights = f" --flights {args.flights} --jobs {args.jobs}" if args.part in {"failures", "changes"} else ""
    measured["command"] = f"python -m benchmarks.fleet {args.part}{of_flights}"
    report = {"version": version(), "tables": [*(t for t in tables if t["section"] != measured["section"]), measured]}
    file.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n")
    print(msgspec.json.format(msgspec.json.encode(measured), indent=1).decode())


if __name__ == "__main__":
    main()
