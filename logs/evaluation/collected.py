"""Contents of a log for its evaluation, in one pass."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from logs.evaluation.metrics import Mask, Times
from logs.evaluation.trajectory import POSE_TYPES, Trajectory, decode, decode_geodetic, from_rows
from logs.store.reader import Attachment, LogError, LogReader, Record
from logs.store.recorder import REFERENCE_ATTACHMENT
from logs.wire import schemas
from logs.wire.codec import INTEGRITY_TOPIC, decode_aid_status, decode_diagnostics, decode_integrity
from logs.wire.stamps import stamp_of
from models.frames import Origin
from models.messages import AidStatus, Array, Integrity, Reason, Vec3

ODOMETRY_TOPIC: Final = "/landfix/odometry"
TRUTH_TOPIC: Final = "/truth"
_AID_TOPIC, _HEALTH_TOPIC = "/landfix/aid_status", "/landfix/health"
_RESET_TOPIC, _GLOBAL_TOPIC = "/landfix/reset", "/landfix/global"
_FIX_TYPES: Final = (schemas.POSE_FIX, schemas.LANDMARK_FIX, schemas.NAV_SAT_FIX)
_PROGRESS_EVERY: Final = 5000  # records

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class HealthPoint:
    """Mode, and seconds since an absolute position was fused."""

    t_ns: int
    mode: str
    absolute_age_s: float


@dataclass(frozen=True, slots=True)
class Jump:
    """A Reset in map axes."""

    t_ns: int
    counter: int
    delta_p: Vec3
    delta_v: Vec3
    delta_theta: Vec3


@dataclass(frozen=True, slots=True)
class Fixes:
    """Positions (n, 3) m in map of one topic, and which were used."""

    t_ns: Times
    p: Array
    used: Mask


@dataclass(frozen=True, slots=True)
class Collected:
    """The evaluated part of a log.

    aids: last decision on each measurement; reference: kind of a truth that is the autopilot's estimate; unreadable: malformed
    messages; every: thinning of `estimates`.
    """

    estimate: Trajectory
    truth: Trajectory
    aids: tuple[AidStatus, ...]
    health: tuple[HealthPoint, ...]
    resets: tuple[Jump, ...]
    fixes: dict[str, Fixes]
    torn: bool
    unreadable: int
    origin: Origin | None
    every: int
    estimates: int
    attachments: tuple[Attachment, ...]
    metadata: dict[str, dict[str, str]]
    skipped_chunks: int
    reference: str = ""
    integrity: tuple[Integrity, ...] = ()

    @property
    def yardstick(self) -> str:
        """Reference of the comparison, in a word."""
        return "reference" if self.reference else "truth"


class NoEstimateError(LogError):
    """A processed log without an estimate; aids: last decisions."""

    def __init__(self, words: str, aids: tuple[AidStatus, ...], attachments: tuple[Attachment, ...], *, torn: bool) -> None:
        super().__init__(words)
        self.aids, self.attachments, self.torn = aids, attachments, torn


class _Sheaf:
    __slots__ = ("_most", "arrived_ns", "data", "every", "schema", "seen", "unreadable")

    def __init__(self, schema: str, most: int | None = None) -> None:
        self.schema = schema
        self.data: list[bytes] = []
        self.arrived_ns: list[int] = []
        self.unreadable = 0
        self.every, self.seen, self._most = 1, 0, most

    def add(self, data: bytes, arrived_ns: int) -> None:
        if self.seen % self.every == 0:
            self.data.append(data)
            self.arrived_ns.append(arrived_ns)
        self.seen += 1
        if self._most is not None and len(self.data) > self._most:
            self.every *= 2
            del self.data[1::2], self.arrived_ns[1::2]

    def parsed(self, parse: Callable[[bytes], T]) -> Iterator[tuple[int, T]]:
        self.unreadable = 0
        for arrived_ns, data in zip(self.arrived_ns, self.data, strict=True):
            try:
                yield arrived_ns, parse(data)
            except Exception:  # whatever bytes from outside trip over
                self.unreadable += 1

    def messages(self) -> Iterator[tuple[int, Any]]:
        return self.parsed(lambda data: schemas.STORE.deserialize_cdr(data, self.schema))


class Collector:
    """Keeps messages for an evaluation.

    truth_topic: reference; most: estimates and truths kept.
    """

    def __init__(self, truth_topic: str = TRUTH_TOPIC, most: int | None = None) -> None:
        self._truth_topic, self._most = truth_topic, most
        self._own = {ODOMETRY_TOPIC, _AID_TOPIC, _HEALTH_TOPIC, _RESET_TOPIC, _GLOBAL_TOPIC, INTEGRITY_TOPIC, truth_topic}
        self._sheaves: dict[str, _Sheaf] = {}

    def add(self, topic: str, schema: str, data: bytes, log_time_ns: int) -> None:
        """The next message."""
        if topic in self._own or schema in _FIX_TYPES:
            sheaf = self._sheaves.get(topic)
            if sheaf is None:
                most = self._most if topic in {ODOMETRY_TOPIC, self._truth_topic} else None
                sheaf = self._sheaves[topic] = _Sheaf(schema, most)
            sheaf.add(data, log_time_ns)

    def collected(
        self,
        path: Path,
        attachments: tuple[Attachment, ...] = (),
        metadata: dict[str, dict[str, str]] | None = None,
        skipped_chunks: int = 0,
        *,
        torn: bool = False,
    ) -> Collected:
        """The result; path and the rest: of the log. Raises LogError."""
        sheaves = self._sheaves
        aids = _aids(self._of(_AID_TOPIC))
        if ODOMETRY_TOPIC not in sheaves:
            if sheaves.keys() & {_AID_TOPIC, _HEALTH_TOPIC}:
                words = f"{path}: the estimator made no estimate of it: {_waited_for(self._of(_HEALTH_TOPIC))}"
                raise NoEstimateError(words, aids, attachments, torn=torn)
            lacks = f"holds no {ODOMETRY_TOPIC}{' before it is cut off' if torn else ''}"
            raise LogError(f"{path}: {lacks}; make an estimate first: landfix replay {path} -o estimate.mcap")
        estimate = _estimate(path, sheaves[ODOMETRY_TOPIC])
        origin = _origin(estimate, self._of(_GLOBAL_TOPIC))
        return Collected(
            estimate=estimate,
            truth=_truth(path, self._truth_topic, sheaves.get(self._truth_topic), origin),
            aids=aids,
            health=_health(self._of(_HEALTH_TOPIC)),
            resets=_resets(self._of(_RESET_TOPIC)),
            fixes=_fixes({t: s for t, s in sheaves.items() if t not in self._own and s.schema in _FIX_TYPES}, aids, origin),
            torn=torn,
            unreadable=sum(sheaf.unreadable for sheaf in sheaves.values()),
            origin=origin,
            every=sheaves[ODOMETRY_TOPIC].every,
            estimates=len(estimate) if sheaves[ODOMETRY_TOPIC].every == 1 else sheaves[ODOMETRY_TOPIC].seen,
            attachments=attachments,
            metadata=metadata or {},
            skipped_chunks=skipped_chunks,
            reference=_reference(attachments) if self._truth_topic == TRUTH_TOPIC else "",
            integrity=tuple(i for _, i in self._of(INTEGRITY_TOPIC).parsed(decode_integrity)),
        )

    def _of(self, topic: str) -> _Sheaf:
        return self._sheaves.get(topic) or _Sheaf("")


def read(
    path: Path,
    truth_topic: str = TRUTH_TOPIC,
    progress: Callable[[float], None] | None = None,
    *,
    most: int | None = None,
    see: Callable[[Record], None] | None = None,
) -> Collected:
    """The Collected of a log; progress gets the fraction done.

    most: kept; see: gets every record. Raises LogError without an estimate or the wanted truth.
    """
    collector = Collector(truth_topic, most)
    with LogReader(path) as reader:
        for count, record in enumerate(reader):
            collector.add(record.topic, record.schema, record.data, record.log_time_ns)
            if see:
                see(record)
            if progress and count % _PROGRESS_EVERY == 0:
                progress(reader.fraction)
        attachments, torn = tuple(reader.attachments), reader.torn
        return collector.collected(path, attachments, reader.metadata, reader.skipped_chunks, torn=torn)


def _estimate(path: Path, sheaf: _Sheaf) -> Trajectory:
    estimate = decode(schemas.ODOMETRY, sheaf.data, sheaf.arrived_ns)
    if not len(estimate):
        raise LogError(f"{path}: no message of {ODOMETRY_TOPIC} is whole")
    if not np.isfinite(estimate.p).all(axis=1).any():
        raise LogError(f"{path}: none of its {len(estimate)} estimates is a number")
    return estimate


def _truth(path: Path, topic: str, sheaf: _Sheaf | None, origin: Origin | None) -> Trajectory:
    if sheaf is None:
        if topic != TRUTH_TOPIC:
            raise LogError(f"{path}: holds no {topic}; name a topic that does hold a reference with --truth")
        return from_rows(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 7)))
    truth = _positions(sheaf, origin)
    if truth is None:
        why = "the estimate has no place on Earth" if sheaf.schema == schemas.NAV_SAT_FIX else f"{sheaf.schema} holds no position"
        raise LogError(f"{path}: {topic} cannot serve as truth: {why}")
    return truth[np.asarray(np.isfinite(truth.p).all(axis=1))]


def _reference(attachments: Iterable[Attachment]) -> str:
    return next((a.data.decode(errors="replace") for a in attachments if a.name == REFERENCE_ATTACHMENT), "")


def _positions(sheaf: _Sheaf, origin: Origin | None) -> Trajectory | None:
    if sheaf.schema in POSE_TYPES:
        return decode(sheaf.schema, sheaf.data, sheaf.arrived_ns)
    if sheaf.schema == schemas.NAV_SAT_FIX and origin is not None:
        return decode_geodetic(sheaf.data, sheaf.arrived_ns, origin)
    if sheaf.schema == schemas.LANDMARK_FIX:
        places = [(arrived, _t_ns(m), m.pose.pose.position) for arrived, m in sheaf.messages()]
        arrived_ns, t_ns = (np.array([place[k] for place in places], np.int64) for k in (0, 1))
        return from_rows(t_ns, arrived_ns, np.array([(p.x, p.y, p.z) for _, _, p in places]).reshape(-1, 3))
    return None


def _origin(estimate: Trajectory, sheaf: _Sheaf) -> Origin | None:
    for _, fix in sheaf.messages():
        row = int(np.searchsorted(estimate.t_ns, _t_ns(fix)))
        if row < len(estimate) and estimate.t_ns[row] == _t_ns(fix) and np.isfinite(estimate.p[row]).all():
            east, north, up = (float(x) for x in estimate.p[row])
            place = origin = np.array([fix.latitude, fix.longitude, fix.altitude])
            for _ in range(5):
                reported = Origin(*map(float, origin)).to_geodetic((north, east, -up))
                origin = origin + (place - reported)
            return Origin(*map(float, origin))
    return None


def _aids(sheaf: _Sheaf) -> tuple[AidStatus, ...]:
    last: dict[tuple[str, str, int, int], AidStatus] = {}
    for _, status in sheaf.parsed(decode_aid_status):
        key = (status.topic, status.kind, status.t_ns, status.arrived_ns)
        if key not in last or status.revision >= last[key].revision:
            last[key] = status
    return tuple(sorted(last.values(), key=lambda s: (s.t_ns, s.arrived_ns, s.topic, s.kind)))


def _health(sheaf: _Sheaf) -> tuple[HealthPoint, ...]:
    points = []
    for _, (t_ns, values) in sheaf.parsed(lambda data: (stamp_of(data) or 0, decode_diagnostics(data))):
        points.append(HealthPoint(t_ns, values.get("mode", "unknown"), float(values.get("absolute_age_s", "inf"))))
    return tuple(points)


def _waited_for(sheaf: _Sheaf) -> str:
    details = [values.get("detail", "") for _, values in sheaf.parsed(decode_diagnostics)]
    return next((detail for detail in reversed(details) if detail), "it does not say why")


def _resets(sheaf: _Sheaf) -> tuple[Jump, ...]:
    jumps = []
    for _, m in sheaf.messages():
        delta_p, delta_v, delta_theta = ((v.x, v.y, v.z) for v in (m.delta_position, m.delta_velocity, m.delta_rotation))
        jumps.append(Jump(_t_ns(m), int(m.counter), delta_p, delta_v, delta_theta))
    return tuple(jumps)


def _fixes(sheaves: dict[str, _Sheaf], aids: Iterable[AidStatus], origin: Origin | None) -> dict[str, Fixes]:
    used: dict[str, set[int]] = {}
    for status in aids:
        arrivals = used.setdefault(status.topic, set())
        if status.reason in {Reason.FUSED, Reason.ALIGNING}:
            arrivals.add(status.arrived_ns)
    fixes = {}
    for topic, sheaf in sheaves.items():
        positions = _positions(sheaf, origin) if topic in used else None
        if positions is not None:
            was_used = np.array([t in used[topic] for t in positions.arrived_ns.tolist()], bool)
            fixes[topic] = Fixes(positions.t_ns, positions.p, was_used)
    return fixes


def _t_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)
