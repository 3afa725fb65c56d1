"""The daemon's ports: Inbox, Outbox, Log; none blocks or raises."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from logs.wire.codec import Encoded
from models.messages import Input, Output


class Arrival(NamedTuple):
    """ROS 2 CDR bytes and arrival on the daemon's clock; own: from our own vision."""

    topic: str
    schema: str
    data: bytes
    arrived_ns: int
    own: bool = False


class Inbox(Protocol):
    """Where links put what they receive; never blocks or raises, keeps the order."""

    def put_bytes(self, topic: str, schema: str, data: bytes) -> None:
        """Put wire bytes; images go to the log only."""
        ...

    def put(self, message: Input) -> None:
        """Put a measurement without CDR; estimator and log get the same bytes."""
        ...


class Outbox(Protocol):
    """Sends the outputs of the estimator."""

    def send(self, outputs: Sequence[Output], encoded: Sequence[Encoded]) -> None:
        """Send what one input led to: records (NED, FRD) and due messages in CDR."""
        ...

    def close(self) -> None:
        """The daemon stops; nothing is sent after this."""
        ...


class Log(Protocol):
    """Keeps everything; never blocks or raises; counts what is dropped."""

    def put_input(self, arrival: Arrival) -> None:
        """Put an input of the estimator, the last to be dropped."""
        ...

    def put_output(self, encoded: Encoded, log_time_ns: int) -> None:
        """Put an output, which a replay can repeat."""
        ...

    def put_image(self, arrival: Arrival) -> None:
        """An image; the oldest ones go first when the disk is slow."""
        ...


class Screen(Protocol):
    """Shows images to viewers."""

    def watched(self) -> bool:
        """Whether somebody subscribes now; asked before anything is drawn."""
        ...

    def show(self, image: Encoded) -> None:
        """Send it; must not block or raise."""
        ...
