"""What a stereo pair costs from images to fix, stage by stage, compared with SIFT + FLANN on the same pair: one run, one thread.

python -m benchmarks.speed.pipeline --seed 1 --pairs 40

Pairs: rendered villages on textured ground from 30 to 120 m, lenses distorted, 3 to 12 landmarks, at least 500 SIFT key points in
each image. Three priors: as after a fix a second ago (0.3 m, 0.3 and 0.5 degrees), as among GNSS fixes (1.5 m, 0.5 and 1
degree), as minutes after the last fix (3 m, 0.5 and 2 degrees). Times are of the processor, so that other work on the machine
counts less; the ratio is between two things measured one after the other. Nothing is asserted.
"""

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from typing import Any

import cv2
import msgspec
import numpy as np

from benchmarks.fixes.sift import sift_and_flann
from models import so3
from models.messages import Array
from models.prior import Prior
from vision import pipeline, recognise
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline
from vision.predict import coarse_search, fit, predict
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render_labels, render_pair
from vision.synthetic.rigs import make_rig
from vision.synthetic.scenes import Scene, WorldSpec, make_world

RIGS = {"VGA": make_rig(), "720p": make_rig(1280, 720, 900.0)}
PRIORS = {
    "fix 1 s ago": (0.3, 0.3, 0.2, 0.3, 0.3, 0.5),
    "GNSS": (1.5, 1.5, 1.0, 0.5, 0.5, 1.0),
    "minutes ago": (3.0, 3.0, 2.0, 0.5, 0.5, 2.0),
}  # 1 sigma: m, degrees
FLIGHTS = ((30.0, 12.0), (60.0, 22.0), (120.0, 40.0))  # height above ground, distance of buildings, m
LANDMARKS = (3, 12)
LEAST_POINTS = 500
STAGES: tuple[tuple[str, Any, str], ...] = (
    ("check", pipeline, "usable"),
    ("predict", predict.PredictPath, "moves"),
    ("reduce", coarse_search, "levels"),
    ("search", coarse_search.Search, "candidates"),
    ("fit", fit, "estimate_pose"),
    ("last look", fit, "final_check"),
    ("rectify", recognise, "rectify"),
    ("segment, regions", recognise, "segment_regions"),
    ("correspond", recognise, "correspond"),
    ("measure", recognise, "measure"),
    ("identify", recognise, "identify"),
)  # name, where it is looked up, under which name


class StageClock:
    """Seconds of the processor spent in each stage since it was last read, without what stages inside it took."""

    def __init__(self) -> None:
        self._spent = dict.fromkeys((name for name, _, _ in STAGES), 0.0)
        self._inner = [0.0]
        for name, owner, function in STAGES:
            setattr(owner, function, self._timed(name, getattr(owner, function)))

    def read(self) -> dict[str, float]:
        """Of each stage; begins anew."""
        spent, self._spent = self._spent, dict.fromkeys(self._spent, 0.0)
        return spent

    def _timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.process_time()
            self._inner.append(0.0)
            try:
                return function(*args, **kwargs)
            finally:
                whole = time.process_time() - begin
                self._spent[name] += whole - self._inner.pop()
                self._inner[-1] += whole

        return timed


@dataclass(frozen=True)
class Pair:
    """One pair, the scene it shows, and where it was taken."""

    scene: Scene
    left: Image
    right: Image
    p_n: Array
    q_nb: Array
    landmarks: int


