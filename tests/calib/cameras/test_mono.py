from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from calib.board.chessboard import Board, View, find
from calib.cameras import mono
from calib.cameras.bundle import IDENTITY, Seen
from calib.cameras.mono import Lens
from calib.cameras.selection import ENOUGH, choose, coverage
from calib.errors import CalibrationError
from calib.report import verdict
from models.camera import CameraModel
from models.messages import Array
from tests.boards import views as synthetic
from tests.calib.conftest import BOARD, CAMERA, simulated_views


def parameters(camera: CameraModel) -> Array:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])


def covariance(result: mono.Mono) -> Array:
    assert result.camera.covariance is not None
    return result.camera.covariance


@pytest.fixture(scope="module")
def result() -> mono.Mono:
    return mono.calibrate(simulated_views(), BOARD)


def test_the_camera_comes_back_within_its_sigma(result: mono.Mono) -> None:
    error = parameters(CAMERA) - parameters(result.camera)
    assert 0.5 < error @ np.linalg.solve(covariance(result), error) < 25.0  # chi-square of 9: 0.02 % beyond each
    assert 0.24 < result.solution.rms < 0.31  # 0.2 px each way
    assert result.held_out.rms == pytest.approx(result.solution.rms, rel=0.15)
    assert not result.dropped
    assert verdict.of_mono(result).grade <= verdict.Grade.USABLE


def test_adjustment_and_sigmas_agree_with_opencv(result: mono.Mono) -> None:
    x_o = [BOARD.points[v.ids].astype(np.float32) for v in result.views]
    px = [v.px.astype(np.float32).reshape(-1, 1, 2) for v in result.views]
    rms, K, k, _, _, sigma, _, _ = cv2.calibrateCameraExtended(x_o, px, (640, 480), np.eye(3), np.zeros(5))
    assert result.solution.rms == pytest.approx(rms, rel=1e-5)
    np.testing.assert_allclose(result.camera.matrix, K, atol=0.01)
    np.testing.assert_allclose(result.camera.distortion, np.ravel(k), atol=2e-4)
    # OpenCV's sigma divides by the number of points, ours by the redundancy of both coordinates: the same but for that factor.
    ours, theirs = np.sqrt(np.diagonal(covariance(result))), np.ravel(sigma)[:9]
    np.testing.assert_allclose(ours / theirs, np.full(9, (ours / theirs)[0]), rtol=0.02)


@pytest.mark.long
def test_sigma_is_the_scatter_of_many_calibrations() -> None:
    z = []
    for seed in range(12):
        result = mono.calibrate(simulated_views(14, seed), BOARD, Lens.FIVE)
        z.append((parameters(CAMERA) - parameters(result.camera)) / np.sqrt(np.diagonal(covariance(result))))
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3
    assert np.abs(np.mean(z, axis=0)).max() < 1.1


@pytest.mark.parametrize(("lens", "free"), [(Lens.TWO, 6), (Lens.FOUR, 8), (Lens.FIVE, 9), (Lens.EIGHT, 12)])
def test_lens_models(lens: Lens, free: int) -> None:
    result = mono.calibrate(simulated_views(10), BOARD, lens)
    assert np.count_nonzero(np.diagonal(covariance(result))) == free
    assert result.camera.fx == pytest.approx(CAMERA.fx, rel=0.01)
    if lens is Lens.TWO:
        assert result.camera.distortion[2:] == (0.0, 0.0)


def test_a_fisheye_comes_back_as_the_rational_camera_that_equals_it() -> None:
    size, K, k = (640, 480), np.array([[330.0, 0, 321.0], [0, 331.0, 241.0], [0, 0, 1]]), np.array([-0.01, 0.003, -0.001, 0.0])
    stand_in = CameraModel(*size, 330.0, 331.0, 321.0, 241.0)
    rng, views = np.random.default_rng(2), []
    for n, pose in enumerate(synthetic.poses([(stand_in, IDENTITY)], BOARD, 16, rng)):
        x_c = pose.of(BOARD.points)
        px, _ = cv2.fisheye.projectPoints(x_c.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, k)
        noisy = np.asarray(px).reshape(-1, 2) + rng.normal(0.0, 0.1, (54, 2))
        views.append(View(str(n), *size, np.arange(54), noisy, 2.0))
    result = mono.calibrate(views, BOARD, Lens.FISHEYE)
    assert result.solution.rms < 0.16
    rays = np.array([[0.0, 0.0, 1.0], [0.5, 0.2, 1.0], [-0.7, 0.6, 1.0], [0.8, -0.5, 1.0]])
    truth, _ = cv2.fisheye.projectPoints(rays.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), K, k)
    np.testing.assert_allclose(result.camera.project(rays), np.asarray(truth).reshape(-1, 2), atol=1.0)


def test_a_view_that_does_not_fit_is_dropped_with_its_reason() -> None:
    views = simulated_views(12)
    rng = np.random.default_rng(1)
    bent = View("bent", 640, 480, views[4].ids, views[4].px + rng.normal(0.0, 3.0, (54, 2)), 2.0)
    result = mono.calibrate([*views[:4], bent, *views[5:]], BOARD)
    assert [d.name for d in result.dropped] == ["bent"]
    assert "residual" in result.dropped[0].reason
    assert len(result.views) == 11
    assert result.solution.rms < 0.32


