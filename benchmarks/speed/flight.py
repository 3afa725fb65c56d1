"""A made-up flight for timing: level circles, 200 Hz IMU with noise, pose fixes at any rate. No data needed.

p = r (cos wt, sin wt, 0),  yaw = wt + 90 degrees,  a_b = (0, v^2 / r, -g),  gyro_b = (0, 0, w)
"""

import math

import numpy as np

from models import so3
from models.frames import GRAVITY
from models.imu import ImuNoise
from models.messages import ImuSample, PoseFix, vec3

NOISE = ImuNoise(7e-4, 4e-2, 1e-4, 1e-3)  # as used for the EuRoC flights
RATE_HZ = 200
PERIOD_NS = 1_000_000_000 // RATE_HZ
RADIUS_M, SPEED_M_S = 5.0, 2.0
SIGMA_M, SIGMA_RAD = 0.15, math.radians(1.0)
COVARIANCE = np.diag([SIGMA_M**2] * 3 + [SIGMA_RAD**2] * 3)


def imu_samples(seconds: float, seed: int = 0) -> list[ImuSample]:
    """Samples from t = 0 on, each arriving at its own time."""
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE_HZ)
    gyro = np.array([0.0, 0.0, SPEED_M_S / RADIUS_M]) + NOISE.gyro_noise * math.sqrt(RATE_HZ) * rng.standard_normal((n, 3))
    accel = np.array([0.0, SPEED_M_S**2 / RADIUS_M, -GRAVITY]) + NOISE.accel_noise * math.sqrt(RATE_HZ) * rng.standard_normal(
        (n, 3)
    )
    return [ImuSample(k * PERIOD_NS, k * PERIOD_NS, vec3(gyro[k]), vec3(accel[k])) for k in range(n)]


def pose_fixes(seconds: float, rate_hz: float, delay_s: float = 0.0, seed: int = 1) -> list[PoseFix]:
    """Fixes between IMU samples (so that each splits a step), delay_s late."""
    rng = np.random.default_rng(seed)
    fixes = []
    for k in range(round(seconds * rate_hz)):
        t_ns = round(k * 1e9 / rate_hz) // PERIOD_NS * PERIOD_NS + PERIOD_NS // 3
        angle = SPEED_M_S / RADIUS_M * t_ns * 1e-9
        p_n = RADIUS_M * np.array([math.cos(angle), math.sin(angle), 0.0]) + SIGMA_M * rng.standard_normal(3)
        q = so3.multiply(so3.quat_exp(SIGMA_RAD * rng.standard_normal(3)), so3.from_euler(0.0, 0.0, angle + math.pi / 2))
        wxyz = (float(q[0]), float(q[1]), float(q[2]), float(q[3]))
        fixes.append(PoseFix(t_ns, t_ns + round(delay_s * 1e9), vec3(p_n), wxyz, COVARIANCE))
    return fixes
