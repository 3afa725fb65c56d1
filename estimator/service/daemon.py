"""The loop: messages through Fusion.handle, outputs to links and log.

Fusion gets the logged bytes: a replay is equal to the bit.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from estimator.frontend.requests import Track
from estimator.fusion import Fusion
from estimator.publish import Publisher
from estimator.service.base.clock import SECOND_NS, Clock, Stamps
from estimator.service.base.mailbox import Mailbox
from estimator.service.base.ports import Arrival, Log, Outbox
from estimator.service.base.status import Status
from logs.wire.codec import Decoder, Encoded, encode_input
from logs.wire.stamps import restamped, stamp_of
from models.messages import Estimate, ImuSample, Input, Output, Tick

_ASLEEP_NS: Final = SECOND_NS // 2  # the process itself was stopped, if its tick is so late
REFUSED_PREFIX: Final = "/landfix/refused"  # of the topics of messages whose stamps are of no known clock
_GRACE_S: Final = 0.1  # to read what has piled up meanwhile
_PATIENCE_NS: Final = SECOND_NS  # without an estimate by the IMU: the tick then no longer waits for the messages before it
_NEVER: Final = 2**63
_TICK_NS: Final = SECOND_NS // 20  # between two looks whether the IMU is silent


class ServiceConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[service]: the daemon's life."""

    state_file: Annotated[
        str, Meta(description="where the last state is kept for a restart; relative to [log] folder; '': not")
    ] = "landfix.state"
    warm_restart_s: Annotated[float, Meta(ge=0, le=50, description="s: an older state is not gone on from")] = 10.0


class Daemon:
    """alive(): with estimates or a known reason for none; watchers: with every output."""

    def __init__(
        self,
        *,
        fusion: Fusion,
        decoder: Decoder,
        publisher: Publisher,
        mailbox: Mailbox,
        outboxes: Sequence[Outbox],
        log: Log,
        stamps: Stamps,
        clock: Clock,
        status: Status,
        track: Track,
        alive: Callable[[], None],
        watchers: Sequence[Callable[[Output], None]],
    ) -> None:
        self._fusion, self._decoder, self._publisher = fusion, decoder, publisher
        self.mailbox, self._outboxes, self._log = mailbox, outboxes, log
        self._stamps, self._clock, self._status, self._alive, self._watchers = stamps, clock, status, alive, watchers
        self._track = track
        self._stopping = False
        self._patient_ns = _NEVER  # until then a tick waits for all messages before it; set by the first estimate

    def stop(self) -> None:
        """Let run() return after the current message; signal-safe."""
        self._stopping = True
        self.mailbox.wake()

    def run(self) -> None:
        """Until stop()."""
        next_tick_ns = self._clock.now_ns() + _TICK_NS
        while not self._stopping:
            wait_ns = next_tick_ns - self._clock.now_ns()
            if wait_ns > 0:
                arrival = self.mailbox.get(wait_ns * 1e-9)
                if arrival is not None:
                    self._survive(self.take, arrival)
                continue
            if -wait_ns > _ASLEEP_NS:
                next_tick_ns = self._clock.now_ns() + round(_GRACE_S * SECOND_NS)
                self._patient_ns = max(self._patient_ns, next_tick_ns + _PATIENCE_NS)
                continue
            self._survive(self._tick)
            next_tick_ns += _TICK_NS

    def _survive(self, step: Callable[..., None], *given: Arrival) -> None:
        try:
            step(*given)
        except Exception as error:
            self._status.note_defect(f"{type(error).__name__}: {error}")

    def take(self, arrival: Arrival) -> None:
        """Take one message; behind an IMU sample also answers of vision."""
        if isinstance(self._handle(arrival), ImuSample):
            self._take_own()
        if not len(self.mailbox):
            self._fusion.catch_up()

    def _take_own(self) -> None:
        while arrival := self.mailbox.get_own():
            self._handle(arrival)

    def _handle(self, arrival: Arrival) -> Input | None:
        if arrival.own:
            for outbox in self._outboxes:
                outbox.send((), [Encoded(arrival.topic, arrival.schema, arrival.data)])
        else:
            arrival = self._on_our_clock(arrival)
        self._log.put_input(arrival)
        topic, schema, data, arrived_ns, _ = arrival
        message = self._decoder.decode(topic, schema, data, arrived_ns)
        if message is None:
            return None
        outputs = self._fusion.handle(message)
        self._track.note(outputs)
        encoded = list(self._publisher.encoded(outputs)) if outputs else []
        if outputs:
            for outbox in self._outboxes:
                outbox.send(outputs, encoded)
        now_ns = self._clock.now_ns()
        self._status.note(message, outputs, now_ns)
        for output in outputs:
            if isinstance(output, Estimate) and isinstance(message, ImuSample):
                self._patient_ns = now_ns + _PATIENCE_NS
            for watcher in self._watchers:
                watcher(output)
        for message_out in encoded:
            self._log.put_output(message_out, arrived_ns)
        return message

    def _on_our_clock(self, arrival: Arrival) -> Arrival:
        topic, _, data, arrived_ns, _ = arrival
        stamp_ns = stamp_of(data)
        if stamp_ns is None:
            return arrival
        t_ns = self._stamps.validity_ns(topic, stamp_ns, arrived_ns)
        if t_ns is None:
            self._status.implausible += 1
            return arrival._replace(topic=REFUSED_PREFIX + topic)
        return arrival if t_ns == stamp_ns else arrival._replace(data=restamped(data, t_ns))

    def _tick(self) -> None:
        self._take_own()  # no IMU sample may come for it
        now_ns = self._clock.now_ns()
        if self._status.works(now_ns):
            self._alive()
        if not len(self.mailbox) or now_ns > self._patient_ns:
            self.take(Arrival(*encode_input(Tick(now_ns, now_ns)), now_ns))
        if report := self._status.report(now_ns):
            for outbox in self._outboxes:
                outbox.send((), [report])
            self._log.put_output(report, now_ns)
