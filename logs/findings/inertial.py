"""Faults of an IMU: units, axes, dead or clipped axes, low rate."""

from typing import Final

import numpy as np

from logs.findings.streams import IMU, Cause, Stream, runs
from models.frames import GRAVITY
from models.messages import Array

LOWEST_RATE_HZ: Final = 20.0
_FROZEN_S: Final = 2.0
_STUCK_S: Final = 10.0
_LEAST_FROZEN: Final = 20  # samples
_LIVELY: Final = 0.5  # of the samples differ from the one before
_NOISE: Final = -0.2  # lag-1 correlation of differences: -0.5 is white noise, a smooth signal has more than 0
_STILL_WINDOW_S: Final = 1.0
_GRAVITY_BAND: Final = (6.0, 16.0)  # m/s^2, mean over the stillest second: of a lively flight as well
_MIXED_M_S2: Final = 2.0
_SWIFTEST_M_S: Final = 150.0  # of a vehicle that turns for long
_REST_GYRO, _REST_ACCEL = 0.02, 0.15  # rad/s, m/s^2: standard deviations of a second at rest
_OFF_GYRO, _OFF_ACCEL = 0.15, 0.9  # rad/s, m/s^2: more than biases of small sensors
_UPRIGHT: Final = 0.15  # m/s^2: in a banked turn |f| differs more from g
_TILT_DEG: Final = 60.0
_BEGINNING_S: Final = 10.0
_FASTEST_RAD_S: Final = 40.0  # 2300 deg/s: beyond the range of flight gyroscopes
_FASTEST_DEG_S: Final = 5000.0
_STRONGEST_M_S2: Final = 500.0
_SWIFT_RAD_S: Final = 3.0
_FEW_SPIKES: Final = 1e-3  # of all samples; in deg/s more are beyond
_HALF_EMPTY: Final = 0.1  # of all samples
_RANGES: Final = (  # full scales: deg/s, g
    np.radians([125.0, 250.0, 500.0, 1000.0, 2000.0]), GRAVITY * np.array([2.0, 4.0, 6.0, 8.0, 16.0]),
)  # fmt: skip
_LEAST_CLIPPED: Final = 20
RATE_ADVICE: Final = "log the IMU at 50 Hz or more, better 100"
_AXES: Final = ("gyroscope x", "gyroscope y", "gyroscope z", "accelerometer x", "accelerometer y", "accelerometer z")
_DEAD: Final = "this axis of the sensor or of its driver is dead"


def slow(imu: Stream) -> Cause | None:
    """Median rate below 20 Hz."""
    if imu.kind != IMU:
        return None
    steps = np.diff(np.unique(imu.t_s))
    hz = 1.0 / float(np.median(steps)) if len(steps) else 0.0
    if not 0.0 < hz < LOWEST_RATE_HZ:
        return None
    what = f"{hz:.1f} samples a second are too few to navigate by"
    return Cause(what, float(imu.arrived_s[0]), RATE_ADVICE, unfit=True)


def halves(imu: Stream) -> Cause | None:
    """Gyroscope and accelerometer in separate messages, the other zero."""
    if imu.kind != IMU:
        return None
    empty = [float(np.mean(~imu.values[:, part].any(axis=1))) for part in (slice(0, 3), slice(3, 6))]
    if max(empty) < _HALF_EMPTY or min(empty) > 1.0 - _HALF_EMPTY or (min(empty) == 0.0 and max(empty) < 1.0 - _HALF_EMPTY):
        return None
    what = f"the gyroscope is exactly 0 in {empty[0]:.0%}, the accelerometer in {empty[1]:.0%} of the samples"
    return Cause(what, float(imu.arrived_s[0]), "put rate and force of one moment into one message")


def mixed(imu: Stream) -> Cause | None:
    """Two sensors take turns: the mean forces of even and of odd samples differ, which no vibration does for long."""
    if imu.kind != IMU:
        return None
    apart = float(np.linalg.norm(imu.values[::2, 3:].mean(axis=0) - imu.values[1::2, 3:].mean(axis=0)))
    if apart < _MIXED_M_S2:
        return None
    what = f"its samples alternate between two sensors, whose forces differ by {apart:.1f} m/s^2"
    return Cause(what, float(imu.arrived_s[0]), "give each sensor a topic of its own")


