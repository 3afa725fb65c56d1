"""A replay that looks at the images again, instead of taking the fixes in the log.

Of a flight in which vision worked the log holds each request: it is repeated, and its answer stands where the flight's stood, so
the same fixes come out, bit for bit. A log of images that were never looked at gets requests of its own, from the estimate of
the replay, and answers replay_latency_ms later.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import msgspec

from estimator.frontend.processor import Sight
from estimator.frontend.requests import Pair, Pairing, Shot, Track, VisionConfig
from logs.store.parts import PartsReader
from logs.store.reader import Record
from logs.wire.codec import VISION_REQUEST_TOPIC, Encoded, decode_vision_request, encode
from logs.wire.markers import TOPIC as LANDMARKS_TOPIC
from logs.wire.stamps import stamp_of
from models.messages import Output, PictureName, VisionRequest

FIX_TOPIC: Final = "/landfix/fix"
REPORT_TOPIC: Final = "/landfix/vision"
_ANSWERS: Final = frozenset({FIX_TOPIC, REPORT_TOPIC, LANDMARKS_TOPIC})
_KEPT: Final = 400  # images


class ImageCounts(msgspec.Struct):
    """processed: requests; fixes: what they gave; same, different: beside the fixes in the log; missing: images not in it."""

    processed: int = 0
    fixes: int = 0
    same: int = 0
    different: int = 0
    missing: int = 0

    def __str__(self) -> str:
        beside = f"; of the log's fixes {self.same} the same, {self.different} not" if self.same or self.different else ""
        lost = f"; pictures of {self.missing} requests are not in the log" if self.missing else ""
        return f"{self.processed} pairs looked at, {self.fixes} fixes{beside}{lost}"


class SightReplay:
    """Puts the answers of vision among the records of a log. left, right: topics of the images."""

    def __init__(
        self, sight: Sight, config: VisionConfig, left: Iterable[str], right: Iterable[str], source: Path | Sequence[Path]
    ) -> None:
        self._sight, self._latency_ns = sight, round(config.replay_latency_ms * 1e6)
        self._side = {**dict.fromkeys(left, "left"), **dict.fromkeys(right, "right")}
        self._repeats = _has_requests(source)
        self._pairing, self._track = Pairing(config), Track()
        self._shots: dict[PictureName, Shot] = {}
        self._asked: deque[VisionRequest] = deque()
        self._answers: dict[tuple[str, int], Encoded] = {}  # by topic and exposure
        self._answered_ns = 0  # exposure of the last
        self._due: deque[tuple[int, list[Encoded]]] = deque()
        self.counts = ImageCounts()

    def note(self, outputs: Iterable[Output]) -> None:
        """What Fusion said: the priors of requests to come."""
        if not self._repeats:
            self._track.note(outputs)

    def records(self, record: Record) -> Iterator[Record]:
        """What the estimator is to see instead of this record, in order."""
        while self._due and self._due[0][0] <= record.log_time_ns:
            due_ns, answers = self._due.popleft()
            yield from (Record(a.topic, a.schema, due_ns, a.data) for a in answers)
        if record.topic in _ANSWERS:
            yield from self._again(record)
            return
        yield record
        if record.topic in self._side:
            yield from self._picture(record)
        elif record.topic == VISION_REQUEST_TOPIC:
            self._ask(decode_vision_request(record.data, record.log_time_ns))

    def _picture(self, record: Record) -> Iterator[Record]:
        stamp_ns = stamp_of(record.data)
        if stamp_ns is None:
            return
        t_ns = stamp_ns + self._sight.time_offset_ns
        shot = Shot(record.topic, record.schema, record.data, stamp_ns, t_ns, record.log_time_ns)
        if self._repeats:
            self._shots[shot.name] = shot
            while len(self._shots) > _KEPT:
                del self._shots[next(iter(self._shots))]
            return
        for pair in self._pairing.put(self._side[record.topic], shot):
            if request := self._track.request(pair, record.log_time_ns):
                (message,) = encode(request)
                yield Record(message.topic, message.schema, record.log_time_ns, message.data)
                self._due.append((record.log_time_ns + self._latency_ns, self._look(request, message, pair)))

    def _look(self, request: VisionRequest, message: Encoded, pair: Pair) -> list[Encoded]:
        """The answer to the request as it was written, which is what a replay of it will read."""
        return self._counted(self._sight.look(decode_vision_request(message.data, request.arrived_ns), (pair.left, pair.right)))

    def _ask(self, request: VisionRequest) -> None:
        """Requests are answered in their order, when the fix or report of one is needed: all images have been read by then."""
        self._asked.append(request)

    def _again(self, record: Record) -> Iterator[Record]:
        """The answer that takes the recorded one's place; what another program sent under our name stays."""
        t_ns = self._answered_ns if record.topic == LANDMARKS_TOPIC else stamp_of(record.data)  # it follows report and fix
        while t_ns is not None and any(r.t_ns == t_ns for r in self._asked):
            self._answer(self._asked.popleft())
        answer = self._answers.pop((record.topic, t_ns or 0), None)
        if record.topic == FIX_TOPIC and self._repeats:
            self.counts.same += answer is not None and answer.data == record.data
            self.counts.different += answer is None or answer.data != record.data
        if answer is not None:
            yield Record(answer.topic, answer.schema, record.log_time_ns, answer.data)

    def _answer(self, request: VisionRequest) -> None:
        self._answered_ns = request.t_ns
        left, right = (self._shots.get(name) if name else None for name in (request.left, request.right))
        if (request.left and left is None) or (request.right and right is None):
            self.counts.missing += 1
            return
        for message in self._counted(self._sight.look(request, (left, right))):
            self._answers[message.topic, request.t_ns] = message

    def _counted(self, answers: list[Encoded]) -> list[Encoded]:
        self.counts.processed += 1
        self.counts.fixes += any(a.topic == FIX_TOPIC for a in answers)
        return answers


def _has_requests(source: Path | Sequence[Path]) -> bool:
    """Whether vision was asked in the flight of this log."""
    with PartsReader(source) as reader:
        return any(record.topic == VISION_REQUEST_TOPIC for record in reader)
