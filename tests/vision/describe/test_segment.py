"""Segmentation: colour cylinders, double threshold, peakiness test and seeds."""

import colorsys
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vision.describe.segment import (
    Seeds,
    Space,
    Tolerance,
    classes,
    colour_table,
    cylinder,
    segment_colours,
    segment_intensity,
    segment_seeds,
    valleys,
)

RED, BLUE, GREEN, GREY = (40.0, 50.0, 190.0), (170.0, 80.0, 40.0), (60.0, 160.0, 60.0), (150.0, 150.0, 150.0)
SPACES: list[Space] = ["hsv", "hsi", "lab", "yuv"]


def patches(colours: list[tuple[float, float, float]], noise: float = 4.0, light: float = 1.0) -> NDArray[Any]:
    """Squares of 40 px side by side."""
    rng = np.random.default_rng(1)
    image = np.concatenate([np.full((40, 40, 3), c) for c in colours], axis=1) * light
    return np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("bgr", [(10, 20, 200), (200, 30, 40), (30, 180, 170), (90, 200, 60), (200, 40, 160), (3, 2, 1)])
def test_hsi_is_the_thesis_formula(bgr: tuple[int, int, int]) -> None:
    """Hue by the arc cosine of eq. 4.31-4.32 (with the square root the second one lacks), S and I by eq. 4.29-4.30."""
    b, g, r = np.array(bgr) / sum(bgr)
    arc = np.arccos(0.5 * ((r - g) + (r - b)) / np.sqrt((r - g) ** 2 + (r - b) * (g - b)))
    hue = np.degrees(arc if b <= g else 2 * np.pi - arc)
    h, s, i = cylinder(np.array([[bgr]], np.uint8), "hsi")[0, 0].astype(float)
    assert abs((2 * h - hue + 180) % 360 - 180) <= 1.01
    assert s == pytest.approx(255 * (1 - 3 * min(r, g, b) / (r + g + b)), abs=0.51)
    assert i == pytest.approx(sum(bgr) / 3, abs=0.51)


def test_hsv_hue_is_that_of_the_colour_wheel() -> None:
    for bgr in ((10, 20, 200), (200, 30, 40), (30, 180, 170)):
        h, s, v = cylinder(np.array([[bgr]], np.uint8), "hsv")[0, 0]
        expected = colorsys.rgb_to_hsv(*(x / 255 for x in bgr[::-1]))
        assert h == pytest.approx(180 * expected[0], abs=1.0)
        assert s == pytest.approx(255 * expected[1], abs=1.0)
        assert v == max(bgr)


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("light", [0.6, 1.0, 1.25])
def test_known_colours_are_found_in_any_light(space: Space, light: float) -> None:
    image = patches([RED, BLUE, GREEN, GREY], light=light)
    labels = segment_colours(image, colour_table([RED, BLUE, GREEN], space))
    for k, expected in enumerate((1, 2, 3, 0)):
        assert (labels[:, 40 * k : 40 * k + 40] == expected).mean() > 0.97


def test_red_is_one_colour_on_both_sides_of_the_hue_circle() -> None:
    image = patches([(20.0, 40.0, 200.0), (40.0, 20.0, 200.0)], noise=0.0)
    assert (segment_colours(image, colour_table([(30.0, 30.0, 200.0)])) == 1).all()


def test_grey_landmarks_are_reported_by_lightness() -> None:
    image = patches([(60.0, 60.0, 60.0), (150.0, 150.0, 150.0), (235.0, 235.0, 235.0)])
    labels = segment_colours(image, colour_table([(235.0, 235.0, 235.0)]))
    assert (labels[:, 82:118] == 1).mean() > 0.97
    assert not labels[:, :80].any()
    np.testing.assert_array_equal(segment_colours(image[..., 1], colour_table([(235.0, 235.0, 235.0)], "grey"))[:, :78], 0)


def test_alike_colours_are_one_class() -> None:
    assert classes([RED, (44.0, 54.0, 185.0), BLUE]) == [RED, BLUE]


@pytest.mark.parametrize("space", SPACES)
def test_seeds_divide_an_image_without_knowing_its_colours(space: Space) -> None:
    image = patches([RED, BLUE, GREEN, (60.0, 60.0, 60.0), (220.0, 220.0, 220.0)])
    labels = segment_seeds(image, space)
    found = [int(np.bincount(labels[:, 40 * k + 3 : 40 * k + 37].ravel()).argmax()) for k in range(5)]
    assert len(set(found)) == 5
    for k, label in enumerate(found):
        assert (labels[:, 40 * k : 40 * k + 40] == label).mean() > 0.95


