"""The final check: which landmarks lie where a fit says, and whether the two images say the same."""

from dataclasses import replace

import numpy as np
import pytest

from models.maps.landmarks import Landmark
from tests.vision.predict.test_predict import MARKS, RIG, drawn, under_a_sheet, whole
from vision.pose.observation import ObservationConfig
from vision.pose.pose import PoseEstimate, estimate_pose
from vision.pose.sensitivity import eyes
from vision.predict.final_check import final_check


def fitted() -> PoseEstimate:
    view = whole()
    fit = estimate_pose(RIG, (view.left, view.right), MARKS, (view.p_n, view.R_nb), drawn(view, 1))
    assert isinstance(fit, PoseEstimate)
    return fit


def test_roofs_that_were_fitted_lie_where_the_fit_reports_in_both_images() -> None:
    view = whole()
    seen = final_check(RIG, (view.left, view.right), MARKS, fitted(), ObservationConfig())
    assert seen.share.min() > 0.7
    assert min(seen.images) > 0.75
    assert seen.apart is not None
    assert abs(seen.apart[0]) < 0.3
    assert abs(seen.apart[1]) < 0.3


def test_a_landmark_some_pixels_aside_is_not_where_the_fit_reports() -> None:
    """0.35 m are 5 px: beyond 2.5 px, within the look's 8 px."""
    view, fit = whole(), fitted()
    moved = Landmark.of("0", MARKS[0].outline_n + np.array([0.25, 0.25]), 0.0, 3.0)
    seen = final_check(RIG, (view.left, view.right), (moved, *MARKS[1:]), fit, ObservationConfig())
    assert seen.share[0] < 0.5
    assert seen.share[1:].min() > 0.7


def test_walls_that_do_not_end_where_the_map_reports_speak_against_a_landmark() -> None:
    """The same roof on walls 3 m longer, as that of another house: the roof lies on edges, its feet and corners do not."""
    view, fit = whole(), fitted()
    for k in (1, 2):  # the first one is seen from above
        taller = Landmark.of("taller", MARKS[k].outline_n, 3.0, MARKS[k].height_m + 3.0)
        others = (*MARKS[:k], taller, *MARKS[k + 1 :])
        present, instead = (
            final_check(RIG, (view.left, view.right), marks, fit, ObservationConfig()).present for marks in (MARKS, others)
        )
        assert present[k] > 4.0 * np.log(9.0)  # what four sides of the roof say at most
        assert instead[k] < present[k] - 2.0
        np.testing.assert_array_equal(np.delete(present, k), np.delete(instead, k))


@pytest.mark.parametrize(
    ("aside_m", "sigma_m", "found"),
    [(0.22, 0.0, False), (0.22, 0.1, True)],
    ids=["not the edge that was fitted", "as far as the map may be off"],
)
def test_an_edge_may_be_as_far_off_as_the_map(aside_m: float, sigma_m: float, found: bool) -> None:
    """0.22 m are 3.3 px across each edge: beyond 2.5, within (2.5^2 + (2 x 1.5)^2)^(1/2) = 3.9."""
    view, fit = whole(), fitted()
    c, s = np.cos(0.3), np.sin(0.3)  # along both sides of the house alike
    aside = aside_m * np.array([c - s, s + c])
    moved = Landmark.of("0", MARKS[0].outline_n + aside, 0.0, 3.0, None, 0.0, 0.0, sigma_m)
    seen = final_check(RIG, (view.left, view.right), (moved, *MARKS[1:]), fit, ObservationConfig())
    assert bool(seen.share[0] > 0.6) is found
    assert found or seen.share[0] < 0.5


@pytest.mark.parametrize(("over", "asked"), [((0, 1), False), ((0,), True)], ids=["in both images", "in one"])
def test_what_something_covers_in_both_images_is_not_asked(over: tuple[int, ...], asked: bool) -> None:
    """A sheet over a corner of a roof hides half of the rim, and the ends of what is left of its sides."""
    view, fit, images = whole(), fitted(), [whole().left, whole().right]
    for k in over:
        images[k] = under_a_sheet(images[k], eyes(RIG)[k], view)
    seen = final_check(RIG, (images[0], images[1]), MARKS, fit, ObservationConfig())
    assert seen.share[1:].min() > 0.7
    assert asked or seen.share[0] > 0.55  # 0.46 of all
    assert bool(seen.images[1] - seen.images[0] > 0.1) is asked
    assert seen.covered < 0.03 if asked else 0.05 < seen.covered < 0.25  # half of one roof's rim in three


@pytest.mark.parametrize(("du", "dv"), [(3, 0), (0, 2), (-2, -3)])
def test_a_shift_of_the_right_image_is_measured(du: int, dv: int) -> None:
    view = whole()
    shifted = np.ascontiguousarray(np.roll(view.right, (dv, du), axis=(0, 1)))
    seen = final_check(RIG, (view.left, shifted), MARKS, fitted(), ObservationConfig())
    assert seen.apart is not None
    np.testing.assert_allclose(seen.apart[:2], (du, dv), atol=0.5)
    assert 0.0 < seen.apart[2] < 0.6


def test_one_image_has_nothing_to_differ_from() -> None:
    view = whole()
    seen = final_check(RIG, (view.left, None), MARKS, replace(fitted()), ObservationConfig())
    assert seen.apart is None
    assert len(seen.images) == 1
