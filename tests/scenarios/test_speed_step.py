"""GIVEN GNSS alone, once aligned, WHEN its speed steps by 2 m/s, and its positions with it, THEN what is followed is covered."""

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.filter.mismatch.speed_step import SpeedStep
from models.frames import Origin
from models.messages import GnssFix, GnssVelocity, ImuSample, Input, PoseFix, ReceiverState, Vec3
from models.sim.scenario import EPOCH_NS, Simulation
from models.state import X
from tests.estimator.scenes import config_of, fly, position_errors, radii, simulated, within

ALIGNED_S, FROM_S, END_S, STEP_M_S = 4.0, 8.0, 30.0, 2.0
GNSS_ALONE = f"""
duration_s = {END_S}
[vehicle]
kind = "multirotor"
[imu]
rate_hz = 50.0
grade = "flight_controller"
[gnss]
rate_hz = 5.0
[pose_fix]
rate_hz = 2.0
"""


def _pulled(simulation: Simulation, state: ReceiverState) -> list[Input]:
    lla = config_of(simulation).origin
    assert lla is not None
    origin = Origin(*lla)
    found: list[Input] = []
    for message in simulation.messages:
        since_s = (message.t_ns - EPOCH_NS) * 1e-9 - FROM_S
        if since_s > 0.0 and isinstance(message, GnssFix):
            p_n = np.array(origin.to_ned(message.lat_deg, message.lon_deg, message.alt_m))
            lat, lon, alt = origin.to_geodetic(p_n + np.array([STEP_M_S * since_s, 0.0, 0.0]))
            found.append(replace(message, lat_deg=lat, lon_deg=lon, alt_m=alt, state=state))
        elif since_s > 0.0 and isinstance(message, GnssVelocity):
            north, east, down = message.v_n
            found.append(replace(message, v_n=(north + STEP_M_S, east, down)))
        elif not isinstance(message, PoseFix) or since_s < ALIGNED_S - FROM_S:
            found.append(message)
    return found


@pytest.mark.parametrize("state", [ReceiverState.UNKNOWN, ReceiverState.JAMMED])
def test_a_speed_that_the_imu_contradicts_is_covered_before_it_is_followed(state: ReceiverState) -> None:
    simulation = simulated(GNSS_ALONE, seed=2)
    run = fly(simulation, messages=_pulled(simulation, state))
    late = within(run.aligned, FROM_S, END_S, every=5)
    off = position_errors(late, simulation.truth)
    assert off[-1] > 0.8 * STEP_M_S * (END_S - FROM_S)  # nothing but the IMU contradicts it
    assert (off < radii(late)).all()
    assert "the speed of /gnss stepped by" in run.health[-1].detail


@pytest.mark.parametrize("impact_s", [FROM_S - 0.9, FROM_S + 5.0], ids=["before it", "while it lasts"])
def test_an_impact_hides_no_step_and_ends_none(impact_s: float) -> None:
    def struck(m: Input) -> Input:
        if not isinstance(m, ImuSample) or not 0.0 <= (m.t_ns - EPOCH_NS) * 1e-9 - impact_s < 0.02:
            return m
        x, y, z = m.accel_b
        return replace(m, accel_b=(x, y + 35.0, z))

    simulation = simulated(GNSS_ALONE, seed=2)
    run = fly(simulation, messages=[struck(m) for m in _pulled(simulation, ReceiverState.UNKNOWN)])
    late = within(run.aligned, FROM_S, END_S, every=5)
    assert (position_errors(late, simulation.truth) < 1.5 * radii(late)).all()
    assert "the speed of /gnss stepped by" in run.health[-1].detail


def _reading(t_s: float, nu: Vec3, before: SpeedStep | None = None) -> SpeedStep:
    t_ns, x, variance = round(t_s * 1e9), np.zeros(X.SIZE), np.full(3, 0.1**2)
    if before is None:
        return SpeedStep(t_ns, x, np.array(nu), variance, agrees=True, scatter2=0.02, usual=10)
    after = before.after(t_ns, np.array(nu), x, variance)
    return replace(after, t_ns=t_ns, nu=np.array(nu), followed=bool(after.net.any()))


def test_a_speed_that_fits_the_state_before_is_no_step() -> None:
    found = _reading(0.2, (2.0, 0.0, 0.0), _reading(0.0, (0.0, 0.0, 0.0)))
    assert found.before is not None
    assert not found.confirmed(np.array([1.1, 0.0, 0.0])).net.any()  # readings before were 0.9 m/s off
    np.testing.assert_array_equal(found.confirmed(np.array([1.9, 0.0, 0.0])).net, [1.9, 0.0, 0.0])


def test_steps_that_are_usual_for_a_receiver_are_none() -> None:
    found = _reading(0.0, (0.0, 0.0, 0.0))
    for k in range(1, 30):  # a claim of 0.1 m/s, steps of 0.7
        found = _reading(0.2 * k, (0.7 * (k % 2), 0.0, 0.0), found)
    assert not _reading(6.0, (2.0, 0.0, 0.0), found).net.any()


def test_a_step_back_ends_it() -> None:
    up = _reading(0.2, (2.0, 0.0, 0.0), _reading(0.0, (0.0, 0.0, 0.0)))
    assert up.covariance is not None
    np.testing.assert_allclose(up.covariance[3:6, 3:6], np.diag([4.0, 0.0, 0.0]))
    np.testing.assert_allclose(np.sqrt(up.covariance[0, 0]), 2.0 * 0.2)
    assert _reading(0.4, (2.1, 0.2, 0.0), up).covariance is not None  # noise is no step
    assert _reading(0.4, (0.1, 0.2, 0.0), up).covariance is None


def test_what_the_timing_of_a_receiver_makes_of_an_acceleration_is_no_step() -> None:
    before = _reading(0.0, (0.0, 0.0, 0.0))
    x = np.zeros(X.SIZE)
    x[X.V] = 3.0, 0.0, 0.0  # 15 m/s^2
    assert not before.after(200_000_000, np.array([1.4, 0.0, 0.0]), x, before.variance).net.any()
