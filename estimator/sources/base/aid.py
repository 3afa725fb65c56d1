"""The measurement that a source delivers: its place in the order, what it says, the errors that it carries, or why it is none."""

import math
import struct
from collections.abc import Callable, Sequence
from functools import cache
from hashlib import blake2b
from typing import NamedTuple

import msgspec

from estimator.sources.base.rules import RULES, Rules
from models.frames import Origin
from models.measurements import Measurement
from models.messages import Array, Reading, Reason

_FLOAT = struct.Struct("=d")


class Aid(msgspec.Struct, frozen=True, eq=False):
    """A message that passed its checks, as a measurement.

    order: the place among all measurements; measurement(origin) builds z, None without an origin; absolute: fixes the position
    on the map; log_false: ln of the probability density of a false reading; slow_errors: those that it carries; detail: what
    there is to say of it once it is judged; alignment_only: a prior, not fused in flight; assumed: what was taken in place of an
    accuracy that the message does not give; weighs: it is evidence for one hypothesis rather than another, which a reading is not
    whose considered errors are larger than the rest: the next one says the same; begin: of a measurement over some time, what
    takes a place of its own in the order where that time begins; delay_sigma_s: of the time of validity, s; check(origin): why it
    is none at that place; uses_rate: the angular rate takes part.
    """

    t_ns: int
    arrived_ns: int
    topic: str
    kind: str
    order: tuple[int, str, str, bytes]
    rules: Rules
    absolute: bool
    log_false: float
    measurement: Callable[[Origin | None], Measurement | None]
    slow_errors: "tuple[SlowError, ...]" = ()
    geodetic: tuple[float, float, float] | None = None
    receiver: str | None = None
    detail: str = ""
    alignment_only: bool = False
    assumed: str = ""
    log_misled: float | None = None
    weighs: bool = True
    uses_rate: bool = False
    check: "Callable[[Origin | None], Refusal | None] | None" = None
    begin: "Aid | None" = None
    delay_sigma_s: float = 0.0

    @property
    def is_reported(self) -> bool:
        """Whether its decision is one to report."""
        return True

    @property
    def resembles(self) -> bool:
        """A false reading is a look-alike, found where it was sought, so that it proves little when it fits."""
        return self.kind == "pose"

    @property
    def witness(self) -> str:
        """The topic of its receiver's positions, which is no independent source, or its own."""
        return self.receiver or self.topic


class SensorConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The section of an optional sensor: it is off until its key in [inputs] names a topic."""

    def aid(self, reading: Reading) -> "Aid | Refusal":
        """The reading, whose values are finite, as a measurement, or why it is none."""
        raise NotImplementedError


class SlowError(msgspec.Struct, frozen=True, eq=False):
    """An error s (k,) that repeats from fix to fix: first-order Gauss-Markov of covariance (k, k), time constant tau_s [s].

    jacobian: d z / d s, (m, k), of all components of the measurement, or that of the state; None: s shifts the leading components
    one by one.
    walk: (k,) variance per second: s is estimated as a random walk, s_0 from the first reading on; None: it is considered.
    starts_at_zero: where it is estimated, s_0 is 0 with this covariance, and not what the first reading makes of it.
    """

    block: str
    covariance: Array
    tau_s: float
    jacobian: Array | Callable[[Array], Array] | None = None
    walk: Array | None = None
    starts_at_zero: bool = False

    def moves(self, x: Array) -> Array | None:
        """The jacobian at the state x."""
        return self.jacobian(x) if callable(self.jacobian) else self.jacobian


class Refusal(NamedTuple):
    """Why a message is no measurement."""

    reason: Reason
    detail: str = ""


# Half widths of the box in which a false reading is expected, per component.
FALSE_POSITION_M, FALSE_ATTITUDE_RAD, FALSE_VELOCITY_M_S = 50.0, 1.0, 30.0


def log_false(rules: Rules, half_widths: Sequence[float]) -> float:
    """ln(share x density) of a false reading, uniform in a box of these half widths."""
    return _log_uniform(rules.false_share, tuple(half_widths))


@cache
def _log_uniform(share: float, half_widths: tuple[float, ...]) -> float:
    return math.log(share) - sum(math.log(2.0 * w) for w in half_widths)


def order(t_ns: int, kind: str, topic: str, *content: float | bytes) -> tuple[int, str, str, bytes]:
    """Where a measurement stands among all: by time, then kind, topic and content, so that arrival plays no part."""
    raw = b"".join([c if isinstance(c, bytes) else _FLOAT.pack(c) for c in content])
    return t_ns, kind, topic, blake2b(raw, digest_size=8).digest()


def _no_reading(_: object) -> "Measurement | None":
    return None


def asked(t_ns: int, topic: str, half_widths: Sequence[float], slow: "tuple[SlowError, ...]") -> Aid:
    """What the IMU itself shows at t_ns, with no reading of a sensor: the samples before it give the measurement."""
    return Aid(
        t_ns=t_ns,
        arrived_ns=t_ns,
        topic=topic,
        kind=topic,
        order=order(t_ns, topic, topic),
        rules=RULES[topic],
        absolute=False,
        log_false=log_false(RULES[topic], half_widths),
        measurement=_no_reading,
        slow_errors=slow,
        weighs=False,
    )
