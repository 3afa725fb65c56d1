"""Keeps one core from going idle during benchmarks.service: what `idle=poll` does on the kernel's command line.

    python -m benchmarks.service.awake CORE

Until it is killed, at the lowest priority there is: any other process takes the core from it at once. A host takes a core that
its virtual machine leaves idle, and may take long to return it; then latencies are the host's. Each division waits for the one
before it, so that the other thread of a shared core is hardly slowed down.
"""

import os
import sys

from numba import njit


@njit(cache=True)
def _wait_for_divisions(x: float) -> float:
    for _ in range(1_000_000_000):
        x = 1.5 / x
    return x


def main() -> None:
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.sched_setaffinity(0, {int(sys.argv[1])})
    x = 1.1
    while True:
        x = _wait_for_divisions(x)


if __name__ == "__main__":
    main()
