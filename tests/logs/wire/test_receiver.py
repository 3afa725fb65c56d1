"""The flags of u-blox and Septentrio: bytes of the drivers' own definitions."""

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from logs.wire.codec import Decoder, encode_input
from logs.wire.receiver import ReceiverFlags, state_of
from models.messages import GnssFix, ReceiverState

MON_HW, NAV_STATUS, SEC_SIG = "ublox_msgs/msg/MonHW", "ublox_msgs/msg/NavSTATUS", "ublox_ubx_msgs/msg/UBXSecSig"
UBX_STATUS, AIM = "ublox_ubx_msgs/msg/UBXNavStatus", "septentrio_gnss_driver/msg/AIMPlusStatus"
DEFINITIONS = {
    MON_HW: """uint32 pin_sel
uint32 pin_bank
uint32 pin_dir
uint32 pin_val
uint16 noise_per_ms
uint16 agc_cnt
uint8 a_status
uint8 a_power
uint8 flags
uint8 reserved0
uint32 used_mask
uint8[17] vp
uint8 jam_ind
uint8[2] reserved1
uint32 pin_irq
uint32 pull_h
uint32 pull_l
""",
    NAV_STATUS: "uint32 iTOW\nuint8 gpsFix\nuint8 flags\nuint8 fixStat\nuint8 flags2\nuint32 ttff\nuint32 msss\n",
    SEC_SIG: """std_msgs/Header header
uint8 version
uint8 jam_det_enabled
uint8 jamming_state
uint8 spf_det_enabled
uint8 spoofing_state
""",
    "ublox_ubx_msgs/msg/GpsFix": "uint8 fix_type\n",
    "ublox_ubx_msgs/msg/MapMatching": "uint8 status\n",
    **dict.fromkeys(("ublox_ubx_msgs/msg/PSMStatus", "ublox_ubx_msgs/msg/SpoofDet"), "uint8 state\n"),
    "ublox_ubx_msgs/msg/CarrSoln": "uint8 status\n",
    UBX_STATUS: """std_msgs/Header header
uint32 itow
ublox_ubx_msgs/GpsFix gps_fix
bool gps_fix_ok
bool diff_soln
bool wkn_set
bool tow_set
bool diff_corr
bool carr_soln_valid
ublox_ubx_msgs/MapMatching map_matching
ublox_ubx_msgs/PSMStatus psm
ublox_ubx_msgs/SpoofDet spoof_det
ublox_ubx_msgs/CarrSoln carr_soln
uint32 ttff
uint32 msss
""",
    AIM: """std_msgs/Header header
uint32 tow
uint16 wnc
uint8 interference
uint8 spoofing
bool osnma_info_available
uint8 galileo_authentic
uint8 galileo_spoofed
uint8 gps_authentic
uint8 gps_spoofed
""",
}
STORE = get_typestore(Stores.ROS2_HUMBLE)
for name, text in DEFINITIONS.items():
    STORE.register(get_types_from_msg(text, name))
MAKE: Any = STORE.types
HEADER = MAKE["std_msgs/msg/Header"](stamp=MAKE["builtin_interfaces/msg/Time"](sec=1, nanosec=2), frame_id="gnss")
SECOND = 1_000_000_000


PARTS = {"gps_fix": "GpsFix", "map_matching": "MapMatching", "psm": "PSMStatus", "spoof_det": "SpoofDet", "carr_soln": "CarrSoln"}


def _part(kind: str, value: int) -> Any:
    """Of one byte, whatever its name."""
    return MAKE[f"ublox_ubx_msgs/msg/{kind}"](value)


def _bytes(schema: str, **fields: Any) -> bytes:
    pins = dict.fromkeys(("pin_sel", "pin_bank", "pin_dir", "pin_val", "used_mask", "pin_irq", "pull_h", "pull_l"), 2**32 - 1)
    noise = {"noise_per_ms": 9, "agc_cnt": 99, "a_status": 2, "a_power": 1, "reserved0": 255, "jam_ind": 7}
    arrays = {"vp": np.full(17, 255, np.uint8), "reserved1": np.full(2, 255, np.uint8)}
    status = {"iTOW": 2**32 - 1, "gpsFix": 3, "flags": 15, "fixStat": 255, "ttff": 1, "msss": 1}
    signal = {"header": HEADER, "version": 1, "jam_det_enabled": 1, "spf_det_enabled": 1}
    counts = dict.fromkeys(("galileo_authentic", "galileo_spoofed", "gps_authentic", "gps_spoofed"), 9)
    aim = {"header": HEADER, "tow": 2**32 - 1, "wnc": 2**16 - 1, "osnma_info_available": True, **counts}
    flags = dict.fromkeys(("gps_fix_ok", "diff_soln", "wkn_set", "tow_set", "diff_corr", "carr_soln_valid"), True)
    parts = {name: _part(kind, fields.pop(name, 9)) for name, kind in PARTS.items()} if schema == UBX_STATUS else {}
    ubx = {"header": HEADER, "itow": 2**32 - 1, **flags, **parts, "ttff": 1, "msss": 1}
    known: dict[str, dict[str, Any]] = {
        MON_HW: {**pins, **noise, **arrays}, NAV_STATUS: status, SEC_SIG: signal, UBX_STATUS: ubx, AIM: aim,
    }  # fmt: skip
    return bytes(STORE.serialize_cdr(MAKE[schema](**(known[schema] | fields)), schema))


