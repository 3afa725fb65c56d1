"""A ROS 1 bag without an index, record by record ("Bags/Format/2.0" of the ROS wiki).

    record = header length, header, data length, data      header = (length, "name=value")*      all lengths uint32

op 5: a chunk of records; op 7: a connection with its type; op 2: a message.
"""

import bz2
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame

from models.untrusted.file import opened
from models.untrusted.limits import PIECE_BYTES, TooLargeError, allowed, check

_MAGIC: Final = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_KEPT_BYTES: Final = 64 * 2**20
_LENGTH: Final = struct.Struct("<I")
_UNPACK: Final[Mapping[str, Callable[[bytes, int], bytes]]] = {  # to so many bytes at most
    "none": lambda data, _: data,
    "bz2": lambda data, most: bz2.BZ2Decompressor().decompress(data, most),
    "lz4": lambda data, most: bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, most)),
}


class Unpacker:
    """Contents of a bag's chunks, bounded in total by its size."""

    def __init__(self, size: int) -> None:
        self._left = allowed(size)
        self._kept: dict[int, bytes] = {}

    def __call__(self, compression: str, data: bytes, chunk: int | None = None) -> bytes:
        """Raises TooLargeError; KeyError: unknown compression; the decompressor's errors."""
        if chunk is not None and chunk in self._kept:
            return self._kept[chunk]
        most = min(self._left, PIECE_BYTES)
        content = _UNPACK[compression](data, most + 1)
        check(len(content), len(data), most)
        self._left -= len(content)
        if chunk is not None:
            self._kept[chunk] = content
            while len(self._kept) > 1 and sum(map(len, self._kept.values())) > _KEPT_BYTES:
                del self._kept[next(iter(self._kept))]
        return content


def messages(path: Path) -> Iterator[tuple[str, str, int, bytes, float]]:
    """(topic, type, arrival [ns], bytes, share of the file) before the first torn record. Raises ValueError."""
    connections: dict[bytes, tuple[str, str]] = {}
    size = path.stat().st_size
    with opened(path) as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("no ROS 1 bag of version 2.0")
        whole, unpack = 0, Unpacker(size)
        for header, data in _records(file):
            whole += 1
            parts = _of_chunk(header, data, unpack) if header.get(b"op") == bytes([_CHUNK]) else [(header, data)]
            for inner, content in parts:
                if inner.get(b"op") == bytes([_CONNECTION]):
                    about = _fields(content)
                    connections[inner[b"conn"]] = inner[b"topic"].decode(), _ros2_name(about[b"type"].decode())
                elif inner.get(b"op") == bytes([_MESSAGE]) and inner[b"conn"] in connections:
                    sec, nsec = struct.unpack("<II", inner[b"time"])
                    yield *connections[inner[b"conn"]], sec * 1_000_000_000 + nsec, content, file.tell() / size
        if not whole:
            raise ValueError("no whole record")


def _records(file: BinaryIO) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    while True:
        blocks = []
        for _ in range(2):
            length = file.read(_LENGTH.size)
            if len(length) < _LENGTH.size or (n := _LENGTH.unpack(length)[0]) > PIECE_BYTES:
                return
            blocks.append(file.read(n))
        torn = len(blocks[1]) < n
        try:
            header = _fields(blocks[0])
        except ValueError:
            return
        if not torn or header.get(b"op") == bytes([_CHUNK]):
            yield header, blocks[1]
        if torn:
            return


def _of_chunk(header: dict[bytes, bytes], data: bytes, unpack: Unpacker) -> list[tuple[dict[bytes, bytes], bytes]]:
    try:
        content = unpack(header[b"compression"].decode(), data)
    except TooLargeError:
        raise
    except (KeyError, OSError, RuntimeError, ValueError, EOFError):
        return []
    found, at = [], 0
    while at + _LENGTH.size <= len(content):
        blocks = []
        for _ in range(2):
            (n,) = _LENGTH.unpack_from(content, at) if at + _LENGTH.size <= len(content) else (PIECE_BYTES,)
            blocks.append(content[at + _LENGTH.size : at + _LENGTH.size + n])
            at += _LENGTH.size + n
        if at > len(content):
            break
        found.append((_fields(blocks[0]), blocks[1]))
    return found


def _fields(block: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at < len(block):
        if at + _LENGTH.size > len(block):
            raise ValueError("torn header")
        (n,) = _LENGTH.unpack_from(block, at)
        at += _LENGTH.size
        name, equals, value = block[at : at + n].partition(b"=")
        if not equals or at + n > len(block):
            raise ValueError("torn header")
        fields[name] = value
        at += n
    return fields


def _ros2_name(name: str) -> str:
    package, _, kind = name.partition("/")
    return f"{package}/msg/{kind}"
