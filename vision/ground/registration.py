"""Position by laying the camera's image onto a satellite image or an orthophoto, with the filter's prior.

The thesis' own matcher, Sobel's magnitude (eq. 4.62-4.64) and the normalised correlation coefficient (eq. 4.80), turned on the
map. Edges stay where brightness and colours change with season and light.

    coarse   the camera's image as seen from straight above, by the prior's attitude and height, is shifted over the map within
             reach_sigma of the prior's covariance, turned and stretched as far as that leaves heading and height open
    blocks   from the best position its blocks are shifted singly, to a fraction of a pixel, twice, then finer: each is a point
             of the map whose pixel is known, with the covariance that the peak's curvature and height give

        C = (1 - rho^2) / rho  K^-1  a / n,   K = -d^2 rho / ds^2,   a = 2 pi s^2: pixels whose noise is one after the blur s

    pose     of these points and the prior (point_pose.py)
    no       unless one position stands out (peak to second peak), and so many blocks agree on one pose that chance does not
             explain it. A position that is only likely waits for the next image to say the same (recognisers.py)
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import Annotated

import cv2
import msgspec
import numpy as np
from msgspec import Meta
from scipy.special import betainc

from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.describe.correspond import sobel
from vision.ground.image import Float, GroundImage, pyramid
from vision.ground.view import Camera, Grid, Mask, camera_view, make_grid, map_view
from vision.image.rectify import Image
from vision.pose.point_pose import PointConfig, Points, fit_points
from vision.pose.pose import PoseEstimate

_BLUR_PX = 1.0
_SAME_NOISE_PX = 2.0 * math.pi * _BLUR_PX**2
_AROUND_PX = 15  # over which the contrast is made even
_FAINT = 24.0  # Sobel magnitude (8 grey levels per 3 px) of what is noise rather than structure
_PLAIN = 0.08  # standard deviation of a block's structure below which it has none
_STEP_PX = 2.0  # at the patch's end, half a step of heading and scale
_LOBE_PX = 6.0  # from the peak: another position begins there
# Of a block's position: two interpolations. All blocks lie at about the same fraction of a pixel, so it does not average.
_FLOOR_PX = 0.1
_AGREES_PX = 2.0  # of the grid: a block that is no farther off
_BY_CHANCE = 0.15  # share of the blocks of a wrong position that agree: pi 2^2 / 11^2, and a pose was fitted to them
_POINTS = PointConfig(least=6, freedom=4.0, expected=1.0)


class RegistrationConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How far and how finely the map is searched, and what is accepted."""

    reach_sigma: Annotated[float, Meta(gt=0, le=5, description="standard deviations of the prior that are searched")] = 3.0
    coarse: Annotated[int, Meta(ge=64, description="points along the image in the search; it reaches so many each way")] = 128
    most_turns: Annotated[int, Meta(ge=1, description="headings times heights that are tried")] = 81
    fine: tuple[int, ...] = (256, 448)  # points along the image when blocks are shifted
    search: tuple[int, ...] = (8, 5)  # points that a block is shifted, each way
    block: Annotated[int, Meta(ge=16, description="points to a block's side")] = 40
    least_blocks: Annotated[int, Meta(ge=6, description="that agree")] = 8
    sure: Annotated[float, Meta(gt=0, lt=1, description="probability of as many agreeing blocks by chance: a fix")] = 1e-6
    likely: Annotated[float, Meta(gt=0, lt=1, description="a fix if the next image says the same")] = 1e-4
    sure_ratio: Annotated[float, Meta(ge=1, description="height of the peak over that of the second: a fix")] = 1.25
    likely_ratio: Annotated[float, Meta(ge=1, description="a fix if the next image says the same")] = 1.08


@dataclass(frozen=True, slots=True)
class Peak:
    """The best position of the search. p_n, R_nb: the pose there; ratio: of first to second peak; correlation: coefficient at it.

    deviations: correlation over the standard deviation of those of other positions; seen_n (3,): ground where by the prior the
    middle of what is seen lies; shown_n (2,): where by the map; q: points of the search are so many m apart; curvature (2, 2):
    -d^2 rho / d(north, east)^2 [1/m^2], None where the peak has no one position, or lies at the border of the search.
    """

    p_n: Array
    R_nb: Array
    ratio: float
    correlation: float
    deviations: float
    seen_n: Array
    shown_n: Array
    q: float
    curvature: Array | None


@dataclass(frozen=True, slots=True)
class NotRegistered:
    """Why not: no_ground | outside | prior_too_wide | no_structure | not_found | no_pose; peak: of the search, if it had one."""

    reason: str
    detail: str = ""
    peak: Peak | None = None


