"""Connected components, sub-pixel contours, fitted polygons, regions tightened to their colour."""

import cv2
import numpy as np
import pytest

from models.messages import Array
from vision.describe.components import components
from vision.describe.polygon import fit_polygon
from vision.describe.regions import Limits, find_regions, sharpen
from vision.describe.segment import colour_table, segment_colours
from vision.image.rectify import Image

ROOF, GROUND = np.array([40.0, 50.0, 190.0]), np.array([80.0, 125.0, 95.0])
TABLE = colour_table([(40.0, 50.0, 190.0)])


def draw(corners: Array, noise: float = 2.0, blur: float = 0.6, seed: int = 1, shape: tuple[int, int] = (160, 200)) -> Image:
    """A polygon by 8 x 8 rays a pixel: no bias of its own beyond 0.01 px."""
    fine = 8
    big = np.zeros((shape[0] * fine, shape[1] * fine), np.uint8)
    cv2.fillPoly(big, [np.rint(((corners + 0.5) * fine - 0.5) * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    cover = big.reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3))
    cover = cv2.GaussianBlur(cover, (0, 0), blur)[..., None]
    light = GROUND * (1 - cover) + ROOF * cover
    noisy = light + np.random.default_rng(seed).normal(0, noise, light.shape)
    return np.asarray(np.clip(noisy, 0, 255).round(), dtype=np.uint8)


def rectangle(centre: tuple[float, float], sides: tuple[float, float], angle: float) -> Array:
    """Corners (4, 2), anticlockwise as seen in an image (v down)."""
    c, s = np.cos(angle), np.sin(angle)
    flat = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * np.array(sides) / 2.0
    return np.asarray(flat @ np.array([[c, s], [-s, c]]) + centre)


def test_components_agree_with_opencv() -> None:
    """Random labels: the same components, areas and boxes as OpenCV finds class by class."""
    rng = np.random.default_rng(1)
    labels = cv2.resize(rng.integers(0, 4, (30, 40), dtype=np.uint8), (160, 120), interpolation=cv2.INTER_NEAREST)
    labels[rng.random(labels.shape) < 0.1] = 0
    table, runs, owner = components(np.asarray(labels, np.uint8))
    expected = []
    for k in (1, 2, 3):
        _, _, stats, _ = cv2.connectedComponentsWithStats((labels == k).astype(np.uint8), connectivity=8)
        expected += [(k, *(int(x) for x in row)) for row in stats[1:]]
    assert sorted(map(tuple, table.tolist())) == sorted(expected)
    pixels = np.bincount(owner, weights=(runs[:, 2] - runs[:, 1]).astype(float))
    np.testing.assert_array_equal(pixels, table[:, 5])


def test_components_of_the_wrong_size_are_left_out() -> None:
    labels = np.zeros((20, 30), np.uint8)
    labels[2:4, 2:4], labels[6:10, 6:10], labels[0:18, 15:30] = 1, 1, 1
    table, _, owner = components(labels, least_px=5, largest_px=100)
    np.testing.assert_array_equal(table, [[1, 6, 6, 4, 4, 16]])
    assert set(owner.tolist()) == {-1, 0}


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.5, 0.785])
def test_corners_are_found_to_a_tenth_of_a_pixel(angle: float) -> None:
    errors, areas = [], []
    for seed in range(5):
        offset = np.random.default_rng(seed).uniform(0, 1, 2)
        true = rectangle((100.0 + offset[0], 80.0 + offset[1]), (61.3, 40.7), angle)
        image = draw(true, seed=seed)
        (region,) = find_regions(image, segment_colours(image, TABLE))
        assert region.corners is not None
        assert len(region.corners) == 4
        nearest = np.linalg.norm(region.corners[:, None] - true, axis=2).argmin(axis=1)
        assert np.roll(nearest, -int(nearest.argmin())).tolist() == [0, 1, 2, 3]  # anticlockwise as seen
        errors.append(region.corners - true[nearest])
        areas.append(region.area_px / (61.3 * 40.7) - 1.0)
        np.testing.assert_allclose(region.colour_bgr, ROOF, atol=6.0)
        assert not region.touches_border
    assert 0.005 < np.sqrt(np.mean(np.square(errors))) < 0.1
    assert abs(np.mean(areas)) < 0.004  # 0.06 px all around


