"""Predict and verify through the pipeline: partial views, one camera, decoys, what waits for the next image, replays."""

from dataclasses import replace
from functools import cache
from typing import Literal, NamedTuple

import cv2
import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from tests import long
from tests.vision.part_views import part_view
from tests.vision.predict.drawn_views import draw_view, found_of
from tests.vision.predict.views import PRIOR_PX, decoy, images_of, later, prior_of
from tests.vision.roofs import nadir_rig
from vision.identify.ambiguity import steps_off
from vision.image.rectify import Image
from vision.pipeline import LandmarkPipeline, PipelineConfig, Result
from vision.pose.pose import PoseConfig
from vision.pose.sensitivity import Eye, eyes
from vision.predict.coarse_search import Candidate
from vision.predict.motion import motion
from vision.predict.predict import PredictConfig, PredictPath, nearer_and_farther
from vision.predict.verify import VerifyConfig
from vision.records.images import Images, usable
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.render import render_pair
from vision.synthetic.shapes import rectangle
from vision.synthetic.world import Appearance, Sun, World

ORIGIN = (47.0, 8.0, 400.0)
CHI2_9999_OF_3 = 21.108
SIGMA = np.array([3.0, 3.0, 1.0, *np.radians([0.5, 0.5, 2.0])])
RIG = nadir_rig(lens=(-0.1, 0.02, 0.0, 0.0))
PLACES = (((3.0, 2.0), 0.3), ((-7.0, 9.0), 1.2), ((-4.0, -9.0), 2.0))


class View(NamedTuple):
    """A pair, where it was taken, and the map."""

    left: Image
    right: Image
    p_n: Array
    R_nb: Array
    marks: tuple[Landmark, ...]


def house(name: str, position: tuple[float, float], angle: float, sigma_m: float = 0.1) -> Landmark:
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return Landmark.of(name, rectangle(9.0, 6.0) @ turn + position, 0.0, 3.0, None, sigma_m, 0.1, 0.05)


def look_at(marks: tuple[Landmark, ...], p_n: Array, seed: int = 3, shown: tuple[Landmark, ...] | None = None) -> View:
    """Pale roofs of the colour of their surroundings, seen from p_n; shown: what truly stands."""
    rng, R_nb = np.random.default_rng(seed), so3.matrix(so3.from_euler(0.05, -0.08, 0.6))
    present = marks if shown is None else shown
    looks = tuple(Appearance((120.0, 128.0, 134.0), texture="shingles", contrast=0.1) for _ in present)
    world = World(present, looks, (), Ground.procedural(rng), Sun(0.8))
    return View(*render_pair(world, RIG, p_n, R_nb, Conditions(), rng), p_n, R_nb, marks)


MARKS = tuple(house(str(k), position, angle) for k, (position, angle) in enumerate(PLACES))


@cache
def whole() -> View:
    return look_at(MARKS, np.array([0.0, 0.0, -40.0]))


def under_a_sheet(image: Image, eye: Eye, view: View) -> Image:
    """The image that `eye` took with a red sheet, 7 m wide, over a corner of the first roof of the map."""
    turn, mark = np.linspace(0.0, 2.0 * np.pi, 40), view.marks[0]
    rim_n = np.append(mark.outline_n[0], mark.roof_d) + 3.5 * np.column_stack((np.cos(turn), np.sin(turn), 0.0 * turn))
    p_nk, R_nk = eye.pose(view.p_n, view.R_nb)
    covered = image.copy()
    cv2.fillPoly(covered, [np.rint(eye.camera.project((rim_n - p_nk) @ R_nk)).astype(np.int32)], (40, 40, 230))
    return covered


def prior_off(view: View, error: Array, sigma: Array = SIGMA) -> Prior:
    q = so3.normalise(so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(view.R_nb)))
    return Prior(view.p_n - error[:3], q, np.diag(sigma**2))


def drawn(view: View, seed: int, sigma: Array = SIGMA) -> Prior:
    return prior_off(view, sigma * np.random.default_rng(seed).normal(size=6), sigma)


def pipeline(marks: tuple[Landmark, ...], rig: StereoRig = RIG) -> LandmarkPipeline:
    return LandmarkPipeline(rig, LandmarkMap.from_landmarks(ORIGIN, marks), PipelineConfig(path="predict"))


