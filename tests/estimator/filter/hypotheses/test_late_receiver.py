"""A receiver whose stamps are late, on a wing, where fixes have ended: true readings are not locked out."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.stress.cell import errors, landfix, perturbed
from benchmarks.stress.flights import load_flight
from benchmarks.stress.perturbations import KINDS

FROM_S = 10.0


@pytest.mark.parametrize(
    ("late_ms", "seed", "what"),
    [
        (300.0, 1, "a drift against nothing but fixes that the estimate refuses stops the receiver"),
        (300.0, 5, "one that does without the receiver gains by a velocity that its followers refuse"),
        (500.0, 0, "a run of the aligning stretch ends elsewhere than its newest reading"),
    ],
)
def test_an_estimate_with_a_receiver_stays_near_it(late_ms: float, seed: int, what: str, tmp_path: Path) -> None:
    kind = KINDS["GNSS delay"]
    flight = load_flight("sim/wing", kind.aids, seed, tmp_path)
    estimates, _, _ = landfix(perturbed(flight, kind, late_ms, seed), flight)
    _, error, radius = errors(estimates, flight, FROM_S)
    speed = float(np.linalg.norm(flight.v_n, axis=1).max())
    assert error.max() < 3.0 * speed * late_ms * 1e-3, what  # the receiver is wrong by a third of it
    assert np.mean(error > radius) < 0.05, what
    assert np.mean(error > 3.0 * radius) == 0.0, what
