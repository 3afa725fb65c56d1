"""Image motion of a few landmarks with the pose, and what the prior leaves open.

    q = J dx + e,    Q = J P J^T,    dx = P J^T Q^-1 q           (q: shift u, v [px], turn [rad], log scale about their middle)

Four of six degrees of freedom matter; each q stands for its likeliest pose.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.camera import CameraModel
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.outline.visibility import Prisms
from vision.pose.pose import Pose
from vision.pose.sensitivity import Eye, part_in_view

_FLOOR = np.array([0.7, 0.7, 2e-3, 2e-3]) ** 2  # px^2, px^2, rad^2, 1: of q beside what dx explains

_LEAST = 3  # points that tell how the image moves
_LEAST_SQUARE = 1e-9  # px^2, of what is moved
_ASIDE = 0.1  # of the image's width: what lies farther outside does not count


@dataclass(frozen=True, slots=True)
class Motion:
    """Prior, J (4, 6), Q (4, 4), gain (6, 4); middle (2,), radius px of the outlines, roof_px: median width."""

    prior: Prior
    J: Array
    covariance: Array
    gain: Array
    middle: Array
    radius: float
    roof_px: float

    @property
    def shift_px(self) -> float:
        """1 sigma of the shift in its widest direction."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance[:2, :2])[-1]))

    @property
    def turn_rad(self) -> float:
        """1 sigma of the turn."""
        return math.sqrt(float(self.covariance[2, 2]))

    @property
    def log_scale(self) -> float:
        """1 sigma of the logarithm of the scale."""
        return math.sqrt(float(self.covariance[3, 3]))

    def pose(self, error: Array) -> Pose:
        """The prior's pose with error (6,)."""
        p_n, q_nb = np.asarray(self.prior.p_n, dtype=float), np.asarray(self.prior.q_nb_wxyz, dtype=float)
        return p_n + error[:3], _turned(q_nb, np.ascontiguousarray(error[3:]))


@njit(cache=True)
def _turned(q: Array, dtheta: Array) -> Array:
    return so3.product(so3.matrix(so3.quat_exp(dtheta)), so3.matrix(q))


def motion(eye: Eye, landmarks: Sequence[Landmark], prior: Prior) -> Motion | None:
    """Motion of the roofs in view, or nearly, at the prior; None without."""
    pinhole = straight(eye)
    p_n = np.asarray(prior.p_n, dtype=float)
    p_nk, R_nk = pinhole.pose(p_n, prior.R_nb)
    aside, corners = _ASIDE * eye.camera.width, Prisms.of(landmarks).roofs
    points = corners[pinhole.camera.contains(pinhole.camera.project((corners - p_nk) @ R_nk), -aside)]
    if len(points) < _LEAST and landmarks:  # of what is larger than the image sides are seen, not corners
        points = roofs_in_view(pinhole, landmarks, (p_n, prior.R_nb), aside)[0]
    if len(points) < _LEAST:  # all may come into view yet
        points = corners
    x_c = (points - p_nk) @ R_nk
    before = x_c[:, 2] > 0.1 * np.linalg.norm(x_c, axis=1)
    if before.sum() < _LEAST:
        return None
    points, x_c = points[before], x_c[before]
    px = pinhole.camera.project(x_c)
    middle = px.mean(axis=0)
    r = px - middle
    D = moved(pinhole.camera, x_c, points - p_n, R_nk)
    B = similarity(r).reshape(-1, 4)
    J = B.T @ D.reshape(-1, 6) / np.maximum(np.sum(B**2, axis=0), _LEAST_SQUARE)[:, None]  # its columns are orthogonal
    P = np.asarray(prior.covariance, dtype=float)
    Q = J @ P @ J.T + np.diag(_FLOOR)
    radius = max(1.3 * math.sqrt(float(np.mean(np.sum(r**2, axis=1)))), 1.0)
    roof_px = eye.camera.fx * float(np.median([mark.width_m for mark in landmarks])) / float(np.median(x_c[:, 2]))
    return Motion(prior, J, Q, np.linalg.solve(Q, J @ P).T, middle, radius, roof_px)


def roofs_in_view(eye: Eye, landmarks: Sequence[Landmark], pose: Pose, aside_px: float) -> tuple[Array, NDArray[np.int64]]:
    """Ends (N, 3) of roof sides within aside_px of the image, and their landmarks (N,)."""
    wide = Eye(enlarged(eye.camera, math.ceil(aside_px)), eye.R_kb, eye.p_bk, eye.right)
    bodies = Prisms.of(landmarks)
    start, count, following = bodies.roofs, np.diff(bodies.offsets), np.arange(1, len(bodies.vertices) + 1)
    following[bodies.offsets[1:] - 1] -= count
    end = start[following]
    part = part_in_view(wide, start, end, pose)
    seen = part[:, 0] < part[:, 1]
    whose = np.repeat(np.arange(len(count)), count)[seen]
    along, part = (end - start)[seen], part[seen]
    ends = np.stack((start[seen] + part[:, :1] * along, end[seen] - (1.0 - part[:, 1:]) * along), axis=1)
    return ends.reshape(-1, 3), np.repeat(whose, 2)


@lru_cache(maxsize=32)
def enlarged(camera: CameraModel, by: int) -> CameraModel:
    """A camera without distortion with `by` more pixels on each side."""
    return CameraModel(camera.width + 2 * by, camera.height + 2 * by, camera.fx, camera.fy, camera.cx + by, camera.cy + by)


def moved(camera: CameraModel, x_c: Array, lever_n: Array, R_nk: Array) -> Array:
    """Image motion (N, 2, 6) of x_c (N, 3) with the pose:  dx_c = R_nk^T (-dp + [X - p]x dtheta)."""
    jacobian = camera.project_jacobian(x_c) @ R_nk.T
    lever = lever_n[:, None, :]
    across = jacobian[..., [1, 2, 0]] * lever[..., [2, 0, 1]] - jacobian[..., [2, 0, 1]] * lever[..., [1, 2, 0]]
    return np.concatenate((-jacobian, across), axis=2)


def straight(eye: Eye) -> Eye:
    """The same camera without distortion."""
    return Eye(_pinhole(eye.camera), eye.R_kb, eye.p_bk, eye.right)


@lru_cache(maxsize=8)
def _pinhole(c: CameraModel) -> CameraModel:
    return CameraModel(c.width, c.height, c.fx, c.fy, c.cx, c.cy)


def similarity(r: Array) -> Array:
    """d(px) (N, 2, 4) of points r (N, 2) from the middle by shift, turn and log scale."""
    B = np.zeros((len(r), 2, 4))
    B[:, 0, 0] = B[:, 1, 1] = 1.0
    B[:, 0, 2], B[:, 1, 2] = -r[:, 1], r[:, 0]
    B[:, :, 3] = r
    return B
