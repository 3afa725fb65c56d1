"""Correspondence on a textured board of known disparity."""

import cv2
import numpy as np
import pytest

from models.messages import Array
from tests.vision import stereo_scene
from vision.describe import correlation
from vision.describe.correspond import Match, Search, Unmatched, correspond, sobel
from vision.describe.regions import Region, find_regions
from vision.describe.segment import colour_table, segment_colours
from vision.image.rectify import Image

TABLE = colour_table([stereo_scene.RED])


def regions_of(left: Image) -> list[Region]:
    return find_regions(left, segment_colours(left, TABLE))


def grey(image: Image) -> Image:
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def test_sobel_is_the_thesis_kernel() -> None:
    """G = sqrt(GX^2 + GY^2), eq. 4.62-4.64, on one pixel's neighbourhood by hand."""
    image = np.array([[1, 5, 2], [7, 9, 4], [3, 8, 6]], np.uint8)
    gx = (2 - 1) + 2 * (4 - 7) + (6 - 3)
    gy = (3 - 1) + 2 * (8 - 5) + (6 - 2)
    assert sobel(image)[1, 1] == pytest.approx(np.hypot(gx, gy))


def test_the_scan_is_opencvs_correlation_coefficient() -> None:
    """Eq. 4.80 over a rectangle of pixels, against matchTemplate."""
    rng = np.random.default_rng(1)
    left, right = rng.integers(0, 255, (60, 90), dtype=np.uint8), rng.integers(0, 255, (60, 90), dtype=np.uint8)
    pixels = np.array([(u, v) for v in range(20, 30) for u in range(40, 55)], np.int32)
    scores = correlation.scan(left, right, pixels, -10, 20, 0)
    expected = cv2.matchTemplate(right[20:30], left[20:30, 40:55], cv2.TM_CCOEFF_NORMED)[0]
    np.testing.assert_allclose(scores, [expected[40 - d] for d in range(-10, 21)], atol=1e-5)


@pytest.mark.parametrize("shift_px", [0.0, 12.5])
@pytest.mark.parametrize("depth_m", [6.0, 10.0, 11.3])
def test_disparity_to_a_few_hundredths_of_a_pixel(depth_m: float, shift_px: float) -> None:
    """u_l - u_r = f b / Z - (cx_r - cx_l); every cell on its own is right within its sigma, the plane is better."""
    rig = stereo_scene.rig(shift_px=shift_px)
    left, right, _ = stereo_scene.board(rig, depth_m, noise=2.0)
    (match,) = correspond(grey(left), grey(right), regions_of(left), rig)
    assert isinstance(match, Match)
    true = stereo_scene.F * stereo_scene.BASELINE / depth_m - shift_px
    assert abs(match.plane.coefficients[0] - true) < 0.04
    normalised = (match.disparities - true) / match.sigmas
    assert 0.5 < np.sqrt(np.mean(normalised**2)) < 1.6
    assert abs(match.vertical_px) < 0.1
    assert match.score > 0.7


def _noisy(u: Array, v: Array, waves: Array, rng: np.random.Generator) -> Image:
    """Sum of waves, rms 5 levels, noise of 3 levels."""
    light = np.full(u.shape, 120.0)
    for k, (a, b) in enumerate(waves):
        light += 1.6 * np.sin(a * u + b * v + k)
    return (light + rng.normal(0.0, 3.0, u.shape)).round().astype(np.uint8)


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 0.75])
def test_noise_does_not_pull_disparities_towards_half_pixels(fraction: float) -> None:
    """Texture hardly stronger than the noise: the mean over many cells is right, and each within its sigma.

    With the gradient of the right image instead of the left one's the means are off by 0.1 px and more.
    """
    errors, normalised = [], []
    u, v = np.meshgrid(np.arange(240.0), np.arange(200.0))
    for seed in range(4):
        rng = np.random.default_rng(seed)
        waves = rng.normal(0.0, 0.35, (20, 2))
        left, right = (_noisy(u + d, v, waves, rng) for d in (0.0, 7.0 + fraction))
        plane = np.array([7.0 + fraction, 0.0, 0.0, 0.0, 0.0])
        cells, _, _ = correlation.cells(left, right, np.ones((180, 200), np.bool_), (20, 10), 12, plane, 0, 1.0, 0.7)
        errors += list(cells[:, 2] - 7.0 - fraction)
        normalised += list((cells[:, 2] - 7.0 - fraction) / cells[:, 3])
    assert len(errors) > 500
    assert abs(np.median(errors)) < 0.03
    assert 0.7 < np.median(np.abs(normalised)) * 1.4826 < 1.15


def test_an_inclined_board_gives_an_inclined_plane() -> None:
    """1 / Z = A x + B y + C: p = -f b slope_x / (f depth), exactly affine in the image."""
    rig = stereo_scene.rig()
    left, right, _ = stereo_scene.board(rig, 8.0, slope=(0.5, -0.3), noise=1.0)
    (match,) = correspond(grey(left), grey(right), regions_of(left), rig, Search(slope_tangent=2.0))
    assert isinstance(match, Match)
    expected = -stereo_scene.BASELINE / 8.0 * np.array([0.5, -0.3])
    np.testing.assert_allclose(match.plane.coefficients[1:], expected, atol=0.0012)


