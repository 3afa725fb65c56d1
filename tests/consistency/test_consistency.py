"""Is the covariance consistent? A small campaign: NEES over independent seeds, two-sided, before, during and after outages.

Seeds are fixed, so the outcome is too. The IMU shakes (white noise 15 x the data sheet, as configured) and its biases are
small: the covariance is made of process noise, and an error of a factor of two in it shows.
"""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.campaign.flights import Flight, flight
from benchmarks.campaign.runs import BLOCKS, PARTS, run
from benchmarks.campaign.statistics import Consistency, Result, judge, pooled_ratio
from logs.evaluation.metrics import chi2_band
from models import sampling
from models.messages import Array, Reason
from models.sim.aids import PoseFixes
from models.sim.sensors import Imu
from models.sim.trajectory import FixedWing, Multirotor
from tests import long

SEEDS = 16
PROBABILITY = 0.999  # of the band that a cell must lie in
SHAKEN = 15.0
VEHICLES: dict[str, Multirotor | FixedWing] = {"multirotor": Multirotor(), "fixed wing": FixedWing()}
FLIGHTS: dict[str, Flight] = {
    name: flight(
        name,
        vehicle,
        imu=Imu(rate_hz=50.0, noise_multiplier=SHAKEN, turn_on=0.05),
        pose_fix=PoseFixes(rate_hz=2.0, sigma_m=(0.1, 0.1, 0.1), sigma_deg=(0.3, 0.3, 0.3)),
        lengths_s=(5.0, 10.0),
        aided_s=15.0,
        between_s=10.0,
        configured_noise=SHAKEN,
    )
    for name, vehicle in VEHICLES.items()
}


@cache
def flown(name: str, process_scale: float = 1.0) -> Result:
    return judge(FLIGHTS[name], [run(FLIGHTS[name], number, process_scale) for number in range(SEEDS)])


def beyond(cell: Consistency) -> int:
    """-1: below its band (errors smaller than reported), 1: above, 0: inside."""
    low, high = chi2_band(cell.n * len(PARTS[cell.part]), PROBABILITY)
    scaled = cell.mean * cell.n * len(PARTS[cell.part])
    return int(scaled > high) - int(scaled < low)


@long.parametrize("name", FLIGHTS)
def test_nees_of_pose_velocity_and_state_stays_in_its_band(name: str) -> None:
    # GIVEN sensors as the filter models them, and outages of 5 and 10 s
    result = flown(name)
    # THEN at every instant there is an estimate, and its covariance is what the errors of all seeds are
    assert result.missing == 0
    assert [cell for cell in result.consistency if beyond(cell)] == []
    assert sum(cell.inside for cell in result.consistency) >= 0.85 * len(result.consistency)
    assert all(whole.consistent for whole in result.wholes)


@long.parametrize("name", FLIGHTS)
def test_errors_are_as_small_as_the_bound_allows(name: str) -> None:
    result = flown(name)
    for block in BLOCKS:
        # The pooled ratio scatters by about 5 %.
        assert 0.85 < pooled_ratio(cell for cell in result.efficiency if cell.block == block) < 1.15


@long.parametrize("name", FLIGHTS)
def test_true_fixes_are_fused(name: str) -> None:
    result = flown(name)
    assert result.lost == 0
    assert result.fixes.get(Reason.GATED, 0) <= 0.005 * sum(result.fixes.values())
    assert result.internal == 0


def put_and_not_learn(t_ns: NDArray[np.int64], u: Array, _: Array, k: int, __: int, stamp_ns: int, *row: float) -> None:
    t_ns[k], u[k] = stamp_ns, row


@long.parametrize(("process_scale", "side"), [(0.5, 1), (2.0, -1)])
def test_a_filter_with_wrong_process_noise_is_found_out(process_scale: float, side: int, monkeypatch: pytest.MonkeyPatch) -> None:
    # GIVEN a filter whose process noise is half, or twice, the true one, and which does not measure the rest on its samples
    monkeypatch.setattr(sampling, "put", put_and_not_learn)
    result = flown("multirotor", process_scale)
    # THEN cells leave their band, on the side that shows the error
    found = [cell for cell in result.consistency if beyond(cell)]
    assert {beyond(cell) for cell in found} == {side}
    assert {"pose", "full"} <= {cell.part for cell in found}
    assert all((whole.mean - 1.0) * side > 0.0 and not whole.consistent for whole in result.wholes if whole.part != "velocity")
