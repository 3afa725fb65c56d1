"""The measurement of a source: order, content, errors, or its refusal."""

import math
import struct
from collections.abc import Callable, Sequence
from functools import cache
from hashlib import blake2b
from typing import Any, NamedTuple

import msgspec

from estimator.sources.base.rules import RULES, Rules
from models.frames import Origin
from models.measurements import Measurement
from models.messages import Array, Reading, Reason

_FLOAT = struct.Struct("=d")


class Aid(msgspec.Struct, frozen=True, eq=False):
    """A checked message as a measurement.

    measurement(origin): z or None; absolute: fixes the map position; log_false: ln density of a false reading; alignment_only: a
    prior, not fused in flight; assumed: substituted accuracy; weighs: evidence between hypotheses, unless considered errors
    dominate; begin: entry where its time begins; check(origin): refusal, STOPPED: of the source; uses_rate: depends on the
    angular rate.
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

    def doubted(self, false_share: float) -> "Aid":
        """The same of a source of which a larger share is false."""
        log_false = self.log_false + math.log(false_share / self.rules.false_share)
        return msgspec.structs.replace(
            self, rules=msgspec.structs.replace(self.rules, false_share=false_share), log_false=log_false
        )

    @property
    def is_reported(self) -> bool:
        """Whether its decision is reported."""
        return True

    @property
    def is_sensor(self) -> bool:
        """Neither a position nor of a receiver."""
        return not self.absolute and self.receiver is None

    @property
    def resembles(self) -> bool:
        """Searched for at the expected position: a good fit proves little."""
        return self.kind == "pose"

    @property
    def witness(self) -> str:
        """Topic of its receiver's positions, or its own."""
        return self.receiver or self.topic


class SensorConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Section of an optional sensor, off until [inputs] names a topic."""

    def aid(self, reading: Reading) -> "Aid | Refusal":
        """A finite reading as a measurement, or its refusal."""
        raise NotImplementedError


class SlowError(msgspec.Struct, frozen=True, eq=False):
    """An error s (k,) that repeats from fix to fix: first-order Gauss-Markov, covariance (k, k), tau_s [s].

    jacobian: d z / d s (m, k) of the whole measurement, or the state's; None: s shifts the leading components. walk (k,):
    variance per second, estimated, s_0 from the first reading or zero (starts_at_zero); None: considered.
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
    """ln(share x density) of a false reading, uniform in a box."""
    return _log_uniform(rules.false_share, tuple(half_widths))


@cache
def _log_uniform(share: float, half_widths: tuple[float, ...]) -> float:
    return math.log(share) - sum(math.log(2.0 * w) for w in half_widths)


def order(t_ns: int, kind: str, topic: str, *content: float | bytes) -> tuple[int, str, str, bytes]:
    """Place among all measurements: time, kind, topic, content."""
    raw = b"".join([c if isinstance(c, bytes) else _FLOAT.pack(c) for c in content])
    return t_ns, kind, topic, blake2b(raw, digest_size=8).digest()


def of_reading(
    reading: Reading, z: "Measurement | Callable[[Origin | None], Measurement | None]", content: tuple[float | bytes, ...],
    half_widths: Sequence[float], rules: Rules | None = None, delay_s: float = 0.0, **more: Any,
) -> Aid:  # fmt: skip
    """A sensor's reading as z, ordered by its content; rules: those of its kind; more: other fields of Aid."""
    t_ns, rules = reading.t_ns - round(delay_s * 1e9), rules or RULES[reading.kind]
    return Aid(
        t_ns=t_ns,
        arrived_ns=reading.arrived_ns,
        topic=reading.topic,
        kind=reading.kind,
        order=order(t_ns, reading.kind, reading.topic, *content),
        rules=rules,
        absolute=False,
        log_false=log_false(rules, half_widths),
        measurement=z if callable(z) else lambda _: z,
        **more,
    )


def _no_reading(_: object) -> "Measurement | None":
    return None


def asked(t_ns: int, topic: str, half_widths: Sequence[float], slow: "tuple[SlowError, ...]") -> Aid:
    """A measurement from the IMU samples before t_ns, without a reading."""
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
