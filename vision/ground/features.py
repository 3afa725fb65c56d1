"""Position by features of a georeferenced image: SIFT and FLANN.

    keypoints of both images (Lowe 2004) -> nearest two descriptors, ratio test -> RANSAC (P3P) -> pose of inliers and prior

Fails in another light or season.
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Final

import cv2
import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.ground.image import GroundImage, pyramid
from vision.ground.view import make_grid
from vision.image.rectify import Image
from vision.pose.point_pose import PointConfig, PointPose, Points, fit_points
from vision.pose.pose import PoseEstimate

Descriptors = NDArray[np.uint8]  # SIFT's are whole numbers
Rows = NDArray[np.intp]
_TREES: Final[dict[str, bool | int | float | str]] = {"algorithm": 1, "trees": 4}  # FLANN's randomised k-d trees
_CHECKS: Final[dict[str, bool | int | float | str]] = {"checks": 64}
_GRID: Final = 64  # points that tell what the camera sees
_REACH_SIGMA: Final = 4.0
_FEATURE_PX = 0.5  # of a keypoint's position in its image
_TILE_PX, _MARGIN_PX = 512, 64  # of a map whose keypoints are sought
_DOUBLED_PX = 0.25  # OpenCV seeks in the doubled image and halves what it finds: u = (2 u + 1/2) / 2 - 1/4
_FEWEST = 8  # inliers that are worth fitting a pose to
_POINTS = PointConfig(least=_FEWEST, freedom=8.0, expected=1.0)
_GATE = 13.8  # chi-square of 2, 99.9 %


class FeatureConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of matching and acceptance."""

    most: Annotated[int, Meta(ge=50, description="keypoints of a camera's image")] = 1500
    most_in_map: Annotated[int, Meta(ge=50, description="keypoints of the map's image")] = 60_000
    longest_map: Annotated[int, Meta(ge=256, description="px: a larger map image is halved before keypoints are sought")] = 5000
    ratio: Annotated[float, Meta(gt=0, lt=1, description="of nearest to second descriptor distance")] = 0.75
    inlier_px: Annotated[float, Meta(gt=0, description="reprojection error of an inlier")] = 3.0
    least: Annotated[int, Meta(ge=6, description="inliers that make a fix")] = 16
    least_share: Annotated[float, Meta(ge=0, le=1, description="of the matches that are inliers")] = 0.15
    least_spread: Annotated[float, Meta(ge=0, le=1, description="of the image's area within the inliers' hull")] = 0.05


@dataclass(frozen=True, eq=False)
class FeatureMap:
    """Keypoints of a map's image: points (N, 3) in n, descriptors (N, 128)."""

    image: GroundImage
    x_n: Array
    descriptors: Descriptors

    @classmethod
    def of(cls, image: GroundImage, config: FeatureConfig | None = None) -> "FeatureMap":
        """Keypoints of an image, about a second a million pixels."""
        return cls.placed(image, *map_keypoints(image.pyramid, config))

    @classmethod
    def placed(cls, image: GroundImage, px: Array, descriptors: Descriptors) -> "FeatureMap":
        """Keypoints at pixels (N, 2), by georeference and heights."""
        return cls(image, image.points(px @ image.affine[:, :2].T + image.affine[:, 2]), descriptors)

    def near(self, position_n: Array, radius_m: float) -> Rows:
        """Rows of the keypoints within a circle about a position (2,)."""
        return np.flatnonzero(np.hypot(*(self.x_n[:, :2] - position_n).T) < radius_m)


def map_keypoints(levels: tuple[Image, ...], config: FeatureConfig | None = None) -> tuple[Array, Descriptors]:
    """Pixels (N, 2) of level 0 and descriptors (N, 128) of a map image's pyramid."""
    config = config or FeatureConfig()
    level = 0
    while level < len(levels) - 1 and max(levels[level].shape) > config.longest_map:
        level += 1
    px, descriptors = _of_large(levels[level], config.most_in_map)
    return px * 2.0**level, descriptors


@dataclass(frozen=True, slots=True)
class NotRecognised:
    """Why not: no_ground | no_features | few_matches | few_inliers | no_pose."""

    reason: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Matches:
    """Matching pixels (N, 2) and map points (N, 3); inlier_px: RANSAC's distance."""

    px: Array
    x_n: Array
    sigma_px: float
    inlier_px: float


@dataclass(frozen=True, slots=True)
class Recognised:
    """A pose, and how many features matched and fit."""

    pose: PoseEstimate
    matched: int
    inliers: int


