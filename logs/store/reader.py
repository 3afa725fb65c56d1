"""CDR messages of a log in order of arrival, to the last whole record of a torn file."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

import msgspec
from mcap.records import Schema

from logs.store.records import LogError, RecordFile
from logs.wire.schemas import missing_end

__all__ = ["Attachment", "LogError", "LogReader", "Record", "check_output"]


class Record(msgspec.Struct, frozen=True, eq=False, gc=False):
    """One message: schema: type name, log_time_ns: arrival."""

    topic: str
    schema: str
    log_time_ns: int
    data: bytes


class Attachment(NamedTuple):
    """A file kept in the log."""

    name: str
    media_type: str
    data: bytes


def check_output(out: Path, *inputs: Path) -> None:
    """Raises LogError where `out` would overwrite an input or has no folder."""
    if not out.parent.is_dir():
        raise LogError(f"{out}: cannot be written ({out.parent} is no folder)")
    if out.exists() and any(source.exists() and out.samefile(source) for source in inputs):
        raise LogError(f"{out}: the output would overwrite the input; name another file after -o")


class LogReader:
    """Iterates over a log's messages. Raises LogError.

    Complete after iteration: torn, skipped_chunks (damage), attachments, metadata, foreign (topics not CDR).
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._file = RecordFile(path)
        self.foreign: dict[str, str] = {}
        self._schemas: dict[str, Schema] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __iter__(self) -> Iterator[Record]:
        names: dict[int, tuple[str, str, bytes] | None] = {}
        for channel, _, log_time_ns, _, data in self._file:
            if channel not in names:
                names[channel] = self._names(channel)
            if (name := names[channel]) is not None:
                yield Record(name[0], name[1], log_time_ns, data + name[2])

    @property
    def torn(self) -> bool:
        """No proper end: the writer was cut off, or still writes."""
        return self._file.torn

    @property
    def skipped_chunks(self) -> int:
        """Damaged places, each at least one chunk."""
        return self._file.skipped_chunks

    @property
    def fraction(self) -> float:
        """How much of the file has been read, 0 to 1."""
        return self._file.fraction

    @property
    def attachments(self) -> list[Attachment]:
        """The files kept in the log, in order."""
        return [Attachment(a.name, a.media_type, a.data) for a in self._file.attachments]

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """The metadata records by name; of several with one name the last."""
        return {m.name: m.metadata for m in self._file.metadata}

    @property
    def schemas(self) -> dict[str, Schema]:
        """Definitions of types read so far, by name, for a Recorder."""
        return self._schemas

    def _names(self, channel_id: int) -> tuple[str, str, bytes] | None:
        channel = self._file.channels[channel_id]
        schema = self._file.schemas.get(channel.schema_id)
        if channel.message_encoding != "cdr" or schema is None:
            self.foreign[channel.topic] = channel.message_encoding if schema else f"{channel.message_encoding} without a schema"
            return None
        name = re.sub(r"^(\w+)/(\w+)$", r"\1/msg/\2", schema.name)  # sensor_msgs/Imu, as ROS 1 names it and some writers do
        self._schemas[name] = schema
        return channel.topic, name, missing_end(name, schema.data)
