"""Pictures and views of a board by a known camera, for tests and benchmarks: what calibration must give back.

Each pixel's ray meets the board's plane, x_o = R_oc (x_c - t), and takes the colour of the square there; four rays a pixel.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from calib.bundle import Pose
from calib.chessboard import Board, Grey, View
from models import so3
from models.camera import CameraModel, StereoRig

_DARK, _BRIGHT, _WALL = 30.0, 220.0, 120.0
_FINE = 2  # rays a pixel each way


class Painter:
    """Renders a board for one camera; the camera's rays are worked out once."""

    def __init__(self, camera: CameraModel, board: Board) -> None:
        self.camera, self.board = camera, board
        fine = (np.arange(_FINE) + 0.5) / _FINE - 0.5
        u = (np.arange(camera.width)[:, None] + fine).ravel()
        v = (np.arange(camera.height)[:, None] + fine).ravel()
        grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        self._rays = np.column_stack((camera.undistort(grid), np.ones(len(grid))))

    def paint(self, pose: Pose, rng: np.random.Generator, noise: float = 2.0, blur_px: float = 0.6) -> Grey:
        """The picture of a board at x_c = R @ x_o + t; noise: grey levels, blur_px: sigma of the lens' blur."""
        # x_o = R^T (s ray - t) with z_o = 0
        rays_o, eye_o = self._rays @ pose.R, -pose.R.T @ pose.t
        with np.errstate(divide="ignore", invalid="ignore"):
            s = -eye_o[2] / rays_o[:, 2]
            square = (eye_o[:2] + s[:, None] * rays_o[:, :2]) / self.board.square_m
        i, j = np.floor(square + 1.0).T
        inside = (s > 0) & (i >= 0) & (j >= 0) & (i <= self.board.columns) & (j <= self.board.rows)
        paper = (s > 0) & (i >= -1) & (j >= -1) & (i <= self.board.columns + 1) & (j <= self.board.rows + 1)
        dark = np.add(i, j) % 2 == 0  # the square inside corners 0 and columns + 1 is dark, as chessboard.find reads it
        level = np.where(inside & dark, _DARK, np.where(paper, _BRIGHT, _WALL))
        shape = (self.camera.height, _FINE, self.camera.width, _FINE)
        picture = level.reshape(shape).mean(axis=(1, 3))
        if blur_px > 0:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur_px))
        noisy = np.rint(picture + rng.normal(0.0, noise, picture.shape))
        return np.asarray(np.clip(noisy, 0, 255), dtype=np.uint8)


def poses(cameras: Sequence[tuple[CameraModel, Pose]], board: Board, count: int, rng: np.random.Generator) -> list[Pose]:
    """Poses of a board as a person holds it: through the whole picture, tilted to 40 degrees, wholly seen by all cameras."""
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
    """The view without a picture: exact corners plus white noise."""
    px = camera.project(pose.of(board.points))
    return View(name, camera.width, camera.height, np.arange(len(px)), px + rng.normal(0.0, sigma_px, px.shape), 2.0)


def both(rig: StereoRig) -> list[tuple[CameraModel, Pose]]:
    """The cameras of a rig and where each sees the left camera's points."""
    return [(rig.left, Pose(np.eye(3), np.zeros(3))), (rig.right, Pose(rig.R_rc, rig.t_rc))]
