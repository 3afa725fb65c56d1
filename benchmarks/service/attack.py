"""The daemon under attack: floods, kills and stops while a vehicle flies; how soon its estimates come in time again.

    python -m benchmarks.service.attack [--minutes 10] [--out out/attack.jsonl]

A real `landfix run` with its vision, a vehicle (200 Hz IMU, 5 Hz GNSS, stereo images at 10 Hz) and, one after the other, the
attacks, each followed by quiet. Recovered: from then on every estimate arrives within 0.1 s of its stamp (median of 20). At the
end the daemon is killed (SIGKILL) and its log read: lost is what arrived in the last instant and is not in it. Each row is
appended to --out as it comes.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import zenoh

from benchmarks.service import images
from benchmarks.service.__main__ import configuration, listening, python
from benchmarks.service.vehicle import connected, image, imu, pose_fix
from benchmarks.service.watch import child
from estimator.service.zenoh import keys as zenoh_keys
from logs.store.reader import LogReader
from logs.wire import schemas
from logs.wire.codec import Encoded, encode_input, type_hash
from logs.wire.stamps import stamp_of

PORT: Final = 17449
FLOOD_S: Final = 5.0
QUIET_S: Final = 12.0
_IN_TIME_S, _WINDOW = 0.1, 20
_RATE_HZ: Final = 100_000


class Ears:
    """Arrival and stamp of each estimate, and the newest status."""

    def __init__(self, session: zenoh.Session) -> None:
        self.heard: list[tuple[float, float]] = []  # s, both
        self._session = session
        key = zenoh_keys.rmw_key(0, "/landfix/odometry", schemas.ODOMETRY)
        self._subscriber = session.declare_subscriber(key, self._hear)

    def _hear(self, sample: zenoh.Sample) -> None:
        stamp_ns = stamp_of(sample.payload.to_bytes())
        if stamp_ns is not None:
            self.heard.append((time.time(), stamp_ns * 1e-9))

    def recovered_s(self, since_s: float) -> float:
        """From since_s on: until the estimates are in time, and stay so; inf: never."""
        late = [arrived - stamp for arrived, stamp in self.heard if arrived >= since_s]
        times = [arrived for arrived, _ in self.heard if arrived >= since_s]
        if len(late) < _WINDOW:
            return float("inf")
        medians = np.array([np.median(late[k : k + _WINDOW]) for k in range(len(late) - _WINDOW + 1)])
        bad = np.flatnonzero(medians > _IN_TIME_S)
        first = 0 if not len(bad) else int(bad[-1]) + 1
        return times[first] - since_s if first < len(medians) else float("inf")

    def status(self) -> dict[str, str]:
        """The daemon's own account; empty where it does not answer."""
        for reply in self._session.get("landfix/status", timeout=3.0):
            if reply.ok is not None:
                values: dict[str, str] = json.loads(reply.ok.payload.to_bytes())["daemon"]
                return values
        return {}


def flood(session: zenoh.Session, message: Encoded, seconds: float = FLOOD_S) -> int:
    """One message over and over, as fast as it goes, at most _RATE_HZ; how often."""
    topic, schema, data = message
    publisher = session.declare_publisher(zenoh_keys.rmw_key(0, topic, schema, type_hash(schema)))
    attachment = zenoh_keys.attachment(1, time.time_ns(), bytes(16))
    began, sent = time.monotonic(), 0
    while (elapsed := time.monotonic() - began) < seconds:
        for _ in range(min(200, max(0, round(elapsed * _RATE_HZ) - sent))):
            publisher.put(data, attachment=attachment)
            sent += 1
    publisher.undeclare()  # type: ignore[no-untyped-call]
    return sent


