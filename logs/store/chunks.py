"""Chunk content, decompressed to its declared size where models.untrusted.limits allows."""

import zlib
from io import BytesIO

import lz4.frame
import zstandard
from mcap.records import Chunk

from models.untrusted.limits import check


def content_of(chunk: Chunk, allowed: int) -> bytes:
    """Records of a chunk, checked; allowed: bytes. Raises TooLargeError, ValueError, the decompressor's errors."""
    size = chunk.uncompressed_size
    check(size, len(chunk.data), allowed)
    if chunk.compression == "zstd":
        content = zstandard.ZstdDecompressor().stream_reader(BytesIO(chunk.data), read_across_frames=True).read(size + 1)
    elif chunk.compression == "lz4":
        content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif not chunk.compression:
        content = chunk.data
    else:
        raise ValueError(f"unknown compression {chunk.compression!r}")
    if len(content) != size:
        raise ValueError("a chunk's content has another size than it declares")
    if chunk.uncompressed_crc != 0 and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("a chunk fails its CRC")
    return bytes(content)
