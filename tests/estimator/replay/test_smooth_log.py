from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.cli import app
from estimator.config import Config, load
from estimator.filter.smoother import smooth
from estimator.replay.replay import replay
from estimator.replay.smooth_log import CONFIG_ATTACHMENT, TOPIC, write_smoothed
from logs.store.reader import LogError, LogReader, Record
from logs.wire.codec import decode_odometry
from models.sim.scenario import Simulation
from models.state import E, X


@pytest.fixture(scope="module")
def config(flight: Path) -> Config:
    return load(flight.with_suffix(".toml"))


@pytest.fixture(scope="module")
def estimate(flight: Path, config: Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("smooth") / "estimate.mcap"
    replay(flight, out, config)
    return out


@pytest.fixture(scope="module")
def out(estimate: Path, config: Config) -> Path:
    out = estimate.with_name("smoothed.mcap")
    write_smoothed(estimate, out, config)
    return out


def records(path: Path) -> list[Record]:
    with LogReader(path) as reader:
        return list(reader)


def bare(record: Record) -> tuple[str, str, int, bytes]:
    return record.topic, record.schema, record.log_time_ns, record.data


def test_everything_else_is_copied_byte_for_byte_in_its_order(estimate: Path, out: Path) -> None:
    assert [bare(r) for r in records(out) if r.topic != TOPIC] == [bare(r) for r in records(estimate)]


def test_what_is_written_is_the_smoothed_flight(simulation: Simulation, config: Config, out: Path) -> None:
    expected = smooth(simulation.messages, config.fusion())
    found = [r for r in records(out) if r.topic == TOPIC]
    assert len(found) == len(expected.t_ns) > 150
    for k in (0, 40, len(found) - 1):
        odometry = decode_odometry(found[k].data)
        assert odometry.t_ns == expected.t_ns[k]
        np.testing.assert_allclose(odometry.p_n, expected.nav[k][X.P], atol=1e-12)
        np.testing.assert_allclose(odometry.pose_covariance[:3, :3], expected.covariance[k][E.P, E.P], atol=1e-12)


def test_a_node_stands_at_the_arrival_of_the_sample_that_closes_it(out: Path) -> None:
    log_times = [r.log_time_ns for r in records(out)]
    assert log_times == sorted(log_times)
    for record in records(out):
        if record.topic == TOPIC:
            assert 0 <= record.log_time_ns - decode_odometry(record.data).t_ns <= 5_000_000  # 200 Hz, no delay


def test_smoothing_again_gives_the_same_bytes(out: Path, config: Config) -> None:
    again = out.with_name("again.mcap")
    write_smoothed(out, again, config)
    assert again.read_bytes() == out.read_bytes()


def test_the_log_reports_what_made_it(out: Path, config: Config) -> None:
    with LogReader(out) as reader:
        list(reader)
    assert [a.data.decode() for a in reader.attachments if a.name == CONFIG_ATTACHMENT] == [config.toml()]


def test_the_summary_and_progress(flight: Path, config: Config, tmp_path: Path) -> None:
    fractions: list[float] = []
    summary = write_smoothed(flight, tmp_path / "out.mcap", config, fractions.append)
    assert summary.nodes == sum(r.topic == TOPIC for r in records(tmp_path / "out.mcap"))
    assert summary.segments == 1
    assert 0.01 < summary.worst_sigma_m < 5.0
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_the_input_is_not_overwritten(flight: Path, config: Config) -> None:
    before = flight.read_bytes()
    with pytest.raises(LogError, match="overwrite"):
        write_smoothed(flight, flight, config)
    assert flight.read_bytes() == before


def test_a_file_that_is_no_log_is_refused(tmp_path: Path, config: Config) -> None:
    (tmp_path / "no.mcap").write_text("nothing")
    with pytest.raises(LogError):
        write_smoothed(tmp_path / "no.mcap", tmp_path / "out.mcap", config)


def test_the_command_writes_the_same(flight: Path, out: Path, tmp_path: Path) -> None:
    again = tmp_path / "smoothed.mcap"
    result = CliRunner().invoke(
        app, ["replay", str(flight), "-o", str(again), "-c", str(flight.with_suffix(".toml")), "--smooth"]
    )
    assert result.exit_code == 0, result.output
    assert "/landfix/smoothed" in result.stderr
    assert again.read_bytes() == out.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["smoothed.mcap"]
