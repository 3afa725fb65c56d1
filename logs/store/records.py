"""Whole MCAP records of a damaged file, in file order, without exceptions (mcap.dev/spec).

Chunks of wrong CRC or beyond models.untrusted.limits are dropped. After damage reading goes on at the next chunk.
"""

import contextlib
import mmap
import os
import re
import shlex
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Final, TypeAlias

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, McapRecord, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC as MAGIC

from logs.store.chunks import content_of
from models.untrusted.file import opened
from models.untrusted.limits import TooLargeError, allowed, check_records
from models.untrusted.toml_text import one_line

RawMessage: TypeAlias = tuple[int, int, int, int, bytes]
"""Channel, sequence, log time, publish time, data."""

_FRAME: Final = struct.Struct("<BQ")  # opcode, length
_MESSAGE: Final = struct.Struct("<9xHIQQ")  # behind the frame: channel, sequence, log time, publish time
_MESSAGE_OPCODE: Final = int(Opcode.MESSAGE)
_CHUNK_START: Final = re.compile(rb"\x06.{36}(?:\x03\0\0\0lz4|\x04\0\0\0zstd)", re.DOTALL)  # opcode to name of the compression
_FOOTER_SIZE: Final = 29  # bytes, frame included
_CONTENT: Final = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
}
_VAIN_RATIO: Final = 4
_CHECK_EVERY: Final = 1000  # records
_IMPORTED: Final = {b"ULog\x01\x12\x35": ("a PX4", "ulog"), b"\xa3\x95\x80\x80": ("an ArduPilot dataflash", "dataflash")}
_ZSTD: Final = b"\x28\xb5\x2f\xfd"
_NOTES: Final = {
    b"": "is empty",
    b"#ROSBAG ": "is a ROS 1 bag; convert it to MCAP (rosbags-convert)",
    b"SQLite f": "is an SQLite bag; convert it to MCAP (ros2 bag convert, rosbags-convert)",
}


def _what(start: bytes, path: Path) -> str:
    out = f"{shlex.quote(str(path))} -o {shlex.quote(path.stem + '.mcap')}"
    for magic, (name, kind) in _IMPORTED.items():
        if start.startswith(magic):
            return f"{name} log: landfix import {kind} {out}"
    if len(start) == len(MAGIC) and path.suffix.lower() == ".tlog":
        return f"a MAVLink telemetry log: landfix import tlog {out}"
    if start.startswith(_ZSTD):
        return f"is compressed as a whole; unpack it first: zstd -d {shlex.quote(str(path))}"
    return _NOTES.get(start, "is not an MCAP file, or its first bytes are damaged")


class LogError(Exception):
    """A log cannot be opened, read or written; one line."""


