"""Images of a World; the same seed gives the same bytes on one machine."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from models.camera import CameraModel, StereoRig
from models.messages import Array
from vision.synthetic.camera_effects import Conditions, Image, expose
from vision.synthetic.coverage import Grid
from vision.synthetic.faces import View, visible_faces
from vision.synthetic.ground import DETAIL_SIZE, DETAIL_TEXEL_M
from vision.synthetic.shading import NOTHING, Labels, paint_ground, paint_solids
from vision.synthetic.shadows import cast, shadow_polygons
from vision.synthetic.texture import surfaces
from vision.synthetic.world import World

_GRID_PX = 8  # rays are exact on this grid and linear between: below 0.005 px for a mild lens
_PIECE_PX = 8.0  # longest straight piece of a bent edge
_MARGIN_PX = 3.0  # beyond the image, where polygons are cut


@dataclass(frozen=True)
class Lens:
    """Rays (h, w, 2) = (x/z, y/z), squared radius (h, w), 1 in the farthest corner."""

    rays: Grid
    radius2: Grid
    limits: Array
    piece: float


@lru_cache(maxsize=8)
def lens(camera: CameraModel) -> Lens:
    """Undistorted rays of every pixel, once a camera. Raises ValueError for a folding distortion."""
    u, v = _knots(camera.width), _knots(camera.height)
    plane = camera.undistort(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)).reshape(len(v), len(u), 2)
    if not np.isfinite(plane).all():
        raise ValueError("camera: its distortion cannot be undone everywhere in the image")
    across, down = _hats(u, camera.width), _hats(v, camera.height)
    rays = np.stack([down @ plane[:, :, i] @ across.T for i in range(2)], axis=-1).astype(np.float32)
    offset_u, offset_v = np.arange(camera.width) - camera.cx, np.arange(camera.height) - camera.cy
    radius2 = (offset_v**2)[:, None] + (offset_u**2)[None, :]
    least, most = plane.min(axis=(0, 1)), plane.max(axis=(0, 1))
    margin = _MARGIN_PX / np.array([camera.fx, camera.fy])
    limits = np.array([least[0] - margin[0], most[0] + margin[0], least[1] - margin[1], most[1] + margin[1]])
    piece = _PIECE_PX / max(camera.fx, camera.fy) if any(camera.distortion) else math.inf
    return Lens(np.ascontiguousarray(rays), (radius2 / radius2.max()).astype(np.float32), limits, piece)


def render(
    world: World, camera: CameraModel, p_nc: Array, R_nc: Array, conditions: Conditions, rng: np.random.Generator
) -> Image:
    """What a camera at p_nc (3,) with axes R_nc (3, 3) sees: (h, w, 3) BGR."""
    light, _ = _light(world, camera, p_nc, R_nc, conditions)
    return expose(light, conditions, lens(camera).radius2, rng)


def render_pair(
    world: World, rig: StereoRig, p_n: Array, R_nb: Array, conditions: Conditions, rng: np.random.Generator
) -> tuple[Image, Image]:
    """Left and right image of a rig on a body at p_n with axes R_nb."""
    left = render(world, rig.left, *rig.camera_pose(p_n, R_nb), conditions, rng)
    return left, render(world, rig.right, *rig.right_camera_pose(p_n, R_nb), conditions, rng)


def render_labels(world: World, camera: CameraModel, p_nc: Array, R_nc: Array) -> Labels:
    """Solid that fills most of each pixel (h, w): landmarks, then clutter; -1: ground."""
    return _light(world, camera, p_nc, R_nc, Conditions())[1]


def _light(world: World, camera: CameraModel, p_nc: Array, R_nc: Array, conditions: Conditions) -> tuple[Grid, Labels]:
    through_lens, sun, ground = lens(camera), world.sun, world.ground
    size = camera.height, camera.width
    p_nc, R_nc = np.ascontiguousarray(p_nc, dtype=np.float64), np.ascontiguousarray(R_nc, dtype=np.float64)
    image, through = np.zeros((*size, 3), dtype=np.float32), np.ones(size, dtype=np.float32)
    labels, shadow = np.full(size, NOTHING, dtype=np.int32), np.zeros(size, dtype=np.float32)
    view = View(p_nc, R_nc, through_lens.limits, through_lens.piece)
    haze = np.array([conditions.haze_per_m, *conditions.haze_bgr])
    focal = math.sqrt(camera.fx * camera.fy)
    rays, shadow_light = through_lens.rays, sun.shadow
    if world.solids:
        points, polygons, groups = shadow_polygons(world.columns, view, sun, ground.down_m)
        cast(shadow, camera.project(points), polygons, groups)
        f = visible_faces(world.columns, view, sun.direction_n, sun.ambient)
        paint_solids(
            image, through, labels, shadow, shadow_light, rays, camera.project(f.vertices), f.offsets, f.solids, f.solid_offsets,
            f.H, f.colour, f.texture, f.parameters, surfaces(), focal, haze,
        )  # fmt: skip
    H, reach = _to_ground(world, p_nc, R_nc)
    paint_ground(
        image, through, shadow, shadow_light, rays, H, reach, ground.cover, ground.cover_size, ground.cover_texel_m,
        ground.detail, DETAIL_SIZE, DETAIL_TEXEL_M, np.array(ground.tint_bgr), ground.detail_contrast, focal, haze,
    )  # fmt: skip
    return image, labels


def _to_ground(world: World, p_nc: Array, R_nc: Array) -> tuple[Array, float]:
    ground, (along, across) = world.ground, world.ground.axes_n
    reach, down = ground.down_m - float(p_nc[2]), np.array([0.0, 0.0, 1.0])
    s, t = along @ p_nc + ground.shift_m[0], across @ p_nc + ground.shift_m[1]
    rows = np.stack([s * down + reach * along, t * down + reach * across, down])
    return np.ascontiguousarray(rows @ R_nc), reach


def _knots(size: int) -> Array:
    return np.linspace(-0.5, size - 0.5, math.ceil(size / _GRID_PX) + 1)


def _hats(knots: Array, size: int) -> Array:
    position = (np.arange(size) - knots[0]) / (knots[1] - knots[0])
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(len(knots))[None, :])))
