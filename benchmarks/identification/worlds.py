"""Worlds of look-alikes in numbers: objects of nearly one size, a map that lacks 30 % of them and holds 10 % that are gone, and
what a stereo rig 50 to 100 m above measures of them. No images.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from models import so3
from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark, LandmarkMap
from models.messages import Array
from models.prior import Prior
from vision.identify.catalogue import Sighting

SCALE_SIGMA: Final = 0.01  # relative, of all depths alike
_ATTITUDE_SIGMA_DEG: Final = (1.0, 1.0, 2.0)
UNMAPPED, GONE, MAP_SIGMA_M, HEIGHT_SIGMA_M, OUTLINE_SIGMA_M = 0.3, 0.1, 0.3, 0.2, 0.08
_FOUND, _BAD = 0.85, 0.03  # of the regions: segmented; measured badly
_SIDE_M, _SPACING_M, _APART_M = 400.0, 25.0, 14.0
_SIZES_M, _VARIATION, _HEIGHT_M = np.array([[8.0], [11.0]]), 0.1, 3.0
_DISPARITY_SIGMA_PX, _EDGE_SIGMA_PX, _CENTRE_SIGMA_PX, _TURN_SIGMA, _FILL_SIGMA = 0.15, 0.4, 0.3, math.radians(0.7), 0.01
_FOCAL_PX, _BASELINE_M, _SIZE_PX = 600.0, 0.5, np.array([640, 480])
_CAMERA = CameraModel(640, 480, _FOCAL_PX, _FOCAL_PX, 319.5, 239.5)
_DOWN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # camera looks down, its top is forward
RIG: Final = StereoRig(_CAMERA, _CAMERA, np.eye(3), np.array([-_BASELINE_M, 0.0, 0.0]), _DOWN, np.zeros(3))


@dataclass(frozen=True, slots=True)
class World:
    """Roof centres (N, 3), width and length (2, N), orientation (N,), ids: empty where the map does not have it."""

    position_n: Array
    sizes_m: Array
    orientation: Array
    ids: list[str]
    map: LandmarkMap


@dataclass(frozen=True, slots=True)
class Frame:
    """True position, the prior, regions, and the id of the object that each shows."""

    p_n: Array
    prior: Prior
    sightings: list[Sighting]
    truth: list[str]


def draw_world(rng: np.random.Generator, *, grid: bool) -> World:
    """Objects at random, none nearer than 14 m to another, or in a grid; and the map somebody made of them some time ago."""
    heading = rng.uniform(0.0, 2.0 * math.pi)
    position = _grid(rng, heading) if grid else _random(rng)
    count = len(position)
    sizes = _SIZES_M * rng.uniform(1.0 - _VARIATION, 1.0 + _VARIATION, (2, count))
    turn = rng.normal(heading, math.radians(1.0), count) if grid else rng.uniform(0.0, math.pi, count)
    position = np.column_stack([position, rng.normal(-_HEIGHT_M, 0.5, count)])
    mapped, stands = rng.random((2, count)) >= [[UNMAPPED], [GONE]]
    marks = [_landmark(rng, f"L{k}", position[k], sizes[:, k], turn[k]) for k in np.flatnonzero(mapped)]
    there = np.flatnonzero(~mapped | stands)
    ids = [f"L{k}" if mapped[k] else "" for k in there]
    return World(position[there], sizes[:, there], turn[there], ids, LandmarkMap.from_landmarks((30.0, 31.0, 0.0), marks))


def observe(rng: np.random.Generator, world: World, prior_sigma_m: float) -> Frame:
    """What is seen from somewhere above the world's middle, nearly level, and a prior that is off."""
    p_n = np.array([*rng.uniform(-0.25 * _SIDE_M, 0.25 * _SIDE_M, 2), -rng.uniform(50.0, 100.0)])
    roll, pitch = rng.normal(0.0, math.radians(4.0), 2)
    q_nb = so3.from_euler(roll, pitch, rng.uniform(-math.pi, math.pi))
    prior, error = draw_prior(rng, p_n, q_nb, prior_sigma_m)
    x_c = (world.position_n - p_n) @ so3.matrix(q_nb) @ RIG.R_bc
    px = x_c[:, :2] / x_c[:, 2:] * _FOCAL_PX + 0.5 * (_SIZE_PX - 1.0)
    reach = (0.5 * np.hypot(*world.sizes_m) / x_c[:, 2] * _FOCAL_PX)[:, None]
    whole = np.all((px > reach) & (px < _SIZE_PX - reach), axis=1) & (x_c[:, 2] > 0.0)
    found = np.flatnonzero(whole & (rng.random(len(x_c)) < _FOUND))
    scale, R_nc = rng.normal(0.0, SCALE_SIGMA), prior.R_nb @ RIG.R_bc
    seen = [_measure(rng, x_c[k], world.sizes_m[:, k], world.orientation[k] - error[5], scale, R_nc) for k in found]
    return Frame(p_n, prior, seen, [world.ids[k] for k in found])


