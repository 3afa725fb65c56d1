"""Our rig and camera files: YAML, units in names, whole covariances.

x_r = R_rc @ x_c + t_rc  (right_from_left),   x_b = R_bc @ x_c + p_bc  (body_from_left)
"""

from typing import Any, Final, TypeVar

import msgspec
import numpy as np

from calib.errors import CalibrationError
from calib.files.plain_yaml import number, rows, sequence
from models.camera import CameraModel, StereoRig
from models.messages import Array

RIG_FORMAT: Final = "landfix-rig"
CAMERA_FORMAT: Final = "landfix-camera"
VERSION: Final = 1

FORWARD: Final[Array] = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # forward, right, down
UNKNOWN_POSE: Final[Array] = np.diag([9e4] * 3 + [10.0] * 3)  # m^2, rad^2: "not given"

_INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")

Matrix = list[list[float]]


class _Camera(msgspec.Struct, forbid_unknown_fields=True):
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: list[float] = []
    covariance: Matrix | None = None

    def model(self) -> CameraModel:
        return CameraModel(
            self.width, self.height, self.fx, self.fy, self.cx, self.cy, tuple(self.distortion), _matrix(self.covariance)
        )


class _Pose(msgspec.Struct, forbid_unknown_fields=True):
    rotation: Matrix
    translation_m: list[float]
    covariance: Matrix | None = None


class _RigFile(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    version: int
    left: _Camera
    right: _Camera
    right_from_left: _Pose
    body_from_left: _Pose | None = None
    time_offset_s: float = 0.0


class _CameraFile(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    version: int
    camera: _Camera
    body_from_camera: _Pose | None = None


_File = TypeVar("_File", _RigFile, _CameraFile)


def read_rig(value: dict[str, Any], where: str) -> StereoRig:
    """The rig of a parsed file. Raises CalibrationError, ValueError."""
    _check_version(value, where)
    file = _convert(value, _RigFile, where)
    rc, bc = file.right_from_left, file.body_from_left
    R_bc, p_bc = FORWARD, np.zeros(3)
    covariance_bc: Array | None = UNKNOWN_POSE
    if bc is not None:
        R_bc, p_bc = np.array(bc.rotation), np.array(bc.translation_m)
        covariance_bc = _covariance(bc.covariance, where, "body_from_left")
    return StereoRig(
        file.left.model(), file.right.model(), np.array(rc.rotation), np.array(rc.translation_m), R_bc, p_bc,
        _covariance(rc.covariance, where, "right_from_left"), covariance_bc, file.time_offset_s,
    )  # fmt: skip


def read_camera(value: dict[str, Any], where: str) -> CameraModel:
    """The camera of a parsed file. Raises CalibrationError, ValueError."""
    _check_version(value, where)
    return _convert(value, _CameraFile, where).camera.model()


def read_mount(value: dict[str, Any], where: str) -> StereoRig | None:
    """The camera of a parsed file on its body, or None."""
    _check_version(value, where)
    file = _convert(value, _CameraFile, where)
    bc = file.body_from_camera
    if bc is None:
        return None
    covariance_bc = _covariance(bc.covariance, where, "body_from_camera")
    return StereoRig.of_one(file.camera.model(), np.array(bc.rotation), np.array(bc.translation_m), covariance_bc)


def rig_text(rig: StereoRig) -> str:
    """The rig as a file, without an unknown body pose."""
    text = (
        "# A stereo rig. Pixels, metres, radians; c = left, r = right camera (right, down, forward), b = body (FRD at the IMU).\n"
        f"format: {RIG_FORMAT}\nversion: {VERSION}\n"
        f"left:\n{_camera(rig.left)}right:\n{_camera(rig.right)}"
        f"right_from_left:  # x_r = rotation @ x_c + translation_m\n{_pose(rig.R_rc, rig.t_rc, rig.covariance_rc)}"
    )
    if rig.covariance_bc is None or rig.covariance_bc[0, 0] < UNKNOWN_POSE[0, 0]:
        text += f"body_from_left:  # x_b = rotation @ x_c + translation_m\n{_pose(rig.R_bc, rig.p_bc, rig.covariance_bc)}"
    return text + f"time_offset_s: {number(rig.time_offset_s)}  # shutter time minus stamp\n"


def camera_text(camera: CameraModel) -> str:
    """The camera as a file."""
    return f"# A camera. Pixels, radians.\nformat: {CAMERA_FORMAT}\nversion: {VERSION}\ncamera:\n{_camera(camera)}"


def mounted_text(rig: StereoRig) -> str:
    """A rig's one camera with its mount, as a file."""
    where = f"body_from_camera:  # x_b = rotation @ x_c + translation_m\n{_pose(rig.R_bc, rig.p_bc, rig.covariance_bc)}"
    return f"{camera_text(rig.left)}# Metres, radians; c = camera (right, down, forward), b = body (FRD at the IMU).\n{where}"


def _camera(camera: CameraModel) -> str:
    values = (camera.fx, camera.fy, camera.cx, camera.cy)
    sigma = None if camera.covariance is None else np.sqrt(np.diagonal(camera.covariance))
    text = f"  width: {camera.width}\n  height: {camera.height}\n"
    for k, (name, x) in enumerate(zip(_INTRINSICS, values, strict=False)):
        text += f"  {name}: {number(x)}" + (f"  # +- {sigma[k]:.2g}" if sigma is not None else "") + "\n"
    text += f"  distortion: {sequence(camera.distortion)}"
    if camera.distortion:
        text += f"  # {' '.join(_INTRINSICS[4 : 4 + len(camera.distortion)])}"
        text += f" +- {' '.join(f'{s:.2g}' for s in sigma[4:])}" if sigma is not None else ""
    if camera.covariance is not None:
        text += f"\n  covariance:  # of fx fy cx cy and distortion{rows(camera.covariance, '    ')}"
    return text + "\n"


def _pose(R: Array, t: Array, covariance: Array | None) -> str:
    text = f"  rotation:{rows(R, '    ')}\n  translation_m: {sequence(t)}"
    if covariance is None:
        return text + "\n"
    sigma = np.sqrt(np.diagonal(covariance))
    mm, deg = (" ".join(f"{s:.2g}" for s in part) for part in (1e3 * sigma[:3], np.rad2deg(sigma[3:])))
    text += f"  # +- {mm} mm, {deg} deg"
    return text + f"\n  covariance:  # of x y z rx ry rz about the parent's axes, m^2 and rad^2{rows(covariance, '    ')}\n"


def _check_version(value: dict[str, Any], where: str) -> None:
    if value.get("version") != VERSION:
        raise CalibrationError(f"{where}: version {value.get('version')!r} of the rig file; this landfix reads version {VERSION}")


def _convert(value: dict[str, Any], kind: type[_File], where: str) -> _File:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise CalibrationError(f"{where}: {error}") from None


def _matrix(given: Matrix | None) -> Array | None:
    return None if given is None else np.array(given, dtype=np.float64)


def _covariance(given: Matrix | None, where: str, name: str) -> Array | None:
    covariance = _matrix(given)
    if covariance is not None and covariance.shape == (6, 6):
        scale = np.sqrt(np.clip(np.diagonal(covariance), 1e-30, None))
        correlation = covariance / np.outer(scale, scale)
        if not (np.allclose(correlation, correlation.T, atol=1e-6) and np.linalg.eigvalsh(correlation).min() > -1e-6):
            raise CalibrationError(f"{where}: the covariance of {name} is not symmetric and positive")
    return covariance
