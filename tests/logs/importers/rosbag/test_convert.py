"""Bags of each storage give the log that the same messages give; what real bags get wrong is mended or named."""

import os
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from typer.testing import CliRunner

from estimator.cli import app
from estimator.config import load
from estimator.replay.replay import replay
from logs.importers import ImportOptions, convert
from logs.importers.rosbag.survey import TWIST_STAMPED, stamp, stamped
from logs.importers.summary import ImportSummary
from logs.store.reader import LogError, LogReader, Record
from logs.store.recorder import Recorder
from logs.wire import cdr_fast, schemas
from logs.wire.codec import Decoder, Topics
from logs.wire.schemas import STORE
from models.messages import GnssFix, ReceiverState
from tests.logs.importers.rosbag.bags import changed, flight, ros1, ros2, without_index

IMU, FIX, VELOCITY = "/mavros/imu/data_raw", "/gps/fix", "/gps/velocity"
NAV_STATUS = "ublox_msgs/msg/NavSTATUS"


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return flight()


def imported(source: Path, out: Path, imu: str = "") -> tuple[ImportSummary, list[Record]]:
    summary = convert("rosbag", source, out, options=ImportOptions(imu=imu))
    with LogReader(out) as reader:
        return summary, list(reader)


def parsed(data: bytes, schema: str) -> Any:
    return STORE.deserialize_cdr(data, schema)


def bytes_of(records: list[Record]) -> list[tuple[str, int, bytes]]:
    return [(r.topic, r.log_time_ns, r.data) for r in records]


def use(summary: ImportSummary) -> dict[str, str]:
    return {row.topic: row.use for row in summary.topics}


def remark(summary: ImportSummary, topic: str) -> str:
    return next(row.remark for row in summary.topics if row.topic == topic)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_ros2_bags_are_copied_byte_for_byte(records: list[Record], tmp_path: Path, storage: StoragePlugin) -> None:
    bag = ros2(tmp_path / "bag", records, storage)
    summary, log = imported(bag, tmp_path / "flight.mcap")
    assert bytes_of(log) == bytes_of(records)
    assert use(summary) == {IMU: "imu", FIX: "gnss", VELOCITY: "gnss_velocity"}
    (file,) = [p for p in bag.iterdir() if p.suffix in {".db3", ".mcap"}]
    _, alone = imported(file, tmp_path / "alone.mcap")
    assert bytes_of(alone) == bytes_of(records)


@pytest.mark.parametrize("compression", [None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4])
def test_ros1_bags_become_the_same_log(
    records: list[Record], tmp_path: Path, compression: Writer1.CompressionFormat | None
) -> None:
    _, log = imported(ros1(tmp_path / "flight.bag", records, compression), tmp_path / "flight.mcap")
    assert bytes_of(log) == bytes_of(records)


@pytest.mark.parametrize("compression", [None, Writer1.CompressionFormat.BZ2, Writer1.CompressionFormat.LZ4])
def test_a_ros1_bag_without_index_is_read_to_its_last_whole_record(
    records: list[Record], tmp_path: Path, compression: Writer1.CompressionFormat | None
) -> None:
    bag = ros1(tmp_path / "flight.bag", records, compression)
    summary, log = imported(without_index(bag, cut=0.8), tmp_path / "flight.mcap")
    assert 0.3 * len(records) < len(log) < 0.9 * len(records)
    assert bytes_of(log) == bytes_of(records)[: len(log)]
    assert "no index" in " ".join(summary.notes)


def test_the_log_is_replayed_with_the_configuration_that_was_written(records: list[Record], tmp_path: Path) -> None:
    imported(ros2(tmp_path / "bag", records, StoragePlugin.MCAP), tmp_path / "flight.mcap")
    summary = replay(tmp_path / "flight.mcap", tmp_path / "estimate.mcap", load(tmp_path / "flight.toml"))
    assert summary.estimates > 2000
    assert set(summary.fixes[FIX]) <= {"aligning", "fused"}


def test_an_imu_with_z_down_is_read_as_frd(records: list[Record], tmp_path: Path) -> None:
    def turned(r: Record) -> Record:
        m = parsed(r.data, schemas.IMU)
        for v in (m.angular_velocity, m.linear_acceleration):
            v.y, v.z = -v.y, -v.z
        return Record(r.topic, r.schema, r.log_time_ns, bytes(STORE.serialize_cdr(m, schemas.IMU)))

    summary, _ = imported(ros2(tmp_path / "bag", changed(records, IMU, turned), StoragePlugin.MCAP), tmp_path / "a.mcap")
    assert load(tmp_path / "a.toml").imu.axes == "frd"
    assert any("z points down" in note for note in summary.notes)


