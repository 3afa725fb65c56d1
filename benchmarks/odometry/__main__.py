"""Visual odometry alone, without a filter: drift, covariance, lost steps, false motion, time.

python -m benchmarks.odometry                        everything, ten minutes of one core
python -m benchmarks.odometry recorded motion        one table or several

Recorded sets are searched for in LANDFIX_DATA; without them their tables are left out.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.flights.tasks import data_folder
from benchmarks.odometry import sets
from benchmarks.odometry.score import Scored, run
from benchmarks.tables import Table, number
from models.messages import Array
from vision.image.rectify import Image
from vision.odometry.views import grey

OUT = Path("out/bench_odometry")
ROUNDS = 8  # of the measurement of time
HEIGHTS_M = (10.0, 30.0, 60.0, 120.0)
COLUMNS = (
    "set", "steps", "lost", "step m", "length", "drift %", "deg/m", "end %", "step mm", "step deg", "NEES/3 p", "NEES/3 rot",
    "inliers", "scale", "ms",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", metavar="TABLE", help=", ".join(TABLES))
    parser.add_argument(
        "--also", type=Path, nargs="+", default=[], help="folders of more KITTI pairs (poses.txt) and tracks (.npz)"
    )
    args = parser.parse_args()
    if unknown := set(args.what) - set(TABLES):
        raise SystemExit(f"{', '.join(unknown)}: not a table; choose from {', '.join(TABLES)}")
    cv2.setNumThreads(1)
    makers = TABLES | {"recorded": lambda: recorded(tuple(args.also))}
    tables = [table for name in args.what or TABLES for table in makers[name]()]
    report = "\n".join(table.markdown() for table in tables)
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "report.md").write_text(report)
    print(report)


def recorded(also: tuple[Path, ...] = ()) -> list[Table]:
    """Real images and real tracks."""
    if not (data_folder() / "odometry").is_dir():
        return []
    handheld = sets.euroc(sets.HANDHELD, 340)
    cars = [data_folder() / "images" / "kitti06_0000_0050_stereo", *(p.parent for root in also for p in root.rglob("poses.txt"))]
    drives = [data_folder() / "odometry" / "kitti_raw_klt_tracks", *also]
    sequences = [handheld.every(n) for n in (2, 4, 8)] + [sets.euroc(sets.KEY_FRAMES)]
    sequences += [sets.kitti_pairs(folder).every(n) for folder in cars for n in (1, 2)]
    sequences += [sets.kitti_tracks(path).every(3) for root in drives for path in sorted(root.glob("*.npz"))]
    rows = [row(run(sequence, longest_s=0.8)) for sequence in sequences]
    return [Table("Recorded: odometry alone (/n: each n-th frame; lost steps add no drift)", COLUMNS, rows)]


def rendered() -> list[Table]:
    """Straight down at four heights; the rig as calibrated, and drawn from its covariance."""
    rows = []
    for height_m in HEIGHTS_M:
        for kind in ("village", "grass", "forest"):
            exact, drawn = (sets.nadir(height_m, kind, exact=is_exact) for is_exact in (True, False))
            rows.append(row(run(exact), "stereo"))
            rows.append(row(run(drawn), "stereo"))
            rows.append(row(run(drawn, height_sigma=0.02), "stereo, height +-2 %"))
            rows.append(row(run(drawn, height_sigma=0.02, one_camera=True), "one camera, height +-2 %"))
    return [Table("Rendered, straight down, 2 Hz, at most 10 m/s", COLUMNS, rows)]


def motion() -> list[Table]:
    """The ground in half of the image moves."""
    rows = []
    for height_m in (30.0, 60.0):
        for moving_m_s in (0.2, 1.0, 4.0):
            for height_sigma in (None, 0.02):
                scored = run(sets.nadir(height_m, "village", exact=True, moving_m_s=moving_m_s), height_sigma=height_sigma)
                seen = sum(bool(step.reason or step.remark) for step in scored.steps)
                wrong = int((scored.nees.max(axis=1) > 16.3 / 3).sum()) if len(scored.nees) else 0
                rows.append(
                    (f"{height_m:.0f} m{', height given' if height_sigma else ''}", f"{moving_m_s} m/s", str(len(scored.steps)),
                     str(seen), str(scored.lost), str(len(scored.errors)), str(wrong), number(1e3 * rms(scored.errors[:, :3])))
                )  # fmt: skip
    columns = ("height", "speed", "steps", "said or lost", "lost", "answered", "of these outside 99.9 %", "rms mm")
    return [Table("Half of the image moves", columns, rows)]


def speed() -> list[Table]:
    """Processor time of a pair of grey images: its frame (rectification included) and the step to it."""
    timed = [(f"{width} x {height}, {kind}", sets.nadir(30.0, kind, exact=True, size=(width, height)))
             for width, height in ((1280, 720), (640, 480)) for kind in ("village", "grass", "forest")]  # fmt: skip
    if (data_folder() / "odometry").is_dir():
        timed.append(("752 x 480, hand-held at 5 Hz", sets.euroc(sets.HANDHELD, 340).every(4)))
    rows = []
    for name, sequence in timed:
        kept = replace(
            sequence, frames=[f._replace(images=_held(*(grey(image) for image in f.images()))) for f in sequence.frames]
        )
        rounds = [run(kept) for _ in range(ROUNDS)]
        each = np.array([np.array(scored.frame_ms[1:]) + scored.step_ms for scored in rounds])
        best = (f"{x:.1f}" for x in np.percentile(each.min(axis=0), [50, 99]).tolist())
        rows.append((name, *best, *(f"{x:.1f}" for x in np.percentile(each, [50, 99]).tolist())))
    columns = ("grey images", "best of each pair: p50", "p99", f"all of {ROUNDS} rounds: p50", "p99")
    return [Table("Processor time, ms a pair", columns, rows)]


def _held(left: Image, right: Image) -> Callable[[], tuple[Image, Image]]:
    return lambda: (left, right)


TABLES: dict[str, Callable[[], list[Table]]] = {
    "recorded": recorded, "rendered": rendered, "motion": motion, "speed": speed,
}  # fmt: skip


def row(scored: Scored, note: str = "") -> tuple[str, ...]:
    """One line of the large tables."""
    if not len(scored.errors):
        return (f"{scored.name} {note}", str(len(scored.steps)), str(scored.lost), *["-"] * 12)
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
    return (f"{scored.name} {note}".strip(), *counts, *(number(v) for v in values))


def rms(e: Array) -> float:
    """Root mean square of the lengths of rows."""
    return float(np.sqrt((e**2).sum(axis=1).mean())) if len(e) else float("nan")


if __name__ == "__main__":
    main()
