"""A flight's faults, drawn: which kinds it has, how large, from when to when.

    kind i is there with probability q_i;   nominally it would be with p_i = 1 - exp(-r_i T)
    weight of the flight  w = prod_i (p_i / q_i where it is there, (1 - p_i) / (1 - q_i) where not)

r_i: rate of the fault table for its cause, shared by the kinds of that cause; T: duration of the flight. Sizes are log-uniform,
onset and end uniform: their laws are the same nominally and as drawn, so they are not in the weight.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Final

import msgspec
import numpy as np

from benchmarks.stress.flights import Flight
from benchmarks.stress.perturbations import (
    ONSET_S,
    Perturb,
    Rng,
    antenna_switch,
    bias_ramp,
    fix_delay,
    fix_drift,
    fix_heading,
    fix_scale,
    gnss_boot,
    gnss_delay,
    gnss_pull,
    gnss_slow,
    height_datum,
    imu_mount,
    map_north,
    map_shift,
    vibration,
)
from estimator.integrity.config import IntegrityConfig
from models.messages import Input, PoseFix
from models.sim.faults import in_order

_TABLE: Final = IntegrityConfig()
FAULTS_A_FLIGHT: Final = 1.0  # drawn, on average
_SHORTEST_S: Final = 5.0


class Kind(msgspec.Struct, frozen=True):
    """A fault that can be drawn. cause: whose rate of the fault table it shares; sizes: smallest and largest, in `unit`."""

    perturb: Perturb
    cause: str
    unit: str
    sizes: tuple[float, float]


def repeated(flight: Flight, size: float, rng: Rng) -> list[Input]:  # noqa: ARG001  (one signature for all)
    """Pose fixes say the position of the first one again and again, size m off it, with new stamps."""
    fixes = [m for m in flight.messages if isinstance(m, PoseFix)]
    if not fixes:
        return flight.messages
    said = {"p_n": (fixes[0].p_n[0] + size, *fixes[0].p_n[1:]), "q_nb_wxyz": fixes[0].q_nb_wxyz}
    return [msgspec.structs.replace(m, **said) if isinstance(m, PoseFix) else m for m in flight.messages]


RATES: Final[Mapping[str, float]] = {
    "gnss": _TABLE.gnss_fault_per_hour,
    "fix": _TABLE.fix_fault_per_hour,
    "map": _TABLE.map_fault_per_hour,
    "timing": _TABLE.timing_fault_per_hour,
    "imu": _TABLE.imu_fault_per_hour,
}
KINDS: Final[Mapping[str, Kind]] = {
    "GNSS pulled": Kind(gnss_pull, "gnss", "m/s", (0.05, 5.0)),
    "antenna switch": Kind(antenna_switch, "gnss", "m", (1.0, 100.0)),
    "GNSS off": Kind(gnss_boot, "gnss", "m", (5.0, 5000.0)),
    "GNSS slow error": Kind(gnss_slow, "gnss", "m", (0.5, 5.0)),
    "height datum": Kind(height_datum, "gnss", "m", (3.0, 50.0)),
    "GNSS delay": Kind(gnss_delay, "timing", "ms", (20.0, 300.0)),
    "fix delay": Kind(fix_delay, "timing", "ms", (20.0, 300.0)),
    "map shift": Kind(map_shift, "map", "m", (0.5, 20.0)),
    "map north": Kind(map_north, "map", "deg", (0.5, 30.0)),
    "fix scale": Kind(fix_scale, "map", "%", (0.05, 5.0)),
    "fix frame drifts": Kind(fix_drift, "fix", "x", (0.5, 5.0)),
    "fix heading": Kind(fix_heading, "fix", "deg", (1.0, 30.0)),
    "pose source repeats itself": Kind(repeated, "fix", "m", (0.01, 5.0)),
    "vibration": Kind(vibration, "imu", "m/s^2", (1.0, 15.0)),
    "bias ramp": Kind(bias_ramp, "imu", "deg/s/min", (0.1, 2.0)),
    "IMU mount": Kind(imu_mount, "imu", "deg", (0.5, 5.0)),
}


class Fault(msgspec.Struct, frozen=True):
    """One that was drawn, between two times from the flight's first message."""

    kind: str
    size: float
    from_s: float
    to_s: float

    def __str__(self) -> str:
        return f"{self.kind} {self.size:.3g} {KINDS[self.kind].unit} from {self.from_s:.0f} to {self.to_s:.0f} s"


def nominal(kind: str, duration_s: float) -> float:
    """p_i: the probability of a kind in a flight, by the fault table."""
    cause = KINDS[kind].cause
    shared = RATES[cause] / sum(k.cause == cause for k in KINDS.values())
    return -math.expm1(-shared * duration_s / 3600.0)


def drawn(rng: Rng, duration_s: float) -> tuple[tuple[Fault, ...], float]:
    """The faults of a flight, and its weight."""
    share = FAULTS_A_FLIGHT / len(KINDS)
    faults, weight = list[Fault](), 1.0
    for name, kind in KINDS.items():
        p = nominal(name, duration_s)
        if rng.random() >= share:
            weight *= (1.0 - p) / (1.0 - share)
            continue
        weight *= p / share
        low, high = np.log(kind.sizes)
        from_s = rng.uniform(0.0, duration_s - _SHORTEST_S)
        faults.append(Fault(name, float(np.exp(rng.uniform(low, high))), from_s, rng.uniform(from_s + _SHORTEST_S, duration_s)))
    return tuple(faults), weight


def with_faults(flight: Flight, faults: tuple[Fault, ...], rng: Rng) -> list[Input]:
    """The messages with each fault while it lasts, one after the other."""
    messages = flight.messages
    for fault in faults:
        begin, end = (flight.start_ns + round(s * 1e9) for s in (fault.from_s, fault.to_s))
        inside = [m for m in messages if begin <= m.t_ns < end]
        changed = KINDS[fault.kind].perturb(_begun(flight, inside, begin), fault.size, rng)
        messages = in_order([*(m for m in messages if not begin <= m.t_ns < end), *(m for m in changed if m.t_ns >= begin)])
    return messages


def _begun(flight: Flight, messages: list[Input], begin_ns: int) -> Flight:
    """The flight with these messages behind one that is ONSET_S older: what sets in at ONSET_S sets in with the first of them."""
    first = msgspec.structs.replace(flight.messages[0], t_ns=begin_ns - round(ONSET_S * 1e9))
    return dataclasses.replace(flight, messages=[first, *messages])
