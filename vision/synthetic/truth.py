"""Visible parts of each landmark in an image, computed from the prisms, independent of the renderer."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.camera import CameraModel
from models.messages import Array
from vision.synthetic.faces import Indices
from vision.synthetic.world import World

Mask = NDArray[np.bool_]

_STEP_PX = 1.0  # between the points of an edge that are asked for
_BEFORE = 1.0 - 1e-6  # a line of sight ends just before the point, so that its own face does not hide it


@dataclass(frozen=True)
class Stretch:
    """A visible stretch of the roof edge from corner `edge`: shares 0..1, pixels (N, 2)."""

    edge: int
    start: float
    end: float
    px: Array


@dataclass(frozen=True)
class LandmarkView:
    """One landmark in one image.

    corners_px: roof (K, 2), NaN behind the camera; corners_visible, sides_visible (K,); occluded: hidden share of the roof's edge
    in the image; cut: by the border.
    """

    id: str
    corners_px: Array
    corners_visible: Mask
    stretches: tuple[Stretch, ...]
    sides_visible: Mask
    occluded: float
    cut: bool


def landmark_views(world: World, camera: CameraModel, p_nc: Array, R_nc: Array) -> list[LandmarkView]:
    """The landmarks of which any roof edge or side is to be seen."""
    found = []
    for index in range(len(world.landmarks)):
        if _may_be_seen(world, index, camera, p_nc, R_nc):
            landmark_view = _landmark_view(world, index, camera, p_nc, R_nc)
            if landmark_view.stretches or landmark_view.sides_visible.any():
                found.append(landmark_view)
    return found


def _may_be_seen(world: World, index: int, camera: CameraModel, p_nc: Array, R_nc: Array) -> bool:
    mark = world.landmarks[index]
    radius = math.hypot(float(world.columns.radius_m[index]), 0.5 * mark.height_m)
    x_c = R_nc.T @ (np.array([*world.columns.centre_n[index], mark.base_d - 0.5 * mark.height_m]) - p_nc)
    size = np.array([camera.width, camera.height]) - 1.0
    corners = camera.ray(np.array([[0.0, 0.0], [size[0], 0.0], size, [0.0, size[1]]]))
    cone, far = math.acos(float(corners[:, 2].min())), float(np.linalg.norm(x_c))
    return far <= radius or math.acos(max(-1.0, min(1.0, float(x_c[2]) / far))) <= cone + math.asin(radius / far)


def _landmark_view(world: World, index: int, camera: CameraModel, p_nc: Array, R_nc: Array) -> LandmarkView:
    mark = world.landmarks[index]
    outline, k = mark.outline_n, len(mark.outline_n)
    corners = np.column_stack([outline, np.full(k, mark.roof_d)])
    corners_px = camera.project((corners - p_nc) @ R_nc)
    seen_from_above = bool(p_nc[2] < mark.roof_d)
    stretches: list[Stretch] = []
    inside_points = hidden_points = 0
    cut = not camera.contains(corners_px).all()
    sides = np.zeros(k, dtype=np.bool_)
    for edge in range(k):
        a, b = corners[edge], corners[(edge + 1) % k]
        points, shares = _along(a, b, camera, p_nc, R_nc)
        px = camera.project((points - p_nc) @ R_nc)
        inside = camera.contains(px)
        hidden = _hidden(world, points, p_nc)
        cut = cut or not inside.all()
        inside_points += int(inside.sum())
        hidden_points += int((inside & hidden).sum())
        if seen_from_above:
            stretches += _stretches(edge, shares, px, inside & ~hidden)
        outside = (b[0] - a[0]) * (p_nc[1] - a[1]) - (b[1] - a[1]) * (p_nc[0] - a[0])
        if mark.height_m > 0.0 and outside > 0.0:
            sides[edge] = _wall_seen(world, index, a, b, camera, p_nc, R_nc)
    visible = camera.contains(corners_px) & ~_hidden(world, corners, p_nc) & seen_from_above
    occluded = hidden_points / inside_points if inside_points else 0.0
    return LandmarkView(mark.id, corners_px, visible, tuple(stretches), sides, occluded, cut)


def _along(a: Array, b: Array, camera: CameraModel, p_nc: Array, R_nc: Array) -> tuple[Array, Array]:
    depth = max(0.1, float(min((a - p_nc) @ R_nc[:, 2], (b - p_nc) @ R_nc[:, 2])))
    n = max(2, min(4000, math.ceil(float(np.linalg.norm(b - a)) * camera.fx / depth / _STEP_PX) + 1))
    shares = np.linspace(0.0, 1.0, n)
    return a + shares[:, None] * (b - a), shares


def _stretches(edge: int, shares: Array, px: Array, visible: Mask) -> list[Stretch]:
    steps = np.flatnonzero(np.diff(np.concatenate(([0], visible.astype(np.int8), [0]))))
    runs = steps.reshape(-1, 2)
    return [Stretch(edge, float(shares[i]), float(shares[j - 1]), px[i:j]) for i, j in runs if j - i > 1]


def _wall_seen(world: World, index: int, a: Array, b: Array, camera: CameraModel, p_nc: Array, R_nc: Array) -> bool:
    along, down = np.meshgrid(np.linspace(0.02, 0.98, 12), np.linspace(0.02, 0.98, 5))
    points = a + along.ravel()[:, None] * (b - a)
    points[:, 2] += down.ravel() * world.landmarks[index].height_m
    inside = camera.contains(camera.project((points - p_nc) @ R_nc))
    return bool(np.any(inside & ~_hidden(world, points, p_nc)))


def _hidden(world: World, points: Array, p_nc: Array) -> Mask:
    c = world.columns
    return _blocked(np.ascontiguousarray(points), p_nc, c.vertices, c.offsets, c.base_d, c.height_m, c.centre_n, c.radius_m)


@njit(cache=True)
def _blocked(
    points: Array, p: Array, vertices: Array, offsets: Indices, base_d: Array, height_m: Array, centre_n: Array,
    radius_m: Array,
) -> Mask:  # fmt: skip
    hidden = np.zeros(len(points), dtype=np.bool_)
    for i in range(len(points)):
        x = points[i]
        for s in range(len(base_d)):
            if height_m[s] <= 0.0 or hidden[i]:
                continue
            roof = base_d[s] - height_m[s]
            # p + t (x - p) is below the roof's plane from t0 on; the camera itself may be below it.
            fall = x[2] - p[2]
            t0 = 0.0 if p[2] >= roof else ((roof - p[2]) / fall if fall > 0.0 else 1.0)
            if t0 >= _BEFORE:
                continue
            n0, e0 = p[0] + t0 * (x[0] - p[0]), p[1] + t0 * (x[1] - p[1])
            n1, e1 = p[0] + _BEFORE * (x[0] - p[0]), p[1] + _BEFORE * (x[1] - p[1])
            away = max(abs(0.5 * (n0 + n1) - centre_n[s, 0]) - 0.5 * abs(n1 - n0),
                       abs(0.5 * (e0 + e1) - centre_n[s, 1]) - 0.5 * abs(e1 - e0))  # fmt: skip
            if away > radius_m[s]:
                continue
            hidden[i] = _meets(vertices[offsets[s] : offsets[s + 1]], n0, e0, n1, e1)
    return hidden


@njit(cache=True)
def _meets(outline: Array, n0: float, e0: float, n1: float, e1: float) -> bool:
    k, inside = len(outline), False
    for i in range(k):
        a, b = outline[i], outline[(i + 1) % k]
        dn, de = b[0] - a[0], b[1] - a[1]
        det = dn * (e1 - e0) - de * (n1 - n0)
        if det != 0.0:
            s = ((n0 - a[0]) * (e1 - e0) - (e0 - a[1]) * (n1 - n0)) / det
            t = ((n0 - a[0]) * de - (e0 - a[1]) * dn) / det
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                return True
        if (a[0] > n0) != (b[0] > n0) and e0 < a[1] + (n0 - a[0]) * de / dn:
            inside = not inside
    return inside
