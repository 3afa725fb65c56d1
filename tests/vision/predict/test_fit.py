"""From a place of the coarse search to a fit."""

import math
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from models.so3 import from_matrix, matrix, multiply, quat_exp
from tests.vision.predict.test_predict import MARKS, RIG, View, drawn, look_at, whole
from vision.outline.visibility import MapError
from vision.pose.observation import ObservationConfig
from vision.pose.pose import NoPose, PoseConfig, PoseEstimate, estimate_pose, retract
from vision.pose.sensitivity import eyes
from vision.predict import fit as fits
from vision.predict.coarse_search import Candidate
from vision.predict.final_check import FinalCheck, final_check
from vision.predict.fit import Fitter
from vision.predict.verify import Evidence, Fitted, VerifyConfig, Waiting, decided, grade, position_odds
from vision.records.images import Images
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.render import render_pair
from vision.synthetic.world import Appearance, Solid, Sun, World


def position(view: View, marks: tuple[Landmark, ...], east_m: float = 0.0) -> Candidate:
    """The true pose, where the search thinks that every landmark is off the map by east_m."""
    shift_m, length = np.zeros((len(marks), len(MapError))), np.full(len(marks), 100.0)
    shift_m[:, MapError.EAST] = east_m
    return Candidate(view.p_n, view.R_nb, np.zeros(6), shift_m, 0.5 * length, length, 100.0)


def fitted(view: View, marks: tuple[Landmark, ...], east_m: float = 0.0) -> Fitted:
    fitter = Fitter(RIG, PoseConfig(), VerifyConfig(), 6, 0.1)
    fit = fitter.fit(Images(view.left, view.right, ""), list(marks), position(view, marks, east_m), drawn(view, 1))
    assert isinstance(fit, Fitted)
    return fit


def test_one_pose_from_two_positions_is_one() -> None:
    """Where landmarks are off the map by what the search thought of them does not tell two poses apart."""
    tried = [fitted(whole(), MARKS, east_m) for east_m in (0.0, 0.15)]
    assert isinstance(decided(tried, VerifyConfig(moved_px=2.0)), Fitted)


@pytest.mark.parametrize(("apart_m", "odds", "accepted"), [(0.0, 1.0, True), (5.0, 1.0, False), (5.0, -2.0, True)])
def test_of_two_positions_one_must_be_much_likelier(apart_m: float, odds: float, accepted: bool) -> None:
    best = replace(fitted(whole(), MARKS), odds=2.0)
    outcome = decided([elsewhere(best, apart_m, odds), best], VerifyConfig())
    assert outcome is best if accepted else "another position, 106 px off" in str(outcome)


@pytest.mark.parametrize(
    ("likelier", "odds", "accepted"), [(39.3, 36.3, False), (39.3, 32.0, True), (8.0, 4.9, True), (8.0, 5.1, False)]
)
def test_one_landmark_does_not_decide_between_positions_that_would_be_accepted(
    likelier: float, odds: float, accepted: bool
) -> None:
    """In a row of equal houses the place one house on has one more of them in view, or one less, and all of them stand."""
    best = replace(fitted(whole(), MARKS), odds=likelier)
    assert (decided([elsewhere(best, 11.0, odds), best], VerifyConfig()) is best) is accepted


@pytest.mark.parametrize(("apart_m", "kept"), [(0.01, 0.6), (0.5, 0.9)])
def test_one_fit_from_two_positions_has_kept_what_the_least_has(apart_m: float, kept: float) -> None:
    best = replace(fitted(whole(), MARKS), odds=4.5, kept=0.9)
    outcome = decided([replace(elsewhere(best, apart_m, 4.2), kept=0.6), best], VerifyConfig())
    assert isinstance(outcome, Fitted)
    assert outcome.kept == kept


def elsewhere(fit: Fitted, apart_m: float, odds: float) -> Fitted:
    """The same fit, so far east."""
    pose = replace(fit.pose, joint_p_n=fit.pose.joint_p_n + np.array([0.0, apart_m, 0.0]))
    return replace(fit, pose=pose, odds=odds, middles=fit.middles + apart_m * RIG.left.fx / 40.0)


