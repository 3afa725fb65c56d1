"""Every optional sensor, stuck, biased, of the wrong sign, with wrong axes or late: it is said, and the estimate is consistent.

Airspeed has its own in test_air.py.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.fusion import Fusion, FusionConfig
from models.messages import ImuSample, Input, Reading, Reason
from models.sim.scenario import EPOCH_NS
from models.sim.sensors import GRADES, Imu
from models.state import E
from tests import long
from tests.estimator.scenes import Run, by_arrival, error, within
from tests.scenarios.senses import HOME, Ride, barometer, heading, magnetometer, range_down, ride, velocity_body

BEGIN_S, DARK_S, END_S = 22.0, 40.0, 65.0  # of the fault, of the dark
LATE_NS = 1_000_000_000
CONFIG = FusionConfig(imu=GRADES["hobby"].noise, origin=HOME.lla)
SENSORS: dict[str, Callable[..., list[Input]]] = {
    "heading": heading,
    "magnetometer": magnetometer,
    "velocity_body": velocity_body,
    "range": range_down,
    "baro": barometer,
}
BIASES = {"heading": math.radians(30.0), "magnetometer": 2e-5, "velocity_body": 3.0, "range": 10.0, "baro": 3000.0}
FAULTS = ("stuck", "biased", "negative", "exchanged", "late", "in feet")
SCALARS = {"range", "baro"}
NOT_SEEN = {
    ("magnetometer", "late"),
    ("range", "late"),
    ("baro", "late"),
}  # a second late, in gentle loops at a constant height: no harm is done
CASES = [
    (kind, fault)
    for kind in SENSORS
    for fault in FAULTS
    if not (fault == "exchanged" and kind in SCALARS) and (fault != "in feet" or kind == "range")
]


@pytest.fixture(scope="module")
def journey() -> Ride:
    return ride(5.0, END_S - 5.0, seed=2, imu=Imu(grade="hobby", rate_hz=50.0))


def _faulty(readings: list[Input], fault: str) -> list[Input]:
    """The readings with a fault since BEGIN_S."""
    changed: list[Input] = []
    before: tuple[float, ...] = ()
    for r in readings:
        assert isinstance(r, Reading)
        if (r.t_ns - EPOCH_NS) * 1e-9 < BEGIN_S:
            before = r.values
            changed.append(r)
            continue
        first, *others = r.values
        values = {
            "stuck": before,
            "biased": (first + BIASES[r.kind], *others),
            "negative": tuple(-v for v in r.values),
            "exchanged": (others[0], first, *others[1:]) if others else (first + math.pi / 2.0,),
            "late": r.values,
            "in feet": tuple(3.28 * v for v in r.values),
        }[fault]
        late_ns = LATE_NS if fault == "late" else 0
        changed.append(replace(r, values=values, t_ns=r.t_ns + late_ns, arrived_ns=r.arrived_ns + late_ns))
    return changed


@long.parametrize(("kind", "fault"), CASES, one_in=7)
def test_given_a_sensor_that_goes_wrong_then_that_is_said_and_the_estimate_stays_consistent(
    journey: Ride, kind: str, fault: str
) -> None:
    lit = [m for m in journey.messages if isinstance(m, ImuSample) or (m.t_ns - EPOCH_NS) * 1e-9 < DARK_S]
    readings = _faulty(SENSORS[kind](journey.truth), fault)
    run = Run(Fusion(CONFIG)).feed(by_arrival([*lit, *readings]))
    assert run.internal_errors() == []
    for begin_s, end_s in ((BEGIN_S, DARK_S), (DARK_S, END_S)):
        for part, most in ((E.P, 2.0), (E.V, 4.0), (E.THETA, 4.0)):  # of one run: 3.0 and 2.8 without a fault
            estimates = within(run.aligned, begin_s, end_s)
            off = [error(e, journey.truth)[part] for e in estimates]
            nees = [o @ np.linalg.solve(e.covariance[part, part], o) / 3.0 for o, e in zip(off, estimates, strict=True)]
            assert np.mean(nees) < most
    said = {Reason.GATED, Reason.STOPPED, Reason.HELD, Reason.IMPLAUSIBLE}
    refused = [s for s in run.statuses if s.topic == readings[0].topic and s.reason in said]
    assert len(refused) > 20 or (kind, fault) in NOT_SEEN
