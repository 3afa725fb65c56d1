"""A step from rendered pairs, and every reason for a lost one."""

import cv2
import numpy as np
import pytest

from models import so3
from models.camera import StereoRig
from tests.vision.odometry.scene import HEIGHT_M, P_N, RIG, pair, prediction, truth
from vision.image.rectify import Image
from vision.odometry.step import Frame, Step, StereoOdometry, Tracks

ODOMETRY = StereoOdometry(RIG)


def frame(left: Image | None, right: Image | None) -> Frame:
    made = ODOMETRY.frame(left, right)
    assert not isinstance(made, str), made
    return made


def chi2(step: Step) -> float:
    """Squared distance from the truth; 6 degrees of freedom."""
    p, R = truth()
    e = np.r_[step.p - p, so3.quat_log(so3.from_matrix(np.ascontiguousarray(R.T @ so3.matrix(step.q))))]
    return float(e @ np.linalg.solve(step.covariance + step.systematic @ step.systematic.T, e))


def test_stereo() -> None:
    step = ODOMETRY.step(frame(*pair(0)), frame(*pair(1)), prediction())
    assert step.reason == ""
    assert np.linalg.norm(step.p - truth()[0]) < 0.06  # of 1.4 m, from 20 m
    assert chi2(step) < 22.5
    assert step.points > 60


def test_the_same_bits_again() -> None:
    first, again = (ODOMETRY.step(frame(*pair(0)), frame(*pair(1)), prediction()) for _ in range(2))
    for a, b in ((first.p, again.p), (first.q, again.q), (first.covariance, again.covariance)):
        assert a.tobytes() == b.tobytes()


def test_the_prediction_is_no_measurement() -> None:
    """Another prediction, 15 cm away: the answer moves by far less than its sigma."""
    a, b = (ODOMETRY.step(frame(*pair(0)), frame(*pair(1)), prediction(e)) for e in ((0.05, -0.04, 0.03), (-0.06, 0.05, -0.03)))
    assert not a.reason + b.reason
    assert np.linalg.norm((a.p - b.p) / np.sqrt(np.diag(a.covariance)[:3])) < 0.5


def test_one_camera_with_height() -> None:
    step = ODOMETRY.step(frame(pair(0)[0], None), frame(pair(1)[0], None), prediction(height=(HEIGHT_M, 0.3)))
    assert step.reason == ""
    assert np.linalg.norm(step.p - truth()[0]) < 0.15
    assert chi2(step) < 22.5
    assert np.linalg.norm(step.systematic[:3, 1]) > 0.02  # what the height leaves open


def test_one_camera_without_height_is_lost() -> None:
    step = ODOMETRY.step(frame(pair(0)[0], None), frame(pair(1)[0], None), prediction())
    assert "height above the ground is not known" in step.reason


def test_the_right_image_may_be_missing_at_the_second_time() -> None:
    step = ODOMETRY.step(frame(*pair(0)), frame(pair(1)[0], None), prediction())
    assert step.reason == ""
    assert chi2(step) < 22.5


def test_a_height_holds_the_scale_where_disparities_are_off() -> None:
    """The right camera turned by 0.05 degrees, which nobody knows: 0.5 px."""
    turned = so3.matrix(so3.quat_exp(np.array([0.0, np.radians(0.05), 0.0]))) @ RIG.R_rc
    covariance = np.diag(np.r_[np.full(3, 1e-8), np.full(3, np.radians(0.05) ** 2)])
    off = StereoOdometry(StereoRig(RIG.left, RIG.right, turned, turned @ RIG.R_rc.T @ RIG.t_rc, RIG.R_bc, RIG.p_bc, covariance))
    frames = [off.frame(*pair(k)) for k in (0, 1)]
    assert isinstance(frames[0], Frame)
    assert isinstance(frames[1], Frame)
    without, with_height = (off.step(frames[0], frames[1], p) for p in (prediction(), prediction(height=(HEIGHT_M, 0.1))))
    length = np.linalg.norm(truth()[0])
    assert abs(np.linalg.norm(with_height.p) / length - 1.0) < 0.03
    assert np.linalg.norm(with_height.systematic[:3]) < 0.9 * np.linalg.norm(without.systematic[:3])
    assert chi2(without) < 22.5
    assert chi2(with_height) < 22.5


