"""Image enhancement against the thesis' equations."""

import cv2
import numpy as np
import pytest

from vision.image import enhance
from vision.image.rectify import Image


def ramp(low: int, high: int, dtype: type = np.uint8) -> Image:
    return np.tile(np.linspace(low, high, 256).astype(dtype), (64, 1))


def test_median_takes_out_salt_and_pepper_and_keeps_an_edge() -> None:
    rng = np.random.default_rng(1)
    clean = np.full((60, 80), 50, np.uint8)
    clean[:, 40:] = 200
    noisy = clean.copy()
    noisy[rng.random(clean.shape) < 0.06] = 255
    assert (enhance.median(noisy, 5)[4:-4, 4:-4] != clean[4:-4, 4:-4]).mean() < 0.004  # a cluster next to the edge


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_stretch_is_a_straight_line_through_the_limits(dtype: type) -> None:
    """s = (r - c) (b - a) / (d - c) + a with a = 0, b = 255 (eq. 4.60)."""
    image = ramp(60, 180, dtype)
    c, d = enhance.limits(image)
    s = enhance.stretch(image)
    assert s.dtype == np.uint8
    assert s.min() == 0
    assert s.max() == 255
    middle = (image > c) & (image < d)
    np.testing.assert_allclose(s[middle], (image[middle] - c) * 255.0 / (d - c), atol=0.51)


def test_one_hot_and_one_dead_pixel_do_not_stop_the_stretch() -> None:
    """The outlier of thesis section 4.2.1.4."""
    image = ramp(100, 150)
    image[0, 0], image[1, 1] = 0, 255
    assert np.ptp(enhance.stretch(image)[4:].astype(int)) > 250


def test_stretch_keeps_hue() -> None:
    """Limits are common to the channels: a grey image with a cast keeps it."""
    image = np.dstack([ramp(60, 120), ramp(60, 120), ramp(40, 100)])
    s = enhance.stretch(image).astype(int)
    assert np.abs(s[:, 100, 0] - s[:, 100, 1]).max() == 0
    assert (s[:, 100, 2] < s[:, 100, 0] - 20).all()


def test_a_flat_image_becomes_middle_grey() -> None:
    np.testing.assert_array_equal(enhance.stretch(np.full((20, 20), 7, np.uint16)), 128)


def test_fog_is_taken_off_and_a_clear_image_left_alone() -> None:
    """Of colours under fog, c t + v (1 - t), hue and saturation come back to what they were without it."""
    rng = np.random.default_rng(5)
    colours = np.array([(40, 50, 190), (170, 80, 40), (60, 160, 60), (12, 12, 12)], np.float64)
    clear = colours[rng.integers(0, 4, (60, 80))].astype(np.uint8)
    foggy = (0.35 * clear + 0.65 * np.array([205.0, 198.0, 190.0])).astype(np.uint8)
    np.testing.assert_array_equal(enhance.unveil(clear), clear)
    seen, veiled, true = (cv2.cvtColor(x, cv2.COLOR_BGR2HSV)[..., 1].astype(float) for x in (enhance.unveil(foggy), foggy, clear))
    bright = clear.max(axis=2) > 100
    assert np.median(veiled[bright] / true[bright]) < 0.5
    assert 0.7 < np.median(seen[bright] / true[bright]) < 1.05


def test_a_stretch_with_room_cuts_nothing_that_is_a_little_hotter() -> None:
    """One pixel in a hundred burns: the others keep most of the levels, and what is 20 % hotter than they are is not cut off."""
    levels = np.linspace(7000, 8000, 40_000).astype(np.uint16).reshape(200, 200)
    levels[:20, :15] = 60_000
    levels[50:60, 50:60] = 8200
    stretched = enhance.stretch(levels, 0.01, 0.25)
    assert np.ptp(stretched[100:].astype(int)) > 0.3 * 255
    assert stretched[55, 55] < 255
    assert int(stretched[55, 55]) > int(stretched[199, 199]) + 15
    assert enhance.stretch(levels, 0.01)[55, 55] == 255
