"""Rendered pairs straight down, with their true motion."""

from functools import cache

import numpy as np

from models import so3
from models.messages import Array
from vision.image.rectify import Image
from vision.odometry.step import Prediction
from vision.synthetic import Conditions, WorldSpec, make_rig, make_world, render_pair

RIG = make_rig(exact=True)
HEIGHT_M = 20.0
P_N = (np.array([0.0, 0.0, -HEIGHT_M]), np.array([1.2, 0.7, -HEIGHT_M - 0.3]))
R_NB = (so3.matrix(so3.from_euler(0.03, -0.02, 0.4)), so3.matrix(so3.from_euler(-0.02, 0.03, 0.55)))
DOWN_B = R_NB[0].T @ np.array([0.0, 0.0, 1.0])


@cache
def pair(k: int, shift_m: float = 0.0) -> tuple[Image, Image]:
    """Images at the first or second pose; shift_m: the ground lies so far to the east."""
    world = make_world(5, WorldSpec(area_m=80.0)).world
    at = P_N[k] - np.array([0.0, shift_m, 0.0])
    left, right = render_pair(world, RIG, at, R_NB[k], Conditions(), np.random.default_rng(k))
    return left, right


def truth() -> tuple[Array, Array]:
    """dp (3,), R_01 (3, 3)."""
    return R_NB[0].T @ (P_N[1] - P_N[0]), R_NB[0].T @ R_NB[1]


def prediction(
    error_m: tuple[float, float, float] = (0.05, -0.04, 0.03), height: tuple[float, float] | None = None
) -> Prediction:
    """The truth, off by error_m and 0.1 degrees; height: of the body, and its sigma."""
    p, R = truth()
    q = so3.multiply(so3.from_matrix(np.ascontiguousarray(R)), so3.quat_exp(np.radians([0.1, -0.1, 0.1])))
    covariance = np.diag(np.square([0.05] * 3 + [np.radians(0.1)] * 3))
    if height is None:
        return Prediction(p + error_m, q, covariance)
    return Prediction(p + error_m, q, covariance, DOWN_B, *height)
