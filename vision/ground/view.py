"""The ground from straight above on a grid.

position(i, j) = centre + q E ((j, i) - middle),   E = (e_1, e_2): along the camera's rows on the ground, and across
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.camera import CameraModel
from models.messages import Array
from vision.ground.image import Float, GroundImage, sample, sample_affine
from vision.image.rectify import Image

Mask = NDArray[np.bool_]
Camera = tuple[CameraModel, Array, Array]  # p_nc, R_nc
_FARTHEST = 3.0  # times the nearest point's distance: what lies beyond is too flat to be compared
_STEEPEST = 0.05  # least sine of a ray below the horizon
_RASTER = (13, 9)  # rays that find the footprint
_BORDER_PX = 1.0  # of the camera's image that stays out
_LEAST = 8  # points of a grid, each way


@dataclass(frozen=True, slots=True)
class Grid:
    """centre (2,) north, east; axes (2, 2) with columns e_1, e_2; q [m] between neighbours; camera_m: its pixel."""

    centre: Array
    axes: Array
    q: float
    shape: tuple[int, int]
    camera_m: float

    def position(self, at: Array) -> Array:
        """Positions (N, 2) of grid coordinates (N, 2) column, row."""
        middle = 0.5 * (np.array(self.shape[::-1]) - 1.0)
        position: Array = self.centre + self.q * (at - middle) @ self.axes.T
        return position

    def positions(self, margin: int = 0) -> Array:
        """North and east [m] of the points, `margin` more on each side: (h + 2 margin, w + 2 margin, 2)."""
        rows, columns = (self.q * (np.arange(-margin, n + margin) - 0.5 * (n - 1.0)) for n in self.shape)
        positions: Array = self.centre + (columns[:, None] * self.axes[:, 0] + rows[:, None, None] * self.axes[:, 1])
        return positions

    def turned(self, yaw: float, scale: float) -> "Grid":
        """Turned from north to east and stretched, about its centre."""
        c, s = np.cos(yaw), np.sin(yaw)
        return Grid(self.centre, np.array([[c, -s], [s, c]]) @ self.axes, self.q * scale, self.shape, self.camera_m)


def make_grid(camera: Camera, map_image: GroundImage, most: int, finest_m: float = 0.0) -> Grid | None:
    """A grid over the camera's view, `most` points long at most; None: sky."""
    model, _, R_nc = camera
    positions = _footprint(camera, map_image)
    right = R_nc[:2, 0]
    if positions is None or np.linalg.norm(right) < _STEEPEST:
        return None
    e = right / np.linalg.norm(right)
    axes = np.array([[e[0], -e[1]], [e[1], e[0]]])
    along = positions @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    size = high - low
    camera_m = float(np.sqrt(size[0] * size[1] / (model.width * model.height)))
    q = max(float(size.max()) / most, camera_m, map_image.pixel_m, finest_m)
    columns, rows = np.maximum(size / q, _LEAST).astype(int).tolist()
    return Grid(axes @ (0.5 * (low + high)), axes, q, (rows, columns), camera_m)


def _footprint(camera: Camera, map_image: GroundImage) -> Array | None:
    model, p_nc, R_nc = camera
    u, v = np.meshgrid(*(np.linspace(0.0, size - 1.0, n) for size, n in zip((model.width, model.height), _RASTER, strict=True)))
    rays = model.ray(np.column_stack((u.ravel(), v.ravel()))) @ R_nc.T
    rays = rays[rays[:, 2] > _STEEPEST]
    ground = float(map_image.heights.at(p_nc[None, :2])[0])
    positions = None
    for _ in range(3):  # the ground's height where it is seen
        if len(rays) < _RASTER[0] or not ground - p_nc[2] > 0.0:
            return None
        reach = (ground - p_nc[2]) / rays[:, 2]
        near = reach < _FARTHEST * reach.min()
        positions = p_nc[:2] + rays[near, :2] * reach[near, None]
        ground = float(np.mean(map_image.heights.at(positions)))
    return positions


def camera_view(levels: tuple[Image, ...], camera: Camera, grid: Grid, map_image: GroundImage) -> tuple[Float, Mask]:
    """Grey values (h, w) of the camera's pyramid, and where it shows ground."""
    model, p_nc, R_nc = camera
    px = model.project((map_image.points(grid.positions().reshape(-1, 2)) - p_nc) @ R_nc)
    values = sample(levels, px.reshape(*grid.shape, 2), grid.q / grid.camera_m)
    return values, model.contains(px, _BORDER_PX).reshape(grid.shape)


def map_view(map_image: GroundImage, grid: Grid, margin: int) -> Float:
    """Grey values of the map's image on the grid plus margin."""
    first, *neighbours = map_image.to_pixels(grid.position(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) - margin))
    affine = np.column_stack((*(one - first for one in neighbours), first))
    height, width = (n + 2 * margin for n in grid.shape)
    return sample_affine(map_image.pyramid, affine, (height, width), grid.q / map_image.pixel_m)


def map_known(map_image: GroundImage, grid: Grid, margin: int) -> Mask:
    """Where the map's image shows the grid plus margin."""
    positions = grid.positions(margin)
    if map_image.contains(positions[[0, 0, -1, -1], [0, -1, 0, -1]]).all():
        return np.ones(positions.shape[:2], dtype=np.bool_)
    return map_image.contains(positions.reshape(-1, 2)).reshape(positions.shape[:2])
