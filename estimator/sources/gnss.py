"""GNSS: position on the ellipsoid, velocity over ground.

White covariance of the receiver, and slow considered errors (atmosphere, multipath, receiver filter).
"""

import math
from functools import lru_cache
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from estimator.sources.base.aid import FALSE_POSITION_M, FALSE_VELOCITY_M_S, Aid, Refusal, SlowError, log_false, order
from estimator.sources.base.covariance import covariance_refusal, with_default
from estimator.sources.base.rules import RULES
from models.frames import Origin
from models.measurements import Position, Velocity
from models.messages import GnssFix, GnssVelocity, Reason, ReceiverState

FLAGGED = "the receiver reports "  # begins the detail of a fix whose receiver has raised a flag
_AXES = np.arange(3)
_FASTEST_M_S = 500.0
_JAMMED = msgspec.structs.replace(RULES["gnss"], false_share=0.5)  # a receiver that reports jamming: as likely as not
_NOTHING = np.zeros((3, 3))  # is known of the accuracy
_NO_ACCURACY = "the receiver gives no accuracy: [gnss] {} taken"


_Lever: TypeAlias = Annotated[float, Meta(ge=-100, le=100)]


class ReceiverConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[[gnss.receivers]]: what one receiver has of its own; what is left out is as in [gnss]."""

    topic: str
    delay_s: Annotated[float, Meta(ge=-1, le=5)] | None = None
    antenna_b_m: tuple[_Lever, _Lever, _Lever] | None = None
    horizontal_sigma_m: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    vertical_sigma_m: Annotated[float, Meta(ge=1e-3, le=1e4)] | None = None
    velocity_sigma_m_s: Annotated[float, Meta(ge=1e-3, le=1000)] | None = None
    slow_sigma_m: Annotated[float, Meta(ge=0, le=1e4)] | None = None


class GnssConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[gnss]: delay, lever arm, default noise, judgement."""

    delay_s: Annotated[
        float, Meta(ge=-1, le=5, description="s: stamps are later than validity by this much; below 0: the IMU's are")
    ] = 0.0
    velocity_delay_s: Annotated[
        float, Meta(ge=-1, le=5, description="s: velocities are older than positions of the same stamp by this much")
    ] = 0.0
    antenna_b_m: Annotated[tuple[_Lever, _Lever, _Lever], Meta(description="m: antenna from the IMU, forward right down")] = (
        0.0,
        0.0,
        0.0,
    )
    horizontal_sigma_m: Annotated[float, Meta(ge=1e-3, le=1e4, description="m: where the receiver gives no accuracy, or 0")] = 1.5
    vertical_sigma_m: Annotated[float, Meta(ge=1e-3, le=1e4, description="m: where the receiver gives no accuracy, or 0")] = 3.0
    velocity_sigma_m_s: Annotated[
        float, Meta(ge=1e-3, le=1000, description="m/s: where the receiver gives no accuracy, or 0")
    ] = 0.3
    trust: Annotated[
        float, Meta(ge=0, le=1, description="probability that the receiver is not misled (spoofed) for long; 1: never questioned")
    ] = 0.99
    slow_sigma_m: Annotated[float, Meta(ge=0, le=1e4, description="m: slow part of the position error, horizontal; 0: none")] = (
        1.5
    )
    slow_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: correlation time of the slow part")] = 60.0
    velocity_slow_sigma_m_s: Annotated[
        float, Meta(ge=0, le=1000, description="m/s: slow part of the velocity error, horizontal; 0: none")
    ] = 0.05
    velocity_slow_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: correlation time of that")] = 10.0
    receivers: Annotated[
        tuple[ReceiverConfig, ...],
        Meta(description="[[gnss.receivers]], one by topic: its delay, antenna and sigmas where they differ from these"),
    ] = ()

    def of(self, topic: str) -> "GnssConfig":
        """For one receiver."""
        return _own(self, topic) if self.receivers else self


@lru_cache(maxsize=64)
def _own(config: GnssConfig, topic: str) -> GnssConfig:
    own = next((msgspec.structs.asdict(r) for r in config.receivers if r.topic == topic), {})
    given = {key: value for key, value in own.items() if key != "topic" and value is not None}
    return msgspec.structs.replace(config, receivers=(), **given)


