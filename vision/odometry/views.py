"""One camera: raw and small rectified image, pixels between them.

x ~ R_cc' K^-1 (u, v, 1),   (u, v)_raw = project(x)          (R_cc': rectified camera axes c' in those of the camera c)
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from models.camera import CameraModel, StereoRig
from models.messages import Array
from vision.image.rectify import Image, Maps, Mask, rectification, rectify

_MEAN, _SPREAD, _MOST_GAIN = 128.0, 45.0, 10.0  # grey levels of a normalised image
_BORDER_PX: Final = 12  # corners stay so far from the border of what both the raw and the rectified image show
_GRID_PX: Final = 4  # of the pixels for which that is computed
_WIDE_PX: Final = 1000  # wider images are reduced by 4 instead of 2


@dataclass(frozen=True, slots=True)
class View:
    """raw image; small: rectified, `scale` times smaller; grey, contrast normalised."""

    raw: Image
    small: Image
    scale: int


class Lens:
    """Raw and rectified pixels of one camera.

    maps: of the small image, or None; scale: its reduction.
    """

    def __init__(self, camera: CameraModel, R_from_c: Array, rectified: CameraModel, maps: Maps | None, scale: int) -> None:
        self.camera, self._R, self._rectified, self._maps, self._scale = camera, R_from_c, rectified, maps, scale

    def rectified(self, raw_px: Array) -> Array:
        """Rectified pixels (N, 2) of raw ones (N, 2); NaN stays."""
        rays = np.column_stack((self.camera.undistort(raw_px), np.ones(len(raw_px)))) @ self._R.T
        K = self._rectified
        u: Array = np.column_stack((K.fx * rays[:, 0] / rays[:, 2] + K.cx, K.fy * rays[:, 1] / rays[:, 2] + K.cy))
        return u

    def raw(self, px: Array) -> Array:
        """Raw pixels (N, 2) of rectified ones (N, 2); NaN where the lens shows nothing."""
        K = self._rectified
        rays = np.column_stack(((px[:, 0] - K.cx) / K.fx, (px[:, 1] - K.cy) / K.fy, np.ones(len(px))))
        return self.camera.project(rays @ self._R)

    def inner(self) -> Mask:
        """Raw pixels where corners may be."""
        height, width = self.camera.height, self.camera.width
        v, u = np.mgrid[0:height:_GRID_PX, 0:width:_GRID_PX]
        raw = np.column_stack((u.ravel(), v.ravel())).astype(np.float64)
        inside = self.camera.contains(raw, _BORDER_PX) & self._rectified.contains(self.rectified(raw), _BORDER_PX)
        mask = cv2.resize(inside.reshape(u.shape).astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        return np.asarray(mask, np.uint8)

    def turn(self, R: Array) -> Array:
        """K R' K^-1 (3, 3) of a rotation R, at the middle of the raw image."""
        K = self.camera.matrix
        H: Array = K @ (self._R.T @ R @ self._R) @ np.linalg.inv(K)
        return H

    def view(self, image: Image) -> View:
        """Grey, mean 128, spread 45."""
        raw = grey(image)
        small = rectify(reduced(raw, self._scale), self._maps)
        mean, spread = cv2.meanStdDev(small, mask=None if self._maps is None else self._maps.valid)
        gain = float(np.clip(_SPREAD / max(float(spread[0, 0]), 1e-3), 0.2, _MOST_GAIN))
        table = np.clip(np.rint(_MEAN + gain * (np.arange(256.0) - float(mean[0, 0]))), 0.0, 255.0).astype(np.uint8)
        return View(cv2.LUT(raw, table), cv2.LUT(small, table), self._scale)


def lenses(rig: StereoRig) -> tuple[StereoRig, Lens, Lens]:
    """Full-size rectified rig without covariances, and lenses. Raises ValueError as rectification()."""
    scale = 4 if rig.left.width > _WIDE_PX else 2
    k = 1.0 / scale
    small = rectification(StereoRig(_scaled(rig.left, k), _scaled(rig.right, k), rig.R_rc, rig.t_rc, rig.R_bc, rig.p_bc))
    R_from_c = small.rig.R_bc.T @ rig.R_bc
    left, right = _scaled(small.rig.left, scale), _scaled(small.rig.right, scale)
    full = StereoRig(left, right, small.rig.R_rc, small.rig.t_rc, small.rig.R_bc, small.rig.p_bc)
    of_right = Lens(rig.right, R_from_c @ rig.R_rc.T, right, small.right, scale)
    return full, Lens(rig.left, R_from_c, left, small.left, scale), of_right


def grey(image: Image) -> Image:
    """(H, W) of a grey or BGR image."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def reduced(image: Image, scale: int) -> Image:
    """Means of scale x scale pixels; the remainder is dropped."""
    height, width = image.shape[0] // scale, image.shape[1] // scale
    return cv2.resize(image[: scale * height, : scale * width], (width, height), interpolation=cv2.INTER_AREA)


def scaled_px(px: Array, k: float) -> Array:
    """Pixels of an image k times the size (centres at integers)."""
    scaled: Array = k * (px + 0.5) - 0.5
    return scaled


def _scaled(camera: CameraModel, k: float) -> CameraModel:
    cx, cy = scaled_px(np.array([camera.cx, camera.cy]), k).tolist()
    width, height = int(k * camera.width), int(k * camera.height)
    return CameraModel(width, height, k * camera.fx, k * camera.fy, cx, cy, camera.distortion)
