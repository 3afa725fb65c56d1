"""Faults of sensors, stamps and frames, each a change of one topic's messages; sizes and times are drawn."""

from collections.abc import Callable
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from models.frames import GRAVITY
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, OdometryPose, PoseFix, Reading

Messages: TypeAlias = list[Input]
Change: TypeAlias = Callable[[Messages, np.random.Generator], Messages]
_FIELDS: Final[dict[type, tuple[str, ...]]] = {
    ImuSample: ("gyro_b", "accel_b"), GnssFix: ("lat_deg", "lon_deg"), GnssVelocity: ("v_n",), Reading: ("values",),
    PoseFix: ("p_n", "q_nb_wxyz"), OdometryPose: ("p_o", "q_ob_wxyz"),
}  # fmt: skip


class Fault(NamedTuple):
    """kind: of the messages that it changes; words: one of them is in a sentence that names the cause."""

    kind: str
    change: Change
    words: tuple[str, ...]


def _later(m: Messages, rng: np.random.Generator) -> int:
    """A time of arrival between 20 % and 70 % of the log."""
    first, last = m[0].arrived_ns, m[-1].arrived_ns
    return int(first + rng.uniform(0.2, 0.7) * (last - first))


def _stamps(change: Callable[[int, int, int], int]) -> Change:
    """change(t_ns, arrived_ns, number) -> t_ns."""
    return lambda m, _: [replace(x, t_ns=change(x.t_ns, x.arrived_ns, k)) for k, x in enumerate(m)]


