"""A pressure becomes a height whose zero is unknown, or a refusal with its reason."""

import math

import numpy as np
import pytest

from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.baro import BaroConfig, height_m
from estimator.sources.base.aid import Aid, Refusal
from models.measurements import Height
from models.messages import Reading, Reason

STANDARD = [(101325.0, 0.0), (89874.6, 1000.0), (54019.9, 5000.0), (26436.3, 10000.0)]  # Pa, m: ICAO standard atmosphere


def _aid(pressure_pa: float = 95_000.0, variance_pa2: float = 0.0, config: BaroConfig | None = None) -> Aid:
    reading = Reading(10**9, 2 * 10**9, "/baro", "baro", (pressure_pa,), np.array([[variance_pa2]]))
    made = aid_of(reading, SourcesConfig(baro=config or BaroConfig()))
    assert isinstance(made, Aid), made
    return made


def _height(aid: Aid) -> Height:
    z = aid.measurement(None)
    assert isinstance(z, Height)
    return z


@pytest.mark.parametrize(("pressure_pa", "height"), STANDARD)
def test_height_is_that_of_the_standard_atmosphere(pressure_pa: float, height: float) -> None:
    assert height_m(pressure_pa) == pytest.approx(height, abs=0.001 * height + 0.1)


def test_a_reading_measures_height_and_fixes_no_position() -> None:
    aid = _aid(89874.6)
    assert _height(aid).z_m == pytest.approx(1000.0, abs=1.0)
    assert not aid.absolute
    assert aid.kind == "baro"
    assert (aid.t_ns, aid.arrived_ns) == (10**9, 2 * 10**9)


@pytest.mark.parametrize("unknown", [0.0, -1.0, math.nan, math.inf])
def test_the_messages_noise_is_added_to_that_of_the_air_where_it_is_known(unknown: float) -> None:
    config = BaroConfig(sigma_m=2.0)
    assert _height(_aid(101325.0, unknown, config)).noise == pytest.approx(4.0)
    assert _height(_aid(101325.0, 100.0**2, config)).noise == pytest.approx(4.0 + 8.32**2, rel=0.01)  # 8.32 m a hectopascal


def test_its_zero_drifts_and_a_climb_is_mistaken_by_what_the_temperature_is_off() -> None:
    (slow,) = _aid(config=BaroConfig(drift_m_sqrt_s=0.2, temperature_sigma_k=20.0)).slow_errors
    assert slow.jacobian is not None
    assert slow.walk is not None
    np.testing.assert_allclose(slow.walk, [0.04, 0.0])
    climbed = np.zeros(16)
    climbed[2] = -100.0
    moved = slow.moves(climbed)
    assert moved is not None
    sigma = math.sqrt(float((moved @ slow.covariance @ moved.T)[0, 0]))
    assert sigma == pytest.approx(100.0 * 20.0 / 288.15)


@pytest.mark.parametrize(
    ("pressure_pa", "reason"),
    [
        (math.nan, Reason.NOT_FINITE),
        (math.inf, Reason.NOT_FINITE),
        (-5.0, Reason.IMPLAUSIBLE),
        (0.0, Reason.IMPLAUSIBLE),
        (500.0, Reason.IMPLAUSIBLE),
        (1e6, Reason.IMPLAUSIBLE),
    ],
)
def test_what_is_no_pressure_is_refused(pressure_pa: float, reason: Reason) -> None:
    made = aid_of(Reading(0, 0, "/baro", "baro", (pressure_pa,)), SourcesConfig())
    assert isinstance(made, Refusal)
    assert made.reason is reason


def test_equal_readings_have_one_position_and_others_another() -> None:
    assert _aid().order == _aid().order
    assert _aid().order != _aid(95_000.1).order
