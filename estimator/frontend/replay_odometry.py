"""A replay that measures the motion between the recorded pairs again, instead of taking the increments in the log.

Of a flight in which visual odometry worked the log holds each request: it is repeated, and its answer stands where the flight's
stood, bit for bit the same. A log without requests gets its own, from the estimate of the replay, and answers latency later.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import msgspec

from estimator.frontend.key_frames import KeyFrames, VisualOdometryConfig
from estimator.frontend.odometry import ODOMETRY_REPORT_TOPIC, OdometrySight
from estimator.frontend.replay_pictures import SightReplay
from estimator.frontend.requests import Pair, Pairing, Shot, Track, VisionConfig
from logs.store.parts import PartsReader
from logs.store.reader import Record
from logs.wire.codec import ODOMETRY_REQUEST_TOPIC, Encoded, decode_odometry_request, encode
from logs.wire.stamps import stamp_of
from models.messages import ODOMETRY_DELTA_TOPIC, OdometryRequest, Output, PictureName

_KEPT: Final = 200  # images
_Answers = dict[str, Encoded]


class OdometryCounts(msgspec.Struct):
    """steps: requests; measured: increments; same, different: beside those in the log; missing: images not in it."""

    steps: int = 0
    measured: int = 0
    same: int = 0
    different: int = 0
    missing: int = 0

    def __str__(self) -> str:
        beside = f"; of the log's increments {self.same} the same, {self.different} not" if self.same or self.different else ""
        lost = f"; images of {self.missing} requests are not in the log" if self.missing else ""
        return f"odometry: {self.steps} steps, {self.measured} increments{beside}{lost}"


class OdometryReplay:
    """Puts the answers of visual odometry among the records of a log. left, right: topics of the images."""

    def __init__(
        self,
        sight: OdometrySight,
        config: VisualOdometryConfig,
        vision: VisionConfig,
        topics: tuple[Iterable[str], Iterable[str]],
        source: Path | Sequence[Path],
    ) -> None:
        self._sight, self._latency_ns = sight, round(vision.replay_latency_ms * 1e6)
        self._side = {**dict.fromkeys(topics[0], "left"), **dict.fromkeys(topics[1], "right")}
        with PartsReader(source) as reader:
            self._repeats = any(record.topic == ODOMETRY_REQUEST_TOPIC for record in reader)
        self._pairing, self._key_frames, self._track = Pairing(vision), KeyFrames(config), Track()
        self._shots: dict[PictureName, Shot] = {}
        self._asked: dict[int, OdometryRequest] = {}  # by exposure of the later pair
        self._answers: dict[int, _Answers] = {}
        self._due: deque[tuple[int, list[Encoded]]] = deque()
        self.counts = OdometryCounts()

    def note(self, outputs: Iterable[Output]) -> None:
        """What Fusion said: the predictions of requests to come."""
        if not self._repeats:
            self._track.note(outputs)

    def records(self, record: Record) -> Iterator[Record]:
        """What the estimator is to see instead of this record, in order."""
        while self._due and self._due[0][0] <= record.log_time_ns:
            due_ns, answers = self._due.popleft()
            yield from (Record(a.topic, a.schema, due_ns, a.data) for a in answers)
        if record.topic in {ODOMETRY_DELTA_TOPIC, ODOMETRY_REPORT_TOPIC} and (stamp_of(record.data) or 0) in self._asked:
            yield from self._again(record)
            return
        yield record
        if record.topic in self._side:
            yield from self._image(record)
        elif record.topic == ODOMETRY_REQUEST_TOPIC:
            request = decode_odometry_request(record.data, record.log_time_ns)
            self._asked[request.t_ns] = request

    def _image(self, record: Record) -> Iterator[Record]:
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
            if asked := self._key_frames.request(pair, self._track, record.log_time_ns):
                request, first = asked
                (message,) = encode(request)
                yield Record(message.topic, message.schema, record.log_time_ns, message.data)
                written = decode_odometry_request(message.data, record.log_time_ns)  # what a replay of it will read
                self._due.append((record.log_time_ns + self._latency_ns, self._counted(self._sight.look(written, first, pair))))

    def _again(self, record: Record) -> Iterator[Record]:
        """The answer that takes the recorded one's place."""
        t_ns = stamp_of(record.data) or 0
        if t_ns not in self._answers:
            self._answers[t_ns] = self._answer(self._asked[t_ns])
        answer = self._answers[t_ns].get(record.topic)
        if record.topic == ODOMETRY_DELTA_TOPIC:
            self.counts.same += answer is not None and answer.data == record.data
            self.counts.different += answer is None or answer.data != record.data
        if answer is not None:
            yield Record(answer.topic, answer.schema, record.log_time_ns, answer.data)

    def _answer(self, request: OdometryRequest) -> _Answers:
        pairs = []
        for names in (request.first, request.second):
            left, right = (self._shots.get(name) if name else None for name in names)
            if (names[0] and left is None) or (names[1] and right is None):
                self.counts.missing += 1
                return {}
            pairs.append(Pair(left, right))
        return {answer.topic: answer for answer in self._counted(self._sight.look(request, *pairs))}

    def _counted(self, answers: list[Encoded]) -> list[Encoded]:
        self.counts.steps += 1
        self.counts.measured += any(a.topic == ODOMETRY_DELTA_TOPIC for a in answers)
        return answers


class Together:
    """Landmarks and odometry of one log, each from its own requests."""

    def __init__(self, parts: Sequence[SightReplay | OdometryReplay]) -> None:
        self.parts = parts

    def note(self, outputs: Iterable[Output]) -> None:
        """What Fusion said."""
        kept = list(outputs)
        for part in self.parts:
            part.note(kept)

    def records(self, record: Record) -> Iterator[Record]:
        """What the estimator is to see instead of this record, in order."""
        records = [record]
        for part in self.parts:
            records = [seen for one in records for seen in part.records(one)]
        yield from records
