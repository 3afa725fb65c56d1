"""Fixes in part in a log: replayed from fixes to the same bytes, smoothed, and read from a log that is older than they are."""

from pathlib import Path

import pytest
from mcap.writer import Writer

from estimator.config import Config, parse
from estimator.replay.replay import replay
from logs.store.reader import LogReader, Record
from logs.store.recorder import Recorder
from logs.wire import schemas
from logs.wire.codec import decode_aid_status, encode_input
from logs.wire.schemas import schema_text
from models.messages import Input, LandmarkFix, Reason
from models.sim.scenario import Simulation
from tests.estimator.filter.test_partial_history import FLIGHT, _in_part
from tests.estimator.scenes import simulated

FIX = "/landfix/fix"


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulated(FLIGHT)


@pytest.fixture(scope="module")
def config(flight: Simulation) -> Config:
    return parse(flight.config_toml)


@pytest.fixture(scope="module")
def log(flight: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("partial") / "flight.mcap"
    with Recorder(path) as recorder:
        for message in _in_part(list(flight.messages)):
            recorder.write(*encode_input(message), message.arrived_ns)
    return path


def _records(path: Path, topic: str) -> list[Record]:
    with LogReader(path) as reader:
        return [record for record in reader if record.topic == topic]


def test_a_replay_fuses_them_and_its_own_replay_gives_the_same_bytes(log: Path, config: Config, tmp_path: Path) -> None:
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    replay(log, first, config)
    replay(first, second, config)
    assert first.read_bytes() == second.read_bytes()
    assert [r.data for r in _records(first, FIX)] == [r.data for r in _records(log, FIX)]
    statuses = [decode_aid_status(r.data) for r in _records(first, "/landfix/aid_status")]
    fused = [s for s in statuses if s.topic == FIX and s.reason is Reason.FUSED]
    assert len(fused) >= 10
    assert {len(s.innovation) for s in fused} == {2, 3, 4}


def _whole(fix: LandmarkFix) -> LandmarkFix:
    return LandmarkFix(fix.t_ns, fix.arrived_ns, fix.p_n, fix.q_nb_wxyz, fix.covariance, None, ("a",), 0.9, 0.3)


def _as_first_version(message: Input, writer: Writer, channels: dict[str, int]) -> None:
    """As a program wrote it whose LandmarkFix knew no directions."""
    topic, schema, data = encode_input(message)
    text = schema_text(schema)
    if schema == schemas.LANDMARK_FIX:
        text = text[: text.index("# The combinations of pose error")] + text[text.index("=" * 80) :]
        data = data[:-8]
    if topic not in channels:
        schema_id = writer.register_schema(schema, "ros2msg", text.encode())
        channels[topic] = writer.register_channel(topic, "cdr", schema_id)
    writer.add_message(channels[topic], message.arrived_ns, data, message.arrived_ns)


def test_a_log_of_the_first_version_is_replayed_and_written_as_one_of_today(
    flight: Simulation, config: Config, tmp_path: Path
) -> None:
    old, out, again = (tmp_path / name for name in ("old.mcap", "out.mcap", "again.mcap"))
    channels: dict[str, int] = {}
    with old.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for message in _in_part(list(flight.messages)):
            _as_first_version(_whole(message) if isinstance(message, LandmarkFix) else message, writer, channels)
        writer.finish()  # type: ignore[no-untyped-call]
    replay(old, out, config)
    replay(out, again, config)
    assert out.read_bytes() == again.read_bytes()
    reasons = {s.reason for s in (decode_aid_status(r.data) for r in _records(out, "/landfix/aid_status")) if s.topic == FIX}
    assert Reason.MALFORMED not in reasons
    assert Reason.FUSED in reasons
    with LogReader(out) as reader:
        assert any(record.topic == FIX for record in reader)
        assert b"float64[] readings" in reader.schemas[schemas.LANDMARK_FIX].data
