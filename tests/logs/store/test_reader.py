"""Reading whole, torn, damaged and foreign files: all that is whole comes, in order, and never an exception but LogError."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from logs.store.reader import Attachment, LogError, LogReader, Record
from logs.store.recorder import Recorder
from logs.wire import schemas
from logs.wire.codec import Decoder, encode_input, encode_truth
from logs.wire.schemas import schema_text
from models.messages import ImuSample, LandmarkFix

START_NS = 1_700_000_000_000_000_000


def messages(count: int) -> list[tuple[str, str, bytes, int]]:
    """IMU at 100 Hz and truth at 25 Hz."""
    rng = np.random.default_rng(1)
    out = []
    for i in range(count):
        t_ns = START_NS + i * 10_000_000
        gyro = float(rng.standard_normal()), 0.0, 0.0
        out.append((*encode_input(ImuSample(t_ns, t_ns, gyro, (0.0, 0.0, -9.8))), t_ns))
        if i % 4 == 0:
            out.append((*encode_truth(t_ns, (0.1 * i, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), t_ns))
    return out


def record(path: Path, count: int) -> list[tuple[str, str, bytes, int]]:
    written = messages(count)
    with Recorder(path, metadata={"version": "1"}) as recorder:
        recorder.attach("map.geojson", "application/geo+json", b"{}" * 40)
        for message in written:
            recorder.write(*message)
    return written


def test_names_are_printable(tmp_path: Path) -> None:
    """They go to terminals."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start("ros2")
        schema = writer.register_schema(schemas.IMU, "ros2msg", schema_text(schemas.IMU).encode())
        channel = writer.register_channel("/imu\x1b]0;owned\x07", "cdr", schema)
        writer.add_message(channel, START_NS, messages(1)[0][2], START_NS)
        writer.add_metadata("landfix", {"version": "1\x1b[2J"})
        writer.finish()  # type: ignore[no-untyped-call]
    (message,), reader = read(path)
    assert message[0] == "/imu ]0;owned"
    assert reader.metadata["landfix"] == {"version": "1 [2J"}


def plain(records: Sequence[Record]) -> list[tuple[str, str, bytes, int]]:
    return [(r.topic, r.schema, r.data, r.log_time_ns) for r in records]


def read(path: Path) -> tuple[list[tuple[str, str, bytes, int]], LogReader]:
    with LogReader(path) as reader:
        return plain(list(reader)), reader


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """(end of the chunk in the file, messages up to there) of each chunk, by the file's own index."""
    ends, total = [], 0
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        for index in summary.chunk_indexes:
            file.seek(index.chunk_start_offset)
            chunk = next(iter(StreamReader(file, skip_magic=True, emit_chunks=True).records))
            assert isinstance(chunk, Chunk)
            total += sum(isinstance(r, Message) for r in breakup_chunk(chunk))
            ends.append((index.chunk_start_offset + index.chunk_length, total))
    return ends


# --- whole files --------------------------------------------------------------------------------------------------------


def test_what_the_recorder_wrote(tmp_path: Path) -> None:
    written = record(tmp_path / "a.mcap", 100)
    got, reader = read(tmp_path / "a.mcap")
    assert got == written
    assert not reader.torn
    assert reader.skipped_chunks == 0
    assert reader.attachments == [Attachment("map.geojson", "application/geo+json", b"{}" * 40)]
    assert reader.metadata == {"landfix": {"version": "1"}}
    assert not reader.foreign


def test_reading_twice_and_partly_and_how_far_it_is(tmp_path: Path) -> None:
    written = record(tmp_path / "a.mcap", 100)
    with LogReader(tmp_path / "a.mcap") as reader:
        first = next(iter(reader))
        assert plain([first]) == written[:1]
        fractions = [reader.fraction for _ in reader]
        assert plain(list(reader)) == written
        assert reader.attachments == [Attachment("map.geojson", "application/geo+json", b"{}" * 40)]
        assert reader.fraction == 1.0
    assert fractions == sorted(fractions)
    assert 0.0 < fractions[0] < 0.2
    assert 0.5 < fractions[-1] <= 1.0


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("use_chunking", [True, False])
def test_any_compression_and_none(tmp_path: Path, compression: CompressionType, use_chunking: bool) -> None:
    path, written = tmp_path / "a.mcap", messages(60)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=4000, compression=compression, use_chunking=use_chunking)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for topic, schema, data, t_ns in written:
            if topic not in channels:
                schema_id = writer.register_schema(schema, "ros2msg", schema_text(schema).encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema_id)
            writer.add_message(channels[topic], t_ns, data, t_ns + 7)
        writer.finish()  # type: ignore[no-untyped-call]
    got, reader = read(path)
    assert got == written
    assert not reader.torn


