"""Search for the image's structure on the map within the prior: position, heading, height.

    the camera's image as seen from straight above, by the prior's attitude and height, is shifted over the map within
    reach_sigma of the prior's covariance, turned and stretched as far as that leaves heading and height open

Sobel magnitudes (thesis eq. 4.62-4.64), compared by correlation (eq. 4.80).
"""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated

import cv2
import msgspec
import numpy as np
from msgspec import Meta

from models.camera import StereoRig
from models.messages import Array
from models.prior import Prior
from vision.describe.correspond import sobel
from vision.ground.image import Float, GroundImage
from vision.ground.orientation import coefficient, directions
from vision.ground.ridge import LOBE_PX, Ridge, find_line, where_evidence_is
from vision.ground.view import Camera, Grid, Mask, camera_view, make_grid, map_known, map_view
from vision.image.rectify import Image

BLUR_PX = 1.0
_AROUND_PX = 15  # over which the contrast is made even
_FAINT = 24.0  # Sobel magnitude (8 grey levels per 3 px) of what is noise rather than structure
PLAIN = 0.08  # standard deviation of a part's structure below which it has none
_STEP_PX = 2.0  # at the patch's end, half a step of heading and scale


class RegistrationConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Range and resolution of the search, and acceptance."""

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
    ridge_ratio: Annotated[float, Meta(gt=1, description="height of a line of positions over all others: known across it")] = 1.6


@dataclass(frozen=True, slots=True)
class Peak:
    """Best position: p_n, R_nb; ratio: first to second peak; correlation: its coefficient.

    deviations: in sigmas of other positions; seen_n (3,): middle of the view by the prior, shown_n (2,): by the map; q: point
    spacing, m; curvature (2, 2): -d^2 rho / d(north, east)^2 [1/m^2], or None; oriented: coefficient of edge directions.
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
    oriented: float = 0.0
    ridge: Ridge | None = None


@dataclass(frozen=True, slots=True)
class NotRegistered:
    """no_ground | outside | prior_too_wide | no_structure | not_found | no_pose; peak: if any."""

    reason: str
    detail: str = ""
    peak: Peak | None = None


def structure(view: Float) -> Float:
    """Root of Sobel's magnitude over its local mean."""
    magnitude = sobel(cv2.GaussianBlur(view, (0, 0), BLUR_PX))
    even: Float = np.sqrt(magnitude / (cv2.blur(magnitude, (_AROUND_PX, _AROUND_PX)) + np.float32(_FAINT)))
    return even


def shift_of_ground(arm_n: Array) -> Array:
    """dg = J (dp, dtheta), J (2, 6): motion of a ray's ground point; arm_n (3,): to it.

    dg = dp + dtheta x r - r (dp + dtheta x r)_d / r_d
    """
    x, y, z = arm_n
    moved = np.array([[1.0, 0.0, 0.0, 0.0, z, -y], [0.0, 1.0, 0.0, -z, 0.0, x], [0.0, 0.0, 1.0, y, -x, 0.0]])
    J: Array = moved[:2] - np.outer(arm_n[:2] / z, moved[2])
    return J


def search(
    rig: StereoRig, levels: tuple[Image, ...], prior: Prior, map_image: GroundImage, config: RegistrationConfig
) -> Peak | NotRegistered:
    """Position, heading, height of the best correlation with the map."""
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
        return NotRegistered(
            "prior_too_wide",
            f"{reach * grid.q:.0f} m each way ({config.coarse * grid.q:.0f} would do), {number} headings and heights "
            f"({config.most_turns} would do)",
        )
    yaws, scales = (step * np.arange(-n, n + 1.0) for n in counts)
    turns = [(float(yaw), 1.0 + float(scale)) for yaw, scale in product(yaws, scales) if scale > -0.5]
    view, seen = camera_view(levels, camera, grid, map_image)
    mask = cv2.erode(seen.astype(np.float32), np.ones((5, 5)), borderValue=1.0).astype(np.float32)
    known = map_known(map_image, grid, reach)
    if mask.mean() < 0.2 or known.mean() < 0.5:
        return NotRegistered("outside", f"the map's image shows {known.mean():.0%} of that the camera may see")
    template = structure(view)
    if not template[mask > 0.0].std() > PLAIN:
        return NotRegistered("no_structure", "the image shows nothing that could be compared")
    extent = config.reach_sigma**2 * covariance + np.eye(2)
    inside = _ellipse(extent, reach)
    scores = np.stack([_correlation(structure(map_view(map_image, grid.turned(*t), reach)), template, mask) for t in turns])
    searched = _Searched(np.where(inside, scores, np.float32(-1.0)), inside, extent, turns, grid)
    peak = _stands_out(searched, ground, prior)
    if isinstance(peak, NotRegistered):
        return peak
    return _with_evidence(peak, searched, (view, template, mask), map_image, config.ridge_ratio)


