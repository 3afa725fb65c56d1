"""A flight that was recorded into several files, and what the output keeps besides messages."""

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from estimator.cli import app
from estimator.config import Config, load
from estimator.replay.replay import replay
from logs.store.reader import Attachment, LogError, LogReader, Record
from logs.store.recorder import FINDINGS_ATTACHMENT, Recorder
from logs.store.recover import recover
from logs.wire.codec import encode_input
from models.messages import ImuSample

RIG, MAP = Attachment("calibration/rig.yaml", "text/plain", b"rig"), Attachment("map/map.geojson", "text/plain", b"map")


@pytest.fixture(scope="module")
def config(flight: Path) -> Config:
    return load(flight.with_suffix(".toml"))


@pytest.fixture(scope="module")
def parts(flight: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The flight in three files, as landfix run rotates them."""
    folder = tmp_path_factory.mktemp("parts")
    with LogReader(flight) as reader:
        records = list(reader)
        attachments = reader.attachments
    third = len(records) // 3
    shares = records[:third], records[third : 2 * third], records[2 * third :]
    return [_written(folder / f"landfix-x-{k:03d}.mcap", k, share, attachments) for k, share in enumerate(shares)]


@pytest.fixture(scope="module")
def whole(flight: Path, config: Config, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The replay of the flight as one file."""
    out = tmp_path_factory.mktemp("whole") / "out.mcap"
    replay(flight, out, config)
    return out.read_bytes()


def _written(path: Path, number: int, records: list[Record], attachments: list[Attachment]) -> Path:
    with Recorder(path, metadata={"part": str(number)}) as recorder:
        for attachment in attachments:
            recorder.attach(*attachment)
        for r in records:
            recorder.write(r.topic, r.schema, r.data, r.log_time_ns)
    return path


def _run(*args: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in args])


def _attachments(log: Path) -> list[Attachment]:
    with LogReader(log) as reader:
        for _ in reader:
            pass
        return [a for a in reader.attachments if a.name != FINDINGS_ATTACHMENT]


def test_the_parts_in_any_order_or_their_folder_replay_to_the_bytes_of_the_whole(
    parts: list[Path], config: Config, whole: bytes, tmp_path: Path
) -> None:
    seen: list[float] = []
    summary = replay([parts[2], parts[0], parts[1]], tmp_path / "out.mcap", config, seen.append)
    assert (tmp_path / "out.mcap").read_bytes() == whole
    assert (summary.missing, summary.torn) == ("", False)
    assert seen == sorted(seen)
    assert 0.0 < seen[0] < 0.4 < seen[-1] <= 1.0
    replay(parts[0].parent, tmp_path / "out.mcap", config)
    assert (tmp_path / "out.mcap").read_bytes() == whole


def test_a_later_part_alone_is_said_to_be_not_the_flight(parts: list[Path], flight: Path, whole: bytes, tmp_path: Path) -> None:
    arguments = "-o", tmp_path / "out.mcap", "-c", flight.with_suffix(".toml")
    result = _run("replay", parts[2], *arguments)
    assert result.exit_code == 0
    assert "without parts 0, 1 of this flight the estimate aligns anew" in result.stderr
    assert "without part 1 of this flight" in _run("replay", parts[0], parts[2], *arguments).stderr
    for result in (_run("replay", parts[0], *arguments), _run("replay", *parts, *arguments)):
        assert result.exit_code == 0
        assert "this flight" not in result.stderr
    assert (tmp_path / "out.mcap").read_bytes() == whole


def test_many_missing_parts_are_reported_in_short(parts: list[Path], config: Config, tmp_path: Path) -> None:
    with LogReader(parts[0]) as reader:
        late = _written(tmp_path / "late.mcap", 40, list(reader)[:10], [])
    assert replay(late, tmp_path / "out.mcap", config).missing == "40 of the parts 0 to 39"


