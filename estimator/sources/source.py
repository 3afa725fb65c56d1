"""What all aiding sources share: the rules they are judged by, the measurement they deliver, and their state machine.

    stopped --(first measurement)--> starting --(probation passed)--> active --(silence, or a fault)--> stopped

The machine is a value in the tracker's checkpoint and reads times of validity only, so a replayed past is judged the same.
"""

import math
import struct
from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import cache
from hashlib import blake2b
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from msgspec.structs import replace
from numba import njit

from estimator.sources.gating import cusum
from models.frames import Origin
from models.measurements import Measurement
from models.messages import Array, Reading, Reason

_NEVER = -(2**62)
_FLOAT = struct.Struct("=d")
CUSUM_SLACK, _CUSUM_LIMIT = 1.0, 10.0  # sigma: bias of the innovations that is tolerated; the sum at which a source is rejected


class GateRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a source is judged."""

    gate_probability: Annotated[
        float, Meta(gt=0.5, lt=1, description="share of good measurements that pass the chi-square gate")
    ] = 0.9999
    timeout_s: Annotated[float, Meta(ge=1e-3, le=1e6, description="s: silent for longer, the source has stopped")] = 5.0
    false_share: Annotated[float, Meta(ge=1e-9, lt=1, description="share of measurements expected to be false")] = 0.05
    probation: Annotated[
        int,
        Meta(
            ge=0,
            le=1_000_000,
            description="measurements that must pass before a (returning) source is fused together with another one",
        ),
    ] = 0
    hold_s: Annotated[float, Meta(ge=0, le=1e6, description="s: how long a rejected source is held off; 0: never")] = 0.0


class SourceRules(GateRules, frozen=True, forbid_unknown_fields=True):
    """How a source is judged whose readings may be false for a while, and so compete as hypotheses."""

    spacing_s: Annotated[
        float, Meta(ge=0, le=3600, description="s: errors of readings closer than this are the same; only one of them is fused")
    ] = 0.0


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
    rules: GateRules
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
    def hypothetical(self) -> SourceRules:
        """The rules of a source whose readings compete as hypotheses, which all are but odometry."""
        assert isinstance(self.rules, SourceRules)
        return self.rules

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


class SensorRules(SourceRules, frozen=True, forbid_unknown_fields=True):
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


def log_false(rules: GateRules, half_widths: Sequence[float]) -> float:
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


def asked(t_ns: int, topic: str, rules: SourceRules, half_widths: Sequence[float], slow: "tuple[SlowError, ...]") -> Aid:
    """What the IMU itself shows at t_ns, with no reading of a sensor: the samples before it give the measurement."""
    return Aid(
        t_ns=t_ns,
        arrived_ns=t_ns,
        topic=topic,
        kind=topic,
        order=order(t_ns, topic, topic),
        rules=rules,
        absolute=False,
        log_false=log_false(rules, half_widths),
        measurement=_no_reading,
        slow_errors=slow,
        weighs=False,
    )


def with_default(cov: Array, sigmas: Sequence[float] | Array) -> tuple[Array, bool]:
    """The covariance (k, k) with sigma_i^2 where nothing is known of component i, and whether there was such a component.

    Nothing is known where the whole row and column are 0: half of the drivers say "unknown" so (ROS COVARIANCE_TYPE_UNKNOWN,
    ArduPilot's GPA, PX4's eph, MAVLink's h_acc of 0), and nobody measures without error.
    """
    if cov.shape != (len(sigmas), len(sigmas)) or cov.diagonal().all():  # nearly every call
        return cov, False
    unknown = ~(cov.any(axis=0) | cov.any(axis=1))
    return cov + np.diag(np.where(unknown, np.square(sigmas), 0.0)), bool(unknown.any())


_FLAWS = {
    1: Refusal(Reason.NOT_FINITE, "covariance"),
    2: Refusal(Reason.NOT_PSD, "a variance is not positive"),
    3: Refusal(Reason.NOT_PSD, "covariance is not symmetric"),
    4: Refusal(Reason.NOT_PSD, "covariance is not positive definite"),
}
_ASYMMETRY, _SMALLEST_PIVOT = 1e-6, 1e-12  # of the correlation matrix


def covariance_refusal(cov: Array, size: int | None = None) -> Refusal | None:
    """Why `cov` (k, k) is no covariance: not finite, asymmetric or not positive definite; None where it is one.

    size: the k that is wanted, where it is not known yet that the array has it.
    """
    if size is not None and cov.shape != (size, size):
        return Refusal(Reason.MALFORMED, f"covariance: {size} x {size} is expected")
    return _FLAWS.get(_flaw(np.ascontiguousarray(cov)))


@njit(cache=True)
def _flaw(cov: Array) -> int:
    """The first flaw of a covariance, a key of _FLAWS, or 0: Cholesky of the correlation matrix."""
    n = cov.shape[0]
    for i in range(n):
        for j in range(n):
            if not math.isfinite(cov[i, j]):
                return 1
    for i in range(n):
        if not cov[i, i] > 0.0:
            return 2
    low = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            scale = math.sqrt(cov[i, i]) * math.sqrt(cov[j, j])
            if abs(cov[i, j] - cov[j, i]) > _ASYMMETRY * scale:
                return 3
            total = cov[i, j] / scale
            for k in range(j):
                total -= low[i, k] * low[j, k]
            if i == j:
                if total < _SMALLEST_PIVOT:
                    return 4
                low[i, i] = math.sqrt(total)
            else:
                low[i, j] = total / low[j, j]
    return 0


class Phase(StrEnum):
    """How far a source is trusted."""

    STOPPED = "stopped"
    STARTING = "starting"
    ACTIVE = "active"


class SourceState(msgspec.Struct, frozen=True):
    """The machine of one source."""

    phase: Phase = Phase.STOPPED
    last_ns: int = _NEVER  # newest measurement
    silent_ns: int = _NEVER  # so long without another, and the source has stopped
    fused_ns: int = _NEVER
    passed: int = 0  # in a row, while starting
    held_until_ns: int = _NEVER
    sums: tuple[float, ...] = ()
    drift_m_s: float = 0.0  # of odometry that has contradicted the IMU with nobody to decide: by so much it may be wrong
    failed_ns: int = _NEVER  # first gate that failed since the last reading that was fused
    is_refuted: bool = False  # gates failed for longer than hold_s, while positions confirmed the estimate
    spread_m: tuple[float, float] = (math.inf, 0.0)  # of odometry: smallest and largest sigma of late, fading since last_ns

    def arrive(self, rules: GateRules, t_ns: int, *, alone: bool) -> "SourceState":
        """A measurement of t_ns comes in; alone: no other absolute source is active, so there is no independent source.

        Alone, a sensor that has been refuted stays stopped: the estimate's covariance grows, until anything passes the gate.
        """
        phase, passed, sums = self.phase, self.passed, self.sums
        if alone and self.is_refuted:
            phase = Phase.STOPPED
        elif t_ns > self.silent_ns or (phase is Phase.STOPPED and t_ns >= self.held_until_ns):
            phase, passed, sums = Phase.STARTING, 0, ()
        if phase is Phase.STARTING and (passed >= rules.probation or (alone and t_ns >= self.held_until_ns)):
            phase = Phase.ACTIVE
        silent_ns = t_ns + round(rules.timeout_s * 1e9)
        return SourceState(
            phase,
            t_ns,
            silent_ns,
            self.fused_ns,
            passed,
            self.held_until_ns,
            sums,
            failed_ns=self.failed_ns,
            is_refuted=self.is_refuted,
        )

    def phase_at(self, t_ns: int) -> Phase:
        """How far the source is trusted at t_ns, with nothing newer from it than this state knows of."""
        return Phase.STOPPED if t_ns > self.silent_ns else self.phase

    def held(self, rules: GateRules, t_ns: int, *, alone: bool = True) -> "SourceState":
        """A reading failed: one that passes soon after does so by chance, of a sensor that is stuck or late."""
        hold_ns, since_ns = round(rules.hold_s * 1e9), max(self.failed_ns, 0) or t_ns
        is_refuted = self.is_refuted or (not alone and 0 < hold_ns < t_ns - since_ns)
        return replace(self, phase=Phase.STOPPED, held_until_ns=t_ns + hold_ns, failed_ns=since_ns, is_refuted=is_refuted)

    def judge(
        self, rules: GateRules, t_ns: int, *, alone: bool, passed: bool, fused: bool, nu: Array, sigma: Array
    ) -> "SourceState":
        """The measurement passed its gate or not, was fused or not.

        A drift is the source's only where an independent source agrees with the filter: alone, the filter may be what drifts.
        """
        state = replace(self, fused_ns=t_ns, failed_ns=_NEVER, is_refuted=False) if fused else self
        if state.phase is Phase.STARTING:
            return replace(state, passed=state.passed + 1 if passed else 0)
        if rules.hold_s > 0 and fused and not alone:
            sums = cusum(state.sums, nu, sigma, CUSUM_SLACK)
            found_out = max(sums) > _CUSUM_LIMIT
            if state.phase is Phase.ACTIVE and found_out:
                return replace(state, phase=Phase.STOPPED, held_until_ns=t_ns + int(rules.hold_s * 1e9), sums=())
            return replace(state, sums=sums)
        return state