def position_aid(fix: GnssFix, config: GnssConfig) -> Aid | Refusal:
    """A fix as a position measurement."""
    config = config.of(fix.topic)
    place = (fix.lat_deg, fix.lon_deg, fix.alt_m)
    if fix.status < 0:
        return Refusal(Reason.NO_FIX)
    if not all(map(math.isfinite, place)):
        return Refusal(Reason.NOT_FINITE, "position")
    if not fix.is_on_earth:
        return Refusal(Reason.IMPLAUSIBLE, "no place on Earth: latitude and longitude are expected in degrees, height in metres")
    if fix.lat_deg == 0.0 and fix.lon_deg == 0.0:
        return Refusal(Reason.NO_FIX, "latitude and longitude are exactly zero")
    sigmas = (config.horizontal_sigma_m, config.horizontal_sigma_m, config.vertical_sigma_m)
    noise, is_assumed = with_default(_NOTHING if fix.covariance_n is None else fix.covariance_n, sigmas)
    if refusal := covariance_refusal(noise, 3):
        return refusal
    lever = np.array(config.antenna_b_m)
    is_jammed, is_spoofed = fix.state is ReceiverState.JAMMED, fix.state is ReceiverState.SPOOFED
    rules = _JAMMED if is_jammed else RULES["gnss"]
    t_ns = fix.t_ns - round(config.delay_s * 1e9)
    return Aid(
        t_ns=t_ns,
        arrived_ns=fix.arrived_ns,
        topic=fix.topic,
        kind="gnss_position",
        order=order(t_ns, "gnss_position", fix.topic, *place, noise.tobytes(), float(fix.state)),
        rules=rules,
        absolute=True,
        log_false=log_false(rules, [FALSE_POSITION_M] * 3),
        measurement=lambda origin: None if origin is None else Position(np.array(origin.to_ned(*place)), noise, _AXES, lever),
        log_misled=math.log(1.0 - config.trust) if config.trust < 1.0 else None,
        slow_errors=_slow("gnss", config.slow_sigma_m, config.slow_s),
        geodetic=None if is_spoofed else place,
        check=_spoofed if is_spoofed else None,
        detail=f"{FLAGGED}jamming" if is_jammed else "",
        assumed=_NO_ACCURACY.format(f"horizontal_sigma_m {sigmas[0]:g}, vertical_sigma_m {sigmas[2]:g}") if is_assumed else "",
    )


def _spoofed(_: Origin | None) -> Refusal:
    return Refusal(Reason.STOPPED, f"{FLAGGED}spoofing")


def velocity_aid(velocity: GnssVelocity, config: GnssConfig) -> Aid | Refusal:
    """A velocity over ground as a measurement."""
    config = config.of(velocity.topic.rpartition("/")[0])
    v_n = np.array(velocity.v_n)
    if not all(map(math.isfinite, velocity.v_n)):
        return Refusal(Reason.NOT_FINITE, "velocity")
    if max(map(abs, velocity.v_n)) > _FASTEST_M_S:
        return Refusal(Reason.IMPLAUSIBLE, f"faster than {_FASTEST_M_S:.0f} m/s: metres per second are expected")
    sigmas = (config.velocity_sigma_m_s,) * 3
    noise, is_assumed = with_default(_NOTHING if velocity.covariance_n is None else velocity.covariance_n, sigmas)
    if refusal := covariance_refusal(noise, 3):
        return refusal
    z = Velocity(v_n, noise, np.array(config.antenna_b_m))
    t_ns = velocity.t_ns - round((config.delay_s + config.velocity_delay_s) * 1e9)
    return Aid(
        t_ns=t_ns,
        arrived_ns=velocity.arrived_ns,
        topic=velocity.topic,
        kind="gnss_velocity",
        order=order(t_ns, "gnss_velocity", velocity.topic, v_n.tobytes(), noise.tobytes()),
        rules=RULES["gnss"],
        absolute=False,
        log_false=log_false(RULES["gnss"], [FALSE_VELOCITY_M_S] * 3),
        measurement=lambda _: z,
        uses_rate=True,
        slow_errors=_slow("gnss_velocity", config.velocity_slow_sigma_m_s, config.velocity_slow_s),
        receiver=velocity.topic.rpartition("/")[0] or None,  # /gnss/velocity comes from /gnss
        assumed=_NO_ACCURACY.format(f"velocity_sigma_m_s {config.velocity_sigma_m_s:g}") if is_assumed else "",
    )


@lru_cache(maxsize=64)
def _slow(block: str, sigma: float, tau_s: float) -> tuple[SlowError, ...]:
    return (SlowError(block, np.diag([sigma**2, sigma**2, 4.0 * sigma**2]), tau_s),) if sigma else ()
