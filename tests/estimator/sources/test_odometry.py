"""Increments and poses of an odometry: what they measure, their noise, why they are refused, and what a contradiction changes."""

import math

import msgspec
import numpy as np
import pytest

from estimator.sources import odometry
from estimator.sources.aids import SourcesConfig, aid_of
from estimator.sources.base.aid import Refusal
from estimator.sources.base.learnt_noise import LearntNoise
from estimator.sources.base.machine import Phase, SourceState
from estimator.sources.base.rules import RULES
from estimator.sources.odometry import Increment, Kept, OdometryAid, OdometryConfig, Posed
from models.messages import OdometryDelta, OdometryPose, Reason

SECOND = 10**9
T0, T1 = 100 * SECOND, 100 * SECOND + SECOND // 2
LEVEL = (1.0, 0.0, 0.0, 0.0)
DELTA = OdometryDelta(T1, T1, T0, (2.0, 0.0, 0.0), LEVEL, np.diag([0.02**2] * 3 + [0.002**2] * 3))
_RULES = RULES["odometry"]
PLAIN = OdometryConfig(position_sigma_m=0.005, attitude_sigma_deg=0.05, position_share=0.01, lasting_share=0.01, scale_sigma=0.02)


def _made(message: OdometryDelta | OdometryPose, config: OdometryConfig = PLAIN) -> OdometryAid | Refusal:
    aid = aid_of(message, SourcesConfig(odometry=config))
    assert isinstance(aid, OdometryAid | Refusal)
    return aid


def _aid(message: OdometryDelta | OdometryPose, config: OdometryConfig = PLAIN) -> OdometryAid:
    aid = _made(message, config)
    assert isinstance(aid, OdometryAid), aid
    return aid


def _noise(delta: OdometryDelta, config: OdometryConfig = PLAIN) -> np.ndarray:
    end = _aid(delta, config).motion
    assert isinstance(end, Increment)
    return end.z.noise


def test_an_increment_takes_two_positions_and_only_its_end_is_reported() -> None:
    end = _aid(DELTA)
    begin = end.begin
    assert begin is not None
    assert (begin.t_ns, end.t_ns) == (T0, T1)
    assert (begin.is_reported, end.is_reported) == (False, True)
    assert not end.absolute
    assert end.order < (T1, *begin.order[1:])  # where one ends and the next begins, the end comes first


