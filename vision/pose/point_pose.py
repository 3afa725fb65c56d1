"""Pose from map points at known pixels, and the prior, by robust Gauss-Newton (Lowe 1991).

    px_i = project(R_nc^T (X_i - p_nc)) + e_i,   e_i ~ N(0, R_i)
    dx_c = R_nc^T (-dp + [X - p]x dtheta + dX) + R_bc^T (-dt_bc + [x_b - p_bc]x dtheta_bc)

Common errors: unit-variance unknowns. Reported without the prior.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.pose.information import Measured
from vision.pose.least_squares import POSE, Solution, System, distances, solve, solve_robustly
from vision.pose.pose import Pose, PoseEstimate, combine, difference, retract

_MAP_ERRORS, _SLOPES = 3, 2  # of the map: north, east, down; of the ground: north, east
_CONVERGED = 1e-3  # of the prior's standard deviation
_SURPRISE = 22.5  # chi-square (6) against the prior from which on the points are doubted


class PointConfig(msgspec.Struct, frozen=True):
    """gate: chi-square (2); least: points of a pose; freedom, expected: variance factor's prior."""

    gate: float = 13.8
    least: int = 8
    steps: int = 8
    freedom: float = 16.0
    expected: float = 1.25
    worst_factor: float = 8.0


@dataclass(frozen=True, slots=True)
class Points:
    """x_n (N, 3) m, px (N, 2), R (N, 2, 2) px^2 of the left camera."""

    x_n: Array
    px: Array
    R: Array

    def chosen(self, rows: NDArray[np.bool_]) -> "Points":
        """These rows."""
        return Points(self.x_n[rows], self.px[rows], self.R[rows])


@dataclass(frozen=True, slots=True)
class PointPose:
    """estimate; landmark_errors (1, 6, 3): by map errors north, east, down; residual (N, 2) px; used (N,)."""

    estimate: PoseEstimate
    residual: Array
    used: NDArray[np.bool_]


def fit_points(
    rig: StereoRig, points: Points, start: Pose, prior: Prior, map_sigma: tuple[float, float, float],
    config: PointConfig | None = None,
) -> PointPose | str:  # fmt: skip
    """The pose, or why none; start: p_n, R_nb.

    map_sigma: common horizontal, height [m], ground slope [rad].
    """
    config = config or PointConfig()
    if len(points.px) < config.least:
        return f"{len(points.px)} points fit"
    p_n, R_nb = np.array(start[0], dtype=float), np.array(start[1], dtype=float)
    information: Array = np.linalg.inv(np.asarray(prior.covariance, dtype=np.float64))
    scale = np.sqrt(np.diag(prior.covariance))
    nuisance: Array = np.zeros(0)
    step: Solution | None = None
    for _ in range(config.steps):
        system = _system(rig, points, p_n, R_nb, map_sigma)
        if system is None:
            return "points behind the camera"
        nuisance = np.zeros(system.A.shape[2] - POSE)
        step = solve_robustly(system, nuisance, information, difference(p_n, R_nb, prior.p_n, prior.q_nb_wxyz))
        if not np.isfinite(step.dx).all():
            return "diverged"
        p_n, R_nb = _moved(p_n, R_nb, step.dx)
        if np.all(np.abs(step.dx) < _CONVERGED * scale):
            break
    return _final(rig, points, (p_n, R_nb), prior, information, map_sigma, config)


def _final(
    rig: StereoRig, points: Points, pose: Pose, prior: Prior, information: Array,
    map_sigma: tuple[float, float, float], config: PointConfig,
) -> PointPose | str:  # fmt: skip
    p_n, R_nb = pose
    used = np.ones(len(points.px), dtype=np.bool_)
    delta = difference(p_n, R_nb, prior.p_n, prior.q_nb_wxyz)
    system = _system(rig, points, p_n, R_nb, map_sigma)
    if system is None:
        return "points behind the camera"
    nothing = np.zeros(system.A.shape[2] - POSE, dtype=np.float64)
    step = solve_robustly(system, nothing, information, delta)
    factor = config.expected
    for _ in range(6):
        before = used
        used = distances(system, step.residual) < config.gate * max(factor, 1.0)
        if used.sum() < config.least:
            return f"{used.sum()} points fit"
        kept = system.weighted(used.astype(np.float64))
        step = solve(kept, nothing, information, delta)
        chi2 = float(distances(kept, step.residual).sum() + step.nuisance @ step.nuisance)
        factor = (config.freedom * config.expected + chi2) / (config.freedom + max(2 * int(used.sum()) - POSE, 1))
        if np.array_equal(before, used):
            break
    if factor > config.worst_factor or not np.isfinite(step.dx).all():
        return f"variance factor {factor:.1f}"
    return _report(kept, step, (p_n, R_nb), prior, information, used, factor)


