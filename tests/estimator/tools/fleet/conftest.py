"""Short simulated flights in a bucket, and their rows."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import Client

from estimator.replay import simulate as simulated
from estimator.tools.fleet.engine import cluster
from models.sim.scenario import simulate
from models.sim.scenario_file import loads

SCENARIO = """
duration_s = 12.0
[imu]
rate_hz = 100.0
[gnss]
outages_s = [[6.0, 12.0]]
[pose_fix]
rate_hz = 1.0
"""
FLIGHTS = 4


@pytest.fixture(scope="session")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of flights 0.mcap, 1.mcap ..., each 12 s, and their vehicle.toml."""
    folder = tmp_path_factory.mktemp("fleet")
    for seed in range(FLIGHTS):
        simulation = simulate(loads(SCENARIO), seed=seed)
        simulated.write(simulation, folder / f"{seed}.mcap")
        (folder / "vehicle.toml").write_text(simulation.config_toml)
    return folder


@pytest.fixture(scope="session")
def client() -> Iterator[Client]:
    """One process."""
    with cluster(1) as made:
        yield made
