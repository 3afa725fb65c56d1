"""The log's own thread: nothing is lost, whatever the disk does."""

import os
import resource
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from estimator.service.base.ports import Arrival
from estimator.service.log import writer
from estimator.service.log.recovery import FolderError, FolderLock, recover_in_background, torn_logs
from estimator.service.log.writer import LogConfig, LogWriter
from logs.store.reader import Attachment, LogReader
from logs.store.recorder import Recorder
from logs.wire import schemas
from logs.wire.codec import Encoded
from tests.estimator.service.flying import records, until

T0 = 1_795_000_000_000_000_000
MS = 1_000_000


def _arrival(k: int, size: int = 300, topic: str = "/imu") -> Arrival:
    return Arrival(topic, schemas.IMU, k.to_bytes(8, "little") * (size // 8), T0 + k * MS)


def _number(data: bytes) -> int:
    return int.from_bytes(data[:8], "little")


@contextmanager
def _writer(folder: Path, hold: Callable[[], None] = lambda: None, **config: object) -> Iterator[LogWriter]:
    settings = LogConfig(**({"least_free_mb": 0.0} | config))  # type: ignore[arg-type]
    kept = [Attachment("config.toml", "application/toml", b"[imu]\n")]
    log = LogWriter(settings, lambda n: folder / f"landfix-{n:03d}.mcap", {"version": "1"}, kept, hold)
    try:
        yield log
    finally:
        log.close()


def test_it_is_written_in_order_with_what_belongs_to_it(tmp_path: Path) -> None:
    with _writer(tmp_path) as log:
        for k in range(500):
            log.put_input(_arrival(k))
            log.put_output(Encoded("/landfix/odometry", schemas.ODOMETRY, k.to_bytes(8, "little")), T0 + k * MS)
    with LogReader(tmp_path / "landfix-000.mcap") as reader:
        read = [(r.topic, _number(r.data)) for r in reader]
        assert not reader.torn
        assert [a.data for a in reader.attachments] == [b"[imu]\n"]
    assert read == [(topic, k) for k in range(500) for topic in ("/imu", "/landfix/odometry")]


def test_what_was_put_a_tenth_of_a_second_ago_is_on_disk(tmp_path: Path) -> None:
    with _writer(tmp_path) as log:
        for k in range(10):
            log.put_input(_arrival(k))
        until(lambda: _found(tmp_path) == 10, "all is on disk")


def _found(folder: Path) -> int:
    file = folder / "landfix-000.mcap"
    return len(records(file)) if file.exists() and file.stat().st_size > 8 else 0


def test_it_rotates_by_size_and_loses_nothing_in_between(tmp_path: Path) -> None:
    with _writer(tmp_path, rotate_mb=0.02) as log:
        for k in range(40):
            for n in range(25):
                log.put_input(_arrival(25 * k + n, size=304))
            time.sleep(0.08)
    files = sorted(tmp_path.glob("*.mcap"))
    assert len(files) >= 2
    assert all(sum(len(r.data) for r in records(file)) > 20_000 for file in files[:-1])
    assert [_number(r.data) for file in files for r in records(file)] == list(range(1000))
    for n, file in enumerate(files):
        with LogReader(file) as reader:
            list(reader)
            assert not reader.torn
            assert len(reader.attachments) == 1
            assert reader.metadata["landfix"]["part"] == str(n)


def _delete(file: Path) -> None:
    file.unlink()


def _replace(file: Path) -> None:
    file.unlink()
    file.write_bytes(b"somebody else's")


def _move(file: Path) -> None:
    file.rename(file.with_suffix(".moved"))


def _delete_folder(file: Path) -> None:
    shutil.rmtree(file.parent)


@pytest.mark.parametrize("act", [_delete, _replace, _move, _delete_folder])
def test_a_file_that_is_gone_is_noticed_and_followed_by_another(tmp_path: Path, act: Callable[[Path], None]) -> None:
    folder = tmp_path / "logs"
    with _writer(folder) as log:
        log.put_input(_arrival(1))
        until(lambda: log.state.file, "the log begins")
        act(folder / "landfix-000.mcap")
        until(lambda: log.state.removed_files == 1, "it is noticed", seconds=5.0)
        assert log.state.state == "recording"
        log.put_input(_arrival(2))
        time.sleep(1.2)  # the next look
        assert log.state.removed_files == 1
    assert [_number(r.data) for r in records(folder / "landfix-001.mcap")] == [2]


def test_oldest_logs_make_room_where_that_is_allowed(tmp_path: Path) -> None:
    for name in ("landfix-20200101.mcap", "landfix-20250101.mcap", "another.mcap"):
        (tmp_path / name).write_bytes(b"x" * 600_000)
    settings = LogConfig(least_free_mb=0.0, keep_gb=0.001)
    log = LogWriter(settings, lambda n: tmp_path / f"landfix-2026010{n}.mcap", {})
    until(lambda: log.state.file, "the log begins")
    log.close()
    assert sorted(p.name for p in tmp_path.glob("*.mcap")) == ["another.mcap", "landfix-20250101.mcap", "landfix-20260100.mcap"]


def test_a_full_disk_is_reported_and_survived_and_nothing_is_lost(tmp_path: Path) -> None:
    """The limit on the size of files stands for the full disk: a write fails in the middle, later ones succeed again."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with _writer(tmp_path) as log:
        until(lambda: log.state.file, "the log begins")
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, hard))
        try:
            k = 0
            while not log.state.state.startswith("failed"):
                for _ in range(20):
                    log.put_input(Arrival("/imu", schemas.IMU, k.to_bytes(8, "little") + _noise(k, 300), T0 + k * MS))
                    k += 1
                time.sleep(0.005)
                assert k < 100_000
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        assert "cannot be written" in log.state.state
        until(lambda: log.state.state == "recording", "the log goes on")
        assert log.state.lost_inputs == 0
    numbers = [_number(r.data) for file in sorted(tmp_path.glob("*.mcap")) for r in records(file)]
    assert sorted(set(numbers)) == list(range(k))


def _noise(k: int, size: int) -> bytes:
    """Bytes that do not compress."""
    state, out = k * 2654435761 + 1, bytearray()
    while len(out) < size:
        state = state * 6364136223846793005 + 1442695040888963407 & (1 << 64) - 1
        out += (state >> 32).to_bytes(4, "little")
    return bytes(out[:size])


def test_a_disk_that_is_slow_to_sync_holds_up_no_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    syncing, synced = threading.Event(), threading.Event()

    def fsync(_: int) -> None:
        syncing.set()
        synced.wait()

    monkeypatch.setattr("os.fsync", fsync)
    with _writer(tmp_path, sync_s=0.01) as log:
        try:
            log.put_input(_arrival(0))
            assert syncing.wait(60.0)
            log.put_input(_arrival(1))
            until(lambda: _found(tmp_path) == 2, "what comes meanwhile is on disk")
        finally:
            synced.set()


def test_what_waits_for_a_disk_gets_a_last_chance_at_the_end(tmp_path: Path) -> None:
    blocked = tmp_path / "logs"
    blocked.write_text("")
    with _writer(blocked) as log:
        until(lambda: log.state.state.startswith("failed"), "the disk takes nothing")
        log.put_input(_arrival(7))
        blocked.unlink()
    assert [_number(r.data) for r in records(blocked / "landfix-000.mcap")] == [7]


def test_with_too_little_space_it_waits(tmp_path: Path) -> None:
    with _writer(tmp_path, least_free_mb=1e9) as log:
        log.put_input(_arrival(1))
        until(lambda: log.state.state.startswith("waiting for space"), "it says so")
        assert list(tmp_path.glob("*.mcap")) == []
        assert log.waiting_bytes == 296


def test_a_folder_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("a file where a folder should be")
    with _writer(tmp_path / "logs") as log:
        log.put_input(_arrival(1))
        until(lambda: log.state.state.startswith("failed"), "it says so")


def test_images_make_room_for_newer_ones_and_inputs_for_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that does not take anything: the folder's name is that of a file."""
    blocked = tmp_path / "logs"
    blocked.write_text("")
    monkeypatch.setattr(writer, "_IMAGES_LIMIT", 1_000_000)
    with _writer(blocked) as log:
        until(lambda: log.state.state.startswith("failed"), "the disk takes nothing")
        for k in range(100):
            log.put_image(Arrival("/left/image", schemas.IMAGE, k.to_bytes(8, "little") * 5000, T0 + k))
            log.put_input(_arrival(k))
            log.put_output(Encoded("/landfix/odometry", schemas.ODOMETRY, bytes(500_000)), T0 + k)
        state = log.state
        assert state.dropped_images == 75
        assert state.lost_inputs == 0
        assert 30 < state.dropped_outputs < 40
        blocked.unlink()
        until(lambda: log.state.state == "recording", "the disk takes all")
    images = [_number(r.data) for r in records(blocked / "landfix-000.mcap", "/left/image")]
    assert images == list(range(75, 100))
    assert len(records(blocked / "landfix-000.mcap", "/imu")) == 100


def test_a_name_that_is_there_already_is_left_alone(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_bytes(b"somebody's")
    (tmp_path / "landfix-000.mcap").symlink_to(elsewhere)
    (tmp_path / "landfix-001.mcap").write_bytes(b"another's")
    with _writer(tmp_path) as log:
        log.put_input(_arrival(3))
        until(lambda: log.state.state == "recording" and log.state.file, "it records under the next name")
    assert elsewhere.read_bytes() == b"somebody's"
    assert (tmp_path / "landfix-001.mcap").read_bytes() == b"another's"
    assert [_number(r.data) for r in records(tmp_path / "landfix-002.mcap")] == [3]


def test_a_file_that_another_program_shortens_is_noticed_and_followed_by_another(tmp_path: Path) -> None:
    with _writer(tmp_path) as log:
        log.put_input(_arrival(1))
        until(lambda: _found(tmp_path) == 1, "the log begins")
        os.truncate(tmp_path / "landfix-000.mcap", 20)
        log.put_input(_arrival(2))
        until(lambda: log.state.removed_files == 1, "it is noticed", seconds=5.0)
        until(lambda: log.state.state == "recording", "the log goes on", seconds=5.0)
    assert [_number(r.data) for r in records(tmp_path / "landfix-001.mcap")] == [2]


def test_a_thread_that_stands_still_is_said_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    goes_on, flush = threading.Event(), Recorder.flush

    def stuck(recorder: Recorder) -> None:
        goes_on.wait()
        flush(recorder)

    with _writer(tmp_path) as log:
        until(lambda: log.state.file, "the log begins")
        monkeypatch.setattr(Recorder, "flush", stuck)
        try:
            log.put_input(_arrival(1))
            until(lambda: log.state.state.startswith("stalled"), "it says so", seconds=2.5)
            assert log.state.stalls == 1
        finally:
            goes_on.set()
        until(lambda: log.state.state == "recording", "it goes on")
        assert log.state.stalls == 1
        assert log.state.lost_inputs == 0


def test_what_a_stuck_thread_cannot_write_is_counted_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    goes_on = threading.Event()
    with _writer(tmp_path) as log:
        until(lambda: log.state.file, "the log begins")
        monkeypatch.setattr(Recorder, "flush", lambda _: goes_on.wait())
        log.put_input(_arrival(1))
        time.sleep(0.3)
        for k in range(5):
            log.put_input(_arrival(k))
        log.close(timeout_s=0.1)
        assert log.state.lost_inputs == 5
        goes_on.set()


def test_the_lock_does_not_vanish_with_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    with FolderLock(folder) as lock, _writer(folder, hold=lock.hold) as log:
        until(lambda: log.state.file, "the log begins")
        shutil.rmtree(folder)
        until(lambda: log.state.removed_files == 1 and log.state.state == "recording", "it begins anew", seconds=5.0)
        with pytest.raises(FolderError, match="another landfix records there"):
            FolderLock(folder)


def test_a_folder_that_another_took_meanwhile_is_said_and_the_flight_recorded(tmp_path: Path) -> None:
    with FolderLock(tmp_path) as lock, _writer(tmp_path, hold=lock.hold) as log:
        until(lambda: log.state.file, "the log begins")
        (tmp_path / "landfix.lock").unlink()
        with FolderLock(tmp_path):
            until(lambda: "another landfix records there" in log.state.state, "it says so", seconds=5.0)
            assert log.state.state.startswith("recording: ")
            log.put_input(_arrival(1))
        until(lambda: log.state.state == "recording", "it is alone again", seconds=5.0)
    assert [_number(r.data) for r in records(tmp_path / "landfix-000.mcap")] == [1]


def test_links_and_pipes_in_the_folder_are_neither_followed_nor_waited_for(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_bytes(b"somebody's")
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "landfix-a.mcap").symlink_to(elsewhere)
    (folder / "landfix-b.mcap").symlink_to(folder / "nowhere")
    os.mkfifo(folder / "landfix-c.mcap")
    assert torn_logs(folder) == []
    with _writer(folder, keep_gb=1.0) as log:
        until(lambda: log.state.file, "the log begins")
    (folder / "landfix.lock").symlink_to(elsewhere)
    with pytest.raises(FolderError, match="symbolic links"):
        FolderLock(folder)
    torn = folder / "landfix-d.mcap"
    torn.write_bytes(b"\x89MCAP0\r\n")
    (folder / "landfix-d.recovered.part").symlink_to(elsewhere)
    process = recover_in_background(folder)
    assert process is not None
    assert process.wait(60) == 0
    assert not torn_logs(folder)
    assert elsewhere.read_bytes() == b"somebody's"


def test_a_pause_while_it_ends_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "_STALL_S", 0.2)
    close = Recorder.close

    def slow(recorder: Recorder) -> None:
        time.sleep(0.5)
        close(recorder)

    with _writer(tmp_path) as log:
        until(lambda: log.state.file, "the log begins")
        stalls = log.state.stalls
        monkeypatch.setattr(Recorder, "close", slow)
        log.close()
        assert log.state.stalls == stalls + 1


@pytest.mark.parametrize("cut", [1, 100])
def test_torn_logs_are_made_whole(tmp_path: Path, cut: int) -> None:
    with _writer(tmp_path) as log:
        for k in range(200):
            log.put_input(_arrival(k))
    file = tmp_path / "landfix-000.mcap"
    whole = file.read_bytes()
    assert torn_logs(tmp_path) == []
    file.write_bytes(whole[:-cut])
    assert torn_logs(tmp_path) == [file]
    process = recover_in_background(tmp_path)
    assert process is not None
    assert process.wait(60) == 0
    assert torn_logs(tmp_path) == []
    assert [_number(r.data) for r in records(file)] == list(range(200))
    assert recover_in_background(tmp_path) is None


def test_many_threads_may_put_at_once(tmp_path: Path) -> None:
    def images(start: int) -> None:
        for k in range(start, start + 200):
            log.put_image(Arrival("/left/image", schemas.IMAGE, k.to_bytes(8, "little") * 10, T0 + k))

    with _writer(tmp_path) as log:
        threads = [threading.Thread(target=images, args=(1000 * n,)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(records(tmp_path / "landfix-000.mcap")) == 800
