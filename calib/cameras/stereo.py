"""Two cameras from board pairs: x_r = R_rc @ x_c + t_rc (thesis 3.8-3.9, 5.1.3).

Epipolar geometry:

    E = [t_rc]x R_rc,   F = K_r^-T E K_l^-1,   (u_r, 1) F (u_l, 1)^T = 0          (thesis eq. 3.96-3.127)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from calib.board.chessboard import Board, View
from calib.cameras import mono
from calib.cameras.bundle import IDENTITY, Pose, Problem, Solution, adjust
from calib.cameras.mono import Dropped, HeldOut, Lens
from calib.cameras.selection import FEWEST, check_sizes, choose
from calib.errors import CalibrationError
from calib.files.rig_yaml import FORWARD, UNKNOWN_POSE
from models import so3
from models.camera import StereoRig
from models.messages import Array
from vision.image.rectify import rectification

_FOLDS: Final = 4


class Pair(NamedTuple):
    """The same corners in both images of a pair."""

    left: View
    right: View


@dataclass(frozen=True)
class Stereo:
    """Corner distances [px] from epipolar lines, raw, and rectified rows.

    held_out: rectified, pairs left out; square_m: mean triangulated square.
    """

    rig: StereoRig
    lens: Lens
    pairs: tuple[Pair, ...]
    solution: Solution
    dropped: tuple[Dropped, ...]
    E: Array
    F: Array
    epipolar_before_px: float
    epipolar_after_px: float
    held_out: HeldOut
    square_m: float


def calibrate(
    pairs: Sequence[Pair], board: Board, lens: Lens = Lens.FIVE, progress: Callable[[float], None] | None = None
) -> Stereo:
    """Calibrate the rig of the pairs. Raises CalibrationError."""
    report = progress or (lambda _: None)
    for side in (0, 1):
        check_sizes([pair[side] for pair in pairs], f"{('left', 'right')[side]} images")
    both = [common for pair in pairs if (common := shared(pair, board)) is not None]
    chosen = [both[i] for i in choose([p.left for p in both], board)]
    problem = _start(chosen, board, lens)
    report(0.4)
    solution, kept, dropped = mono.without_outliers(problem, [f"{p.left.name}, {p.right.name}" for p in chosen])
    report(0.7)
    used = tuple(chosen[i] for i in kept)
    rig = _rig(solution)
    _check_sides(rig)
    E = so3.skew(rig.t_rc) @ rig.R_rc
    F = np.linalg.inv(rig.right.matrix).T @ E @ np.linalg.inv(rig.left.matrix)
    rows = row_errors(rig, used)
    before = np.concatenate([epipolar_distances(F, p.left.px, p.right.px) for p in used])
    report(1.0)
    return Stereo(
        rig, lens, used, solution, tuple(dropped), E, F / np.linalg.norm(F), _rms(before), _rms(np.concatenate(rows)),
        _held_out(solution, used), float(np.mean(square_sides(rig, used, board))),
    )  # fmt: skip


def epipolar_distances(F: Array, left: Array, right: Array) -> Array:
    """Distances (N,) [px] of right points from lines F (u_l, 1)."""
    lines = np.column_stack((left, np.ones(len(left)))) @ F.T
    return np.asarray(
        np.sum(lines * np.column_stack((right, np.ones(len(right)))), axis=1) / np.linalg.norm(lines[:, :2], axis=1)
    )


def row_errors(rig: StereoRig, pairs: Sequence[Pair]) -> list[Array]:
    """Rectified row left minus right, per pair [px]."""
    flat = rectification(rig).rig
    R_left = flat.R_bc.T @ rig.R_bc
    errors = []
    for pair in pairs:
        left = flat.left.project(_rays(rig.left.undistort(pair.left.px)) @ R_left.T)
        right = flat.right.project(_rays(rig.right.undistort(pair.right.px)) @ (R_left @ rig.R_rc.T).T)
        errors.append(left[:, 1] - right[:, 1])
    return errors


def square_sides(rig: StereoRig, pairs: Sequence[Pair], board: Board) -> Array:
    """Board squares' sides from triangulated corners [m]."""
    sides = []
    for pair in pairs:
        x_c = triangulate(rig, pair.left.px, pair.right.px)
        row, column = np.divmod(pair.left.ids, board.columns)
        for di, dj in ((0, 1), (1, 0)):
            for a, (i, j) in enumerate(zip(row, column, strict=True)):
                b = np.flatnonzero((row == i + di) & (column == j + dj))
                if len(b):
                    sides.append(float(np.linalg.norm(x_c[a] - x_c[b[0]])))
    return np.array(sides)


