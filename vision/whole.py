"""All outlines as one body with six degrees of freedom, for pictures where hardly one of them gives a fit by itself.

    L(dx) = a sum_i w_i (c_i(dx) - c) - dx^T P^-1 dx / 2,      c_i = |n_i . g| / (|g| + g_0)          (joint_score.py)

dx: the prior's error, of covariance P; the sum tells by how many nats the directions of the gradients under the outlines are
likelier at a place than by chance, c. Kerbs under trees, roofs of many panels, hips: no side shows one clean edge between two
colours, but all sides together have one place. From each place that the coarse search found, L is climbed along the directions in
which the prior lets the outlines move; so it is from the best of all shifts of the place that leads, for these are its rivals.
The best place is told if it is SURE nats likelier than any other.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.landmarks import Landmark
from models.messages import Array
from vision.coarse import Candidate, CoarseConfig, limit_px
from vision.joint_score import chance, joint_score
from vision.motion import Motion, moved
from vision.pattern import NAME, refused
from vision.pictures import Pictures
from vision.point_pose import PointConfig, Points, fit_points
from vision.pose import Pose
from vision.reduced import Field, Level, levels
from vision.reports import Result, fix_of, pose_flaw
from vision.sensitivity import Eye, eyes
from vision.sightings import one_eyed
from vision.visibility import Prisms
from vision.voters import Voters, chromas, voters

SURE = 10.0  # nats; the best two of all wrong places of a picture are up to 5 apart (120 rendered pairs with a turned map)
_NATS = 0.36  # a: of one point; that of independent ones would be 2.5, but edges of things lie under a whole side or none of it
_INDEPENDENT_PX = 3.0  # points nearer to each other have less to say
_POINTS = 600
_LEAST = 3  # outlines in view: one or two alone are the shape of many things
_FLOOR = 0.5  # of the picture's median gradient: below it there is no direction
_APART_PX = 8.0  # nearer places are one
_AROUND_PX = 40.0  # searched all around, at least: what the prior excludes still tells what chance makes
_STARTS, _RIVALS = 5, 8
_STEPS_PX = np.array([6.0, 3.0, 1.5, 0.75])
_LAST_PX = np.array([1.5, 0.75, 0.375])
_CLIMBS = 4  # rounds with steps of one size
_LEAST_PX = 0.2  # a direction that moves the outlines less than that is the prior's
_PLACE_PX = 1.0  # how well the middle of all outlines is known
_MIDDLES = PointConfig(least=1, freedom=1e9, expected=1.0)  # so few points have no residual that tells of their noise


@dataclass(frozen=True, slots=True)
class _Place:
    """error (6,) of the prior, L, and where the middle of the outlines lies (2,) px."""

    error: Array
    value: float
    middle: Array


def whole(
    result: Result, rig: StereoRig, pictures: Pictures, marks: Sequence[Landmark], move: Motion, found: Sequence[Candidate],
    config: CoarseConfig,
) -> Result:  # fmt: skip
    """What predict and verify says; the place of all outlines together where it has none. found: places of the coarse search."""
    picture, eye = pictures.right if pictures.only_right else pictures.left, eyes(rig)[int(pictures.only_right)]
    if result.fix is not None or picture is None or config.sigmas * move.shift_px > limit_px(eye.camera, config):
        return result
    body = _Body(eye, picture, marks, move, config.sigmas * np.sqrt(np.diag(move.covariance)[:2]))
    places = body.climbed([one.error for one in found[:_STARTS]])
    if not places:
        return result
    places += body.climbed(body.rivals(max(places, key=lambda place: place.value).error))
    best = max(places, key=lambda place: place.value)
    others = [place.value for place in places if np.linalg.norm(place.middle - best.middle) > _APART_PX]
    margin = best.value - max([0.0, *others])
    return _told(result, one_eyed(rig, right=pictures.only_right), marks, move, best, margin) if margin >= SURE else result


class _Body:
    """The outlines of some landmarks before one picture; reach (2,) px: shifts from the prior that are looked at."""

    def __init__(
        self, eye: Eye, picture: NDArray[np.uint8], marks: Sequence[Landmark], move: Motion, reach: Array
    ) -> None:  # fmt: skip
        self._move, self._reach, self._prisms, self._chromas = move, reach, Prisms.of(marks), chromas(marks)
        self._fine, self._half = levels(picture, eye.camera, (1, 2))
        self._eye = Eye(self._fine.camera, eye.R_kb, eye.p_bk, eye.right)
        self._floor = _FLOOR * self._fine.typical() + 0.5
        self._root = np.linalg.cholesky(np.asarray(move.prior.covariance, dtype=float))
        self._by_chance: float | None = None

    def climbed(self, errors: Sequence[Array]) -> list[_Place]:
        """The summits of L next to places, but for those that show too little to be sure of."""
        return [place for error in errors if (place := self._climbed(error)) is not None]

    def _climbed(self, error: Array) -> _Place | None:
        for steps in (_STEPS_PX, _LAST_PX):  # what is seen of walls and sides changes on the way
            seen = self._seen(error)
            if seen is None or len(np.unique(seen.mark)) < _LEAST or (weight := _NATS * _weights(seen)).sum() < 2.0 * SURE:
                return None
            if self._by_chance is None:
                self._by_chance = chance(*self._shifted(self._fine, seen, error, _APART_PX))
            basis, size_px = self._basis(seen, self._move.pose(error))
            error, value = _climb(
                self._fine.whole(), _pinhole(self._fine), self._floor, seen.points_n, seen.direction_n, weight, self._by_chance,
                *self._eye.stand(*self._move.pose(np.zeros(6))), self._move.prior.information, basis, size_px, np.array(error),
                steps,
            )  # fmt: skip
        return _Place(error, value, self._move.J[:2] @ error)

    def rivals(self, error: Array) -> list[Array]:
        """Errors (6,) of the prior that shift the picture of a place to the summits of the joint score elsewhere."""
        seen = self._seen(error)
        if seen is None:
            return []
        asked = self._shifted(self._half, seen, error, 2.0)
        score, su, sv = joint_score(*asked), asked[4], asked[5]
        score[np.hypot(su[:, None], sv[None, :]) <= _APART_PX] = -np.inf
        shifts = []
        for _ in range(_RIVALS):
            a, b = np.unravel_index(int(np.argmax(score)), score.shape)
            if not score[a, b] > 0.0:
                break
            shifts.append(np.array([su[a], sv[b]]))
            score[np.hypot(su[:, None] - su[a], sv[None, :] - sv[b]) <= _APART_PX] = -np.inf
        return [error + self._move.gain[:, :2] @ shift for shift in shifts]

    def _seen(self, error: Array) -> Voters | None:
        return voters(self._eye, self._prisms, self._chromas, self._move.pose(error), _APART_PX, _POINTS)

    def _shifted(
        self, level: Level, seen: Voters, error: Array, step_px: float
    ) -> tuple[Field, Array, Array, float, Array, Array]:
        """What joint_score() asks for: shifts of a place to all that the prior allows, and all around, a step apart."""
        middle = self._move.J[:2] @ error
        low, high = np.minimum(-self._reach - middle, -_AROUND_PX), np.maximum(self._reach - middle, _AROUND_PX)
        su, sv = (np.arange(math.floor(a / step_px), b / step_px + 1.0) * step_px for a, b in zip(low, high, strict=True))
        aimed = seen.aimed(self._eye, self._move.pose(error), self._move.gain[:, :2])
        return level.whole(), _pinhole(level), aimed, self._floor, su, sv

    def _basis(self, seen: Voters, pose: Pose) -> tuple[Array, Array]:
        """Directions (6, 6), columns of one sigma of the prior each, and by how much (6,) px they move the outlines."""
        p_nk, R_nk = self._eye.pose(*pose)
        x_c = (seen.points_n - p_nk) @ R_nk
        D = moved(self._fine.camera, x_c, seen.points_n - pose[0], R_nk).reshape(-1, 6) @ self._root
        square, turns = np.linalg.eigh(D.T @ D / len(x_c))
        return np.ascontiguousarray(self._root @ turns), np.sqrt(np.maximum(square, 0.0))


def _pinhole(level: Level) -> Array:
    c = level.camera
    return np.array([c.fx, c.fy, c.cx, c.cy])


def _weights(seen: Voters) -> Array:
    """w (N,): of each point, by the length of outline that it stands for."""
    return np.repeat(np.minimum(seen.length / _INDEPENDENT_PX, 1.0), np.diff(seen.first))


def _told(result: Result, rig: StereoRig, marks: Sequence[Landmark], move: Motion, best: _Place, margin: float) -> Result:
    """The place as a fix: each outline's middle is where it lies then. rig: the camera that saw it is the left one."""
    start = move.pose(best.error)
    p_nc, R_nc = rig.camera_pose(*start)
    middles = np.array([(*mark.centre_n, mark.roof_d) for mark in marks])
    px = rig.left.project((middles - p_nc) @ R_nc)
    shown = rig.left.contains(px)
    if not shown.any():
        return result
    points = Points(middles[shown], px[shown], np.tile(np.eye(2) * _PLACE_PX**2 * shown.sum(), (int(shown.sum()), 1, 1)))
    variance = np.mean([(mark.sigma_m**2, mark.height_sigma_m**2) for mark in marks], axis=0)
    fitted = fit_points(rig, points, start, move.prior, (math.sqrt(variance[0]), math.sqrt(variance[1]), 0.0), _MIDDLES)
    if isinstance(fitted, str):
        return result
    pose, t_ns = fitted.estimate, result.report.t_ns
    if flaw := pose_flaw(pose, move.prior):
        return refused(result, "no_pose", flaw)
    detail = (
        f"{result.report.detail}; all {int(shown.sum())} outlines together have one place, {margin:.0f} nats above the second"
    )
    report = msgspec.structs.replace(result.report, outcome="fixed", detail=detail, residual_px=pose.residual_px)
    return Result(fix_of(pose, t_ns, (NAME,), 1.0), report, result.regions, pose)


