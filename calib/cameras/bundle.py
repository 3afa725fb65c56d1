"""Bundle adjustment of one or two cameras and a board.

    x_1 = R x_o + t,   x_k = R_k x_1 + t_k,   px = pi_k(x_k) + e        (o = board, 1 = first camera)

    H = sum J_s^T J_s - J_s^T J_v (J_v^T J_v)^-1 J_v^T J_s

s: (fx fy cx cy *distortion) per camera, (t_k, rotation) per further one; v: (t, rotation) per view, R <- exp(dtheta) R.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from calib.cameras.covariance import bowed, marginal
from calib.errors import CalibrationError
from models import so3
from models.camera import CameraModel
from models.messages import Array

_STEPS: Final = 60
_CONVERGED: Final = 1e-10  # relative decrease of the cost
_POSE = 6


class Seen(NamedTuple):
    """Corners of a camera in a view: board points x_o (N, 3) at px (N, 2)."""

    x_o: Array
    px: Array


class Pose(NamedTuple):
    """x_a = R @ x_b + t."""

    R: Array
    t: Array

    @classmethod
    def of_vectors(cls, rvec: Any, tvec: Any) -> "Pose":
        """From OpenCV's rotation vector and translation."""
        r, t = (np.array(v, dtype=np.float64).ravel() for v in (rvec, tvec))
        return cls(so3.matrix(so3.quat_exp(r)), t)

    def moved(self, d: Array) -> "Pose":
        """t + d[:3], exp(d[3:]) @ R."""
        return Pose(so3.matrix(so3.quat_exp(np.ascontiguousarray(d[3:]))) @ self.R, self.t + d[:3])

    def of(self, x: Array) -> Array:
        """Points (N, 3) in frame a."""
        return x @ self.R.T + self.t


IDENTITY: Final = Pose(np.eye(3), np.zeros(3))


def rotation_vector(R: Array) -> Array:
    """Axis times angle [rad] (3,) of a rotation (3, 3)."""
    return so3.quat_log(so3.from_matrix(np.ascontiguousarray(R)))


@dataclass(frozen=True)
class Problem:
    """`views[i][k]`: corners of camera k; poses[i]: the board; places[0] = IDENTITY.

    free: estimated parameters, a row per camera; (): none, nor places.
    """

    cameras: tuple[CameraModel, ...]
    places: tuple[Pose, ...]
    views: tuple[tuple[Seen | None, ...], ...]
    poses: tuple[Pose, ...]
    free: tuple[tuple[bool, ...], ...] = ()

    def only(self, rows: Sequence[int]) -> "Problem":
        """With these views."""
        return replace(self, views=tuple(self.views[i] for i in rows), poses=tuple(self.poses[i] for i in rows))

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Mask of free shared unknowns."""
        if not self.free:
            return np.zeros(sum(4 + len(c.distortion) for c in self.cameras) + _POSE * (len(self.cameras) - 1), dtype=np.bool_)
        lens = [f for camera in self.free for f in camera]
        return np.array(lens + [True] * _POSE * (len(self.cameras) - 1), dtype=np.bool_)


@dataclass(frozen=True)
class Solution:
    """`residuals[i][k]` (N, 2): measured minus predicted [px]; covariance: of shared unknowns (fixed: 0).

    widened: variance factor for common errors; bow: of the board, over its length.
    """

    problem: Problem
    residuals: tuple[tuple[Array | None, ...], ...]
    covariance: Array
    sigma_px: float
    widened: float
    bow: float

    @property
    def rms(self) -> float:
        """Root mean squared distance of measured and predicted corners [px]."""
        return _rms([r for view in self.residuals for r in view if r is not None])

    def camera_rms(self, k: int) -> float:
        """The same of one camera."""
        return _rms([view[k] for view in self.residuals if view[k] is not None])  # type: ignore[misc]

    def view_rms(self) -> list[float]:
        """The same of each view."""
        return [_rms([r for r in view if r is not None]) for view in self.residuals]


def adjust(problem: Problem) -> Solution:
    """Levenberg-Marquardt from the problem's values. Raises CalibrationError."""
    mask, damping = problem.mask, 1e-3
    terms = [_terms(problem, i, mask) for i in range(len(problem.views))]
    cost = sum(float(t.r @ t.r) for t in terms)
    if not np.isfinite(cost):
        raise CalibrationError("no camera fits these views: are the corners those of the given board?")
    for _ in range(_STEPS):
        ds, dv = _step(terms, damping, int(mask.sum()))
        moved = _moved(problem, mask, ds, dv)
        trial = None if moved is None else [_terms(moved, i, mask) for i in range(len(problem.views))]
        cost_new = np.inf if trial is None else sum(float(t.r @ t.r) for t in trial)
        if moved is not None and trial is not None and cost_new < cost:
            done = cost - cost_new < _CONVERGED * cost
            problem, terms, cost, damping = moved, trial, cost_new, max(damping / 10.0, 1e-12)
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e8:
                break
    return _solution(problem, terms, mask, cost)


class _Terms(NamedTuple):
    r: Array
    J_s: Array
    J_v: Array
    J_b: Array