def test_a_fix_of_the_first_version_is_read_as_one_of_today(tmp_path: Path) -> None:
    """A log whose LandmarkFix knows no directions: there the definition ends, and the message eight bytes earlier."""
    path = tmp_path / "old.mcap"
    fix = LandmarkFix(START_NS, START_NS, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), np.eye(6), 2.0 * np.eye(6), ("a",), 0.9, 0.3)
    now = encode_input(fix)
    text = schema_text(now.schema)
    first = text[: text.index("# The combinations of pose error")] + text[text.index("=" * 80) :]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        channels = [
            writer.register_channel(topic, "cdr", writer.register_schema(now.schema, "ros2msg", definition.encode()))
            for topic, definition in (("/old", first), (now.topic, text))
        ]
        for channel, data in zip(channels, (now.data[:-8], now.data), strict=True):
            writer.add_message(channel, START_NS, data, START_NS)
        writer.finish()  # type: ignore[no-untyped-call]
    got, _ = read(path)
    assert [data for _, _, data, _ in got] == [now.data, now.data]
    back = Decoder().decode(now.topic, now.schema, got[0][2], START_NS)
    assert isinstance(back, LandmarkFix)
    assert back.directions is back.readings is None
    np.testing.assert_array_equal(back.covariance, fix.covariance)


def test_a_file_that_ros_wrote(landfix_data: Path) -> None:
    path = landfix_data / "native_logs/nav2_turtlebot.mcap"
    got, reader = read(path)
    with path.open("rb") as file:
        expected = [
            (channel.topic, schema.name if schema else "", message.data, message.log_time)
            for schema, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]
    assert len(got) == 8197
    assert got == expected
    assert not reader.torn
    assert "string child_frame_id" in reader.schemas[schemas.ODOMETRY].data.decode()


def test_what_is_not_cdr_is_left_out_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("")
        tick = writer.register_schema(schemas.HEADER, "ros2msg", schema_text(schemas.HEADER).encode())
        json = writer.register_schema("Beep", "jsonschema", b"{}")
        channels = [
            writer.register_channel("/landfix/tick", "cdr", tick),
            writer.register_channel("/beep", "json", json),
            writer.register_channel("/bare", "cdr", 0),
        ]
        for channel in channels:
            writer.add_message(channel, 5, b"12345", 5)
        writer.finish()  # type: ignore[no-untyped-call]
    got, reader = read(path)
    assert got == [("/landfix/tick", schemas.HEADER, b"12345", 5)]
    assert reader.foreign == {"/beep": "json", "/bare": "cdr without a schema"}


# --- torn files ---------------------------------------------------------------------------------------------------------


def test_cut_at_every_byte(tmp_path: Path) -> None:
    # GIVEN a log of several chunks
    path, cut_path = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    written = record(path, 40)
    whole = path.read_bytes()
    ends = chunk_ends(path)
    assert len(ends) == 4
    assert ends[-1][1] == len(written)
    # WHEN it is cut anywhere (every byte around the chunks' ends, others at random)
    near = {end + d for end, _ in ends for d in range(-12, 13)}
    cuts = sorted(near | set(np.random.default_rng(2).integers(8, len(whole), 400).tolist()) | {8, 9, 10, len(whole) - 1})
    for cut in cuts:
        cut_path.write_bytes(whole[:cut])
        got, reader = read(cut_path)
        # THEN every message of the whole chunks is there, and no other
        assert got == written[: max((n for end, n in ends if end <= cut), default=0)]
        assert reader.torn
        assert reader.skipped_chunks == 0


