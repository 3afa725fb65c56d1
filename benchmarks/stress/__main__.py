"""Stress table: what growing differences between world and configuration cost, in landfix and in the plain filter.

python -m benchmarks.stress --quick                 a simulated flight of 70 s, one seed (make stress)
python -m benchmarks.stress --resume                everything: simulated and recorded flights, three seeds (hours)
python -m benchmarks.stress --only "fix delay" "IMU mount" --flights euroc/MH_03_medium --seeds 0
python -m benchmarks.stress --quick --rows new.jsonl --against benchmarks/results/stress.jsonl      the cells that changed
"""

import argparse
import os
from pathlib import Path

from benchmarks.flights.tasks import ROOT, data_folder
from benchmarks.jobs import results_in, run_jobs
from benchmarks.stress.cell import Job, Row, run
from benchmarks.stress.flights import names
from benchmarks.stress.perturbations import KINDS
from benchmarks.stress.report import changes_table, draw, failures_table, stress_table


def main() -> None:
    args = arguments()
    os.environ["OMP_NUM_THREADS"] = "1"  # inherited: one thread a process
    if not args.quick and not args.flights and not (data_folder() / "flights").is_dir():
        raise SystemExit(f"{data_folder()}/flights not found: set LANDFIX_DATA to the folder of recorded flights, or use --quick")
    flights = args.flights or names(quick=args.quick)
    seeds = args.seeds or ([0] if args.quick else [0, 1, 2])
    kept = args.rows or args.out / "rows.jsonl"
    work = jobs(flights, args.only or list(KINDS), seeds, args.out, quick=args.quick)
    rows = run_jobs(work, run, Row, kept, processes=args.jobs, resume=args.resume)
    args.out.mkdir(parents=True, exist_ok=True)
    tables = [stress_table(rows), failures_table(rows)]
    if args.against is not None:
        tables.append(changes_table([row for _, row in results_in(args.against, Row)], rows))
    report = [table.markdown() for table in tables]
    (args.out / "report.md").write_text("\n".join(report))
    draw(rows, args.out / "stress.png")
    print("\n".join(report if args.against is None else report[-1:]))
    print(f"{args.out}/report.md, stress.png, {kept}")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one simulated flight, seed 0, the two largest sizes")
    parser.add_argument("--only", nargs="+", choices=KINDS, metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--flights", nargs="+", choices=names(quick=False), metavar="SET/FLIGHT", help="such as sim/wing")
    parser.add_argument("--seeds", nargs="+", type=int, help="0 1 2; --quick: 0")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--resume", action="store_true", help="keep the rows of an earlier run that was ended")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "stress", help="folder of report and picture")
    parser.add_argument("--rows", type=Path, help="file of one JSON line for each cell, flight and seed (default: in --out)")
    parser.add_argument("--against", type=Path, help="rows of another version: print what changed in the cells of both")
    return parser.parse_args()


def jobs(flights: list[str], kinds: list[str], seeds: list[int], out: Path, *, quick: bool) -> list[Job]:
    """One for each cell, flight and seed; quick: the two largest sizes of a kind."""
    return [
        (flight, kind, size, seed, str(out / "tasks"))
        for kind in kinds
        for size in (KINDS[kind].sizes[-2:] if quick else KINDS[kind].sizes)
        for flight in flights
        for seed in seeds
    ]


if __name__ == "__main__":
    main()
