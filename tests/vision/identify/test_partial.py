"""Regions that the border cuts off, against geometry done by hand: a roof half out of the image, seen from a known pose."""

import math
from dataclasses import replace

import numpy as np
import pytest

from models import so3
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.describe.regions import Region
from vision.identify import sightings
from vision.identify.catalogue import Catalogue, Sighting, catalogue
from vision.identify.identify import NONE, identify
from vision.identify.likelihood import _say_nothing, _whiten
from vision.identify.partial import Partial, chain, seen_corners
from vision.synthetic.rigs import make_rig

RIG = make_rig(distortion=())
P_N, Q = np.array([1.0, -2.0, -60.0]), so3.from_euler(0.05, -0.04, 0.3)
PRIOR = Prior(P_N, Q, np.diag([25.0] * 3 + [math.radians(1.0) ** 2] * 3))
ROOF_D, WIDTH, LENGTH = -4.0, 8.0, 14.0
SIZE = np.array([RIG.left.width - 1.0, RIG.left.height - 1.0])


def landmark(name: str, centre: tuple[float, float], width: float = WIDTH, length: float = LENGTH, turn: float = 0.4) -> Landmark:
    c, s = math.cos(turn), math.sin(turn)
    flat = 0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width]]) @ np.array([[c, s], [-s, c]])
    return Landmark.of(name, flat + centre, 0.0, -ROOF_D, None, 0.3, 0.2, 0.05)


def pixels(mark: Landmark) -> Array:
    p_nc, R_nc = RIG.camera_pose(P_N, so3.matrix(Q))
    return RIG.left.project((np.column_stack((mark.outline_n, np.full(len(mark.outline_n), ROOF_D))) - p_nc) @ R_nc)


def place_at(u: float, v: float) -> tuple[float, float]:
    """North and east of the roof's plane at a pixel."""
    p_nc, R_nc = RIG.camera_pose(P_N, so3.matrix(Q))
    ray = R_nc @ RIG.left.ray(np.array([[u, v]]))[0]
    n, e = (p_nc + ray * (ROOF_D - p_nc[2]) / ray[2])[:2]
    return float(n), float(e)


def clipped(corners: Array) -> Array:
    """A convex polygon cut at the image's border (Sutherland and Hodgman 1974)."""
    for axis, limit, sign in ((0, 0.0, 1.0), (0, SIZE[0], -1.0), (1, 0.0, 1.0), (1, SIZE[1], -1.0)):
        kept = []
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            inside_a, inside_b = sign * (a[axis] - limit) >= 0.0, sign * (b[axis] - limit) >= 0.0
            if inside_a:
                kept.append(a)
            if inside_a != inside_b:
                kept.append(a + (limit - a[axis]) / (b[axis] - a[axis]) * (b - a))
        corners = np.array(kept)
    return corners


def sighting(mark: Landmark, known: Catalogue) -> Sighting | None:
    px = clipped(pixels(mark))
    region = Region(px, px, 1.0, (0, 0, 1, 1), np.ones((1, 1), np.bool_), True, (1.0, 2.0, 3.0), 0.1, 1)
    one = sightings.from_one_camera(region, PRIOR, RIG, ROOF_D)
    assert one is not None
    return sightings.cut_off(one, region, seen_corners(px, RIG.left.width, RIG.left.height, None), PRIOR, RIG, known)


def partial(mark: Landmark, known: Catalogue) -> Partial:
    one = sighting(mark, known)
    assert one is not None
    assert one.partial is not None
    return one.partial


def test_the_corners_seen_stand_where_the_map_has_them() -> None:
    """Three corners in view, then two: the run is theirs, of this landmark and of no other."""
    for turn, count in ((0.4, 2), (1.1, 3)):
        mark = landmark("a", place_at(30.0, 240.0), turn=turn)
        assert seen_corners(pixels(mark), RIG.left.width, RIG.left.height, None).sum() == count
        known = catalogue([landmark("b", (40.0, 40.0), 30.0, 40.0), mark])
        seen = partial(mark, known)
        assert seen.landmark.tolist() == [1]
        np.testing.assert_allclose(seen.target_n[0] - P_N, seen.middle_n, atol=0.02)
        np.testing.assert_allclose(seen.features[seen.known], seen.described[0][seen.known], atol=2e-3)
        one = sighting(mark, known)
        assert one is not None
        np.testing.assert_allclose(P_N + one.arm_n, known.position_n[1], atol=0.05)
        assert seen.similarity(np.ones(2), 0.01).tolist() == pytest.approx([0.0, 1.0], abs=5e-3)


