from collections.abc import Callable
from pathlib import Path

import pytest

from estimator.config import Config, load
from estimator.replay.replay import replay
from logs.evaluation.evaluate import evaluate
from logs.store.reader import LogError, LogReader, Record
from logs.store.recorder import CONFIG_ATTACHMENT, FINDINGS_ATTACHMENT, Recorder
from logs.wire.codec import encode_input, encode_slow
from models.messages import Estimate, ImuSample, Tick


@pytest.fixture(scope="module")
def config(flight: Path) -> Config:
    return load(flight.with_suffix(".toml"))


@pytest.fixture(scope="module")
def estimate(flight: Path, config: Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("replay") / "estimate.mcap"
    replay(flight, out, config)
    return out


def records(path: Path) -> list[Record]:
    with LogReader(path) as reader:
        return list(reader)


def bare(record: Record) -> tuple[str, str, int, bytes]:
    return record.topic, record.schema, record.log_time_ns, record.data


def test_the_inputs_are_copied_byte_for_byte_in_their_order(flight: Path, estimate: Path) -> None:
    copied = [bare(r) for r in records(estimate) if not r.topic.startswith("/landfix/") and r.topic != "/tf"]
    assert copied == [bare(r) for r in records(flight)]


def test_an_estimate_follows_the_sample_that_caused_it_at_its_arrival(estimate: Path) -> None:
    last_imu_ns = 0
    estimates = 0
    for record in records(estimate):
        if record.topic == "/imu":
            last_imu_ns = record.log_time_ns
        elif record.topic == "/landfix/odometry":
            estimates += 1
            assert record.log_time_ns == last_imu_ns
    assert 3500 < estimates <= 4001  # 20 s at 200 Hz, less the alignment


def test_two_replays_give_the_same_bytes(flight: Path, estimate: Path, config: Config, tmp_path: Path) -> None:
    replay(flight, tmp_path / "again.mcap", config)
    assert (tmp_path / "again.mcap").read_bytes() == estimate.read_bytes()


def test_replaying_a_replay_gives_the_same_bytes(estimate: Path, config: Config, tmp_path: Path) -> None:
    replay(estimate, tmp_path / "again.mcap", config)
    assert (tmp_path / "again.mcap").read_bytes() == estimate.read_bytes()


def test_the_log_reports_what_made_it(estimate: Path, config: Config) -> None:
    with LogReader(estimate) as reader:
        list(reader)
    assert [a.data.decode() for a in reader.attachments if a.name == CONFIG_ATTACHMENT] == [config.toml()]
    assert set(reader.metadata["landfix"]) == {"version", "config_sha256"}


def test_the_summary_counts(flight: Path, config: Config, tmp_path: Path) -> None:
    fractions: list[float] = []
    summary = replay(flight, tmp_path / "out.mcap", config, fractions.append)
    assert summary.records == len(records(flight))
    assert summary.imu_samples == 4001
    assert 3500 < summary.estimates <= 4001
    assert summary.duration_s == pytest.approx(20.0, abs=0.5)
    assert sum(summary.fixes["/gnss"].values()) == sum(r.topic == "/gnss" for r in records(flight))
    assert sum(summary.fixes["/pose_fix"].values()) == sum(r.topic == "/pose_fix" for r in records(flight))
    assert summary.fixes["/gnss"]["fused"] > 40
    assert summary.worst_radius95_m is not None
    assert 0.0 < summary.worst_radius95_m < 100.0
    outages = [o.duration_s for o in evaluate(tmp_path / "out.mcap").outages if o.source == "all"]
    assert summary.longest_without_absolute_s == pytest.approx(max(outages, default=0.0))
    assert 15.0 < sum(summary.modes_s.values()) <= 20.0
    assert summary.internal_errors == 0
    assert not summary.torn
    estimates = [r for r in records(tmp_path / "out.mcap") if r.topic == "/landfix/odometry"]
    first_s = (estimates[0].log_time_ns - records(flight)[0].log_time_ns) * 1e-9
    assert summary.first_estimate_s == pytest.approx(first_s)
    assert fractions
    assert all(0.0 <= f <= 1.0 for f in fractions)
    assert fractions == sorted(fractions)


def test_own_outputs_are_left_out_and_own_inputs_kept(tmp_path: Path) -> None:
    """GIVEN a log with a tick, and a stale odometry; WHEN replayed; THEN the tick is there and the odometry gone."""
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    sample, tick = ImuSample(10**9, 10**9, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8)), Tick(10**9, 10**9)
    with Recorder(source) as recorder:
        recorder.write(*encode_input(sample), 10**9)
        recorder.write("/landfix/odometry", "nav_msgs/msg/Odometry", b"stale", 10**9)
        recorder.write(*encode_input(tick), 10**9)
    replay(source, out, Config())
    topics = [r.topic for r in records(out)]
    assert topics[0] == "/imu"
    assert "/landfix/tick" in topics
    assert b"stale" not in [r.data for r in records(out)]


