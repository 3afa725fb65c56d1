"""A fault in what a sensor sends: stuck, biased, of the wrong sign, with wrong axes, late."""

import math
from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
from msgspec.structs import replace

from models import so3
from models.messages import AttitudePrior, GnssVelocity, ImuSample, Input, OdometryDelta, Reading, Vec3, vec3

NONE: Final = "none"
FAULTS: Final = ("stuck", "biased", "wrong sign", "wrong axes", "late")
LATE_S: Final = 1.0
_LATE_NS: Final = round(LATE_S * 1e9)
_BIASES: Final[dict[str, tuple[float, ...]]] = {
    "heading": (math.radians(30.0),),
    "magnetometer": (2e-5,),
    "velocity_body": (3.0,),
    "range": (10.0,),
    "baro": (3000.0,),
    "airspeed": (8.0,),
    "beacon": (5.0,),
}
_GYRO_BIAS: Final = (0.5, 0.0, 0.0)  # rad/s
_STEP_BIAS: Final = (0.5, 0.0, 0.0)  # m, of an increment
_QUARTER: Final = so3.from_euler(0.0, 0.0, 0.5 * math.pi)

Sent: TypeAlias = ImuSample | Reading | OdometryDelta | GnssVelocity | AttitudePrior


def faulty(messages: list[Input], fault: str, begin_ns: int, sends: Callable[[Input], bool]) -> list[Input]:
    """The messages, of which those that `sends` picks have the fault since begin_ns; in order of arrival."""
    if fault == NONE:
        return messages
    before: dict[str, Sent] = {}
    changed: list[Input] = []
    for m in messages:
        if not sends(m) or not isinstance(m, Sent):
            changed.append(m)
        elif m.t_ns < begin_ns:
            before[m.topic] = m
            changed.append(m)
        else:
            changed.append(_with_fault(m, before.setdefault(m.topic, m), fault))
    return sorted(changed, key=lambda m: m.arrived_ns)


def _with_fault(m: Sent, before: Sent, fault: str) -> Input:
    if fault == "late":
        shifted: Input = replace(m, t_ns=m.t_ns + _LATE_NS, arrived_ns=m.arrived_ns + _LATE_NS)
        return (
            replace(shifted, t0_ns=m.t0_ns + _LATE_NS)
            if isinstance(shifted, OdometryDelta) and isinstance(m, OdometryDelta)
            else shifted
        )
    if isinstance(m, Reading) and isinstance(before, Reading):
        return replace(m, values=_values(m, before, fault))
    if isinstance(m, ImuSample) and isinstance(before, ImuSample):
        gyro = _vector(m.gyro_b, before.gyro_b, fault, _GYRO_BIAS)
        return replace(m, gyro_b=gyro, accel_b=_vector(m.accel_b, before.accel_b, fault, (0.0, 0.0, 0.0)))
    if isinstance(m, OdometryDelta) and isinstance(before, OdometryDelta):
        return replace(m, dp_b=_vector(m.dp_b, before.dp_b, fault, _STEP_BIAS))
    if isinstance(m, GnssVelocity) and isinstance(before, GnssVelocity):
        return replace(m, v_n=_vector(m.v_n, before.v_n, fault, (3.0, 0.0, 0.0)))
    assert isinstance(m, AttitudePrior)
    assert isinstance(before, AttitudePrior)
    return replace(m, q_nb_wxyz=_attitude(m, before, fault))


def _values(m: Reading, before: Reading, fault: str) -> tuple[float, ...]:
    first, *others = m.values
    match fault:
        case "stuck":
            return before.values
        case "biased":
            return first + _BIASES[m.kind][0], *others
        case "wrong sign":
            return tuple(-v for v in m.values)
        case _:  # x and y exchanged; a heading is that of antennas across
            return (others[0], first, *others[1:]) if others else (math.remainder(first + 0.5 * math.pi, 2.0 * math.pi),)


def _vector(now: Vec3, before: Vec3, fault: str, bias: Vec3) -> Vec3:
    match fault:
        case "stuck":
            return before
        case "biased":
            return vec3(np.add(now, bias))
        case "wrong sign":
            return vec3(np.negative(now))
        case _:
            return now[1], now[0], now[2]


def _attitude(m: AttitudePrior, before: AttitudePrior, fault: str) -> tuple[float, float, float, float]:
    """biased: by 30 degrees of yaw; wrong sign: of pitch and roll; wrong axes: a quarter turn about the vertical."""
    match fault:
        case "stuck":
            return before.q_nb_wxyz
        case "biased":
            q = so3.multiply(so3.from_euler(0.0, 0.0, math.radians(30.0)), np.array(m.q_nb_wxyz))
        case "wrong sign":
            roll, pitch, yaw = so3.to_euler(np.array(m.q_nb_wxyz))
            q = so3.from_euler(-float(roll), -float(pitch), float(yaw))
        case _:
            q = so3.multiply(_QUARTER, np.array(m.q_nb_wxyz))
    w, x, y, z = q.tolist()
    return w, x, y, z