def units(imu: Stream) -> Cause | None:
    """|f| over the stillest second is not gravity, or rates exceed any vehicle's."""
    if imu.kind != IMU:
        return None
    finite = imu.values[np.isfinite(imu.values).all(axis=1)]
    if len(finite) < 2:
        return None
    gyro = np.linalg.norm(finite[:, :3], axis=1)
    length = float(np.linalg.norm(_stillest(imu).mean(axis=0)[3:]))
    since_s = float(imu.arrived_s[0])
    if np.mean(gyro > _FASTEST_RAD_S) > _FEW_SPIKES or gyro.mean() > _SWIFT_RAD_S:
        return _swift(gyro, np.linalg.norm(finite[:, 3:], axis=1), since_s)
    if _GRAVITY_BAND[0] < length < _GRAVITY_BAND[1]:
        return None
    read = f"the accelerometer reads {length:.3g} m/s^2 in its stillest second"
    mean = float(np.linalg.norm(finite[:, 3:].mean(axis=0)))
    if 0.8 < length < 1.3 and 0.8 < mean < 1.3:
        return Cause(f"{read}: it is in g", since_s, f"convert to m/s^2 (x {GRAVITY})")
    if mean < 2.0:
        return Cause(f"{read}: gravity is missing", since_s, "send the specific force as it is measured, gravity included")
    return Cause(f"{read}: its unit or scale is wrong", since_s, f"send m/s^2: at rest it reads {GRAVITY:.2f}")


def _swift(gyro: Array, force: Array, since_s: float) -> Cause:
    """What it is that turns faster than any vehicle; gyro, force: norms (n,)."""
    if gyro.mean() > _FASTEST_DEG_S:
        what = f"its gyroscope reads {gyro.mean():.2g} on average, which no sensor does"
        return Cause(what, since_s, "see the order of its bytes, and their type", unfit=True)
    if _GRAVITY_BAND[0] < np.median(gyro) < _GRAVITY_BAND[1] and np.median(force) < _SWIFT_RAD_S:
        what = f"its gyroscope reads {np.median(gyro):.1f}, its accelerometer {np.median(force):.2g}: the two are exchanged"
        return Cause(what, since_s, "exchange the two in its driver or in the columns")
    what = f"it turns at {gyro.mean():.1f} rad/s on average, up to {gyro.max():.0f}: the gyroscope is in deg/s"
    return Cause(what, since_s, "convert to rad/s (x 0.0174533)")


def off_at_rest(imu: Stream) -> Cause | None:
    """In its stillest second |f| is not g, or the rate across f is not 0: an offset beyond any bias.

    A coordinated turn at v stands still, too: |f|^2 = g^2 + (v omega)^2.
    """
    window = _stillest(imu)
    mean, spread = window.mean(axis=0), window.std(axis=0)
    if imu.kind != IMU or len(window) < 10 or spread[:3].max() > _REST_GYRO or spread[3:].max() > _REST_ACCEL:
        return None
    rate, length, since_s = mean[:3], float(np.linalg.norm(mean[3:])), float(imu.arrived_s[0])
    down = mean[3:] / length
    across = float(np.linalg.norm(rate - down * (rate @ down)))
    if across > _OFF_GYRO and abs(length - GRAVITY) < _UPRIGHT:
        what = f"the gyroscope reads {across:.2f} rad/s in a second in which gravity does not turn"
        return Cause(what, since_s, "it has an offset: calibrate it at rest, or mend its driver")
    turn = float(np.sqrt(length**2 - GRAVITY**2)) / _SWIFTEST_M_S if length > GRAVITY else np.inf
    if abs(length - GRAVITY) > _OFF_ACCEL and np.linalg.norm(rate) < min(0.5 * _OFF_GYRO, turn):
        what = f"the accelerometer reads {length:.2f} m/s^2 at rest: its scale or offset is wrong"
        return Cause(what, since_s, f"calibrate it: at rest it reads {GRAVITY:.2f}")
    return None


