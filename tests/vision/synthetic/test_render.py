"""The renderer against geometry that it does not share: CameraModel.project of true corners, and statistics of grey values."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from models import so3
from models.camera import CameraModel
from models.maps.landmarks import Landmark
from vision.synthetic import (
    IDEAL,
    Appearance,
    Conditions,
    Ground,
    Solid,
    Sun,
    World,
    WorldSpec,
    blur_of_motion,
    make_rig,
    make_world,
    render,
    render_labels,
    render_pair,
)  # fmt: skip
from vision.synthetic.shapes import rectangle
from vision.synthetic.world import Bgr

DARK, BRIGHT = 40.0, 220.0
PLAIN = Ground.of_image(np.full((64, 64, 3), int(DARK), dtype=np.uint8), 1.0)  # a ground without texture
OVERCAST = Sun(ambient=1.0)  # no shadows
LENS = (-0.21, 0.07, 0.0011, -0.0008)
CAMERA = CameraModel(640, 480, 600.0, 604.0, 322.0, 236.0, LENS)
NADIR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def plain(colour: Bgr) -> Appearance:
    return Appearance(colour, colour, contrast=0.0, wall_contrast=0.0)


def box(
    north: float, east: float, height: float, colour: Bgr, length: float = 12.0, width: float = 8.0, turn: float = 0.0
) -> Solid:
    c, s = math.cos(turn), math.sin(turn)
    return Solid(rectangle(length, width) @ np.array([[c, s], [-s, c]]) + (north, east), 0.0, height, plain(colour))


def world_of(*solids: Solid, sun: Sun = OVERCAST, ground: Ground = PLAIN) -> World:
    return World((), (), solids, ground, sun)


def pose(height: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    return np.array([0.0, 0.0, -height]), so3.matrix(so3.from_euler(roll, pitch, yaw)) @ NADIR


def project(
    solid: Solid, height: float, p_nc: np.ndarray, R_nc: np.ndarray, per_edge: int = 100
) -> tuple[np.ndarray, np.ndarray]:
    """Points on the roof's edges, at least 1 m from corners, and the normals of the projected edge there."""
    steps, h = np.linspace(0.15, 0.85, per_edge), 1e-3
    px, normal = [], []
    for a, b in zip(solid.outline_n, np.roll(solid.outline_n, -1, axis=0), strict=True):

        def at(t: np.ndarray, a: np.ndarray = a, b: np.ndarray = b) -> np.ndarray:
            flat = a + t[:, None] * (b - a)
            return CAMERA.project((np.column_stack([flat, np.full(len(flat), -height)]) - p_nc) @ R_nc)

        tangent = at(steps + h) - at(steps - h)
        tangent /= np.hypot(*tangent.T)[:, None]
        px.append(at(steps))
        normal.append(np.column_stack([-tangent[:, 1], tangent[:, 0]]))
    return np.concatenate(px), np.concatenate(normal)


def edge_offsets(image: np.ndarray, px: np.ndarray, normal: np.ndarray, reach: float = 6.0) -> np.ndarray:
    """Where the edge lies along the normal, by integrating intensity: (integral of I - I_end) / step, about the middle."""
    s = np.arange(-reach, reach + 0.05, 0.05)
    at = px[:, None, :] + s[None, :, None] * normal[:, None, :]
    values = map_coordinates(image.astype(np.float64), [at[..., 1], at[..., 0]], order=1)
    low, high = values[:, :20].mean(axis=1), values[:, -20:].mean(axis=1)
    bright = (values - low[:, None]) / (high - low)[:, None]
    return np.asarray(reach - np.trapezoid(bright, s, axis=1))


