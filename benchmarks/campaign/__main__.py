"""Monte-Carlo campaign over simulated flights: is the covariance consistent, and the error near its lower bound?

python -m benchmarks.campaign                            all flights, 100 seeds each; goes on where it ended
python -m benchmarks.campaign --quick                    every third flight, 10 seeds
python -m benchmarks.campaign --scenarios rotor --seeds 20
"""

import argparse
import os
from pathlib import Path

from benchmarks.campaign.flights import matched
from benchmarks.campaign.report import flight_table, verdict
from benchmarks.campaign.runs import Score, run
from benchmarks.campaign.statistics import judge
from benchmarks.flights.tasks import ROOT
from benchmarks.jobs import run_jobs

FLIGHTS = {flight.name: flight for flight in matched()}


def main() -> None:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign", description=__doc__, formatter_class=formatter)
    parser.add_argument("--seeds", type=int, help="runs a flight (100; --quick: 10)")
    parser.add_argument("--scenarios", nargs="+", default=[""], metavar="NAME", help=f"beginnings of names: {', '.join(FLIGHTS)}")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--quick", action="store_true", help="every third flight, 10 seeds")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "campaign", help="folder of report and rows")
    args = parser.parse_args()
    names = [name for name in FLIGHTS if name.startswith(tuple(args.scenarios))][:: 3 if args.quick else 1]
    seeds = range(args.seeds or (10 if args.quick else 100))
    os.environ["OMP_NUM_THREADS"] = "1"  # inherited: one thread a process
    work = [(name, seed) for name in names for seed in seeds]
    scores = dict(zip(work, run_jobs(work, fly, Score, args.out / "rows.jsonl", processes=args.jobs, resume=True), strict=True))
    results = [judge(FLIGHTS[name], [scores[name, seed] for seed in seeds]) for name in names]
    report = f"{verdict(results).markdown()}\n{flight_table(results).markdown()}"
    (args.out / "report.md").write_text(report, encoding="utf-8")
    print(f"{report}\n{args.out}/report.md")


def fly(job: tuple[str, int]) -> Score:
    """A run of a flight."""
    return run(FLIGHTS[job[0]], job[1])


if __name__ == "__main__":
    main()
