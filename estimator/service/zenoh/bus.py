"""The Zenoh link: rmw_zenoh, optionally zenoh-bridge-ros2dds; callbacks only enqueue, congestion drops."""

import contextlib
import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import zenoh

from estimator.service.base.clock import Clock
from estimator.service.base.ports import Inbox
from estimator.service.base.status import TOPIC as DAEMON_TOPIC
from estimator.service.zenoh import keys
from estimator.service.zenoh.config import ZenohConfig, first_sentence, session_config
from logs.wire import schemas
from logs.wire.codec import Encoded, type_hash
from logs.wire.receiver import ReceiverFlags
from models.messages import Output

OUTPUTS: Final = {
    "/landfix/odometry": schemas.ODOMETRY,
    "/landfix/pose": schemas.POSE,
    "/tf": schemas.TF,
    "/landfix/global": schemas.NAV_SAT_FIX,
    "/landfix/aid_status": schemas.AID_STATUS,
    "/landfix/health": schemas.DIAGNOSTICS,
    "/landfix/reset": schemas.RESET,
    "/landfix/integrity": schemas.INTEGRITY,
    DAEMON_TOPIC: schemas.DIAGNOSTICS,
}
_DIAGNOSTICS: Final = "/diagnostics"  # ROS's topic for all DiagnosticArrays, by option
_FAST: Final = frozenset({"/landfix/odometry"})  # sent at once, not gathered into batches
_GID_BYTES: Final = 16
_KB, _MB = 1_000, 1_000_000
_MOST_DOMAINS: Final = 10  # named
_QUERIES: Final = "landfix/"  # of the queryables: landfix/status, landfix/config, ...


class BusError(Exception):
    """Zenoh cannot be used; one line for the user."""


class _Sender:
    def __init__(self, session: zenoh.Session, config: ZenohConfig, topic: str, schema: str) -> None:
        fast = topic in _FAST
        options: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.DROP,
            "priority": zenoh.Priority.REAL_TIME if fast else zenoh.Priority.DATA,
            "express": fast,
        }
        hashed, zid, live = type_hash(schema), str(session.zid()), session.liveliness()
        self.last: bytes | None = None
        self._gid, self._sequence = secrets.token_bytes(_GID_BYTES), 0
        self._rmw = self._plain = None
        self._kept: list[Any] = []  # tokens and queryables live as long as they are referred to
        if config.rmw:
            key = keys.rmw_key(config.domain, topic, schema, hashed)
            self._rmw = session.declare_publisher(key, **options)
            entity = self._rmw.id.eid
            token = keys.publisher_token(config.domain, zid, config.node, entity, topic, schema, hashed)
            self._kept += [live.declare_token(token), session.declare_queryable(key, self._answer)]
        if config.ros2dds:
            key = keys.plain_key(topic)
            self._plain = session.declare_publisher(key, **options)
            self._kept += [
                live.declare_token(keys.bridge_token(zid, topic, schema, hashed)),
                session.declare_queryable(key, self._answer),
            ]

    def put(self, data: bytes, now_ns: int) -> None:
        self.last = data
        if self._rmw is not None:
            self._sequence += 1
            self._rmw.put(data, attachment=keys.attachment(self._sequence, now_ns, self._gid))
        if self._plain is not None:
            self._plain.put(data)

    def watched(self) -> bool:
        return any(p is not None and p.matching_status.matching for p in (self._rmw, self._plain))  # type: ignore[attr-defined]

    def _answer(self, query: zenoh.Query) -> None:
        with query:
            if self.last is not None:
                query.reply(query.key_expr, self.last)


class ZenohScreen:
    """A Screen: one topic, sent by its own thread."""

    def __init__(self, session: zenoh.Session, config: ZenohConfig, clock: Clock, topic: str, schema: str) -> None:
        self._sender, self._clock = _Sender(session, config, topic, schema), clock

    def watched(self) -> bool:
        """Whether somebody subscribes."""
        with contextlib.suppress(zenoh.ZError):
            return self._sender.watched()
        return False

    def show(self, image: Encoded) -> None:
        """Send it."""
        with contextlib.suppress(zenoh.ZError):
            self._sender.put(image.data, self._clock.now_ns())


