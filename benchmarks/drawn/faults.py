"""A flight's faults, drawn: which kinds it has, how large, from when to when.

    kind i is there with probability q_i;   nominally it would be with p_i = 1 - exp(-r_i T)
    weight of the flight  w = prod_i (p_i / q_i where it is there, (1 - p_i) / (1 - q_i) where not)

r_i: rate of the fault table for its cause, shared by the kinds of that cause; T: duration of the flight. Sizes and durations are
log-uniform, onsets uniform: their laws are the same nominally and as drawn, so they are not in the weight.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Final

import msgspec

from benchmarks.stress import perturbations as perturb
from benchmarks.stress.flights import Flight
from benchmarks.stress.perturbations import ONSET_S, Perturb, Rng
from estimator.integrity.config import IntegrityConfig
from models.frames import GRAVITY
from models.messages import Input
from models.sim.faults import in_order

_TABLE: Final = IntegrityConfig()
FAULTS_A_FLIGHT: Final = 1.0  # drawn, on average
SHORTEST_S: Final = 2.0


class Kind(msgspec.Struct, frozen=True):
    """A fault that can be drawn. cause: whose rate of the fault table it shares; sizes: smallest and largest, in `unit`.

    bounded: the largest size in the fault table where no second source checks; onset_s: from the first message, when
    the perturbation sets in.
    """

    perturb: Perturb
    cause: str
    unit: str
    sizes: tuple[float, float]
    bounded: float = 0.0
    onset_s: float = ONSET_S


RATES: Final[Mapping[str, float]] = {
    "gnss": _TABLE.gnss_fault_per_hour,
    "fix": _TABLE.fix_fault_per_hour,
    "map": _TABLE.map_fault_per_hour,
    "timing": _TABLE.timing_fault_per_hour,
    "imu": _TABLE.imu_fault_per_hour,
}
_LATE_MS: Final = 1000.0 * _TABLE.timing_s
_TURN_DEG: Final = math.degrees(_TABLE.imu_fault_m_s2 / GRAVITY)
KINDS: Final[Mapping[str, Kind]] = {
    "GNSS pulled": Kind(perturb.gnss_pull, "gnss", "m/s", (0.05, 5.0)),
    "antenna switch": Kind(perturb.antenna_switch, "gnss", "m", (1.0, 100.0)),
    "GNSS off": Kind(perturb.gnss_boot, "gnss", "m", (5.0, 5000.0)),
    "GNSS slow error": Kind(perturb.gnss_slow, "gnss", "m", (0.5, 5.0)),
    "GNSS frozen": Kind(perturb.gnss_frozen, "gnss", "s", (5.0, 100.0)),
    "GNSS jammed": Kind(perturb.gnss_jammed, "gnss", "s", (3.0, 20.0)),
    "height datum": Kind(perturb.height_datum, "gnss", "m", (3.0, 50.0)),
    "GNSS delay": Kind(perturb.gnss_delay, "timing", "ms", (20.0, 300.0), _LATE_MS),
    "fix delay": Kind(perturb.fix_delay, "timing", "ms", (20.0, 450.0), _LATE_MS),
    "time jitter": Kind(perturb.time_jitter, "timing", "ms", (2.0, 30.0), _LATE_MS),
    "map shift": Kind(perturb.map_shift, "map", "m", (0.5, 30.0), _TABLE.map_shift_m),
    "map north": Kind(perturb.map_north, "map", "deg", (0.5, 30.0)),
    "fix scale": Kind(perturb.fix_scale, "map", "%", (0.05, 5.0), _TABLE.map_scale_percent),
    "fix frame drifts": Kind(perturb.fix_drift, "fix", "x", (0.5, 5.0)),
    "fix heading": Kind(perturb.fix_heading, "fix", "deg", (1.0, 180.0)),
    "fix repeats": Kind(perturb.fix_repeats, "fix", "s", (2.0, 100.0)),
    "fixes scatter": Kind(perturb.fix_scatter, "fix", "m", (1.0, 30.0)),
    "look-alikes": Kind(perturb.look_alikes, "fix", "fixes", (1.0, 20.0)),
    "fix covariance too small": Kind(perturb.fix_covariance, "fix", "x", (2.0, 100.0)),
    "vibration": Kind(perturb.vibration, "imu", "m/s^2", (1.0, 30.0), _TABLE.imu_fault_m_s2 / perturb.RECTIFIED),
    "bias ramp": Kind(perturb.bias_ramp, "imu", "deg/s/min", (0.1, 2.0)),
    "IMU mount": Kind(perturb.imu_mount, "imu", "deg", (0.5, 180.0), _TURN_DEG),
    "IMU held": Kind(perturb.imu_held, "imu", "s", (0.1, 2.0), onset_s=perturb.HELD_EVERY_S - 2.0),
    "IMU biased": Kind(perturb.imu_biased, "imu", "times", (0.2, 15.0), _TABLE.imu_fault_m_s2 / perturb.BIAS_M_S2),
    "yaw gyro dead": Kind(perturb.gyro_axis_dead, "imu", "s", (1.0, 60.0)),
    "gyro scale": Kind(perturb.gyro_scale, "imu", "%", (1.0, 100.0)),
    "accelerometer clips": Kind(perturb.clipping, "imu", "s", (0.1, 1.0), onset_s=perturb.BURST_EVERY_S - 1.0),
    "IMU samples lost": Kind(perturb.imu_drop, "imu", "%", (2.0, 50.0)),
}
_OF_GNSS: Final = frozenset(name for name, k in KINDS.items() if k.cause == "gnss") | {"GNSS delay"}


class Fault(msgspec.Struct, frozen=True):
    """One that was drawn, between two times from the flight's first message."""

    kind: str
    size: float
    from_s: float
    to_s: float

    def __str__(self) -> str:
        return f"{self.kind} {self.size:.3g} {KINDS[self.kind].unit} from {self.from_s:.0f} to {self.to_s:.0f} s"

    def bounded(self, aids: str) -> bool:
        """Whether the fault table bounds it, at this size and with these sources."""
        return aids == "both" or self.size <= KINDS[self.kind].bounded


