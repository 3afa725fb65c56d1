"""A photo for a calibrated camera: EXIF orientation, and the size at which the camera was calibrated.

A camera is calibrated in the sensor's pixels, whatever the orientation flag says. A photo is turned upright only where it fits
the camera's size no other way. EXIF orientation: 1 as stored; 6, 3, 8 turned by 1, 2, 3 quarters clockwise; others mirrored.
"""
# ruff: noqa: PLC0415  (imported where needed, so that --help is fast)

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Final

from calib.errors import CalibrationError

if TYPE_CHECKING:
    from models.camera import CameraModel
    from models.messages import Array
    from vision.image.rectify import Image

_ORIENTATION: Final = 0x0112
_QUARTERS: Final = {1: 0, 6: 1, 3: 2, 8: 3}
_SAME_ASPECT: Final = 3e-3  # one row of a picture of 480, for which sizes are rounded


def quarter_turns(path: Path) -> int:
    """Quarters clockwise by which a viewer turns the photo. Raises CalibrationError for a mirrored one."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as photo:
            flag = photo.getexif().get(_ORIENTATION, 1)
    except Exception:  # what Pillow cannot read has no flag; whether it is a picture, OpenCV says
        return 0
    if flag in range(9) and flag not in (0, *_QUARTERS):
        raise CalibrationError(f"{path}: EXIF orientation {flag} is mirrored: save it as the camera saw it")
    return _QUARTERS.get(flag, 0)


def fitted(path: Path, image: "Image", camera: "CameraModel", turns: int) -> "tuple[Image, bool]":
    """The photo at the camera's size, and whether it was turned upright for that. Raises CalibrationError for another aspect."""
    import cv2
    import numpy as np

    turned = turns % 2 == 1 and not _fits(image, camera) and _fits(np.rot90(image), camera)
    if turned:
        image = np.ascontiguousarray(np.rot90(image, -turns))
    height, width = image.shape[:2]
    if (width, height) == (camera.width, camera.height):
        return image, turned
    if not _fits(image, camera):
        raise CalibrationError(
            f"{path}: {width} x {height} is of another aspect ratio than the camera, {camera.width} x {camera.height}: "
            "calibrate the camera in the mode in which the photo was taken"
        )
    way = cv2.INTER_AREA if width > camera.width else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (camera.width, camera.height), interpolation=way), dtype=image.dtype), turned


def turns_left(path: Path, camera: "CameraModel", turns: int) -> int:
    """Quarters by which a viewer turns the photo beyond what `fitted` does."""
    from PIL import Image

    if turns % 2 == 0:
        return turns
    with warnings.catch_warnings(action="ignore"), Image.open(path) as photo:
        width, height = photo.size
    return 0 if not _aspect_fits(width, height, camera) and _aspect_fits(height, width, camera) else turns


def at_width(camera: "CameraModel", width: int) -> "CameraModel":
    """The camera of the same photos at another width: u + 1/2 is scaled, since pixel centres are at integers."""
    import msgspec
    import numpy as np

    s = width / camera.width
    scales = np.array([s] * 4 + [1.0] * len(camera.distortion))
    covariance = None if camera.covariance is None else camera.covariance * np.outer(scales, scales)
    return msgspec.structs.replace(
        camera, width=width, height=round(s * camera.height), fx=s * camera.fx, fy=s * camera.fy,
        cx=s * (camera.cx + 0.5) - 0.5, cy=s * (camera.cy + 0.5) - 0.5, covariance=covariance,
    )  # fmt: skip


def turned_mount(R_bc: "Array", turns: int) -> "Array":
    """R_bc of the sensor from that of the photo as it is shown: x_shown = R_z(90 deg turns) x_sensor."""
    import numpy as np

    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned: Array = R_bc @ np.linalg.matrix_power(quarter, turns)
    return turned


def _fits(image: "Image", camera: "CameraModel") -> bool:
    return _aspect_fits(image.shape[1], image.shape[0], camera)


def _aspect_fits(width: int, height: int, camera: "CameraModel") -> bool:
    return bool(abs(width * camera.height / (height * camera.width) - 1.0) < _SAME_ASPECT)
