"""Torn and damaged logs made whole, and a recorder killed in the middle of its work."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from logs.store.reader import LogError, LogReader
from logs.store.recorder import Recorder
from logs.store.recover import RecoverSummary, recover
from logs.wire.codec import encode_input
from models.messages import ImuSample

START_NS = 1_700_000_000_000_000_000
STEP_NS = 5_000_000
FLUSH_NS = 100_000_000  # documented


def record(path: Path, count: int) -> None:
    with Recorder(path, metadata={"version": "1"}) as recorder:
        recorder.attach("config.toml", "application/toml", b"[imu]\n")
        for i in range(count):
            t_ns = START_NS + i * STEP_NS
            recorder.write(*encode_input(ImuSample(t_ns, t_ns, (0.0, 0.0, 1e-3 * i), (0.0, 0.0, -9.8))), t_ns)


def stamps(path: Path) -> list[int]:
    with LogReader(path) as reader:
        return [r.log_time_ns for r in reader]


def assert_opens_everywhere(path: Path, messages: int) -> None:
    """In mcap's indexed reader, checksums on, and in rosbags, messages deserialised by the schemas within."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == messages
        assert sum(1 for _ in reader.iter_messages()) == messages
        for channel in summary.channels.values():
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("config.toml", b"[imu]\n")]
        assert {m.name: m.metadata for m in reader.iter_metadata()} == {"landfix": {"version": "1"}}
    with AnyReader([path]) as bag:
        decoded: list[Any] = [bag.deserialize(data, c.msgtype) for c, _, data in bag.messages()]
    assert len(decoded) == messages
    assert all(m.linear_acceleration.z == pytest.approx(9.8) for m in decoded)


def test_a_torn_log_opens_everywhere(tmp_path: Path) -> None:
    # GIVEN a log cut within its last chunk, as a killed recorder leaves it
    whole, torn, out = (tmp_path / name for name in ("whole.mcap", "torn.mcap", "out.mcap"))
    record(whole, 1000)
    torn.write_bytes(whole.read_bytes()[: int(whole.stat().st_size * 0.6)])
    kept = stamps(torn)
    assert 300 < len(kept) < 1000
    # WHEN it is recovered
    summary = recover(torn, out)
    # THEN every whole chunk is in a file that mcap and rosbags open
    assert summary == RecoverSummary(
        messages=len(kept),
        attachments=1,
        metadata=1,
        chunks_lost=0,
        messages_lost=None,
        orphans=0,
        torn=True,
        bytes_read=torn.stat().st_size,
        bytes_written=out.stat().st_size,
    )
    assert str(summary).startswith(f"{len(kept)} messages, 1 attachments and 1 metadata records kept; 0 damaged places")
    assert stamps(out) == kept == [START_NS + i * STEP_NS for i in range(len(kept))]
    assert_opens_everywhere(out, len(kept))


def test_a_damaged_chunk_is_left_out_and_counted(tmp_path: Path) -> None:
    whole, bad, out = (tmp_path / name for name in ("whole.mcap", "bad.mcap", "out.mcap"))
    record(whole, 400)
    data = bytearray(whole.read_bytes())
    with whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    data[summary.chunk_indexes[3].chunk_start_offset + 200] ^= 1
    bad.write_bytes(data)
    fractions: list[float] = []
    result = recover(bad, out, progress=fractions.append)
    assert (result.messages, result.chunks_lost, result.messages_lost, result.torn) == (380, 1, 20, False)
    assert "1 damaged places skipped, 20 messages lost" in str(result)
    assert_opens_everywhere(out, 380)


def test_a_whole_log_stays_as_it_is_and_progress_is_reported(tmp_path: Path) -> None:
    whole, out = tmp_path / "whole.mcap", tmp_path / "out.mcap"
    record(whole, 25_000)
    fractions: list[float] = []
    result = recover(whole, out, progress=fractions.append)
    assert (result.messages, result.chunks_lost, result.messages_lost, result.torn) == (25_000, 0, 0, False)
    assert stamps(out) == stamps(whole)
    assert fractions == sorted(fractions)
    assert len(fractions) == 2
    assert 0.0 < fractions[0] < fractions[1] < 1.0


def test_a_log_of_another_program(landfix_data: Path, tmp_path: Path) -> None:
    source, out = landfix_data / "native_logs/nav2_turtlebot.mcap", tmp_path / "out.mcap"
    result = recover(source, out)
    assert (result.messages, result.torn) == (8197, False)
    with LogReader(source) as a, LogReader(out) as b:
        assert [(r.topic, r.schema, r.log_time_ns, r.data) for r in a] == [(r.topic, r.schema, r.log_time_ns, r.data) for r in b]


def test_a_log_without_a_message_becomes_an_empty_one(tmp_path: Path) -> None:
    torn, out = tmp_path / "torn.mcap", tmp_path / "out.mcap"
    record(torn, 10)
    torn.write_bytes(torn.read_bytes()[:40])
    result = recover(torn, out)
    assert (result.messages, result.torn) == (0, True)
    assert stamps(out) == []


def test_what_cannot_be_recovered_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    good, text = tmp_path / "good.mcap", tmp_path / "text.mcap"
    record(good, 10)
    before = good.read_bytes()
    text.write_text("no log at all")
    with pytest.raises(LogError, match=r"text\.mcap: is not an MCAP file"):
        recover(text, tmp_path / "out.mcap")
    with pytest.raises(LogError, match="the output would overwrite the input"):
        recover(good, good)
    with pytest.raises(LogError, match=r"none/out\.mcap: cannot be written \(no such file or directory\)"):
        recover(good, tmp_path / "none" / "out.mcap")
    assert good.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["good.mcap", "text.mcap"]


WRITER = """
import os, sys
from logs.wire.codec import encode_input
from logs.store.recorder import Recorder
from models.messages import ImuSample

with Recorder(sys.argv[1], metadata={"version": "1"}) as recorder:
    recorder.attach("config.toml", "application/toml", b"[imu]\\n")
    t_ns = int(sys.argv[2])
    imu = encode_input(ImuSample(t_ns, t_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8)))
    while True:
        recorder.write(*imu, t_ns)
        os.write(1, t_ns.to_bytes(8, "little"))
        t_ns += int(sys.argv[3])
"""


@pytest.mark.parametrize("written", [1, 20_011])
def test_killed_while_writing_loses_at_most_a_tenth_of_a_second(tmp_path: Path, written: int) -> None:
    # GIVEN a process that writes at full speed, and prints the log time of each message once it is written
    log, out = tmp_path / "log.mcap", tmp_path / "out.mcap"
    command = [sys.executable, "-c", WRITER, str(log), str(START_NS), str(STEP_NS)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=Path(__file__).parents[3]) as process:
        assert process.stdout is not None
        output = process.stdout.read(8 * written)
        # WHEN it is killed
        process.kill()
        output += process.stdout.read()
    last = int.from_bytes(output[-8 - len(output) % 8 :][:8], "little")
    # THEN less than 0.1 s of log time is missing, and what is there is whole
    result = recover(log, out)
    got = stamps(out)
    assert got == [START_NS + i * STEP_NS for i in range(len(got))]
    assert last - (START_NS + (len(got) - 1) * STEP_NS) <= FLUSH_NS
    assert result.torn
    assert result.chunks_lost == 0
    if got:
        assert_opens_everywhere(out, len(got))
