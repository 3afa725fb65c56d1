"""Some topics of an MCAP log in a store, by index and byte ranges (mcap.dev/spec).

Without an index the log is read whole.
"""

import struct
from bisect import bisect_right
from collections.abc import Callable, Iterator
from hashlib import sha256
from io import BytesIO
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import fsspec
from fsspec.utils import merge_offset_ranges
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC as MAGIC

from logs.store.recorder import CONFIG_ATTACHMENT, REFERENCE_ATTACHMENT

_FRAME: Final = struct.Struct("<BQ")  # opcode, length
_ENTRY: Final = struct.Struct("<QQ")  # of a message index: log time, offset in the chunk
_FOOTER_BYTES: Final = _FRAME.size + 20 + len(MAGIC)
_GAP_BYTES: Final = 16 * 1024  # a gap of so many bytes is read rather than asked for again
_BLOCK_BYTES: Final = 4 * 2**20  # of one request
_AT_ONCE_BYTES: Final = 64 * 2**20  # in memory
_CHUNK_HEAD: Final = 8 + 8 + 8 + 4  # bytes of a chunk before the name of its compression
_ATTACHMENTS: Final = frozenset({CONFIG_ATTACHMENT, REFERENCE_ATTACHMENT})
_RECORDS: Final = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
}

Range = tuple[int, int]


class Copied(NamedTuple):
    """Bytes read from the store, sha256 of the copy."""

    read_bytes: int
    digest: str


class Index:
    """The summary at the end of an MCAP file."""

    def __init__(self, summary: bytes) -> None:
        self.records: dict[Opcode, list[McapRecord]] = {opcode: [] for opcode in _RECORDS}
        at = 0
        while at + _FRAME.size <= len(summary):
            opcode, length = _FRAME.unpack_from(summary, at)
            if opcode in _RECORDS:
                content = summary[at + _FRAME.size : at + _FRAME.size + length]
                self.records[Opcode(opcode)].append(_RECORDS[Opcode(opcode)](ReadDataStream(BytesIO(content))))
            at += _FRAME.size + length

    @property
    def chunks(self) -> list[ChunkIndex]:
        """In the order of the file."""
        chunks = [r for r in self.records[Opcode.CHUNK_INDEX] if isinstance(r, ChunkIndex)]
        return sorted(chunks, key=lambda c: c.chunk_start_offset)

    def channels(self, wanted: Callable[[str], bool]) -> set[int]:
        """The channels of wanted topics."""
        return {r.id for r in self.records[Opcode.CHANNEL] if isinstance(r, Channel) and wanted(r.topic)}

    def extras(self) -> list[Range]:
        """Positions of metadata, and attachments that are read."""
        metadata = [(r.offset, r.offset + r.length) for r in self.records[Opcode.METADATA_INDEX] if isinstance(r, MetadataIndex)]
        files = [r for r in self.records[Opcode.ATTACHMENT_INDEX] if isinstance(r, AttachmentIndex)]
        return [*((r.offset, r.offset + r.length) for r in files if r.name in _ATTACHMENTS), *metadata]


def copy_selected(fs: fsspec.AbstractFileSystem, path: str, out: Path, wanted: Callable[[str], bool]) -> Copied:
    """Write the wanted topics to `out`. Raises OSError."""
    source = _Source(fs, path)
    index = source.index()
    with out.open("w+b") as file:
        if index is None or not index.chunks or not all(chunk.message_index_offsets for chunk in index.chunks):
            whole = ((start, min(start + _BLOCK_BYTES, source.size)) for start in range(0, source.size, _BLOCK_BYTES))
            for block in source.pieces(whole):
                file.write(block)
        else:
            _write(file, source, index, index.channels(wanted))
        file.seek(0)
        digest = sha256()
        while block := file.read(2**20):
            digest.update(block)
    return Copied(source.read_bytes, digest.hexdigest())


def _write(file: BinaryIO, source: "_Source", index: Index, channels: set[int]) -> None:
    file.write(MAGIC + _packed(Header("ros2", "landfix")))
    for opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        for record in index.records[opcode]:
            file.write(_packed(record))
    for piece in source.pieces(iter(index.extras())):
        file.write(piece)
    for mixed, chunks in _runs(index.chunks, channels):
        if mixed:
            for chunk in chunks:
                file.write(_partial(source, chunk, channels))
        else:
            for piece in source.pieces((c.chunk_start_offset, c.chunk_start_offset + c.chunk_length) for c in chunks):
                file.write(piece)
    file.write(_packed(DataEnd(0)) + _packed(Footer(0, 0, 0)) + MAGIC)


