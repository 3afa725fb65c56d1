"""Judges a log's streams by stretches, in bounded memory."""

from array import array
from typing import Final

import numpy as np

from logs.findings.judge import judged
from logs.findings.streams import Finding, Stream, row
from models.messages import Input, Vec3

_STRETCH_NS: Final = 120 * 10**9
_MOST: Final = 400_000  # messages in a stretch


class _Column:
    def __init__(self, kind: str, width: int) -> None:
        self.kind, self.width = kind, width
        self.t_ns, self.arrived_ns, self.values = array("q"), array("q"), array("d")

    def add(self, t_ns: int, arrived_ns: int, values: tuple[float, ...]) -> None:
        self.t_ns.append(t_ns)
        self.arrived_ns.append(arrived_ns)
        self.values.extend(values)

    def stream(self, start_ns: int) -> Stream:
        t_s, arrived_s = ((np.array(ns) - start_ns) * 1e-9 for ns in (self.t_ns, self.arrived_ns))
        return Stream(self.kind, t_s, arrived_s, np.array(self.values).reshape(-1, self.width))

    def forget(self, before_ns: int) -> None:
        k = int(np.searchsorted(np.array(self.arrived_ns), before_ns))
        del self.t_ns[:k], self.arrived_ns[:k], self.values[: k * self.width]


class Watch:
    """The estimator's inputs for the causes; origin: lat_deg, lon_deg, alt_m of the map."""

    def __init__(self, origin: Vec3 | None = None) -> None:
        self._origin = origin
        self._columns: dict[str, _Column] = {}
        self._start_ns = self._from_ns = -1
        self._count = 0
        self._found: dict[tuple[str, str], Finding] = {}

    def add(self, message: Input) -> None:
        """Add a message, in order of arrival."""
        made = row(message)
        if made is None:
            return
        kind, values = made
        now_ns = message.arrived_ns
        if self._start_ns < 0:
            self._start_ns = self._from_ns = now_ns
        if now_ns - self._from_ns > _STRETCH_NS or self._count > _MOST:
            self._judge()
            self._forget((self._from_ns + now_ns) // 2)
        column = self._columns.get(message.topic)
        if column is None:
            column = self._columns[message.topic] = _Column(kind, len(values))
        if column.width == len(values):
            column.add(message.t_ns, now_ns, values)
            self._count += 1

    def findings(self) -> list[Finding]:
        """Causes so far, likeliest first; the earliest by topic and kind."""
        self._judge()
        return [finding for _, finding in sorted(self._found.items(), key=lambda item: (not item[1].unfit, item[0][1]))]

    def _judge(self) -> None:
        streams = {topic: column.stream(self._start_ns) for topic, column in self._columns.items() if column.t_ns}
        with np.errstate(all="ignore"):  # a reading may be infinite
            for kind, finding in judged(streams, self._origin):
                self._found.setdefault((finding.who, kind), finding)

    def _forget(self, before_ns: int) -> None:
        for column in self._columns.values():
            column.forget(before_ns)
        self._from_ns = before_ns
        self._count = sum(len(column.t_ns) for column in self._columns.values())
