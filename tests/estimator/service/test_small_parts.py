"""Keys and attachments, the word to systemd, the file with the last state."""

import os
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.writer import MCAP0_MAGIC as MAGIC
from zenoh.ext import Int64, z_serialize

from estimator.service.base.clock import Clock
from estimator.service.base.status import Status
from estimator.service.log import state_file
from estimator.service.log.recovery import FolderLock, recover_in_background
from estimator.service.log.state_file import SavedState, StateKeeper
from estimator.service.log.writer import LogConfig, LogWriter
from estimator.service.watchdog import Notifier
from estimator.service.zenoh import keys as zenoh_keys
from estimator.service.zenoh.config import SecurityConfig, access_control
from logs.wire import schemas
from logs.wire.codec import Decoder, type_hash
from logs.wire.schemas import STORE
from models.messages import AidStatus, Checkpoint, Estimate, Health, ImuSample, LastGnss, Mode, Output, Reason, Tick
from tests.estimator.service.flying import until

T0 = 1_795_000_000_000_000_000


def test_keys_and_tokens_are_those_of_rmw_zenoh() -> None:
    hashed = type_hash(schemas.ODOMETRY)
    key = zenoh_keys.rmw_key(7, "/landfix/odometry", schemas.ODOMETRY, hashed)
    assert key == f"7/landfix/odometry/nav_msgs::msg::dds_::Odometry_/{hashed}"
    assert hashed == "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    token = zenoh_keys.publisher_token(7, "abc", "landfix", 12, "/landfix/odometry", schemas.ODOMETRY, hashed)
    assert token == f"@ros2_lv/7/abc/0/12/MP/%/%/landfix/%landfix%odometry/nav_msgs::msg::dds_::Odometry_/{hashed}/:2:,10:,:,:,,"
    assert zenoh_keys.subscriber_token(7, "abc", "landfix", 12, "/imu", schemas.IMU, "x").startswith("@ros2_lv/7/abc/0/12/MS/")
    assert zenoh_keys.node_token(7, "abc", "landfix") == "@ros2_lv/7/abc/0/0/NN/%/%/landfix"
    assert zenoh_keys.bridge_token("abc", "/landfix/odometry", schemas.ODOMETRY, "x") == (
        "@/abc/@ros2_lv/MP/landfix§odometry/nav_msgs§msg§Odometry/:1:0:0,10:typehash=x;"
    )
    assert zenoh_keys.plain_key("/landfix/odometry") == "landfix/odometry"


def test_the_attachment_is_what_zenohs_own_serializer_makes() -> None:
    gid = bytes(range(16))
    made = zenoh_keys.attachment(5, T0, gid)
    assert len(made) == 33
    assert made == z_serialize((Int64(5), Int64(T0), gid)).to_bytes()


def test_access_control_denies_what_is_not_named() -> None:
    made = access_control(SecurityConfig(users_file="u", feeders=("a",)), ["0/imu/**"], ["0/landfix/**"])
    assert made["default_permission"] == "deny"
    assert [s["usernames"] for s in made["subjects"]] == [["a"]]
    assert [p["rules"] for p in made["policies"]] == [["feed", "ask-for-input"]]
    allowed = {name for rule in made["rules"] if rule["id"] in {"feed", "ask-for-input"} for name in rule["key_exprs"]}
    assert allowed == {"0/imu/**", "@ros2_lv/**"}


def test_systemd_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        notifier = Notifier()
        notifier.ready("running")
        notifier.alive()
        heard = [systemd.recv(100) for _ in range(2)]
        assert heard == [b"READY=1\nSTATUS=running", b"WATCHDOG=1"]
        systemd.close()
        notifier.alive()  # nobody listens any more: nothing happens
        notifier.stopping()


def test_without_systemd_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    Notifier().ready("running")


def _estimate(t_ns: int) -> Estimate:
    return Estimate(t_ns, t_ns, np.arange(16.0), np.eye(15) * 2.0, (0.0, 0.0, 0.0), Mode.AIDED, 4, t_ns - 5, (47.0, 8.0, 400.0))