class Row(msgspec.Struct, frozen=True):
    """One pair with one prior. Seconds."""

    size: str
    prior: str
    outcome: str
    landmarks: int
    points: int
    seconds: float
    sift_s: float
    stages: dict[str, float]


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.speed.pipeline", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=40, help="of each size")
    parser.add_argument("--json", action="store_true", help="print every pair as JSON")
    arguments = parser.parse_args()
    if arguments.pairs < 1:
        parser.error("--pairs must be at least 1")
    cv2.setNumThreads(1)
    clock, rows = StageClock(), list[Row]()
    for size in RIGS:
        for number, pair in zip(range(-1, arguments.pairs), pairs(size, arguments.seed), strict=False):
            timed = measure(size, pair, clock, np.random.default_rng([arguments.seed, number + 1]))
            rows += timed if number >= 0 else []  # the first pair compiles and makes tables
            print(f"\r{size}: {number + 1} of {arguments.pairs}", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
    print(msgspec.json.encode(rows).decode() if arguments.json else as_text(rows))


def pairs(size: str, seed: int) -> Iterator[Pair]:
    """Pairs that show what is asked for, without end."""
    rng, number = np.random.default_rng([seed, len(size)]), 0
    while True:
        height, spacing = FLIGHTS[number % len(FLIGHTS)]
        number += 1
        spec = WorldSpec(
            area_m=8.0 * spacing, spacing_m=spacing, unmapped=0.2, gone=0.05, sigma_m=0.2, height_sigma_m=0.1,
            outline_sigma_m=0.05, rig=RIGS[size],
        )  # fmt: skip
        scene = make_world(int(rng.integers(1 << 31)), spec)
        p_n = np.array([*rng.uniform(-1.5 * spacing, 1.5 * spacing, 2), -height * rng.uniform(0.8, 1.1)])
        roll, pitch = rng.normal(0.0, math.radians(4.0), 2)
        q_nb = so3.from_euler(roll, pitch, rng.uniform(-math.pi, math.pi))
        labels = render_labels(scene.world, scene.rig.left, *scene.rig.camera_pose(p_n, so3.matrix(q_nb)))
        shown = np.unique(labels)
        landmarks = int(np.sum((shown >= 0) & (shown < len(scene.world.landmarks))))
        if LANDMARKS[0] <= landmarks <= LANDMARKS[1]:
            left, right = render_pair(scene.world, scene.rig, p_n, so3.matrix(q_nb), Conditions(haze_per_m=5e-4), rng)
            yield Pair(scene, left, right, p_n, q_nb, landmarks)


def measure(size: str, pair: Pair, clock: StageClock, rng: np.random.Generator) -> list[Row]:
    """The pair with each prior, SIFT + FLANN before the first; nothing where that finds too few points to be compared with."""
    theirs = sift_and_flann(pair.left, pair.right)
    if theirs is None or theirs.points < LEAST_POINTS:
        return []
    rows = []
    for name, sigmas in PRIORS.items():
        sigma = np.array(sigmas) * np.repeat([1.0, math.pi / 180.0], 3)
        error = rng.normal(0.0, sigma)
        q = so3.multiply(so3.quat_exp(-error[3:]), pair.q_nb)
        prior = Prior(pair.p_n - error[:3], so3.normalise(q), np.diag(sigma**2))
        landmarks = LandmarkPipeline(pair.scene.rig_calibrated, pair.scene.map)
        clock.read()
        begin = time.process_time()
        result = landmarks.process(pair.left, pair.right, 1, prior)
        seconds, stages = time.process_time() - begin, clock.read()
        stages["the rest"] = seconds - sum(stages.values())
        rows.append(Row(size, name, result.report.outcome, pair.landmarks, theirs.points, seconds, theirs.seconds, stages))
    return rows


def as_text(rows: list[Row]) -> str:
    """A table for each size and prior."""
    return "\n\n".join(
        _block(f"{size}, prior: {prior}", some)
        for size in RIGS
        for prior in PRIORS
        if (some := [r for r in rows if (r.size, r.prior) == (size, prior)])
    )


def _block(title: str, rows: list[Row]) -> str:
    outcomes = ", ".join(f"{name} {count}" for name, count in Counter(r.outcome for r in rows).most_common())
    points = np.median([r.points for r in rows])
    lines = [
        f"{title}: {len(rows)} pairs with {LANDMARKS[0]} to {LANDMARKS[1]} landmarks, {points:.0f} SIFT key points; {outcomes}"
    ]
    lines.append(f"  {'ms':20s} {'mean':>8s} {'p50':>8s} {'p99':>8s}")
    for stage in rows[0].stages:
        spent = np.array([r.stages[stage] for r in rows])
        if spent.any():
            lines.append(_line(stage, spent))
    ours, theirs = np.array([r.seconds for r in rows]), np.array([r.sift_s for r in rows])
    lines += [_line("whole pipeline", ours), _line("SIFT + FLANN", theirs)]
    lines.append(f"  1/{np.median(theirs / ours):.1f} of SIFT + FLANN; {1.0 / np.median(ours):.0f} pairs a second on one core")
    return "\n".join(lines)


def _line(name: str, seconds: Array) -> str:
    mean, (p50, p99) = 1e3 * float(seconds.mean()), 1e3 * np.quantile(seconds, (0.5, 0.99))
    return f"  {name:20s} {mean:8.2f} {p50:8.2f} {p99:8.2f}"


if __name__ == "__main__":
    main()