def test_a_delay_moves_both_ends() -> None:
    end = _aid(DELTA, OdometryConfig(delay_s=0.05))
    assert end.begin is not None
    assert (end.begin.t_ns, end.t_ns) == (T0 - SECOND // 20, T1 - SECOND // 20)


def test_its_own_noise_has_a_floor_and_where_it_gives_none_a_share_of_the_length_counts() -> None:
    floor = math.radians(0.05) ** 2
    np.testing.assert_allclose(np.diag(_noise(DELTA)), [0.02**2 + 0.005**2] * 3 + [0.002**2 + floor] * 3)
    scaled = _noise(DELTA, msgspec.structs.replace(PLAIN, noise_scale=2.0))
    np.testing.assert_allclose(scaled[0, 0], 4 * 0.02**2 + 0.005**2)
    silent = msgspec.structs.replace(DELTA, covariance=np.zeros((6, 6)))
    np.testing.assert_allclose(np.diag(_noise(silent))[0], 0.02**2 + 2 * 0.005**2)


def test_components_that_are_not_given_have_no_row() -> None:
    covariance = np.diag([0.01, 1e6, math.nan, -1.0, 20.0, 0.001])
    end = _aid(msgspec.structs.replace(DELTA, covariance=covariance)).motion
    assert isinstance(end, Increment)
    assert end.z.rows.tolist() == [0, 5]
    assert end.z.noise.shape == (2, 2)


def test_it_carries_a_lasting_error_that_is_considered_and_a_scale_that_is_estimated() -> None:
    lasting, scale = _aid(DELTA).slow_errors
    assert lasting.walk is None
    assert lasting.tau_s == 5.0
    np.testing.assert_allclose(np.diag(np.asarray(lasting.jacobian)), [0.02] * 3 + [0.0] * 3)
    assert scale.walk is not None
    assert scale.starts_at_zero
    np.testing.assert_allclose(np.asarray(scale.jacobian)[:, 0], [2.0, 0, 0, 0, 0, 0])
    assert math.sqrt(scale.covariance[0, 0]) == pytest.approx(0.02)


CAMERAS = msgspec.structs.replace(DELTA, systematic=np.zeros((6, 2)))


def _widened(spread_m: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """White and lasting covariance of an increment of cameras."""
    aid = _aid(CAMERAS)
    end = aid.motion
    assert isinstance(end, Increment)
    assert end.reported is not None
    aid, z, spread_m = odometry.widened(aid, end.z, end.reported, spread_m)
    J = np.asarray(aid.slow_errors[0].jacobian)
    return z.noise, J @ J.T, spread_m


def test_an_increment_is_no_more_certain_than_those_before_and_far_apart_ones_err_for_longer() -> None:
    """Of a scene that moves slowly some steps show that they are uncertain, and all are wrong."""
    own_m, share = 0.02 * math.sqrt(3.0), [0.02**2] * 3 + [0.0] * 3
    noise, lasting, spread_m = _widened((math.inf, 0.0))
    np.testing.assert_allclose(noise, _noise(CAMERAS))
    np.testing.assert_allclose(np.diag(lasting), share, atol=1e-12)
    assert spread_m == pytest.approx((own_m, own_m))
    noise, lasting, spread_m = _widened((own_m, 2.0 * own_m))
    np.testing.assert_allclose(noise, 4.0 * _noise(CAMERAS))
    np.testing.assert_allclose(np.diag(lasting), share, atol=1e-12)
    noise, lasting, spread_m = _widened((own_m, 4.0 * own_m))
    np.testing.assert_allclose(noise, 16.0 * _noise(CAMERAS))
    np.testing.assert_allclose(np.diag(lasting), share + 16.0 * CAMERAS.covariance.diagonal(), atol=1e-12)
    assert spread_m == pytest.approx((own_m, 4.0 * own_m))


def test_what_was_uncertain_is_forgotten() -> None:
    state = SourceState(last_ns=T0, spread_m=(0.1, 0.4))
    assert odometry.spread_at(state, T0 + 10 * SECOND) == pytest.approx((0.1 * math.e, 0.4 / math.e))
    assert odometry.spread_at(state, T0 + 10**5 * SECOND) == (math.inf, 0.0)
    assert odometry.spread_at(SourceState(), T0) == (math.inf, 0.0)


def test_flow_wheels_and_increments_without_a_covariance_do_not_remember() -> None:
    flat = np.diag([0.01, 0.01, -1.0, -1.0, -1.0, -1.0])
    for delta in (
        DELTA,
        msgspec.structs.replace(CAMERAS, covariance=flat),
        msgspec.structs.replace(CAMERAS, covariance=np.zeros((6, 6))),
    ):
        end = _aid(delta).motion
        assert isinstance(end, Increment)
        assert end.reported is None


def test_keys_of_competing_sources_are_none_of_odometry() -> None:
    assert "spacing_s" not in OdometryConfig.__struct_fields__


def test_a_rig_that_reports_how_it_errs_takes_the_place_of_the_scale() -> None:
    moved = np.arange(12.0).reshape(6, 2)
    _, rig = _aid(msgspec.structs.replace(DELTA, systematic=moved)).slow_errors
    np.testing.assert_array_equal(np.asarray(rig.jacobian), moved)
    np.testing.assert_array_equal(rig.covariance, np.eye(2))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"dp_b": (math.nan, 0.0, 0.0)}, Reason.NOT_FINITE),
        ({"dq_wxyz": (0.0, 0.0, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"dp_b": (1e3, 0.0, 0.0)}, Reason.IMPLAUSIBLE),  # 2 km/s
        ({"t0_ns": T1 + 1}, Reason.UNSUPPORTED),
        ({"t0_ns": T1}, Reason.UNSUPPORTED),
        ({"t0_ns": T1 - 10 * SECOND}, Reason.UNSUPPORTED),
        ({"covariance": np.eye(3)}, Reason.MALFORMED),
        ({"covariance": np.full((6, 6), math.nan)}, Reason.UNSUPPORTED),
        ({"covariance": np.eye(6) + 5.0 * np.eye(6)[::-1]}, Reason.NOT_PSD),
        ({"systematic": np.zeros((3, 1))}, Reason.MALFORMED),
        ({"systematic": np.full((6, 1), math.inf)}, Reason.MALFORMED),
    ],
)
def test_bad_increments_get_their_reason(change: dict[str, object], reason: Reason) -> None:
    made = _made(msgspec.structs.replace(DELTA, **change))
    assert isinstance(made, Refusal)
    assert made.reason is reason


