"""Flights with drawn faults: protection levels against errors, and what they come to per hour by importance sampling.

python -m benchmarks.drawn --flights 30 --jobs 1                goes on where it ended; --hours 1 takes as many as make an hour
python -m benchmarks.drawn --flights 30000 --scheduler tcp://10.0.0.5:8786

Results stand in out/drawn/flights.jsonl; every flight with an error above its level is listed with its faults in report.md, and
its seed makes it again.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import msgspec
import numpy as np

from benchmarks.drawn.alerts import cautions, table
from benchmarks.drawn.faults import drawn, with_faults
from benchmarks.drawn.rates import Flown, Rate, rate
from benchmarks.flights.tasks import ROOT
from benchmarks.integrity.runs import compared, flown, village
from benchmarks.jobs import run_jobs
from benchmarks.tables import Table

Job: TypeAlias = tuple[int, float]  # seed, seconds


def main() -> None:
    args = arguments()
    count = round(args.hours * 3600.0 / args.seconds) if args.hours else args.flights
    jobs = [(seed, args.seconds) for seed in range(args.seed, args.seed + count)]
    kept = args.out / "flights.jsonl"
    done = run_jobs(jobs, fly, Flown, kept, processes=args.jobs, resume=True, scheduler=args.scheduler)
    text = report(rate(done), done)
    (args.out / "report.md").write_text(text)
    print(text)


def fly(job: Job) -> Flown:
    """The flight of a seed: vehicle and manoeuvres, faults, all drawn from it."""
    seed, seconds = job
    rng = np.random.default_rng([seed, 17])
    vehicle = "rotor" if rng.random() < 0.5 else "wing"
    flight = village(vehicle, "both", seconds, seed)
    faults, weight = drawn(rng, seconds)
    estimates, levels = flown(flight, with_faults(flight, faults, rng))
    spans = [(flight.start_ns + round(f.from_s * 1e9), flight.start_ns + round(f.to_s * 1e9)) for f in faults]
    row = compared(flight, estimates, levels)
    row = msgspec.structs.replace(row, group="drawn", flight=vehicle, kind=", ".join(map(str, faults)), size=seconds, seed=seed)
    return Flown(seed, vehicle, seconds, faults, weight, row, cautions(levels, spans))


def report(found: Rate, done: Sequence[Flown]) -> str:
    """As Markdown."""
    lines = [
        f"{found.flights} flights, {found.hours:.2f} h, effective sample size {found.ess:.1f}",
        f"error > PL(1e-5): {found.per_hour:.2g} +- {found.error:.2g} per hour, weighted",
        f"at most {found.at_most:.2g} per hour (95 % a stratum), of it {found.faults_at_most:.2g} with faults",
    ]
    columns = ("stratum", "flights", "with event", "nominal", "share at most", "per hour at most", "worst e / PL")
    rows = [
        (
            s.name,
            str(s.flights),
            str(s.with_event),
            f"{s.nominal:.2g}",
            f"{s.share_at_most:.2g}",
            f"{s.per_hour:.2g}",
            f"{s.worst:.3g}",
        )
        for s in found.strata
    ]
    events = [
        (str(f.seed), f.vehicle, ", ".join(map(str, f.faults)) or "none", f"{f.row.worst:.3g}", f"{f.weight:.2g}")
        for f in done
        if f.has_event
    ]
    listed = Table("Flights with an error above PL(1e-5)", ("seed", "vehicle", "faults", "worst e / PL", "weight"), events)
    return (
        "\n".join(f"- {line}" for line in lines)
        + f"\n{Table('Strata', columns, rows).markdown()}\n{table(done).markdown()}\n{listed.markdown()}\n"
    )


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=30)
    parser.add_argument("--hours", type=float, default=0.0, help="in place of --flights")
    parser.add_argument("--seconds", type=float, default=120.0, help="of a flight")
    parser.add_argument("--seed", type=int, default=0, help="the first")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="dask.distributed scheduler")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "drawn")
    return parser.parse_args()


if __name__ == "__main__":
    main()
