"""A receiver's flags of interference, also those that u-blox's ROS drivers publish in the namespace of NavSatFix.

MON-HW and NAV-STATUS of ublox_msgs have UBX's own layout (u-blox M8 and F9 interface descriptions); SEC-SIG of ublox_ubx_msgs
begins with a Header.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from models.messages import Array, ReceiverState

_HEAD: Final = 4  # bytes of encapsulation
_SUSPECTED, _DETECTED = 2, 3  # of jamming and spoofing
_STATE_BITS: Final = 12  # of NavSatStatus.service, where ReceiverState begins
_FRESH_NS: Final = 5_000_000_000  # a driver that sends no flags any more reports nothing
FLAGS: Final = {  # name in the driver's namespace -> its type
    "monhw": "ublox_msgs/msg/MonHW",
    "navstatus": "ublox_msgs/msg/NavSTATUS",
    "ubx_sec_sig": "ublox_ubx_msgs/msg/UBXSecSig",
}


def receiver_state(jamming: Array, spoofing: Array) -> Array:
    """Of PX4's, MAVLink's and UBX's: 0 unknown, 1 none, 2 mitigated or suspected, 3 detected."""
    disturbed = (jamming == _DETECTED) | (spoofing == _SUSPECTED)
    return np.where(
        spoofing == _DETECTED, ReceiverState.SPOOFED, np.where(disturbed, ReceiverState.JAMMED, ReceiverState.UNKNOWN)
    )


def reported(jamming: int, spoofing: int) -> ReceiverState:
    """The same of one message."""
    return ReceiverState(int(receiver_state(np.array(jamming), np.array(spoofing))))


def state_of(schema: str, data: bytes) -> ReceiverState:
    """What a message of CDR bytes reports; too short: nothing."""
    try:
        if schema == FLAGS["monhw"]:
            return reported(data[_HEAD + 22] >> 2 & 3, 0)
        if schema == FLAGS["navstatus"]:
            return reported(0, data[_HEAD + 7] >> 3 & 3)
        at = _after_header(data)  # version, detection enabled, state, detection enabled, state
        return reported(data[at + 2], data[at + 4])
    except (IndexError, struct.error):
        return ReceiverState.UNKNOWN


class ReceiverFlags:
    """The newest flags in the namespace of each topic of NavSatFix, put into its messages."""

    def __init__(self, fixes: Sequence[str]) -> None:
        namespaces = {topic: topic.rpartition("/")[0] for topic in fixes}
        self.topics: Mapping[str, str] = {
            f"{where}/{name}": schema for where in namespaces.values() for name, schema in FLAGS.items()
        }
        self._of_fix = {topic: [f"{where}/{name}" for name in FLAGS] for topic, where in namespaces.items()}
        self._states: dict[str, tuple[int, ReceiverState]] = {}

    def hear(self, topic: str, data: bytes, now_ns: int) -> None:
        """A message of `topics`."""
        self._states[topic] = now_ns, state_of(self.topics[topic], data)

    def marked(self, topic: str, data: bytes, now_ns: int) -> bytes:
        """A NavSatFix with the flags in NavSatStatus.service, as landfix logs them."""
        known = [self._states[name] for name in self._of_fix.get(topic, ()) if name in self._states]
        state = max((s for t_ns, s in known if now_ns - t_ns < _FRESH_NS), default=ReceiverState.UNKNOWN)
        if state is ReceiverState.UNKNOWN:
            return data
        try:
            at = _after_header(data) + 1  # int8 status, uint16 service
            at += (at - _HEAD) % 2
            order = "<H" if data[1] & 1 else ">H"
            (service,) = struct.unpack_from(order, data, at)
        except (IndexError, struct.error):
            return data
        return data[:at] + struct.pack(order, service & (1 << _STATE_BITS) - 1 | state << _STATE_BITS) + data[at + 2 :]


def _after_header(data: bytes) -> int:
    """Where the first byte behind a std_msgs/Header stands."""
    (length,) = struct.unpack_from("<I" if data[1] & 1 else ">I", data, _HEAD + 8)
    return _HEAD + 12 + int(length)
