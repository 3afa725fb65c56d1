"""Position by registration with an orthophoto, near the prior (docs/vision_orthophoto.md).

coarse   position, heading and height within the prior where the whole is most like the map (search.py)
blocks   shifted singly, sub-pixel, twice, then finer: map points with pixel and covariance
pose     of these points and the prior (point_pose.py), if enough blocks agree

    C = (1 - rho^2) / rho  K^-1  a / n,   K = -d^2 rho / ds^2,   a = 2 pi s^2: pixels whose noise is one after the blur s
"""

import math
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from scipy.special import betainc

from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.ground.image import Float, GroundImage, pyramid
from vision.ground.search import BLUR_PX, PLAIN, NotRegistered, Peak, RegistrationConfig, curvature_at, search, structure
from vision.ground.view import Camera, Grid, camera_view, make_grid, map_known, map_view
from vision.image.rectify import Image
from vision.pose.point_pose import PointConfig, Points, fit_points
from vision.pose.pose import PoseEstimate

_SAME_NOISE_PX = 2.0 * math.pi * BLUR_PX**2
# Of a block's position: two interpolations. All blocks lie at about the same fraction of a pixel, so it does not average.
_FLOOR_PX = 0.1
_AGREES_PX = 2.0  # of the grid: a block that is no farther off
_AGAIN, _SETTLED = 3, 0.8  # more turns at most, while less than so many of the blocks agree: those at the far end come last
_BY_CHANCE = 0.15  # share of the blocks of a wrong position that agree: pi 2^2 / 11^2, and a pose was fitted to them
_POINTS = PointConfig(least=6, freedom=4.0, expected=1.0)


@dataclass(frozen=True, slots=True)
class Registered:
    """A pose with its evidence."""

    pose: PoseEstimate
    tried: int
    agreed: int
    chance: float
    peak: Peak

    @property
    def ratio(self) -> float:
        """Of the first to the second peak."""
        return self.peak.ratio

    @property
    def correlation(self) -> float:
        """Coefficient at the peak of the search."""
        return self.peak.correlation

    def is_moving(self, config: RegistrationConfig) -> bool:
        """Significant, and many blocks are still off: another iteration may help."""
        return self.chance < config.likely and self.agreed < _SETTLED * self.tried

    def is_sure(self, config: RegistrationConfig) -> bool:
        """Whether one image is enough."""
        return self.chance < config.sure and self.ratio >= config.sure_ratio

    def is_likely(self, config: RegistrationConfig) -> bool:
        """Likely: two that agree make a fix."""
        return self.chance < config.likely and self.ratio >= config.likely_ratio


@dataclass(frozen=True, slots=True)
class _Matched:
    points: Points
    tried: int
    step_m: float
    point_px: float

    @classmethod
    def none(cls) -> "_Matched":
        return cls(Points(np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 2, 2))), 0, 1.0, 1.0)


def register(
    rig: StereoRig, image: Image, prior: Prior, map_image: GroundImage, config: RegistrationConfig | None = None
) -> Registered | NotRegistered:
    """Pose of the left camera; the result is likely or sure by is_likely, is_sure."""
    config = config or RegistrationConfig()
    levels = pyramid(image)
    position = search(rig, levels, prior, map_image, config)
    if isinstance(position, NotRegistered):
        return position
    pose = position.p_n, position.R_nb
    found: Registered | None = None
    again = [(config.fine[-1], config.search[-1])] * _AGAIN
    for k, (points, reach) in enumerate([*zip(config.fine, config.search, strict=True), *again]):
        if k >= len(config.fine) and found is not None and not found.is_moving(config):
            break
        laid = _laid(rig, levels, (pose, prior), map_image, position, (points, reach, config.block))
        if isinstance(laid, NotRegistered):
            return laid
        found, pose = laid, (laid.pose.joint_p_n, laid.pose.joint_R_nb)
    assert found is not None
    if found.agreed < config.least_blocks:
        correlation = f"correlation {position.correlation:.2f}"
        return NotRegistered("not_found", f"{found.agreed} of {found.tried} blocks agree; {correlation}", position)
    return found