@njit(cache=True)
def _evidence(
    field: Field, camera: Array, floor: float, points: Array, directions: Array, weight: Array, by_chance: float, p_nk: Array,
    R_nk: Array,
) -> float:  # fmt: skip
    """sum_i w_i (c_i - c) of points (N, 3) on edges of direction (N, 3), seen from a camera's pose; outside it, nothing."""
    rows, columns = field.shape[0], field.shape[1]
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    x, d, total = np.empty(3), np.empty(3), 0.0
    for i in range(len(points)):
        for k in range(3):
            x[k], d[k] = 0.0, 0.0
            for j in range(3):
                x[k] += R_nk[j, k] * (points[i, j] - p_nk[j])
                d[k] += R_nk[j, k] * directions[i, j]
        if not x[2] > 0.0:
            continue
        u, v = fx * x[0] / x[2] + cx, fy * x[1] / x[2] + cy
        if not (u >= 1.0 and v >= 1.0 and u < columns - 2.0 and v < rows - 2.0):
            continue
        g = field[int(v + 0.5), int(u + 0.5)]
        along_u, along_v = fx * (d[0] * x[2] - x[0] * d[2]), fy * (d[1] * x[2] - x[1] * d[2])
        size = math.hypot(along_u, along_v)
        if g[6] < 0.0 or size == 0.0:
            continue
        nu, nv = -along_v / size, along_u / size
        h0, h1, h2 = g[0] * nu + g[3] * nv, g[1] * nu + g[4] * nv, g[2] * nu + g[5] * nv
        total += weight[i] * (math.sqrt(h0 * h0 + h1 * h1 + h2 * h2) / (g[6] + floor) - by_chance)
    return total


