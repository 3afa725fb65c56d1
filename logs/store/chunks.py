"""A chunk's content, bounded: a small file cannot make its reader use much memory or time.

A chunk declares the size of its content. It is decompressed to that size at most, and only where that size is allowed: for one
chunk by MOST_BYTES, for all chunks read so far by SPARE_BYTES + MOST_RATIO x the bytes of the file that were read.
"""

import zlib
from io import BytesIO
from typing import Final

import lz4.frame
import zstandard
from mcap.records import Chunk

MOST_BYTES: Final = 256 * 2**20  # of one chunk; writers use 1 to 4 MiB, or one large message
SPARE_BYTES: Final = 2 * 2**30
MOST_RATIO: Final = 1000  # black images reach it, over a whole log
_MIB: Final = 2**20


class TooLargeError(ValueError):
    """A chunk declares more than is read."""


def content_of(chunk: Chunk, allowed: int) -> bytes:
    """The records of a chunk, decompressed and checked against its size and CRC.

    allowed: bytes that may still be decompressed. Raises TooLargeError where the chunk declares more, ValueError or the
    decompressor's exception where it is damaged.
    """
    size = chunk.uncompressed_size
    most = min(MOST_BYTES, allowed)
    if size > most:
        raise TooLargeError(
            f"a chunk of {len(chunk.data)} bytes declares {size / _MIB:.0f} MiB of content, {most / _MIB:.0f} are read at most: "
            "it was not recorded by a logger"
        )
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
