"""The coarse search on rendered images: votes, places, what moves how, and what it must reject."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import cv2
import msgspec
import numpy as np
import pytest

from models import so3
from models.camera import CameraModel
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from tests import long
from tests.vision.roofs import nadir_rig
from vision.image.rectify import Image
from vision.image.reduced import Field, Level, levels
from vision.outline.visibility import MapError, Prisms
from vision.pose.sensitivity import Eye, eyes
from vision.predict import coarse_search
from vision.predict.coarse_search import Candidate, CoarseConfig, Search
from vision.predict.edge_points import chains, chromas, edge_points
from vision.predict.motion import motion, moved, straight
from vision.predict.search_level import SearchLevel
from vision.predict.votes import aim, vote
from vision.synthetic.camera_effects import Conditions
from vision.synthetic.ground import Ground
from vision.synthetic.render import render
from vision.synthetic.world import Appearance, Sun, World

HEIGHT_M = 40.0
RIG = nadir_rig(lens=(-0.1, 0.02, 0.0, 0.0))
EYE = eyes(RIG)[0]
SIGMA = np.array([3.5, 3.5, 1.0, *np.radians([0.5, 0.5, 2.0])])


class Seen(NamedTuple):
    image: Image
    marks: tuple[Landmark, ...]
    p_n: Array
    R_nb: Array


def box(
    name: str, position: tuple[float, float], angle: float, sigma_m: float = 0.0, colour: tuple[int, int, int] | None = None
) -> Landmark:
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = np.array([(-4.0, -2.5), (4.0, -2.5), (4.0, 2.5), (-4.0, 2.5)]) @ turn + position
    return Landmark.of(name, corners, 0.0, 3.0, colour, sigma_m)


@cache
def seen(sigma_m: float = 0.0, tilt: float = 0.1) -> Seen:
    """Three grey roofs that differ in place and direction, textured, in no map colour."""
    rng = np.random.default_rng(4)
    marks = tuple(
        box(str(k), position, angle, sigma_m)
        for k, (position, angle) in enumerate((((2.0, 1.0), 0.3), ((-7.0, 9.0), 1.2), ((5.0, -9.0), 2.0)))
    )
    looks = tuple(Appearance((118.0, 126.0, 130.0), texture="shingles", contrast=0.1) for _ in marks)
    p_n, R_nb = np.array([0.5, -0.5, -HEIGHT_M]), so3.matrix(so3.from_euler(tilt, -0.05, 0.8))
    world = World(marks, looks, (), Ground.procedural(rng), Sun(1.0))
    return Seen(render(world, RIG.left, *RIG.camera_pose(p_n, R_nb), Conditions(), rng), marks, p_n, R_nb)


def prior_off(view: Seen, error: Array) -> Prior:
    """A prior whose error is `error`: truth = prior (+) error."""
    q = so3.normalise(so3.multiply(so3.quat_exp(-error[3:]), so3.from_matrix(view.R_nb)))
    return Prior(view.p_n - error[:3], q, np.diag(SIGMA**2))


def found(view: Seen, prior: Prior, image: Image | None = None) -> list[Candidate]:
    moves = motion(EYE, view.marks, prior)
    assert moves is not None
    return Search(EYE, view.marks, moves, CoarseConfig()).candidates(view.image if image is None else image)


def off_px(view: Seen, position: Candidate, mapped: tuple[Landmark, ...] | None = None) -> float:
    """By how much the roofs' corners, as mapped, lie next to their true places, at most."""
    worst = 0.0
    for mark, known, shift in zip(view.marks, mapped or view.marks, position.shift_m, strict=True):
        ends = []
        for pose, outline in (((view.p_n, view.R_nb), mark.outline_n), (position.pose, known.outline_n + shift[:2])):
            p_nk, R_nk = EYE.pose(*pose)
            ends.append(EYE.camera.project((np.column_stack((outline, np.full(4, mark.roof_d))) - p_nk) @ R_nk))
        worst = max(worst, float(np.linalg.norm(ends[1] - ends[0], axis=1).max()))
    return worst


@long.parametrize("seed", range(6))
def test_outlines_a_hundred_pixels_off_are_found_to_a_few(seed: int) -> None:
    rng = np.random.default_rng(seed)
    direction = rng.uniform(0.0, 2.0 * np.pi)
    error = np.array([7.0 * np.cos(direction), 7.0 * np.sin(direction), *rng.normal(size=4) * SIGMA[2:]])
    positions = found(seen(), prior_off(seen(), error))
    assert off_px(seen(), positions[0]) < 6.0
    assert all(position.score < 0.6 * positions[0].score for position in positions[1:])
    assert positions[0].support.sum() > 0.5 * positions[0].length.sum()