@njit(cache=True)
def _climb(
    field: Field, camera: Array, floor: float, points: Array, directions: Array, weight: Array, by_chance: float, p_n: Array,
    R_nb: Array, p_bk: Array, R_kb: Array, information: Array, basis: Array, size_px: Array, error: Array, steps_px: Array,
) -> tuple[Array, float]:  # fmt: skip
    """The error (6,) of the prior (p_n, R_nb) at a summit of L, and L there: one direction after the other, in smaller steps."""
    best, value, at = -np.inf, -np.inf, error.copy()
    trial = error.copy()
    for step_px in steps_px:
        rises = True
        for _ in range(_CLIMBS):
            if not rises:
                break
            rises = False
            for k in range(6):
                step = min(step_px / max(size_px[k], 1e-9), 1.0)
                for sign in (0.0, 1.0, -1.0):
                    if (sign == 0.0 and best > -np.inf) or (sign != 0.0 and step * size_px[k] < _LEAST_PX):
                        continue
                    for j in range(6):
                        trial[j] = at[j] + sign * step * basis[j, k]
                    R = so3.product(so3.matrix(so3.quat_exp(trial[3:])), R_nb)
                    p_nk = p_n + trial[:3] + so3.applied(R, p_bk)
                    value = _evidence(field, camera, floor, points, directions, weight, by_chance, p_nk, R @ R_kb.T)
                    value -= 0.5 * float(trial @ information @ trial)
                    if value > best:
                        best, rises = value, rises or sign != 0.0
                        at[:] = trial
                        if sign != 0.0:
                            break
    return at, best