@pytest.mark.parametrize("height", [0.0, 5.0])
@pytest.mark.parametrize("psf", [0.0, 0.45])
def test_edges_lie_on_the_true_polygon(height: float, psf: float) -> None:
    """GIVEN roofs under a strong lens WHEN rendered THEN the edges' bias is <= 0.02 px and their RMS error <= 0.05 px."""
    rng = np.random.default_rng(3)
    outward = []
    for _ in range(12):
        solid = box(0.0, 0.0, height, (BRIGHT, BRIGHT, BRIGHT), turn=rng.uniform(0, math.pi))
        p, R = pose(rng.uniform(22, 60), rng.uniform(-0.12, 0.12), rng.uniform(-0.12, 0.12), rng.uniform(-3, 3))
        image = render(world_of(solid), CAMERA, p, R, replace(IDEAL, psf_sigma_px=psf), rng)[:, :, 1]
        px, normal = project(solid, height, p, R)
        seen = np.all((px > 8) & (px < np.array([631, 471])), axis=1)
        centre = px.mean(axis=0)
        side = np.sign(np.sum(normal * (px - centre), axis=1))
        outward.append(edge_offsets(image, px[seen], normal[seen]) * side[seen])
    errors = np.concatenate(outward)
    assert len(errors) > 2000
    assert abs(errors.mean()) <= 0.005  # documented 0.02
    assert math.sqrt(np.mean(errors**2)) <= 0.025  # documented 0.05


def test_motion_blur_leaves_edges_where_they_are() -> None:
    solid = box(0.0, 0.0, 3.0, (BRIGHT, BRIGHT, BRIGHT), turn=0.4)
    p, R = pose(40.0, 0.05, -0.08, 0.3)
    image = render(world_of(solid), CAMERA, p, R, replace(IDEAL, blur_px=(4.0, 2.5)), np.random.default_rng(1))[:, :, 1]
    sharp = render(world_of(solid), CAMERA, p, R, IDEAL, np.random.default_rng(1))[:, :, 1]
    px, normal = project(solid, 3.0, p, R)
    errors = edge_offsets(image, px, normal)
    assert abs(errors.mean()) < 0.02
    assert math.sqrt(np.mean(errors**2)) < 0.03
    gradient = [np.abs(np.diff(i.astype(float), axis=1)).max() for i in (image, sharp)]
    assert gradient[0] < 0.5 * gradient[1]


def test_walls_stand_between_roof_and_ground() -> None:
    """A box next to the camera: the wall that faces it covers exactly the quadrilateral between roof and base edge."""
    solid = replace(
        box(0.0, 12.0, 6.0, (BRIGHT, BRIGHT, BRIGHT)),
        appearance=Appearance((200.0, 200.0, 200.0), (10.0, 10.0, 250.0), contrast=0.0, wall_contrast=0.0),
    )
    p, R = pose(40.0)
    image = render(world_of(solid), CAMERA, p, R, IDEAL, np.random.default_rng(1))
    wall_light = 0.7  # of the sky
    corners = np.array([[6, 8, -6], [-6, 8, -6], [-6, 8, 0], [6, 8, 0]], dtype=float)
    u, v = CAMERA.project((corners - p) @ R).T
    area = 0.5 * abs(np.dot(u, np.roll(v, 1)) - np.dot(v, np.roll(u, 1)))
    red = np.abs(image[:, :, 2].astype(float) - 250.0 * wall_light) < 2
    assert red.sum() == pytest.approx(area, rel=0.06)
    dark = image[:, :, 1] < 10.0  # nothing but wall is darker than the ground: no seam of ground between roof and wall
    assert dark.sum() == red.sum() or abs(int(dark.sum()) - int(red.sum())) < 60
    middle = int(CAMERA.project((np.array([[0, 8, -6.0]]) - p) @ R)[0, 1])
    row = image[middle, :, 1].astype(float)
    roof_begins = int(np.flatnonzero(row > 150)[0])
    assert np.all(np.diff(row[roof_begins - 3 : roof_begins + 2]) >= -1.0)  # wall, mixed pixel, roof: nothing brighter between