def assert_right(result: Result, view: View) -> None:
    assert result.fix is not None, result.report
    assert result.pose is not None
    e = view.p_n - result.pose.joint_p_n
    assert e @ np.linalg.solve(result.pose.joint_covariance[:3, :3], e) < CHI2_9999_OF_3
    assert np.linalg.norm(e) < 1.0


@long.parametrize("seed", range(4))
def test_pale_roofs_that_no_colour_distinguishes_from_the_ground_give_a_fix(seed: int) -> None:
    view = whole()
    result = pipeline(MARKS).process(view.left, view.right, 5, drawn(view, seed))
    assert_right(result, view)
    assert result.fix is not None
    assert len(result.fix.landmarks) == 3
    assert 0.6 < result.fix.similarity <= 1.0
    assert "predicted" in result.report.detail
    assert {r.path for r in result.regions} == {"predict"}
    assert [r.state for r in result.regions] == ["identified"] * 3


@pytest.mark.parametrize(("number", "off_px"), [(4, 160.0), (118, 120.0)])
def test_one_roof_whose_size_the_search_mistakes_is_fitted_from_other_distances(number: int, off_px: float) -> None:
    """Found, but as a roof of another size, half of its sides on edges."""
    view = draw_view(3001, number)
    images = images_of(view)
    priors = {d: prior_of(view, PRIOR_PX, d) for d in (20.0, 40.0, 80.0, 120.0, 160.0)}
    result = pipeline(view.landmarks, view.rig).process(*images, 1, priors[off_px])
    found = found_of(view, result.pose)
    assert result.fix is not None, result.report
    assert found.error_m < 1.2
    assert found.squared < CHI2_9999_OF_3


def test_other_distances_leave_one_roof_where_it_is_in_the_image() -> None:
    eye, marks, prior = eyes(RIG)[0], list(MARKS), prior_off(whole(), np.zeros(6))
    position = Candidate.as_mapped(eye, marks, (prior.p_n, prior.R_nb), np.zeros(6))
    middle = np.array([*marks[1].centre_n, marks[1].roof_d])
    positions = nearer_and_farther(marks, position, np.array([False, True, False]), prior)
    away = position.p_n - middle
    sigma = np.sqrt(away @ prior.covariance[:3, :3] @ away) / (away @ away)
    farther = [np.linalg.norm(one.p_n - middle) / np.linalg.norm(away) for one in positions]
    np.testing.assert_allclose(np.log(farther), sigma * np.array([-2.0, -1.0, 1.0, 2.0]))
    for one in positions:
        np.testing.assert_allclose(np.cross(one.p_n - middle, away), 0.0, atol=1e-9)
    assert (
        nearer_and_farther(marks, position, np.array([True, True, False]), prior) == []
    )  # their separation determines the distance


def test_roofs_that_the_border_cuts_take_part() -> None:
    """All three roofs are cut; no region of the image is whole."""
    view = look_at(MARKS, np.array([9.0, -1.5, -26.0]))
    prior = drawn(view, 2, SIGMA * np.array([0.4, 0.4, 0.5, 1.0, 1.0, 1.0]))
    assert_right(pipeline(MARKS).process(view.left, view.right, 0, prior), view)


@pytest.mark.parametrize("lost", ["left", "right"])
def test_one_camera_alone(lost: str) -> None:
    view = whole()
    left, right = (None if lost == name else image for name, image in (("left", view.left), ("right", view.right)))
    result = pipeline(MARKS).process(left, right, 0, drawn(view, 1))
    assert_right(result, view)
    assert f"{lost} camera not used: missing" in result.report.detail


def test_one_landmark_of_a_map_that_a_program_picked_is_no_fix_however_often_it_is_seen() -> None:
    """Two of them are; of a map that somebody has checked one is, too."""
    view = look_at(MARKS[:2], np.array([0.0, 0.0, -40.0]))
    fixes = []
    for marks, automatic in ((MARKS[:1], False), (MARKS[:1], True), (MARKS[:2], True)):
        the_map = LandmarkMap.from_landmarks(ORIGIN, marks)
        the_map.automatic = automatic
        one = LandmarkPipeline(RIG, the_map, PipelineConfig(path="predict"))
        results = [one.process(view.left, view.right, k * 10**8, drawn(view, 1)) for k in range(3)]
        fixes.append(any(result.fix is not None for result in results))
    assert fixes == [True, False, True]