def test_what_a_narrow_prior_leaves_open_is_sought_in_a_less_reduced_image(monkeypatch: pytest.MonkeyPatch) -> None:
    reduced: list[tuple[int, ...]] = []

    def noted(image: Image, camera: CameraModel, sizes: tuple[int, ...]) -> list[Level]:
        reduced.append(sizes)
        return levels(image, camera, sizes)

    monkeypatch.setattr(coarse_search, "levels", noted)
    for share in (1.0, 0.05):
        prior = prior_off(seen(), share * SIGMA)
        positions = found(seen(), Prior(prior.p_n, prior.q_nb_wxyz, share**2 * prior.covariance))
        assert off_px(seen(), positions[0]) < 6.0
    wide, narrow = reduced
    assert narrow[0] == wide[0]
    assert narrow[-1] < wide[-1]


@pytest.mark.parametrize(("off_px", "looks"), [(0.0, 1), (2.5, 2)])
def test_a_position_that_a_fit_hardly_moves_is_not_fitted_again(
    off_px: float, looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    view, voted, vote_of = seen(), list[int](), SearchLevel.vote
    moves = motion(EYE, view.marks, prior_off(view, np.zeros(6)))
    assert moves is not None
    search = Search(EYE, view.marks, moves, CoarseConfig())
    (level,) = levels(view.image, EYE.camera, (1,))
    search_level = SearchLevel(level, EYE, view.marks, moves, 0.2, 160.0, 160)
    as_predicted = Candidate(*moves.pose(np.zeros(6)), np.zeros(6), np.zeros((3, len(MapError))), np.zeros(3), np.zeros(3), 0.0)
    true = search._again(search_level, as_predicted, 2)
    position = replace(true, error=true.error + moves.gain[:, 0] * off_px)

    def noted(search_level: SearchLevel, *args: Array) -> tuple[Array, Array]:
        voted.append(1)
        return vote_of(search_level, *args)

    monkeypatch.setattr(SearchLevel, "vote", noted)
    near = search._nearest(search_level, position, 2)
    assert len(voted) == looks
    assert np.abs(moves.J @ (near.error - true.error))[:2].max() < 1.0


def test_landmarks_that_are_off_the_map_find_their_own_places() -> None:
    """Each roof 0.6 m aside of where the map has it, in another direction."""
    view = seen(sigma_m=0.5)
    aside = np.array([(0.6, 0.0), (-0.3, 0.5), (-0.3, -0.5)])
    mapped = tuple(
        Landmark.of(m.id, m.outline_n - d, m.base_d, m.height_m, None, 0.5) for m, d in zip(view.marks, aside, strict=True)
    )
    wrong = view._replace(marks=mapped)
    (position, *_) = found(wrong, prior_off(wrong, np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.0])))
    assert off_px(view, position, mapped) < 6.0
    assert np.abs(position.shift_m[:, :2]).max() > 0.3


def test_a_landmark_that_is_larger_than_mapped_is_found_as_large_as_it_is() -> None:
    """Two standard deviations, 4 px on each side: as mapped it lies on two sides of four at best, and off by that much."""
    view, growth, smaller = seen(), 0.28, np.zeros((3, len(MapError)))
    smaller[:, MapError.GROWTH] = -growth
    outlines = Prisms.of(view.marks).moved(smaller).vertices.reshape(3, 4, 2)
    mapped = tuple(Landmark.of(m.id, outline, m.base_d, m.height_m) for m, outline in zip(view.marks, outlines, strict=True))
    unsure = tuple(msgspec.structs.replace(m, outline_sigma_m=0.5 * growth) for m in mapped)
    as_mapped, as_large = (
        found(wrong, prior_off(wrong, np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.0])))[0]
        for wrong in (view._replace(marks=mapped), view._replace(marks=unsure))
    )
    np.testing.assert_allclose(as_large.shift_m[:, MapError.GROWTH], growth, atol=0.1)
    assert not as_mapped.shift_m[:, MapError.GROWTH].any()
    assert off_px(view, as_large, view.marks) < 6.0
    assert as_large.support.sum() > 1.2 * as_mapped.support.sum()


