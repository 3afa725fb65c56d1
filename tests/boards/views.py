"""Images and views of a board by a known camera: x_o = R_oc (x_c - t).

Edge pixels: mean of 55 rays on a Fibonacci lattice.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from calib.board.chessboard import Board, View
from calib.board.corners import Grey
from calib.cameras.bundle import Pose
from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array

_DARK, _BRIGHT, _WALL = 30.0, 220.0, 120.0
_LATTICE = np.array([((k + 0.5) / 55.0 - 0.5, (34 * k % 55 + 0.5) / 55.0 - 0.5) for k in range(55)])  # px


class Painter:
    """Renders a board for one camera with precomputed rays."""

    def __init__(self, camera: CameraModel, board: Board) -> None:
        self.camera, self.board = camera, board
        v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
        plane = camera.undistort(np.column_stack((u.ravel(), v.ravel()))).reshape(camera.height, camera.width, 2)
        self._plane = plane
        self._by_v, self._by_u = (np.asarray(np.gradient(plane, axis=axis)) for axis in (0, 1))  # from pixel to pixel

    def paint(self, pose: Pose, rng: np.random.Generator, noise: float = 2.0, blur_px: float = 0.6) -> Grey:
        """Image at x_c = R @ x_o + t; noise: grey levels, blur_px: sigma."""
        image = self._levels(pose, self._plane)
        around = np.ones((3, 3), np.uint8)
        edge = cv2.dilate(image, around) != cv2.erode(image, around)
        plane, by_u, by_v = self._plane[edge], self._by_u[edge], self._by_v[edge]
        image[edge] = np.mean([self._levels(pose, plane + du * by_u + dv * by_v) for du, dv in _LATTICE], axis=0)
        if blur_px > 0:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur_px))
        noisy = np.rint(image + rng.normal(0.0, noise, image.shape))
        return np.asarray(np.clip(noisy, 0, 255), dtype=np.uint8)

    def _levels(self, pose: Pose, plane: Array) -> Array:
        # x_o = R^T (s ray - t) with z_o = 0
        rays_o, eye_o = plane @ pose.R[:2] + pose.R[2], -pose.R.T @ pose.t
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -eye_o[2] / rays_o[..., 2]
            i, j = (np.floor((eye_o[k] + s * rays_o[..., k]) / self.board.square_m + 1.0) for k in (0, 1))
        inside = (s > 0) & (i >= 0) & (j >= 0) & (i <= self.board.columns) & (j <= self.board.rows)
        paper = (s > 0) & (i >= -1) & (j >= -1) & (i <= self.board.columns + 1) & (j <= self.board.rows + 1)
        dark = (i + j) % 2 == 0  # the square inside corners 0 and columns + 1 is dark, as chessboard.find reads it
        return np.where(inside & dark, _DARK, np.where(paper, _BRIGHT, _WALL))


def poses(cameras: Sequence[tuple[CameraModel, Pose]], board: Board, count: int, rng: np.random.Generator) -> list[Pose]:
    """Hand-held board poses, tilts to 40 degrees, seen by all cameras."""
    first = cameras[0][0]
    middle = board.points.mean(axis=0)
    chosen: list[Pose] = []
    while len(chosen) < count:
        rough = rng.uniform(0.3, 1.2) * first.fx * board.columns * board.square_m / first.width * 1.6
        px = rng.uniform((0.0, 0.0), (first.width, first.height))
        centre = first.ray(px[None])[0] * rough
        tilt = so3.quat_exp(np.append(rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.3, 0.3)))
        R = so3.matrix(tilt)
        pose = Pose(R, centre - R @ middle)
        x_1 = pose.of(board.points)
        if all(x[:, 2].min() > 0.05 and c.contains(c.project(x), 8.0).all() for c, x in ((c, p.of(x_1)) for c, p in cameras)):
            chosen.append(pose)
    return chosen


def seen(camera: CameraModel, pose: Pose, board: Board, rng: np.random.Generator, sigma_px: float, name: str = "") -> View:
    """The view without an image: exact corners plus white noise."""
    px = camera.project(pose.of(board.points))
    return View(name, camera.width, camera.height, np.arange(len(px)), px + rng.normal(0.0, sigma_px, px.shape), 2.0)


def both(rig: StereoRig) -> list[tuple[CameraModel, Pose]]:
    """The rig's cameras, poses of the left one in each."""
    return [(rig.left, Pose(np.eye(3), np.zeros(3))), (rig.right, Pose(rig.R_rc, rig.t_rc))]
