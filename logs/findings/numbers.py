"""Readings that are no numbers."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from logs.findings.streams import FIX, IMU, ODOMETRY, POSE, VELOCITY, Cause, Stream

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


def _given(stream: Stream) -> NDArray[np.bool_]:
    values = stream.values[:, :2] if stream.kind in _HORIZONTAL else stream.values
    return np.asarray(np.isfinite(values).all(axis=1))
