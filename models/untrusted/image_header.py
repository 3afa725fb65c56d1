"""Size and depth of an image by its header, before it is decoded.

JPEG (ITU-T T.81, B.2.2), PNG (ISO 15948, 11.2.2), TIFF 6.0 and BigTIFF, BMP, WebP (RFC 9649), PBM to PPM (Netpbm).
"""

import mmap
import re
import struct
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from models.untrusted.file import opened
from models.untrusted.limits import BINARY_RATIO, allowed

Bytes: TypeAlias = bytes | memoryview | mmap.mmap


class ImageHeader(NamedTuple):
    """Declared size; bytes_a_pixel: decoded, at least; scans: times that a JPEG's decoder visits all pixels."""

    width: int
    height: int
    bytes_a_pixel: int
    scans: int = 1

    @property
    def pixels(self) -> int:
        """Width times height."""
        return self.width * self.height


_NO_FRAME: Final = frozenset({0xC4, 0xC8, 0xCC})  # among the frame headers SOF0 to SOF15: tables
_SCAN: Final = re.compile(rb"\xff\xda")  # SOS: within a scan 0xFF is followed by 0 or a restart marker
_MOST_SCANS: Final = 100  # progressive ones have about 10, and those of a preview
_ALONE: Final = frozenset({0x01, *range(0xD0, 0xD9)})  # JPEG markers without a segment
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 3, 4: 4, 6: 4}  # as decoded: a palette becomes colours
_PNM: Final = re.compile(rb"P([1-6])" + rb"(?:\s|#[^\n]*\n)+(\d{1,9})" * 2 + rb"(?:(?:\s|#[^\n]*\n)+(\d{1,6}))?")
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_COLOUR, _TIFF_SAMPLES = 256, 257, 258, 262, 277
_TIFF_PALETTE: Final = 3
_TIFF_SIZES: Final = {3: "H", 4: "I", 16: "Q"}


def image_header(data: Bytes) -> ImageHeader | None:
    """Header of a file by its first bytes; None: unknown format, or torn."""
    for magic, read in _FORMATS.items():
        if data[: len(magic)] == magic:
            try:
                found = read(data)
            except (struct.error, IndexError):
                return None
            return found if found is not None and found.width > 0 and found.height > 0 else None
    return None


def image_header_of_file(path: Path) -> ImageHeader | None:
    """As image_header; nothing but the header is read. Raises OSError."""
    with opened(path) as file:
        if not file.read(1):
            return None
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return image_header(data)


def too_large(header: ImageHeader, size: int, most_pixels: int) -> str:
    """Why an image in `size` bytes is not decoded; empty if it may be."""
    declared = f"declares {header.width} x {header.height} pixels"
    if header.pixels > most_pixels:
        return f"{declared}, {most_pixels} are read at most"
    if header.pixels * header.bytes_a_pixel > allowed(size, BINARY_RATIO):
        return f"{declared} in {size} bytes"
    if header.scans > _MOST_SCANS:
        return f"{declared} in more than {_MOST_SCANS} scans"
    return ""


def _jpeg(data: Bytes) -> ImageHeader | None:
    at = 2
    while True:
        if data[at] != 0xFF:
            return None
        marker = data[at + 1]
        if marker == 0xFF or marker in _ALONE:
            at += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in _NO_FRAME:
            bits, height, width, channels = struct.unpack_from(">BHHB", data, at + 4)
            scans = sum(1 for _ in islice(_SCAN.finditer(data, at), _MOST_SCANS + 1))
            return ImageHeader(width, height, (1 if channels == 1 else 3) * (1 if bits <= 8 else 2), scans)
        (length,) = struct.unpack_from(">H", data, at + 2)
        at += 2 + length


def _png(data: Bytes) -> ImageHeader | None:
    if data[12:16] != b"IHDR":
        return None
    width, height, bits, colour = struct.unpack_from(">IIBB", data, 16)
    return ImageHeader(width, height, _PNG_CHANNELS.get(colour, 4) * (2 if bits == 16 else 1))


def _bmp(data: Bytes) -> ImageHeader | None:
    (size,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if size == 12 else "<ii", data, 18)
    return ImageHeader(width, abs(height), 3)


def _webp(data: Bytes) -> ImageHeader | None:
    match data[8:16]:
        case b"WEBPVP8 ":
            width, height = struct.unpack_from("<HH", data, 26)
            return ImageHeader(width & 0x3FFF, height & 0x3FFF, 3)
        case b"WEBPVP8L":
            (bits,) = struct.unpack_from("<I", data, 21)
            return ImageHeader(1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF), 4)
        case b"WEBPVP8X":
            width, height = (int.from_bytes(data[k : k + 3], "little") for k in (24, 27))
            return ImageHeader(1 + width, 1 + height, 4)
    return None


def _pnm(data: Bytes) -> ImageHeader | None:
    found = _PNM.match(data[:4096])
    if found is None:
        return None
    channels = 3 if found[1] in b"36" else 1
    return ImageHeader(int(found[2]), int(found[3]), channels * (2 if int(found[4] or 1) > 255 else 1))


def _tiff(data: Bytes) -> ImageHeader | None:
    order, big = "<" if data[:2] == b"II" else ">", data[2:4] in (b"+\0", b"\0+")
    (start,) = struct.unpack_from(f"{order}{'Q' if big else 'I'}", data, 8 if big else 4)
    (count,) = struct.unpack_from(f"{order}{'Q' if big else 'H'}", data, start)
    entry, size, inline = (start + 8, 20, 12) if big else (start + 2, 12, 8)
    tags = {}
    for k in range(min(count, 4096)):
        at = entry + size * k
        tag, kind = struct.unpack_from(f"{order}HH", data, at)
        if kind in _TIFF_SIZES:
            (number,) = struct.unpack_from(f"{order}{'Q' if big else 'I'}", data, at + 4)
            form = f"{order}{_TIFF_SIZES[kind]}"
            place = at + inline
            if number * struct.calcsize(form) > size - inline:  # several values stand elsewhere; the first is enough
                (place,) = struct.unpack_from(f"{order}{'Q' if big else 'I'}", data, place)
            (tags[tag],) = struct.unpack_from(form, data, place)
    if _TIFF_WIDTH not in tags or _TIFF_HEIGHT not in tags:
        return None
    channels = 3 if tags.get(_TIFF_COLOUR) == _TIFF_PALETTE else tags.get(_TIFF_SAMPLES, 1)
    return ImageHeader(tags[_TIFF_WIDTH], tags[_TIFF_HEIGHT], channels * -(-tags.get(_TIFF_BITS, 1) // 8))


_FORMATS: Final[dict[bytes, Callable[[Bytes], ImageHeader | None]]] = {
    b"\xff\xd8\xff": _jpeg,
    b"\x89PNG\r\n\x1a\n": _png,
    **dict.fromkeys((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"), _tiff),
    b"BM": _bmp,
    b"RIFF": _webp,
    **dict.fromkeys((b"P1", b"P2", b"P3", b"P4", b"P5", b"P6"), _pnm),
}