@pytest.mark.parametrize(("sigma_m", "accepted"), [(1.5, True), (0.3, False)])
def test_two_fits_that_leave_open_what_is_between_them_are_one_position(sigma_m: float, accepted: bool) -> None:
    """4 m, 85 px apart: less than 4.1 of (2 x 1.5^2)^(1/2) m, more than that of 0.3 m."""
    best = replace(fitted(whole(), MARKS), odds=2.0)
    best = replace(best, pose=replace(best.pose, joint_covariance=np.diag([sigma_m**2] * 3 + [1e-4] * 3)))
    assert (decided([elsewhere(best, 4.0, 1.0), best], VerifyConfig()) is best) is accepted


@pytest.mark.parametrize(("odds", "apart_m", "accepted"), [(5.1, 0.1, True), (4.4, 0.1, False), (5.1, 5.0, False)])
def test_of_fits_of_one_position_the_most_certain_one_is_taken(odds: float, apart_m: float, accepted: bool) -> None:
    """Less likely by 2.3 at most, and not elsewhere: a landmark more adds information on the pose, and is as right."""
    sure = replace(fitted(whole(), MARKS), odds=odds)
    vague = replace(elsewhere(sure, apart_m, 7.0), pose=replace(sure.pose, joint_covariance=4.0 * sure.pose.joint_covariance))
    vague = replace(vague, pose=replace(vague.pose, joint_p_n=sure.pose.joint_p_n + np.array([0.0, apart_m, 0.0])))
    outcome = decided([vague, sure], VerifyConfig(decides=2.3))
    assert (outcome is sure) is accepted
    assert isinstance(outcome, Fitted) is (apart_m < 1.0)


def test_a_direction_that_the_likeliest_fit_leaves_open_needs_a_likelier_fit() -> None:
    """Along a road every position is the same one; the corner of something else at one of them does not choose among them."""
    corner = replace(fitted(whole(), MARKS), odds=6.3)
    vague = 4.0 * corner.pose.joint_covariance
    pose = replace(corner.pose, directions=np.eye(6)[:5], readings=np.zeros(5), joint_covariance=vague)
    road = replace(corner, odds=6.8, pose=pose)
    assert decided([corner, road], VerifyConfig()) is road
    likelier = replace(corner, odds=7.0)
    assert decided([likelier, road], VerifyConfig()) is likelier


def test_odds_of_a_position_by_hand() -> None:
    """One landmark that stands, 20 to 1, one without evidence, one that is gone for sure; two sigma off; 60 % found."""
    there = np.log(0.9 * 20.0 + 0.1) + 0.0 + np.log(0.1)
    shown = 0.6 * np.log(0.75 / 0.45) + 0.4 * np.log(0.25 / 0.55)
    odds = position_odds(np.array([np.log(20.0), 0.0, -800.0]), 0.1, 4.0, 0.6, 0.25)
    assert odds == pytest.approx((there - 2.0) / 3.0 + 12.0 * shown - 4.0, abs=1e-12)
    assert np.isfinite(position_odds(np.array([800.0]), 0.1, 0.0, 1.0, 0.0))


@pytest.mark.parametrize(("chosen", "less"), [([0], 4.0), ([0, 1, 2], 0.0)], ids=["alone", "next to others"])
def test_what_covers_one_roof_alone_may_be_the_bare_ground(chosen: list[int], less: float) -> None:
    view, prior = whole(), drawn(whole(), 1)
    some, views = [MARKS[k] for k in chosen], (view.left, view.right)
    fit = estimate_pose(RIG, views, some, (view.p_n, view.R_nb), prior)
    assert isinstance(fit, PoseEstimate)
    seen = final_check(RIG, views, some, fit, ObservationConfig())
    fitter = Fitter(RIG, PoseConfig(), VerifyConfig(), 6, 0.1)
    bare, covered = (
        fitter._odds(views, list(MARKS), position(view, MARKS), chosen, fit, replace(seen, covered=h), prior) for h in (0.0, 0.25)
    )
    assert bare - covered == pytest.approx(less)


@pytest.mark.parametrize(
    ("odds", "checked", "expected"),
    [(1.9, 1.0, "refused"), (2.1, 1.0, "weak"), (4.9, 1.0, "weak"), (5.1, 1.0, "sure"), (11.9, 0.7, "weak"), (12.1, 0.7, "sure")],
)
def test_how_far_a_fit_is_accepted_follows_from_its_odds(odds: float, checked: float, expected: str) -> None:
    """Above 12 however little of the outlines is found."""
    fit = replace(fitted(whole(), MARKS), odds=odds, checked=checked)
    assert grade(Evidence(100.0, 0.5, 1.0, 0.0), fit, VerifyConfig())[0] == expected


