"""What the recorder writes: files every MCAP and ROS tool opens, equal for equal calls, never more than 0.1 s behind."""

import os
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Schema
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from logs.store.reader import LogError, LogReader
from logs.store.recorder import Recorder
from logs.wire import schemas
from logs.wire.codec import encode_input, encode_truth
from logs.wire.schemas import STORE, schema_text
from models.messages import ImuSample, Tick

START_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000
FLUSH_NS = 100_000_000  # documented


def write(path: Path, count: int = 100) -> list[tuple[str, str, bytes, int]]:
    """A short log: IMU and truth at 200 Hz; what was written."""
    written = []
    with Recorder(path, metadata={"version": "1.2.3", "git": "abc"}) as recorder:
        recorder.attach("config.toml", "application/toml", b"[imu]\n")
        for i in range(count):
            t_ns = START_NS + i * STEP_NS
            truth = encode_truth(t_ns, (0.1 * i, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
            for encoded in (encode_input(ImuSample(t_ns, t_ns, (0.0, 0.0, 0.01 * i), (0.0, 0.0, -9.8))), truth):
                recorder.write(*encoded, t_ns)
                written.append((*encoded, t_ns))
    return written


def test_mcap_reader_sees_what_was_written(tmp_path: Path) -> None:
    # GIVEN a log
    path = tmp_path / "a.mcap"
    written = write(path)
    # WHEN mcap's own reader opens it
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        messages = [
            (channel.topic, schema.name if schema else "", message.data, message.log_time)
            for schema, channel, message in reader.iter_messages(log_time_order=False)
        ]
        attachments = [(a.name, a.media_type, a.data) for a in reader.iter_attachments()]
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        profile = reader.get_header().profile
    # THEN everything is there, in order, with statistics
    assert messages == written
    assert attachments == [("config.toml", "application/toml", b"[imu]\n")]
    assert metadata == {"landfix": {"version": "1.2.3", "git": "abc"}}
    assert profile == "ros2"
    assert summary.statistics is not None
    assert summary.statistics.message_count == 200
    for channel in summary.channels.values():
        assert channel.message_encoding == "cdr"
        assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        assert "reliability: reliable" in channel.metadata["offered_qos_profiles"]
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}
    assert {c.compression for c in summary.chunk_indexes} == {"lz4"}


def test_rosbags_opens_it_by_the_schemas_within(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path)
    with AnyReader([path]) as reader:
        truths: list[Any] = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages() if c.topic == "/truth"]
    assert len(truths) == 100
    assert truths[50].pose.pose.position.y == pytest.approx(5.0)


def test_equal_calls_write_equal_bytes(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_never_more_than_a_tenth_of_a_second_is_unwritten(tmp_path: Path) -> None:
    # GIVEN a recorder that was never closed
    path = tmp_path / "a.mcap"
    recorder = Recorder(path)
    for i in range(300):
        t_ns = START_NS + i * STEP_NS
        recorder.write(*encode_input(ImuSample(t_ns, t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))), t_ns)
        # WHEN another process examines the file as the system has it
        if i % 37 == 0 or i == 299:
            with LogReader(path) as reader:
                stamps = [record.log_time_ns for record in reader]
                assert reader.torn
            # THEN all but the last 0.1 s is there
            assert len(stamps) * STEP_NS > (i + 1) * STEP_NS - FLUSH_NS - 1
    # AND a flush leaves nothing out
    recorder.flush()
    with LogReader(path) as reader:
        assert sum(1 for _ in reader) == 300
    recorder.close()
    recorder.close()


def test_log_times_may_go_back_and_chunks_stay_small(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    times = [START_NS + t for t in (0, 50_000_000, 20_000_000, -500_000_000, 10**9, 10**9, 5)]
    with Recorder(path) as recorder:
        for t_ns in times:
            recorder.write(*encode_input(Tick(t_ns, t_ns)), t_ns)
        for _ in range(50):
            recorder.write("/left/image", schemas.COMPRESSED_IMAGE, os.urandom(5000), START_NS + 5)
    with LogReader(path) as reader:
        assert [r.log_time_ns for r in reader if r.topic == "/landfix/tick"] == times
    with path.open("rb") as file:
        chunks = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
    assert all(c.message_end_time - c.message_start_time < 2 * FLUSH_NS for c in chunks)
    assert max(c.uncompressed_size for c in chunks) < 64 * 1024 + 6000


def test_every_type_of_ros_is_known_and_a_foreign_one_is_copied_by_its_definition(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    foreign = Schema(id=7, name="my_msgs/msg/Beep", encoding="ros2msg", data=b"uint8 tone\n")
    with Recorder(path, schemas={foreign.name: foreign}) as recorder:
        recorder.write("/beep", "my_msgs/msg/Beep", b"\0\1\0\0\7", START_NS)
        recorder.write("/field", "sensor_msgs/msg/MagneticField", b"\0\1\0\0", START_NS)
        with pytest.raises(LogError, match=r"no definition of the type no_msgs/msg/No on /no is known"):
            recorder.write("/no", "no_msgs/msg/No", b"", START_NS)
    with LogReader(path) as reader:
        assert [(r.topic, r.schema) for r in reader] == [
            ("/beep", "my_msgs/msg/Beep"),
            ("/field", "sensor_msgs/msg/MagneticField"),
        ]
        assert reader.schemas["my_msgs/msg/Beep"].data == foreign.data
        assert reader.schemas["sensor_msgs/msg/MagneticField"].data.decode() == schema_text("sensor_msgs/msg/MagneticField")
    assert "sensor_msgs/msg/MagneticField" in STORE.fielddefs


def test_an_error_within_still_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"

    def record_and_fail() -> None:
        with Recorder(path) as recorder:
            recorder.write(*encode_input(Tick(START_NS, START_NS)), START_NS)
            raise RuntimeError("mine")

    with pytest.raises(RuntimeError, match="mine"):
        record_and_fail()
    with LogReader(path) as reader:
        assert len(list(reader)) == 1
        assert not reader.torn


def test_what_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"^[^\n]*none/a.mcap: cannot be written \(no such file or directory\)$"):
        Recorder(tmp_path / "none" / "a.mcap")
    with pytest.raises(LogError, match="is a directory"):
        Recorder(tmp_path)
    recorder = Recorder(tmp_path / "a.mcap")
    tick = encode_input(Tick(START_NS, START_NS))
    with pytest.raises(LogError, match="a log time before 1970"):
        recorder.write(*tick, -1)
    recorder.close()
    with pytest.raises(LogError, match="cannot be written"):
        recorder.write(*tick, START_NS)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_one_line() -> None:
    with pytest.raises(LogError, match=r"/dev/full: cannot be written \(no space left on device\)"):
        Recorder("/dev/full")
