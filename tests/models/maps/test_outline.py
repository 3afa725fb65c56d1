"""Polygon geometry against shapes whose answers are known, and OpenCV."""

import math

import cv2
import numpy as np
import pytest

from models.maps import outline
from models.maps.outline import EAST, FILL, LENGTH, NORTH, ORIENTATION, RADIUS, SIZE, WIDTH
from models.messages import Array

RECTANGLE = np.array([[0.0, 4.0], [10.0, 4.0], [10.0, 0.0], [0.0, 0.0]])  # 10 m north-south, 4 m east-west, anticlockwise
ELL = np.array([[0.0, 0.0], [0.0, 6.0], [2.0, 6.0], [2.0, 2.0], [8.0, 2.0], [8.0, 0.0]])


def turned(points: Array, angle: float, shift: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Turned from north towards east."""
    c, s = math.cos(angle), math.sin(angle)
    moved: Array = np.ascontiguousarray(points @ np.array([[c, s], [-s, c]]) + shift)
    return moved


def described(points: Array) -> Array:
    row: Array = outline.describe(points, np.array([0, len(points)]))[0]
    return row


def test_area_is_positive_when_anticlockwise_seen_from_above() -> None:
    """From the north-east corner to the north-west one is anticlockwise: north is up, east is right."""
    assert outline.area(np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])) == pytest.approx(4.0)
    assert outline.area(RECTANGLE) == pytest.approx(40.0)
    assert outline.area(np.ascontiguousarray(ELL[::-1])) == pytest.approx(-outline.area(ELL))


@pytest.mark.parametrize("angle", np.linspace(0.0, math.pi, 13)[:-1])
def test_description_of_a_rectangle_in_any_direction(angle: float) -> None:
    d = described(turned(RECTANGLE, angle, (5e4, -3e4)))
    assert d[SIZE] == pytest.approx(40.0)
    assert d[WIDTH] == pytest.approx(4.0)
    assert d[LENGTH] == pytest.approx(10.0)
    assert d[FILL] == pytest.approx(1.0)
    assert math.sin(d[ORIENTATION] - angle) == pytest.approx(0.0, abs=1e-9)
    assert 0.0 <= d[ORIENTATION] <= math.pi
    np.testing.assert_allclose(d[[NORTH, EAST]], turned(np.array([[5.0, 2.0]]), angle, (5e4, -3e4))[0], atol=1e-6)
    assert d[RADIUS] == pytest.approx(math.hypot(5.0, 2.0), abs=1e-6)


def test_description_of_an_l() -> None:
    d = described(np.ascontiguousarray(ELL[::-1]) if outline.area(ELL) < 0 else ELL)
    assert d[SIZE] == pytest.approx(24.0)
    rectangle = cv2.minAreaRect(ELL.astype(np.float32))
    assert d[WIDTH] * d[LENGTH] == pytest.approx(rectangle[1][0] * rectangle[1][1], rel=1e-5)
    assert d[FILL] == pytest.approx(24.0 / (d[WIDTH] * d[LENGTH]))
    assert d[NORTH] == pytest.approx((12 * 1 + 12 * 5) / 24)
    assert d[EAST] == pytest.approx((12 * 3 + 12 * 1) / 24)


def test_fill_ratio_of_a_circle_is_pi_over_four() -> None:
    t = np.linspace(0.0, 2 * math.pi, 720, endpoint=False)
    d = described(3.0 * np.column_stack((np.cos(t), -np.sin(t))))
    assert d[FILL] == pytest.approx(math.pi / 4, rel=1e-4)


def test_least_rectangle_is_opencv_s() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        points = rng.normal(scale=10.0, size=(int(rng.integers(3, 40)), 2))
        d = described(points)
        (_, sides, _) = cv2.minAreaRect(points.astype(np.float32))
        assert d[WIDTH] * d[LENGTH] == pytest.approx(sides[0] * sides[1], rel=1e-4)


def test_rectangle_survives_doubled_and_aligned_points() -> None:
    grid = np.array([[n, e] for n in range(4) for e in range(3)] * 2, dtype=float)
    d = described(grid)
    assert (d[WIDTH], d[LENGTH]) == (pytest.approx(2.0), pytest.approx(3.0))
    line = described(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]))
    assert line[FILL] == 0.0
    assert np.isfinite(line).all()


def test_cleaning_keeps_corners_and_drops_what_is_none() -> None:
    dirty = np.array(
        [[0, 0], [5, 0], [5, 1e-4], [7, 0.001], [10, 0], [10, 0], [10, 4], [13, 4], [10, 4], [0, 4], [0, 2], [0, 1e-4]],
        dtype=float,
    )
    kept = outline.clean(dirty, 0.005)
    assert len(kept) == 4
    for corner in ([0, 0], [10, 0], [10, 4], [0, 4]):
        assert np.min(np.linalg.norm(kept - corner, axis=1)) < 1e-3
    np.testing.assert_array_equal(outline.clean(ELL, 0.005), ELL)


def test_a_finely_drawn_circle_stays_one() -> None:
    t = np.linspace(0.0, 2 * math.pi, 2000, endpoint=False)
    circle = 5.0 * np.column_stack((np.cos(t), np.sin(t)))
    kept = outline.clean(circle, 0.005)
    assert 20 < len(kept) < 200
    assert abs(outline.area(kept)) == pytest.approx(math.pi * 25, rel=3e-3)


@pytest.mark.parametrize(
    ("points", "crosses"),
    [
        (RECTANGLE, False),
        (ELL, False),
        (np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 5.0], [10.0, 5.0]]), True),  # bow tie
        (np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 0.0], [0.0, 4.0]]), True),  # a corner on another side
        (np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), False),
    ],
)
def test_self_crossing(points: Array, crosses: bool) -> None:
    for shift in range(len(points)):
        assert outline.crosses_itself(np.roll(points, shift, axis=0)) is crosses


def test_contains_agrees_with_opencv() -> None:
    rng = np.random.default_rng(5)
    for n, e in rng.uniform(-1.0, 9.0, (300, 2)):
        assert outline.contains(ELL, n, e) == (cv2.pointPolygonTest(ELL.astype(np.float32), (float(n), float(e)), False) > 0)
