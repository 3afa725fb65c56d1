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


class Fault(NamedTuple):
    """kind: of the messages that it changes; words: one of them is in a sentence that names the cause."""

    kind: str
    change: Change
    words: tuple[str, ...]


def _later(m: Messages, rng: np.random.Generator) -> int:
    """A time of arrival between 20 % and 70 % of the log."""
    first, last = m[0].arrived_ns, m[-1].arrived_ns
    return int(first + rng.uniform(0.2, 0.7) * (last - first))


def _stamps(change: Callable[[int, int, int], int]) -> Callable[[Messages, int], Messages]:
    """change(t_ns, arrived_ns, number) -> t_ns."""
    return lambda m, _: [replace(x, t_ns=change(x.t_ns, x.arrived_ns, k)) for k, x in enumerate(m)]


def step(m: Messages, rng: np.random.Generator) -> Messages:
    """The clock is set."""
    size, at = int(1e9 * rng.choice([-1, 1]) * 10.0 ** rng.uniform(-0.3, 3.5)), _later(m, rng)
    return _stamps(lambda t, a, _: t + size * (a > at))(m, 0)


def speed(m: Messages, rng: np.random.Generator) -> Messages:
    """The clock runs too fast or too slow."""
    k, first = float(rng.choice([0.25, 0.5, 0.8, 0.97, 1.05, 1.5, 2.0, 10.0])), m[0].t_ns
    return _stamps(lambda t, _a, _k: first + round(k * (t - first)))(m, 0)


def wrap(m: Messages, rng: np.random.Generator) -> Messages:
    """A 32-bit counter of micro- or milliseconds."""
    size, at = int(2**32 * rng.choice([1_000, 1_000_000])), _later(m, rng)
    return _stamps(lambda t, a, _: t - size * (a > at))(m, 0)


def nanoseconds(m: Messages, _: np.random.Generator) -> Messages:
    """The seconds are not set."""
    return _stamps(lambda t, _a, _k: t % 10**9)(m, 0)


def never_set(m: Messages, _: np.random.Generator) -> Messages:
    """Stamp 0."""
    return _stamps(lambda _t, _a, _k: 0)(m, 0)


def zone(m: Messages, rng: np.random.Generator) -> Messages:
    """A time zone, or GPS time."""
    ahead = int(1e9 * rng.choice([-7200, 3600, 18, 19800]))
    return _stamps(lambda t, _a, _k: t + ahead)(m, 0)


def float32(m: Messages, _: np.random.Generator) -> Messages:
    """Seconds since 1970 as float32."""
    return _stamps(lambda t, _a, _k: round(float(np.float32(t * 1e-9)) * 1e9))(m, 0)


