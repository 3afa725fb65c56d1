"""Linear algebra runs in the thread that asks for it: another one would cost milliseconds wherever it waits for a busy core."""

import os
import subprocess
import sys
from pathlib import Path

_CODE = """
import sys
import estimator.cli
import numpy as np, scipy.linalg

a = np.random.default_rng(0).standard_normal((400, 400))
scipy.linalg.inv(a @ a)
with open("/proc/self/status") as status:
    print(next(line.split()[1] for line in status if line.startswith("Threads:")))
"""


def _threads(**given: str) -> int:
    unset = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment = unset | {"PYTHONPATH": str(Path(__file__).parents[2])} | given
    process = subprocess.run([sys.executable, "-c", _CODE], env=environment, capture_output=True, text=True, check=True)
    return int(process.stdout)


def test_one_thread_unless_more_are_configured() -> None:
    assert _threads() == 1
    if len(os.sched_getaffinity(0)) > 1:
        assert _threads(OPENBLAS_NUM_THREADS="2") > 1
