"""The overlay on rendered images: lines lie where edges are seen, residuals are as large as the pose is wrong."""

import math
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from models.so3 import from_euler, matrix, quat_exp
from vision.show.overlay import (
    IDENTIFIED,
    MAPPED,
    RESIDUAL,
    Canvas,
    add_strip,
    draw_overlay,
    expected_px,
    in_view,
    outline_residuals,
)
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.render import render
from vision.synthetic.rigs import make_rig
from vision.synthetic.scenes import WorldSpec, make_world


class View(NamedTuple):
    image: Canvas
    rig: StereoRig
    p_nc: Array
    R_nc: Array
    landmarks: list[Landmark]


@pytest.fixture(scope="module")
def scene() -> View:
    """A painted village from 60 m, tilted a little."""
    made = make_world(3, WorldSpec(painted=1.0, flat=0.0, cars=0.0, trees=0.0, patches=0.0, rig=make_rig(exact=True)))
    p_n, R_nb = np.array([0.0, 0.0, -60.0]), matrix(from_euler(0.05, -0.03, 0.4))
    p_nc, R_nc = made.rig.camera_pose(p_n, R_nb)
    image = render(made.world, made.rig.left, p_nc, R_nc, Conditions(), np.random.default_rng(0))
    return View(image, made.rig, p_nc, R_nc, made.map.near(0.0, 0.0, 150.0))


def box(north: float, east: float, length: float = 12.0, width: float = 8.0, height: float = 4.0) -> Landmark:
    half = np.array([[length, width], [length, -width], [-length, -width], [-length, width]]) / 2
    return Landmark.of(f"{north:.0f},{east:.0f}", half + np.array([north, east]), 0.0, height)


CAMERA = CameraModel(640, 480, 500.0, 500.0, 319.5, 239.5)
NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # right is east, down in the image is south
ABOVE = np.array([0.0, 0.0, -50.0])


def test_a_true_map_from_a_true_pose_leaves_hundredths_of_a_pixel(scene: View) -> None:
    found = outline_residuals(scene.image, scene.rig.left, scene.p_nc, scene.R_nc, scene.landmarks)
    assert len(found) >= 5
    assert np.mean([residual.found for residual in found]) > 0.9
    spread = float(np.median([residual.spread_px for residual in found]))
    assert 0.005 < spread < 0.1
    for residual in found:
        mark = next(x for x in scene.landmarks if x.id == residual.id)
        corners = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        px = scene.rig.left.project((corners - scene.p_nc) @ scene.R_nc)
        assert np.linalg.norm(residual.px[:, None] - px, axis=2).min() > 3.9, "near a corner two edges are seen"


@pytest.mark.parametrize("east_m", [-0.15, 0.0, 0.15])
def test_residuals_are_the_error_of_the_pose(scene: View, east_m: float) -> None:
    """Moving the camera moves outlines by J dp; the residual along the normal is what is missing."""
    wrong = scene.p_nc + np.array([0.0, east_m, 0.0])
    offsets, expected = [], []
    for residual in outline_residuals(scene.image, scene.rig.left, wrong, scene.R_nc, scene.landmarks):
        landmark = next(x for x in scene.landmarks if x.id == residual.id)
        depth = landmark.roof_d - scene.p_nc[2]
        shift = scene.rig.left.fx / depth * (scene.R_nc.T @ np.array([0.0, east_m, 0.0]))[:2]
        offsets.append(residual.offset_px)
        expected.append(residual.normal @ shift)
    difference = np.concatenate(offsets) - np.concatenate(expected)
    assert abs(np.nanmedian(difference)) < 0.05
    assert np.nanmedian(np.abs(difference)) < 0.08
    if east_m:
        assert np.nanmedian(np.abs(np.concatenate(offsets))) > 0.5


def test_nothing_is_found_on_a_blank_image(scene: View) -> None:
    noise = np.random.default_rng(0).normal(0.0, 2.0, scene.image.shape)
    blank = (128.0 + noise).astype(np.uint8)
    found = outline_residuals(blank, scene.rig.left, scene.p_nc, scene.R_nc, scene.landmarks)
    assert found
    assert np.mean([residual.found for residual in found]) < 0.02
    level = outline_residuals(np.full_like(blank, 128), scene.rig.left, scene.p_nc, scene.R_nc, scene.landmarks)
    assert all(residual.found == 0.0 and math.isnan(residual.spread_px) for residual in level)
    assert outline_residuals(blank, scene.rig.left, scene.p_nc, scene.R_nc, []) == []


