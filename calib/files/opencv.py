"""OpenCV FileStorage, XML or YAML, OpenCV's names plus our covariances.

Camera: camera_matrix, distortion_coefficients, [covariance]. Rig: M1, D1, M2, D2, R, T (x_r = R @ x_c + T, metres),
[covariance_M1, covariance_M2, covariance_RT, R_body, T_body, covariance_body, time_offset_s]; both: image_width, image_height.
"""

import re
from xml.parsers import expat

import cv2
import numpy as np

from calib.errors import CalibrationError
from calib.files.rig_yaml import FORWARD, UNKNOWN_POSE, VERSION
from models.camera import CameraModel, StereoRig
from models.messages import Array
from vision.image.rectify import rectification

_DEEPEST = 100  # levels of nesting; OpenCV's parser calls itself for each, and some ten thousand end the process
_JSON = re.compile(r'"(?:[^"\\\n]|\\.)*"|(?P<open>[\[{])|(?P<close>[\]}])')
_YAML = re.compile(_JSON.pattern + "|#.*")
_OPENING = re.compile(r"[:?!]|-(?!\.?\d)")  # what opens a level of block YAML within a line; signs of numbers do not
_COUNTS = (0, 4, 5, 8)  # distortion coefficients that CameraModel takes


def read_camera(text: str, where: str) -> CameraModel | None:
    """The camera of a FileStorage text; None: it holds a rig, or none. Raises CalibrationError."""
    storage = _open(text, where)
    if storage.getNode("camera_matrix").empty() or not storage.getNode("M1").empty():
        return None
    return _camera(storage, "camera_matrix", "distortion_coefficients", "covariance", where)


def read_rig(text: str, where: str) -> StereoRig:
    """The rig of a FileStorage text. Raises CalibrationError, ValueError."""
    storage = _open(text, where)
    missing = [name for name in ("M1", "D1", "M2", "D2", "R", "T") if storage.getNode(name).empty()]
    if missing:
        raise CalibrationError(f"{where}: {', '.join(missing)} missing: this is no OpenCV stereo rig (needed: M1 D1 M2 D2 R T)")
    R_bc, p_bc = FORWARD, np.zeros(3)
    covariance_bc: Array | None = UNKNOWN_POSE
    if not storage.getNode("R_body").empty():
        R_bc, p_bc = _matrix(storage, "R_body", where), _matrix(storage, "T_body", where).ravel()
        covariance_bc = _optional(storage, "covariance_body", where)
    offset = storage.getNode("time_offset_s")
    return StereoRig(
        _camera(storage, "M1", "D1", "covariance_M1", where), _camera(storage, "M2", "D2", "covariance_M2", where),
        _matrix(storage, "R", where), _matrix(storage, "T", where).ravel(), R_bc, p_bc,
        _optional(storage, "covariance_RT", where), covariance_bc, 0.0 if offset.empty() else offset.real(),
    )  # fmt: skip


def camera_text(camera: CameraModel, xml: bool) -> str:
    """One camera as a FileStorage text."""
    storage = _new(camera, xml)
    _put_camera(storage, camera, "camera_matrix", "distortion_coefficients", "covariance")
    return storage.releaseAndGetString()


def rig_text(rig: StereoRig, xml: bool) -> str:
    """A rig as FileStorage text, with R1 R2 P1 P2 Q F E."""
    storage = _new(rig.left, xml)
    _put_camera(storage, rig.left, "M1", "D1", "covariance_M1")
    _put_camera(storage, rig.right, "M2", "D2", "covariance_M2")
    storage.write("R", rig.R_rc)
    storage.write("T", rig.t_rc.reshape(3, 1))
    if rig.covariance_rc is not None:
        storage.write("covariance_RT", rig.covariance_rc)
    if rig.covariance_bc is None or rig.covariance_bc[0, 0] < UNKNOWN_POSE[0, 0]:
        storage.write("R_body", rig.R_bc)
        storage.write("T_body", rig.p_bc.reshape(3, 1))
        if rig.covariance_bc is not None:
            storage.write("covariance_body", rig.covariance_bc)
    storage.write("time_offset_s", rig.time_offset_s)
    for name, matrix in _derived(rig).items():
        storage.write(name, matrix)
    return storage.releaseAndGetString()


def distortion_of(camera: CameraModel) -> Array:
    """Coefficients as OpenCV takes them, at least four."""
    return np.array(camera.distortion or (0.0,) * 4)


def rectified(rig: StereoRig) -> tuple[Array, Array, Array, Array]:
    """R1, R2 (3, 3), P1, P2 (3, 4): x' = R1 x_c, u = P1 (x', 1) = P2 (x', 1)."""
    flat = rectification(rig).rig
    R1 = flat.R_bc.T @ rig.R_bc
    P1 = np.column_stack((flat.left.matrix, np.zeros(3)))
    P2 = np.column_stack((flat.right.matrix, flat.right.matrix @ flat.t_rc))
    return R1, R1 @ rig.R_rc.T, P1, P2


