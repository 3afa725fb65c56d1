"""Motion through the air, from a pitot tube or a multirotor's drag, and air density (docs/air_data.md).

    z_b = R_nb^T (v - w) + n,   w = (w_n, w_e, 0)
    f = -(k + (rho / 2 B) |u|) u,   u = (z_x, z_y)                           (PX4 EKF2: MCOEF k [1/s], BCOEF B [kg/m^2])
    u = -m(|f|) f / |f|,            m(f) = (sqrt(k^2 + 4 c f) - k) / 2 c,   c = rho / 2 B

f: specific force across the thrust. Estimated: wind, scale s, z_b = (1 + s) u + n, d z / d s = u of the estimate (errors in
variables; Fuller 1987).
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from models import so3
from models.messages import Array
from models.state import E, X

SEA_LEVEL_KG_M3 = 1.225
_CALM = (0.0, 0.0)
_ACROSS = np.arange(2)
_TINY = 1e-9
_SCALE = ".scale"


def scale_of(topic: str) -> str:
    """The block of a sensor's scale."""
    return topic + _SCALE


def is_scale(block: str) -> bool:
    """Whether a block is the scale of an air sensor."""
    return block.endswith(_SCALE)


@dataclass(frozen=True, slots=True, eq=False)
class AirVelocity:
    """z_b (m,): components `rows` of R^T (v - w), m/s; wind_n: m/s, north, east."""

    z_b: Array
    noise: Array
    rows: NDArray[np.intp]
    wind_n: tuple[float, float] = _CALM

    def in_wind(self, wind_n: Array) -> Self:
        """With this estimate of the wind."""
        return replace(self, wind_n=(float(wind_n[0]), float(wind_n[1])))

    def by_scale(self, x: Array) -> Array:
        """d z / d s, (m, 1): the velocity through the air at x, along the nose."""
        h = self.through_air(x)[self.rows, np.newaxis]
        h[self.rows > 0] = 0.0
        return h

    def through_air(self, x: Array) -> Array:
        """R^T (v - w), (3,)."""
        u: Array = so3.matrix(x[X.Q]).T @ (x[X.V] - np.array([*self.wind_n, 0.0]))
        return u

    def evaluate(self, x: Array, _: Array, /) -> tuple[Array, Array]:
        """nu = z - R^T v, with the wind as an error of z; H_v = R^T, H_theta = [R^T (v - w)]x."""
        r_bn, h = so3.matrix(x[X.Q]).T, np.zeros((3, E.SIZE))
        through_air = r_bn @ (x[X.V] - np.array([*self.wind_n, 0.0]))
        h[:, E.V], h[:, E.THETA] = r_bn, so3.skew(through_air)
        return self.z_b - (r_bn @ x[X.V])[self.rows], h[self.rows]


@dataclass(frozen=True, slots=True, eq=False)
class DragForce:
    """f_b (2,): mean specific force along x, y, m/s^2; linear: k, 1/s; square: c, 1/m."""

    f_b: Array
    sigma: float
    linear: float
    square: float
    wind_n: tuple[float, float] = _CALM

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return _ACROSS

    @property
    def noise(self) -> Array:
        """See Measurement."""
        by_force = self.velocity(self.f_b)[1]
        return self.sigma**2 * by_force @ by_force.T

    def in_wind(self, wind_n: Array) -> Self:
        """With this estimate of the wind."""
        return replace(self, wind_n=(float(wind_n[0]), float(wind_n[1])))

    def by_scale(self, x: Array) -> Array:
        """d z / d s, (2, 1), at the state x."""
        return self._through_air(x).through_air(x)[_ACROSS, np.newaxis]

    def velocity(self, f_b: Array) -> tuple[Array, Array]:
        """u (2,) [m/s] of a force f (2,) [m/s^2], and d u / d f (2, 2) [s]."""
        force, k, c = float(np.linalg.norm(f_b)), self.linear, self.square
        root = math.sqrt(k * k + 4.0 * c * force)
        speed = 2.0 * force / (root + k)  # = (root - k) / 2c, for any c
        along = f_b / force if force > _TINY else np.zeros(2)
        outer, across = np.outer(along, along), speed / force if force > _TINY else 1.0 / k
        return -speed * along, -(outer / root + across * (np.eye(2) - outer))

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """As AirVelocity of u(f - b_a), with H_ba = d u / d f."""
        nu, h = self._through_air(x).evaluate(x, gyro_b)
        h[:, E.BA][:, _ACROSS] = self.velocity(self.f_b - x[X.BA][_ACROSS])[1]
        return nu, h

    def _through_air(self, x: Array) -> AirVelocity:
        z_b, _ = self.velocity(self.f_b - x[X.BA][_ACROSS])
        return AirVelocity(z_b, np.eye(2), _ACROSS, self.wind_n)


def density_ratio(height_m: float) -> float:
    """rho / rho_0 = (1 - 2.25577e-5 h)^4.25588 of the standard atmosphere (ICAO Doc 7488) below 11 km."""
    return float(max(1.0 - 2.25577e-5 * height_m, 0.1) ** 4.25588)
