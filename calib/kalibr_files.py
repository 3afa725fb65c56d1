"""Kalibr camchain: cam0 is the left, cam1 the right camera.

cam1.T_cn_cnm1 = T_rc,   cam0.T_cam_imu = T_cb (x_c = T_cb x_b),   t_imu = t_cam + timeshift_cam_imu
"""

from typing import Any

import numpy as np

from calib.errors import CalibrationError
from calib.plain_yaml import number, rows, sequence
from calib.rig_yaml import FORWARD, UNKNOWN_POSE
from models.camera import CameraModel, StereoRig
from models.messages import Array


def camera(value: dict[str, Any], name: str, where: str) -> CameraModel:
    """Camera `name` of a parsed camchain. Raises CalibrationError."""
    chain = value.get(name)
    if not isinstance(chain, dict):
        raise CalibrationError(f"{where}: {name} is missing: a rig has cam0 (left) and cam1 (right)")
    kind, lens = chain.get("camera_model"), chain.get("distortion_model", "none")
    if kind != "pinhole" or lens not in {"radtan", "none"}:
        raise CalibrationError(f"{where}: {name} is {kind}-{lens}; supported is pinhole-radtan")
    try:
        width, height = (int(x) for x in chain["resolution"])
        fx, fy, cx, cy = (float(x) for x in chain["intrinsics"])
        distortion = tuple(float(x) for x in chain.get("distortion_coeffs", ()))
    except (KeyError, TypeError, ValueError):
        raise CalibrationError(f"{where}: {name}: resolution, intrinsics or distortion_coeffs missing or no numbers") from None
    return CameraModel(width, height, fx, fy, cx, cy, distortion)


def rig(value: dict[str, Any], where: str) -> StereoRig:
    """The rig of a parsed camchain. Raises CalibrationError."""
    left, right = camera(value, "cam0", where), camera(value, "cam1", where)
    R_rc, t_rc = _pose(value["cam1"], "T_cn_cnm1", where)
    R_bc, p_bc = FORWARD, np.zeros(3)
    covariance_bc: Array | None = UNKNOWN_POSE
    if "T_cam_imu" in value["cam0"]:
        R_cb, t_cb = _pose(value["cam0"], "T_cam_imu", where)
        R_bc, p_bc, covariance_bc = R_cb.T, -R_cb.T @ t_cb, None
    offset = float(value["cam0"].get("timeshift_cam_imu", 0.0))
    return StereoRig(left, right, R_rc, t_rc, R_bc, p_bc, None, covariance_bc, offset)


def camera_text(model: CameraModel, name: str = "cam0") -> str:
    """One camera. Raises CalibrationError for a lens Kalibr has no name for."""
    if any(model.distortion[4:]):
        raise CalibrationError("Kalibr's radtan has four distortion coefficients; calibrate with --lens 2 or 4 for it")
    k = (model.distortion or (0.0,) * 4)[:4]
    return (
        f"{name}:\n  camera_model: pinhole\n  intrinsics: {sequence((model.fx, model.fy, model.cx, model.cy))}\n"
        f"  distortion_model: radtan\n  distortion_coeffs: {sequence(k)}\n  resolution: [{model.width}, {model.height}]\n"
    )


def rig_text(stereo: StereoRig) -> str:
    """The rig as a camchain; covariances have no place in it."""
    text = camera_text(stereo.left)
    if stereo.covariance_bc is None or stereo.covariance_bc[0, 0] < UNKNOWN_POSE[0, 0]:
        R_rb, t_rb = stereo.R_rc @ stereo.R_bc.T, stereo.t_rc - stereo.R_rc @ stereo.R_bc.T @ stereo.p_bc
        shift = f"  timeshift_cam_imu: {number(stereo.time_offset_s)}\n"
        text += _text("T_cam_imu", stereo.R_bc.T, -stereo.R_bc.T @ stereo.p_bc) + shift
        right = _text("T_cam_imu", R_rb, t_rb) + shift
    else:
        right = ""
    return text + camera_text(stereo.right, "cam1") + _text("T_cn_cnm1", stereo.R_rc, stereo.t_rc) + right


def _text(name: str, R: Array, t: Array) -> str:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return f"  {name}:{rows(T, '    ')}\n"


def _pose(chain: dict[str, Any], name: str, where: str) -> tuple[Array, Array]:
    try:
        T = np.array(chain[name], dtype=np.float64).reshape(4, 4)
    except (KeyError, TypeError, ValueError):
        raise CalibrationError(f"{where}: {name} is missing or not a 4 x 4 matrix") from None
    return T[:3, :3], T[:3, 3]