def test_what_moved_since_a_program_picked_it_gives_no_false_fix() -> None:
    """A lorry, learnt from a flight, is 4 m from where it stood: alone it looks like an error of the position."""
    moved = msgspec.structs.replace(MARKS[0], outline_n=MARKS[0].outline_n + np.array([4.0, 0.0]))
    view = look_at(MARKS, np.array([0.0, 0.0, -40.0]), shown=(moved, *MARKS[1:]))
    results = {}
    for marks, automatic in ((MARKS[:1], False), (MARKS[:1], True), (MARKS, True)):
        the_map = LandmarkMap.from_landmarks(ORIGIN, marks)
        the_map.automatic = automatic
        one = LandmarkPipeline(RIG, the_map, PipelineConfig(path="predict"))
        results[len(marks), automatic] = one.process(view.left, view.right, 0, drawn(view, 1))
    false = results[1, False].pose
    assert false is not None
    assert np.linalg.norm((view.p_n - false.joint_p_n)[:2]) > 3.0, "what the mark is for"
    assert results[1, True].fix is None
    assert_right(results[3, True], view)


def test_a_landmark_that_was_pulled_down_is_left_out() -> None:
    view = look_at(MARKS, np.array([0.0, 0.0, -40.0]), shown=MARKS[:2])
    result = pipeline(MARKS).process(view.left, view.right, 0, drawn(view, 1))
    assert_right(result, view)
    assert result.fix is not None
    assert set(result.fix.landmarks) == {"0", "1"}
    assert {r.landmark: r.state for r in result.regions}["2"] in {"not_found", "open"}


def test_a_landmark_that_moved_is_left_out() -> None:
    """One of three is near what may be missing in one image: where the others' place waits, the next image agrees."""
    view = whole()
    one = pipeline((house("0", (6.0, 3.5), 0.3), *MARKS[1:]))
    result, later = (one.process(view.left, view.right, t_ns, drawn(view, 1)) for t_ns in (0, 10**8))
    assert result.fix is not None or result.report.outcome == "waiting"
    for answer in (result, later):
        if answer.fix is not None:
            assert_right(answer, view)
            assert "0" not in answer.fix.landmarks
    assert later.fix is not None


def test_reported_boxes_are_where_the_fit_reports() -> None:
    """Roofs off the map by up to 0.5 m, 8 px, which the search finds to a few px."""
    rng, mapped = (
        np.random.default_rng(5),
        tuple(house(mark.id, PLACES[k][0], PLACES[k][1], 0.3) for k, mark in enumerate(MARKS)),
    )
    true = tuple(msgspec.structs.replace(m, outline_n=m.outline_n + rng.normal(0.0, 0.3, 2)) for m in mapped)
    view = look_at(mapped, np.array([0.0, 0.0, -40.0]), shown=true)
    result = pipeline(mapped).process(view.left, view.right, 0, drawn(view, 1))
    assert_right(result, view)
    eye = eyes(RIG)[0]
    p_nk, R_nk = eye.pose(view.p_n, view.R_nb)
    for said in result.regions:
        roof = next(mark for mark in true if mark.id == said.landmark)
        px = eye.camera.project((np.column_stack((roof.outline_n, np.full(4, roof.roof_d))) - p_nk) @ R_nk)
        u, v, width, height = said.bbox
        np.testing.assert_allclose([u, v, u + width, v + height], np.concatenate((px.min(axis=0), px.max(axis=0))), atol=1.0)


@pytest.mark.parametrize("angle", [0.6, 1.57, 2.4])
def test_a_map_that_is_turned_is_refused(angle: float) -> None:
    view, turn = whole(), np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = tuple(
        house(str(k), tuple((np.array(position) @ turn).tolist()), a + angle) for k, (position, a) in enumerate(PLACES)
    )
    result = pipeline(turned).process(view.left, view.right, 0, drawn(view, 1))
    assert result.fix is None
    assert result.report.outcome in {"not_found", "no_pose"}  # by the votes, or by the fit of the best of many places


