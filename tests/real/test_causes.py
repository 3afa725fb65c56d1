"""The cases whose words misled, and recorded flights without a fault: who is accused, of what."""

import lzma
import os
import shutil
from pathlib import Path

import pytest

from estimator.config import load
from logs.findings import Finding, Watch
from logs.importers import convert
from logs.store.reader import LogError, LogReader

ROOT = Path(__file__).parents[2]
CASES = Path(os.environ.get("LANDFIX_DATA", ROOT.parent / "shared" / "data")).parent / "cases"


def _case(name: str) -> Path:
    path = CASES / name
    if not path.exists():
        pytest.skip(f"{name} not found: set LANDFIX_DATA to the folder of recorded flights")
    return path


def _found(log: Path, config: Path) -> list[Finding]:
    loaded = load(config)
    decoder, watch = loaded.decoder(), Watch(loaded.map.origin)
    with LogReader(log) as reader:
        for record in reader:
            if (message := decoder.decode(record.topic, record.schema, record.data, record.log_time_ns)) is not None:
                watch.add(message)
    return watch.findings()


def _unpacked(packed: Path, folder: Path) -> Path:
    path = folder / packed.stem
    path.write_bytes(lzma.decompress(packed.read_bytes()))
    return path


@pytest.mark.parametrize(
    ("case", "config", "who", "words"),
    [
        ("turn3/gnss_jam", "", "/gnss", "scatter"),
        ("turn3/imu_batched", "", "/imu", "batches of 20, stamped on arrival"),
        ("turn3/imu_gyrostuck", "", "/imu", "gyroscope z reads 0"),
        ("turn3/imu_stamp2x", "", "/imu", "2 times the speed"),
        ("turn3/imu_stampback143", "", "/imu", "jump by -1.43 s"),
        ("logs/gnss_frozen_at_25s", "logs/base", "/gnss", "repeats one reading"),
        ("logs/pose_fix_frozen_at_25s", "logs/with_pose_fix", "/pose_fix", "repeats one reading"),
        ("logs/imu_frd_told_flu_no_truth", "logs/base", "/imu", "other convention"),
        ("logs/imu_gyro_accel_split", "logs/base", "/imu", "exactly 0 in 50%"),
        ("logs/imu_one_gyro_spike", "logs/base", "/imu", "1 samples are beyond any sensor"),
        ("fixes_in_centimetres", "", "/pose_fix", "centimetres"),
        ("decisions/stk_imu_holds_1s", "", "/imu", "repeats one reading for 1.0 s"),
        ("decisions/frz_pose_repeats_indoor", "", "/pose_fix", "repeats one reading for 8.0 s"),
        ("decisions/frz_pose_repeats_outdoor", "", "/pose_fix", "repeats one reading for 8.0 s"),
        ("decisions/gf0_gnss_freezes_20s", "", "/gnss", "repeats one reading for 19.8 s"),
    ],
)
def test_the_first_sentence_names_the_stream_and_its_fault(case: str, config: str, who: str, words: str, tmp_path: Path) -> None:
    packed = case.startswith("turn3")
    path = _case(f"{case}.mcap.xz" if packed else f"{case}.mcap")
    found = _found(_unpacked(path, tmp_path) if packed else path, CASES / f"{config or case}.toml")
    assert found
    assert found[0].who == who
    assert words in found[0].what


@pytest.mark.parametrize(
    "case", ["gnss_delay_mis_set", "decisions/la3_three_lookalikes", "logs/gnss_altitude_nan", "logs/schema_without_msg"]
)
def test_a_log_whose_streams_are_sound_accuses_none(case: str) -> None:
    config = "logs/base" if case.startswith("logs") else case
    assert _found(_case(f"{case}.mcap"), CASES / f"{config}.toml") == []


@pytest.mark.parametrize("case", ["csv_cout6", "csv_float32"])
def test_stamps_without_their_digits_are_refused(case: str, tmp_path: Path) -> None:
    shutil.unpack_archive(_case(f"turn3/{case}.tar.xz"), tmp_path)
    folder = next(path.parent for path in tmp_path.rglob("imu.csv*"))
    with pytest.raises(LogError, match="4002 stamps have one value"):
        convert("csv", folder, tmp_path / "o.mcap")


def test_the_bag_of_a_recorder_that_was_killed_is_read(tmp_path: Path) -> None:
    bag = _unpacked(_case("turn3/ros1_killed.bag.active.xz"), tmp_path)
    assert bag.name.endswith(".bag.active")
    assert convert("rosbag", bag, tmp_path / "o.mcap").messages


@pytest.mark.parametrize(
    ("kind", "source"),
    [
        ("csv", "flights/ardupilot_logs/log171"),
        ("csv", "flights/quad_rtk_dot/flight_a"),
        ("ulog", "native_logs/px4_fmuv6c_6s.ulg"),
        ("ulog", "native_logs/px4_sitl_v115_31s.ulg"),
    ],
)
def test_recorded_flights_accuse_none(kind: str, source: str, landfix_data: Path, tmp_path: Path) -> None:
    assert convert(kind, landfix_data / source, tmp_path / "o.mcap").findings == ()