def _runs(chunks: list[ChunkIndex], channels: set[int]) -> Iterator[tuple[bool, list[ChunkIndex]]]:
    run: list[ChunkIndex] = []
    was = False
    for chunk in chunks:
        held = chunk.message_index_offsets.keys()
        if not channels & held:
            continue
        mixed = not chunk.compression and not held <= channels
        if run and mixed != was:
            yield was, run
            run = []
        was = mixed
        run.append(chunk)
    if run:
        yield was, run


def _partial(source: "_Source", chunk: ChunkIndex, channels: set[int]) -> bytes:
    after = chunk.chunk_start_offset + chunk.chunk_length
    (indexes,) = source.pieces(iter([(after, after + chunk.message_index_length)]))
    ours, starts = set[int](), {chunk.uncompressed_size}
    for channel, at in chunk.message_index_offsets.items():
        (size,) = struct.unpack_from("<I", indexes, at - after + _FRAME.size + 2)
        begin = at - after + _FRAME.size + 6
        offsets = {offset for _, offset in _ENTRY.iter_unpack(indexes[begin : begin + size])}
        starts |= offsets
        ours |= offsets if channel in channels else set()
    content = chunk.chunk_start_offset + _FRAME.size + _CHUNK_HEAD + 4 + len(chunk.compression) + 8
    ranges = ((content + a, content + b) for a, b in pairwise(sorted(starts)) if a in ours)
    data = b"".join(piece[: _FRAME.size + _FRAME.unpack_from(piece)[1]] for piece in source.pieces(ranges))
    return _packed(Chunk("", data, chunk.message_end_time, chunk.message_start_time, 0, len(data)))


class _Source:
    def __init__(self, fs: fsspec.AbstractFileSystem, path: str) -> None:
        self._fs, self._path = fs, path
        self.size = int(fs.size(path) or 0)
        self.read_bytes = 0

    def index(self) -> Index | None:
        end = self._read([(max(0, self.size - _FOOTER_BYTES), self.size)])[0]
        opcode, length = _FRAME.unpack_from(end) if len(end) == _FOOTER_BYTES else (0, 0)
        if opcode != Opcode.FOOTER or length != _FOOTER_BYTES - _FRAME.size - len(MAGIC) or not end.endswith(MAGIC):
            return None
        start = Footer.read(ReadDataStream(BytesIO(end[_FRAME.size :]))).summary_start
        stop = self.size - _FOOTER_BYTES
        return Index(self._read([(start, stop)])[0]) if 0 < start < stop else None

    def pieces(self, ranges: Iterator[Range]) -> Iterator[bytes]:
        for group in _groups(ranges):
            starts, ends = [a for a, _ in group], [b for _, b in group]
            _, begins, stops = merge_offset_ranges([self._path] * len(group), starts, ends, _GAP_BYTES, _BLOCK_BYTES)
            merged = [(int(a or 0), int(b or 0)) for a, b in zip(begins, stops, strict=True)]
            blocks = dict(zip(merged, self._read(merged), strict=True))
            for a, b in group:
                begin, stop = merged[bisect_right(merged, a, key=itemgetter(0)) - 1]
                yield blocks[begin, stop][a - begin : b - begin]

    def _read(self, ranges: list[Range]) -> list[bytes]:
        starts, ends = [a for a, _ in ranges], [b for _, b in ranges]
        read: list[bytes] = self._fs.cat_ranges([self._path] * len(ranges), starts, ends, on_error="raise")
        if any(len(block) != b - a for block, (a, b) in zip(read, ranges, strict=True)):
            raise OSError(f"{self._path}: the store gave fewer bytes than it lists")
        self.read_bytes += sum(map(len, read))
        return read


def _groups(ranges: Iterator[Range]) -> Iterator[list[Range]]:
    group: list[Range] = []
    for a, b in ranges:
        if group and b - group[0][0] > _AT_ONCE_BYTES:
            yield group
            group = []
        group.append((a, b))
    if group:
        yield group


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content
