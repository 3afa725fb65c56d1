"""One score of all outlines together: its summit is where they are, and it says when another place is as good."""

import numpy as np
import pytest
from numpy.typing import NDArray

from models.camera import CameraModel
from models.messages import Array
from vision.image.reduced import Level
from vision.predict.joint_score import Summit, joint_score, summit

SIZE, FLOOR = 200, 2.0
CAMERA = CameraModel(SIZE, SIZE, 1.0, 1.0, 0.0, 0.0)  # x_c = (u, v, 1)
SHIFTS = np.arange(-30.0, 31.0)
OPEN = np.eye(2) * 1e6  # a prior that prefers nothing
BOXES = ((40, 50, 30, 18), (90, 60, 20, 20), (60, 110, 26, 34))  # u, v, width, height
Image = NDArray[np.uint8]


def outlines(boxes: tuple[tuple[int, int, int, int], ...] = BOXES) -> Array:
    """Points (N, 11) as the score takes them, half a pixel from the boxes' outermost ones."""
    points, normals = [], []
    for u, v, width, height in boxes:
        along_u, along_v = np.arange(u, u + width) + 0.0, np.arange(v, v + height) + 0.0
        for edge, normal in (
            (np.column_stack((along_u, np.full(width, v - 0.5))), (0.0, -1.0)),
            (np.column_stack((along_u, np.full(width, v + height - 0.5))), (0.0, 1.0)),
            (np.column_stack((np.full(height, u - 0.5), along_v)), (-1.0, 0.0)),
            (np.column_stack((np.full(height, u + width - 0.5), along_v)), (1.0, 0.0)),
        ):
            points.append(edge)
            normals.append(np.tile(normal, (len(edge), 1)))
    px, n = np.concatenate(points), np.concatenate(normals)
    aimed = np.zeros((len(px), 11))
    aimed[:, :2], aimed[:, 2], aimed[:, 3], aimed[:, 7], aimed[:, 9:] = px, 1.0, 1.0, 1.0, n
    return aimed


def drawn(shift: tuple[int, int], boxes: tuple[tuple[int, int, int, int], ...] = BOXES, noise: float = 0.0) -> Image:
    """The boxes, each of its own brightness, in an image of noise."""
    image = np.full((SIZE, SIZE), 100.0)
    for (u, v, width, height), level in zip(boxes, (160.0, 60.0, 130.0), strict=False):
        image[v + shift[1] : v + shift[1] + height, u + shift[0] : u + shift[0] + width] = level
    image += np.random.default_rng(3).normal(size=image.shape) * noise
    return np.asarray(np.clip(np.rint(image), 0, 255), dtype=np.uint8)


def scores(image: Image, aimed: Array) -> Array:
    level = Level(1, CAMERA, image, np.zeros((SIZE, SIZE), dtype=np.bool_))
    return joint_score(level.whole(), np.array([1.0, 1.0, 0.0, 0.0]), aimed, FLOOR, SHIFTS, SHIFTS)


def found(score: Array, su: Array = SHIFTS, covariance: Array = OPEN) -> Summit:
    """The summit at the one turn and scale there is."""
    whole = np.eye(4)
    whole[:2, :2] = covariance
    return summit(score[None], np.zeros((1, 2)), su, SHIFTS, whole, 8.0)


def test_the_summit_is_where_the_outlines_are() -> None:
    best = found(scores(drawn((13, -8), noise=15.0), outlines()))
    np.testing.assert_allclose(best.q[:2], [13.0, -8.0], atol=1.0)
    assert best.ratio > 1.5


def test_dark_and_bright_roofs_count_alike_and_so_does_any_contrast() -> None:
    strong = scores(drawn((5, 5)), outlines())
    weak = scores(np.asarray(100 + (drawn((5, 5)).astype(int) - 100) // 2, dtype=np.uint8), outlines())
    assert strong.max() > 0.3
    np.testing.assert_allclose(strong.max(), weak.max(), rtol=0.15)


def test_noise_alone_has_no_position() -> None:
    best = found(scores(drawn((0, 0), boxes=(), noise=15.0), outlines()))
    assert best.score < 0.15
    assert best.ratio < 1.3


def test_what_stands_there_twice_has_two_summits() -> None:
    one = ((40, 60, 20, 20),)
    image = drawn((0, 0), boxes=((40, 60, 20, 20), (64, 60, 20, 20)))
    best = found(scores(image, outlines(one)))
    assert 1.0 <= best.ratio < 1.1


def test_of_two_positions_as_good_the_prior_takes_its_own_and_no_ratio_reports_it() -> None:
    """Two boxes alike, 24 px apart: next to a prior of 10 px the one it is about is the place, whichever that is."""
    one = ((40, 60, 20, 20),)
    image = drawn((0, 0), boxes=one)
    image[60:80, 64:84] = image[60:80, 40:60]
    score = scores(image, outlines(one))
    for about in (0.0, 24.0):
        best = found(score, SHIFTS - about, np.eye(2) * 10.0**2)
        np.testing.assert_allclose(best.q[:2], [0.0, 0.0], atol=1.0)
        assert best.ratio < 1.1


def test_outlines_speak_louder_than_the_prior() -> None:
    best = found(scores(drawn((20, -15), noise=15.0), outlines()), covariance=np.eye(2) * 10.0**2)
    np.testing.assert_allclose(best.q[:2], [20.0, -15.0], atol=1.0)
    assert best.ratio > 1.5


def test_points_outside_the_image_say_nothing() -> None:
    """Half of the outlines far aside: the same summit, half as high; and what no shift shows has no score."""
    aimed, aside = outlines(), outlines()
    aside[:, 0] += 10.0 * SIZE
    inside = scores(drawn((13, -8), noise=15.0), aimed)
    both = scores(drawn((13, -8), noise=15.0), np.concatenate((aimed, aside)))
    np.testing.assert_allclose(both, 0.5 * inside, atol=1e-9)
    assert found(scores(drawn((13, -8)), aside)).score == 0.0


def test_the_turn_that_fits_is_found_and_a_rival_may_have_any_turn() -> None:
    there, rival = scores(drawn((13, -8), noise=15.0), outlines()), scores(drawn((-14, 9), noise=15.0), outlines())
    turned, open_ = np.array([(-0.05, 0.0), (0.0, 0.0), (0.05, 0.02)]), np.diag([1e4, 1e4, 1.0, 1.0])
    best = summit(np.array([0.1 * there, 0.5 * there, there]), turned, SHIFTS, SHIFTS, open_, 8.0)
    np.testing.assert_allclose(best.q, [13.0, -8.0, 0.05, 0.02], atol=1.0)
    assert best.q[2] == 0.05
    assert best.ratio > 1.5  # its own place at another turn is no rival
    doubtful = summit(np.array([0.9 * rival, 0.5 * there, there]), turned, SHIFTS, SHIFTS, open_, 8.0)
    assert doubtful.ratio == pytest.approx(there.max() / (0.9 * rival.max()), rel=0.1)


def test_a_turn_that_the_prior_excludes_needs_a_better_score() -> None:
    score = scores(drawn((0, 0), noise=15.0), outlines())
    turned = np.array([(0.0, 0.0), (0.2, 0.0)])
    best = summit(np.array([score, 1.05 * score]), turned, SHIFTS, SHIFTS, np.diag([1e4, 1e4, 1e-4, 1e-4]), 8.0)
    assert best.q[2] == 0.0
