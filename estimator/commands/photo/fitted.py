"""A photo for a calibrated camera, in sensor pixels.

EXIF orientation: 1 as stored; 6, 3, 8 turned by 1, 2, 3 quarters clockwise; others mirrored.
"""

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


def quarter_turns(path: Path) -> int:
    """Clockwise quarters by which a viewer turns the photo. Raises CalibrationError."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path) as photo:
            flag = photo.getexif().get(_ORIENTATION, 1)
    except Exception:  # what Pillow cannot read has no flag; whether it is an image, OpenCV says
        return 0
    if flag in range(9) and flag not in (0, *_QUARTERS):
        raise CalibrationError(f"{path}: EXIF orientation {flag} is mirrored: save it as the camera saw it")
    return _QUARTERS.get(flag, 0)


def fitted(path: Path, image: "Image", camera: "CameraModel", turns: int) -> "tuple[Image, bool]":
    """The photo at the camera's size, and whether turned upright. Raises CalibrationError."""
    import numpy as np

    from vision.image.scaled import fits, scaled

    def has_aspect(seen: "Image") -> bool:
        return fits(seen.shape[1], seen.shape[0], camera)

    turned = turns % 2 == 1 and not has_aspect(image) and has_aspect(np.rot90(image))
    if turned:
        image = np.ascontiguousarray(np.rot90(image, -turns))
    height, width = image.shape[:2]
    if not has_aspect(image):
        raise CalibrationError(
            f"{path}: {width} x {height} is of another aspect ratio than the camera, {camera.width} x {camera.height}: "
            "calibrate the camera in the mode in which the photo was taken"
        )
    return scaled(image, camera), turned


def turns_left(path: Path, camera: "CameraModel", turns: int) -> int:
    """Quarters by which a viewer turns the photo beyond what `fitted` does."""
    from PIL import Image

    from vision.image.scaled import fits

    if turns % 2 == 0:
        return turns
    with warnings.catch_warnings(action="ignore"), Image.open(path) as photo:
        width, height = photo.size
    return 0 if not fits(width, height, camera) and fits(height, width, camera) else turns


def at_width(camera: "CameraModel", width: int) -> "CameraModel":
    """The camera at another width."""
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
    """R_bc of the sensor: x_shown = R_z(90 deg turns) x_sensor."""
    import numpy as np

    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned: Array = R_bc @ np.linalg.matrix_power(quarter, turns)
    return turned