@pytest.mark.parametrize("number", [1, 2])
def test_a_torn_part_is_named_and_replayed_as_far_as_it_goes(
    parts: list[Path], flight: Path, tmp_path: Path, number: int
) -> None:
    torn = tmp_path / "landfix-torn.mcap"
    torn.write_bytes(parts[number].read_bytes()[: parts[number].stat().st_size // 2])
    given = [part for part in parts if part is not parts[number]]
    result = _run("replay", *given, torn, "-o", tmp_path / "out.mcap", "-c", flight.with_suffix(".toml"))
    assert result.exit_code == 0
    assert result.stderr == "landfix: landfix-torn.mcap is truncated; replayed up to its last whole record\n"


def test_a_part_made_whole_again_is_still_that_part(parts: list[Path], config: Config, whole: bytes, tmp_path: Path) -> None:
    again = [tmp_path / part.name for part in parts]
    for part, made in zip(parts, again, strict=True):
        recover(part, made)
    replay(again, tmp_path / "out.mcap", config)
    assert (tmp_path / "out.mcap").read_bytes() == whole
    assert replay(again[2], tmp_path / "out.mcap", config).missing == "parts 0, 1"
    with pytest.raises(LogError, match="are both part 1"):
        replay([*parts, again[1]], tmp_path / "out.mcap", config)


def test_a_damaged_part_and_what_was_recovered_of_it_count_once(parts: list[Path], config: Config, tmp_path: Path) -> None:
    damaged = tmp_path / "landfix-x-001.mcap"
    content = bytearray(parts[1].read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    alone = replay([parts[0], damaged, parts[2]], tmp_path / "out.mcap", config)
    recover(damaged, damaged.with_suffix(".recovered.mcap"))
    beside = replay([parts[0], *sorted(tmp_path.glob("landfix-x-*.mcap")), parts[2]], tmp_path / "out.mcap", config)
    assert alone.skipped_chunks == beside.skipped_chunks == 1
    assert alone.records == beside.records


def test_what_is_not_one_flight_is_refused(parts: list[Path], config: Config, tmp_path: Path) -> None:
    other = tmp_path / "landfix-y-000.mcap"
    other.write_bytes(parts[0].read_bytes())
    with pytest.raises(LogError, match="are both part 0"):
        replay([*parts, other], tmp_path / "out.mcap", config)
    (tmp_path / "landfix-x-001.mcap").write_bytes(parts[1].read_bytes())
    with pytest.raises(LogError, match=r"holds 2 flights \(landfix-x, landfix-y\)"):
        replay(tmp_path, tmp_path / "out.mcap", config)
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="holds no parts"):
        replay(tmp_path / "empty", tmp_path / "out.mcap", config)
    with pytest.raises(LogError, match="would overwrite the input"):
        replay(parts, parts[1], config)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log with a calibration and a map of its own, and of one IMU sample: a replay makes no estimate of it and exits with 1."""
    path = tmp_path / "in.mcap"
    encoded = encode_input(ImuSample(1, 1, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8)))
    return _written(path, 0, [Record(encoded.topic, encoded.schema, 1, encoded.data)], [RIG, MAP])


def test_files_that_the_configuration_names_take_the_place_of_the_logs_own(log: Path, tmp_path: Path) -> None:
    (tmp_path / "new.yaml").write_bytes(b"another rig")
    config, out = tmp_path / "c.toml", tmp_path / "out.mcap"
    config.write_text('[rig]\nfile = "new.yaml"\n')
    assert _run("replay", log, "-o", out, "-c", config).exit_code == 1
    first = _attachments(out)
    assert [(a.name, a.data) for a in first[1:]] == [("calibration/new.yaml", b"another rig"), (MAP.name, MAP.data)]
    assert _run("replay", out, "-o", tmp_path / "again.mcap", "-c", config).exit_code == 1
    assert (tmp_path / "again.mcap").read_bytes() == out.read_bytes()


def test_a_file_that_is_not_there_is_reported_and_the_logs_own_is_kept(log: Path, tmp_path: Path) -> None:
    config, out = tmp_path / "c.toml", tmp_path / "out.mcap"
    config.write_text('[rig]\nfile = "gone.yaml"\n')
    result = _run("replay", log, "-o", out, "-c", config)
    assert result.exit_code == 1
    assert "gone.yaml: no such file or directory; the output keeps the log's calibration" in result.stderr
    assert [a.name for a in _attachments(out)[1:]] == [RIG.name, MAP.name]
