"""Conflicts of GNSS and pose fixes: when health names them, how far off the estimate is, and when it is right again.

python -m benchmarks.stress.conflicts                         both simulated flights, one seed (minutes)
python -m benchmarks.stress.conflicts --flights euroc/MH_03_medium quad/flight_a --resume

Time counts from the onset: the pull's begin, or the first true fix where GNSS is wrong from boot. "Right" is an error below 2 m
that stays below it to the end, or up to the last fix where fixes are rarer than each 10 s.
"""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.flights.tasks import ROOT
from benchmarks.jobs import run_jobs
from benchmarks.stress.cell import OVERCONFIDENT, Job, errors, perturbed
from benchmarks.stress.flights import load_flight, names
from benchmarks.stress.perturbations import BOOT_S, KINDS, ONSET_S
from benchmarks.stress.report import size_text
from benchmarks.tables import Table, number
from estimator.fusion import Fusion
from models.messages import Estimate, Health, PoseFix

CONFLICTS = [name for name in KINDS if name.startswith(("GNSS pulled", "GNSS off from boot"))]
RIGHT_M = 2.0
_NAMED = ("disagree", "not used")


class Conflict(msgspec.Struct, frozen=True):
    """One conflict on one flight. named_s, right_s: seconds from the onset, None: never; says: what health says then.

    worst_m: largest error after the onset; end_m: that at the last fix; overconfident: share of the time after the onset.
    """

    kind: str
    size: float
    flight: str
    named_s: float | None
    right_s: float | None
    worst_m: float
    end_m: float
    end_radius_m: float
    overconfident: float
    says: str


def run(job: Job) -> Conflict:
    """Fly, and look at health and errors from the onset on."""
    name, kind_name, size, seed, tasks = job
    kind = KINDS[kind_name]
    flight = load_flight(name, kind.aids, seed, Path(tasks))
    messages = perturbed(flight, kind, size, seed)
    onset_s = BOOT_S if kind.from_s else ONSET_S
    fusion, estimates, health = Fusion(flight.config), list[Estimate](), list[Health]()
    for message in messages:
        for output in fusion.handle(message):
            if isinstance(output, Estimate):
                estimates.append(output)
            elif isinstance(output, Health):
                health.append(output)
    last_fix_s = (max(m.t_ns for m in messages if isinstance(m, PoseFix)) - flight.start_ns) * 1e-9
    t_s, error_m, radius_m = errors(estimates, flight, onset_s)
    if not len(t_s):
        raise SystemExit(f"{name}: no estimate after the onset at {onset_s:.0f} s; choose a longer flight")
    to_last = t_s <= max(last_fix_s + 0.05, onset_s + 1.0) if kind.period_s > 10.0 else np.ones(len(t_s), bool)
    late = t_s[to_last][error_m[to_last] >= RIGHT_M]
    is_right = not len(late) or late[-1] < t_s[to_last][-1]
    named = [h for h in health if (h.t_ns - flight.start_ns) * 1e-9 >= onset_s and any(text in h.detail for text in _NAMED)]
    return Conflict(
        kind_name,
        size,
        name,
        (named[0].t_ns - flight.start_ns) * 1e-9 - onset_s if named else None,
        (float(late[-1]) - onset_s if len(late) else 0.0) if is_right else None,
        float(error_m.max()),
        float(error_m[to_last][-1]),
        float(radius_m[to_last][-1]),
        float(np.mean(error_m > OVERCONFIDENT * radius_m)),
        named[0].detail if named else "",
    )


def table(rows: Sequence[Conflict]) -> Table:
    """One line a kind and size, over the flights."""
    columns = ("conflict", "size", "named after s, median", "never named", "right after s, median", "latest", "right at the end",
               "worst error m, median", "overconfident %, worst")  # fmt: skip
    lines: list[tuple[str, ...]] = []
    for kind in CONFLICTS:
        for size in KINDS[kind].sizes:
            those = [r for r in rows if (r.kind, r.size) == (kind, size)]
            if not those:
                continue
            named = [r.named_s for r in those if r.named_s is not None]
            right = [r.right_s for r in those if r.right_s is not None]
            lines.append((
                kind,
                size_text(kind, size),
                number(float(np.median(named)) if named else None),
                f"{len(those) - len(named)} of {len(those)}",
                number(float(np.median(right)) if right else None),
                number(max(right, default=None)),
                f"{len(right)} of {len(those)}",
                number(float(np.median([r.worst_m for r in those]))),
                number(100.0 * max(r.overconfident for r in those)),
            ))  # fmt: skip
    return Table(f"Conflicts of GNSS and fixes ({len(rows)} runs)", columns, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--flights", nargs="+", choices=names(quick=False), metavar="SET/FLIGHT", default=["sim/rotor", "sim/wing"]
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--resume", action="store_true", help="keep the rows of an earlier run that was ended")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "conflicts")
    args = parser.parse_args()
    work = [
        (flight, kind, size, seed, str(args.out / "tasks"))
        for kind in CONFLICTS
        for size in KINDS[kind].sizes
        for flight in args.flights
        for seed in args.seeds
    ]
    rows = run_jobs(work, run, Conflict, args.out / "rows.jsonl", processes=args.jobs, resume=args.resume)
    report = table(rows).markdown()
    (args.out / "report.md").write_text(report)
    print(report)
    for says in {re.sub(r"[\d.]+", "", r.says): r.says for r in rows if r.says}.values():  # one of each kind
        print(f"- {says}")
    print(f"{args.out}/report.md, rows.jsonl")


if __name__ == "__main__":
    main()
