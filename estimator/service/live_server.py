"""Foxglove WebSocket server of a log or a running daemon, same CDR bytes. Needs landfix[live]."""

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from estimator.service.zenoh.keys import rmw_key
from logs.store.reader import LogReader
from logs.wire.codec import Encoded
from logs.wire.markers import TOPIC as LANDMARKS_TOPIC
from logs.wire.schemas import is_known, schema_text

_KEPT: Final = frozenset({LANDMARKS_TOPIC})  # published rarely: who comes late gets the last
_LONGEST_WAIT_S: Final = 1.0
_PROGRESS_EVERY: Final = 500


class LiveError(Exception):
    """No server; one line."""


class LiveServer:
    """A context manager; put() from any thread. Raises LiveError."""

    def __init__(self, host: str, port: int) -> None:
        try:
            import foxglove  # noqa: PLC0415  (an extra)
        except ImportError:
            raise LiveError("landfix live needs Foxglove's SDK: pip install 'landfix[live]'") from None
        self._foxglove, self._context = foxglove, foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._last: dict[str, tuple[bytes, int]] = {}
        self._lock = threading.Lock()
        try:
            self._server = foxglove.start_server(
                name="landfix", host=host, port=port, context=self._context, server_listener=_Welcome(self._repeat),
                capabilities=[foxglove.Capability.Time],
            )  # fmt: skip
        except RuntimeError as error:
            raise LiveError(f"{host}:{port}: cannot listen there ({' '.join(str(error).split())})") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._server.stop()

    @property
    def port(self) -> int:
        """Listening port."""
        return int(self._server.port)

    @property
    def watched(self) -> bool:
        """Whether anybody has subscribed to anything."""
        return any(channel.has_sinks() for channel in tuple(self._channels.values()))

    def offer(self, topics: Mapping[str, str]) -> None:
        """Announce topics, topic -> type."""
        for topic, schema in topics.items():
            if topic not in self._channels and is_known(schema):
                definition = self._foxglove.Schema(name=schema, encoding="ros2msg", data=schema_text(schema).encode())
                self._channels[topic] = self._foxglove.Channel(
                    topic, schema=definition, message_encoding="cdr", context=self._context
                )

    def put(self, message: Encoded, t_ns: int) -> None:
        """Send a message of t_ns."""
        self.offer({message.topic: message.schema})
        channel = self._channels.get(message.topic)
        if channel is not None:
            if message.topic in _KEPT:
                self._last[message.topic] = message.data, t_ns
            channel.log(message.data, log_time=t_ns)

    def tell_time(self, t_ns: int) -> None:
        """Send the time to viewers."""
        self._server.broadcast_time(t_ns)

    def _repeat(self, topic: str) -> None:
        if topic in self._last:
            data, t_ns = self._last[topic]
            self._channels[topic].log(data, log_time=t_ns)


class _Welcome:
    def __init__(self, subscribed: Callable[[str], None]) -> None:
        self._subscribed = subscribed

    def on_subscribe(self, client: object, channel: object) -> None:  # noqa: ARG002  (the protocol's arguments)
        self._subscribed(channel.topic)  # type: ignore[attr-defined]


def topics_of(log: Path, progress: Callable[[float], None] = lambda _: None) -> dict[str, str]:
    """Topic -> type of a log."""
    found: dict[str, str] = {}
    with LogReader(log) as reader:
        for count, record in enumerate(reader):
            found[record.topic] = record.schema
            if count % _PROGRESS_EVERY == 0:
                progress(reader.fraction)
    return found


def play(server: LiveServer, log: Path, speed: float, progress: Callable[[float], None] = lambda _: None) -> int:
    """Play a log; number of messages. Silence is cut to a second."""
    due_s, last_ns, count = time.monotonic(), None, 0
    with LogReader(log) as reader:
        for count, record in enumerate(reader, 1):
            t_ns = record.log_time_ns
            due_s += min(_LONGEST_WAIT_S, max(0, t_ns - (last_ns or t_ns)) * 1e-9 / speed)
            last_ns = t_ns
            time.sleep(max(0.0, due_s - time.monotonic()))
            server.tell_time(t_ns)
            server.put(Encoded(record.topic, record.schema, record.data), t_ns)
            if count % _PROGRESS_EVERY == 0:
                progress(reader.fraction)
    return count


def relay(server: LiveServer, session: Any, domain: int, topics: Mapping[str, str]) -> list[Any]:
    """A daemon's publications to the server; keep the subscribers."""
    server.offer(topics)

    def forward(topic: str, schema: str) -> Callable[[Any], None]:
        def hear(sample: Any) -> None:
            now_ns = time.time_ns()
            server.tell_time(now_ns)
            server.put(Encoded(topic, schema, sample.payload.to_bytes()), now_ns)

        return hear

    return [session.declare_subscriber(rmw_key(domain, t, s), forward(t, s)) for t, s in topics.items()]
