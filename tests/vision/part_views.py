"""Rendered views that show too little for a whole pose: one corner, two parallel edges, one round roof, one square."""

from typing import Final

import numpy as np

from models import so3
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from tests.vision.pose.test_pose import COLOURS, Flight
from tests.vision.roofs import nadir_rig
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.render import render_pair
from vision.synthetic.world import Appearance, Sun, World

SIGMA: Final = np.array([0.5, 0.5, 0.3, *np.radians([0.2, 0.2, 0.7])])  # a filter that is aided
HEIGHT_M: Final = 40.0
_SIDE: Final = HEIGHT_M * 640.0 / 600.0  # as wide as the image
_ROUND: Final = 0.15 * HEIGHT_M  # radius


def box(width: float, length: float) -> Array:
    """Anticlockwise from above (north, east), about 0."""
    return np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * [width, length]


def polygon(corners: int, area_m2: float) -> Array:
    """A regular one."""
    t = 2.0 * np.pi * np.arange(corners) / corners
    radius = np.sqrt(2.0 * area_m2 / (corners * np.sin(2.0 * np.pi / corners)))
    return np.asarray(radius * np.column_stack((np.cos(t), np.sin(t))))


def _outline(kind: str, rng: np.random.Generator) -> tuple[Array, Array]:
    """As it is, and where its middle is from below the vehicle."""
    match kind:
        case "corner":
            return box(_SIDE, _SIDE), 0.5 * _SIDE + rng.uniform(-0.1, 0.1, 2) * _SIDE
        case "strip":
            return box(10.0 * HEIGHT_M, 0.25 * HEIGHT_M), np.array([0.0, rng.uniform(-0.1, 0.1) * HEIGHT_M])
        case "round":
            return polygon(48, np.pi * _ROUND**2), rng.uniform(-0.1, 0.1, 2) * HEIGHT_M
        case _:
            return box(0.18 * HEIGHT_M, 0.18 * HEIGHT_M), rng.uniform(-0.15, 0.15, 2) * HEIGHT_M


def part_view(kind: str, seed: int, sigma: Array = SIGMA) -> Flight:
    """corner, strip, round (mapped with 12 corners) or square, with the vehicle's heading; the prior is drawn about the truth."""
    rng, rig = np.random.default_rng(seed), nadir_rig(lens=(-0.1, 0.02, 0.0, 0.0))
    yaw = rng.uniform(-3.0, 3.0)
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    outline, middle = _outline(kind, rng)
    height_m = rng.uniform(0.03, 0.08) * HEIGHT_M
    true = Landmark.of("0", (outline + middle) @ turn, 0.0, height_m, COLOURS[0])
    drawn = polygon(12, np.pi * _ROUND**2) if kind == "round" else outline
    mark = Landmark.of("0", (drawn + middle) @ turn, 0.0, height_m, COLOURS[0])
    world = World((true,), (Appearance(COLOURS[0]),), (), Ground.procedural(rng), Sun(rng.uniform(-3.0, 3.0)))
    roll, pitch = rng.normal(0.0, 0.05, 2)
    R_nb = so3.matrix(so3.from_euler(roll, pitch, yaw))
    p_n = np.array([0.0, 0.0, -HEIGHT_M])
    images = render_pair(world, rig, p_n, R_nb, Conditions(), rng)
    error = sigma * rng.normal(size=6)
    q = so3.normalise(so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(R_nb)))
    return Flight(images, rig, (mark,), p_n, R_nb, Prior(p_n - error[:3], q, np.diag(sigma**2)))
