"""Images of towns with the footprints that people drew on them, as photos of a camera that looks straight down.

The samples that the repository arghadeep25/Building-Footprint-Extraction-from-High-Resolution-Satellite-Images shows of five
public sets (Inria, CrowdAI, WHU, SpaceNet, ISPRS Potsdam; each has a licence of its own, most for research only, so none of them
is in this repository). Its folder datasets is read from images/building_tiles of LANDFIX_DATA. A footprint is a component of the
mask, its outline by Douglas and Peucker to 1.5 px. The images are rectified, so that footprints count as painted on level
ground. Sizes of a pixel are those of the sets where they are known; where a set mixes them, 0.5 m is written.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from models.camera import CameraModel
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from vision.image.rectify import Image

FOLDER = "images/building_tiles"
FOCAL_PX = 400.0  # so that 0.3 m a pixel are seen from 120 m
ORIGIN = (48.0, 11.0, 0.0)
SIGMA_M = 0.7  # of each outline and of each of its corners: drawn by hand, and roofs lean
_SETS = {  # metres a pixel; the images; what a name is replaced by in the name of the mask
    "Inria": (0.3, "inria/images/*.png", ("images", "gt")),
    "WHU East Asia": (0.45, "whu_east_asia/images/*.png", ("images", "gt")),
    "CrowdAI": (0.3, "crowdai/image/*_img.png", ("image/{0}_img", "gt/{0}{0}")),
    "WHU New Zealand": (0.3, "nzlnd/images/*.png", ("images", "gt")),
    "SpaceNet": (0.3, "spacenet/*[0-9].png", (".png", "_gt.png")),
    "WHU cities": (0.5, "whu_sample/*[a-z].png", (".png", "_gt.png")),
    "Potsdam": (1.17, "isprs/images/*.png", ("images", "gt")),
}
CHOSEN_ON = ("Inria", "WHU East Asia")  # every threshold was chosen on these, the others confirm it
_LEAST_PX2 = 40.0
_OUTLINE_PX = 1.5
_LEAST_MARKS = 3
_NED = np.array([[0.0, -1.0], [1.0, 0.0]])  # (north, east) of (u, v)


@dataclass(frozen=True)
class Tile:
    """An image of which a pixel is step_m wide; marks: footprints in n, whose origin is under the image's middle."""

    group: str
    name: str
    image: Image
    step_m: float
    marks: tuple[Landmark, ...]

    @property
    def camera(self) -> CameraModel:
        """The camera, FOCAL_PX * step_m above the ground."""
        height, width = self.image.shape[:2]
        return CameraModel(width, height, FOCAL_PX, FOCAL_PX, 0.5 * (width - 1), 0.5 * (height - 1))

    @property
    def p_n(self) -> Array:
        """Where the camera is."""
        return np.array([0.0, 0.0, -FOCAL_PX * self.step_m])

    def landmarks(self, marks: tuple[Landmark, ...] | None = None, common_sigma_m: float = 0.0) -> LandmarkMap:
        """Some footprints as a map, all by default."""
        return LandmarkMap.from_landmarks(ORIGIN, self.marks if marks is None else marks, (common_sigma_m, 0.0))


def is_there(data: Path) -> bool:
    """Whether the images are."""
    return (data / FOLDER / "inria").is_dir()


def tiles(data: Path) -> Iterator[Tile]:
    """Every image with three footprints or more."""
    for group, (step_m, pattern, (old, new)) in _SETS.items():
        for path in sorted((data / FOLDER).glob(pattern)):
            within = str(path.relative_to(data / FOLDER)).replace(old.format(path.name[0]), new.format(path.name[0]))
            mask_path = data / FOLDER / within
            if path.stem.endswith("_gt") or not mask_path.is_file():
                continue
            image, mask = cv2.imread(str(path)), cv2.imread(str(mask_path), cv2.IMREAD_GRAYSCALE)
            assert image is not None
            assert mask is not None
            marks = footprints(np.asarray(mask, dtype=np.uint8), step_m)
            if len(marks) >= _LEAST_MARKS:
                yield Tile(group, path.stem, np.asarray(image, dtype=np.uint8), step_m, marks)


def footprints(mask: Image, step_m: float) -> tuple[Landmark, ...]:
    """Components of a mask that the image's border does not cut, as landmarks."""
    _, binary = cv2.threshold(mask, 100, 255, cv2.THRESH_BINARY)
    height, width = mask.shape
    found = list[Landmark]()
    for contour in cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        corners = cv2.approxPolyDP(contour, _OUTLINE_PX, closed=True)[:, 0].astype(np.float64)
        low, high = corners.min(axis=0), corners.max(axis=0)
        cut = (low <= 1.0).any() or high[0] >= width - 2.0 or high[1] >= height - 2.0
        if len(corners) < 3 or cut or cv2.contourArea(corners.astype(np.float32)) < _LEAST_PX2:
            continue
        out = corners - corners.mean(axis=0)
        corners += 0.5 * out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1.0)  # the contour runs inside the mask
        outline_n = (corners - 0.5 * np.array([width - 1.0, height - 1.0])) @ _NED.T * step_m
        found.append(
            Landmark.of(str(len(found)), outline_n, 0.0, sigma_m=SIGMA_M, outline_sigma_m=SIGMA_M, corner_sigma_m=SIGMA_M)
        )
    return tuple(found)


def elsewhere(tile: Tile, kind: str, others: list[Tile], rng: np.random.Generator, open_m: float) -> tuple[Landmark, ...]:
    """The footprints of a decoy: turned, mirrored, moved, or of another town; none of them is where the prior allows it.

    open_m: what the prior leaves open on the ground (1 sigma of an axis). A map that is moved by less than several times as
    much is found where it is, and rightly so: 99.99 % of a prior are within 4.3.
    """
    if kind == "another town":
        other = others[int(rng.integers(len(others)))]
        return _changed(other.marks, np.eye(2) * tile.step_m / other.step_m, np.zeros(2))
    if kind == "moved":
        bearing, away_m = rng.uniform(0.0, 2.0 * math.pi), open_m * rng.uniform(8.0, 12.0)
        return _changed(tile.marks, np.eye(2), away_m * np.array([math.cos(bearing), math.sin(bearing)]))
    if kind == "mirrored":
        return _changed(tile.marks, np.diag([1.0, -1.0]), np.zeros(2))
    angle = math.radians(rng.uniform(30.0, 150.0)) * rng.choice([-1.0, 1.0])
    R = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return _changed(tile.marks, R, np.zeros(2))


def shifted(marks: tuple[Landmark, ...], rng: np.random.Generator, by_m: float, *, together: bool) -> tuple[Landmark, ...]:
    """The footprints of a map in error: all by_m off in one direction, or every third one in a direction of its own."""
    bearing = np.full(len(marks), rng.uniform(0.0, 2.0 * math.pi)) if together else rng.uniform(0.0, 2.0 * math.pi, len(marks))
    off = together | (rng.permutation(len(marks)) % 3 == 0)
    shift_m = by_m * off[:, None] * np.column_stack((np.cos(bearing), np.sin(bearing)))
    return tuple(_changed((mark,), np.eye(2), by)[0] for mark, by in zip(marks, shift_m, strict=True))


def _changed(marks: tuple[Landmark, ...], A: Array, shift_m: Array) -> tuple[Landmark, ...]:
    return tuple(
        Landmark.of(m.id, m.outline_n @ A.T + shift_m, 0.0, sigma_m=SIGMA_M, outline_sigma_m=SIGMA_M, corner_sigma_m=SIGMA_M)
        for m in marks
    )
