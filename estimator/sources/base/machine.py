"""The state machine of a source.

    stopped --(first measurement)--> starting --(probation passed)--> active --(silence, or a fault)--> stopped

Part of the checkpoint; reads times of validity only.
"""

import math
from enum import StrEnum

import msgspec
from msgspec.structs import replace

from estimator.sources.base.faults import RECENT_S
from estimator.sources.base.gating import cusum
from estimator.sources.base.learnt_noise import LearntNoise
from estimator.sources.base.rules import Rules
from models.messages import Array

_NEVER = -(2**62)
_LEAST_SPACING_S, _DOUBLED = 0.1, 3  # how often the time that a refuted sensor has to agree doubles
CUSUM_SLACK, _CUSUM_LIMIT = 1.0, 10.0  # sigma: bias of the innovations that is tolerated; the sum at which a source is rejected
_REFUTED_SLACK = 0.5  # bias that is tolerated where a refuted sensor has to agree


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
    failed_ns: int = _NEVER  # first gate that failed since the last reading that was fused
    is_refuted: bool = False  # gates failed for longer than hold_s, while positions confirmed the estimate
    refutations: int = 0  # by positions
    spoofed_ns: int = _NEVER  # last reading whose receiver reported spoofing
    false_share: float = 0.0  # of its last reading
    spread_m: tuple[float, float] = (math.inf, 0.0)  # of odometry: smallest and largest sigma of late, fading since last_ns
    noise: LearntNoise = LearntNoise()  # of odometry

    def arrive(self, rules: Rules, t_ns: int, *, alone: bool) -> "SourceState":
        """A measurement arrives; alone: no other absolute source is active.

        Alone, a refuted sensor stays stopped.
        """
        phase, passed, sums = self.phase, self.passed, self.sums
        if alone and self.is_refuted:
            phase = Phase.STOPPED
        elif t_ns > self.silent_ns or (phase is Phase.STOPPED and t_ns >= self.held_until_ns):
            phase, passed, sums = Phase.STARTING, 0, ()
        again = math.ceil(self.agrees_s / max(rules.spacing_s, _LEAST_SPACING_S)) if self.is_refuted else 0
        probation = max(rules.probation, again)
        if phase is Phase.STARTING and (passed >= probation or (alone and t_ns >= self.held_until_ns)):
            phase = Phase.ACTIVE
        until_ns, share = t_ns + round(rules.timeout_s * 1e9), rules.false_share
        return replace(self, phase=phase, last_ns=t_ns, silent_ns=until_ns, passed=passed, sums=sums, false_share=share)

    def phase_at(self, t_ns: int) -> Phase:
        """Phase at t_ns without newer readings."""
        return Phase.STOPPED if t_ns > self.silent_ns else self.phase

    def held(self, rules: Rules, t_ns: int, *, alone: bool = True) -> "SourceState":
        """A reading failed."""
        hold_ns, since_ns = round(rules.hold_s * 1e9), max(self.failed_ns, 0) or t_ns
        is_refuted = self.is_refuted or (not alone and 0 < hold_ns < t_ns - since_ns)
        return replace(self, phase=Phase.STOPPED, held_until_ns=t_ns + hold_ns, failed_ns=since_ns, is_refuted=is_refuted)

    def refuted(self, t_ns: int) -> "SourceState":
        """Positions show that it is wrong."""
        again = self.refutations + 1
        return replace(self, phase=Phase.STOPPED, held_until_ns=t_ns, passed=0, sums=(), is_refuted=True, refutations=again)

    @property
    def agrees_s(self) -> float:
        """So long a refuted sensor has to agree: 10 s, then 20, 40 and 80."""
        return RECENT_S * 2.0 ** min(max(self.refutations - 1, 0), _DOUBLED)

    def spoofed(self, rules: Rules, t_ns: int) -> "SourceState":
        """The receiver reports spoofing: held off, then on probation."""
        state = self.arrive(rules, t_ns, alone=False)
        return replace(
            state, phase=Phase.STOPPED, held_until_ns=t_ns + round(rules.hold_s * 1e9), passed=0, sums=(), spoofed_ns=t_ns
        )

    def judge(self, rules: Rules, t_ns: int, *, alone: bool, passed: bool, fused: bool, nu: Array, sigma: Array) -> "SourceState":
        """The measurement passed its gate or not.

        A drift is the source's only where there is an independent source.
        """
        state = replace(self, fused_ns=t_ns, failed_ns=_NEVER, is_refuted=False) if fused else self
        if state.phase is Phase.STARTING:
            sums = cusum(state.sums, nu, sigma, _REFUTED_SLACK) if state.is_refuted else ()
            agrees = passed and max(sums, default=0.0) <= _CUSUM_LIMIT
            return replace(state, passed=state.passed + 1, sums=sums) if agrees else replace(state, passed=0, sums=())
        if rules.hold_s > 0 and fused and not alone:
            sums = cusum(state.sums, nu, sigma, CUSUM_SLACK)
            found_out = max(sums) > _CUSUM_LIMIT
            if state.phase is Phase.ACTIVE and found_out:
                return replace(state, phase=Phase.STOPPED, held_until_ns=t_ns + int(rules.hold_s * 1e9), sums=())
            return replace(state, sums=sums)
        return state
