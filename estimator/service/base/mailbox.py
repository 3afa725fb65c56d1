"""The Inbox of ports.py: any thread puts, the loop gets, in the order of arrival.

So much of each topic may wait, and no more: what comes beyond is dropped and counted by topic. A topic that floods the daemon
fills its own share, and every other topic waits behind that share at most. The order of arrival stays one queue, so the log holds
what the loop handles, in its order.
"""

import queue
import threading
from collections.abc import Callable, Sequence
from typing import Final

from estimator.service.base.clock import Clock
from estimator.service.base.ports import Arrival, Log
from logs.wire.codec import Encoded, ImuMounting, encode_input
from models.messages import ImuSample, Input

_MOST: Final = 1000  # messages of one topic that wait for the loop: 0.1 s of its work
_MOST_IMU: Final = 8000  # of an IMU: 20 s of one at 400 Hz
_MOST_BYTES: Final = 16_000_000  # of one topic


class _Share:
    """What of one topic waits. put is counted by whoever puts, under a lock; got by the loop."""

    __slots__ = ("dropped", "got", "got_bytes", "most", "put", "put_bytes")

    def __init__(self, most: int) -> None:
        self.most = most
        self.put = self.put_bytes = self.got = self.got_bytes = self.dropped = 0

    def takes(self) -> bool:
        """Whether one more may wait; counted as dropped where it may not."""
        takes = self.put - self.got < self.most and self.put_bytes - self.got_bytes < _MOST_BYTES
        self.dropped += not takes
        return takes


class Mailbox:
    """Images go straight to the log, and to vision where it is used; imu: topics of IMUs, of which more may wait."""

    def __init__(self, clock: Clock, log: Log, images: Sequence[str], imu: Sequence[str], mounting: ImuMounting) -> None:
        self._clock, self._log, self._images, self._mounting = clock, log, frozenset(images), mounting
        self.see: Callable[[Arrival], None] = _look_away
        self._queue: queue.SimpleQueue[Arrival | None] = queue.SimpleQueue()
        self._own: queue.SimpleQueue[Encoded] = queue.SimpleQueue()
        self._putting = threading.Lock()
        self._shares = {topic: _Share(_MOST_IMU) for topic in imu}

    def put_bytes(self, topic: str, schema: str, data: bytes) -> None:
        """A message on the wire's own bytes."""
        if topic in self._images:
            arrival = Arrival(topic, schema, data, self._clock.now_ns())
            self._log.put_image(arrival)
            self.see(arrival)
            return
        with self._putting:
            if (share := self._share(topic, _MOST)).takes():
                self._enqueue(share, Arrival(topic, schema, data, self._clock.now_ns()))

    def put(self, message: Input) -> None:
        """A measurement of a link that speaks no CDR."""
        with self._putting:
            if (share := self._share(message.topic, _MOST_IMU if isinstance(message, ImuSample) else _MOST)).takes():
                self._enqueue(share, Arrival(*encode_input(message, self._mounting), self._clock.now_ns()))

    def put_own(self, message: Encoded) -> None:
        """What our own vision was asked and answers: kept until get_own()."""
        self._own.put(message)

    def get(self, timeout_s: float) -> Arrival | None:
        """The next message; None when there is none in time, or after wake()."""
        try:
            arrival = self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if arrival is not None:
            share = self._shares[arrival.topic]
            share.got += 1
            share.got_bytes += len(arrival.data)
        return arrival

    def get_own(self) -> Arrival | None:
        """The next message of our own vision, which arrives now; None when there is none."""
        try:
            return Arrival(*self._own.get_nowait(), self._clock.now_ns(), own=True)
        except queue.Empty:
            return None

    def wake(self) -> None:
        """Let get() return at once; safe in a signal handler."""
        self._queue.put(None)

    def report(self) -> dict[str, int]:
        """For the status. lost_inputs: what came faster than it could be handled; dropped: the same by topic."""
        dropped = {topic: share.dropped for topic, share in list(self._shares.items()) if share.dropped}
        by_topic = {f"dropped {topic}": count for topic, count in sorted(dropped.items())}
        return {"waiting": len(self), "lost_inputs": sum(dropped.values())} | by_topic

    def __len__(self) -> int:
        return self._queue.qsize() + self._own.qsize()

    def _share(self, topic: str, most: int) -> _Share:
        """Of a topic; a link passes on only the topics of the configuration, so there are few."""
        share = self._shares.get(topic)
        if share is None:
            share = self._shares[topic] = _Share(most)
        return share

    def _enqueue(self, share: _Share, arrival: Arrival) -> None:
        share.put += 1
        share.put_bytes += len(arrival.data)
        self._queue.put(arrival)


def _look_away(_: Arrival) -> None:
    """There is no vision."""