def test_empty_ground_is_refused_and_every_outline_has_its_line() -> None:
    view = look_at(MARKS, np.array([0.0, 0.0, -40.0]), shown=())
    result = pipeline(MARKS).process(view.left, view.right, 0, drawn(view, 1))
    assert result.fix is None
    assert result.report.outcome == "not_found"
    assert {r.landmark for r in result.regions} == {"0", "1", "2"}
    assert all(r.reason for r in result.regions)


def test_a_row_of_equal_houses_is_ambiguous_unless_the_prior_decides() -> None:
    """Houses 9 m apart beyond both borders: with a prior of 3 m there are two places, with one of 0.7 m one."""
    row = tuple(house(f"r{k}", (0.0, 9.0 * k), 0.0) for k in range(-6, 7))
    view = look_at(row, np.array([0.0, 1.0, -40.0]))
    wide = pipeline(row).process(view.left, view.right, 0, drawn(view, 3))
    assert (wide.fix, wide.report.outcome) == (None, "ambiguous")
    narrow = SIGMA * np.array([0.23, 0.23, 0.5, 1.0, 1.0, 0.5])
    decided = pipeline(row).process(view.left, view.right, 0, drawn(view, 3, narrow))
    assert decided.pose is not None
    assert np.linalg.norm(decided.pose.joint_p_n - view.p_n) < 1.5  # the next house is 9 m away


def test_a_prior_that_is_too_wide_goes_to_segmentation_and_reports_it() -> None:
    view = whole()
    wide = drawn(view, 1, SIGMA * np.array([8.0, 8.0, 1.0, 1.0, 1.0, 1.0]))
    auto = LandmarkPipeline(RIG, LandmarkMap.from_landmarks(ORIGIN, MARKS), PipelineConfig())
    result = auto.process(view.left, view.right, 0, wide)
    assert "regions identified" in result.report.detail


def test_a_prior_that_is_a_little_wider_than_the_search_is_searched_as_far_as_it_goes() -> None:
    """3 sigma are 195 px, the search ends at 160: 2 sigma lie within."""
    view = whole()
    wide = drawn(view, 1, SIGMA * np.array([1.3, 1.3, 1.0, 1.0, 1.0, 1.0]))
    auto = LandmarkPipeline(RIG, LandmarkMap.from_landmarks(ORIGIN, MARKS), PipelineConfig())
    result = auto.process(view.left, view.right, 0, wide)
    assert_right(result, view)
    assert ("predicted" in result.report.detail, "regions identified" in result.report.detail) == (True, False)


def test_auto_is_predict_where_the_prior_is_good() -> None:
    view = whole()
    auto = LandmarkPipeline(RIG, LandmarkMap.from_landmarks(ORIGIN, MARKS), PipelineConfig())
    only = pipeline(MARKS)
    a, b = (p.process(view.left, view.right, 0, drawn(view, 1)) for p in (auto, only))
    assert a.fix is not None
    assert b.fix is not None
    assert a.fix.p_n == b.fix.p_n
    alone = LandmarkPipeline(RIG, LandmarkMap.from_landmarks(ORIGIN, MARKS), PipelineConfig(path="segment"))
    said = alone.process(view.left, view.right, 0, drawn(view, 1)).report.detail
    assert ("regions identified" in said, "regions identified" in a.report.detail) == (True, False)


@pytest.mark.parametrize("kind", ["corner", "strip"])
def test_auto_predicts_what_is_larger_than_the_image(kind: str) -> None:
    """One corner of a roof as wide as the image; a strip whose corners lie 200 m aside, almost next to the camera."""
    view = part_view(kind, 0)
    auto = LandmarkPipeline(view.rig, LandmarkMap.from_landmarks(ORIGIN, view.landmarks), PipelineConfig())
    result = auto.process(*view.images, 0, view.prior)
    if result.report.outcome == "waiting":
        result = auto.process(*view.images, 1_000_000_000, view.prior)
    assert "predicted" in result.report.detail
    assert result.fix is not None
    assert result.pose is not None
    e = view.p_n - result.pose.joint_p_n
    assert e @ np.linalg.solve(result.pose.joint_covariance[:3, :3], e) < CHI2_9999_OF_3


