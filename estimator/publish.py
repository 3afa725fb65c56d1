"""Outputs on the wire and their rates, for daemon, replay and simulation."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from estimator.strict_toml import ConfigError
from logs.store.reader import Attachment
from logs.wire.codec import Encoded, encode, encode_slow
from models.messages import Estimate, Output
from models.untrusted.file import content

OVERLAY_TOPIC = "/landfix/overlay"


def file_attachment(kind: str, path: Path) -> Attachment:
    """A named file (`calibration`, `map`) as an attachment. Raises ConfigError."""
    try:
        return Attachment(f"{kind}/{path.name}", "application/octet-stream", content(path))
    except OSError as error:
        raise ConfigError(f"{path}: {(error.strerror or 'cannot be read').lower()}") from None


class OutputConfig(msgspec.Struct, frozen=True):
    """Rates of the outputs."""

    rate_hz: Annotated[
        float, Meta(ge=0, le=10_000, description="/landfix/odometry at most this often; 0: one per IMU sample")
    ] = 0.0
    slow_rate_hz: Annotated[
        float, Meta(ge=0.01, le=30, description="/landfix/pose, /tf and /landfix/global at most this often")
    ] = 30.0
    overlay_hz: Annotated[
        float, Meta(ge=0, le=30, description="Hz: /landfix/overlay at most this often, drawn while it has a subscriber; 0: never")
    ] = 2.0


class Pace:
    """Thins a stream: due() is true for the first stamp of each period 1/rate_hz from t_ns = 0 (0: always)."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz) if rate_hz > 0 else 0
        self._last: int | None = None

    def due(self, t_ns: int) -> bool:
        """Whether the message stamped t_ns is to be sent."""
        if not self._period_ns:
            return True
        period = t_ns // self._period_ns
        if period == self._last:
            return False
        self._last = period
        return True


class Publisher:
    """Encodes and thins Fusion's outputs."""

    def __init__(self, config: OutputConfig) -> None:
        self._odometry = Pace(config.rate_hz)
        self._slow = Pace(config.slow_rate_hz)

    def encoded(self, outputs: Iterable[Output]) -> Iterator[Encoded]:
        """The messages to send, in order."""
        for output in outputs:
            if not isinstance(output, Estimate):
                yield from encode(output)
                continue
            if self._odometry.due(output.t_ns):
                yield from encode(output)
            if self._slow.due(output.t_ns):
                yield from encode_slow(output)
