"""The daemon under load for minutes: latency, processor, memory, drops, fixes, and whether its log says the same again.

    python -m benchmarks.service [--minutes 10] [--odometry] [--mavlink] [--realtime] [--awake] [--json]

Processes on this machine: `landfix run` with its vision, a vehicle (400 Hz IMU, 5 Hz GNSS, stereo VGA of a rendered village at
10 Hz) and a subscriber. Latency is from an IMU sample's stamp to its estimate in the subscriber's hands: two hops over Zenoh and
the estimator between them; next to it how late the machine wakes a process that only sleeps, at the same priority, and what a
host takes from a virtual machine. The images are rendered beforehand. --odometry: visual
odometry of every pair (10 Hz) in a process of its own. --mavlink: IMU and GNSS come over MAVLink instead (UDP).
"""

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.service import images
from benchmarks.service.vehicle import ORIGIN, PERIOD_NS
from benchmarks.service.watch import children, watch
from estimator.config import parse
from estimator.replay.replay import replay
from estimator.service.zenoh.bus import OUTPUTS
from logs.store.reader import LogReader
from logs.wire.decoding import LANDMARK_FIX_TOPIC
from models.messages import ODOMETRY_DELTA_TOPIC

_OWN_WORDS = "/landfix/daemon"
_ALIGNMENT = ["--fix-hz", "5", "--fix-s", "2"]  # on a circle at constant speed the heading is observable too slowly


def configuration(folder: Path, port: int, mavlink_port: int | None, *, odometry: bool = False) -> str:
    """The vehicle's."""
    motion = "[visual_odometry]\nenabled = true\ninterval_s = 0.1\nground_m = 0.0\n" if odometry else ""
    link = f'[mavlink]\nendpoint = "udpin:127.0.0.1:{mavlink_port}"\nimu_hz = 400.0\ngnss_hz = 5.0\n' if mavlink_port else ""
    return f"""
[map]
origin = {[*ORIGIN.lla]}
landmarks = "{folder / "map.geojson"}"
[rig]
file = "{folder / "rig.yaml"}"
[zenoh]
listen = ["tcp/127.0.0.1:{port}"]
[log]
folder = "{folder / "logs"}"
{link}{motion}"""


def run(
    minutes: float,
    port: int,
    mavlink_port: int | None,
    folder: Path,
    *,
    awake: bool = False,
    odometry: bool = False,
    imu_hz: float = 400.0,
) -> dict[str, Any]:
    """One run; what was measured."""
    text = configuration(folder, port, mavlink_port, odometry=odometry)
    (folder / "vehicle.toml").write_text(text)
    began_s = time.monotonic()
    daemon = python("estimator", "run", "-c", str(folder / "vehicle.toml"))
    while not listening(port):
        time.sleep(0.05)
    start_s = time.monotonic() - began_s
    endpoint = f"tcp/127.0.0.1:{port}"
    subscriber = python("benchmarks.service.subscriber", "--connect", endpoint)
    assert subscriber.stdout is not None
    assert subscriber.stdout.readline() == b"ready\n"
    words = ["--connect", endpoint, "--seconds", str(60.0 * minutes), "--pictures", str(folder / "turn.mcap"), *_ALIGNMENT]
    words += ["--imu-hz", str(imu_hz)]
    if mavlink_port:
        vehicle = python("benchmarks.service.autopilot", "--to", f"127.0.0.1:{mavlink_port}", *words)
    else:
        vehicle = python("benchmarks.service.vehicle", *words)
    machine = python("benchmarks.service.machine")
    keepers = [python("benchmarks.service.awake", str(core)) for core in os.sched_getaffinity(0)] if awake else []
    names = ("vision", "odometry")[: 1 + odometry]
    workers = dict(zip(names, children(daemon.pid, "spawn_main", len(names)), strict=True))
    processes = {"daemon": daemon.pid, **workers, "vehicle": vehicle.pid, "subscriber": subscriber.pid}
    used = watch(processes, lambda: vehicle.poll() is not None)
    flown = json.loads(vehicle.communicate()[0])
    machine.send_signal(signal.SIGTERM)
    flown["machine"] = json.loads(machine.communicate()[0])
    for keeper in keepers:
        keeper.kill()
        keeper.communicate()
    time.sleep(1.5)  # the status is of the last full second
    subscriber.send_signal(signal.SIGTERM)
    heard = json.loads(subscriber.communicate()[0])
    daemon.send_signal(signal.SIGTERM)
    daemon.communicate()
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    (log,) = (folder / "logs").glob("*.mcap")
    logged, status = _counts(log), heard.pop("daemon")
    shown = "log ", "vision ", "visual_odometry ", "zenoh ", "mavlink ", "handling"
    result: dict[str, Any] = (heard | flown) | {
        "start_s": round(start_s, 1),
        "processes": used,
        "not_logged": {topic: n - logged.get(topic, 0) for topic, n in flown["sent"].items()},
        "fixes": logged.get(LANDMARK_FIX_TOPIC, 0),
        "increments": logged.get(ODOMETRY_DELTA_TOPIC, 0),
        "status": {name: value for name, value in status.items() if name.startswith(shown)},
        "estimates_logged": logged.get("/landfix/odometry", 0),
        "log_mb": round(log.stat().st_size / 1e6, 1),
        "replay_says_the_same": _same(log, text, folder),
    }
    return result


