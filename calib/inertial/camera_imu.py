"""Camera on an IMU from a moving recording of a fixed board.

    min sum_k e_k^T e_k over (p_bc, R_bc, time offset, tilt of the board, gravity)    (Hol 2010)

e: normalised innovations (grey_box.py). Covariance: (J^T J)^-1 max(1, mean e^2), plus the camera's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calib.board.chessboard import Board, View
from calib.cameras.board_poses import BoardPoses, board_poses, read_from_one_end
from calib.cameras.bundle import rotation_vector
from calib.errors import CalibrationError
from calib.inertial import grey_box
from calib.inertial.imu import check
from models import so3
from models.camera import CameraModel
from models.imu import Coast, ImuNoise, constants
from models.messages import Array
from models.state import E, NavState

Times = NDArray[np.int64]

_POSITION, _ROTATION, _OFFSET, _TILT, _GRAVITY = slice(0, 3), slice(3, 6), 6, slice(7, 9), 9
_SIZE: Final = 10
_STEP: Final = np.array([1e-4] * 3 + [1e-5] * 3 + [2e-5] + [1e-5] * 2 + [1e-3])  # m, rad, s, rad, m/s^2: for derivatives
_GRAVITY_SIGMA: Final = 0.03  # m/s^2, over the Earth
_ITERATIONS: Final = 12
_FEWEST: Final = 50  # images
_LONGEST_OFFSET_S: Final = 0.5
_STILL_RAD_S: Final = 0.05
_OTHER_AXIS_RAD_S: Final = 0.05  # scatter of the rate about the second axis
_OUTLIER: Final = 35.0  # e^T e of one image, 6 degrees of freedom: 4e-6 by chance


@dataclass(frozen=True)
class CameraImu:
    """x_b = R_bc @ x_c + p_bc, time_offset_s (shutter minus stamp); covariance (7, 7), x y z rx ry rz about b, offset.
    innovations (M, 6), normalised; used: images.
    """

    R_bc: Array
    p_bc: Array
    time_offset_s: float
    covariance: Array
    innovations: Array
    t_s: Array
    rotation_only_deg: float  # between the first guess from rates alone and the result
    mean_square: float
    residual_px: float
    dropped: int

    @property
    def images(self) -> int:
        """How many were used: the first has no innovation."""
        return len(self.innovations) + 1


@dataclass(frozen=True)
class Recording:
    """IMU samples in body axes: t_ns (K,), gyro [rad/s] and accel [m/s^2] (K, 3)."""

    t_ns: Times
    gyro: Array
    accel: Array


def calibrate(
    imu: Recording, stamps_ns: Times, views: Sequence[View], board: Board, camera: CameraModel, noise: ImuNoise,
    progress: Callable[[float], None] | None = None,
) -> CameraImu:  # fmt: skip
    """Extrinsics from views of a fixed board, stamped in IMU time. Raises CalibrationError."""
    report = progress or (lambda _: None)
    check(imu.t_ns, imu.gyro, imu.accel)
    inside = (stamps_ns > imu.t_ns[0] + 6e8) & (stamps_ns < imu.t_ns[-1] - 6e8)
    if int(inside.sum()) < _FEWEST:
        raise CalibrationError(
            f"{int(inside.sum())} images show the board while the IMU ran; {_FEWEST} are the least, a minute at 20 Hz is good"
        )
    order = np.flatnonzero(inside)[np.argsort(stamps_ns[inside], kind="stable")]
    one_board = read_from_one_end([views[i] for i in order], board)
    poses, fits = board_poses(one_board, board, camera, lambda f: report(0.6 * f))
    problem = _Problem(imu, stamps_ns[order][fits], poses, noise)
    theta, J, e = _minimise(problem, lambda f: report(0.6 + 0.2 * f))
    good = np.sum(e[:-1].reshape(-1, 6) ** 2, axis=1) <= _OUTLIER * max(1.0, float(np.median(e[:-1] ** 2)) / 0.455)
    if not good.all():
        problem = problem.without(~good)
        theta, J, e = _minimise(problem, lambda f: report(0.8 + 0.15 * f), theta)
    covariance, mean_square = _covariance(problem, theta, J, e)
    report(1.0)
    R_bc = problem.R_bc(theta)
    turn = rotation_vector(problem.R_bc0.T @ R_bc)
    return CameraImu(
        R_bc, theta[_POSITION].copy(), problem.offset0 + float(theta[_OFFSET]), covariance[:7, :7], e[:-1].reshape(-1, 6),
        1e-9 * (problem.stamps_ns[1:] - problem.stamps_ns[0]), float(np.rad2deg(np.linalg.norm(turn))), mean_square,
        float(poses.sigma_px * np.sqrt(2.0)), int(np.sum(~good)) + len(order) - len(fits),
    )  # fmt: skip


class _Problem:
    def __init__(self, imu: Recording, stamps_ns: Times, poses: BoardPoses, noise: ImuNoise) -> None:
        self.imu, self.stamps_ns, self.poses, self.noise = imu, stamps_ns, poses, noise
        self.u = np.hstack((imu.gyro, imu.accel))
        self.R_bc0, self.offset0 = first_rotation(imu, stamps_ns, poses)
        self.R_no0 = self._level()

    def without(self, bad: NDArray[np.bool_]) -> "_Problem":
        kept = np.concatenate(([True], ~bad))
        fewer = object.__new__(_Problem)
        fewer.__dict__.update(self.__dict__)
        fewer.stamps_ns, fewer.poses = self.stamps_ns[kept], self.poses.only(kept)
        return fewer

    def R_bc(self, theta: Array) -> Array:
        return np.asarray(so3.matrix(so3.quat_exp(theta[_ROTATION].copy())) @ self.R_bc0)

    def residuals(self, theta: Array, poses: BoardPoses | None = None) -> Array:
        poses = poses or self.poses
        R_bc, p_bc = self.R_bc(theta), theta[_POSITION].copy()
        R_no = so3.matrix(so3.quat_exp(np.append(theta[_TILT], 0.0))) @ self.R_no0
        shutter = self.stamps_ns + np.int64(round(1e9 * (self.offset0 + float(theta[_OFFSET]))))
        x, P = self._first_state(poses, R_no, R_bc, p_bc)
        c = constants(self.noise, Coast(), None)
        c[0] += theta[_GRAVITY]
        e = grey_box.innovations(
            x, P, int(shutter[0]), self.imu.t_ns, self.u, shutter[1:], poses.R_co[1:], poses.t_co[1:], poses.covariance[1:],
            R_no, R_bc, p_bc, c,
        )  # fmt: skip
        return np.append(e.ravel(), theta[_GRAVITY] / _GRAVITY_SIGMA)

    def _first_state(self, poses: BoardPoses, R_no: Array, R_bc: Array, p_bc: Array) -> tuple[Array, Array]:
        few = min(6, len(self.stamps_ns))
        R_nb = [R_no @ poses.R_co[k].T @ R_bc.T for k in range(few)]
        p_n = np.array([-R_no @ poses.R_co[k].T @ poses.t_co[k] - R_nb[k] @ p_bc for k in range(few)])
        t = 1e-9 * (self.stamps_ns[:few] - self.stamps_ns[0])
        v_n = np.polyfit(t, p_n, 1)[0]
        state = NavState(p_n[0], v_n, so3.from_matrix(np.ascontiguousarray(R_nb[0])), np.zeros(3), np.zeros(3))
        P = np.zeros((E.SIZE, E.SIZE))
        sigma = np.sqrt(np.diagonal(poses.covariance[0]))
        for part, value in (
            (E.P, 3.0 * sigma[:3].max() + 1e-3),
            (E.V, 0.5),
            (E.THETA, 3.0 * sigma[3:].max() + 1e-3),
            (E.BG, 0.1),
            (E.BA, 0.5),
        ):
            P[part, part] = value**2 * np.eye(3)
        return state.pack(), P

    def _level(self) -> Array:
        at = self.stamps_ns + np.int64(round(1e9 * self.offset0))
        f = np.column_stack([np.interp(at, self.imu.t_ns, a) for a in self.imu.accel.T])
        up = np.mean([R.T @ self.R_bc0.T @ a for R, a in zip(self.poses.R_co, f, strict=True)], axis=0)
        up /= np.linalg.norm(up)
        side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        side /= np.linalg.norm(side)
        return np.stack((side, np.cross(-up, side), -up))


def first_rotation(imu: Recording, stamps_ns: Times, poses: BoardPoses) -> tuple[Array, float]:
    """R_bc and offset from gyro = R_bc @ camera rate + bias. Raises CalibrationError."""
    dt = 1e-9 * np.diff(stamps_ns)
    near = dt < 3.0 * np.median(dt)
    turns = [rotation_vector(a @ b.T) for a, b in zip(poses.R_co[:-1], poses.R_co[1:], strict=True)]
    rate_c = (np.array(turns) / dt[:, None])[near]
    begin, end = stamps_ns[:-1][near], stamps_ns[1:][near]
    angle = np.vstack((np.zeros(3), np.cumsum(0.5e-9 * np.diff(imu.t_ns)[:, None] * (imu.gyro[1:] + imu.gyro[:-1]), axis=0)))

    def mean_rate(offset_s: float) -> Array:
        shift = 1e9 * offset_s
        ends = [np.column_stack([np.interp(t + shift, imu.t_ns, a) for a in angle.T]) for t in (begin, end)]
        return np.asarray((ends[1] - ends[0]) / dt[near][:, None])

    _check_turned(mean_rate(0.0))
    step, best = 0.02, 0.0
    offsets = np.arange(-_LONGEST_OFFSET_S, _LONGEST_OFFSET_S + step / 2, step)
    while step > 5e-4:
        best = float(min(offsets, key=lambda o: _turn_between(mean_rate(o), rate_c)[0]))
        step /= 5.0
        offsets = best + step * np.arange(-6, 7)
    scatter, R_bc = _turn_between(mean_rate(best), rate_c)
    if scatter > 0.3 * float(np.median(np.sum((rate_c - np.median(rate_c, axis=0)) ** 2, axis=1))):
        raise CalibrationError(
            "gyroscope and camera do not turn alike at any offset up to 0.5 s: the right topics, gyroscope in rad/s?"
        )
    return R_bc, best


def _check_turned(rate_b: Array) -> None:
    spread = np.sqrt(np.sort(np.linalg.eigvalsh(np.cov(rate_b.T)))[::-1])
    if spread[0] < _STILL_RAD_S:
        raise CalibrationError("the camera hardly turned: turn it about all three axes, briskly, for a minute, board in view")
    if spread[1] < _OTHER_AXIS_RAD_S:
        raise CalibrationError("the camera turned about one axis only: turn it about all three, the translation needs it")


def _turn_between(a: Array, b: Array) -> tuple[float, Array]:
    """R, biases removed, and median square of a - R b (Kabsch 1976)."""
    a, b = a - np.median(a, axis=0), b - np.median(b, axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return float(np.median(np.sum((a - b @ R.T) ** 2, axis=1))), R


def _minimise(problem: _Problem, progress: Callable[[float], None], start: Array | None = None) -> tuple[Array, Array, Array]:
    theta = np.zeros(_SIZE) if start is None else start
    e = problem.residuals(theta)
    if not np.isfinite(e).all():
        raise CalibrationError("the filter failed on this recording: are the IMU's axes and units those of the configuration?")
    for k in range(_ITERATIONS):
        J = _jacobian(problem, theta)
        step = -_STEP * np.linalg.lstsq(J * _STEP, e, rcond=1e-12)[0]  # in units of about equal effect
        factor = 1.0
        while factor > 1e-3:
            trial = problem.residuals(theta + factor * step)
            if np.isfinite(trial).all() and trial @ trial < e @ e:
                break
            factor *= 0.5
        else:
            break
        done = e @ e - trial @ trial < 1e-7 * (e @ e)
        theta, e = theta + factor * step, trial
        progress((k + 1) / _ITERATIONS)
        if done:
            break
    return theta, _jacobian(problem, theta), e


def _jacobian(problem: _Problem, theta: Array) -> Array:
    columns = []
    for k, h in enumerate(_STEP):
        d = np.zeros(_SIZE)
        d[k] = h
        columns.append((problem.residuals(theta + d) - problem.residuals(theta - d)) / (2.0 * h))
    return np.column_stack(columns)


def _covariance(problem: _Problem, theta: Array, J: Array, e: Array) -> tuple[Array, float]:
    scale = np.linalg.norm(J, axis=0)
    inverse = np.linalg.pinv((J / scale).T @ (J / scale), hermitian=True) / np.outer(scale, scale)
    mean_square = float(e @ e) / (len(e) - _SIZE)
    C = max(1.0, mean_square) * inverse
    lens = problem.poses.lens_covariance
    if lens is not None:
        # What an error of one sigma along each axis of the lens' covariance does to the measured poses, and they to theta.
        values, axes = np.linalg.eigh(lens)
        for value, axis in zip(values, axes.T, strict=True):
            if value > 0.0:
                moved = problem.poses.shifted(np.sqrt(value) * axis)
                back = problem.poses.shifted(-np.sqrt(value) * axis)
                d = inverse @ (J.T @ (0.5 * (problem.residuals(theta, moved) - problem.residuals(theta, back))))
                C += np.outer(d, d)
    return C, mean_square
