"""Derivatives against differences, and what shared errors do to the pose."""

import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array
from models.prior import Prior
from tests.vision.ground import scene
from vision.pose.point_pose import PointPose, Points, _system, fit_points
from vision.pose.pose import retract
from vision.synthetic.rigs import make_rig

RIG = make_rig()
P_N, Q = np.array([3.0, -2.0, -80.0]), so3.from_euler(0.1, -0.2, 0.8)
SHARED = (0.5, 0.7, 0.03)


def _ground(count: int = 40, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    return np.column_stack((rng.uniform(-35.0, 35.0, count), rng.uniform(-35.0, 35.0, count), rng.uniform(-4.0, 0.0, count)))


def _seen(rig: StereoRig, x_n: Array, p_n: Array, R_nb: Array) -> Array:
    p_nc, R_nc = rig.camera_pose(p_n, R_nb)
    return rig.left.project((x_n - p_nc) @ R_nc)


def _points(x_n: Array, px: Array, sigma_px: float = 0.5) -> Points:
    return Points(x_n, px, np.broadcast_to(sigma_px**2 * np.eye(2), (len(px), 2, 2)).copy())


def test_every_column_is_the_derivative_times_its_sigma() -> None:
    x_n, R_nb = _ground(), so3.matrix(Q)
    system = _system(RIG, _points(x_n, _seen(RIG, x_n, P_N, R_nb)), P_N, R_nb, SHARED)
    assert system is not None
    np.testing.assert_allclose(system.z, 0.0, atol=1e-12)
    step = 1e-5
    numeric = [(_seen(RIG, x_n, *retract(P_N, Q, d)) - _seen(RIG, x_n, *retract(P_N, Q, -d))) / 2e-5 for d in step * np.eye(6)]
    for k in range(3):
        d = step * np.eye(3)[k] * (0.5, 0.5, 0.7)[k]
        numeric.append((_seen(RIG, x_n + d, P_N, R_nb) - _seen(RIG, x_n - d, P_N, R_nb)) / 2e-5)
    for k in range(2):
        d = np.zeros_like(x_n)
        d[:, 2] = step * 0.03 * (x_n[:, k] - x_n[:, k].mean())
        numeric.append((_seen(RIG, x_n + d, P_N, R_nb) - _seen(RIG, x_n - d, P_N, R_nb)) / 2e-5)
    np.testing.assert_allclose(system.A[:, :, :11], np.stack(numeric, axis=2), rtol=1e-5, atol=1e-5)


def test_errors_of_the_rig_have_the_covariance_that_they_cause() -> None:
    """N N^T of the columns next to the map's against differences: camera on the body and the camera's own numbers."""
    x_n, R_nb = _ground(6), so3.matrix(Q)
    system = _system(RIG, _points(x_n, _seen(RIG, x_n, P_N, R_nb)), P_N, R_nb, SHARED)
    assert system is not None
    N = system.A[:, :, 11:].reshape(12, -1)

    def moved(step: Array) -> Array:
        mounted = msgspec.structs.replace(
            RIG, p_bc=RIG.p_bc + step[:3], R_bc=so3.matrix(so3.quat_exp(np.ascontiguousarray(step[3:6]))) @ RIG.R_bc
        )
        c = RIG.left
        own = np.array([c.fx, c.fy, c.cx, c.cy, *c.distortion]) + step[6:]
        camera = CameraModel(c.width, c.height, own[0], own[1], own[2], own[3], tuple(own[4:]))
        return _seen(msgspec.structs.replace(mounted, left=camera), x_n, P_N, R_nb).ravel()

    assert RIG.covariance_bc is not None
    assert RIG.left.covariance is not None
    size = 6 + len(RIG.left.covariance)
    J = np.column_stack([(moved(1e-6 * d) - moved(-1e-6 * d)) / 2e-6 for d in np.eye(size)])
    P = np.zeros((size, size))
    P[:6, :6], P[6:, 6:] = RIG.covariance_bc, RIG.left.covariance
    np.testing.assert_allclose(N @ N.T, J @ P @ J.T, rtol=1e-4, atol=1e-7)


def _fit(shared: tuple[float, float, float], seed: int = 0, wild: int = 0) -> tuple[PointPose, Prior]:
    rng = np.random.default_rng(seed)
    x_n, sigma = _ground(seed=seed), np.array([5.0, 5.0, 3.0, 0.03, 0.03, 0.05])
    error = rng.normal(0.0, sigma)
    p0, R0 = retract(P_N, Q, error)
    prior = Prior(p0, so3.from_matrix(R0), np.diag(sigma**2))
    px = _seen(scene.RIG, x_n, P_N, so3.matrix(Q)) + rng.normal(0.0, 0.5, (len(x_n), 2))
    px[:wild] += rng.uniform(20.0, 60.0, (wild, 2))
    found = fit_points(scene.RIG, _points(x_n, px), (prior.p_n, prior.R_nb), prior, shared)
    assert isinstance(found, PointPose)
    return found, prior


def test_the_measurement_is_as_far_off_as_reported() -> None:
    squared = [scene.chi_square(_fit((0.0, 0.0, 0.0), seed)[0].estimate, P_N, so3.matrix(Q)) for seed in range(40)]
    assert 0.7 < np.mean(squared) / 6.0 < 1.3


def test_implausible_points_are_left_out() -> None:
    found, _ = _fit((0.0, 0.0, 0.0), wild=12)
    assert not found.used[:12].any()
    assert found.used[12:].mean() > 0.9
    assert np.linalg.norm(found.estimate.joint_p_n - P_N) < 1.0


@pytest.mark.parametrize(("shared", "common"), [((0.5, 0.0, 0.0), True), ((0.0, 0.5, 0.0), True), ((0.0, 0.0, 0.03), False)])
def test_what_points_share_widens_the_fix(shared: tuple[float, float, float], common: bool) -> None:
    """An error of the map lasts from fix to fix, the slope of the ground does not."""
    exact, wide = _fit((0.0, 0.0, 0.0))[0].estimate, _fit(shared)[0].estimate
    assert bool(np.any(wide.covariance_common != 0.0)) == common
    grown = wide.covariance + wide.covariance_common - exact.covariance
    assert np.diag(grown)[:3].sum() > 0.2 * (0.5**2 if common else np.diag(exact.covariance)[:3].sum())


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_points_are_no_pose(count: int) -> None:
    x_n, prior = _ground(5)[:count], Prior(P_N, Q, np.eye(6))
    answer = fit_points(scene.RIG, _points(x_n, _seen(scene.RIG, x_n, P_N, so3.matrix(Q))), (P_N, so3.matrix(Q)), prior, SHARED)
    assert answer == f"{count} points fit"


def test_points_behind_the_camera_are_no_pose() -> None:
    x_n, prior = _ground(9), Prior(P_N, Q, np.eye(6))
    behind = fit_points(scene.RIG, _points(x_n * (1, 1, 0) - (0, 0, 200), np.zeros((9, 2))), (P_N, so3.matrix(Q)), prior, SHARED)
    assert behind == "points behind the camera"
