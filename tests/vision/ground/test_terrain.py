"""Oblique views of another season over slopes: with terrain as good as over flat ground, without it no claim that fails."""

import math
from dataclasses import replace

import cv2
import numpy as np
from scipy.stats import chi2

from models import so3
from models.maps.landmarks import LandmarkMap
from models.messages import Array
from models.prior import Prior
from tests.vision.ground import scene
from vision.ground.features import FeatureMap
from vision.ground.image import Heights
from vision.image.rectify import Image
from vision.pose.pose import difference
from vision.recognisers import MapImage, Recognisers

_SIGMA = np.array([8.0, 8.0, 3.0, 0.01, 0.01, 0.03])
_NOTHING = LandmarkMap.from_landmarks((47.0, 8.0, 400.0), [])
_OBLIQUE, _HEIGHT_M, _STEP_M, _REACH_M = math.radians(45.0), 90.0, 10.0, 400.0


def _shot(ground: Image, p_n: Array, R_nb: Array, slope: Array, rng: np.random.Generator) -> Image:
    """The ground on the plane down = slope (north, east), as the left camera sees it: a homography."""
    p_nc, R_nc = scene.RIG.camera_pose(p_n, R_nb)
    to_ground = np.vstack((scene.AFFINE, [0.0, 0.0, 1.0]))
    to_n = np.column_stack(([1.0, 0.0, slope[0]], [0.0, 1.0, slope[1]], -p_nc))
    H = scene.CAMERA.matrix @ R_nc.T @ to_n @ to_ground
    image = cv2.warpPerspective(ground, H, (scene.CAMERA.width, scene.CAMERA.height), borderMode=cv2.BORDER_REFLECT)
    seen: Image = np.clip(image + rng.normal(0.0, 3.0, image.shape), 0, 255).astype(np.uint8)
    return seen


def _plane(slope: Array) -> Heights:
    """A raster of its heights."""
    at = np.arange(-_REACH_M, _REACH_M + 1.0, _STEP_M)
    affine = np.array([[0.0, _STEP_M, -_REACH_M], [_STEP_M, 0.0, -_REACH_M]])
    return Heights(slope[0] * at[:, None] + slope[1] * at, affine, unevenness_m=0.5)


def _errors(slope_deg: float, *, raster: bool) -> tuple[list[float], list[float]]:
    """Horizontal errors [m] of fix and prior together, and their squares over the claimed covariance, of views with a fix."""
    errors, squared = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        uphill, yaw = rng.uniform(-np.pi, np.pi, 2)
        slope = math.tan(math.radians(slope_deg)) * np.array([math.cos(uphill), math.sin(uphill)])
        q = so3.multiply(so3.from_euler(0.0, 0.0, yaw), so3.from_euler(rng.normal(0.0, 0.05), _OBLIQUE, 0.0))
        behind = _HEIGHT_M * math.tan(_OBLIQUE)
        p_n = np.array([-behind * math.cos(yaw), -behind * math.sin(yaw), -_HEIGHT_M])
        e = rng.normal(0.0, _SIGMA)
        prior = Prior(p_n + e[:3], so3.normalise(so3.multiply(so3.quat_exp(e[3:]), q)), np.diag(_SIGMA**2))
        heights = _plane(slope) if raster else Heights.level(0.0)
        image = replace(scene.map_image(scene.drawing(seed, 1)), heights=heights, height_sigma_m=0.5)
        known = MapImage(image, FeatureMap(image, np.empty((0, 3)), np.empty((0, 128), np.uint8)))
        shot = _shot(scene.drawing(seed), p_n, so3.matrix(q), slope, rng)
        result = Recognisers(scene.RIG, _NOTHING, known).process(shot, None, 0, prior)
        if result.fix is not None and result.pose is not None:
            joint = result.pose
            off = difference(p_n, so3.matrix(q), joint.joint_p_n, so3.from_matrix(np.ascontiguousarray(joint.joint_R_nb)))[:2]
            errors.append(float(np.linalg.norm(off)))
            squared.append(float(off @ np.linalg.solve(joint.joint_covariance[:2, :2], off)))
    return errors, squared


def test_slopes_of_20_degrees_with_their_heights() -> None:
    flat, slopes = _errors(0.0, raster=True), _errors(20.0, raster=True)
    assert len(flat[0]) == 4
    assert len(slopes[0]) == 4
    assert np.median(slopes[0]) < 1.5 * np.median(flat[0])
    assert max(*slopes[1], *flat[1]) < chi2.ppf(1.0 - 1e-3, 2)


def test_slopes_without_heights_are_refused_or_claimed() -> None:
    for slope_deg in (3.0, 20.0):
        errors, squared = _errors(slope_deg, raster=False)
        assert max(squared, default=0.0) < chi2.ppf(1.0 - 1e-3, 2), (slope_deg, errors)
    assert len(errors) < 3, "most views of steep slopes cannot be laid over flat ground"
