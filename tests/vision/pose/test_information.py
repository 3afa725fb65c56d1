"""In which directions do images measure the pose? On made-up information, and on rendered views that show too little."""

from functools import cache

import numpy as np
import pytest

from models import so3
from models.measurements import DIRECTION_SCALE
from models.messages import Array
from tests.estimator.partial import not_measured
from tests.vision.part_views import part_view
from tests.vision.pose.test_pose import Flight, near
from vision.pose.information import Measured
from vision.pose.least_squares import POSE, System
from vision.pose.pose import PoseConfig, PoseEstimate, difference, estimate_pose

SEEDS = range(14)


def _system(rank: int, seed: int, errors: int = 2, sigma_px: float = 0.1, weak: float = 0.0) -> tuple[System, Array]:
    """Edges that show `rank` combinations of the pose, each moved by errors of map and rig; and the images' omega."""
    rng = np.random.default_rng(seed)
    seen = rng.normal(size=(rank, POSE))
    H = rng.normal(size=(12, 2, rank)) @ seen + weak * rng.normal(size=(12, 2, POSE))
    A = np.concatenate((H, 0.3 * rng.normal(size=(12, 2, errors))), axis=2)
    R = np.repeat(sigma_px**2 * np.eye(2)[None], 12, axis=0)
    system = System.of(np.zeros((12, 2)), A, R, np.ones((12, 2), dtype=np.bool_))
    omega = np.einsum("eia,eij,ejb->ab", A, system.W, A) + np.diag([0.0] * POSE + [1.0] * errors)
    return system, omega


@pytest.mark.parametrize("rank", [1, 3, 4, 5])
def test_as_many_directions_as_are_seen_and_these_with_their_covariance(rank: int) -> None:
    system, omega = _system(rank, rank)
    prior = np.diag([4.0, 4.0, 9.0, 1e3, 1e3, 1e2])
    measured = Measured.of(omega, prior)
    assert measured.rank == rank
    assert not measured.whole
    image, moved = measured.covariances(system, omega, 1.0)
    directions, _ = measured.reported_along(np.zeros(6), image + moved @ moved.T)
    rows = directions / DIRECTION_SCALE
    np.testing.assert_allclose(rows @ rows.T, np.eye(rank), atol=1e-12)
    # THEN in these directions the covariance is the inverse of what the images know there
    alone = omega[:6, :6] - omega[:6, 6:] @ np.linalg.solve(omega[6:, 6:], omega[6:, :6])
    expected = directions @ np.linalg.pinv(alone, rcond=1e-10, hermitian=True) @ directions.T
    np.testing.assert_allclose(directions @ (image + moved @ moved.T) @ directions.T, expected, rtol=1e-6, atol=1e-14)
    # AND across them the variance is a thousand times the prior's
    across = not_measured(directions)
    wide = np.linalg.eigvalsh(across @ image @ across.T)
    assert wide[0] > 0.0
    assert np.linalg.eigvalsh(image)[0] > 0.0


def test_no_error_of_map_and_rig_moves_what_was_not_measured() -> None:
    """Of two combinations the images know a little, less than a thousandth of what the prior does."""
    system, omega = _system(4, 4, weak=0.01)
    measured = Measured.of(omega, 1e3 * np.eye(6))
    assert measured.rank == 4
    assert measured.share[-1] > 1e-6
    _, moved = measured.covariances(system, omega, 1.3)
    across = measured.basis[:, 4:].T @ measured.low.T
    np.testing.assert_allclose(across @ moved, 0.0, atol=1e-12)
    assert np.abs(moved).max() > 1e-4


def test_readings_with_the_prior_are_the_joint_optimum() -> None:
    """K (D delta + y) = delta for a delta that images and prior agree on."""
    system, omega = _system(4, 7)
    prior = np.diag([4.0, 4.0, 9.0, 1e3, 1e3, 1e2])
    measured = Measured.of(omega, prior)
    image, moved = measured.covariances(system, omega, 1.0)
    P0 = np.linalg.inv(prior)
    alone = omega[:6, :6] - omega[:6, 6:] @ np.linalg.solve(omega[6:, 6:], omega[6:, :6])
    delta: Array = np.asarray(np.linalg.solve(prior + alone, alone @ np.random.default_rng(1).normal(size=6)), dtype=np.float64)
    D, y = measured.reported_along(delta, image + moved @ moved.T)
    gain = P0 @ D.T @ np.linalg.inv(D @ (P0 + image + moved @ moved.T) @ D.T)
    np.testing.assert_allclose(gain @ (D @ delta + y), delta, rtol=1e-6, atol=1e-12)


def test_a_well_seen_pose_is_reported_as_it_was() -> None:
    system, omega = _system(6, 3, errors=0, sigma_px=0.001)
    measured = Measured.of(omega, 0.1 * np.eye(6))
    assert measured.rank == 6
    assert measured.whole
    image, moved = measured.covariances(system, omega, 1.0)
    assert moved.shape == (6, 0)
    np.testing.assert_allclose(image, np.linalg.inv(omega), rtol=1e-2)


