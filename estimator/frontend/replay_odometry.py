"""Motion measured again, in place of the logged increments."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

from estimator.frontend.key_frames import KeyFrames, VisualOdometryConfig
from estimator.frontend.odometry import ODOMETRY_REPORT_TOPIC, OdometryProcessor
from estimator.frontend.repeat import Asked, Counts, Repeat
from estimator.frontend.requests import Pair, VisionConfig
from logs.store.reader import Record
from logs.wire.codec import ODOMETRY_REQUEST_TOPIC, Encoded, decode_odometry_request, encode
from logs.wire.stamps import stamp_of
from models.messages import ODOMETRY_DELTA_TOPIC, OdometryRequest

_Answers: TypeAlias = dict[str, Encoded]


class OdometryReplay(Repeat):
    """Visual odometry's answers among a log's records."""

    def __init__(
        self,
        processor: OdometryProcessor,
        config: VisualOdometryConfig,
        vision: VisionConfig,
        topics: tuple[Iterable[str], Iterable[str]],
        source: Path | Sequence[Path],
    ) -> None:
        counts = Counts("odometry: {asked} steps, {measured} increments", "increments")
        super().__init__(vision, processor.time_offset_ns, topics, source, ODOMETRY_REQUEST_TOPIC, ODOMETRY_DELTA_TOPIC, counts)
        self._processor, self._key_frames = processor, KeyFrames(config)
        self._asked: dict[int, OdometryRequest] = {}  # by exposure of the later pair
        self._answers: dict[int, _Answers] = {}

    def _is_answer(self, record: Record) -> bool:
        return record.topic in {ODOMETRY_DELTA_TOPIC, ODOMETRY_REPORT_TOPIC} and (stamp_of(record.data) or 0) in self._asked

    def _keep(self, record: Record) -> None:
        request = decode_odometry_request(record.data, record.log_time_ns)
        self._asked[request.t_ns] = request

    def _ask(self, pair: Pair, arrived_ns: int) -> Asked | None:
        asked = self._key_frames.request(pair, self._track, arrived_ns)
        if asked is None:
            return None
        request, first = asked
        (message,) = encode(request)
        written = decode_odometry_request(message.data, arrived_ns)  # what a replay of it will read
        return Asked(message, self._counted(self._processor.process(written, first, pair)))

    def _again(self, record: Record) -> Iterator[Record]:
        t_ns = stamp_of(record.data) or 0
        if t_ns not in self._answers:
            self._answers[t_ns] = self._answer(self._asked[t_ns])
        yield from self._in_place(record, self._answers[t_ns].get(record.topic))

    def _answer(self, request: OdometryRequest) -> _Answers:
        first, second = (self._pair(*names) for names in (request.first, request.second))
        if first is None or second is None:
            self.counts.missing += 1
            return {}
        return {answer.topic: answer for answer in self._counted(self._processor.process(request, first, second))}