@pytest.mark.parametrize(("axes", "mounting"), [((0, 2, 1), (90.0, 0.0)), ((2, 1, 0), (0.0, 90.0))])
def test_an_imu_on_its_side_is_stood_upright(
    records: list[Record], tmp_path: Path, axes: tuple[int, int, int], mounting: tuple[float, float]
) -> None:
    """y up, then x up; FLU, so that what was up is along another axis."""

    def turned(r: Record) -> Record:
        m = parsed(r.data, schemas.IMU)
        for v in (m.angular_velocity, m.linear_acceleration):
            old = (v.x, v.y, v.z)
            v.x, v.y, v.z = (old[k] if k == j else (old[2] if j == axes.index(2) else -old[k]) for j, k in enumerate(axes))
        return Record(r.topic, r.schema, r.log_time_ns, bytes(STORE.serialize_cdr(m, schemas.IMU)))

    imported(ros2(tmp_path / "bag", changed(records, IMU, turned), StoragePlugin.MCAP), tmp_path / "a.mcap")
    config = load(tmp_path / "a.toml")
    assert config.imu.mounting_rpy_deg[:2] == mounting
    decoder = config.decoder()
    with LogReader(tmp_path / "a.mcap") as reader:
        messages = [decoder.decode(r.topic, r.schema, r.data, r.log_time_ns) for r in reader if r.topic == IMU]
    force = np.mean([m.accel_b for m in messages if m is not None], axis=0)  # type: ignore[union-attr]
    assert force[2] < -9.0


def test_stamps_of_zero_become_the_time_of_recording(records: list[Record], tmp_path: Path) -> None:
    empty = changed(records, FIX, lambda r: Record(r.topic, r.schema, r.log_time_ns, stamped(r.data, 0)))
    summary, log = imported(ros2(tmp_path / "bag", empty, StoragePlugin.MCAP), tmp_path / "a.mcap")
    assert all(stamp(r.data) == r.log_time_ns for r in log if r.topic == FIX)
    assert any(note.startswith(f"{FIX}: has no stamps") for note in summary.notes)


def test_an_imu_of_another_clock_takes_the_arrivals_with_it(records: list[Record], tmp_path: Path) -> None:
    """As in a bag that was recorded anew while an old one was played: all stamps are a year older than the recording."""
    year = 365 * 86400 * 10**9
    later = [Record(r.topic, r.schema, r.log_time_ns + year, r.data) for r in records]
    summary, log = imported(ros2(tmp_path / "bag", later, StoragePlugin.MCAP), tmp_path / "a.mcap")
    assert max(abs(a.log_time_ns - b.log_time_ns) for a, b in zip(log, records, strict=True)) < 10**8
    assert [r.data for r in log] == [r.data for r in records]
    assert any("off the times of recording" in note for note in summary.notes)


def test_a_receiver_of_another_clock_is_stamped_anew(records: list[Record], tmp_path: Path) -> None:
    gps_week = changed(records, FIX, lambda r: Record(r.topic, r.schema, r.log_time_ns, stamped(r.data, r.log_time_ns - 10**12)))
    _, log = imported(ros2(tmp_path / "bag", gps_week, StoragePlugin.MCAP), tmp_path / "a.mcap")
    assert all(stamp(r.data) == r.log_time_ns for r in log if r.topic == FIX)


def test_each_receiver_feeds_the_estimator_once(records: list[Record], tmp_path: Path) -> None:
    """A relay repeats the first receiver, a filter publishes NavSatFix too; a second receiver is a source of its own."""
    more = []
    for r in records:
        more.append(r)
        if r.topic == FIX:
            m = parsed(r.data, r.schema)
            more += [Record(name, r.schema, r.log_time_ns, r.data) for name in ("/relay", "/gps/filtered")]
            m.latitude += 1e-6
            more.append(Record("/gps2/fix", r.schema, r.log_time_ns, bytes(STORE.serialize_cdr(m, r.schema))))
    summary, log = imported(ros2(tmp_path / "bag", more, StoragePlugin.MCAP), tmp_path / "a.mcap")
    assert load(tmp_path / "a.toml").inputs.gnss == (FIX, "/gps2/fix")
    assert "repeats the fixes" in remark(summary, "/relay")
    assert "filter" in remark(summary, "/gps/filtered")
    assert {r.topic for r in log} >= {"/relay", "/gps/filtered"}


