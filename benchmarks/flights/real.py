"""Accuracy and consistency on recorded flights, with a plain filter and the published figures of others.

python -m benchmarks.flights.real                              everything (make bench-real; the first time about half an hour)
python -m benchmarks.flights.real --quick                      one seed, every third flight
python -m benchmarks.flights.real --scenarios AX --sets euroc --naive
python -m benchmarks.flights.real --scenarios AL --sets quad --config tuned.toml   with another noise than the tasks tell
"""

import argparse
import json
from pathlib import Path
from typing import Any

from benchmarks.flights import tables
from benchmarks.flights.runs import NAIVE, OURS, Job, run
from benchmarks.flights.tasks import ROOT, SETS, data_folder, tasks
from benchmarks.jobs import run_jobs
from benchmarks.tables import Table

FLIGHT_SCENARIOS = "NABDLFXCGVW"


def main() -> None:
    args = arguments()
    if not (data_folder() / "flights").is_dir():
        raise SystemExit(f"{data_folder()}/flights not found: set LANDFIX_DATA to the folder of recorded flights")
    if args.config and not args.config.is_file():
        raise SystemExit(f"{args.config}: no such file")
    seeds, every = (args.seeds[:1], 3) if args.quick else (args.seeds, 1)
    args.out.mkdir(parents=True, exist_ok=True)
    estimators = (NAIVE,) if args.naive_only else (OURS, NAIVE) if args.naive else (OURS,)
    config, folder = str(args.config or ""), str(args.out)
    jobs = [Job(task, estimators, config, folder) for task in tasks(args.sets, args.scenarios, seeds, every)]
    kept = args.out / "runs.jsonl"
    found = run_jobs(jobs, run, list[dict[str, Any]], kept, processes=args.jobs, resume=args.resume) if jobs else []
    runs = [result for results in found for result in results]
    report = [table.markdown() for table in report_tables(runs)]
    if runs:
        (args.out / "results.json").write_text(json.dumps(runs, indent=1))
    (args.out / "report.md").write_text("\n".join(report))
    print("\n".join(report))
    print(f"{args.out}/report.md, results.json")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--scenarios", type=scenario_letters, default=FLIGHT_SCENARIOS, help="letters")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--naive", action="store_true", help="the plain filter too (slow the first time, then kept)")
    parser.add_argument("--naive-only", action="store_true", help="the plain filter alone")
    parser.add_argument("--config", type=Path, metavar="TOML", help="in place of the tasks' own, such as what landfix tune wrote")
    parser.add_argument("--quick", action="store_true", help="one seed, every third flight")
    parser.add_argument("--resume", action="store_true", help="go on where the last run ended")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench_real")
    return parser.parse_args()


def scenario_letters(text: str) -> str:
    unknown = set(text) - set(tables.SCENARIOS)
    if unknown:
        raise argparse.ArgumentTypeError(f"no scenario {', '.join(sorted(unknown))}: letters out of {''.join(tables.SCENARIOS)}")
    return text


def report_tables(runs: list[dict[str, Any]]) -> list[Table]:
    """Medians by scenario, consistency, outage ends by flight, worst runs."""
    if not runs:
        return []
    by_scenario = {s: [r for r in runs if r["scenario"] == s] for s in dict.fromkeys(r["scenario"] for r in runs)}
    found = [tables.scenario_table(scenario, those) for scenario, those in by_scenario.items()]
    found.append(tables.consistency_table(runs))
    found += [tables.flight_table(s, by_scenario[s], "end_60" if s == "B" else "end_30") for s in ("A", "B") if s in by_scenario]
    return [*found, tables.worst_table(runs)]


if __name__ == "__main__":
    main()
