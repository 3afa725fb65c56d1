"""Rendered views of coloured roofs whose truth is known: for the statistics of what is measured."""

from dataclasses import dataclass

import cv2
import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps import outline as polygon
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.describe.measure import Level
from vision.image.rectify import Image
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.render import render_pair
from vision.synthetic.world import Appearance, World

COLOURS = ((40, 50, 190), (170, 80, 40), (60, 170, 60), (40, 170, 210), (160, 60, 150))
_TEXTURES = ("paint", "shingles", "gravel", "metal")


@dataclass(frozen=True)
class View:
    """A stereo pair over a world; roofs_c: corners of each roof in the left camera; level: their normal, known to 1 deg."""

    left: Image
    right: Image
    rig: StereoRig
    landmarks: tuple[Landmark, ...]
    roofs_c: tuple[Array, ...]
    level: Level


def nadir_rig(
    width: int = 640,
    height: int = 480,
    f: float = 600.0,
    baseline_m: float = 0.3,
    lens: tuple[float, ...] = (),
    squint_rad: float = 0.0,
) -> StereoRig:
    """Looks down; the image's upper edge is ahead."""
    camera = CameraModel(width, height, f, f, (width - 1) / 2, (height - 1) / 2, lens)
    R_bc = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    R_rc = so3.matrix(so3.quat_exp(squint_rad * np.array([1.0, -0.7, 1.2])))
    return StereoRig(camera, camera, R_rc, np.array([-baseline_m, 0.0, 0.0]), R_bc, np.zeros(3))


def roofs(rng: np.random.Generator, height_m: float) -> tuple[tuple[Landmark, ...], tuple[Appearance, ...]]:
    """Three to six boxes on a loose grid below a camera at height_m, painted in strong colours."""
    marks, appearances = [], []
    positions = [(x, y) for x in (-0.25, 0.25) for y in (-0.33, 0.0, 0.33)]
    for k in rng.permutation(6)[: rng.integers(3, 7)]:
        sides = np.sort(rng.uniform(0.07, 0.17, 2)) * height_m
        centre = (np.array(positions[k]) + rng.uniform(-0.02, 0.02, 2)) * height_m
        a = rng.uniform(0.0, np.pi)
        turn = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        outline = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * sides[::-1] / 2.0 @ turn + centre
        outline = outline if polygon.area(outline) > 0 else outline[::-1]
        marks.append(Landmark.of(str(k), outline, 0.0, rng.uniform(0.0, 0.12) * height_m, COLOURS[k % 5]))
        appearances.append(Appearance(COLOURS[k % 5], texture=_TEXTURES[rng.integers(4)], contrast=rng.uniform(0.03, 0.15)))
    return tuple(marks), tuple(appearances)


def view(seed: int, height_m: float = 30.0, tilt_rad: float = 0.12, rig: StereoRig | None = None) -> View:
    """One view from a seed: world, ground, attitude and place drawn."""
    rng, rig = np.random.default_rng(seed), rig or nadir_rig()
    landmarks, appearances = roofs(rng, height_m)
    yaw, tilt = rng.uniform(-np.pi, np.pi), np.array([*rng.normal(0.0, tilt_rad, 2), 0.0])
    R_nb = so3.matrix(so3.quat_exp(np.array([0.0, 0.0, yaw]))) @ so3.matrix(so3.quat_exp(tilt))
    p_n = np.array([*rng.normal(0.0, 0.05, 2) * height_m, -height_m])
    left, right = render_pair(World(landmarks, appearances, (), Ground.procedural(rng)), rig, p_n, R_nb, Conditions(), rng)
    p_nc, R_nc = rig.camera_pose(p_n, R_nb)
    corners = [(np.column_stack((m.outline_n, np.full(len(m.outline_n), m.roof_d))) - p_nc) @ R_nc for m in landmarks]
    known = so3.matrix(so3.quat_exp(rng.normal(0.0, np.radians(1.0), 3))) @ R_nc.T @ np.array([0.0, 0.0, -1.0])
    return View(left, right, rig, landmarks, tuple(corners), Level(known, np.radians(1.0)))


def roof_at(the_view: View, contour: Array, rig: StereoRig) -> int | None:
    """Index of the roof that a contour shows, wholly in the image and of about its size; None for anything else."""
    for k, corners in enumerate(the_view.roofs_c):
        px = rig.left.project(corners)
        size = cv2.contourArea(px.astype(np.float32))
        near = np.abs(px.mean(axis=0) - contour.mean(axis=0)).max() < 5.0
        if near and rig.left.contains(px, 4.0).all() and 0.75 < cv2.contourArea(contour.astype(np.float32)) / size < 1.33:
            return k
    return None