def batched(m: Messages, rng: np.random.Generator) -> Messages:
    """n samples a batch, stamped on arrival."""
    n = int(rng.integers(5, 30))
    last = [m[min(k // n * n + n - 1, len(m) - 1)].arrived_ns for k in range(len(m))]
    return [replace(x, t_ns=last[k] + 10_000 * (k % n), arrived_ns=last[k] + 10_000 * (k % n)) for k, x in enumerate(m)]


def two_clocks(m: Messages, rng: np.random.Generator) -> Messages:
    """Every second or third message is of a sender whose clock differs."""
    n, off = int(rng.integers(2, 4)), int(1e9 * rng.uniform(0.3, 5.0))
    return _stamps(lambda t, _a, k: t - off * (k % n == 0))(m, 0)


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


def _imu(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def changed(m: Messages, _: np.random.Generator) -> Messages:
        out: Messages = []
        for x in m:
            assert isinstance(x, ImuSample)
            v = change(np.array([*x.gyro_b, *x.accel_b])).tolist()
            out.append(replace(x, gyro_b=tuple(v[:3]), accel_b=tuple(v[3:])))
        return out

    return changed


def without_gravity(m: Messages, _: np.random.Generator) -> Messages:
    """As an attitude filter removes it: along the mean specific force of the last second."""
    force = np.array([x.accel_b for x in m if isinstance(x, ImuSample)])
    total = np.vstack([np.zeros(3), np.cumsum(force, axis=0)])
    n = max(1, round(1e9 * len(m) / (m[-1].arrived_ns - m[0].arrived_ns)))
    first = np.maximum(0, np.arange(len(m)) + 1 - n)
    mean = (total[1:] - total[first]) / (np.arange(len(m)) + 1 - first)[:, None]
    left = force - GRAVITY * mean / np.linalg.norm(mean, axis=1)[:, None]
    return [replace(x, accel_b=tuple(f)) for x, f in zip(m, left.tolist(), strict=True)]


def dead(m: Messages, rng: np.random.Generator) -> Messages:
    """One axis stops, at 0 or at its last value."""
    axis, at = int(rng.integers(6)), _later(m, rng) if rng.random() < 0.7 else 0
    first = next(x for x in m if x.arrived_ns >= at)
    assert isinstance(first, ImuSample)
    value = 0.0 if rng.random() < 0.5 else [*first.gyro_b, *first.accel_b][axis]

    def stopped(v: np.ndarray) -> np.ndarray:
        v[axis] = value
        return v

    return [x for x in m if x.arrived_ns < at] + _imu(stopped)([x for x in m if x.arrived_ns >= at], rng)


def mirrored_gyro(m: Messages, rng: np.random.Generator) -> Messages:
    """One axis of the gyroscope has the wrong sign."""
    sign = np.ones(6)
    sign[2] = -1.0
    return _imu(lambda v: v * sign)(m, rng)


def _fix(change: Callable[[float, float, np.random.Generator], tuple[float, float]]) -> Change:
    def changed(m: Messages, rng: np.random.Generator) -> Messages:
        out: Messages = []
        for x in m:
            assert isinstance(x, GnssFix)
            lat, lon = change(x.lat_deg, x.lon_deg, rng)
            out.append(replace(x, lat_deg=lat, lon_deg=lon))
        return out

    return changed


def jammed(m: Messages, rng: np.random.Generator) -> Messages:
    """Noise grows, the reported accuracy does not."""
    sigma = rng.uniform(15.0, 40.0) / 111e3
    kept = [replace(x, covariance_n=np.diag([1.0, 1.0, 2.0])) for x in m]
    return later(_fix(lambda a, b, r: (a + r.normal() * sigma, b + r.normal() * sigma)))(kept, rng)


def _velocity(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def changed(m: Messages, _: np.random.Generator) -> Messages:
        return [replace(x, v_n=tuple(change(np.array(x.v_n)).tolist())) for x in m if isinstance(x, GnssVelocity)]

    return changed


def _reading(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    def changed(m: Messages, _: np.random.Generator) -> Messages:
        return [replace(x, values=tuple(change(np.array(x.values)).tolist())) for x in m if isinstance(x, Reading)]

    return changed


def _noise(of: Callable[[Callable[[np.ndarray], np.ndarray]], Change], sigma: float) -> Change:
    """White, on each component."""
    return lambda m, rng: of(lambda v: v + sigma * rng.normal(size=v.shape))(m, rng)


def _pose(turn: bool, factor: float) -> Change:
    def changed(m: Messages, rng: np.random.Generator) -> Messages:
        axis, angle = "zyx"[int(rng.integers(3))], float(rng.choice([-90.0, 45.0, 90.0, 180.0]))
        by = Rotation.from_euler(axis, angle, degrees=True)
        out: Messages = []
        for x in m:
            if isinstance(x, PoseFix | OdometryPose):
                q = x.q_nb_wxyz if isinstance(x, PoseFix) else x.q_ob_wxyz
                w, *v = (Rotation.from_quat([*q[1:], q[0]]) * by).as_quat()[[3, 0, 1, 2]].tolist()
                turned = (w, *v) if turn else q
                if isinstance(x, PoseFix):
                    out.append(replace(x, q_nb_wxyz=turned, p_n=tuple((factor * np.array(x.p_n)).tolist())))
                else:
                    out.append(replace(x, q_ob_wxyz=turned))
        return out

    return changed


def east_north_up(m: Messages, _: np.random.Generator) -> Messages:
    """Poses in ROS's frame, taken for north, east, down."""
    to_enu = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    out: Messages = []
    for x in m:
        assert isinstance(x, PoseFix)
        w, *v = (to_enu * Rotation.from_quat([*x.q_nb_wxyz[1:], x.q_nb_wxyz[0]])).as_quat()[[3, 0, 1, 2]].tolist()
        out.append(replace(x, p_n=tuple(to_enu.apply(x.p_n).tolist()), q_nb_wxyz=(w, *v)))
    return out


def level_poses(m: Messages, _: np.random.Generator) -> Messages:
    """Positions with an attitude that never changes."""
    return [replace(x, q_nb_wxyz=(1.0, 0.0, 0.0, 0.0)) for x in m if isinstance(x, PoseFix)]


def later(change: Change) -> Change:
    """From a time on."""

    def changed(m: Messages, rng: np.random.Generator) -> Messages:
        at = _later(m, rng)
        return [x for x in m if x.arrived_ns < at] + change([x for x in m if x.arrived_ns >= at], rng)

    return changed


def not_a_number(m: Messages, rng: np.random.Generator) -> Messages:
    """From a time on; of an IMU, one axis."""
    nan = np.where(np.arange(6) == int(rng.integers(6)), np.nan, 1.0)
    return later(_imu(lambda v: v * nan) if isinstance(m[0], ImuSample) else _fix(lambda _, b, _r: (np.nan, b)))(m, rng)


def twice(m: Messages, _: np.random.Generator) -> Messages:
    """Two bridges."""
    return [x for x in m for _ in range(2)]


def stamps_stop(m: Messages, rng: np.random.Generator) -> Messages:
    """From a time on."""
    at, first = _later(m, rng), m[0].t_ns
    return _stamps(lambda t, a, _: t if a < at else first)(m, 0)


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


def elsewhere(m: Messages, rng: np.random.Generator) -> Messages:
    """A receiver that is spoofed to 50 to 1,000 m away."""
    way, course = 10.0 ** rng.uniform(1.7, 3.0) / 111e3, rng.uniform(0.0, 2.0 * np.pi)
    return later(_fix(lambda a, b, _: (a + way * np.cos(course), b + way * np.sin(course) / np.cos(np.radians(a)))))(m, rng)


def outliers(m: Messages, _: np.random.Generator) -> Messages:
    """Of some hundred metres, one in ten."""
    return _fix(lambda a, b, r: (a + (r.random() < 0.1) * r.normal() * 3e-3, b + (r.random() < 0.1) * r.normal() * 3e-3))(m, _)


def _rounded(digits: int) -> Change:
    return _fix(lambda a, b, _: (round(a, digits), round(b, digits)))


def _moved_pose(change: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]) -> Change:
    """change(p, q)."""

    def changed(m: Messages, _: np.random.Generator) -> Messages:
        out: Messages = []
        for x in m:
            if isinstance(x, PoseFix):
                p, q = change(np.array(x.p_n), np.array(x.q_nb_wxyz))
                out.append(replace(x, p_n=tuple(p.tolist()), q_nb_wxyz=tuple(q.tolist())))
            elif isinstance(x, OdometryPose):
                p, q = change(np.array(x.p_o), np.array(x.q_ob_wxyz))
                out.append(replace(x, p_o=tuple(p.tolist()), q_ob_wxyz=tuple(q.tolist())))
        return out

    return changed


def late(m: Messages, rng: np.random.Generator) -> Messages:
    """Stamped on arrival, by 0.5 to 1.3 s."""
    by = int(1e9 * rng.uniform(0.5, 1.3))
    return [replace(x, t_ns=x.t_ns + by, arrived_ns=x.arrived_ns + by) for x in m]


def minutes(deg: float) -> float:
    """ddmm.mmmm / 100."""
    return float(np.trunc(deg) + 0.6 * (deg - np.trunc(deg)))


def reset(m: Messages, rng: np.random.Generator) -> Messages:
    """An odometry that begins anew."""
    far = rng.uniform(4.0, 20.0) * np.array([*np.sign(rng.normal(size=2)), 0.0])
    return later(_moved_pose(lambda p, q: (p - far, q)))(m, rng)


DEG: Final = 180.0 / np.pi
_INVERSE: Final = (1.0, -1.0, -1.0, -1.0)
_FORCE: Final = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
_ALL = ("imu", "gnss", "velocity", "pose", "baro", "field")
_STEPS, _SPEED = ("jump", "fall back"), ("times the speed", "drift")
FAULTS: Final[dict[str, Fault]] = {
    **{f"{kind} clock set": Fault(kind, step, _STEPS) for kind in ("imu", "gnss", "pose")},
    **{f"{kind} clock speed": Fault(kind, speed, _SPEED) for kind in ("imu", "gnss", "pose")},
    **{f"{kind} counter wraps": Fault(kind, wrap, ("wrapped",)) for kind in ("imu", "gnss")},
    **{f"{kind} seconds missing": Fault(kind, nanoseconds, ("only the nanoseconds",)) for kind in ("imu", "gnss")},
    **{f"{kind} stamp never set": Fault(kind, never_set, ("stamps are the same",)) for kind in ("imu", "gnss", "baro")},
    **{f"{kind} in another time": Fault(kind, zone, ("time zone", "GPS time")) for kind in ("imu", "gnss", "velocity")},
    **{f"{kind} two clocks": Fault(kind, two_clocks, ("two clocks",)) for kind in ("imu", "gnss")},
    "imu stamps float32": Fault("imu", float32, ("stamps",)),
    "imu batched": Fault("imu", batched, ("batches",)),
    "imu silent": Fault("imu", silent, ("silent", "ends")),
    "imu too slow": Fault("imu", slow, ("samples a second",)),
    **{f"{kind} held": Fault(kind, held, ("repeats one reading",)) for kind in _ALL},
    **{f"{kind} repeated": Fault(kind, repeated, ("stands",)) for kind in ("imu", "gnss")},
    "imu axis dead": Fault("imu", dead, ("without any change",)),
    "imu gyro in deg/s": Fault("imu", _imu(lambda v: v * [DEG, DEG, DEG, 1, 1, 1]), ("deg/s",)),
    "imu accel in g": Fault("imu", _imu(lambda v: v / [1, 1, 1, 9.80665, 9.80665, 9.80665]), ("in g",)),
    "imu other convention": Fault("imu", _imu(lambda v: v * [1, -1, -1, 1, -1, -1]), ("other convention",)),
    "imu on its side": Fault("imu", _imu(lambda v: v[[0, 2, 1, 3, 5, 4]] * [1, -1, 1, 1, -1, 1]), ("mounted",)),
    "imu gravity removed": Fault("imu", without_gravity, ("gravity is missing",)),
    "gyro mirrored": Fault("turning", mirrored_gyro, ("mirrored", "turned")),
    **{f"{kind} not a number": Fault(kind, not_a_number, ("not a number",)) for kind in ("imu", "gnss")},
    **{f"{kind} twice": Fault(kind, twice, ("comes 2 times",)) for kind in ("imu", "gnss", "velocity")},
    **{f"{kind} stamps stop": Fault(kind, stamps_stop, ("stamps",)) for kind in ("imu", "gnss")},
    "imu stamps jitter": Fault("imu", jitter, ("go back",)),
    **{f"imu {name}": Fault("imu", change, ("missing",)) for name, change in (("loses samples", lost), ("has holes", holes))},
    "imu sensors exchanged": Fault("imu", _imu(lambda v: v[[3, 4, 5, 0, 1, 2]]), ("are exchanged",)),
    "imu reversed force": Fault("imu", _imu(lambda v: v * [1, 1, 1, -1, -1, -1]), ("the other sign",)),
    "imu of other bytes": Fault("imu", _imu(lambda v: v.astype("<f4").view(">f4").astype(float)), ("no sensor", "not a number")),
    "imu shaken": Fault("imu", later(lambda m, r: _imu(lambda v: v + 20.0 * r.normal(size=6) * _FORCE)(m, r)), ("scatter",)),
    "gyro of another scale": Fault("turning", _imu(lambda v: v * [2, 2, 2, 1, 1, 1]), ("it turns 2",)),
    "gyro offset": Fault("turning", _imu(lambda v: np.add(v, [0.2, -0.1, 0.3, 0.0, 0.0, 0.0])), ("gyroscope",)),
    "gyro rounded": Fault("imu", _imu(lambda v: np.array([*(0.05 * np.round(20.0 * v[:3])), *v[3:]])), ("rounded",)),
    "gnss spoofed": Fault("gnss", elsewhere, ("jump",)),
    "gnss outliers": Fault("gnss", outliers, ("jump", "scatter")),
    "gnss sometimes at 0, 0": Fault("gnss", _fix(lambda a, b, r: (0.0, 0.0) if r.random() < 0.3 else (a, b)), ("latitude 0",)),
    "gnss minutes": Fault("gnss", _fix(lambda a, b, _: (minutes(a), minutes(b))), ("minutes are written",)),
    "gnss of 4 digits": Fault("gnss", _rounded(4), ("rounded",)),
    "gnss in 1e-7 degrees": Fault("gnss", _fix(lambda a, b, _: (1e7 * a, 1e7 * b)), ("degrees",)),
    "gnss sure of itself": Fault("gnss", lambda m, _: [replace(x, covariance_n=1e-8 * np.eye(3)) for x in m], ("accuracy",)),
    "velocity of the body": Fault("velocity", _velocity(lambda v: np.array([np.hypot(v[0], v[1]), 0.0, v[2]])), ("body",)),
    **{f"{kind} late": Fault(kind, late, ("late",)) for kind in ("pose", "odometry", "moving")},
    "odometry reset": Fault("odometry", reset, ("jump",)),
    "pose inverse": Fault("pose", _moved_pose(lambda p, q: (p, q * _INVERSE)), ("inverse",)),
    "odometry inverse": Fault("odometry", _moved_pose(lambda p, q: (p, q * _INVERSE)), ("inverse",)),
    "pose x, y, z, w": Fault("pose", _moved_pose(lambda p, q: (p, q[[1, 2, 3, 0]])), ("x, y, z, w",)),
    "pose of angles": Fault("pose", _moved_pose(lambda p, q: (p, 57.3 * q)), ("length",)),
    "pose of another map": Fault("pose", later(_moved_pose(lambda p, q: (np.add(p, [9.0, -12.0, 1.0]), q))), ("jump",)),
    "pose in centimetres": Fault("pose", _moved_pose(lambda p, q: (100.0 * p, q)), ("centimetres",)),
    "odometry twice as long": Fault("odometry", _moved_pose(lambda p, q: (2.0 * p, q)), ("times too large",)),
    "velocity noise": Fault("velocity", later(_noise(_velocity, 6.0)), ("scatter",)),
    "baro noise": Fault("baro", later(_noise(_reading, 300.0)), ("scatter",)),
    "baro jumps": Fault("baro", later(_reading(lambda v: v + 500.0)), ("jump",)),
    "gnss exchanged": Fault("gnss", _fix(lambda a, b, _: (b, a)), ("exchanged",)),
    "gnss longitude sign": Fault("gnss", _fix(lambda a, b, _: (a, -b)), ("wrong sign",)),
    "gnss elsewhere": Fault("gnss", _fix(lambda a, b, _: (a - 25.0, b)), ("from [map] origin",)),
    "gnss at 0, 0": Fault("gnss", _fix(lambda _a, _b, _r: (0.0, 0.0)), ("latitude 0",)),
    "gnss jammed": Fault("gnss", jammed, ("scatter",)),
    "velocity km/h": Fault("velocity", _velocity(lambda v: 3.6 * v), ("km/h",)),
    "velocity exchanged": Fault("velocity", _velocity(lambda v: v[[1, 0, 2]]), ("exchanged",)),
    "velocity reversed": Fault("velocity", _velocity(lambda v: -v), ("reversed",)),
    "pose turned": Fault("pose", _pose(True, 1.0), ("turned",)),
    "pose east north up": Fault("pose", east_north_up, ("gravity",)),
    "pose level": Fault("pose", level_poses, ("attitude does not fit",)),
    "odometry turned": Fault("odometry", _pose(True, 1.0), ("turned",)),
    "baro in hPa": Fault("baro", _reading(lambda v: 0.01 * v), ("hPa",)),
    "field mirrored": Fault("field", _reading(lambda v: v * [1.0, -1.0, 1.0]), ("mirrored",)),
    "field 0": Fault("field", _reading(lambda v: 0.0 * v), ("all its readings are 0",)),
    "field in gauss": Fault("field", _reading(lambda v: 1e4 * v), ("gauss",)),
}  # fmt: skip
