"""A fix on landmarks that measured the pose in part: a measurement of that part, or the reason why it is none."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from estimator.sources.aids import aid_of
from estimator.sources.base.aid import FALSE_POSITION_M, Aid, Refusal
from estimator.sources.base.rules import RULES
from estimator.sources.landmark import landmark_aid
from estimator.sources.pose import LandmarkFixConfig, PoseConfig, pose_aid
from models import so3
from models.measurements import DIRECTION_SCALE, PartialPose, Pose
from models.messages import Array, LandmarkFix, Reason
from models.state import X
from tests.estimator.partial import orthonormal, point_rows

ROWS = orthonormal(np.vstack((point_rows(np.array([5.0, -8.0, 40.0])), np.eye(6)[5])))  # a point below, and the heading
COVARIANCE = np.diag([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])
W, QX, QY, QZ = so3.from_euler(0.1, 0.2, 0.3).tolist()
STATE = np.zeros(X.SIZE)
STATE[X.Q] = (W, QX, QY, QZ)
ALONE = PoseConfig(tilt_deg=0.0, mount_deg=0.0)


def _fix(**changes: Any) -> LandmarkFix:
    fix = LandmarkFix(
        10**9, 10**9, (1.0, 2.0, 3.0), (W, QX, QY, QZ), COVARIANCE, None, ("a", "b"), 0.9, 0.4, directions=ROWS
    )  # fmt: skip
    return msgspec.structs.replace(fix, **changes)


def _aid(fix: LandmarkFix, config: PoseConfig = ALONE) -> Aid:
    made = landmark_aid(fix, config)
    assert isinstance(made, Aid), made
    return made


def _measurement(fix: LandmarkFix, config: PoseConfig = ALONE) -> PartialPose:
    z = _aid(fix, config).measurement(None)
    assert isinstance(z, PartialPose)
    return z


def test_it_measures_what_its_directions_let_through() -> None:
    z = _measurement(_fix())
    np.testing.assert_allclose(z.noise, ROWS @ COVARIANCE @ ROWS.T)
    np.testing.assert_array_equal(z.directions, ROWS)
    assert len(z.rows) == 4
    aid = _aid(_fix())
    assert (aid.kind, aid.detail) == ("pose", "4 of 6 directions")
    assert aid.log_false == pytest.approx(math.log(RULES["pose"].false_share) - 4 * math.log(2.0 * FALSE_POSITION_M))


def test_what_is_wide_where_it_was_not_measured_changes_nothing() -> None:
    across = np.eye(6) - np.linalg.pinv(ROWS) @ ROWS
    wide = _measurement(_fix(covariance=COVARIANCE + 1e4 * across @ across.T))
    np.testing.assert_allclose(wide.noise, _measurement(_fix()).noise, atol=1e-8)


def test_without_directions_it_is_the_pose_fix_it_was_to_the_bit() -> None:
    aid, as_pose = _aid(_fix(directions=None)), pose_aid(_fix(directions=None), ALONE)
    assert isinstance(as_pose, Aid)
    assert (aid.order, aid.absolute, aid.log_false, aid.detail) == (as_pose.order, True, as_pose.log_false, "")
    assert isinstance(aid.measurement(None), Pose)


def test_six_directions_are_the_whole_pose_distinguished_from_elsewhere() -> None:
    rows, y = np.diag(DIRECTION_SCALE), np.array([0.1, -0.2, 0.3, 0.5, -1.0, 1.5])
    z = _measurement(_fix(directions=rows, readings=y))
    nu, _ = z.evaluate(STATE, np.zeros(3))
    np.testing.assert_allclose(nu[:3], [1.1, 1.8, 3.3])
    np.testing.assert_allclose(nu[3:], y[3:], atol=1e-12)
    np.testing.assert_allclose(z.noise, DIRECTION_SCALE * COVARIANCE * DIRECTION_SCALE[:, None])


def test_directions_and_readings_are_part_of_what_distinguishes_two_fixes() -> None:
    orders = [_aid(fix).order for fix in (_fix(), _fix(directions=ROWS[:3]), _fix(readings=np.full(4, 0.1)))]
    assert len(set(orders)) == 3


@pytest.mark.parametrize(
    ("rows", "absolute"),
    [
        (ROWS, True),
        (orthonormal(point_rows(np.array([0.0, 0.0, 300.0]))), True),
        (orthonormal(np.eye(6)[[0, 1, 5]]), False),  # no height
        (orthonormal(np.eye(6)[[0, 2, 3, 4, 5]]), False),  # along an edge
        (orthonormal(np.eye(6)[3:]), False),
        (orthonormal(np.eye(6)[:2]), False),
    ],
)
def test_it_is_absolute_where_the_position_is_known_once_the_attitude_is(rows: Array, absolute: bool) -> None:
    assert _aid(_fix(directions=rows)).absolute is absolute


@pytest.mark.parametrize("config", [PoseConfig(tilt_deg=0.0, mount_deg=0.0), LandmarkFixConfig()])
def test_errors_that_repeat_are_seen_along_the_directions(config: PoseConfig) -> None:
    """What is fused as new, what lasts and what landmarks and rig repeat make up D (C + C_common) D^T."""
    errors = np.random.default_rng(3).standard_normal((2, 6, 4)) * 0.1
    rig = np.diag([1e-4, 2e-4, 3e-4, 1e-6, 4e-6, 9e-6])
    common = np.einsum("mik,mjk->ij", errors, errors) + rig
    aid = _aid(_fix(covariance_common=common, landmark_errors=errors, covariance_rig=rig), config)
    z = aid.measurement(None)
    assert z is not None
    noise = z.noise
    for slow in aid.slow_errors:
        moved = slow.moves(STATE)
        assert moved is not None
        assert moved.shape == (4, len(slow.covariance))
        noise = noise + moved @ slow.covariance @ moved.T
    np.testing.assert_allclose(noise, ROWS @ (COVARIANCE + common) @ ROWS.T, atol=1e-10)
    names = ["/landfix/fix/a", "/landfix/fix/b", "/landfix/fix.rig"]
    assert [slow.block for slow in aid.slow_errors] == names + (["/landfix/fix.look"] if config.lasting_share else [])


def test_noise_scale_multiplies_sigma() -> None:
    scaled = _measurement(_fix(), PoseConfig(tilt_deg=0.0, mount_deg=0.0, noise_scale=3.0))
    np.testing.assert_allclose(scaled.noise, 9.0 * ROWS @ COVARIANCE @ ROWS.T)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"directions": np.full((2, 6), math.nan)}, Reason.NOT_FINITE),
        ({"directions": np.where(np.eye(6)[:4] > 0, math.inf, 0.0)}, Reason.NOT_FINITE),
        ({"directions": np.zeros((0, 6))}, Reason.UNSUPPORTED),
        ({"directions": np.zeros((4, 6))}, Reason.MALFORMED),
        ({"directions": np.zeros(12)}, Reason.MALFORMED),
        ({"directions": ROWS.T}, Reason.MALFORMED),
        ({"directions": np.vstack((ROWS, ROWS))}, Reason.MALFORMED),
        ({"directions": 1.001 * ROWS}, Reason.MALFORMED),
        ({"directions": ROWS[[0, 0]]}, Reason.MALFORMED),
        ({"directions": 1e200 * ROWS}, Reason.MALFORMED),
        ({"directions": ROWS / DIRECTION_SCALE}, Reason.MALFORMED),  # orthonormal in metres and radians
        ({"directions": np.float64(1.0)}, Reason.MALFORMED),
        ({"readings": np.zeros(3)}, Reason.MALFORMED),
        ({"readings": np.zeros((4, 1))}, Reason.MALFORMED),
        ({"readings": np.array([0.0, math.nan, 0.0, 0.0])}, Reason.NOT_FINITE),
        ({"readings": np.array([0.0, 2e6, 0.0, 0.0])}, Reason.IMPLAUSIBLE),
        ({"covariance": np.eye(3)}, Reason.MALFORMED),
        ({"covariance": np.full((6, 6), math.nan)}, Reason.NOT_FINITE),
        ({"covariance": 1e300 * np.eye(6)}, Reason.NOT_FINITE),
        ({"covariance": np.zeros((6, 6))}, Reason.NOT_PSD),
        ({"covariance": -np.eye(6)}, Reason.NOT_PSD),
        ({"covariance_common": -np.eye(6)}, Reason.NOT_PSD),
        ({"p_n": (math.nan, 0.0, 0.0)}, Reason.NOT_FINITE),
        ({"p_n": (2e6, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"q_nb_wxyz": (1.0, 1.0, 0.0, 0.0)}, Reason.IMPLAUSIBLE),
        ({"landmark_errors": np.zeros((1, 6, 4)), "covariance_common": np.eye(6)}, Reason.MALFORMED),
    ],
)
def test_an_unusable_fix_has_its_reason(changes: dict[str, Any], reason: Reason) -> None:
    refusal = landmark_aid(_fix(**changes), PoseConfig())
    assert isinstance(refusal, Refusal)
    assert refusal.reason is reason


def test_fixes_reach_it_through_the_common_door() -> None:
    class Sections:
        gnss = pose_fix = baro = None
        landmark_fix = LandmarkFixConfig()

    aid = aid_of(_fix(), Sections())  # type: ignore[arg-type]
    assert isinstance(aid, Aid)
    assert isinstance(aid.measurement(None), PartialPose)