def test_seeds_of_a_grey_image() -> None:
    image = cv2.GaussianBlur(patches([(40.0,) * 3, (120.0,) * 3, (220.0,) * 3]), (5, 5), 0)[..., 0]
    labels = segment_seeds(image)
    assert len({int(np.median(labels[:, 40 * k + 5 : 40 * k + 35])) for k in range(3)}) == 3


def gaussians(*peaks: tuple[float, float, float]) -> NDArray[Any]:
    """Histogram of 256 levels: (mean, sigma, pixels) each, with the noise of counting."""
    x = np.arange(256)
    clean = np.sum([n / s * np.exp(-0.5 * ((x - m) / s) ** 2) for m, s, n in peaks], axis=0)
    return np.asarray(np.random.default_rng(3).poisson(clean), dtype=np.float64)


def test_valleys_lie_between_the_peaks() -> None:
    found = valleys(gaussians((60, 10, 40000), (140, 8, 30000), (210, 12, 30000)))
    assert len(found) == 2
    assert 80 < found[0] < 122
    assert 158 < found[1] < 186


def test_a_wide_noisy_peak_is_one() -> None:
    """Counting noise makes dozens of small peaks: none is good, the wide one is."""
    assert len(valleys(gaussians((128, 30, 3000)))) == 0


def test_a_shoulder_is_no_peak_of_its_own() -> None:
    assert len(valleys(gaussians((100, 12, 50000), (122, 12, 20000)))) == 0


def test_peakiness_is_the_thesis_product() -> None:
    """(1 - (Va + Vb) / 2P) (1 - N / (P W)), eq. 4.74: two triangles that just pass and just fail."""
    h = np.concatenate([np.linspace(0, 100, 40), np.linspace(100, 40, 20), np.linspace(40, 100, 20), np.linspace(100, 0, 40)])
    smooth = np.convolve(np.pad(h, 1, mode="edge"), np.ones(3) / 3, "valid")
    cut = 60
    part = smooth[:cut]
    good = (1 - smooth[cut] / (2 * part.max())) * (1 - part.sum() / (part.max() * cut))
    assert 0.2 < good < 0.6
    assert len(valleys(h, Seeds(peakiness=good - 0.03))) == 1
    assert len(valleys(h, Seeds(peakiness=good + 0.03))) == 0


def test_a_circular_histogram_has_no_end() -> None:
    """A peak across 0 stays one class."""
    h = np.roll(gaussians((60, 10, 40000), (150, 8, 30000)), -60)
    found = valleys(h, circular=True)
    assert len(found) == 2
    assert not any(v < 20 or v > 236 for v in found)


def test_a_thing_is_found_whether_darker_or_brighter_on_ground_of_any_level() -> None:
    """A slope of 120 levels across the image, things 25 levels off it: no one threshold would serve."""
    rng = np.random.default_rng(2)
    ground = np.linspace(60.0, 180.0, 320)[None, :] + rng.normal(0.0, 5.0, (240, 320))
    truth = np.zeros((240, 320), int)
    for k, (u, v) in enumerate([(40, 50), (130, 150), (200, 60), (270, 170)]):
        truth[v : v + 30, u : u + 40] = 1 + k % 2
    image = np.clip(ground + np.choose(truth, (0.0, -25.0, 25.0)), 0, 255).astype(np.uint8)
    labels = segment_intensity(cv2.medianBlur(image, 5))
    for side in (1, 2):
        assert (labels[truth == side] == side).mean() > 0.9
    assert (labels[truth == 0] == 0).mean() > 0.8


def test_an_empty_image_has_no_things_however_faint_its_noise() -> None:
    noise = np.random.default_rng(3).normal(100.0, 1.0, (240, 320)).astype(np.uint8)
    assert not segment_intensity(noise).any()


def test_a_narrower_tolerance_leaves_a_paler_reflection_out() -> None:
    """A red box, and the same red mixed with a floor's grey, of the same hue and 0.6 times its saturation."""
    box, reflection = (40, 50, 190), (96, 102, 190)
    image = np.array([[box, reflection]], dtype=np.uint8)
    usual, narrow = (segment_colours(image, colour_table([box], "hsv", Tolerance().scaled(f)))[0].tolist() for f in (1.0, 0.5))
    assert usual == [1, 1]
    assert narrow == [1, 0]
