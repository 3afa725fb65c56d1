"""A pose fix becomes a measurement of what it gives: attitude as a whole, roll and pitch, yaw, or nothing of it."""

import math
from typing import Any

import numpy as np
import pytest

from estimator.sources.base.aid import Aid, Refusal, SlowError
from estimator.sources.landmark import landmark_aid
from estimator.sources.pose import LandmarkFixConfig, PoseConfig, given_components, pose_aid
from models import so3
from models.measurements import Pose
from models.messages import Array, LandmarkFix, PoseFix, Quat, Reason
from models.state import X

Q: Quat = tuple(so3.from_euler(0.1, 0.2, 0.3).tolist())
LEVEL = np.eye(X.SIZE)[X.Q.start]
GIVEN = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])


def _fix(**changes: Any) -> PoseFix:
    fields: dict[str, Any] = {"t_ns": 10**9, "arrived_ns": 10**9, "p_n": (1.0, 2.0, 3.0), "q_nb_wxyz": Q, "covariance": GIVEN}
    return PoseFix(**(fields | changes))


def _without(rows: list[int], variance: float) -> Array:
    cov = GIVEN.copy()
    cov[rows, rows] = variance
    return cov


def _aid(fix: PoseFix | LandmarkFix, config: PoseConfig | None = None) -> Aid:
    made = pose_aid(fix, config or PoseConfig())
    assert isinstance(made, Aid), made
    return made


def _measurement(fix: PoseFix, config: PoseConfig | None = None) -> Pose:
    z = _aid(fix, config).measurement(None)
    assert isinstance(z, Pose)
    return z


@pytest.mark.parametrize("not_given", [9e4, 1e9, math.nan, -1.0, math.inf])
@pytest.mark.parametrize(
    ("missing", "attitude"),
    [
        ([], "full"),
        ([5], "tilt"),
        ([3, 4], "yaw"),
        ([3, 4, 5], "none"),
        ([0, 1], "full"),
        ([2, 3, 4, 5], "none"),
        ([0, 1, 2, 5], "tilt"),
    ],
)
def test_components_that_are_not_given_go(missing: list[int], attitude: str, not_given: float) -> None:
    z = _measurement(_fix(covariance=_without(missing, not_given)))
    rows = [k for k in range(6) if k not in missing]
    assert z.rows.tolist() == rows
    assert z.attitude == attitude
    np.testing.assert_array_equal(z.noise, GIVEN[np.ix_(rows, rows)])


@pytest.mark.parametrize(("variance", "limit"), [(89_999.0, True), (90_000.0, False)])
def test_the_limit_of_a_position_that_is_given(variance: float, limit: bool) -> None:
    assert bool(given_components(_without([1], variance)).mask[1]) is limit


@pytest.mark.parametrize(("variance", "limit"), [(9.99, True), (10.0, False)])
def test_the_limit_of_an_attitude_that_is_given(variance: float, limit: bool) -> None:
    assert bool(given_components(_without([4], variance)).mask[4]) is limit


