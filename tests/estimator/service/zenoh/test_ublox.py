"""A u-blox driver on the bus: its flag reaches the next fix of the same namespace."""

from pathlib import Path

import numpy as np

from estimator.service.base.clock import Clock
from estimator.service.zenoh.bus import ZenohBus
from estimator.service.zenoh.config import ZenohConfig
from estimator.service.zenoh.keys import rmw_key
from logs.wire import schemas
from logs.wire.codec import Decoder, Topics, encode_input
from models.messages import GnssFix, Input, ReceiverState
from tests.estimator.service.flying import client, free_port, until


class _Inbox:
    def __init__(self) -> None:
        self.fixes: list[Input | None] = []
        self.decoder = Decoder(Topics.of({"gnss": "/ublox/fix"}))

    def put_bytes(self, topic: str, schema: str, data: bytes) -> None:
        self.fixes.append(self.decoder.decode(topic, schema, data, 0))

    def put(self, message: Input) -> None:
        self.fixes.append(message)


def test_a_flag_beside_a_receiver_s_fixes_is_in_the_next_one(tmp_path: Path) -> None:
    port, inbox, clock = free_port(), _Inbox(), Clock()
    bus = ZenohBus(ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",)), tmp_path, clock, {"/ublox/fix": schemas.NAV_SAT_FIX}, ())
    t_ns = clock.now_ns()
    fix = encode_input(GnssFix(t_ns, t_ns, 47.0, 8.0, 450.0, np.eye(3))).data
    spoofed = bytes([0, 1, 0, 0]) + bytes(7) + bytes([3 << 3]) + bytes(8)  # flags2 of NAV-STATUS
    try:
        bus.open_inputs(inbox)
        with client(port) as session:
            put = session.declare_publisher(rmw_key(0, "/ublox/fix", schemas.NAV_SAT_FIX, "RIHS01_0")).put
            until(lambda: put(fix) or inbox.fixes, "the fix comes", every_s=0.1)
            session.put(rmw_key(0, "/ublox/navstatus", "ublox_msgs/msg/NavSTATUS", "RIHS01_1"), spoofed)
            until(lambda: put(fix) or _state(inbox), "the flag")
    finally:
        bus.close()
    assert isinstance(inbox.fixes[0], GnssFix)
    assert inbox.fixes[0].state is ReceiverState.UNKNOWN
    assert _state(inbox) is ReceiverState.SPOOFED


def _state(inbox: _Inbox) -> ReceiverState:
    newest = inbox.fixes[-1]
    assert isinstance(newest, GnssFix)
    return newest.state
