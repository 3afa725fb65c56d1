"""A computation at the lowest priority there is, on one core, beside benchmarks.service: what else a vehicle computes.

    python -m benchmarks.service_busy CORE

Until it is killed. Any other process takes the core from it at once. A virtual machine that always computes never gives its cores
back to its host, who may take long to return them: then latencies are of the processes in it, not of its host.
"""

import os
import sys


def main() -> None:
    os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.sched_setaffinity(0, {int(sys.argv[1])})
    while True:
        pass


if __name__ == "__main__":
    main()
