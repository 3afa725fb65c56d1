# ruff: noqa: ARG001  (one signature for all)
"""What may differ between the world and the configuration: functions from messages to messages.

    perturb(flight, size, rng) -> messages in order of arrival;   nothing else changes, size 0 (ratios: 1) changes nothing

Constant directions and random courses are drawn from rng, so that equal seeds give equal perturbations.
"""

import math
from collections.abc import Callable
from typing import TypeAlias

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.stress import sensors
from benchmarks.stress.flights import Aids, Flight
from models.frames import GRAVITY, Origin
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, PoseFix, vec3
from models.sim.faults import in_order

Rng: TypeAlias = np.random.Generator
Perturb: TypeAlias = Callable[[Flight, float, Rng], list[Input]]

ONSET_S = 30.0  # when a receiver is pulled off or switches its antenna, and a vibration begins
DRIFT_M, DRIFT_DEG, DRIFT_S = 0.3, 2.0, 60.0  # of the fixes' frame, at size 1
SLOW_S = 120.0  # time constant of a receiver's slow error
CLIP_M_S2, BURST_M_S2, BURST_EVERY_S = 2.0 * GRAVITY, 2.0 * GRAVITY, 10.0
RECTIFIED = 0.03  # offset of the accelerometer per RMS of the vibration
BOOT_S = 20.0  # a receiver is wrong from boot, the first true fix comes now
HELD_EVERY_S = 15.0
ALIKE_M, ALIKE_DEG = 12.0, 5.0  # offset of look-alikes, and of their heading
_TINY_S = 1e-9
JAM_M, JAM_M_S = 25.0, 4.0  # noise of a jammed receiver, at full strength
BIAS_DEG_S, BIAS_M_S2 = 1.0, 0.6  # of an IMU that is biased for a while, at size 1
BIASED_S = 5.0
FAST_HZ, CORRELATED_S = 20.0, 2.0  # fixes whose errors are correlated

_replace = msgspec.structs.replace


