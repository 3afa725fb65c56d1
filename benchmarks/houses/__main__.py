"""Footprints under real images: `python -m benchmarks.houses`.

Each image is a photo straight down, the map is the footprints in it, the prior is drawn. Three footprints, ten, or all that are
there; what is judged is how far the fix puts the footprints from where the file has them. Decoys: footprints that are not in the
image. Half of the sets (tiles.CHOSEN_ON) chose the thresholds of the pattern, the others did not. Maps in error (--in-error): all
footprints 3 m off together, as common_sigma_m says, or every third one by itself, of which the map says nothing. Results go to
out/houses/.
"""

import argparse
import math
import sys

import numpy as np

from benchmarks.flights.tasks import data_folder
from benchmarks.houses.calibration import draw
from benchmarks.houses.tiles import CHOSEN_ON, FOLDER, is_there
from benchmarks.houses.trials import DECOYS, IN_ERROR, OUT, SIZES, Answer, answer, every_tile, jobs
from benchmarks.jobs import run_jobs
from benchmarks.tables import Table, number

_NEAR_M, _INSIDE_95 = 3.0, 5.991  # chi-square of 2


def row(name: str, some: list[Answer]) -> tuple[str, ...]:
    """Figures of trials that are no decoys."""
    fixed = [a for a in some if a.accepted]
    off, error, radius, squared = (
        np.array([getattr(a, of) for a in fixed] or [math.nan]) for of in ("off_m", "error_m", "radius_m", "squared")
    )
    near = [a.naive_m is not None and a.naive_m < _NEAR_M for a in some]
    return (
        name, str(len({a.tile for a in some})), str(len(some)), f"{len(fixed) / max(len(some), 1):.0%}",
        number(float(np.median(off))), number(float(off.max())), number(float(np.median(error))),
        number(float(np.median(radius))),
        number(float(squared.mean()) / 2.0), f"{np.mean(squared < _INSIDE_95):.0%}", str(int(np.sum(squared > 9.0 * _INSIDE_95))),
        number(1e3 * float(np.median([a.cpu_s for a in some] or [math.nan]))), f"{np.mean(near or [False]):.0%}",
    )  # fmt: skip


COLUMNS = (
    "images, footprints", "images", "trials", "accepted", "median m", "worst m", "position, median m", "claimed 95 % m",
    "NEES / 2", "within it", "beyond 3 x", "ms", "Sobel + correlation, within 3 m",
)  # fmt: skip


def report(answers: list[Answer], sizes: list[int]) -> str:
    """Tables."""
    rows, decoys = [], []
    sized = list(zip(answers, sizes, strict=True))
    for title, chosen in (("chosen on", True), ("others", False)):
        for size in (*SIZES, 0):
            some = [a for a, s in sized if s == size and (a.group in CHOSEN_ON) == chosen]
            rows.append(row(f"{title}, {size or 'all'}", [a for a in some if a.kind == "true"]))
            decoys.append((f"{title}, {size or 'all'}", *_share([a for a in some if a.kind in DECOYS])))
    groups = [
        row(f"{g}, all sizes", [a for a in answers if a.group == g and a.kind == "true"]) for g in {a.group: 0 for a in answers}
    ]
    kinds = [row(kind, [a for a in answers if a.kind == kind]) for kind in ("true", *IN_ERROR)]
    return "\n".join([
        Table("Footprints under real images", COLUMNS, rows).markdown(), Table("By set", COLUMNS, groups).markdown(),
        Table("By map", COLUMNS, kinds).markdown(),
        Table("Decoys", ("images, footprints", "decoys", "accepted"), decoys).markdown(),
    ])  # fmt: skip


def _share(some: list[Answer]) -> tuple[str, str]:
    return str(len(some)), str(sum(a.accepted for a in some))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.houses", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--priors", type=int, default=3, help="drawn for each image and number of footprints")
    parser.add_argument("--decoys", type=int, default=1, help="of each of four kinds, for each image and number of footprints")
    parser.add_argument("--in-error", action="store_true", help="maps of which all footprints, or a third, are 3 m off, as well")
    parser.add_argument("--sets", nargs="+", default=None, help="of these only")
    parser.add_argument("--pictures", action="store_true", help="write an overlay of every trial that is no decoy")
    parser.add_argument("--resume", action="store_true", help="keep what was done before")
    parser.add_argument("--processes", type=int, default=1)
    args = parser.parse_args()
    if not is_there(data_folder()):
        raise SystemExit(f"{data_folder() / FOLDER} not found: see benchmarks/houses/tiles.py for what belongs there")
    OUT.mkdir(parents=True, exist_ok=True)
    every = [t for t in every_tile() if args.sets is None or t.group in args.sets]
    todo = list(jobs(every, args.seed, args.priors, args.decoys, drawn=args.pictures, in_error=args.in_error))
    answers = run_jobs(todo, answer, Answer, OUT / "answers.jsonl", processes=args.processes, resume=args.resume)
    text = report(answers, [job[3] for job in todo])
    (OUT / "report.md").write_text(text)
    sys.stdout.write(f"{text}\nclaims and errors: {draw(answers, OUT / 'calibration.png')}\n")


if __name__ == "__main__":
    main()
