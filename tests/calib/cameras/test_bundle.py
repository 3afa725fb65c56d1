from dataclasses import replace

import numpy as np
import pytest

from calib.cameras import bundle
from calib.cameras.bundle import IDENTITY, Pose, Problem, Seen, adjust
from models import so3
from tests.boards import views as synthetic
from tests.calib.conftest import BOARD, true_rig


def problem(sigma_px: float, seed: int = 0) -> Problem:
    rng, rig = np.random.default_rng(seed), true_rig()
    places = tuple(place for _, place in synthetic.both(rig))
    poses = synthetic.poses(synthetic.both(rig), BOARD, 8, rng)
    views = []
    for pose in poses:
        seen = []
        for camera, place in synthetic.both(rig):
            px = camera.project(place.of(pose.of(BOARD.points)))
            seen.append(Seen(BOARD.points, px + rng.normal(0.0, sigma_px, px.shape)))
        views.append(tuple(seen))
    free = ((True,) * 9,) * 2
    return Problem((rig.left, rig.right), places, tuple(views), tuple(poses), free)


def moved(truth: Problem) -> Problem:
    """Everything off: lenses, the pose between the cameras, the board's poses."""
    rng = np.random.default_rng(9)
    cameras = tuple(
        bundle.with_parameters(c, np.array([c.fx + 9, c.fy - 7, c.cx + 5, c.cy - 4, *(0.8 * np.array(c.distortion))]))
        for c in truth.cameras
    )  # fmt: skip
    places = (IDENTITY, truth.places[1].moved(np.array([3e-3, -2e-3, 5e-3, 0.01, -0.02, 0.01])))
    poses = tuple(p.moved(rng.normal(0.0, 5e-3, 6)) for p in truth.poses)
    return replace(truth, cameras=cameras, places=places, poses=poses)


def test_derivatives_are_those_of_the_residuals() -> None:
    start = moved(problem(0.0))
    mask = start.mask
    terms = bundle._terms(start, 0, mask)
    for k in range(len(mask)):
        d = np.zeros(len(mask))
        d[k] = h = 1e-6
        ahead, back = (bundle._moved(start, mask, s * d, [np.zeros(6)] * 8) for s in (1.0, -1.0))
        assert ahead is not None
        assert back is not None
        slope = (bundle._terms(ahead, 0, mask).r - bundle._terms(back, 0, mask).r) / (2.0 * h)
        np.testing.assert_allclose(-slope, terms.J_s[:, k], atol=1e-5 * max(1.0, np.abs(slope).max()))
    for k in range(6):
        d = np.zeros(6)
        d[k] = h = 1e-6
        rows = []
        for s in (1.0, -1.0):
            at = bundle._moved(start, mask, np.zeros(len(mask)), [s * d, *[np.zeros(6)] * 7])
            assert at is not None
            rows.append(bundle._terms(at, 0, mask).r)
        np.testing.assert_allclose((rows[1] - rows[0]) / (2.0 * h), terms.J_v[:, k], atol=1e-5 * np.abs(terms.J_v).max())


def test_exact_corners_give_the_truth_from_far_away() -> None:
    truth = problem(0.0)
    solution = adjust(moved(truth))
    assert solution.rms < 1e-6
    for found, camera in zip(solution.problem.cameras, truth.cameras, strict=True):
        np.testing.assert_allclose(found.matrix, camera.matrix, atol=1e-4)
        np.testing.assert_allclose(found.distortion, camera.distortion, atol=1e-5)
    np.testing.assert_allclose(solution.problem.places[1].R, truth.places[1].R, atol=1e-8)
    np.testing.assert_allclose(solution.problem.places[1].t, truth.places[1].t, atol=1e-8)


