"""Faults: transforms of messages, in order of arrival.

messages' = fault(messages),   applied to messages of the fault's topics with  start_s <= t - epoch < end_s
"""

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

import msgspec
import numpy as np

from models.frames import GRAVITY, Origin
from models.messages import Array, GnssFix, GnssVelocity, ImuSample, Input, PoseFix, Vec3, vec3
from models.sim.ranges import Delay, NotNegative, Positive, Share, ascending, between

IMU, GNSS, VELOCITY, POSE_FIX = "/imu", "/gnss", "/gnss/velocity", "/pose_fix"

M = TypeVar("M", bound=msgspec.Struct)
_FOOT = 0.3048  # m


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """Interval (seconds from the start, open end), topics, random numbers."""

    start_s: NotNegative = 0.0
    end_s: NotNegative | None = None
    topics: tuple[str, ...] = (GNSS, VELOCITY)
    seed: int = 0

    def __post_init__(self) -> None:
        ascending("start_s, end_s", (self.start_s, math.inf if self.end_s is None else self.end_s))

    def apply(self, messages: list[Input], epoch_ns: int, origin: Origin | None, run_seed: int = 0) -> list[Input]:
        """Faulty messages in order of arrival. Raises ValueError for a GNSS move without origin."""
        rng = np.random.default_rng([self.seed, run_seed])
        end_s = math.inf if self.end_s is None else self.end_s
        result: list[Input] = []
        for message in messages:
            since_s = (message.t_ns - epoch_ns) * 1e-9
            if message.topic in self.topics and self.start_s <= since_s < end_s:
                result += self._become(message, _Moment(since_s - self.start_s, origin, rng))
            else:
                result.append(message)
        return in_order(result)

    def _become(self, message: Input, at: "_Moment") -> list[Input]:
        raise NotImplementedError  # each kind says it; a msgspec Struct cannot be an ABC as well


@dataclass(frozen=True, slots=True)
class _Moment:
    since_s: float
    origin: Origin | None
    rng: np.random.Generator


def in_order(messages: list[Input]) -> list[Input]:
    """By arrival, stable."""
    return sorted(messages, key=lambda m: m.arrived_ns)


class Drop(Fault, frozen=True, tag="drop"):
    """Messages are lost."""

    share: Share = 1.0

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        return [] if at.rng.random() < self.share else [message]


class ImuDropout(Drop, frozen=True, tag="imu_dropout"):
    """The IMU is silent; the scenario needs ticks."""

    topics: tuple[str, ...] = (IMU,)


class Jam(Fault, frozen=True, tag="jam"):
    """GNSS is silent, or status -1 without velocity (silent = false)."""

    silent: bool = True

    def _become(self, message: Input, _: _Moment) -> list[Input]:
        if self.silent or not isinstance(message, GnssFix):
            return []
        return [_with(message, status=-1)]


class SpoofJump(Fault, frozen=True, tag="spoof_jump"):
    """GNSS positions jump; velocity stays true."""

    offset_n_m: Vec3 = (100.0, 0.0, 0.0)

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        return [_displaced(message, np.array(self.offset_n_m), at.origin)]


class SpoofPull(Fault, frozen=True, tag="spoof_pull"):
    """GNSS is drawn away slowly, velocity included."""

    rate_n_m_s: Vec3 = (0.5, 0.0, 0.0)

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        rate = np.array(self.rate_n_m_s)
        if isinstance(message, GnssVelocity):
            return [_with(message, v_n=vec3(rate + message.v_n))]
        return [_displaced(message, rate * at.since_s, at.origin)]


class Meacon(Fault, frozen=True, tag="meacon"):
    """A repeater: the receiver reports the repeater's antenna, at rest."""

    place_n_m: Vec3 = (200.0, 200.0, -10.0)

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        covariance = message.covariance_n if isinstance(message, GnssFix | GnssVelocity) else None
        noise = np.zeros(3) if covariance is None else at.rng.multivariate_normal(np.zeros(3), covariance)
        if isinstance(message, GnssVelocity):
            return [_with(message, v_n=vec3(noise))]
        if isinstance(message, GnssFix):
            lat, lon, alt = _known(at.origin).to_geodetic(self.place_n_m + noise)
            return [_with(message, lat_deg=lat, lon_deg=lon, alt_m=alt)]
        return [message]


class Late(Fault, frozen=True, tag="delay"):
    """Messages arrive later, by a constant or random [least, most]."""

    topics: tuple[str, ...] = (POSE_FIX,)
    delay_s: Delay = 0.5

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        delay_ns = round(at.rng.uniform(*between(self.delay_s)) * 1e9)
        return [_with(message, arrived_ns=message.arrived_ns + delay_ns)]


