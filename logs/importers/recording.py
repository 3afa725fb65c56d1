"""A foreign log as columns in NED, FRD, SI; nan: not given."""

import heapq
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Self, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from logs.importers.settings import Settings
from logs.store.reader import LogError
from logs.wire.sensors import SENSORS
from models.messages import (
    ATTITUDE_TOPIC,
    Array,
    AttitudePrior,
    GnssFix,
    GnssVelocity,
    ImuSample,
    Input,
    OdometryPose,
    PoseFix,
    Quat,
    Reading,
    ReceiverState,
    Vec3,
)

Times: TypeAlias = NDArray[np.int64]
Progress: TypeAlias = Callable[[float], None]  # called with the fraction done

EPOCH_NS = 1_700_000_000 * 10**9  # 2023-11-14T22:13:20Z: when t = 0 was, in logs that do not know the date
_LAST_NS = (2**31 - 1) * 10**9  # 2038: the wire's seconds have 31 bits
_ATTITUDE_NS = 500_000_000  # between attitudes to begin with: one is enough, at most 2 s old
_ATTITUDE_VARIANCE = np.deg2rad([2.0, 2.0, 4.0]) ** 2  # rad^2, of tilt and heading: no autopilot's log has its own
AUTOPILOT = "the autopilot's own estimate"
_BLOCK = 4096  # rows that are plain Python objects at one time


class Truth(msgspec.Struct, frozen=True, eq=False):
    """True state, or the log's own estimate; nan: not given."""

    t_ns: int
    arrived_ns: int
    p_n: Vec3
    v_n: Vec3
    q_nb_wxyz: Quat
    topic: str = "/truth"


Message: TypeAlias = Input | Truth


class ImportOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a log does not contain; "": as the log or data set.

    axes: IMU x, y, z as f/b, r/l, u/d; world: n/s, e/w, u/d (csv, euroc); pose_fix_hz, odometry: vision.csv as such (csv).
    """

    axes: str = ""
    world: str = ""
    imu: str = ""
    pose_fix_hz: float = 0.0
    odometry: bool = False

    def refuse_but(self, kind: str, *names: str) -> None:
        """Raise LogError for a set option not in `names`."""
        for name in self.__struct_fields__:
            if name not in names and getattr(self, name) != getattr(DEFAULTS, name):
                raise LogError(f"--{name.replace('_', '-')} means nothing for {kind} logs; leave it out")


DEFAULTS = ImportOptions()


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """Messages of a topic: t_ns, arrived_ns (n,), columns (n, ...)."""

    topic: str
    t_ns: Times
    arrived_ns: Times
    columns: tuple[Array, ...]
    make: Callable[..., Message]

    def __len__(self) -> int:
        return len(self.t_ns)

    def within(self, first_ns: int, last_ns: int) -> Self:
        """Messages valid and arrived within the interval."""
        earlier, later = np.minimum(self.t_ns, self.arrived_ns), np.maximum(self.t_ns, self.arrived_ns)
        rows = (earlier >= first_ns) & (later <= last_ns)
        if rows.all():
            return self
        return replace(self, t_ns=self.t_ns[rows], arrived_ns=self.arrived_ns[rows], columns=tuple(c[rows] for c in self.columns))

    def __iter__(self) -> Iterator[Message]:
        order = np.argsort(self.arrived_ns, kind="stable")
        for start in range(0, len(order), _BLOCK):
            rows = order[start : start + _BLOCK]
            columns = (column[rows].tolist() for column in self.columns)
            yield from map(self.make, self.t_ns[rows].tolist(), self.arrived_ns[rows].tolist(), *columns)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A whole log; at equal arrival earlier streams first."""

    streams: tuple[Stream, ...]
    settings: Settings
    notes: tuple[str, ...] = ()  # what a person should know, one line each
    reference: str = ""  # what /truth is where it is no ground truth

    @classmethod
    def of(cls, streams: Iterable[Stream], settings: Settings, notes: Iterable[str], reference: str = "") -> Self:
        """Without messages of impossible stamps; a note counts them."""
        given = tuple(streams)
        kept = [s.within(0, _LAST_NS) for s in given]
        lost = sum(map(len, given)) - sum(map(len, kept))
        more = [f"{lost} messages stamped outside 1970-2038 left out"] if lost else []
        return cls(tuple(s for s in kept if len(s)), settings, (*notes, *more), reference)

    def __len__(self) -> int:
        return sum(map(len, self.streams))

    def __iter__(self) -> Iterator[Message]:
        return heapq.merge(*self.streams, key=attrgetter("arrived_ns"))

    def stream(self, topic: str) -> Stream | None:
        """The topic's stream or None."""
        return next((s for s in self.streams if s.topic == topic), None)


def arrival(t_ns: Times) -> Times:
    """Arrivals: running maximum of stamps, outliers removed."""
    held = t_ns.copy()
    if len(t_ns) > 2:
        leaps = 1 + np.flatnonzero((t_ns[1:-1] > t_ns[2:]) & (t_ns[2:] >= t_ns[:-2]))
        held[leaps] = t_ns[leaps + 1]
    return np.maximum.accumulate(held)


