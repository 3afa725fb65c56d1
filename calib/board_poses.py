"""Where the board is in each picture of a recording, with covariance: x_c = R_co @ x_o + t_co."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.bundle import IDENTITY, Pose, Problem, Seen, adjust
from calib.chessboard import Board, View
from calib.mono import board_pose
from models.camera import CameraModel
from models.messages import Array


@dataclass(frozen=True)
class BoardPoses:
    """R_co (M, 3, 3), t_co (M, 3), covariance (M, 6, 6) of (t, rotation about the axes of c) from noise of the corners sigma_px.

    by_lens (M, 6, k): what an error of the lens' parameters does to a pose; lens_covariance (k, k) of those, None = exact.
    """

    R_co: Array
    t_co: Array
    covariance: Array
    sigma_px: float
    by_lens: Array
    lens_covariance: Array | None

    def only(self, kept: NDArray[np.bool_]) -> "BoardPoses":
        """Some of the pictures."""
        return replace(
            self, R_co=self.R_co[kept], t_co=self.t_co[kept], covariance=self.covariance[kept], by_lens=self.by_lens[kept]
        )  # fmt: skip

    def shifted(self, lens: Array) -> "BoardPoses":
        """As they would have been measured with the lens' parameters off by `lens`."""
        moved = [Pose(R, t).moved(d) for R, t, d in zip(self.R_co, self.t_co, self.by_lens @ lens, strict=True)]
        return replace(self, R_co=np.array([p.R for p in moved]), t_co=np.array([p.t for p in moved]))


def board_poses(
    views: Sequence[View], board: Board, camera: CameraModel, progress: Callable[[float], None] | None = None
) -> BoardPoses:
    """Each view's pose by least squares; the noise of the corners is what all views leave together."""
    R, t, information, coupling, squares, spare = [], [], [], [], 0.0, 0
    for k, view in enumerate(views):
        seen = Seen(board.points[view.ids], view.px)
        solved = adjust(Problem((camera,), (IDENTITY,), ((seen,),), (board_pose(camera, seen),)))
        pose = solved.problem.poses[0]
        x_c = pose.of(seen.x_o)
        to_x = camera.project_jacobian(x_c)
        turned = seen.x_o @ pose.R.T
        J = np.concatenate((to_x, np.cross(turned[:, None], to_x)), axis=2).reshape(-1, 6)
        J_lens = camera.parameter_jacobian(x_c).reshape(len(J), -1)
        N = J.T @ J
        R.append(pose.R)
        t.append(pose.t)
        information.append(N)
        coupling.append(-np.linalg.solve(N, J.T @ J_lens))
        squares += solved.rms**2 * len(seen.px)
        spare += 2 * len(seen.px) - 6
        if progress:
            progress((k + 1) / len(views))
    sigma2 = squares / max(spare, 1)
    return BoardPoses(
        np.array(R),
        np.array(t),
        np.asarray(sigma2 * np.linalg.inv(information), dtype=np.float64),
        float(np.sqrt(sigma2)),
        np.array(coupling),
        camera.covariance,
    )
