"""OrthoLoC's example: `python -m benchmarks.aerial.ortholoc [--seed 0] [--priors 12]`.

A photo 25 degrees off straight down, over its own orthophoto and over the state's, of another season; decoys: the map turned.

Files `urban_residential*` of deepscenario/OrthoLoC, ortholoc/assets/demo (CC BY-NC-SA 4.0), in images/ortholoc_demo of
LANDFIX_DATA. Poses are exact; the ground is 13.0 m below the origin, by 57 SIFT matches.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from benchmarks.aerial.registration import decoys, fly, table
from benchmarks.aerial.registration_sets import LOW, Flight, Scene, Taken, shots, turned
from benchmarks.aerial.trials import nadir_rig
from benchmarks.flights.tasks import data_folder
from models.camera import CameraModel
from vision.ground.image import GroundImage, Heights
from vision.image.rectify import Image
from vision.recognisers import MapImage

FOLDER = "images/ortholoc_demo"
GROUND_UP_M = -13.0
NAME = "urban_residential"
MAPS = {"the photo's own orthophoto": "DOP", "the state's orthophoto": "xDOP"}
_STEP_M = 0.1815185546875  # of the files' tags
_WEST_M = {"DOP": -92.821044921875, "xDOP": -92.82773812056985}
_NORTH_M = {"DOP": 92.836181640625, "xDOP": 92.82782244775444}
_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # of east, north, up
_APART_NS = 20_000_000_000  # so that no prior has to do with the one before


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.aerial.ortholoc", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--priors", type=int, default=12)
    args = parser.parse_args()
    if not is_there(data_folder()):
        raise SystemExit(f"{data_folder() / FOLDER} not found: it holds {NAME}* of deepscenario/OrthoLoC, ortholoc/assets/demo")
    cv2.setNumThreads(1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # it does not know GeoTIFF's tags, and says so
    outcomes = [o for flight in flights(data_folder(), args.seed, args.priors) for o in fly(flight)]
    sys.stdout.write(f"{table(outcomes).markdown()}\n{decoys(outcomes).markdown()}")


def flights(data: Path, seed: int, priors: int) -> Iterator[Flight]:
    """The photo with so many priors, over each map, and over each map turned."""
    for name, form in MAPS.items():
        one = scene(data, form, priors)
        yield Flight(name, one.rig, one.known, shots(one, LOW, (seed, name, 0)))
        for k, turn in enumerate((cv2.ROTATE_180, cv2.ROTATE_90_CLOCKWISE, cv2.ROTATE_90_COUNTERCLOCKWISE)):
            decoy = turned(one.known, turn)
            yield Flight(f"{name}, turned", one.rig, decoy, shots(one, LOW, (seed, name, 1 + k)), decoy=True)


def is_there(data: Path) -> bool:
    """Whether the files are."""
    return (data / FOLDER / f"{NAME}_extrinsics.json").is_file()


def scene(data: Path, form: str, priors: int) -> Scene:
    """The photo, as often as there are priors, over one of MAPS."""
    camera, photo = _camera(data), read(data / FOLDER / f"{NAME}.jpg")
    world_to_camera = np.array(json.loads((data / FOLDER / f"{NAME}_extrinsics.json").read_text())["pose_w2c"])
    R_cw, t = world_to_camera[:, :3], world_to_camera[:, 3]
    rig = nadir_rig(camera)
    p_n, R_nb = _NED @ (-R_cw.T @ t), _NED @ R_cw.T @ rig.R_bc.T
    affine = np.array([
        [0.0, -_STEP_M, _NORTH_M[form] - 0.5 * _STEP_M],
        [_STEP_M, 0.0, _WEST_M[form] + 0.5 * _STEP_M],
    ])  # fmt: skip
    image = read(data / FOLDER / f"{NAME}_{form}.tif")
    known = MapImage.of(GroundImage(form, image, affine, Heights.level(-GROUND_UP_M), 0.3, 0.5))
    return Scene(rig, known, [Taken(k * _APART_NS, photo, p_n, R_nb) for k in range(priors)])


def _camera(data: Path) -> CameraModel:
    k = json.loads((data / FOLDER / f"{NAME}_intrinsics.json").read_text())["intrinsics"]
    return CameraModel(1024, 768, k[0][0], k[1][1], k[0][2], k[1][2])


def read(path: Path) -> Image:
    """A picture (h, w, 3). Raises FileNotFoundError."""
    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError(path)
    return np.asarray(image, dtype=np.uint8)


if __name__ == "__main__":
    main()