@pytest.mark.parametrize("grey", [False, True])
def test_lines_lie_on_the_edges_of_roofs(scene: View, grey: bool) -> None:
    image = cv2.cvtColor(scene.image, cv2.COLOR_BGR2GRAY).astype(np.uint8) if grey else scene.image
    before = image.copy()
    marks = in_view(scene.rig.left, scene.p_nc, scene.R_nc, scene.landmarks)
    overlay = draw_overlay(image, scene.rig.left, scene.p_nc, scene.R_nc, scene.landmarks, {marks[0].id})
    np.testing.assert_array_equal(image, before)
    assert overlay.shape == (*image.shape[:2], 3)
    for mark in marks:
        ends = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        middle = (ends + np.roll(ends, -1, axis=0)) / 2
        px = scene.rig.left.project((middle - scene.p_nc) @ scene.R_nc)
        colour = np.array(IDENTIFIED if mark is marks[0] else MAPPED)
        for u, v in px[scene.rig.left.contains(px, 3.0)].round().astype(int).tolist():
            near = overlay[v - 1 : v + 2, u - 1 : u + 2].reshape(-1, 3).astype(int)
            on_line = np.abs(near - colour).max(axis=1).min() < 60
            assert on_line or np.all(near.max(axis=1) < 240), "a line, or a name over it"


def test_what_is_hidden_is_not_drawn() -> None:
    """From straight above the foot of a box lies inside its roof's outline; from aside the near side's foot is seen."""
    ground = np.full((480, 640, 3), 100, np.uint8)
    above = draw_overlay(ground, CAMERA, ABOVE, NADIR, [box(0.0, 0.0, height=10.0)], ["0,0"])
    u, v = CAMERA.project((np.array([[6.0, 4.0, 0.0]]) - ABOVE) @ NADIR)[0].round().astype(int)
    assert np.all(above[v - 2 : v + 3, u - 2 : u + 3] == 100), "foot of the north-east corner"
    aside = ABOVE + np.array([40.0, 0.0, 0.0])
    seen = draw_overlay(ground, CAMERA, aside, NADIR, [box(20.0, 0.0)], ["20,0"])
    u, v = CAMERA.project((np.array([[26.0, 0.0, 0.0]]) - aside) @ NADIR)[0].round().astype(int)
    assert not np.all(seen[v - 2 : v + 3, u - 2 : u + 3] == 100), "foot of the north side, seen from the north"


def test_what_a_tower_hides_is_not_drawn() -> None:
    """A tower of 30 m under the camera hides the ground behind it up to 22.5 m: 9 m x 50 / 20."""
    ground = np.full((480, 640, 3), 100, np.uint8)
    tower, pad = box(6.5, 0.0, 5.0, 12.0, 30.0), box(15.0, 0.0, 4.0, 4.0, 0.0)
    alone = draw_overlay(ground, CAMERA, ABOVE, NADIR, [tower])
    np.testing.assert_array_equal(draw_overlay(ground, CAMERA, ABOVE, NADIR, [tower, pad]), alone)
    assert np.any(draw_overlay(ground, CAMERA, ABOVE, NADIR, [tower, box(-15.0, 0.0, 4.0, 4.0, 0.0)]) != alone)


def test_residual_strokes_names_and_caption_are_drawn(scene: View) -> None:
    wrong = scene.p_nc + np.array([0.1, 0.1, 0.0])
    residuals = outline_residuals(scene.image, scene.rig.left, wrong, scene.R_nc, scene.landmarks)
    ids = {residual.id for residual in residuals}
    plain = draw_overlay(scene.image, scene.rig.left, wrong, scene.R_nc, scene.landmarks, ids)
    strokes = draw_overlay(scene.image, scene.rig.left, wrong, scene.R_nc, scene.landmarks, ids, residuals)
    magenta = [np.sum(np.abs(image.astype(int) - RESIDUAL).max(axis=2) < 30) for image in (plain, strokes)]
    assert magenta[1] > magenta[0] + 200
    said = draw_overlay(scene.image, scene.rig.left, wrong, scene.R_nc, scene.landmarks, ids, caption=["fix: Müller", "0.3 m"])
    changed = np.argwhere(np.any(said != plain, axis=2))
    assert changed[:, 0].min() > 240, "below on the left, and names that made room"
    assert changed[:, 1].max() < 320
    assert np.any(said[435:, 10:60] != plain[435:, 10:60])


def test_landmarks_out_of_view_change_nothing() -> None:
    ground = np.full((480, 640, 3), 100, np.uint8)
    for landmarks in ([], [box(500.0, 0.0)], [box(0.0, -200.0)]):
        np.testing.assert_array_equal(draw_overlay(ground, CAMERA, ABOVE, NADIR, landmarks), ground)
    upwards = NADIR @ np.diag([1.0, -1.0, -1.0])
    np.testing.assert_array_equal(draw_overlay(ground, CAMERA, ABOVE, upwards, [box(0.0, 0.0)]), ground)


