"""Where an image was taken, without any outline: by an orthophoto with heights, or by known points of a plane."""

from dataclasses import dataclass

import cv2
import numpy as np
import pymap3d
from numpy.typing import NDArray

from models.camera import CameraModel
from models.maps import projection
from models.maps.landmarks import LandmarkMap
from models.messages import Array

Image = NDArray[np.uint8]

_REDUCED = 2  # the photos are 2.4 times as fine as the orthophoto
_RATIO = 0.8
_INLIER_PX = 4.0
_LEAST_INLIERS = 30


@dataclass(frozen=True)
class Ortho:
    """An orthophoto (H, W, 3), 0 where it has no data, and the point in n (H, W, 3) that each pixel shows, NaN where unknown."""

    image: Image
    points_n: Array


@dataclass(frozen=True)
class Reference:
    """p_nc, R_nc of the camera; inliers, their RMS [px], and what their scatter says of the place: sigma_m (3,)."""

    p_nc: Array
    R_nc: Array
    inliers: int
    rms_px: float
    sigma_m: Array


class SiftReference:
    """Key points of the orthophoto, found once."""

    def __init__(self, ortho: Ortho) -> None:
        known = np.isfinite(ortho.points_n[..., 0])
        inside = cv2.erode(known.astype(np.uint8), np.ones((9, 9), np.uint8))
        self._sift = cv2.SIFT.create(8_000, contrastThreshold=0.02)
        self._key, self._descriptor = self._sift.detectAndCompute(ortho.image, inside)
        self._ortho = ortho

    def locate(self, photo: Image, camera: CameraModel) -> Reference | None:
        """The camera's pose, None where fewer than 30 points agree."""
        reduced = cv2.resize(photo, None, fx=1.0 / _REDUCED, fy=1.0 / _REDUCED, interpolation=cv2.INTER_AREA)
        key, descriptor = self._sift.detectAndCompute(reduced, None)
        matcher = cv2.BFMatcher()
        pairs = [m for m in matcher.knnMatch(descriptor, self._descriptor, k=2) if len(m) == 2]
        good = [m for m, n in pairs if m.distance < _RATIO * n.distance]
        if len(good) < _LEAST_INLIERS:
            return None
        px = (np.array([key[m.queryIdx].pt for m in good]) + 0.5) * _REDUCED - 0.5
        x_n = _at(self._ortho.points_n, np.array([self._key[m.trainIdx].pt for m in good]))
        use = np.isfinite(x_n[:, 0])
        straight_px = camera.undistort(px[use]) * np.diag(camera.matrix)[:2] + camera.matrix[:2, 2]
        return _pose(x_n[use], straight_px, camera)


def _at(points_n: Array, px: Array) -> Array:
    u, v = np.rint(px).astype(int).T
    found: Array = points_n[v, u]
    return found


def _pose(x_n: Array, px: Array, camera: CameraModel) -> Reference | None:
    """RANSAC by SQPNP, then Levenberg-Marquardt on the inliers, which are chosen once more by the result."""
    middle = x_n.mean(axis=0)
    x = x_n - middle
    done, rotation, translation, inliers = cv2.solvePnPRansac(
        x, px, camera.matrix, None, iterationsCount=5000, reprojectionError=_INLIER_PX, flags=cv2.SOLVEPNP_SQPNP
    )
    if not done or len(inliers) < _LEAST_INLIERS:
        return None
    chosen = inliers[:, 0]
    for _ in range(3):
        rotation, translation = cv2.solvePnPRefineLM(x[chosen], px[chosen], camera.matrix, None, rotation, translation)
        seen, jacobian = cv2.projectPoints(x, rotation, translation, camera.matrix, None)
        error = px - seen[:, 0]
        chosen = np.flatnonzero(np.linalg.norm(error, axis=1) < _INLIER_PX)
    R_nc, shift = np.asarray(cv2.Rodrigues(rotation)[0].T, dtype=float), np.asarray(translation[:, 0], dtype=float)
    J = jacobian.reshape(len(px), 2, -1)[chosen, :, :6].reshape(-1, 6)
    variance = float(np.sum(error[chosen] ** 2)) / (2 * len(chosen) - 6)
    covariance = _of_place(np.asarray(rotation[:, 0], dtype=float), shift, np.linalg.inv(J.T @ J) * variance)
    rms = float(np.sqrt(np.mean(np.sum(error[chosen] ** 2, axis=1))))
    return Reference(middle - R_nc @ shift, R_nc, len(chosen), rms, np.sqrt(np.diag(covariance)))


def _of_place(rotation: Array, translation: Array, covariance: Array) -> Array:
    """Covariance (3, 3) of p = -R^T t from that of (rotation, t), by differences."""

    def place(step: Array) -> Array:
        moved: Array = -(cv2.Rodrigues(rotation + step[:3])[0].T @ (translation + step[3:]))
        return moved

    h = 1e-6
    J = np.column_stack([(place(h * e) - place(-h * e)) / (2.0 * h) for e in np.eye(6)])
    result: Array = J @ covariance @ J.T
    return result


def plane_pose(x_n: Array, px: Array, camera: CameraModel) -> tuple[Array, Array]:
    """p_nc, R_nc of the camera that shows points of a level plane x_n (N, 3) at px (N, 2). Camera without distortion."""
    level_n = np.column_stack((x_n[:, :2], np.zeros(len(x_n))))
    _, rotation, translation = cv2.solvePnP(level_n, px, camera.matrix, None, flags=cv2.SOLVEPNP_IPPE)
    rotation, translation = cv2.solvePnPRefineLM(level_n, px, camera.matrix, None, rotation, translation)
    R_nc = np.asarray(cv2.Rodrigues(rotation)[0].T, dtype=float)
    return np.array([0.0, 0.0, x_n[:, 2].mean()]) - R_nc @ translation[:, 0], R_nc


def utm_to_ned(landmarks: LandmarkMap, epsg: int, xy: Array, alt_m: Array) -> Array:
    """Points (N, 3) in the map's n of UTM coordinates (N, 2) and altitudes (N,)."""
    lonlat = projection.to_lonlat(epsg, xy)
    if lonlat is None:
        raise ValueError(f"EPSG {epsg} is not known")
    return np.column_stack(pymap3d.geodetic2ned(lonlat[:, 1], lonlat[:, 0], alt_m, *landmarks.origin))
