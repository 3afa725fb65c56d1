"""Landmarks searched again, in place of the logged fixes."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from estimator.frontend.processor import Processor
from estimator.frontend.repeat import Asked, Counts, Repeat
from estimator.frontend.requests import Pair, VisionConfig
from logs.store.reader import Record
from logs.wire.cameras import LEFT_TOPIC, RIGHT_TOPIC, STATIC_TOPIC, is_own_static
from logs.wire.codec import VISION_REQUEST_TOPIC, Encoded, decode_vision_request, encode
from logs.wire.markers import TOPIC as LANDMARKS_TOPIC
from logs.wire.stamps import stamp_of
from models.messages import VisionRequest

FIX_TOPIC: Final = "/landfix/fix"
REPORT_TOPIC: Final = "/landfix/vision"
_ANSWERS: Final = frozenset({FIX_TOPIC, REPORT_TOPIC, LANDMARKS_TOPIC, LEFT_TOPIC, RIGHT_TOPIC})
_UNSTAMPED: Final = frozenset({LANDMARKS_TOPIC, STATIC_TOPIC})  # whose stamps are not at the message's beginning


class ImageReplay(Repeat):
    """Vision's answers among a log's records."""

    def __init__(
        self, processor: Processor, config: VisionConfig, left: Iterable[str], right: Iterable[str], source: Path | Sequence[Path]
    ) -> None:
        counts = Counts("{asked} pairs processed, {measured} fixes", "fixes")
        super().__init__(config, processor.time_offset_ns, (left, right), source, VISION_REQUEST_TOPIC, FIX_TOPIC, counts)
        self._processor = processor
        self._asked: deque[VisionRequest] = deque()
        self._answers: dict[tuple[str, int], Encoded] = {}  # by topic and exposure
        self._answered_ns = 0  # exposure of the last

    def _is_answer(self, record: Record) -> bool:
        return record.topic in _ANSWERS or (record.topic == STATIC_TOPIC and is_own_static(record.data))

    def _keep(self, record: Record) -> None:
        self._asked.append(decode_vision_request(record.data, record.log_time_ns))

    def _ask(self, pair: Pair, arrived_ns: int) -> Asked | None:
        request = self._track.request(pair, arrived_ns)
        if request is None:
            return None
        (message,) = encode(request)
        written = decode_vision_request(message.data, request.arrived_ns)  # what a replay of it will read
        return Asked(message, self._counted(self._processor.process(written, (pair.left, pair.right))))

    def _again(self, record: Record) -> Iterator[Record]:
        t_ns = self._answered_ns if record.topic in _UNSTAMPED else stamp_of(record.data)  # it follows report and fix
        while t_ns is not None and any(r.t_ns == t_ns for r in self._asked):
            self._answer(self._asked.popleft())
        yield from self._in_place(record, self._answers.pop((record.topic, t_ns or 0), None))

    def _answer(self, request: VisionRequest) -> None:
        self._answered_ns = request.t_ns
        pair = self._pair(request.left, request.right)
        if pair is None:
            self.counts.missing += 1
            return
        for message in self._counted(self._processor.process(request, (pair.left, pair.right))):
            self._answers[message.topic, request.t_ns] = message
