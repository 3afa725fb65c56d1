"""One flight of benchmarks.service.fuzz, driven as the daemon drives its messages, and what must not happen in it."""

import re
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from benchmarks.service.fuzz_messages import BEGIN_NS, SECOND, Datagram, flight
from benchmarks.service.vehicle import ORIGIN
from estimator.config import parse
from estimator.filter.alignment import Decision
from estimator.filter.history import Entry, History
from estimator.fusion import Fusion
from estimator.publish import Publisher
from estimator.service.autopilot.output_policy import OutputPolicy
from estimator.service.base.clock import Clock
from estimator.service.mavlink.io import Heard
from estimator.service.mavlink.link import MavlinkLink
from estimator.service.warm_up import warm_up
from estimator.sources.base.aid import Refusal
from logs.wire.codec import Encoded, encode_input
from models import state
from models.messages import AidStatus, Estimate, Input, Output, Reason

CONFIG: Final = f"""
[map]
origin = {[*ORIGIN.lla]}
[inputs]
baro = "/baro"
attitude = "/attitude"
[mavlink]
endpoint = "udpout:127.0.0.1:9"
attitude_sigma_deg = [1.0, 3.0]
"""
_WITHOUT_MAP: Final = CONFIG.replace(f"[map]\norigin = {[*ORIGIN.lla]}\n", "")
_WIRE_NS: Final = 2**31 * SECOND  # no stamp from the wire is beyond
_SLOW_S: Final = 0.5  # of processor time, for one message
_REDUCE_S: Final = 20.0
_ENDED: Final = "the estimate has ended"
_kinds_reduced: set[str] = set()  # by this process
_warmed: list[bool] = []


class Finding(msgspec.Struct, frozen=True):
    """What must not happen; reproduction: what to do to see it."""

    what: str
    count: int
    detail: str
    reproduction: str


class FlightResult(msgspec.Struct, frozen=True):
    """Of one flight; reasons: "kind reason" -> decisions."""

    messages: int
    spoiled: int
    reasons: dict[str, int]
    slowest_ms: float
    findings: list[Finding]


class _Watched(Fusion):
    """Fusion with an eye on the exceptions that it survives."""

    error: str = ""

    def _refuse(self, message: Input, refusal: Refusal) -> AidStatus:
        if refusal.reason is Reason.INTERNAL:
            self.error = _place_of(sys.exception())
        return super()._refuse(message, refusal)


def _tell_places() -> None:
    """What History survives says where it arose, too."""
    decide = History._decide

    def noting(self: History, entry: Entry, decision: Decision) -> None:
        place = f" ({_place_of(sys.exception())})" if decision.reason is Reason.INTERNAL else ""
        decide(self, entry, decision._replace(detail=decision.detail + place))

    History._decide = noting  # type: ignore[method-assign]


_tell_places()


class _Line:
    """An Endpoint that gives what it is given."""

    whole, state = True, "open"

    def __init__(self) -> None:
        self.heard: list[Heard] = []
        self.sent = 0

    def receive(self, timeout_s: float) -> Heard | None:  # noqa: ARG002  (an Endpoint may wait)
        return self.heard.pop() if self.heard else None

    def send(self, data: bytes, receiver: Any) -> bool:  # noqa: ARG002  (nobody is there)
        self.sent += len(data)
        return True

    def close(self) -> None:
        pass


class _Flight:
    """The daemon's parts without its threads: everything that one message goes through."""

    def __init__(self, text: str) -> None:
        config = parse(text)
        self.now_ns = BEGIN_NS
        self.fusion, self.decoder, self.publisher = _Watched(config.fusion()), config.decoder(), Publisher(config.output)
        clock = Clock(0, wall=lambda: self.now_ns, steady=lambda: self.now_ns)
        policy = OutputPolicy(config.autopilot)
        self.link = MavlinkLink(config.mavlink, Path(), config.inputs, clock, policy, config.autopilot.odometry_hz, 47.5)
        self.link.close()
        self.line = _Line()
        self.link._endpoint, self.link._stopping = self.line, False
        self.handed: list[Input] = []  # to Fusion
        self.reasons: Counter[str] = Counter()
        self.wrong: Counter[str] = Counter()
        self.first: dict[str, tuple[int, str]] = {}  # what -> how much was handed before, what was said
        self.estimated_ns: int | None = None

    def take(self, what: Input | Encoded | Datagram) -> None:
        """One message."""
        try:
            match what:
                case Datagram(data, sender):
                    self.line.heard.append(Heard(data, sender))
                    self.link._turn(self)
                case Encoded(topic, schema, data):
                    message = self.decoder.decode(topic, schema, data, self.now_ns)
                    if message is not None:
                        self._handle(message)
                case _:
                    self._handle(what)
        except Exception as error:
            shown = what.data.hex() if isinstance(what, Datagram | Encoded) else repr(what)
            self.note(_place_of(error), f"{error}; message: {str(what)[:60]} {shown[:3000]}")

    def put(self, message: Input) -> None:
        """Of an Inbox."""
        self.take(encode_input(message))

    def put_bytes(self, topic: str, schema: str, data: bytes) -> None:
        """Likewise."""
        self.take(Encoded(topic, schema, data))

    def note(self, what: str, detail: str) -> None:
        """Something that must not happen."""
        self.wrong[what] += 1
        self.first.setdefault(what, (len(self.handed), detail))

    def _handle(self, message: Input) -> None:
        self.handed.append(message)
        outputs = [o for o in self.fusion.handle(message) if abs(o.t_ns) < _WIRE_NS]
        encoded = list(self.publisher.encoded(outputs))
        self.link.send(outputs, encoded)
        for output in outputs:
            self._look_at(output)

    def _look_at(self, output: Output) -> None:
        if isinstance(output, AidStatus):
            self.reasons[f"{output.kind} {output.reason}"] += 1
            if output.reason is Reason.INTERNAL:
                inner = re.search(r"\((\w+ at [^)]*)\)$", output.detail)
                self.note(self.fusion.error or (inner[1] if inner else output.detail), output.detail)
                self.fusion.error = ""
        elif isinstance(output, Estimate):
            self.estimated_ns = self.now_ns
            if not state.sound(output.nav, output.covariance):
                self.note("an estimate that is not sound", f"{output}")


