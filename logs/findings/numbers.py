"""Readings that are no numbers, no rotations, or rounded."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from logs.findings.streams import FIX, IMU, ODOMETRY, POSE, TURNING, VELOCITY, Cause, Stream
from models.messages import Array

_STEPS: Final = ((slice(0, 3), 0.02, "gyroscope", "rad/s"), (slice(3, 6), 0.3, "accelerometer", "m/s^2"))
_DEGREE_STEP_M: Final = 0.25
_DEGREE_M: Final = 111_195.0
_LENGTH: Final = 0.05  # of a quaternion: float32 has 1e-7
_LEVELS: Final = 6  # of a reading that moves
_SHARE: Final = 0.02  # of all readings
_JUDGED: Final = (IMU, "magnetometer", "baro")  # whole; others may leave out a component, or give infinity for no echo
_HORIZONTAL: Final = (FIX, VELOCITY, POSE, ODOMETRY)


def finite(stream: Stream) -> Stream:
    """The readings that are numbers, but for a height that is not given."""
    rows = _given(stream)
    return stream if rows.all() else Stream(stream.kind, stream.t_s[rows], stream.arrived_s[rows], stream.values[rows])


def not_finite(stream: Stream) -> Cause | None:
    """NaN or infinity in more than 2 % of the readings."""
    wrong = ~_given(stream)
    count = int(np.count_nonzero(wrong))
    if stream.kind not in (*_JUDGED, *_HORIZONTAL) or count <= _SHARE * len(wrong):
        return None
    what = f"{count} of {len(wrong)} readings are not a number (NaN or infinite)"
    since_s = float(stream.arrived_s[int(np.argmax(wrong))])
    return Cause(what, since_s, "see the sensor, its cable and its driver", unfit=bool(wrong.all()))


def no_quaternions(stream: Stream) -> Cause | None:
    """|q| is neither 1 nor, as not given, 0."""
    if stream.kind not in TURNING:
        return None
    length = np.linalg.norm(stream.values[:, -4:], axis=1)
    wrong = (length > 0.0) & (np.abs(length - 1.0) > _LENGTH)
    if np.count_nonzero(wrong) <= _SHARE * len(wrong):
        return None
    what = f"its quaternions have a length of {float(np.median(length[wrong])):.3g}, not 1"
    return Cause(what, float(stream.arrived_s[int(np.argmax(wrong))]), "send unit quaternions, not angles")


def rounded(stream: Stream) -> Cause | None:
    """The readings of an axis are whole multiples of a step that no sensor has."""
    since_s = float(stream.arrived_s[0])
    for columns, most, name, unit in _STEPS if stream.kind == IMU else ():
        step = max(map(_step, stream.values[:, columns].T))
        if step > most:
            return Cause(f"its {name} is rounded to {step:.3g} {unit}", since_s, "send the digits that the sensor gives")
    if stream.kind == FIX:
        step = _DEGREE_M * max(_step(stream.values[:, 0]), _step(stream.values[:, 1]) * np.cos(np.radians(stream.values[0, 0])))
        sigma = float(np.median(stream.values[:, 3])) or 1.0
        if step > max(_DEGREE_STEP_M, 12.0**0.5 * sigma):
            what = f"its positions are rounded to {step:.2g} m"
            return Cause(what, since_s, "write degrees with 8 digits behind the point, as float64")
    return None


def _step(x: Array) -> float:
    """The step of which all differences are whole multiples; 0: there is none."""
    levels = np.unique(x)
    if len(levels) < _LEVELS:
        return 0.0
    step = float(np.diff(levels).min())
    multiples = (levels - levels[0]) / step
    return step if np.abs(multiples - np.round(multiples)).max() < 0.02 else 0.0


def _given(stream: Stream) -> NDArray[np.bool_]:
    values = stream.values[:, :2] if stream.kind in _HORIZONTAL else stream.values
    return np.asarray(np.isfinite(values).all(axis=1))
