"""A map of another year: `python -m benchmarks.aerial.years`.

Pairs of satellite images of one place, 5 to 14 years apart (LEVIR-CD, 0.5 m a pixel, and DSIFN; both for research only, so none
is in this repository): the folders samples_LEVIR and samples_DSIFN of the repository wgcban/ChangeFormer, in images/years of
LANDFIX_DATA. The later image is the map; three photos straight down are drawn from the earlier one. How well a pair is
registered is not known: REFERENCE_M. Decoys: maps turned, and of another place.
"""

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from benchmarks.aerial.ortholoc import read
from benchmarks.aerial.registration import decoys, fly, table
from benchmarks.aerial.registration_sets import LOW, Flight, Scene, Taken, drawn_view, shots, turned
from benchmarks.aerial.trials import nadir_rig
from benchmarks.flights.tasks import data_folder
from models import so3
from models.camera import CameraModel
from vision.ground.image import GroundImage, Heights
from vision.image.rectify import Image
from vision.recognisers import MapImage

FOLDER, SETS = "images/years", ("samples_LEVIR", "samples_DSIFN")
REFERENCE_M = 1.0
_STEP_M, _HEIGHT_M, _VIEWS, _OFF_M = 0.5, 69.0, 3, 10.0
_CAMERA = CameraModel(320, 240, 277.0, 277.0, 159.5, 119.5)
_APART_NS = 20_000_000_000  # so that no photo has to do with the one before


def main() -> None:
    """Command line."""
    if not is_there(data_folder()):
        raise SystemExit(f"{data_folder() / FOLDER} not found: it holds {' and '.join(SETS)} of wgcban/ChangeFormer")
    cv2.setNumThreads(1)
    outcomes = [o for flight in flights(data_folder()) for o in fly(flight)]
    sys.stdout.write(f"{table(outcomes).markdown()}\n{decoys(outcomes).markdown()}")


def is_there(data: Path) -> bool:
    """Whether the images are."""
    return (data / FOLDER / SETS[0] / "A").is_dir()


def flights(data: Path) -> Iterator[Flight]:
    """Each pair over its own map, over that map turned, and over the next pair's."""
    scenes = [scene(data / FOLDER / group, path.name, k) for k, (group, path) in enumerate(_pairs(data))]
    for k, one in enumerate(scenes):
        yield Flight("another year", one.rig, one.known, shots(one, LOW, (0, "years", k)))
        wrong = turned(one.known, cv2.ROTATE_90_CLOCKWISE), turned(one.known, cv2.ROTATE_180), scenes[k - 1].known
        for number, known in enumerate(wrong):
            yield Flight("another year, wrong map", one.rig, known, shots(one, LOW, (1 + number, "years", k)), decoy=True)


def _pairs(data: Path) -> Iterator[tuple[str, Path]]:
    for group in SETS:
        for path in sorted((data / FOLDER / group / "A").glob("*.png")):
            yield group, path


def scene(folder: Path, name: str, seed: int) -> Scene:
    """Three photos of the earlier image over the later one."""
    rng, rig = np.random.default_rng(seed), nadir_rig(_CAMERA)
    earlier, later = (_ground(name, read(folder / year / name)) for year in ("A", "B"))
    taken = []
    for k in range(_VIEWS):
        p_n = np.array([*rng.uniform(-_OFF_M, _OFF_M, 2), -_HEIGHT_M])
        R_nb = so3.matrix(so3.from_euler(rng.normal(0.0, 0.03), rng.normal(0.0, 0.03), rng.uniform(-math.pi, math.pi)))
        image = np.clip(drawn_view(earlier.image, earlier, rig, (p_n, R_nb)), 0.0, 255.0).astype(np.uint8)
        taken.append(Taken(k * _APART_NS, image, p_n, R_nb, REFERENCE_M))
    return Scene(rig, MapImage.of(later), taken)


def _ground(name: str, image: Image) -> GroundImage:
    """North up, level, its middle at the origin."""
    height, width = image.shape[:2]
    affine = np.array([[0.0, -_STEP_M, 0.5 * _STEP_M * (height - 1)], [_STEP_M, 0.0, -0.5 * _STEP_M * (width - 1)]])
    return GroundImage(name, image, affine, Heights.level(0.0), 0.5, 0.5)


if __name__ == "__main__":
    main()
