"""What the tests of the program around the estimator share: a short simulated flight as a log, and a single estimate."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.replay import simulate as simulated
from models.messages import Estimate, Mode
from models.sim.scenario import Simulation, simulate
from models.sim.scenario_file import loads
from models.state import E, NavState

SCENARIO = """
duration_s = 20.0
[gnss]
outages_s = [[12.0, 20.0]]
[pose_fix]
rate_hz = 1.0
delay_s = 0.3
"""


@pytest.fixture(scope="session")
def simulation() -> Simulation:
    """20 s of IMU at 200 Hz, GNSS at 5 Hz until 12 s, pose fixes at 1 Hz that are 0.3 s late."""
    return simulate(loads(SCENARIO), seed=1)


@pytest.fixture(scope="session")
def flight(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The simulation as flight.mcap, with its configuration flight.toml next to it."""
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    simulated.write(simulation, path)
    path.with_suffix(".toml").write_text(simulation.config_toml)
    return path


@pytest.fixture(scope="session")
def estimate_at() -> Callable[[int], Estimate]:
    """An estimate at the origin, level, heading north, of a given stamp."""
    nav = NavState(np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)).pack()

    def make(t_ns: int) -> Estimate:
        return Estimate(t_ns, t_ns, nav, np.eye(E.SIZE), (0.0, 0.0, 0.0), Mode.AIDED, 0, t_ns, (47.0, 8.0, 400.0))

    return make
