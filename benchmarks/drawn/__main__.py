"""Flights with drawn faults: protection levels against errors, alerts, lock-outs, and a rate by importance sampling.

python -m benchmarks.drawn --flights 30 --jobs 1                goes on where it ended; --hours 1 takes as many as make an hour
python -m benchmarks.drawn --flights 30000 --scheduler tcp://10.0.0.5:8786
python -m benchmarks.drawn --flights 3000 --summary benchmarks/results/drawn.json

Rows stand in out/drawn/flights.jsonl with seed and program; a changed program flies anew, and the rows of the others stay. The
report is of all rows of this program. Every flight with an error above its level while usable is listed with its faults, and its
seed makes it again.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.drawn import lockout
from benchmarks.drawn.alerts import alerts, in_time_or_covered, table
from benchmarks.drawn.flights import fly, program
from benchmarks.drawn.rates import AIDS, Flown, Rate, rates
from benchmarks.flights.tasks import ROOT
from benchmarks.jobs import results_in, run_jobs
from benchmarks.tables import Table

SECONDS = 120.0  # of a flight


def main() -> None:
    args = arguments()
    count = round(args.hours * 3600.0 / SECONDS) if args.hours else args.flights
    kept = args.out / "flights.jsonl"
    fly_all(range(args.seed, args.seed + count), kept, args.jobs, args.scheduler)
    known = sorted((f for _, f in results_in(kept, Flown)), key=lambda f: f.seed)
    done = [f for f in known if f.program == program()]
    programs = compared(done, known)
    text = f"{report(done)}\n{programs.markdown()}"
    (args.out / "report.md").write_text(text)
    if args.summary:
        args.summary.write_text(json.dumps(summary(done) | {"programs": msgspec.to_builtins(programs)}, indent=1) + "\n")
    print(text)


def fly_all(seeds: Sequence[int], kept: Path, processes: int | None, scheduler: str) -> list[Flown]:
    """The flights of these seeds by this program, those that stand in `kept` taken from there."""
    jobs = [(seed, SECONDS, program()) for seed in seeds]
    return run_jobs(jobs, fly, Flown, kept, processes=processes, resume=True, scheduler=scheduler)


def summary(done: Sequence[Flown]) -> dict[str, Any]:
    """What the pages cite."""
    good, faults = in_time_or_covered([f for f in done if f.is_bounded])
    return {
        "program": done[0].program,
        "seeds": " ".join(str(f.seed) for f in done),
        "hours": sum(f.duration_s for f in done) / 3600.0,
        "faults_of_the_table": faults,
        "in_time_or_covered": good,
        "rates": msgspec.to_builtins(rates(done)),
        "alerts": msgspec.to_builtins(alerts(done)),
        "lockout": msgspec.to_builtins(lockout.table(_locked(done))),
        "events": msgspec.to_builtins(_events(done)),
    }


def compared(done: Sequence[Flown], known: Sequence[Flown]) -> Table:
    """Each program of the rows compared with this one, over the flights that both have flown."""
    rows = []
    for other in dict.fromkeys(f.program for f in known):
        theirs = {f.seed: f for f in known if f.program == other}
        both = [(theirs[f.seed], f) for f in done if f.seed in theirs]
        events = [[f for f in side if f.has_event] for side in zip(*both, strict=True)]
        seeds = [", ".join(str(f.seed) for f in some) or "none" for some in events]
        worst = [f"{max((f.row.worst for f in some), default=0.0):.3g}" for some in events]
        rows += [(other, str(len(both)), *seeds, *worst)] if both else []
    columns = ("program", "flights", "seeds above the level", "by this program", "worst e / PL", "by this program")
    return Table("Programs, over the same flights", columns, rows)


def report(done: Sequence[Flown]) -> str:
    """As Markdown."""
    parts = [_rate(found) for found in rates(done)]
    parts += [t.markdown() for t in (table(done), lockout.table(_locked(done)), _events(done))]
    return "\n".join(parts)


def _rate(found: Rate) -> str:
    lines = [
        f"{AIDS[found.aids]}: {found.flights} flights, {found.hours:.2f} h, effective sample size {found.ess:.1f}",
        f"error > PL(1e-5) while usable: {found.per_hour:.2g} +- {found.error:.2g} per hour, weighted",
        f"at most {found.at_most:.2g} per hour (95 % a stratum), of it {found.faults_at_most:.2g} with faults that the "
        f"table bounds and {found.unbounded_at_most:.2g} with the others, were they as frequent",
    ]
    columns = ("stratum", "flights", "with event", "nominal", "share at most", "per hour at most", "worst e / PL")
    rows = [
        (s.name, str(s.flights), str(s.with_event), *map("{:.2g}".format, (s.nominal, s.share_at_most, s.per_hour, s.worst)))
        for s in found.strata
    ]
    return "\n".join(f"- {line}" for line in lines) + f"\n\n{Table(f'Strata, {AIDS[found.aids]}', columns, rows).markdown()}"


def _locked(done: Sequence[Flown]) -> list[tuple[str, lockout.Lockout]]:
    return [(f.stratum, f.locked) for f in done if f.locked is not None]


def _events(done: Sequence[Flown]) -> Table:
    rows = [
        (
            *(str(f.seed), f.vehicle, AIDS[f.aids], ", ".join(map(str, f.faults)) or "none"),
            *("yes" if f.is_bounded else "no", f"{f.row.worst:.3g}", f"{f.weight:.2g}"),
        )
        for f in done
        if f.has_event
    ]
    columns = ("seed", "vehicle", "sources", "faults", "bounded", "worst e / PL", "weight")
    return Table("Flights with an error above PL(1e-5) while usable", columns, rows)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--flights", type=int, default=30)
    parser.add_argument("--hours", type=float, default=0.0, help="in place of --flights")
    parser.add_argument("--seed", type=int, default=0, help="the first")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="dask.distributed scheduler")
    parser.add_argument("--summary", type=Path, help="file for the figures that pages cite")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "drawn")
    return parser.parse_args()


if __name__ == "__main__":
    main()
