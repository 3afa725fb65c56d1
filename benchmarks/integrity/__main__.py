"""Protection levels against true errors: counts, availability, time to alert.

python -m benchmarks.integrity --quick              simulated flights: the stress table and villages (minutes)
python -m benchmarks.integrity                      those of LANDFIX_DATA too: outages, false fixes, outliers (an hour)
python -m benchmarks.integrity --scheduler tcp://10.0.0.5:8786

What was done stands in out/integrity/rows.jsonl and is not done again; delete the file to begin anew. When the run ends,
also by Ctrl-C, its counts are added to docs/integrity_runs.csv.
"""

import argparse
import os
from pathlib import Path

from benchmarks.flights.tasks import ROOT, SETS, data_folder, flights
from benchmarks.integrity.pictures import draw
from benchmarks.integrity.record import RECORD, added
from benchmarks.integrity.report import groups, groups_table, summary, table
from benchmarks.integrity.rows import Row
from benchmarks.integrity.runs import Job, run
from benchmarks.jobs import results_in, run_jobs
from benchmarks.stress.perturbations import KINDS

_SCENARIOS = "ACXB"  # of the scoring tool: outages, false fixes after outages, outliers, one long outage
_GROUPS = ("village", "stress", "real")
_VILLAGE_S = 300.0


def main() -> None:
    args = arguments()
    os.environ["OMP_NUM_THREADS"] = "1"  # inherited: one thread a process
    work = jobs(args.out / "tasks", quick=args.quick, seeds=args.seeds)
    work = [job for job in work if job[0] in args.groups]
    kept = args.out / "rows.jsonl"
    try:
        rows = run_jobs(work, run, Row, kept, processes=args.jobs, resume=True, scheduler=args.scheduler)
    finally:  # also of a run that is ended with Ctrl-C
        known = added([row for _, row in results_in(kept, Row)], args.record)
    found = "\n".join(t.markdown() for t in (groups_table(rows), table(rows)))
    text = f"{summary(rows)}\nAll of {args.record.name}:\n\n{summary(known)}\n{found}"
    (args.out / "report.md").write_text(text)
    draw(groups(rows), args.out / "stanford.png")
    print(text)
    print(f"{args.out}/report.md, rows.jsonl, stanford.png")


def jobs(tasks: Path, *, quick: bool, seeds: int) -> list[Job]:
    """Villages, the stress table on simulated flights, recorded flights."""
    folder = str(tasks)
    work: list[Job] = [
        ("village", vehicle, aids, _VILLAGE_S, seed, folder)
        for aids in ("fixes", "both")
        for vehicle in ("rotor", "wing")
        for seed in range(seeds)
    ]

    cells = [(kind.name, size) for kind in KINDS.values() for size in kind.sizes[-2:]]
    work += [("stress", "sim/rotor", *cell, 0, folder) for cell in cells]
    if not quick and (data_folder() / "flights").is_dir():
        recorded = [f"{group}/{flight}" for group in SETS for flight in flights(group)]
        work += [("real", flight, scenario, 0.0, 0, folder) for scenario in _SCENARIOS for flight in recorded]
        work += [("stress", flight, "nothing, with GNSS", 0.0, 0, folder) for flight in recorded]
    work += [] if quick else [("stress", "sim/wing", *cell, 0, folder) for cell in cells]
    return work


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="simulated flights, the two largest sizes of each kind")
    parser.add_argument("--seeds", type=int, default=3, help="of the villages")
    parser.add_argument("--groups", nargs="+", choices=_GROUPS, default=_GROUPS, help="these alone")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="dask.distributed scheduler")
    parser.add_argument("--record", type=Path, default=RECORD, help="counts of all runs so far, added to")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "integrity")
    return parser.parse_args()


if __name__ == "__main__":
    main()
