"""A board filmed by a camera on a moving IMU, truth known."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from calib.board.chessboard import Board, View
from calib.cameras.bundle import Pose, rotation_vector
from calib.inertial.camera_imu import Recording, Times
from models import so3
from models.camera import CameraModel
from models.frames import GRAVITY
from models.imu import ImuNoise
from models.messages import Array
from tests.boards import views as synthetic

EUROC_NOISE: Final = ImuNoise(gyro_noise=1.6968e-4, accel_noise=2e-3, gyro_walk=1.9393e-5, accel_walk=3e-3, gyro_scale=0.0)
_START_NS: Final = 1_700_000_000_000_000_000
_EPSILON = 1e-4  # s, for derivatives of the path


@dataclass(frozen=True)
class Truth:
    """distance_m: to the board."""

    R_bc: Array
    p_bc: Array
    time_offset_s: float
    seconds: float = 60.0
    imu_hz: float = 200.0
    camera_hz: float = 20.0
    corner_sigma_px: float = 0.15
    distance_m: float = 0.55
    turn_rad: float = 0.35
    move_m: float = 0.12


class Motion:
    """The body's path: three sines a direction, board in view."""

    def __init__(self, truth: Truth, board: Board, rng: np.random.Generator) -> None:
        self._truth = truth
        self._amplitude = rng.uniform(0.5, 1.0, (6, 3)) / np.array([1.0, 1.6, 2.5])
        self._rate = 2.0 * np.pi * rng.uniform(0.7, 1.3, (6, 3)) * np.array([0.25, 0.6, 1.1])
        self._phase = rng.uniform(0.0, 2.0 * np.pi, (6, 3))
        size = np.array([truth.move_m] * 2 + [1.2 * truth.move_m] + [truth.turn_rad] * 2 + [1.5 * truth.turn_rad])
        self._amplitude *= (size / self._amplitude.sum(axis=1))[:, None]
        tilt = so3.quat_exp(np.append(rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0)))
        # The board stands upright, more or less: its x to the right, y down, seen from the camera.
        self.R_no = so3.matrix(tilt) @ np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        self._middle = board.points.mean(axis=0)

    def camera(self, t: float) -> Pose:
        """The camera in the board's frame: x_o = R @ x_c + t."""
        s = (self._amplitude * np.sin(self._rate * t + self._phase)).sum(axis=1)
        R_oc = so3.matrix(so3.quat_exp(s[3:].copy()))
        # Turned about a point between camera and board, so that turning alone does not lose the board.
        return Pose(R_oc, self._middle + s[:3] - R_oc @ np.array([0.0, 0.0, self._truth.distance_m]))

    def body(self, t: float) -> tuple[Array, Array]:
        """p_n, R_nb."""
        R_oc, p_o = self.camera(t)
        R_nb = self.R_no @ R_oc @ self._truth.R_bc.T
        return self.R_no @ p_o - R_nb @ self._truth.p_bc, R_nb

    def imu(self, t: float) -> tuple[Array, Array]:
        """Exact rate and specific force in b."""
        (p0, R0), (p1, R1), (p2, R2) = (self.body(t + d) for d in (-_EPSILON, 0.0, _EPSILON))
        turn = rotation_vector(R0.T @ R2)
        a_n = (p2 - 2.0 * p1 + p0) / _EPSILON**2
        return turn / (2.0 * _EPSILON), R1.T @ (a_n - np.array([0.0, 0.0, GRAVITY]))


def record(
    truth: Truth, camera: CameraModel, board: Board, noise: ImuNoise, rng: np.random.Generator
) -> tuple[Recording, Times, list[View], Motion]:
    """IMU samples, stamps (shutter minus offset), views of all corners."""
    motion = Motion(truth, board, rng)
    t = np.arange(0.0, truth.seconds, 1.0 / truth.imu_hz)
    exact = np.array([np.concatenate(motion.imu(x)) for x in t])
    white = np.repeat([noise.gyro_noise, noise.accel_noise], 3) * np.sqrt(truth.imu_hz)
    walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3) / np.sqrt(truth.imu_hz)
    first = np.concatenate((rng.normal(0.0, 0.02, 3), rng.normal(0.0, 0.1, 3)))
    bias = first + np.cumsum(rng.normal(0.0, 1.0, (len(t), 6)) * walk, axis=0)
    u = exact + bias + rng.normal(0.0, 1.0, (len(t), 6)) * white
    imu = Recording(_START_NS + np.rint(1e9 * t).astype(np.int64), u[:, :3].copy(), u[:, 3:].copy())
    stamps, views = [], []
    for k, shutter in enumerate(np.arange(1.0, truth.seconds - 1.0, 1.0 / truth.camera_hz)):
        R_oc, p_o = motion.camera(float(shutter))
        pose = Pose(R_oc.T, -R_oc.T @ p_o)
        px = camera.project(pose.of(board.points))
        if camera.contains(px, 4.0).all():
            views.append(synthetic.seen(camera, pose, board, rng, truth.corner_sigma_px, str(k)))
            stamps.append(_START_NS + round(1e9 * (float(shutter) - truth.time_offset_s)))
    return imu, np.array(stamps, dtype=np.int64), views, motion