def test_the_covariance_is_that_of_the_whole_problem() -> None:
    """Marginal of the shared unknowns: the corner of the inverse of the whole normal matrix."""
    solution = adjust(problem(0.2))
    p, mask = solution.problem, solution.problem.mask
    m, views = int(mask.sum()), len(p.views)
    N = np.zeros((m + 6 * views, m + 6 * views))
    for i in range(views):
        t = bundle._terms(p, i, mask)
        J = np.zeros((len(t.r), len(N)))
        J[:, :m], J[:, m + 6 * i : m + 6 * i + 6] = t.J_s, t.J_v
        N += J.T @ J
    scale = np.sqrt(np.diagonal(N))
    whole = np.linalg.inv(N / np.outer(scale, scale)) / np.outer(scale, scale)
    expected = solution.sigma_px**2 * solution.widened * whole[:m, :m]
    np.testing.assert_allclose(solution.covariance, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    squares = sum(float(np.sum(r * r)) for view in solution.residuals for r in view if r is not None)
    measured = 8 * 2 * 2 * 54
    assert solution.sigma_px == pytest.approx(np.sqrt(squares / (measured - m - 6 * views)))


def test_a_camera_that_does_not_see_a_view_takes_no_part_in_it() -> None:
    truth = problem(0.1)
    views = ((truth.views[0][0], None), *truth.views[1:])
    solution = adjust(replace(truth, views=views))
    assert solution.residuals[0][1] is None
    assert len(solution.view_rms()) == 8
    assert 0.1 < solution.camera_rms(1) < 0.18


def test_with_nothing_shared_free_only_the_poses_move() -> None:
    truth = problem(0.1)
    solution = adjust(replace(moved(truth), cameras=truth.cameras, places=truth.places, free=()))
    for found, camera in zip(solution.problem.cameras, truth.cameras, strict=True):
        np.testing.assert_array_equal(found.matrix, camera.matrix)
    assert 0.1 < solution.rms < 0.18
    assert not solution.covariance.any()


def test_a_pose_moves_about_the_axes_it_leads_to() -> None:
    pose = Pose(so3.matrix(so3.quat_exp(np.array([0.3, -0.2, 0.5]))), np.array([1.0, 2.0, 3.0]))
    d = np.array([0.1, 0.2, 0.3, 0.01, -0.02, 0.03])
    np.testing.assert_allclose(pose.moved(d).R, so3.matrix(so3.quat_exp(d[3:].copy())) @ pose.R)
    np.testing.assert_allclose(pose.moved(d).t, pose.t + d[:3])


def test_what_a_pose_can_imitate_leaves_nothing_of_the_lens_and_never_less() -> None:
    """Undetermined lenses, seen by chance in a fisheye's: the difference of normal matrices had negative diagonals there."""
    rng = np.random.default_rng(0)
    J_v, r = rng.normal(size=(108, 6)), rng.normal(size=108)
    J_s = 1e8 * J_v @ rng.normal(size=(6, 12))
    H, g, B, b = bundle._reduced(bundle._Terms(r, J_s, J_v, np.empty((108, 0))), 0.0)
    assert np.all(np.diagonal(H) >= 0.0)
    assert np.abs(H).max() < 1e-25 * np.abs(J_s.T @ J_s).max()
    np.testing.assert_allclose(J_v @ B, J_s, rtol=1e-9, atol=1e-4)
    np.testing.assert_allclose(J_v.T @ (r - J_v @ b), 0.0, atol=1e-12)
    assert np.abs(g).max() < 1e-4


def test_damping_is_that_of_the_normal_equations() -> None:
    rng = np.random.default_rng(1)
    t = bundle._Terms(rng.normal(size=40), rng.normal(size=(40, 5)), rng.normal(size=(40, 6)), np.empty((40, 0)))
    V = t.J_v.T @ t.J_v
    V[np.diag_indices(6)] *= 1.3
    W = t.J_s.T @ t.J_v
    H, g, B, b = bundle._reduced(t, 0.3)
    np.testing.assert_allclose(H, t.J_s.T @ t.J_s - W @ np.linalg.solve(V, W.T), atol=1e-12)
    np.testing.assert_allclose(g, t.J_s.T @ t.r - W @ np.linalg.solve(V, t.J_v.T @ t.r), atol=1e-12)
    np.testing.assert_allclose(B, np.linalg.solve(V, W.T), atol=1e-12)
    np.testing.assert_allclose(b, np.linalg.solve(V, t.J_v.T @ t.r), atol=1e-12)