def fly(seed: int, number: int) -> FlightResult:
    """One flight and what was found in it."""
    warnings.simplefilter("ignore")  # of numpy, about numbers that are none
    if not _warmed:
        warm_up()
        _warmed.append(True)
    rng = np.random.default_rng((seed, number))
    text = CONFIG if rng.random() < 0.8 else _WITHOUT_MAP
    sent = flight(rng, mavlink_too=number % 3 == 2)
    flown = _Flight(text)
    slowest_s, early_ns = 0.0, BEGIN_NS
    for message in sent:
        flown.now_ns = message.arrived_ns
        before_s = time.thread_time()
        flown.take(message.what)
        took_s = time.thread_time() - before_s
        slowest_s = max(slowest_s, took_s)
        if took_s > _SLOW_S:
            flown.note("a message that takes more than half a second", f"{took_s:.1f} s: {str(message.what)[:300]}")
        if flown.estimated_ns is not None and message.arrived_ns < sent[-1].arrived_ns - 2 * SECOND:
            early_ns = flown.estimated_ns
    if early_ns > BEGIN_NS and flown.now_ns - (flown.estimated_ns or 0) > SECOND // 2:
        flown.note(_ENDED, f"last at {((flown.estimated_ns or 0) - BEGIN_NS) * 1e-9:.2f} s")
    findings = [_finding(flown, what, text, seed, number, reduce=k == 0) for k, what in enumerate(flown.wrong)]
    return FlightResult(len(sent), sum(s.spoiled for s in sent), dict(flown.reasons), round(1e3 * slowest_s, 1), findings)


# --- reproductions ----------------------------------------------------------------------------------------------------------


def _finding(flown: _Flight, what: str, text: str, seed: int, number: int, *, reduce: bool) -> Finding:
    """reduce: it is the first of its flight, no consequence of another."""
    count, detail = flown.first[what]
    again = f"python -c 'from benchmarks.service.fuzz_flight import fly; print(fly({seed}, {number}).findings)'"
    if reduce and what not in _kinds_reduced and what != _ENDED:
        _kinds_reduced.add(what)
        left = _reduced(flown.handed[:count], lambda inputs: what in _errors_of(inputs, text))
        config = "" if text is CONFIG else " without [map]"
        shown = "\n".join(f"    {message}"[:1500] for message in left if not _is_plain(message))
        plain = Counter(type(m).__name__ for m in left if _is_plain(m))
        again += f"\nreduced from {count} to {len(left)} messages{config}: plain ones {dict(plain)}, and\n{shown}"
    return Finding(what, flown.wrong[what], detail, again)


def _errors_of(inputs: Sequence[Input], text: str) -> set[str]:
    flown = _Flight(text)
    for message in inputs:
        flown.now_ns = message.arrived_ns
        flown.take(message)
        if flown.wrong:
            break
    return set(flown.wrong)


def _reduced(inputs: list[Input], fails: Callable[[list[Input]], bool]) -> list[Input]:
    """Fewer messages that fail the same way (delta debugging: Zeller and Hildebrandt 2002), as far as the time goes."""
    end_s, size = time.monotonic() + _REDUCE_S, len(inputs) // 2
    while size:
        begin = 0
        while begin < len(inputs) and time.monotonic() < end_s:
            fewer = inputs[:begin] + inputs[begin + size :]
            if fails(fewer):
                inputs = fewer
            else:
                begin += size
        size //= 2
    return inputs


def _is_plain(message: Input) -> bool:
    """Of the flight, and too many to be shown."""
    return type(message).__name__ in {"ImuSample", "Tick"} and BEGIN_NS <= message.t_ns <= message.arrived_ns


def _place_of(error: BaseException | None) -> str:
    """The exception's type and where in our code it arose: one kind, one name."""
    if error is None:
        return ""
    frames: Iterator[traceback.FrameSummary] = reversed(traceback.extract_tb(error.__traceback__))
    ours = next((f for f in frames if re.search(r"/(estimator|logs|models)/", f.filename)), None)
    where = f"{'/'.join(Path(ours.filename).parts[-2:])}:{ours.lineno} {ours.name}" if ours else "elsewhere"
    return f"{type(error).__name__} at {where}"
