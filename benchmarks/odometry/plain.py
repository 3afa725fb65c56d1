"""What a user would start with: OpenCV's corners, Lucas-Kanade and PnP with RANSAC on rectified pairs.

goodFeaturesToTrack -> Lucas-Kanade left to right, and first to second -> x_c = f b / d (m, 1) -> solvePnPRansac, refined
"""

from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.messages import Array
from vision.image.rectify import Image, rectification, rectify
from vision.odometry.motion import Geometry
from vision.odometry.step import Prediction, Step, Tracks

_CORNERS, _QUALITY, _APART_PX = 300, 0.01, 10.0
_ROW_PX, _LEAST_DISPARITY_PX = 1.0, 1.0
_REPROJECTION_PX, _ROUNDS, _LEAST = 1.0, 200, 10
_WINDOW: Final = (21, 21)


class Pair(NamedTuple):
    """Rectified, grey."""

    left: Image
    right: Image


class PlainOdometry:
    """StereoOdometry's methods without its prediction and covariance."""

    def __init__(self, rig: StereoRig) -> None:
        self._rectification = rectification(rig)
        self._geometry = Geometry(self._rectification.rig)

    def frame(self, left: Image, right: Image) -> Pair:
        """The rectified pair."""
        return Pair(rectify(left, self._rectification.left), rectify(right, self._rectification.right))

    def step(self, first: Pair, second: Pair, prediction: Prediction) -> Step:
        """The motion from the first pair to the second."""
        corners = cv2.goodFeaturesToTrack(first.left, _CORNERS, _QUALITY, _APART_PX)
        if corners is None:
            return Step("no corners")
        px = np.asarray(corners, np.float32).reshape(-1, 2)
        right, there = _flow(first.left, first.right, px), _flow(first.left, second.left, px)
        kept = np.isfinite(there[:, 0]) & (np.abs(right[:, 1] - px[:, 1]) <= _ROW_PX)
        nowhere = np.full(int(kept.sum()), np.nan)
        tracks = Tracks(np.column_stack((px, right[:, 0]))[kept].astype(np.float64), np.column_stack((there[kept], nowhere)))
        return self.motion_of(tracks, prediction)

    def motion_of(self, tracks: Tracks, _prediction: Prediction) -> Step:
        """The motion of tracks, of which u_r of the second pair is not used."""
        geometry = self._geometry
        y0, there = tracks.y0, tracks.y1[:, :2]
        near = geometry.disparity(y0) >= _LEAST_DISPARITY_PX
        if near.sum() < _LEAST:
            return Step("too few points")
        x, _ = geometry.points(y0[near])
        K = np.array([[geometry.f, 0.0, geometry.cx], [0.0, geometry.f, geometry.cy], [0.0, 0.0, 1.0]])
        found, turn, shift, inliers = cv2.solvePnPRansac(
            x, there[near], K, None, iterationsCount=_ROUNDS, reprojectionError=_REPROJECTION_PX
        )
        if not found or len(inliers) < _LEAST:
            return Step("no pose")
        turn, shift = cv2.solvePnPRefineLM(x[inliers[:, 0]], there[near][inliers[:, 0]], K, None, turn, shift)
        R_c10 = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
        R_bc, p_bc = geometry.R_bc, geometry.p_bc
        R = R_bc @ R_c10.T @ R_bc.T
        p = p_bc - R @ p_bc - R_bc @ R_c10.T @ shift.ravel()
        return Step("", p, so3.from_matrix(np.ascontiguousarray(R)), points=len(there))


def _flow(a: Image, b: Image, px: NDArray[np.float32]) -> Array:
    """(N, 2) in b of px (N, 2) in a; NaN: not found."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(a, b, px, None, winSize=_WINDOW)  # type: ignore[call-overload]
    flow: Array = np.where(found.astype(bool), there, np.nan).astype(np.float64)
    return flow
