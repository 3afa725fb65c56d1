"""A pose fix becomes a measurement of what it gives: attitude as a whole, roll and pitch, yaw, or nothing of it."""

import math
from typing import Any

import numpy as np
import pytest

from estimator.sources.pose import PoseConfig, given_components, pose_aid
from estimator.sources.source import Aid, Refusal
from models import so3
from models.measurements import Pose
from models.messages import Array, LandmarkFix, PoseFix, Quat, Reason

Q: Quat = tuple(so3.from_euler(0.1, 0.2, 0.3).tolist())
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
    assert bool(given_components(_without([1], variance))[1]) is limit


@pytest.mark.parametrize(("variance", "limit"), [(9.99, True), (10.0, False)])
def test_the_limit_of_an_attitude_that_is_given(variance: float, limit: bool) -> None:
    assert bool(given_components(_without([4], variance))[4]) is limit


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
        ({"covariance": np.zeros((6, 6))}, Reason.NOT_PSD),
        ({"covariance": np.diag([0.1, 0.1, 0.0, 0.1, 0.1, 0.1])}, Reason.NOT_PSD),
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
    ],
)
def test_an_unusable_fix_has_its_reason(changes: dict[str, Any], reason: Reason) -> None:
    refusal = pose_aid(_fix(**changes), PoseConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is reason


def test_the_common_part_is_considered_under_the_topics_name() -> None:
    common = np.eye(6) * 0.04
    slow = _aid(_fix(covariance_common=common, topic="/tower")).slow_error
    assert slow is not None
    assert slow.block == "/tower"
    np.testing.assert_array_equal(slow.covariance, common)
    assert slow.tau_s > 1e6
    assert _aid(_fix(covariance_common=np.zeros((6, 6)))).slow_error is None


def test_a_landmark_fix_is_a_pose_fix_too() -> None:
    fix = LandmarkFix(10**9, 10**9, (1.0, 2.0, 3.0), Q, GIVEN, None, ("roof 7",), 0.9, 0.4)
    z = _aid(fix).measurement(None)
    assert isinstance(z, Pose)
    np.testing.assert_array_equal(z.z_n, [1.0, 2.0, 3.0])