def _report(
    system: System, step: Solution, pose: Pose, prior: Prior, information: Array, used: NDArray[np.bool_], factor: float
) -> PointPose | str:
    measured = Measured.of(step.omega, information)
    if not measured.rank:
        return "the points say nothing that the prior does not"
    p_n, R_nb = _moved(*pose, step.dx)
    delta = difference(p_n, R_nb, prior.p_n, prior.q_nb_wxyz)
    image, moved = measured.covariances(system, step.omega, 1.0)  # as it was solved
    directions, readings = None, None
    if measured.whole:
        p_n, R_nb = retract(prior.p_n, prior.q_nb_wxyz, measured.alone(delta, image + moved @ moved.T))
    else:
        directions, readings = measured.reported_along(delta, image + moved @ moved.T)
    image, moved = measured.covariances(system, step.omega, factor)
    map_errors, slopes, rig = np.split(moved, (_MAP_ERRORS, _MAP_ERRORS + _SLOPES), axis=1)
    image = image + slopes @ slopes.T  # another ground in the next image
    image, by_rig = 0.5 * (image + image.T), rig @ rig.T
    common = map_errors @ map_errors.T + by_rig
    image = image * max(measured.surprise(delta, image + common, _SURPRISE), 1.0)
    joint = combine(prior, p_n, R_nb, image + common, directions, readings)
    rms = float(np.sqrt(np.mean(step.residual[used] ** 2)))
    cost = float(distances(system, step.residual).sum() + delta @ information @ delta)
    estimate = PoseEstimate(
        p_n, R_nb, image, common, directions, readings, map_errors[None], by_rig, *joint, rms, factor, float(used.mean()),
        int(used.sum()), np.zeros((1, _MAP_ERRORS)), cost,
    )  # fmt: skip
    return PointPose(estimate, step.residual, used)


def _system(rig: StereoRig, points: Points, p_n: Array, R_nb: Array, map_sigma: tuple[float, float, float]) -> System | None:
    p_nc, R_nc = rig.camera_pose(p_n, R_nb)
    x_c = (points.x_n - p_nc) @ R_nc
    seen = rig.left.project(x_c)
    if not np.isfinite(seen).all():
        return None
    d_c = rig.left.project_jacobian(x_c)
    d_n = d_c @ R_nc.T
    d_b = d_c @ rig.R_bc.T
    pose = np.concatenate((-d_n, d_n @ _skew(points.x_n - p_n)), axis=2)
    horizontal, height, slope = map_sigma
    uphill = slope * (points.x_n[:, :2] - points.x_n[:, :2].mean(axis=0))
    shared = [d_n * np.array([horizontal, horizontal, height]), d_n[:, :, 2:] * uphill[:, None, :]]
    if rig.covariance_bc is not None:
        bc = np.concatenate((-d_b, d_b @ _skew(x_c @ rig.R_bc.T)), axis=2)
        shared.append(bc @ _root(rig.covariance_bc))
    if rig.left.covariance is not None:
        shared.append(rig.left.parameter_jacobian(x_c) @ _root(rig.left.covariance))
    found = np.ones(points.px.shape, dtype=np.bool_)
    return System.of(points.px - seen, np.concatenate((pose, *shared), axis=2), points.R, found)


def _skew(x: Array) -> Array:
    result = np.zeros((len(x), 3, 3))
    result[:, 0, 1], result[:, 0, 2], result[:, 1, 2] = -x[:, 2], x[:, 1], -x[:, 0]
    return result - result.transpose(0, 2, 1)


def _root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root


def _moved(p_n: Array, R_nb: Array, step: Array) -> tuple[Array, Array]:
    turned = so3.multiply(so3.quat_exp(np.ascontiguousarray(step[3:])), so3.from_matrix(np.ascontiguousarray(R_nb)))
    return p_n + step[:3], so3.matrix(so3.normalise(turned))
