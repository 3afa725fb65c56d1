"""A measurement that is refused moves nothing: the estimates beside it are those without it, but for the covariance."""

import msgspec
import numpy as np
import pytest

from models.messages import GnssFix, Input, PoseFix, Reason, vec3
from models.sim.faults import in_order
from models.sim.scenario import Simulation
from models.state import E
from tests.estimator.scenes import SECOND, fly, simulated

FLIGHT = """
duration_s = 30.0
[imu]
rate_hz = 50.0
[gnss]
rate_hz = 5.0
[pose_fix]
rate_hz = 2.0
"""


@pytest.fixture(scope="module")
def flight() -> Simulation:
    return simulated(FLIGHT, seed=4)


def _hostile(flight: Simulation, rng: np.random.Generator) -> list[Input]:
    """Some measurements of one kind within two seconds, each of which contradicts everything."""
    begin_ns = flight.messages[0].t_ns + int(rng.integers(12 * SECOND, 24 * SECOND))
    kind, found = PoseFix if rng.random() < 0.5 else GnssFix, list[Input]()
    for t_ns in sorted(begin_ns + rng.integers(0, 2 * SECOND, int(rng.integers(1, 5)))):
        like = min((m for m in flight.messages if isinstance(m, kind)), key=lambda m: abs(m.t_ns - int(t_ns)))
        off_m, at = float(10.0 ** rng.uniform(2.0, 4.5)), {"t_ns": int(t_ns), "arrived_ns": int(t_ns)}
        if isinstance(like, PoseFix):
            found.append(msgspec.structs.replace(like, p_n=vec3(like.p_n + off_m * rng.standard_normal(3)), **at))
        else:
            found.append(msgspec.structs.replace(like, alt_m=like.alt_m + off_m, lat_deg=like.lat_deg + 1e-5 * off_m, **at))
    return found


@pytest.mark.parametrize("seed", range(6))
def test_refused_measurements_move_no_estimate(flight: Simulation, seed: int) -> None:
    hostile = _hostile(flight, np.random.default_rng(seed))
    without, beside = fly(flight), fly(flight, messages=in_order([*flight.messages, *hostile]))
    stamps = {m.t_ns for m in hostile}
    assert {s.reason for s in beside.statuses if s.t_ns in stamps and s.topic == hostile[0].topic} == {Reason.GATED}
    for a, b in zip(without.estimates, beside.estimates, strict=True):
        assert a.t_ns == b.t_ns
        np.testing.assert_allclose(b.nav, a.nav, rtol=0.0, atol=1e-4)  # the IMU interval is split at their stamps
        assert np.linalg.eigvalsh(b.covariance[E.P, E.P] - a.covariance[E.P, E.P]).min() > -1e-3
    assert not [r for r in beside.resets if r.t_ns >= min(stamps)]
