"""Landmarks too small to have edges, each measured as one small landmark: on drawn and rendered images whose truth is known."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from models import so3
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from tests.vision.pose.test_pose import Flight, seen_from_above
from tests.vision.roofs import nadir_rig
from vision.outline.visibility import Kind, Prisms, visible_edges
from vision.pipeline import LandmarkPipeline, PipelineConfig
from vision.pose.observation import ObservationConfig
from vision.pose.pose import PoseEstimate, difference, estimate_pose
from vision.pose.sensitivity import eyes
from vision.pose.small_landmarks import blocks, measure, sampled
from vision.predict.final_check import final_check

ORIGIN = (47.3977, 8.5456, 488.0)
CORNERS = np.array([(-0.5, -0.4), (0.5, -0.4), (0.5, 0.4), (-0.5, 0.4)])
FINE, ROUND = 16, 8  # drawn so much finer; pieces of a pixel for OpenCV
Image = NDArray[np.uint8]


def turned(angle: float) -> Array:
    """What turns rows (N, 2)."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def boulders(seed: int, sigma: Array, count: int = 8, height_m: float = 40.0, map_sigma_m: float = 0.05) -> Flight:
    """Boxes of half a metre, 7 to 11 px, around the place below; where they are is mapped with an error."""
    rng, rig = np.random.default_rng(seed), nadir_rig(lens=(-0.1, 0.02, 0.0, 0.0))
    true, mapped = [], []
    for k in range(count):
        bearing, a = 2.0 * np.pi * k / count, rng.uniform(0.0, np.pi)
        position = np.array([np.cos(bearing), np.sin(bearing)]) * rng.uniform(3.0, 11.0)
        outline, tall = CORNERS * rng.uniform(0.45, 0.75) @ turned(a) + position, rng.uniform(0.05, 0.3)
        blue, green, red = rng.integers(120, 200, 3).tolist()
        colour = blue, green, red
        true.append(Landmark.of(str(k), outline, 0.0, tall, colour))
        mapped.append(Landmark.of(str(k), outline + rng.normal(0.0, map_sigma_m, 2), 0.0, tall, colour, map_sigma_m))
    return seen_from_above(rng, rig, true, mapped, height_m, 0.08, sigma)


def house_and_boulders(seed: int, sigma: Array) -> Flight:
    """A house at one border of the image, seven boulders three metres apart at the other one."""
    rng, rig = np.random.default_rng(seed), nadir_rig(lens=(-0.1, 0.02, 0.0, 0.0))
    true, mapped = [], []
    for k in range(8):
        a = rng.uniform(0.0, np.pi)
        if k == 0:
            position, size, tall = np.array([-8.0, rng.uniform(-5.0, 5.0)]), rng.uniform(6.0, 8.0), 3.0
        else:
            position = np.array([rng.uniform(6.0, 11.0), 3.1 * k - 11.0])
            size, tall = rng.uniform(0.45, 0.75), rng.uniform(0.05, 0.3)
        outline = CORNERS * size @ turned(a) + position
        blue, green, red = rng.integers(120, 200, 3).tolist()
        true.append(Landmark.of(str(k), outline, 0.0, tall, (blue, green, red)))
        mapped.append(Landmark.of(str(k), outline + rng.normal(0.0, 0.05, 2), 0.0, tall, (blue, green, red), 0.05))
    return seen_from_above(rng, rig, true, mapped, 40.0, 0.08, sigma)


def located(view: Flight) -> tuple[tuple[str, ...], PoseEstimate]:
    """The landmarks of the pipeline's fix, and its fit."""
    pipeline = LandmarkPipeline(view.rig, LandmarkMap.from_landmarks(ORIGIN, view.landmarks), PipelineConfig(path="predict"))
    result = pipeline.process(*view.images, 1, view.prior)
    assert result.fix is not None
    assert result.pose is not None
    return result.fix.landmarks, result.pose


def squared_error(view: Flight, fit: PoseEstimate) -> float:
    """Squared Mahalanobis distance of prior and images together."""
    off = difference(view.p_n, view.R_nb, fit.joint_p_n, so3.from_matrix(fit.joint_R_nb))
    return float(off @ np.linalg.solve(fit.joint_covariance, off))


def drawn(corners: Array, colour: tuple[int, int, int], image: Image) -> Image:
    """A filled outline (K, 2) px, its rim as soft as a pixel is wide."""
    large = cv2.resize(image, None, fx=FINE, fy=FINE, interpolation=cv2.INTER_NEAREST)
    points = np.rint(((corners + 0.5) * FINE - 0.5) * ROUND).astype(np.int32)
    cv2.fillPoly(large, [points], colour, shift=3)
    return np.asarray(cv2.resize(large, image.shape[1::-1], interpolation=cv2.INTER_AREA), dtype=np.uint8)


