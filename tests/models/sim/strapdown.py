"""A strapdown integrator of the tests' own, to judge simulated IMU samples by: fourth-order Runge-Kutta over pairs of samples.

p' = v,   v' = R f + g(p) - 2 w_ie x v,   R' = R [omega]x - [w_ie]x R
"""

from collections.abc import Callable

import numpy as np

from models import so3
from models.frames import GRAVITY, Origin
from models.messages import Array

Gravity = Callable[[Array], Array]
Pose = tuple[Array, Array, Array]  # p_n, v_n, R_nb


def local_gravity(origin: Origin | None) -> Gravity:
    """Gravity of the osculating ellipsoid, to first order in the distance from the origin."""
    if origin is None:
        return lambda _: np.array([0.0, 0.0, GRAVITY])
    e2, s2 = 6.69437999014e-3, np.sin(np.radians(origin.lat_deg)) ** 2
    east = 6378137.0 / np.sqrt(1 - e2 * s2) + origin.alt_m
    north = 6378137.0 * (1 - e2) / (1 - e2 * s2) ** 1.5 + origin.alt_m
    g, by_latitude = origin.gravity, 0.0519 * np.sin(2 * np.radians(origin.lat_deg)) / 6.37e6
    return lambda p_n: np.array(
        [-g * p_n[0] / north, -g * p_n[1] / east, g * (1 + 2 * p_n[2] / 6378137.0) + by_latitude * p_n[0]]
    )


def integrate(start: Pose, gyro_b: Array, accel_b: Array, dt: float, origin: Origin | None) -> Pose:
    """The pose after samples (n, 3), n odd, taken every dt seconds."""
    gravity, turn = local_gravity(origin), so3.skew(origin.earth_rate_n if origin else np.zeros(3))

    def slope(x: Pose, k: int) -> Pose:
        p, v, R = x
        return v, R @ accel_b[k] + gravity(p) - 2 * turn @ v, R @ so3.skew(gyro_b[k]) - turn @ R

    def moved(x: Pose, d: Pose, h: float) -> Pose:
        return x[0] + h * d[0], x[1] + h * d[1], x[2] + h * d[2]

    x, h = start, 2 * dt
    for k in range(0, len(gyro_b) - 2, 2):
        k1 = slope(x, k)
        k2 = slope(moved(x, k1, h / 2), k + 1)
        k3 = slope(moved(x, k2, h / 2), k + 1)
        k4 = slope(moved(x, k3, h), k + 2)
        for d, weight in ((k1, 1), (k2, 2), (k3, 2), (k4, 1)):
            x = moved(x, d, h / 6 * weight)
    return x
