"""ROS camera_info YAML; a rig is NAME_left.yaml and NAME_right.yaml.

In the pair's rectification:  x_rect = R1 x_c = R2 x_r - (Tx, 0, 0),  Tx = P2[0, 3] / P2[0, 0], so
R_rc = R2^T R1,  t_rc = R2^T (Tx, 0, 0).
"""

from pathlib import Path
from typing import Any

import numpy as np

from calib.errors import CalibrationError
from calib.files.opencv import distortion_of, rectified
from calib.files.plain_yaml import sequence
from calib.files.rig_yaml import FORWARD, UNKNOWN_POSE
from models.camera import CameraModel, StereoRig
from models.messages import Array

_MODELS = {"plumb_bob": (4, 5), "rational_polynomial": (8,)}


def pair_of(path: Path) -> tuple[Path, Path]:
    """Both files of a rig from either, or from the name without side."""
    stem = path.stem.removesuffix("_left").removesuffix("_right")
    if path.stem in {"left", "right"}:
        return path.with_stem("left"), path.with_stem("right")
    return path.with_stem(f"{stem}_left"), path.with_stem(f"{stem}_right")


def camera(value: dict[str, Any], where: str) -> CameraModel:
    """The camera of a parsed camera_info. Raises CalibrationError."""
    model = value.get("distortion_model", "plumb_bob")
    k = _matrix(value, "distortion_coefficients", where).ravel()
    if model not in _MODELS or len(k) not in (*_MODELS[model], 0):
        raise CalibrationError(f"{where}: {model} with {len(k)} coefficients is not supported ({', '.join(_MODELS)})")
    K = _matrix(value, "camera_matrix", where)
    size = value.get("image_width"), value.get("image_height")
    if K.shape != (3, 3) or not all(isinstance(x, int) for x in size):
        raise CalibrationError(f"{where}: camera_matrix must be 3 x 3, image_width and image_height whole numbers")
    return CameraModel(size[0], size[1], K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(float(x) for x in k))  # type: ignore[arg-type]


def rig(left: dict[str, Any], right: dict[str, Any], where: str) -> StereoRig:
    """The rig of two parsed camera_info. Raises CalibrationError."""
    R1, R2 = _matrix(left, "rectification_matrix", where), _matrix(right, "rectification_matrix", where)
    P2 = _matrix(right, "projection_matrix", where)
    if P2.shape != (3, 4) or P2[0, 0] <= 0 or P2[0, 3] == 0.0:
        raise CalibrationError(f"{where}: the right projection_matrix holds no baseline: these are no stereo pair")
    t = R2.T @ np.array([P2[0, 3] / P2[0, 0], 0.0, 0.0])
    return StereoRig(camera(left, where), camera(right, where), R2.T @ R1, t, FORWARD, np.zeros(3), None, UNKNOWN_POSE)


def camera_text(model: CameraModel, name: str, R: Array | None = None, P: Array | None = None) -> str:
    """A camera_info; R, P: rectification, else identity and K."""
    n = len(model.distortion)
    distortion = distortion_of(model)
    P = np.column_stack((model.matrix, np.zeros(3))) if P is None else P
    return (
        f"image_width: {model.width}\nimage_height: {model.height}\ncamera_name: {name}\n"
        + _text("camera_matrix", model.matrix)
        + f"distortion_model: {'rational_polynomial' if n == 8 else 'plumb_bob'}\n"
        + _text("distortion_coefficients", (distortion if n in {5, 8} else np.append(distortion, 0.0)).reshape(1, -1))
        + _text("rectification_matrix", np.eye(3) if R is None else R)
        + _text("projection_matrix", P)
    )


def rig_texts(stereo: StereoRig) -> tuple[str, str]:
    """The two camera_info of a rig."""
    R1, R2, P1, P2 = rectified(stereo)
    return camera_text(stereo.left, "left", R1, P1), camera_text(stereo.right, "right", R2, P2)


def _text(name: str, matrix: Array) -> str:
    return f"{name}:\n  rows: {matrix.shape[0]}\n  cols: {matrix.shape[1]}\n  data: {sequence(matrix.ravel())}\n"


def _matrix(value: dict[str, Any], name: str, where: str) -> Array:
    try:
        given = value[name]
        return np.array(given["data"], dtype=np.float64).reshape(given["rows"], given["cols"])
    except (KeyError, TypeError, ValueError):
        raise CalibrationError(f"{where}: {name} (rows, cols, data) is missing or not a matrix of that size") from None