def test_the_last_state_is_found_again(tmp_path: Path) -> None:
    path, clock = tmp_path / "state", Clock()
    t0 = clock.now_ns() - 1_000_000
    keeper = StateKeeper(path, clock, "config")
    keeper.note(_estimate(t0))
    until(path.exists, "it is written by itself")
    keeper.note(Health(t0, t0, Mode.AIDED, 0.0, 1.0, 1.0, 4, {}, {}, 1, LastGnss(47.0, 8.0, 400.0, 3.0, 2.0)))
    keeper.note(_estimate(t0 + 7))
    keeper.note(msgspec.structs.replace(_estimate(t0 + 8), mode=Mode.ALIGNING_HEADING))  # nothing to go on from as if aligned
    keeper.close()
    saved, why = state_file.load(path)
    assert why == ""
    assert saved is not None
    assert (saved.t_ns, saved.config, saved.boot) == (t0 + 7, "config", state_file.boot_id())
    assert state_file.clock_of(saved).anchor_ns == clock.anchor_ns
    read = Decoder().decode("/landfix/checkpoint", schemas.CHECKPOINT, saved.checkpoint, t0 + 9)
    assert isinstance(read, Checkpoint)
    assert read.nav.tolist() == list(range(16))
    assert (read.t_ns, read.reset_counter, read.origin) == (t0 + 7, 4, (47.0, 8.0, 400.0))
    assert read.last_gnss is not None


@pytest.mark.parametrize(
    ("umask", "file_mode", "folder_mode"), [(0o000, 0o640, 0o750), (0o022, 0o640, 0o750), (0o077, 0o600, 0o700)]
)
def test_what_the_daemon_creates_is_not_for_everybody(tmp_path: Path, umask: int, file_mode: int, folder_mode: int) -> None:
    folder, before = tmp_path / "logs", os.umask(umask)
    try:
        lock = FolderLock(folder)
        torn = folder / "landfix-0.mcap"
        torn.write_bytes(MAGIC)
        process = recover_in_background(folder)
        assert process is not None
        assert process.wait(60.0) == 0
        writer = LogWriter(LogConfig(least_free_mb=0.0), lambda n: folder / "deeper" / f"landfix-{n}.mcap", {})
        keeper = StateKeeper(folder / "state", Clock(), "a")
        keeper.note(_estimate(T0))
        keeper.close()
        writer.close()
        lock.close()
    finally:
        os.umask(before)
    made = {path.name: path.stat().st_mode & 0o777 for path in (folder, *folder.rglob("*"))}
    folders = {name: made.pop(name) for name in ("logs", "deeper")}
    assert folders == dict.fromkeys(folders, folder_mode)
    assert made == dict.fromkeys(["landfix.lock", "landfix.recovery.lock", "landfix-0.mcap", "state"], file_mode)


@pytest.mark.parametrize("content", [b"", b"\xff" * 100, msgspec.msgpack.encode({"format": 1}), b"\x93\x01\x02"])
def test_a_state_that_is_damaged_is_none(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "state").write_bytes(content)
    assert state_file.load(tmp_path / "state") == (None, "is no state file, or a damaged one")
    assert state_file.load(tmp_path / "none") == (None, "")


def test_only_a_young_state_of_this_configuration_is_gone_on_from() -> None:
    saved = SavedState(1, "boot", 0, T0, "mine", b"")
    second = 1_000_000_000
    assert state_file.usable(saved, T0 + 9 * second, "mine", 10.0) is saved
    assert state_file.usable(saved, T0 + 11 * second, "mine", 10.0) is None
    assert state_file.usable(saved, T0 - second, "mine", 10.0) is None
    assert state_file.usable(saved, T0, "another", 10.0) is None
    assert state_file.usable(None, T0, "mine", 10.0) is None
    assert state_file.clock_of(saved).anchor_ns != 0  # of another boot


def test_a_folder_that_cannot_be_written_is_no_reason_to_stop(tmp_path: Path) -> None:
    keeper = StateKeeper(tmp_path / "nowhere" / "state", Clock(), "config")
    keeper.note(_estimate(T0))
    keeper.close()
    assert keeper.problem == "No such file or directory"


