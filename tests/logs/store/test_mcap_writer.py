"""Our writer against mcap's own: the same calls give the same bytes."""

from io import BytesIO

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from logs.store.mcap_writer import McapWriter


def use(writer: McapWriter | Writer, seed: int, messages: int) -> None:
    """A log with definitions, attachments, metadata and flushes at random places."""
    rng = np.random.default_rng(seed)
    writer.start("ros2", "test")
    writer.add_metadata("first", {"a": "1", "ü": ""})
    channels: list[int] = []
    for _ in range(messages):
        if rng.random() < 0.02 or not channels:
            schema = writer.register_schema(f"pkg/msg/T{len(channels)}", "ros2msg", rng.bytes(int(rng.integers(8000))))
            channels.append(writer.register_channel(f"/t{len(channels)}", "cdr", schema, {"k": "v"}))
        if rng.random() < 0.02:
            writer.add_attachment(1, 2, "file", "text/plain", rng.bytes(int(rng.integers(5000))))
        if rng.random() < 0.05:
            writer.flush()  # type: ignore[no-untyped-call,unused-ignore]
        channel, data = int(rng.choice(channels)), rng.bytes(int(rng.integers(900)))
        writer.add_message(channel, int(rng.integers(2**40)), data, int(rng.integers(2**40)), int(rng.integers(100)))
    writer.add_metadata("last", {})
    writer.finish()  # type: ignore[no-untyped-call,unused-ignore]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("messages", [0, 1, 400])
def test_the_same_bytes(seed: int, messages: int) -> None:
    ours, theirs = BytesIO(), BytesIO()
    use(McapWriter(ours, 10_000), seed, messages)
    use(Writer(theirs, chunk_size=10_000, compression=CompressionType.LZ4), seed, messages)
    assert ours.getvalue() == theirs.getvalue()
