"""MCAP writer: LZ4, same bytes as mcap.writer.Writer at a third of its cost (mcap.dev/spec)."""

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import BinaryIO, Final

import lz4.frame
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC as MAGIC

_MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_OPCODE: Final = int(Opcode.MESSAGE)
_MESSAGE_HEAD: Final = 22  # bytes of a message's content before its data
_INDEX: Final = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
_FOOTER: Final = struct.Struct("<BQQQ")  # opcode, length, summary start, summary offset start


class McapWriter:
    """Writes to an open binary file: start(), schemas, channels, records, finish()."""

    def __init__(self, file: BinaryIO, chunk_bytes: int) -> None:
        self._file = file
        self._chunk_bytes = chunk_bytes
        self._block = bytearray()  # the open chunk
        self._entries: dict[int, list[int]] = {}  # of the open chunk, by channel: log time, offset, log time, offset, ...
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[bytes] = []  # index records, packed: a day's flight has a million of them
        self._times: tuple[int, int] | None = None  # earliest and latest log time
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}

    def start(self, profile: str, library: str) -> None:
        """Write the file's beginning."""
        self._file.write(MAGIC)
        self._put(Header(profile, library))

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Define a type; its id."""
        schema = Schema(id=len(self._schemas) + 1, data=data, encoding=encoding, name=name)
        self._schemas.append(schema)
        self._define(schema)
        return schema.id

    def register_channel(self, topic: str, encoding: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Define a topic; its id."""
        channel = Channel(len(self._channels) + 1, topic, encoding, dict(metadata), schema_id)
        self._channels.append(channel)
        self._define(channel)
        return channel.id

    def add_message(self, channel: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """Add a message; times >= 0, ns."""
        block = self._block
        head = _MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE_HEAD + len(data), channel, sequence, log_time, publish_time)
        entries = self._entries.get(channel)
        if entries is None:
            entries = self._entries[channel] = []
        entries += (log_time, len(block))
        block += head
        block += data
        if len(block) > self._chunk_bytes:
            self._close_chunk()

    def add_attachment(self, create_time: int, log_time: int, name: str, media_type: str, data: bytes) -> None:
        """Keep a file in the log."""
        offset = self._file.tell()
        length = self._put(Attachment(create_time, log_time, name, media_type, data))
        self._attachments.append(AttachmentIndex(offset, length, log_time, create_time, len(data), name, media_type))

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Keep keys and values in the log."""
        offset = self._file.tell()
        self._metadata.append(MetadataIndex(offset, self._put(Metadata(name, dict(data))), name))

    def flush(self) -> None:
        """Close the chunk and flush."""
        self._close_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write summary, index, statistics, end; the file stays open."""
        self._close_chunk()
        self._put(DataEnd(0))
        start, summary = self._file.tell(), RecordBuilder()
        groups: list[tuple[Opcode, Iterable[bytes]]] = [
            (Opcode.SCHEMA, map(_packed, self._schemas)),
            (Opcode.CHANNEL, map(_packed, self._channels)),
            (Opcode.STATISTICS, [_packed(self._statistics())]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, map(_packed, self._attachments)),
            (Opcode.METADATA_INDEX, map(_packed, self._metadata)),
        ]
        offsets = []
        for opcode, records in groups:
            begin = summary.count
            for record in records:
                summary.write(record)
            offsets.append(SummaryOffset(opcode, start + begin, summary.count - begin))
        offset_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        content = _end(summary)
        crc = zlib.crc32(_FOOTER.pack(Opcode.FOOTER, 8 + 8 + 4, start, offset_start), zlib.crc32(content))
        self._file.write(content)
        self._put(Footer(start, offset_start, crc))
        self._file.write(MAGIC)

    def _define(self, record: Schema | Channel) -> None:
        self._block += _packed(record)
        if len(self._block) > self._chunk_bytes:
            self._close_chunk()

    def _close_chunk(self) -> None:
        """Write the chunk; the next begins empty in any case."""
        if not self._entries:
            return
        block, entries = bytes(self._block), self._entries
        self._block, self._entries = bytearray(), {}
        times = [time for of_channel in entries.values() for time in of_channel[::2]]
        data = lz4.frame.compress(block)
        offset = self._file.tell()
        length = self._put(Chunk("lz4", data, max(times), min(times), zlib.crc32(block), len(block)))
        index_offsets, at = {}, offset + length
        for channel, of_channel in entries.items():
            size = 8 * len(of_channel)
            head = _INDEX.pack(Opcode.MESSAGE_INDEX, 2 + 4 + size, channel, size)
            self._file.write(head + struct.pack(f"<{len(of_channel)}Q", *of_channel))
            index_offsets[channel] = at
            at += len(head) + size
            self._counts[channel] = self._counts.get(channel, 0) + len(of_channel) // 2
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=offset,
            compression="lz4",
            compressed_size=len(data),
            message_end_time=max(times),
            message_index_length=at - offset - length,
            message_index_offsets=index_offsets,
            message_start_time=min(times),
            uncompressed_size=len(block),
        )
        self._chunks.append(_packed(index))
        first, last = self._times or (index.message_start_time, index.message_end_time)
        self._times = min(first, index.message_start_time), max(last, index.message_end_time)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_end_time=self._times[1] if self._times else 0,
            message_start_time=self._times[0] if self._times else 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put(self, record: McapRecord) -> int:
        packed = _packed(record)
        self._file.write(packed)
        return len(packed)


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _end(builder)


def _end(builder: RecordBuilder) -> bytes:
    content: bytes = builder.end()  # type: ignore[no-untyped-call]
    return content