def test_what_is_left_open_is_counted_where_the_image_is() -> None:
    """A corner of a large roof moves as the image does, not as the roof's middle far outside."""
    view = part_view("corner", 0)
    eye = eyes(view.rig)[0]
    move = motion(eye, view.landmarks, view.prior)
    assert move is not None
    assert eye.camera.contains(move.middle[None])[0]


def test_grey_images_with_a_map_of_colours() -> None:
    """What a colour looks like to a camera without any is not known: it must not count against the right place."""
    view = whole()
    red = tuple(msgspec.structs.replace(m, colour_bgr=(30, 30, 220)) for m in MARKS)
    grey = [np.ascontiguousarray(image[:, :, 1]) for image in (view.left, view.right)]
    assert_right(pipeline(red).process(grey[0], grey[1], 0, drawn(view, 1)), view)


def doubting(path: Literal["auto", "predict"] = "predict") -> LandmarkPipeline:
    """To which every place is a weak one, and all outlines together say nothing."""
    config = PipelineConfig(path=path)
    verify = msgspec.structs.replace(config.predict.verify, score_px=1e6)
    predict = msgspec.structs.replace(config.predict, verify=verify, most_together=2)
    return LandmarkPipeline(RIG, LandmarkMap.from_landmarks(ORIGIN, MARKS), msgspec.structs.replace(config, predict=predict))


ON = np.array([1.0, 0.5, 0.0])


@cache
def farther_on() -> View:
    """The same place, seen from a metre farther on."""
    return look_at(MARKS, np.array([0.0, 0.0, -40.0]) + ON)


def test_little_to_be_seen_waits_for_an_image_from_elsewhere_that_agrees() -> None:
    """The same view says the same again, which is nothing new."""
    view, later, one, late = whole(), farther_on(), doubting(), doubting()
    prior = drawn(view, 1, 0.3 * SIGMA)
    first, second = (one.process(view.left, view.right, k * 10**8, prior) for k in (1, 2))
    assert [(said.fix, said.report.outcome) for said in (first, second)] == [(None, "waiting")] * 2
    assert "from the same viewpoint" in second.report.detail
    assert_right(one.process(later.left, later.right, 3 * 10**8, replace(prior, p_n=prior.p_n + ON)), later)
    assert [late.process(view.left, view.right, t, prior).fix for t in (10**8, 10 * 10**9)] == [None, None]


def test_a_likely_position_is_not_overruled_by_segmentation() -> None:
    """From a prior so wide that segmentation is asked where nothing was found."""
    view = whole()
    assert doubting("auto").process(view.left, view.right, 0, drawn(view, 1)).report.outcome == "waiting"


def test_a_position_that_does_not_agree_with_the_one_before_waits_on() -> None:
    """The prior moved by a metre and a half between the images, the vehicle did not: the two places say different errors."""
    view, later, one = whole(), farther_on(), doubting()
    prior = drawn(view, 1)
    other = replace(prior, p_n=prior.p_n + np.array([1.5, 0.0, 0.0]))
    assert one.process(view.left, view.right, 10**8, prior).report.outcome == "waiting"
    assert one.process(view.left, view.right, 2 * 10**8, other).report.outcome == "waiting"
    assert_right(one.process(later.left, later.right, 3 * 10**8, replace(other, p_n=other.p_n + ON)), later)


def test_a_certain_position_that_does_not_agree_with_the_weak_one_before_waits_too() -> None:
    """One of the two is wrong: here the second, since its prior moved and the vehicle did not."""
    view, weak, sure = whole(), doubting(), pipeline(MARKS)
    prior = drawn(view, 1)
    other = replace(prior, p_n=prior.p_n + np.array([1.5, 0.0, 0.0]))
    sure._predict._waiting = weak._predict._waiting
    for then, outcome in ((other, "waiting"), (prior, "fixed")):
        weak.process(view.left, view.right, 10**8, prior)
        assert sure.process(view.left, view.right, 2 * 10**8, then).report.outcome == outcome


