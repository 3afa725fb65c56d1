"""A magnetic field becomes a heading, or a refusal that names what to set."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.magnetometer import MagnetometerConfig
from models import so3
from models.earth_field import field_n, year_of
from models.measurements import Heading
from models.messages import Array, Reading, Reason
from models.sim.scenario import EPOCH_NS
from models.state import X
from tests.scenarios.senses import HOME

FIELD_N = np.array(field_n(HOME, round(year_of(EPOCH_NS), 1)))


def _aid(field_b: Array, config: MagnetometerConfig | None = None) -> Aid | Refusal | None:
    reading = Reading(EPOCH_NS, EPOCH_NS, "/mag", "magnetometer", tuple(field_b.tolist()))
    return aid_of(reading, SourcesConfig(magnetometer=config or MagnetometerConfig()))


def _heading(field_b: Array, config: MagnetometerConfig | None = None) -> Heading | Refusal | None:
    aid = _aid(field_b, config)
    assert isinstance(aid, Aid), aid
    assert aid.check is not None
    z = aid.check(HOME) or aid.measurement(HOME)
    assert isinstance(z, Heading | Refusal)
    return z


def _state(yaw: float, pitch: float = 0.0) -> Array:
    x = np.zeros(X.SIZE)
    x[X.Q] = so3.from_euler(0.1, pitch, yaw)
    return x


@pytest.mark.parametrize("yaw", [-3.0, 0.0, 1.2])
def test_the_true_attitude_has_no_innovation_at_any_tilt(yaw: float) -> None:
    x = _state(yaw, 0.4)
    z = _heading(so3.matrix(x[X.Q]).T @ FIELD_N)
    assert isinstance(z, Heading)
    nu, _ = z.evaluate(x, np.zeros(3))
    assert abs(nu[0]) < 1e-9
    assert z.objection(x) == ""
    assert abs(z.evaluate(_state(yaw + 0.3, 0.4), np.zeros(3))[0][0] + 0.3) < 1e-9


def test_calibration_and_mounting_are_taken_out() -> None:
    x, offset, scale, mounted = _state(0.5), np.array([40.0, -16.0, 39.0]), np.array([0.9, 1.1, 1.2]), (0.0, 0.0, 90.0)
    in_sensor = so3.matrix(so3.from_euler(0.0, 0.0, math.pi / 2)).T @ so3.matrix(x[X.Q]).T @ FIELD_N
    read = in_sensor / scale + 1e-6 * offset
    config = MagnetometerConfig(offset_ut=(40.0, -16.0, 39.0), scale=(0.9, 1.1, 1.2), mounting_rpy_deg=mounted)
    z = _heading(read, config)
    assert isinstance(z, Heading)
    assert abs(z.evaluate(x, np.zeros(3))[0][0]) < 1e-9


@pytest.mark.parametrize(
    ("factor", "reason", "says"),
    [(1e4, Reason.IMPLAUSIBLE, "tesla"), (1e-3, Reason.IMPLAUSIBLE, "tesla"), (math.nan, Reason.NOT_FINITE, "magnetometer")],
)
def test_gauss_nanotesla_or_no_number_is_refused(factor: float, reason: Reason, says: str) -> None:
    made = _aid(FIELD_N * factor)
    assert isinstance(made, Refusal)
    assert made.reason is reason
    assert says in made.detail


def test_a_field_of_another_strength_is_refused_with_the_key_to_set() -> None:
    z = _heading(FIELD_N * 1.5)
    assert isinstance(z, Refusal)
    assert "offset_ut" in z.detail
    assert isinstance(_heading(FIELD_N * 1.5, MagnetometerConfig(strength_within=0.6)), Heading)


def test_a_field_of_another_inclination_meets_an_objection() -> None:
    z = _heading(np.array([FIELD_N[0], FIELD_N[1], -FIELD_N[2]]))  # axes up
    assert isinstance(z, Heading)
    assert "63 deg above the horizon, -63 expected" in z.objection(_level())


def _level() -> Array:
    x = np.zeros(X.SIZE)
    x[X.Q] = (1.0, 0.0, 0.0, 0.0)
    return x


def test_without_an_origin_the_declination_has_to_be_given() -> None:
    aid = _aid(FIELD_N)
    assert isinstance(aid, Aid)
    assert aid.measurement(None) is None
    given = _aid(FIELD_N, MagnetometerConfig(declination_deg=3.0))
    assert isinstance(given, Aid)
    z = given.measurement(None)
    assert isinstance(z, Heading)
    assert z.azimuth == pytest.approx(math.radians(3.0))


def test_what_repeats_is_hard_iron_along_the_body_and_an_angle() -> None:
    aid = _aid(FIELD_N, MagnetometerConfig(hard_iron_sigma_ut=2.0, slow_sigma_deg=4.0))
    assert isinstance(aid, Aid)
    iron, place = aid.slow_errors
    moved = iron.moves(_level())
    assert moved is not None
    by_iron = math.sqrt(float((moved @ iron.covariance @ moved.T)[0, 0]))
    assert by_iron == pytest.approx(2e-6 / math.hypot(*FIELD_N[:2]), rel=1e-6)
    assert math.degrees(math.sqrt(place.covariance[0, 0])) == pytest.approx(4.0)
    assert not aid.weighs
    bare = _aid(FIELD_N, replace(MagnetometerConfig(), hard_iron_sigma_ut=0.0, slow_sigma_deg=0.0))
    assert isinstance(bare, Aid)
    assert bare.slow_errors == ()
