"""All outlines as one body: found where no roof has one colour, and no answer when in doubt."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from benchmarks.aerial_trials import turned
from models import so3
from models.camera import CameraModel, StereoRig
from models.landmarks import Landmark, LandmarkMap
from models.messages import Array
from vision.identify import Prior
from vision.pattern import NAME
from vision.pipeline import LandmarkPipeline, PipelineConfig
from vision.rectify import Image
from vision.reports import Result

DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
CAMERA = CameraModel(640, 480, 500.0, 500.0, 319.5, 239.5)
RIG = StereoRig(CAMERA, CAMERA, np.eye(3), np.array([-1.0, 0.0, 0.0]), DOWN, np.zeros(3))
TRUTH = np.array([0.0, 0.0, -50.0])
CAMP = ((-14.0, -19.0, 5.0, 6), (-9.0, 13.0, 6.0, 5), (2.0, -6.0, 4.0, 4), (11.0, 18.0, 5.0, 8), (13.0, -17.0, 4.5, 6))
SIGMA = np.array([1.5, 1.5, 0.5, 0.01, 0.01, 0.03])


def tent(name: str, north: float, east: float, radius: float, corners: int) -> Landmark:
    """A flat polygon of unequal sides."""
    angle = 2.0 * math.pi * (np.arange(corners) + 0.3 * np.sin(np.arange(corners) + north)) / corners
    return Landmark.of(name, np.column_stack((north + radius * np.cos(angle), east + radius * np.sin(angle))), sigma_m=0.05)


def camp(places: Sequence[tuple[float, float, float, int]] = CAMP) -> list[Landmark]:
    return [tent(f"tent {k}", *place) for k, place in enumerate(places)]


def drawn(marks: Sequence[Landmark]) -> Image:
    """Each tent has panels, bright and dark in turn, on a ground between them: no side parts one colour from another."""
    picture = 120.0 + 8.0 * np.random.default_rng(3).normal(size=(480, 640))
    for mark in marks:
        corners = np.column_stack((mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)))
        px = CAMERA.project((corners - TRUTH) @ DOWN)
        for k, (a, b) in enumerate(zip(px, np.roll(px, -1, axis=0), strict=True)):
            panel = np.zeros_like(picture, dtype=np.uint8)
            cv2.fillPoly(panel, [np.round(16.0 * np.array([px.mean(axis=0), a, b])).astype(np.int32)], 1, shift=4)
            picture[panel > 0] = 165.0 if k % 2 else 75.0
    image: Image = np.clip(cv2.GaussianBlur(picture, (3, 3), 0), 0, 255).astype(np.uint8)
    return image


def looked(picture: Image, marks: Sequence[Landmark], error: Array, sigma: Array = SIGMA) -> Result:
    prior = Prior(TRUTH + error[:3], so3.quat_exp(error[3:]), np.diag(sigma**2))
    pipeline = LandmarkPipeline(RIG, LandmarkMap.from_landmarks((47.0, 8.0, 400.0), marks), PipelineConfig(path="predict"))
    return pipeline.process(picture, None, 0, prior)


@pytest.mark.parametrize("seed", range(4))
def test_tents_of_many_shades_are_found_together_and_as_sure_as_told(seed: int) -> None:
    # GIVEN a belief that is off as far as it says, attitude included
    error = SIGMA * np.random.default_rng(seed).normal(size=6)
    # WHEN no outline gives a fit by itself
    found = looked(drawn(camp()), camp(), error)
    # THEN all of them together do, near the truth
    assert found.fix is not None
    assert found.pose is not None
    assert found.fix.landmarks == (NAME,)
    assert "all 5 outlines together" in found.report.detail
    off = found.pose.joint_p_n - TRUTH
    assert np.linalg.norm(off) < 1.5
    assert off @ np.linalg.solve(found.pose.joint_covariance[:3, :3], off) < 16.3  # chi-square of 3, 99.9 %


def test_a_camp_that_is_not_there_is_not_found() -> None:
    for seed in range(4):
        elsewhere = turned(camp(), np.zeros(2), np.random.default_rng(seed))
        assert looked(drawn(camp()), elsewhere, np.zeros(6)).fix is None


def test_of_two_camps_alike_none_is_chosen() -> None:
    near = [(0.35 * n, 0.35 * e - 9.0, 0.6 * r, k) for n, e, r, k in CAMP]
    both = camp([*near, *((n, e + 14.0, r, k) for n, e, r, k in near)])
    error = np.array([0.0, -7.0, 0.0, 0.0, 0.0, 0.0])  # half-way
    wide = SIGMA * [2.0, 2.0, 1.0, 1.0, 1.0, 1.0]
    assert looked(drawn(both), camp(near), error, wide).fix is None
    # and one of them alone is found
    assert looked(drawn(camp(near)), camp(near), error, wide).fix is not None


def test_two_outlines_are_too_few() -> None:
    assert looked(drawn(camp(CAMP[:2])), camp(CAMP[:2]), np.zeros(6)).fix is None
