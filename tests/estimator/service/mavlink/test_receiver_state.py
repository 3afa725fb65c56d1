"""GNSS_INTEGRITY in MAVLink bytes becomes the state of the receiver's fixes, which survives the log."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import common, development

from estimator.service.mavlink.config import MavlinkConfig
from estimator.service.mavlink.inputs import Inputs
from estimator.service.mavlink.wire import Wire
from logs.wire.codec import Decoder, Topics, encode_input
from models.messages import GnssFix, ReceiverState

SECOND = 1_000_000_000
UNKNOWN, JAMMED, SPOOFED = ReceiverState


def _integrity(jamming: int, spoofing: int, receiver: int = 0, authentication: int = 0) -> Any:
    return development.MAVLink_gnss_integrity_message(
        receiver, 0, authentication, jamming, spoofing, 0, 65535, 65535, 255, 255, 255, 255
    )


def _fix() -> Any:
    return common.MAVLink_gps_raw_int_message(10**6, 3, 47 * 10**7, 8 * 10**7, 500_000, 100, 100, 500, 0, 12)


def _received(inputs: Inputs, message: Any) -> Any:
    """The message after its way through the bytes of a frame."""
    frame = bytes(message.pack(common.MAVLink(None, 1, 1)))
    (received,) = Wire(1, 197, frozenset({1}), frozenset(inputs.wanted), None, 0).messages(frame, whole=True)
    return received


def _measured(inputs: Inputs, now_ns: int) -> ReceiverState:
    """The state of the next fix."""
    found = list(inputs.measured(_received(inputs, _fix()), now_ns, now_ns, None))
    (state,) = [m.state for m in found if isinstance(m, GnssFix)]
    return state


@pytest.mark.parametrize(
    ("jamming", "spoofing", "state"),
    [(0, 0, UNKNOWN), (1, 1, UNKNOWN), (2, 1, UNKNOWN), (3, 1, JAMMED), (1, 2, JAMMED), (1, 3, SPOOFED), (3, 3, SPOOFED)],
)
def test_flags_reach_the_very_next_fix(jamming: int, spoofing: int, state: ReceiverState) -> None:
    inputs = Inputs(MavlinkConfig(), Topics(), 0.0)
    assert _measured(inputs, SECOND) is UNKNOWN
    inputs.note_integrity(_received(inputs, _integrity(jamming, spoofing)), SECOND)
    assert _measured(inputs, SECOND) is state


def test_authentication_is_shown_and_judges_no_fix() -> None:
    inputs = Inputs(MavlinkConfig(), Topics(), 0.0)
    for receiver, authentication in enumerate((2, 3)):
        inputs.note_integrity(_received(inputs, _integrity(1, 1, receiver, authentication)), SECOND)
    assert _measured(inputs, SECOND) is UNKNOWN
    assert inputs.report()["receiver"] == "1: authentication cannot begin, 2: authenticated"


def test_flags_that_no_longer_come_and_those_of_another_receiver_change_nothing() -> None:
    inputs = Inputs(MavlinkConfig(), Topics(), 0.0)
    for receiver in (1, 7):
        inputs.note_integrity(_received(inputs, _integrity(3, 3, receiver)), SECOND)
    assert _measured(inputs, SECOND) is UNKNOWN
    inputs.note_integrity(_received(inputs, _integrity(3, 3)), SECOND)
    assert _measured(inputs, 4 * SECOND) is SPOOFED
    assert _measured(inputs, 5 * SECOND) is UNKNOWN


@pytest.mark.parametrize("state", ReceiverState)
def test_the_log_keeps_the_state(state: ReceiverState) -> None:
    fix = GnssFix(SECOND, SECOND, 47.0, 8.0, 500.0, None, state=state)
    encoded = encode_input(fix)
    decoded = Decoder().decode(encoded.topic, encoded.schema, encoded.data, SECOND)
    assert isinstance(decoded, GnssFix)
    assert decoded.state is state
