"""Vehicles with one optional sensor each, and its faults: since begin_s the fault, since dark_s no GNSS.

Gentle loops of a multirotor, a car, a fixed wing in wind, a vehicle that stops; the IMU is a hobby one of 50 Hz.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace

from benchmarks.faults.readings import FAULTS, NONE, faulty
from estimator.config import parse
from estimator.filter.alignment import InitialiseConfig
from estimator.fusion import FusionConfig
from estimator.sources.air.drag import DragConfig
from estimator.sources.beacon import BeaconConfig
from estimator.sources.rest import RestConfig
from estimator.sources.velocity_body import VelocityBodyConfig
from models import so3
from models.imu import ImuNoise
from models.messages import (
    Array,
    AttitudePrior,
    GnssFix,
    GnssVelocity,
    ImuSample,
    Input,
    OdometryDelta,
    vec3,
)
from models.relative_pose import between
from models.sim.aids import Gnss
from models.sim.air import Airspeed, Wind
from models.sim.beacons import Beacons, measure_ranges
from models.sim.scenario import EPOCH_NS, Scenario, Truth, simulate
from models.sim.sensors import GRADES, Imu
from models.sim.trajectory import FixedWing, Multirotor
from tests.scenarios.senses import HOME, Ride, barometer, heading, loops, magnetometer, range_down, ride, velocity_body

FLOW: Final = "/optical_flow"
_HOBBY: Final = Imu(grade="hobby", rate_hz=50.0)
_FLIGHT: Final = Imu(grade="flight_controller", rate_hz=50.0)
_NOT_GIVEN: Final = 1e6
_BEACONS: Final = Beacons()


class Case(NamedTuple):
    """messages in order of arrival, GNSS hidden since dark_s; topics: those of the sensor; times in s since EPOCH_NS."""

    messages: list[Input]
    truth: Truth
    config: FusionConfig
    topics: tuple[str, ...]
    begin_s: float
    dark_s: float
    end_s: float


Make: TypeAlias = Callable[[int], Case]  # of a seed


def _dark(messages: list[Input], dark_s: float) -> list[Input]:
    until_ns = EPOCH_NS + round(dark_s * 1e9)
    lit = [m for m in messages if not isinstance(m, GnssFix | GnssVelocity) or m.t_ns < until_ns]
    return sorted(lit, key=lambda m: m.arrived_ns)


def _of(topics: tuple[str, ...]) -> Callable[[Input], bool]:
    return lambda m: getattr(m, "topic", "") in topics


def _config(imu: Imu = _HOBBY, **sections: object) -> FusionConfig:
    return replace(FusionConfig(imu=GRADES[imu.grade].noise, origin=HOME.lla), **sections)


# --- loops of a multirotor, a car -----------------------------------------------------------------------------------------------


def _looping(
    read: Callable[[Truth, int], list[Input]], topics: tuple[str, ...], config: FusionConfig, *, scalar: bool = False
) -> Mapping[str, Make]:
    def make(fault: str, seed: int) -> Case:
        journey = ride(5.0, 60.0, seed=seed, imu=_HOBBY)
        return _case(journey, read(journey.truth, seed), fault, topics, config)

    faults = [f for f in (NONE, *FAULTS) if f != "wrong axes" or not scalar]
    return {fault: lambda seed, fault=fault: make(fault, seed) for fault in faults}  # type: ignore[misc]


def _case(
    journey: Ride, readings: list[Input], fault: str, topics: tuple[str, ...], config: FusionConfig, begin_s: float = 22.0
) -> Case:
    messages = _dark([*journey.messages, *readings], 40.0)
    sent = faulty(messages, fault, EPOCH_NS + round(begin_s * 1e9), _of(topics))
    return Case(sent, journey.truth, config, topics, begin_s, 40.0, 65.0)


def _beacons(truth: Truth, seed: int) -> list[Input]:
    rng = np.random.default_rng(seed + 50)
    return list(measure_ranges(_BEACONS, truth.t_ns, EPOCH_NS, truth.p_n, truth.R_nb, rng))


def _flow(truth: Truth, seed: int) -> list[Input]:
    """Steps of 0.2 s: forward and to the right, to 3 %; the turn is that of the gyroscope."""
    rng, step, out = np.random.default_rng(seed), 10, list[Input]()
    for k in range(0, len(truth.t_ns) - step, step):
        t0, t1 = int(truth.t_ns[k]), int(truth.t_ns[k + step])
        moved = between(*(np.r_[truth.p_n[i], truth.q_nb_wxyz[i]] for i in (k, k + step)))
        dp = moved[:3] * 1.02 + 0.02 * rng.standard_normal(3)
        w, x, y, z = moved[3:].tolist()
        covariance = np.diag([0.02**2] * 2 + [_NOT_GIVEN] * 4)
        systematic = np.array([[0.03 * dp[0]], [0.03 * dp[1]], [0.0], [0.0], [0.0], [0.0]])
        out.append(OdometryDelta(t1, t1, t0, vec3(dp), (w, x, y, z), covariance, systematic, topic=FLOW))
    return out


def car(t: Array) -> Array:
    """Up to 6 m/s along the nose, in turns."""
    yaw = 1.2 * np.sin(0.2 * t)
    speed = np.minimum(1.5 * t, 6.0)
    steps = speed * np.gradient(t) if len(t) > 1 else speed
    return np.column_stack([np.cumsum(steps * np.cos(yaw)), np.cumsum(steps * np.sin(yaw)), np.zeros_like(t), yaw])


def _wheels() -> Mapping[str, Make]:
    config = _config(velocity_body=VelocityBodyConfig(across_sigma_m_s=0.2))

    def make(fault: str, seed: int) -> Case:
        journey = ride(5.0, 60.0, seed=seed, yaw=0.0, path=car, imu=_HOBBY)
        readings = velocity_body(journey.truth, seed=seed, wheels=True)
        if fault == "skids sideways":
            journey = ride(5.0, 60.0, seed=seed, yaw=0.0, path=_skidding, imu=_HOBBY)
            readings = velocity_body(journey.truth, seed=seed, wheels=True)
            fault = NONE
        return _case(journey, readings, fault, ("/velocity_body",), config)

    faults = (NONE, "stuck", "biased", "wrong sign", "skids sideways", "late")
    return {fault: lambda seed, fault=fault: make(fault, seed) for fault in faults}  # type: ignore[misc]


def _skidding(t: Array) -> Array:
    """A car whose nose is turned by 30 degrees from its course since 17 s."""
    points = car(t)
    points[:, 3] += math.radians(30.0) * np.clip((t - 17.0) / 2.0, 0.0, 1.0)
    return points


# --- air -----------------------------------------------------------------------------------------------------------------------


def _flown(vehicle: Multirotor | FixedWing, airspeed: Airspeed | None, seed: int) -> tuple[list[Input], Truth, FusionConfig]:
    scenario = Scenario(
        duration_s=130.0,
        vehicle=vehicle,
        imu=Imu(grade="hobby", rate_hz=50.0, noise_multiplier=20.0),  # it vibrates, as [imu] says by default
        gnss=Gnss(rate_hz=5.0),
        wind=Wind(speed_m_s=6.0, gust_m_s=0.8),
        airspeed=airspeed,
    )
    simulation = simulate(scenario, seed)
    return simulation.messages, simulation.truth, replace(parse(simulation.config_toml).fusion(), imu=ImuNoise())


def _airspeed() -> Mapping[str, Make]:
    def make(fault: str, seed: int) -> Case:
        messages, truth, config = _flown(FixedWing(), Airspeed(), seed)
        sent = faulty(_dark(messages, 80.0), fault, EPOCH_NS + 40 * 10**9, _of(("/airspeed",)))
        return Case(sent, truth, config, ("/airspeed",), 40.0, 80.0, 130.0)

    return {fault: lambda seed, fault=fault: make(fault, seed) for fault in (NONE, *FAULTS) if fault != "wrong axes"}  # type: ignore[misc]


def _turned(messages: list[Input], truth: Truth, r_mb: Array) -> tuple[list[Input], Truth]:
    """The IMU sits turned on the vehicle: what it reads, and the truth of its own axes."""
    turned = [
        replace(m, gyro_b=vec3(r_mb @ m.gyro_b), accel_b=vec3(r_mb @ m.accel_b)) if isinstance(m, ImuSample) else m
        for m in messages
    ]
    r_nb = truth.R_nb @ r_mb.T
    changed = {"R_nb": r_nb, "q_nb_wxyz": np.array([so3.from_matrix(r) for r in r_nb])}
    changed |= {name: getattr(truth, name) @ r_mb.T for name in ("omega_b", "gyro_b", "accel_b", "gyro_bias", "accel_bias")}
    return turned, Truth(*(changed.get(name, getattr(truth, name)) for name in Truth.__slots__))


def _drag() -> Mapping[str, Make]:
    def make(fault: str, seed: int) -> Case:
        vehicle = FixedWing() if fault == "a fixed wing" else Multirotor(drag_1_s=0.15, hover_share=0.0)
        messages, truth, config = _flown(vehicle, None, seed)
        factors = {"coefficient / 3": 1.0 / 3.0, "coefficient x 3": 3.0}
        drag = DragConfig(enabled=True, momentum_1_s=0.15 * factors.get(fault, 1.0))
        if fault == "thrust tilted 10 deg":
            messages, truth = _turned(messages, truth, so3.matrix(so3.from_euler(0.0, math.radians(10.0), 0.0)))
        return Case(_dark(messages, 80.0), truth, replace(config, drag=drag), ("drag",), 40.0, 80.0, 130.0)

    faults = (NONE, "coefficient / 3", "coefficient x 3", "thrust tilted 10 deg", "a fixed wing")
    return {fault: lambda seed, fault=fault: make(fault, seed) for fault in faults}  # type: ignore[misc]


# --- rest ----------------------------------------------------------------------------------------------------------------------


def _rest() -> Mapping[str, Make]:
    """Loops for 25 s, then what the IMU alone takes for rest; turned: rad/s; drifts: m/s; lit: with GNSS for 15 s of it."""
    scenes = {
        NONE: (0.0, 0.0, True),
        "adrift 0.3 m/s": (0.3, 0.0, True),
        "adrift 0.3 m/s in the dark": (0.3, 0.0, False),
        "cruise 3 m/s": (3.0, 0.0, True),
        "turntable 0.5 deg/s": (0.0, math.radians(0.5), True),
        "turntable in the dark": (0.0, math.radians(0.5), False),
    }

    def make(drifts: float, turns: float, seed: int, *, lit: bool) -> Case:
        def path(t: Array) -> Array:
            after = np.maximum(t - 25.0, 0.0)
            drift = np.column_stack([drifts * after, np.zeros_like(t), np.zeros_like(t), turns * after])
            return loops(np.minimum(t, 25.0)) + drift

        journey = ride(2.0, 88.0, seed=seed, path=path, imu=_HOBBY)
        dark_s = 42.0 if lit else 26.0
        return Case(
            _dark(journey.messages, dark_s), journey.truth, _config(rest=RestConfig(enabled=True)), ("rest",), 29.0, dark_s, 90.0
        )

    return {
        name: lambda seed, scene=scene: make(scene[0], scene[1], seed, lit=scene[2])  # type: ignore[misc]
        for name, scene in scenes.items()
    }


# --- IMUs, attitude, course ----------------------------------------------------------------------------------------------------


def _other(truth: Truth, topic: str, seed: int) -> list[Input]:
    """Another IMU, whose biases are its own."""
    rng, noise = np.random.default_rng(seed), GRADES[_FLIGHT.grade].noise
    white = rng.standard_normal((len(truth.t_ns), 6)) * np.sqrt(_FLIGHT.rate_hz)
    biases = rng.normal(size=6) * np.repeat([0.01, 0.15], 3)
    gyro = truth.gyro_b + biases[:3] + white[:, :3] * noise.gyro_noise
    accel = truth.accel_b + biases[3:] + white[:, 3:] * noise.accel_noise
    return [
        ImuSample(int(t), int(t) + 3_000_000, vec3(g), vec3(a), topic) for t, g, a in zip(truth.t_ns, gyro, accel, strict=True)
    ]


def _imus(count: int, wrong: str) -> Mapping[str, Make]:
    topics = ("/imu", "/imu2", "/imu3")[:count]

    def make(fault: str, seed: int) -> Case:
        journey = ride(5.0, 60.0, seed=seed, imu=_FLIGHT)
        others = [m for k, topic in enumerate(topics[1:]) for m in _other(journey.truth, topic, 100 * seed + k)]
        return _case(journey, others, fault, (wrong,), _config(_FLIGHT, imu_topics=topics), 30.0)

    return {fault: lambda seed, fault=fault: make(fault, seed) for fault in (NONE, *FAULTS)}  # type: ignore[misc]


def _attitude() -> Mapping[str, Make]:
    """Of an autopilot, 2 degrees of tilt and 4 of heading off, from the beginning; the vehicle moves after 5 s."""
    sigma = np.radians([2.0, 2.0, 4.0])

    def make(fault: str, seed: int) -> Case:
        journey = ride(5.0, 60.0, seed=seed, imu=_HOBBY)
        off = so3.quat_exp(np.random.default_rng(seed).normal(size=3) * sigma)
        priors: list[Input] = []
        for k in range(25, len(journey.truth.t_ns), 25):
            w, x, y, z = so3.multiply(off, journey.truth.q_nb_wxyz[k]).tolist()
            t = int(journey.truth.t_ns[k])
            priors.append(AttitudePrior(t, t, (w, x, y, z), np.diag(sigma**2)))
        return _case(journey, priors, fault, ("/attitude",), _config(), 0.0)

    return {fault: lambda seed, fault=fault: make(fault, seed) for fault in (NONE, *FAULTS)}  # type: ignore[misc]


def _course() -> Mapping[str, Make]:
    """A car that begins with the course of GNSS; its faults are those of a vehicle that does not move along its nose."""
    turned = {NONE: 0.0, "biased": math.radians(20.0), "wrong sign": math.pi, "wrong axes": 0.5 * math.pi}

    def make(fault: str, seed: int) -> Case:
        def path(t: Array) -> Array:
            points = car(t)
            points[:, 3] += turned[fault]
            return points

        journey = ride(5.0, 60.0, seed=seed, yaw=0.0, path=path, imu=_HOBBY)
        config = _config(initialise=InitialiseConfig(course_sigma_deg=5.0))
        return _case(journey, [], NONE, ("/gnss/velocity",), config, 0.0)

    return {fault: lambda seed, fault=fault: make(fault, seed) for fault in turned}  # type: ignore[misc]


_UWB: Final = _config(beacon=BeaconConfig(at_n_m=_BEACONS.at_n_m))

CASES: Final[dict[str, Mapping[str, Make]]] = {
    "velocity in the body": _looping(lambda t, s: velocity_body(t, seed=s), ("/velocity_body",), _config()),
    "wheels": _wheels(),
    "flow": _looping(_flow, (FLOW,), _config()),
    "range to ground": _looping(lambda t, s: range_down(t, seed=s), ("/range",), _config(), scalar=True),
    "barometer": _looping(lambda t, s: barometer(t, seed=s), ("/baro",), _config(), scalar=True),
    "magnetometer": _looping(lambda t, s: magnetometer(t, seed=s), ("/mag",), _config()),
    "two antennas": _looping(lambda t, s: heading(t, seed=s), ("/heading",), _config()),
    "beacons, one of three": _looping(_beacons, ("/beacon/1",), _UWB, scalar=True),
    "beacons, all three": _looping(_beacons, ("/beacon/1", "/beacon/2", "/beacon/3"), _UWB, scalar=True),
    "airspeed": _airspeed(),
    "drag": _drag(),
    "rest": _rest(),
    "first of two IMUs": _imus(2, "/imu"),
    "first of three IMUs": _imus(3, "/imu"),
    "second of two IMUs": _imus(2, "/imu2"),
    "autopilot's attitude": _attitude(),
    "course of GNSS": _course(),
    "velocity of GNSS": _looping(lambda *_: [], ("/gnss/velocity",), _config()),
}
