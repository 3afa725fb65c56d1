"""Velocities of a receiver in other axes or another unit, from the start: positions align, and the velocities are refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.stress.cell import errors, landfix
from benchmarks.stress.flights import load_flight
from models.messages import GnssVelocity, Input, Vec3

FROM_S = 10.0
WRONG: dict[str, Callable[[Vec3], Vec3]] = {
    "east, north": lambda v: (v[1], v[0], v[2]),
    "reversed": lambda v: (-v[0], -v[1], -v[2]),
    "up": lambda v: (v[0], v[1], -v[2]),
    "half": lambda v: (0.5 * v[0], 0.5 * v[1], 0.5 * v[2]),
    "turned by 20 deg": lambda v: (0.94 * v[0] - 0.34 * v[1], 0.34 * v[0] + 0.94 * v[1], v[2]),
}


def _in_other_axes(messages: list[Input], change: Callable[[Vec3], Vec3], without: str = "") -> list[Input]:
    kept = (m for m in messages if m.topic != without)
    return [replace(m, v_n=change(m.v_n)) if isinstance(m, GnssVelocity) else m for m in kept]


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("vehicle", ["sim/rotor", "sim/wing"])
def test_with_fixes_they_cost_nothing(vehicle: str, wrong: str, tmp_path: Path) -> None:
    flight = load_flight(vehicle, "both", 0, tmp_path)
    estimates, _, _ = landfix(_in_other_axes(flight.messages, WRONG[wrong]), flight)
    _, error, radius = errors(estimates, flight, FROM_S)
    assert np.sqrt(np.mean(error**2)) < 0.25
    assert np.mean(error > radius) < 0.05


@pytest.mark.parametrize("wrong", ["east, north", "reversed", "half", "turned by 20 deg"])
def test_positions_of_the_receiver_align_a_wing(wrong: str, tmp_path: Path) -> None:
    flight = load_flight("sim/wing", "both", 0, tmp_path)
    estimates, _, _ = landfix(_in_other_axes(flight.messages, WRONG[wrong], without="/pose_fix"), flight)
    assert (estimates[0].t_ns - flight.start_ns) * 1e-9 < FROM_S
    _, error, radius = errors(estimates, flight, FROM_S)
    assert np.sqrt(np.mean(error**2)) < 1.5
    assert np.mean(error > radius) < 0.05
