"""Worlds from a seed: what is in the map, what stands, and errors of the documented size."""

import math
from dataclasses import replace

import numpy as np
import pytest

from models import so3
from models.maps.outline import area
from vision.synthetic import WorldSpec, draw_rig, make_rig, make_world
from vision.synthetic.camera_effects import _line
from vision.synthetic.shapes import grow, house, rectangle

SPEC = WorldSpec(area_m=500.0, sigma_m=0.5, height_sigma_m=0.3, outline_sigma_m=0.2, trees=0.0, cars=0.0, patches=0.0)


def test_errors_of_the_map_have_their_sigmas() -> None:
    """400 buildings: shift, growth and rise within chi-square bands of 99.9 %."""
    scene = make_world(3, SPEC)
    shifts, growths, rises = [], [], []
    for true in scene.world.landmarks:
        mapped = scene.map[true.id]
        shifts.append(true.outline_n.mean(axis=0) - mapped.outline_n.mean(axis=0))
        edges = np.linalg.norm(np.roll(mapped.outline_n, -1, axis=0) - mapped.outline_n, axis=1)
        growths.append((true.size_m2 - mapped.size_m2) / edges.sum())  # of the first order
        rises.append(mapped.roof_d - true.roof_d)
        assert (mapped.sigma_m, mapped.height_sigma_m, mapped.outline_sigma_m) == (0.5, 0.3, 0.2)
    assert len(shifts) == 400
    for values, sigma in ((np.ravel(shifts), 0.5), (np.array(growths), 0.2), (np.array(rises), 0.3)):
        assert 0.87 < np.std(values) / sigma < 1.13
        assert abs(np.mean(values)) < 4 * sigma / math.sqrt(len(values))


def test_a_better_map_is_of_the_same_world() -> None:
    """The map does not move with the sigmas, and with none the truth is the map."""
    worse, exact = make_world(5, SPEC), make_world(5, replace(SPEC, sigma_m=0.0, height_sigma_m=0.0, outline_sigma_m=0.0))
    assert [m.id for m in worse.world.landmarks] == [m.id for m in exact.world.landmarks]
    for mark in exact.world.landmarks:
        np.testing.assert_allclose(mark.outline_n, exact.map[mark.id].outline_n, atol=1e-9)
        np.testing.assert_allclose(mark.outline_n, worse.map[mark.id].outline_n, atol=1e-9)


def test_unmapped_and_gone() -> None:
    """Shares of 400 buildings; what is gone is in the map only, what is unmapped stands among the clutter."""
    scene = make_world(7, replace(SPEC, unmapped=0.3, gone=0.1))
    mapped, standing = {m.id for m in scene.map}, {m.id for m in scene.world.landmarks}
    assert standing < mapped
    assert len(scene.world.clutter) + len(mapped) == 400
    assert 0.22 < len(scene.world.clutter) / 400 < 0.38
    assert 0.05 < 1.0 - len(standing) / len(mapped) < 0.16


def test_lookalikes_differ_by_a_tenth_and_stand_25_m_apart() -> None:
    marks = make_world(1, replace(SPEC, layout="lookalikes", sigma_m=0.0, outline_sigma_m=0.0, painted=1.0)).world.landmarks
    lengths, widths = np.array([(m.length_m, m.width_m) for m in marks]).T
    for sizes, middle in ((lengths, 12.0), (widths, 8.0)):
        assert 0.9 <= sizes.min() / middle < 0.93
        assert 1.07 < sizes.max() / middle <= 1.1
    assert len({m.colour_bgr for m in marks}) == 1
    centres = np.array([m.centre_n for m in marks])
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1) + 1e9 * np.eye(len(marks))
    assert 21.0 < apart.min(axis=1).mean() < 26.0


@pytest.mark.parametrize("layout", ["village", "grid", "lookalikes"])
def test_nothing_stands_in_another_or_where_it_must_be_clear(layout: str) -> None:
    spec = WorldSpec(area_m=200.0, clear_m=15.0)
    world = make_world(2, replace(spec, layout=layout)).world  # type: ignore[arg-type]
    c = world.columns
    standing = np.flatnonzero(c.height_m > 0.0)
    discs = [(c.centre_n[k], c.vertices[c.offsets[k] : c.offsets[k + 1]]) for k in standing]
    assert all(np.hypot(*outline.T).min() > 12.0 for _, outline in discs)
    for k, (_, outline) in enumerate(discs):
        for centre, _ in discs[:k]:
            assert np.hypot(*(outline - centre).T).min() > 0.5


