from dataclasses import replace

import numpy as np
import pytest

from calib.board.chessboard import Board, View
from calib.cameras.bundle import Pose
from calib.errors import CalibrationError
from calib.inertial import camera_imu, grey_box, imu_report
from calib.inertial.camera_imu import CameraImu, Recording
from calib.report.verdict import Grade
from models import so3
from models.camera import CameraModel
from models.frames import GRAVITY
from models.imu import Coast, constants
from models.messages import Array
from models.state import E, NavState
from tests.boards import motion as synthetic_motion
from tests.boards.motion import EUROC_NOISE, Truth, record
from tests.calib.conftest import BOARD

CAMERA = CameraModel(752, 480, 458.654, 457.296, 367.215, 248.375, (-0.283, 0.074, 2e-4, 1.8e-5))
FORWARD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def truth(seed: int, seconds: float = 15.0, camera_hz: float = 10.0) -> Truth:
    rng = np.random.default_rng(seed)
    R_bc = so3.matrix(so3.quat_exp(rng.normal(0.0, 0.4, 3))) @ FORWARD
    return Truth(R_bc, rng.uniform(-0.1, 0.1, 3), float(rng.uniform(-0.05, 0.05)), seconds, camera_hz=camera_hz)


def error(true: Truth, found: CameraImu) -> Array:
    turn = so3.quat_log(so3.from_matrix(np.ascontiguousarray(true.R_bc @ found.R_bc.T)))
    return np.concatenate((true.p_bc - found.p_bc, turn, [true.time_offset_s - found.time_offset_s]))


def solved(seed: int) -> tuple[Truth, CameraImu]:
    true = truth(seed)
    imu, stamps, views, _ = record(true, CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(seed))
    return true, camera_imu.calibrate(imu, stamps, views, BOARD, CAMERA, EUROC_NOISE)


@pytest.fixture(scope="module")
def runs() -> list[tuple[Truth, CameraImu]]:
    return [solved(seed) for seed in range(3)]


def test_rotation_translation_and_time_offset_come_back(runs: list[tuple[Truth, CameraImu]]) -> None:
    for true, found in runs:
        e = error(true, found)
        assert np.abs(e[:3]).max() < 2e-3
        assert np.rad2deg(np.abs(e[3:6]).max()) < 0.1
        assert abs(e[6]) < 3e-4


def test_errors_are_what_sigma_reports(runs: list[tuple[Truth, CameraImu]]) -> None:
    nees = [e @ np.linalg.solve(found.covariance, e) for true, found in runs for e in [error(true, found)]]
    assert 5.5 < np.sum(nees) < 44.0  # chi-square of 21, 0.05 % beyond each
    for _, found in runs:
        assert 0.85 < found.mean_square < 1.15
        assert found.residual_px == pytest.approx(0.15 * np.sqrt(2.0), rel=0.05)
        assert abs(np.mean(found.innovations[1:] * found.innovations[:-1])) < 0.08  # white


def test_verdict_tables_and_picture(runs: list[tuple[Truth, CameraImu]]) -> None:
    found = runs[0][1]
    assert imu_report.of_camera_imu(found).grade is Grade.USABLE  # fifteen seconds are short
    assert any("time offset" in row[0] for row in imu_report.camera_imu_tables(found)[0][2])
    assert len(imu_report.camera_imu_figure(found).axes) == 4


def test_a_board_that_looks_the_same_upside_down_may_be_read_from_either_end() -> None:
    true, alike, rng = truth(0, 10.0), Board(8, 6, 0.025), np.random.default_rng(0)
    imu, stamps, views, _ = record(true, CAMERA, alike, EUROC_NOISE, rng)
    either = [replace(v, px=v.px[::-1].copy()) if rng.random() < 0.5 else v for v in views]
    found = camera_imu.calibrate(imu, stamps, either, alike, CAMERA, EUROC_NOISE)
    assert found.dropped == 0
    assert np.abs(error(true, found)[:3]).max() < 2e-3


def test_squares_of_another_size_than_configured_are_to_be_done_again() -> None:
    true = truth(1, 10.0)
    imu, stamps, views, _ = record(true, CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(1))
    judged = imu_report.of_camera_imu(camera_imu.calibrate(imu, stamps, views, Board(9, 6, 0.027), CAMERA, EUROC_NOISE))
    assert judged.grade is Grade.REDO
    assert "is --square-mm right" in judged.advice[0]


def test_the_time_offset_is_shutter_minus_stamp() -> None:
    """A stamp 30 ms after the shutter is an offset of -30 ms."""
    true = Truth(FORWARD, np.zeros(3), -0.03, 8.0, camera_hz=10.0)
    imu, stamps, views, motion = record(true, CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(1))
    first = 1e-9 * (stamps[0] - imu.t_ns[0]) - 0.03
    R_oc, p_o = motion.camera(first)
    px = CAMERA.project(Pose(R_oc.T, -R_oc.T @ p_o).of(BOARD.points))
    np.testing.assert_allclose(views[0].px, px, atol=1.0)


def test_the_simulated_imu_leads_along_the_simulated_path() -> None:
    true = Truth(FORWARD, np.array([0.05, 0.02, -0.03]), 0.0)
    motion = synthetic_motion.Motion(true, BOARD, np.random.default_rng(0))
    p, R = motion.body(1.0)
    v = (motion.body(1.0 + 1e-5)[0] - motion.body(1.0 - 1e-5)[0]) / 2e-5
    dt = 1e-3
    for k in range(500):
        rate, force = motion.imu(1.0 + (k + 0.5) * dt)
        half = R @ so3.matrix(so3.quat_exp(0.5 * dt * rate))
        a = half @ force + np.array([0.0, 0.0, GRAVITY])
        p, v, R = p + dt * v + 0.5 * dt * dt * a, v + dt * a, R @ so3.matrix(so3.quat_exp(dt * rate))
    np.testing.assert_allclose(p, motion.body(1.5)[0], atol=1e-4)
    np.testing.assert_allclose(R, motion.body(1.5)[1], atol=1e-4)


