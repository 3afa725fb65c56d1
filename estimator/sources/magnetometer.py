"""A magnetometer: heading from the Earth's field (World Magnetic Model).

    m_b = S (z_b - o),   azimuth of R_nb m_b = declination + e + v

Considered: h_b of iron on the vehicle, e_0 of the place and of tilt (Heading.is_steep):

    e = e_0 - (d azimuth / d m_b) h_b

Impossible strength or inclination is refused.
"""

import math
from functools import cache
from typing import Annotated, Final, TypeAlias

import numpy as np
from msgspec import Meta

from estimator.sources.base.aid import Aid, Refusal, SensorConfig, SlowError, of_reading
from models import so3
from models.earth_field import field_n, year_of
from models.frames import Origin
from models.measurements import Heading
from models.messages import Array, Reading, Reason

_WEAKEST_T, _STRONGEST_T = 5e-6, 5e-4  # no field of the Earth, 22 to 67 microtesla, even through iron
_FALSE_RAD: Final = math.pi
_UT: Final = 1e-6
_Degrees: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]
_Declination: TypeAlias = Annotated[float, Meta(ge=-180, le=180)]
_Offset: TypeAlias = Annotated[float, Meta(ge=-1000, le=1000)]
_Scale: TypeAlias = Annotated[float, Meta(ge=0.1, le=10)]


class MagnetometerConfig(SensorConfig, frozen=True, forbid_unknown_fields=True):
    """[magnetometer]: mounting, calibration, errors; off without [inputs] magnetometer."""

    mounting_rpy_deg: Annotated[
        tuple[_Degrees, _Degrees, _Degrees], Meta(description="deg: roll, pitch, yaw of the magnetometer in the body, as FRD")
    ] = (0.0, 0.0, 0.0)
    offset_ut: Annotated[
        tuple[_Offset, _Offset, _Offset], Meta(description="uT: hard iron, taken from its readings, in its own axes as FRD")
    ] = (0.0, 0.0, 0.0)
    scale: Annotated[
        tuple[_Scale, _Scale, _Scale], Meta(description="factors of its axes, once the offset is taken from them")
    ] = (1.0, 1.0, 1.0)
    declination_deg: Annotated[
        _Declination | None, Meta(description="deg: east positive; none: of the World Magnetic Model at the origin")
    ] = None
    sigma_deg: Annotated[float, Meta(ge=0.01, le=90, description="deg: error that is new with each reading")] = 3.0
    hard_iron_sigma_ut: Annotated[
        float, Meta(ge=0, le=100, description="uT: of the hard iron that is left, per axis; 20 uT are the horizontal field")
    ] = 2.5
    slow_sigma_deg: Annotated[
        float, Meta(ge=0, le=90, description="deg: of soft iron, the mounting and the place, which stays for slow_s")
    ] = 3.0
    slow_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: correlation time of the slow part")] = 300.0
    strength_within: Annotated[
        float, Meta(ge=0.01, le=10, description="share of the field's strength by which a reading may be off")
    ] = 0.3
    inclination_within_deg: Annotated[float, Meta(ge=1, le=180, description="deg: by which its inclination may be off")] = 15.0

    def aid(self, reading: Reading) -> Aid | Refusal:
        """A field [T] as a measurement of heading."""
        z_b = np.array(reading.values)
        strength = float(np.linalg.norm(z_b))
        if not _WEAKEST_T < strength < _STRONGEST_T:
            return Refusal(Reason.IMPLAUSIBLE, f"a field of {strength:.3g} T: tesla are expected, the Earth's is 2e-5 to 7e-5")
        m_b = _turned(self.mounting_rpy_deg) @ (np.array(self.scale) * (z_b - _UT * np.array(self.offset_ut)))
        year = round(year_of(reading.t_ns), 1)

        @cache  # a measurement that comes late has others done again
        def measurement(origin: Origin | None) -> Heading | None:
            return self._heading(m_b, origin, year)

        seen = Heading(m_b, 0.0, np.zeros((1, 1)))
        iron = SlowError(
            f"{reading.topic}.iron",
            self.hard_iron_sigma_ut**2 * np.eye(3),
            math.inf,
            lambda x: -_UT * seen.by_direction(x),
        )
        place = SlowError(f"{reading.topic}.slow", np.array([[math.radians(self.slow_sigma_deg) ** 2]]), self.slow_s)
        return of_reading(
            reading,
            measurement,
            reading.values,
            [_FALSE_RAD],
            slow_errors=(iron,) * (self.hard_iron_sigma_ut > 0) + (place,) * (self.slow_sigma_deg > 0),
            weighs=False,
            check=lambda origin: self._check(m_b, origin, year),
        )

    def _check(self, m_b: Array, origin: Origin | None, year: float) -> Refusal | None:
        if origin is None:
            return None
        strength, expected = float(np.linalg.norm(m_b)), math.hypot(*field_n(origin, year))
        if abs(strength / expected - 1.0) <= self.strength_within:
            return None
        found = f"a field of {strength / _UT:.0f} uT, {expected / _UT:.0f} expected"
        return Refusal(
            Reason.IMPLAUSIBLE, f"{found}: iron or currents near it, or [magnetometer] offset_ut and scale are missing"
        )

    def _heading(self, m_b: Array, origin: Origin | None, year: float) -> Heading | None:
        noise, given = np.array([[math.radians(self.sigma_deg) ** 2]]), self.declination_deg
        if origin is None:
            return None if given is None else Heading(m_b, math.radians(given), noise, is_steep=True)
        north, east, down = field_n(origin, year)
        azimuth = math.atan2(east, north) if given is None else math.radians(given)
        elevation = -math.atan2(down, math.hypot(north, east))
        return Heading(m_b, azimuth, noise, elevation, math.radians(self.inclination_within_deg), is_steep=True)


@cache
def _turned(rpy_deg: tuple[float, float, float]) -> Array:
    return so3.matrix(so3.from_euler(*np.deg2rad(rpy_deg)))
