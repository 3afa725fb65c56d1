"""The IMU: true specific force and rate, errors of a grade (Groves 2013, eq. 5.28, 5.44).

f_b     = R_nb^T (a_n + 2 w_ie x v_n - g_n(p))          w_ie: Earth rate, 0 without an origin
omega_b = omega_nb + R_nb^T w_ie
y_k     = M x_k + b_k + n_k,   n_k ~ N(0, density^2 / dt),   b_{k+1} = b_k + N(0, walk^2 dt)
"""

import math
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np
import pymap3d

from models.frames import GRAVITY, Origin, normal_gravity
from models.imu import ImuNoise
from models.messages import Array
from models.sim.ranges import NotNegative, Positive, Rate
from models.sim.trajectory import Motion

_WALK_TIME_S = 100.0  # a bias wanders by the grade's bias instability in this time
_MILLI_G = 1e-3 * GRAVITY


@dataclass(frozen=True, slots=True)
class Grade:
    """An instrument class: noise, and sigmas of the turn-on bias (rad/s, m/s^2)."""

    noise: ImuNoise
    gyro_turn_on: float
    accel_turn_on: float


def _grade(arw: float, gyro_bi: float, vrw: float, accel_bi: float, gyro_turn_on: float, accel_turn_on: float) -> Grade:
    """From deg/sqrt(h), deg/h, m/s/sqrt(h), milli-g; turn-on deg/s, milli-g."""
    noise = ImuNoise(
        gyro_noise=math.radians(arw) / 60.0,
        accel_noise=vrw / 60.0,
        gyro_walk=math.radians(gyro_bi) / 3600.0 / math.sqrt(_WALK_TIME_S),
        accel_walk=accel_bi * _MILLI_G / math.sqrt(_WALK_TIME_S),
        gyro_scale=0.0,  # a calibrated one; `Imu.scale_sigma` and `misalignment_deg` are added to it
    )
    return Grade(noise, math.radians(gyro_turn_on), accel_turn_on * _MILLI_G)


GRADES = {
    "hobby": _grade(0.30, 25.0, 0.24, 0.15, 0.5, 40.0),  # MPU-6000 class
    "flight_controller": _grade(0.17, 6.0, 0.10, 0.06, 0.2, 20.0),  # BMI088, ICM-42688 class
    "industrial": _grade(0.30, 8.0, 0.04, 0.02, 0.1, 5.0),  # ADIS16470, VN-100 class
    "tactical": _grade(0.15, 0.5, 0.03, 0.05, 0.003, 2.0),  # STIM300, HG4930 class
}


class Imu(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An IMU of a grade; the second group is unknown to the filter.

    turn_on: factor on the bias; misalignment_deg: of each axis; *_step: quantisation; *_limit: saturation.
    """

    grade: Literal["hobby", "flight_controller", "industrial", "tactical"] = "flight_controller"
    rate_hz: Rate = 200.0
    turn_on: NotNegative = 1.0
    delay_s: NotNegative = 0.0

    noise_multiplier: NotNegative = 1.0
    scale_sigma: NotNegative = 0.0
    misalignment_deg: NotNegative = 0.0
    gyro_step_rad_s: NotNegative = 0.0
    accel_step_m_s2: NotNegative = 0.0
    gyro_limit_rad_s: Positive | None = None
    accel_limit_m_s2: Positive | None = None


@dataclass(frozen=True, slots=True)
class ImuRecord:
    """Measured and true (n, 3): rad/s, m/s^2; y = x + bias + noise without mismatch."""

    gyro_b: Array
    accel_b: Array
    true_gyro_b: Array
    true_accel_b: Array
    gyro_bias: Array
    accel_bias: Array


def gravity_n(p_n: Array, origin: Origin | None) -> Array:
    """Gravity (n, 3) [m/s^2] at p_n (n, 3), g(lat, h) * down(lat, lon); standard without origin."""
    if origin is None:
        return np.broadcast_to([0.0, 0.0, GRAVITY], p_n.shape)
    lat, lon, alt = pymap3d.ned2geodetic(*p_n.T, origin.lat_deg, origin.lon_deg, origin.alt_m, deg=True)
    phi, lam = np.radians(lat), np.radians(lon)
    down_e = (-np.cos(phi) * np.cos(lam), -np.cos(phi) * np.sin(lam), -np.sin(phi))
    east, north, up = pymap3d.uvw2enu(*down_e, origin.lat_deg, origin.lon_deg)
    size = np.vectorize(normal_gravity, otypes=[float])(phi, alt)
    g_n: Array = np.column_stack([north, east, -up]) * size[:, None]
    return g_n


def feel(motion: Motion, origin: Origin | None) -> tuple[Array, Array]:
    """omega_b (rad/s), f_b (m/s^2), (n, 3), of a perfect IMU."""
    earth_rate = origin.earth_rate_n if origin else np.zeros(3)
    f_n = motion.a_n + 2.0 * np.cross(earth_rate, motion.v_n) - gravity_n(motion.p_n, origin)
    return motion.omega_b + earth_rate @ motion.R_nb, np.einsum("kij,ki->kj", motion.R_nb, f_n)


def measure(imu: Imu, motion: Motion, origin: Origin | None, dt: float, rng: np.random.Generator) -> ImuRecord:
    """Record of an IMU sampling this motion every dt seconds."""
    grade, noise = GRADES[imu.grade], GRADES[imu.grade].noise
    gyro, accel = feel(motion, origin)
    gyro_bias = _walk(grade.gyro_turn_on * imu.turn_on, noise.gyro_walk, len(gyro), dt, rng)
    accel_bias = _walk(grade.accel_turn_on * imu.turn_on, noise.accel_walk, len(accel), dt, rng)
    white = imu.noise_multiplier / math.sqrt(dt)
    gyro_y = gyro @ _distortion(imu, rng).T + gyro_bias + noise.gyro_noise * white * rng.standard_normal(gyro.shape)
    accel_y = accel @ _distortion(imu, rng).T + accel_bias + noise.accel_noise * white * rng.standard_normal(accel.shape)
    return ImuRecord(
        gyro_b=_digitise(gyro_y, imu.gyro_step_rad_s, imu.gyro_limit_rad_s),
        accel_b=_digitise(accel_y, imu.accel_step_m_s2, imu.accel_limit_m_s2),
        true_gyro_b=gyro,
        true_accel_b=accel,
        gyro_bias=gyro_bias,
        accel_bias=accel_bias,
    )


def _walk(turn_on: float, walk: float, n: int, dt: float, rng: np.random.Generator) -> Array:
    steps = walk * math.sqrt(dt) * rng.standard_normal((n, 3))
    steps[0] = turn_on * rng.standard_normal(3)
    return np.cumsum(steps, axis=0)


def _distortion(imu: Imu, rng: np.random.Generator) -> Array:
    """M (3, 3) = I + scale errors + cross-axis couplings."""
    M = math.radians(imu.misalignment_deg) * rng.standard_normal((3, 3))
    M[np.diag_indices(3)] = 1.0 + imu.scale_sigma * rng.standard_normal(3)
    return M


def _digitise(y: Array, step: float, limit: float | None) -> Array:
    if limit is not None:
        y = np.clip(y, -limit, limit)
    return np.round(y / step) * step if step else y