def recognise(
    rig: StereoRig, image: Image, prior: Prior, known: FeatureMap, config: FeatureConfig | None = None
) -> Recognised | NotRecognised:
    """Pose of the left camera; deterministic to the bit."""
    config = config or FeatureConfig()
    map_image = known.image
    camera = rig.left, *rig.camera_pose(prior.p_n, prior.R_nb)
    grid = make_grid(camera, map_image, _GRID)
    if grid is None:
        return NotRecognised("no_ground", "the camera does not point at the ground")
    sigma = math.sqrt(float(np.linalg.eigvalsh(prior.covariance[:2, :2])[-1]))
    rows = known.near(grid.centre, 0.6 * grid.q * math.hypot(*grid.shape) + _REACH_SIGMA * sigma)
    levels = pyramid(image)
    level = min(max(int(math.log2(max(map_image.pixel_m / grid.camera_m, 1.0))), 0), len(levels) - 1)  # no finer than the map
    if len(rows) < config.least:
        return NotRecognised("no_features", f"{len(rows)} in the map about there")
    px, descriptors = _keypoints(levels[level], config.most)
    if len(px) < config.least:
        return NotRecognised("no_features", f"{len(px)} in the image")
    mine, theirs = _matches(descriptors, known.descriptors[rows], config.ratio)
    if len(mine) < config.least:
        return NotRecognised("few_matches", f"{len(mine)} of {len(px)} features")
    sigma_px = _FEATURE_PX * math.hypot(2.0**level, map_image.pixel_m / grid.camera_m)
    matches = Matches(px[mine] * 2.0**level, known.x_n[rows[theirs]], sigma_px, config.inlier_px * 2.0**level)
    return pose_of_matches(rig, matches, first_inliers(rig, matches), prior, map_image, config)


def pose_of_matches(
    rig: StereoRig, matches: Matches, agree: Rows, prior: Prior, map_image: GroundImage, config: FeatureConfig
) -> Recognised | NotRecognised:
    """The pose of RANSAC's inliers with the prior, whose scale, heading and tilt it must have."""
    px, x_n, sigma_px = matches.px, matches.x_n, matches.sigma_px
    if len(agree) < _FEWEST:
        return NotRecognised("few_inliers", f"{len(agree)} of {len(px)} matches")
    pose, best = (_position(rig, prior.R_nb, px[agree], x_n[agree]), prior.R_nb), None
    for _ in range(2):  # to the matches that agreed, then to all that do
        if not _far_enough(rig, pose, x_n[agree], map_image).all():
            return NotRecognised("no_pose", f"points beside the camera, of {len(px)} matches")
        points = _points(rig, pose, px[agree], x_n[agree], sigma_px, map_image)
        fit = fit_points(rig, points, pose, prior, map_image.shared_sigma, _POINTS)
        if isinstance(fit, str):
            return NotRecognised("no_pose", f"{fit}, of {len(px)} matches")
        pose, best = (fit.estimate.joint_p_n, fit.estimate.joint_R_nb), _judged(fit, points, len(px), rig, config)
        agree = np.flatnonzero(_distances(rig, pose, px, x_n, sigma_px, map_image) < _GATE)
    assert best is not None
    return best


def _judged(fit: PointPose, points: Points, matched: int, rig: StereoRig, config: FeatureConfig) -> Recognised | NotRecognised:
    inliers = int(fit.used.sum())
    hull = cv2.convexHull(points.px[fit.used].astype(np.float32))
    spread = float(cv2.contourArea(hull)) / (rig.left.width * rig.left.height)
    if inliers < max(config.least, config.least_share * matched) or spread < config.least_spread:
        return NotRecognised("few_inliers", f"{inliers} of {matched} matches, on {spread:.0%} of the image")
    return Recognised(fit.estimate, matched, inliers)


def _keypoints(image: Image, most: int) -> tuple[Array, Descriptors]:
    found, descriptors = cv2.SIFT.create(nfeatures=most).detectAndCompute(image, None)
    if not len(found):
        return np.empty((0, 2)), np.empty((0, 128), np.uint8)
    return np.array([k.pt for k in found], dtype=np.float64) - _DOUBLED_PX, descriptors.astype(np.uint8)


