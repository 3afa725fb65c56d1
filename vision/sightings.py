"""From measured regions to sightings: what identification needs, in n at the prior's attitude.

r = R_nb (R_bc x_c + p_bc)                                               (stereo: x_c is measured)
r = lambda R_nb R_bc ray + R_nb p_bc,  lambda so that it ends on the plane of the roofs     (one camera)
"""

import math
from collections.abc import Sequence

import numpy as np

from models import outline as polygon
from models.camera import StereoRig
from models.messages import Array
from vision.identify import Prior
from vision.likelihood import Sighting
from vision.measure import Level, Measured
from vision.regions import Region

ROOF_SLOPE_RAD = math.radians(2.0)  # of a roof that the map calls flat
ONE_CAMERA_SCALE_SIGMA = 0.02  # relative: roofs stand at different heights, beside the prior's own height
_EDGE_PX = 0.5  # of the side of an outline, one camera: nothing checks it
_FLOOR_PX = 0.3  # of the centre of an outline
_SHALLOW = 0.25  # sine below which a ray does not meet the ground where it can be told


def level(prior: Prior, rig: StereoRig) -> Level:
    """Roofs are level: their normal in the left camera's frame."""
    up_c = (prior.R_nb @ rig.R_bc).T @ np.array([0.0, 0.0, -1.0])
    return Level(up_c, math.hypot(ROOF_SLOPE_RAD, math.sqrt(max(prior.covariance[3, 3], prior.covariance[4, 4]))))


def from_stereo(m: Measured, prior: Prior, rig: StereoRig) -> Sighting:
    """A region whose distance was measured; rig: the rectified one."""
    R_nc = prior.R_nb @ rig.R_bc
    own, shared = m.disparity_sigma_px / m.disparity_px, m.rig_sigma_px / m.disparity_px
    of_depth = own**2 + shared**2
    sizes = np.array([m.width_m, m.length_m])
    logs = m.covariance[1:3, 1:3] / np.outer(sizes, sizes) - of_depth
    floor = (_FLOOR_PX * m.centre_c[2] / rig.left.fx) ** 2
    rest = _positive(m.covariance_c - of_depth * np.outer(m.centre_c, m.centre_c)) + floor * np.eye(3)
    axis_n = R_nc @ m.axis_c
    return Sighting(
        arm_n=prior.R_nb @ (rig.R_bc @ m.centre_c + rig.p_bc),
        depth_sigma=own,
        covariance_n=R_nc @ rest @ R_nc.T,
        size_m2=m.size_m2,
        width_m=m.width_m,
        length_m=m.length_m,
        fill_ratio=m.fill_ratio,
        log_size_covariance=_positive(logs),
        fill_ratio_sigma=m.sigma("fill_ratio"),
        orientation_rad=math.atan2(axis_n[1], axis_n[0]) % math.pi,
        orientation_sigma_rad=m.orientation_sigma_rad,
        colour_bgr=m.region.colour_bgr,
    )


def shared_scale_sigma(measured: Sequence[Measured]) -> float:
    """Relative error of depth that the rig's calibration gives all regions; at least 0.1 %."""
    return max(float(np.median([m.rig_sigma_px / m.disparity_px for m in measured], axis=0)) if measured else 0.0, 1e-3)


def from_one_camera(region: Region, prior: Prior, rig: StereoRig, roof_d: float) -> Sighting | None:
    """A region laid on the plane of the roofs (down = roof_d), seen by rig.left; None where the ray does not meet it well."""
    p_nc, R_nc = rig.camera_pose(prior.p_n, prior.R_nb)
    rays = rig.left.ray(region.outline) @ R_nc.T
    if not np.isfinite(rays).all() or rays[:, 2].min() < _SHALLOW or roof_d - p_nc[2] < 1.0:
        return None
    points = rays * ((roof_d - p_nc[2]) / rays[:, 2])[:, None]
    d = polygon.describe(np.ascontiguousarray(points[:, :2]), np.array([0, len(points)]))[0]
    if polygon.area(np.ascontiguousarray(points[:, :2])) < 0.0:
        d = polygon.describe(np.ascontiguousarray(points[::-1, :2]), np.array([0, len(points)]))[0]
    if not d[polygon.SIZE] > 0.0:
        return None
    arm_c = np.array([d[polygon.NORTH], d[polygon.EAST], roof_d - p_nc[2]])
    distance = float(np.linalg.norm(arm_c))
    edge_m, sine = _EDGE_PX * distance / rig.left.fx, float(arm_c[2] / distance)
    tilt = math.sqrt(max(prior.covariance[3, 3], prior.covariance[4, 4]) + ROOF_SLOPE_RAD**2)
    slanted = 2.0 * tilt * math.sqrt(1.0 - sine**2) / sine  # relative error of a length towards the camera
    of_sizes = np.array([edge_m / d[polygon.WIDTH], edge_m / d[polygon.LENGTH]]) * math.sqrt(2.0)
    return Sighting(
        arm_n=arm_c + p_nc - prior.p_n,
        depth_sigma=1e-3,
        covariance_n=(_FLOOR_PX * distance / rig.left.fx / sine) ** 2 * np.eye(3),
        size_m2=float(d[polygon.SIZE]),
        width_m=float(d[polygon.WIDTH]),
        length_m=float(d[polygon.LENGTH]),
        fill_ratio=float(d[polygon.FILL]),
        log_size_covariance=np.diag(of_sizes**2 + slanted**2),
        fill_ratio_sigma=float(2.0 * edge_m / d[polygon.WIDTH]),
        orientation_rad=float(d[polygon.ORIENTATION]),
        orientation_sigma_rad=float(math.atan(2.0 * edge_m / d[polygon.LENGTH])) + 0.5 * slanted,
        colour_bgr=region.colour_bgr,
    )


def one_eyed(rig: StereoRig, *, right: bool) -> StereoRig:
    """The rig as if its one good camera were the left one."""
    if not right:
        return rig
    R_br = rig.R_bc @ rig.R_rc.T
    return StereoRig(
        rig.right, rig.right, np.eye(3), np.array([-rig.baseline_m, 0.0, 0.0]), R_br, rig.p_bc - R_br @ rig.t_rc,
        None, rig.covariance_bc, rig.time_offset_s,
    )  # fmt: skip


def _positive(matrix: Array) -> Array:
    """The nearest covariance: negative eigenvalues set to 0."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
