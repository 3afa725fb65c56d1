"""Recorded stereo pairs with what is known of their disparity: read for tests and benchmarks, where the data are present."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from models.camera import CameraModel, StereoRig
from models.messages import Array
from vision.image.rectify import Image


@dataclass(frozen=True)
class RealPair:
    """truth: disparity of the left image's pixels, NaN where unknown; its own error in px (how far it is rounded)."""

    name: str
    left: Image
    right: Image
    rig: StereoRig
    truth: Array
    nearest_m: float


def _rig(image: Image, f: float, cx: float, cy: float, baseline_m: float, shift_px: float = 0.0) -> StereoRig:
    height, width = image.shape[:2]
    left, right = CameraModel(width, height, f, f, cx, cy), CameraModel(width, height, f, f, cx + shift_px, cy)
    return StereoRig(left, right, np.eye(3), np.array([-baseline_m, 0.0, 0.0]), np.eye(3), np.zeros(3))


def _read(path: Path, flag: int = cv2.IMREAD_COLOR) -> Image:
    image = cv2.imread(str(path), flag)
    assert image is not None, path
    return image


def motorcycle(data: Path) -> RealPair:
    """Middlebury 2014: a garage at 2 to 5 m; dense truth, calibrated."""
    folder = data / "images/middlebury_stereo"
    left, right = _read(folder / "motorcycle_left.png"), _read(folder / "motorcycle_right.png")
    with np.load(folder / "motorcycle_disp.npz") as archive:
        truth = archive[archive.files[0]].astype(np.float64)
    truth[~np.isfinite(truth)] = np.nan
    return RealPair("Middlebury motorcycle", left, right, _rig(left, 994.978, 311.193, 254.877, 0.193001, 31.086), truth, 1.5)


def aloe(data: Path) -> RealPair:
    """Middlebury 2006: a plant before cloth; dense truth in whole pixels, no metric calibration (numbers made up)."""
    folder = data / "images/middlebury_stereo"
    left, right = _read(folder / "aloeL.jpg"), _read(folder / "aloeR.jpg")
    truth = _read(folder / "aloeGT.png", cv2.IMREAD_GRAYSCALE).astype(np.float64)
    truth[truth == 0] = np.nan
    return RealPair("Middlebury aloe", left, right, _rig(left, 3740.0, 641.0, 555.0, 0.16), truth, 2.2)


def kitti(data: Path, frame: int) -> RealPair:
    """KITTI odometry 06: a road, grey. No true disparity comes with it: semi-global matching, checked from both sides."""
    folder = data / "images/kitti06_0000_0050_stereo"
    left, right = (_read(folder / side / f"{frame:06d}.jpg", cv2.IMREAD_GRAYSCALE) for side in ("left", "right"))
    truth = _semi_global(left, right)
    return RealPair(f"KITTI 06 {frame}", left, right, _rig(left, 707.0912, 601.8873, 183.1104, 379.8145 / 707.0912), truth, 4.0)


def _semi_global(left: Image, right: Image) -> Array:
    """Dense disparity by an independent method; NaN where left-to-right and right-to-left differ by more than a pixel."""
    matcher = cv2.StereoSGBM.create(0, 128, 5, 200, 800, mode=cv2.STEREO_SGBM_MODE_HH, uniquenessRatio=5)
    forth = matcher.compute(left, right) / 16.0
    back = matcher.compute(np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1]))[:, ::-1] / 16.0
    v, u = np.indices(forth.shape)
    other = back[v, np.clip(np.rint(u - forth).astype(int), 0, forth.shape[1] - 1)]
    return np.asarray(np.where((forth > 0) & (np.abs(forth - other) <= 1.0), forth, np.nan), dtype=np.float64)


def at(truth: Array, px: Array) -> Array:
    """Truth (N,) at the pixels nearest to (N, 2)."""
    u, v = np.rint(px).astype(int).T
    return np.asarray(truth[np.clip(v, 0, truth.shape[0] - 1), np.clip(u, 0, truth.shape[1] - 1)])