def test_swapped_images_give_no_fix() -> None:
    view = look_at(MARKS, np.array([0.0, 0.0, -25.0]))
    narrow = drawn(view, 1, 0.3 * SIGMA)
    result = pipeline(MARKS).process(view.right, view.left, 0, narrow)
    assert (result.fix, result.report.outcome) == (None, "no_pose")
    assert_right(pipeline(MARKS).process(view.left, view.right, 0, narrow), view)


def test_a_right_image_of_another_moment_is_not_used() -> None:
    view, later = whole(), look_at(MARKS, np.array([0.6, 0.3, -40.0]))
    result = pipeline(MARKS).process(view.left, later.right, 0, drawn(view, 1))
    if result.fix is not None:
        assert "right camera not used" in result.report.detail
        assert_right(result, view)


def test_the_same_requests_give_the_same_bytes() -> None:
    view = whole()
    requests = [(k * 10**8, drawn(view, k)) for k in range(1, 4)]
    runs = [[one.process(view.left, view.right, *request) for request in requests] for one in (pipeline(MARKS), pipeline(MARKS))]
    for a, b in zip(*runs, strict=True):
        assert a.report.detail == b.report.detail
        assert a.report.similarities == b.report.similarities
        assert a.fix is not None
        assert b.fix is not None
        assert a.fix.p_n == b.fix.p_n
        np.testing.assert_array_equal(a.fix.covariance, b.fix.covariance)


def test_unknown_fields_are_refused() -> None:
    for text in ('{"paths": "auto"}', '{"predict": {"coarse": {"limit": 3}}}', '{"path": "guess"}'):
        with pytest.raises(msgspec.ValidationError):
            msgspec.json.decode(text, type=PipelineConfig)


def test_every_position_that_is_nearly_as_good_is_a_rival() -> None:
    """A row of equal houses and a prior that is one house off: two of four places are excluded by it, two are as likely."""
    view, (left, right), prior = decoy(91, 93, "row")
    result = pipeline(view.landmarks, view.rig).process(left, right, 0, prior)
    assert (result.fix, result.report.outcome) == (None, "ambiguous")


@pytest.mark.parametrize(("seed", "number", "kind"), [(1126, 29, "turned"), (1128, 53, "gone")])
def test_where_the_bare_ground_covers_half_of_one_roof_nothing_stands(seed: int, number: int, kind: str) -> None:
    """Another roof of which three sides lie on edges: the rest of the outline is on grass, in the next image as well."""
    view, images, prior = decoy(seed, number, kind)
    decoyed = pipeline(view.landmarks, view.rig)
    assert decoyed.process(*images, 1, prior).fix is None
    _, images, prior = later(view, prior)
    assert decoyed.process(*images, 500_000_001, prior).fix is None


@pytest.mark.parametrize(("number", "kind"), [(15, "gone"), (23, "shifted"), (26, "shifted")])
def test_a_position_of_chance_is_no_fix_by_its_odds(number: int, kind: str) -> None:
    """Ground where nothing of the map stands. Odds apart, two images that agree make a fix of it, 6 to 35 m off and sure."""
    view, images, prior = decoy(95, number, kind)
    moved, then, later_prior = later(view, prior)
    blind = PipelineConfig(
        path="predict", predict=PredictConfig(verify=VerifyConfig(odds=-1e3, weak_odds=-1e3, both_odds=-1e3, decides=1e-9))
    )
    wrong = []
    for config in (PipelineConfig(path="predict"), blind):
        looking = LandmarkPipeline(view.rig, LandmarkMap.from_landmarks(ORIGIN, view.landmarks), config)
        first, second = looking.process(*images, 1, prior), looking.process(*then, 500_000_001, later_prior)
        outcomes = (found_of(view, first.pose), found_of(moved, second.pose))
        assert config is blind or first.fix is None
        wrong.append(any(one.wrong for one in outcomes))
    assert wrong == [False, True]