@pytest.mark.parametrize(("seen", "kept"), [((0,), 1 / 3), ((0, 1), 1.0), ((0, 1, 2), 1.0)])
def test_one_landmark_alone_answers_for_those_that_have_no_votes(seen: tuple[int, ...], kept: float) -> None:
    """By chance one outline lies on edges somewhere in what is searched, but not two as far apart as on the map."""
    view = whole()
    at, support = position(view, MARKS), np.zeros(len(MARKS))
    support[list(seen)] = 50.0
    fitter = Fitter(RIG, PoseConfig(), VerifyConfig(), 6, 0.1)
    fit = fitter.fit(Images(view.left, view.right, ""), list(MARKS), replace(at, support=support), drawn(view, 1))
    assert isinstance(fit, Fitted)
    assert fit.used == list(seen)
    assert fit.kept == pytest.approx(kept)


def on_the_ground(view: View, px: list[tuple[float, float]]) -> Array:
    """Where sights of the left camera meet the ground (K, 2)."""
    p_nk, R_nk = eyes(RIG)[0].pose(view.p_n, view.R_nb)
    ray = RIG.left.ray(np.array(px)) @ R_nk.T
    return np.asarray((p_nk - ray * (p_nk[2] / ray[:, 2:]))[:, :2])


def test_one_side_on_a_kerb_is_no_landmark() -> None:
    """Of a roof at the border one side is in view. Where it is gone a concrete slab has its edge there: it is not the roof."""
    view = whole()
    gone = Landmark.of("3", on_the_ground(view, [(760, 150), (624, 150), (624, 330), (760, 330)]), 0.0, 0.0, None, 0.1, 0.0, 0.05)
    slab = Solid(on_the_ground(view, [(760, 60), (624, 60), (624, 420), (760, 420)]), 0.0, 0.0, Appearance((165.0, 170.0, 172.0)))
    looks = tuple(Appearance((120.0, 128.0, 134.0), texture="shingles", contrast=0.1) for _ in MARKS)
    rng, marks = np.random.default_rng(3), (*MARKS, gone)
    for present, used in ((False, [0, 1, 2]), (True, [0, 1, 2, 3])):
        looks_of = (*looks, Appearance((40.0, 60.0, 190.0))) if present else looks
        clutter = () if present else (slab,)
        world = World(marks if present else MARKS, looks_of, clutter, Ground.procedural(np.random.default_rng(3)), Sun(0.8))
        pair = render_pair(world, RIG, view.p_n, view.R_nb, Conditions(), rng)
        assert fitted(View(*pair, view.p_n, view.R_nb, marks), marks).used == used


@pytest.mark.parametrize(("grown_m", "joins"), [(0.6, True), (0.0, True), (None, False)])
def test_a_roof_larger_than_mapped_joins_once_the_others_tell_the_pose(grown_m: float | None, joins: bool) -> None:
    """Its sides are out of the first window's reach. One that is gone does not join, whatever its outline lies on."""
    middle, outline = np.array(MARKS[2].centre_n), MARKS[2].outline_n
    rough = msgspec.structs.replace(MARKS[2], outline_sigma_m=0.3)
    marks, present = (*MARKS[:2], rough), MARKS[:2]
    if grown_m is not None:
        axes = np.linalg.svd(outline - middle)[2]
        sides = (outline - middle) @ axes.T
        present = (*present, msgspec.structs.replace(rough, outline_n=middle + (sides + grown_m * np.sign(sides)) @ axes))
    view = look_at(marks, np.array([0.0, 0.0, -40.0]), shown=present)
    fitter, images, prior = (
        Fitter(RIG, PoseConfig(), VerifyConfig(), 2, 0.1),
        Images(view.left, view.right, ""),
        drawn(view, 1),
    )
    at, some = position(view, marks), list(marks)
    at.support[2] = 25.0  # fewer votes than the others: not in the first fit
    first = fitter.fit(images, some, at, prior)
    assert isinstance(first, Fitted)
    again = fitter.joined(images, some, at, first, prior)
    assert (first.used, again.used) == ([0, 1], [0, 1, 2] if joins else [0, 1])
    if grown_m is not None:
        assert again.pose.shift_m[2, MapError.GROWTH] == pytest.approx(grown_m, abs=0.1)