def test_surprise_counts_what_was_measured() -> None:
    """The same share of consistent readings stays below the limit, whatever the rank."""
    for rank in (2, 4):
        system, omega = _system(rank, rank)
        measured = Measured.of(omega, np.eye(6))
        image, moved = measured.covariances(system, omega, 1.0)
        alone = omega[:6, :6] - omega[:6, 6:] @ np.linalg.solve(omega[6:, 6:], omega[6:, :6])
        rng, C = np.random.default_rng(5), image + moved @ moved.T
        seen_as = rng.multivariate_normal(np.zeros(6), alone @ alone + alone, 4000)  # information times the reading
        drawn = np.asarray(np.linalg.solve(np.eye(6) + alone, seen_as.T).T, dtype=np.float64)
        over = np.mean([measured.surprise(delta, C, 12.59) > 1.0 for delta in drawn])  # 5 % of chi-square (6)
        assert 0.035 < over < 0.065


# --- rendered views -----------------------------------------------------------------------------------------------------


@cache
def seen(kind: str, seed: int) -> tuple[Flight, PoseEstimate]:
    view = part_view(kind, seed)
    found = estimate_pose(view.rig, view.images, view.landmarks, near(view), view.prior, PoseConfig(least_edges=3))
    assert isinstance(found, PoseEstimate), (kind, seed, found)
    return view, found


def _directions(found: PoseEstimate) -> Array:
    assert found.directions is not None
    return found.directions


def test_two_parallel_edges_leave_the_way_along_them_open() -> None:
    for seed in SEEDS:
        view, found = seen("strip", seed)
        along = np.zeros(6)
        along[:2] = view.landmarks[0].outline_n[1] - view.landmarks[0].outline_n[0]
        along /= np.linalg.norm(along)
        D = _directions(found)
        assert len(D) <= 5
        assert np.linalg.norm(D @ along) < 0.02
        across = np.array([-along[1], along[0], 0.0, 0.0, 0.0, 0.0])
        assert np.linalg.norm(D @ across) > 0.3
        # the pose reported is the prior's along the edges, and the fix says that it knows nothing there
        off = difference(found.p_n, found.R_nb, view.prior.p_n, np.asarray(view.prior.q_nb_wxyz))
        assert abs(off @ along) < 0.15
        assert along @ found.covariance @ along > 100.0 * along @ view.prior.covariance @ along


def test_a_round_roof_leaves_the_turn_about_it_open() -> None:
    for seed in SEEDS:
        view, found = seen("round", seed)
        middle = view.landmarks[0].outline_n.mean(axis=0)
        about = np.array([middle[1] - view.p_n[1], view.p_n[0] - middle[0], 0.0, 0.0, 0.0, 1.0])
        D = _directions(found)
        assert len(D) <= 5
        assert np.linalg.norm(D @ about) < 0.02 * np.linalg.norm(about * DIRECTION_SCALE)
        assert found.joint_covariance[5, 5] > 0.98 * view.prior.covariance[5, 5]
        assert np.trace(found.joint_covariance[:3, :3]) < 0.5 * np.trace(view.prior.covariance[:3, :3])
        assert found.landmark_errors.shape[2] == 7


def test_a_square_shows_all_of_the_pose() -> None:
    ranks = [6 if found.directions is None else len(found.directions) for _, found in (seen("square", s) for s in SEEDS)]
    assert set(ranks) == {6}


def test_one_corner_shows_at_least_four_combinations_and_seldom_all_well() -> None:
    ranks = [len(_directions(seen("corner", seed)[1])) for seed in SEEDS]  # reported along directions, every time
    assert min(ranks) >= 4
    assert {4, 5} & set(ranks)


@pytest.mark.parametrize(
    ("kind", "low", "high"), [("corner", 0.6, 1.7), ("strip", 0.2, 1.4), ("square", 0.5, 1.5), ("round", 0.03, 1.2)]
)
def test_what_was_measured_is_as_far_off_as_reported(kind: str, low: float, high: float) -> None:
    """Mean squared Mahalanobis distance of D (x_true (-) x_fix) - y, per direction."""
    ratios = []
    for seed in SEEDS:
        view, found = seen(kind, seed)
        e, C = difference(view.p_n, view.R_nb, found.p_n, so3.from_matrix(found.R_nb)), found.covariance + found.covariance_common
        if found.directions is not None and found.readings is not None:
            e, C = found.directions @ e - found.readings, found.directions @ C @ found.directions.T
        ratios.append(e @ np.linalg.solve(C, e) / len(e))
    assert low < np.mean(ratios) < high


def test_weak_directions_are_reported_from_the_joint_optimum() -> None:
    for seed in SEEDS:
        _, found = seen("corner", seed)
        off = difference(found.p_n, found.R_nb, found.joint_p_n, so3.from_matrix(found.joint_R_nb))
        assert off @ np.linalg.solve(found.joint_covariance, off) < 1.0