def test_log_times_may_stand_still_or_go_back(tmp_path: Path) -> None:
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    times = [10**9, 10**9, 3 * 10**9, 2 * 10**9]
    with Recorder(source) as recorder:
        for t in times:
            recorder.write(*encode_input(ImuSample(t, t, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))), t)
    summary = replay(source, out, Config())
    assert [r.log_time_ns for r in records(out) if r.topic == "/imu"] == times
    assert summary.duration_s == pytest.approx(2.0)


def test_attachments_of_the_input_are_kept(tmp_path: Path) -> None:
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    with Recorder(source) as recorder:
        recorder.attach("rig.xml", "text/xml", b"<rig/>")
        recorder.attach(CONFIG_ATTACHMENT, "application/toml", b"# of another flight")
        recorder.write(*encode_input(ImuSample(1, 1, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))), 1)
    replay(source, out, Config())
    with LogReader(out) as reader:
        list(reader)
    assert [(a.name, a.data) for a in reader.attachments if a.name != FINDINGS_ATTACHMENT] == [
        (CONFIG_ATTACHMENT, Config().toml().encode()),
        ("rig.xml", b"<rig/>"),
    ]


def test_a_torn_log_is_replayed_to_its_last_whole_record(flight: Path, config: Config, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(flight.read_bytes()[: flight.stat().st_size // 2])
    summary = replay(torn, tmp_path / "out.mcap", config)
    whole = records(torn)
    assert summary.torn
    assert summary.records == len(whole) > 1000
    assert [bare(r) for r in records(tmp_path / "out.mcap") if r.topic == "/imu"] == [bare(r) for r in whole if r.topic == "/imu"]


def test_the_output_never_overwrites_the_input(flight: Path, config: Config) -> None:
    before = flight.read_bytes()
    with pytest.raises(LogError, match="would overwrite the input"):
        replay(flight, flight, config)
    assert flight.read_bytes() == before


def test_a_file_that_is_no_log_leaves_no_output(config: Config, tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_text("no log")
    with pytest.raises(LogError):
        replay(tmp_path / "no.mcap", tmp_path / "out.mcap", config)
    assert not (tmp_path / "out.mcap").exists()


def test_transforms_of_others_are_kept(tmp_path: Path, estimate_at: Callable[[int], Estimate]) -> None:
    """GIVEN /tf with our own map -> base_link, another's odom -> base_link and torn bytes; THEN only ours is left out."""
    source, out = tmp_path / "in.mcap", tmp_path / "out.mcap"
    ours = next(e for e in encode_slow(estimate_at(10**9)) if e.topic == "/tf")
    others = ours.data.replace(b"map\0", b"odo\0")
    with Recorder(source) as recorder:
        for data in (ours.data, others, b"torn"):
            recorder.write("/tf", ours.schema, data, 10**9)
    replay(source, out, Config())
    assert [r.data for r in records(out)] == [others, b"torn"]