def test_rows_that_do_not_fit_are_measured() -> None:
    rig = stereo_scene.rig()
    for vertical in (-1.3, 0.4, 2.2):
        left, right, _ = stereo_scene.board(rig, 9.0, vertical_px=vertical)
        (match,) = correspond(grey(left), grey(right), regions_of(left), rig)
        assert isinstance(match, Match)
        assert match.vertical_px == pytest.approx(vertical, abs=0.1)


def test_brightness_and_contrast_of_the_cameras_may_differ() -> None:
    rig = stereo_scene.rig()
    left, right, _ = stereo_scene.board(rig, 9.0)
    dim = (0.6 * right + 20).astype(np.uint8)
    (match,) = correspond(grey(left), grey(dim), regions_of(left), rig)
    assert isinstance(match, Match)
    assert abs(match.plane.coefficients[0] - 150.0 / 9.0) < 0.05


def test_sixteen_bit_images_match_too() -> None:
    rig = stereo_scene.rig()
    left, right, _ = stereo_scene.board(rig, 9.0)
    wide = [grey(x).astype(np.uint16) * 150 + 3000 for x in (left, right)]
    (match,) = correspond(wide[0], wide[1], regions_of(left), rig)
    assert isinstance(match, Match)
    assert abs(match.plane.coefficients[0] - 150.0 / 9.0) < 0.05


def test_swapped_images_are_noticed() -> None:
    rig = stereo_scene.rig()
    left, right, _ = stereo_scene.board(rig, 9.0)
    (match,) = correspond(grey(right), grey(left), regions_of(right), rig)
    assert isinstance(match, Unmatched)
    assert match.behind
    assert "behind the camera" in match.reason


def _reflecting(image: Image, region: Region, rng: np.random.Generator) -> Image:
    """Three soft lights on a region, of which the other camera sees others: what shines there is no mark of the surface."""
    light, (v, u) = image.astype(np.float64), np.indices(image.shape[:2])
    x, y, width, height = region.bbox
    for _ in range(3):
        u0, v0, s = rng.uniform(x, x + width), rng.uniform(y, y + height), rng.uniform(4.0, 9.0)
        light += 30.0 * np.exp(-((u - u0) ** 2 + (v - v0) ** 2) / (2.0 * s * s))[..., None]
    return np.clip(light, 0.0, 255.0).astype(np.uint8)


@pytest.mark.parametrize("seed", [0, 1, 2, 5])
def test_a_board_with_reflections_correlates_weakly_and_is_measured(seed: int) -> None:
    rig, rng = stereo_scene.rig(), np.random.default_rng(seed)
    left, right, _ = stereo_scene.board(rig, 10.0, noise=2.0)
    region = regions_of(left)[0]
    first, second = (grey(_reflecting(image, region, rng)) for image in (left, right))
    (match,) = correspond(first, second, [region], rig)
    assert isinstance(match, Match)
    assert 0.40 < match.score < 0.55
    assert abs(match.plane.coefficients[0] - 15.0) < 3.0 * np.sqrt(match.plane.covariance[0, 0]) < 0.12


def test_two_similar_boards_in_one_pane_are_no_match() -> None:
    """Half of the light is a reflection of the board, 30 px beside it."""
    rig = stereo_scene.rig()
    left, right, _ = stereo_scene.board(rig, 10.0, noise=2.0)
    pane = (0.5 * right + 0.5 * np.roll(right, -30, axis=1)).astype(np.uint8)
    (match,) = correspond(grey(left), grey(pane), regions_of(left)[:1], rig)
    assert isinstance(match, Unmatched)
    assert "over the next, needed 0.2" in match.reason


def test_what_is_not_there_is_not_found() -> None:
    rig = stereo_scene.rig()
    left, _, _ = stereo_scene.board(rig, 9.0, seed=1)
    noise = np.random.default_rng(2).integers(0, 255, (240, 320), dtype=np.uint8)
    for other in (noise, np.zeros((240, 320), np.uint8), np.full((240, 320), 255, np.uint8)):
        (match,) = correspond(grey(left), other, regions_of(left), rig)
        assert isinstance(match, Unmatched)
        assert "no match" in match.reason


def test_a_fence_fits_in_many_positions() -> None:
    """Vertical stripes every 24 px: ambiguous, not a guess."""
    stripes = np.tile((60 + 120 * (np.arange(320) // 12 % 2)).astype(np.uint8), (240, 1))
    mask = np.zeros((240, 320), np.uint8)
    mask[90:130, 140:200] = 1
    (region,) = find_regions(np.dstack([stripes // 3, stripes // 3, stripes]), mask)[:1]
    (match,) = correspond(stripes, np.roll(stripes, -10, axis=1), [region], stereo_scene.rig())
    assert isinstance(match, Unmatched)
    assert "ambiguous" in match.reason