def attacks(session: zenoh.Session, daemon: int) -> dict[str, Callable[[], object]]:
    """Name -> what it does; each takes some seconds at most."""
    rng = np.random.default_rng(1)

    def late_burst() -> int:
        for k in range(100):
            session.put(
                zenoh_keys.rmw_key(0, "/pose_fix", schemas.POSE_FIX, type_hash(schemas.POSE_FIX)),
                encode_input(pose_fix(time.time_ns() - 500_000_000 - 45_000_000 * k, rng)).data,
                attachment=zenoh_keys.attachment(k, time.time_ns(), bytes(16)),
            )
        return 100

    def stopped() -> str:
        os.kill(daemon, signal.SIGSTOP)
        time.sleep(2.0)
        os.kill(daemon, signal.SIGCONT)
        return "2 s"

    def vision_killed() -> str:
        os.kill(child(daemon, "spawn_main"), signal.SIGKILL)
        return "SIGKILL"

    now_ns = time.time_ns()
    return {
        "empty messages on /gnss": lambda: flood(session, Encoded("/gnss", schemas.NAV_SAT_FIX, b"")),
        "one IMU sample over and over": lambda: flood(session, encode_input(imu(now_ns, rng))),
        "empty messages on /imu": lambda: flood(session, Encoded("/imu", schemas.IMU, b"")),
        "one pose fix over and over": lambda: flood(session, encode_input(pose_fix(now_ns, rng))),
        "an unknown topic": lambda: flood(session, Encoded("/nobody/knows", schemas.IMU, b"")),
        "images of noise": lambda: flood(session, image("/left/image", now_ns, bytes(640 * 480)), 2.0),
        "100 late fixes at once": late_burst,
        "SIGSTOP, SIGCONT": stopped,
        "vision killed": vision_killed,
    }


def run(minutes: float, folder: Path, out: Path) -> list[dict[str, Any]]:
    """All attacks in turn, for so long; a row for each."""
    (folder / "vehicle.toml").write_text(configuration(folder, PORT, None))
    daemon = python("estimator", "run", "-c", str(folder / "vehicle.toml"))
    while not listening(PORT):
        time.sleep(0.1)
    endpoint = f"tcp/127.0.0.1:{PORT}"
    words = [
        "--connect",
        endpoint,
        "--seconds",
        "100000",
        "--imu-hz",
        "200",
        "--fix-hz",
        "1",
        "--pictures",
        str(folder / "turn.mcap"),
    ]
    vehicle = python("benchmarks.service.vehicle", *words)
    rows: list[dict[str, Any]] = []
    with connected(endpoint) as session, connected(endpoint) as attacker:
        ears = Ears(session)
        while len(ears.heard) < 2000 or ears.status().get("vision state") not in {"seeing", "ready", "waiting for an estimate"}:
            time.sleep(1.0)
        began, killed = time.monotonic(), 0
        while time.monotonic() - began < 60.0 * minutes:
            for name, act in attacks(attacker, daemon.pid).items():
                sent = act()
                ended_s = time.time()
                killed += name == "vision killed"
                time.sleep(QUIET_S)
                status = ears.status()
                rows.append({
                    "attack": name, "sent": sent, "recovered_s": round(ears.recovered_s(ended_s), 2),
                    "restarts_without_cause": int(status.get("vision restarts", -1)) - killed,
                    "compiled_in_flight": status.get("vision compiled_in_flight", ""),
                    "rss_mb": round(_rss_mb(daemon.pid)), "internal_errors": int(status.get("internal_errors", 0)),
                })  # fmt: skip
                print(rows[-1], flush=True)
                with out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
                if time.monotonic() - began > 60.0 * minutes:
                    break
        daemon.kill()
        killed_s = time.time()
    vehicle.kill()
    daemon.wait()
    last_ns = 0
    for log in (folder / "logs").glob("*.mcap"):
        with LogReader(log) as reader:
            last_ns = max([last_ns, *(r.log_time_ns for r in reader if r.topic == "/imu")])
    rows.append({"attack": "SIGKILL", "lost_s": round(killed_s - last_ns * 1e-9, 3)})
    print(rows[-1])
    return rows


def _rss_mb(pid: int) -> float:
    fields = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return int(fields["VmRSS"].split()[0]) / 1024.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--out", type=Path, default=Path("out/attack.jsonl"))
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        images.write(folder)
        rows = run(given.minutes, folder, given.out)
    slow = [
        r for r in rows if r.get("recovered_s", 0.0) > 2.0 or r.get("restarts_without_cause", 0) or r.get("internal_errors", 0)
    ]
    print(f"{len(rows)} attacks, {len(slow)} of them not recovered within 2 s or with a restart without cause")
    sys.exit(bool(slow))


if __name__ == "__main__":
    main()
