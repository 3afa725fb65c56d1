"""Range along the body's down axis: height above flat ground.

    z cos(tilt) = -p_d + s_0 + n,   cos(tilt) = e_d^T R_nb e_z

-s_0: ground above the origin, by the first reading and walking, or ground_m.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Final, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from estimator.sources.base.aid import Aid, Refusal, SensorConfig, SlowError, of_reading
from models import so3
from models.measurements import Conditional
from models.messages import Array, Reading, Reason
from models.state import E, X

_FIRST = np.arange(1)
_DOWN_B = np.array([0.0, 0.0, 1.0])
_FALSE_HEIGHT_M = 50.0
_SIGMA_SHARE: Final = 0.01  # of the range, added
_STEEPEST: Final = math.radians(30.0)  # tilt beyond which it is not used
_Height: TypeAlias = Annotated[float, Meta(ge=-1e4, le=1e5)]


@dataclass(frozen=True, slots=True, eq=False)
class RangeDown(Conditional):
    """z_m above ground_m; noise (1, 1); steepest: tilt, rad."""

    z_m: float
    ground_m: float
    noise: Array
    steepest: float

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return _FIRST

    def evaluate(self, x: Array, _: Array, /) -> tuple[Array, Array]:
        """nu = z R_dz + ground + p_d;  H_pd = -1, H_theta = z e_d^T R [e_z]x."""
        down_b, h = so3.matrix(x[X.Q])[2], np.zeros((1, E.SIZE))
        h[0, E.P.stop - 1] = -1.0
        h[0, E.THETA] = self.z_m * (down_b @ so3.skew(_DOWN_B))
        return np.array([self.z_m * down_b[2] + self.ground_m + x[X.P][2]]), h

    def objection(self, x: Array) -> str:
        """See Conditional."""
        tilt = math.acos(min(max(float(so3.matrix(x[X.Q])[2, 2]), -1.0), 1.0))
        return f"tilted by {math.degrees(tilt):.0f} deg" if tilt > self.steepest else ""


class RangeConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[range]: downward range finder; off without [inputs] range."""

    ground_m: Annotated[
        _Height | None,
        Meta(description="m: height of the flat ground above the origin; none: that of the first reading, drifting"),
    ] = None
    sigma_m: Annotated[float, Meta(ge=1e-3, le=100, description="m: of a reading, the ground's roughness included")] = 0.2
    terrain_m_sqrt_s: Annotated[float, Meta(ge=1e-6, le=1000, description="m/sqrt(s): by which the ground rises and falls")] = 0.5

    def aid(self, reading: Reading) -> Aid | Refusal:
        """A range [m] as a measurement of height."""
        z_m = reading.values[0]
        if z_m <= 0.0:
            return Refusal(Reason.IMPLAUSIBLE, f"a range of {z_m:.3g} m")
        noise = np.array([[self.sigma_m**2 + (_SIGMA_SHARE * z_m) ** 2]])
        z = RangeDown(z_m, self.ground_m or 0.0, noise, _STEEPEST)
        walk = np.array([self.terrain_m_sqrt_s**2])
        ground = SlowError(f"{reading.topic}.ground", np.zeros((1, 1)), math.inf, np.ones((1, 1)), walk)
        return of_reading(reading, z, (z_m,), [_FALSE_HEIGHT_M], slow_errors=(ground,) * (self.ground_m is None))
