"""Range to a known beacon (ultra-wideband).

    z = |b - a| + s_0 + n,   a = p + R_nb l
    (d^T B d) / 2,   B = (I - u u^T) / |a - b|,   E[(d^T B d)^2] = (tr BC + m^T B m)^2 + 2 tr(BCBC) + 4 m^T B C B m

b: beacon; l: antenna in the body; s_0: considered, for slow_s. Second line: error d ~ N(m, C) beyond the gradient u = (a - b) /
|a - b|; repeated, it counts _SAME times.
"""

import re
from dataclasses import dataclass
from typing import Annotated, Final, TypeAlias

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from estimator.sources.base.aid import Aid, Refusal, SensorConfig, SlowError, of_reading
from models import so3
from models.measurements import Curved
from models.messages import Array, Reading, Reason
from models.state import E, X

_FIRST = np.arange(1)
_FALSE_M: Final = 50.0
_SAME: Final = 50.0  # readings, ten seconds of them, in which the geometry hardly changes
_NEAREST_M: Final = 0.05
_NUMBER: Final = re.compile(r"\d+$")
_Metres: TypeAlias = Annotated[float, Meta(ge=-1e5, le=1e5)]
_Lever: TypeAlias = Annotated[float, Meta(ge=-100, le=100)]


@dataclass(frozen=True, slots=True, eq=False)
class BeaconRange(Curved):
    """z_m to beacon_n (3,) from an antenna at lever_b (3,); noise (1, 1)."""

    z_m: float
    beacon_n: Array
    lever_b: Array
    noise: Array

    @property
    def rows(self) -> NDArray[np.intp]:
        """See Measurement."""
        return _FIRST

    def _line(self, x: Array) -> tuple[float, Array]:
        off = x[X.P] + so3.matrix(x[X.Q]) @ self.lever_b - self.beacon_n
        distance = max(float(np.linalg.norm(off)), _NEAREST_M)
        return distance, off / distance

    def evaluate(self, x: Array, _: Array, /) -> tuple[Array, Array]:
        """nu = z - |b - a|;  H_p = u^T, H_theta = -u^T R [l]x."""
        distance, u = self._line(x)
        h = np.zeros((1, E.SIZE))
        h[0, E.P] = u
        h[0, E.THETA] = -u @ so3.matrix(x[X.Q]) @ so3.skew(self.lever_b)
        return np.array([self.z_m - distance]), h

    def bend(self, x: Array, cov: Array, nu: Array, h: Array, s: Array) -> Array:
        """See Curved; after the reading m = K nu, C = P - K S K^T, of the position."""
        distance, u = self._line(x)
        by_reading = cov[E.P] @ h[0]
        m, c = by_reading * nu[0] / s[0, 0], cov[E.P, E.P] - np.outer(by_reading, by_reading) / s[0, 0]
        b = (np.eye(3) - np.outer(u, u)) / distance
        bc, bm = b @ c, b @ m
        moment = (np.trace(bc) + m @ bm) ** 2 + 2.0 * np.trace(bc @ bc) + 4.0 * bm @ c @ bm
        return np.array([[_SAME * 0.25 * moment]])


class BeaconConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[beacon]: ranges to known beacons (UWB); off without [inputs] beacon."""

    at_n_m: Annotated[
        tuple[tuple[_Metres, _Metres, _Metres], ...],
        Meta(description="m: north, east, down of each beacon from the map's origin; topics end with its number, from 1 on"),
    ] = ()
    antenna_b_m: Annotated[tuple[_Lever, _Lever, _Lever], Meta(description="m: antenna from the IMU, forward right down")] = (
        0.0,
        0.0,
        0.0,
    )
    sigma_m: Annotated[float, Meta(ge=1e-3, le=100, description="m: of a reading, new each time")] = 0.1
    slow_sigma_m: Annotated[float, Meta(ge=0, le=100, description="m: of antenna delay, survey and reflections; 0: none")] = 0.2
    slow_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: correlation time of the slow part")] = 30.0
    longest_m: Annotated[float, Meta(ge=1, le=1e5, description="m: readings beyond are none")] = 1000.0

    def aid(self, reading: Reading) -> Aid | Refusal:
        """A range [m] as a measurement along the line to its beacon."""
        (z_m,) = reading.values
        named = _NUMBER.search(reading.topic)
        k = int(named[0]) - 1 if named else -1
        if not 0 <= k < len(self.at_n_m):
            return Refusal(
                Reason.UNSUPPORTED, f"{reading.topic} ends with the number of no beacon: [beacon] at_n_m has {len(self.at_n_m)}"
            )
        if not 0.0 < z_m < self.longest_m:
            return Refusal(Reason.IMPLAUSIBLE, f"a range of {z_m:.4g} m; [beacon] longest_m is {self.longest_m:g}")
        z = BeaconRange(z_m, np.array(self.at_n_m[k]), np.array(self.antenna_b_m), np.array([[self.sigma_m**2]]))
        slow = SlowError(f"{reading.topic}.slow", np.array([[self.slow_sigma_m**2]]), self.slow_s)
        return of_reading(reading, z, (z_m,), [_FALSE_M], slow_errors=(slow,) * (self.slow_sigma_m > 0), weighs=False)
