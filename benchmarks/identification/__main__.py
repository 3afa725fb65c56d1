"""How often landmarks are identified, and how often wrongly, among look-alikes: wrong fixes and identities with 95 % bounds.

python -m benchmarks.identification --looks 6000 --pairs 216 --jobs 2        goes on where it ended
python -m benchmarks.identification --summary benchmarks/results/looks.json  what is done so far, for pages
Batches stand in out/identification/batches.jsonl with seed and program. A changed program looks anew at the seeds from --seed on;
of a seed that two programs have done the newer row counts. Wrong fix: off by more than 3 m and outside its 99.99 % ellipsoid.
Claimed: how many fixes of looks should be by a wrong identity, by their posteriors. Surer: doubt below 1e-5. A case of the
summary is made again by --looks 3000 --pairs 216 --seed SEED.
"""

import argparse
import json
import math
from collections.abc import Collection
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.flights.tasks import ROOT
from benchmarks.identification.batch import SURER, Batch, Job, program
from benchmarks.identification.images import LAYOUTS, PAIRS, show
from benchmarks.identification.looks import look
from benchmarks.integrity.report import bound
from benchmarks.jobs import results_in, run_jobs
from benchmarks.tables import Table

PRIORS_M = (5.0, 10.0, 20.0)
_LOOKS = 500  # of a batch of one world and prior
COLUMNS = ("kind", "world", "tried", "fixes", "wrong fixes", "at most", "by a wrong identity", "at most", "claimed",
           "surer fixes", "wrong of them", "identities", "wrong ones", "at most")  # fmt: skip


def main() -> None:
    args = arguments()
    kept = args.out / "batches.jsonl"
    if args.looks or args.pairs:
        run_jobs(
            jobs(args.looks, args.pairs, args.seed), run, Batch, kept, processes=args.jobs, resume=True, scheduler=args.scheduler
        )
    done = {(b.kind, b.world, b.seed): b for _, b in results_in(kept, Batch)}.values()
    print(table(done).markdown())
    if args.summary:
        args.summary.write_text(json.dumps(summary(done), indent=1) + "\n")


def jobs(looks: int, pairs: int, seed: int) -> list[Job]:
    """Looks and pairs in turns, all worlds as often."""
    plans = ("looks", ("random", "grid"), _LOOKS, looks), ("pairs", LAYOUTS, PAIRS, pairs)
    made_by, turns = program(), list[tuple[float, Job]]()
    for kind, layouts, many, wanted in plans:
        seeds = range(seed, seed + math.ceil(wanted / (many * len(layouts) * len(PRIORS_M))))
        some = [(kind, layout, prior_m, many, one, made_by) for one in seeds for layout in layouts for prior_m in PRIORS_M]
        turns += [(k / len(some), job) for k, job in enumerate(some)]
    return [job for _, job in sorted(turns)]


def run(job: Job) -> Batch:
    return look(job) if job[0] == "looks" else show(job)


def table(done: Collection[Batch]) -> Table:
    """A line for each world, and one for all of a kind."""
    groups = dict[tuple[str, str], list[Batch]]()
    for b in done:
        groups.setdefault((b.kind, b.world), []).append(b)
        groups.setdefault((b.kind, "all"), []).append(b)
    ordered = sorted(groups.items(), key=lambda group: (group[0][0], group[0][1] == "all", group[0][1]))
    return Table("Wrong fixes and identities; rates with 95 %", COLUMNS, [(*name, *_numbers(some)) for name, some in ordered])


def _numbers(some: list[Batch]) -> tuple[str, ...]:
    names = "tried", "fixes", "far", "misled", "doubt", "surer", "identified", "mistaken"
    tried, fixes, far, misled, doubt, surer, identified, mistaken = (sum(getattr(b, name) for b in some) for name in names)
    surely = sum(bool(c.mistaken) and c.doubt < SURER for b in some for c in b.cases)
    rates = [f"{bound(n, of):.2g}" for n, of in ((far, fixes), (misled, fixes), (mistaken, identified))]
    claims = (f"{doubt:.2g}", str(surer), str(surely)) if some[0].kind == "looks" else ("-", "-", "-")
    return (str(tried), str(fixes), str(far), rates[0], str(misled), rates[1], *claims, str(identified), str(mistaken), rates[2])


def summary(done: Collection[Batch]) -> dict[str, Any]:
    """What the pages cite, and each case with a wrong identity or a wrong fix."""
    found, programs = table(done), dict[str, list[int]]()
    for b in done:
        programs.setdefault(f"{b.kind} by {b.program}", []).append(b.seed)
    cases = [msgspec.to_builtins(c) | {"kind": b.kind, "world": b.world, "seed": b.seed} for b in done for c in b.cases]
    seeds = {made_by: f"{len(some)} batches, seeds {min(some)} to {max(some)}" for made_by, some in programs.items()}
    return {"seeds": seeds, "columns": found.columns, "rows": found.rows, "cases": cases}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("--looks", "--pairs", "--seed"):
        parser.add_argument(name, type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="dask.distributed scheduler")
    parser.add_argument("--summary", type=Path, help="file for the figures that pages cite")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "identification")
    return parser.parse_args()


if __name__ == "__main__":
    main()
