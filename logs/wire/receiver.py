"""A receiver's flags of interference, also those that ROS drivers publish in the namespace of NavSatFix.

MON-HW and NAV-STATUS of ublox_msgs have UBX's own layout (u-blox M8 and F9 interface descriptions); SEC-SIG and NAV-STATUS of
ublox_ubx_msgs and Septentrio's AIM+ (spoofing found by OSNMA, or by its own test) begin with a Header.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from models.messages import Array, ReceiverState

_HEAD: Final = 4  # bytes of encapsulation
_GAIN: Final = 8191  # largest count of u-blox's automatic gain control
_AUTHENTICATION: Final = {1: "authentication begins", 2: "authentication cannot begin", 3: "authenticated"}
_SUSPECTED, _DETECTED = 2, 3  # of jamming and spoofing
_STATE_BITS: Final = 12  # of NavSatStatus.service, where ReceiverState begins
_FRESH_NS: Final = 5_000_000_000  # a driver that sends no flags any more reports nothing
FLAGS: Final = {  # name in the driver's namespace -> its type
    "monhw": "ublox_msgs/msg/MonHW",
    "navstatus": "ublox_msgs/msg/NavSTATUS",
    "ubx_sec_sig": "ublox_ubx_msgs/msg/UBXSecSig",
    "ubx_nav_status": "ublox_ubx_msgs/msg/UBXNavStatus",
    "aimplusstatus": "septentrio_gnss_driver/msg/AIMPlusStatus",
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


def reception(noise: float, gain: float, indicator: float, authentication: int = 0) -> str:
    """Of u-blox's MON-HW (gain of 8191, jamming indicator of 255) and GPS_AUTHENTICATION_STATE, which judges no position; 0 is
    not given.
    """
    given = (
        (indicator, f"jamming indicator {indicator:.0f} of 255"),
        (gain, f"gain {100.0 * gain / _GAIN:.0f} %"),
        (noise, f"noise {noise:.0f}"),
        (authentication, _AUTHENTICATION.get(authentication, "")),
    )
    return ", ".join(words for value, words in given if value > 0 and words)


def state_of(schema: str, data: bytes) -> ReceiverState:
    """What a message of CDR bytes reports; too short: nothing."""
    try:
        if schema == FLAGS["monhw"]:
            return reported(data[_HEAD + 22] >> 2 & 3, 0)
        if schema == FLAGS["navstatus"]:
            return reported(0, data[_HEAD + 7] >> 3 & 3)
        at = _after_header(data)
        if schema == FLAGS["aimplusstatus"]:  # uint32, uint16; interference: 0 none, 1 mitigated, 2 present; spoofing: 1, 2, 3
            at += -at % 4 + 6
            return reported(data[at] + 1, _DETECTED if data[at + 1] in {1, 2, 3} else 0)
        if schema == FLAGS["ubx_nav_status"]:  # uint32 and nine bytes before
            return reported(0, data[at + -at % 4 + 13])
        return reported(data[at + 2], data[at + 4])  # version, detection enabled, state, detection enabled, state
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
