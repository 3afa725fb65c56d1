"""Ground truth of what is to be seen, against the labels that the renderer paints by another way."""

import math
from dataclasses import replace

import numpy as np
import pytest

from models import so3
from models.camera import CameraModel
from models.maps.landmarks import Landmark
from vision.synthetic import Appearance, Ground, Solid, World, WorldSpec, landmark_views, make_world, render_labels
from vision.synthetic.shapes import rectangle

CAMERA = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5, (-0.1, 0.03, 0.0, 0.0))
NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
LOOK = Appearance((200.0, 30.0, 30.0))
GROUND = Ground.of_image(np.full((4, 4, 3), 60, dtype=np.uint8), 1.0)


def one(height: float, *clutter: Solid) -> World:
    return World((Landmark.of("a", rectangle(12.0, 8.0), 0.0, height),), (LOOK,), clutter, GROUND)


def tilted(roll: float, pitch: float, yaw: float = 0.0) -> np.ndarray:
    R: np.ndarray = so3.matrix(so3.from_euler(roll, pitch, yaw)) @ NADIR
    return R


def test_everything_of_a_roof_below() -> None:
    (landmark_view,) = landmark_views(one(4.0), CAMERA, np.array([0.0, 0.0, -40.0]), NADIR)
    assert landmark_view.corners_visible.all()
    assert [(s.edge, s.start, s.end) for s in landmark_view.stretches] == [(k, 0.0, 1.0) for k in range(4)]
    assert not landmark_view.sides_visible.any()
    assert landmark_view.occluded == 0.0
    assert not landmark_view.cut


def test_the_side_that_faces_the_camera() -> None:
    (landmark_view,) = landmark_views(one(4.0), CAMERA, np.array([0.0, -15.0, -40.0]), NADIR)  # west of it
    middles = 0.5 * (rectangle(12, 8) + np.roll(rectangle(12, 8), -1, axis=0))
    assert [tuple(m) for m in middles[landmark_view.sides_visible]] == [(0.0, -4.0)]


def test_what_a_taller_neighbour_hides() -> None:
    """A tower of 20 m stands 2 m west of the roof (4 m high): from far in the west it hides part of the western edge only."""
    tower = Solid(rectangle(6.0, 4.0) + np.array([0.0, -8.0]), 0.0, 20.0, LOOK)
    p = np.array([0.0, -30.0, -30.0])
    R = tilted(-0.6, 0.0)
    (landmark_view,) = landmark_views(one(4.0, tower), CAMERA, p, R)
    west = next(k for k in range(4) if rectangle(12, 8)[k][1] < 0 > rectangle(12, 8)[(k + 1) % 4][1])
    stretches = [s for s in landmark_view.stretches if s.edge == west]
    assert len(stretches) == 2
    # Sight to (n, -4) at down -4 passes the tower's western face (e = -10) where it is 3 m from its middle.
    reach = 3.0 * 26.0 / 20.0
    assert stretches[0].end == pytest.approx(0.5 - reach / 12.0, abs=0.01)
    assert stretches[1].start == pytest.approx(0.5 + reach / 12.0, abs=0.01)
    assert 0.05 < landmark_view.occluded < 0.9
    assert landmark_view.corners_visible.all()


def test_cut_by_the_border() -> None:
    (landmark_view,) = landmark_views(one(4.0), CAMERA, np.array([0.0, 18.0, -40.0]), NADIR)
    assert landmark_view.cut
    assert 0 < landmark_view.corners_visible.sum() < 4
    assert landmark_views(one(4.0), CAMERA, np.array([0.0, 200.0, -40.0]), NADIR) == []
    assert landmark_views(one(4.0), CAMERA, np.array([0.0, 0.0, -40.0]), NADIR @ np.diag([1.0, -1.0, -1.0])) == []  # looks up


def test_agrees_with_the_labels_of_a_crowded_image() -> None:
    rng = np.random.default_rng(7)
    world = make_world(6, WorldSpec(area_m=160.0, spacing_m=16.0, flat=0.0, trees=0.0)).world
    towers = []
    for mark in world.landmarks:  # one close to each landmark, on the side of a random direction
        way = rng.uniform(0, 2 * math.pi)
        position = mark.centre_n + (0.5 * math.hypot(mark.length_m, mark.width_m) + 1.6) * np.array(
            [math.cos(way), math.sin(way)]
        )
        towers.append(Solid(rectangle(3.0, 3.0) + position, 0.0, 15.0, LOOK))
    world = replace(world, clutter=tuple(towers))
    shown: list[bool] = []
    hidden: list[bool] = []
    for _ in range(6):
        p, R = (
            np.array([*rng.uniform(-20, 20, 2), -rng.uniform(30, 50)]),
            tilted(rng.uniform(-0.6, 0.6), rng.uniform(-0.2, 0.2), rng.uniform(-3, 3)),
        )
        labels = render_labels(world, CAMERA, p, R)
        index = {mark.id: k for k, mark in enumerate(world.landmarks)}
        for landmark_view in landmark_views(world, CAMERA, p, R):
            own = index[landmark_view.id]
            for edge in range(len(landmark_view.corners_px)):
                mark = world.landmarks[own]
                a, b = mark.outline_n[edge], mark.outline_n[(edge + 1) % len(mark.outline_n)]
                inward = np.array([b[1] - a[1], a[0] - b[0]]) / math.hypot(*(b - a))
                for share in np.linspace(0.1, 0.9, 9):
                    depth = np.linalg.norm(np.append(a, mark.roof_d) - p)
                    at = np.append(a + share * (b - a) + 1.5 * depth / CAMERA.fx * inward, mark.roof_d)
                    ((u, v),) = CAMERA.project(((at - p) @ R)[None])
                    if 2 < u < 637 and 2 < v < 477:
                        visible = any(s.edge == edge and s.start < share < s.end for s in landmark_view.stretches)
                        (shown if visible else hidden).append(bool(labels[round(v), round(u)] == own))
    assert len(shown) > 600
    assert len(hidden) > 50
    assert np.mean(shown) > 0.98
    assert np.mean(hidden) < 0.1
