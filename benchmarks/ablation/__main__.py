"""Predict and verify with one stage left out at a time: `python -m benchmarks.ablation [--sets ...] [--stages ...] [--trials N]`.

Every trial is drawn once and answered by the whole pipeline and by the pipeline without each stage. A stage that made no
difference in a trial is not run again there. Printed are the differences to the whole pipeline: trials no longer recognised, or
recognised only without the stage, wrong fixes more and less, and processor time. Answers go to out/ablation/, line by line.
Recognised, wrong: as in `landfix bench recognition`, `benchmarks.fixes.outline` and `benchmarks.aerial`.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.ablation.runs import WHOLE, Answer, Outcome, run
from benchmarks.ablation.stages import STAGES
from benchmarks.ablation.trials import SETS
from benchmarks.jobs import run_jobs
from benchmarks.tables import Table
from estimator.bench.recognisers import Verdict

OUT = Path(__file__).resolve().parents[2] / "out" / "ablation"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.ablation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument(
        "--stages", nargs="+", metavar="NAME", help="that are left out, by their names in the table; default: each"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--trials", type=int, default=200, help="of each set; aerial sets may have fewer")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--resume", action="store_true", help="keep the trials that were done before this run was ended")
    arguments = parser.parse_args()
    if arguments.trials < 1 or arguments.processes < 1:
        parser.error("--trials and --processes must be at least 1")
    names = tuple(stage.name for stage in STAGES)
    if unknown := set(arguments.stages or ()).difference(names):
        parser.error(f"no stage {min(unknown)!r}: --stages takes {', '.join(map(repr, names))}")
    stages = tuple(arguments.stages or names)
    jobs = [(name, arguments.seed, number, stages) for number in range(arguments.trials) for name in arguments.sets]
    kept = OUT / f"outcomes_{arguments.seed}.jsonl"
    outcomes = run_jobs(jobs, run, Outcome, kept, processes=arguments.processes, resume=arguments.resume)
    sys.stdout.write(report(outcomes))


def report(outcomes: Sequence[Outcome]) -> str:
    """One table over all sets, and one of each set."""
    known = [o for o in outcomes if o.answers]
    sets = {"all": known}
    for one in known:
        sets.setdefault(one.group.split(",")[0], []).append(one)
    return "\n".join(table(name, of).markdown() for name, of in sets.items())


def table(title: str, outcomes: Sequence[Outcome]) -> Table:
    """Of each stage: trials it made a difference to, and what changes without it."""
    whole = Counter(o.answers[WHOLE].verdict for o in outcomes)
    n, ms = len(outcomes), float(np.mean([o.answers[WHOLE].ms for o in outcomes]))
    rows = [(WHOLE, str(n), f"{whole['recognised'] / n:.1%}", "", "", str(whole["wrong"]), "", "", f"{ms:.0f}")]
    for stage in STAGES:
        pairs = [(o.answers[WHOLE], o.answers[stage.name]) for o in outcomes if stage.name in o.answers]
        if not pairs:
            continue
        lost, gained = (sum(_is(a, b, "recognised") for a, b in some) for some in (pairs, [(b, a) for a, b in pairs]))
        fewer, more = (sum(_is(a, b, "wrong") for a, b in some) for some in (pairs, [(b, a) for a, b in pairs]))
        change = (gained - lost) / max(len(pairs), 1)
        cost = float(np.mean([b.ms - a.ms for a, b in pairs]))
        rows.append((
            stage.name, str(sum(not b.same for _, b in pairs)), f"{change:+.1%}", str(lost), str(gained), f"{more - fewer:+d}",
            str(more), str(fewer), f"{cost:+.1f}",
        ))  # fmt: skip
    columns = (
        "stage left out", "trials used", "recognised", "lost", "gained", "wrong", "more", "fewer", "ms",
    )  # fmt: skip
    return Table(f"{title}: {n} trials", columns, rows)


def _is(one: Answer, other: Answer, verdict: Verdict) -> bool:
    """Whether one has the verdict and the other has not."""
    return one.verdict == verdict and other.verdict != verdict


if __name__ == "__main__":
    main()
