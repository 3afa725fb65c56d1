"""One bound for all that is unpacked or decoded; n: bytes of the file read so far.

    allowed(n) = SPARE_BYTES + ratio n
    records(n) = SPARE_RECORDS + n

A piece unpacked at once: PIECE_BYTES; a text: TEXT_BYTES.
"""

from typing import Final

SPARE_BYTES: Final = 256 * 2**20
PIECE_BYTES: Final = 256 * 2**20  # writers of logs use chunks of 1 to 4 MiB, or one large message
TEXT_BYTES: Final = 2 * 2**30
FILE_BYTES: Final = 2 * 2**30  # of a file that is read at once
PIPE_BYTES: Final = 64 * 2**20  # of one that does not say how long it is
BINARY_RATIO: Final = 1000  # black images reach it, over a whole log
TEXT_RATIO: Final = 100  # CSV and GeoJSON: 5 to 20
SPARE_RECORDS: Final = 100_000  # then one a byte: a message takes two bytes at least where its stamps are not all the same
CAMERA_PIXELS: Final = 100_000_000  # of a camera's image; the largest cameras of survey have as many
_MIB: Final = 2**20


class TooLargeError(ValueError):
    """More would come out than is allowed; one line."""


def allowed(read_bytes: int, ratio: int = BINARY_RATIO) -> int:
    """Bytes allowed out of so many."""
    return SPARE_BYTES + ratio * read_bytes


def check(declared: int, packed: int, most: int, what: str = "a chunk") -> None:
    """Raises TooLargeError where `packed` bytes declare more than `most` or PIECE_BYTES."""
    most = min(most, PIECE_BYTES)
    if declared > most:
        raise TooLargeError(
            f"{what} of {packed} bytes declares {declared / _MIB:.0f} MiB of content, {max(most, 0) / _MIB:.0f} are read at most"
        )


def check_records(count: int, read_bytes: int) -> None:
    """Raises TooLargeError for too many records in so many bytes."""
    if count > (most := SPARE_RECORDS + read_bytes):
        raise TooLargeError(f"more than {most} records are packed into {read_bytes} bytes")
