"""One step of odometry: motion with covariance, or the reason for none.

    pairs -> contrast normalised, rectified at half size (Frame) -> corners, tracks -> Gauss-Newton (motion) -> Step

The prediction is no measurement.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.messages import Array
from vision.image.rectify import Image
from vision.odometry.corners import corners
from vision.odometry.motion import Geometry, Motion, Plane, Solution, solve
from vision.odometry.tracks import coarse_columns, stereo, temporal
from vision.odometry.views import View, lenses
from vision.records.images import usable

_MOST_DISPARITY: Final = 0.2  # of the image's width
_PLANE_FACTOR: Final = 1.6  # points are no nearer and no further than this, in units of the plane's distance
_SIGMA_PX: Final = 0.25  # of a track, in each coordinate
_INLIER: Final = 16.27  # chi-square of 3, 99.9 %
_LEAST_POINTS, _LEAST_INLIERS, _LEAST_SHARE = 20, 15, 0.3
_DOUBTFUL_SCALE, _MOST_SCALE = 1.5, 3.0  # residuals in units of _SIGMA_PX
_SECOND_POINTS, _SECOND_SHARE, _SECOND_AGREE = 10, 0.12, 0.6  # another motion: points, of all, and of those that do not fit
_TURN_CHI2: Final = 50.0  # of 3: further from the predicted rotation, which is the gyro's, no rotation can be
_DOUBTFUL_CHI2: Final = 22.5  # of 6, 99.9 %: so far from the prediction one motion is rarely
_NEAR_CHI2, _FAR_CHI2 = 16.8, 40.0  # of 6: inside the prediction (99 %), and outside
_GUIDE: Final = 4.0  # times the covariance of the prediction, where it chooses points
_NEIGHBOURS: Final = 3
_SHARED, _SHARED_SAID = 0.3, 0.5  # correlation of neighbours' residuals: up to here as usual, and from here said
_INFLATION: Final = 4.0  # of the covariance: errors of neighbouring tracks are alike
_FLOOR: Final = np.array([0.002] * 3 + [np.radians(0.04)] * 3)  # m, rad


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """Limits of a step; disparity_sigma_px: at least; relief_m: ground mean against the given height; roughness_m: points against
    their mean.
    """

    points: int = 140
    relief_m: float = 1.5
    roughness_m: float = 0.7
    slope_deg: float = 3.0
    disparity_sigma_px: float = 0.3


@dataclass(frozen=True, slots=True)
class Prediction:
    """Body pose at t1 in the body at t0: p (3,), q wxyz, covariance (6, 6) of (dp, theta), R = R exp(theta).

    down_b: unit vector at t0, height_m above ground, sigma; None: unknown.
    """

    p: Array
    q: Array
    covariance: Array
    down_b: Array | None = None
    height_m: float = 0.0
    height_sigma_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Frame:
    """A pair as it is tracked in; right: None where there is none."""

    left: View
    right: View | None


@dataclass(frozen=True, slots=True)
class Tracks:
    """y (N, 3) of the same points in both frames, px; NaN in u_r: not measured."""

    y0: Array
    y1: Array


@dataclass(frozen=True, slots=True)
class Step:
    """Body pose at t1 in the body at t0, or reason.

    covariance (6, 6): of (dp, theta), new in each step; systematic (6, 2): disparities, height 1 sigma too large.
    """

    reason: str
    p: Array = field(default_factory=lambda: np.zeros(3))
    q: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    covariance: Array = field(default_factory=lambda: np.full((6, 6), np.nan))
    systematic: Array = field(default_factory=lambda: np.zeros((6, 2)))
    points: int = 0
    residual_scale: float = 0.0
    remark: str = ""
    tracks: Tracks | None = None
    inliers: NDArray[np.bool_] | None = None


class StereoOdometry:
    """A rig's maps, made once; frame() and step() have no memory."""

    def __init__(self, rig: StereoRig, settings: OdometrySettings | None = None) -> None:
        self.settings = settings or OdometrySettings()
        self._raw: StereoRig = rig
        rectified, self._left, self._right = lenses(rig)
        self._geometry = Geometry(rectified)
        self._inner = self._left.inner()
        self._disparity_sigma_px = max(_disparity_sigma_px(rig), self.settings.disparity_sigma_px)

    def frame(self, left: Image | None, right: Image | None) -> Frame | str:
        """A raw pair as step() takes it, or what is wrong with it."""
        images = usable(left, None if self._raw.one_camera else right, self._raw)
        if isinstance(images, str):
            return images
        if images.left is None:
            return images.remark.removesuffix("; ")
        return Frame(self._left.view(images.left), None if images.right is None else self._right.view(images.right))

    def step(self, first: Frame, second: Frame, prediction: Prediction) -> Step:
        """The motion from the first frame to the second."""
        plane = self._plane(prediction)
        raw = corners(first.left.raw, self._inner, self.settings.points)
        if len(raw) < _LEAST_POINTS:
            return Step(f"too few corners: {len(raw)} (blur, darkness or no texture)")
        if plane is None and (first.right is None or self._raw.one_camera):
            return Step("one camera, and the height above the ground is not known")
        return self.motion_of(self._tracks(first, second, raw, prediction, plane), prediction)

    def _plane(self, prediction: Prediction) -> Plane | None:
        if prediction.down_b is None:
            return None
        geometry = self._geometry
        h = prediction.height_m - float(prediction.down_b @ geometry.p_bc)
        if not (h > 0.0 and prediction.height_sigma_m > 0.0):
            return None
        n = geometry.R_bc.T @ prediction.down_b
        sigma = float(np.hypot(prediction.height_sigma_m, self.settings.relief_m))
        return Plane(n, h, sigma, float(np.radians(self.settings.slope_deg)), self.settings.roughness_m)

    def _tracks(self, first: Frame, second: Frame, raw: Array, prediction: Prediction, plane: Plane | None) -> Tracks:
        geometry = self._geometry
        px = self._left.rectified(raw)
        raw, px = raw[np.isfinite(px[:, 0])], px[np.isfinite(px[:, 0])]
        y0 = np.column_stack((px, self._columns(first, raw, px, plane)))
        kept = ~(geometry.disparity(y0) <= 0.0)
        if plane is None:
            kept &= np.isfinite(y0[:, 2])
        y0, raw = y0[kept], raw[kept]
        if not len(y0):
            return Tracks(y0, y0)
        whole = y0.copy()
        missing = ~np.isfinite(y0[:, 2])
        if plane is not None and missing.any():
            whole[missing, 2] = y0[missing, 0] - geometry.shift - geometry.plane_disparity(y0[missing], plane.pi)[0]
        motion = Motion(prediction.p, so3.matrix(prediction.q))
        ahead, _ = geometry.project(geometry.seen_from(motion, geometry.points(whole)[0])[1])
        turn = self._left.turn(geometry.R_bc.T @ motion.R @ geometry.R_bc)
        raw = temporal(first.left.raw, second.left.raw, raw, self._left.raw(ahead[:, :2]), turn)
        there = self._left.rectified(raw)
        kept = np.isfinite(there[:, 0])
        y0, there, ahead, raw = y0[kept], there[kept], ahead[kept], raw[kept]
        column = np.full(len(there), np.nan)
        if second.right is not None:
            guess = there[:, 0] - (ahead[:, 0] - ahead[:, 2])
            column = stereo(second.left, second.right, raw, there[:, 1], guess, self._right)
        y1 = np.column_stack((there, column))
        y1[geometry.disparity(y1) <= 0.0, 2] = np.nan
        return Tracks(y0, y1)

    def _columns(self, first: Frame, raw: Array, px: Array, plane: Plane | None) -> Array:
        if first.right is None:
            return np.full(len(px), np.nan)
        most = np.full(len(px), _MOST_DISPARITY * self._left.camera.width)
        least = np.zeros(len(px))
        if plane is not None:
            d = self._geometry.plane_disparity(px, plane.pi)[0]
            least, most = d / _PLANE_FACTOR, d * _PLANE_FACTOR + 2.0
        zero = px[:, 0] - self._geometry.shift
        coarse = coarse_columns(first.left, first.right, px, zero - most, zero - least)
        return stereo(first.left, first.right, raw, px[:, 1], coarse, self._right)

    def motion_of(self, tracks: Tracks, prediction: Prediction) -> Step:
        """The checked motion of tracks."""
        plane = self._plane(prediction)
        n = len(tracks.y0)
        if n < _LEAST_POINTS:
            return Step(f"too few tracks: {n} points are in both pairs", points=n, tracks=tracks)
        everything = chosen = np.ones(n, np.bool_)
        solution, inliers, lost = self._checked(tracks, everything, prediction, plane)
        far = _distance(solution, prediction)
        if (
            lost or solution.scale > _DOUBTFUL_SCALE or far > _DOUBTFUL_CHI2
        ):  # several motions may have been mixed: begin with the points that fit the prediction
            near = self._solve(tracks, everything, prediction, plane, np.asarray(np.linalg.inv(_GUIDE * prediction.covariance)))
            if near.converged and (fitting := near.distances <= _INLIER).sum() >= _LEAST_INLIERS:
                chosen = fitting
                solution, inliers, lost = self._checked(tracks, chosen, prediction, plane)
            else:
                lost = lost or f"{_large(solution)}, {np.sqrt(far):.0f} sigma from the prediction, which too few points fit"
        if lost:
            return Step(lost, points=n, residual_scale=solution.scale, tracks=tracks, inliers=inliers)
        reason, remark = self._second_motion(tracks, inliers, solution, prediction, plane)
        shared = _shared(tracks.y0[inliers], solution.residuals[inliers[chosen]])
        if shared > _SHARED_SAID:
            remark = remark or f"neighbouring tracks err alike (correlation {shared:.2f}): part of the scene may move"
        alike = 1.0 + int(inliers.sum()) * max(shared - _SHARED, 0.0) / (1.0 - _SHARED)
        floor = np.diag(_FLOOR**2)
        return Step(
            reason,
            solution.motion.p,
            so3.from_matrix(np.ascontiguousarray(solution.motion.R)),
            _INFLATION * alike * solution.scale**2 * solution.covariance + floor,
            solution.systematic,
            n,
            solution.scale,
            remark,
            tracks,
            inliers,
        )

    def _solve(
        self, tracks: Tracks, chosen: NDArray[np.bool_], prediction: Prediction, plane: Plane | None, guide: Array | None = None
    ) -> Solution:
        start = Motion(prediction.p, so3.matrix(prediction.q))
        y0, y1 = tracks.y0[chosen], tracks.y1[chosen]
        return solve(self._geometry, y0, y1, _SIGMA_PX, self._disparity_sigma_px, start, plane, guide=guide)

    def _checked(
        self, tracks: Tracks, chosen: NDArray[np.bool_], prediction: Prediction, plane: Plane | None
    ) -> tuple[Solution, NDArray[np.bool_], str]:
        solution = self._solve(tracks, chosen, prediction, plane)
        inliers = chosen.copy()
        inliers[chosen] = solution.distances <= _INLIER * solution.scale**2
        return solution, inliers, self._flaw(solution, inliers) or _turn_flaw(solution, prediction)

    @staticmethod
    def _flaw(solution: Solution, inliers: NDArray[np.bool_]) -> str:
        n, good = len(inliers), int(inliers.sum())
        if not solution.converged:
            return f"no convergence with {n} points"
        if solution.scale > _MOST_SCALE:
            return _large(solution)
        if good < _LEAST_INLIERS or good < _LEAST_SHARE * n:
            return f"too few inliers: {good} of {n} points"
        return ""

    def _second_motion(
        self, tracks: Tracks, inliers: NDArray[np.bool_], solution: Solution, prediction: Prediction, plane: Plane | None
    ) -> tuple[str, str]:
        others = ~inliers
        count = int(others.sum())
        if count < max(_SECOND_POINTS, _SECOND_SHARE * len(inliers)):
            return "", ""
        guide = np.zeros((6, 6))
        guide[3:, 3:] = np.linalg.inv(_GUIDE * prediction.covariance[3:, 3:])
        second = self._solve(tracks, others, prediction, plane, guide)
        together = int((second.distances <= _INLIER).sum()) if second.converged else 0
        if together < max(_SECOND_POINTS, _SECOND_AGREE * count):
            return "", ""
        what = f"two motions: {int(inliers.sum())} and {together} of {len(inliers)} points"
        of_first, of_second = (_distance(s, prediction) for s in (solution, second))
        return ("", what) if of_first < _NEAR_CHI2 and of_second > _FAR_CHI2 else (what, "")