class RecordFile:
    """Messages of an MCAP file; attributes are complete after them.

    channels, schemas: by id; torn: no proper end; skipped_chunks: damage; orphans: messages of a lost channel; expected: writer's
    count.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._file = opened(self.path)
        except IsADirectoryError:
            raise LogError(f"{path}: is a directory; name the .mcap file inside it") from None
        except OSError as error:
            raise LogError(f"{path}: {(error.strerror or 'cannot be opened').lower()}") from None
        self.size = os.fstat(self._file.fileno()).st_size
        start = self._file.read(len(MAGIC))
        if start != MAGIC:
            self._file.close()
            raise LogError(f"{path}: {_what(start, self.path)}")
        self._reset()
        for opcode, content, position in self._frames():
            if opcode == Opcode.HEADER:
                self._unchunked(opcode, content, position)
            break

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def fraction(self) -> float:
        """How much of the file has been read, 0 to 1."""
        return self._file.tell() / self.size

    def __iter__(self) -> Iterator[RawMessage]:
        self._reset()
        count = 0
        for opcode, content, start in self._frames():
            if opcode == Opcode.CHUNK:
                messages = self._chunk(content, start)
            elif opcode == Opcode.MESSAGE or opcode in _CONTENT:
                messages = self._unchunked(opcode, content, start)
            else:
                continue
            count += len(messages)
            yield from messages
        if self._too_large and not count:
            raise LogError(f"{self.path}: {self._too_large}")

    def _reset(self) -> None:
        self.profile = ""
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.attachments: list[Attachment] = []
        self.metadata: list[Metadata] = []
        self.torn = True
        self.skipped_chunks = 0
        self.orphans = 0
        self.expected: int | None = None
        self._whole = len(MAGIC)  # up to here everything was understood
        self._damaged = False  # the last chunk was
        self._chunked = False
        self._too_large = ""  # why the first chunk that was too large was left out
        self._decompressed = self._in_vain = 0  # bytes; of chunks that were damaged
        self._records = 0

    def _frames(self) -> Iterator[tuple[int, bytes, int]]:
        start = len(MAGIC)
        while True:
            self._file.seek(start)
            frame = self._file.read(_FRAME.size)
            opcode, length = _FRAME.unpack(frame) if len(frame) == _FRAME.size else (0, 0)
            end = start + _FRAME.size + length
            early_footer = opcode == Opcode.FOOTER and end + len(MAGIC) != self.size
            if opcode == 0 or end > self.size or early_footer:
                found = self._next_chunk(self._whole)
                if found is None:
                    return
                if not self._damaged:
                    self._skip(found)
                start, self._whole = found, found + 1
                continue
            yield opcode, self._file.read(length), start
            if opcode == Opcode.FOOTER:
                self.torn = self._file.read() != MAGIC
                return
            start = end

    def _next_chunk(self, start: int) -> int | None:
        if self._in_vain > _VAIN_RATIO * self.size:
            return None
        with mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ) as view:
            for match in _CHUNK_START.finditer(view, start):
                _, length = _FRAME.unpack_from(view, match.start())
                if match.start() + _FRAME.size + length <= self.size:
                    return match.start()
        return None

    def _chunk(self, content: bytes, start: int) -> list[RawMessage]:
        try:
            fields = _stream(content)
            chunk = Chunk.read(fields)
            content_bytes = content_of(chunk, allowed(start) - self._decompressed)
            self._decompressed += len(content_bytes)
            messages = self._block(content_bytes)
        except Exception as error:  # each decompressor has exceptions of its own
            if isinstance(error, TooLargeError):
                self._too_large = self._too_large or str(error)
            self._in_vain += len(content)
            self._skip(start)
            self._damaged = True
            return []
        self._whole = start + _FRAME.size + fields.count  # by the chunk's own account: the record's length may be what is wrong
        self._damaged, self._chunked = False, True
        return messages

    def _unchunked(self, opcode: int, content: bytes, start: int) -> list[RawMessage]:
        try:
            if opcode == Opcode.ATTACHMENT and zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little") != 0:
                raise ValueError("attachment fails its CRC")
            if opcode == Opcode.MESSAGE and self._chunked:
                raise ValueError("a message that no CRC covers, in a file of chunks")
            return self._block(_FRAME.pack(opcode, len(content)) + content)
        except (McapError, ValueError, struct.error):
            self._skip(start)
            return []

    def _block(self, block: bytes) -> list[RawMessage]:
        messages: list[RawMessage] = []
        at, end = 0, len(block)
        frame, message, known = _FRAME.unpack_from, _MESSAGE.unpack_from, self.channels
        while at < end:
            opcode, length = frame(block, at)
            after = at + _FRAME.size + length
            if after > end:
                raise ValueError("record longer than its chunk")
            if opcode == _MESSAGE_OPCODE:
                channel, sequence, log_time, publish_time = message(block, at)
                if channel in known:
                    messages.append((channel, sequence, log_time, publish_time, block[at + 31 : after]))
                else:
                    self.orphans += 1
            elif opcode in _CONTENT:
                self._note(_CONTENT[Opcode(opcode)](_stream(block[at + _FRAME.size : after])))
            at = after
            self._records += 1
            if self._records % _CHECK_EVERY == 0:
                check_records(self._records, self._file.tell())
        return messages

    def _note(self, record: McapRecord) -> None:
        match record:
            case Channel():
                record.topic = one_line(record.topic)
                self.channels.setdefault(record.id, record)
            case Schema():
                self.schemas.setdefault(record.id, record)
            case Attachment():
                self.attachments.append(record)
            case Metadata():
                record.metadata = {one_line(key): one_line(value) for key, value in record.metadata.items()}
                self.metadata.append(record)
            case Header():
                self.profile = record.profile
            case Statistics():
                self.expected = record.message_count
            case _:
                pass

    def _skip(self, start: int) -> None:
        """Note damage; definitions lost with it come from the summary."""
        self._whole = start + 1
        self.skipped_chunks += 1
        if self.skipped_chunks == 1:
            with contextlib.suppress(McapError, ValueError, struct.error):  # the summary may be damaged too
                self._block(self._summary())

    def _summary(self) -> bytes:
        file, end = self._file.fileno(), self.size - len(MAGIC)
        footer = os.pread(file, _FOOTER_SIZE, max(0, end - _FOOTER_SIZE))
        if footer[:1] != bytes([Opcode.FOOTER]) or len(footer) < _FOOTER_SIZE:
            return b""
        start = Footer.read(_stream(footer[_FRAME.size :])).summary_start
        return os.pread(file, end - start, start) if 0 < start < end else b""


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
