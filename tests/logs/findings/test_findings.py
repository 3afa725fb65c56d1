"""Each fault of stamps, values or axes is named at the stream that has it; sound streams are not accused."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.findings import Finding, position, pull, together
from logs.findings.judge import judged
from logs.findings.streams import FIX, IMU, ODOMETRY, POSE, VELOCITY, Stream, row
from models.frames import GRAVITY
from models.messages import Array, PoseFix, Vec3

ORIGIN = (47.4, 8.5, 500.0)
RATES = {"/imu": (IMU, 100.0), "/gnss": (FIX, 5.0), "/gnss/velocity": (VELOCITY, 5.0), "/pose_fix": (POSE, 2.0),
         "/odometry": (ODOMETRY, 10.0), "/mag": ("magnetometer", 10.0), "/baro": ("baro", 10.0)}  # fmt: skip
Streams = dict[str, Stream]
Fault = Callable[[Stream, np.random.Generator], tuple[Stream, str]]


def _values(kind: str, t: Array, rng: np.random.Generator, lean: float) -> Array:
    """Of a vehicle that weaves along a curve; lean: rad, amplitude of roll and pitch."""
    p = _position(t)
    R = _attitude(t, lean)
    q = (R * Rotation.from_rotvec(rng.normal(scale=0.005, size=(len(t), 3)))).as_quat()[:, [3, 0, 1, 2]]
    if kind == IMU:
        h = 1e-3
        rate = (_attitude(t - h, lean).inv() * _attitude(t + h, lean)).as_rotvec() / (2 * h)
        force = R.inv().apply((_position(t - h) - 2.0 * p + _position(t + h)) / h**2 - [0.0, 0.0, GRAVITY])
        return np.hstack([rate + rng.normal(scale=0.01, size=rate.shape), force + rng.normal(scale=0.1, size=force.shape)])
    if kind == FIX:
        lla = ORIGIN + (p + rng.normal(scale=0.5, size=p.shape)) / [111_195.0, 111_195.0 * np.cos(np.radians(ORIGIN[0])), -1.0]
        return np.column_stack([lla, np.full(len(t), 0.8)])
    if kind == VELOCITY:
        return np.gradient(p, t, axis=0) + rng.normal(scale=0.1, size=p.shape)
    if kind == "magnetometer":
        return np.array([3e-6, -5e-6, 1e-6]) + R.inv().apply([2.1e-5, 1e-6, 4.3e-5]) + rng.normal(scale=2e-7, size=p.shape)
    if kind == "baro":
        return 95_000.0 + 12.0 * p[:, 2:] + rng.normal(scale=5.0, size=(len(t), 1))
    return np.hstack([p + rng.normal(scale=0.1, size=p.shape), q])


def _position(t: Array) -> Array:
    return np.stack([60.0 * np.sin(0.2 * t), 40.0 * np.sin(0.13 * t + 1.0), -20.0 - 5.0 * np.sin(0.3 * t)], axis=1)


def _attitude(t: Array, lean: float) -> Rotation:
    angles = np.stack([0.6 * t + np.sin(0.5 * t), lean * np.sin(0.9 * t), lean * np.sin(1.3 * t + 1.0)], axis=1)
    return Rotation.from_euler("ZYX", angles)


def _sound(seed: int, lean: float = 0.35) -> Streams:
    return dict(_flight(seed, lean))


@cache
def _flight(seed: int, lean: float) -> Streams:
    rng = np.random.default_rng(seed)

    def stream(kind: str, hz: float) -> Stream:
        t = np.arange(0.0, 40.0, 1.0 / hz)
        return Stream(kind, t, t + 0.02 + rng.exponential(0.005, len(t)), _values(kind, t, rng, lean))

    return {topic: stream(*given) for topic, given in RATES.items()}


def _found(streams: Streams, origin: Vec3 | None = ORIGIN) -> list[Finding]:
    return [finding for _, finding in sorted(judged(streams, origin), key=lambda item: item[0])]


def _step(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    step = rng.choice([-1.0, 1.0]) * round(rng.uniform(0.3, 50.0), 1)
    return s._replace(t_s=s.t_s + step * (s.t_s > rng.uniform(8.0, 32.0))), f"jump by {step:+.2f}"


def _speed(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    k = rng.choice([0.5, 0.9, 1.1, 2.0])
    return s._replace(t_s=k * s.t_s), f"runs at {k:.3g}"


def _wrap(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(t_s=s.t_s - 4294.967296 * (s.t_s > rng.uniform(8.0, 32.0))), "microseconds has wrapped"


def _nanoseconds(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(t_s=s.t_s % 1.0), "only the nanoseconds"


def _ahead(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(t_s=s.t_s + 18.0), "GPS time against UTC"


def _batched(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    size = int(rng.integers(4, 30))
    last = np.minimum(np.arange(len(s.t_s)) // size * size + size - 1, len(s.t_s) - 1)
    t_s = s.t_s[last] + 1e-5 * (np.arange(len(s.t_s)) % size)
    return s._replace(t_s=t_s, arrived_s=t_s + 0.01), f"batches of {size}"


def _digits(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(t_s=(s.t_s + 1e9).astype(np.float32).astype(float) - 1e9), "stamps"


def _dead(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    axis, values = int(rng.integers(6)), s.values.copy()
    rows = slice(int(rng.uniform(0.05, 0.8) * len(values)), None)
    values[rows, axis] = rng.choice([0.0, values[rows.start, axis]])
    return s._replace(values=values), f"{'gyroscope' if axis < 3 else 'accelerometer'} {'xyz'[axis % 3]} reads"


def _stuck(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    values, n = s.values.copy(), len(s.values)
    values[n // 2 : n // 2 + n // 4] = values[n // 2]
    return s._replace(values=values), "repeats one reading"


def _silent(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    rows = (s.t_s < 15.0) | (s.t_s > 19.0)
    return Stream(s.kind, s.t_s[rows], s.arrived_s[rows], s.values[rows]), "silent for 4.0 s"


def _of(factor: list[float], words: str) -> Fault:
    return lambda s, _: (s._replace(values=s.values * factor), words)


def _of_columns(columns: list[int], words: str) -> Fault:
    return lambda s, _: (s._replace(values=s.values[:, columns]), words)


def _camera(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    R = Rotation.from_quat(s.values[:, [4, 5, 6, 3]]) * Rotation.from_euler("z", 90.0, degrees=True)
    return s._replace(values=np.hstack([s.values[:, :3], R.as_quat()[:, [3, 0, 1, 2]]])), "turned by"


def _east_north_up(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    to_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    R = Rotation.from_matrix(to_enu) * Rotation.from_quat(s.values[:, [4, 5, 6, 3]])
    return s._replace(values=np.hstack([s.values[:, :3] @ to_enu, R.as_quat()[:, [3, 0, 1, 2]]])), "from gravity"


def _level(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(
        values=np.hstack([s.values[:, :3], np.tile([1.0, 0.0, 0.0, 0.0], (len(s.t_s), 1))])
    ), "attitude does not fit"


def _jammed(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    noise = rng.normal(scale=3e-4, size=(len(s.t_s), 2)) * (s.t_s > 20.0)[:, None]
    return s._replace(values=s.values + np.hstack([noise, 0.0 * noise])), "scatter"


def _not_a_number(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    values, words = s.values.copy(), "are not a number"
    values[int(rng.uniform(0.0, 0.9) * len(values)) :, 0] = rng.choice([np.nan, np.inf])
    return s._replace(values=values), words


def _twice(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return Stream(s.kind, *(np.repeat(x, 2, axis=0) for x in s[1:])), "comes 2 times"


def _jitter(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(t_s=s.t_s + rng.normal(scale=0.03, size=len(s.t_s))), "stamps go back"


def _lost(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    rows = rng.random(len(s.t_s)) > 0.4
    return Stream(s.kind, *(x[rows] for x in s[1:])), "of its samples are missing"


def _offset(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(values=np.add(s.values, [0.1, -0.1, 0.2, 0.0, 0.0, 0.0])), "its gyroscope is off by (0.1"


def _moved(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    away = rng.choice([-1.0, 1.0], 2) * ([1e-3, 1e-3] if s.kind == FIX else [30.0, 40.0])
    values = s.values.copy()
    values[s.t_s > 17.0, :2] += away
    return s._replace(values=values), "jump by"


def _outliers(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    values = s.values.copy()
    values[10::10, 0] += rng.normal(scale=5e-3, size=len(values[10::10]))
    return s._replace(values=values), "jump to and fro"


def _runs_away(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    values = s.values.copy()
    values[:, 0] += 3e-5 * np.maximum(s.t_s - 20.0, 0.0)
    return s._replace(values=values), "run away from /gnss/velocity"


def _noise(sigma: list[float], words: str) -> Fault:
    return lambda s, rng: (s._replace(values=s.values + rng.normal(size=s.values.shape) * sigma), words)


def _nowhere(s: Stream, rng: np.random.Generator) -> tuple[Stream, str]:
    values = s.values.copy()
    values[rng.random(len(s.t_s)) < 0.3, :2] = 0.0
    return s._replace(values=values), "fixes are at latitude 0, longitude 0"


def _late(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(t_s=s.t_s + 0.9, arrived_s=s.arrived_s + 0.9), "0.9 s late against /gnss"


def _inverse(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    return s._replace(values=s.values * [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0]), "inverse"


def _stays(columns: list[int], words: str) -> Fault:
    return lambda s, _: (
        s._replace(values=np.where(np.isin(np.arange(s.values.shape[1]), columns), s.values[0], s.values)),
        words,
    )


def _two_sensors(s: Stream, _: np.random.Generator) -> tuple[Stream, str]:
    other = np.where(np.arange(len(s.t_s)) % 2, 1.0, -1.0)[:, None] ** [0, 1, 1, 0, 1, 1]
    return s._replace(values=s.values * other), "alternate between two sensors"


ONE, DEG = [1.0] * 3, 57.29578
FAULTS = [
    *(("/imu", f) for f in (_step, _speed, _wrap, _nanoseconds, _ahead, _batched, _digits, _dead, _stuck, _silent)),
    *(("/gnss", f) for f in (_step, _speed, _wrap, _nanoseconds, _ahead, _jammed, _stuck)),
    *(("/pose_fix", f) for f in (_step, _speed, _stuck, _camera, _east_north_up, _level)),
    *(("/odometry", f) for f in (_step, _stuck, _camera)),
    *((topic, _stuck) for topic in ("/mag", "/baro", "/gnss/velocity")),
    *((topic, _not_a_number) for topic in RATES),
    *((topic, _twice) for topic in ("/imu", "/gnss", "/gnss/velocity")),
    *(("/imu", f) for f in (_jitter, _lost, _offset)),
    *(("/gnss", f) for f in (_moved, _outliers, _runs_away)),
    ("/gnss", _stays([0, 1], "latitude and longitude stay")),
    ("/gnss", _stays([1], "its longitudes stay")),
    ("/pose_fix", _stays([0, 1, 2], "its position stays")),
    ("/odometry", _stays([0, 1, 2], "its position stays")),
    ("/imu", _two_sensors),
    *((topic, _inverse) for topic in ("/pose_fix", "/odometry")),
    ("/pose_fix", _moved),
    ("/pose_fix", _of_columns([0, 1, 2, 4, 5, 6, 3], "x, y, z, w")),
    ("/pose_fix", _of([1.0] * 3 + [DEG] * 4, "a length of 57.3")),
    ("/odometry", _of([2.0] * 3 + [1.0] * 4, "times too large")),
    ("/odometry", _of([0.75] * 3 + [1.0] * 4, "its ways are 0.7")),
    ("/odometry", _of([1.3] * 3 + [1.0] * 4, "its ways are 1.3")),
    ("/odometry", lambda s, _: (s._replace(values=np.tile(s.values[:1], (len(s.t_s), 1))), "never changes")),
    ("/imu", _of(ONE + [1.15] * 3, "its accelerometer contradicts")),
    ("/gnss", _of([1e7] * 2 + [1.0] * 2, "no degrees")),
    ("/gnss", _of([1.0] * 2 + [1000.0, 1.0], "its height is 5")),
    ("/gnss", _of([*ONE, 1e-4], "reports an accuracy of")),
    ("/gnss", lambda s, _: (s._replace(values=np.hstack([np.round(s.values[:, :2], 4), s.values[:, 2:]])), "rounded to 11 m")),
    ("/gnss/velocity", _of([1.0, 1.0, -1.0], "falls where it rises")),
    ("/gnss/velocity", _of([0.0] * 3, "all its readings are 0 while")),
    ("/gnss/velocity", lambda s, _: (s._replace(values=np.abs(s.values[:, :1]) * [1.0, 0.0, 0.0]), "body's axes")),
    ("/baro", lambda s, _: (s._replace(values=s.values + 500.0 * (s.t_s[:, None] > 17.0)), "its pressure jumps by +49")),
    ("/mag", _of([1.0, 0.0, 1.0], "its y axis reads 0")),
    ("/imu", _of([DEG] * 3 + ONE, "deg/s")),
    ("/imu", _of(ONE + [1.0 / GRAVITY] * 3, "it is in g")),
    ("/imu", _of_columns([3, 4, 5, 0, 1, 2], "the two are exchanged")),
    ("/imu", _of([1e30] * 3 + ONE, "which no sensor does")),
    ("/imu", _of(ONE + [-1.0] * 3, "the accelerometer has the other sign")),
    ("/imu", _of([2.0] * 3 + ONE, "it turns 2")),
    ("/imu", _noise([0.0] * 3 + [25.0] * 3, "accelerometer scatters")),
    ("/gnss/velocity", _noise([5.0, 5.0, 0.0], "velocities scatter")),
    ("/gnss/velocity", _of([0.5] * 3, "2 times too small")),
    ("/baro", _noise([200.0], "pressure scatters")),
    ("/gnss", _nowhere),
    *((topic, _late) for topic in ("/gnss", "/gnss/velocity")),
    ("/odometry", _moved),
    ("/imu", _of([1.0, -1.0, -1.0] * 2, "other convention")),
    ("/imu", _of([1.0, 1.0, -1.0, *ONE], "mirrored")),
    ("/imu", _of_columns([1, 0, 2, 3, 4, 5], "mirrored")),
    ("/gnss", _of_columns([1, 0, 2, 3], "exchanged")),
    ("/gnss", _of([1.0, -1.0, 1.0, 1.0], "longitude has the wrong sign")),
    ("/gnss/velocity", _of([3.6] * 3, "km/h")),
    ("/gnss/velocity", _of_columns([1, 0, 2], "exchanged")),
    ("/pose_fix", _of([100.0] * 3 + [1.0] * 4, "centimetres")),
    ("/pose_fix", _of_columns([1, 0, 2, 3, 4, 5, 6], "north and east are exchanged")),
    ("/mag", _of([1.0, -1.0, 1.0], "mirrored in y")),
    ("/mag", _of([0.0] * 3, "all its readings are 0")),
    ("/mag", _of([1e4] * 3, "gauss")),
    ("/baro", _of([0.01], "hPa")),
]  # fmt: skip


@pytest.mark.parametrize(("topic", "fault"), FAULTS)
def test_the_stream_at_fault_is_named_with_its_cause(topic: str, fault: Fault) -> None:
    streams = _sound(0)
    streams[topic], words = fault(streams[topic], np.random.default_rng(100))
    found = _found(streams)
    assert found
    assert found[0].who == topic
    assert words in found[0].what


def test_an_attitude_that_is_not_given_accuses_nobody() -> None:
    streams = _sound(0)
    fix = PoseFix(0, 0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), np.diag([0.01] * 3 + [10.0] * 3))
    made = row(fix)
    assert made is not None
    poses = streams["/pose_fix"]
    values = np.hstack([poses.values[:, :3], np.tile(made[1][3:], (len(poses.t_s), 1))])
    assert _found({**streams, "/pose_fix": poses._replace(values=values)}) == []


@pytest.mark.parametrize("seed", range(5))
def test_an_attitude_is_not_accused_for_noise_of_the_positions(seed: int) -> None:
    streams = _sound(seed)
    poses = streams["/pose_fix"]
    noise = np.random.default_rng(seed).normal(scale=2.0, size=(len(poses.t_s), 3))
    noisy = poses._replace(values=poses.values + np.pad(noise, ((0, 0), (0, 4))))
    assert pull.pulled(streams["/imu"], noisy) is None


def test_an_odometry_that_stands_still_is_not_accused_for_noise_of_the_fixes() -> None:
    streams = _sound(0)
    odometry, poses = (
        s._replace(values=np.tile(s.values[:1], (len(s.t_s), 1))) for s in (streams["/odometry"], streams["/pose_fix"])
    )
    noise = np.random.default_rng(0).normal(scale=0.5, size=(len(poses.t_s), 3))
    noisy = poses._replace(values=poses.values + np.pad(noise, ((0, 0), (0, 4))))
    assert position.stretched(odometry, noisy, "/pose_fix") is None


def test_samples_that_come_in_batches_are_not_called_missing() -> None:
    streams = _sound(0)
    streams["/imu"], words = _batched(streams["/imu"], np.random.default_rng(0))
    (what,) = [finding.what for finding in _found(streams) if finding.who == "/imu"]
    assert words in what


def test_poses_that_are_late_by_stamp_and_arrival_are_found_by_the_accelerometer() -> None:
    streams = _sound(0)
    poses = streams["/pose_fix"]
    cause = pull.pulled(streams["/imu"], poses._replace(t_s=poses.t_s + 1.0, arrived_s=poses.arrived_s + 1.0))
    assert cause is not None
    assert "1.0 s late" in cause.what


def test_a_log_that_is_played_again_is_named() -> None:
    streams = _sound(0)
    again = {n: s._replace(t_s=s.t_s - 15.0 * (s.arrived_s > 20.0)) for n, s in streams.items()}
    (found,) = _found(again)
    assert (found.who, found.what) == ("/imu", "its stamps jump by -15.00 s, and those of all others with them")


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lean", [0.0, 0.35])
def test_sound_streams_are_not_accused(seed: int, lean: float) -> None:
    assert _found(_sound(seed, lean)) == []


@pytest.mark.parametrize("axis", range(6))
def test_an_axis_without_noise_that_reads_0_from_the_start_is_not_accused(axis: int) -> None:
    streams = _sound(2)
    smooth = np.sin(streams["/imu"].t_s[:, None] * [0.3, 0.4, 0.5, 0.3, 0.4, 0.0]) * 0.1 - [0, 0, 0, 0, 0, GRAVITY]
    smooth[:, axis] = -GRAVITY if axis == 5 else 0.0
    assert _found({"/imu": streams["/imu"]._replace(values=smooth), "/gnss": streams["/gnss"]}) == []


def test_a_receiver_that_speaks_every_five_seconds_is_not_called_jammed() -> None:
    t = np.arange(0.0, 200.0, 5.0)
    assert not _found({"/gnss": Stream(FIX, t, t + 0.02, _values(FIX, t, np.random.default_rng(0), 0.35))})


def test_a_log_recorded_at_half_speed_accuses_nobody() -> None:
    slow = {name: s._replace(arrived_s=2.0 * s.arrived_s) for name, s in _sound(0).items()}
    assert [f for f in _found(slow) if "stamps" in f.what] == []


def test_when_it_began_is_said() -> None:
    streams = _sound(1)
    imu = streams["/imu"]
    streams["/imu"] = imu._replace(t_s=imu.t_s - 1.43 * (imu.t_s > 12.0))
    assert _found(streams)[0].since_s == pytest.approx(12.0, abs=0.1)


def test_late_and_shuffled_fixes_are_no_fault() -> None:
    streams = _sound(3)
    fixes, rng = streams["/pose_fix"], np.random.default_rng(3)
    arrived = fixes.t_s + rng.uniform(0.0, 5.0, len(fixes.t_s))
    order = np.argsort(arrived)
    streams["/pose_fix"] = Stream(POSE, fixes.t_s[order], arrived[order], fixes.values[order])
    assert _found(streams) == []


def test_a_log_of_a_few_samples_cannot_be_navigated_by() -> None:
    imu = _sound(1)["/imu"]
    few = {"/imu": Stream(IMU, imu.t_s[:1], imu.arrived_s[:1], imu.values[:1])}
    (finding,) = [found for _, found in judged(few, ORIGIN)]
    assert finding.unfit
    assert str(finding).startswith("/imu since 0.0 s: 1 sample in all; log the IMU")


def test_a_gyroscope_that_is_stuck_from_the_beginning_beside_axes_that_are_filtered() -> None:
    """Low-pass filtered axes have no white noise, as those of many autopilots' logs."""
    imu = _sound(2)["/imu"]
    values = np.stack([np.convolve(column, np.full(20, 0.05), "same") for column in imu.values.T], axis=1)
    values[:, 0] = -0.0576
    found = [finding for _, finding in judged({"/imu": Stream(IMU, imu.t_s, imu.arrived_s, values)}, ORIGIN)]
    assert "gyroscope x reads -0.0576 without any change" in found[0].what
    values[:, 0] = 0.0
    assert not any("without any change" in f.what for _, f in judged({"/imu": imu._replace(values=values)}, ORIGIN))


