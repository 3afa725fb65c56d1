"""All outlines as one pattern, from far above: where they are though no roof has one colour, and no when in doubt."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.prior import Prior
from vision.pipeline import LandmarkPipeline, PipelineConfig
from vision.pose.sensitivity import eyes
from vision.predict import pattern
from vision.predict.coarse_search import CoarseConfig
from vision.predict.motion import motion
from vision.records.images import Images
from vision.records.reports import Result, nothing

SIZE, HEIGHT_M = 300, 2000.0  # 0.5 m a pixel
DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
CAMERA = CameraModel(SIZE, SIZE, 4000.0, 4000.0, 149.5, 149.5)
RIG = StereoRig(CAMERA, CAMERA, np.eye(3), np.array([-1.0, 0.0, 0.0]), DOWN, np.zeros(3))
TRUTH = np.array([0.0, 0.0, -HEIGHT_M])
OFF = np.array([9.0, -6.0, 0.0])  # of the prior, m
VILLAGE = (
    (-30.0, -28.0, 12.0, 8.0),
    (-22.0, 20.0, 9.0, 9.0),
    (5.0, -8.0, 16.0, 7.0),
    (28.0, 25.0, 10.0, 8.0),
    (24.0, -33.0, 8.0, 12.0),
)
WIDE = ((-25.0, -25.0, 20.0, 24.0), (-22.0, 24.0, 22.0, 20.0), (25.0, -4.0, 18.0, 24.0))
ROW = tuple((-30.0 + 12.0 * k, 0.0, 6.0, 9.0) for k in range(6))
Boxes = tuple[tuple[float, float, float, float], ...]  # north, east of the middle, sizes


def mark(name: str, box: tuple[float, float, float, float]) -> Landmark:
    north, east, a, b = box
    corners = [
        (north - a / 2, east - b / 2),
        (north - a / 2, east + b / 2),
        (north + a / 2, east + b / 2),
        (north + a / 2, east - b / 2),
    ]
    return Landmark.of(name, np.array(corners), sigma_m=0.3)


def drawn(boxes: Boxes) -> Images:
    """Each roof has a bright and a dark half on a ground between them, as hipped ones have in the sun."""
    levels = 110.0 + 12.0 * np.random.default_rng(5).normal(size=(SIZE, SIZE))
    for north, east, a, b in boxes:
        top, left, rows, columns = (round(x) for x in (149.5 - 2 * north - a, 149.5 + 2 * east - b, 2 * a, 2 * b))
        levels[top : top + rows // 2, left : left + columns] += 45.0
        levels[top + rows // 2 : top + rows, left : left + columns] -= 45.0
    image: NDArray[np.uint8] = np.asarray(np.clip(levels, 0, 255), dtype=np.uint8)
    return Images(image, None, "")


def asked(
    boxes: Boxes,
    standing: Boxes,
    yaw_rad: float = 1e-3,
    result: Result | None = None,
    sigma_m: float = 12.0,
    yaw_off: float = 0.0,
    *,
    alone: bool = True,
    off_m: NDArray[np.float64] | None = None,
) -> tuple[Result, Prior]:
    """What is made of a result: a map of boxes over an image of those that stand there; yaw_off: of the prior, rad."""
    covariance = np.diag([sigma_m**2, sigma_m**2, 1.0, 1e-7, 1e-7, yaw_rad**2])
    off_m = OFF * sigma_m / 12.0 if off_m is None else off_m
    prior = Prior(TRUTH + off_m, so3.from_euler(0.0, 0.0, yaw_off), covariance)
    marks = [mark(str(k), box) for k, box in enumerate(boxes)]
    move = motion(eyes(RIG)[0], marks, prior)
    assert move is not None
    before = result or nothing(7, "no_pose", "no fit")
    return pattern.judged(before, RIG, drawn(standing), marks, move, CoarseConfig(), alone=alone), prior


@pytest.mark.parametrize(("copied", "found"), [(2, True), (3, False), (4, False)])
def test_a_position_that_is_not_half_as_likely_again_as_the_second_is_no_fix(copied: int, found: bool) -> None:
    """Some of the roofs stand a second time, 17 m off; ratios of the two positions: 2.06, 1.46, 1.24."""
    again = tuple((north + 14.0, east + 9.0, a, b) for north, east, a, b in VILLAGE[:copied])
    result, _ = asked(VILLAGE, VILLAGE + again)
    assert (result.fix is not None) is found


def test_roofs_of_two_colours_are_found_together() -> None:
    result, prior = asked(VILLAGE, VILLAGE)
    assert result.fix is not None
    assert result.pose is not None
    error = result.pose.joint_p_n - TRUTH
    assert float(np.linalg.norm(error[:2])) < 0.8
    assert float(np.linalg.norm(OFF)) > 10.0
    assert result.fix.landmarks == (pattern.NAME,)
    assert result.fix.directions is not None
    assert len(result.fix.directions) == 2
    sigma = np.sqrt(np.diag(result.pose.joint_covariance))
    assert 0.3 < sigma[0] < 1.5  # a pixel is half a metre, the map 0.3, tilt 0.6
    assert sigma[2] == pytest.approx(math.sqrt(prior.covariance[2, 2]), rel=0.05)


def test_the_error_of_the_map_repeats() -> None:
    """0.3 m of the map against a pixel, half a metre, that is new in every image."""
    result, _ = asked(VILLAGE, VILLAGE)
    assert result.fix is not None
    along, common = result.fix.directions, result.fix.covariance_common
    assert along is not None
    assert common is not None
    repeats, new = (np.trace(along @ c @ along.T) for c in (common, result.fix.covariance))
    assert repeats / new == pytest.approx((0.3 / 0.5) ** 2, rel=0.05)


def test_nothing_there_is_no_fix() -> None:
    """However narrow the prior is: the places it excludes tell what chance makes."""
    for sigma_m in (12.0, 0.3):
        result, _ = asked(VILLAGE, (), sigma_m=sigma_m)
        assert result.fix is None
        assert result.report.outcome == "no_pose"


def test_a_row_of_equal_houses_is_no_position() -> None:
    assert asked(ROW[1:4], ROW)[0].fix is None


@pytest.mark.parametrize("about", [0.0, 18.0])
def test_where_the_same_houses_stand_twice_the_prior_decides_which(about: float) -> None:
    """Two equal groups, 36 px apart: the place is the one the prior is about, and the ratio says that the other is as good."""
    group = VILLAGE[:3]
    both = group + tuple((north, east + 18.0, a, b) for north, east, a, b in group)
    prior = Prior(
        TRUTH - np.array([0.0, about, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]), np.diag([25.0, 25.0, 1.0, 1e-7, 1e-7, 1e-6])
    )
    eye, marks = eyes(RIG)[0], [mark(str(k), box) for k, box in enumerate(group)]
    move = motion(eye, marks, prior)
    assert move is not None
    best = pattern.best_shift(eye, drawn(both), marks, move, CoarseConfig())
    assert not isinstance(best, str)
    p_n, _ = move.pose(move.gain @ best.q)
    assert float(np.linalg.norm((p_n - prior.p_n)[:2])) < 1.0
    assert best.ratio < 1.1


@pytest.mark.parametrize("yaw_off", [math.radians(5.0), math.radians(-4.0)])
def test_where_the_heading_is_open_it_is_searched_as_well(yaw_off: float) -> None:
    """Five degrees move the outlines' ends by ten pixels: no shift alone lays them on their edges."""
    result, _ = asked(VILLAGE, VILLAGE, yaw_rad=math.radians(3.0), yaw_off=yaw_off)
    assert result.fix is not None
    assert result.pose is not None
    assert float(np.linalg.norm((result.pose.joint_p_n - TRUTH)[:2])) < 1.0
    sigma = np.sqrt(np.diag(result.pose.joint_covariance))
    assert 0.3 < sigma[0] < 1.5
    assert sigma[5] > math.radians(1.0)  # the fix says nothing of the heading


