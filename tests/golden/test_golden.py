"""The estimate of one flight is what it was: whoever changes it sees by how much, and says so by committing the new one."""

import numpy as np

from tests.golden.flight import PATH, REFRESH, text


def test_the_trajectory_is_what_it_was() -> None:
    now = np.array([line.split() for line in text().splitlines() if not line.startswith("#")], dtype=float)
    golden = np.loadtxt(PATH)
    assert golden.shape == now.shape == (44, 16)
    worst = float(np.abs(now - golden).max())
    assert worst <= 1.5e-6, f"the estimate has changed by up to {worst:.2g}; if that is meant: {REFRESH}"