def _shared(px: Array, residuals: Array) -> float:
    """Correlation of residuals (N, 2) with their nearest points' px (N, 3)."""
    apart = np.square(px[:, None, 0] - px[:, 0]) + np.square(px[:, None, 1] - px[:, 1])
    np.fill_diagonal(apart, np.inf)
    nearest = np.argpartition(apart, _NEIGHBOURS, axis=1)[:, :_NEIGHBOURS]
    power = float((residuals**2).sum())
    return float((residuals[:, None] * residuals[nearest]).sum()) / (_NEIGHBOURS * power) if power > 0.0 else 0.0


def _large(solution: Solution) -> str:
    return f"residuals {solution.scale:.1f} times as large as expected"


def _turn_flaw(solution: Solution, prediction: Prediction) -> str:
    e, S = _difference(solution, prediction)
    distance = float(e[3:] @ np.linalg.solve(S[3:, 3:], e[3:]))
    if distance > _TURN_CHI2:
        return f"rotation {np.degrees(np.linalg.norm(e[3:])):.1f} deg from the predicted one ({np.sqrt(distance):.0f} sigma)"
    return ""


def _distance(solution: Solution, prediction: Prediction) -> float:
    e, S = _difference(solution, prediction)
    return float(e @ np.linalg.solve(S, e))


def _difference(solution: Solution, prediction: Prediction) -> tuple[Array, Array]:
    motion = solution.motion
    turn = so3.quat_log(so3.from_matrix(np.ascontiguousarray(so3.matrix(prediction.q).T @ motion.R)))
    own = _INFLATION * solution.scale**2 * solution.covariance + solution.systematic @ solution.systematic.T
    return np.r_[motion.p - prediction.p, turn], prediction.covariance + own + np.diag(_FLOOR**2)


def _disparity_sigma_px(rig: StereoRig) -> float:
    """Of calibration: principal points, right camera's turn about y."""
    variance = sum(float(c.covariance[2, 2]) for c in (rig.left, rig.right) if c.covariance is not None)
    if rig.covariance_rc is not None:
        variance += rig.left.fx**2 * float(rig.covariance_rc[4, 4])
    return float(np.sqrt(variance))
