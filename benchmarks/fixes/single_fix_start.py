"""A start for the pose fit of a single view: from where roofs lie in one image, and how large they are, as regions show it.

    c_j = centroid of roof j [px],   ln s_j = ln sqrt(area_j);   dc = J_c dx_c,   d ln s = -dz_c / z_c

Shifts of the landmarks on the map are estimated along with the pose, since at low height they are far larger than a fit's window.
"""

import math
from collections.abc import Sequence

import numpy as np

from models import so3
from models.camera import CameraModel
from models.maps import outline as polygon
from models.maps.landmarks import Landmark
from models.messages import Array
from models.prior import Prior
from vision.outline.visibility import MapError
from vision.pose.sensitivity import Eye

_MOST_ROUNDS, _CLOSE_RAD = 6, 1e-3  # a step that turns sights by less than this was the last


def centroid_and_size(contour_px: Array) -> tuple[Array, float]:
    """Centroid (2,) and square root of the area [px] of a closed contour (K, 2)."""
    return polygon.describe(contour_px, np.array([0, len(contour_px)]))[0, [polygon.NORTH, polygon.EAST]], float(
        np.sqrt(abs(polygon.area(contour_px)))
    )


def start_from_regions(
    eye: Eye, landmarks: Sequence[Landmark], centres_px: Array, sizes_px: Array, prior: Prior, sigma_px: float = 2.0
) -> tuple[Array, Array, Array]:
    """p_n (3,), R_nb (3, 3) and map errors (L, M) [m] nearest to the prior at which roofs lie at centres_px (L, 2).

    sizes_px: (L,) square roots of the regions' areas, NaN where a region is cut off.
    """
    p_n, R_nb = np.array(prior.p_n, dtype=float), so3.matrix(np.asarray(prior.q_nb_wxyz, dtype=float))
    information = np.linalg.inv(prior.covariance)
    shift = np.zeros((len(landmarks), len(MapError)))
    sigma = np.maximum([mark.sigma_m for mark in landmarks], 1e-4)
    total = np.zeros(6)
    for _ in range(_MOST_ROUNDS):
        A = np.diag(np.concatenate((np.zeros(6), np.repeat(sigma**-2.0, 2))))
        A[:6, :6] = information
        y = -A @ np.concatenate((total, shift[:, :2].ravel()))
        p_nk, R_nk = eye.pose(p_n, R_nb)
        nearest = math.inf
        for j, mark in enumerate(landmarks):
            outline = mark.outline_n + shift[j, :2]
            roof = np.column_stack((outline, np.full(len(outline), mark.roof_d)))
            seen = _roof(eye.camera, (roof - p_nk) @ R_nk)
            if seen is None:
                continue
            centre, size, x_c = seen
            nearest = min(nearest, float(x_c[2]))
            J = eye.camera.project_jacobian(x_c[None, :])[0] @ R_nk.T
            depth = -R_nk[:, 2] / x_c[2]
            rows_n = np.vstack((J, depth)) / np.array([sigma_px, sigma_px, sigma_px / size])[:, None]
            error = np.append((centres_px[j] - centre) / sigma_px, np.log(sizes_px[j] / size) / (sigma_px / size))
            good = np.isfinite(error)
            lever = R_nk @ x_c + p_nk - p_n
            H = np.zeros((3, len(A)))
            H[:, :3], H[:, 3:6] = -rows_n, -np.cross(lever, rows_n)
            H[:, 6 + 2 * j : 8 + 2 * j] = rows_n[:, :2]
            A += H[good].T @ H[good]
            y += H[good].T @ error[good]
        step = np.linalg.solve(A, y)
        p_n, R_nb = p_n + step[:3], so3.matrix(so3.quat_exp(step[3:6])) @ R_nb
        total += step[:6]
        shift[:, :2] += step[6:].reshape(-1, 2)
        if max(float(np.abs(step[3:6]).max()), float(np.abs(step[:3]).max()) / nearest) < _CLOSE_RAD:
            break
    return p_n, R_nb, shift


def _roof(camera: CameraModel, x_c: Array) -> tuple[Array, float, Array] | None:
    """Centroid and size of a projected roof, and the point of the roof there; None where it is not all before the camera."""
    px = camera.project(x_c)
    if not np.isfinite(px).all():
        return None
    centre, size = centroid_and_size(px)
    ray = camera.ray(centre[None, :])[0]
    normal = np.cross(x_c[1] - x_c[0], x_c[2] - x_c[1])
    along = float(normal @ ray)
    if size <= 0.0 or abs(along) < 1e-9:
        return None
    return centre, size, ray * float(normal @ x_c[0]) / along
