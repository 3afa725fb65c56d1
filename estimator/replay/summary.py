"""Counts of a run, for the printed summary and its JSON."""

from collections import Counter
from math import isfinite

import msgspec

from estimator.replay.no_estimate import advice, too_slow
from logs.evaluation.evaluate import ALL_SOURCES, is_absolute, outages_between
from logs.findings import Finding, Watch
from models.messages import (
    AidStatus,
    Estimate,
    GnssFix,
    Health,
    ImuSample,
    Input,
    LandmarkFix,
    Mode,
    Output,
    PoseFix,
    Reason,
    Reset,
    Vec3,
)

_LONGEST_STEP_NS = 1_000_000_000  # a longer gap between estimates is silence, not time in a mode


class ReplaySummary(msgspec.Struct, frozen=True):
    """What happened; fixes: topic -> reason -> measurements (last decisions)."""

    records: int
    imu_samples: int
    estimates: int
    duration_s: float  # log time
    elapsed_s: float  # wall time
    speed: float  # multiple of real time
    fixes: dict[str, dict[str, int]]
    modes_s: dict[str, float]  # seconds of estimates in each mode
    longest_without_absolute_s: float  # the longest outage, as `landfix evaluate` defines it; 0: none
    worst_radius95_m: float | None  # horizontal, since alignment; None: there is no estimate
    resets: int
    internal_errors: int
    torn: bool
    skipped_chunks: int = 0
    missing: str = ""  # parts of the flight that were not there: the estimate is not the one that was flown
    first_estimate_s: float | None = None  # log time before it; None: there is no estimate
    waited_for: str = ""  # what was last said to keep it from an estimate
    advice: str = ""  # why there is no estimate and what to do; empty where there is one
    remark: str = ""  # why there is one for less than half of the time, where that is known
    torn_parts: list[str] = []  # files that lack their proper end: read up to their last whole record
    findings: list[Finding] = []  # the streams at fault, the most likely cause first


class SummaryBuilder:
    """Counts records, inputs, outputs; watch: for findings."""

    def __init__(self, origin: Vec3 | None = None, *, watch: bool = True) -> None:
        self.records = 0
        self._watch = Watch(origin) if watch else None
        self._imu = self._positions = self._estimates = self._resets = self._internal = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self._previous_ns: int | None = None
        self._modes_ns: Counter[Mode] = Counter()
        self._estimate_ns = 0  # the first
        self._worst_radius_m: float | None = None
        self._began_s: float | None = None
        self._waited_for = ""
        self._details: dict[str, str] = {}
        self._decisions: dict[tuple[str, str, int, int], Reason] = {}

    def record(self, log_time_ns: int) -> None:
        """One record of the log."""
        self.records += 1
        if self._first_ns is None:
            self._first_ns = log_time_ns
        self._last_ns = max(self._last_ns, log_time_ns)

    def step(self, message: Input, outputs: list[Output]) -> None:
        """Count one input and its outputs."""
        if self._watch:
            self._watch.add(message)
        if isinstance(message, ImuSample):
            self._imu += 1
        elif isinstance(message, GnssFix | PoseFix | LandmarkFix):
            self._positions += 1
        for output in outputs:
            if isinstance(output, Estimate):
                self._estimate(output)
            elif isinstance(output, AidStatus):
                self._decisions[output.topic, output.kind, output.t_ns, output.arrived_ns] = output.reason
                self._internal += output.reason is Reason.INTERNAL
                if output.detail:
                    self._details[output.topic] = output.detail
            elif isinstance(output, Health):
                self._health(output)
            elif isinstance(output, Reset):
                self._resets += 1

    def _estimate(self, estimate: Estimate) -> None:
        self._estimates += 1
        if self._began_s is None:
            self._began_s, self._estimate_ns = self._duration_s, estimate.t_ns
        if self._previous_ns is not None and 0 < estimate.t_ns - self._previous_ns <= _LONGEST_STEP_NS:
            self._modes_ns[estimate.mode] += estimate.t_ns - self._previous_ns
        self._previous_ns = estimate.t_ns

    def _health(self, health: Health) -> None:
        if isfinite(health.radius95_m):
            self._worst_radius_m = max(self._worst_radius_m or 0.0, health.radius95_m)
        elif health.detail:
            self._waited_for = health.detail

    @property
    def _duration_s(self) -> float:
        return 0.0 if self._first_ns is None else (self._last_ns - self._first_ns) * 1e-9

    def _longest_outage_s(self) -> float:
        if self._previous_ns is None:
            return 0.0
        seen: dict[str, list[tuple[int, int]]] = {}
        for (topic, kind, t_ns, arrived_ns), reason in self._decisions.items():
            if is_absolute(kind, reason, t_ns, self._estimate_ns):
                seen.setdefault(topic, []).append((t_ns, arrived_ns))
        spans = outages_between(seen or {ALL_SOURCES: []}, self._estimate_ns, self._previous_ns)[ALL_SOURCES].spans
        return max((end - start for start, end in spans), default=0) * 1e-9

    def findings(self) -> list[Finding]:
        """The streams at fault so far."""
        return self._watch.findings() if self._watch else []

    def summary(self, elapsed_s: float, torn: list[str], skipped_chunks: int, missing: str, kind: str) -> ReplaySummary:
        """The summary at the end; kind: importer, or empty."""
        fixes: dict[str, Counter[str]] = {}
        for (topic, *_), reason in self._decisions.items():
            fixes.setdefault(topic, Counter())[reason.value] += 1
        why = ""
        if not self._estimates:
            why = advice(kind, self._imu, self._positions, self._duration_s, fixes, self._details, self._waited_for)
        covered_s, since_s = sum(self._modes_ns.values()) * 1e-9, self._duration_s - (self._began_s or 0.0)
        slow = too_slow(kind, self._imu, self._duration_s) if self._estimates and covered_s < 0.5 * since_s else ""
        return ReplaySummary(
            records=self.records,
            imu_samples=self._imu,
            estimates=self._estimates,
            duration_s=self._duration_s,
            elapsed_s=elapsed_s,
            speed=self._duration_s / elapsed_s if elapsed_s > 0 else 0.0,
            fixes={topic: dict(reasons) for topic, reasons in sorted(fixes.items())},
            modes_s={mode.value: ns * 1e-9 for mode, ns in self._modes_ns.items()},
            longest_without_absolute_s=self._longest_outage_s(),
            worst_radius95_m=self._worst_radius_m,
            resets=self._resets,
            internal_errors=self._internal,
            torn=bool(torn),
            skipped_chunks=skipped_chunks,
            missing=missing,
            first_estimate_s=self._began_s,
            waited_for=self._waited_for,
            torn_parts=torn,
            findings=self.findings(),
            advice=why,
            remark=f"an estimate for {covered_s:.1f} of {since_s:.1f} s: {slow}" if slow else "",
        )
