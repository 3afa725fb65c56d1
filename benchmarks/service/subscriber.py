"""Somebody who listens to the daemon, as a process of its own: how late, how many, and whether each is a number.

    python -m benchmarks.service.subscriber --connect tcp/127.0.0.1:7447

Latency is from the stamp of the IMU sample to its estimate here. Until SIGTERM; then one JSON object.
"""

import argparse
import json
import math
import signal
import threading
import time
from typing import Any

import numpy as np
import zenoh

from benchmarks.service.vehicle import connected
from estimator.service.zenoh import keys as zenoh_keys
from logs.wire import cdr_fast, schemas
from logs.wire.codec import decode_odometry
from logs.wire.stamps import stamp_of

MINUTE_NS = 60_000_000_000
_SHARES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}


class Ear:
    """Keeps little: the time and the bytes' verdict of each estimate."""

    def __init__(self, session: zenoh.Session) -> None:
        self.minutes_ns: list[list[int]] = []  # latencies, a list for each minute since the first stamp
        self._first_ns: int | None = None
        self.not_finite = self.out_of_order = 0
        self._last_ns = 0
        decode_odometry(cdr_fast.odometry(1, np.zeros(85)))  # tables are made: the first estimate is not to be late
        key = zenoh_keys.rmw_key(0, "/landfix/odometry", schemas.ODOMETRY)
        self._subscriber = session.declare_subscriber(key, self._hear)

    @property
    def latency_ns(self) -> list[int]:
        """Of all estimates."""
        return [ns for minute in self.minutes_ns for ns in minute]

    def _hear(self, sample: zenoh.Sample) -> None:
        now_ns, data = time.time_ns(), sample.payload.to_bytes()
        t_ns = stamp_of(data) or 0
        if self._first_ns is None:
            self._first_ns = t_ns
        while len(self.minutes_ns) <= (t_ns - self._first_ns) // MINUTE_NS:
            self.minutes_ns.append([])
        self.minutes_ns[-1].append(now_ns - t_ns)
        self.out_of_order += t_ns <= self._last_ns
        self._last_ns = t_ns
        odometry = decode_odometry(data)
        self.not_finite += not np.isfinite([*odometry.p_n, *odometry.q_nb_wxyz, *odometry.pose_covariance.ravel()]).all()


def quantiles_ms(latency_ns: list[int]) -> dict[str, float]:
    """The middle and the tail."""
    ms = sorted(ns * 1e-6 for ns in latency_ns) or [math.nan]
    return {name: round(ms[math.ceil(q * len(ms)) - 1], 3) for name, q in _SHARES.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    session = connected(parser.parse_args().connect)
    ear = Ear(session)
    print("ready", flush=True)
    stop.wait()
    status: dict[str, Any] = {}
    for reply in session.get("landfix/status", timeout=5.0):
        status = json.loads(reply.ok.payload.to_bytes())["daemon"] if reply.ok else {}
    heard = {
        "estimates_heard": len(ear.latency_ns),
        "latency_ms": quantiles_ms(ear.latency_ns),
        "each_minute_ms": [quantiles_ms(minute) for minute in ear.minutes_ns],
        "not_finite": ear.not_finite,
        "out_of_order": ear.out_of_order,
        "daemon": status,
    }
    print(json.dumps(heard))
    session.close()  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
