"""What one look at an image takes for a landmark's colour."""

import math

import numpy as np
import pytest

from models.maps.landmarks import Landmark
from tests.vision.pose.test_pose import flight
from tests.vision.predict.test_predict import MARKS, RIG, under_a_sheet, whole
from tests.vision.roofs import nadir_rig
from vision.outline.profiles import profiles
from vision.pose.observation import ObservationConfig, Scene, _roof_beside
from vision.pose.sensitivity import eyes

POINTS, HALF = 20, 8


@pytest.mark.parametrize(("raised", "expected"), [(True, 120.0), (False, 100.0)])
def test_what_lies_farther_inside_is_the_other_slope_of_a_roof_but_other_paint_of_a_mark(raised: bool, expected: float) -> None:
    """Grey value 100 on ground of 60, and 120 within a rim of 10 px: a gable in other light, or the disc of a helipad."""
    image = np.full((200, 200, 3), 60, np.uint8)
    image[60:140, 60:140], image[70:130, 70:130] = 100, 120
    px = np.column_stack((np.full(POINTS, 60.0), np.linspace(85.0, 115.0, POINTS)))
    normal, usable, one = np.tile((-1.0, 0.0), (POINTS, 1)), np.ones(POINTS, dtype=np.bool_), np.ones(1, dtype=np.bool_)
    edge, landmark = np.zeros(POINTS, dtype=np.int64), np.zeros(1, dtype=np.int64)
    values = profiles(image, px, normal, HALF, 1.0, 1, usable)
    beside = _roof_beside(image, values, px, normal, edge, landmark, one, np.array([raised]), HALF, usable)
    np.testing.assert_allclose(beside, expected, atol=1.0)


def test_the_edge_of_a_painted_mark_in_a_shadow_is_its_edge_still() -> None:
    """White paint, 10 m wide, on grey ground, from 40 m; a shadow, 45 % of the light, lies over one edge and beyond it."""
    rig, R_nb = nadir_rig(), np.eye(3)
    p_n = np.array([0.0, 0.0, -40.0])
    mark = Landmark.of("pad", 5.0 * np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]), 0.0, 0.0)
    eye = eyes(rig)[0]
    p_nk, R_nk = eye.pose(p_n, R_nb)
    corners = eye.camera.project((np.column_stack((mark.outline_n, np.zeros(4))) - p_nk) @ R_nk)
    image = np.full((480, 640, 3), 90, np.uint8)
    left, top, right, bottom = (math.ceil(x) for x in (*corners.min(axis=0), *corners.max(axis=0)))
    image[top:bottom, left:right] = 200
    image[: top + 20] = (0.45 * image[: top + 20]).astype(np.uint8)
    seen = Scene(rig, (image, None), [mark]).observe(p_n, R_nb, np.zeros((1, 6)), rig, ObservationConfig(), farthest_px=2.5)
    assert seen.found.all()
    assert np.abs(seen.line[:, 0, 0]).max() < 0.6


def test_edges_farther_off_are_not_found_any_more() -> None:
    view = flight(1)
    scene, as_mapped = Scene(view.rig, view.images, view.landmarks), np.zeros((3, 6))
    seen = scene.observe(view.p_n, view.R_nb, as_mapped, view.rig, ObservationConfig(), farthest_px=2.5)
    off_px = np.zeros(seen.found.shape)
    off_px[np.argmax(seen.found[:, 1]), 1] = -1.6
    near = seen.within(off_px, 1.5)
    np.testing.assert_array_equal(near.found, seen.found & (off_px == 0.0))
    assert near.found.sum() == seen.found.sum() - 1
    assert seen.share - near.share == pytest.approx(seen.lines[1].points[np.argmax(seen.found[:, 1])] / seen.usable)
    assert seen.within(off_px, 1.6).share == seen.share
    gone = seen.samples.edge == np.argmax(seen.found[:, 1])
    assert not near.lines[1].weight[gone].any()
    assert not near.lines[1].gain[gone].any()
    np.testing.assert_array_equal(near.lines[1].weight[~gone], seen.lines[1].weight[~gone])
    np.testing.assert_array_equal(near.lines[0].square, seen.lines[0].square)
    assert near.lines[1].square.sum() < seen.lines[1].square.sum()


def test_a_search_does_not_ask_what_a_sheet_covers() -> None:
    """A sheet over a corner of a pale roof: a good part of the rim is not examined."""
    view = whole()
    covered = under_a_sheet(view.left, eyes(RIG)[0], view)
    whole_rim, rest = (
        Scene(RIG, (shown, None), MARKS[:1])
        .observe(view.p_n, view.R_nb, np.zeros((1, 6)), RIG, ObservationConfig(), search_px=8)
        .usable
        for shown in (view.left, covered)
    )
    assert rest < 0.9 * whole_rim
