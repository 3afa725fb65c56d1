"""Rectification: corresponding points share a row; maps made once.

    x_c' = R_cc' ^T x_c,   x_r' = x_c' - (b, 0, 0)     (both cameras look the same way, side by side: R_rc = I)

so that u_l - u_r = f b / Z + cx_l - cx_r and v_l = v_r (thesis sections 3.9 and 5.1.2-5.1.4, eq. 3.128).
"""

from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from models.camera import CameraModel, StereoRig
from models.messages import Array

Image: TypeAlias = NDArray[Any]  # (H, W) grey or (H, W, 3) BGR, uint8 or uint16
Mask: TypeAlias = NDArray[np.uint8]  # 0 or 255

_ALREADY = 1e-7  # rad, or a part of the focal length: below it nothing would move by 1e-3 px


@dataclass(frozen=True, slots=True)
class Maps:
    """Source pixels of a rectified image (fixed point, 1/32 px), and which exist."""

    pixels: NDArray[np.int16]
    fractions: NDArray[np.uint16]
    valid: Mask


@dataclass(frozen=True, slots=True)
class Rectification:
    """The rectified rig (R_rc = I, no distortion) and the maps, None for rectified input."""

    rig: StereoRig
    left: Maps | None
    right: Maps | None


def rectification(rig: StereoRig) -> Rectification:
    """Raises ValueError unless the cameras stand side by side, left first."""
    if _is_rectified(rig):
        return Rectification(rig, None, None)
    R_from_c = _rows(rig)
    R_from_r = R_from_c @ rig.R_rc.T
    camera = _common_camera(rig, R_from_c, R_from_r)
    size = (rig.left.width, rig.left.height)
    rectified = StereoRig(
        left=msgspec.structs.replace(camera, covariance=_pinhole_part(rig.left)),
        right=msgspec.structs.replace(camera, covariance=_pinhole_part(rig.right)),
        R_rc=np.eye(3),
        t_rc=np.array([-rig.baseline_m, 0.0, 0.0]),
        R_bc=rig.R_bc @ R_from_c.T,
        p_bc=rig.p_bc,
        covariance_rc=_turned(rig.covariance_rc, R_from_r),
        covariance_bc=rig.covariance_bc,
        time_offset_s=rig.time_offset_s,
    )
    return Rectification(
        rectified, _maps(rig.left, R_from_c, camera.matrix, size), _maps(rig.right, R_from_r, camera.matrix, size)
    )


def rectify(image: Image, maps: Maps | None) -> Image:
    """The rectified image, black beyond the raw one."""
    if maps is None:
        return image
    return cv2.remap(image, maps.pixels, maps.fractions, cv2.INTER_LINEAR)


def _is_rectified(rig: StereoRig) -> bool:
    left, right, f = rig.left, rig.right, rig.left.fx
    lenses = any(left.distortion) or any(right.distortion)
    cameras = abs(np.array([left.fy - f, right.fx - f, right.fy - f, right.cy - left.cy])).max() <= _ALREADY * f
    sizes = (left.width, left.height) == (right.width, right.height)
    parallel = np.allclose(rig.R_rc, np.eye(3), atol=_ALREADY)
    beside = np.allclose(rig.t_rc, (-rig.baseline_m, 0.0, 0.0), atol=_ALREADY * rig.baseline_m) and rig.baseline_m > 0
    return bool(not lenses and cameras and sizes and parallel and beside)


def _rows(rig: StereoRig) -> Array:
    """x_c' = R @ x_c: x along the baseline, z between the axes (Fusiello, Trucco, Verri 2000)."""
    if not rig.baseline_m > 0.0:
        raise ValueError("stereo rig: the two cameras are at the same position")
    x = -rig.R_rc.T @ rig.t_rc / rig.baseline_m
    if x[0] < np.cos(np.radians(45.0)):
        raise ValueError("stereo rig: the right camera must be to the right of the left one (t_rc x < 0)")
    z = np.array([0.0, 0.0, 1.0]) + rig.R_rc[2]
    z -= x * (x @ z)
    z /= np.linalg.norm(z)
    return np.stack((x, np.cross(z, x), z))


def _common_camera(rig: StereoRig, R_from_c: Array, R_from_r: Array) -> CameraModel:
    f = float(np.mean([rig.left.fx, rig.left.fy, rig.right.fx, rig.right.fy]))
    width, height = rig.left.width, rig.left.height
    middles = []
    for camera, R in ((rig.left, R_from_c), (rig.right, R_from_r)):
        middle = np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
        x = R @ np.append(camera.undistort(middle)[0], 1.0)
        middles.append(f * x[:2] / x[2])
    u, v = np.mean(middles, axis=0)
    return CameraModel(width, height, f, f, float((width - 1) / 2 - u), float((height - 1) / 2 - v))


def _maps(camera: CameraModel, R: Array, K: Array, size: tuple[int, int]) -> Maps:
    distortion = np.array(camera.distortion or (0.0,) * 4)
    u, v = cv2.initUndistortRectifyMap(camera.matrix, distortion, R, K, size, cv2.CV_32FC1)
    seen = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    pixels, fractions = cv2.convertMaps(u, v, cv2.CV_16SC2)
    return Maps(
        np.asarray(pixels, dtype=np.int16), np.asarray(fractions, dtype=np.uint16), np.where(seen, 255, 0).astype(np.uint8)
    )


def _turned(covariance: Array | None, R: Array) -> Array | None:
    if covariance is None:
        return None
    both = np.kron(np.eye(2), R)
    return both @ covariance @ both.T


def _pinhole_part(camera: CameraModel) -> Array | None:
    return None if camera.covariance is None else camera.covariance[:4, :4]
