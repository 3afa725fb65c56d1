"""The same bits from kernels just compiled and from kernels loaded: what was flown on the first day replays on the second."""

import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import estimator
import models
import vision

LOOK = """
import hashlib
import numpy as np
from vision.pose.observation import distance_from_roof
from vision.outline.edge_search import search

rng = np.random.default_rng(1)
image = rng.integers(60, 100, (480, 640, 3), dtype=np.uint8)
along, side = np.linspace(-25.0, 25.0, 20), 31.3
px, normal, edge = [], [], []
for roof in range(4):
    centre = 100.0 + 130.0 * np.array([roof, 0.5 * roof])
    u, v = (centre - 30.0).astype(int)
    image[v : v + 60, u : u + 60] = rng.integers(140, 200, 3, dtype=np.uint8) + rng.integers(0, 20, (60, 60, 3), dtype=np.uint8)
    for k, n in enumerate(np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])):
        px.append(centre + side * n + along[:, None] * n[::-1])
        normal.append(np.tile(n, (20, 1)))
        edge += [4 * roof + k] * 20
nothing_beside = np.full((32, 2), -1e3)
edge = np.array(edge)
distance, usable, hidden = distance_from_roof(
    image, np.concatenate(px), np.concatenate(normal), np.ones(320, np.bool_), edge, np.zeros(16, np.int64),
    np.ones(16, np.bool_), np.arange(16) // 4, np.full(16, -1), nothing_beside, 16,
)
offsets = search(distance, edge, 16, 1.0, usable & ~hidden)
print(int(np.isfinite(offsets).sum()), hashlib.sha256(offsets.tobytes() + usable.tobytes()).hexdigest())
"""


@pytest.mark.long
def test_a_kernel_that_was_just_compiled_gives_the_bits_of_one_that_is_loaded(tmp_path: Path) -> None:
    def run() -> str:
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        return subprocess.run([sys.executable, "-c", LOOK], env=environment, check=True, capture_output=True, text=True).stdout

    compiled, loaded = run(), run()
    assert int(compiled.split()[0]) > 200  # edges were found
    assert compiled == loaded


def test_no_kernel_that_an_estimate_rests_on_may_calculate_in_another_order() -> None:
    """With fastmath the compiler may, and does as a kernel stands alone or in its callers, whichever was loaded first."""
    names = [
        found.name
        for package in (models, vision, estimator)
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    ]
    kernels = [
        value for name in names if not name.endswith("__main__") for value in vars(importlib.import_module(name)).values()
        if isinstance(value, Dispatcher) and not value.py_func.__module__.startswith("vision.synthetic")  # which draws images
    ]  # fmt: skip
    assert len(kernels) > 100
    assert not [kernel for kernel in kernels if kernel.targetoptions.get("fastmath")]
