"""An IMU that goes wrong beside a receiver alone: covered at once, and the receiver leads within 15 s, unless it is pulled."""

from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from models.messages import GnssFix, GnssVelocity, ImuSample, Input, PoseFix, vec3
from models.sim.scenario import EPOCH_NS
from tests.estimator.scenes import SECOND, fly, position_errors, radii, simulated

FLIGHT = """
duration_s = 60.0
[vehicle]
kind = "multirotor"
seed = 0
[gnss]
[pose_fix]
rate_hz = 2.0
"""
ALIGNED_NS, ONSET_NS, END_NS, LEADS_NS = (EPOCH_NS + s * SECOND for s in (10, 25, 28, 40))
PULL_M_S = 5.0
SLIPPED = Rotation.from_rotvec(np.radians(20.0) * np.array([0.5, 0.5, 0.7])).as_matrix()


def _slips(m: ImuSample) -> ImuSample:
    """The mount gives way: turned by 20 degrees from ONSET_NS on."""
    return replace(m, gyro_b=vec3(SLIPPED @ m.gyro_b), accel_b=vec3(SLIPPED @ m.accel_b))


def _in_degrees(m: ImuSample) -> ImuSample:
    """The gyroscope in another unit for three seconds."""
    return replace(m, gyro_b=vec3(np.degrees(m.gyro_b))) if m.t_ns < END_NS else m


@pytest.mark.parametrize("wrong", [_slips, _in_degrees])
def test_the_estimate_is_covered_and_follows_the_receiver_again(wrong: Callable[[ImuSample], ImuSample]) -> None:
    flight = simulated(FLIGHT, seed=0)
    messages: list[Input] = [
        wrong(m) if isinstance(m, ImuSample) and m.t_ns > ONSET_NS else m
        for m in flight.messages
        if not isinstance(m, PoseFix) or m.t_ns < ALIGNED_NS
    ]
    run = fly(flight, messages=messages)
    assert np.diff([e.t_ns for e in run.estimates]).max() < SECOND // 2
    late = [e for e in run.estimates if e.t_ns > ONSET_NS][::10]
    assert (position_errors(late, flight.truth) > 3.0 * radii(late)).mean() < 0.01
    assert position_errors([e for e in late if e.t_ns > LEADS_NS], flight.truth).max() < 5.0


def test_a_receiver_whose_speed_steps_is_not_followed_between_fixes_each_twenty_seconds() -> None:
    flight = simulated(FLIGHT, seed=0)

    def pulled(m: Input) -> Input:
        since_s = (m.t_ns - EPOCH_NS) * 1e-9 - 30.0
        if isinstance(m, GnssFix) and since_s > 0.0:
            return replace(m, lat_deg=m.lat_deg + PULL_M_S * since_s / 111_320.0)
        if isinstance(m, GnssVelocity) and since_s > 0.0:
            return replace(m, v_n=(m.v_n[0] + PULL_M_S, *m.v_n[1:]))
        return m

    run = fly(
        flight,
        messages=[
            pulled(m)
            for m in flight.messages
            if not isinstance(m, PoseFix) or m.t_ns < ALIGNED_NS or (m.t_ns - EPOCH_NS) % (20 * SECOND) < SECOND // 2
        ],
    )
    assert position_errors([e for e in run.estimates if e.t_ns > ONSET_NS][::20], flight.truth).max() < 20.0
