"""GIVEN a position and a heading typed for a vehicle that stands, and no other sensor, THEN both last until it moves."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.config import parse
from estimator.fusion import Fusion
from estimator.service.start import EVERY_S, LEAST_S, Start
from models import so3
from models.messages import Estimate, ImuSample, Mode, vec3
from models.radius import horizontal_radius
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import Imu
from models.state import X
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, ride

STANDS_S, FLIES_S, YAW = 60.0, 8.0, 0.7
TOML = f"""
[map]
origin = [{HOME.lat_deg}, {HOME.lon_deg}, {HOME.alt_m}]
[inputs]
gnss = []
gnss_velocity = []
"""


NOISY = "[imu]\ngyro_noise = 0.01\naccel_noise = 0.12\n"  # examples/px4_sitl.toml
OF_A_SAMPLE = np.repeat([7e-3, 0.07], 3)  # rad/s, m/s^2: of PX4's SIH at rest, by which a rest was lost, or never found


def _fly(rest: bool, seed: int, noisy: bool = False) -> tuple[Run, Ride]:
    rng = np.random.default_rng(seed)
    journey = ride(STANDS_S, FLIES_S, seed=seed, yaw=YAW, imu=Imu(grade="flight_controller", rate_hz=100.0))
    at = vec3(journey.truth.p_n[0] + rng.normal(0.0, 1.0, 3))
    start = Start(at, 1.0, YAW + math.radians(rng.normal(0.0, 3.0)), math.radians(3.0))
    fixes = [start.fix(EPOCH_NS + round((1.0 + k * EVERY_S) * 1e9)) for k in range(round(LEAST_S / EVERY_S))]
    imu = [m for m in journey.messages if isinstance(m, ImuSample)]
    if noisy:
        drawn = rng.normal(scale=OF_A_SAMPLE, size=(len(imu), 6))
        imu = [
            replace(m, gyro_b=vec3(m.gyro_b + n[:3]), accel_b=vec3(m.accel_b + n[3:])) for m, n in zip(imu, drawn, strict=True)
        ]
    config = parse(TOML + (NOISY if noisy else "") + f"[rest]\nenabled = {str(rest).lower()}\n")
    return Run(Fusion(config.fusion())).feed(by_arrival([*imu, *fixes])), journey


def _radius_m(e: Estimate) -> float:
    return float(horizontal_radius(e.covariance[None, :2, :2])[0])


@pytest.mark.parametrize("seed", range(3))
def test_a_typed_start_lasts_until_it_moves_and_what_follows_is_covered(seed: int) -> None:
    run, journey = _fly(rest=True, seed=seed)
    assert run.aligned[0].t_ns < EPOCH_NS + 3_000_000_000
    (last, *_) = within(run.aligned, STANDS_S - 1.0, STANDS_S)
    assert last.mode is Mode.DEAD_RECKONING
    assert _radius_m(last) < 3.5  # of 2.4 that were typed
    assert np.degrees(np.sqrt(last.covariance[8, 8])) < 3.5
    moved = within(run.aligned, STANDS_S + FLIES_S - 1.0, STANDS_S + FLIES_S)[-1]
    assert np.linalg.norm(error(moved, journey.truth)[:2]) < min(12.0, _radius_m(moved))
    yaw = so3.to_euler(so3.normalise(moved.nav[X.Q]))[2] - so3.to_euler(journey.truth.q_nb_wxyz[-1])[2]
    assert abs(math.remainder(yaw, 2.0 * math.pi)) < math.radians(10.0)


@pytest.mark.parametrize("seed", range(6))
def test_it_lasts_with_a_noisy_imu_as_well(seed: int) -> None:
    run, _ = _fly(rest=True, seed=seed, noisy=True)
    velocity = max(float(np.sqrt(e.covariance.diagonal()[3:6].max())) for e in within(run.aligned, 4.0, LEAST_S))
    assert velocity < 0.15  # whenever it is asked: 0.2 confirms no rest
    assert max(map(_radius_m, within(run.aligned, 8.0, STANDS_S))) < 3.5


def test_without_rest_it_is_of_no_use_in_seconds() -> None:
    run, _ = _fly(rest=False, seed=0)
    (later, *_) = within(run.aligned, LEAST_S + 10.0, LEAST_S + 11.0)
    assert _radius_m(later) > 15.0  # [autopilot] most_radius_m
