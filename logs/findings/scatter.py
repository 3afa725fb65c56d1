"""Readings that scatter from one to the next by more than their sensor does.

off_k = |x_k - (x_k-1 + x_k+1) / 2|,   most of 4 s;   of a motion a dt^2 / 2
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from logs.findings.position import positions
from logs.findings.streams import FIX, IMU, VELOCITY, Cause, Stream
from models.messages import Array

_LEAST: Final = 8
_WINDOW_S: Final = 4.0
_SHARE: Final = 0.6
_SIGMAS: Final = 8.0  # times the reported accuracy of a receiver
_FIX_M: Final = 3.0
_SWERVE_M_S2: Final = 5.0  # acceleration of a lively vehicle
_MOST: Final = {  # kind: columns, most, most a second between readings, what it is, unit, remedy
    VELOCITY: (slice(0, 2), 2.0, 4.0, "velocities", "m/s", "see the receiver, or give its covariance"),
    "baro": (slice(0, 1), 60.0, 0.0, "pressure", "Pa", "see its hose and port, its cable and its driver"),
    IMU: (slice(3, 6), 20.0, 0.0, "accelerometer", "m/s^2", "damp the vibration, see its cable, and set [imu] accel_noise"),
}


def scattered(stream: Stream) -> Cause | None:
    """More than 8 x the reported accuracy of a receiver, or than any such sensor."""
    if stream.kind == FIX:
        return _positions(stream)
    if stream.kind not in _MOST:
        return None
    columns, most, more_a_second, name, unit, advice = _MOST[stream.kind]
    ordered = stream.in_order()
    t, off = ordered.t_s, _off(ordered.values[:, columns])
    wide = (off > most + more_a_second * np.diff(t)[1:]) & _even(t) if len(t) > _LEAST else np.zeros(0, bool)
    if (rows := _window(t, wide)) is None:
        return None
    noun = f"its {name} scatter{'s' if stream.kind != VELOCITY else ''}"
    what = f"{noun} by {float(np.median(off[rows])):.2g} {unit} from one reading to the next"
    return Cause(what, stream.arrival_at(float(t[rows][0])), advice)


def _positions(stream: Stream) -> Cause | None:
    t, p = positions(stream)
    sigma = stream.in_order().values[:, 3]
    if len(t) < _LEAST or not sigma.any():
        return None
    off = _off(p)
    swerve = 0.5 * _SWERVE_M_S2 * np.diff(t)[1:] ** 2
    wide = (off > np.maximum(_SIGMAS * sigma[1:-1], _FIX_M) + swerve) & (sigma[1:-1] > 0.0) & _even(t)
    if (rows := _window(t, wide)) is None:
        return None
    what = f"its positions scatter by {float(np.median(off[rows])):.1f} m while it reports {float(np.median(sigma)):.2g} m"
    return Cause(what, stream.arrival_at(float(t[rows][0])), "the receiver is jammed or shadowed, or the accuracy is not its own")


def _off(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x[1:-1] - 0.5 * (x[:-2] + x[2:]), axis=1))


def _even(t: Array) -> NDArray[np.bool_]:
    return np.asarray(np.diff(t)[1:] < 1.5 * np.diff(t)[:-1])


def _window(t: Array, wide: NDArray[np.bool_]) -> slice | None:
    """The first 4 s of which most are wide."""
    n = max(_LEAST, round(_WINDOW_S / max(float(np.median(np.diff(t))), 1e-3))) if len(wide) else 1
    if len(wide) < n:
        return None
    share = np.convolve(wide, np.ones(n) / n, "valid")
    if share.max() < _SHARE:
        return None
    first = int(np.argmax(share > _SHARE))
    return slice(first, first + n)
