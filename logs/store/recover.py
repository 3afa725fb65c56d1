"""All whole records of a damaged log into a new file."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import msgspec
from mcap.records import Attachment, Metadata

from logs.store.mcap_writer import McapWriter
from logs.store.records import LogError, RecordFile

_CHUNK_BYTES: Final = 1024 * 1024
_PROGRESS_EVERY: Final = 10_000  # messages


class RecoverSummary(msgspec.Struct, frozen=True):
    """Counts kept and lost."""

    messages: int
    attachments: int
    metadata: int
    chunks_lost: int  # damaged places, each at least one chunk
    messages_lost: int | None  # None: the writer's count is lost as well
    orphans: int  # messages that were whole, but of a channel whose definition was lost
    torn: bool  # the file had no proper end
    bytes_read: int
    bytes_written: int

    def __str__(self) -> str:
        kept = f"{self.messages} messages, {self.attachments} attachments and {self.metadata} metadata records kept"
        lost = f"{self.chunks_lost} damaged places skipped"
        if self.messages_lost is not None:
            lost += f", {self.messages_lost} messages lost"
        if self.orphans:
            lost += f", {self.orphans} messages of unknown channels left out"
        end = "the file had been cut off" if self.torn else "the file had a proper end"
        return f"{kept}; {lost}; {end}"


def recover(
    src: str | os.PathLike[str], dst: str | os.PathLike[str], progress: Callable[[float], None] | None = None
) -> RecoverSummary:
    """Write whole records of `src` to `dst`, atomically; progress: fraction. Raises LogError."""
    source, target = Path(src), Path(dst)
    records = RecordFile(source)
    part = target.with_name(target.name + ".part")
    try:
        if target.exists() and target.samefile(source):
            raise LogError(f"{target}: the output would overwrite the input; name another file")
        messages = _rewrite(records, part, progress)
        part.replace(target)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise LogError(f"{target}: cannot be written ({(error.strerror or 'unknown error').lower()})") from None
    finally:
        records.close()
    return RecoverSummary(
        messages=messages,
        attachments=len(records.attachments),
        metadata=len(records.metadata),
        chunks_lost=records.skipped_chunks,
        messages_lost=None if records.expected is None else records.expected - messages,
        orphans=records.orphans,
        torn=records.torn,
        bytes_read=records.size,
        bytes_written=target.stat().st_size,
    )


def _rewrite(records: RecordFile, path: Path, progress: Callable[[float], None] | None) -> int:
    count = attachments = metadata = 0
    channels: dict[int, int] = {}
    schemas = {0: 0}  # 0: none
    path.unlink(missing_ok=True)  # of one that was killed; a link in its place is not followed
    with path.open("xb") as file:
        writer = McapWriter(file, _CHUNK_BYTES)
        writer.start(profile=records.profile, library="landfix recover")
        for channel_id, sequence, log_time, publish_time, data in records:
            if count == 0:  # what stood at the file's beginning stands there again: it says which part of a flight this is
                attachments, metadata = len(records.attachments), len(records.metadata)
                _keep(writer, records.attachments, records.metadata)
            if channel_id not in channels:
                channels[channel_id] = _register(writer, records, channel_id, schemas)
            writer.add_message(channels[channel_id], log_time, data, publish_time, sequence)
            count += 1
            if progress and count % _PROGRESS_EVERY == 0:
                progress(records.fraction)
        _keep(writer, records.attachments[attachments:], records.metadata[metadata:])
        writer.finish()
    return count


def _keep(writer: McapWriter, attachments: Sequence[Attachment], metadata: Sequence[Metadata]) -> None:
    for a in attachments:
        writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
    for m in metadata:
        writer.add_metadata(m.name, m.metadata)


def _register(writer: McapWriter, records: RecordFile, channel_id: int, schemas: dict[int, int]) -> int:
    channel = records.channels[channel_id]
    if channel.schema_id not in schemas:
        schema = records.schemas.get(channel.schema_id)
        schemas[channel.schema_id] = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
    return writer.register_channel(channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata)
