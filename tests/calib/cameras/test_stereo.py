from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from calib.board.chessboard import Board, View, find
from calib.cameras import stereo
from calib.cameras.mono import Lens
from calib.cameras.stereo import Pair
from calib.errors import CalibrationError
from calib.report import verdict
from models import so3
from models.camera import StereoRig
from models.messages import Array
from tests.boards import views as synthetic
from tests.calib.conftest import BOARD, seen_by, true_rig


def simulated_pairs(
    count: int = 12, seed: int = 0, sigma_px: float = 0.2, rig: StereoRig | None = None, board: Board = BOARD
) -> list[Pair]:
    rng = np.random.default_rng(seed)
    (left, at_left), (right, at_right) = cameras = synthetic.both(rig or true_rig())
    pairs = []
    for k, pose in enumerate(synthetic.poses(cameras, board, count, rng)):
        l_view = synthetic.seen(left, seen_by(at_left, pose), board, rng, sigma_px, f"l{k}")
        r_view = synthetic.seen(right, seen_by(at_right, pose), board, rng, sigma_px, f"r{k}")
        pairs.append(Pair(l_view, r_view))
    return pairs


def pose_error(result: stereo.Stereo) -> tuple[Array, Array]:
    truth = true_rig()
    turn = so3.quat_log(so3.from_matrix(np.ascontiguousarray(truth.R_rc @ result.rig.R_rc.T)))
    assert result.rig.covariance_rc is not None
    return np.concatenate((truth.t_rc - result.rig.t_rc, turn)), result.rig.covariance_rc


@pytest.fixture(scope="module")
def result() -> stereo.Stereo:
    return stereo.calibrate(simulated_pairs(), BOARD)


def test_the_rig_comes_back_within_its_sigma(result: stereo.Stereo) -> None:
    error, C = pose_error(result)
    assert 0.3 < error @ np.linalg.solve(C, error) < 25.0
    assert np.abs(error[:3]).max() < 1e-3
    assert result.square_m == pytest.approx(0.025, rel=2e-3)
    assert 0.05 < result.epipolar_after_px < 0.3 < result.epipolar_before_px  # 0.2 px in each row, less what the fit takes
    assert result.held_out.rms < 0.35
    assert verdict.of_stereo(result).grade <= verdict.Grade.USABLE


@pytest.mark.long
def test_sigma_is_the_scatter_of_many_calibrations() -> None:
    z = []
    for seed in range(8):
        error, C = pose_error(stereo.calibrate(simulated_pairs(12, seed), BOARD, Lens.FIVE))
        z.append(error / np.sqrt(np.diagonal(C)))
    assert 0.65 < np.sqrt(np.mean(np.square(z))) < 1.35


def test_essential_and_fundamental_matrix_hold_for_true_points() -> None:
    exact = stereo.calibrate(simulated_pairs(8, 1, 0.0), BOARD)
    x_c = np.random.default_rng(0).uniform((-1, -1, 2), (1, 1, 5), (20, 3))
    x_r = true_rig().to_right(x_c)
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", x_r, exact.E, x_c), 0.0, atol=1e-5)
    u, v = x_c @ exact.rig.left.matrix.T, x_r @ exact.rig.right.matrix.T
    distances = stereo.epipolar_distances(exact.F, u[:, :2] / u[:, 2:], v[:, :2] / v[:, 2:])
    np.testing.assert_allclose(distances, 0.0, atol=1e-2)
    assert exact.epipolar_after_px < 1e-3
    np.testing.assert_allclose(
        stereo.triangulate(exact.rig, exact.rig.left.project(x_c), exact.rig.right.project(x_r)), x_c, rtol=1e-4
    )


def test_swapped_and_stacked_cameras_are_refused_with_what_to_do() -> None:
    pairs = simulated_pairs(8)
    with pytest.raises(CalibrationError, match=r"swapped.*exchange --left and --right"):
        stereo.calibrate([Pair(p.right, p.left) for p in pairs], BOARD)
    stacked = msgspec.structs.replace(true_rig(), t_rc=np.array([0.001, -0.06, 0.0]))
    with pytest.raises(CalibrationError, match="not next to it"):
        stereo.calibrate(simulated_pairs(8, rig=stacked), BOARD)


