"""Monte-Carlo campaign over simulated flights: is the covariance consistent, and the error near its lower bound?

    python -m benchmarks.campaign                            all flights, 100 seeds each
    python -m benchmarks.campaign --quick                    every third flight, 10 seeds
    python -m benchmarks.campaign --scenarios rotor --seeds 20
    python -m benchmarks.campaign --list                     names of the scenarios

Writes report.md and results.json.
"""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.progress import track

from benchmarks.campaign import flights as campaign_flights
from benchmarks.campaign import report as campaign_report
from benchmarks.campaign import runs as campaign_runs
from benchmarks.campaign import statistics as campaign_statistics
from benchmarks.campaign.statistics import Result
from benchmarks.jobs import importable
from estimator.tools.fleet.engine import cluster
from estimator.tools.fleet.engine import results as results_of

OUT = Path(__file__).parents[2] / "out" / "campaign"
FLIGHTS = {flight.name: flight for flight in campaign_flights.matched() + campaign_flights.mismatched()}


def main() -> None:
    arguments = parse()
    if arguments.list:
        print("\n".join(FLIGHTS))
        return
    names = chosen(arguments.scenarios)
    flights = [name for name in FLIGHTS if name in names][:: 3 if arguments.quick else 1]
    seeds = range(arguments.seeds or (10 if arguments.quick else 100))
    os.environ["OMP_NUM_THREADS"] = "1"  # inherited: one thread a process
    done = run_all([(name, seed) for name in flights for seed in seeds], arguments.jobs)
    results = [campaign_statistics.judge(FLIGHTS[name], [done[name, seed] for seed in seeds]) for name in flights]
    write(arguments.out, results)


def fly(job: tuple[str, int]) -> campaign_runs.Score:
    name, seed = job
    return campaign_runs.run(FLIGHTS[name], seed)


def parse() -> argparse.Namespace:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign", description=__doc__, formatter_class=formatter)
    parser.add_argument("--seeds", type=positive, help="runs a scenario (default 100)")
    parser.add_argument("--scenarios", nargs="+", metavar="NAME", help="names, or beginnings of names (default: all)")
    parser.add_argument("--jobs", type=positive, default=2, help="processes (default 2)")
    parser.add_argument("--quick", action="store_true", help="every third flight, 10 seeds")
    parser.add_argument("--list", action="store_true", help="print the names of the scenarios")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the results (default out/campaign)")
    arguments = parser.parse_args()
    if unknown := [w for w in arguments.scenarios or [] if not any(n.startswith(w) for n in FLIGHTS)]:
        parser.error(f"no scenario begins with {', '.join(unknown)}; --list prints them")
    return arguments


def positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be 1 or more")
    return value


def chosen(beginnings: Sequence[str] | None) -> set[str]:
    """Names that begin with one of these; all of them by default."""
    return {name for name in FLIGHTS if beginnings is None or name.startswith(tuple(beginnings))}


def run_all(jobs: list[tuple[str, int]], processes: int) -> dict[tuple[str, int], campaign_runs.Score]:
    """The score of each flight and seed; one that fails stops everything, with its name and seed."""
    results: dict[tuple[str, int], campaign_runs.Score] = {}
    with cluster(processes) as client:
        for job, outcome in track(results_of(client, importable(fly), jobs), "flights", len(jobs)):
            if isinstance(outcome, Exception):
                raise RuntimeError(f"{job[0]}, seed {job[1]} failed") from outcome
            results[job] = outcome
    return results


def write(out: Path, results: list[Result]) -> None:
    """Tables to the terminal, everything to files."""
    matched, mismatched = [r for r in results if r.matched], [r for r in results if not r.matched]
    tables = [campaign_report.verdict(results)]
    if matched:
        tables.append(campaign_report.flight_table("Matched sensors", matched))
        tables += [campaign_report.phase_table(matched), campaign_report.worst_table(matched)]
    if mismatched:
        tables.append(campaign_report.flight_table("Sensors that do not match the model (figures only)", mismatched))
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.md").write_text(campaign_report.markdown(tables), encoding="utf-8")
    (out / "results.json").write_bytes(msgspec.json.format(msgspec.json.encode({"flights": results}), indent=1))
    print("\n".join(table.markdown() for table in tables))
    print(f"Report: {out / 'report.md'}")


if __name__ == "__main__":
    main()
