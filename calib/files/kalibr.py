"""Kalibr camchain: cam0 left, cam1 right.

cam1.T_cn_cnm1 = T_rc,  cam0.T_cam_imu = T_cb (x_c = T_cb x_b; OpenVINS: T_imu_cam = T_bc),  t_imu = t_cam + timeshift_cam_imu
"""

from typing import Any

import numpy as np

from calib.errors import CalibrationError
from calib.files.plain_yaml import number, rows, sequence
from calib.files.rig_yaml import FORWARD, UNKNOWN_POSE
from models.camera import CameraModel, StereoRig
from models.messages import Array


def camera(value: dict[str, Any], name: str, where: str) -> CameraModel:
    """Camera `name` of a parsed camchain. Raises CalibrationError."""
    chain = value.get(name)
    if not isinstance(chain, dict):
        raise CalibrationError(f"{where}: {name} is missing: a rig has cam0 (left) and cam1 (right)")
    kind, lens = chain.get("camera_model"), chain.get("distortion_model", "none")
    if kind != "pinhole" or lens not in {"radtan", "none", "equidistant"}:
        raise CalibrationError(f"{where}: {name} is {kind}-{lens}; supported are pinhole-radtan and pinhole-equidistant")
    try:
        width, height = (int(x) for x in chain["resolution"])
        fx, fy, cx, cy = (float(x) for x in chain["intrinsics"])
        distortion = tuple(float(x) for x in chain.get("distortion_coeffs", ()))
    except (KeyError, TypeError, ValueError):
        raise CalibrationError(f"{where}: {name}: resolution, intrinsics or distortion_coeffs missing or no numbers") from None
    if lens == "equidistant":
        try:
            from calib.files.fisheye import rational  # noqa: PLC0415  (scipy.optimize: half a second that others do not need)

            return rational(fx, fy, cx, cy, np.array(distortion), (width, height))
        except CalibrationError as error:
            raise CalibrationError(f"{where}: {name}: {error}") from None
    return CameraModel(width, height, fx, fy, cx, cy, distortion)


def rig(value: dict[str, Any], where: str) -> StereoRig:
    """The rig of a parsed camchain. Raises CalibrationError."""
    left, right = camera(value, "cam0", where), camera(value, "cam1", where)
    on_body = [_on_body(value[name], where) for name in ("cam0", "cam1")]
    if "T_cn_cnm1" in value["cam1"] or on_body[0] is None or on_body[1] is None:
        T_rc = _pose(value["cam1"], "T_cn_cnm1", where)
    else:
        T_rc = np.linalg.inv(on_body[1]) @ on_body[0]
    R_bc, p_bc = FORWARD, np.zeros(3)
    covariance_bc: Array | None = UNKNOWN_POSE
    if on_body[0] is not None:
        R_bc, p_bc, covariance_bc = on_body[0][:3, :3], on_body[0][:3, 3], None
    offset = float(value["cam0"].get("timeshift_cam_imu", 0.0))
    return StereoRig(left, right, T_rc[:3, :3], T_rc[:3, 3], R_bc, p_bc, None, covariance_bc, offset)


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


def _on_body(chain: dict[str, Any], where: str) -> Array | None:
    if "T_imu_cam" in chain:
        return _pose(chain, "T_imu_cam", where)
    if "T_cam_imu" not in chain:
        return None
    T_cb = _pose(chain, "T_cam_imu", where)
    T_bc = np.eye(4)
    T_bc[:3, :3], T_bc[:3, 3] = T_cb[:3, :3].T, -T_cb[:3, :3].T @ T_cb[:3, 3]
    return T_bc


def _pose(chain: dict[str, Any], name: str, where: str) -> Array:
    try:
        return np.array(chain[name], dtype=np.float64).reshape(4, 4)
    except (KeyError, TypeError, ValueError):
        raise CalibrationError(f"{where}: {name} is missing or not a 4 x 4 matrix") from None
