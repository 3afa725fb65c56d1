"""Worlds of look-alikes, in numbers: objects of nearly one size, a map that lacks some and holds some that are gone, and what a
stereo rig measures of them. No images: thousands of frames a minute.
"""

import math
from dataclasses import dataclass

import msgspec
import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from vision.identify.catalogue import Sighting

SIDE_M, SPACING_M = 400.0, 25.0
WIDTH_M, LENGTH_M, HEIGHT_M = 8.0, 11.0, 3.0
MAP_SIGMA_M, HEIGHT_SIGMA_M, OUTLINE_SIGMA_M = 0.3, 0.2, 0.08
SCALE_SIGMA, DISPARITY_SIGMA_PX, EDGE_SIGMA_PX = 0.01, 0.15, 0.4
ATTITUDE_SIGMA_DEG = (1.0, 1.0, 2.0)

FOCAL_PX, BASELINE_M = 600.0, 0.5
_CAMERA = CameraModel(640, 480, FOCAL_PX, FOCAL_PX, 319.5, 239.5)
_DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # camera looks down, its top is forward
RIG = StereoRig(_CAMERA, _CAMERA, np.eye(3), np.array([-BASELINE_M, 0.0, 0.0]), _DOWN, np.zeros(3))


class Conditions(msgspec.Struct, frozen=True):
    """One kind of world.

    variation: of width and length, +-; unmapped, gone, found, bad: as in vision's Assumptions; replaced: of the gone, an
    unmapped object stands in the very place; claim: true errors over those claimed; scale_sigma: relative, of all depths
    alike; disparity_sigma_px: of each region.
    """

    layout: str = "random"  # or grid; both have one object in 25 x 25 m
    prior_sigma_m: float = 10.0
    variation: float = 0.1
    unmapped: float = 0.3
    gone: float = 0.1
    replaced: float = 0.0
    found: float = 0.85
    bad: float = 0.03
    claim: float = 1.0
    scale_sigma: float = SCALE_SIGMA
    disparity_sigma_px: float = DISPARITY_SIGMA_PX
    height_m: tuple[float, float] = (50.0, 100.0)


@dataclass(frozen=True, slots=True)
class Objects:
    """What stands in the world: place (N, 3) of the roof's centre in n, width, length, orientation (N,), mapped (N,) or -1."""

    position_n: Array
    width_m: Array
    length_m: Array
    orientation: Array
    ids: list[str]


@dataclass(frozen=True, slots=True)
class World:
    """Objects and the (wrong in places) map of them; an object's id is empty where the map does not have it."""

    objects: Objects
    map: LandmarkMap


@dataclass(frozen=True, slots=True)
class Frame:
    """One image pair: true place and attitude, the prior, what was seen and the id of the object each sighting shows."""

    p_n: Array
    prior: Prior
    sightings: list[Sighting]
    truth: list[str]
    scale_sigma: float


def draw_world(rng: np.random.Generator, c: Conditions) -> World:
    """Objects, and the map somebody made of them some time ago."""
    heading = rng.uniform(0.0, 2.0 * math.pi)
    position = _grid(rng, heading) if c.layout == "grid" else _random(rng)
    count = len(position)
    width, length = (size * rng.uniform(1.0 - c.variation, 1.0 + c.variation, count) for size in (WIDTH_M, LENGTH_M))
    turn = rng.normal(heading, math.radians(1.0), count) if c.layout == "grid" else rng.uniform(0.0, math.pi, count)
    position = np.column_stack([position, rng.normal(-HEIGHT_M, 0.5, count)])
    mapped = rng.random(count) >= c.unmapped
    gone = mapped & (rng.random(count) < c.gone)
    there = ~gone | (rng.random(count) < c.replaced)
    landmarks = [_landmark(rng, f"L{k}", position[k], width[k], length[k], turn[k]) for k in np.flatnonzero(mapped)]
    width[gone], length[gone] = (
        size * rng.uniform(1.0 - c.variation, 1.0 + c.variation, gone.sum()) for size in (WIDTH_M, LENGTH_M)
    )
    ids = [f"L{k}" if mapped[k] and not gone[k] else "" for k in np.flatnonzero(there)]
    objects = Objects(position[there], width[there], length[there], turn[there], ids)
    return World(objects, LandmarkMap.from_landmarks((30.0, 31.0, 0.0), landmarks))


def draw_pose(rng: np.random.Generator, c: Conditions) -> tuple[Array, Array]:
    """p_n, q_nb near the middle of the world, nearly level."""
    p_n = np.array([*rng.uniform(-0.25 * SIDE_M, 0.25 * SIDE_M, 2), -rng.uniform(*c.height_m)])
    roll, pitch = rng.normal(0.0, math.radians(4.0), 2)
    return p_n, so3.from_euler(roll, pitch, rng.uniform(-math.pi, math.pi))


def draw_error(rng: np.random.Generator, c: Conditions) -> Array:
    """Error of a prior (6,): truth = prior + error."""
    return rng.normal(0.0, c.claim * _sigmas(c.prior_sigma_m))