def imu(t_ns: Times, arrived_ns: Times, gyro_b: Array, accel_b: Array, topic: str = "/imu") -> Stream:
    """ImuSamples; gyro_b (n, 3) rad/s, accel_b (n, 3) m/s^2."""

    def make(t: int, arrived: int, gyro: list[float], accel: list[float]) -> ImuSample:
        return ImuSample(t, arrived, (gyro[0], gyro[1], gyro[2]), (accel[0], accel[1], accel[2]), topic)

    return Stream(topic, t_ns, arrived_ns, (gyro_b, accel_b), make)


def gnss(
    t_ns: Times,
    arrived_ns: Times,
    lla: Array,
    variance_n: Array,
    status: Array,
    topic: str = "/gnss",
    flags: Array | None = None,
) -> Stream:
    """GnssFixes; lla (n, 3) deg, deg, m; variance_n (n, 3) m^2, nan: none; status (n,) NavSatStatus; flags (n,) ReceiverState."""

    def make(t: int, arrived: int, place: list[float], variance: list[float], state: float, flag: float) -> GnssFix:
        lat, lon, alt = place
        return GnssFix(t, arrived, lat, lon, alt, _diagonal(variance), int(state), topic, ReceiverState(int(flag)))

    return Stream(topic, t_ns, arrived_ns, (lla, variance_n, status, np.zeros(len(t_ns)) if flags is None else flags), make)


def gnss_velocity(t_ns: Times, arrived_ns: Times, v_n: Array, variance_n: Array, topic: str = "/gnss/velocity") -> Stream:
    """GnssVelocities; v_n (n, 3) m/s, variance_n (n, 3) m^2/s^2, nan: none."""

    def make(t: int, arrived: int, v: list[float], variance: list[float]) -> GnssVelocity:
        return GnssVelocity(t, arrived, (v[0], v[1], v[2]), _diagonal(variance), topic)

    return Stream(topic, t_ns, arrived_ns, (v_n, variance_n), make)


def sensor(kind: str, t_ns: Times, arrived_ns: Times, values: Array) -> Stream:
    """Readings of a logs.wire.sensors kind, variance unknown; values (n, k)."""
    topic = SENSORS[kind].topic

    def make(t: int, arrived: int, row: list[float]) -> Reading:
        return Reading(t, arrived, topic, kind, tuple(row))

    return Stream(topic, t_ns, arrived_ns, (values,), make)


def pose_fix(t_ns: Times, arrived_ns: Times, p_n: Array, q_nb_wxyz: Array, variance: Array, topic: str = "/pose_fix") -> Stream:
    """PoseFixes; p_n (n, 3) m, q_nb_wxyz (n, 4), variance (n, 6) m^2 and rad^2."""

    def make(t: int, arrived: int, p: list[float], q: list[float], variances: list[float]) -> PoseFix:
        return PoseFix(t, arrived, (p[0], p[1], p[2]), (q[0], q[1], q[2], q[3]), np.diag(np.array(variances)), topic=topic)

    return Stream(topic, t_ns, arrived_ns, (p_n, q_nb_wxyz, variance), make)


def odometry(t_ns: Times, arrived_ns: Times, p_o: Array, q_ob_wxyz: Array, run: Array, quality: Array | None = None) -> Stream:
    """OdometryPoses; p_o (n, 3) m, q_ob_wxyz (n, 4), nan rows dropped; run (n,): frame number; quality (n,): below 0, lost."""
    quality = np.zeros(len(run)) if quality is None else quality
    rows = np.flatnonzero(np.isfinite(p_o).all(axis=1) & np.isfinite(q_ob_wxyz).all(axis=1))

    def make(t: int, arrived: int, p: list[float], q: list[float], number: float, level: float) -> OdometryPose:
        at = (p[0], p[1], p[2]), (q[0], q[1], q[2], q[3])
        return OdometryPose(t, arrived, *at, f"odom {number:.0f}", is_lost=level < 0.0)

    return Stream("/odometry", t_ns[rows], arrived_ns[rows], (p_o[rows], q_ob_wxyz[rows], run[rows], quality[rows]), make)


def attitude(t_ns: Times, arrived_ns: Times, q_nb_wxyz: Array, topic: str = ATTITUDE_TOPIC) -> Stream:
    """Two AttitudePriors a second; q_nb_wxyz (n, 4), nan rows dropped."""
    known = np.flatnonzero(np.isfinite(q_nb_wxyz).all(axis=1))
    _, first = np.unique(t_ns[known] // _ATTITUDE_NS, return_index=True)
    rows = known[first]

    def make(t: int, arrived: int, q: list[float]) -> AttitudePrior:
        return AttitudePrior(t, arrived, (q[0], q[1], q[2], q[3]), np.diag(_ATTITUDE_VARIANCE), topic)

    return Stream(topic, t_ns[rows], arrived_ns[rows], (q_nb_wxyz[rows],), make)


def truth(t_ns: Times, p_n: Array, v_n: Array, q_nb_wxyz: Array) -> Stream:
    """Truths at their arrival; p_n (n, 3) m, v_n (n, 3) m/s, q_nb_wxyz (n, 4)."""

    def make(t: int, arrived: int, p: list[float], v: list[float], q: list[float]) -> Truth:
        return Truth(t, arrived, (p[0], p[1], p[2]), (v[0], v[1], v[2]), (q[0], q[1], q[2], q[3]))

    return Stream("/truth", t_ns, arrival(t_ns), (p_n, v_n, q_nb_wxyz), make)


def _diagonal(variances: list[float]) -> Array | None:
    return None if any(map(math.isnan, variances)) else np.diag(np.array(variances))