def test_houses_are_outlines_of_positive_area() -> None:
    rng = np.random.default_rng(0)
    corners = set()
    for _ in range(200):
        outline, height = house(rng, 15.0)
        assert area(outline) > 0.0
        assert 2.0 < height < 9.0
        corners.add(len(outline))
    assert corners == {4, 6, 8}


def test_growing_moves_every_edge_by_the_same_distance() -> None:
    """GIVEN an L WHEN grown by 0.5 m THEN its size is size + perimeter d + (convex - concave corners) d^2."""
    outline = np.array([[4.0, 3.0], [4.0, -1.0], [1.0, -1.0], [1.0, -4.0], [-4.0, -4.0], [-4.0, 3.0]])
    perimeter = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).sum()
    assert area(grow(outline, 0.5)) == pytest.approx(area(outline) + 0.5 * perimeter + 4 * 0.25)
    np.testing.assert_allclose(np.ptp(grow(rectangle(6.0, 4.0), 0.5), axis=0), [7.0, 5.0])


def test_rigs_are_drawn_within_their_covariance() -> None:
    """Squared Mahalanobis distance of 300 rigs: 6 and 6 on average, for the pair and for the body."""
    calibrated, rng = make_rig(), np.random.default_rng(1)
    squares = []
    for _ in range(300):
        true = draw_rig(calibrated, rng)
        for R, R_hat, t, t_hat, covariance in (
            (true.R_bc, calibrated.R_bc, true.p_bc, calibrated.p_bc, calibrated.covariance_bc),
            (true.R_rc, calibrated.R_rc, true.t_rc, calibrated.t_rc, calibrated.covariance_rc),
        ):
            assert covariance is not None
            error = np.concatenate([t - t_hat, so3.quat_log(so3.from_matrix(np.ascontiguousarray(R @ R_hat.T)))])
            squares.append(error @ np.linalg.solve(covariance, error))
        assert true.left.fx != calibrated.left.fx
    assert 5.5 < np.mean(squares) < 6.5
    assert draw_rig(make_rig(exact=True), rng).left.fx == 600.0


@pytest.mark.parametrize("pitch_deg", [-90.0, -60.0])
def test_the_rig_looks_where_it_is_said_to(pitch_deg: float) -> None:
    rig = make_rig(pitch_deg=pitch_deg)
    pitch = math.radians(pitch_deg)
    np.testing.assert_allclose(rig.R_bc[:, 2], [math.cos(pitch), 0.0, -math.sin(pitch)], atol=1e-12)
    np.testing.assert_allclose(rig.R_bc[:, 0], [0.0, 1.0, 0.0], atol=1e-12)
    p_left, p_right = rig.camera_pose(np.zeros(3), np.eye(3))[0], rig.right_camera_pose(np.zeros(3), np.eye(3))[0]
    np.testing.assert_allclose(p_right - p_left, [0.0, 0.3, 0.0], atol=1e-12)


@pytest.mark.parametrize("way", [(5.0, 0.0), (-3.0, 4.0), (0.4, 0.2), (0.0, -7.3)])
def test_a_motion_kernel_is_centred_and_as_long_as_the_way(way: tuple[float, float]) -> None:
    kernel = _line(*way).astype(float)
    half = kernel.shape[0] // 2
    v, u = np.mgrid[-half : half + 1, -half : half + 1]
    assert kernel.sum() == pytest.approx(1.0, abs=1e-6)
    assert (kernel * u).sum() == pytest.approx(0.0, abs=1e-6)
    assert (kernel * v).sum() == pytest.approx(0.0, abs=1e-6)
    # a uniform way has the variance w^2 / 12; reading between pixels adds up to 1/4 to either axis
    assert (kernel * u**2).sum() == pytest.approx(way[0] ** 2 / 12, abs=0.26)
    assert (kernel * v**2).sum() == pytest.approx(way[1] ** 2 / 12, abs=0.26)
    assert np.sign((kernel * u * v).sum()) == np.sign(way[0] * way[1])
