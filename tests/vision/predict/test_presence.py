"""The odds that a landmark stands, from how the gradients lie along its sides."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from models.messages import Array
from vision.outline.visibility import Kind
from vision.predict.presence import across, log_likelihood_ratio

EVERY = 6  # px from point to point
Image = NDArray[np.uint8]


def texture(seed: int) -> Image:
    """Nothing but noise, 200 x 200."""
    return np.random.default_rng(seed).integers(60, 120, (200, 200, 3)).astype(np.uint8)


def with_step(image: Image, at: int) -> Image:
    """Above row `at` it is brighter and of another colour."""
    stepped = image.copy()
    stepped[:at] += np.array([20, 90, 120], np.uint8)
    return stepped


def side(row: int, points: int) -> tuple[Array, Array]:
    """Points of a side along a row and their normals."""
    px = np.column_stack((20.0 + EVERY * np.arange(points), np.full(points, row - 0.5)))
    return px, np.tile([0.0, 1.0], (points, 1))


def log_ratio(image: Image, sides: list[tuple[Array, Array]], images: int = 1, kind: Kind = Kind.ROOF) -> float:
    px, normal = (np.concatenate(ones) for ones in zip(*sides, strict=True))
    edge = np.repeat(np.arange(len(sides)), [len(one[0]) for one in sides])
    sums = across(image, px, normal, edge, len(sides), np.ones(len(px), np.bool_))
    return float(log_likelihood_ratio([sums] * images, np.zeros(len(sides), np.int64), 1, np.full(len(sides), int(kind)))[0])


def test_sides_on_edges_speak_for_a_landmark_and_sides_on_nothing_against_it() -> None:
    image = with_step(texture(1), 100)
    on, off = log_ratio(image, [side(100, 12)]), np.array([log_ratio(texture(seed), [side(100, 12)]) for seed in range(60)])
    assert math.exp(on) == pytest.approx(0.9 / 0.1, rel=0.05)  # (1 - h) / q, no more
    assert off.mean() < -1.0
    assert (off > 1.0).mean() < 0.05  # by chance


@pytest.mark.parametrize(("kind", "most"), [(Kind.BASE, 0.8 / 0.2), (Kind.UPRIGHT, 0.8 / 0.2), (Kind.SMALL, 0.85 / 0.05)])
def test_walls_speak_less_than_roofs_and_a_whole_rim_more_than_a_side(kind: Kind, most: float) -> None:
    assert math.exp(log_ratio(with_step(texture(1), 100), [side(100, 12)], kind=kind)) == pytest.approx(most, rel=0.05)


def test_a_corner_of_two_streets_is_as_likely_a_house_as_not() -> None:
    """Two sides lie on kerbs, two on nothing: with one map entry in ten gone that is not enough."""
    sides = [side(100, 12), side(100, 20), side(40, 12), side(160, 20)]
    odds = [math.exp(log_ratio(with_step(texture(seed), 100), sides)) * 9.0 for seed in range(20)]
    assert np.median(odds) < 99.0
    whole = [math.exp(log_ratio(with_step(texture(seed), 100), [side(100, n) for n in (12, 20, 12)])) * 9.0 for seed in range(20)]
    assert min(whole) > 999.0


def test_the_fewer_points_a_side_shows_the_less_it_reports() -> None:
    ratio = [log_ratio(with_step(texture(2), 100), [side(100, n)]) for n in (1, 2, 3, 6, 12)]
    assert ratio[0] == 0.0
    assert np.all(np.diff(ratio) > 0.0)
    assert math.exp(ratio[2]) < 7.0


def test_both_images_of_a_pair_say_it_once() -> None:
    image = with_step(texture(3), 100)
    assert log_ratio(image, [side(100, 8)], images=2) == log_ratio(image, [side(100, 8)])


def test_points_outside_the_image_do_not_count() -> None:
    px, normal = side(100, 60)
    sums = across(with_step(texture(4), 100), px, normal, np.zeros(60, np.int64), 1, np.ones(60, np.bool_))
    assert sums[0, -1] == len([u for u in px[:, 0] if u < 199.0 - 0.5])
    nothing = across(texture(4), px - 500.0, normal, np.zeros(60, np.int64), 1, np.ones(60, np.bool_))
    assert not nothing.any()


def test_an_even_image_has_no_edges() -> None:
    even = np.full((200, 200, 3), 90, np.uint8)
    assert log_ratio(even, [side(100, 12)]) < -2.0
