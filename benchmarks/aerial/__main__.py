"""Outlines on real aerial images: `python -m benchmarks.aerial [brighton] [nust] [roads]`.

One camera, a trial is one image with its own pipeline; where that waits for another image, Brighton has one; *at once*: the first
image alone. Thresholds are the defaults (docs/vision_aerial.md). Output: out/aerial/.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.aerial import brighton, nust
from benchmarks.aerial.trials import Outcome, Row, Trial, row, run
from benchmarks.flights.tasks import data_folder
from benchmarks.tables import Table, number

OUT = Path(__file__).resolve().parents[2] / "out" / "aerial"
SETS = ("brighton", "nust", "roads")


def main() -> None:
    """Command line."""
    args = arguments()
    data = data_folder()
    if not (data / "images").is_dir():
        raise SystemExit(f"{data}/images not found: set LANDFIX_DATA to the folder of recorded images")
    cv2.setNumThreads(1)
    OUT.mkdir(parents=True, exist_ok=True)
    outcomes = [outcome for name in args.sets or SETS for outcome in run_all(trials(name, data, args))]
    rows = summary(outcomes)
    (OUT / f"outcomes_{args.seed}.json").write_bytes(msgspec.json.encode(outcomes))
    report = f"{table(rows).markdown()}\n{reasons(outcomes).markdown()}"
    (OUT / "report.md").write_text(report)
    sys.stdout.write(msgspec.json.encode(rows).decode() + "\n" if args.json else f"{report}\n{OUT}/report.md\n")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.aerial", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", choices=[[], *SETS], help="all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--priors", type=int, default=10, help="drawn for each image")
    parser.add_argument("--width", type=int, default=brighton.AS_FINE_AS_THE_MAP, help="of Brighton's photos")
    parser.add_argument(
        "--attitude-deg", type=float, nargs=2, metavar=("LEVEL", "YAW"), help="standard deviations of Brighton's prior (1 3)"
    )
    parser.add_argument("--json", action="store_true", help="print the table as JSON")
    args = parser.parse_args()
    if args.priors < 1 or not 320 <= args.width <= brighton.WIDTH:
        parser.error(f"--priors must be at least 1, --width between 320 and {brighton.WIDTH}")
    if not all(0.0 < sigma <= 10.0 for sigma in args.attitude_deg or ()):
        parser.error("--attitude-deg: both must be above 0 and at most 10")
    return args


def trials(name: str, data: Path, args: argparse.Namespace) -> Iterator[Trial]:
    """Those of a set."""
    if name == "brighton":
        level, yaw = np.radians(args.attitude_deg) if args.attitude_deg else brighton.SPREAD.sigma[[3, 5]]
        spread = replace(brighton.SPREAD, level_sigma_rad=float(level), yaw_sigma_rad=float(yaw))
        return brighton.trials(data, args.seed, args.priors, args.width, spread)
    if name == "nust":
        return nust.trials(data, args.seed, args.priors)
    return nust.road_trials(data, args.seed, args.priors)


def run_all(several: Iterable[Trial]) -> Iterator[Outcome]:
    """Every trial."""
    for trial in track(several, description="trials", console=Console(stderr=True)):
        yield run(trial)


def summary(outcomes: Iterable[Outcome]) -> list[Row]:
    """One row a group, in order of appearance."""
    groups: dict[str, list[Outcome]] = {}
    for o in outcomes:
        groups.setdefault(o.group, []).append(o)
    return [row(group) for group in groups.values()]


def table(rows: Iterable[Row]) -> Table:
    columns = (
        "set", "images", "trials", "accepted", "at once", "within 2 m", "beyond 2 m", "known to 2 m", "and beyond",
        "median m", "95 % m", "worst m", "claimed 95 % m", "within it", "cpu s",
    )  # fmt: skip
    cells = [
        (
            r.group, str(r.images), str(r.trials), f"{r.accepted:.1%}", f"{r.at_once:.1%}", f"{r.right:.1%}",
            str(r.wrong), f"{r.sure:.1%}", str(r.sure_wrong), number(r.median_m), number(r.p95_m), number(r.worst_m),
            number(r.claimed_m), str(r.inside), number(r.cpu_s),
        )
        for r in rows
    ]  # fmt: skip
    return Table("Fixes", columns, cells)


def reasons(outcomes: Iterable[Outcome]) -> Table:
    """How often each outcome came."""
    count = Counter((o.group, o.outcome) for o in outcomes)
    return Table("Outcomes", ("set", "outcome", "trials"), [(*what, str(n)) for what, n in sorted(count.items())])


if __name__ == "__main__":
    main()