def test_a_magnetometer_that_stands_still_is_at_fault_where_the_vehicle_turns() -> None:
    """A simulator's has no noise: at rest it repeats itself."""
    streams = _sound(3)
    held, values = slice(150, 250), streams["/mag"].values.copy()
    values[held] = values[150]
    magnetometer = streams["/mag"]._replace(values=values)
    resting = streams["/imu"].values * [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    turning = [f for _, f in judged({"/mag": magnetometer, "/imu": streams["/imu"]}, ORIGIN)]
    still = [f for _, f in judged({"/mag": magnetometer, "/imu": streams["/imu"]._replace(values=resting)}, ORIGIN)]
    assert any(f.who == "/mag" and "repeats one reading" in f.what for f in turning)
    assert not any("repeats one reading" in f.what for f in still)


@pytest.mark.parametrize("seed", range(12))
def test_whatever_the_numbers_are_it_comes_to_an_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    streams = _sound(seed % 3)
    for topic, s in streams.items():
        rows = slice(*sorted(rng.integers(0, len(s.t_s), 2).tolist()))
        values, t_s = s.values.copy(), s.t_s.copy()
        values[rows, int(rng.integers(values.shape[1]))] = rng.choice([0.0, 1.0, np.nan, np.inf, 1e308, -1e308, 1e-310, 1e18])
        t_s[rows] = rng.choice([0.0, -1e9, 1e9, t_s[-1]])
        n = int(rng.integers(1, len(t_s)))
        streams[topic] = Stream(s.kind, t_s[:n], s.arrived_s[:n], values[:n])
    with np.errstate(all="ignore"):
        assert all(str(finding) for finding in _found(streams))


def test_a_gyroscope_or_an_accelerometer_that_is_off_at_rest_is_named() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 20.0, 0.01)
    values = rng.normal(scale=0.01, size=(len(t), 6)) - [0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY]
    for offset, words in (
        ([0.2, 0, 0, 0, 0, 0], "gravity does not turn"),
        ([0, 0, 0, 0, 0, -1.0], "10.81 m/s^2 at rest"),
        ([0, 0.033, 0.058, 0, 0, -1.52], ""),  # banked by 30 degrees at 85 m/s
        ([0] * 6, ""),
    ):
        found = [f for _, f in judged({"/imu": Stream(IMU, t, t + 0.01, values + offset)}, ORIGIN)]
        assert [f.what for f in found if not words or words not in f.what] == []
        assert bool(found) == bool(words)


def test_one_cause_of_several_topics_is_one_sentence() -> None:
    silent = [Finding(f"/imu{k}", "it is silent", 61.0 + 0.01 * k, "see its cable") for k in range(3)]
    other = Finding("/gnss", "it is silent", 61.0, "see its antenna")
    assert [f.who for f in together([*silent, other])] == ["/imu0, /imu1, /imu2", "/gnss"]
