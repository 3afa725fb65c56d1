"""What an object that is not in the map looks like: like those that are."""

import math

import numpy as np
import pytest

from models.maps.landmarks import Landmark
from models.messages import Array
from vision.identify.catalogue import Assumptions, Catalogue, catalogue
from vision.identify.clutter import attributes, grid, intensity

NOISE = np.diag([0.01, 0.01, 0.01, 0.01]) ** 2
LEVEL = np.zeros(1)


def street(turns: Array) -> Catalogue:
    """Houses of 8 by 11 m, 25 m apart, turned by turns (N,), the nearest first."""
    half = math.isqrt(len(turns)) / 2.0
    axis = 25.0 * np.arange(-half + 0.5, half)
    positions = sorted(((n, e) for n in axis for e in axis), key=lambda position: math.hypot(*position))
    marks = []
    for k, (turn, position) in enumerate(zip(turns, positions, strict=True)):
        c, s = math.cos(turn), math.sin(turn)
        outline = 0.5 * np.array([[11.0, 8.0], [11.0, -8.0], [-11.0, -8.0], [-11.0, 8.0]]) @ np.array([[c, s], [-s, c]])
        marks.append(Landmark.of(str(k), outline + np.array(position), 0.0, 3.0))
    return catalogue(marks)


def density(known: Catalogue, orientation: float, turns: Array = LEVEL) -> Array:
    """Of a house that lies so, by how the image may be turned (T,)."""
    features = np.array([[math.log(8.0), math.log(11.0), 1.0, orientation]])
    return attributes(features, NOISE[None], known, turns, LEVEL, Assumptions())[0, :, 0]


def test_in_a_street_what_is_not_in_the_map_lies_as_what_is() -> None:
    """Were orientations smoothed more than they differ, a landmark of the next block would look likelier than it is."""
    aligned = street(np.random.default_rng(1).normal(0.5, math.radians(1.0), 36))
    scattered = street(np.random.default_rng(1).uniform(0.0, math.pi, 36))
    assert density(aligned, 0.5) > 5.0 * density(scattered, 0.5)
    assert density(aligned, 0.9) == pytest.approx(density(aligned, 1.2))  # anything: nothing lies like that


def test_what_is_not_in_the_map_differs_no_more_than_what_is() -> None:
    """All houses of the map are rectangles: so are the others. With a kernel of 0.03 a fill ratio of 0.96 was half as likely."""
    known = street(np.random.default_rng(1).uniform(0.0, math.pi, 64))
    features = np.array([[math.log(8.0), math.log(11.0), fill, 0.5] for fill in (1.0, 0.96)])
    noise = np.repeat(NOISE[None], 2, axis=0)
    like, unlike = attributes(features, noise, known, LEVEL, LEVEL, Assumptions())[:, 0, 0]
    assert like > 100.0 * unlike


def test_attributes_are_those_at_the_turn_that_is_asked_about() -> None:
    """A house that seems to lie 0.1 rad off the street lies along it if the image is turned by as much."""
    aligned = street(np.full(36, 0.5))
    of_turns = density(aligned, 0.4, np.array([-0.1, 0.0, 0.1]))
    assert of_turns[2] > 5.0 * of_turns[1]
    assert of_turns[2] == pytest.approx(density(aligned, 0.5)[0])


def test_at_the_end_of_the_map_streets_do_not_grow_thin() -> None:
    """From each of the nearest landmarks its neighbours count, the farther ones of the map as well."""
    known = street(np.zeros(144))
    arm = np.array([[0.0, 0.0, 50.0], [75.0, 50.0, 50.0]])  # three blocks and two apart
    found = intensity(arm, np.zeros((2, 3, 3)), known, LEVEL, LEVEL, Assumptions())[1, 0, 0]
    assert found == pytest.approx(0.3 / 0.7 / math.pi, rel=0.25)  # one on nearly every place, in a circle of 1 m


def test_turns_and_scales_are_those_that_the_prior_leaves_open() -> None:
    covariance = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, math.radians(2.0) ** 2, 0.01**2])
    turns, log_scales = grid(covariance)
    np.testing.assert_allclose([turns[0], turns[-1], log_scales[-1]], [-math.radians(4.0), math.radians(4.0), 0.02])
    assert np.diff(turns).max() <= math.radians(1.0) + 1e-12
