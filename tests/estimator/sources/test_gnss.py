"""A GNSS message becomes a measurement of the antenna, or a refusal with its reason."""

import math
from typing import Any

import numpy as np
import pytest

from estimator.sources.base.aid import Aid, Refusal
from estimator.sources.gnss import GnssConfig, position_aid, velocity_aid
from models.frames import Origin
from models.measurements import Position, Velocity
from models.messages import Array, GnssFix, GnssVelocity, Reason, ReceiverState

HOME = Origin(47.0, 8.0, 500.0)
NOISE = np.diag([1.0, 2.0, 3.0])


def _fix(**changes: Any) -> GnssFix:
    fields: dict[str, Any] = {
        "t_ns": 10**9,
        "arrived_ns": 10**9,
        "lat_deg": 47.001,
        "lon_deg": 8.001,
        "alt_m": 510.0,
        "covariance_n": NOISE,
    }
    return GnssFix(**(fields | changes))


def _velocity(**changes: Any) -> GnssVelocity:
    fields: dict[str, Any] = {"t_ns": 10**9, "arrived_ns": 10**9, "v_n": (1.0, 2.0, 3.0), "covariance_n": NOISE}
    return GnssVelocity(**(fields | changes))


def _aid(made: Aid | Refusal) -> Aid:
    assert isinstance(made, Aid), made
    return made


def test_a_fix_measures_the_antenna_in_n() -> None:
    z = _aid(position_aid(_fix(), GnssConfig(antenna_b_m=(0.1, 0.2, 0.3)))).measurement(HOME)
    assert isinstance(z, Position)
    np.testing.assert_allclose(z.z_n, HOME.to_ned(47.001, 8.001, 510.0))
    np.testing.assert_array_equal(z.noise, NOISE)
    np.testing.assert_array_equal(z.lever_b, [0.1, 0.2, 0.3])
    assert 110.0 < z.z_n[0] < 112.0
    assert 75.0 < z.z_n[1] < 77.0


def test_without_origin_there_is_no_measurement() -> None:
    aid = _aid(position_aid(_fix(), GnssConfig()))
    assert aid.measurement(None) is None
    assert aid.geodetic == (47.001, 8.001, 510.0)
    assert aid.absolute


