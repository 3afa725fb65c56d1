"""Measured regions to sightings, in n at the prior's attitude.

r = R_nb (R_bc x_c + p_bc)                                               (stereo: x_c is measured)
r = lambda R_nb R_bc ray + R_nb p_bc,  lambda so that it ends on the plane of the roofs     (one camera)
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from models.camera import StereoRig
from models.maps import outline as polygon
from models.messages import Array
from models.prior import Prior
from vision.describe.measure import Level, Measured
from vision.describe.regions import Region
from vision.identify.catalogue import Catalogue, Sighting
from vision.identify.identify import view_of
from vision.identify.partial import chain, partial_of

ROOF_SLOPE_RAD = math.radians(1.0)  # of a roof that the map calls flat
ONE_CAMERA_SCALE_SIGMA = 0.02  # relative: roofs stand at different heights, beside the prior's own height
_UNEVEN = 0.3  # part of the rig's error of disparity that differs over the image
_EDGE_PX = 0.3  # of the side of an outline, one camera: nothing checks it
_FLOOR_PX = 0.3  # of the centre of an outline
_SHALLOW = 0.25  # sine below which a ray meets the ground too far away


def level(prior: Prior, rig: StereoRig) -> Level:
    """Roofs are level: their normal in the left camera's frame."""
    up_c = (prior.R_nb @ rig.R_bc).T @ np.array([0.0, 0.0, -1.0])
    return Level(up_c, math.hypot(ROOF_SLOPE_RAD, math.sqrt(max(prior.covariance[3, 3], prior.covariance[4, 4]))))


def from_stereo(m: Measured, prior: Prior, rig: StereoRig) -> Sighting | None:
    """A region with measured distance (rectified rig), sizes on the level plane there."""
    own = math.hypot(m.disparity_sigma_px, _UNEVEN * m.rig_sigma_px) / m.disparity_px
    return _on_level(m.region, prior, rig, float((prior.R_nb @ rig.R_bc @ m.centre_c)[2]), own)


def shared_scale_sigma(measured: Sequence[Measured]) -> float:
    """Relative depth error common to all regions by the rig; >= 0.1 %."""
    return max(float(np.median([m.rig_sigma_px / m.disparity_px for m in measured], axis=0)) if measured else 0.0, 1e-3)


def from_one_camera(region: Region, prior: Prior, rig: StereoRig, roof_d: float) -> Sighting | None:
    """A region on the roofs' plane (down = roof_d), seen by rig.left."""
    return _on_level(region, prior, rig, roof_d - float(rig.camera_pose(prior.p_n, prior.R_nb)[0][2]), 1e-3)


def cut_off(
    sighting: Sighting, region: Region, seen: NDArray[np.bool_], prior: Prior, rig: StereoRig, landmarks: Catalogue
) -> Sighting | None:  # fmt: skip
    """The sighting of a region cut off; None where too little shows."""
    p_nc, R_nc = rig.camera_pose(prior.p_n, prior.R_nb)
    body = p_nc - prior.p_n
    points, order = _laid(region.outline, R_nc, rig, float(sighting.arm_n[2] - body[2]))
    arms = chain(points + body, seen[order])
    if arms is None:
        return None
    pixel_m, slanted = _resolution(sighting.arm_n - body, prior, rig)
    part = partial_of(
        arms, landmarks.vertices, landmarks.offsets, landmarks.position_n[:, 2], R_nc.T, R_nc.T @ body, view_of(rig), pixel_m
    )  # fmt: skip
    if part is None:
        return None
    to_centre = np.mean(landmarks.position_n[part.landmark] - part.target_n, axis=0)
    edges = math.sqrt(2.0) * _EDGE_PX * pixel_m / part.sides_m
    return replace(
        sighting,
        arm_n=part.middle_n + to_centre,
        log_size_covariance=np.diag(edges**2 + slanted**2),
        orientation_sigma_rad=float(edges[0] + 0.5 * slanted),
        partial=part,
    )


def _laid(outline: Array, R_nc: Array, rig: StereoRig, down_m: float) -> tuple[Array, slice]:
    """An outline (K, 2) px on the level plane: (K, 3), anticlockwise from above; its order."""
    rays = rig.left.ray(outline) @ R_nc.T
    points = rays * (down_m / rays[:, 2])[:, None]
    order = slice(None, None, 1 if polygon.area(np.ascontiguousarray(points[:, :2])) > 0.0 else -1)
    return points[order], order


def _on_level(region: Region, prior: Prior, rig: StereoRig, down_m: float, depth_sigma: float) -> Sighting | None:
    p_nc, R_nc = rig.camera_pose(prior.p_n, prior.R_nb)
    slant = (rig.left.ray(region.outline) @ R_nc.T)[:, 2]
    if not np.isfinite(slant).all() or slant.min() < _SHALLOW or down_m < 1.0:
        return None
    points = np.ascontiguousarray(_laid(region.outline, R_nc, rig, down_m)[0][:, :2])
    d = polygon.describe(points, np.array([0, len(points)]))[0]
    if not d[polygon.SIZE] > 0.0:
        return None
    arm = np.array([d[polygon.NORTH], d[polygon.EAST], down_m])
    pixel_m, slanted = _resolution(arm, prior, rig)
    sine = down_m / float(np.linalg.norm(arm))
    edges = math.sqrt(2.0) * _EDGE_PX * pixel_m / np.array([d[polygon.WIDTH], d[polygon.LENGTH]])
    return Sighting(
        arm_n=arm + p_nc - prior.p_n,
        depth_sigma=depth_sigma,
        covariance_n=(_FLOOR_PX * pixel_m / sine) ** 2 * np.eye(3),
        size_m2=float(d[polygon.SIZE]),
        width_m=float(d[polygon.WIDTH]),
        length_m=float(d[polygon.LENGTH]),
        fill_ratio=float(d[polygon.FILL]),
        log_size_covariance=np.diag(edges**2 + slanted**2),
        fill_ratio_sigma=float(edges[0]),
        orientation_rad=float(d[polygon.ORIENTATION]),
        orientation_sigma_rad=float(edges[1] + 0.5 * slanted),
        colour_bgr=region.colour_bgr,
    )


def _resolution(arm: Array, prior: Prior, rig: StereoRig) -> tuple[float, float]:
    distance = float(np.linalg.norm(arm))
    sine = float(arm[2]) / distance
    tilt = math.sqrt(max(prior.covariance[3, 3], prior.covariance[4, 4]) + ROOF_SLOPE_RAD**2)
    return distance / rig.left.fx, 2.0 * tilt * math.sqrt(1.0 - sine**2) / sine


def one_eyed(rig: StereoRig, *, right: bool) -> StereoRig:
    """The rig as if its one good camera were the left one."""
    if not right:
        return rig
    R_br = rig.R_bc @ rig.R_rc.T
    return StereoRig(
        rig.right, rig.right, np.eye(3), np.array([-rig.baseline_m, 0.0, 0.0]), R_br, rig.p_bc - R_br @ rig.t_rc,
        None, rig.covariance_bc, rig.time_offset_s,
    )  # fmt: skip