def rim(corners: Array) -> tuple[Array, Array]:
    """Points (24, 2) of an outline, that runs to the left of its inside, and their normals."""
    t = (np.arange(6) + 0.5) / 6.0
    side = np.roll(corners, -1, axis=0) - corners
    points = (corners[:, None] + t[:, None] * side[:, None]).reshape(-1, 2)
    normal = np.column_stack((side[:, 1], -side[:, 0])) / np.linalg.norm(side, axis=1)[:, None]
    return points, np.repeat(normal, 6, axis=0)


def shift_of(image: Image, corners: Array, half: int) -> Array:
    """By how much the outline is moved (2,); NaN where it is not found."""
    px, normal = rim(corners)
    n = len(px)
    offsets, usable, all_of_them = np.zeros(n), np.zeros(n, np.bool_), np.ones(n, np.bool_)
    measure(image, px, normal, all_of_them, np.zeros(n, np.int64), half, all_of_them, offsets, usable)
    good = np.isfinite(offsets)
    return np.asarray(np.linalg.lstsq(normal[good], offsets[good])[0]) if good.any() else np.full(2, np.nan)


def meadow(seed: int) -> Image:
    """Grass, 100 x 100."""
    return np.random.default_rng(seed).normal((60.0, 120.0, 100.0), 4.0, (100, 100, 3)).clip(0, 255).astype(np.uint8)


def test_what_has_no_side_of_a_dozen_pixels_is_a_spot() -> None:
    """From 60 m with f = 600 px: boxes of 0.9 and 1.5 m are 9 and 15 px wide."""
    rig, pose = nadir_rig(), (np.array([0.0, 0.0, -60.0]), np.eye(3))
    marks = [Landmark.of(str(k), CORNERS * size + (0.0, 4.0 * k), 0.0, 0.3) for k, size in enumerate((0.9, 1.5, 0.9))]
    eye = eyes(rig)[0]
    edges = visible_edges(Prisms.of(marks), eye.pose(*pose)[0])
    block, is_small = blocks(edges, eye, pose)
    np.testing.assert_array_equal(is_small, edges.landmark != 1)
    for k in (0, 2):
        own = edges.landmark == k
        assert set(block[own]) == {np.flatnonzero(own)[0]}
    np.testing.assert_array_equal(block[~is_small], np.flatnonzero(~is_small))
    samples = sampled(edges, eye, pose, 4.0, 20, np.ones(len(is_small), np.bool_), is_small)
    assert (edges.kind[samples.edge][is_small[samples.edge]] == Kind.ROOF).all()
    assert np.bincount(edges.landmark[samples.edge], minlength=3).min() > 12


@pytest.mark.parametrize("half", [3, 8, 16])
@pytest.mark.parametrize("colour", [(150, 160, 170), (40, 60, 160)])
def test_its_shift_is_measured_to_a_fraction_of_a_pixel(half: int, colour: tuple[int, int, int]) -> None:
    rng, error = np.random.default_rng(half), []
    for seed in range(20):
        turn = rng.uniform(0.0, np.pi)
        corners = 8.0 * CORNERS @ turned(turn) + 50.0
        moved = rng.uniform(-0.9, 0.9, 2) * half
        error.append(shift_of(drawn(corners + moved, colour, meadow(seed)), corners, half) - moved)
    assert np.sqrt(np.mean(np.square(error))) < 0.12


def test_its_shadow_is_not_it() -> None:
    """Darker than the stone is lighter, of the same shape, and next to it. A dark stone of another hue is one."""
    corners, aside = 8.0 * CORNERS + 50.0, np.array([9.0, 4.0])
    stone, shade, slate = (130, 160, 160), (24, 48, 40), (50, 40, 40)
    shaded = drawn(corners, stone, drawn(corners + aside, shade, meadow(1)))
    np.testing.assert_allclose(shift_of(shaded, corners, 12), 0.0, atol=0.4)
    assert np.isnan(shift_of(drawn(corners, shade, meadow(1)), corners, 12)).all()
    np.testing.assert_allclose(shift_of(drawn(corners, slate, meadow(1)), corners, 12), 0.0, atol=0.3)


def test_two_that_look_alike_are_none() -> None:
    corners, stone = 8.0 * CORNERS + 50.0, (150, 160, 170)
    both = drawn(corners, stone, drawn(corners + np.array([-11.0, 3.0]), stone, meadow(2)))
    assert np.isnan(shift_of(both, corners, 12)).all()
    np.testing.assert_allclose(shift_of(both, corners, 5), 0.0, atol=0.3)


