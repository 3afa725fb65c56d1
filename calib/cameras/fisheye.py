"""First estimate of a fisheye."""

import cv2
import numpy as np

from calib.cameras.bundle import Pose
from calib.errors import CalibrationError
from calib.files.fisheye import rational
from models.camera import CameraModel
from models.messages import Array


def first_camera(x_o: list[Array], px: list[Array], size: tuple[int, int]) -> tuple[CameraModel, list[Pose]]:
    """OpenCV's equidistant calibration as a rational camera, and board poses. Raises CalibrationError."""
    objects, images = [x.reshape(1, -1, 3) for x in x_o], [p.reshape(1, -1, 2) for p in px]
    # Two coefficients to begin with: four bend back beyond the outermost corner.
    flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K4
    try:
        _, K, k, rvecs, tvecs = cv2.fisheye.calibrate(objects, images, size, np.eye(3), np.zeros(4), flags=flags)
    except cv2.error:
        raise CalibrationError("the views do not determine a fisheye camera: more views, the board near the border too") from None
    camera = rational(
        float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), np.asarray(k, dtype=np.float64).ravel(), size
    )
    return camera, [Pose.of_vectors(r, t) for r, t in zip(rvecs, tvecs, strict=True)]