@dataclass(frozen=True, slots=True)
class _Searched:
    """scores (turns, 2 reach + 1, 2 reach + 1), -1 outside d^T extent^-1 d <= 1."""

    scores: Float
    inside: Mask
    extent: Array
    turns: list[tuple[float, float]]
    grid: Grid

    @property
    def best(self) -> tuple[int, int, int]:
        k, i, j = np.unravel_index(int(np.argmax(self.scores)), self.scores.shape)
        return int(k), int(i), int(j)


def _turns(grid: Grid, prior: Prior, height: float, reach_sigma: float) -> tuple[float, list[int]]:
    step = 2.0 * _STEP_PX / (0.5 * max(grid.shape))
    sigmas = math.sqrt(float(prior.covariance[5, 5])), math.sqrt(float(prior.covariance[2, 2])) / height
    return step, [math.ceil(max(reach_sigma * sigma - 0.5 * step, 0.0) / step) for sigma in sigmas]


def _ellipse(extent: Array, reach: int) -> Mask:
    d = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1.0)] * 2), axis=-1)
    inside: Mask = np.einsum("ijk,kl,ijl->ij", d, np.linalg.inv(extent), d) <= 1.0
    return inside


def _correlation(image: Float, template: Float, mask: Float) -> Float:
    count = float(mask.sum())
    t = mask * (template - float((mask * template).sum()) / count)
    product = cv2.matchTemplate(image, t, cv2.TM_CCORR)
    mean, square = (cv2.matchTemplate(x, mask, cv2.TM_CCORR) for x in (image, image * image))
    variance = np.maximum(square - mean * mean / count, 1e-6 * count)
    coefficient: Float = (product / np.sqrt(variance * float((t * t).sum()))).astype(np.float32)
    return coefficient


def _with_evidence(
    peak: Peak, searched: _Searched, seen: tuple[Float, Float, Float], map_image: GroundImage, ratio: float
) -> Peak:
    (k, i, j), reach, grid = searched.best, len(searched.inside) // 2, searched.grid
    turned, (height, width) = grid.turned(*searched.turns[k]), grid.shape
    ground = map_view(map_image, turned, reach)
    image, (view, template, mask) = structure(ground), seen
    line = find_line(searched.scores, searched.inside, searched.extent, ratio)
    same = coefficient(directions(ground, image), directions(view, template), mask, (i, j))
    if line is None:
        return replace(peak, oriented=same)
    at = where_evidence_is(template, image[i : i + height, j : j + width], mask)
    seen_n = map_image.points(grid.position(at[None]))[0]
    shown_n = turned.position((at + (j - reach, i - reach) + line.offset * line.normal)[None])[0]
    ridge = Ridge(turned.axes @ line.normal, seen_n, shown_n, line.sigma * turned.q, line.ratio, line.deviations)
    return replace(peak, oriented=same, ridge=ridge)


def _stands_out(searched: _Searched, ground: Array, prior: Prior) -> Peak | NotRegistered:
    """(rho_1 - median) / (rho_2 - median)."""
    scores, inside, grid, (k, i, j) = searched.scores, searched.inside, searched.grid, searched.best
    best, reach = float(scores[k, i, j]), len(inside) // 2
    if not best > 0.0:
        return NotRegistered("no_structure", "nothing in the map looks like the image")
    highest = scores.max(axis=0)
    rows, columns = np.indices(inside.shape)
    elsewhere = inside & (np.hypot(rows - i, columns - j) > LOBE_PX)
    usual = float(np.median(highest[inside]))
    second = float(highest[elsewhere].max(initial=-1.0))
    ratio = (best - usual) / (second - usual) if second > usual and best > usual else math.inf if best > usual else 1.0
    yaw, scale = searched.turns[k]
    turned = grid.turned(yaw, scale)
    c, s = math.cos(yaw), math.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    arm = R @ (ground - prior.p_n) * scale
    to_n = turned.q * turned.axes
    shifted = grid.centre + to_n @ np.array([float(j) - reach, float(i) - reach])
    scatter = float(scores[k][elsewhere].std()) if elsewhere.any() else math.inf
    shape = curvature_at(scores[k], i, j) if _surrounded(inside, i, j) else None
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
    return 0 < i < len(inside) - 1 and 0 < j < inside.shape[1] - 1 and bool(inside[i - 1 : i + 2, j - 1 : j + 2].all())


def curvature_at(rho: Float, i: int, j: int) -> tuple[Array, Array] | None:
    """K = -d^2 rho / d(column, row)^2 (2, 2), and step (2,) to the top, or None."""
    n = rho[i - 1 : i + 2, j - 1 : j + 2].astype(np.float64)
    slope = 0.5 * np.array([n[1, 2] - n[1, 0], n[2, 1] - n[0, 1]])
    twist = 0.25 * (n[2, 2] + n[0, 0] - n[0, 2] - n[2, 0])
    K = -np.array([[n[1, 2] + n[1, 0] - 2.0 * n[1, 1], twist], [twist, n[2, 1] + n[0, 1] - 2.0 * n[1, 1]]])
    if np.linalg.eigvalsh(K)[0] < 1e-3:
        return None
    step = np.linalg.solve(K, slope)
    return (K, step) if np.abs(step).max() <= 1.0 else None
