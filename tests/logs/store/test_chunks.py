"""A small file cannot make its reader use much memory or time."""

import struct
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC as MAGIC

from logs.store import chunks
from logs.store.chunks import content_of
from logs.store.reader import LogError, LogReader
from logs.store.records import RecordFile
from logs.store.recover import recover
from models.untrusted.limits import PIECE_BYTES as MOST_BYTES
from models.untrusted.limits import TooLargeError
from tests.logs.store.test_reader import read, record

CONTENT = b"\0" * 3_000_000
PACKED = {"zstd": zstandard.compress(CONTENT), "lz4": lz4.frame.compress(CONTENT), "": CONTENT}


def _chunk(compression: str, size: int, data: bytes | None = None) -> Chunk:
    return Chunk(compression, PACKED[compression] if data is None else data, 0, 0, zlib.crc32(CONTENT), size)


def _record(compression: str, size: int, data: bytes) -> bytes:
    body = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression.encode() + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


@pytest.mark.parametrize("compression", PACKED)
def test_the_content_of_a_chunk(compression: str) -> None:
    assert content_of(_chunk(compression, len(CONTENT)), MOST_BYTES) == CONTENT


@pytest.mark.parametrize("compression", PACKED)
@pytest.mark.parametrize("size", [0, 10, len(CONTENT) - 1, len(CONTENT) + 1])
def test_another_size_than_declared_is_damage(compression: str, size: int) -> None:
    with pytest.raises(ValueError, match="another size"):
        content_of(_chunk(compression, size), MOST_BYTES)


@pytest.mark.parametrize("compression", PACKED)
def test_more_than_is_allowed_is_not_decompressed(compression: str) -> None:
    for size, allowed in ((MOST_BYTES + 1, 2**60), (len(CONTENT), len(CONTENT) - 1), (2**63, 2**60), (1, -5)):
        with pytest.raises(TooLargeError, match="at most"):
            content_of(_chunk(compression, size), allowed)


def test_a_file_of_nothing_but_a_bomb_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(MAGIC + _record("zstd", 2**31, PACKED["zstd"]))
    with (
        LogReader(path) as reader,
        pytest.raises(LogError, match=r"bomb.mcap: a chunk of .* declares 2048 MiB of content, 256 are"),
    ):
        list(reader)
    with pytest.raises(LogError, match="declares 2048 MiB"):
        recover(path, tmp_path / "out.mcap")


def test_a_bomb_in_a_log_costs_itself_only(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    written = record(path, 400)
    path.write_bytes(MAGIC + _record("zstd", 2**31, PACKED["zstd"]) + path.read_bytes()[len(MAGIC) :])
    messages, reader = read(path)
    assert messages == written
    assert reader.skipped_chunks == 1


def test_many_small_bombs_are_bounded_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("logs.store.records.allowed", lambda start: 10_000_000 + 10 * start)
    contents: list[int] = []
    unpack = chunks.content_of

    def noting(chunk: Chunk, allowed: int) -> bytes:
        content = unpack(chunk, allowed)
        contents.append(len(content))
        return content

    monkeypatch.setattr("logs.store.records.content_of", noting)
    path = tmp_path / "bombs.mcap"
    padding = struct.pack("<BQ", 0x80, len(CONTENT)) + CONTENT  # one private record of three megabytes
    bomb = _record("zstd", len(padding), zstandard.compress(padding))
    path.write_bytes(MAGIC + 100 * bomb)
    with LogReader(path) as reader, pytest.raises(LogError, match="declares 3 MiB"):
        list(reader)
    assert len(contents) == 3


def test_many_records_in_a_small_chunk_are_refused_in_one_line(tmp_path: Path) -> None:
    path, records = tmp_path / "dense.mcap", struct.pack("<BQ", 0x80, 0) * 2_000_000
    body = struct.pack("<QQQII", 0, 0, len(records), 0, 4) + b"zstd"
    packed = zstandard.compress(records)
    body += struct.pack("<Q", len(packed)) + packed
    path.write_bytes(MAGIC + struct.pack("<BQ", 6, len(body)) + body)
    with LogReader(path) as reader, pytest.raises(LogError, match=r"dense.mcap: more than \d+ records are packed into \d+ bytes"):
        list(reader)


def test_content_that_turns_out_damaged_counts_too(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    torn = struct.pack("<BQ", 5, 2**40) + CONTENT  # the first record is longer than its chunk
    path.write_bytes(MAGIC + 400 * _record("zstd", len(torn), zstandard.compress(torn)))
    file = RecordFile(path)
    with pytest.raises(LogError, match="declares 3 MiB"):
        list(file)
    assert file._decompressed < 256 * 2**20 + 1000 * file.size
    file.close()


def _work_of_a_chain(path: Path, links: int) -> tuple[int, int]:
    """Each link is a chunk that contains all links behind it, and none can be decompressed: bytes tried, size of the file."""
    data = b""
    for _ in range(links):
        data = _record("zstd", 10, data + b"\0" * 40)
    path.write_bytes(MAGIC + data)
    file = RecordFile(path)
    try:
        assert not list(file)
        return file._in_vain, file.size
    finally:
        file.close()


def test_chunks_within_chunks_are_read_in_linear_time(tmp_path: Path) -> None:
    for links in (300, 3000):
        work, size = _work_of_a_chain(tmp_path / "chain.mcap", links)
        assert 4 * size < work < 6 * size, "the bound was not reached, or does not hold"