def test_of_two_imus_the_faster_is_taken_or_the_one_that_is_named(records: list[Record], tmp_path: Path) -> None:
    slow = [Record("/imu2", r.schema, r.log_time_ns, r.data) for r in records if r.topic == IMU][::2]
    bag = ros2(tmp_path / "bag", sorted([*records, *slow], key=lambda r: r.log_time_ns), StoragePlugin.SQLITE3)
    assert use(imported(bag, tmp_path / "a.mcap")[0])["/imu2"] == ""
    summary, _ = imported(bag, tmp_path / "b.mcap", imu="/imu2")
    assert (use(summary)["/imu2"], use(summary)[IMU]) == ("imu", "")
    with pytest.raises(LogError, match="/imu3"):
        imported(bag, tmp_path / "c.mcap", imu="/imu3")


def test_a_twist_without_covariance_is_a_velocity_of_unknown_accuracy(records: list[Record], tmp_path: Path) -> None:
    def bare(r: Record) -> Record:
        return Record(r.topic, TWIST_STAMPED, r.log_time_ns, r.data[: -8 * 36])

    _, log = imported(ros2(tmp_path / "bag", changed(records, VELOCITY, bare), StoragePlugin.MCAP), tmp_path / "a.mcap")
    decoder = load(tmp_path / "a.toml").decoder()
    (first, *_) = [r for r in log if r.topic == VELOCITY]
    (given, *_) = [r for r in records if r.topic == VELOCITY]
    velocity = decoder.decode(first.topic, first.schema, first.data, first.log_time_ns)
    twist = parsed(given.data, schemas.TWIST).twist.twist.linear
    assert velocity.v_n == (twist.y, twist.x, -twist.z)  # type: ignore[union-attr]


def test_poses_are_kept_and_offered_but_not_used(records: list[Record], tmp_path: Path) -> None:
    poses = [Record("/vio/odometry", schemas.ODOMETRY, r.log_time_ns, cdr_fast.odometry(r.log_time_ns, np.eye(1, 85, 6)[0]))
             for r in records if r.topic == FIX]  # fmt: skip
    bag = ros2(tmp_path / "bag", sorted([*records, *poses], key=lambda r: r.log_time_ns), StoragePlugin.MCAP)
    _, log = imported(bag, tmp_path / "a.mcap")
    assert sum(r.topic == "/vio/odometry" for r in log) == len(poses)
    written = (tmp_path / "a.toml").read_text()
    assert load(tmp_path / "a.toml").inputs.odometry == ()
    (tmp_path / "used.toml").write_text(written.replace('# odometry = "/vio', 'odometry = "/vio'))
    assert load(tmp_path / "used.toml").inputs.odometry == ("/vio/odometry",)


def test_a_torn_mcap_is_read_as_far_as_it_goes(records: list[Record], tmp_path: Path) -> None:
    file = tmp_path / "bag.mcap"
    with Recorder(file) as recorder:
        for r in records:
            recorder.write(r.topic, r.schema, r.data, r.log_time_ns)
    file.write_bytes(file.read_bytes()[: int(0.7 * file.stat().st_size)])
    summary, log = imported(file, tmp_path / "flight.mcap")
    assert 0.3 * len(records) < len(log) < len(records)
    assert any("what stands before was read" in note for note in summary.notes)


def test_a_database_needs_no_metadata_and_a_torn_one_is_refused_with_the_remedy(records: list[Record], tmp_path: Path) -> None:
    bag = ros2(tmp_path / "bag", records, StoragePlugin.SQLITE3)
    (file,) = bag.glob("*.db3")
    (bag / "metadata.yaml").unlink()
    _, log = imported(bag, tmp_path / "flight.mcap")
    assert bytes_of(log) == bytes_of(records)
    file.write_bytes(file.read_bytes()[:300_001])
    with pytest.raises(LogError, match=r"\.recover"):
        imported(bag, tmp_path / "torn.mcap")


@pytest.mark.parametrize("place", [lambda path: path.write_text("z: [" + "1," * 300_000 + "1]\n"), os.mkfifo])
def test_metadata_that_nobody_writes_are_passed_over(
    place: Callable[[Path], object], records: list[Record], tmp_path: Path
) -> None:
    bag = ros2(tmp_path / "bag", records, StoragePlugin.SQLITE3)
    (bag / "metadata.yaml").unlink()
    place(bag / "metadata.yaml")
    _, log = imported(bag, tmp_path / "flight.mcap")
    assert bytes_of(log) == bytes_of(records)


_LIMITED = """
import resource, sys
from pathlib import Path
from logs.importers import convert
from logs.store.reader import LogError
resource.setrlimit(resource.RLIMIT_AS, (2**31, 2**31))
try:
    convert("rosbag", Path(sys.argv[1]), Path(sys.argv[2]))
except LogError as error:
    print(error)
"""


