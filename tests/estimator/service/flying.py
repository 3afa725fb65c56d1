"""What the daemon's tests share: a configuration on a free port, a daemon in a thread or as a process, a vehicle, its log."""

import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from benchmarks.service.vehicle import ORIGIN, Vehicle, connected, truth
from estimator.config import Config, parse
from estimator.replay.replay import replay
from estimator.service.base.clock import Clock
from estimator.service.base.status import TOPIC as DAEMON_TOPIC
from estimator.service.daemon import Daemon
from estimator.service.run import assembled
from estimator.service.zenoh.bus import OUTPUTS
from estimator.service.zenoh.keys import rmw_key
from logs.store.reader import LogReader, Record
from logs.wire import schemas
from logs.wire.codec import Odometry, decode_odometry, encode_input
from logs.wire.schemas import STORE
from models.messages import Array, ImuSample

ODOMETRY = "/landfix/odometry"
_PATIENCE_S = 180.0  # a machine may be busy; nothing here waits longer than it must
_SILENCE_S = 5.0


def free_port() -> int:
    """A TCP port that nobody listens on."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def toml(folder: Path, port: int, more: str = "", zenoh_keys: str = "") -> str:
    """The configuration of a vehicle as benchmarks.service.vehicle flies it; zenoh_keys: lines of its section, [log] the last."""
    return f"""
[map]
origin = [{ORIGIN.lat_deg}, {ORIGIN.lon_deg}, {ORIGIN.alt_m}]
[zenoh]
listen = ["tcp/127.0.0.1:{port}"]
{zenoh_keys}
[log]
folder = "{folder / "logs"}"
least_free_mb = 0.0
{more}
"""


@contextmanager
def in_thread(config: Config, folder: Path, clock: Clock | None = None) -> Iterator[Daemon]:
    """A daemon that runs in a thread, stopped and closed at the end."""
    with assembled(config, folder, clock=clock) as daemon:
        thread = threading.Thread(target=daemon.run)
        thread.start()
        try:
            yield daemon
        finally:
            daemon.stop()
            thread.join()


@contextmanager
def as_process(text: str, folder: Path, port: int, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """`landfix run` as a process of its own, ready when the context begins and gone when it ends."""
    file = folder / "vehicle.toml"
    file.write_text(text)
    with (folder / "stderr.txt").open("ab") as errors:
        process = subprocess.Popen([sys.executable, "-m", "estimator", "run", "-c", str(file), *options], stderr=errors)
    try:
        until(lambda: listening(port) or process.poll() is not None, "the daemon listens")
        assert process.poll() is None, (folder / "stderr.txt").read_text()
        yield process
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        process.wait()


def listening(port: int) -> bool:
    """Whether somebody listens on a port of this machine."""
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) == 0


def until(condition: Callable[[], object], what: str, seconds: float = _PATIENCE_S, every_s: float = 0.02) -> None:
    """Wait for a condition; fail when it does not come true."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited {seconds:g} s for: {what}"
        time.sleep(every_s)


@contextmanager
def client(port: int, **settings: object) -> Iterator[zenoh.Session]:
    """A session of somebody else."""
    session = connected(f"tcp/127.0.0.1:{port}", **settings)
    try:
        yield session
    finally:
        session.close()  # type: ignore[no-untyped-call]


def fly(session: zenoh.Session, seconds: float, *, gnss_hz: float = 5.0, fix_hz: float = 5.0, image_hz: float = 0.0) -> Vehicle:
    """A vehicle that has flown, with 200 IMU samples a second, and has heard the last estimate, or none for long."""
    vehicle = Vehicle(session, seed=1)
    vehicle.fly(seconds, 200.0, gnss_hz=gnss_hz, fix_hz=fix_hz, image_hz=image_hz)
    heard, since_s = -1, time.monotonic()
    while vehicle.heard_ns < vehicle.flown_ns and time.monotonic() - since_s < _SILENCE_S:
        if heard != len(vehicle.latency_ns):
            heard, since_s = len(vehicle.latency_ns), time.monotonic()
        time.sleep(0.02)
    return vehicle


