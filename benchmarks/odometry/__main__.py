"""Visual odometry alone on recorded images and tracks, without a filter: drift, covariance, lost steps, time.

python -m benchmarks.odometry [--also DIR]           ten minutes of one core

The sets are searched for in LANDFIX_DATA.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from benchmarks.flights.tasks import data_folder
from benchmarks.odometry import sets
from benchmarks.odometry.score import Scored, run
from benchmarks.tables import Table, number
from models.messages import Array

OUT = Path("out/bench_odometry")
COLUMNS = (
    "set", "steps", "lost", "step m", "length", "drift %", "deg/m", "end %", "step mm", "step deg", "NEES/3 p", "NEES/3 rot",
    "inliers", "scale", "ms",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--also", type=Path, nargs="+", default=[], help="folders of more KITTI pairs (poses.txt) and tracks (.npz)"
    )
    args = parser.parse_args()
    if not (data_folder() / "odometry").is_dir():
        raise SystemExit(f"{data_folder()}/odometry not found: set LANDFIX_DATA to the folder of recorded images")
    cv2.setNumThreads(1)
    report = recorded(tuple(args.also)).markdown()
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "report.md").write_text(report)
    print(report)


def recorded(also: tuple[Path, ...] = ()) -> Table:
    """Real images and real tracks."""
    handheld = sets.euroc(sets.HANDHELD, 340)
    cars = [data_folder() / "images" / "kitti06_0000_0050_stereo", *(p.parent for root in also for p in root.rglob("poses.txt"))]
    drives = [data_folder() / "odometry" / "kitti_raw_klt_tracks", *also]
    sequences = [handheld.every(n) for n in (2, 4, 8)] + [sets.euroc(sets.KEY_FRAMES)]
    sequences += [sets.kitti_pairs(folder).every(n) for folder in cars for n in (1, 2)]
    sequences += [sets.kitti_tracks(path).every(3) for root in drives for path in sorted(root.glob("*.npz"))]
    rows = [row(run(sequence, longest_s=0.8)) for sequence in sequences]
    return Table("Recorded: odometry alone (/n: each n-th frame; lost steps add no drift)", COLUMNS, rows)


def row(scored: Scored) -> tuple[str, ...]:
    """One line of the table."""
    if not len(scored.errors):
        return (scored.name, str(len(scored.steps)), str(scored.lost), *["-"] * 12)
    good = [step for step in scored.steps if not step.reason]
    inliers = np.median([step.points if step.inliers is None else int(step.inliers.sum()) for step in good])
    nees = scored.nees.mean(axis=0).tolist()
    values = (
        float(scored.lengths.mean()), sum(float(np.linalg.norm(step.p)) for step in good) / float(scored.lengths.sum()),
        *scored.drift(), 1e3 * rms(scored.errors[:, :3]),
        float(np.degrees(rms(scored.errors[:, 3:]))), *nees, float(inliers),
        float(np.median([step.residual_scale for step in good])),
        float(np.median(scored.step_ms) + (np.median(scored.frame_ms[1:]) if scored.frame_ms else 0.0)),
    )  # fmt: skip
    counts = str(len(scored.steps)), str(scored.lost)
    return (scored.name, *counts, *(number(v) for v in values))


def rms(e: Array) -> float:
    """Root mean square of the lengths of rows."""
    return float(np.sqrt((e**2).sum(axis=1).mean())) if len(e) else float("nan")


if __name__ == "__main__":
    main()
