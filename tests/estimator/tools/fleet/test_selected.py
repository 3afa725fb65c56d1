"""Only what is needed is read: by the index, whole chunks or single messages; without an index everything."""

from pathlib import Path

import fsspec
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from estimator.tools.fleet.selected import copy_selected
from logs.store.reader import LogReader, Record
from logs.store.recorder import Recorder
from logs.wire.codec import encode_input
from logs.wire.images import encode_image
from logs.wire.schemas import schema_text
from models.messages import ImuSample

_RNG = np.random.default_rng(1)
_NOISE = _RNG.integers(0, 255, (300, 400), np.uint8)


def messages() -> list[tuple[int, tuple[str, str, bytes]]]:
    """2 s of IMU at 100 Hz and an image of noise every 0.1 s."""
    found: list[tuple[int, tuple[str, str, bytes]]] = []
    for k in range(200):
        t_ns = 1_700_000_000_000_000_000 + k * 10_000_000
        found.append((t_ns, encode_input(ImuSample(t_ns, t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8)))))
        if k % 10 == 0:
            found.append((t_ns, encode_image(t_ns, _NOISE, "/left/image")))
    return found


def records(path: Path, topic: str) -> list[tuple[int, bytes]]:
    with LogReader(path) as log:
        return [(r.log_time_ns, r.data) for r in log if r.topic == topic]


def topics(path: Path) -> set[str]:
    with LogReader(path) as log:
        found: list[Record] = list(log)
        assert not log.torn
        assert not log.skipped_chunks
    return {r.topic for r in found}


def ours(path: Path) -> None:
    with Recorder(path) as recorder:
        recorder.attach("map/town.geojson", "application/json", bytes(100_000))
        recorder.attach("config.toml", "application/toml", b"[imu]\n")
        for t_ns, message in messages():
            recorder.write(*message, t_ns)


def rosbag(path: Path, compression: CompressionType = CompressionType.NONE) -> None:
    """As rosbag2 writes it: chunks of 768 KiB, all topics in each."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=768 * 1024, compression=compression)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for t_ns, (topic, schema, data) in messages():
            if topic not in channels:
                of = writer.register_schema(schema, "ros2msg", schema_text(schema).encode())
                channels[topic] = writer.register_channel(topic, "cdr", of)
            writer.add_message(channels[topic], t_ns, data, t_ns)
        writer.finish()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("write", [ours, rosbag])
def test_images_stay_in_the_store(tmp_path: Path, write: object) -> None:
    assert callable(write)
    write(tmp_path / "flight.mcap")
    copied = copy_selected(
        fsspec.filesystem("file"), str(tmp_path / "flight.mcap"), tmp_path / "copy.mcap", {"/imu"}.__contains__
    )
    assert topics(tmp_path / "copy.mcap") == {"/imu"}
    assert records(tmp_path / "copy.mcap", "/imu") == records(tmp_path / "flight.mcap", "/imu")
    assert copied.read_bytes < 0.05 * (tmp_path / "flight.mcap").stat().st_size  # images of 120 kB at 10 Hz, IMU at 100 Hz


def test_of_attachments_only_what_is_used_is_read(tmp_path: Path) -> None:
    ours(tmp_path / "flight.mcap")
    copy_selected(fsspec.filesystem("file"), str(tmp_path / "flight.mcap"), tmp_path / "copy.mcap", {"/imu"}.__contains__)
    with LogReader(tmp_path / "copy.mcap") as log:
        assert sum(1 for _ in log) == 200
        assert [a.name for a in log.attachments] == ["config.toml"]


def test_a_compressed_chunk_of_all_topics_is_read_whole(tmp_path: Path) -> None:
    rosbag(tmp_path / "flight.mcap", CompressionType.ZSTD)
    copied = copy_selected(
        fsspec.filesystem("file"), str(tmp_path / "flight.mcap"), tmp_path / "copy.mcap", {"/imu"}.__contains__
    )
    assert records(tmp_path / "copy.mcap", "/imu") == records(tmp_path / "flight.mcap", "/imu")
    assert copied.read_bytes > 0.8 * (tmp_path / "flight.mcap").stat().st_size


def test_a_log_without_an_index_is_read_whole(tmp_path: Path) -> None:
    ours(tmp_path / "flight.mcap")
    torn = (tmp_path / "flight.mcap").read_bytes()[:300_000]
    (tmp_path / "torn.mcap").write_bytes(torn)
    copied = copy_selected(fsspec.filesystem("file"), str(tmp_path / "torn.mcap"), tmp_path / "copy.mcap", {"/imu"}.__contains__)
    assert (tmp_path / "copy.mcap").read_bytes() == torn
    assert copied.read_bytes >= len(torn)
