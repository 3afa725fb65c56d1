import msgspec
import numpy as np
import pytest

from models.messages import Array, LandmarkFix
from vision.pose.map_error import WHOLE_MAP, with_map_error

ERRORS = np.random.default_rng(0).normal(size=(2, 6, 4))
RIG = 0.01 * np.eye(6)
COMMON = np.einsum("mik,mjk->ij", ERRORS, ERRORS) + RIG
FIX = LandmarkFix(
    1, 1, (0.0, 0.0, -50.0), (1.0, 0.0, 0.0, 0.0), np.eye(6), COMMON, ("a", "b"), 0.9, 0.2,
    landmark_errors=ERRORS, covariance_rig=RIG,
)  # fmt: skip


def test_the_whole_map_s_error_is_one_more_that_repeats() -> None:
    fix = with_map_error(FIX, (0.5, 2.0))
    assert fix.landmarks == ("a", "b", WHOLE_MAP)
    assert fix.landmark_errors is not None
    assert fix.covariance_common is not None
    whole = np.einsum("mik,mjk->ij", fix.landmark_errors, fix.landmark_errors) + RIG
    np.testing.assert_allclose(fix.covariance_common, whole)
    np.testing.assert_allclose(fix.covariance_common - COMMON, np.diag([0.25, 0.25, 4.0, 0.0, 0.0, 0.0]), atol=1e-12)
    np.testing.assert_allclose(fix.landmark_errors[:2], ERRORS)


def test_a_map_that_is_not_shifted_leaves_the_fix_alone() -> None:
    assert with_map_error(FIX, (0.0, 0.0)) is FIX


@pytest.mark.parametrize("common", [None, np.eye(6)])
def test_a_fix_that_does_not_tell_its_errors_apart_gets_it_as_a_whole(common: Array | None) -> None:
    bare = msgspec.structs.replace(FIX, landmark_errors=None, covariance_common=common, covariance_rig=None)
    fix = with_map_error(bare, (1.0, 1.0))
    assert fix.landmarks == ("a", "b")
    assert fix.covariance_common is not None
    before = 0.0 if common is None else 1.0
    np.testing.assert_allclose(np.diag(fix.covariance_common), np.repeat([before + 1.0, before], 3))