class Duplicate(Fault, frozen=True, tag="duplicate"):
    """A share of messages comes again, later."""

    topics: tuple[str, ...] = (POSE_FIX,)
    share: Share = 0.5
    delay_s: NotNegative = 0.1

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        again = _with(message, arrived_ns=message.arrived_ns + round(self.delay_s * 1e9))
        return [message, again] if at.rng.random() < self.share else [message]


class Shuffle(Fault, frozen=True, tag="shuffle"):
    """Messages are delivered together, shuffled, at each window's end."""

    topics: tuple[str, ...] = (POSE_FIX,)
    window_s: Positive = 2.0

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        held_s = self.window_s * (math.floor(at.since_s / self.window_s) + 1) - at.since_s
        # A random microsecond is the random order: arrivals differ, and in_order does the rest.
        held_ns = round(held_s * 1e9) + int(at.rng.integers(1_000_000))
        return [_with(message, arrived_ns=max(message.arrived_ns, message.t_ns + held_ns))]


class NotFinite(Fault, frozen=True, tag="not_finite"):
    """A share of messages carries NaN or infinity."""

    topics: tuple[str, ...] = (IMU, GNSS, VELOCITY, POSE_FIX)
    share: Share = 0.1
    value: Literal["nan", "inf"] = "nan"

    def _become(self, message: Input, at: _Moment) -> list[Input]:
        if at.rng.random() >= self.share:
            return [message]
        bad = float(self.value)
        match message:
            case ImuSample():
                return [_with(message, accel_b=(*message.accel_b[:2], bad))]
            case GnssFix():
                return [_with(message, lat_deg=bad)]
            case GnssVelocity():
                return [_with(message, v_n=(bad, *message.v_n[1:]))]
            case PoseFix():
                return [_with(message, p_n=(bad, *message.p_n[1:]))]
            case _:
                return [message]


class ZeroCovariance(Fault, frozen=True, tag="zero_covariance"):
    """The reported covariance is zero."""

    topics: tuple[str, ...] = (GNSS, VELOCITY, POSE_FIX)

    def _become(self, message: Input, _: _Moment) -> list[Input]:
        match message:
            case GnssFix() | GnssVelocity():
                return [_with(message, covariance_n=np.zeros((3, 3)))]
            case PoseFix():
                return [_with(message, covariance=np.zeros((6, 6)))]
            case _:
                return [message]


class ClockStep(Fault, frozen=True, tag="clock_step"):
    """The stamping clock jumps; arrivals do not."""

    topics: tuple[str, ...] = (POSE_FIX,)
    step_s: float = 1.0

    def _become(self, message: Input, _: _Moment) -> list[Input]:
        return [_with(message, t_ns=message.t_ns + round(self.step_s * 1e9))]


class WrongUnits(Fault, frozen=True, tag="wrong_units"):
    """deg/s: gyro; g: accelerometer; no_gravity: acceleration (level flight); feet: fixes."""

    topics: tuple[str, ...] = (IMU, GNSS, POSE_FIX)
    unit: Literal["deg/s", "g", "no_gravity", "feet"] = "deg/s"

    def _become(self, message: Input, _: _Moment) -> list[Input]:
        match self.unit, message:
            case "deg/s", ImuSample():
                return [_with(message, gyro_b=vec3(np.degrees(message.gyro_b)))]
            case "g", ImuSample():
                return [_with(message, accel_b=vec3(np.divide(message.accel_b, GRAVITY)))]
            case "no_gravity", ImuSample():
                return [_with(message, accel_b=vec3(np.add(message.accel_b, (0.0, 0.0, GRAVITY))))]
            case "feet", GnssFix():
                return [_with(message, alt_m=message.alt_m / _FOOT)]
            case "feet", PoseFix():
                return [_with(message, p_n=vec3(np.divide(message.p_n, _FOOT)))]
            case _:
                return [message]


AnyFault: TypeAlias = (
    Drop | ImuDropout | Jam | SpoofJump | SpoofPull | Meacon | Late | Duplicate | Shuffle | NotFinite | ZeroCovariance | ClockStep
    | WrongUnits
)  # fmt: skip


def _with(message: M, **changes: object) -> M:
    return msgspec.structs.replace(message, **changes)


def _known(origin: Origin | None) -> Origin:
    if origin is None:
        raise ValueError("a GNSS position can be moved only where the origin is known")
    return origin


def _displaced(message: Input, offset_n: Array, origin: Origin | None) -> Input:
    if isinstance(message, PoseFix):
        return _with(message, p_n=vec3(offset_n + message.p_n))
    if not isinstance(message, GnssFix):
        return message
    known = _known(origin)
    lat, lon, alt = known.to_geodetic(offset_n + known.to_ned(message.lat_deg, message.lon_deg, message.alt_m))
    return _with(message, lat_deg=lat, lon_deg=lon, alt_m=alt)