@pytest.mark.parametrize("found", [True, False])
def test_what_is_left_is_fitted_from_the_fit_before(found: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of three is mapped aside and goes; without it nothing has to be searched again, unless there is no fit so."""
    view, searched = whole(), list[tuple[int, tuple[int, ...]]]()

    def noted(*args: Any) -> PoseEstimate | NoPose:
        searched.append((len(args[2]), args[5].observation.search_px))
        return estimate_pose(*args) if found or args[5].observation.search_px else NoPose("not_found")

    monkeypatch.setattr(fits, "estimate_pose", noted)
    fit = fitted(view, (*MARKS[:2], aside(MARKS[2], (0.0, 2.0))))
    assert fit.used == [0, 1]
    assert searched == [(3, (8, 8)), (2, ()), *([] if found else [(2, (8, 8))])]
    assert np.linalg.norm(fit.pose.joint_p_n - view.p_n) < 0.5


def test_where_all_together_contradict_each_other_one_determines_the_position() -> None:
    """Two of three are mapped 2 m aside, each its own way."""
    view = whole()
    moved = (MARKS[0], aside(MARKS[1], (0.0, 2.0)), aside(MARKS[2], (2.0, 0.0)))
    fitter, images = Fitter(RIG, PoseConfig(), VerifyConfig(), 6, 0.1), Images(view.left, view.right, "")
    at, prior = position(view, moved), drawn(view, 1)
    assert isinstance(fitter.fit(images, list(moved), at, prior), str)
    one = fitter.fit_one(images, list(moved), at, prior)
    assert isinstance(one, Fitted)
    assert one.used == [0]
    assert np.linalg.norm(one.pose.joint_p_n - view.p_n) < 0.5


def aside(mark: Landmark, by: tuple[float, float]) -> Landmark:
    return Landmark.of(
        mark.id, mark.outline_n + by, mark.base_d, mark.height_m, None, mark.sigma_m, mark.height_sigma_m, mark.outline_sigma_m
    )


def test_the_second_round_begins_where_all_that_was_found_puts_the_pose() -> None:
    """From one landmark alone, 2 m too high and tilted so that it lies where it shows: the others are ten pixels off."""
    view = whole()
    fitter, images = Fitter(RIG, PoseConfig(), VerifyConfig(), 6, 0.1), Images(view.left, view.right, "")
    at, votes, prior = position(view, MARKS), np.zeros(len(MARKS)), drawn(view, 1)
    votes[0] = 50.0
    one = fitter.fit(images, list(MARKS), replace(at, support=votes), prior)
    assert isinstance(one, Fitted)
    open_to = 9.0 * one.pose.joint_covariance
    variance, axes = np.linalg.eigh(open_to)
    p_n, R_nb = retract(one.pose.joint_p_n, from_matrix(one.pose.joint_R_nb), 3.0 * np.sqrt(variance[-3]) * axes[:, -3])
    assert abs(p_n[2] - view.p_n[2]) > 1.5
    off = replace(one, pose=replace(one.pose, joint_p_n=p_n, joint_R_nb=R_nb, joint_covariance=open_to))
    again = fitter.joined(images, list(MARKS), replace(at, p_n=p_n, R_nb=R_nb), off, prior)
    assert again.used == [0, 1, 2]
    assert np.linalg.norm(again.pose.joint_p_n - view.p_n) < 0.5


@pytest.mark.parametrize(
    ("share", "present", "used"),
    [(0.6, 2.5, True), (0.6, 2.3, False), (0.4, 4.8, True), (0.4, 4.6, False), (0.0, 7.1, True), (0.0, 6.9, False)],
)
def test_the_less_the_final_check_finds_the_more_certain_a_landmark_must_be(share: float, present: float, used: bool) -> None:
    """99, 99.9 and 99.99 %, with one of ten gone: 4.6, 6.9 and 9.2 less ln 9."""
    fit = fitted(whole(), MARKS).pose
    seen = FinalCheck(np.full(len(MARKS), share), np.full(len(MARKS), present), (1.0, 1.0), 0.0, None)
    stood = Fitter(RIG, PoseConfig(), VerifyConfig(), 6, 0.1)._present(list(MARKS), fit, seen)
    assert stood.tolist() == [used] * len(MARKS)


ROOFS = np.array([[*mark.centre_n, mark.roof_d] for mark in MARKS])


def beside(prior: Prior, metres: float, turn_rad: float = 0.0) -> Prior:
    """The filter's estimate, moved north and turned about its own forward axis; its error stays."""
    q = multiply(prior.q_nb_wxyz, quat_exp(np.array([turn_rad, 0.0, 0.0])))
    return Prior(prior.p_n + np.array([metres, 0.0, 0.0]), q, prior.covariance)


def moved(fit: Fitted, metres: float, turn_rad: float = 0.0) -> Fitted:
    """The same error of the prior from there: a false match that repeats."""
    p_n, R_nb = fit.pose.joint_p_n, fit.pose.joint_R_nb @ matrix(quat_exp(np.array([turn_rad, 0.0, 0.0])))
    return replace(fit, pose=replace(fit.pose, joint_p_n=p_n + np.array([metres, 0.0, 0.0]), joint_R_nb=R_nb))


def test_an_image_that_is_processed_again_is_compared_with_the_image_before() -> None:
    """Where prediction finds nothing and segmentation then does; the image after one that showed nothing does not."""
    fit, prior, memory = fitted(whole(), MARKS), drawn(whole(), 1), Waiting(VerifyConfig())
    assert memory.doubt(fit, 1, prior, ROOFS, weak=True)
    memory.nothing(2)
    assert not memory.doubt(moved(fit, 3.0), 2, beside(prior, 3.0), ROOFS, weak=True)
    assert memory.holds(3, fit.odds)
    memory.nothing(3)
    assert not memory.holds(4, fit.odds)
    assert memory.doubt(fit, 4, prior, ROOFS, weak=True)


def test_a_false_match_that_repeats_while_hovering_confirms_nothing() -> None:
    """Ten images from a place that drifts by 6 cm, then one from 3 m farther on."""
    fit, prior, memory = fitted(whole(), MARKS), drawn(whole(), 1), Waiting(VerifyConfig())
    for k in range(10):
        drift = 0.03 * (k % 3)
        said = memory.doubt(moved(fit, drift), 1 + k * 100_000_000, beside(prior, drift), ROOFS, weak=True)
        assert said.endswith("one from elsewhere must agree" if k else "the next image must agree")
    assert not memory.doubt(moved(fit, 3.0), 1_100_000_000, beside(prior, 3.0), ROOFS, weak=True)


def test_a_turn_is_a_change_of_viewpoint() -> None:
    fit, prior = fitted(whole(), MARKS), drawn(whole(), 1)
    for degrees, confirms in ((0.3, False), (1.0, True)):
        memory, turn = Waiting(VerifyConfig()), math.radians(degrees)
        memory.doubt(fit, 1, prior, ROOFS, weak=True)
        assert bool(memory.doubt(moved(fit, 0.0, turn), 2, beside(prior, 0.0, turn), ROOFS, weak=True)) is not confirms


def test_what_is_sure_by_itself_needs_no_other_viewpoint() -> None:
    """Neither where the earlier image was sure, nor where this one is and only has to agree."""
    fit, prior = fitted(whole(), MARKS), drawn(whole(), 1)
    after_a_fix, after_a_doubt = Waiting(VerifyConfig()), Waiting(VerifyConfig())
    after_a_fix.fixed(fit, 1, prior)
    assert not after_a_fix.doubt(fit, 2, prior, ROOFS, weak=True)
    after_a_doubt.doubt(fit, 1, prior, ROOFS, weak=True)
    assert not after_a_doubt.doubt(fit, 2, prior, ROOFS, weak=False)


def test_a_much_likelier_position_does_not_wait_for_one_that_does() -> None:
    """Ten times, ln 10 = 2.3: as where two places in one image are compared."""
    fit, prior, memory = fitted(whole(), MARKS), drawn(whole(), 1), Waiting(VerifyConfig())
    memory.doubt(replace(fit, odds=4.0), 1, prior, ROOFS, weak=True)
    assert memory.holds(2, 6.2)
    assert not memory.holds(2, 6.4)


def test_a_fix_supports_a_weak_position_that_agrees_and_makes_none_wait() -> None:
    fit, prior, memory = fitted(whole(), MARKS), drawn(whole(), 1), Waiting(VerifyConfig())
    memory.fixed(fit, 1, prior)
    assert not memory.holds(2, fit.odds)
    assert not memory.doubt(fit, 2, prior, ROOFS, weak=True)
    memory.fixed(fit, 3, prior)
    assert memory.doubt(fit, 4, replace(prior, p_n=prior.p_n + np.array([1.5, 0.0, 0.0])), ROOFS, weak=True)