def test_the_sigma_of_a_contour_is_its_scatter() -> None:
    """Distance of the contour's points from the true circle, against edge_sigma_px."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ratios = []
    for seed in range(6):
        true = np.column_stack((100.3 + 40 * np.cos(angle), 80.6 - 40 * np.sin(angle)))
        image = draw(true, noise=5.0, seed=seed)
        (region,) = find_regions(image, segment_colours(image, TABLE))
        assert region.corners is None or len(region.corners) > 6
        radius = np.linalg.norm(region.contour - (100.3, 80.6), axis=1)
        assert abs(radius.mean() - 40.0) < 0.08
        ratios.append(region.edge_sigma_px / radius.std())
    assert 0.5 < np.mean(ratios) < 1.5


def test_an_edge_of_colour_without_brightness_is_an_edge() -> None:
    """Inside and outside are equally grey: the contour still goes to where the colour changes."""
    image = np.empty((60, 80, 3), np.uint8)
    image[:] = (60, 120, 60)
    image[20:40, 25:55] = (131, 60, 150)
    assert abs(int(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[30, 40]) - int(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[5, 5])) <= 2
    left_side = np.column_stack((np.full(9, 26.0), np.arange(25.0, 34.0)))
    outline = np.concatenate((left_side, [(53.0, 33.0), (53.0, 25.0)]))
    moved, _ = sharpen(cv2.GaussianBlur(image, (0, 0), 0.7), outline)
    np.testing.assert_allclose(moved[3:6, 0], 24.5, atol=0.06)


def test_l_shapes_and_discs() -> None:
    ell = np.array([(40.0, 30.0), (40.0, 110.0), (130.0, 110.0), (130.0, 70.0), (80.0, 70.0), (80.0, 30.0)]) + 0.4
    image = draw(ell)
    (region,) = find_regions(image, segment_colours(image, TABLE))
    assert region.corners is not None
    assert len(region.corners) == 6
    assert np.linalg.norm(region.corners[:, None] - ell, axis=2).min(axis=1).max() < 0.3
    assert fit_polygon(np.random.default_rng(1).normal(size=(60, 2)) * 9.0) is None


def test_what_the_image_cuts_off_is_flagged() -> None:
    image = draw(rectangle((10.0, 80.0), (61.0, 40.0), 0.0))
    (region,) = find_regions(image, segment_colours(image, TABLE))
    assert region.touches_border
    image = draw(rectangle((100.0, 80.0), (61.0, 40.0), 0.0))
    valid = np.full(image.shape[:2], 255, np.uint8)
    valid[:, :80] = 0  # the rectified image ends within the roof
    (region,) = find_regions(image, segment_colours(image, TABLE), valid=valid)
    assert region.touches_border


def test_a_leak_into_the_ground_is_taken_back() -> None:
    """Labels that run out into a soil of like hue: the region is as if they had not."""
    true = rectangle((100.0, 80.0), (60.0, 40.0), 0.3)
    image = draw(true)
    labels = segment_colours(image, TABLE)
    labels[85:100, 20:80] = 1
    labels[70:73, 130:190] = 1
    (region,) = find_regions(image, labels)
    assert region.area_px == pytest.approx(2400.0, rel=0.02)


def test_a_region_that_was_too_small_grows_to_its_edge() -> None:
    true = rectangle((100.0, 80.0), (60.0, 40.0), 0.0)
    image = draw(true)
    labels = np.asarray(cv2.erode(segment_colours(image, TABLE), np.ones((5, 5), np.uint8)), np.uint8)
    (region,) = find_regions(image, labels)
    assert region.area_px == pytest.approx(2400.0, rel=0.02)


def test_grey_images_have_regions_too() -> None:
    image = draw(rectangle((100.0, 80.0), (60.0, 40.0), 0.2))[..., 2]
    (region,) = find_regions(image, (image > 140).astype(np.uint8))
    assert region.corners is not None
    assert region.colour_bgr[0] == region.colour_bgr[1] == region.colour_bgr[2]


def test_how_many_and_how_small() -> None:
    image = np.full((120, 160, 3), GROUND).astype(np.uint8)
    for k in range(6):
        image[10 : 20 + 2 * k, 10 + 25 * k : 20 + 25 * k + k] = ROOF
    labels = segment_colours(image, TABLE)
    areas = [r.area_px for r in find_regions(image, labels)]
    assert len(areas) == 6
    assert areas == sorted(areas, reverse=True)
    assert len(find_regions(image, labels, Limits(most=2))) == 2
    assert len(find_regions(image, labels, Limits(least_px=200))) == 2
    assert find_regions(image, np.zeros_like(labels)) == []
