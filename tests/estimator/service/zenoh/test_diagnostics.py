"""Health and status on ROS's common topic: by option, under the key of rmw_zenoh, to whom may read it."""

from pathlib import Path

import pytest
import zenoh

from estimator.service.base.clock import Clock
from estimator.service.zenoh.bus import ZenohBus
from estimator.service.zenoh.config import ZenohConfig
from logs.wire import schemas
from logs.wire.codec import Encoded, encode
from models.messages import Health, Mode
from tests.estimator.service.flying import client, free_port, until


@pytest.mark.parametrize("wanted", [True, False])
def test_health_is_on_diagnostics_where_the_configuration_enables_it(wanted: bool, tmp_path: Path) -> None:
    port, heard = free_port(), list[zenoh.Sample]()
    config = ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",), diagnostics=wanted)
    health = encode(Health(1, 1, Mode.AIDED, 0.1, 2.0, 1.0, 0, {}, {}, 1))[0]
    bus = ZenohBus(config, tmp_path, Clock(), {}, ())

    def enough() -> bool:
        bus.send((), [health, Encoded("/landfix/reset", schemas.RESET, b"")])
        return len(heard) > 20

    try:
        with client(port) as session:
            session.declare_subscriber("0/**", heard.append)
            until(enough, "messages")
    finally:
        bus.close()
    topics = {
        str(sample.key_expr).partition("/diagnostic_msgs")[0] for sample in heard if "DiagnosticArray" in str(sample.key_expr)
    }
    assert topics == ({"0/landfix/health", "0/diagnostics"} if wanted else {"0/landfix/health"})
    assert {sample.payload.to_bytes() for sample in heard if "diagnostics" in str(sample.key_expr)} <= {health.data}
