"""Flights with spoiled messages, driven as the daemon drives them.

What must not happen: an exception anywhere, a decision "internal", an estimate that is not sound, one that ends although the IMU
goes on, a message that takes more than half a second.
"""

import re
import sys
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from benchmarks.attacks.cell import Row
from benchmarks.attacks.spoiled import BEGIN_NS, SECOND, Datagram, flight, per_flight
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

AREA: Final = "spoiled messages"
SEEDS: Final = range(1, 5)
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
_ENDED: Final = "the estimate has ended"
_warmed: list[bool] = []


class Flown(NamedTuple):
    """One flight: messages, spoiled ones, decisions by "kind reason", slowest message, what must not happen."""

    messages: int
    spoiled: int
    reasons: Counter[str]
    slowest_s: float
    findings: list[str]


def rows(_: Path, count: int, wanted: Callable[[str, str], bool]) -> Iterator[Row]:
    """One a seed: what became of a share of 100 times so many messages."""
    flights = -(-100 * count // per_flight() // len(SEEDS))
    for seed in SEEDS:
        name = f"{flights} flights of seed {seed}"
        if not wanted(AREA, name):
            continue
        flown = [fly(seed, number) for number in range(flights)]
        reasons = sum((f.reasons for f in flown), Counter[str]())
        found = list(dict.fromkeys(finding for f in flown for finding in f.findings))
        said = f"{sum(f.messages for f in flown)} messages, {sum(f.spoiled for f in flown)} spoiled; "
        said += ", ".join(f"{n} {reason}" for reason, n in sorted(reasons.items()))
        slowest_s = round(max(f.slowest_s for f in flown), 3)
        yield Row(AREA, name, "failed" if found else "held", "; ".join(found[:20]), 0, slowest_s, said)


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
        self.handed = 0  # messages to Fusion
        self.reasons: Counter[str] = Counter()
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
        self.first.setdefault(what, (self.handed, detail))

    def _handle(self, message: Input) -> None:
        self.handed += 1
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


def fly(seed: int, number: int) -> Flown:
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
    again = f"benchmarks.attacks.flown.fly({seed}, {number})"
    findings = [f"{what}: {detail[:300]} ({again}, after {count} messages)" for what, (count, detail) in flown.first.items()]
    return Flown(len(sent), sum(s.spoiled for s in sent), flown.reasons, slowest_s, findings)


def _place_of(error: BaseException | None) -> str:
    """The exception's type and where in our code it arose: one kind, one name."""
    if error is None:
        return ""
    frames: Iterator[traceback.FrameSummary] = reversed(traceback.extract_tb(error.__traceback__))
    ours = next((f for f in frames if re.search(r"/(estimator|logs|models)/", f.filename)), None)
    where = f"{'/'.join(Path(ours.filename).parts[-2:])}:{ours.lineno} {ours.name}" if ours else "elsewhere"
    return f"{type(error).__name__} at {where}"