@pytest.mark.parametrize(
    ("schema", "fields", "state"),
    [
        (MON_HW, {"flags": 0b00100}, ReceiverState.UNKNOWN),  # ok
        (MON_HW, {"flags": 0b11011}, ReceiverState.UNKNOWN),  # warning: the fix is well
        (MON_HW, {"flags": 0b01100}, ReceiverState.JAMMED),  # critical
        (NAV_STATUS, {"flags2": 0b00_01_000}, ReceiverState.UNKNOWN),  # no spoofing
        (NAV_STATUS, {"flags2": 0b01_10_011}, ReceiverState.JAMMED),  # indicated
        (NAV_STATUS, {"flags2": 0b10_11_111}, ReceiverState.SPOOFED),
        (SEC_SIG, {"jamming_state": 1, "spoofing_state": 1}, ReceiverState.UNKNOWN),
        (SEC_SIG, {"jamming_state": 3, "spoofing_state": 1}, ReceiverState.JAMMED),
        (SEC_SIG, {"jamming_state": 0, "spoofing_state": 3}, ReceiverState.SPOOFED),
        (UBX_STATUS, {"spoof_det": 1}, ReceiverState.UNKNOWN),
        (UBX_STATUS, {"spoof_det": 2}, ReceiverState.JAMMED),
        (UBX_STATUS, {"spoof_det": 3}, ReceiverState.SPOOFED),
        (AIM, {"interference": 1, "spoofing": 0}, ReceiverState.UNKNOWN),  # mitigated
        (AIM, {"interference": 2, "spoofing": 4}, ReceiverState.JAMMED),
        (AIM, {"interference": 0, "spoofing": 1}, ReceiverState.SPOOFED),  # by OSNMA
        (AIM, {"interference": 2, "spoofing": 3}, ReceiverState.SPOOFED),
    ],
)
def test_flags_are_read_from_the_drivers_bytes(schema: str, fields: dict[str, Any], state: ReceiverState) -> None:
    data = _bytes(schema, **fields)
    assert state_of(schema, data) is state
    assert state_of(schema, data[:8]) is ReceiverState.UNKNOWN


def test_a_fix_carries_the_newest_flags_beside_it_for_five_seconds() -> None:
    flags, decoder = ReceiverFlags(["/ublox/fix"]), Decoder()
    assert flags.topics["/ublox/monhw"] == MON_HW
    fix = encode_input(GnssFix(SECOND, SECOND, 47.0, 8.0, 450.0, np.eye(3), 2)).data

    def state(now_s: int) -> ReceiverState:
        found = decoder.decode("/gnss", "sensor_msgs/msg/NavSatFix", flags.marked("/ublox/fix", fix, now_s * SECOND), SECOND)
        assert isinstance(found, GnssFix)
        assert (found.lat_deg, found.lon_deg, found.alt_m, found.status) == (47.0, 8.0, 450.0, 2)
        return found.state

    assert flags.marked("/ublox/fix", fix, 0) == fix
    flags.hear("/ublox/monhw", _bytes(MON_HW, flags=12), SECOND)
    flags.hear("/ublox/navstatus", _bytes(NAV_STATUS, flags2=24), 3 * SECOND)
    assert [state(t) for t in (3, 7, 8)] == [ReceiverState.SPOOFED, ReceiverState.SPOOFED, ReceiverState.UNKNOWN]
    flags.hear("/ublox/monhw", _bytes(MON_HW, flags=12), 9 * SECOND)
    assert state(9) is ReceiverState.JAMMED
    flags.hear("/ublox/monhw", _bytes(MON_HW, flags=4), 10 * SECOND)
    assert state(10) is ReceiverState.UNKNOWN
    assert flags.marked("/other", fix, 9 * SECOND) == fix
    assert flags.marked("/ublox/fix", fix[:9], 3 * SECOND) == fix[:9]
