"""The fleet engine on this machine: a bucket that fails, workers killed; goes on where it ended.

python -m benchmarks.fleet --flights 2000 --jobs 2
"""

import argparse
from pathlib import Path

import msgspec

from benchmarks.fleet import failures
from benchmarks.flights.tasks import ROOT
from estimator.version import version


def main() -> None:
    """Writes OUT/fleet.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "fleet")
    args = parser.parse_args()
    (args.out / "logs").mkdir(parents=True, exist_ok=True)
    measured = failures.table(args.flights, args.jobs, args.out)
    measured["command"] = f"python -m benchmarks.fleet --flights {args.flights} --jobs {args.jobs}"
    report = msgspec.json.format(msgspec.json.encode({"version": version(), "tables": [measured]}), indent=1)
    (args.out / "fleet.json").write_bytes(report + b"\n")
    print(report.decode())


if __name__ == "__main__":
    main()
