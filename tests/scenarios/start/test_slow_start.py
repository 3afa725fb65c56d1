"""GIVEN a receiver whose first fixes share an error of 1.5 m, that fades in a minute, THEN the first estimates are covered."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.config import parse
from estimator.fusion import Fusion
from models import so3
from models.messages import AttitudePrior, GnssFix, Input
from models.sim.aids import Gnss
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import Imu
from tests.estimator.scenes import Run, by_arrival, error
from tests.scenarios.senses import HOME, ride

SIGMA_M, TAU_S, RATE_HZ = (1.5, 1.5, 3.0), 60.0, 5.0  # as [gnss] slow_sigma_m and slow_s have it
TOML = f"[map]\norigin = [{HOME.lat_deg}, {HOME.lon_deg}, {HOME.alt_m}]\n"


def _nees(moving: bool, seed: int) -> list[float]:
    """Of the horizontal position, a component, of the estimates of the first two seconds."""
    rng = np.random.default_rng(seed)
    rests_s = 0.5 if moving else 4.0
    imu, gnss = Imu(grade="flight_controller", rate_hz=50.0), Gnss(rate_hz=RATE_HZ, sigma_m=(0.5, 0.5, 1.0))
    journey = ride(rests_s, 9.0 if moving else 0.5, seed=seed, imu=imu, gnss=gnss)
    slow, keeps, messages = rng.normal(0.0, SIGMA_M), math.exp(-1.0 / (RATE_HZ * TAU_S)), list[Input]()
    for m in journey.messages:
        if isinstance(m, GnssFix):
            slow = keeps * slow + math.sqrt(1.0 - keeps**2) * rng.normal(0.0, SIGMA_M)
            lat, lon, alt = HOME.to_geodetic(np.array(HOME.to_ned(m.lat_deg, m.lon_deg, m.alt_m)) + slow)
            m = replace(m, lat_deg=lat, lon_deg=lon, alt_m=alt)  # noqa: PLW2901
        messages.append(m)
    if not moving:
        w, x, y, z = so3.normalise(journey.truth.q_nb_wxyz[0]).tolist()
        times = range(EPOCH_NS, EPOCH_NS + 4_000_000_000, 500_000_000)
        messages += [AttitudePrior(t, t, (w, x, y, z), np.diag([1e-3, 1e-3, 5e-3]), "/attitude") for t in times]
    run = Run(Fusion(parse(TOML).fusion())).feed(by_arrival(messages))
    off = [(error(e, journey.truth)[:2], e.covariance[:2, :2]) for e in run.aligned[:100:10]]
    return [0.5 * float(d @ np.linalg.solve(cov, d)) for d, cov in off]


@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "in motion"])
def test_the_first_estimates_are_covered(moving: bool) -> None:
    found = [_nees(moving, seed) for seed in range(6)]
    assert min(map(len, found)) == 10
    assert np.mean(found) < 2.5  # 15 at rest, 10 in motion, of a start that is as good as its white noise