@pytest.mark.parametrize("yaw_off", [math.radians(13.0), math.radians(-24.0)])
def test_a_heading_open_by_ten_degrees_is_searched(yaw_off: float) -> None:
    """In an image of half the size, whose pixels are 1 m; the heading stays the prior's, and the middle is some metres aside."""
    result, _ = asked(VILLAGE, VILLAGE, yaw_rad=math.radians(10.0), yaw_off=yaw_off)
    assert result.fix is not None
    assert result.pose is not None
    error, covariance = (result.pose.joint_p_n - TRUTH)[:2], result.pose.joint_covariance[:2, :2]
    assert float(np.linalg.norm(error)) < 3.0
    assert float(error @ np.linalg.solve(covariance, error)) < 9.2  # 99 %
    assert asked(VILLAGE, (), yaw_rad=math.radians(10.0), yaw_off=yaw_off)[0].fix is None


def test_what_is_not_searched_is_said_with_the_heading_that_would_be() -> None:
    result, _ = asked(VILLAGE, VILLAGE, yaw_rad=math.radians(10.0), sigma_m=40.0)
    assert result.fix is None
    assert "not searched: heading open by 10.0 deg" in result.report.detail
    allowed = float(result.report.detail.rsplit("searched up to ", 1)[1])
    assert 0.0 < allowed < 10.0
    nearer, _ = asked(VILLAGE, VILLAGE, yaw_rad=math.radians(0.99 * allowed), sigma_m=40.0)
    assert nearer.fix is not None


def test_with_an_open_heading_nothing_there_is_no_fix() -> None:
    assert asked(VILLAGE, (), yaw_rad=math.radians(3.0))[0].fix is None
    assert asked(ROW[1:4], ROW, yaw_rad=math.radians(3.0))[0].fix is None


