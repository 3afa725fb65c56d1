"""Recorded quadrotors with GNSS and fixes of which one is wrong: there is an estimate, and its covariance contains the truth."""

from pathlib import Path

import pytest

from benchmarks.stress import cell
from benchmarks.stress.flights import load_flight
from benchmarks.stress.perturbations import KINDS


@pytest.mark.parametrize(
    ("name", "kind", "size", "seed"),
    [
        ("quad/horiz_04", "map shift", 20.0, 0),  # the estimate changes sides
        ("quad/horiz_02", "map shift", 20.0, 1),  # had none
        ("quad/horiz_02", "map north", 30.0, 0),
        ("quad/flight_a", "fix units", 3.28, 0),
        ("quad/horiz_04", "fix units", 3.28, 2),  # straight on
        ("quad/horiz_02", "GNSS pulled, fixes 0.05 Hz", 3.0, 1),  # after an impact
        ("quad/horiz_13", "GNSS pulled, fixes 0.05 Hz", 3.0, 1),  # impacts while it is pulled
    ],
)
@pytest.mark.usefixtures("landfix_data")
def test_the_truth_is_covered(tmp_path: Path, name: str, kind: str, size: float, seed: int) -> None:
    flight = load_flight(name, KINDS[kind].aids, seed, tmp_path)
    estimates, _, _ = cell.landfix(cell.perturbed(flight, KINDS[kind], size, seed), flight)
    found = cell.score(estimates, flight, cell.BURN_S + KINDS[kind].from_s + KINDS[kind].period_s)
    assert found.complete
    assert found.overconfident <= 0.01