def test_a_velocity_needs_no_origin_and_fixes_no_position() -> None:
    aid = _aid(velocity_aid(_velocity(), GnssConfig(antenna_b_m=(0.1, 0.2, 0.3))))
    z = aid.measurement(None)
    assert isinstance(z, Velocity)
    np.testing.assert_array_equal(z.z_n, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(z.lever_b, [0.1, 0.2, 0.3])
    assert not aid.absolute


def test_stamps_that_are_late_are_set_right() -> None:
    config = GnssConfig(delay_s=0.12)
    for aid in (_aid(position_aid(_fix(), config)), _aid(velocity_aid(_velocity(), config))):
        assert aid.t_ns == 10**9 - 120_000_000
        assert aid.order[0] == aid.t_ns
        assert aid.arrived_ns == 10**9


def test_where_the_receiver_gives_no_covariance_the_configured_one_holds() -> None:
    config = GnssConfig(horizontal_sigma_m=2.0, vertical_sigma_m=4.0, velocity_sigma_m_s=0.5)
    z = _aid(position_aid(_fix(covariance_n=None), config)).measurement(HOME)
    v = _aid(velocity_aid(_velocity(covariance_n=None), config)).measurement(HOME)
    assert z is not None
    assert v is not None
    np.testing.assert_array_equal(z.noise, np.diag([4.0, 4.0, 16.0]))
    np.testing.assert_array_equal(v.noise, np.eye(3) * 0.25)


def test_the_slow_error_is_considered_unless_there_is_none() -> None:
    (slow,) = _aid(position_aid(_fix(), GnssConfig(slow_sigma_m=0.5, slow_s=60.0))).slow_errors
    np.testing.assert_allclose(slow.covariance, np.diag([0.25, 0.25, 1.0]))
    assert slow.tau_s == 60.0
    assert _aid(position_aid(_fix(), GnssConfig(slow_sigma_m=0.0))).slow_errors == ()


def test_the_velocity_has_a_slow_error_of_its_own() -> None:
    (slow,) = _aid(velocity_aid(_velocity(), GnssConfig(velocity_slow_sigma_m_s=0.1, velocity_slow_s=20.0))).slow_errors
    np.testing.assert_allclose(slow.covariance, np.diag([0.01, 0.01, 0.04]))
    assert slow.tau_s == 20.0
    (position,) = _aid(position_aid(_fix(), GnssConfig())).slow_errors
    assert position.block != slow.block
    assert _aid(velocity_aid(_velocity(), GnssConfig(velocity_slow_sigma_m_s=0.0))).slow_errors == ()


def test_velocities_may_be_older_than_positions_of_the_same_stamp() -> None:
    fix, velocity, config = _fix(), _velocity(), GnssConfig(delay_s=-0.075, velocity_delay_s=0.125)
    assert _aid(position_aid(fix, config)).t_ns == fix.t_ns + 75_000_000
    aid = _aid(velocity_aid(velocity, config))
    assert aid.t_ns == velocity.t_ns - 50_000_000 == aid.order[0]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"status": -1}, Reason.NO_FIX),
        ({"lat_deg": 0.0, "lon_deg": 0.0}, Reason.NO_FIX),
        ({"lat_deg": math.nan}, Reason.NOT_FINITE),
        ({"alt_m": math.inf}, Reason.NOT_FINITE),
        ({"lat_deg": 90.1}, Reason.IMPLAUSIBLE),
        ({"lon_deg": -180.1}, Reason.IMPLAUSIBLE),
        ({"lat_deg": 470_010_000.0}, Reason.IMPLAUSIBLE),
        ({"alt_m": 1e308}, Reason.IMPLAUSIBLE),
        ({"covariance_n": np.diag([1.0, -1.0, 1.0])}, Reason.NOT_PSD),
        ({"covariance_n": np.array([[0.0, 0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 1.0]])}, Reason.NOT_PSD),
        ({"covariance_n": np.full((3, 3), math.nan)}, Reason.NOT_FINITE),
    ],
)
def test_an_unusable_fix_has_its_reason(changes: dict[str, Any], reason: Reason) -> None:
    refusal = position_aid(_fix(**changes), GnssConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is reason


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"v_n": (math.nan, 0.0, 0.0)}, Reason.NOT_FINITE),
        ({"v_n": (0.0, -math.inf, 0.0)}, Reason.NOT_FINITE),
        ({"v_n": (1e150, 1e150, 0.0)}, Reason.IMPLAUSIBLE),
        ({"v_n": (501.0, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"covariance_n": -np.eye(3)}, Reason.NOT_PSD),
    ],
)
def test_an_unusable_velocity_has_its_reason(changes: dict[str, Any], reason: Reason) -> None:
    refusal = velocity_aid(_velocity(**changes), GnssConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is reason


@pytest.mark.parametrize(
    ("given", "taken"),
    [
        (None, [2.0, 2.0, 5.0]),
        (np.zeros((3, 3)), [2.0, 2.0, 5.0]),
        (np.diag([0.0, 0.0, 0.49]), [2.0, 2.0, 0.7]),
        (np.diag([0.25, 0.25, 0.0]), [0.5, 0.5, 5.0]),
    ],
)
def test_an_accuracy_of_zero_is_unknown(given: Array | None, taken: list[float]) -> None:
    config = GnssConfig(horizontal_sigma_m=2.0, vertical_sigma_m=5.0)
    aid = _aid(position_aid(_fix(covariance_n=given), config))
    z = aid.measurement(HOME)
    assert isinstance(z, Position)
    np.testing.assert_allclose(z.noise, np.diag(np.square(taken)))
    assert "horizontal_sigma_m 2, vertical_sigma_m 5" in aid.assumed
    assert not _aid(position_aid(_fix(), config)).assumed


@pytest.mark.parametrize("given", [None, np.zeros((3, 3))])
def test_an_accuracy_of_zero_of_a_velocity_is_unknown(given: Array | None) -> None:
    aid = _aid(velocity_aid(_velocity(covariance_n=given), GnssConfig(velocity_sigma_m_s=0.4)))
    z = aid.measurement(None)
    assert isinstance(z, Velocity)
    np.testing.assert_allclose(z.noise, np.eye(3) * 0.4**2)
    assert "velocity_sigma_m_s 0.4" in aid.assumed


def test_another_reading_of_one_instant_has_another_position() -> None:
    one, two = _aid(position_aid(_fix(), GnssConfig())), _aid(position_aid(_fix(alt_m=510.1), GnssConfig()))
    other_noise = _aid(position_aid(_fix(covariance_n=2.0 * NOISE), GnssConfig()))
    again = _aid(position_aid(_fix(arrived_ns=2 * 10**9), GnssConfig()))
    assert one.order == again.order
    assert len({one.order, two.order, other_noise.order}) == 3


def test_a_receiver_that_reports_spoofing_is_not_followed() -> None:
    aid = _aid(position_aid(_fix(state=ReceiverState.SPOOFED), GnssConfig()))
    assert aid.check is not None
    assert aid.check(HOME) == Refusal(Reason.STOPPED, "the receiver reports spoofing")
    assert aid.geodetic is None


def test_a_receiver_that_reports_jamming_is_as_likely_false_as_not() -> None:
    plain, jammed = (_aid(position_aid(_fix(state=s), GnssConfig())) for s in (ReceiverState.UNKNOWN, ReceiverState.JAMMED))
    assert jammed.log_false - plain.log_false == pytest.approx(math.log(0.5 / 0.01))
    assert (plain.detail, jammed.detail) == ("", "the receiver reports jamming")