def nothing(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """The world as configured."""
    return flight.messages


def imu_mount(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """IMU turned by size degrees about a random axis: y = R y_true."""
    return _turn_imu(flight, Rotation.from_rotvec(math.radians(size) * direction(rng)))


def imu_axes(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """IMU axes permuted: turned by size (90, 180) degrees about the vertical."""
    return _turn_imu(flight, Rotation.from_rotvec([0.0, 0.0, math.radians(size)]))


def gyro_scale(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Angular rates too large by size per cent."""
    return _imu(flight, lambda m: _replace(m, gyro_b=vec3(np.multiply(m.gyro_b, 1.0 + 0.01 * size))))


def bias_ramp(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Gyro bias grows by size deg/s per minute, accelerometer bias by a tenth of that in m/s^2, along a random axis."""
    gyro, accel = math.radians(size) / 60.0 * direction(rng), 0.1 * size / 60.0 * direction(rng)

    def ramp(m: ImuSample) -> ImuSample:
        t = _seconds(flight, m)
        return _replace(m, gyro_b=vec3(m.gyro_b + gyro * t), accel_b=vec3(m.accel_b + accel * t))

    return _imu(flight, ramp)


def vibration(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on white vibration of size m/s^2 RMS on each accelerometer axis, rectified along z: + RECTIFIED size."""

    def shake(m: ImuSample) -> ImuSample:
        noise = size * rng.standard_normal(3) + [0.0, 0.0, RECTIFIED * size]
        return m if _seconds(flight, m) < ONSET_S else _replace(m, accel_b=vec3(m.accel_b + noise))

    return _imu(flight, shake)


def clipping(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Each BURST_EVERY_S a burst of size s: vibration of BURST_M_S2 RMS on each axis, clipped at +-CLIP_M_S2."""

    def clip(m: ImuSample) -> ImuSample:
        shaken = m.accel_b + BURST_M_S2 * rng.standard_normal(3)
        burst = _seconds(flight, m) % BURST_EVERY_S >= BURST_EVERY_S - size
        return _replace(m, accel_b=vec3(np.clip(shaken, -CLIP_M_S2, CLIP_M_S2))) if burst else m

    return _imu(flight, clip)


def imu_drop(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Size per cent of the IMU samples are lost."""
    return [m for m in flight.messages if not isinstance(m, ImuSample) or rng.random() >= 0.01 * size]


def time_jitter(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Every stamp late by up to size ms (uniform), as of samples stamped on arrival: the order within a topic stays."""
    last: dict[str, int] = {}
    found = []
    for m in flight.messages:
        late_ns = round(rng.uniform(0.0, size) * 1e6)
        t_ns = max(m.t_ns + late_ns, last.get(m.topic, m.t_ns - 1) + 1)
        last[m.topic] = t_ns
        found.append(_replace(m, t_ns=t_ns, arrived_ns=max(m.arrived_ns, t_ns)))
    return in_order(found)


def fix_delay(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Pose fixes stamped and arriving size ms late."""
    return _late(flight, size, PoseFix)


def fix_covariance(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Pose fixes report a covariance that is too small by the ratio size."""
    return _fixes(flight, lambda m: _replace(m, covariance=m.covariance / size))


def fix_drift(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Gauss-Markov error of the fixes: size DRIFT_M on each axis, size DRIFT_DEG about each axis, time constant DRIFT_S."""
    course = _gauss_markov(flight, DRIFT_S, 6, rng)

    def drift(m: PoseFix) -> PoseFix:
        x = size * course[flight.row(m.t_ns)]
        return _replace(turned(m, np.radians(DRIFT_DEG) * x[3:]), p_n=vec3(m.p_n + DRIFT_M * x[:3]))

    return _fixes(flight, drift)


def fix_scale(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Positions of the fixes, from the origin, too large by size per cent."""
    return _fixes(flight, lambda m: _replace(m, p_n=vec3(np.multiply(m.p_n, 1.0 + 0.01 * size))))


def fix_units(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Positions of the fixes in another unit: times size."""
    return _fixes(flight, lambda m: _replace(m, p_n=vec3(np.multiply(m.p_n, size))))


def fix_heading(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Heading of the fixes off by size degrees, positions true: magnetic taken for true north."""
    return _fixes(flight, lambda m: turned(m, np.array([0.0, 0.0, math.radians(size)])))


def map_north(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """The map of the fixes turned about its origin by size degrees: positions and headings."""
    turn = np.array([0.0, 0.0, math.radians(size)])
    return _fixes(flight, lambda m: _replace(turned(m, turn), p_n=vec3(Rotation.from_rotvec(turn).apply(m.p_n))))


def map_shift(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """The map of the fixes moved by size m in a random horizontal direction."""
    offset = size * level(rng)
    return _fixes(flight, lambda m: _replace(m, p_n=vec3(m.p_n + offset)))


def height_datum(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """GNSS height above another datum: lower by size m."""
    return _gnss(flight, np.array([0.0, 0.0, size]))


def gnss_slow(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """GNSS with a Gauss-Markov error of size m on each axis, time constant SLOW_S, not in its covariance."""
    return _gnss(flight, size * _gauss_markov(flight, SLOW_S, 3, rng))


def gnss_delay(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """GNSS position and velocity stamped and arriving size ms late."""
    return _late(flight, size, GnssFix, GnssVelocity)


def gnss_lever(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Antenna size m ahead of the body's origin: p + R l, v + d/dt (R l)."""
    lever = flight.R_nb @ [size, 0.0, 0.0]
    rate = np.gradient(lever, (flight.t_ns - flight.t_ns[0]) * 1e-9, axis=0)
    return _gnss(flight, lever, rate)


def antenna_switch(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on the receiver reports a place size m off, horizontally."""
    return _gnss(flight, np.outer(_since_onset(flight) >= 0.0, size * level(rng)))


def gnss_boot(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """GNSS off by size m, horizontally, from the first message to the last."""
    return _gnss(flight, size * level(rng))


def gnss_pull(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on GNSS moves away at size m/s, horizontally; its velocity agrees."""
    pull, t_s = size * level(rng), _since_onset(flight)
    return _gnss(flight, np.outer(np.maximum(t_s, 0.0), pull), np.outer(t_s >= 0.0, pull))


def imu_held(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Each HELD_EVERY_S the IMU repeats its last sample under new stamps for size seconds."""
    last: ImuSample | None = None

    def hold(m: ImuSample) -> ImuSample:
        nonlocal last
        if last is None or _seconds(flight, m) % HELD_EVERY_S < HELD_EVERY_S - size:
            last = m
        return _replace(m, gyro_b=last.gyro_b, accel_b=last.accel_b)

    return _imu(flight, hold)


def gyro_axis_dead(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on the yaw gyroscope reads 0 to the bit, for size seconds."""

    def dead(m: ImuSample) -> ImuSample:
        return _replace(m, gyro_b=(*m.gyro_b[:2], 0.0)) if ONSET_S <= _seconds(flight, m) < ONSET_S + size else m

    return _imu(flight, dead)


def imu_biased(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """For BIASED_S from ONSET_S on the IMU is off by size times BIAS_DEG_S and BIAS_M_S2 along random axes."""
    gyro, accel = size * math.radians(BIAS_DEG_S) * direction(rng), size * BIAS_M_S2 * direction(rng)

    def biased(m: ImuSample) -> ImuSample:
        is_off = ONSET_S <= _seconds(flight, m) < ONSET_S + BIASED_S
        return _replace(m, gyro_b=vec3(m.gyro_b + gyro), accel_b=vec3(m.accel_b + accel)) if is_off else m

    return _imu(flight, biased)


def fix_repeats(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on the last pose comes again under new stamps, for size seconds."""
    last: PoseFix | None = None

    def repeat(m: PoseFix) -> PoseFix:
        nonlocal last
        if last is None or not ONSET_S <= _seconds(flight, m) < ONSET_S + size:
            last = m
        return _replace(m, p_n=last.p_n, q_nb_wxyz=last.q_nb_wxyz)

    return _fixes(flight, repeat)


def look_alikes(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """The first size fixes after each outage, and from ONSET_S on, are off by ALIKE_M in one direction and ALIKE_DEG."""
    left, offset, turn = 0, np.zeros(3), np.zeros(3)
    begins_s = [ONSET_S, *(end for _, end in flight.outages_s)]

    def alike(m: PoseFix) -> PoseFix:
        nonlocal left, offset, turn
        if begins_s and _seconds(flight, m) >= min(begins_s):
            begins_s.remove(min(begins_s))
            left, offset, turn = round(size), ALIKE_M * level(rng), math.radians(ALIKE_DEG) * direction(rng)
        left -= 1
        return m if left < 0 else _replace(turned(m, turn), p_n=vec3(m.p_n + offset))

    return _fixes(flight, alike)


def fixes_correlated(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """Fixes at FAST_HZ in place of the others, of size times the errors that they claim, correlated over CORRELATED_S."""
    first = next(m for m in flight.messages if isinstance(m, PoseFix))
    course = _gauss_markov(flight, CORRELATED_S, 6, rng)
    root = np.linalg.cholesky(first.covariance)
    others = [m for m in flight.messages if not isinstance(m, PoseFix)]
    fixes = list[Input]()
    for wanted in np.arange(flight.t_ns[0], flight.t_ns[-1], round(1e9 / FAST_HZ)):
        row = flight.row(int(wanted))
        t_ns, t_s = int(flight.t_ns[row]), float(flight.t_ns[row] - flight.start_ns) * 1e-9
        if t_s < 0.0 or any(a < t_s < b for a, b in flight.outages_s):
            continue
        error = size * (root @ course[row])
        w, x, y, z = (float(c) for c in Rotation.from_matrix(flight.R_nb[row]).as_quat(scalar_first=True))
        true = _replace(first, t_ns=t_ns, arrived_ns=t_ns, p_n=vec3(flight.p_n[row] + error[:3]), q_nb_wxyz=(w, x, y, z))
        fixes.append(turned(true, error[3:]))
    return in_order([*others, *fixes])


def fix_scatter(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """White noise of size m on each axis of the fixes, not in their covariance."""
    return _fixes(flight, lambda m: _replace(m, p_n=vec3(m.p_n + size * rng.standard_normal(3))))


def fix_clock(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """The clock of the fixes gains size ms each second."""
    return in_order([
        _replace(m, t_ns=m.t_ns + round(size * 1e-3 * (m.t_ns - flight.start_ns)),
                 arrived_ns=m.arrived_ns + round(size * 1e-3 * (m.t_ns - flight.start_ns))) if isinstance(m, PoseFix) else m
        for m in flight.messages
    ])  # fmt: skip


def fix_clock_steps(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on the stamps of the fixes are size ms late."""
    step = round(size * 1e6)
    return in_order([
        _replace(m, t_ns=m.t_ns + step, arrived_ns=m.arrived_ns + step)
        if isinstance(m, PoseFix) and _seconds(flight, m) >= ONSET_S else m
        for m in flight.messages
    ])  # fmt: skip


def gnss_frozen(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on the receiver repeats its last position for size seconds; its velocity goes on."""
    last: GnssFix | None = None

    def freeze(m: Input) -> Input:
        nonlocal last
        if not isinstance(m, GnssFix):
            return m
        if last is None or not ONSET_S <= _seconds(flight, m) < ONSET_S + size:
            last = m
        return _replace(m, lat_deg=last.lat_deg, lon_deg=last.lon_deg, alt_m=last.alt_m)

    return [freeze(m) for m in flight.messages]


def gnss_jammed(flight: Flight, size: float, rng: Rng) -> list[Input]:
    """From ONSET_S on noise of JAM_M and JAM_M_S, growing over size seconds, for twice as long; the accuracy stays as it was."""
    t_s = _since_onset(flight)
    strength = np.where((t_s >= 0.0) & (t_s < 2.0 * size), np.clip(t_s / max(size, _TINY_S), 0.0, 1.0), 0.0)[:, None]
    noise = rng.standard_normal((2, len(t_s), 3))
    return _gnss(flight, JAM_M * strength * noise[0], JAM_M_S * strength * noise[1])


def rarer(messages: list[Input], period_s: float, from_s: float) -> list[Input]:
    """Pose fixes from from_s on only, and none sooner than period_s after the one before."""
    start_ns, wait_ns, next_ns, kept = messages[0].t_ns, round((period_s - 1e-3) * 1e9), 0, list[Input]()
    for m in messages:
        if isinstance(m, PoseFix):
            if m.t_ns < max(next_ns, start_ns + round(from_s * 1e9)):
                continue
            next_ns = m.t_ns + wait_ns
        kept.append(m)
    return kept


class Kind(msgspec.Struct, frozen=True):
    """A perturbation, its sizes in `unit` from small to large, and the aids of the flights that it is applied to.

    period_s, from_s: of the pose fixes, where they are rarer or begin later.
    """

    name: str
    perturb: Perturb
    unit: str
    sizes: tuple[float, ...]
    aids: Aids = "fixes"
    period_s: float = 0.0
    from_s: float = 0.0


def _at_fix_periods(kind: Kind, *periods_s: float) -> list[Kind]:
    """The kind once for each period of the pose fixes."""
    return [_replace(kind, name=f"{kind.name}, fixes {1 / s:g} Hz", period_s=s) for s in periods_s]


KINDS = {
    kind.name: kind
    for kind in [
        Kind("nothing", nothing, "", (0.0,)),
        Kind("nothing, with GNSS", nothing, "", (0.0,), "both"),
        Kind("nothing, GNSS alone", nothing, "", (0.0,), "gnss"),
        Kind("IMU mount", imu_mount, "deg", (1.0, 3.0, 5.0)),
        Kind("IMU axes", imu_axes, "deg", (90.0, 180.0)),
        Kind("gyro scale", gyro_scale, "%", (1.0, 2.0, 5.0)),
        Kind("bias ramp", bias_ramp, "deg/s/min", (0.2, 0.5, 2.0)),
        Kind("vibration", vibration, "m/s^2", (2.0, 5.0, 15.0)),
        Kind("accelerometer clips", clipping, "s", (0.1, 0.3, 1.0)),
        Kind("IMU held", imu_held, "s", (0.3, 1.0)),
        Kind("IMU biased", imu_biased, "times", (1.0, 3.0)),
        Kind("yaw gyro dead", gyro_axis_dead, "s", (100.0,)),
        Kind("yaw gyro dead, with GNSS", gyro_axis_dead, "s", (100.0,), "both"),
        Kind("IMU samples lost", imu_drop, "%", (2.0, 5.0, 20.0)),
        Kind("time jitter", time_jitter, "ms", (2.0, 5.0, 15.0)),
        Kind("fix delay", fix_delay, "ms", (40.0, 80.0, 150.0)),
        Kind("fix clock gains", fix_clock, "ms/s", (0.5, 2.0)),
        Kind("fix clock steps", fix_clock_steps, "ms", (100.0, 300.0)),
        Kind("fix repeats", fix_repeats, "s", (3.0, 8.0)),
        Kind("look-alikes", look_alikes, "fixes", (1.0, 3.0, 8.0)),
        Kind("fixes 20 Hz correlated", fixes_correlated, "times", (1.0, 2.0)),
        Kind("fix covariance too small", fix_covariance, "x", (2.0, 4.0, 16.0, 100.0)),
        Kind("fix frame drifts", fix_drift, "x", (0.5, 1.0, 2.0)),
        Kind("fix scale", fix_scale, "%", (1.0, 2.0, 5.0)),
        Kind("fix heading", fix_heading, "deg", (3.0, 10.0, 30.0)),
        Kind("fix units", fix_units, "x", (3.28, 100.0), "both"),
        Kind("map north", map_north, "deg", (3.0, 10.0, 30.0), "both"),
        Kind("map turned", map_north, "deg", (3.0, 10.0)),
        Kind("map shift", map_shift, "m", (1.0, 5.0, 20.0), "both"),
        Kind("height datum", height_datum, "m", (3.0, 19.4, 50.0), "both"),
        Kind("height datum, fixes from 20 s", height_datum, "m", (3.0, 19.4, 50.0), "both", period_s=0.5, from_s=BOOT_S),
        Kind("GNSS lever arm", gnss_lever, "m", (0.3, 1.0, 3.0), "both"),
        Kind("antenna switch", antenna_switch, "m", (1.0, 3.0, 10.0), "both"),
        Kind("GNSS delay", gnss_delay, "ms", (40.0, 100.0, 300.0), "gnss"),
        Kind("GNSS frozen", gnss_frozen, "s", (5.0, 20.0), "gnss"),
        Kind("GNSS jammed", gnss_jammed, "s", (3.5, 10.0), "gnss"),
        Kind("GNSS slow error", gnss_slow, "m", (0.5, 1.0, 2.0), "gnss"),
        Kind("second fixes shifted", sensors.second_shifted, "m", (0.3, 1.0, 20.0)),
        Kind("second fixes shifted, with GNSS", sensors.second_shifted, "m", (1.0, 20.0), "both"),
        Kind("second map turned", sensors.second_turned, "deg", (3.0, 10.0)),
        Kind("second fixes late", sensors.second_late, "ms", (50.0, 150.0, 400.0)),
        Kind("velocity scaled", sensors.velocity_scaled, "x", (1.0, 0.5, 2.0)),
        Kind("velocity biased", sensors.velocity_biased, "m/s", (0.5, 2.0)),
        Kind("velocity drifts", sensors.velocity_drifts, "m/s^2", (0.05,)),
        Kind("velocity late", sensors.velocity_late, "ms", (100.0, 500.0)),
        Kind("odometry drifts", sensors.odometry_drifts, "m/s", (0.2,)),
        Kind("velocity drifts, GNSS alone", sensors.velocity_drifts, "m/s^2", (0.05,), "gnss"),
        Kind("odometry drifts, GNSS alone", sensors.odometry_drifts, "m/s", (0.2,), "gnss"),
        Kind("barometer climbs, GNSS alone", sensors.baro_climbs, "m/s", (1.0,), "gnss"),
        *_at_fix_periods(
            Kind("GNSS off from boot", gnss_boot, "m", (20.0, 200.0, 5000.0), "both", from_s=BOOT_S),
            2.0,
            5.0,
        ),
        *_at_fix_periods(Kind("GNSS pulled", gnss_pull, "m/s", (0.1, 0.5, 3.0), "both"), 0.5, 1.0, 5.0, 20.0),
    ]
}


def _seconds(flight: Flight, message: Input) -> float:
    return (message.t_ns - flight.start_ns) * 1e-9


def direction(rng: Rng) -> Array:
    """A random unit vector, (3,)."""
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def level(rng: Rng) -> Array:
    """A random horizontal unit vector, (3,)."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _gauss_markov(flight: Flight, tau_s: float, size: int, rng: Rng) -> Array:
    """x' = -x/tau + w of variance 1 at the stamps of the truth, (n, size)."""
    keep = np.exp(-np.diff(flight.t_ns) * 1e-9 / tau_s)
    noise = rng.standard_normal((len(flight.t_ns), size))
    x = noise.copy()
    for k, a in enumerate(keep):
        x[k + 1] = a * x[k] + math.sqrt(1.0 - a * a) * noise[k + 1]
    return x


def _imu(flight: Flight, change: Callable[[ImuSample], ImuSample]) -> list[Input]:
    return [change(m) if isinstance(m, ImuSample) else m for m in flight.messages]


def _turn_imu(flight: Flight, turn: Rotation) -> list[Input]:
    R = turn.as_matrix()
    return _imu(flight, lambda m: _replace(m, gyro_b=vec3(R @ m.gyro_b), accel_b=vec3(R @ m.accel_b)))


def _fixes(flight: Flight, change: Callable[[PoseFix], PoseFix]) -> list[Input]:
    return [change(m) if isinstance(m, PoseFix) else m for m in flight.messages]


def turned(fix: PoseFix, theta_n: Array) -> PoseFix:
    """The attitude turned about the axes of n: R = exp(theta_n) R_fix."""
    turned = Rotation.from_rotvec(theta_n) * Rotation.from_quat(fix.q_nb_wxyz, scalar_first=True)
    w, x, y, z = (float(c) for c in turned.as_quat(scalar_first=True))
    return _replace(fix, q_nb_wxyz=(w, x, y, z))


def _late(flight: Flight, late_ms: float, *kinds: type) -> list[Input]:
    late_ns = round(late_ms * 1e6)
    late = [
        _replace(m, t_ns=m.t_ns + late_ns, arrived_ns=m.arrived_ns + late_ns) if isinstance(m, kinds) else m
        for m in flight.messages
    ]
    return in_order(late)


def _since_onset(flight: Flight) -> Array:
    """Seconds from ONSET_S to the stamps of the truth, (n,)."""
    return np.asarray((flight.t_ns - flight.start_ns) * 1e-9 - ONSET_S)


def _gnss(flight: Flight, offset_n: Array, velocity_n: Array | None = None) -> list[Input]:
    """GNSS with an offset of position [m] and of velocity [m/s] at the stamps of the truth, (n, 3), or constant, (3,)."""
    origin = Origin.of(flight.config.origin)
    assert origin is not None  # flights with GNSS have one
    offsets = np.broadcast_to(offset_n, flight.p_n.shape)
    velocities = np.broadcast_to(np.zeros(3) if velocity_n is None else velocity_n, flight.p_n.shape)

    def moved(m: Input) -> Input:
        if isinstance(m, GnssFix):
            p_n = np.add(origin.to_ned(m.lat_deg, m.lon_deg, m.alt_m), offsets[flight.row(m.t_ns)])
            lat, lon, alt = origin.to_geodetic(p_n)
            return _replace(m, lat_deg=lat, lon_deg=lon, alt_m=alt)
        return _replace(m, v_n=vec3(m.v_n + velocities[flight.row(m.t_ns)])) if isinstance(m, GnssVelocity) else m

    return [moved(m) for m in flight.messages]