def test_a_board_that_looks_the_same_upside_down_is_turned_where_one_image_read_it_from_the_other_end() -> None:
    alike = Board(8, 6, 0.025)
    pairs = simulated_pairs(8, board=alike)
    first = pairs[0].right
    other_end = Pair(pairs[0].left, View(first.name, 640, 480, first.ids, first.px[::-1], 2.0))
    result = stereo.calibrate([other_end, *pairs[1:]], alike)
    assert not result.dropped
    assert result.solution.rms < 0.32


def test_a_pair_read_from_both_ends_is_dropped() -> None:
    pairs = simulated_pairs(8)
    first = pairs[0].right
    both_ends = Pair(pairs[0].left, View(first.name, 640, 480, first.ids, first.px[::-1], 2.0))
    assert [d.name for d in stereo.calibrate([both_ends, *pairs[1:]], BOARD).dropped] == ["l0, r0"]


@pytest.mark.parametrize("turns", [1, 2])
def test_a_right_camera_on_its_side_or_head_is_one_that_is_turned(turns: int) -> None:
    """Its pixels turned by a quarter or a half: the same rays, R_rc turned about the optical axis."""
    truth, size = true_rig(), (480, 640) if turns == 1 else (640, 480)
    pairs = []
    for p in simulated_pairs(12):
        u, v = p.right.px.T
        px = np.column_stack((v, 639.0 - u) if turns == 1 else (639.0 - u, 479.0 - v))
        pairs.append(Pair(p.left, View(p.right.name, *size, p.right.ids, px, 2.0)))
    result = stereo.calibrate(pairs, BOARD)
    turned = so3.matrix(so3.quat_exp(np.array([0.0, 0.0, -0.5 * np.pi * turns])))
    assert result.solution.rms < 0.32
    assert result.epipolar_after_px < 0.3
    np.testing.assert_allclose(result.rig.R_rc, turned @ truth.R_rc, atol=5e-3)
    np.testing.assert_allclose(result.rig.t_rc, turned @ truth.t_rc, atol=1e-3)


def test_pairs_that_see_different_corners_share_what_both_see() -> None:
    def hidden(v: View, kept: slice) -> View:
        return View(v.name, v.width, v.height, v.ids[kept], v.px[kept], v.edge_px)

    pairs = [Pair(hidden(p.left, slice(0, 45)), hidden(p.right, slice(9, 54))) for p in simulated_pairs(10)]
    result = stereo.calibrate(pairs, BOARD)
    assert all(len(p.left.ids) == 36 for p in result.pairs)
    assert result.rig.baseline_m == pytest.approx(0.083, abs=1e-3)


def test_a_pair_not_taken_together_is_dropped() -> None:
    pairs = simulated_pairs(12)
    apart = Pair(pairs[0].left, pairs[5].right)
    result = stereo.calibrate([apart, *pairs[1:]], BOARD)
    assert [d.name for d in result.dropped] == [f"{pairs[0].left.name}, {pairs[5].right.name}"]


def test_real_pairs_are_at_or_below_the_reference(chessboards: Path) -> None:
    """README of the images: stereo 0.217 px, rectified row error 0.171 px, left out 0.173 px, square 25.011 mm, 83.21 mm."""
    sides = []
    for side in ("left", "right"):
        views = [find(np.asarray(cv2.imread(str(p))), BOARD, p.name) for p in sorted(chessboards.glob(f"{side}*.jpg"))]
        sides.append([v for v in views if isinstance(v, View)])
    result = stereo.calibrate([Pair(*p) for p in zip(*sides, strict=True)], BOARD)
    assert len(result.pairs) == 13
    assert 0.1 < result.solution.rms <= 0.217
    assert result.solution.camera_rms(0) <= 0.195
    assert result.solution.camera_rms(1) <= 0.207
    assert 0.05 < result.epipolar_after_px <= 0.171
    assert result.held_out.rms <= 0.173
    assert result.square_m == pytest.approx(0.025, abs=2e-5)
    assert result.rig.covariance_rc is not None
    sigma = np.sqrt(np.diagonal(result.rig.covariance_rc))
    assert np.abs(result.rig.t_rc - np.array([-0.0832, 0.00093, 0.00036]))[0] < 2.0 * sigma[0]
    turn = np.rad2deg(np.linalg.norm(so3.quat_log(so3.from_matrix(np.ascontiguousarray(result.rig.R_rc)))))
    assert turn == pytest.approx(0.499, abs=2.0 * np.rad2deg(sigma[3:].max()))
