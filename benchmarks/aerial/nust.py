"""NUST campus: a nadir video over two helipads, and over roads, digitised from the orthophoto.

Reference: every fifth frame registered to the orthophoto (SIFT, homography; about 0.5 m). A frame shows 223 m; focal length over
width is taken as 0.77. The ground is a plane. Judged: the ground in the frame's middle.
"""

import csv
import math
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.aerial.reference import plane_pose, utm_to_ned
from benchmarks.aerial.trials import Case, Judge, Spread, Trial, generator, nadir_rig, outline_share
from models.camera import CameraModel
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from vision.image.rectify import Image

FOLDER = "images/nust_uav_video_orthophoto"
MAP_FILE = Path(__file__).parents[1] / "data" / "nust_helipads.geojson"
EPSG = 32643
SPREAD = Spread(7.0, 3.0, math.radians(1.0), math.radians(3.0))
ROADS_FILE = Path(__file__).parents[1] / "data" / "nust_roads.geojson"
RING, STRAIGHT, MIRRORED = "NUST, ring road", "NUST, straight roads", "NUST, roads mirrored"
_RING_SHARE = 0.2  # of the ring in view, at least
_EVERY = 6  # registered frames
BOTH, ONE = "NUST, both helipads", "NUST, one helipad"
PADS = ("pad west", "pad east")
_ORTHO_CORNER, _ORTHO_STEP_M = (313101.47628, 3724912.30675), 0.5
_SIFT_PX = 0.25
REFERENCE_M = 0.19  # of the middle, per axis: reference, registration and features differ two by two by so much
_WIDTH, _HEIGHT, _FOCAL = 852, 480, 0.77
_MIDDLE = np.array([[0.5 * (_WIDTH - 1), 0.5 * (_HEIGHT - 1)]])


def camera() -> CameraModel:
    """The camera assumed."""
    f = _FOCAL * _WIDTH
    return CameraModel(_WIDTH, _HEIGHT, f, f, 0.5 * (_WIDTH - 1), 0.5 * (_HEIGHT - 1))


def trials(data: Path, seed: int, priors: int) -> Iterator[Trial]:
    """Every registered frame that shows a whole helipad."""
    landmarks, known = landmark_map(), registrations(data)
    shown = {number: pads(homography, landmarks) for number, homography in known.items()}
    for number, image in frames(data, [number for number, seen in shown.items() if seen]):
        one = case(number, image, known[number], landmarks)
        for k in range(priors):
            yield Trial(one, k, SPREAD.draw(generator(seed, one.name, k), one.p_n, one.R_nb))


def road_trials(data: Path, seed: int, priors: int) -> Iterator[Trial]:
    """Every sixth registered frame with roads, and with roads that are not there: mirrored about its middle."""
    roads, known = LandmarkMap.from_geojson(ROADS_FILE.read_bytes()), registrations(data)
    for number, image in frames(data, sorted(known)[::_EVERY]):
        right = case(number, image, known[number], roads)
        decoy = replace(right, group=MIRRORED, landmarks=_mirrored(roads, right.p_n[:2]))
        where = pose(known[number], roads)
        ring = np.mean([outline_share(right.rig.left, *where, mark) for mark in roads if mark.id.startswith("ring")])
        for one in (replace(right, group=RING if ring > _RING_SHARE else STRAIGHT), decoy):
            for k in range(priors):
                yield Trial(one, k, SPREAD.draw(generator(seed, f"{one.group} {one.name}", k), one.p_n, one.R_nb))


def _mirrored(landmarks: LandmarkMap, about: Array) -> LandmarkMap:
    """East and west exchanged."""
    turned = [
        Landmark.of(
            m.id, (m.outline_n - about) * np.array([1.0, -1.0]) + about, m.base_d, m.height_m, m.colour_bgr, m.sigma_m,
            m.height_sigma_m, m.outline_sigma_m, corner_sigma_m=m.corner_sigma_m,
        )
        for m in landmarks
    ]  # fmt: skip
    return LandmarkMap.from_landmarks(landmarks.origin, turned)


def landmark_map() -> LandmarkMap:
    """The digitised pads and their inner marks."""
    return LandmarkMap.from_geojson(MAP_FILE.read_bytes())


def registrations(data: Path) -> dict[int, Array]:
    """Frame -> homography (3, 3) from its pixels to those of the orthophoto.

    SIFT's key points lie 0.25 px too far right and down in both images (it seeks in the doubled one), so H(u) = H'(u + d) - d.
    """
    with (data / FOLDER / "reference_registration_sift.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = [f"h{i}{j}" for i in range(3) for j in range(3)]
    there, back = (np.array([[1.0, 0.0, d], [0.0, 1.0, d], [0.0, 0.0, 1.0]]) for d in (_SIFT_PX, -_SIFT_PX))
    return {int(row["frame"]): back @ np.array([float(row[n]) for n in names]).reshape(3, 3) @ there for row in rows}


def frames(data: Path, wanted: Collection[int]) -> Iterator[tuple[int, Image]]:
    """Those frames of the video."""
    video = cv2.VideoCapture(str(data / FOLDER / "uav_video.mp4"))
    for number in range(max(wanted, default=-1) + 1):
        done, image = video.read()
        if not done:
            return
        if number in wanted:
            yield number, image


def pose(homography: Array, landmarks: LandmarkMap) -> tuple[Array, Array]:
    """p_nc, R_nc of the camera whose image of the ground plane the homography describes best."""
    u, v = np.meshgrid(np.linspace(0.0, _WIDTH - 1.0, 9), np.linspace(0.0, _HEIGHT - 1.0, 6))
    px = np.column_stack((u.ravel(), v.ravel()))
    ortho_px = cv2.perspectiveTransform(px[None], homography)[0]
    xy = np.array(_ORTHO_CORNER) + _ORTHO_STEP_M * (ortho_px + 0.5) * np.array([1.0, -1.0])
    ground_n = utm_to_ned(landmarks, EPSG, xy, np.full(len(xy), landmarks.origin[2]))
    return plane_pose(ground_n, px, camera())


def pads(homography: Array, landmarks: LandmarkMap) -> tuple[str, ...]:
    """Helipads wholly in the frame."""
    where = pose(homography, landmarks)
    there = {mark.id: mark for mark in landmarks if mark.id in PADS}
    return tuple(name for name in PADS if name in there and outline_share(camera(), *where, there[name]) == 1.0)


def case(number: int, image: Image, homography: Array, landmarks: LandmarkMap) -> Case:
    """A frame."""
    rig = nadir_rig(camera())
    p_nc, R_nc = pose(homography, landmarks)
    shown = pads(homography, landmarks)
    group = BOTH if len(shown) == len(PADS) else ONE
    return Case(group, f"frame {number}", image, rig, landmarks, p_nc, R_nc @ rig.R_bc.T, shown, _by_middle(p_nc, R_nc))


def _by_middle(p_nc: Array, R_nc: Array) -> Judge:
    """Distance on the ground between what the middle of the image shows; the body stands at the camera."""
    ray_c = camera().ray(_MIDDLE)[0]

    def ground(p: Array, R: Array) -> Array:
        ray = R @ ray_c
        place: Array = (p - ray * (p[2] / ray[2]))[:2]
        return place

    there, R_bc = ground(p_nc, R_nc), nadir_rig(camera()).R_bc
    return lambda p, R: float(np.linalg.norm(ground(p, R @ R_bc) - there))
