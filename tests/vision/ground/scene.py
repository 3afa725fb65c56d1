"""A flat piece of ground with fields, roads and roofs, as a map's image and as a camera sees it."""

from functools import cache

import cv2
import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.messages import Array
from models.prior import Prior
from vision.ground.image import GroundImage, Heights
from vision.image.rectify import Image
from vision.pose.pose import PoseEstimate, difference

FINE_M = 0.2  # the drawing's pixel
SIDE = 1600  # px of the drawing
CAMERA = CameraModel(640, 480, 500.0, 500.0, 319.5, 239.5)
R_BC = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # looks down, its top is forward
RIG = StereoRig(CAMERA, CAMERA, np.eye(3), np.array([-0.3, 0.0, 0.0]), R_BC, np.array([0.1, 0.0, 0.05]))
AFFINE = np.array([[0.0, -FINE_M, 0.5 * FINE_M * SIDE], [FINE_M, 0.0, -0.5 * FINE_M * SIDE]])  # north is up


@cache
def drawing(seed: int, season: int = 0) -> Image:
    """Grey values of the ground; of another season fields and trees are as dark as they were bright."""
    rng, tones = np.random.default_rng(seed), np.random.default_rng(1000 * season + seed)
    image = np.full((SIDE, SIDE), 120, np.uint8)
    for _ in range(40):
        centre, size, angle = rng.uniform(0, SIDE, 2), rng.uniform(100, 500, 2), rng.uniform(0, 180)
        box = cv2.boxPoints((tuple(centre), tuple(size), angle)).astype(np.int32)
        cv2.fillConvexPoly(image, box, int(tones.uniform(60, 180)))
    for _ in range(12):
        ends = rng.uniform(0, SIDE, (2, 2)).astype(int)
        cv2.line(image, tuple(map(int, ends[0])), tuple(map(int, ends[1])), 190, 25, cv2.LINE_AA)
    for _ in range(160):
        centre, radius = rng.uniform(0, SIDE, 2), rng.uniform(8, 20)
        cv2.circle(image, tuple(map(int, centre)), int(radius), int(tones.uniform(30, 150)), -1, cv2.LINE_AA)
    for _ in range(130):
        centre, size, angle = rng.uniform(0, SIDE, 2), rng.uniform(30, 90, 2), rng.uniform(0, 180)
        box = cv2.boxPoints((tuple(centre), tuple(size), angle)).astype(np.int32)
        cv2.fillConvexPoly(image, box, int(rng.uniform(140, 240)), cv2.LINE_AA)
    grain = cv2.GaussianBlur(rng.normal(0, 30, image.shape).astype(np.float32), (0, 0), 2.0)
    drawn: Image = np.clip(image + grain, 0, 255).astype(np.uint8)
    return drawn


def map_image(ground: Image, reduction: int = 3, sigma_m: float = 0.0) -> GroundImage:
    """The drawing as an orthophoto of pixels `reduction` times as large."""
    size = SIDE // reduction
    small = cv2.resize(ground[: size * reduction, : size * reduction], (size, size), interpolation=cv2.INTER_AREA)
    affine = AFFINE.copy()
    affine[:, 2] += AFFINE[:, :2].sum(axis=1) * 0.5 * (reduction - 1)
    affine[:, :2] *= reduction
    return GroundImage("ortho", small.astype(np.uint8), affine, Heights.level(0.0, unevenness_m=0.0, slope=0.0), sigma_m)


def shot(ground: Image, p_n: Array, R_nb: Array, rng: np.random.Generator, noise: float = 3.0) -> Image:
    """What the left camera sees of it: px ~ K R_cn (g - p_nc), a homography as the ground is flat at down = 0."""
    p_nc, R_nc = RIG.camera_pose(p_n, R_nb)
    to_ground = np.vstack((AFFINE, [0.0, 0.0, 1.0]))  # north, east, 1
    H = CAMERA.matrix @ R_nc.T @ np.column_stack((np.eye(3)[:, :2], -p_nc)) @ to_ground
    twice = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])  # anti-aliasing
    large = cv2.warpPerspective(ground, twice @ H, (2 * CAMERA.width, 2 * CAMERA.height), borderMode=cv2.BORDER_REFLECT)
    image = cv2.resize(large, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA).astype(np.float64)
    return np.clip(image + rng.normal(0.0, noise, image.shape), 0, 255).astype(np.uint8)


def flight(rng: np.random.Generator, sigma: Array) -> tuple[Array, Array, Prior]:
    """A true pose over the ground, and a prior drawn about it; sigma (6,) m and rad."""
    p_n = np.array([*rng.uniform(-50.0, 50.0, 2), -rng.uniform(90.0, 130.0)])
    roll, pitch = rng.normal(0.0, 0.06, 2)
    q = so3.from_euler(roll, pitch, rng.uniform(-np.pi, np.pi))
    error = rng.normal(0.0, sigma)
    q0 = so3.normalise(so3.multiply(so3.quat_exp(error[3:]), q))
    return p_n, so3.matrix(q), Prior(p_n + error[:3], q0, np.diag(sigma**2))


def chi_square(pose: PoseEstimate, p_n: Array, R_nb: Array) -> float:
    """Squared Mahalanobis distance of a measurement from the truth, scaled as if of six degrees of freedom."""
    e = difference(p_n, R_nb, pose.p_n, so3.from_matrix(np.ascontiguousarray(pose.R_nb)))
    total = pose.covariance + pose.covariance_common
    if pose.directions is None or pose.readings is None:
        return float(e @ np.linalg.solve(total, e))
    nu = pose.directions @ e - pose.readings
    return float(nu @ np.linalg.solve(pose.directions @ total @ pose.directions.T, nu)) * 6.0 / len(nu)
