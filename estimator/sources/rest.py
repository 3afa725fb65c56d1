"""Rest: zero velocity and rotation, heading as at its start.

Shown by the IMU (no change for 3 s), confirmed by a known velocity, zero within the gate. Asked for while the vehicle is landed.

    0 = v + n_v,   w_mean = b_g + R_nb^T w_ie + n_w,   0 = psi - psi_0 + n_psi

psi_0: initial heading, estimated.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from estimator.sources.base.aid import Aid, Refusal, SensorConfig, SlowError, asked
from estimator.sources.base.gating import gate
from models import so3
from models.measurements import Heading
from models.messages import Array, Reading, Reason
from models.state import E, X

TOPIC = "rest"
BLOCK = f"{TOPIC}.heading"
_ROWS = np.arange(7)
_HEADING, _VELOCITY, _RATE = slice(0, 1), slice(1, 4), slice(4, 7)
_ZERO = 0.95  # share of velocities at rest that are taken for zero
_WALK = 1e-12  # rad^2/s: of a heading that stays
ON_GROUND: Final = 1  # of MAV_LANDED_STATE
EVERY_NS: Final = 1_000_000_000
AFTER_NS: Final = 3_000_000_000  # of rest, before the first update
_GYRO, _ACCEL = 0.01, 0.1  # rad/s, m/s^2: deviation over a second below which it may be at rest
_KNOWN_M_S = 0.2  # sigma of the estimated velocity above which nothing confirms a rest
_RATE_SIGMA = 3e-4  # rad/s: of a vehicle at rest, mean of a second, apart from the noise of its samples


class RestConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[rest]: zero-velocity and zero-rotation updates, where the autopilot says that it is landed; enabled: everywhere."""

    enabled: Annotated[
        bool, Meta(description="whether a vehicle that the IMU shows at rest is taken to be at rest, landed or not")
    ] = False
    velocity_sigma_m_s: Annotated[float, Meta(ge=1e-4, le=10, description="m/s: of a vehicle at rest")] = 0.05
    heading_sigma_deg: Annotated[float, Meta(ge=1e-3, le=10, description="deg: by which its heading may have moved")] = 0.1

    def aid(self, reading: Reading) -> Aid | Refusal:
        """A MAV_LANDED_STATE: on the ground the IMU is asked, as elsewhere; the word alone stops nothing."""
        return rest_aid(reading.t_ns) if reading.values[0] == ON_GROUND else Refusal(Reason.THINNED, "not landed")


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """psi_0 near azimuth; gyro_b (3,): mean rate, earth_n: Earth rate, rad/s."""

    azimuth: float
    gyro_b: Array
    earth_n: Array
    noise: Array

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return _ROWS

    def evaluate(self, x: Array, gyro_b: Array) -> tuple[Array, Array]:
        """nu = (wrap(azimuth - psi), -v, w - b_g - R^T w_ie)."""
        nu, h, earth_b = np.empty(7), np.zeros((7, E.SIZE)), so3.matrix(x[X.Q]).T @ self.earth_n
        nu[_HEADING], h[_HEADING] = Heading(np.array([1.0, 0.0, 0.0]), self.azimuth, self.noise[:1, :1]).evaluate(x, gyro_b)
        nu[_VELOCITY], h[_VELOCITY, E.V] = -x[X.V], np.eye(3)
        nu[_RATE], h[_RATE, E.BG] = self.gyro_b - x[X.BG] - earth_b, np.eye(3)
        h[_RATE, E.THETA] = so3.skew(earth_b)
        return nu, h


def rest_aid(t_ns: int) -> Aid:
    """Whether the vehicle rests at t_ns, by the IMU."""
    heading = SlowError(BLOCK, np.zeros((1, 1)), math.inf, np.eye(7)[:, :1], np.array([_WALK]))
    return asked(t_ns, TOPIC, [math.pi] + [10.0] * 3 + [1.0] * 3, (heading,))


def is_quiet(u: Array) -> bool:
    """Whether samples u (k, 6) of a second may be of rest."""
    deviation = u.std(axis=0)
    return bool(deviation[:3].max() < _GYRO and deviation[3:].max() < _ACCEL)


def at_rest(u: Array, azimuth: float, earth_n: Array, config: RestConfig) -> Rest:
    """The measurement in samples u (k, 6): of the rate, sigma^2 = 3e-4^2 + s^2 / k, s^2 = mean (w_i - w_i-1)^2 / 2: no sway."""
    given = [math.radians(config.heading_sigma_deg)] + [config.velocity_sigma_m_s] * 3
    rate = _RATE_SIGMA**2 + 0.5 * np.square(np.diff(u[:, :3], axis=0)).mean(axis=0) / len(u)
    return Rest(azimuth, u[:, :3].mean(axis=0), earth_n, np.diag(np.r_[np.square(given), rate]))


def objection(x: Array, cov: Array, config: RestConfig) -> str:
    """Why x, P (n, n) does not confirm a rest; '' where velocity is known, and zero within 95 %."""
    if cov.diagonal()[E.V].max() >= _KNOWN_M_S**2:
        return "looks at rest, but the velocity is not known well enough to confirm it"
    v = x[X.V]
    s = cov[E.V, E.V] + config.velocity_sigma_m_s**2 * np.eye(3)
    is_zero = v @ np.linalg.solve(s, v) < gate(_ZERO, 3)
    return "" if is_zero else f"looks at rest, but moves at {float(np.linalg.norm(v)):.2f} m/s"
