"""Outlines whose single corners are off: what that does to edges, to the covariance of a fix, and what of it repeats."""

import msgspec
import numpy as np

from models import so3
from models.maps.landmarks import Landmark
from models.messages import Array
from tests.vision.pose.test_pose import SIGMA, Flight, flight, near, seen_from_above
from tests.vision.roofs import nadir_rig
from vision.outline.visibility import MapError
from vision.pose.corner_errors import by_corners, repeating
from vision.pose.pose import PoseEstimate, difference, estimate_pose

CORNER_M = 0.25


def test_an_edges_offset_and_tilt_have_half_the_variance_of_its_corners() -> None:
    """The formula against 20,000 rectangles whose corners were moved."""
    rng = np.random.default_rng(1)
    ends = rng.normal(0.0, 2.0, (20_000, 2, 2))  # e_1, e_2 of an edge along the first axis, whose normal is the second
    offset, tilt = 0.5 * ends[:, :, 1].sum(axis=1), 0.5 * (ends[:, 1, 1] - ends[:, 0, 1])
    own = by_corners(np.full((1, 1), 2.0 / np.sqrt(2.0)))[0]
    np.testing.assert_allclose(np.cov(offset, tilt), own @ own.T, atol=0.1)


def test_what_repeats_is_the_largest_part_and_no_more_than_there_is() -> None:
    moved = np.random.default_rng(2).normal(size=(5, 6, 2))
    mark = np.array([0, 0, 1, 1, 1])
    whole = np.array([np.einsum("eik,ejk->ij", moved[mark == k], moved[mark == k]) for k in range(2)])
    every = repeating(moved, mark, 2, 6)
    np.testing.assert_allclose(every @ every.transpose(0, 2, 1), whole, atol=1e-9)
    some = repeating(moved, mark, 2, 2)
    assert some.shape == (2, 6, 2)
    left = whole - some @ some.transpose(0, 2, 1)
    assert np.linalg.eigvalsh(left).min() > -1e-9


def _drawn_badly(seed: int) -> Flight:
    """Three boxes, of which a person drew the map: each corner is off by itself."""
    true, rng = flight(seed).landmarks, np.random.default_rng(1000 + seed)
    mapped = [
        Landmark.of(
            m.id, m.outline_n + rng.normal(0.0, CORNER_M, m.outline_n.shape), m.base_d, m.height_m, m.colour_bgr,
            sigma_m=CORNER_M, outline_sigma_m=CORNER_M, corner_sigma_m=CORNER_M,
        )
        for m in true
    ]  # fmt: skip
    return seen_from_above(rng, nadir_rig(), list(true), mapped, 40.0, 0.15, SIGMA)


def _squared(view: Flight, marks: list[Landmark]) -> Array | None:
    """(1,): squared error over variance of the heading, which no shift or growth of an outline can explain."""
    found = estimate_pose(view.rig, view.images, marks, near(view), view.prior)
    if not isinstance(found, PoseEstimate):
        return None
    off = difference(found.joint_p_n, found.joint_R_nb, view.p_n, so3.from_matrix(np.ascontiguousarray(view.R_nb)))
    return np.array([off[5] ** 2 / found.joint_covariance[5, 5]])


def test_headings_from_an_outline_drawn_by_hand_are_as_wrong_as_they_claim() -> None:
    views = [_drawn_badly(seed) for seed in range(24)]
    own = [_squared(view, list(view.landmarks)) for view in views]
    blind = [_squared(view, [msgspec.structs.replace(m, corner_sigma_m=0.0) for m in view.landmarks]) for view in views]
    with_it, without = (np.array([one for one in some if one is not None]) for some in (own, blind))
    assert len(with_it) >= 12
    assert 0.3 < with_it.mean() < 2.0
    assert without.mean() > 2.0 * with_it.mean()


def test_corner_errors_repeat_from_image_to_image() -> None:
    view = _drawn_badly(3)
    found = estimate_pose(view.rig, view.images, view.landmarks, near(view), view.prior)
    blind = [msgspec.structs.replace(m, corner_sigma_m=0.0) for m in view.landmarks]
    before = estimate_pose(view.rig, view.images, blind, near(view), view.prior)
    assert isinstance(found, PoseEstimate)
    assert isinstance(before, PoseEstimate)
    assert found.landmark_errors.shape == (3, 6, len(MapError) + 2)
    whole = np.einsum("mik,mjk->ij", found.landmark_errors, found.landmark_errors) + found.covariance_rig
    np.testing.assert_allclose(whole, found.covariance_common, atol=1e-9)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0
    assert found.covariance_common[5, 5] > 2.0 * before.covariance_common[5, 5], "the heading's error repeats too"
