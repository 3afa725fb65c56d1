"""pymavlink's codec with filters, signatures, bounded memory."""

import hmac
import math
import struct
from collections.abc import Iterator
from hashlib import sha256
from typing import Any, Final

from pymavlink.dialects.v20 import ardupilotmega, development
from pymavlink.dialects.v20 import common as mavlink

_EPOCH_2015_NS: Final = 1_420_070_400_000_000_000  # of signatures, in units of 10 us
_TICK_NS: Final = 10_000
_SIGNATURE: Final = 6  # bytes at the end of a signed frame
_KEPT: Final = 4096  # bytes already parsed that are kept at most
_V1: Final = 0xFE
_STARTS: Final = frozenset({_V1, 0xFD})
_NO_FRAME: Final = frozenset({"Bad prefix", "Invalid signature"})  # skipped already; a whole frame, of somebody else
_HEADER_V1, _HEADER_V2 = 6, 10
VISION_POSITION_DELTA: Final[int] = ardupilotmega.MAVLINK_MSG_ID_VISION_POSITION_DELTA  # of ArduPilot's dialect alone
_POSITION: Final = frozenset({"x", "y", "z"})
GNSS_INTEGRITY: Final[int] = development.MAVLINK_MSG_ID_GNSS_INTEGRITY  # not yet in the common dialect
mavlink.mavlink_map.setdefault(VISION_POSITION_DELTA, ardupilotmega.MAVLink_vision_position_delta_message)
mavlink.mavlink_map.setdefault(GNSS_INTEGRITY, development.MAVLink_gnss_integrity_message)


class Wire(mavlink.MAVLink):  # type: ignore[misc]
    """Frames <-> messages; listen_to: component ids; wanted: message ids; key: refuses unsigned."""

    buf: bytearray
    buf_index: int
    seq: int

    def __init__(
        self, system: int, component: int, listen_to: frozenset[int], wanted: frozenset[int], key: bytes | None, now_ns: int
    ) -> None:
        super().__init__(None, srcSystem=system, srcComponent=component)
        self.robust_parsing = True
        self._system, self._listen_to, self._wanted = system, listen_to, wanted
        self.damaged = self.passed_over = self.refused = 0
        if key is not None:
            self.signing.secret_key, self.signing.sign_outgoing = key, True
            self.signing.link_id = component
            self.signing.timestamp = max(0, now_ns - _EPOCH_2015_NS) // _TICK_NS

    def messages(self, data: bytes, *, whole: bool) -> Iterator[Any]:
        """Wanted messages; whole: no frame continues in the next data."""
        try:
            found = list(self._found(data))
        except Exception:  # IndexError, MAVError ... of the parser itself: what has come is counted as damaged
            self.damaged += 1
            self._forget()
            return
        if whole:
            self.damaged += bool(self.buf_len())
            self._forget()
        elif self.buf_index > _KEPT:
            del self.buf[: self.buf_index]
            self.buf_index = 0
        for message in found:
            if isinstance(message, mavlink.MAVLink_bad_data):
                if message.reason == "Invalid signature":
                    self.refused += 1
                else:
                    self.damaged += 1
            elif isinstance(message, mavlink.MAVLink_unknown):
                self.passed_over += 1
            else:
                yield message

    def _found(self, data: bytes) -> Iterator[Any]:
        message = self.parse_char(data)
        while message is not None:
            if self._is_false_start(message):
                self.buf, self.buf_index = bytearray(message.data[1:]) + self.buf[self.buf_index :], 0
                message = mavlink.MAVLink_bad_data(message.data[:1], "false start")
            yield message
            message = self.parse_char(b"")

    def _is_false_start(self, message: Any) -> bool:
        """A wrong checksum, or an unchecked frame that no frame follows."""
        if isinstance(message, mavlink.MAVLink_bad_data):
            return message.reason not in _NO_FRAME
        return isinstance(message, mavlink.MAVLink_unknown) and self.buf_len() > 0 and self.buf[self.buf_index] not in _STARTS

    def packed(self, message: Any) -> bytes | None:
        """The frame; None: a number does not fit."""
        try:
            data = bytes(message.pack(self)) if _is_finite(message) else b""
        except (struct.error, OverflowError):
            data = b""
        if not data:
            return None
        self.seq = (self.seq + 1) % 256
        return data

    def decode(self, frame: bytearray) -> Any:
        """Wanted messages only, checksum included."""
        if frame[0] == _V1:
            system, component, number = frame[3], frame[4], frame[5]
        elif len(frame) >= _HEADER_V2:
            system, component, number = frame[5], frame[6], int.from_bytes(frame[7:10], "little")
        else:
            raise mavlink.MAVError("short frame")
        if system != self._system or component not in self._listen_to or number not in self._wanted:
            return mavlink.MAVLink_unknown(number, frame)
        try:
            return super().decode(frame)
        except mavlink.MAVError:
            raise
        except Exception as error:  # struct.error, IndexError ...: costs this frame, not the others that came with it
            raise mavlink.MAVError(f"damaged frame: {error}") from None

    def check_signature(self, frame: bytearray, system: int, component: int) -> bool:
        """Verify the signature before its time stamp."""
        if not hmac.compare_digest(
            sha256(self.signing.secret_key + frame[:-_SIGNATURE]).digest()[:_SIGNATURE], frame[-_SIGNATURE:]
        ):
            return False
        return bool(super().check_signature(frame, system, component))

    def _forget(self) -> None:
        self.buf = bytearray()
        self.buf_index = 0
        self.expected_length = _HEADER_V1 + 2


def _is_finite(message: Any) -> bool:
    """Every number; PX4's ODOMETRY may lack its position."""
    names = set(message.fieldnames)
    if message.get_type() == "ODOMETRY" and message.frame_id == mavlink.MAV_FRAME_LOCAL_NED:
        names -= _POSITION if all(math.isnan(getattr(message, name)) for name in _POSITION) else set()
    values = (getattr(message, name) for name in names)
    numbers = (x for value in values for x in (value if isinstance(value, list) else [value]))
    return all(math.isfinite(x) for x in numbers if isinstance(x, float))
