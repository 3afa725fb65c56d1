"""What may happen to the process: killed, stopped, asked to stop. The estimate goes on, the log has all but the last instant."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import zenoh

from benchmarks.service.vehicle import Vehicle
from estimator.config import parse
from estimator.service.log.recovery import FolderError, torn_logs
from estimator.service.zenoh import keys
from estimator.service.zenoh.bus import BusError
from logs.wire import schemas
from logs.wire.codec import type_hash
from logs.wire.stamps import stamp_of
from tests.estimator.service.flying import (
    as_process,
    assert_replay_says_the_same,
    assert_sound,
    client,
    environment,
    errors_in_sigma,
    fly,
    free_port,
    in_thread,
    logs_of,
    odometry,
    records,
    status,
    toml,
    until,
)


def test_after_kill_9_the_log_is_whole_and_the_estimate_goes_on_where_it_was(tmp_path: Path) -> None:
    """No fix comes after the restart: without its last state the second daemon could say nothing."""
    port = free_port()
    text = toml(tmp_path, port, more="[service]\nwarm_restart_s = 50.0")
    with as_process(text, tmp_path, port) as first, client(port) as session:
        vehicle = Vehicle(session, seed=1)
        vehicle.fly(3.0, 200.0, gnss_hz=5.0, fix_hz=5.0, image_hz=0.0)
        assert os.getpriority(os.PRIO_PROCESS, first.pid) == _precedence()
        first.kill()
        killed_ns = time.time_ns()
    (torn,) = torn_logs(tmp_path / "logs")
    lost_s = (killed_ns - records(torn, "/imu")[-1].log_time_ns) * 1e-9
    busy_s = max(vehicle.latency_ns[-100:]) * 1e-9  # how long the machine let it wait
    assert lost_s < 0.1 + busy_s
    assert (tmp_path / "logs" / "landfix.state").exists()

    with in_thread(parse(text), tmp_path), client(port) as session:  # a process takes a minute to start where all are busy
        vehicle = fly(session, 1.0, fix_hz=0.0, gnss_hz=0.0)
        until(lambda: not torn_logs(tmp_path / "logs")[:-1], "the torn log is made whole")
    assert len(vehicle.latency_ns) > 150
    before, after = logs_of(tmp_path)
    assert len(records(after, "/landfix/checkpoint")) == 1
    gap_s = (odometry(after)[0].t_ns - odometry(before)[-1].t_ns) * 1e-9
    assert 0.1 < gap_s < 60.0
    assert errors_in_sigma(odometry(after)).max() < 5.0
    assert_sound(before, after)
    assert_replay_says_the_same(before, text, torn=True)
    assert_replay_says_the_same(after, text, torn=True)


def _precedence() -> int:
    """The nice value that the daemon asks for, or ours where nobody may ask."""
    ours = os.getpriority(os.PRIO_PROCESS, 0)
    refused = subprocess.run(["nice", "-n", str(-10 - ours), "true"], capture_output=True, check=False).stderr
    return ours if refused else -10


@pytest.mark.long
def test_a_process_that_was_stopped_for_three_seconds_goes_on(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port)
    with as_process(text, tmp_path, port) as daemon:
        vehicle = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.service.vehicle", "--connect", f"tcp/127.0.0.1:{port}", "--seconds", "8",
             "--imu-hz", "200", "--fix-hz", "5"],
            env=environment(), stdout=subprocess.DEVNULL,
        )  # fmt: skip
        until(lambda: _estimates(tmp_path) > 200, "it flies", every_s=0.3)
        daemon.send_signal(signal.SIGSTOP)
        time.sleep(3.0)
        daemon.send_signal(signal.SIGCONT)
        flown = _estimates(tmp_path)
        until(lambda: _estimates(tmp_path) > flown + 300, "it flies on", every_s=0.3)
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(120) == 0
        vehicle.kill()
        vehicle.wait()
    (log,) = logs_of(tmp_path)
    assert errors_in_sigma(odometry(log)[-100:]).max() < 5.0
    assert_sound(log)
    assert_replay_says_the_same(log, text)


@pytest.mark.long
def test_while_the_disk_is_full_it_flies_on_and_the_log_has_all_of_it_in_the_end(tmp_path: Path) -> None:
    """The limit on the size of files stands for the full disk: a write fails in the middle, later ones succeed again."""
    port = free_port()
    text = toml(tmp_path, port)
    with as_process(text, tmp_path, port) as daemon, client(port) as session:
        before = fly(session, 1.0)
        unlimited = resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE, (8192, unlimited[1]))
        full = fly(session, 1.5)
        until(lambda: status(session).get("log state", "").startswith("failed"), "the log has noticed")
        resource.prlimit(daemon.pid, resource.RLIMIT_FSIZE, unlimited)
        until(lambda: status(session).get("log state") == "recording", "the log goes on")
        after = fly(session, 1.0)
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(120) == 0
    logs = logs_of(tmp_path)
    sent = [v.sent["/imu"] for v in (before, full, after)]
    stamps = {stamp_of(r.data) for log in logs for r in records(log, "/imu")}
    assert len(stamps) == sum(sent) == 700
    assert len(full.latency_ns) > 200
    assert errors_in_sigma(odometry(logs[-1])[-50:]).max() < 5.0
    assert_sound(*logs)


def _estimates(folder: Path) -> int:
    files = [f for f in logs_of(folder) if f.stat().st_size > 8]
    return len(odometry(files[-1])) if files else 0


def test_reported_to_stop_it_stops_at_once_with_a_whole_log(tmp_path: Path) -> None:
    port = free_port()
    text = toml(tmp_path, port)
    with as_process(text, tmp_path, port) as daemon:
        with client(port) as session:
            vehicle = fly(session, 3.0)
            elsewhere = _publisher_on_domain(session, 7)
            session.put(keys.rmw_key(0, "/gnss", schemas.NAV_SAT_FIX, type_hash(schemas.NAV_SAT_FIX)), b"torn")
            until(lambda: "no IMU sample" in (tmp_path / "stderr.txt").read_text(), "it says that the IMU is silent")
            elsewhere.undeclare()  # type: ignore[no-untyped-call]
        daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(120) == 0
    assert torn_logs(tmp_path / "logs") == []
    assert len(records(logs_of(tmp_path)[0], "/imu")) == vehicle.sent["/imu"]
    (log,) = logs_of(tmp_path)
    lines = (tmp_path / "stderr.txt").read_text().splitlines()
    said = dict(line.removeprefix("landfix: ").split(": ", 1) for line in lines if ": " in line.removeprefix("landfix: "))
    assert f"tcp/127.0.0.1:{port}" in said["Zenoh"]
    assert said["waiting for"] == "IMU samples on /imu"
    assert said["first estimate"] == "published"
    assert any(line.startswith("landfix: mode: aided, 95 % radius ") for line in lines)
    assert said["/imu is published on ROS domain 7, landfix reads domain 0"].startswith("set [zenoh] domain = 7")
    assert said["no IMU sample for 3 s"].startswith("is the topic of [inputs] imu sent")
    assert said["malformed message on /gnss"]
    assert said["malformed messages on /gnss"] == "1"
    assert lines[-1] == f"landfix: log complete: {log}, {log.stat().st_size / 1e6:.1f} MB"


def _publisher_on_domain(session: zenoh.Session, domain: int) -> zenoh.LivelinessToken:
    """As rmw_zenoh announces it."""
    hashed = type_hash(schemas.IMU)
    return session.liveliness().declare_token(
        keys.publisher_token(domain, str(session.zid()), "imu_driver", 9, "/imu", schemas.IMU, hashed)
    )


@pytest.mark.long
def test_quiet_it_prints_nothing_and_a_terminal_that_is_closed_stops_it(tmp_path: Path) -> None:
    is_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN  # by nohup, and so by the daemon
    port = free_port()
    with as_process(toml(tmp_path, port), tmp_path, port, "--quiet") as daemon:
        with client(port) as session:
            vehicle = fly(session, 1.0)
        daemon.send_signal(signal.SIGTERM if is_ignored else signal.SIGHUP)
        assert daemon.wait(120) == 0
    assert len(records(logs_of(tmp_path)[0], "/imu")) == vehicle.sent["/imu"]
    assert torn_logs(tmp_path / "logs") == []
    assert (tmp_path / "stderr.txt").read_text() == ""


def test_a_terminal_that_takes_no_line_does_not_stop_the_flight() -> None:
    """stderr is a full pipe that nobody reads: saying something returns at once, and so does the end."""
    code = """