@pytest.mark.parametrize(
    ("p", "q", "reason"),
    [((0.0, math.inf, 0.0), LEVEL, Reason.NOT_FINITE), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.5), Reason.IMPLAUSIBLE)],
)
def test_bad_poses_get_their_reason(p: tuple[float, float, float], q: tuple[float, ...], reason: Reason) -> None:
    made = _made(OdometryPose(T1, T1, p, (q[0], q[1], q[2], q[3])))
    assert isinstance(made, Refusal)
    assert made.reason is reason


def test_wheels_give_the_rows_that_they_measure() -> None:
    at = _aid(OdometryPose(T1, T1, (1.0, 0.0, 0.0), LEVEL), OdometryConfig(rows=("x", "y", "yaw"))).motion
    assert isinstance(at, Posed)
    z, _ = at.since(np.array([0.0, 0, 0, 1, 0, 0, 0]))
    assert z.rows.tolist() == [0, 1, 5]
    np.testing.assert_allclose(z.dp_b, [1.0, 0.0, 0.0])


def test_a_jump_leaves_the_line_by_more_than_a_vehicle_can() -> None:
    before = np.array([0.0, 0, 0, 1, 0, 0, 0])
    kept = Kept(T0, T0, b"", "odom", before, (T0, before, np.array([10.0, 0.0, 0.0])))
    step = SECOND // 20
    straight, velocity = odometry.jumped(kept, T0 + step, before + np.array([0.5, 0, 0, 0, 0, 0, 0]))
    assert straight == 0.0
    assert velocity == pytest.approx([10.0, 0.0, 0.0])
    off, _ = odometry.jumped(kept, T0 + step, before + np.array([0.5, 0.4, 0, 0, 0, 0, 0]))
    assert off == pytest.approx(0.4)


def _is_found(off: float, times: int) -> bool:
    state, found = SourceState(), False
    for k in range(times):
        state = odometry.arrived(state, _RULES, T0 + k * SECOND // 2, alone=True)
        state, is_found = odometry.judged(state, alone=True, passed=off < 5.0, off=np.array([off, 0.0]))
        found = found or is_found
    return found


def test_one_outlier_is_no_contradiction_and_many_alike_are() -> None:
    assert not _is_found(100.0, 1)
    assert not _is_found(0.9, 50)
    assert _is_found(2.5, 7)
    assert _is_found(100.0, 6)


def test_a_drift_is_one_of_the_velocity_in_n() -> None:
    """A body that has turned to the east (yaw 90 degrees) sees a drift to the north on its left."""
    aid, north = _aid(DELTA), np.array([1.0, 0.0, 0.0])
    *_, drift = odometry.drifting(aid, np.array([0.0, 0, 0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)]), 0.5).slow_errors
    assert drift.block == f"{aid.topic}.drift"
    np.testing.assert_allclose(np.asarray(drift.jacobian) @ north, [0.0, -0.5, 0, 0, 0, 0], atol=1e-12)


def test_given_a_refuted_odometry_then_it_is_used_again_after_ten_seconds_of_increments_that_pass() -> None:
    state = SourceState(last_ns=0, silent_ns=SECOND).refuted(0)
    active = []
    for k in range(1, 40):
        state = odometry.arrived(state, _RULES, k * SECOND // 2, alone=False)
        state, _ = odometry.judged(state, alone=False, passed=True, off=np.zeros(3))
        active.append(state.phase is Phase.ACTIVE)
    assert active.index(True) == 20


def test_given_translations_that_are_no_noise_then_the_scale_may_be_wrong_once_unless_rotations_are_none_either() -> None:
    wrong, turned = LearntNoise(b=(100.0, 1.0)), LearntNoise(b=(100.0, 100.0))
    assert odometry.may_be_scale(SourceState(noise=wrong), alone=False)
    assert not odometry.may_be_scale(SourceState(noise=wrong), alone=True)
    assert not odometry.may_be_scale(SourceState(noise=wrong._replace(is_renewed=True)), alone=False)
    assert not odometry.may_be_scale(SourceState(noise=turned), alone=False)
    assert not odometry.may_be_scale(SourceState(), alone=False)
    assert odometry.may_be_scale(SourceState().refuted(0), alone=False)
