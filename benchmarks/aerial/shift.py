"""SpaceNet: where all footprints of a set together lie best, before the decision to accept it.

python -m benchmarks.aerial.shift [--seed N]

found: the summit of the joint score (vision/predict/joint_score.py) is within 2 m of the truth, as all *other* footprints tell
it; ratio: of the summit to the second one, which is what decides. Decoys: the same sets turned, where no position is right.
"""

import argparse
import sys
from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.aerial import spacenet
from benchmarks.aerial.trials import WRONG_M, Case, generator, turned
from benchmarks.flights.tasks import data_folder
from benchmarks.tables import Table
from models.maps.landmarks import Landmark
from models.prior import Prior
from vision.pose.sensitivity import eyes
from vision.predict import pattern
from vision.predict.coarse_search import CoarseConfig
from vision.predict.motion import motion
from vision.records.images import usable


@dataclass(frozen=True)
class Found:
    """How far the summit is from the truth, and how far it stands out."""

    error_m: float
    ratio: float


def observe(case: Case, prior: Prior, marks: list[Landmark]) -> Found:
    """The summit over all shifts that the prior allows, at its heading and height."""
    eye, images = eyes(case.rig)[0], usable(case.image, None, case.rig)
    move = motion(eye, marks, prior)
    assert not isinstance(images, str)
    assert move is not None
    best = pattern.best_shift(eye, images, marks, move, CoarseConfig())
    assert not isinstance(best, str)
    return Found(case.judge(*move.pose(move.gain @ best.q)), best.ratio)


def observations(of: spacenet.Scene, size: int, seed: int) -> tuple[list[Found], list[Found]]:
    """Of all sets of a size, and of the same sets turned; priors as in `python -m benchmarks.aerial spacenet --priors 1`."""
    right, decoys = [], []
    for marks in spacenet.sets(of.landmarks, size):
        name = f"{size} at {marks[0].id}"
        rng, apart_m = generator(seed, name, 0), spacenet.misregistration(of, marks)
        known = spacenet.case(of, name, marks, apart_m)
        right.append(observe(known, spacenet.prior(known, rng), marks))
        elsewhere = turned(marks, np.mean([m.centre_n for m in marks], axis=0), rng)
        decoy = spacenet.case(of, name, elsewhere, apart_m)
        decoys.append(observe(decoy, spacenet.prior(decoy, rng), elsewhere))
    return right, decoys


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.aerial.shift", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    seed = parser.parse_args().seed
    cv2.setNumThreads(1)
    of, rows = spacenet.scene(data_folder()), []
    for size in spacenet.SIZES:
        right, decoys = observations(of, size, seed)
        found = [one for one in right if one.error_m < WRONG_M]
        sure = [sum(one.ratio >= pattern.SURE for one in some) for some in (found, right, decoys)]
        rows.append((
            f"sets of {size}", str(len(right)), f"{len(found) / len(right):.0%}", f"{np.median([f.error_m for f in found]):.2f}",
            f"{np.median([f.ratio for f in found]):.2f}", str(sure[0]), str(sure[1] - sure[0]), str(sure[2]),
            f"{max(d.ratio for d in decoys):.2f}",
        ))  # fmt: skip
    columns = (
        "", "sets", "found within 2 m", "median m", "median ratio", f"ratio >= {pattern.SURE}, right", "wrong", "decoys",
        "decoys' largest ratio",
    )  # fmt: skip
    sys.stdout.write(Table("All outlines together", columns, rows).markdown() + "\n")


if __name__ == "__main__":
    main()
