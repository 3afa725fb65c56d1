"""GIVEN a vehicle at rest with a magnetometer and two antennas THEN their heading is used where they agree, else neither is."""

import math

import numpy as np
import pytest

from estimator.config import parse
from estimator.fusion import Fusion
from models import so3
from models.messages import Reason
from models.sim.sensors import Imu
from models.state import X
from tests.estimator.scenes import Run, by_arrival, within
from tests.scenarios.senses import HOME, heading, magnetometer, ride

RESTS_S, MOVES_S = 8.0, 20.0
TOML = f"""
[map]
origin = [{HOME.lat_deg}, {HOME.lon_deg}, {HOME.alt_m}]
[inputs]
heading = "/heading"
magnetometer = "/mag"
"""


@pytest.mark.parametrize("off_deg", [0.0, 60.0])
def test_of_two_headings_that_differ_neither_is_used_and_the_motion_shows_it(off_deg: float) -> None:
    journey = ride(RESTS_S, MOVES_S, seed=1, imu=Imu(grade="flight_controller", rate_hz=50.0))
    both = [*heading(journey.truth, off_deg=off_deg), *magnetometer(journey.truth)]
    run = Run(Fusion(parse(TOML).fusion())).feed(by_arrival([*journey.messages, *both]))
    assert bool(within(run.aligned, RESTS_S - 2.0, RESTS_S)) == (off_deg == 0.0)
    assert any("the headings of /mag and /heading differ" in h.detail for h in run.health) == (off_deg > 0.0)
    assert (run.reasons("/heading").get(Reason.FUSED, 0) > 100) == (off_deg == 0.0)
    last = run.aligned[-1]
    yaw = so3.to_euler(so3.normalise(last.nav[X.Q]))[2] - so3.to_euler(journey.truth.q_nb_wxyz[-1])[2]
    assert abs(math.remainder(yaw, 2.0 * math.pi)) < 4.0 * np.sqrt(last.covariance[8, 8]) < math.radians(15.0)