@pytest.mark.parametrize(("standing", "found"), [(VILLAGE[2:3], False), (VILLAGE[:3], True)])
def test_with_an_open_heading_one_outline_of_three_is_no_position(standing: Boxes, found: bool) -> None:
    """The one that stands there alone has 1.76 times the second position, all three 1.75."""
    result, _ = asked(VILLAGE[:3], standing, yaw_rad=math.radians(3.0), yaw_off=math.radians(4.0))
    assert (result.fix is not None) is found


def test_with_an_open_heading_two_outlines_are_too_few() -> None:
    before = nothing(7, "no_pose", "no fit")
    assert asked(VILLAGE[:2], VILLAGE[:2], yaw_rad=math.radians(3.0), result=before)[0] is before


def fitted_at(p_n: NDArray[np.float64]) -> Result:
    """A fit edge by edge that puts the vehicle there."""
    good, _ = asked(VILLAGE, VILLAGE)
    assert good.pose is not None
    level = so3.matrix(np.array([1.0, 0.0, 0.0, 0.0]))
    return replace(good, regions=(), pose=replace(good.pose, joint_p_n=p_n, joint_R_nb=level))


def test_with_an_open_heading_a_fit_of_wide_roofs_stays_as_it_is() -> None:
    good = fitted_at(TRUTH)
    assert asked(WIDE, (), yaw_rad=math.radians(3.0), result=good)[0] is good


def test_with_an_open_heading_a_fit_of_small_roofs_must_be_the_one_position() -> None:
    """Three roofs 14 px wide, as they stand there, and the same three once more 18 m farther on."""
    three, yaw = VILLAGE[:3], math.radians(3.0)
    twice = three + tuple((north, east - 18.0, a, b) for north, east, a, b in three)
    good = fitted_at(TRUTH)
    assert asked(three, three, yaw_rad=yaw, result=good)[0] is good
    assert asked(three, twice, yaw_rad=yaw, result=good)[0].report.outcome == "ambiguous"
    elsewhere = asked(three, three, yaw_rad=yaw, result=fitted_at(TRUTH + np.array([12.0, 0.0, 0.0])))[0]
    assert elsewhere.report.outcome == "no_pose"
    assert "px from the fit" in elsewhere.report.detail


@pytest.mark.parametrize(("off_m", "stays"), [(0.0, True), (12.0, False)])
def test_a_fit_is_judged_at_its_own_heading_where_not_all_can_be_searched(off_m: float, stays: bool) -> None:
    yaw, sigma_m = math.radians(10.0), 40.0
    assert "not searched" in asked(VILLAGE, VILLAGE, yaw_rad=yaw, sigma_m=sigma_m)[0].report.detail
    fitted = fitted_at(TRUTH + np.array([off_m, 0.0, 0.0]))
    result, _ = asked(VILLAGE, VILLAGE, yaw_rad=yaw, sigma_m=sigma_m, yaw_off=math.radians(7.0), result=fitted)
    assert (result is fitted) is stays
    assert (result.fix is None) is not stays


@pytest.mark.parametrize(("sigmas", "found"), [(4.0, True), (4.8, False)])
def test_two_directions_are_judged_as_two(sigmas: float, found: bool) -> None:
    """99.99 % of a prior lie within 4.3 sigma of two directions; of six, which are not measured here, within 5.3."""
    result, _ = asked(VILLAGE, VILLAGE, sigma_m=19.0 / sigmas, off_m=np.array([19.0, 0.0, 0.0]))
    assert (result.fix is not None) is found
    assert found or "the prior excludes it" in result.report.detail


def test_one_outline_of_a_map_that_a_program_picked_is_no_fix() -> None:
    """Of two it is one, as of one that somebody has checked."""
    fixes = [
        asked(some, some, alone=alone)[0].fix for some, alone in ((VILLAGE[:1], True), (VILLAGE[:1], False), (VILLAGE, False))
    ]
    assert [fix is not None for fix in fixes] == [True, False, True]


@pytest.mark.parametrize(("off_m", "stays"), [(0.5, True), (6.0, False)])
def test_a_fit_elsewhere_is_refused(off_m: float, stays: bool) -> None:
    fitted = fitted_at(TRUTH + np.array([off_m, 0.0, 0.0]))
    result, _ = asked(VILLAGE, VILLAGE, result=fitted)
    assert (result is fitted) is stays
    assert (result.fix is None) is not stays


def test_the_pipeline_asks_the_pattern() -> None:
    prior = Prior(TRUTH + OFF, np.array([1.0, 0.0, 0.0, 0.0]), np.diag([12.0**2, 12.0**2, 1.0, 1e-7, 1e-7, 1e-6]))
    known = LandmarkMap.from_landmarks((47.0, 8.0, 400.0), [mark(str(k), box) for k, box in enumerate(VILLAGE)])
    pipeline = LandmarkPipeline(RIG, known, PipelineConfig(farthest_m=3000.0))
    result = pipeline.process(drawn(VILLAGE).left, None, 7, prior)
    assert result.fix is not None
    assert result.pose is not None
    assert float(np.linalg.norm((result.pose.joint_p_n - TRUTH)[:2])) < 0.8
    assert pipeline.process(drawn(()).left, None, 8, prior).fix is None
