"""A short simulated flight as a log, made once: IMU 200 Hz, GNSS 5 Hz, late pose fixes, truth."""

from pathlib import Path

import pytest

from models.sim.scenario import Scenario, Simulation, simulate
from models.sim.scenario_file import loads

SCENARIO = """
duration_s = 20.0
[gnss]
outages_s = [[12.0, 20.0]]
[pose_fix]
rate_hz = 1.0
delay_s = 0.3
"""


@pytest.fixture(scope="session")
def scenario() -> Scenario:
    return loads(SCENARIO)


@pytest.fixture(scope="session")
def simulation(scenario: Scenario) -> Simulation:
    return simulate(scenario, seed=1)


@pytest.fixture(scope="session")
def flight(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """flight.mcap with its configuration flight.toml beside it."""
    from estimator import simulate as simulated

    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    simulated.write(simulation, path)
    path.with_suffix(".toml").write_text(simulation.config_toml)
    return path
