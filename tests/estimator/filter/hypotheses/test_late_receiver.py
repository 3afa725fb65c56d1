"""A receiver whose stamps are late, on a wing, where fixes have ended: its readings are not locked out."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.stress.cell import errors, landfix, perturbed
from benchmarks.stress.flights import load_flight
from benchmarks.stress.perturbations import KINDS

FROM_S, MOST_M = 10.0, 30.0


@pytest.mark.parametrize(("late_ms", "seed"), [(300.0, 1), (300.0, 4), (300.0, 5), (500.0, 0)])
def test_an_estimate_with_a_receiver_stays_near_it(late_ms: float, seed: int, tmp_path: Path) -> None:
    kind = KINDS["GNSS delay"]
    flight = load_flight("sim/wing", kind.aids, seed, tmp_path)
    estimates, _, _ = landfix(perturbed(flight, kind, late_ms, seed), flight)
    _, error, radius = errors(estimates, flight, FROM_S)
    assert error.max() < MOST_M
    assert np.mean(error > radius) < 0.05
    assert np.mean(error > 3.0 * radius) == 0.0
