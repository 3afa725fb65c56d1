"""SpaceNet Atlanta: footprints over a panchromatic image of 0.5 m, taken as that of a camera far above.

Map: a set of neighbouring footprints; prior: up to 24 m off. Judged: the shift left between projected footprints and image,
against all *other* footprints.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.aerial.reference import plane_pose, utm_to_ned
from benchmarks.aerial.trials import Case, Spread, nadir_rig
from models.camera import CameraModel
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from vision.describe.survey import to_8_bit
from vision.image.rectify import Image

FOLDER = "images/spacenet_atlanta_footprints"
EPSG = 32616
HEIGHT_M, STEP_M, SIZE = 2000.0, 0.5, 900
SHIFT_M = 24.0  # of the prior, on each axis
SPREAD = Spread(2.0 / math.sqrt(3.0) * SHIFT_M, 1.0, math.radians(0.01), math.radians(0.1))  # as uniform in a square
_NORTH_WEST = (733601.0, 3725139.0)  # of the image
_ROOF_SIGMA_M = 0.7  # footprint to what is seen of the roof: each house leans and was drawn by hand
_SEARCHED_PX, _BLUR_PX = 10, 1.0


@dataclass(frozen=True)
class Scene:
    """Image (16 bit), all footprints, camera and its pose p_nc, R_nc; slope (2, H, W): du, dv of the blurred image."""

    image: Image
    landmarks: LandmarkMap
    camera: CameraModel
    p_nc: Array
    R_nc: Array
    slope: Array


def scene(data: Path) -> Scene:
    """What is on file; footprints count as painted on level ground."""
    image = cv2.imread(str(data / FOLDER / "sample_geotiff.tif"), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise FileNotFoundError(data / FOLDER / "sample_geotiff.tif")
    read = LandmarkMap.from_geojson((data / FOLDER / "geotiff_labels.geojson").read_bytes())
    s = _ROOF_SIGMA_M
    flat = [Landmark.of(m.id, m.outline_n, 0.0, sigma_m=s, outline_sigma_m=s, corner_sigma_m=s) for m in read]
    landmarks = LandmarkMap.from_landmarks(read.origin, flat)
    f = HEIGHT_M / STEP_M
    camera = CameraModel(SIZE, SIZE, f, f, 0.5 * (SIZE - 1), 0.5 * (SIZE - 1))
    px = np.array([[u, v] for u in (0.0, SIZE - 1.0) for v in (0.0, 0.5 * SIZE, SIZE - 1.0)])
    xy = np.array(_NORTH_WEST) + STEP_M * (px + 0.5) * np.array([1.0, -1.0])
    ground_n = utm_to_ned(landmarks, EPSG, xy, np.full(len(xy), landmarks.origin[2]))
    smooth = cv2.GaussianBlur(to_8_bit(image), (0, 0), _BLUR_PX)
    slope = np.array([cv2.Sobel(smooth, cv2.CV_64F, 1, 0), cv2.Sobel(smooth, cv2.CV_64F, 0, 1)])
    return Scene(image, landmarks, camera, *plane_pose(ground_n, px, camera), slope)


def sets(landmarks: LandmarkMap, size: int) -> list[list[Landmark]]:
    """Each footprint with its nearest neighbours."""
    every = list(landmarks)
    centres = np.array([m.centre_n for m in every])
    distance = np.linalg.norm(centres[:, None] - centres, axis=2)
    return [[every[j] for j in np.argsort(row)[:size]] for row in distance]


def case(of: Scene, name: str, marks: Sequence[Landmark], apart_m: Array) -> Case:
    """The image with these footprints for a map; judged by how much farther they are off than all the others."""
    rig = nadir_rig(of.camera)
    landmarks = LandmarkMap.from_landmarks(of.landmarks.origin, marks)

    def judge(p_n: Array, R_nb: Array) -> float:
        return float(np.linalg.norm(projected_shift(of, marks, p_n, R_nb) - apart_m))

    group, shown = f"SpaceNet, {len(marks)} footprints", tuple(m.id for m in marks)
    return Case(group, name, of.image, rig, landmarks, of.p_nc, of.R_nc @ rig.R_bc.T, shown, judge)


def prior(of: Case, rng: np.random.Generator) -> Prior:
    """The pose with what SPREAD draws, the shift uniform in a square."""
    drawn = SPREAD.draw(rng, of.p_n, of.R_nb)
    shift = np.array([*rng.uniform(-SHIFT_M, SHIFT_M, 2), drawn.p_n[2] - of.p_n[2]])
    return replace(drawn, p_n=of.p_n + shift)


def projected_shift(of: Scene, marks: Sequence[Landmark], p_n: Array, R_nb: Array) -> Array:
    """Mean shift (2,) [m], right and down in the image, of the projected set against where the file puts it."""
    roofs = np.concatenate([np.column_stack((m.outline_n, np.full(len(m.outline_n), m.roof_d))) for m in marks])
    p_nc, R_nc = nadir_rig(of.camera).camera_pose(p_n, R_nb)
    px = of.camera.project((roofs - p_nc) @ R_nc) - of.camera.project((roofs - of.p_nc) @ of.R_nc)
    mean: Array = STEP_M * px.mean(axis=0)
    return mean


def misregistration(of: Scene, without: Sequence[Landmark]) -> Array:
    """Shift (2,) [m] at which all other footprints' outlines lie on the steepest slopes: mean |normal . slope|, its summit."""
    used = {m.id for m in without}
    px, normal = _outline_points(of, [m for m in of.landmarks if m.id not in used])
    shifts = np.arange(-_SEARCHED_PX, _SEARCHED_PX + 1)
    score = np.array([[_score(of.slope, px + np.array([u, v]), normal) for u in shifts] for v in shifts])
    v, u = (int(np.clip(i, 1, len(shifts) - 2)) for i in np.unravel_index(int(score.argmax()), score.shape))
    shift: Array = STEP_M * np.array([shifts[u] + _summit(score[v, u - 1 : u + 2]), shifts[v] + _summit(score[v - 1 : v + 2, u])])
    return shift


def _outline_points(of: Scene, marks: Sequence[Landmark]) -> tuple[Array, Array]:
    """Points a pixel apart on the projected outlines (N, 2) and unit normals (N, 2)."""
    points, normals = [], []
    for mark in marks:
        roof = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        corners = of.camera.project((roof - of.p_nc) @ of.R_nc)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            length = float(np.linalg.norm(b - a))
            t = (np.arange(int(length)) + 0.5)[:, None] / max(length, 1.0)
            points.append(a + t * (b - a))
            normals.append(np.tile(np.array([a[1] - b[1], b[0] - a[0]]) / length, (len(t), 1)))
    return np.concatenate(points), np.concatenate(normals)


def _score(slope: Array, px: Array, normal: Array) -> float:
    column, row = np.rint(px).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < SIZE) & (row < SIZE)
    du, dv = slope[:, row[inside], column[inside]]
    return float(np.mean(np.abs(du * normal[inside, 0] + dv * normal[inside, 1])))


def _summit(three: Array) -> float:
    """Of the parabola through three neighbours, the middle one largest."""
    left, top, right = three.tolist()
    bend = left - 2.0 * top + right
    return 0.5 * (left - right) / bend if bend < 0.0 else 0.0
