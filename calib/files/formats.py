"""Rig and camera files: ours, OpenCV XML/YAML, ROS camera_info, Kalibr camchain, by content.

load_rig(path), load_cameras(path, mount) -> StereoRig; both raise CalibrationError.
"""

from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from calib.errors import CalibrationError
from calib.files import kalibr, opencv, rig_yaml, ros
from calib.files.plain_yaml import parse
from models.camera import CameraModel, StereoRig
from models.messages import Array
from models.untrusted.file import content

__all__ = [
    "BodyPose",
    "CalibrationError",
    "Format",
    "load_cameras",
    "load_rig",
    "save_camera",
    "save_mounted",
    "save_rig",
]

_LONGEST_BASELINE_M = 20.0  # of a rig on a vehicle; a larger number is in millimetres
_SHORTEST_BASELINE_M = 1e-3
_MOST_BYTES = 100_000  # YAML is parsed at 50 kB a second


class BodyPose(NamedTuple):
    """Camera on the body, x_b = R_bc @ x_c + p_bc, and its covariance (6, 6)."""

    R_bc: Array
    p_bc: Array
    covariance_bc: Array


class Format(StrEnum):
    """How a rig or a camera is written."""

    LANDFIX = "landfix"
    OPENCV = "opencv"
    ROS = "ros"
    KALIBR = "kalibr"


def load_rig(path: str | Path) -> StereoRig:
    """A stereo rig of any format. Raises CalibrationError.

    Without a body pose: forward, covariance rig_yaml.UNKNOWN_POSE.
    """
    rig = load_cameras(path)
    if rig.one_camera:
        raise CalibrationError(f"{path}: this is one camera, two are needed here: landfix calibrate stereo makes a rig of them")
    return rig


def load_cameras(path: str | Path, mount: BodyPose | None = None) -> StereoRig:
    """A rig, or one camera on the body; mount replaces body_from_camera. Raises CalibrationError."""
    path = Path(path)
    text = _read(path)
    try:
        rig = _on_body(path, text, mount)
    except ValueError as error:  # the camera's and the rig's own checks
        raise error if isinstance(error, CalibrationError) else CalibrationError(f"{path}: {error}") from None
    if not _SHORTEST_BASELINE_M < rig.baseline_m < _LONGEST_BASELINE_M:
        raise CalibrationError(f"{path}: the cameras are {rig.baseline_m:g} m apart; are the translations in metres?")
    return rig


def save_rig(path: str | Path, rig: StereoRig, form: Format | None = None) -> list[Path]:
    """Write a rig, form by name (.xml, .yml: OpenCV). Returns the files."""
    path = Path(path)
    try:
        texts = _rig_texts(path, rig, form or _form_of(path))
    except ValueError as error:  # cameras that cannot be rectified, a lens the form has no name for
        raise CalibrationError(f"{path}: {error}") from None
    for name, text in texts.items():
        _write(name, text)
    return list(texts)


def save_camera(path: str | Path, camera: CameraModel, form: Format | None = None) -> list[Path]:
    """Write one camera; the form as in save_rig."""
    path = Path(path)
    form = form or _form_of(path)
    if form is Format.ROS:
        text = ros.camera_text(camera, path.stem)
    elif form is Format.KALIBR:
        text = kalibr.camera_text(camera)
    elif form is Format.OPENCV:
        text = opencv.camera_text(camera, path.suffix == ".xml")
    else:
        text = rig_yaml.camera_text(camera)
    _write(path, text)
    return [path]


def save_mounted(path: str | Path, rig: StereoRig) -> list[Path]:
    """Write a rig's one camera with its body pose, in our form."""
    path = Path(path)
    if _form_of(path) is not Format.LANDFIX:
        raise CalibrationError(f"{path}: a camera with --mount is written as .yaml only")
    _write(path, rig_yaml.mounted_text(rig))
    return [path]


def _on_body(path: Path, text: str, mount: BodyPose | None) -> StereoRig:
    camera, rig = _one_camera(path, text)
    if camera is None:
        rig = _rig(path, text)
    if rig is not None:
        return rig if mount is None else msgspec.structs.replace(rig, **mount._asdict())
    if mount is None:
        raise CalibrationError(
            f"{path}: this is one camera, and where it sits on the body is missing: --mount X,Y,Z,ROLL,PITCH,YAW of landfix "
            "locate or calibrate mono; landfix calibrate stereo makes a rig of two"
        )
    assert camera is not None
    return StereoRig.of_one(camera, *mount)


def _one_camera(path: Path, text: str) -> tuple[CameraModel | None, StereoRig | None]:
    where = str(path)
    if _is_opencv(text):
        return opencv.read_camera(text, where), None
    value: dict[str, Any] = parse(text, where)
    if value.get("format") == rig_yaml.CAMERA_FORMAT:
        return rig_yaml.read_camera(value, where), rig_yaml.read_mount(value, where)
    if "cam0" in value and "cam1" not in value:
        return kalibr.camera(value, "cam0", where), None
    if "camera_matrix" in value and path not in ros.pair_of(path):
        return ros.camera(value, where), None
    return None, None


def _rig(path: Path, text: str) -> StereoRig:
    if _is_opencv(text):
        return opencv.read_rig(text, str(path))
    value: dict[str, Any] = parse(text, str(path))
    if value.get("format") == rig_yaml.RIG_FORMAT:
        return rig_yaml.read_rig(value, str(path))
    if "cam0" in value:
        return kalibr.rig(value, str(path))
    if "camera_matrix" in value:
        left, right = ros.pair_of(path)
        return ros.rig(parse(_read(left), str(left)), parse(_read(right), str(right)), f"{left}, {right.name}")
    raise CalibrationError(f"{path}: neither a rig of ours, OpenCV, ROS camera_info nor Kalibr camchain")


def _form_of(path: Path) -> Format:
    return Format.OPENCV if path.suffix in {".xml", ".yml"} else Format.LANDFIX


def _rig_texts(path: Path, rig: StereoRig, form: Format) -> dict[Path, str]:
    if form is Format.ROS:
        return dict(zip(ros.pair_of(path), ros.rig_texts(rig), strict=True))
    if form is Format.KALIBR:
        return {path: kalibr.rig_text(rig)}
    if form is Format.OPENCV:
        return {path: opencv.rig_text(rig, path.suffix == ".xml")}
    return {path: rig_yaml.rig_text(rig)}


def _is_opencv(text: str) -> bool:
    return text.lstrip().startswith(("<?xml", "<opencv_storage", "%YAML:1.0")) or "!!opencv-matrix" in text


def _read(path: Path) -> str:
    try:
        return content(path, _MOST_BYTES).decode("utf-8")
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such file") from None
    except (UnicodeDecodeError, IsADirectoryError):
        raise CalibrationError(f"{path}: no text file (needed: a rig or camera file in YAML or XML)") from None
    except OSError as error:
        raise CalibrationError(f"{path}: {error.strerror}") from None


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written: {error.strerror}") from None