def test_nearer_solids_hide_farther_ones() -> None:
    """Labels against a ray cast through every 7th pixel."""
    rng = np.random.default_rng(8)
    spec = WorldSpec(area_m=120.0, spacing_m=14.0, trees=60.0)
    world = replace(make_world(5, spec).world, ground=PLAIN)
    checked = 0
    for _ in range(3):
        p, R = pose(rng.uniform(14, 40), rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(-3, 3))
        labels = render_labels(world, CAMERA, p, R)
        v, u = np.mgrid[3:480:7, 3:640:7].reshape(2, -1)
        rays = CAMERA.ray(np.column_stack([u, v]).astype(float)) @ R.T
        cast = first_hits(world.solids, p, rays)
        agree = cast == labels[v, u]
        assert agree.mean() > 0.985  # what is left lies on borders of pixels
        checked += int(np.count_nonzero(cast >= 0))
    assert checked > 4000


def first_hits(solids: tuple[Solid, ...], p: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Index of the first solid each ray meets: roof plane inside the outline, or a wall; -1 for the ground."""
    best, found = np.full(len(rays), math.inf), np.full(len(rays), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        for k, solid in enumerate(solids):
            roof, outline = solid.base_d - solid.height_m, solid.outline_n
            t = np.where(rays[:, 2] > 0, (roof - p[2]) / rays[:, 2], math.inf)
            on_roof = inside(outline, p[:2] + t[:, None] * rays[:, :2])
            # of flat things in one place the one laid last is seen
            nearer = on_roof & ((t < best - 1e-9) | ((np.abs(t - best) < 1e-9) & (solid.height_m == 0.0)))
            best[nearer], found[nearer] = t[nearer], k
            for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True) if solid.height_m > 0.0 else ():
                d, off = b - a, a - p[:2]
                det = d[1] * rays[:, 0] - d[0] * rays[:, 1]
                t = (d[1] * off[0] - d[0] * off[1]) / det
                along = (rays[:, 1] * off[0] - rays[:, 0] * off[1]) / det
                down = p[2] + t * rays[:, 2]
                nearer = (t > 0) & (along >= 0) & (along <= 1) & (down >= roof) & (down <= solid.base_d) & (t < best)
                best[nearer], found[nearer] = t[nearer], k
    return found


def inside(outline: np.ndarray, x: np.ndarray) -> np.ndarray:
    result = np.zeros(len(x), dtype=bool)
    for (n0, e0), (n1, e1) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if n0 != n1:
            result ^= ((n0 > x[:, 0]) != (n1 > x[:, 0])) & (x[:, 1] < e0 + (x[:, 0] - n0) * (e1 - e0) / (n1 - n0))
    return result


def test_shadows_fall_away_from_the_sun() -> None:
    """Sun in the east at 45 degrees: the shadow of a box 6 m high covers 6 m of ground west of it, as dark as the sky alone."""
    sun = Sun(math.radians(90.0), math.radians(45.0), 0.4)
    p, R = pose(40.0)
    solid = box(0.0, 0.0, 6.0, (BRIGHT, BRIGHT, BRIGHT))
    image = render(world_of(solid, sun=sun), CAMERA, p, R, IDEAL, np.random.default_rng(1))[:, :, 1]
    shadow = np.array([[6, -4], [-6, -4], [-6, -10], [6, -10]], dtype=float)
    u, v = CAMERA.project((np.column_stack([shadow, np.zeros(4)]) - p) @ R).T
    area = 0.5 * abs(np.dot(u, np.roll(v, 1)) - np.dot(v, np.roll(u, 1)))
    hidden = project_area(np.array([[6, -4, -6], [-6, -4, -6], [-6, -4, 0], [6, -4, 0]], dtype=float), p, R)
    dark = image < DARK - 5
    assert dark.sum() == pytest.approx(area - hidden, rel=0.04)
    assert np.median(image[dark]) == pytest.approx(DARK * sun.shadow, abs=1.0)
    assert np.flatnonzero(dark.any(axis=0)).max() < 320  # in the west only, which is left


def project_area(x_n: np.ndarray, p: np.ndarray, R: np.ndarray) -> float:
    u, v = CAMERA.project((x_n - p) @ R).T
    return 0.5 * abs(float(np.dot(u, np.roll(v, 1)) - np.dot(v, np.roll(u, 1))))


def test_ground_moves_as_the_camera_model_predicts() -> None:
    """Optical flow between two poses of the textured ground against the projected plane, sub-pixel."""
    ground = Ground.procedural(np.random.default_rng(4))
    world = world_of(ground=ground)
    (p, R), (p2, R2) = pose(30.0), pose(30.4, 0.01, -0.015, 0.03)
    p2 = p2 + np.array([0.3, 0.5, 0.0])
    first, second = (
        cv2.cvtColor(render(world, CAMERA, at, axes, IDEAL, np.random.default_rng(1)), cv2.COLOR_BGR2GRAY)
        for at, axes in ((p, R), (p2, R2))
    )
    v, u = np.mgrid[40:440:40, 40:600:40].reshape(2, -1)
    px = np.column_stack([u, v]).astype(float)
    rays = CAMERA.ray(px) @ R.T
    x_n = p + rays * ((0.0 - p[2]) / rays[:, 2])[:, None]
    expected = CAMERA.project((x_n - p2) @ R2)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        first, second, px.astype(np.float32), expected.astype(np.float32), winSize=(21, 21), flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    ok = status[:, 0] == 1
    errors = (found - expected)[ok]
    assert ok.mean() > 0.95
    assert np.abs(np.median(errors, axis=0)).max() < 0.02
    assert np.median(np.abs(errors)) < 0.08


@pytest.mark.parametrize("height", [10.0, 30.0, 60.0, 120.0])
@pytest.mark.parametrize("pitch_deg", [0.0, 25.0])
def test_ground_has_enough_to_hold_on_to(height: float, pitch_deg: float) -> None:
    """>= 500 SIFT keypoints in a VGA image of a village at any height."""
    scene = make_world(11, WorldSpec(area_m=200.0))
    R_nb = so3.matrix(so3.from_euler(0.0, math.radians(pitch_deg), 0.7))
    left, _ = render_pair(scene.world, scene.rig, np.array([3.0, 4.0, -height]), R_nb, Conditions(), np.random.default_rng(1))
    assert len(cv2.SIFT.create().detect(cv2.cvtColor(left, cv2.COLOR_BGR2GRAY))) >= 500


def test_noise_is_shot_and_read_noise() -> None:
    conditions = replace(IDEAL, read_sigma=2.0, shot=0.05)
    for grey in (30.0, 180.0):
        ground = Ground.of_image(np.full((64, 64, 3), int(grey), dtype=np.uint8), 1.0)
        image = render(world_of(ground=ground), CAMERA, *pose(20.0), conditions, np.random.default_rng(5)).astype(float)
        assert image.mean() == pytest.approx(grey, abs=0.03)
        assert image.var() == pytest.approx(4.0 + 0.05 * grey + 1 / 12, rel=0.03)
        flat = image[:, :, 1] - image[:, :, 1].mean()
        assert abs(np.mean(flat[:, :-1] * flat[:, 1:])) < 0.02 * flat.var()
        assert abs(np.mean(flat[:-1] * flat[1:])) < 0.02 * flat.var()


def test_exposure_cast_vignette_and_haze() -> None:
    p, R = pose(50.0)
    rng = np.random.default_rng(1)
    world = world_of()
    assert render(world, CAMERA, p, R, replace(IDEAL, exposure=2.0), rng).mean() == pytest.approx(2 * DARK, abs=0.5)
    cast = render(world, CAMERA, p, R, replace(IDEAL, cast_bgr=(1.2, 1.0, 0.5)), rng).mean(axis=(0, 1))
    np.testing.assert_allclose(cast, [1.2 * DARK, DARK, 0.5 * DARK], atol=0.5)
    dim = render(world, CAMERA, p, R, replace(IDEAL, vignetting=0.5, exposure=2.0), rng)
    assert dim[236, 322].mean() == pytest.approx(2 * DARK, abs=1)
    assert dim[-1, 0].mean() == pytest.approx(DARK, abs=2)
    haze = render(world, CAMERA, p, R, replace(IDEAL, haze_per_m=0.01, haze_bgr=(200.0, 200.0, 200.0)), rng)
    assert haze[236, 322].mean() == pytest.approx(DARK * math.exp(-0.5) + 200 * (1 - math.exp(-0.5)), abs=1.0)
    assert haze[0, 0].mean() > haze[236, 322].mean() + 3  # a longer way


def test_same_seed_same_bytes() -> None:
    pairs = []
    for _ in range(2):
        scene = make_world(21, WorldSpec(sigma_m=0.5, unmapped=0.3, gone=0.1))
        pairs.append(
            render_pair(
                scene.world,
                scene.rig,
                np.array([0.0, 0.0, -50.0]),
                np.eye(3),
                Conditions(blur_px=(3.0, 1.0)),
                np.random.default_rng(9),
            )
        )
    assert all(a.tobytes() == b.tobytes() for a, b in zip(*pairs, strict=True))
    other = make_world(22).world
    assert render(other, CAMERA, *pose(50.0), IDEAL, np.random.default_rng(9)).tobytes() != pairs[0][0].tobytes()


def test_horizon_and_below_ground_are_images_too() -> None:
    scene = make_world(2, WorldSpec(area_m=100.0))
    rng = np.random.default_rng(1)
    level = render(scene.world, CAMERA, *pose(10.0, 0.0, math.pi / 2), Conditions(haze_per_m=0.002), rng)
    assert level[:100].std() > 0.0
    under = render(scene.world, CAMERA, *pose(-3.0), Conditions(), rng)
    assert under.shape == level.shape == (480, 640, 3)


def test_an_image_as_ground_lies_north_up() -> None:
    ground = np.zeros((64, 64, 3), dtype=np.uint8)
    ground[:32], ground[:, :32, 2] = (0, 200, 0), 150  # north is green, west is red
    world = world_of(ground=Ground.of_image(ground, 1.0))
    image = render(world, CAMERA, np.array([32.0, 32.0, -20.0]), NADIR, IDEAL, np.random.default_rng(0))
    assert image[60, 320, 1] > 190
    assert image[420, 320, 1] < 10
    assert image[240, 60, 2] > 140
    assert image[240, 580, 2] < 10


def test_blur_of_motion_is_the_way_of_a_ground_point() -> None:
    rig = make_rig(exact=True, distortion=())
    v_c, w_c, exposure = np.array([3.0, -1.0, 0.2]), np.array([0.2, -0.1, 0.0]), 0.01
    camera = rig.left
    centre = np.array([0.0, 0.0, 40.0])
    moved = so3.matrix(so3.quat_exp(w_c * exposure)).T @ (centre - v_c * exposure)
    way = camera.project(np.stack([centre, moved]))
    du, dv = blur_of_motion(camera.fx, v_c, w_c, 40.0, exposure)
    np.testing.assert_allclose([du, dv], way[1] - way[0], atol=2e-3)


def test_landmarks_come_first_in_labels() -> None:
    mark = Landmark.of("pad", rectangle(6.0, 6.0))
    world = World((mark,), (plain((0.0, 0.0, 200.0)),), (box(0.0, 0.0, 2.0, (1.0, 1.0, 1.0), 1.0, 1.0),), PLAIN, OVERCAST)
    labels = render_labels(world, CAMERA, *pose(20.0))
    assert set(np.unique(labels)) == {-1, 0, 1}
    assert labels[236, 322] == 1
    assert labels[236, 322 + 60] == 0