class ZenohBus:
    """An Outbox of ports.py that feeds an Inbox. Raises BusError, ConfigError."""

    def __init__(self, config: ZenohConfig, folder: Path, clock: Clock, inputs: Mapping[str, str], images: Sequence[str]) -> None:
        self._config, self._clock, self._images = config, clock, frozenset(images)
        self._topics = list(inputs.items()) + [(i, s) for i in images for s in (schemas.COMPRESSED_IMAGE, schemas.IMAGE)]
        self._kept: list[Any] = []
        self._flags = ReceiverFlags([topic for topic, schema in inputs.items() if schema == schemas.NAV_SAT_FIX])
        self.oversized = self.unsent = self.received = 0
        made = session_config(config, folder, self._keys(inputs, images), self._output_keys())
        try:
            self.session = zenoh.open(made)
        except zenoh.ZError as error:
            raise BusError(f"[zenoh]: cannot be opened: {first_sentence(error)}") from None
        self._senders = {topic: _Sender(self.session, config, topic, schema) for topic, schema in OUTPUTS.items()}

    def watch_domains(self, topics: Sequence[str], say: Callable[[str], None]) -> None:
        """Report once each foreign domain that publishes a topic."""
        if not self._config.rmw:
            return
        seen = {-1, ours := self._config.domain}
        live = self.session.liveliness()

        def notice(topic: str, token: str) -> None:
            domain = keys.domain_of(token)
            if domain not in seen and len(seen) < _MOST_DOMAINS:
                seen.add(domain)
                say(
                    f"{topic} is published on ROS domain {domain}, landfix reads domain {ours}: set [zenoh] domain = {domain} "
                    "if it is this vehicle's"
                )

        for topic in topics:
            receive = partial(lambda topic, sample: notice(topic, str(sample.key_expr)), topic)
            self._kept.append(live.declare_subscriber(keys.publisher_tokens(topic), receive, history=True))

    def watch_publishers(self, notice: Callable[[str, str], None]) -> None:
        """Report topic and type of whatever others publish on our domain."""

        def receive(sample: zenoh.Sample) -> None:
            if (found := keys.published_of(str(sample.key_expr))) and sample.kind == zenoh.SampleKind.PUT:
                notice(*found)

        tokens = keys.every_publisher(self._config.domain)
        self._kept.append(self.session.liveliness().declare_subscriber(tokens, receive, history=True))

    def open_inputs(self, inbox: Inbox) -> None:
        """Subscribe; from now on the inbox fills."""
        zid, live = str(self.session.zid()), self.session.liveliness()
        if self._config.rmw:
            self._kept.append(live.declare_token(keys.node_token(self._config.domain, zid, self._config.node)))
        for topic, schema in self._topics:
            receive = self._receiver(inbox, topic, schema)
            for key in self._subscribed(topic, schema):
                subscriber = self.session.declare_subscriber(key, receive, allowed_origin=zenoh.Locality.REMOTE)
                self._kept.append(subscriber)
                if self._config.rmw and key != keys.plain_key(topic):
                    token = keys.subscriber_token(
                        self._config.domain, zid, self._config.node, subscriber.id.eid, topic, schema, type_hash(schema)
                    )
                    self._kept.append(live.declare_token(token))

        for topic, schema in self._flags.topics.items():
            hear = self._flag_receiver(topic)
            self._kept += [self.session.declare_subscriber(key, hear) for key in self._subscribed(topic, schema)]

    def screen(self, topic: str, schema: str) -> ZenohScreen:
        """A screen for images on a topic."""
        return ZenohScreen(self.session, self._config, self._clock, topic, schema)

    def serve(self, name: str, content: Callable[[], bytes | None], media_type: str) -> None:
        """Answer queries for landfix/<name>; None: no content."""

        def answer(query: zenoh.Query) -> None:
            with query:
                data = content()
                if data is None:
                    query.reply_err(f"{name}: not configured")
                else:
                    query.reply(query.key_expr, data, encoding=media_type)

        self._kept.append(self.session.declare_queryable(_QUERIES + name, answer))

    def send(self, outputs: Sequence[Output], encoded: Sequence[Encoded]) -> None:  # noqa: ARG002  (an Outbox is given both)
        """Put due messages on the bus."""
        for topic, schema, data in self._with_diagnostics(encoded):
            try:
                sender = self._senders.get(topic)
                if sender is None:
                    sender = self._senders[topic] = _Sender(self.session, self._config, topic, schema)
                sender.put(data, self._clock.now_ns())
            except zenoh.ZError:
                self.unsent += 1

    def _with_diagnostics(self, encoded: Sequence[Encoded]) -> Iterator[Encoded]:
        for message in encoded:
            yield message
            if self._config.diagnostics and message.schema == schemas.DIAGNOSTICS:
                yield message._replace(topic=_DIAGNOSTICS)

    def close(self) -> None:
        """Leave the network."""
        with contextlib.suppress(zenoh.ZError):
            self.session.close()  # type: ignore[no-untyped-call]

    def report(self) -> dict[str, Any]:
        """For the status."""
        return {
            "links": len(self.session.info.transports()),
            "received": self.received,
            "oversized": self.oversized,
            "unsent": self.unsent,
        }

    def _receiver(self, inbox: Inbox, topic: str, schema: str) -> Callable[[zenoh.Sample], None]:
        limit = self._config.largest_image_mb * _MB if topic in self._images else self._config.largest_kb * _KB

        def receive(sample: zenoh.Sample) -> None:
            payload = sample.payload
            if len(payload) > limit:
                self.oversized += 1
                return
            self.received += 1
            data = payload.to_bytes()
            is_fix = schema == schemas.NAV_SAT_FIX
            inbox.put_bytes(topic, schema, self._flags.marked(topic, data, self._clock.now_ns()) if is_fix else data)

        return receive

    def _flag_receiver(self, topic: str) -> Callable[[zenoh.Sample], None]:
        def hear(sample: zenoh.Sample) -> None:
            if len(sample.payload) <= self._config.largest_kb * _KB:
                self._flags.hear(topic, sample.payload.to_bytes(), self._clock.now_ns())

        return hear

    def _subscribed(self, topic: str, schema: str) -> list[str]:
        """Images on a plain key are taken as compressed."""
        plain = self._config.ros2dds and schema != schemas.IMAGE
        return [keys.rmw_key(self._config.domain, topic, schema)] * self._config.rmw + [keys.plain_key(topic)] * plain

    def _keys(self, inputs: Mapping[str, str], images: Sequence[str]) -> list[str]:
        topics = [*inputs, *images, *self._flags.topics]
        px4 = f"{self._config.domain}/fmu/out/**"
        return [px4, *(f"{self._config.domain}/{t.strip('/')}/**" for t in topics), *(keys.plain_key(t) for t in topics)]

    def _output_keys(self) -> list[str]:
        domain = self._config.domain
        common = ["diagnostics", f"{domain}/diagnostics/**"] if self._config.diagnostics else []
        return [
            "landfix/**",
            f"{domain}/landfix/**",
            "tf",
            f"{domain}/tf/**",
            "tf_static",
            f"{domain}/tf_static/**",
            f"{domain}/fmu/in/**",
            *common,
        ]