def python(module: str, *words: str) -> "subprocess.Popen[bytes]":
    """A module of ours as a process of its own."""
    return subprocess.Popen([sys.executable, "-m", module, *words], stdout=subprocess.PIPE)


def listening(port: int) -> bool:
    """Whether somebody listens on a port of this machine."""
    with socket.socket() as s:
        return s.connect_ex(("127.0.0.1", port)) == 0


def _counts(log: Path) -> dict[str, int]:
    counts: dict[str, int] = {}
    with LogReader(log) as reader:
        for record in reader:
            counts[record.topic] = counts.get(record.topic, 0) + 1
    return counts


def _said(log: Path) -> list[tuple[str, int, int]]:
    """What the estimator said: topic, time, hash of the bytes."""
    wanted = set(OUTPUTS) - {_OWN_WORDS}
    with LogReader(log) as reader:
        return [(r.topic, r.log_time_ns, hash(r.data)) for r in reader if r.topic in wanted]


def _same(log: Path, text: str, folder: Path) -> bool:
    replay(log, folder / "again.mcap", parse(text))
    return _said(log) == _said(folder / "again.mcap")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--imu-hz", type=float, default=400.0)
    parser.add_argument("--image-hz", type=float, default=10.0, help="of the turn that is rendered")
    parser.add_argument("--port", type=int, default=17447)
    parser.add_argument("--odometry", action="store_true", help="visual odometry of every pair")
    parser.add_argument("--mavlink", action="store_true", help="IMU and GNSS over MAVLink, on the UDP port after --port")
    parser.add_argument("--realtime", action="store_true", help="SCHED_RR, but for vision, for a busy machine; needs root")
    parser.add_argument("--awake", action="store_true", help="no core goes idle: a host that takes idle ones away cannot")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where images, log and replay are kept")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / "turn.mcap").exists():
            images.write(folder, round(given.image_hz * PERIOD_NS * 1e-9))
        if given.realtime:
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(2))
        mavlink_port = given.port + 1 if given.mavlink else None
        more = {"awake": given.awake, "odometry": given.odometry, "imu_hz": given.imu_hz}
        result = run(given.minutes, given.port, mavlink_port, folder, **more)
    for name, value in result.items() if not given.json else ():
        print(f"{name:24} {value}")
    if given.json:
        print(json.dumps(result))
    sys.exit(any(result["not_logged"].values()) or bool(result["not_finite"]) or not result["replay_says_the_same"])


if __name__ == "__main__":
    main()