def test_the_filters_derivatives_are_those_of_its_residual() -> None:
    """One image at once after a state known to be off: the update must undo the error, first order."""
    rng = np.random.default_rng(4)
    R_bc, p_bc, R_no = (so3.matrix(so3.quat_exp(rng.normal(0.0, 0.8, 3))) for _ in range(3))
    p_bc = rng.normal(0.0, 0.1, 3)
    R_nb, p_n = so3.matrix(so3.quat_exp(rng.normal(0.0, 0.8, 3))), rng.normal(0.0, 1.0, 3)
    R_nc, p_nc = R_nb @ R_bc, p_n + R_nb @ p_bc
    t_ns = np.array([0, 5_000_000], dtype=np.int64)
    u = np.tile(np.concatenate((np.zeros(3), R_nb.T @ np.array([0.0, 0.0, -GRAVITY]))), (2, 1))
    off = np.concatenate((rng.normal(0.0, 1e-4, 3), np.zeros(3), rng.normal(0.0, 1e-4, 3)))
    q_off = so3.from_matrix(np.ascontiguousarray(R_nb @ so3.matrix(so3.quat_exp(-off[6:9]))))
    wrong = NavState(p_n - off[:3], np.zeros(3), q_off, np.zeros(3), np.zeros(3)).pack()
    P = np.diag(np.repeat([1e-4, 1e-12, 1e-4, 1e-12, 1e-12], 3))
    e = grey_box.innovations(
        wrong, P, 0, t_ns, u, np.array([1_000], dtype=np.int64), (R_nc.T @ R_no)[None], (-R_nc.T @ p_nc)[None],
        1e-12 * np.eye(6)[None], R_no, R_bc, p_bc, constants(EUROC_NOISE, Coast(), None),
    )  # fmt: skip
    assert np.isfinite(e).all()
    state = NavState.unpack(wrong)
    np.testing.assert_allclose(state.p_n, p_n, atol=2e-6)
    np.testing.assert_allclose(state.R_nb, R_nb, atol=2e-6)
    assert P[E.P, E.P].max() < 1e-10


def test_motion_without_information_is_refused_with_what_to_do() -> None:
    board_only = Truth(FORWARD, np.zeros(3), 0.0, 12.0, camera_hz=10.0, turn_rad=0.0, move_m=0.05)
    imu, stamps, views, _ = record(board_only, CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(0))
    with pytest.raises(CalibrationError, match="hardly turned: turn it about all three axes"):
        camera_imu.calibrate(imu, stamps, views, BOARD, CAMERA, EUROC_NOISE)
    one_axis = Recording(
        imu.t_ns, imu.gyro * 0.02 + np.sin(1e-9 * (imu.t_ns - imu.t_ns[0]))[:, None] * [0.0, 0.0, 1.0], imu.accel
    )
    with pytest.raises(CalibrationError, match="one axis only"):
        camera_imu.calibrate(one_axis, stamps, views, BOARD, CAMERA, EUROC_NOISE)
    with pytest.raises(CalibrationError, match="10 images show the board"):
        camera_imu.calibrate(imu, stamps[:10], views[:10], BOARD, CAMERA, EUROC_NOISE)


def test_images_with_corners_confused_are_left_out() -> None:
    true = truth(3, 10.0)
    imu, stamps, views, _ = record(true, CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(3))
    confused = list(views)
    for k in (5, 20):
        v = views[k]
        confused[k] = View(v.name, v.width, v.height, v.ids, np.roll(v.px, 1, axis=0), v.edge_px)
    found = camera_imu.calibrate(imu, stamps, confused, BOARD, CAMERA, EUROC_NOISE)
    assert found.dropped == 2
    assert np.abs(error(true, found)[:3]).max() < 2e-3


def test_another_recordings_imu_is_refused() -> None:
    imu, stamps, views, _ = record(truth(0, 12.0), CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(0))
    other, _, _, _ = record(truth(1, 12.0), CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(77))
    with pytest.raises(CalibrationError, match="do not turn alike"):
        camera_imu.calibrate(Recording(imu.t_ns, other.gyro, other.accel), stamps, views, BOARD, CAMERA, EUROC_NOISE)


def test_a_lens_known_badly_makes_the_extrinsics_known_badly() -> None:
    imu, stamps, views, _ = record(truth(2, 10.0), CAMERA, BOARD, EUROC_NOISE, np.random.default_rng(2))
    lens = np.diag([4.0, 4.0, 9.0, 9.0, 0.0, 0.0, 0.0, 0.0])  # 2 px of focal length, 3 px of principal point
    camera = CameraModel(752, 480, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, CAMERA.distortion, lens)
    exact, rough = (camera_imu.calibrate(imu, stamps, views, BOARD, c, EUROC_NOISE) for c in (CAMERA, camera))
    turn = np.sqrt(np.diagonal(rough.covariance)[3:6]).max()
    assert turn > 2.0 * np.sqrt(np.diagonal(exact.covariance)[3:6]).max()
    assert turn < 3.0 * 3.0 / 458.0
