"""Airspeed and drag as measurements: what is refused, what is converted, which errors they carry."""

import numpy as np
import pytest

from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.air.airspeed import AirspeedConfig
from estimator.sources.air.drag import DragConfig, drag_aid, felt
from estimator.sources.air.through_air import AirVelocity
from estimator.sources.air.wind import GUST, WIND, WindConfig
from estimator.sources.base.aid import Aid, Refusal
from models.frames import Origin
from models.messages import Array, Reading, Reason

HIGH = Origin(47.0, 8.0, 2000.0)


def _made(speed: float, config: AirspeedConfig, covariance: Array | None = None) -> Aid | Refusal | None:
    return aid_of(Reading(10**9, 10**9, "/airspeed", "airspeed", (speed,), covariance), SourcesConfig(airspeed=config))


def _velocity(made: object, origin: Origin | None) -> AirVelocity:
    assert isinstance(made, Aid)
    z = made.measurement(origin)
    assert isinstance(z, AirVelocity)
    return z


@pytest.mark.parametrize(
    ("speed", "reason", "says"),
    [
        (400.0, Reason.IMPLAUSIBLE, "metres per second"),
        (-1.4, Reason.IMPLAUSIBLE, "closed"),
        (np.nan, Reason.NOT_FINITE, "airspeed"),
    ],
)
def test_what_is_no_airspeed_is_refused(speed: float, reason: Reason, says: str) -> None:
    made = _made(speed, AirspeedConfig())
    assert isinstance(made, Refusal)
    assert made.reason is reason
    assert says in made.detail


def test_an_indicated_airspeed_is_made_true_for_the_height_of_the_origin() -> None:
    indicated = _made(20.0, AirspeedConfig(indicated=True))
    assert _velocity(indicated, HIGH).z_b == pytest.approx(20.0 * 1.1029, rel=1e-3)  # standard atmosphere at 2000 m
    assert _velocity(_made(20.0, AirspeedConfig()), HIGH).z_b == pytest.approx(20.0)


def test_a_sigma_of_the_message_is_taken_and_zero_is_none() -> None:
    config = AirspeedConfig(sigma_m_s=0.7)
    assert _velocity(_made(20.0, config, np.eye(1) * 0.04), None).noise == pytest.approx(0.04)
    assert _velocity(_made(20.0, config, np.zeros((1, 1))), None).noise == pytest.approx(0.49)


def test_wind_is_estimated_gusts_are_considered_and_a_sideslip_has_a_row_of_its_own() -> None:
    made = _made(20.0, AirspeedConfig(sideslip_deg=4.0))
    assert len(_velocity(made, None).z_b) == 2
    assert isinstance(made, Aid)
    estimated = {slow.block: slow.walk is not None for slow in made.slow_errors}
    assert estimated == {"/airspeed.scale": True, "/airspeed.sideslip": False, WIND: True, GUST: False}


def test_drag_shares_the_wind_and_has_a_tilt_and_a_scale_of_its_own() -> None:
    config = DragConfig(enabled=True, momentum_1_s=0.2)
    u = np.array([[0.0, 0.0, 0.0, -1.0, 0.0, -9.8], [0.0, 0.0, 0.0, -0.6, 0.2, -9.8]])
    aid, z = felt(drag_aid(10**9, WindConfig()), u, config)
    np.testing.assert_allclose(z.velocity(z.f_b)[0], [4.0, -0.5])  # pushed back: it flies forward through the air
    assert [slow.block for slow in aid.slow_errors] == ["drag.tilt", "drag.scale", WIND, GUST]