def each(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Change:
    """change(v, rng) of the numbers v of each message, in the order of _FIELDS."""

    def changed(m: Messages, rng: np.random.Generator) -> Messages:
        out: Messages = []
        for x in m:
            names = _FIELDS[type(x)]
            old = [np.atleast_1d(getattr(x, name)) for name in names]
            parts = np.split(change(np.hstack(old), rng), np.cumsum([len(v) for v in old])[:-1])
            values = [v.tolist()[0] if name.endswith("_deg") else tuple(v.tolist()) for name, v in zip(names, parts, strict=True)]
            out.append(replace(x, **dict(zip(names, values, strict=True))))
        return out

    return changed


def later(change: Change) -> Change:
    """From a time on."""

    def changed(m: Messages, rng: np.random.Generator) -> Messages:
        at = _later(m, rng)
        return [x for x in m if x.arrived_ns < at] + change([x for x in m if x.arrived_ns >= at], rng)

    return changed


def step(m: Messages, rng: np.random.Generator) -> Messages:
    """The clock is set."""
    size, at = int(1e9 * rng.choice([-1, 1]) * 10.0 ** rng.uniform(-0.3, 3.5)), _later(m, rng)
    return _stamps(lambda t, a, _: t + size * (a > at))(m, rng)


def speed(m: Messages, rng: np.random.Generator) -> Messages:
    """The clock runs too fast or too slow."""
    k, first = float(rng.choice([0.25, 0.5, 0.8, 0.97, 1.05, 1.5, 2.0, 10.0])), m[0].t_ns
    return _stamps(lambda t, _a, _k: first + round(k * (t - first)))(m, rng)


def wrap(m: Messages, rng: np.random.Generator) -> Messages:
    """A 32-bit counter of micro- or milliseconds."""
    size, at = int(2**32 * rng.choice([1_000, 1_000_000])), _later(m, rng)
    return _stamps(lambda t, a, _: t - size * (a > at))(m, rng)


def zone(m: Messages, rng: np.random.Generator) -> Messages:
    """A time zone, or GPS time."""
    ahead = int(1e9 * rng.choice([-7200, 3600, 18, 19800]))
    return _stamps(lambda t, _a, _k: t + ahead)(m, rng)


def batched(m: Messages, rng: np.random.Generator) -> Messages:
    """n samples a batch, stamped on arrival."""
    n = int(rng.integers(5, 30))
    last = [m[min(k // n * n + n - 1, len(m) - 1)].arrived_ns for k in range(len(m))]
    return [replace(x, t_ns=last[k] + 10_000 * (k % n), arrived_ns=last[k] + 10_000 * (k % n)) for k, x in enumerate(m)]


def two_clocks(m: Messages, rng: np.random.Generator) -> Messages:
    """Every second or third message is of a sender whose clock differs."""
    n, off = int(rng.integers(2, 4)), int(1e9 * rng.uniform(0.3, 5.0))
    return _stamps(lambda t, _a, k: t - off * (k % n == 0))(m, rng)


def silent(m: Messages, rng: np.random.Generator) -> Messages:
    """A gap, or the end."""
    at, gap = _later(m, rng), int(1e9 * rng.choice([2.5, 8.0, 1e4]))
    return [x for x in m if not at < x.arrived_ns < at + gap]


def slow(m: Messages, rng: np.random.Generator) -> Messages:
    """Logged too rarely."""
    hz = (len(m) - 1) / (1e-9 * (m[-1].arrived_ns - m[0].arrived_ns))
    return m[:: round(hz / rng.uniform(4.0, 15.0))]


def held(m: Messages, rng: np.random.Generator) -> Messages:
    """One reading for 4 s and more under new stamps."""
    at, long = _later(m, rng), int(1e9 * rng.uniform(6.0, 15.0))
    first = next(x for x in m if x.arrived_ns >= at)
    return [replace(first, t_ns=x.t_ns, arrived_ns=x.arrived_ns) if at < x.arrived_ns < at + long else x for x in m]


def repeated(m: Messages, rng: np.random.Generator) -> Messages:
    """Each reading n times."""
    n = int(rng.integers(2, 6))
    return [replace(m[k // n * n], t_ns=x.t_ns, arrived_ns=x.arrived_ns) for k, x in enumerate(m)]


def dead(m: Messages, rng: np.random.Generator) -> Messages:
    """One axis stops, at 0 or at its last value."""
    axis, at = int(rng.integers(6)), _later(m, rng) if rng.random() < 0.7 else 0
    first = next(x for x in m if x.arrived_ns >= at)
    assert isinstance(first, ImuSample)
    value = 0.0 if rng.random() < 0.5 else [*first.gyro_b, *first.accel_b][axis]

    stopped = each(lambda v, _: np.where(np.arange(6) == axis, value, v))
    return [x for x in m if x.arrived_ns < at] + stopped([x for x in m if x.arrived_ns >= at], rng)


def stamps_stop(m: Messages, rng: np.random.Generator) -> Messages:
    """From a time on."""
    at, first = _later(m, rng), m[0].t_ns
    return _stamps(lambda t, a, _: t if a < at else first)(m, rng)


def jitter(m: Messages, rng: np.random.Generator) -> Messages:
    """Of several periods."""
    sigma = float(rng.uniform(2.0, 6.0) * np.median(np.diff([x.t_ns for x in m])))
    return [replace(x, t_ns=round(x.t_ns + sigma * rng.normal())) for x in m]


def lost(m: Messages, rng: np.random.Generator) -> Messages:
    """Single samples, at random."""
    share = rng.uniform(0.3, 0.7)
    return [x for x in m if rng.random() > share]


def holes(m: Messages, rng: np.random.Generator) -> Messages:
    """Of half a second, every few seconds."""
    long, every = rng.uniform(0.4, 0.8), rng.uniform(2.0, 4.0)
    return [x for x in m if (x.arrived_ns * 1e-9) % every > long]


def late(m: Messages, rng: np.random.Generator) -> Messages:
    """Stamped on arrival, by 0.5 to 1.3 s."""
    by = int(1e9 * rng.uniform(0.5, 1.3))
    return [replace(x, t_ns=x.t_ns + by, arrived_ns=x.arrived_ns + by) for x in m]


def without_gravity(m: Messages, rng: np.random.Generator) -> Messages:
    """As an attitude filter removes it: along the mean specific force of the last second."""
    force = np.array([x.accel_b for x in m if isinstance(x, ImuSample)])
    total = np.vstack([np.zeros(3), np.cumsum(force, axis=0)])
    n = max(1, round(1e9 * len(m) / (m[-1].arrived_ns - m[0].arrived_ns)))
    first = np.maximum(0, np.arange(len(m)) + 1 - n)
    mean = (total[1:] - total[first]) / (np.arange(len(m)) + 1 - first)[:, None]
    left = iter(force - GRAVITY * mean / np.linalg.norm(mean, axis=1)[:, None])
    return each(lambda v, _: np.hstack([v[:3], next(left)]))(m, rng)


def jammed(m: Messages, rng: np.random.Generator) -> Messages:
    """Noise grows, the reported accuracy does not."""
    sigma = rng.uniform(15.0, 40.0) / 111e3
    return later(each(lambda v, r: v + sigma * r.normal(size=2)))(
        [replace(x, covariance_n=np.diag([1.0, 1.0, 2.0])) for x in m], rng
    )


def elsewhere(m: Messages, rng: np.random.Generator) -> Messages:
    """A receiver that is spoofed to 50 to 1,000 m away."""
    way, course = 10.0 ** rng.uniform(1.7, 3.0) / 111e3, rng.uniform(0.0, 2.0 * np.pi)
    return later(each(lambda v, _: v + way * np.array([np.cos(course), np.sin(course) / np.cos(np.radians(v[0]))])))(m, rng)


def not_a_number(m: Messages, rng: np.random.Generator) -> Messages:
    """From a time on; of an IMU, one axis; of a receiver, the latitude."""
    axis = int(rng.integers(6)) if isinstance(m[0], ImuSample) else 0
    return later(each(lambda v, _: np.where(np.arange(len(v)) == axis, np.nan, v)))(m, rng)


def reset(m: Messages, rng: np.random.Generator) -> Messages:
    """An odometry that begins anew."""
    far = rng.uniform(4.0, 20.0) * np.array([*np.sign(rng.normal(size=2)), *np.zeros(5)])
    return later(each(lambda v, _: v - far))(m, rng)


def turned(m: Messages, rng: np.random.Generator) -> Messages:
    """Axes of the body exchanged: R exp(angle axis)."""
    axis, angle = "zyx"[int(rng.integers(3))], float(rng.choice([-90.0, 45.0, 90.0, 180.0]))
    by = Rotation.from_euler(axis, angle, degrees=True)
    return each(lambda v, _: np.hstack([v[:3], (_attitude(v) * by).as_quat(scalar_first=True)]))(m, rng)


def east_north_up(v: np.ndarray, _: np.random.Generator) -> np.ndarray:
    """A pose in ROS's frame, taken for north, east, down."""
    to_enu = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return np.hstack([to_enu.apply(v[:3]), (to_enu * _attitude(v)).as_quat(scalar_first=True)])


def _attitude(v: np.ndarray) -> Rotation:
    return Rotation.from_quat(v[3:], scalar_first=True)


def minutes(v: np.ndarray, _: np.random.Generator) -> np.ndarray:
    """ddmm.mmmm / 100."""
    return np.asarray(np.trunc(v) + 0.6 * (v - np.trunc(v)))


DEG: Final = 180.0 / np.pi
_INVERSE: Final = (1, 1, 1, 1, -1, -1, -1)
_FORCE: Final = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
_ALL = ("imu", "gnss", "velocity", "pose", "baro", "field")
_STEPS, _SPEED = ("jump", "fall back"), ("times the speed", "drift")
FAULTS: Final[dict[str, Fault]] = {
    **{f"{kind} clock set": Fault(kind, step, _STEPS) for kind in ("imu", "gnss", "pose")},
    **{f"{kind} clock speed": Fault(kind, speed, _SPEED) for kind in ("imu", "gnss", "pose")},
    **{f"{kind} counter wraps": Fault(kind, wrap, ("wrapped",)) for kind in ("imu", "gnss")},
    **{f"{kind} seconds missing": Fault(kind, _stamps(lambda t, _a, _k: t % 10**9), ("only the nanoseconds",))
       for kind in ("imu", "gnss")},
    **{f"{kind} stamp never set": Fault(kind, _stamps(lambda _t, _a, _k: 0), ("stamps are the same",))
       for kind in ("imu", "gnss", "baro")},
    **{f"{kind} in another time": Fault(kind, zone, ("time zone", "GPS time")) for kind in ("imu", "gnss", "velocity")},
    **{f"{kind} two clocks": Fault(kind, two_clocks, ("two clocks",)) for kind in ("imu", "gnss")},
    "imu stamps float32": Fault("imu", _stamps(lambda t, _a, _k: round(float(np.float32(t * 1e-9)) * 1e9)), ("stamps",)),
    "imu batched": Fault("imu", batched, ("batches",)),
    "imu silent": Fault("imu", silent, ("silent", "ends")),
    "imu too slow": Fault("imu", slow, ("samples a second",)),
    **{f"{kind} held": Fault(kind, held, ("repeats one reading",)) for kind in _ALL},
    **{f"{kind} repeated": Fault(kind, repeated, ("stands",)) for kind in ("imu", "gnss")},
    "imu axis dead": Fault("imu", dead, ("without any change",)),
    "imu gyro in deg/s": Fault("imu", each(lambda v, _: v * [DEG, DEG, DEG, 1, 1, 1]), ("deg/s",)),
    "imu accel in g": Fault("imu", each(lambda v, _: v / [1, 1, 1, 9.80665, 9.80665, 9.80665]), ("in g",)),
    "imu other convention": Fault("imu", each(lambda v, _: v * [1, -1, -1, 1, -1, -1]), ("other convention",)),
    "imu on its side": Fault("imu", each(lambda v, _: v[[0, 2, 1, 3, 5, 4]] * [1, -1, 1, 1, -1, 1]), ("mounted",)),
    "imu gravity removed": Fault("imu", without_gravity, ("gravity is missing",)),
    "gyro mirrored": Fault("turning", each(lambda v, _: v * [1, 1, -1, 1, 1, 1]), ("mirrored", "turned")),
    **{f"{kind} not a number": Fault(kind, not_a_number, ("not a number",)) for kind in ("imu", "gnss")},
    **{f"{kind} twice": Fault(kind, lambda m, _: [x for x in m for _ in range(2)], ("comes 2 times",))
       for kind in ("imu", "gnss", "velocity")},
    **{f"{kind} stamps stop": Fault(kind, stamps_stop, ("stamps",)) for kind in ("imu", "gnss")},
    "imu stamps jitter": Fault("imu", jitter, ("go back",)),
    **{f"imu {name}": Fault("imu", change, ("missing",)) for name, change in (("loses samples", lost), ("has holes", holes))},
    "imu sensors exchanged": Fault("imu", each(lambda v, _: v[[3, 4, 5, 0, 1, 2]]), ("are exchanged",)),
    "imu reversed force": Fault("imu", each(lambda v, _: v * [1, 1, 1, -1, -1, -1]), ("the other sign",)),
    "imu of other bytes": Fault("imu", each(lambda v, _: v.astype("<f4").view(">f4").astype(float)),
                                ("no sensor", "not a number")),
    "imu shaken": Fault("imu", later(each(lambda v, r: v + 20.0 * r.normal(size=6) * _FORCE)), ("scatter",)),
    "gyro of another scale": Fault("turning", each(lambda v, _: v * [2, 2, 2, 1, 1, 1]), ("it turns 2",)),
    "gyro offset": Fault("turning", each(lambda v, _: np.add(v, [0.2, -0.1, 0.3, 0.0, 0.0, 0.0])), ("gyroscope",)),
    "gyro rounded": Fault("imu", each(lambda v, _: np.array([*(0.05 * np.round(20.0 * v[:3])), *v[3:]])), ("rounded",)),
    "gnss spoofed": Fault("gnss", elsewhere, ("jump",)),
    "gnss outliers": Fault("gnss", each(lambda v, r: v + (r.random(2) < 0.1) * r.normal(size=2) * 3e-3), ("jump", "scatter")),
    "gnss sometimes at 0, 0": Fault("gnss", each(lambda v, r: 0.0 * v if r.random() < 0.3 else v), ("latitude 0",)),
    "gnss minutes": Fault("gnss", each(minutes), ("minutes are written",)),
    "gnss of 4 digits": Fault("gnss", each(lambda v, _: np.round(v, 4)), ("rounded",)),
    "gnss in 1e-7 degrees": Fault("gnss", each(lambda v, _: 1e7 * v), ("degrees",)),
    "gnss sure of itself": Fault("gnss", lambda m, _: [replace(x, covariance_n=1e-8 * np.eye(3)) for x in m], ("accuracy",)),
    "velocity of the body": Fault("velocity", each(lambda v, _: np.array([np.hypot(v[0], v[1]), 0.0, v[2]])), ("body",)),
    **{f"{kind} late": Fault(kind, late, ("late",)) for kind in ("pose", "odometry", "moving")},
    "odometry reset": Fault("odometry", reset, ("jump",)),
    "pose inverse": Fault("pose", each(lambda v, _: v * _INVERSE), ("inverse",)),
    "odometry inverse": Fault("odometry", each(lambda v, _: v * _INVERSE), ("inverse",)),
    "pose x, y, z, w": Fault("pose", each(lambda v, _: v[[0, 1, 2, 4, 5, 6, 3]]), ("x, y, z, w",)),
    "pose of angles": Fault("pose", each(lambda v, _: v * [1, 1, 1, *[57.3] * 4]), ("length",)),
    "pose of another map": Fault("pose", later(each(lambda v, _: np.add(v, [9.0, -12.0, 1.0, 0, 0, 0, 0]))), ("jump",)),
    "pose in centimetres": Fault("pose", each(lambda v, _: v * [100, 100, 100, 1, 1, 1, 1]), ("centimetres",)),
    "odometry twice as long": Fault("odometry", each(lambda v, _: v * [2, 2, 2, 1, 1, 1, 1]), ("times too large",)),
    "velocity noise": Fault("velocity", later(each(lambda v, r: v + 6.0 * r.normal(size=3))), ("scatter",)),
    "baro noise": Fault("baro", later(each(lambda v, r: v + 300.0 * r.normal())), ("scatter",)),
    "baro jumps": Fault("baro", later(each(lambda v, _: v + 500.0)), ("jump",)),
    "gnss exchanged": Fault("gnss", each(lambda v, _: v[::-1]), ("exchanged",)),
    "gnss longitude sign": Fault("gnss", each(lambda v, _: v * [1, -1]), ("wrong sign",)),
    "gnss elsewhere": Fault("gnss", each(lambda v, _: v - [25.0, 0.0]), ("from [map] origin",)),
    "gnss at 0, 0": Fault("gnss", each(lambda v, _: 0.0 * v), ("latitude 0",)),
    "gnss jammed": Fault("gnss", jammed, ("scatter",)),
    "velocity km/h": Fault("velocity", each(lambda v, _: 3.6 * v), ("km/h",)),
    "velocity exchanged": Fault("velocity", each(lambda v, _: v[[1, 0, 2]]), ("exchanged",)),
    "velocity reversed": Fault("velocity", each(lambda v, _: -v), ("reversed",)),
    "pose turned": Fault("pose", turned, ("turned",)),
    "pose east north up": Fault("pose", each(east_north_up), ("gravity",)),
    "pose level": Fault("pose", each(lambda v, _: np.array([*v[:3], 1.0, 0.0, 0.0, 0.0])), ("attitude does not fit",)),
    "odometry turned": Fault("odometry", turned, ("turned",)),
    "baro in hPa": Fault("baro", each(lambda v, _: 0.01 * v), ("hPa",)),
    "field mirrored": Fault("field", each(lambda v, _: v * [1.0, -1.0, 1.0]), ("mirrored",)),
    "field 0": Fault("field", each(lambda v, _: 0.0 * v), ("all its readings are 0",)),
    "field in gauss": Fault("field", each(lambda v, _: 1e4 * v), ("gauss",)),
}  # fmt: skip