def test_a_whole_side_has_a_length_the_others_have_not() -> None:
    two, three = (landmark("a", place_at(30.0, 240.0), turn=turn) for turn in (0.4, 1.1))
    assert partial(two, catalogue([two])).known.tolist() == [True, False, False, True]
    assert partial(three, catalogue([three])).known.tolist() == [True, True, False, True]
    other = landmark("a", two.centre_n, WIDTH, 2.0 * LENGTH, turn=0.4)  # the side seen is twice as long
    assert not len(partial_runs(two, other))


def partial_runs(mark: Landmark, other: Landmark) -> Array:
    one = sighting(mark, catalogue([other]))
    return np.zeros(0) if one is None or one.partial is None else one.partial.target_n


def test_a_landmark_whose_other_corners_would_be_in_view_is_none() -> None:
    """The same corners belong to a roof half as long: all of it would be seen."""
    mark = landmark("a", place_at(5.0, 240.0), turn=0.3 + 0.5 * math.pi)
    assert len(partial_runs(mark, mark)) == 1
    inside = landmark("a", place_at(5.0, 240.0), WIDTH, 0.35 * LENGTH, turn=0.3 + 0.5 * math.pi)
    assert not len(partial_runs(mark, inside))


def test_a_chain_is_the_longest_run_of_seen_corners() -> None:
    points = np.arange(7.0)[:, None]
    seen = np.array([True, False, True, False, False, True, True])
    found = chain(points, seen)
    assert found is not None
    assert found.ravel().tolist() == [4.0, 5.0, 6.0, 0.0, 1.0]  # around the end, with its neighbours
    assert chain(points, np.ones(7, np.bool_)) is None
    assert chain(points, np.array([False, True, False, True, False, False, False])) is None


def test_corners_at_the_border_or_where_nothing_was_seen_are_not_the_roofs() -> None:
    corners = np.array([[1.0, 50.0], [50.0, 50.0], [80.0, 50.0], [99.0, 99.0]])
    valid = np.full((100, 100), 255, np.uint8)
    valid[:, 78:] = 0
    assert seen_corners(corners, 100, 100, None).tolist() == [False, True, True, False]
    assert seen_corners(corners, 100, 100, valid).tolist() == [False, True, False, False]


def test_a_row_that_was_not_measured_has_density_one() -> None:
    rng = np.random.default_rng(0)
    L = np.tril(rng.normal(size=(7, 7))) + 3.0 * np.eye(7)
    N, y, A, wide = L @ L.T, rng.normal(size=7), rng.normal(size=(7, 8)), np.ones(7)
    kept = [0, 1, 3, 4, 5, 6]
    small = N[np.ix_(kept, kept)].copy()
    by_hand = _whiten(small, y[kept].copy(), A[kept].copy())
    _say_nothing(2, y, A, N, wide)
    assert _whiten(N, y, A) == pytest.approx(by_hand)
    assert (y[2], wide[2], np.abs(A[2]).max()) == (0.0, 0.0, 0.0)


def test_roofs_at_the_border_tell_similar_landmarks_apart() -> None:
    """One whole roof among look-alikes stays open; with two more that the border cuts the place is sure, and right."""
    rng = np.random.default_rng(3)
    middle = landmark("m", place_at(320.0, 240.0))
    edge = [landmark("l", place_at(20.0, 200.0), 8.6, 13.4), landmark("r", place_at(620.0, 300.0), 7.5, 14.6)]
    shift = [np.array([0.0, 26.0]), np.array([24.0, 2.0]), np.array([-25.0, 9.0])]
    others = [
        landmark(
            f"{m.id}{k}", tuple(np.array(m.centre_n) + s + rng.uniform(-1.5, 1.5, 2)), *rng.uniform((7.4, 13.0), (8.6, 15.0))
        )
        for m in (middle, *edge)
        for k, s in enumerate(shift)
    ]
    known = catalogue([middle, *edge, *others])
    cut = [one for m in edge if (one := sighting(m, known))]
    assert len(cut) == 2
    px = pixels(middle)
    region = Region(px, px, 1.0, (0, 0, 1, 1), np.ones((1, 1), np.bool_), False, (1.0, 2.0, 3.0), 0.1, 1)
    whole = sightings.from_one_camera(region, PRIOR, RIG, ROOF_D)
    assert whole is not None
    wide = replace(PRIOR, covariance=np.diag([400.0] * 3 + [math.radians(1.0) ** 2] * 3))
    alone = identify([whole], known, wide, RIG, 0.01)
    assert alone.position_posterior < 0.9
    together = identify([whole, *cut], known, wide, RIG, 0.01)
    assert [known.ids[k] if k != NONE else "" for k in together.landmark] == ["m", "l", "r"]
    assert together.position_posterior > 0.9999
    assert np.linalg.norm(together.x[:3]) < 2.0