def _of_large(image: Image, most: int) -> tuple[Array, Descriptors]:
    """In tiles: SIFT needs 200 bytes a pixel."""
    height, width = image.shape
    if max(height, width) <= _TILE_PX:
        return _keypoints(image, most)
    px, clear, descriptors = np.empty((0, 2)), np.empty(0), np.empty((0, 128), np.uint8)
    for top, left in product(range(0, height, _TILE_PX), range(0, width, _TILE_PX)):
        v, u = max(top - _MARGIN_PX, 0), max(left - _MARGIN_PX, 0)
        part = image[v : top + _TILE_PX + _MARGIN_PX, u : left + _TILE_PX + _MARGIN_PX]
        found, described = cv2.SIFT.create().detectAndCompute(part, None)
        at = np.array([k.pt for k in found]).reshape(-1, 2) + np.array([u, v])
        own = np.flatnonzero(np.all((at >= (left, top)) & (at < (left + _TILE_PX, top + _TILE_PX)), axis=1))
        if len(own):
            px = np.concatenate((px, at[own] - _DOUBLED_PX))
            clear = np.concatenate((clear, np.array([found[k].response for k in own.tolist()])))
            descriptors = np.concatenate((descriptors, described[own].astype(np.uint8)))
        best = np.argsort(-clear, kind="stable")[:most]  # what is left out now would be left out in the end
        px, clear, descriptors = px[best], clear[best], descriptors[best]
    return px, descriptors


def _matches(mine: Descriptors, theirs: Descriptors, ratio: float) -> tuple[Rows, Rows]:
    cv2.setRNGSeed(0)  # the trees are random: a replay grows the same ones
    pairs = cv2.FlannBasedMatcher(_TREES, _CHECKS).knnMatch(mine.astype(np.float32), theirs.astype(np.float32), k=2)
    best: dict[int, cv2.DMatch] = {}
    for pair in pairs:
        if len(pair) == 2 and pair[0].distance < ratio * pair[1].distance:
            held = best.get(pair[0].trainIdx)
            if held is None or pair[0].distance < held.distance:
                best[pair[0].trainIdx] = pair[0]
    good = sorted(best.values(), key=lambda m: m.queryIdx)
    return np.array([m.queryIdx for m in good], dtype=np.intp), np.array([m.trainIdx for m in good], dtype=np.intp)


def first_inliers(rig: StereoRig, matches: Matches) -> Rows:
    """Rows that fit one pose, by P3P in RANSAC, without the prior."""
    x_n, plane, f = matches.x_n, rig.left.undistort(matches.px), 0.5 * (rig.left.fx + rig.left.fy)
    try:
        done, _, _, rows = cv2.solvePnPRansac(
            x_n - x_n.mean(axis=0), plane, np.eye(3), None, iterationsCount=2000, reprojectionError=matches.inlier_px / f,
            confidence=0.9999, flags=cv2.SOLVEPNP_P3P,
        )  # fmt: skip
    except cv2.error:
        return np.empty(0, dtype=np.intp)
    return rows[:, 0].astype(np.intp) if done and rows is not None else np.empty(0, dtype=np.intp)


def _position(rig: StereoRig, R_nb: Array, px: Array, x_n: Array) -> Array:
    """p_n at a known attitude: sum (I - r r^T)(x - p_nc) = 0, r the rays."""
    rays = rig.left.ray(px) @ (R_nb @ rig.R_bc).T
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    p_nc = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, x_n))
    p_n: Array = p_nc - R_nb @ rig.p_bc
    return p_n


def _distances(
    rig: StereoRig, pose: tuple[Array, Array], px: Array, x_n: Array, sigma_px: float, map_image: GroundImage
) -> Array:
    p_nc, R_nc = rig.camera_pose(*pose)
    off = px - rig.left.project((x_n - p_nc) @ R_nc)
    seen = np.isfinite(off).all(axis=1) & _far_enough(rig, pose, x_n, map_image)
    result = np.full(len(px), np.inf)
    R = _points(rig, pose, px[seen], x_n[seen], sigma_px, map_image).R
    result[seen] = np.einsum("ni,nij,nj->n", off[seen], np.linalg.inv(R), off[seen])
    return result


def _far_enough(rig: StereoRig, pose: tuple[Array, Array], x_n: Array, map_image: GroundImage) -> NDArray[np.bool_]:
    """Points (N,) deeper than the relief is high."""
    p_nc, R_nc = rig.camera_pose(*pose)
    far: NDArray[np.bool_] = (x_n - p_nc) @ R_nc[:, 2] > map_image.heights.unevenness_m
    return far


def _points(rig: StereoRig, pose: tuple[Array, Array], px: Array, x_n: Array, sigma_px: float, map_image: GroundImage) -> Points:
    """R = sigma^2 I + (unevenness du/dd)^2: what stands on the ground leans over."""
    p_nc, R_nc = rig.camera_pose(*pose)
    lean = map_image.heights.unevenness_m * (rig.left.project_jacobian((x_n - p_nc) @ R_nc) @ R_nc.T)[:, :, 2]
    return Points(x_n, px, sigma_px**2 * np.eye(2) + lean[:, :, None] * lean[:, None, :])
