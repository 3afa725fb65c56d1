"""Board poses in a recording, with covariance: x_c = R_co @ x_o + t_co."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.board.chessboard import Board, View
from calib.cameras.bundle import IDENTITY, Pose, Problem, Seen, Solution, adjust
from calib.cameras.mono import board_pose
from calib.errors import CalibrationError
from models.camera import CameraModel
from models.messages import Array

_OUTLIER: Final = 5.0  # times the residual of the middle view


@dataclass(frozen=True)
class BoardPoses:
    """R_co (M, 3, 3), t_co (M, 3), covariance (M, 6, 6) of (t, rotation about c) by corner noise.

    by_lens (M, 6, k): derivative by lens parameters; lens_covariance (k, k), None = exact.
    """

    R_co: Array
    t_co: Array
    covariance: Array
    sigma_px: float
    by_lens: Array
    lens_covariance: Array | None

    def only(self, kept: NDArray[np.bool_]) -> "BoardPoses":
        """Some of the images."""
        return replace(
            self, R_co=self.R_co[kept], t_co=self.t_co[kept], covariance=self.covariance[kept], by_lens=self.by_lens[kept]
        )  # fmt: skip

    def shifted(self, lens: Array) -> "BoardPoses":
        """The poses with the lens' parameters off by `lens`."""
        moved = [Pose(R, t).moved(d) for R, t, d in zip(self.R_co, self.t_co, self.by_lens @ lens, strict=True)]
        return replace(self, R_co=np.array([p.R for p in moved]), t_co=np.array([p.t for p in moved]))


def read_from_one_end(views: Sequence[View], board: Board) -> list[View]:
    """Views by time, an ambiguous board read from one end throughout."""
    if not board.ends_alike:
        return list(views)
    same = [views[0]]
    for view in views[1:]:
        ways = (view, replace(view, px=view.px[::-1].copy()))
        same.append(min(ways, key=lambda v: float(np.sum((v.px - same[-1].px) ** 2))))
    return same


def board_poses(
    views: Sequence[View], board: Board, camera: CameraModel, progress: Callable[[float], None] | None = None
) -> tuple[BoardPoses, NDArray[np.int64]]:
    """Least-squares poses and their views, without outlier views."""
    report = progress or (lambda _: None)
    solved: list[tuple[int, Solution]] = []
    for k, view in enumerate(views):
        seen = Seen(board.points[view.ids], view.px)
        with contextlib.suppress(CalibrationError, cv2.error):
            solved.append((k, adjust(Problem((camera,), (IDENTITY,), ((seen,),), (board_pose(camera, seen),)))))
        report((k + 1) / len(views))
    usual = float(np.median([s.rms for _, s in solved])) if solved else 0.0
    good = [(k, s) for k, s in solved if s.rms <= _OUTLIER * usual]
    if not good:
        raise CalibrationError("the rig's camera fits none of the views: is it the right rig, the right --board?")
    parts = [_information(camera, s) for _, s in good]
    redundancy = [2 * len(views[k].px) - 6 for k, _ in good]
    sigma2 = float(np.average([s.sigma_px**2 for _, s in good], weights=redundancy))
    poses = BoardPoses(
        np.array([s.problem.poses[0].R for _, s in good]), np.array([s.problem.poses[0].t for _, s in good]),
        np.asarray(sigma2 * np.linalg.inv([N for N, _ in parts]), dtype=np.float64), float(np.sqrt(sigma2)),
        np.array([by_lens for _, by_lens in parts]), camera.covariance,
    )  # fmt: skip
    return poses, np.array([k for k, _ in good], dtype=np.int64)


def _information(camera: CameraModel, solution: Solution) -> tuple[Array, Array]:
    seen, pose = solution.problem.views[0][0], solution.problem.poses[0]
    assert seen is not None
    x_c = pose.of(seen.x_o)
    to_x = camera.project_jacobian(x_c)
    turned = seen.x_o @ pose.R.T
    J = np.concatenate((to_x, np.cross(turned[:, None], to_x)), axis=2).reshape(-1, 6)
    J_lens = camera.parameter_jacobian(x_c).reshape(len(J), -1)
    N: Array = J.T @ J
    return N, np.asarray(-np.linalg.solve(N, J.T @ J_lens))
