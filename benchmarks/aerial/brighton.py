"""Brighton Beach: photos from 40 m, outlines digitised from the orthophoto and the heights of the surface model.

The reference pose of a photo is SIFT against the orthophoto, heights from the surface model, then perspective n points.
"""

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from benchmarks.aerial.reference import Image, Ortho, Reference, SiftReference, utm_to_ned
from benchmarks.aerial.trials import Case, Spread, Trial, distance_from, generator, nadir_rig, outline_share, turned
from models.camera import CameraModel
from models.maps.landmarks import LandmarkMap

FOLDER = "images/brighton_beach_uav"
MAP_FILE = Path(__file__).parents[1] / "data" / "brighton_beach.geojson"
EPSG = 32615
SPREAD = Spread(7.0, 1.5, math.radians(1.0), math.radians(3.0))
WIDTH = 1600  # of the stored photos
AS_FINE_AS_THE_MAP = 800  # the outlines are good to 0.1 m: 1.2 px of this width, 2.4 px of the stored one
MANY, FEW, DECOY = "Brighton, 3 outlines or more", "Brighton, 1 or 2 outlines", "Brighton, map turned"
_MANY = 3
_SHOWN = 0.5  # of its outline that is in the photo, then a landmark counts as in view
_FOCAL = 3.61 / 6.317  # focal length over the sensor's width
_DISTORTION = (0.0103, 0.0124, 0.0, 0.0)  # from the key points of 12 photos in the orthophoto, which confirm _FOCAL to 0.6 %
_SENSOR_SIGMA = 3e-3  # of focal length and principal point over the width
_DISTORTION_SIGMA = 3e-3


def camera(width: int = WIDTH) -> CameraModel:
    """The camera at an image width of so many pixels."""
    f, height = _FOCAL * width, width * 9 // 16
    sigma = np.array([_SENSOR_SIGMA * width] * 4 + [_DISTORTION_SIGMA] * 2 + [1e-4] * 2)
    return CameraModel(width, height, f, f, 0.5 * (width - 1), 0.5 * (height - 1), _DISTORTION, np.diag(sigma**2))


def trials(data: Path, seed: int, priors: int, width: int, spread: Spread = SPREAD) -> Iterator[Trial]:
    """Every photo with a reference and an outline, then those with 3 outlines under a turned map.

    The next photo (7 s later) comes after 2 s, with the same error of the prior.
    """
    landmarks, names = landmark_map(), photo_names(data)
    cases = {n: case(data, n, where, landmarks, width) for n, where in references(data, landmarks, names).items()}
    following = dict(pairwise(names))
    for name, known in cases.items():
        if not known.shown:
            continue
        after = cases.get(following.get(name, ""))
        for number in range(priors):
            rng = generator(seed, name, number)
            prior = spread.draw(rng, known.p_n, known.R_nb)
            then = None if after is None else (after, spread.draw(generator(seed, name, number), after.p_n, after.R_nb))
            yield Trial(known, number, prior, then)
            if known.group == MANY:
                decoys = LandmarkMap.from_landmarks(landmarks.origin, turned(list(landmarks), known.p_n[:2], rng))
                yield Trial(_turned_map(known, decoys), number, prior, then and (_turned_map(then[0], decoys), then[1]))


def _turned_map(known: Case, decoys: LandmarkMap) -> Case:
    """The same photo under another map."""
    return replace(known, group=DECOY, landmarks=decoys)


def landmark_map() -> LandmarkMap:
    """The digitised outlines."""
    return LandmarkMap.from_geojson(MAP_FILE.read_bytes())


def photo_names(data: Path) -> list[str]:
    """Files in the order of the flight."""
    with (data / FOLDER / "photos.csv").open() as file:
        return [row["file"] for row in csv.DictReader(file)]


def references(data: Path, landmarks: LandmarkMap, names: Sequence[str]) -> dict[str, Reference]:
    """Reference poses of those photos that have one."""
    finder = SiftReference(ortho(data, landmarks))
    found = {name: finder.locate(photo(data, name), camera()) for name in names}
    return {name: where for name, where in found.items() if where is not None}


def photo(data: Path, name: str) -> Image:
    """A photo as it is stored."""
    return read(data / FOLDER / "photo" / name)


def read(path: Path) -> Image:
    """An image in colour."""
    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError(path)
    return np.asarray(image, dtype=np.uint8)


def ortho(data: Path, landmarks: LandmarkMap) -> Ortho:
    """Orthophoto with the position of every pixel in the map's n."""
    folder = data / FOLDER
    with np.load(folder / "dsm_0.1m_utm15n.npz") as archive:
        height_m, x0, y1, step = archive["dsm"], float(archive["x0"]), float(archive["y1"]), float(archive["res"])
    v, u = np.indices(height_m.shape)
    xy = np.column_stack((x0 + step * u.ravel(), y1 - step * v.ravel()))
    image = read(folder / "ortho_0.1m_utm15n.png")
    return Ortho(image, utm_to_ned(landmarks, EPSG, xy, height_m.ravel().astype(float)).reshape(*height_m.shape, 3))


def case(data: Path, name: str, where: Reference, landmarks: LandmarkMap, width: int) -> Case:
    """A photo, reduced to the width, and which outlines it shows."""
    lens = camera(width)
    image = photo(data, name)
    if width < WIDTH:
        image = np.asarray(cv2.resize(image, (lens.width, lens.height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    shown = tuple(m.id for m in landmarks if outline_share(lens, where.p_nc, where.R_nc, m) >= _SHOWN)
    rig = nadir_rig(lens)
    return Case(
        MANY if len(shown) >= _MANY else FEW, name.removesuffix(".jpg"), image, rig, landmarks, where.p_nc,
        where.R_nc @ rig.R_bc.T, shown, distance_from(where.p_nc),
    )  # fmt: skip
