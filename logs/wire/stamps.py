"""header.stamp of a message on the wire."""

import struct
from typing import Final

SECOND_NS: Final = 1_000_000_000
_LITTLE, _BIG = struct.Struct("<iI"), struct.Struct(">iI")
_HEAD: Final = 4  # bytes of encapsulation; a std_msgs/Header begins right behind


def stamp_of(data: bytes) -> int | None:
    """header.stamp of a CDR message with a leading Header, ns; None without."""
    if len(data) < _HEAD + _LITTLE.size:
        return None
    sec, nanosec = (_LITTLE if data[1] & 1 else _BIG).unpack_from(data, _HEAD)
    return None if nanosec >= SECOND_NS else sec * SECOND_NS + nanosec


def restamped(data: bytes, t_ns: int) -> bytes:
    """The same message with another header.stamp."""
    stamp = (_LITTLE if data[1] & 1 else _BIG).pack(*divmod(t_ns, SECOND_NS))
    return data[:_HEAD] + stamp + data[_HEAD + _LITTLE.size :]