def draw_prior(rng: np.random.Generator, p_n: Array, q_nb: Array, sigma_m: float) -> tuple[Prior, Array]:
    """A prior and its error (6,): truth = prior + error."""
    sigma = np.array([sigma_m] * 3 + [math.radians(a) for a in _ATTITUDE_SIGMA_DEG])
    error = rng.normal(0.0, sigma)
    return Prior(p_n - error[:3], so3.multiply(so3.quat_exp(-error[3:]), q_nb), np.diag(sigma**2)), error


def _measure(rng: np.random.Generator, x_c: Array, sizes: Array, turn: float, scale: float, R_nc: Array) -> Sighting:
    """A region as the stereo stage would measure it."""
    depth_sigma = float(x_c[2]) * _DISPARITY_SIGMA_PX / (_FOCAL_PX * _BASELINE_M)
    pixel_m = float(x_c[2]) / _FOCAL_PX
    size_sigma = _EDGE_SIGMA_PX * pixel_m / sizes
    bad = rng.random() < _BAD
    factor = math.exp(-scale + rng.normal(0.0, depth_sigma))
    shift = rng.normal(0.0, 0.3 * sizes[1] if bad else _CENTRE_SIGMA_PX * pixel_m, 3) * [1.0, 1.0, 0.0]
    logs = rng.normal(0.0, size_sigma) + (rng.normal(0.0, 0.25, 2) if bad else 0.0)
    w, h = (sizes * factor * np.exp(logs)).tolist()
    fill = min(1.0, 0.99 + rng.normal(0.0, 0.01)) * (rng.uniform(0.7, 1.0) if bad else 1.0)
    turn += rng.normal(0.0, math.radians(20.0) if bad else _TURN_SIGMA) + (0.5 * math.pi if w > h else 0.0)
    return Sighting(
        arm_n=R_nc @ ((x_c + shift) * factor), depth_sigma=depth_sigma,
        covariance_n=(_CENTRE_SIGMA_PX * pixel_m) ** 2 * np.eye(3),
        size_m2=w * h * fill, width_m=min(w, h), length_m=max(w, h), fill_ratio=fill,
        log_size_covariance=np.diag(size_sigma**2), fill_ratio_sigma=_FILL_SIGMA,
        orientation_rad=turn % math.pi, orientation_sigma_rad=_TURN_SIGMA,
    )  # fmt: skip


def _landmark(rng: np.random.Generator, name: str, position: Array, sizes: Array, turn: float) -> Landmark:
    w, h = 0.5 * sizes + rng.normal(0.0, OUTLINE_SIGMA_M)
    c, s = math.cos(turn), math.sin(turn)
    outline = np.array([[h, w], [-h, w], [-h, -w], [h, -w]]) @ np.array([[c, s], [-s, c]])
    centre, base = position[:2] + rng.normal(0.0, MAP_SIGMA_M, 2), position[2] + _HEIGHT_M + rng.normal(0.0, HEIGHT_SIGMA_M)
    return Landmark.of(name, outline + centre, base, _HEIGHT_M, None, MAP_SIGMA_M, HEIGHT_SIGMA_M, OUTLINE_SIGMA_M)


def _grid(rng: np.random.Generator, heading: float) -> Array:
    k = np.arange(-0.5 * _SIDE_M, 0.5 * _SIDE_M + 1.0, _SPACING_M)
    n, e = (axis.ravel() for axis in np.meshgrid(k, k))
    c, s = math.cos(heading), math.sin(heading)
    return np.column_stack([c * n - s * e, s * n + c * e]) + rng.normal(0.0, 0.3, (len(n), 2))


def _random(rng: np.random.Generator) -> Array:
    """As dense as the grid."""
    position = np.empty((0, 2))
    while len(position) < round((_SIDE_M / _SPACING_M) ** 2):
        p = rng.uniform(-0.5 * _SIDE_M, 0.5 * _SIDE_M, 2)
        if not len(position) or np.hypot(*(position - p).T).min() > _APART_M:
            position = np.vstack([position, p])
    return position