@contextmanager
def standing(session: zenoh.Session) -> Iterator[None]:
    """A vehicle that stands, 100 IMU samples a second, for as long as the context lasts."""
    key, done = rmw_key(0, "/imu", schemas.IMU, schemas.type_hash(schemas.IMU)), threading.Event()

    def measure() -> None:
        while not done.wait(0.01):
            now_ns = time.time_ns()
            session.put(key, encode_input(ImuSample(now_ns, now_ns, (0.0, 0.0, 0.0), (0.0, 0.0, -9.80665))).data)

    thread = threading.Thread(target=measure)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def logs_of(folder: Path) -> list[Path]:
    """The logs written, oldest first."""
    return sorted((folder / "logs").glob("*.mcap"))


def records(log: Path, *topics: str) -> list[Record]:
    """The records of a log, of some topics only."""
    with LogReader(log) as reader:
        return [r for r in reader if not topics or r.topic in topics]


def odometry(log: Path) -> list[Odometry]:
    """The estimates of a log."""
    return [decode_odometry(r.data) for r in records(log, ODOMETRY)]


def errors_in_sigma(estimates: list[Odometry]) -> Array:
    """How far off the estimates of the benchmark's vehicle are, axis by axis."""
    errors = np.array([np.subtract(e.p_n, truth(e.t_ns)[0]) for e in estimates])
    ratios: Array = np.abs(errors) / np.sqrt(np.array([np.diag(e.pose_covariance)[:3] for e in estimates]))
    return ratios


def assert_sound(*logs: Path) -> None:
    """No estimate was ever not a number, none in a log came twice or backwards, and the logs lost no input.

    What a full disk tears off is written again into the next log, so that logs may have records in common.
    """
    heard = [o for log in logs for o in odometry(log)]
    assert np.isfinite([[*o.p_n, *o.q_nb_wxyz] for o in heard]).all()
    variances = np.array([np.diag(o.pose_covariance) for o in heard])
    assert np.isfinite(variances).all()
    assert (variances > 0.0).all()
    for log in logs:
        assert (np.diff([o.t_ns for o in odometry(log)]) > 0).all()
    for record in (r for log in logs for r in records(log, DAEMON_TOPIC)):
        message: Any = STORE.deserialize_cdr(record.data, record.schema)
        values = {v.key: v.value for v in message.status[0].values}
        assert {"log lost_inputs": "0", "inbox lost_inputs": "0"}.items() <= values.items()
        assert "internal_error" not in values


def said(log: Path) -> list[tuple[str, int, bytes]]:
    """What the estimator said in a log, the daemon's words about itself aside."""
    heard = [r for r in records(log) if r.topic in OUTPUTS and r.topic != DAEMON_TOPIC]
    return [(r.topic, r.log_time_ns, r.data) for r in heard]


def assert_replay_says_the_same(log: Path, text: str, *, torn: bool = False) -> None:
    """The log replayed gives the same bytes that were published in flight; torn: and what the last inputs would have led to."""
    again = log.with_suffix(".again")
    replay(log, again, parse(text))
    flown, replayed = said(log), said(again)
    assert len(flown) > 0
    assert flown == (replayed[: len(flown)] if torn else replayed)
    assert len(replayed) - len(flown) < 100


def environment() -> dict[str, str]:
    """Of a process that is started by a test."""
    return os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])}


def ask(session: zenoh.Session, key: str) -> list[bytes]:
    """The answers to a query."""
    return [reply.ok.payload.to_bytes() for reply in session.get(key, timeout=5.0) if reply.ok is not None]


def status(session: zenoh.Session) -> dict[str, str]:
    """The daemon's values about itself, of the last full second; none where it does not answer."""
    answers: list[dict[str, dict[str, str]]] = [json.loads(a) for a in ask(session, "landfix/status")]
    return answers[0]["daemon"] if answers else {}