def test_cut_within_the_first_bytes(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", 4)
    whole = (tmp_path / "a.mcap").read_bytes()
    for cut in range(1, 8):
        (tmp_path / "cut.mcap").write_bytes(whole[:cut])
        with pytest.raises(LogError, match="is not an MCAP file, or its first bytes are damaged"):
            LogReader(tmp_path / "cut.mcap")


# --- damaged files ------------------------------------------------------------------------------------------------------


def is_subsequence(part: list[tuple[str, str, bytes, int]], whole: list[tuple[str, str, bytes, int]]) -> bool:
    rest = iter(whole)
    return all(message in rest for message in part)


def test_one_flipped_bit_costs_at_most_one_chunk(tmp_path: Path) -> None:
    # GIVEN a log of ten chunks
    path, bad_path = tmp_path / "a.mcap", tmp_path / "bad.mcap"
    written = record(path, 100)
    whole = path.read_bytes()
    ends = [0, *(n for _, n in chunk_ends(path))]
    largest = max(b - a for a, b in pairwise(ends))
    rng = np.random.default_rng(3)
    skipped = 0
    for position in rng.integers(8, len(whole), 600).tolist():
        # WHEN one bit of it flips
        damaged = bytearray(whole)
        damaged[position] ^= 1 << int(rng.integers(8))
        bad_path.write_bytes(damaged)
        got, reader = read(bad_path)
        # THEN what comes is what was written, and at most one chunk of it is missing
        assert is_subsequence(got, written)
        assert len(got) >= len(written) - largest, f"byte {position}"
        skipped += reader.skipped_chunks
    assert skipped > 100


def test_a_damaged_first_chunk_does_not_take_the_channels_with_it(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    written = record(path, 100)
    (_, first), *_ = ends = chunk_ends(path)
    damaged = bytearray(path.read_bytes())
    damaged[ends[0][0] - 20] ^= 0xFF
    path.write_bytes(damaged)
    got, reader = read(path)
    assert got == written[first:]
    assert reader.skipped_chunks == 1
    assert not reader.torn


@pytest.mark.parametrize("opcode", [Opcode.MESSAGE_INDEX, Opcode.CHUNK])
def test_a_damaged_length_costs_at_most_the_chunk_beside_it(tmp_path: Path, opcode: Opcode) -> None:
    # GIVEN the length of a record that says too much, so that the framing of what follows is lost
    path = tmp_path / "a.mcap"
    written = record(path, 100)
    whole = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    middle = summary.chunk_indexes[5]
    start = middle.chunk_start_offset + (middle.chunk_length if opcode == Opcode.MESSAGE_INDEX else 0)
    assert whole[start] == opcode
    per_chunk = [n for _, n in chunk_ends(path)]
    for extra in (1, 300, 5000, 2**40):
        damaged = bytearray(whole)
        length = int.from_bytes(whole[start + 1 : start + 9], "little") + extra
        damaged[start + 1 : start + 9] = length.to_bytes(8, "little")
        path.write_bytes(damaged)
        got, reader = read(path)
        # THEN only a chunk that claims more than the file holds is lost
        lost = opcode == Opcode.CHUNK and extra == 2**40
        assert got == (written[: per_chunk[4]] + written[per_chunk[5] :] if lost else written), extra
        assert reader.skipped_chunks == 1


@pytest.mark.parametrize("opcode", [0, 1, 2, 3, 4, 5, 7, 9, 11, 12, 14, 15, 0x86])
def test_a_chunk_with_a_wrong_header_costs_itself_only(tmp_path: Path, opcode: int) -> None:
    path = tmp_path / "a.mcap"
    written = record(path, 100)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    per_chunk = [n for _, n in chunk_ends(path)]
    damaged = bytearray(path.read_bytes())
    damaged[summary.chunk_indexes[5].chunk_start_offset] = opcode
    path.write_bytes(damaged)
    got, reader = read(path)
    assert got == written[: per_chunk[4]] + written[per_chunk[5] :]
    assert not reader.torn


@given(data=st.binary(max_size=300), cut=st.integers(0, 400))
def test_anything_behind_the_magic_is_survived(tmp_path_factory: pytest.TempPathFactory, data: bytes, cut: int) -> None:
    folder = tmp_path_factory.getbasetemp()
    base = folder / "base.mcap"
    if not base.exists():
        record(base, 12)
    path = folder / "any.mcap"
    for start in (8, 8 + cut):
        path.write_bytes(base.read_bytes()[:start] + data)
        got, reader = read(path)
        assert reader.torn
        assert len(got) <= 15


# --- no log at all ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b"hello world, this is a text", "is not an MCAP file, or its first bytes are damaged"),
        (b"#ROSBAG V2.0\n", "is a ROS 1 bag; convert it to MCAP (rosbags-convert)"),
        (b"SQLite format 3\0", "is an SQLite bag; convert it to MCAP (ros2 bag convert, rosbags-convert)"),
    ],
)
def test_files_of_other_kinds(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError) as error:
        LogReader(path)
    assert str(error.value) == f"{path}: {reason}"


def test_missing_file_and_directory(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"^\S*no\.mcap: no such file or directory$"):
        LogReader(tmp_path / "no.mcap")
    with pytest.raises(LogError, match=r"is a directory; name the \.mcap file inside it$"):
        LogReader(tmp_path)


def test_a_type_named_as_in_ros_1_is_read_under_its_full_name(tmp_path: Path) -> None:
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/Imu", "ros2msg", schemas.schema_text(schemas.IMU).encode())
        channel = writer.register_channel("/imu", "cdr", schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=b"\0\1\0\0")
        writer.finish()  # type: ignore[no-untyped-call]
    with LogReader(tmp_path / "x.mcap") as reader:
        assert [record.schema for record in reader] == ["sensor_msgs/msg/Imu"]
        assert "sensor_msgs/msg/Imu" in reader.schemas