def test_voters_move_with_what_the_landmarks_are_off_the_map() -> None:
    """Points on edges of the roofs and of the walls' feet lie on the edges of the bodies that are moved and grown alike."""
    view, shift_m = seen(), np.zeros((3, len(MapError)))
    shift_m[:, MapError.NORTH], shift_m[:, MapError.EAST], shift_m[:, MapError.GROWTH] = 0.4, -0.7, (0.0, 0.5, -0.3)
    body, eye = Prisms.of(view.marks), straight(EYE)
    made = edge_points(eye, body, chromas(view.marks), (view.p_n, view.R_nb), 0.0, 300)
    assert made is not None
    corners = body.moved(shift_m).vertices.reshape(3, 4, 2)
    start, end = corners[made.mark_of_point], np.roll(corners, -1, axis=1)[made.mark_of_point]
    side, off = end - start, made.moved(shift_m)[:, None, :2] - start
    across = np.abs(side[..., 0] * off[..., 1] - side[..., 1] * off[..., 0]) / np.linalg.norm(side, axis=2)
    level = np.linalg.norm(made.direction_n[:, :2], axis=1) > 0.0
    assert level.sum() > 100
    np.testing.assert_allclose(across.min(axis=1)[level], 0.0, atol=1e-9)


def test_a_position_pays_for_what_in_the_prior_contradicts_it() -> None:
    """score = sum (support - tau length) - dx^T P^-1 dx / 2: seen from a worse prior the same place is worth less by that."""
    view, positions = seen(), []
    for error in (np.zeros(6), np.array([5.0, -4.0, 0.0, 0.0, 0.0, 0.0])):
        position = found(view, prior_off(view, error))[0]
        chi2 = float(np.sum((position.error / SIGMA) ** 2))
        votes = float((position.support - CoarseConfig().expected * position.length).sum())
        assert position.score == pytest.approx(votes - 0.5 * chi2)
        positions.append((votes, chi2))
    assert positions[1][1] - positions[0][1] > 2.0
    assert positions[1][0] == pytest.approx(positions[0][0], rel=0.1)


def test_empty_ground_gives_no_position_worth_a_fit() -> None:
    """The best place of outlines that are not there has less than half of the support per length of the true one."""
    view, rng = seen(), np.random.default_rng(9)
    empty = World((), (), (), Ground.procedural(rng), Sun(1.0))
    ground = render(empty, RIG.left, *RIG.camera_pose(view.p_n, view.R_nb), Conditions(), rng)
    prior = prior_off(view, np.zeros(6))
    (true, *_), (chance, *_) = found(view, prior), found(view, prior, ground)
    assert chance.support.sum() / chance.length.sum() < 0.5 * true.support.sum() / true.length.sum()
    assert chance.score < 0.3 * true.score


def test_the_gain_is_the_likeliest_error_that_moves_the_outlines_so() -> None:
    prior = prior_off(seen(), np.zeros(6))
    moves = motion(EYE, seen().marks, prior)
    assert moves is not None
    q = np.array([30.0, -20.0, 0.05, 0.02])
    dx = moves.gain @ q
    np.testing.assert_allclose(moves.J @ dx, q, rtol=0.02, atol=0.01)
    other = dx + (np.eye(6) - np.linalg.pinv(moves.J) @ moves.J) @ (0.1 * SIGMA)
    np.testing.assert_allclose(moves.J @ other, moves.J @ dx, atol=1e-6)
    assert dx @ (dx / SIGMA**2) < other @ (other / SIGMA**2)


def test_points_move_in_the_image_as_their_derivative_reports() -> None:
    pinhole, view = straight(EYE), seen()
    points = np.column_stack((view.marks[0].outline_n, np.full(4, -3.0)))

    def px(error: Array) -> Array:
        p_nk, R_nk = pinhole.pose(view.p_n + error[:3], so3.matrix(so3.quat_exp(error[3:])) @ view.R_nb)
        return pinhole.camera.project((points - p_nk) @ R_nk)

    p_nk, R_nk = pinhole.pose(view.p_n, view.R_nb)
    D = moved(pinhole.camera, (points - p_nk) @ R_nk, points - view.p_n, R_nk)
    for k in range(6):
        step = 1e-5 * np.eye(6)[k]
        np.testing.assert_allclose(D[:, :, k], (px(step) - px(-step)) / 2e-5, rtol=1e-4, atol=1e-3)