def _derived(rig: StereoRig) -> dict[str, Array]:
    R1, R2, P1, P2 = rectified(rig)
    f, cx, cy = P1[0, 0], P1[0, 2], P1[1, 2]
    Q = np.array([[1.0, 0.0, 0.0, -cx], [0.0, 1.0, 0.0, -cy], [0.0, 0.0, 0.0, f], [0.0, 0.0, 1.0 / rig.baseline_m, 0.0]])
    t = rig.t_rc
    E = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]]) @ rig.R_rc
    F = np.linalg.inv(rig.right.matrix).T @ E @ np.linalg.inv(rig.left.matrix)
    return {"R1": R1, "R2": R2, "P1": P1, "P2": P2, "Q": Q, "E": E, "F": F / F[2, 2]}


def _new(camera: CameraModel, xml: bool) -> cv2.FileStorage:
    storage = cv2.FileStorage(".xml" if xml else ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("version", VERSION)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    return storage


def _put_camera(storage: cv2.FileStorage, camera: CameraModel, matrix: str, distortion: str, covariance: str) -> None:
    storage.write(matrix, camera.matrix)
    storage.write(distortion, distortion_of(camera).reshape(-1, 1))
    if camera.covariance is not None:
        storage.write(covariance, camera.covariance)


def _deepest(text: str) -> int:
    """Upper bound of the nesting. Raises ExpatError."""
    depth = deepest = 0

    def begin(*_: object) -> None:
        nonlocal depth, deepest
        depth += 1
        deepest = max(deepest, depth)

    def end(*_: object) -> None:
        nonlocal depth
        depth -= 1

    if text.lstrip().startswith("<"):
        parser = expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = begin, end
        parser.Parse(text.strip().encode(), True)
        return deepest
    is_json = text.lstrip().startswith("{")
    for found in (_JSON if is_json else _YAML).finditer(text):
        if found["open"]:
            begin()
        elif found["close"]:
            end()
    if is_json:
        return deepest
    lines = text.splitlines()
    return deepest + max((len(line) - len(line.lstrip()) + len(_OPENING.findall(line)) for line in lines), default=0)


def _open(text: str, where: str) -> cv2.FileStorage:
    try:
        if _deepest(text) > _DEEPEST:
            raise CalibrationError(f"{where}: is nested more than {_DEEPEST} levels deep: no rig or camera file")
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError, expat.ExpatError):
        raise CalibrationError(f"{where}: no valid OpenCV file (torn, or not XML/YAML)") from None
    version = storage.getNode("version")
    if not version.empty() and version.real() > VERSION:
        raise CalibrationError(f"{where}: version {version.real():g} of the file; this landfix reads version {VERSION}")
    return storage


def _matrix(storage: cv2.FileStorage, name: str, where: str) -> Array:
    try:
        value = storage.getNode(name).mat()
    except cv2.error:
        value = None
    if value is None:
        raise CalibrationError(f"{where}: {name} is missing or no matrix")
    return np.asarray(value, dtype=np.float64)


def _optional(storage: cv2.FileStorage, name: str, where: str) -> Array | None:
    return None if storage.getNode(name).empty() else _matrix(storage, name, where)


def _camera(storage: cv2.FileStorage, matrix: str, distortion: str, covariance: str, where: str) -> CameraModel:
    width, height = storage.getNode("image_width"), storage.getNode("image_height")
    if width.empty() or height.empty():
        raise CalibrationError(f"{where}: image_width and image_height are missing; add them, a camera is known for one size")
    K = _matrix(storage, matrix, where)
    if K.shape != (3, 3) or not np.allclose((K[0, 1], K[1, 0], *K[2]), (0.0, 0.0, 0.0, 0.0, 1.0), atol=1e-9):
        raise CalibrationError(f"{where}: {matrix} is not of the form fx 0 cx, 0 fy cy, 0 0 1")
    k = _matrix(storage, distortion, where).ravel()
    used = int(np.flatnonzero(k).max(initial=-1)) + 1
    if used > _COUNTS[-1]:
        raise CalibrationError(f"{where}: {used} distortion coefficients; at most {_COUNTS[-1]} are supported")
    kept = min(len(k), _COUNTS[-1])
    kept = kept if kept in _COUNTS else min(n for n in _COUNTS if n >= kept)
    k = np.concatenate((k, np.zeros(_COUNTS[-1])))[:kept]
    return CameraModel(
        int(width.real()), int(height.real()), K[0, 0], K[1, 1], K[0, 2], K[1, 2],
        tuple(float(x) for x in k), _optional(storage, covariance, where),
    )  # fmt: skip