def _laid(
    rig: StereoRig, levels: tuple[Image, ...], start: tuple[tuple[Array, Array], Prior], map_image: GroundImage, position: Peak,
    sizes: tuple[int, int, int],
) -> Registered | NotRegistered:  # fmt: skip
    pose, prior = start
    matched = _blocks(rig, levels, pose, map_image, sizes)
    tried = matched.tried
    if len(matched.points.px) < _POINTS.least:
        return NotRegistered("no_structure", f"{len(matched.points.px)} of {tried} blocks have a position", position)
    horizontal, height, slope = map_image.shared_sigma
    shared = math.hypot(horizontal, _FLOOR_PX * matched.step_m), height, slope
    fit = fit_points(rig, matched.points, pose, prior, shared, _POINTS)
    if isinstance(fit, str):
        return NotRegistered("no_pose", f"{fit}, of {tried} blocks; correlation {position.correlation:.2f}", position)
    agreed = int(np.sum(np.linalg.norm(fit.residual, axis=1) < _AGREES_PX * matched.point_px))
    chance = float(betainc(agreed, tried - agreed + 1, _BY_CHANCE)) if agreed else 1.0  # of so many or more, binomial
    return Registered(fit.estimate, tried, agreed, chance, position)


def _blocks(
    rig: StereoRig, levels: tuple[Image, ...], pose: tuple[Array, Array], map_image: GroundImage, sizes: tuple[int, int, int]
) -> _Matched:
    most, reach, side = sizes
    camera: Camera = (rig.left, *rig.camera_pose(*pose))
    grid = make_grid(camera, map_image, most)
    if grid is None:
        return _Matched.none()
    (view, seen), known = camera_view(levels, camera, grid, map_image), map_known(map_image, grid, reach)
    template, image = structure(view), structure(map_view(map_image, grid, reach))
    rows, columns = (range(n % side // 2, n - side + 1, side) for n in grid.shape)
    found, tried = [], 0
    for y, x in product(rows, columns):
        block, around = template[y : y + side, x : x + side], np.s_[y : y + side + 2 * reach, x : x + side + 2 * reach]
        if block.std() > PLAIN and seen[y : y + side, x : x + side].all() and known[around].all():
            tried += 1
            if peak := _peak(image[around], block):
                found.append(((x + 0.5 * (side - 1), y + 0.5 * (side - 1)), peak[0] - reach, peak[1]))
    return (
        _Matched(_as_points(camera, grid, map_image, found), tried, grid.q, grid.q / grid.camera_m) if found else _Matched.none()
    )


def _peak(image: Float, block: Float) -> tuple[Array, Array] | None:
    rho = cv2.matchTemplate(image, block, cv2.TM_CCOEFF_NORMED)
    i, j = np.unravel_index(int(np.argmax(rho)), rho.shape)
    best = float(rho[i, j])
    if not (0 < i < len(rho) - 1 and 0 < j < len(rho) - 1) or best <= 0.0:
        return None
    shape = curvature_at(np.asarray(rho, dtype=np.float32), int(i), int(j))
    if shape is None:
        return None
    K, step = shape
    noise = (1.0 - best**2) / best * _SAME_NOISE_PX / block.size
    return np.array([float(j), float(i)]) + step, noise * np.linalg.inv(K) + _FLOOR_PX**2 * np.eye(2)


def _as_points(
    camera: Camera, grid: Grid, map_image: GroundImage, found: list[tuple[tuple[float, float], Array, Array]]
) -> Points:
    """Blocks in the grid to map points and camera pixels.

    R = J C J^T + (unevenness du/dd)^2: objects lean over.
    """
    (model, p_nc, R_nc), (at, shift, covariance) = camera, map(np.array, zip(*found, strict=True))
    x_c = (map_image.points(grid.position(at)) - p_nc) @ R_nc
    by_n = model.project_jacobian(x_c) @ R_nc.T
    J = by_n[:, :, :2] @ grid.axes * grid.q
    lean = map_image.heights.unevenness_m * by_n[:, :, 2]
    R = J @ covariance @ J.transpose(0, 2, 1) + lean[:, :, None] * lean[:, None, :]
    return Points(map_image.points(grid.position(at + shift)), model.project(x_c), R)