def triangulate(rig: StereoRig, left: Array, right: Array) -> Array:
    """Points (N, 3) in c midway between the rays [m]."""
    a, b = rig.left.ray(left), rig.right.ray(right) @ rig.R_rc
    origin = -rig.R_rc.T @ rig.t_rc
    ab = np.sum(a * b, axis=1)
    along_a = (a @ origin - ab * (b @ origin)) / (1.0 - ab**2)
    along_b = (ab * (a @ origin) - b @ origin) / (1.0 - ab**2)
    middle: Array = 0.5 * (along_a[:, None] * a + along_b[:, None] * b + origin)
    return middle


def shared(pair: Pair, board: Board) -> Pair | None:
    """Corners in both images, in order; None for too few."""
    left, right = pair
    ids, a, b = np.intersect1d(left.ids, right.ids, return_indices=True)
    if len(ids) < 6:
        return None
    p, q = left.px[a], right.px[b]
    if board.ends_alike and np.sum((p[-1] - p[0]) * (q[-1] - q[0])) < 0.0:
        q = q[::-1]  # read from the other end
    return Pair(
        View(left.name, left.width, left.height, ids, p, left.edge_px),
        View(right.name, right.width, right.height, ids, q, right.edge_px),
    )


def _start(pairs: Sequence[Pair], board: Board, lens: Lens) -> Problem:
    left, right = (adjust(mono.start([p[side] for p in pairs], board, lens)).problem for side in (0, 1))
    R = np.array([b.R @ a.R.T for a, b in zip(left.poses, right.poses, strict=True)])
    t = np.array([b.t - R_rc @ a.t for a, b, R_rc in zip(left.poses, right.poses, R, strict=True)])
    middle = int(np.argmax(np.median(np.einsum("iab,jab->ij", R, R), axis=1)))  # trace(R_i R_j^T) = 1 + 2 cos(angle between)
    place = Pose(R[middle], np.median(t, axis=0))
    views = tuple((*a, *b) for a, b in zip(left.views, right.views, strict=True))
    return Problem((left.cameras[0], right.cameras[0]), (IDENTITY, place), views, left.poses, (*left.free, *right.free))


def _rig(solution: Solution) -> StereoRig:
    left, right = solution.problem.cameras
    n = 4 + len(left.distortion)
    C = solution.covariance
    place = solution.problem.places[1]
    return StereoRig(
        mono.with_covariance(left, C[:n, :n]), mono.with_covariance(right, C[n : 2 * n, n : 2 * n]), place.R, place.t,
        FORWARD, np.zeros(3), C[2 * n :, 2 * n :], UNKNOWN_POSE,
    )  # fmt: skip


def _check_sides(rig: StereoRig) -> None:
    x, y, z = -rig.R_rc.T @ rig.t_rc
    if x * x < y * y + z * z:
        raise CalibrationError(
            f"the second camera is at ({x:.3f}, {y:.3f}, {z:.3f}) m right, down, forward of the first, not next to it: "
            "are they partners? If the cameras lie on their sides, turn both's images upright"
        )
    if x < 0.0:
        raise CalibrationError(
            f"the cameras are swapped: the right one is {-x:.3f} m to the left of the other; exchange --left and --right"
        )


def _held_out(solution: Solution, pairs: Sequence[Pair]) -> HeldOut:
    folds = min(_FOLDS, len(pairs))
    if len(pairs) - len(pairs) // folds < FEWEST - 1:
        return HeldOut(float("nan"), 0.0)
    rms = []
    for fold in range(folds):
        train = adjust(solution.problem.only([i for i in range(len(pairs)) if i % folds != fold]))
        rms += [_rms(rows) for rows in row_errors(_rig(train), pairs[fold::folds])]
    return HeldOut.of(rms)


def _rays(plane: Array) -> Array:
    return np.column_stack((plane, np.ones(len(plane))))


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x * x)))
