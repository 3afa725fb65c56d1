"""What the machine itself does to a latency, next to benchmarks.service: how late it wakes a sleeper, what a host takes from it.

    python -m benchmarks.service.machine [--hz 400]

It sleeps from one tick to the next and does nothing else. Until SIGTERM; then one JSON object. A message from a vehicle to a
subscriber has to wake four threads one after the other, so it cannot be quicker than that.
"""

import argparse
import json
import os
import signal
import threading
import time
from pathlib import Path

from benchmarks.service.subscriber import quantiles_ms

_MINUTE_S = 60.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hz", type=float, default=400.0)
    period_ns = round(1e9 / parser.parse_args().hz)
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    late_ns: list[int] = []
    minutes: list[dict[str, float]] = []
    whole, minute, first, due_ns = _Steal(), _Steal(), 0, time.monotonic_ns()
    while not stop.is_set():
        due_ns = max(due_ns + period_ns, time.monotonic_ns())  # what was slept through is one late waking
        time.sleep(max(due_ns - time.monotonic_ns(), 0) * 1e-9)
        late_ns.append(time.monotonic_ns() - due_ns)
        if minute.seconds >= _MINUTE_S:
            minutes.append(quantiles_ms(late_ns[first:]) | {"stolen_percent": minute.percent})
            first, minute = len(late_ns), _Steal()
    measured = {"wakes_late_ms": quantiles_ms(late_ns), "stolen_percent": whole.percent, "each_minute": minutes}
    print(json.dumps(measured))


class _Steal:
    """Processor time that the host of a virtual machine gives to others, of all cores, from now on."""

    def __init__(self) -> None:
        self._began_s, self._stolen_s = time.monotonic(), _stolen_s()

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.monotonic() - self._began_s

    @property
    def percent(self) -> float:
        """Of the time since it began."""
        return round(100.0 * (_stolen_s() - self._stolen_s) / self.seconds / len(os.sched_getaffinity(0)), 1)


def _stolen_s() -> float:
    return int(Path("/proc/stat").read_text().split(maxsplit=9)[8]) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