@pytest.mark.parametrize(("kind", "number"), [("shifted", 71)])
def test_one_landmark_seen_twice_is_not_confirmed_by_that(kind: str, number: int) -> None:
    """Odds of 3.5 and 2.9, 2.8 and 4.0, of one roof that lies on something else in both images, 20 and 8 m off."""
    view, images, prior = decoy(101, number, kind)
    moved, then, later_prior = later(view, prior)
    wrong = []
    for both_odds in (7.0, 4.0):
        config = PipelineConfig(path="predict", predict=PredictConfig(verify=VerifyConfig(both_odds=both_odds)))
        looking = LandmarkPipeline(view.rig, LandmarkMap.from_landmarks(ORIGIN, view.landmarks), config)
        first, second = looking.process(*images, 1, prior), looking.process(*then, 500_000_001, later_prior)
        assert (first.fix, first.report.outcome) == (None, "waiting")
        wrong.append(second.fix is not None and found_of(moved, second.pose).error_m > 5.0)
    assert wrong == [False, True]


@pytest.mark.parametrize(("decides_alike", "outcome"), [(6.6, "ambiguous"), (0.1, "fixed")])
def test_in_a_row_one_house_more_in_view_does_not_decide(decides_alike: float, outcome: str) -> None:
    """Fifteen equal houses, and a prior one house off. There all of ten stand, at the true place nine: the tenth is cut."""
    view, images, prior = decoy(98, 15, "row")
    looking = PredictPath(view.rig, PredictConfig(verify=VerifyConfig(decides_alike=decides_alike)), PoseConfig(), 0.1)
    both = usable(*images, view.rig)
    assert isinstance(both, Images)
    moves = looking.moves(both, view.landmarks, prior)
    assert moves is not None
    result = looking.locate(both, *moves, 1, prior)
    assert result.report.outcome == outcome
    assert result.pose is None or np.linalg.norm(result.pose.joint_p_n - view.p_n) > 5.0


def test_a_row_that_goes_on_in_the_map_is_no_position_however_many_of_it_are_found() -> None:
    """The prior is a house and 3.3 sigma off: the search meets a place two houses off, where all seven in view stand."""
    view, images, prior = decoy(203, 89, "row")
    looking = PredictPath(view.rig, PredictConfig(), PoseConfig(), 0.1)
    both = usable(*images, view.rig)
    assert isinstance(both, Images)
    moves = looking.moves(both, view.landmarks, prior)
    assert moves is not None
    found = looking.locate(both, *moves, 1, prior)
    assert found.pose is not None
    assert np.linalg.norm(found.pose.joint_p_n - view.p_n) > 20.0
    assert len(found.pose.shift_m) == 7
    landmarks = LandmarkMap.from_landmarks(ORIGIN, view.landmarks)
    whole = LandmarkPipeline(view.rig, landmarks, PipelineConfig(path="predict")).process(*images, 1, prior)
    assert (whole.fix, whole.report.outcome) == (None, "ambiguous")


@pytest.mark.parametrize("number", [43, 87])
def test_of_two_that_look_alike_both_seen_the_next_position_would_lack_one(number: int) -> None:
    """The prior reaches the place a step off; the image does not show there what the map has there."""
    view = draw_view(98, number)
    images, prior = images_of(view), prior_of(view, PRIOR_PX, 160.0)
    result = pipeline(view.landmarks, view.rig).process(*images, 1, prior)
    assert result.pose is not None, result.report
    assert not found_of(view, result.pose).wrong
    marks = list(view.landmarks)
    alike = steps_off(result.pose.joint_p_n, marks, marks, prior.p_n, prior.covariance, 1e3, 1.0 / 3.0)
    assert len(alike) > 0


def test_a_green_roof_on_a_meadow_is_not_fitted_to_the_rim_of_its_shadow() -> None:
    """Roof and shadow have as little red, by which roof and meadow differ: 3.7 m off, sure to 0.4 m, if nothing else is asked."""
    view = draw_view(32, 214)
    images = render_pair(view.world, view.true_rig, view.p_n, view.R_nb, view.conditions, view.rng)
    looking = LandmarkPipeline(view.rig, LandmarkMap.from_landmarks(ORIGIN, view.landmarks), PipelineConfig(path="predict"))
    result = looking.process(*images, 1, view.prior)
    assert result.pose is not None
    e = view.p_n - result.pose.joint_p_n
    assert e @ np.linalg.solve(result.pose.joint_covariance[:3, :3], e) < CHI2_9999_OF_3
    assert np.linalg.norm(e) < 2.0