def test_a_rig_without_covariances_is_not_exact() -> None:
    """The same of a rig file that says nothing."""
    turned = so3.matrix(so3.quat_exp(np.array([0.0, np.radians(0.05), 0.0]))) @ RIG.R_rc
    off = StereoOdometry(StereoRig(RIG.left, RIG.right, turned, turned @ RIG.R_rc.T @ RIG.t_rc, RIG.R_bc, RIG.p_bc))
    first, second = (off.frame(*pair(k)) for k in (0, 1))
    assert isinstance(first, Frame)
    assert isinstance(second, Frame)
    assert chi2(off.step(first, second, prediction())) < 7.8


def test_no_points() -> None:
    none = np.empty((0, 3))
    assert ODOMETRY.motion_of(Tracks(none, none), prediction()).reason == "too few tracks: 0 points are in both pairs"


def test_contrast_of_a_tenth() -> None:
    dim = [[cv2.addWeighted(image, 0.1, image, 0.0, 30.0) for image in pair(k)] for k in (0, 1)]
    step = ODOMETRY.step(frame(*dim[0]), frame(*dim[1]), prediction())
    assert step.reason == ""
    assert chi2(step) < 22.5


@pytest.mark.parametrize(
    ("image", "reason"),
    [(np.zeros((480, 640, 3), np.uint8), "black"), (np.full((480, 640, 3), 255, np.uint8), "white"), (None, "missing")],
)
def test_what_is_no_image(image: Image | None, reason: str) -> None:
    made = ODOMETRY.frame(image, image)
    assert isinstance(made, str)
    assert reason in made


def test_blur_is_lost_or_right() -> None:
    """In the limit nothing is left to be tracked: a reason, no guess."""
    smooth = [[cv2.GaussianBlur(image, (0, 0), 25.0) for image in pair(k)] for k in (0, 1)]
    step = ODOMETRY.step(frame(*smooth[0]), frame(*smooth[1]), prediction())
    assert "too few" in step.reason


def test_another_scene_is_lost() -> None:
    """The second pair shows other ground."""
    step = ODOMETRY.step(frame(*pair(0)), frame(*pair(1, 30.0)), prediction())
    assert step.reason


def half_moving(shift_m: float) -> Frame:
    """The second pair; in the right half of both images the ground has moved."""
    left, right = (np.hstack((a[:, :320], b[:, 320:])) for a, b in zip(pair(1), pair(1, shift_m), strict=True))
    return frame(left, right)


def test_two_motions_are_said_and_the_predicted_one_is_taken() -> None:
    step = ODOMETRY.step(frame(*pair(0)), half_moving(0.6), prediction())
    assert "two motions" in step.reason + step.remark
    assert step.reason or chi2(step) < 22.5


def test_two_motions_that_nothing_tells_apart_are_lost() -> None:
    """A prediction of +-1 m allows both."""
    wide = prediction()
    wide.covariance[:3, :3] = np.eye(3)
    step = ODOMETRY.step(frame(*pair(0)), half_moving(0.6), wide)
    assert "two motions" in step.reason


def test_scene_is_as_specified() -> None:
    assert np.linalg.norm(P_N[1] - P_N[0]) == pytest.approx(1.42, abs=0.01)


def test_a_slow_motion_of_half_of_the_scene_is_no_certainty() -> None:
    """8 cm, 2 px: it cannot be told from depth and rotation, but neighbouring tracks err alike."""
    still = ODOMETRY.step(frame(*pair(0)), frame(*pair(1)), prediction())
    step = ODOMETRY.step(frame(*pair(0)), half_moving(0.08), prediction())
    if not step.reason:
        assert np.trace(step.covariance[:3, :3]) > 4.0 * np.trace(still.covariance[:3, :3])
        assert chi2(step) < 22.5
