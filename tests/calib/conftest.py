from pathlib import Path

import cv2
import numpy as np
import pytest

from calib.board.chessboard import Board, View
from calib.board.corners import Grey
from calib.cameras.bundle import IDENTITY, Pose
from calib.files.rig_yaml import FORWARD
from models import so3
from models.camera import CameraModel, StereoRig
from tests.boards import views

cv2.setNumThreads(1)

BOARD = Board(9, 6, 0.025)
CAMERA = CameraModel(640, 480, 533.0, 534.0, 342.0, 234.0, (-0.28, 0.06, 0.001, -0.0002, 0.05))
SMALL = CameraModel(320, 240, 270.0, 271.0, 158.0, 121.0, (-0.2, 0.05, 0.0, 0.0))


def true_rig() -> StereoRig:
    right = CameraModel(640, 480, 537.0, 536.5, 327.0, 249.0, (-0.29, 0.1, -0.0009, 0.0003, -0.01))
    R_rc = so3.matrix(so3.quat_exp(np.deg2rad([0.4, 0.25, -0.2])))
    return StereoRig(CAMERA, right, R_rc, np.array([-0.083, 0.001, -0.0002]), FORWARD, np.zeros(3))


def seen_by(place: Pose, pose: Pose) -> Pose:
    """The board's pose in a camera at `place`."""
    return Pose(place.R @ pose.R, place.of(pose.t[None])[0])


def simulated_views(count: int = 12, seed: int = 0, sigma_px: float = 0.2) -> list[View]:
    rng = np.random.default_rng(seed)
    poses = views.poses([(CAMERA, IDENTITY)], BOARD, count, rng)
    return [views.seen(CAMERA, pose, BOARD, rng, sigma_px, f"v{k}") for k, pose in enumerate(poses)]


@pytest.fixture(scope="session")
def images() -> list[Grey]:
    """Ten small images of a board, tilted each way."""
    rng = np.random.default_rng(5)
    painter = views.Painter(SMALL, BOARD)
    return [painter.paint(pose, rng) for pose in views.poses([(SMALL, IDENTITY)], BOARD, 10, rng)]


@pytest.fixture(scope="session")
def chessboards(landfix_data: Path) -> Path:
    return landfix_data / "images" / "opencv_chessboard_stereo"
