"""The daemon under load for minutes: latency, processor, memory, drops, and whether its log says the same again.

    python -m benchmarks.service [--minutes 10] [--image-hz 10] [--realtime] [--json]

Three processes on this machine: `landfix run`, the vehicle of benchmarks.service_vehicle (400 Hz IMU, 5 Hz GNSS, 1 Hz pose fixes,
two VGA cameras) and, within it, the subscriber that times the estimates. Latency is from an IMU sample's stamp to its estimate in
the subscriber's hands: two hops over Zenoh and the estimator between them.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.service_vehicle import ORIGIN, TOPICS
from estimator.config import parse
from estimator.replay import replay
from estimator.service.zenoh_bus import OUTPUTS
from logs.reader import LogReader

_OWN_WORDS = "/landfix/daemon"
_WARM_S = 30.0  # the beginning is not counted as growth


def configuration(folder: Path, port: int) -> str:
    """The vehicle's."""
    return f"""
[map]
origin = {[*ORIGIN.lla]}
[zenoh]
listen = ["tcp/127.0.0.1:{port}"]
[log]
folder = "{folder / "logs"}"
"""


def run(minutes: float, image_hz: float, port: int, folder: Path) -> dict[str, Any]:
    """One run; what was measured."""
    text = configuration(folder, port)
    (folder / "vehicle.toml").write_text(text)
    began_s = time.monotonic()
    daemon = subprocess.Popen([sys.executable, "-m", "estimator", "run", "-c", str(folder / "vehicle.toml")])
    while not list((folder / "logs").glob("*.mcap")):
        time.sleep(0.05)
    start_s = time.monotonic() - began_s
    time.sleep(1.0)
    words = ["--connect", f"tcp/127.0.0.1:{port}", "--seconds", str(60.0 * minutes), "--image-hz", str(image_hz)]
    vehicle = subprocess.Popen([sys.executable, "-m", "benchmarks.service_vehicle", *words], stdout=subprocess.PIPE)
    memory, cpu = _watch(daemon.pid, vehicle)
    said, _ = vehicle.communicate()
    daemon.terminate()
    daemon.wait()
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    result: dict[str, Any] = json.loads(said)
    (log,) = (folder / "logs").glob("*.mcap")
    logged = _counts(log)
    result |= {"start_s": round(start_s, 1), **memory, **cpu, "log_mb": round(log.stat().st_size / 1e6, 1)}
    result["not_logged"] = {topic: n - logged.get(topic, 0) for topic, n in result["sent"].items()}
    result["estimates_logged"] = logged.get("/landfix/odometry", 0)
    result["replay_says_the_same"] = _same(log, text, folder)
    return result


def _watch(pid: int, vehicle: "subprocess.Popen[bytes]") -> tuple[dict[str, float], dict[str, float]]:
    """Memory and processor time of a process, until the vehicle has landed."""
    samples = []
    while vehicle.poll() is None:
        samples.append((time.monotonic(), _rss_mb(pid), _cpu_s(pid)))
        time.sleep(1.0)
    warm = [s for s in samples if s[0] - samples[0][0] > min(_WARM_S, (samples[-1][0] - samples[0][0]) / 2)]
    (t0, rss0, cpu0), (t1, rss1, cpu1) = warm[0], warm[-1]
    growth_mb = rss1 - rss0
    memory = {"rss_mb": round(rss1, 1), "rss_growth_mb": round(growth_mb, 2)}
    return memory, {"cpu_percent": round(100.0 * (cpu1 - cpu0) / (t1 - t0), 1)}


def _rss_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def _cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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
    parser.add_argument("--image-hz", type=float, default=10.0)
    parser.add_argument("--port", type=int, default=17447)
    parser.add_argument("--realtime", action="store_true", help="SCHED_RR, for a machine that is busy; needs root")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where log and replay are kept")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.realtime:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    with tempfile.TemporaryDirectory() as folder:
        result = run(given.minutes, given.image_hz, given.port, given.keep or Path(folder))
    if given.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:24} {value}")
    lost = [topic for topic, n in result["not_logged"].items() if n and topic in TOPICS]
    sys.exit(bool(lost) or not result["replay_says_the_same"])


if __name__ == "__main__":
    main()
