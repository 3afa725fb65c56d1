"""What the autopilot's EKF fuses: PX4's ESTIMATOR_SENSOR_FUSION_STATUS (1.18), ArduPilot's word of its source set."""

import re
import struct
from typing import Any, Final

from pymavlink.dialects.v20 import common as mavlink

NUMBER: Final = 514
_SOURCES: Final = (
    "GPS", "optical flow", "vision", "global position", "baro", "range finder", "magnetometer", "airspeed", "beacons",
)  # fmt: skip
_SET: Final = re.compile(r"Using EKF Source Set (\d)")
WANTED: Final = frozenset({NUMBER, mavlink.MAVLINK_MSG_ID_STATUSTEXT})


class FusionStatus(mavlink.MAVLink_message):  # type: ignore[misc]
    """Of MAVLink's development dialect, which pymavlink 2.4.50 lacks; bit masks of instances, nine sources."""

    id = NUMBER
    msgname = "ESTIMATOR_SENSOR_FUSION_STATUS"
    fieldnames: Final = ["intended", "active", "test_ratio"]
    ordered_fieldnames: Final = ["test_ratio", "intended", "active"]
    fieldtypes: Final = ["uint8_t", "uint8_t", "float"]
    fielddisplays_by_name: Final = dict[str, str]()
    fieldenums_by_name: Final = dict[str, str]()
    fieldunits_by_name: Final = dict[str, str]()
    native_format: Final = bytearray(b"<fBB")
    orders: Final = [1, 2, 0]
    lengths: Final = [9, 9, 9]
    array_lengths: Final = [9, 9, 9]
    crc_extra = 197
    unpacker = struct.Struct("<9f9B9B")
    instance_field = None
    instance_offset = -1

    def __init__(self, intended: list[int], active: list[int], test_ratio: list[float]) -> None:
        mavlink.MAVLink_message.__init__(self, self.id, self.msgname)
        self._fieldnames = self.fieldnames
        self.intended, self.active, self.test_ratio = intended, active, test_ratio

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame."""
        payload = self.unpacker.pack(*self.test_ratio, *self.intended, *self.active)
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


mavlink.mavlink_map.setdefault(NUMBER, FusionStatus)


class EkfSources:
    """The newest of both."""

    def __init__(self) -> None:
        self._fuses = self._source_set = ""

    def hear(self, message: Any) -> None:
        """A message of WANTED."""
        if message.get_type() == FusionStatus.msgname:
            fused = [name for name, active in zip(_SOURCES, message.active, strict=True) if active]
            bits = zip(_SOURCES, message.intended, message.active, strict=True)
            missing = [name for name, intended, active in bits if intended & ~active]
            text = ", ".join(fused) or "nothing"
            self._fuses = f"{text}; not fused: {', '.join(missing)}" if missing else text
        elif found := _SET.search(message.text):
            self._source_set = found[1]

    def report(self) -> dict[str, str]:
        """For the status."""
        known = {"ekf_fuses": self._fuses, "ekf_source_set": self._source_set}
        return {key: value for key, value in known.items() if value}
