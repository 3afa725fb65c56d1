"""Stereo rigs as calibrated and as true, drawn within their covariance."""

import math

import msgspec
import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array

_NADIR_bc = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # right is y_b, down in the image is backwards


def make_rig(
    width: int = 640,
    height: int = 480,
    focal_px: float = 600.0,
    baseline_m: float = 0.3,
    pitch_deg: float = -90.0,
    distortion: tuple[float, ...] = (-0.08, 0.03, 0.0004, -0.0003),
    exact: bool = False,
) -> StereoRig:
    """A rig calibrated to 0.4 px in f and c, 0.2 mm, 0.02 deg between cameras, 5 mm, 0.1 deg on the body."""
    camera_sigma = np.array([0.4, 0.4, 0.4, 0.4, *[1e-3, 2e-3, 1e-4, 1e-4, 2e-3][: len(distortion)]])
    covariance = None if exact else np.diag(camera_sigma**2)
    left = CameraModel(width, height, focal_px, focal_px, (width - 1) / 2 + 2.3, (height - 1) / 2 - 1.7, distortion, covariance)
    right = CameraModel(
        width, height, 1.002 * focal_px, 1.002 * focal_px, (width - 1) / 2 - 1.9, (height - 1) / 2 + 2.8, distortion, covariance
    )
    R_rc = so3.matrix(so3.quat_exp(np.radians([0.25, -0.3, 0.2])))
    c, s = math.cos(math.radians(90.0 + pitch_deg)), math.sin(math.radians(90.0 + pitch_deg))
    raised = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])  # about y_b
    return StereoRig(
        left,
        right,
        R_rc,
        R_rc @ np.array([-baseline_m, 0.0, 0.0]),
        raised @ _NADIR_bc,
        np.array([0.1, -0.5 * baseline_m, 0.05]),
        None if exact else _covariance(2e-4, 0.02),
        None if exact else _covariance(5e-3, 0.1),
    )


def draw_rig(calibrated: StereoRig, rng: np.random.Generator) -> StereoRig:
    """A true rig that whose calibration is the given one: errors drawn from its covariances."""
    R_rc, t_rc = _draw_pose(calibrated.R_rc, calibrated.t_rc, calibrated.covariance_rc, rng)
    R_bc, p_bc = _draw_pose(calibrated.R_bc, calibrated.p_bc, calibrated.covariance_bc, rng)
    return msgspec.structs.replace(
        calibrated,
        left=_draw_camera(calibrated.left, rng),
        right=_draw_camera(calibrated.right, rng),
        R_rc=R_rc,
        t_rc=t_rc,
        R_bc=R_bc,
        p_bc=p_bc,
    )


def _draw_pose(R: Array, t: Array, covariance: Array | None, rng: np.random.Generator) -> tuple[Array, Array]:
    if covariance is None:
        return R, t
    error = rng.multivariate_normal(np.zeros(6), covariance)
    return so3.matrix(so3.quat_exp(error[3:])) @ R, t + error[:3]


def _draw_camera(camera: CameraModel, rng: np.random.Generator) -> CameraModel:
    if camera.covariance is None:
        return camera
    numbers = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])
    drawn = rng.multivariate_normal(numbers, camera.covariance).tolist()
    fx, fy, cx, cy = drawn[:4]
    return CameraModel(camera.width, camera.height, fx, fy, cx, cy, tuple(drawn[4:]), camera.covariance)


def _covariance(sigma_m: float, sigma_deg: float) -> Array:
    return np.diag(np.repeat(np.square([sigma_m, math.radians(sigma_deg)]), 3))