def test_a_header_of_2_gib_is_refused_within_less_memory(tmp_path: Path) -> None:
    bag = tmp_path / "a.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n\xff\xff\xff\x7f" + bytes(100))
    words = [sys.executable, "-c", _LIMITED, str(bag), str(tmp_path / "o.mcap")]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    assert said.endswith("a.bag: cannot be read as a ROS 1 bag: a record declares more content than there is\n")


def test_the_files_of_a_folder_are_one_flight_in_the_order_of_their_numbers(records: list[Record], tmp_path: Path) -> None:
    folder, third = tmp_path / "bag", len(records) // 3
    folder.mkdir()
    for k, part in ((2, records[:third]), (9, records[third : 2 * third]), (10, records[2 * third :])):
        (file,) = ros2(tmp_path / f"part{k}", part, StoragePlugin.SQLITE3).glob("*.db3")
        file.rename(folder / f"bag_{k}.db3")
    _, log = imported(folder, tmp_path / "flight.mcap")
    assert bytes_of(log) == bytes_of(records)


def test_what_is_no_bag_or_has_no_imu_is_refused_in_one_line(records: list[Record], tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "note.bag").write_text("a text")
    (tmp_path / "no.db3").write_text("a text")
    without = ros2(tmp_path / "without", [r for r in records if r.topic != IMU], StoragePlugin.MCAP)
    for source, words in (
        (tmp_path / "absent.bag", "no such file"), (tmp_path / "empty", "holds no bag"), (tmp_path / "note.bag", "ROS 1 bag"),
        (tmp_path / "no.db3", "ROS 2 bag"), (without, "no topic of type sensor_msgs/msg/Imu"),
    ):  # fmt: skip
        said = CliRunner().invoke(app, ["import", "rosbag", str(source), "-o", str(tmp_path / "a.mcap")])
        assert (said.exit_code, said.stderr.count("\n")) == (1, 1)
        assert words in said.stderr
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("kind", ["ros1", "ros2"])
def test_the_flags_of_a_u_blox_driver_are_in_the_fixes_of_its_namespace(records: list[Record], tmp_path: Path, kind: str) -> None:
    """NAV-STATUS of ublox_msgs, once a second for ten seconds: spoofed (flags2, bits 3 and 4)."""
    fields = "uint32 i_tow\nuint8 gps_fix\nuint8 flags\nuint8 fix_stat\nuint8 flags2\nuint32 ttff\nuint32 msss\n"
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(fields, NAV_STATUS))
    begin_ns = records[0].log_time_ns
    status = struct.pack("<I4BII", 5000, 3, 0xDD, 0, 3 << 3, 1, 2)
    flags = [Record("/gps/navstatus", NAV_STATUS, begin_ns + k * 10**9, b"\0\1\0\0" + status) for k in range(5, 15)]
    everything = sorted([*records, *flags], key=lambda r: r.log_time_ns)
    bag = (
        ros1(tmp_path / "flight.bag", everything, foreign=store)
        if kind == "ros1"
        else ros2(tmp_path / "bag", everything, StoragePlugin.SQLITE3, foreign=store)
    )
    summary, log = imported(bag, tmp_path / "flight.mcap")
    assert remark(summary, "/gps/navstatus") == "its flags are in the fixes of its namespace"
    decoder = Decoder(Topics.of({"gnss": FIX}))
    fixes = [decoder.decode(r.topic, r.schema, r.data, r.log_time_ns) for r in log if r.topic == FIX]
    spoofed = [(m.arrived_ns - begin_ns) * 1e-9 for m in fixes if isinstance(m, GnssFix) and m.state is ReceiverState.SPOOFED]
    assert 5.0 <= spoofed[0] < 5.3
    assert 18.7 < spoofed[-1] < 19.0  # five seconds after the last word
    assert f"the receiver reports jamming or spoofing in {len(spoofed)} fixes" in summary.notes
    assert {r.topic for r in log} == {IMU, FIX, VELOCITY}


def test_the_command_prints_a_row_for_each_topic(records: list[Record], tmp_path: Path) -> None:
    bag = ros1(tmp_path / "flight.bag", records)
    said = CliRunner().invoke(app, ["import", "rosbag", str(bag), "-o", str(tmp_path / "a.mcap")], env={"COLUMNS": "150"})
    assert said.exit_code == 0
    assert [line.split()[4:6] for line in said.stdout.splitlines() if line.startswith(FIX)] == [["Hz", "gnss"]]