def test_aim_is_projection_and_its_shift_is_a_shift() -> None:
    """A shift of one pixel by the gain moves the middle of the outlines by one pixel."""
    view = seen()
    prior = prior_off(view, np.zeros(6))
    moves = motion(EYE, view.marks, prior)
    assert moves is not None
    pinhole = straight(EYE)
    p_nk, R_nk = pinhole.pose(view.p_n, view.R_nb)
    points = np.concatenate([np.column_stack((m.outline_n, np.full(4, m.roof_d))) for m in view.marks])
    direction = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    aimed = aim(points, direction, view.p_n, moves.gain[:, :2], p_nk, R_nk, 600.0, 600.0)
    np.testing.assert_allclose(aimed[:, :3], (points - p_nk) @ R_nk, atol=1e-9)
    for axis in range(2):
        before = pinhole.camera.project(aimed[:, :3])
        after = pinhole.camera.project(aimed[:, :3] + aimed[:, 3 + 3 * axis : 6 + 3 * axis])
        np.testing.assert_allclose((after - before).mean(axis=0), np.eye(2)[axis], atol=0.05)
    along = pinhole.camera.project((points + 1e-4 * direction - p_nk) @ R_nk) - pinhole.camera.project(aimed[:, :3])
    np.testing.assert_allclose(np.sum(along * aimed[:, 9:], axis=1), 0.0, atol=1e-6)


