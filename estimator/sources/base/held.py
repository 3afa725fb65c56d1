"""Held values: a reading equal to the last, to the bit, in motion is no measurement."""

import math
from operator import eq

import numpy as np

from models.frames import GRAVITY
from models.measurements import Measurement, Pose, Position, Velocity
from models.messages import Array, ImuSample
from models.state import E, X

SAYS = "the same reading to the bit, though the vehicle moves"
_OTHERS_NS = 1_000_000_000  # of sensors that read in coarse steps
_STEADY = frozenset({"velocity_body"})  # a wheel or a log reads the same while the speed is steady
_SIGMAS, _SLOW_M_S = 3.0, 0.5
_ALL_NS, _AXIS_NS, _FEWEST = 100_000_000, 500_000_000, 5  # of the IMU, and samples in a row
_RESTS_RAD_S, _RESTS_M_S2 = 0.05, 0.5
_NAMES = ("gyroscope x", "gyroscope y", "gyroscope z", "accelerometer x", "accelerometer y", "accelerometer z")


def content(z: Measurement, other: bytes) -> bytes:
    """Compared value without accuracy; of a pose the position, whatever its attitude does."""
    match z:
        case Pose() | Position() | Velocity():
            return z.z_n.tobytes()
        case _:
            return other


def spares_ns(z: Measurement, kind: str) -> int:
    """For how long a sensor may read the same."""
    if kind in _STEADY:
        return 2**62
    return 0 if isinstance(z, Pose | Position | Velocity) else _OTHERS_NS


def moves(x: Array, cov: Array) -> bool:
    """Whether the vehicle moves although the IMU is quiet: |v| > 3 sigma."""
    speed = math.hypot(*x[X.V].tolist())
    return speed > max(_SLOW_M_S, _SIGMAS * math.sqrt(sum(cov.diagonal()[E.V].tolist())))


class HeldImu:
    """Held values of an IMU: a sensor for 0.1 s, an axis for 0.5 s, that varied before."""

    __slots__ = ("_alive", "_count", "_last", "_newest_ns", "_since_ns", "_varied_ns", "says")

    def __init__(self) -> None:
        self.says = ""  # of the newest sample
        self._last: tuple[float, ...] = ()
        self._since_ns, self._count = [0] * len(_NAMES), [0] * len(_NAMES)
        self._alive = [False] * len(_NAMES)
        self._newest_ns = -(2**62)
        self._varied_ns: int | None = None  # all axes did, in the sample before

    def note(self, sample: ImuSample) -> str:
        """Which values of the next sample are held, or ""."""
        u = sample.gyro_b + sample.accel_b
        if sample.t_ns <= self._newest_ns:
            return ""
        self._newest_ns = sample.t_ns
        last, self._last = self._last, u
        if not last:
            self._since_ns = [sample.t_ns] * len(u)
            return ""
        if not any(map(eq, last, u)):  # nearly every call
            self._varied_ns, self.says = sample.t_ns, ""
            return ""
        if self._varied_ns is not None:
            n = len(u)
            self._since_ns, self._count, self._alive, self._varied_ns = [self._varied_ns] * n, [0] * n, [True] * n, None
        for axis, (before, now) in enumerate(zip(last, u, strict=True)):
            if before == now:
                self._count[axis] += 1
            else:
                self._since_ns[axis], self._count[axis], self._alive[axis] = sample.t_ns, 0, True
        self.says = self._judge(sample)
        return self.says

    def _judge(self, sample: ImuSample) -> str:
        for_ns = [sample.t_ns - since_ns for since_ns in self._since_ns]
        for sensor in (slice(0, 3), slice(3, 6)):
            is_held = any(self._alive[sensor]) and min(self._count[sensor]) >= _FEWEST and min(for_ns[sensor]) > _ALL_NS
            if is_held and not _rests(sample):
                return f"{_NAMES[sensor.start][:-2]}: {SAYS}"
        axes = [k for k, n in enumerate(self._count) if n >= _FEWEST and self._alive[k] and for_ns[k] > _AXIS_NS]
        if not axes or _rests(sample):
            return ""
        return f"{', '.join(_NAMES[k] for k in axes)}: {SAYS}"


def _rests(sample: ImuSample) -> bool:
    rate, force = np.linalg.norm(sample.gyro_b), np.linalg.norm(sample.accel_b)
    return bool(rate < _RESTS_RAD_S and abs(force - GRAVITY) < _RESTS_M_S2)
