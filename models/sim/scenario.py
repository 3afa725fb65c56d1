"""A scenario (vehicle, sensors, faults); simulate(scenario, seed) -> messages and truth."""

from dataclasses import dataclass
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from models.frames import Origin
from models.imu import ImuNoise
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, PoseFix, Tick
from models.sim.aids import Gnss, PoseFixes, make_pose_fixes, receive_gnss
from models.sim.air import Airspeed, Wind, blow, read_airspeed
from models.sim.beacons import Beacons, measure_ranges, topic_of
from models.sim.cameras import Cameras
from models.sim.faults import AnyFault, in_order
from models.sim.ranges import Rate
from models.sim.sensors import GRADES, Imu, ImuRecord, measure
from models.sim.trajectory import FixedWing, Motion, Multirotor, build

EPOCH_NS = 1_700_000_000_000_000_000
_MOST_SAMPLES = 2e7  # a day at 200 Hz; in memory at once
_HOME = (47.3977, 8.5456, 488.0)  # lat_deg, lon_deg, alt_m: a field near Zurich


class Scenario(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Contents of a scenario file.

    origin: deg, deg, m above the ellipsoid; geographic = false: no Earth rate, no GNSS; other_imus: on /imu2, ...
    """

    name: str = "scenario"
    duration_s: Annotated[float, msgspec.Meta(ge=1.0, le=86_400.0)] = 120.0
    geographic: bool = True
    origin: tuple[float, float, float] = _HOME
    ticks_hz: Rate | None = None
    vehicle: Multirotor | FixedWing = msgspec.field(default_factory=Multirotor)
    imu: Imu = msgspec.field(default_factory=Imu)
    other_imus: tuple[Imu, ...] = ()
    gnss: Gnss | None = None
    pose_fix: PoseFixes | None = None
    cameras: Cameras | None = None
    wind: Wind | None = None
    airspeed: Airspeed | None = None
    beacons: Beacons | None = None
    faults: tuple[AnyFault, ...] = ()

    def __post_init__(self) -> None:
        if self.gnss is not None and not self.geographic:
            raise ValueError("gnss: there is no GNSS where geographic = false")
        if self.cameras is not None and not self.geographic:
            raise ValueError("cameras: their map needs a place on Earth, geographic = false has none")
        samples = sum(imu.rate_hz * self.duration_s for imu in (self.imu, *self.other_imus))
        if not 1.0 <= samples <= _MOST_SAMPLES:
            raise ValueError(f"duration_s, rate_hz: {samples:.3g} IMU samples; wanted are 1 to {_MOST_SAMPLES:.3g}")


@dataclass(frozen=True, slots=True)
class Truth:
    """True motion at IMU rate; body against n, SI.

    p_n, v_n, omega_b (n, 3); q_nb_wxyz (n, 4); R_nb (n, 3, 3); gyro_b, accel_b (n, 3): perfect IMU.
    """

    t_ns: NDArray[np.int64]
    p_n: Array
    v_n: Array
    q_nb_wxyz: Array
    R_nb: Array
    omega_b: Array
    gyro_b: Array
    accel_b: Array
    gyro_bias: Array
    accel_bias: Array

    def since(self, t_ns: int) -> "Truth":
        """The truth from t_ns on."""
        first = int(np.searchsorted(self.t_ns, t_ns))
        return Truth(*(getattr(self, name)[first:] for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class Simulation:
    """Messages in order of arrival, truth, t_ns of false pose fixes.

    config_toml: fitting configuration.
    """

    messages: list[Input]
    truth: Truth
    origin: Origin | None
    imu_noise: ImuNoise
    config_toml: str
    false_fixes: frozenset[int]


def simulate(scenario: Scenario, seed: int) -> Simulation:
    """One run. Raises ValueError for a fault whose needs are missing."""
    for_course, for_imu, for_gnss, for_fixes, for_air, for_others, for_beacons = np.random.default_rng(seed).spawn(7)
    origin = Origin(*scenario.origin) if scenario.geographic else None
    air = blow(scenario.wind, for_air) if scenario.wind else None
    trajectory = build(scenario.vehicle, scenario.duration_s, for_course, air)
    t_ns = _stamps(scenario.imu.rate_hz, scenario.duration_s)
    motion = trajectory.at(np.asarray((t_ns - EPOCH_NS) * 1e-9, dtype=np.float64))
    record = measure(scenario.imu, motion, origin, (t_ns[1] - t_ns[0]) * 1e-9, for_imu)
    aids: list[Input] = []
    false: frozenset[int] = frozenset()
    if scenario.gnss and origin:
        aids += receive_gnss(scenario.gnss, trajectory, origin, EPOCH_NS, for_gnss)
    if scenario.pose_fix:
        fixes, false = make_pose_fixes(scenario.pose_fix, trajectory, EPOCH_NS, for_fixes)
        aids += fixes
    if scenario.airspeed:
        aids += read_airspeed(scenario.airspeed, air, t_ns, EPOCH_NS, motion.v_n, motion.R_nb, for_air)
    if scenario.beacons:
        aids += measure_ranges(scenario.beacons, t_ns, EPOCH_NS, motion.p_n, motion.R_nb, for_beacons)
    for k, imu in enumerate(scenario.other_imus):
        at_ns = _stamps(imu.rate_hz, scenario.duration_s)
        there = trajectory.at(np.asarray((at_ns - EPOCH_NS) * 1e-9, dtype=np.float64))
        felt = measure(imu, there, origin, (at_ns[1] - at_ns[0]) * 1e-9, for_others)
        aids += _imu_messages(imu, at_ns, felt, _other_topic(k))
    ticks = [Tick(t, t) for t in _stamps(scenario.ticks_hz, scenario.duration_s).tolist()] if scenario.ticks_hz else []
    # The sort is stable: of messages arriving together the aids come first, the tick last.
    messages = in_order([*aids, *_imu_messages(scenario.imu, t_ns, record, _topic(ImuSample)), *ticks])
    for fault in scenario.faults:
        messages = fault.apply(messages, EPOCH_NS, origin, seed)
    noise = GRADES[scenario.imu.grade].noise
    config = _config_toml(scenario, noise)
    return Simulation(messages, _truth(t_ns, motion, record), origin, noise, config, false)


def _stamps(rate_hz: float, duration_s: float) -> NDArray[np.int64]:
    period_ns = round(1e9 / rate_hz)
    return EPOCH_NS + np.arange(0, round(duration_s * 1e9) + 1, period_ns, dtype=np.int64)


def _imu_messages(imu: Imu, t_ns: NDArray[np.int64], record: ImuRecord, topic: str) -> list[Input]:
    delay_ns = round(imu.delay_s * 1e9)
    rows = zip(t_ns.tolist(), map(tuple, record.gyro_b.tolist()), map(tuple, record.accel_b.tolist()), strict=True)
    return [ImuSample(t, t + delay_ns, gyro_b, accel_b, topic) for t, gyro_b, accel_b in rows]


def _truth(t_ns: NDArray[np.int64], motion: Motion, record: ImuRecord) -> Truth:
    return Truth(
        t_ns=t_ns,
        p_n=motion.p_n,
        v_n=motion.v_n,
        q_nb_wxyz=motion.q_nb_wxyz,
        R_nb=motion.R_nb,
        omega_b=motion.omega_b,
        gyro_b=record.true_gyro_b,
        accel_b=record.true_accel_b,
        gyro_bias=record.gyro_bias,
        accel_bias=record.accel_bias,
    )


def _config_toml(scenario: Scenario, noise: ImuNoise) -> str:
    lines = ["[imu]", 'axes = "flu"']
    lines += [f"{name} = {value!r}" for name, value in msgspec.structs.asdict(noise).items()]
    imus = [f'"{topic}"' for topic in (_topic(ImuSample), *map(_other_topic, range(len(scenario.other_imus))))]
    lines += ["", "[inputs]", f"imu = {imus[0]}" if len(imus) == 1 else f"imu = [{', '.join(imus)}]"]
    if scenario.gnss:
        lines += [f'gnss = "{_topic(GnssFix)}"', f'gnss_velocity = "{_topic(GnssVelocity)}"']
    if scenario.pose_fix:
        lines += [f'pose_fix = "{_topic(PoseFix)}"']
    if scenario.airspeed:
        lines += ['airspeed = "/airspeed"']
    if scenario.beacons:
        lines += [f"beacon = {[topic_of(k) for k in range(len(scenario.beacons.at_n_m))]}".replace("'", '"')]
        lines += ["", "[beacon]", f"at_n_m = {[list(at) for at in scenario.beacons.at_n_m]}"]
        lines += [f"antenna_b_m = {list(scenario.beacons.antenna_b_m)}"]
    if isinstance(scenario.vehicle, Multirotor) and scenario.vehicle.drag_1_s:
        lines += ["", "[drag]", "enabled = true", f"momentum_1_s = {scenario.vehicle.drag_1_s!r}"]
    if scenario.gnss:
        lines += ["", "[gnss]", f"delay_s = {scenario.gnss.stamp_lag_s!r}", f"antenna_b_m = {list(scenario.gnss.antenna_b_m)}"]
    if scenario.geographic:
        lines += ["", "[map]", f"origin = {list(scenario.origin)}"]
    return "\n".join(lines) + "\n"


def _topic(kind: type[msgspec.Struct]) -> str:
    return next(str(f.default) for f in msgspec.structs.fields(kind) if f.name == "topic")


def _other_topic(k: int) -> str:
    return f"{_topic(ImuSample)}{k + 2}"
