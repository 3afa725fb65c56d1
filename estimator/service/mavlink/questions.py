"""Questions to an autopilot on the ground."""

import struct
import time
from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from contextlib import closing
from pathlib import Path
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from estimator.service.mavlink import codec
from estimator.service.mavlink.config import MavlinkConfig, address_of, signing_key
from estimator.service.mavlink.io import opened
from estimator.service.mavlink.wire import Wire
from models.messages import Vec3

_PATIENCE_S: Final = 10.0  # for its HEARTBEAT
_ROUND_S, _ROUNDS = 1.0, 4  # what has not come after a round is asked for again
_AT_ONCE: Final = 8  # questions in a row, so that none is lost in a small buffer
_PAUSE_S: Final = 0.05
_LISTENED_TO: Final = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_PARAM_VALUE,
        mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    }
)
_INTEGERS: Final = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B3x",
    mavlink.MAV_PARAM_TYPE_INT8: "<b3x",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H2x",
    mavlink.MAV_PARAM_TYPE_INT16: "<h2x",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


class Answers(NamedTuple):
    """autopilot: of HEARTBEAT; version: "4.6.3" or ""; origin: degrees, m above the sea, or None."""

    autopilot: int
    version: str
    parameters: dict[str, float]
    origin: Vec3 | None


def ask(config: MavlinkConfig, folder: Path, names: dict[int, tuple[str, ...]]) -> Answers | None:
    """None: no autopilot. names: parameters by autopilot. Raises ConfigError where its port is taken."""
    with closing(opened(address_of(config))) as endpoint:
        talk = _Talk(config, folder, endpoint)
        end = time.monotonic() + _PATIENCE_S
        while talk.autopilot is None:
            if time.monotonic() > end:
                return None
            talk.greet()
            talk.listen(0.2)
        wanted = set(names.get(talk.autopilot, ()))
        for _ in range(_ROUNDS):
            talk.greet()
            talk.ask_for(sorted(wanted - talk.parameters.keys()))
            if talk.listen(_ROUND_S, wanted):
                break
        return Answers(talk.autopilot, talk.version, talk.parameters, talk.origin)


class _Talk:
    def __init__(self, config: MavlinkConfig, folder: Path, endpoint: Any) -> None:
        key, heard = signing_key(config, folder), frozenset(config.listen_to)
        self._in, self._out = (
            Wire(config.system, config.component, heard, _LISTENED_TO, key, time.time_ns()) for _ in ("parse", "pack")
        )
        self._config, self._endpoint, self._peer = config, endpoint, None
        self.autopilot: int | None = None
        self.version = ""
        self.origin: Vec3 | None = None
        self.parameters: dict[str, float] = {}

    def greet(self) -> None:
        """HEARTBEAT: some answer only those who are there."""
        kind, none = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
        self._say(mavlink.MAVLink_heartbeat_message(kind, none, 0, 0, mavlink.MAV_STATE_ACTIVE, 3))

    def ask_for(self, names: Iterable[str]) -> None:
        system, component = self._config.system, mavlink.MAV_COMP_ID_AUTOPILOT1
        unknown = {
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: not self.version,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: not self.origin,
        }
        for number in (number for number, asked in unknown.items() if asked):
            command = mavlink.MAV_CMD_REQUEST_MESSAGE
            self._say(mavlink.MAVLink_command_long_message(system, component, command, 0, number, 0, 0, 0, 0, 0, 0))
        for k, name in enumerate(names):
            if k % _AT_ONCE == _AT_ONCE - 1:
                self.listen(_PAUSE_S)
            self._say(mavlink.MAVLink_param_request_read_message(system, component, name.encode(), -1))

    def listen(self, seconds: float, wanted: AbstractSet[str] | None = None) -> bool:
        end, complete = time.monotonic() + seconds, False
        while not complete and (left_s := end - time.monotonic()) > 0.0:
            heard = self._endpoint.receive(left_s)
            for message in self._in.messages(heard.data, whole=self._endpoint.whole) if heard else ():
                self._peer = heard.sender
                self._take(message)
            complete = wanted is not None and wanted <= self.parameters.keys() and bool(self.version and self.origin)
        return complete

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID:
            self.autopilot = message.autopilot
        elif kind == "PARAM_VALUE":
            self.parameters[message.param_id] = _value(message, self.autopilot)
        elif kind == "AUTOPILOT_VERSION" and message.flight_sw_version:
            self.version = ".".join(str(message.flight_sw_version >> shift & 0xFF) for shift in (24, 16, 8))
        elif kind == "GPS_GLOBAL_ORIGIN":
            self.origin = message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3

    def _say(self, message: Any) -> None:
        frame = self._out.packed(message)
        if frame is not None:
            self._endpoint.send(frame, self._peer)


def _value(message: Any, autopilot: int | None) -> float:
    """ArduPilot sends integers as numbers, PX4 as the bytes of the float."""
    layout = _INTEGERS.get(message.param_type)
    if autopilot == codec.ARDUPILOT or layout is None:
        return float(message.param_value)
    return float(struct.unpack(layout, struct.pack("<f", message.param_value))[0])