def kinds_of(aids: str) -> list[str]:
    """Of a flight with these sources: "fixes" or "both"."""
    return [name for name in KINDS if aids == "both" or name not in _OF_GNSS]


def nominal(kind: str, aids: str, duration_s: float) -> float:
    """p_i: the probability of a kind in a flight, by the fault table."""
    cause = KINDS[kind].cause
    shared = RATES[cause] / sum(KINDS[k].cause == cause for k in kinds_of(aids))
    return -math.expm1(-shared * duration_s / 3600.0)


def within(kind: str, aids: str) -> float:
    """Share of a kind's faults that the fault table bounds, by the law of sizes."""
    low, high = KINDS[kind].sizes
    if Fault(kind, high, 0.0, 0.0).bounded(aids):
        return 1.0
    return max(0.0, math.log(max(KINDS[kind].bounded, low) / low) / math.log(high / low))


def drawn(rng: Rng, aids: str, duration_s: float) -> tuple[tuple[Fault, ...], float]:
    """The faults of a flight, and its weight."""
    kinds = kinds_of(aids)
    share = FAULTS_A_FLIGHT / len(kinds)
    faults, weight = list[Fault](), 1.0
    for name in kinds:
        p = nominal(name, aids, duration_s)
        if rng.random() >= share:
            weight *= (1.0 - p) / (1.0 - share)
            continue
        weight *= p / share
        from_s = rng.uniform(0.0, duration_s - SHORTEST_S)
        to_s = min(duration_s, from_s + log_uniform(rng, SHORTEST_S, duration_s))
        faults.append(Fault(name, log_uniform(rng, *KINDS[name].sizes), from_s, to_s))
    return tuple(faults), weight


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """A number between the two, whose logarithm is uniform."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def with_faults(flight: Flight, faults: tuple[Fault, ...], rng: Rng) -> list[Input]:
    """The messages with each fault while it lasts, one after the other."""
    messages = flight.messages
    for fault in faults:
        begin, end = (flight.start_ns + round(s * 1e9) for s in (fault.from_s, fault.to_s))
        inside = [m for m in messages if begin <= m.t_ns < end]
        kind = KINDS[fault.kind]
        changed = kind.perturb(_begun(flight, inside, begin - round(kind.onset_s * 1e9)), fault.size, rng)
        messages = in_order([*(m for m in messages if not begin <= m.t_ns < end), *(m for m in changed if m.t_ns >= begin)])
    return messages


def _begun(flight: Flight, messages: list[Input], start_ns: int) -> Flight:
    """The flight with these messages behind one that is older, so that what sets in later sets in with the first of them."""
    first = msgspec.structs.replace(flight.messages[0], t_ns=start_ns)
    return dataclasses.replace(flight, messages=[first, *messages], outages_s=())
