"""Velocity in the body: Doppler log, wheels, optical flow with a range.

    z_b = (1 + k) (I + [m]x) (R_nb^T v + w x l) + n,   w = gyro - b_g

l: IMU to sensor; scale k and misalignment m: considered. Missing components: zero with across_sigma_m_s, where given
(non-holonomic constraint).
"""

import math
from dataclasses import dataclass
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from estimator.sources.base.aid import FALSE_VELOCITY_M_S, Aid, Refusal, SensorConfig, SlowError, of_reading
from estimator.sources.base.covariance import covariance_refusal
from models import so3
from models.messages import Array, Reading, Reason
from models.state import E, X

_FASTEST_M_S = 500.0
_NOT_GIVEN_M2_S2 = 1e4  # a variance of so much, or more, gives nothing
_Lever: TypeAlias = Annotated[float, Meta(ge=-100, le=100)]


@dataclass(frozen=True, slots=True, eq=False)
class BodyVelocity:
    """z_b: (3,) m/s; noise (m, m) and given rows; lever_b (3,) m."""

    z_b: Array
    noise: Array
    rows: NDArray[np.intp]
    lever_b: Array

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """nu = z - R^T v - w x l;  H_v = R^T, H_theta = [R^T v]x, H_bg = [l]x."""
        r_bn, h = so3.matrix(x[X.Q]).T, np.zeros((3, E.SIZE))
        v_b = r_bn @ x[X.V]
        h[:, E.V], h[:, E.THETA], h[:, E.BG] = r_bn, so3.skew(v_b), so3.skew(self.lever_b)
        nu = self.z_b - v_b - np.cross(gyro_b - x[X.BG], self.lever_b)
        return nu[self.rows], h[self.rows]


class VelocityBodyConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[velocity_body]: sensor and errors; off without [inputs] velocity_body."""

    delay_s: Annotated[float, Meta(ge=-1, le=5, description="s: stamps are later than validity by this much")] = 0.0
    lever_b_m: Annotated[tuple[_Lever, _Lever, _Lever], Meta(description="m: sensor from the IMU, forward right down")] = (
        0.0,
        0.0,
        0.0,
    )
    sigma_m_s: Annotated[float, Meta(ge=1e-4, le=100, description="m/s: where the message gives no accuracy")] = 0.1
    across_sigma_m_s: Annotated[
        float, Meta(ge=0, le=100, description="m/s: of wheels, right and down, where the message gives neither; 0: not used")
    ] = 0.0
    scale_sigma: Annotated[float, Meta(ge=0, le=1, description="ratio: of its scale; 0: none")] = 0.02
    mount_deg: Annotated[float, Meta(ge=0, le=90, description="deg: of its axes against the IMU's; 0: none")] = 1.0

    def aid(self, reading: Reading) -> Aid | Refusal:
        """A velocity [m/s] along the body's axes as a measurement."""
        z_b = np.array(reading.values)
        if np.abs(z_b).max() > _FASTEST_M_S:
            return Refusal(Reason.IMPLAUSIBLE, f"faster than {_FASTEST_M_S:.0f} m/s: metres per second are expected")
        noise = self.sigma_m_s**2 * np.eye(3) if reading.covariance is None else reading.covariance
        given = noise.diagonal() < _NOT_GIVEN_M2_S2
        if self.across_sigma_m_s and given[0] and not given[1:].any():
            z_b[1:] = 0.0
            noise, given = np.diag([noise[0, 0], *[self.across_sigma_m_s**2] * 2]), np.ones(3, bool)
        rows = np.flatnonzero(given)
        if not len(rows):
            return Refusal(Reason.UNSUPPORTED, "no component is given")
        noise = noise[np.ix_(rows, rows)]
        if refusal := covariance_refusal(noise):
            return refusal
        z = BodyVelocity(z_b, noise, rows, np.array(self.lever_b_m))
        scale = SlowError(
            f"{reading.topic}.scale", np.array([[self.scale_sigma**2]]), math.inf, lambda x: _along(x)[:, np.newaxis]
        )
        mount = SlowError(
            f"{reading.topic}.mount", math.radians(self.mount_deg) ** 2 * np.eye(3), math.inf, lambda x: -so3.skew(_along(x))
        )
        return of_reading(
            reading,
            z,
            (*reading.values, noise.tobytes()),
            [FALSE_VELOCITY_M_S] * len(rows),
            delay_s=self.delay_s,
            slow_errors=(scale,) * (self.scale_sigma > 0) + (mount,) * (self.mount_deg > 0),
            weighs=False,
            uses_rate=True,
        )


def _along(x: Array) -> Array:
    return np.asarray(so3.matrix(x[X.Q]).T @ x[X.V])
