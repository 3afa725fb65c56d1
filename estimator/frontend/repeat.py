"""Replay from images: logged requests are repeated; else requests from the replay's estimate, answers 50 ms later."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from estimator.frontend.requests import Pair, Pairing, Shot, Track, VisionConfig
from logs.store.parts import PartsReader
from logs.store.reader import Record
from logs.wire.codec import Encoded
from logs.wire.stamps import stamp_of
from models.messages import ImageName, Output

_KEPT: Final = 400  # images
_LATENCY_NS: Final = 50_000_000  # of an answer to images that were never processed in flight


class Asked(NamedTuple):
    """A logged request and its answers."""

    request: Encoded
    answers: list[Encoded]


class Counts(msgspec.Struct):
    """said: with {asked}, {measured}; noun: of a measurement; same, different: from the log's; missing: images."""

    said: str
    noun: str
    asked: int = 0
    measured: int = 0
    same: int = 0
    different: int = 0
    missing: int = 0

    def __str__(self) -> str:
        compared = f"; of the log's {self.noun} {self.same} the same, {self.different} not" if self.same or self.different else ""
        lost = f"; images of {self.missing} requests are not in the log" if self.missing else ""
        return self.said.format(asked=self.asked, measured=self.measured) + compared + lost


class Repeat(ABC):
    """Puts answers among a log's records; topics: left, right images; measurement: topic of what is measured."""

    def __init__(
        self,
        config: VisionConfig,
        time_offset_ns: int,
        topics: tuple[Iterable[str], Iterable[str]],
        source: Path | Sequence[Path],
        request_topic: str,
        measurement: str,
        counts: Counts,
    ) -> None:
        self.counts, self._measurement = counts, measurement
        self._time_offset_ns = time_offset_ns
        self._side = {**dict.fromkeys(topics[0], "left"), **dict.fromkeys(topics[1], "right")}
        self._request_topic = request_topic
        with PartsReader(source) as reader:
            self._repeats = any(record.topic == request_topic for record in reader)
        self._pairing, self._track = Pairing(config, alone=len(set(self._side.values())) == 1), Track()
        self._shots: dict[ImageName, Shot] = {}
        self._due: deque[tuple[int, list[Encoded]]] = deque()

    @abstractmethod
    def _is_answer(self, record: Record) -> bool:
        """Whether our answer replaces this record."""

    @abstractmethod
    def _again(self, record: Record) -> Iterator[Record]:
        """The answer that replaces the record."""

    @abstractmethod
    def _keep(self, record: Record) -> None:
        """Keep a logged request."""

    @abstractmethod
    def _ask(self, pair: Pair, arrived_ns: int) -> Asked | None:
        """A new request with its answers; None: none for this pair."""

    def note(self, outputs: Iterable[Output]) -> None:
        """Note Fusion's outputs: priors of later requests."""
        if not self._repeats:
            self._track.note(outputs)

    def records(self, record: Record) -> Iterator[Record]:
        """Records in place of this one."""
        while self._due and self._due[0][0] <= record.log_time_ns:
            due_ns, answers = self._due.popleft()
            yield from (Record(a.topic, a.schema, due_ns, a.data) for a in answers)
        if self._is_answer(record):
            yield from self._again(record)
            return
        yield record
        if record.topic in self._side:
            yield from self._image(record)
        elif record.topic == self._request_topic:
            self._keep(record)

    def _image(self, record: Record) -> Iterator[Record]:
        stamp_ns = stamp_of(record.data)
        if stamp_ns is None:
            return
        t_ns = stamp_ns + self._time_offset_ns
        shot = Shot(record.topic, record.schema, record.data, stamp_ns, t_ns, record.log_time_ns)
        if self._repeats:
            self._shots[shot.name] = shot
            while len(self._shots) > _KEPT:
                del self._shots[next(iter(self._shots))]
            return
        for pair in self._pairing.put(self._side[record.topic], shot):
            if asked := self._ask(pair, record.log_time_ns):
                yield Record(asked.request.topic, asked.request.schema, record.log_time_ns, asked.request.data)
                self._due.append((record.log_time_ns + _LATENCY_NS, asked.answers))

    def _counted(self, answers: list[Encoded]) -> list[Encoded]:
        self.counts.asked += 1
        self.counts.measured += any(a.topic == self._measurement for a in answers)
        return answers

    def _in_place(self, record: Record, answer: Encoded | None) -> Iterator[Record]:
        """The answer, compared with the record."""
        if record.topic == self._measurement and self._repeats:
            self.counts.same += answer is not None and answer.data == record.data
            self.counts.different += answer is None or answer.data != record.data
        if answer is not None:
            yield Record(answer.topic, answer.schema, record.log_time_ns, answer.data)

    def _pair(self, left: ImageName | None, right: ImageName | None) -> Pair | None:
        found = Pair(*(self._shots.get(name) if name else None for name in (left, right)))
        return None if (left and found.left is None) or (right and found.right is None) else found


class Together:
    """Landmarks and odometry of one log."""

    def __init__(self, parts: Sequence[Repeat]) -> None:
        self.parts = parts

    def note(self, outputs: Iterable[Output]) -> None:
        """Note Fusion's outputs."""
        kept = list(outputs)
        for part in self.parts:
            part.note(kept)

    def records(self, record: Record) -> Iterator[Record]:
        """Records in place of this one."""
        records = [record]
        for part in self.parts:
            records = [seen for one in records for seen in part.records(one)]
        yield from records