def spikes(imu: Stream) -> Cause | None:
    """Single samples beyond any gyroscope or accelerometer."""
    if imu.kind != IMU:
        return None
    rate, force = (np.linalg.norm(imu.values[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    beyond = np.flatnonzero((rate > _FASTEST_RAD_S) | (force > _STRONGEST_M_S2))
    if not len(beyond):
        return None
    what = f"{len(beyond)} samples are beyond any sensor (up to {rate[beyond].max():.0f} rad/s, {force[beyond].max():.0f} m/s^2)"
    return Cause(what, float(imu.arrived_s[beyond[0]]), "see the IMU's driver and its bus")


def tilted(imu: Stream) -> Cause | None:
    """At rest and level f_b = (0, 0, -g) in FRD.

    At the log's start only.
    """
    if imu.kind != IMU or imu.arrived_s[0] > _BEGINNING_S:
        return None
    tilt_deg = min(_tilt_deg(_stillest(imu).mean(axis=0)[3:]), _tilt_deg(np.nanmean(imu.values[:, 3:], axis=0)))
    if tilt_deg < _TILT_DEG:
        return None
    what = f"gravity is {tilt_deg:.0f} degrees from the body's down"
    if tilt_deg < 135.0:
        return Cause(f"{what}: it is mounted or wired otherwise", float(imu.arrived_s[0]), "set [imu] mounting_rpy_deg")
    return Cause(
        f"{what}: the axes are those of the other convention, or the accelerometer has the other sign", float(imu.arrived_s[0]),
        'set the other [imu] axes ("frd" or "flu"); or, where x is reversed too, send the specific force (at rest it is up)',
    )  # fmt: skip


def frozen_axis(imu: Stream) -> Cause | None:
    """An axis repeats to the bit for > 2 s while another of its sensor changes.

    It changed before, or both others have noise, or a gyroscope's axis stands at another value than 0 for > 10 s.
    """
    if imu.kind not in (IMU, "magnetometer"):
        return None
    same = np.diff(imu.values, axis=0) == 0.0
    for axis in range(imu.values.shape[1]):
        sensor = slice(0, 3) if axis < 3 else slice(3, 6)
        noisy = all(_is_noisy(imu.values[:, k]) for k in range(*sensor.indices(6)) if k != axis)
        for first, last in runs(same[:, axis]).tolist():
            long_s = imu.arrived_s[last] - imu.arrived_s[first]
            alive = 1.0 - np.mean(same[first:last, sensor], axis=0)
            stuck = imu.kind == IMU and axis < 3 and imu.values[first, axis] != 0.0 and long_s > _STUCK_S
            never = imu.kind != IMU and not imu.values[:, axis].any()
            lived = noisy or stuck or never or (first > 0 and 1.0 - same[:first, axis].mean() > _LIVELY)
            still = imu.kind != IMU and not _turns(imu.values[first:last])
            if lived and not still and long_s > _FROZEN_S and last - first >= _LEAST_FROZEN and alive.max() > _LIVELY:
                name, value = (
                    _AXES[axis] if imu.kind == IMU else f"its {'xyz'[axis]} axis",
                    imu.values[first, axis] + 0.0,
                )  # not -0
                what = f"{name} reads {value:g} without any change for {long_s:.1f} s, while other axes move"
                return Cause(what, float(imu.arrived_s[first]), _DEAD)
    return None


def _turns(field: Array) -> bool:
    return float(np.ptp(field, axis=0).max()) > 0.1 * float(np.median(np.linalg.norm(field, axis=1)))


def clipped(imu: Stream) -> Cause | None:
    """20 samples at an extreme, to the bit, near a full scale (2 %)."""
    if imu.kind != IMU:
        return None
    for axis in range(6):
        x = np.abs(imu.values[:, axis])
        top = float(np.nanmax(x)) if np.isfinite(x).any() else 0.0
        at = np.flatnonzero(x == top)
        if len(at) >= _LEAST_CLIPPED and np.any(np.abs(_RANGES[axis // 3] / max(top, 1e-9) - 1.0) < 0.02):
            what = f"{_AXES[axis]} is clipped at {top:.4g} in {len(at)} samples"
            return Cause(what, float(imu.arrived_s[at[0]]), "choose a larger full scale, or damp the vibration")
    return None


def _tilt_deg(f_b: Array) -> float:
    return float(np.degrees(np.arccos(np.clip(-f_b[2] / max(float(np.linalg.norm(f_b)), 1e-9), -1.0, 1.0))))


def _stillest(imu: Stream) -> Array:
    """Samples (n, 6) of that second."""
    samples = imu.values[np.isfinite(imu.values).all(axis=1)]
    hz = len(samples) / max(float(np.ptp(imu.arrived_s)), 1e-9)
    width = min(max(2, round(hz * _STILL_WINDOW_S)), max(1, len(samples)))
    windows = samples[: len(samples) // width * width].reshape(-1, width, 6)
    spread = windows.std(axis=1)
    score = spread[:, :3].sum(axis=1) + spread[:, 3:].sum(axis=1) / GRAVITY
    return np.asarray(windows[int(np.argmin(score))])


def _is_noisy(x: Array) -> bool:
    d = np.diff(x[np.isfinite(x)])
    power = float(d @ d)
    return power > 0.0 and float(d[1:] @ d[:-1]) / power < _NOISE and float(np.mean(d != 0.0)) > _LIVELY
