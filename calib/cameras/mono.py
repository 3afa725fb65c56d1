"""One camera from a board: Zhang's calibration (thesis eq. 3.52-3.72), then bundle adjustment."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

import cv2
import numpy as np

from calib.board.chessboard import Board, View
from calib.cameras import fisheye
from calib.cameras.bundle import IDENTITY, Pose, Problem, Seen, Solution, adjust
from calib.cameras.selection import FEWEST, check_sizes, choose
from calib.errors import CalibrationError
from models.camera import CameraModel
from models.messages import Array

_OUTLIER: Final = 3.0  # times the other views' residual ...
_OUTLIER_PX: Final = 0.4  # ... and at least this
_FOLDS: Final = 4


class Lens(StrEnum):
    """Lens model by number of coefficients."""

    TWO = "2"  # k1 k2 (thesis eq. 3.29-3.31)
    FOUR = "4"  # k1 k2 p1 p2
    FIVE = "5"  # Brown: k1 k2 p1 p2 k3
    EIGHT = "8"  # rational: k4 k5 k6 too
    FISHEYE = "fisheye"  # equidistant (Kannala & Brandt 2006), written as the rational model that equals it in the image


_FLAGS = {
    Lens.TWO: cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3,
    Lens.FOUR: cv2.CALIB_FIX_K3,
    Lens.FIVE: 0,
    Lens.EIGHT: 0,  # begins as Brown's: OpenCV's rational fits may have a pole in the image
}
_COUNT = {Lens.TWO: 4, Lens.FOUR: 4, Lens.FIVE: 5, Lens.EIGHT: 8, Lens.FISHEYE: 8}


@dataclass(frozen=True)
class Dropped:
    """An image that was not used, and why."""

    name: str
    reason: str


class HeldOut(NamedTuple):
    """rms [px] (nan: none); beyond: share whose corners the lens model folds."""

    rms: float
    beyond: float

    @classmethod
    def of(cls, rms: Sequence[float]) -> "HeldOut":
        """From residuals per view, nan where the lens model folds."""
        r = np.array(rms)
        return cls(float(np.sqrt(np.nanmean(r * r))) if np.isfinite(r).any() else float("nan"), float(np.mean(np.isnan(r))))


@dataclass(frozen=True)
class Mono:
    """A calibrated camera; views[i] belongs to solution.residuals[i]."""

    camera: CameraModel
    lens: Lens
    views: tuple[View, ...]
    solution: Solution
    dropped: tuple[Dropped, ...]
    held_out: HeldOut
    spread: Array  # (4,) change of fx fy cx cy between calibrations with a part of the views left out, worst, in sigmas


def calibrate(
    views: Sequence[View], board: Board, lens: Lens = Lens.FIVE, progress: Callable[[float], None] | None = None
) -> Mono:
    """Calibrate the camera of the views. Raises CalibrationError."""
    check_sizes(views)
    chosen = [views[i] for i in choose(views, board)]
    rest = [v for v in views if v not in chosen]
    report = progress or (lambda _: None)
    problem = start(chosen, board, lens)
    report(0.3)
    solution, kept, dropped = without_outliers(problem, [v.name for v in chosen])
    report(0.6)
    used = tuple(chosen[i] for i in kept)
    n = 4 + _COUNT[lens]
    camera = with_covariance(solution.problem.cameras[0], solution.covariance[:n, :n])
    held_out, spread = cross_validate(solution)
    if len(rest) >= FEWEST:
        held_out = HeldOut.of([predicted_rms(camera, v, board) for v in rest])
    report(1.0)
    return Mono(camera, lens, used, solution, tuple(dropped), held_out, spread)


def start(views: Sequence[View], board: Board, lens: Lens) -> Problem:
    """Zhang's solution as the adjustment's start."""
    size = (views[0].width, views[0].height)
    x_o = [board.points[v.ids] for v in views]
    if lens is Lens.FISHEYE:
        camera, poses = fisheye.first_camera(x_o, [v.px for v in views], size)
    else:
        camera, poses = _zhang(x_o, [v.px for v in views], size, lens)
    free = (True,) * 6 + (lens is not Lens.TWO,) * 2 + (True,) * (_COUNT[lens] - 4)
    seen = tuple((Seen(x, v.px),) for x, v in zip(x_o, views, strict=True))
    return Problem((camera,), (IDENTITY,), seen, tuple(poses), (free,))


def _zhang(x_o: list[Array], px: list[Array], size: tuple[int, int], lens: Lens) -> tuple[CameraModel, list[Pose]]:
    objects = [x.astype(np.float32) for x in x_o]
    images = [p.astype(np.float32).reshape(-1, 1, 2) for p in px]
    K0, k0 = np.eye(3), np.zeros(5)
    try:
        _, K, k, rvecs, tvecs, _, _, _ = cv2.calibrateCameraExtended(objects, images, size, K0, k0, flags=_FLAGS[lens])
    except cv2.error:
        raise CalibrationError(
            "the views do not determine a camera: tilt the board 20-45 degrees, each way, and do it again"
        ) from None
    k = np.concatenate((np.asarray(k, dtype=np.float64).ravel()[:5], np.zeros(3)))[: _COUNT[lens]]
    camera = CameraModel(*size, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), tuple(float(x) for x in k))
    return camera, [Pose.of_vectors(r, t) for r, t in zip(rvecs, tvecs, strict=True)]


def without_outliers(problem: Problem, names: Sequence[str]) -> tuple[Solution, list[int], list[Dropped]]:
    """Adjusted without outlier views."""
    kept, dropped = list(range(len(problem.views))), list[Dropped]()
    while True:
        solution = adjust(problem.only(kept))
        rms = np.array(solution.view_rms())
        worst = int(np.argmax(rms))
        others = float(np.median(np.delete(rms, worst)))
        if rms[worst] < max(_OUTLIER * others, _OUTLIER_PX) or len(kept) <= FEWEST:
            return solution, kept, dropped
        reason = (
            f"residual {rms[worst]:.2f} px, {rms[worst] / others:.0f} times the others' (board moved, bent, or corners confused)"
        )
        dropped.append(Dropped(names[kept[worst]], reason))
        del kept[worst]


def cross_validate(solution: Solution) -> tuple[HeldOut, Array]:
    """Fit of held-out views, change of fx fy cx cy in sigma / sqrt(F - 1)."""
    problem, views = solution.problem, len(solution.problem.views)
    folds = min(_FOLDS, views)
    sigma = np.sqrt(np.diagonal(solution.covariance)[:4]) / np.sqrt(max(folds - 1, 1))
    full = _pinhole(problem.cameras[0])
    rms, change = list[float](), np.zeros(4)
    for fold in range(folds):
        train = adjust(problem.only([i for i in range(views) if i % folds != fold])).problem
        change = np.maximum(change, np.abs(_pinhole(train.cameras[0]) - full) / sigma)
        for i in range(fold, views, folds):
            left_out = Problem(train.cameras, train.places, (problem.views[i],), (problem.poses[i],))
            rms.append(_rms_or_nan(left_out))
    return HeldOut.of(rms), change


def _rms_or_nan(problem: Problem) -> float:
    try:
        return adjust(problem).rms
    except CalibrationError:
        return float("nan")


def predicted_rms(camera: CameraModel, view: View, board: Board) -> float:
    """RMS of a view, pose alone adjusted [px]."""
    seen = Seen(board.points[view.ids], view.px)
    if np.isnan(camera.undistort(view.px)).any():
        return float("nan")
    return _rms_or_nan(Problem((camera,), (IDENTITY,), ((seen,),), (board_pose(camera, seen),)))


def board_pose(camera: CameraModel, seen: Seen) -> Pose:
    """x_c = R @ x_o + t by homography (IPPE), unrefined."""
    plane = camera.undistort(seen.px).reshape(-1, 1, 2)
    _, rvec, tvec = cv2.solvePnP(seen.x_o, plane, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE)
    return Pose.of_vectors(rvec, tvec)


def with_covariance(camera: CameraModel, covariance: Array) -> CameraModel:
    """The camera with its covariance."""
    return CameraModel(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion, covariance)


def _pinhole(camera: CameraModel) -> Array:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy])
