"""An approximate camera from a photo's tags, with sigmas.

    f [px]   the maker's calibration (DewarpData, or CalibratedFocalLength)             0.3 %, 1 %
             focal length times the sensor's pixels in a mm                                  1.5 %
             w / W times the 35 mm equivalent, W of 36 mm or of a diagonal of 43.3 mm          3 %

35 mm equivalent: width at 3:2, diagonal at 4:3 (CIPA DCG-001), else the mean.
"""

from typing import Final, NamedTuple

import numpy as np

from calib.errors import CalibrationError
from estimator.commands.photo.tags import Tags
from models.camera import CameraModel

_DEWARP, _CALIBRATED, _SENSOR, _FILM = 0.003, 0.01, 0.015, 0.03  # of the focal length, relative
_MIDDLE: Final = 0.01  # of the principal point, over the width
_LENS: Final = (0.03, 0.03, 1e-3, 1e-3)  # of k1 k2 p1 p2
_DEWARP_LENS: Final = (0.005, 0.005, 5e-4, 5e-4, 0.005)
_WIDTH_MM, _DIAGONAL_MM = 36.0, 43.27
_SAME: Final = 0.01  # of aspect ratios
_ZOOMED: Final = 1.01


class FromTags(NamedTuple):
    """The camera, the tag used, relative sigma of its focal length."""

    camera: CameraModel
    source: str
    sigma: float


def camera_of(tags: Tags, width: int, where: str) -> FromTags:
    """The camera of a photo of `width` pixels. Raises CalibrationError."""
    taken_w, taken_h = tags.taken_px
    if (
        abs(tags.width * taken_h / (tags.height * taken_w) - 1.0) > _SAME
        and abs(tags.width * taken_w / (tags.height * taken_h) - 1.0) > _SAME
    ):
        raise CalibrationError(
            f"{where}: cropped from {taken_w} x {taken_h} to {tags.width} x {tags.height} px, so that its tags are of another "
            "camera: give the photo as it was taken"
        )
    height = round(width * tags.height / tags.width)
    if tags.zoom > _ZOOMED:
        raise CalibrationError(
            f"{where}: taken with a digital zoom of {tags.zoom:g}: calibrate it (landfix calibrate mono), --rig"
        )
    scale = width / max(tags.taken_px) if tags.width >= tags.height else width / min(tags.taken_px)
    if tags.dewarp is not None:
        return _dewarped(tags, width, height, scale)
    f, source, sigma = _focal(tags, scale, width, height, where)
    spread = np.array([sigma * f, sigma * f, _MIDDLE * width, _MIDDLE * width, *_LENS])
    middle = 0.5 * (width - 1), 0.5 * (height - 1)
    return FromTags(CameraModel(width, height, f, f, *middle, (0.0,) * len(_LENS), np.diag(spread**2)), source, sigma)


def _dewarped(tags: Tags, width: int, height: int, scale: float) -> FromTags:
    assert tags.dewarp is not None
    fx, fy, cx, cy, *lens = tags.dewarp
    numbers = (scale * fx, scale * fy, 0.5 * (width - 1) + scale * cx, 0.5 * (height - 1) + scale * cy)
    spread = np.array([*(_DEWARP * n for n in numbers), *_DEWARP_LENS])
    distortion = (0.0,) * len(lens) if tags.dewarped else tuple(lens)
    return FromTags(CameraModel(width, height, *numbers, distortion, np.diag(spread**2)), "DewarpData", _DEWARP)


def _focal(tags: Tags, scale: float, width: int, height: int, where: str) -> tuple[float, str, float]:
    if tags.focal_px is not None:
        return scale * tags.focal_px, "CalibratedFocalLength", _CALIBRATED
    if tags.focal_mm is not None and tags.px_per_mm is not None:
        return scale * tags.focal_mm * tags.px_per_mm, "FocalPlaneXResolution", _SENSOR
    if tags.focal_35_mm is not None:
        longer, shorter = max(width, height), min(width, height)
        of_width, of_diagonal = longer / _WIDTH_MM, 1.25 * longer / _DIAGONAL_MM  # 1.25: diagonal over width of 4:3
        aspect = longer / shorter
        px_per_mm = of_width if abs(aspect - 1.5) < _SAME else of_diagonal if aspect < 1.4 else 0.5 * (of_width + of_diagonal)
        return tags.focal_35_mm * px_per_mm, "FocalLengthIn35mmFilm", _FILM
    raise CalibrationError(
        f"{where}: its tags do not tell the focal length: calibrate the camera (landfix calibrate mono), --rig"
    )
