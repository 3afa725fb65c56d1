"""What the autopilot's EKF fuses: bytes of the official definition through the link's parser, on the monitor's screen."""

import math
from typing import Any

from pymavlink.dialects.v20 import common
from pymavlink.generator.mavcrc import x25crc

from estimator.service.mavlink.ekf_sources import NUMBER, WANTED, EkfSources, FusionStatus
from estimator.service.mavlink.wire import Wire
from estimator.service.monitor import ekf_line


def _received(message: Any) -> Any:
    frame = bytes(message.pack(common.MAVLink(None, 1, 1)))
    (received,) = Wire(1, 197, frozenset({1}), WANTED, None, 0).messages(frame, whole=True)
    return received


def test_the_definition_is_the_one_that_px4_sends() -> None:
    """CRC_EXTRA of PX4 1.18's headers: name, types and order of the fields."""
    crc = x25crc()
    crc.accumulate_str("ESTIMATOR_SENSOR_FUSION_STATUS ")
    for kind, name in (("float", "test_ratio"), ("uint8_t", "intended"), ("uint8_t", "active")):
        crc.accumulate_str(f"{kind} {name} ")
        crc.accumulate([9])
    assert (crc.crc & 0xFF) ^ (crc.crc >> 8) == FusionStatus.crc_extra == 197
    assert FusionStatus.unpacker.size == 54
    assert NUMBER == 514


def test_what_it_means_to_fuse_and_does_not_is_named() -> None:
    sources = EkfSources()
    assert sources.report() == {}
    intended, active = [3, 0, 1, 1, 1, 0, 1, 0, 0], [1, 0, 0, 1, 1, 0, 1, 0, 0]  # bits: of two receivers one is fused
    sources.hear(_received(FusionStatus(intended, active, [math.nan] * 9)))
    fuses = "GPS, global position, baro, magnetometer; not fused: GPS, vision"
    assert sources.report() == {"ekf_fuses": fuses}
    assert ekf_line({"mavlink ekf_fuses": fuses}) == f"fuses {fuses}"
    sources.hear(_received(FusionStatus([0] * 9, [0] * 9, [0.0] * 9)))  # a frame of zeros is sent without them
    assert sources.report() == {"ekf_fuses": "nothing"}


def test_a_switch_of_ardupilots_source_set_is_read() -> None:
    sources = EkfSources()
    sources.hear(_received(common.MAVLink_statustext_message(6, b"Using EKF Source Set 2")))
    sources.hear(_received(common.MAVLink_statustext_message(6, b"EKF3 IMU0 fusing optical flow")))
    assert sources.report() == {"ekf_source_set": "2"}
    assert ekf_line({"mavlink ekf_fuses": "GPS", "mavlink ekf_source_set": "2"}) == "fuses GPS   source set 2"