@dataclass(frozen=True, slots=True)
class Registered:
    """A pose with the evidence for it.

    tried, agreed: blocks; chance: probability of that by chance; peak: of the search.
    """

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

    def is_sure(self, config: RegistrationConfig) -> bool:
        """Whether one image is enough."""
        return self.chance < config.sure and self.ratio >= config.sure_ratio

    def is_likely(self, config: RegistrationConfig) -> bool:
        """Whether two images that say the same are."""
        return self.chance < config.likely and self.ratio >= config.likely_ratio


@dataclass(frozen=True, slots=True)
class _Matched:
    """Points of the map with their pixels, how many blocks were tried, the grid's step [m], and the camera's pixels to it."""

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
    """Where the left camera of the rig took the image. The result is likely or sure by its own is_likely, is_sure."""
    config = config or RegistrationConfig()
    levels = pyramid(image)
    position = _search(rig, levels, prior, map_image, config)
    if isinstance(position, NotRegistered):
        return position
    pose = position.p_n, position.R_nb
    fit, matched = None, _Matched.none()
    for points, reach in zip(config.fine, config.search, strict=True):
        matched = _blocks(rig, levels, pose, map_image, (points, reach, config.block))
        if len(matched.points.px) < _POINTS.least:
            return NotRegistered("no_structure", f"{len(matched.points.px)} of {matched.tried} blocks have a position", position)
        horizontal, height, slope = map_image.shared_sigma
        shared = math.hypot(horizontal, _FLOOR_PX * matched.step_m), height, slope
        found = fit_points(rig, matched.points, pose, prior, shared, _POINTS)
        if isinstance(found, str):
            return NotRegistered(
                "no_pose", f"{found}, of {matched.tried} blocks; correlation {position.correlation:.2f}", position
            )
        fit, pose = found, (found.estimate.joint_p_n, found.estimate.joint_R_nb)
    assert fit is not None
    tried = matched.tried
    agreed = int(np.sum(np.linalg.norm(fit.residual, axis=1) < _AGREES_PX * matched.point_px))
    if agreed < config.least_blocks:
        return NotRegistered("not_found", f"{agreed} of {tried} blocks agree; correlation {position.correlation:.2f}", position)
    chance = float(betainc(agreed, tried - agreed + 1, _BY_CHANCE))  # of so many or more, binomial
    return Registered(fit.estimate, tried, agreed, chance, position)


def structure(view: Float) -> Float:
    """What is compared: Sobel's magnitude over its mean around, and of that the root: no shadow's edge counts for a block."""
    magnitude = sobel(cv2.GaussianBlur(view, (0, 0), _BLUR_PX))
    even: Float = np.sqrt(magnitude / (cv2.blur(magnitude, (_AROUND_PX, _AROUND_PX)) + np.float32(_FAINT)))
    return even


def shift_of_ground(arm_n: Array) -> Array:
    """dg = J (dp, dtheta), J (2, 6): how a ray's ground point moves with the pose; arm_n (3,): from the body to that point.

    dg = dp + dtheta x r - r (dp + dtheta x r)_d / r_d
    """
    x, y, z = arm_n
    moved = np.array([[1.0, 0.0, 0.0, 0.0, z, -y], [0.0, 1.0, 0.0, -z, 0.0, x], [0.0, 0.0, 1.0, y, -x, 0.0]])
    J: Array = moved[:2] - np.outer(arm_n[:2] / z, moved[2])
    return J