@pytest.mark.parametrize(
    "p_nc", [np.array([0.0, 0.0, -4.5]), np.array([0.0, 0.0, -4.0]), np.array([0.0, 0.0, -1.0]), np.array([20.0, 0.0, -0.5])]
)
def test_standing_on_in_or_beside_a_landmark_is_no_trouble(p_nc: Array) -> None:
    ground = np.full((480, 640, 3), 100, np.uint8)
    forward = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # looks south
    for R_nc in (NADIR, forward):
        landmarks = [box(0.0, 0.0), box(6.0, 9.0), box(0.0, 0.0, 600.0, 500.0)]
        found = outline_residuals(ground, CAMERA, p_nc, R_nc, landmarks)
        assert draw_overlay(ground, CAMERA, p_nc, R_nc, landmarks, ["0,0"], found).shape == (480, 640, 3)


def test_in_view_keeps_everything_that_projects_into_the_image(scene: View) -> None:
    kept = {mark.id for mark in in_view(scene.rig.left, scene.p_nc, scene.R_nc, scene.landmarks)}
    for mark in scene.landmarks:
        for down in (mark.base_d, mark.roof_d):
            corners = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), down)))
            px = scene.rig.left.project((corners - scene.p_nc) @ scene.R_nc)
            if scene.rig.left.contains(px).any():
                assert mark.id in kept
    assert len(kept) < len(scene.landmarks) / 2


@pytest.mark.parametrize("reach_px", [6.0, 20.0])
def test_edges_are_found_as_far_as_the_reach(scene: View, reach_px: float) -> None:
    """1 m at 60 m moves outlines by 10 px and more: too far for the short reach."""
    wrong = scene.p_nc + np.array([0.9, 0.9, 0.0])
    found = outline_residuals(scene.image, scene.rig.left, wrong, scene.R_nc, scene.landmarks, reach_px)
    assert all(np.abs(np.nan_to_num(r.offset_px)).max() <= reach_px for r in found)
    shift = scene.rig.left.fx / 60.0 * 0.9
    spread = float(np.median([r.spread_px for r in found]))
    if reach_px < shift:
        assert spread < 0.8 * reach_px
    else:
        assert 0.8 * shift < spread < 2.0 * shift


def test_expected_residual_is_what_random_poses_and_maps_give() -> None:
    """sigma^2 = E |du|^2 / 2, by drawing poses and landmarks."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * np.array([[0.1], [0.1], [0.1], [0.002], [0.002], [0.002]])
    R_nb, R_bc, p_bc, p_n = matrix(from_euler(0.1, -0.2, 0.7)), NADIR, np.array([0.4, -0.1, 0.2]), np.array([3.0, -2.0, -60.0])
    mark = Landmark.of("m", [(0.0, 0.0), (12.0, 0.0), (12.0, 8.0), (0.0, 8.0)], 0.0, 5.0, sigma_m=0.3, height_sigma_m=0.8)
    roof = np.array([*mark.centre_n, mark.roof_d])

    def seen(p: Array, R: Array, point: Array) -> Array:
        px: Array = CAMERA.project(((point - (p + R @ p_bc)) @ (R @ R_bc))[None])[0]
        return px

    moved = []
    for _ in range(4000):
        d, own = root @ rng.normal(size=6), rng.normal(size=3) * [0.3, 0.3, 0.8]
        moved.append(seen(p_n + d[:3], matrix(quat_exp(d[3:])) @ R_nb, roof + own) - seen(p_n, R_nb, roof))
    drawn = math.sqrt(0.5 * float(np.mean(np.sum(np.square(moved), axis=1))))
    sigma = expected_px(CAMERA, p_n, p_n + R_nb @ p_bc, R_nb @ R_bc, root @ root.T, mark)
    assert sigma == pytest.approx(drawn, rel=0.05)
    upwards = NADIR @ np.diag([1.0, -1.0, -1.0])
    assert math.isnan(expected_px(CAMERA, p_n, p_n, upwards, root @ root.T, mark))


@pytest.mark.parametrize("shape", [(480, 640), (101, 75), (900, 1201)])
def test_the_strip_leaves_the_image_and_makes_its_sides_even(shape: tuple[int, int]) -> None:
    canvas = np.random.default_rng(0).integers(0, 256, (*shape, 3), np.uint8)
    framed = add_strip(canvas, ["12.3 s", "dead reckoning", "95 %: 0.42 m"])
    np.testing.assert_array_equal(framed[: shape[0], : shape[1]], canvas)
    assert framed.shape[0] % 2 == framed.shape[1] % 2 == 0
    assert 1.0 < framed.shape[0] / shape[0] < 1.3
    written = np.flatnonzero((framed[shape[0] :, : shape[1]].max(axis=2) > 128).any(axis=0))
    assert written.min() < shape[1] / 4
    assert written.max() > 0.75 * shape[1]