import fcntl, os, time
reader, writer = os.pipe()
os.set_blocking(writer, False)
try:
    while True: os.write(writer, b"x" * 4096)
except BlockingIOError:
    os.set_blocking(writer, True)
os.dup2(writer, 2)
from estimator.service.console import Console
began = time.monotonic()
with Console(quiet=False) as console:
    for _ in range(1000):
        console.say("line")
    said = time.monotonic()
print(said - began < 0.5, time.monotonic() - began < 3.0)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), stdout=subprocess.PIPE, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == ["True", "True"]


def test_what_cannot_start_reports_why_in_one_line_and_leaves_the_other_alone(tmp_path: Path) -> None:
    port, other = free_port(), tmp_path / "other"
    other.mkdir()
    text = toml(tmp_path, port)
    with in_thread(parse(text), tmp_path):
        until(lambda: logs_of(tmp_path), "the log begins")
        (log,) = logs_of(tmp_path)
        with pytest.raises(FolderError, match="another landfix records there"), in_thread(parse(text), tmp_path):
            pass
        with pytest.raises(BusError, match=str(port)) as refused, in_thread(parse(toml(other, port)), other):
            pass
        assert logs_of(tmp_path) == [log]
        assert torn_logs(tmp_path / "logs") == [log]  # still being written
    assert "\n" not in str(refused.value)
    assert torn_logs(tmp_path / "logs") == []
