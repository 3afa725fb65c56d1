"""Fixes whose attitude is false and whose position is true: the position is fused, and says which attitude is right."""

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from models.messages import ImuSample, Input, PoseFix, vec3
from models.sim.scenario import EPOCH_NS, Simulation
from tests.estimator.scenes import SECOND, fly, position_errors, simulated, within

FLIGHT = """
duration_s = 45.0
[vehicle]
kind = "fixed_wing"
[imu]
rate_hz = 50.0
[pose_fix]
rate_hz = 2.0
"""
FROM_S = 20.0


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulated(FLIGHT)


def _is_late(m: Input) -> bool:
    return (m.t_ns - EPOCH_NS) / SECOND >= FROM_S


@pytest.mark.parametrize("rotvec_deg", [(12.0, 0.0, 0.0), (0.0, -8.0, 40.0), (0.0, 0.0, 180.0)])
def test_a_camera_that_has_turned_moves_no_position(flight: Simulation, rotvec_deg: tuple[float, float, float]) -> None:
    turn = Rotation.from_rotvec(rotvec_deg, degrees=True)

    def turned(m: PoseFix) -> PoseFix:
        w, x, y, z = (Rotation.from_quat(m.q_nb_wxyz, scalar_first=True) * turn).as_quat(scalar_first=True).tolist()
        return replace(m, q_nb_wxyz=(w, x, y, z))

    run = fly(flight, messages=[turned(m) if isinstance(m, PoseFix) and _is_late(m) else m for m in flight.messages])
    assert position_errors(within(run.estimates, FROM_S, 45.0), flight.truth).max() < 1.0
    assert "the attitude of /pose_fix contradicts the estimate" in run.health[-1].detail


def test_a_gyroscope_that_has_turned_away_is_still_set_right(flight: Simulation) -> None:
    """Its positions fail soon, so the attitude of the fixes leads again."""

    def dead(m: Input) -> Input:
        if isinstance(m, ImuSample) and FROM_S <= (m.t_ns - EPOCH_NS) / SECOND < FROM_S + 5.0:
            return replace(m, gyro_b=vec3(np.multiply(m.gyro_b, (1.0, 1.0, -1.0))))
        return m

    run = fly(flight, messages=[dead(m) for m in flight.messages])
    assert position_errors(within(run.estimates, FROM_S + 12.0, 45.0), flight.truth).max() < 1.5