@pytest.mark.parametrize("missing", [[3], [4], [3, 5], [4, 5], [0, 1, 2, 3, 4, 5]])
def test_other_combinations_are_not_supported(missing: list[int]) -> None:
    refusal = pose_aid(_fix(covariance=_without(missing, 1e9)), PoseConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is Reason.UNSUPPORTED


def test_a_fix_is_absolute_if_it_gives_the_whole_position() -> None:
    assert _aid(_fix()).absolute
    assert _aid(_fix(covariance=_without([3, 4, 5], 1e9))).absolute
    assert not _aid(_fix(covariance=_without([2], 1e9))).absolute


def test_what_is_not_given_may_be_anything() -> None:
    z = _measurement(_fix(p_n=(1.0, 2.0, math.nan), covariance=_without([2], math.nan)))
    np.testing.assert_array_equal(z.z_n[:2], [1.0, 2.0])
    z = _measurement(_fix(q_nb_wxyz=(math.nan,) * 4, covariance=_without([3, 4, 5], math.nan)))
    assert np.isfinite(z.q_nb_wxyz).all()
    assert _measurement(_fix(q_nb_wxyz=(0.0,) * 4, covariance=_without([3, 4, 5], 1e9))).attitude == "none"


def test_noise_scale_multiplies_sigma() -> None:
    np.testing.assert_allclose(_measurement(_fix(), PoseConfig(noise_scale=2.0)).noise, 4.0 * GIVEN)


def test_a_quaternion_that_is_nearly_of_length_one_is_made_so() -> None:
    q = 1.005 * np.array(Q)
    z = _measurement(_fix(q_nb_wxyz=tuple(q)))
    np.testing.assert_allclose(z.q_nb_wxyz, Q, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"covariance": _without([2], 0.0) + 0.05 * (np.eye(6)[[2, 1, 0, 3, 4, 5]] - np.eye(6)).clip(0)}, Reason.NOT_PSD),
        ({"covariance": GIVEN + 0.2 * np.eye(6)[[1, 0, 2, 3, 4, 5]]}, Reason.NOT_PSD),
        ({"covariance": np.eye(3)}, Reason.MALFORMED),
        ({"covariance": np.full((6, 6), math.nan)}, Reason.UNSUPPORTED),
        ({"p_n": (math.nan, 0.0, 0.0)}, Reason.NOT_FINITE),
        ({"p_n": (0.0, 0.0, math.inf)}, Reason.NOT_FINITE),
        ({"p_n": (1e308, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"p_n": (2e6, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"q_nb_wxyz": (0.0, 0.0, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"q_nb_wxyz": (1.0, 1.0, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"q_nb_wxyz": (1e150, 1e150, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"q_nb_wxyz": (math.nan, 0.0, 0.0, 0.0)}, Reason.NOT_FINITE),
        ({"covariance_common": np.eye(3)}, Reason.NOT_PSD),
        ({"covariance_common": -np.eye(6)}, Reason.NOT_PSD),
        ({"covariance_common": np.full((6, 6), math.inf)}, Reason.NOT_PSD),
        ({"covariance_common": np.diag([0.0, 0.0, 1e150, 0.0, 0.0, 0.0])}, Reason.IMPLAUSIBLE),
        ({"covariance_common": np.diag([0.0, 0.0, 0.0, 0.0, 11.0, 0.0])}, Reason.IMPLAUSIBLE),
    ],
)
def test_an_unusable_fix_has_its_reason(changes: dict[str, Any], reason: Reason) -> None:
    refusal = pose_aid(_fix(**changes), PoseConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is reason


def test_the_common_part_is_considered_under_the_topics_name() -> None:
    common = np.eye(6) * 0.04
    (slow,) = _aid(_fix(covariance_common=common, topic="/tower")).slow_errors
    assert slow.block == "/tower"
    np.testing.assert_allclose(_covariance(slow), common, atol=1e-15)
    assert slow.tau_s > 1e6
    assert _aid(_fix(covariance_common=np.zeros((6, 6)))).slow_errors == ()


def test_a_frame_that_does_not_say_how_level_it_is_leans_about_both_horizontal_axes() -> None:
    (slow,) = _aid(_fix(), PoseConfig(tilt_deg=0.5, mount_deg=0.0)).slow_errors
    assert slow.block == "/pose_fix.tilt"  # not that of a common error that a fix reports: it has other states
    moved = slow.moves(LEVEL)
    assert moved is not None
    lean = math.radians(0.5) ** 2
    np.testing.assert_allclose(moved @ slow.covariance @ moved.T, np.diag([0.0, 0.0, 0.0, lean, lean, 0.0]), atol=1e-15)
    assert _aid(_fix(), PoseConfig(tilt_deg=0.0, mount_deg=0.0)).slow_errors == ()


def test_axes_of_fixes_that_do_not_say_how_they_are_mounted_are_turned_against_the_imus() -> None:
    """All that is given of the attitude, and the same on the body wherever it turns."""
    (slow,) = _aid(_fix(), PoseConfig(tilt_deg=0.0, mount_deg=0.5)).slow_errors
    assert slow.block == "/pose_fix.mount"
    moved = slow.moves(LEVEL)
    assert moved is not None
    np.testing.assert_allclose(moved, np.vstack((np.zeros((3, 3)), np.eye(3) * math.radians(0.5))), atol=1e-15)
    turned = LEVEL.copy()
    turned[X.Q] = so3.quat_exp(np.array([0.3, -0.2, 1.1]))
    with_it = slow.moves(turned)
    assert with_it is not None
    np.testing.assert_allclose(with_it[3:], so3.matrix(turned[X.Q]) @ moved[3:], atol=1e-15)


def test_positions_alone_have_no_axes() -> None:
    position = _fix(covariance=_without([3, 4, 5], 1e6))
    assert _aid(position, PoseConfig(tilt_deg=0.5, mount_deg=0.5)).slow_errors == ()
    assert len(_aid(_fix(), PoseConfig(tilt_deg=0.5, mount_deg=0.5)).slow_errors) == 2


def test_a_common_part_of_what_is_not_given_is_left_out() -> None:
    common = np.diag([0.04, 0.04, 1e150, 0.01, 0.01, 0.01])
    (slow,) = _aid(_fix(covariance=_without([2], 1e9), covariance_common=common)).slow_errors
    np.testing.assert_allclose(_covariance(slow), np.diag([0.04, 0.04, 0.0, 0.01, 0.01, 0.01]), atol=1e-15)


def _covariance(slow: SlowError, x: Array | None = None) -> Array:
    """The covariance of the pose that a slow error makes at state x."""
    moved = slow.moves(LEVEL if x is None else x)
    assert moved is not None
    return moved @ slow.covariance @ moved.T


def test_a_common_part_that_grows_with_height_is_reported_each_time_anew() -> None:
    low, high = (_aid(_fix(covariance_common=np.eye(6) * v)).slow_errors[0] for v in (0.04, 0.16))
    assert low.block == high.block
    np.testing.assert_allclose(_covariance(low), np.eye(6) * 0.04, atol=1e-15)
    np.testing.assert_allclose(_covariance(high), np.eye(6) * 0.16, atol=1e-15)


def _landmark_fix(q: tuple[float, float, float, float], names: tuple[str, ...] = ("a", "b"), **changes: Any) -> LandmarkFix:
    errors = np.random.default_rng(3).standard_normal((len(names), 6, 4)) * 0.1
    rig = np.diag([1e-4, 2e-4, 3e-4, 1e-6, 4e-6, 9e-6])
    total = np.einsum("mik,mjk->ij", errors, errors) + rig
    fields: dict[str, Any] = {"landmark_errors": errors, "covariance_rig": rig} | changes
    return LandmarkFix(10**9, 10**9, (1.0, 2.0, 3.0), q, GIVEN, total, names, 0.9, 0.4, **fields)


def test_errors_of_each_landmark_and_of_the_rig_are_distinguished_and_make_up_the_whole() -> None:
    fix = _landmark_fix(Q)
    slow = _aid(fix).slow_errors
    assert [s.block for s in slow] == ["/landfix/fix/a", "/landfix/fix/b", "/landfix/fix.rig"]
    x = LEVEL.copy()
    x[X.Q] = Q
    assert fix.covariance_common is not None
    np.testing.assert_allclose(sum(_covariance(s, x) for s in slow), fix.covariance_common, atol=1e-12)


def test_what_the_rig_does_turns_with_the_body() -> None:
    rig = _aid(_landmark_fix(Q)).slow_errors[-1]
    x = LEVEL.copy()
    x[X.Q] = Q
    then = so3.matrix(x[X.Q])
    x[X.Q] = so3.from_euler(0.0, 0.0, 1.2)
    turn = np.kron(np.eye(2), so3.matrix(x[X.Q]) @ then.T)
    expected = turn @ np.diag([1e-4, 2e-4, 3e-4, 1e-6, 4e-6, 9e-6]) @ turn.T
    np.testing.assert_allclose(_covariance(rig, x), expected, atol=1e-15)


def test_of_too_many_landmarks_the_sum_is_taken() -> None:
    names = tuple(f"roof {k}" for k in range(12))
    (slow,) = _aid(_landmark_fix(Q, names)).slow_errors
    assert slow.block == "/landfix/fix"


@pytest.mark.parametrize(
    "errors",
    [
        np.zeros((1, 6, 4)),
        np.zeros((2, 3, 4)),
        np.full((2, 6, 4), math.nan),
        np.full((2, 6, 4), 1e150),
        np.zeros((2, 6, 400)),
        np.zeros(12),
    ],
)
def test_errors_that_do_not_fit_their_landmarks_are_malformed(errors: Array) -> None:
    refusal = pose_aid(_landmark_fix(Q, landmark_errors=errors), PoseConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is Reason.MALFORMED


def test_a_landmark_fix_is_a_pose_fix_too() -> None:
    fix = LandmarkFix(10**9, 10**9, (1.0, 2.0, 3.0), Q, GIVEN, None, ("roof 7",), 0.9, 0.4)
    z = _aid(fix).measurement(None)
    assert isinstance(z, Pose)
    np.testing.assert_array_equal(z.z_n, [1.0, 2.0, 3.0])


def test_a_share_of_a_fixs_own_error_lasts_and_the_whole_stays_what_it_claims() -> None:
    config = PoseConfig(tilt_deg=0.0, mount_deg=0.0, lasting_share=0.6)
    aid = _aid(_fix(), config)
    (look,) = aid.slow_errors
    z = aid.measurement(None)
    assert z is not None
    assert look.block == "/pose_fix.look"
    assert look.tau_s == 3.0
    np.testing.assert_allclose(z.noise, 0.4 * GIVEN, atol=1e-15)
    np.testing.assert_allclose(z.noise + _covariance(look), GIVEN, atol=1e-15)


def test_landmark_fixes_last_and_others_do_not_by_default() -> None:
    assert _aid(_fix(), PoseConfig(tilt_deg=0.0, mount_deg=0.0)).slow_errors == ()
    assert [s.block for s in _aid(_landmark_fix(Q), LandmarkFixConfig()).slow_errors][-1] == "/landfix/fix.look"


def test_an_accuracy_of_zero_is_unknown() -> None:
    config = PoseConfig(position_sigma_m=0.4, attitude_sigma_deg=2.0)
    taken = np.diag([0.4**2] * 3 + [math.radians(2.0) ** 2] * 3)
    np.testing.assert_allclose(_measurement(_fix(covariance=np.zeros((6, 6))), config).noise, taken)
    assert "position_sigma_m 0.4, attitude_sigma_deg 2" in _aid(_fix(covariance=np.zeros((6, 6))), config).assumed
    in_part = GIVEN * np.diag([1, 1, 0, 1, 1, 1])
    np.testing.assert_allclose(_measurement(_fix(covariance=in_part), config).noise, in_part + np.diag([0, 0, 0.16, 0, 0, 0]))
    without_yaw = np.diag([0.0, 0.0, 0.0, 0.01, 0.02, -1.0])
    np.testing.assert_allclose(_measurement(_fix(covariance=without_yaw), config).noise, np.diag([0.16] * 3 + [0.01, 0.02]))
    assert not _aid(_fix(), config).assumed


def test_the_default_is_not_scaled_as_what_a_fix_claims() -> None:
    z = _measurement(_fix(covariance=np.zeros((6, 6))), PoseConfig(position_sigma_m=0.4, noise_scale=3.0))
    np.testing.assert_allclose(z.noise[:3, :3], 0.16 * np.eye(3))


@pytest.mark.parametrize("blank", [(1.0, 0.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)), (0.0, 0.0, 0.0, 0.0)])
def test_an_attitude_that_nobody_filled_in_is_not_given(blank: Quat) -> None:
    z = _measurement(_fix(q_nb_wxyz=blank, covariance=np.zeros((6, 6))))
    assert z.attitude == "none"
    assert z.rows.tolist() == [0, 1, 2]
    assert _measurement(_fix(q_nb_wxyz=(1.0, 0.0, 0.0, 0.0))).attitude == "full"  # with its accuracy it is one


def test_a_configured_delay_is_subtracted_from_the_stamp_of_whole_and_partial_fixes() -> None:
    config = LandmarkFixConfig(delay_s=0.08, delay_sigma_s=0.005)
    landmark = LandmarkFix(
        10**9,
        10**9,
        p_n=(1.0, 2.0, 3.0),
        q_nb_wxyz=Q,
        covariance=GIVEN,
        covariance_common=None,
        landmarks=("a",),
        similarity=1.0,
        residual_px=0.5,
        directions=np.eye(6)[:2],
    )
    for made in (_aid(_fix(), config), landmark_aid(landmark, config)):
        assert isinstance(made, Aid)
        assert made.t_ns == made.order[0] == 920_000_000
        assert made.arrived_ns == 10**9
        assert made.delay_sigma_s == 0.005