def _search(
    rig: StereoRig, levels: tuple[Image, ...], prior: Prior, map_image: GroundImage, config: RegistrationConfig
) -> Peak | NotRegistered:
    """The position, heading and height where the image's structure is most like the map's."""
    camera: Camera = (rig.left, *rig.camera_pose(prior.p_n, prior.R_nb))
    grid = make_grid(camera, map_image, config.coarse)
    if grid is None:
        return NotRegistered("no_ground", "the camera does not point at the ground")
    ground = map_image.points(grid.centre[None])[0]
    J = shift_of_ground(ground - prior.p_n)
    to_grid = grid.axes.T / grid.q
    covariance = to_grid @ J @ prior.covariance @ J.T @ to_grid.T
    reach = math.ceil(config.reach_sigma * math.sqrt(float(np.diag(covariance).max())) + 1.0)
    step, counts = _turns(grid, prior, float(ground[2] - prior.p_n[2]), config.reach_sigma)
    number = math.prod(2 * n + 1 for n in counts)
    if reach > config.coarse or number > config.most_turns:
        return NotRegistered("prior_too_wide", f"{reach * grid.q:.0f} m each way, {number} headings and heights")
    yaws, scales = (step * np.arange(-n, n + 1.0) for n in counts)
    turns = [(float(yaw), 1.0 + float(scale)) for yaw, scale in product(yaws, scales) if scale > -0.5]
    view, seen = camera_view(levels, camera, grid, map_image)
    mask = cv2.erode(seen.astype(np.float32), np.ones((5, 5)), borderValue=1.0).astype(np.float32)
    known = map_view(map_image, grid, reach)[1]
    if mask.mean() < 0.2 or known.mean() < 0.5:
        return NotRegistered("outside", f"the map's image shows {known.mean():.0%} of that the camera may see")
    template = structure(view)
    if not template[mask > 0.0].std() > _PLAIN:
        return NotRegistered("no_structure", "the image shows nothing that could be compared")
    inside = _ellipse(covariance, reach, config.reach_sigma)
    scores = np.stack([_correlation(structure(map_view(map_image, grid.turned(*t), reach)[0]), template, mask) for t in turns])
    return _stands_out(np.where(inside, scores, -1.0), inside, turns, grid, ground, prior)


def _turns(grid: Grid, prior: Prior, height: float, reach_sigma: float) -> tuple[float, list[int]]:
    """Step of heading [rad] and scale, so that the patch's ends move by a few points, and how many the prior leaves each way."""
    step = 2.0 * _STEP_PX / (0.5 * max(grid.shape))
    sigmas = math.sqrt(float(prior.covariance[5, 5])), math.sqrt(float(prior.covariance[2, 2])) / height
    return step, [math.ceil(max(reach_sigma * sigma - 0.5 * step, 0.0) / step) for sigma in sigmas]


def _ellipse(covariance: Array, reach: int, sigma: float) -> Mask:
    """Shifts (2 reach + 1, 2 reach + 1) within so many standard deviations, and a point."""
    d = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1.0)] * 2), axis=-1)
    grown = sigma**2 * covariance + np.eye(2)
    inside: Mask = np.einsum("ijk,kl,ijl->ij", d, np.linalg.inv(grown), d) <= 1.0
    return inside


def _correlation(image: Float, template: Float, mask: Float) -> Float:
    """Coefficient (eq. 4.80) of the template's pixels under the mask with the image, at each shift."""
    count = float(mask.sum())
    t = mask * (template - float((mask * template).sum()) / count)
    product = cv2.matchTemplate(image, t, cv2.TM_CCORR)
    mean, square = (cv2.matchTemplate(x, mask, cv2.TM_CCORR) for x in (image, image * image))
    variance = np.maximum(square - mean * mean / count, 1e-6 * count)
    coefficient: Float = (product / np.sqrt(variance * float((t * t).sum()))).astype(np.float32)
    return coefficient


def _stands_out(
    scores: Float, inside: Mask, turns: list[tuple[float, float]], grid: Grid, ground: Array, prior: Prior
) -> Peak | NotRegistered:
    """The best of all positions and turns, and how far it stands out of the rest: (rho_1 - median) / (rho_2 - median)."""
    k, i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
    best, reach = float(scores[k, i, j]), len(inside) // 2
    if not best > 0.0:
        return NotRegistered("no_structure", "nothing in the map looks like the image")
    highest = scores.max(axis=0)
    rows, columns = np.indices(inside.shape)
    elsewhere = inside & (np.hypot(rows - i, columns - j) > _LOBE_PX)
    usual = float(np.median(highest[inside]))
    second = float(highest[elsewhere].max(initial=-1.0))
    ratio = (best - usual) / (second - usual) if second > usual and best > usual else math.inf if best > usual else 1.0
    yaw, scale = turns[int(k)]
    turned = grid.turned(yaw, scale)
    c, s = math.cos(yaw), math.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    arm = R @ (ground - prior.p_n) * scale
    to_n = turned.q * turned.axes
    shifted = grid.centre + to_n @ np.array([float(j) - reach, float(i) - reach])
    scatter = float(scores[k][elsewhere].std()) if elsewhere.any() else math.inf
    shape = _curvature(scores[k], int(i), int(j)) if _surrounded(inside, int(i), int(j)) else None
    shown, curvature = shifted, None
    if shape is not None:
        K, step = shape
        to_grid = np.linalg.inv(to_n)
        shown, curvature = shifted + to_n @ step, to_grid.T @ K @ to_grid
    return Peak(
        np.append(shifted, ground[2]) - arm, R @ prior.R_nb, ratio, best, best / scatter if scatter > 0.0 else 0.0, ground, shown,
        turned.q, curvature,
    )  # fmt: skip