def step_field(sign: float, noise: float, size: int = 60) -> tuple[Field, CameraModel]:
    """The field of an image with one upright edge in its middle, in noise."""
    camera = CameraModel(size, size, 100.0, 100.0, 0.5 * size, 0.5 * size)
    image = np.full((size, size, 3), 100.0) + np.random.default_rng(1).normal(0.0, noise, (size, size, 3))
    image[:, size // 2 :] += sign * np.array([10.0, 20.0, 40.0])
    return levels(np.clip(image, 0, 255).astype(np.uint8), camera, (1,))[0].whole(), camera


def edge_votes(field: Field, camera: CameraModel, chroma: Array, points: int = 14, apart_px: float = 3.0) -> Array:
    """Support per length of an upright line of points, shifted by -10 ... 10 px across."""
    aimed = np.zeros((points, 11))
    aimed[:, 1], aimed[:, 2] = (np.arange(points) - points / 2) * apart_px / 100.0, 1.0
    aimed[:, 3], aimed[:, 9] = 0.01, 1.0  # a shift in u, normal to the right
    shifts = np.arange(-10.0, 11.0)
    support, length = vote(
        field, np.array([100.0, 100.0, camera.cx, camera.cy]), aimed, np.array([0, points]), np.array([0]), np.array([1.0]),
        chroma[None, :], 1, 0.5, shifts, np.zeros(1),
    )  # fmt: skip
    return np.asarray(support[0, :, 0] / np.maximum(length[0, :, 0], 1e-9))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_edge_is_found_whatever_its_sign_and_texture_is_none(sign: float) -> None:
    share = edge_votes(*step_field(sign, 4.0), np.zeros(3))
    assert 9 <= int(np.argmax(share)) <= 11
    assert share.max() > 0.7
    assert abs(share[:7].mean()) < 0.06


def test_few_points_in_texture_have_no_more_votes_than_many() -> None:
    """No point is compared with itself: the mean over places is near 0 for three points as for thirty."""
    field, camera = step_field(0.0, 12.0)
    for points in (3, 18):
        assert abs(edge_votes(field, camera, np.zeros(3), points).mean()) < 0.12


def test_the_colour_of_the_map_on_the_wrong_side_costs_votes() -> None:
    """The right side is redder. An outline whose inside is the left one must not be red there."""
    field, camera = step_field(1.0, 2.0)
    red = np.array([-1.0, -0.2, 1.2]) / np.linalg.norm([-1.0, -0.2, 1.2])
    wrong, right = edge_votes(field, camera, red).max(), edge_votes(field, camera, -red).max()
    assert wrong < 0.5 * right


def test_a_reduced_image_is_the_camera_without_its_lens() -> None:
    """A mark drawn at a projected point stands where the reduced camera projects it."""
    point = np.array([[3.0, -2.0, 10.0]])
    image = np.zeros((480, 640), dtype=np.uint8)
    (u, v) = RIG.left.project(point)[0]
    cv2.circle(image, (round(float(u)), round(float(v))), 12, 255, -1)
    for level in levels(image, RIG.left, (2, 4, 8)):
        weight = level.whole()[:, :, 6].astype(float).clip(0.0)
        rows, columns = np.indices(weight.shape)
        middle = np.array([(columns * weight).sum(), (rows * weight).sum()]) / weight.sum()
        np.testing.assert_allclose(middle, level.camera.project(point)[0], atol=0.6)


def test_what_the_lens_did_not_see_has_no_votes() -> None:
    """A lens that draws the corners inwards shows less than the reduced camera has room for."""
    cushion = CameraModel(640, 480, 600.0, 600.0, 319.5, 239.5, (0.15, 0.0, 0.0, 0.0))
    (level,) = levels(np.full((480, 640), 90, dtype=np.uint8), cushion, (8,))
    assert level.whole()[0, 0, 6] == -1.0
    assert level.whole()[30, 40, 6] == 0.0


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_a_field_is_made_wherever_votes_are_counted(turn: float) -> None:
    """Votes in a field made for some points and shifts, noise elsewhere, are those in the whole field; also seen askew."""
    rng, camera = np.random.default_rng(3), CameraModel(160, 120, 100.0, 100.0, 79.5, 59.5)
    image = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
    part, whole = (levels(image, camera, (1,))[0] for _ in range(2))
    vars(part)["_field"][:] = np.nan
    tilt = so3.matrix(so3.quat_exp(np.array([turn, 0.0, 0.0])))
    aimed = np.zeros((12, 11))
    aimed[:, :3] = (np.column_stack((rng.uniform(-4.0, 4.0, (12, 2)), np.zeros(12))) @ tilt.T) + [0.0, 0.0, 8.0]
    aimed[:, 3:6], aimed[:, 6:9], aimed[:, 9] = 0.08 * tilt[:, 0], 0.08 * tilt[:, 1], 1.0
    su, sv = np.arange(-20.0, 5.0), np.arange(-3.0, 30.0)
    one, marks = np.array([0, 12]), np.zeros(1, dtype=np.int64)
    camera_px, length = np.array([100.0, 100.0, 79.5, 59.5]), np.ones(1)
    made = part.field(aimed, (su[0], su[-1]), (sv[0], sv[-1]))
    assert np.isnan(made).any()
    votes = [vote(f, camera_px, aimed, one, marks, length, np.zeros((1, 3)), 1, 1.0, su, sv) for f in (made, whole.whole())]
    np.testing.assert_array_equal(votes[0], votes[1])


def test_a_curve_votes_in_pieces_that_are_long_enough() -> None:
    """A round roof of 40 short edges: joined to chains that bend, a rectangle keeps its sides."""
    angle = -2.0 * np.pi * np.arange(40) / 40
    curve = Landmark.of("round", 5.0 * np.column_stack((np.cos(angle), np.sin(angle))), 0.0, 0.0)
    small = Eye(CameraModel(80, 60, 75.0, 75.0, 39.5, 29.5), EYE.R_kb, EYE.p_bk, right=False)
    made = edge_points(small, Prisms.of([curve]), chromas([curve]), (np.array([0.0, 0.0, -20.0]), np.eye(3)), 0.0, 200)
    assert made is not None
    assert 6 <= len(made.mark) <= 16
    assert abs((made.length * np.diff(made.first)).sum() / (2.0 * np.pi * 5.0 * 75.0 / 20.0) - 1.0) < 0.1
    direction = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])
    kinds = np.zeros(4, dtype=np.int64)
    assert chains(kinds, kinds, np.full(4, 3.0), direction).tolist() == [0, 1, 2, 3]


def test_outlines_beyond_the_border_vote_once_they_come_into_view() -> None:
    """The prior has the only roof wholly out of the image; the search brings it back."""
    view = seen()._replace(marks=seen().marks[1:2])
    mark = view.marks[0]
    roof = np.column_stack((mark.outline_n, np.full(4, mark.roof_d)))

    def px(p_n: Array, R_nb: Array) -> Array:
        p_nk, R_nk = EYE.pose(p_n, R_nb)
        return EYE.camera.project((roof - p_nk) @ R_nk)

    assert EYE.camera.contains(px(view.p_n, view.R_nb)).any()
    far = 140.0 / 600.0 * HEIGHT_M
    errors = [far * np.array([np.cos(a), np.sin(a), 0.0]) for a in np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)]
    outside = [e for e in errors if not EYE.camera.contains(px(view.p_n - e, view.R_nb), -8.0).any()]
    assert outside
    positions = found(view, prior_off(view, np.concatenate((outside[len(outside) // 2], np.zeros(3)))))
    assert off_px(view, positions[0]) < 10.0
