"""A follower goes on without an IMU that it takes for wrong, however wrong that is."""

import numpy as np
from msgspec.structs import replace

from models.messages import ImuSample, Input, vec3
from models.sim.scenario import EPOCH_NS
from tests.estimator.scenes import SECOND, fly, position_errors, simulated, within

FLIGHT = """
duration_s = 20.0
[vehicle]
kind = "multirotor"
seed = 1
[imu]
rate_hz = 50.0
[pose_fix]
rate_hz = 2.0
"""
BEGIN_S, END_S = 10.0, 13.0
EXCHANGED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def test_fixes_lead_again_after_three_seconds_of_an_imu_whose_axes_are_exchanged() -> None:
    def wrong(m: Input) -> Input:
        if isinstance(m, ImuSample) and BEGIN_S <= (m.t_ns - EPOCH_NS) / SECOND < END_S:
            return replace(m, gyro_b=vec3(EXCHANGED @ m.gyro_b), accel_b=vec3(EXCHANGED @ m.accel_b))
        return m

    flight = simulated(FLIGHT)
    run = fly(flight, messages=[wrong(m) for m in flight.messages])
    assert position_errors(within(run.estimates, END_S + 3.1, 20.0), flight.truth).max() < 1.5
