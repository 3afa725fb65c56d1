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
    assert (enhance.median(noisy, 5)[4:-4, 4:-4] != clean[4:-4, 4:-4]).mean() < 0.004  # a cluster beside the edge


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


def test_blocks_bring_out_what_a_whole_stretch_cannot() -> None:
    """A dim half beside a bright one: the texture of both fills the range; no seam between blocks."""
    rng = np.random.default_rng(2)
    image = np.hstack([rng.integers(20, 41, (128, 128)), rng.integers(180, 221, (128, 128))]).astype(np.uint8)
    whole, blocks = enhance.stretch(image), enhance.stretch_blocks(image, 4)
    assert np.ptp(whole[:, :96].astype(int)) < 40
    assert np.ptp(blocks[:, :96].astype(int)) > 150
    smooth = enhance.stretch_blocks(ramp(0, 255), 4).astype(int)
    assert np.abs(np.diff(smooth, axis=1)).max() < 12


def test_a_flat_image_becomes_middle_grey() -> None:
    np.testing.assert_array_equal(enhance.stretch(np.full((20, 20), 7, np.uint16)), 128)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_gamma_and_log(dtype: type) -> None:
    """s = c r^gamma (eq. 4.59), s = c log(1 + r) (eq. 4.58); black stays black, white white."""
    full = np.iinfo(dtype).max
    image = ramp(0, full, dtype)
    for s, expected in (
        (enhance.gamma(image, 0.5), full * np.sqrt(image / full)),
        (enhance.gamma(image, 3.0), full * (image / full) ** 3),
        (enhance.logarithm(image), full / np.log1p(full) * np.log1p(image.astype(float))),
    ):
        assert s.dtype == dtype
        np.testing.assert_allclose(s, expected, atol=0.51)
    np.testing.assert_array_equal(enhance.negative(image), full - image)


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
