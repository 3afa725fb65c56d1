"""The filter a user would start with: a strapdown error-state EKF of 15 states in plain numpy on filterpy.

    p' = v,  v' = R_nb (a - b_a) + g_n,  R_nb' = R_nb [w - b_g]x,  b' = noise          (Sola 2017, eq. 236, 238)

The estimator's models, frames and noise, without rewind, gate and reset Jacobian: the baseline of speed and accuracy.
"""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.spatial.transform import Rotation

from models.imu import ImuNoise
from models.messages import Array, Estimate, GnssVelocity, ImuSample, Input, LandmarkFix, Mode, PoseFix, vec3
from models.state import E, NavState

GRAVITY_N = np.array([0.0, 0.0, 9.80665])  # m/s^2
NOT_GIVEN_P, NOT_GIVEN_A = 9e4, 10.0  # m^2, rad^2: variances from which a component counts as not given

# What is not known at the first fix, 1 sigma: velocity [m/s], gyro bias [rad/s], accelerometer bias [m/s^2].
START_V, START_BG, START_BA = 3.0, 0.05, 0.3


def skew(v: Array) -> Array:
    """[v]x with [v]x w = v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def exp(r: Array) -> Array:
    """Rotation matrix of a rotation vector [rad] (Rodrigues; Sola 2017, eq. 77)."""
    angle = np.sqrt(r @ r)
    if angle < 1e-9:
        return np.eye(3) + skew(r)
    k = skew(r / angle)
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


class NaiveFilter:
    """Starts at the first pose fix. `handle` takes messages as they arrive; others than IMU, pose and velocity are ignored."""

    def __init__(self, noise: ImuNoise) -> None:
        self._noise = noise
        self._ekf = ExtendedKalmanFilter(dim_x=E.SIZE, dim_z=6)
        self._ekf.x = np.zeros(E.SIZE)  # the error state: zero except inside an update
        self._t_ns: int | None = None
        self._gyro = self._accel = np.zeros(3)  # the last sample
        self._p, self._v, self._R = np.zeros(3), np.zeros(3), np.eye(3)
        self._bg, self._ba = np.zeros(3), np.zeros(3)

    @property
    def started(self) -> bool:
        """Whether there was a pose fix to start from."""
        return self._t_ns is not None

    def handle(self, message: Input) -> None:
        """Take one message, in the order of arrival."""
        if isinstance(message, ImuSample):
            self.predict(message.t_ns, np.array(message.gyro_b), np.array(message.accel_b))
        elif isinstance(message, PoseFix | LandmarkFix):
            self.fuse_pose(message)
        elif isinstance(message, GnssVelocity) and message.covariance_n is not None:
            self.fuse_velocity(message)

    def predict(self, t_ns: int, gyro: Array, accel: Array) -> None:
        """Strapdown step to t_ns with the mean of the last sample and this one.

        F = | I  I dt  0              0      0     |
            | 0  I    -R [a]x dt      0     -R dt  |
            | 0  0     exp(-w dt)    -I dt   0     |
            | 0  0     0              I      0     |
            | 0  0     0              0      I     |                          (Sola 2017, eq. 269)
        """
        w, a = 0.5 * (self._gyro + gyro) - self._bg, 0.5 * (self._accel + accel) - self._ba
        self._gyro, self._accel = gyro, accel
        if self._t_ns is None or t_ns <= self._t_ns:
            return
        dt, n = (t_ns - self._t_ns) * 1e-9, self._noise
        half_turn = exp(0.5 * w * dt)
        turn = half_turn @ half_turn
        F = np.eye(E.SIZE)
        F[E.P, E.V] = np.eye(3) * dt
        F[E.V, E.THETA] = -self._R @ skew(a) * dt
        F[E.V, E.BA] = -self._R * dt
        F[E.THETA, E.THETA] = turn.T
        F[E.THETA, E.BG] = -np.eye(3) * dt
        variances = np.zeros(E.SIZE)
        variances[E.V], variances[E.THETA] = n.accel_noise**2 * dt, n.gyro_noise**2 * dt
        variances[E.BG], variances[E.BA] = n.gyro_walk**2 * dt, n.accel_walk**2 * dt
        self._ekf.F, self._ekf.Q = F, np.diag(variances)
        self._ekf.predict()
        a_n = self._R @ half_turn @ a + GRAVITY_N
        self._p = self._p + self._v * dt + 0.5 * a_n * dt**2
        self._v = self._v + a_n * dt
        self._R = self._R @ turn
        self._t_ns = t_ns

    def fuse_pose(self, fix: PoseFix | LandmarkFix) -> None:
        """Position and attitude, or position alone where the attitude's variance says "not given".

        z = (p_fix - p, log(R^T R_fix)),   H dx = (dp, theta)
        """
        R_fix = Rotation.from_quat(fix.q_nb_wxyz, scalar_first=True).as_matrix()
        given = np.diag(fix.covariance) < np.repeat([NOT_GIVEN_P, NOT_GIVEN_A], 3)
        if self._t_ns is None:
            if given.all():
                self._start(fix.t_ns, np.array(fix.p_n), R_fix, fix.covariance)
            return
        if fix.t_ns > self._t_ns:
            self.predict(fix.t_ns, self._gyro, self._accel)
        z = np.concatenate([np.array(fix.p_n) - self._p, Rotation.from_matrix(self._R.T @ R_fix).as_rotvec()])
        H = np.zeros((6, E.SIZE))
        H[:3, E.P] = H[3:, E.THETA] = np.eye(3)
        to_body = np.eye(6)
        to_body[3:, 3:] = self._R.T  # the fix' attitude error is about the axes of n
        noise = to_body @ fix.covariance @ to_body.T
        rows = np.arange(6) if given.all() else np.arange(3)
        self._update(z[rows], H[rows], noise[np.ix_(rows, rows)])

    def fuse_velocity(self, fix: GnssVelocity) -> None:
        """z = v_fix - v, H dx = dv."""
        if not self.started:
            return
        H = np.zeros((3, E.SIZE))
        H[:, E.V] = np.eye(3)
        assert fix.covariance_n is not None  # handle looked
        self._update(np.array(fix.v_n) - self._v, H, fix.covariance_n)

    def estimate(self, arrived_ns: int) -> Estimate:
        """The state now, as the estimator would publish it."""
        assert self._t_ns is not None  # callers ask `started` first
        q = Rotation.from_matrix(self._R).as_quat(scalar_first=True)
        nav = NavState(self._p, self._v, q, self._bg, self._ba).pack()
        rate = vec3(self._gyro - self._bg)
        return Estimate(self._t_ns, arrived_ns, nav, self._ekf.P.copy(), rate, Mode.AIDED, 0, self._t_ns)

    def _start(self, t_ns: int, p_n: Array, R_nb: Array, covariance: Array) -> None:
        self._t_ns, self._p, self._R = t_ns, p_n, R_nb
        P = np.zeros((E.SIZE, E.SIZE))
        P[E.P, E.P], P[E.THETA, E.THETA] = covariance[:3, :3], R_nb.T @ covariance[3:, 3:] @ R_nb
        P[E.V, E.V], P[E.BG, E.BG], P[E.BA, E.BA] = (np.eye(3) * s**2 for s in (START_V, START_BG, START_BA))
        self._ekf.P = P

    def _update(self, z: Array, H: Array, noise: Array) -> None:
        """Kalman update of the error, which then moves into the nominal state."""
        self._ekf.update(z, lambda _: H, lambda x: H @ x, R=noise)
        dx = self._ekf.x
        self._p, self._v, self._R = self._p + dx[E.P], self._v + dx[E.V], self._R @ exp(dx[E.THETA])
        self._bg, self._ba = self._bg + dx[E.BG], self._ba + dx[E.BA]
        self._ekf.x = np.zeros(E.SIZE)
