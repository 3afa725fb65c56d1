"""Visible shares of roofs, and towers that hide some."""

import math
from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from models.camera import CameraModel, StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.synthetic.render import render_labels
from vision.synthetic.shapes import rectangle
from vision.synthetic.world import Appearance, Solid, World

_MARGIN_PX: Final = 400  # beyond the image, where roofs that it cuts are still drawn
_TOWER: Final = Appearance((150.0, 150.0, 152.0), (165.0, 168.0, 170.0), "gravel", 0.1)
_REACH: Final = (0.55, 0.75)  # place of a tower between the point below the camera and the roof that it hides
_TRIES: Final = 8
_GAP_M: Final = 0.5  # between a tower and anything else


def whole(rig: StereoRig, p_n: Array, R_nb: Array, mark: Landmark, edge_px: float) -> bool:
    """Whether the left image holds the roof, edge_px from its border."""
    px, limit = _corners_px(mark, rig.left, *rig.camera_pose(p_n, R_nb)), np.array([rig.left.width, rig.left.height]) - 1.0
    return bool((px >= edge_px).all() and (px <= limit - edge_px).all())


def cut(rig: StereoRig, p_n: Array, R_nb: Array, mark: Landmark) -> bool:
    """Whether the left image's border runs through the roof."""
    px, limit = _corners_px(mark, rig.left, *rig.camera_pose(p_n, R_nb)), np.array([rig.left.width, rig.left.height]) - 1.0
    inside = ((px >= 0.0) & (px <= limit)).all(axis=1)
    return bool(inside.any() and not inside.all())


def shares(world: World, rig: StereoRig, p_n: Array, R_nb: Array) -> dict[str, float]:
    """Visible share of each roof's area in the left image."""
    camera, (p_nc, R_nc) = rig.left, rig.camera_pose(p_n, R_nb)
    labels = render_labels(world, camera, p_nc, R_nc)
    found = {}
    for k in np.unique(labels[(labels >= 0) & (labels < len(world.landmarks))]).tolist():
        px = _corners_px(world.landmarks[k], camera, p_nc, R_nc)
        if not (np.abs(px) < _MARGIN_PX + min(camera.width, camera.height)).all():
            continue
        roof = np.zeros((camera.height + 2 * _MARGIN_PX, camera.width + 2 * _MARGIN_PX), np.uint8)
        cv2.fillPoly(roof, [(px + _MARGIN_PX).round().astype(np.int32)], 1)
        in_view = roof[_MARGIN_PX:-_MARGIN_PX, _MARGIN_PX:-_MARGIN_PX] > 0
        found[world.landmarks[k].id] = float((in_view & (labels == k)).sum()) / float(roof.sum())
    return found


def hide(world: World, rig: StereoRig, p_n: Array, R_nb: Array, rng: np.random.Generator) -> World:
    """A tower before every roof: height t at s of the way, s = (H - t) / (H - h)."""
    p_nc, _ = rig.camera_pose(p_n, R_nb)
    taken = [(*s.outline_n.mean(axis=0), _radius(s.outline_n)) for s in world.solids if s.height_m > 0.0]
    towers = []
    for mark in world.landmarks:
        for _ in range(_TRIES if whole(rig, p_n, R_nb, mark, 0.0) else 0):
            s = rng.uniform(*_REACH)
            place = p_nc[:2] + s * (np.array(mark.centre_n) + rng.normal(0.0, 0.25 * mark.length_m, 2) - p_nc[:2])
            side, turn = s * mark.width_m * rng.uniform(0.6, 1.1), rng.uniform(0.0, math.pi)
            c, d = math.cos(turn), math.sin(turn)
            outline = rectangle(side, side) @ np.array([[c, d], [-d, c]]) + place
            height = -p_nc[2] - s * (mark.roof_d - p_nc[2])
            radius = _radius(outline)
            if all(math.hypot(place[0] - n, place[1] - e) > radius + r + _GAP_M for n, e, r in taken):
                taken.append((float(place[0]), float(place[1]), radius))
                towers.append(Solid(outline, 0.0, float(height), _TOWER))
                break
    return replace(world, clutter=(*world.clutter, *towers))


def _corners_px(mark: Landmark, camera: CameraModel, p_nc: Array, R_nc: Array) -> Array:
    corners = np.column_stack([mark.outline_n, np.full(len(mark.outline_n), mark.roof_d)])
    return np.asarray(np.nan_to_num(camera.project((corners - p_nc) @ R_nc), nan=1e9))


def _radius(outline_n: Array) -> float:
    return float(np.hypot(*(outline_n - outline_n.mean(axis=0)).T).max())