def _terms(problem: Problem, i: int, mask: NDArray[np.bool_]) -> _Terms:
    rs, Js, Jv, Jb = [], [], [], []
    begin = np.cumsum([0] + [4 + len(c.distortion) for c in problem.cameras])
    for k, (camera, place, seen) in enumerate(zip(problem.cameras, problem.places, problem.views[i], strict=True)):
        if seen is None:
            continue
        turned = seen.x_o @ problem.poses[i].R.T
        x_1 = turned + problem.poses[i].t
        x_k = place.of(x_1)
        to_x = camera.project_jacobian(x_k)
        to_x1 = to_x @ place.R
        J = np.zeros((*to_x.shape[:2], len(mask)))
        J[:, :, begin[k] : begin[k + 1]] = camera.parameter_jacobian(x_k)
        if k > 0:
            at = begin[-1] + _POSE * (k - 1)
            J[:, :, at : at + _POSE] = np.concatenate((to_x, np.cross((x_1 @ place.R.T)[:, None], to_x)), axis=2)
        Jv.append(np.concatenate((to_x1, np.cross(turned[:, None], to_x1)), axis=2).reshape(-1, _POSE))
        Jb.append(((to_x1 @ problem.poses[i].R[:, 2])[..., None] * _bow_modes(seen.x_o)[:, None]).reshape(-1, 3))
        Js.append(J.reshape(-1, len(mask))[:, mask])
        rs.append((seen.px - camera.project(x_k)).ravel())
    return _Terms(np.concatenate(rs), np.vstack(Js), np.vstack(Jv), np.vstack(Jb))


def _bow_modes(x_o: Array) -> Array:
    x, y = x_o[:, :2].T
    return np.column_stack((x * x, x * y, y * y))


def _reduced(t: _Terms, damping: float) -> tuple[Array, Array, Array, Array]:
    """A view's part of H and gradient, pose eliminated, and (B, b): pose step b - B ds.

    J_v = Q R, with rows sqrt(damping) |J_v|, is projected out of (J_s r): never negative.
    """
    damped = np.vstack((t.J_v, np.diag(np.sqrt(damping) * np.linalg.norm(t.J_v, axis=0))))
    Q, R = np.linalg.qr(damped)
    both = np.pad(np.column_stack((t.J_s, t.r)), ((0, _POSE), (0, 0)))
    along = Q.T @ both
    rest = both - Q @ along
    N, back = rest.T @ rest, np.asarray(np.linalg.solve(R, along), dtype=np.float64)
    return N[:-1, :-1], N[:-1, -1], back[:, :-1], back[:, -1]


def _step(terms: list[_Terms], damping: float, m: int) -> tuple[Array, list[Array]]:
    parts = [_reduced(t, damping) for t in terms]
    H, g = sum((p[0] for p in parts), np.zeros((m, m))), sum((p[1] for p in parts), np.zeros(m))
    scale = np.sqrt(np.clip(np.diagonal(H), 1e-30, None))
    ds = np.linalg.solve(H / np.outer(scale, scale) + damping * np.eye(m), g / scale) / scale
    return ds, [b - B @ ds for _, _, B, b in parts]


def _moved(problem: Problem, mask: NDArray[np.bool_], ds: Array, dv: list[Array]) -> Problem | None:
    d = np.zeros(len(mask))
    d[mask] = ds
    cameras, at = [], 0
    for camera in problem.cameras:
        n = 4 + len(camera.distortion)
        values = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]) + d[at : at + n]
        if not np.isfinite(values).all() or min(values[:2]) <= 0.0:
            return None
        cameras.append(with_parameters(camera, values))
        at += n
    places = [problem.places[0]]
    for place in problem.places[1:]:
        places.append(place.moved(d[at : at + _POSE]))
        at += _POSE
    poses = tuple(pose.moved(step) for pose, step in zip(problem.poses, dv, strict=True))
    moved = replace(problem, cameras=tuple(cameras), places=tuple(places), poses=poses)
    for view, pose in zip(moved.views, moved.poses, strict=True):
        for camera, place, seen in zip(moved.cameras, moved.places, view, strict=True):
            if seen is not None and not np.isfinite(camera.project(place.of(pose.of(seen.x_o)))).all():
                return None
    return moved


def with_parameters(camera: CameraModel, values: Array) -> CameraModel:
    """The camera with (fx fy cx cy *distortion) = values."""
    fx, fy, cx, cy, *k = (float(x) for x in values)
    return msgspec.structs.replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(k))


def _solution(problem: Problem, terms: list[_Terms], mask: NDArray[np.bool_], cost: float) -> Solution:
    m, measured = int(mask.sum()), sum(len(t.r) for t in terms)
    sigma2 = cost / max(measured - m - _POSE * len(terms), 1)
    covariance, widened, bow = np.zeros((len(mask), len(mask))), 1.0, 0.0
    if m:
        parts = [_reduced(t._replace(J_s=np.hstack((t.J_s, t.J_b))), 0.0)[:2] for t in terms]
        H_i, g_i = np.array([p[0] for p in parts]), np.array([p[1] for p in parts])
        spread = marginal(H_i[:, :m, :m], g_i[:, :m], sigma2)
        length_m = max(float(np.ptp(s.x_o)) for v in problem.views for s in v if s)
        bow, moved = bowed(H_i.sum(axis=0), g_i.sum(axis=0), spread.f * sigma2, length_m)
        covariance[np.ix_(mask, mask)] = spread.covariance + np.outer(moved, moved)
        widened = spread.widened
    residuals = []
    for view, t in zip(problem.views, terms, strict=True):
        counts = [0 if seen is None else 2 * len(seen.px) for seen in view]
        pieces = np.split(t.r, np.cumsum(counts)[:-1])
        residuals.append(tuple(None if s is None else p.reshape(-1, 2) for s, p in zip(view, pieces, strict=True)))
    return Solution(problem, tuple(residuals), covariance, float(np.sqrt(sigma2)), widened, bow)


def _rms(residuals: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.concatenate([np.sum(r * r, axis=1) for r in residuals]))))
