"""The search of all that the prior leaves open: votes of landmarks as a whole, and what they leave out."""

import numpy as np
import pytest

from models.maps.landmarks import Landmark
from models.messages import Array
from tests.vision.predict.test_coarse_search import EYE, HEIGHT_M, Seen, prior_off, seen
from vision.image.reduced import Level, levels
from vision.predict.coarse_search import CoarseConfig, limit_px
from vision.predict.global_search import Grid, summits
from vision.predict.motion import Motion, motion
from vision.predict.rigid_votes import rigid_votes
from vision.predict.search_level import SearchLevel
from vision.predict.votes import vote

CONFIG = CoarseConfig()
SIZE = 4


def prepared(view: Seen, error: Array) -> tuple[SearchLevel, Motion, Grid]:
    """The search of an image reduced four times from a prior with this error."""
    moves = motion(EYE, view.marks, prior_off(view, error))
    assert moves is not None
    limit = limit_px(EYE.camera, CONFIG)
    level = levels(view.image, EYE.camera, (1, SIZE))[1]
    search_level = SearchLevel(level, EYE, view.marks, moves, CONFIG.expected, limit, CONFIG.points)
    return search_level, moves, Grid.of(moves, CONFIG.sigmas, np.radians(CONFIG.turn_deg), SIZE, limit)


def textured(normals: Array, apart_px: float = 2.0) -> tuple[Level, Array]:
    """An image of noise seen by a camera of 80 x 60, and eight points aimed at it, of which a shift moves all alike."""
    rng, camera = np.random.default_rng(5), EYE.camera
    small = levels(rng.integers(0, 255, (camera.height, camera.width, 3), dtype=np.uint8), camera, (8,))[0]
    c, aimed = small.camera, np.zeros((len(normals), 11))
    aimed[:, 0] = (apart_px * np.arange(len(normals)) + 20.25 - c.cx) / c.fx
    aimed[:, 1], aimed[:, 2], aimed[:, 3], aimed[:, 7] = (30.25 - c.cy) / c.fy, 1.0, 1.0 / c.fx, 1.0 / c.fy
    aimed[:, 9:] = normals
    return small, aimed


@pytest.mark.parametrize("bend", [0.0, 0.4])
@pytest.mark.parametrize("reach", [3, 34])
def test_what_moves_as_a_whole_has_the_votes_of_its_points(bend: float, reach: int) -> None:
    """Sums of images laid on each other are sums over points: straight and curved, in windows smaller than the edge and larger
    than the way to the border, with a colour on one side, and with what the lens did not see.
    """
    angle = bend * np.arange(8)
    level, aimed = textured(np.column_stack((np.cos(angle), np.sin(angle))))
    c, chroma, first = level.camera, np.array([[0.6, -0.8, 0.0], [0.0, 0.0, 0.0]]), np.array([0, 5, 8])
    mark, length = np.array([0, 1]), np.array([2.0, 3.0])
    shifts = np.arange(-reach, reach + 1.0)
    field = level.whole()
    field[28:31, 24:27, 6] = -1.0
    camera = np.array([c.fx, c.fy, c.cx, c.cy])
    support, seen_px = vote(field, camera, aimed, first, mark, length, chroma, 2, 1.0, shifts, shifts)
    pixel = np.column_stack((20 + 2 * np.arange(8), np.full(8, 30)))
    window = (-reach, reach, -reach, reach)
    whole = rigid_votes(field, pixel, aimed[:, 9:].copy(), first, mark, length, chroma, 2, 1.0, 0.2, window)
    np.testing.assert_allclose(whole, (support - 0.2 * seen_px).transpose(0, 2, 1), atol=1e-4)
    assert np.ptp(whole) > 1.0


def test_the_votes_of_a_turn_and_scale_are_those_of_its_own_points() -> None:
    """Computed once for many turns and scales, the score of a summit is nearly what all points aimed from there have."""
    search_level, moves, grid = prepared(seen(), np.array([3.0, -2.0, 0.5, 0.0, 0.0, 0.05]))
    scores, positions = summits(search_level, moves, grid)
    assert search_level.own_radius() < 0.6 * moves.radius  # so that landmarks look alike in several of them
    information = np.linalg.inv(moves.covariance)
    off = []
    for score, q in zip(scores[:10], positions[:10], strict=True):
        aimed = search_level.aimed(moves.pose(moves.gain @ np.array([0.0, 0.0, *q[2:]])))
        votes, _ = search_level.vote(aimed, q[:1], q[1:2])
        off.append(score - (SIZE * float(votes.sum()) - 0.5 * q @ information @ q))
    assert np.abs(off).max() < 0.25 * scores[0]
    assert abs(np.mean(off)) < 0.1 * scores[0]


@pytest.mark.parametrize("turn", [-0.08, 0.0, 0.08])
def test_the_best_summit_is_where_the_outlines_are(turn: float) -> None:
    """To a step of the grid, for a prior that is turned by two of its standard deviations, too."""
    error = np.array([4.0, 3.0, 1.0, 0.0, 0.0, turn])
    search_level, moves, grid = prepared(seen(), error)
    q = summits(search_level, moves, grid)[1][0]
    off = q - moves.J @ error
    assert np.sqrt(off @ search_level.across(q) @ off) < 1.5 * SIZE


def test_a_landmark_alone_is_reported_in_every_turn_and_scale() -> None:
    """Its own radius is that of all outlines: votes of one turn and scale serve no other."""
    alone = seen()._replace(marks=seen().marks[:1])
    search_level, moves, _ = prepared(alone, np.zeros(6))
    assert search_level.own_radius() == pytest.approx(moves.radius, rel=0.3)


def test_landmarks_off_the_map_vote_as_far_off_as_it_leaves_open() -> None:
    """Three roofs, each aside of where the map has it in another direction: together they have a summit only if they may be."""
    aside = np.array([(0.6, 0.0), (-0.3, 0.5), (-0.3, -0.5)]) * (2.0 * SIZE * HEIGHT_M / 600.0)
    scores = []
    for sigma_m in (0.0, 0.6):
        view = seen()
        marks = tuple(
            Landmark.of(m.id, m.outline_n - d, m.base_d, m.height_m, None, sigma_m)
            for m, d in zip(view.marks, aside, strict=True)
        )
        search_level, moves, grid = prepared(view._replace(marks=marks), np.zeros(6))
        scores.append(summits(search_level, moves, grid)[0][0])
    assert scores[1] > 1.2 * scores[0]
