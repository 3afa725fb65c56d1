"""The azimuth of two antennas becomes a heading, or a refusal."""

import math

import numpy as np
import pytest

from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.heading import HeadingConfig
from models import so3
from models.measurements import Heading
from models.messages import Array, Reading, Reason
from models.state import X


def _made(azimuth: float, covariance: Array | None = None, config: HeadingConfig | None = None) -> Aid | Refusal | None:
    reading = Reading(10**9, 2 * 10**9, "/heading", "heading", (azimuth,), covariance)
    return aid_of(reading, SourcesConfig(heading=config or HeadingConfig()))


def test_a_baseline_across_the_vehicle_points_to_the_right_of_its_nose() -> None:
    aid = _made(math.radians(120.0), config=HeadingConfig(baseline_b_m=(0.0, 0.8, 0.0), delay_s=0.2))
    assert isinstance(aid, Aid)
    assert aid.t_ns == 800_000_000
    z, x = aid.measurement(None), np.zeros(X.SIZE)
    x[X.Q] = so3.from_euler(0.0, 0.2, math.radians(30.0))
    assert isinstance(z, Heading)
    assert abs(z.evaluate(x, np.zeros(3))[0][0]) < 1e-9


def test_the_receivers_accuracy_is_taken_where_there_is_one() -> None:
    given, unknown = _made(0.1, np.eye(1) * 4e-4), _made(0.1)
    assert isinstance(given, Aid)
    assert isinstance(unknown, Aid)
    z, assumed = given.measurement(None), unknown.measurement(None)
    assert isinstance(z, Heading)
    assert isinstance(assumed, Heading)
    assert (z.noise[0, 0], given.assumed) == (4e-4, "")
    assert math.degrees(math.sqrt(assumed.noise[0, 0])) == pytest.approx(1.0)
    assert "sigma_deg" in unknown.assumed


@pytest.mark.parametrize(
    ("azimuth", "config", "reason"),
    [
        (90.0, HeadingConfig(), Reason.IMPLAUSIBLE),
        (math.nan, HeadingConfig(), Reason.NOT_FINITE),
        (1.0, HeadingConfig(baseline_b_m=(0.0, 0.0, 0.0)), Reason.UNSUPPORTED),
    ],
)
def test_degrees_no_number_and_no_baseline_are_refused(azimuth: float, config: HeadingConfig, reason: Reason) -> None:
    made = _made(azimuth, config=config)
    assert isinstance(made, Refusal)
    assert made.reason is reason
