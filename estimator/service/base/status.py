"""The daemon's state: latencies, rates, drops."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np

from estimator.service.base.clock import SECOND_NS
from logs.wire import schemas
from logs.wire.codec import Encoded
from logs.wire.schemas import STORE
from models.messages import AidStatus, Estimate, Health, ImuSample, Input, Mode, Output, Reason, Tick, Unusable

TOPIC: Final = "/landfix/daemon"
_PERIOD_NS: Final = SECOND_NS
_RECENT: Final = 4096  # estimates whose latency is remembered
_OK, _WARN, _ERROR = 0, 1, 2
_SILENT_NS: Final = 3 * SECOND_NS  # without an estimate, or a known reason for none: the estimator has failed
_NO_ESTIMATE: Final = "no estimate, and no known reason for it: the estimator has failed"


class Status:
    """Counts what passes; parts: further reports by name."""

    def __init__(self, began_ns: int, parts: Mapping[str, Callable[[], Mapping[str, Any]]]) -> None:
        self._began_ns, self._parts = began_ns, parts
        self._next_ns = self._reported_ns = began_ns
        self._counts: dict[str, int] = {}  # by topic, since the last report
        self._totals: dict[str, int] = {}
        self._latency_ns: deque[tuple[int, int]] = deque(maxlen=_RECENT)  # since validity, since arrival
        self._defects, self._defect = 0, ""
        self.implausible = 0  # messages whose stamps are of no known clock
        self._health: Health | None = None
        self._sane_ns = self._imu_ns = began_ns  # last estimate, or known reason for none; last IMU sample
        self._values: dict[str, str] = {}

    @property
    def health(self) -> Health | None:
        """The newest."""
        return self._health

    def note(self, message: Input, outputs: Sequence[Output], now_ns: int) -> None:
        """Count one handled input and its outputs."""
        topic = message.topic
        self._counts[topic] = self._counts.get(topic, 0) + 1
        if isinstance(message, ImuSample):
            self._imu_ns = now_ns
        if self._explains(message, outputs):
            self._sane_ns = now_ns
        if isinstance(message, Unusable):
            self._totals["unusable"] = self._totals.get("unusable", 0) + 1
        for output in outputs:
            if isinstance(output, Estimate):
                if not isinstance(message, Tick):
                    self._latency_ns.append((now_ns - output.t_ns, now_ns - output.arrived_ns))
            elif isinstance(output, Health):
                self._health = output
            elif isinstance(output, AidStatus):
                reason = f"{output.topic} {output.reason}"
                self._totals[reason] = self._totals.get(reason, 0) + 1

    def works(self, now_ns: int) -> bool:
        """Estimates come out, or the reason for none is known."""
        return now_ns - self._sane_ns <= _SILENT_NS or now_ns - self._imu_ns > _SILENT_NS

    def _explains(self, message: Input, outputs: Sequence[Output]) -> bool:
        for output in outputs:
            if isinstance(output, AidStatus) and output.reason is Reason.INTERNAL:
                return False
            if isinstance(output, Estimate) or (isinstance(message, ImuSample) and isinstance(output, AidStatus | Health)):
                return True
        waits = self._health is not None and self._health.mode in {Mode.STARTING, Mode.ALIGNING}
        return waits and isinstance(message, ImuSample)

    def note_defect(self, detail: str) -> None:
        """Note an internal error."""
        self._defects, self._defect = self._defects + 1, detail

    def report(self, now_ns: int) -> Encoded | None:
        """Report of the last second, if it is over."""
        if now_ns < self._next_ns:
            return None
        period_s = max(1e-9 * (now_ns - self._reported_ns), 1e-3)
        self._reported_ns, self._next_ns = now_ns, now_ns + _PERIOD_NS
        values: dict[str, Any] = {"uptime_s": f"{(now_ns - self._began_ns) * 1e-9:.0f}"}
        values |= {f"rate_hz {topic}": f"{n / period_s:.1f}" for topic, n in sorted(self._counts.items())}
        values["implausible_stamps"] = self.implausible
        if not self.works(now_ns):
            values["estimator"] = _NO_ESTIMATE
        if self._defects:
            values |= {"internal_errors": self._defects, "internal_error": self._defect}
        values |= self._latencies()
        for name, part in self._parts.items():
            values |= {f"{name} {key}": value for key, value in part().items()}
        self._counts = dict.fromkeys(self._counts, 0)
        self._values = {key: str(value) for key, value in values.items()}
        return _diagnostics(now_ns, self._values)

    def json(self) -> bytes:
        """Newest report, newest health, counts since the start."""
        totals = dict(sorted(self._totals.items()))
        return msgspec.json.encode({"daemon": self._values, "counts": totals, "health": self._health})

    def _latencies(self) -> dict[str, str]:
        if not self._latency_ns:
            return {}
        ms = np.array(self._latency_ns) * 1e-6
        named = {"latency_ms": ms[:, 0], "handling_ms": ms[:, 1]}
        return {
            f"{name} {kind}": f"{value:.2f}"
            for name, column in named.items()
            for kind, value in zip(("p50", "p99", "max"), np.percentile(column, [50, 99, 100]), strict=True)
        }


def _troubles(values: Mapping[str, str]) -> Iterator[str]:
    if "estimator" in values:
        yield values["estimator"]
    if values.get("log state", "recording") not in {"recording", "off"}:
        yield f"log {values['log state']}"
    if values.get("state file", "kept") != "kept":
        yield f"state file: {values['state file']}"
    if values.get("log removed_files", "0") != "0":
        yield f"{values['log removed_files']} log files were removed while they were written"
    if any(key.endswith("lost_inputs") and value != "0" for key, value in values.items()):
        flooded = ", ".join(key.removeprefix("inbox dropped ") for key in values if key.startswith("inbox dropped "))
        yield f"inputs are lost: more came than can be handled of {flooded}" if flooded else "inputs are lost"
    if "internal_error" in values:
        yield f"internal error: {values['internal_error']}"


def _diagnostics(t_ns: int, values: Mapping[str, str]) -> Encoded:
    types = STORE.types
    make: Any = types["diagnostic_msgs/msg/KeyValue"]
    pairs = [make(key=key, value=value) for key, value in values.items()]
    troubles = ", ".join(_troubles(values))
    status: Any = types["diagnostic_msgs/msg/DiagnosticStatus"]
    header: Any = types[schemas.HEADER]
    stamp: Any = types["builtin_interfaces/msg/Time"]
    array: Any = types[schemas.DIAGNOSTICS]
    level = _ERROR if "estimator" in values else _WARN if troubles else _OK
    entry = status(level=level, name="landfix daemon", message=troubles or "running", hardware_id="", values=pairs)
    sec, nanosec = divmod(t_ns, SECOND_NS)
    message = array(header=header(stamp=stamp(sec=sec, nanosec=nanosec), frame_id=""), status=[entry])
    return Encoded(TOPIC, schemas.DIAGNOSTICS, bytes(STORE.serialize_cdr(message, schemas.DIAGNOSTICS, little_endian=True)))