def test_errors_that_a_view_has_in_common_widen_sigma() -> None:
    views = simulated_views(14, 3, 0.02)
    x, y = (2.0 * BOARD.points[:, :2] / BOARD.points[:, :2].max(axis=0) - 1.0).T
    rng = np.random.default_rng(3)
    bent = [
        View(v.name, 640, 480, v.ids, v.px + np.outer(x * x + y * y, rng.normal(0.0, 0.4, 2)), 2.0) for v in views
    ]  # fmt: skip
    plain, widened = mono.calibrate(views, BOARD), mono.calibrate(bent, BOARD)
    assert plain.solution.widened < 1.5
    assert widened.solution.widened > 3.0
    error = parameters(CAMERA) - parameters(widened.camera)
    assert np.abs(error[:4] / np.sqrt(np.diagonal(covariance(widened))[:4])).max() < 4.0


def test_a_bowed_board_is_reported_and_its_effect_is_in_sigma() -> None:
    """0.8 mm over 200 mm, alike in all views: by the corners' noise alone the focal length is off by more than five sigma."""
    rng, bow = np.random.default_rng(4), np.zeros((54, 3))
    bow[:, 2] = 8e-4 * (2.0 * BOARD.points[:, 0] / 0.2 - 1.0) ** 2
    views = []
    for k, pose in enumerate(synthetic.poses([(CAMERA, IDENTITY)], BOARD, 20, rng)):
        px = CAMERA.project(pose.of(BOARD.points + bow)) + rng.normal(0.0, 0.03, (54, 2))
        views.append(View(str(k), 640, 480, np.arange(54), px, 2.0))
    result = mono.calibrate(views, BOARD)
    assert result.solution.bow == pytest.approx(8e-4 / 0.2, rel=0.2)
    error = parameters(CAMERA) - parameters(result.camera)
    z = np.abs(error[:4] / np.sqrt(np.diagonal(covariance(result))[:4]))
    assert np.abs(error[:2]).min() > 0.5
    assert z.max() < 3.0
    assert any("board is bowed" in a for a in verdict.of_mono(result).advice)
    flat = mono.calibrate(simulated_views(20), BOARD)
    assert flat.solution.bow == 0.0


def test_twenty_views_that_differ_are_chosen() -> None:
    views = simulated_views(20)
    alike = [View(f"again {k}", 640, 480, v.ids, v.px + 0.5, 2.0) for k, v in enumerate(views[:5])]
    chosen = choose([*views, *alike], BOARD, 12)
    assert len(chosen) == 12
    assert len({(views + views[:5])[i].name for i in chosen}) == 12
    assert len(choose(simulated_views(30), BOARD)) == ENOUGH
    assert coverage(views).sum() == 20 * 54


def test_too_few_alike_and_mixed_views_are_refused() -> None:
    views = simulated_views(8)
    with pytest.raises(CalibrationError, match=r"4 usable views.*take more images"):
        mono.calibrate(views[:4], BOARD)
    alike = [View(str(k), 640, 480, v.ids, v.px + 0.3 * k, 2.0) for k, v in enumerate([views[0]] * 9)]
    with pytest.raises(CalibrationError, match="all alike"):
        mono.calibrate(alike, BOARD)
    other = View("other", 1280, 960, views[0].ids, 2.0 * views[0].px, 2.0)
    with pytest.raises(CalibrationError, match=r"different sizes: .* 640 x 480, other 1280 x 960"):
        mono.calibrate([*views, other], BOARD)


def test_a_board_never_tilted_is_not_called_good() -> None:
    """Boards parallel to the image leave the focal length open: either refused or not good."""
    rng, views = np.random.default_rng(6), []
    for k in range(12):
        pose = IDENTITY._replace(t=rng.uniform((-0.15, -0.1, 0.45), (-0.05, -0.02, 0.7)))
        views.append(synthetic.seen(CAMERA, pose, BOARD, rng, 0.2, str(k)))
    try:
        result = mono.calibrate(views, BOARD)
    except CalibrationError as error:
        assert "tilt" in str(error)  # noqa: PT017  (either outcome is right)
    else:
        judged = verdict.of_mono(result)
        assert judged.grade is verdict.Grade.REDO
        assert "tilt the board" in judged.text


def test_real_images_are_at_or_below_the_reference(chessboards: Path) -> None:
    """README of the images: 0.195 px left, 0.207 px right, f 532.83 and 537.45 px."""
    for side, reference, f in (("left", 0.195, 532.83), ("right", 0.207, 537.45)):
        views = [find(np.asarray(cv2.imread(str(p))), BOARD, p.name) for p in sorted(chessboards.glob(f"{side}*.jpg"))]
        assert all(isinstance(v, View) for v in views)
        result = mono.calibrate([v for v in views if isinstance(v, View)], BOARD)
        assert 0.1 < result.solution.rms <= reference
        assert 0.1 < result.held_out.rms < 1.2 * reference
        assert result.camera.fx == pytest.approx(f, abs=2.0 * np.sqrt(covariance(result)[0, 0]))
        assert result.spread.max() < 3.0
        assert verdict.of_mono(result).grade is verdict.Grade.GOOD


def test_a_camera_with_its_covariance_is_the_same_camera() -> None:
    known = mono.with_covariance(CAMERA, np.eye(9))
    np.testing.assert_array_equal(parameters(known), parameters(CAMERA))
    assert msgspec.structs.asdict(known)["width"] == 640


def test_board_pose_by_the_homography() -> None:
    board = Board(7, 5, 0.04)
    pose = synthetic.poses([(CAMERA, IDENTITY)], board, 1, np.random.default_rng(8))[0]
    view = synthetic.seen(CAMERA, pose, board, np.random.default_rng(0), 0.0)
    found = mono.board_pose(CAMERA, Seen(board.points, view.px))
    np.testing.assert_allclose(found.R, pose.R, atol=1e-6)
    np.testing.assert_allclose(found.t, pose.t, atol=1e-6)
    assert mono.predicted_rms(CAMERA, view, board) < 1e-6