def test_a_defect_on_the_way_costs_one_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    t0 = clock.now_ns() - 1000
    keeper = StateKeeper(tmp_path / "state", clock, "config")
    with monkeypatch.context() as broken:
        broken.setattr("estimator.service.log.state_file.checkpoint_of", lambda *_: 1 / 0)
        keeper.note(_estimate(t0))
        until(lambda: keeper.report() == {"file": "ZeroDivisionError: division by zero"}, "it is reported")
    keeper.note(_estimate(t0 + 1))
    until(lambda: keeper.report() == {"file": "kept"}, "the next one is kept")
    keeper.close()
    saved, _ = state_file.load(tmp_path / "state")
    assert saved is not None
    assert saved.t_ns == t0 + 1


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("log", {"state": "recording"}, "running"),
        ("log", {"state": "off"}, "running"),
        ("log", {"state": "failed: no space left"}, "log failed: no space left"),
        ("log", {"state": "recording", "lost_inputs": 3}, "inputs are lost"),
        ("inbox", {"waiting": 7, "lost_inputs": 0}, "running"),
        ("inbox", {"waiting": 7, "lost_inputs": 1}, "inputs are lost"),
        ("inbox", {"lost_inputs": 9, "dropped /gnss": 9}, "inputs are lost: more came than can be handled of /gnss"),
        ("log", {"state": "recording", "removed_files": 2}, "2 log files were removed while they were written"),
        ("state", {"file": "kept"}, "running"),
        ("state", {"file": "Permission denied"}, "state file: Permission denied"),
    ],
)
def test_what_needs_attention_is_a_warning(name: str, values: dict[str, object], said: str) -> None:
    assert _said(Status(T0, {name: lambda: values})) == (0 if said == "running" else 1, said)


def _after(seconds: float, outputs: Sequence[Output], *, imu: bool = True) -> Status:
    """Estimates come out for a second; then, for so long, each IMU sample leads to these outputs."""
    status = Status(T0, {})
    for k in range(round(100 * (1.0 + seconds))):
        now_ns = T0 + k * 10_000_000
        sample = ImuSample(now_ns, now_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.8))
        if k < 100:
            status.note(sample, [_estimate(now_ns)], now_ns)
        elif imu:
            status.note(sample, outputs, now_ns)
        else:
            status.note(Tick(now_ns, now_ns), outputs, now_ns)
    return status


_INTERNAL = AidStatus(T0, T0, "/imu", "ImuSample", Reason.INTERNAL, detail="internal error: IndexError")
_FUTURE = AidStatus(T0, T0, "/imu", "ImuSample", Reason.IN_FUTURE)
_ALIGNING = Health(T0, T0, Mode.ALIGNING, 0.0, 1.0, 1.0, 0, {}, {}, 0, detail="waiting for a position")


@pytest.mark.parametrize(
    ("outputs", "imu", "works"),
    [
        ([_estimate(T0)], True, True),
        ([_INTERNAL], True, False),
        ([_INTERNAL, _ALIGNING], True, False),
        ([], True, False),  # the mode was never said to be one without estimates
        ([_ALIGNING], True, True),
        ([_FUTURE], True, True),
        ([], False, True),  # no IMU: that is the reason
    ],
)
def test_the_watchdog_is_fed_while_estimates_or_a_known_reason_for_none_come_out(
    outputs: list[Output], imu: bool, works: bool
) -> None:
    now_ns = T0 + 9 * 1_000_000_000
    status = _after(8.0, outputs, imu=imu)
    assert status.works(now_ns) is works
    assert _after(2.0, outputs, imu=imu).works(T0 + 3 * 1_000_000_000), "not at once"
    report = status.report(now_ns)
    assert report is not None
    message: Any = STORE.deserialize_cdr(report.data, report.schema)
    assert message.status[0].level == (0 if works else 2)


def test_a_defect_is_a_warning() -> None:
    status = Status(T0, {})
    status.note_defect("KeyError: 7")
    assert _said(status) == (1, "internal error: KeyError: 7")


def _said(status: Status) -> tuple[int, str]:
    report = status.report(T0)
    assert report is not None
    message: Any = STORE.deserialize_cdr(report.data, report.schema)
    return message.status[0].level, message.status[0].message