def _surrounded(inside: Mask, i: int, j: int) -> bool:
    """Whether a position and its eight neighbours were searched."""
    return 0 < i < len(inside) - 1 and 0 < j < inside.shape[1] - 1 and bool(inside[i - 1 : i + 2, j - 1 : j + 2].all())


def _curvature(rho: Float, i: int, j: int) -> tuple[Array, Array] | None:
    """K = -d^2 rho / d(column, row)^2 (2, 2) at a summit, and the step (2,) to the parabola's top; None where there is none."""
    n = rho[i - 1 : i + 2, j - 1 : j + 2].astype(np.float64)
    slope = 0.5 * np.array([n[1, 2] - n[1, 0], n[2, 1] - n[0, 1]])
    twist = 0.25 * (n[2, 2] + n[0, 0] - n[0, 2] - n[2, 0])
    K = -np.array([[n[1, 2] + n[1, 0] - 2.0 * n[1, 1], twist], [twist, n[2, 1] + n[0, 1] - 2.0 * n[1, 1]]])
    if np.linalg.eigvalsh(K)[0] < 1e-3:
        return None
    step = np.linalg.solve(K, slope)
    return (K, step) if np.abs(step).max() <= 1.0 else None


def _blocks(
    rig: StereoRig, levels: tuple[Image, ...], pose: tuple[Array, Array], map_image: GroundImage, sizes: tuple[int, int, int]
) -> _Matched:
    """Blocks of the image, each shifted over the map; sizes: points along the image, of the search, to a block's side."""
    most, reach, side = sizes
    camera: Camera = (rig.left, *rig.camera_pose(*pose))
    grid = make_grid(camera, map_image, most)
    if grid is None:
        return _Matched.none()
    (view, seen), (ground, known) = camera_view(levels, camera, grid, map_image), map_view(map_image, grid, reach)
    template, image = structure(view), structure(ground)
    rows, columns = (range(n % side // 2, n - side + 1, side) for n in grid.shape)
    found, tried = [], 0
    for y, x in product(rows, columns):
        block, around = template[y : y + side, x : x + side], np.s_[y : y + side + 2 * reach, x : x + side + 2 * reach]
        if block.std() > _PLAIN and seen[y : y + side, x : x + side].all() and known[around].all():
            tried += 1
            if peak := _peak(image[around], block):
                found.append(((x + 0.5 * (side - 1), y + 0.5 * (side - 1)), peak[0] - reach, peak[1]))
    return (
        _Matched(_as_points(camera, grid, map_image, found), tried, grid.q, grid.q / grid.camera_m) if found else _Matched.none()
    )


def _peak(image: Float, block: Float) -> tuple[Array, Array] | None:
    """Where a block fits best (column, row), to a fraction of a pixel, covariance (2, 2); None where there is no single one."""
    rho = cv2.matchTemplate(image, block, cv2.TM_CCOEFF_NORMED)
    i, j = np.unravel_index(int(np.argmax(rho)), rho.shape)
    best = float(rho[i, j])
    if not (0 < i < len(rho) - 1 and 0 < j < len(rho) - 1) or best <= 0.0:
        return None
    shape = _curvature(np.asarray(rho, dtype=np.float32), int(i), int(j))
    if shape is None:
        return None
    K, step = shape
    noise = (1.0 - best**2) / best * _SAME_NOISE_PX / block.size
    return np.array([float(j), float(i)]) + step, noise * np.linalg.inv(K) + _FLOOR_PX**2 * np.eye(2)


def _as_points(
    camera: Camera, grid: Grid, map_image: GroundImage, found: list[tuple[tuple[float, float], Array, Array]]
) -> Points:
    """Blocks: their middles in the grid, shifts and covariances -> points of the map and pixels of the camera.

    R = J C J^T + (unevenness du/dd)^2: what stands on the ground leans over.
    """
    (model, p_nc, R_nc), (at, shift, covariance) = camera, map(np.array, zip(*found, strict=True))
    x_c = (map_image.points(grid.position(at)) - p_nc) @ R_nc
    by_n = model.project_jacobian(x_c) @ R_nc.T
    J = by_n[:, :, :2] @ grid.axes * grid.q
    lean = map_image.heights.unevenness_m * by_n[:, :, 2]
    R = J @ covariance @ J.transpose(0, 2, 1) + lean[:, :, None] * lean[:, None, :]
    return Points(map_image.points(grid.position(at + shift)), model.project(x_c), R)