def observe(rng: np.random.Generator, world: World, p_n: Array, q_nb: Array, error: Array, c: Conditions) -> Frame:
    """What is seen from a pose whose prior is wrong by `error`."""
    q_prior = so3.multiply(so3.quat_exp(-error[3:]), q_nb)
    prior = Prior(p_n - error[:3], q_prior, np.diag(_sigmas(c.prior_sigma_m) ** 2))
    o, R_nc = world.objects, so3.matrix(q_nb) @ RIG.R_bc
    x_c = (o.position_n - p_n) @ R_nc
    scale = rng.normal(0.0, c.claim * c.scale_sigma)
    radius = 0.5 * np.hypot(o.width_m, o.length_m)
    px = x_c[:, :2] / x_c[:, 2:] * FOCAL_PX + [319.5, 239.5]
    reach = (radius / x_c[:, 2] * FOCAL_PX)[:, None]
    whole = np.all((px > reach) & (px < [640, 480] - reach), axis=1) & (x_c[:, 2] > 0.0)
    seen, truth = [], []
    for k in np.flatnonzero(whole & (rng.random(len(radius)) < c.found)):
        turn = o.orientation[k] - error[5]
        seen.append(_measure(rng, x_c[k], o.width_m[k], o.length_m[k], turn, scale, prior.R_nb @ RIG.R_bc, c))
        truth.append(o.ids[k])
    return Frame(p_n, prior, seen, truth, c.scale_sigma)


def _sigmas(prior_sigma_m: float) -> Array:
    return np.array([prior_sigma_m] * 3 + [math.radians(a) for a in ATTITUDE_SIGMA_DEG])


def _measure(
    rng: np.random.Generator, x_c: Array, width: float, length: float, turn: float, scale: float, R_nc: Array, c: Conditions
) -> Sighting:
    """A region as the stereo stage would measure it; claimed sigmas are those drawn from, times 1 / claim."""
    depth_sigma = x_c[2] * c.disparity_sigma_px / (FOCAL_PX * BASELINE_M)
    pixel_m = x_c[2] / FOCAL_PX
    size_sigma = EDGE_SIGMA_PX * pixel_m / np.array([width, length])
    bad = rng.random() < c.bad
    factor = math.exp(-scale + rng.normal(0.0, c.claim * depth_sigma))
    shift = rng.normal(0.0, 0.3 * length if bad else c.claim * 0.3 * pixel_m, 3) * [1.0, 1.0, 0.0]
    logs = rng.normal(0.0, c.claim * size_sigma) + (rng.normal(0.0, 0.25, 2) if bad else 0.0)
    w, h = np.array([width, length]) * factor * np.exp(logs)
    fill = min(1.0, 0.99 + rng.normal(0.0, 0.01)) * (rng.uniform(0.7, 1.0) if bad else 1.0)
    turn += rng.normal(0.0, math.radians(20.0 if bad else 0.7)) + (0.5 * math.pi if w > h else 0.0)
    return Sighting(
        arm_n=R_nc @ ((x_c + shift) * factor),
        depth_sigma=depth_sigma,
        covariance_n=(0.3 * pixel_m) ** 2 * np.eye(3),
        size_m2=w * h * fill,
        width_m=min(w, h),
        length_m=max(w, h),
        fill_ratio=fill,
        log_size_covariance=np.diag(size_sigma**2),
        fill_ratio_sigma=0.01,
        orientation_rad=turn % math.pi,
        orientation_sigma_rad=math.radians(0.7),
    )


def _landmark(rng: np.random.Generator, name: str, position: Array, width: float, length: float, turn: float) -> Landmark:
    grown = 2.0 * rng.normal(0.0, OUTLINE_SIGMA_M)
    w, h = 0.5 * (width + grown), 0.5 * (length + grown)
    c, s = math.cos(turn), math.sin(turn)
    corners = np.array([[h, w], [-h, w], [-h, -w], [h, -w]]) @ np.array([[c, s], [-s, c]])
    centre = position[:2] + rng.normal(0.0, MAP_SIGMA_M, 2)
    base = position[2] + HEIGHT_M + rng.normal(0.0, HEIGHT_SIGMA_M)
    return Landmark.of(
        name, corners + centre, base, HEIGHT_M, None, MAP_SIGMA_M, HEIGHT_SIGMA_M, OUTLINE_SIGMA_M,
    )  # fmt: skip


def _grid(rng: np.random.Generator, heading: float) -> Array:
    k = np.arange(-0.5 * SIDE_M, 0.5 * SIDE_M + 1.0, SPACING_M)
    n, e = (axis.ravel() for axis in np.meshgrid(k, k))
    c, s = math.cos(heading), math.sin(heading)
    return np.column_stack([c * n - s * e, s * n + c * e]) + rng.normal(0.0, 0.3, (len(n), 2))


def _random(rng: np.random.Generator) -> Array:
    """As dense as the grid, none closer than 14 m to another."""
    wanted, position = round((SIDE_M / SPACING_M) ** 2), np.empty((0, 2))
    while len(position) < wanted:
        p = rng.uniform(-0.5 * SIDE_M, 0.5 * SIDE_M, 2)
        if not len(position) or np.hypot(*(position - p).T).min() > 14.0:
            position = np.vstack([position, p])
    return position
