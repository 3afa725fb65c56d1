"""Record the running sensors as the daemon would, and judge them as a log."""

import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from msgspec.structs import replace

from estimator.config import Config, Rig
from estimator.service.base.status import TOPIC
from estimator.service.monitor import ekf_line
from estimator.service.run import assembled
from estimator.service.zenoh.bus import BusError
from estimator.strict_toml import ConfigError
from estimator.tools.doctor.log import log
from estimator.tools.doctor.machine import Check, judge
from logs.wire.codec import TICK_TOPIC, Encoded, decode_diagnostics
from models.messages import Output

_RATE: Final = "rate_hz "
_NOT_SENSORS: Final = ("log", TICK_TOPIC)  # of a log's checks
_BUSY: Final = "end `landfix run` first, or check the log that it writes: landfix doctor LOG.mcap -c FILE"


class _Listener:
    """In place of the daemon's links: nothing is sent; says the rates once a second."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say, self.topics = say, dict[str, str]()
        self.status: dict[str, str] = {}  # of the daemon, the newest

    def published(self, topic: str, schema: str) -> None:
        self.topics[topic] = schema

    def send(self, outputs: Sequence[Output], encoded: Sequence[Encoded]) -> None:  # noqa: ARG002  (an Outbox is given both)
        for message in encoded:
            if message.topic == TOPIC:
                self.status = decode_diagnostics(message.data)
                rates = {key.removeprefix(_RATE): rate for key, rate in self.status.items() if key.startswith(_RATE)}
                heard = ", ".join(f"{topic} {float(rate):.0f} Hz" for topic, rate in rates.items() if topic != TICK_TOPIC)
                self._say(heard or "nothing comes")

    def close(self) -> None:
        """Nothing was opened."""


def live(config: Config, folder: Path, seconds: float, say: Callable[[str], None]) -> list[Check]:
    """Checks of `seconds` of the running sensors, the vehicle at rest; folder: base of files."""
    listener = _Listener(say)
    with tempfile.TemporaryDirectory(prefix="landfix-") as kept:
        quiet = replace(
            config,
            log=replace(config.log, enabled=True, folder=kept, images=False, least_free_mb=0.0),
            service=replace(config.service, state_file=""),
            rig=Rig(),
            visual_odometry=replace(config.visual_odometry, enabled=False),
        )
        try:
            _record(quiet, folder, seconds, listener)
        except (BusError, ConfigError) as error:
            return [judge("live", str(error), fail=True, advice=_BUSY)]
        checks = [check for file in sorted(Path(kept).glob("*.mcap")) for check in log(file, config, live=listener.topics)]
    if ekf := ekf_line(listener.status):
        advice = "its parameters ask for a source that it does not fuse: see docs/mavlink.md"
        checks.append(judge("autopilot's EKF", ekf, warn="not fused" in ekf, advice=advice))
    return [check for check in checks if check.found != "off" and not check.name.startswith(_NOT_SENSORS)]


def _record(config: Config, folder: Path, seconds: float, listener: _Listener) -> None:
    with assembled(config, folder, listener=listener) as daemon:
        loop = threading.Thread(target=daemon.run, name="doctor")
        loop.start()
        try:
            time.sleep(seconds)
        finally:
            daemon.stop()
            loop.join()
