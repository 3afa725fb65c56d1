"""A follower goes on without an IMU that it takes for wrong, however wrong that is, and leads soon after an outage."""

import numpy as np
import pytest
from msgspec.structs import replace

from models.messages import ImuSample, Input, PoseFix, Reason, vec3
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


DARK = FLIGHT.replace("20.0", "35.0").replace("rate_hz = 2.0", "rate_hz = 2.0\noutages_s = [[12.0, 20.0]]")
FALSE_N = np.array([9.0, 0.0, -8.0])


@pytest.mark.parametrize("bias", [(0.0, 1.5, 0.0), (1.0, 0.0, -1.0)])
def test_after_an_outage_that_the_imu_spent_wrong_the_fourth_fix_leads(bias: tuple[float, float, float]) -> None:
    """What the error of an IMU has moved, it still moves."""

    def wrong(m: Input) -> Input:
        if isinstance(m, ImuSample) and 13.0 <= (m.t_ns - EPOCH_NS) / SECOND < 16.0:
            return replace(m, accel_b=vec3(np.add(m.accel_b, bias)))
        return m

    flight = simulated(DARK)
    run = fly(flight, messages=[wrong(m) for m in flight.messages])
    assert position_errors(within(run.estimates, 19.0, 20.0), flight.truth).min() > 10.0
    assert position_errors(within(run.estimates, 22.2, 35.0), flight.truth).max() < 1.5


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_eight_false_fixes_of_one_place_after_an_outage_do_not_lead(seed: int) -> None:
    flight = simulated(DARK, seed=seed)
    false = [m for m in flight.messages if isinstance(m, PoseFix) and m.t_ns >= EPOCH_NS + 20 * SECOND][:8]
    last_ns = false[-1].t_ns
    moved = [
        replace(m, p_n=vec3(m.p_n + FALSE_N)) if isinstance(m, PoseFix) and false[0].t_ns <= m.t_ns <= last_ns else m
        for m in flight.messages
    ]
    run = fly(flight, messages=moved)
    words = run.last_words("/pose_fix")
    assert {words[m.t_ns, "pose"].reason for m in false} == {Reason.GATED}
