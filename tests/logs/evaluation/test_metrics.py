from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.evaluation import metrics as m
from models.messages import Array
from tests.logs.flight_log import csv

SQUARE = np.array([[0.0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 1]])
SHIFT = np.array([1.0, 2.0, 3.0])


def random_walk(seed: int, n: int = 400) -> tuple[Array, Array]:
    """Smooth random positions (n, 3) and quaternions wxyz (n, 4)."""
    rng = np.random.default_rng(seed)
    p = np.cumsum(np.cumsum(rng.normal(size=(n, 3)), axis=0), axis=0) * 0.01
    r = Rotation.from_rotvec(np.cumsum(rng.normal(size=(n, 3)), axis=0) * 0.05)
    return p, r.as_quat(scalar_first=True)


def disturbed(seed: int, p: Array, q: Array) -> tuple[Array, Array]:
    """The same with errors of 0.1 m and 0.02 rad, seen from another place."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec([0.1, -0.2, 2.0])
    p_est = turn.apply(p + rng.normal(size=p.shape) * 0.1) * 1.1 + [3.0, -2.0, 1.0]
    r_est = turn * m.rotation(q) * Rotation.from_rotvec(rng.normal(size=p.shape) * 0.02)
    return p_est, r_est.as_quat(scalar_first=True)


def test_stats_of_known_magnitudes() -> None:
    s = m.stats(np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 1.0], [0.0, 2.0, 0.0]]))
    assert [s.rmse, s.mean, s.median, s.max, s.n] == pytest.approx([np.sqrt(10.0), 8 / 3, 2.0, 5.0, 3])


def test_nothing_gives_nan_not_an_exception() -> None:
    none, no_poses = np.empty((0, 3)), np.empty((0, 4))
    pairs = m.pairs_apart(np.empty(0), 1.0, 0.1)
    assert m.ate(none, none, "sim3").n == 0
    assert np.isnan(m.ate(none, none).rmse)
    assert m.rpe(none, no_poses, none, no_poses, pairs)[0].n == 0
    assert np.isnan(m.drift(none, none).end_m)
    assert m.nees(none, np.empty((0, 3, 3))).shape == (0,)
    assert np.isnan(m.consistency(np.empty(0), 3).mean)


@pytest.mark.parametrize(
    ("kind", "removed"),
    [
        ("none", set[str]()),
        ("yaw", {"shift", "yaw"}),
        ("se3", {"shift", "yaw", "tilt"}),
        ("sim3", {"shift", "yaw", "tilt", "scale"}),
    ],
)
def test_each_alignment_removes_just_its_own_freedom(kind: m.AlignmentKind, removed: set[str]) -> None:
    moved = {
        "shift": SQUARE + SHIFT,
        "yaw": Rotation.from_rotvec([0, 0, 2.5]).apply(SQUARE),
        "tilt": Rotation.from_rotvec([0.3, 0, 0]).apply(SQUARE),
        "scale": SQUARE * 1.2,
    }
    for name, p_est in moved.items():
        rmse = m.ate(p_est, SQUARE, kind).rmse
        assert rmse < 1e-12 if name in removed else rmse > 0.1, name


def test_alignment_recovers_the_motion() -> None:
    p, q = random_walk(1)
    turn, shift = Rotation.from_rotvec([0.3, -1.0, 2.0]), np.array([5.0, -3.0, 2.0])
    p_est = turn.inv().apply(p - shift) / 1.7
    a = m.align(p_est, p, "sim3")
    assert a.scale == pytest.approx(1.7, abs=1e-12)
    np.testing.assert_allclose(a.R, turn.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(a.t, shift, atol=1e-10)
    np.testing.assert_allclose(a.positions(p_est), p, atol=1e-10)
    q_est = (turn.inv() * m.rotation(q)).as_quat(scalar_first=True)
    assert m.stats(m.attitude_error(a.attitudes(q_est), q)).max < 1e-12


def test_yaw_alignment_is_the_best_of_all_yaws() -> None:
    p, q = random_walk(3)
    p_est, _ = disturbed(4, p, q)
    best = m.ate(p_est, p, "yaw").rmse
    centred_est, centred = p_est - p_est.mean(axis=0), p - p.mean(axis=0)
    others = [m.stats(centred - Rotation.from_rotvec([0, 0, a]).apply(centred_est)).rmse for a in np.linspace(0, 2 * np.pi, 721)]
    assert best <= min(others) <= 1.001 * best


def test_a_mirrored_trajectory_is_not_aligned_by_a_reflection() -> None:
    mirrored = SQUARE * [1.0, 1.0, -1.0]
    assert np.linalg.det(m.align(mirrored, SQUARE, "se3").R) == pytest.approx(1.0)
    assert m.ate(mirrored, SQUARE, "se3").rmse > 0.1


@pytest.mark.parametrize("kind", ["yaw", "se3", "sim3"])
def test_alignment_of_degenerate_points_still_minimises(kind: m.AlignmentKind) -> None:
    standing = np.zeros((5, 3))
    assert m.ate(standing, standing + SHIFT, kind).rmse < 1e-12
    line = np.linspace(0, 1, 7)[:, None] * [1.0, 0.0, 0.0]
    assert m.ate(line, line + 5.0, kind).rmse < 1e-12


def test_attitude_error_is_about_the_axes_of_map() -> None:
    dtheta = np.array([0.01, -0.02, 0.03])
    estimated = Rotation.from_euler("ZYX", [1.0, 0.5, -0.7])
    true = Rotation.from_rotvec(dtheta) * estimated
    error = m.attitude_error(estimated.as_quat(scalar_first=True)[None], true.as_quat(scalar_first=True)[None])
    np.testing.assert_allclose(error, dtheta[None], atol=1e-14)


def test_path_length() -> None:
    np.testing.assert_allclose(m.path_length(SQUARE), [0, 4, 7, 7 + np.sqrt(17)])


def test_pairs_are_the_nearest_within_tolerance() -> None:
    i, j = m.pairs_apart(np.array([0.0, 1.0, 1.9, 3.2, 3.3, 9.0]), 1.0, 0.35)
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == [(0, 1), (1, 2), (2, 3)]
    assert m.pairs_apart(np.array([0.0, 0.0, 0.0]), 0.1, 1.0)[0].tolist() == [0, 1]  # a row is no pair with itself


def test_rpe_of_a_constant_drift() -> None:
    """GIVEN an estimate whose odometry is 2 % long and turns 0.01 rad too much a step, THEN the RPE says just that."""
    n = 50
    t = np.linspace(0.0, n - 1.0, n)
    yaw = np.zeros((n, 3))
    p_true = t[:, None] * [1.0, 0.0, 0.0]
    q_true = Rotation.from_rotvec(yaw).as_quat(scalar_first=True)
    translation, turn = m.rpe(p_true * 1.02, q_true, p_true, q_true, m.pairs_apart(t, 5.0, 0.1))
    assert [translation.mean, translation.max, translation.n] == pytest.approx([0.1, 0.1, 45])
    assert turn.max == pytest.approx(0.0, abs=1e-12)
    yaw[:, 2] = 0.01 * t
    q_est = Rotation.from_rotvec(yaw).as_quat(scalar_first=True)
    turn = m.rpe(p_true, q_est, p_true, q_true, m.pairs_apart(t, 5.0, 0.1))[1]
    assert turn.rmse == pytest.approx(0.05)


def test_rpe_does_not_see_where_the_map_lies() -> None:
    p, q = random_walk(2)
    turn = Rotation.from_rotvec([0.3, -1.0, 2.0])
    moved = turn.apply(p) + 7.0, (turn * m.rotation(q)).as_quat(scalar_first=True)
    translation, angle = m.rpe(*moved, p, q, m.pairs_apart(m.path_length(p), 2.0, 0.2))
    assert translation.n > 100
    assert translation.max < 1e-10
    assert angle.max < 1e-10


def test_drift_of_a_linear_error() -> None:
    t = np.linspace(0, 10, 101)[:, None]
    d = m.drift(t * [0.0, 0.3, 0.4], t * [2.0, 0.0, 0.0])
    assert d.end_m == pytest.approx(5.0)
    assert d.max_m == pytest.approx(5.0)
    assert d.rmse_m == pytest.approx(0.5 * np.sqrt(np.mean(t**2)))
    assert d.distance_m == pytest.approx(20.0)
    assert d.end_percent == pytest.approx(25.0)


def test_nees_by_hand() -> None:
    error = np.array([[2.0, 0.0, 0.0], [1.0, 2.0, 3.0]])
    covariance = np.array([np.diag([4.0, 1.0, 1.0]), np.diag([1.0, 4.0, 9.0])])
    np.testing.assert_allclose(m.nees(error, covariance), [1.0, 3.0])
    correlated = np.array([[[2.0, 1.0], [1.0, 2.0]]])
    np.testing.assert_allclose(m.nees(np.array([[1.0, 1.0]]), correlated), [2 / 3])


def test_a_covariance_that_is_not_definite_gives_inf() -> None:
    bad = [np.zeros((2, 2)), np.diag([1.0, -1.0]), np.array([[1.0, 0.5], [0.2, 1.0]]), np.diag([np.nan, 1.0])]
    values = m.nees(np.ones((5, 2)), np.array([*bad, np.eye(2)]))
    np.testing.assert_array_equal(values, [np.inf, np.inf, np.inf, np.inf, 2.0])


@pytest.mark.parametrize("dof", [3, 6])
def test_nees_reports_a_consistent_covariance_from_one_that_is_not(dof: int) -> None:
    rng = np.random.default_rng(dof)
    root = np.tril(rng.normal(size=(2000, dof, dof))) + 2.0 * np.eye(dof)
    covariance = root @ root.mT
    error = (root @ rng.normal(size=(2000, dof, 1)))[..., 0]
    checked = m.consistency(m.nees(error, covariance), dof)
    assert checked.consistent
    assert checked.mean == pytest.approx(1.0, abs=0.06)
    assert checked.inside == pytest.approx(0.95, abs=0.015)
    assert checked.covered == pytest.approx(0.95, abs=0.015)
    assert checked.n_effective == pytest.approx(2000, rel=0.15)
    confident = m.consistency(m.nees(1.5 * error, covariance), dof)
    timid = m.consistency(m.nees(error / 1.5, covariance), dof)
    assert confident.mean > confident.band[1]
    assert timid.mean < timid.band[0]
    assert confident.covered < 0.85
    assert timid.covered > 0.98


def test_the_band_allows_for_correlated_samples() -> None:
    """GIVEN consistent errors correlated over 100 samples, THEN the band is wide enough for 19 runs in 20, and was not by n."""
    rng = np.random.default_rng(5)
    phi, n, runs = 0.98, 3000, 60
    by_n_eff = by_n = 0
    for _ in range(runs):
        e = np.empty((n, 3))
        e[0] = rng.normal(size=3)
        noise = rng.normal(size=(n, 3)) * np.sqrt(1 - phi**2)
        for k in range(1, n):
            e[k] = phi * e[k - 1] + noise[k]
        values = (e**2).sum(axis=1)
        by_n_eff += m.consistency(values, 3).consistent
        by_n += m.consistency(values, 3, n_effective=n).consistent
    assert 0.85 <= by_n_eff / runs <= 1.0
    assert by_n / runs < 0.6


def test_effective_samples_of_a_first_order_process() -> None:
    """n_eff / n -> (1 - phi) / (1 + phi) for an AR(1) series."""
    rng = np.random.default_rng(6)
    x = np.zeros(100_000)
    noise = rng.normal(size=len(x))
    for k in range(1, len(x)):
        x[k] = 0.9 * x[k - 1] + noise[k]
    assert m.effective_samples(x) / len(x) == pytest.approx(0.1 / 1.9, rel=0.1)
    assert m.effective_samples(noise) / len(x) == pytest.approx(1.0, abs=0.05)
    assert m.effective_samples(np.ones(7)) == 7


def test_chi2_band_is_the_tabulated_one() -> None:
    assert m.chi2_band(3) == pytest.approx((0.2158, 9.3484), abs=1e-4)


def test_nis_has_the_expectation_of_its_dof_whatever_the_correlation() -> None:
    rng = np.random.default_rng(7)
    S = np.array([[4.0, 1.8], [1.8, 1.0]])
    values = m.nis(rng.multivariate_normal([0, 0], S, size=20_000), np.sqrt(np.diag(S)))
    assert values.mean() == pytest.approx(2.0, abs=0.06)
    np.testing.assert_allclose(m.nis(np.array([[1.0, 4.0]]), np.array([[1.0, 2.0]])), [5.0])


def test_waits_end_when_newer_information_arrives() -> None:
    valid = np.array([0, 1, 2, 8, 9, 3])
    assert m.waits(valid, valid).tolist() == [[0, 1], [1, 2], [2, 3], [3, 8], [8, 9]]
    assert m.waits(valid, valid + 4).tolist() == [[0, 5], [1, 6], [2, 7], [3, 12], [8, 13]]
    assert m.waits(np.array([5, 1, 2, 9]), np.array([5, 6, 7, 9])).tolist() == [[5, 9]]  # 1 and 2 come late
    assert m.waits(np.array([5]), np.array([5])).shape == (0, 2)


def test_gaps_are_measured_by_what_had_arrived() -> None:
    valid = np.array([0, 10, 20, 80, 90, 30])
    assert m.gaps(valid, valid, 200, 20) == [(30, 80), (90, 200)]
    assert m.gaps(valid, valid + 15, 100, 30) == [(30, 95)]  # each 1.5 steps late
    assert m.gaps(valid, valid + 15, 100, 20) == [(0, 25), (30, 95)]  # always old: what is left of an overlap is shorter


def test_no_gap_holds_information() -> None:
    """GIVEN fixes 30 apart, each at once, THEN each wait is a gap of its own: 30 long, not 120."""
    valid = np.arange(0, 121, 30)
    assert m.gaps(valid, valid, 120, 20) == [(0, 30), (30, 60), (60, 90), (90, 120)]


def test_common_spans() -> None:
    assert m.common([(0, 10), (20, 40)], [(5, 25), (30, 31), (40, 50)]) == [(5, 10), (20, 25), (30, 31)]
    assert m.common([(0, 10)], []) == []


def test_old_information_ends_no_gap() -> None:
    valid, arrived = np.array([10, 4, 30]), np.array([10, 20, 31])
    assert m.gaps(valid, arrived, 32, 5) == [(10, 31)]
    assert m.gaps(np.empty(0, np.int64), np.empty(0, np.int64), 32, 5) == []


def test_within_is_strict() -> None:
    assert m.within(np.array([1, 2, 3, 4, 9]), [(2, 4), (8, 10)]).tolist() == [False, False, True, False, True]


def evo_path(p: Array, q: Array) -> object:
    trajectory = pytest.importorskip("evo.core.trajectory", reason="evo (the yardstick of these tests) is not installed")
    return trajectory.PosePath3D(positions_xyz=p, orientations_quat_wxyz=q)


def evo_ape(p_est: Array, q_est: Array, p: Array, q: Array, kind: m.AlignmentKind) -> dict[str, float]:
    metrics = pytest.importorskip("evo.core.metrics", reason="evo (the yardstick of these tests) is not installed")
    estimate, truth = evo_path(p_est, q_est), evo_path(p, q)
    if kind != "none":
        estimate.align(truth, correct_scale=kind == "sim3")  # type: ignore[attr-defined]
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((truth, estimate))
    return dict(ape.get_all_statistics())


def assert_as_evo(p_est: Array, q_est: Array, p: Array, q: Array, step: int) -> None:
    """ATE and RPE (translation and rotation, over `step` rows) agree with evo's to 1e-9."""
    kinds: tuple[m.AlignmentKind, ...] = ("none", "se3", "sim3")
    for kind in kinds:
        ours, theirs = m.ate(p_est, p, kind), evo_ape(p_est, q_est, p, q, kind)
        for name in ("rmse", "mean", "median", "max"):
            assert getattr(ours, name) == pytest.approx(theirs[name], rel=1e-9, abs=1e-9), (kind, name)
    metrics = pytest.importorskip("evo.core.metrics", reason="evo (the yardstick of these tests) is not installed")
    rows = np.arange(len(p) - step)
    relations = (metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_rad)
    for ours, relation in zip(m.rpe(p_est, q_est, p, q, (rows, rows + step)), relations, strict=True):
        theirs_rpe = metrics.RPE(relation, step, metrics.Unit.frames, all_pairs=True)
        theirs_rpe.process_data((evo_path(p, q), evo_path(p_est, q_est)))
        theirs = theirs_rpe.get_all_statistics()
        for name in ("rmse", "mean", "median", "max"):
            assert getattr(ours, name) == pytest.approx(theirs[name], rel=1e-9, abs=1e-9), (relation, name)


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_ate_and_rpe_are_evos_on_random_trajectories(seed: int) -> None:
    p, q = random_walk(seed)
    assert_as_evo(*disturbed(seed + 100, p, q), p, q, step=7)


@pytest.mark.parametrize("sequence", ["MH_04_difficult", "V1_02_medium"])
def test_ate_and_rpe_are_evos_on_a_real_flight(landfix_data: Path, sequence: str) -> None:
    """GIVEN real visual poses and the truth at the nearest stamps, THEN the figures are evo's and the data set's own."""
    folder = landfix_data / "flights" / "euroc" / sequence
    vision, truth = csv(folder / "vision.csv"), csv(folder / "truth.csv")
    row = np.abs(truth[:, 0][None] - vision[:, 0][:, None]).argmin(axis=1)
    near = np.abs(truth[row, 0] - vision[:, 0]) < 0.004
    vision, truth = vision[near], truth[row[near]]
    p_est, q_est, p, q = vision[:, 1:4], vision[:, 4:8], truth[:, 1:4], truth[:, 7:11]
    assert len(p) > 1000
    assert_as_evo(p_est, q_est, p, q, step=20)
    published = {"MH_04_difficult": 0.17, "V1_02_medium": 0.06}  # README of the set, m
    assert m.ate(p_est, p).rmse == pytest.approx(published[sequence], abs=0.006)