def test_one_side_of_a_rim_measures_no_shift() -> None:
    """As of a boulder of which the border leaves one side; three sides tell it."""
    corners, px, normal = 8.0 * CORNERS + 50.0, *rim(8.0 * CORNERS + 50.0)
    image = drawn(corners + np.array([1.0, -2.0]), (150, 160, 170), meadow(4))
    for n, measured in ((6, False), (18, True)):
        offsets, usable, yes = np.zeros(n), np.ones(n, np.bool_), np.ones(n, np.bool_)
        measure(image, px[:n], normal[:n], yes, np.zeros(n, np.int64), 8, yes, offsets, usable)
        assert usable.all() == measured
        assert np.isfinite(offsets).any() == measured


def test_at_the_border_and_on_plain_ground_there_is_none() -> None:
    corners, cut = 8.0 * CORNERS + 50.0, 8.0 * CORNERS + np.array([1.0, 50.0])
    assert np.isnan(shift_of(drawn(cut, (150, 160, 170), meadow(3)), cut, 8)).all()
    assert np.isnan(shift_of(np.full((100, 100, 3), 90, np.uint8), corners, 8)).all()


def test_a_pose_of_small_landmarks_is_as_accurate_as_reported() -> None:
    """Eight boulders and a prior of 0.3 m: mean squared Mahalanobis distance inside 99 %, on both sides."""
    sigma = np.array([0.3, 0.3, 0.3, *np.radians((0.3, 0.3, 0.5)).tolist()])
    distance, gain = list[float](), list[Array]()
    for seed in range(30):
        view = boulders(seed, sigma)
        fit = estimate_pose(view.rig, view.images, view.landmarks, (np.asarray(view.prior.p_n), view.prior.R_nb), view.prior)
        assert isinstance(fit, PoseEstimate), fit
        distance.append(squared_error(view, fit))
        gain.append(fit.joint_covariance.diagonal() / sigma**2)
    low, high = (float(chi2.ppf(share, 6 * len(distance))) / len(distance) for share in (0.005, 0.995))
    assert low < np.mean(distance) < high
    assert (np.mean(gain, axis=0)[[2, 5]] < 0.2).all()  # height and heading; place and tilt look nearly alike


@pytest.mark.parametrize("seed", [103, 109, 116])
def test_boulders_alone_make_a_fix(seed: int) -> None:
    """A prior of 1.5 m and 2 degrees; no side of theirs is an edge."""
    view = boulders(seed, np.array([1.5, 1.5, 1.0, *np.radians((0.5, 0.5, 2.0)).tolist()]))
    names, fit = located(view)
    assert len(names) >= 7
    assert squared_error(view, fit) < chi2.ppf(0.999, 6)


@pytest.mark.parametrize(("seed", "least"), [(12, 8), (14, 5)])
def test_small_ones_are_looked_for_where_the_large_ones_put_them(seed: int, least: int) -> None:
    """The tilt is open by 2.5 degrees, and so is the way from one border of the image to the other."""
    view = house_and_boulders(seed, np.array([1.5, 1.5, 1.0, *np.radians((2.5, 2.5, 3.0)).tolist()]))
    names, fit = located(view)
    assert len(names) >= least
    assert squared_error(view, fit) < chi2.ppf(0.95, 6)
    used = [mark for mark in view.landmarks if mark.id in names]
    once = estimate_pose(view.rig, view.images, used, (view.p_n, view.R_nb), view.prior)
    assert isinstance(once, PoseEstimate)
    ratio = np.linalg.det(fit.joint_covariance) / np.linalg.det(once.joint_covariance)
    assert 0.5 < ratio < 2.0  # the information of the house counts once


def test_a_stone_beside_the_position_is_missed_though_its_edges_cross_the_rim() -> None:
    """Where the map has each boulder, and half a metre next to: 7 px, less than it is wide."""
    view = boulders(3, np.full(6, 1e-3), map_sigma_m=1e-3)
    fit = estimate_pose(view.rig, view.images, view.landmarks, (view.p_n, view.R_nb), view.prior)
    assert isinstance(fit, PoseEstimate)
    beside = [Landmark.of(m.id, m.outline_n + np.array([0.5, 0.0]), m.base_d, m.height_m, m.colour_bgr) for m in view.landmarks]
    there, missed = (final_check(view.rig, view.images, marks, fit, ObservationConfig()) for marks in (view.landmarks, beside))
    assert np.median(there.present) > 2.0
    assert (there.share >= 0.5).mean() >= 0.75
    assert (missed.share < 0.5).mean() >= 0.75
    np.testing.assert_allclose(missed.present[missed.share < 0.5], np.log(0.15 / 0.95))
