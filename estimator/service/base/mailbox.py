"""Messages for the loop: a bounded queue per topic, so that a flood delays only itself.

    next = the oldest message of lines that are not crowded, else of all

Dropped and counted: what does not fit, and repetitions in a crowded line.
"""

import queue
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

from estimator.service.base.clock import Clock
from estimator.service.base.ports import Arrival, Log
from logs.wire.codec import Encoded, ImuMounting, encode_input
from models.messages import Input

_LEAST: Final = 4096  # bytes that each message counts in addition to its own: handling an empty one takes as long as any
_CROWDED: Final = 512 * _LEAST  # more than a second of a fast IMU
_FULL: Final = 4096 * _LEAST  # ten seconds of it, half a second to handle


class _Line:
    """Lock-free: links count in, the loop counts out."""

    def __init__(self) -> None:
        self.waiting: deque[Arrival] = deque()
        self.put_bytes = self.got_bytes = self.dropped = 0
        self.last = b""  # the last message, whether it waits or was dropped

    @property
    def load(self) -> int:
        return self.put_bytes - self.got_bytes


class Mailbox:
    """An Inbox; images go straight to log and vision."""

    def __init__(self, clock: Clock, log: Log, images: Sequence[str], mounting: ImuMounting) -> None:
        self._clock, self._log, self._images, self._mounting = clock, log, frozenset(images), mounting
        self.see: Callable[[Arrival], None] = _look_away
        self._lines: dict[str, _Line] = {}  # replaced, not changed: the loop reads it meanwhile
        self._putting = threading.Lock()
        self._bell: queue.SimpleQueue[None] = queue.SimpleQueue()  # one item for each message put
        self._own: queue.SimpleQueue[Encoded] = queue.SimpleQueue()

    def put_bytes(self, topic: str, schema: str, data: bytes) -> None:
        """A message on the wire's own bytes."""
        if topic in self._images:
            arrival = Arrival(topic, schema, data, self._clock.now_ns())
            self._log.put_image(arrival)
            self.see(arrival)
        else:
            self._enqueue(topic, schema, data)

    def put(self, message: Input) -> None:
        """Put a measurement without CDR."""
        self._enqueue(*encode_input(message, self._mounting))

    def put_own(self, message: Encoded) -> None:
        """Put requests and answers of our vision, for get_own()."""
        self._own.put(message)

    def get(self, timeout_s: float) -> Arrival | None:
        """The next message; None on time-out or wake()."""
        try:
            self._bell.get(timeout=timeout_s)
        except queue.Empty:
            return None
        lines = [line for line in self._lines.values() if line.waiting]
        if not lines:
            return None
        line = lines[0] if len(lines) == 1 else min(lines, key=_turn)
        arrival = line.waiting.popleft()
        line.got_bytes += _LEAST + len(arrival.data)
        return arrival

    def get_own(self) -> Arrival | None:
        """The next message of our vision, or None."""
        try:
            return Arrival(*self._own.get_nowait(), self._clock.now_ns(), own=True)
        except queue.Empty:
            return None

    def wake(self) -> None:
        """Let get() return at once; safe in a signal handler."""
        self._bell.put(None)

    def report(self) -> dict[str, int]:
        """lost_inputs: came faster than handled; dropped: by topic."""
        dropped = {topic: line.dropped for topic, line in sorted(self._lines.items()) if line.dropped}
        by_topic = {f"dropped {topic}": count for topic, count in dropped.items()}
        return {"waiting": len(self), "lost_inputs": sum(dropped.values())} | by_topic

    def __len__(self) -> int:
        return self._bell.qsize() + self._own.qsize()

    def _enqueue(self, topic: str, schema: str, data: bytes) -> None:
        with self._putting:
            line = self._line(topic)
            repeated, line.last = data == line.last, data
            if line.load >= _FULL or (repeated and line.load > _CROWDED):
                line.dropped += 1
                return
            line.put_bytes += _LEAST + len(data)
            line.waiting.append(Arrival(topic, schema, data, self._clock.now_ns()))
        self._bell.put(None)

    def _line(self, topic: str) -> _Line:
        line = self._lines.get(topic)
        if line is None:
            line = _Line()
            self._lines = self._lines | {topic: line}
        return line


def _turn(line: _Line) -> tuple[bool, int]:
    return line.load > _CROWDED, line.waiting[0].arrived_ns


def _look_away(_: Arrival) -> None:
    """No vision."""
