"""How the picture of a point moves with the pose, the map and the rig, seen along the outline's normal.

    x_c = R_nc^T (X - p_nc),   R_nc = R_nb R_bc,   p_nc = p + R_nb p_bc
    dx_c = R_nc^T (-dp + [X - p]x dtheta + dX)                  pose (R_true = exp(dtheta) R) and map point
         + R_bc^T (-dt_bc + [x_b - p_bc]x dtheta_bc)            camera on the body
    dx_r = R_rc dx_c + dt_rc - [R_rc x_c]x dtheta_rc            right camera

A row is n . du/d(unknown) [px per unit]: the thesis' Table 1 (after Lowe), for any camera model and with all that else may be wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.camera import CameraModel, StereoRig
from models.messages import Array
from vision.visibility import ModelEdges, hidden

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Samples:
    """Points on model edges: points_n (N, 3) m, place t (N,) in 0 ... 1 and edge (N,) index."""

    points_n: Array
    t: Array
    edge: Indices


@dataclass(frozen=True, slots=True)
class EdgeView:
    """Samples in one picture: px (N, 2), unit normal (N, 2), row_c (N, 3) = n . du/dx_camera, x_c (N, 3) in this camera."""

    px: Array
    normal: Array
    row_c: Array
    x_c: Array
    usable: Mask


@dataclass(frozen=True, slots=True)
class Eye:
    """One camera of the rig: its model and its pose from the body, x_k = R_kb (x_b - p_bk)."""

    camera: CameraModel
    R_kb: Array
    p_bk: Array
    right: bool

    def pose(self, p_n: Array, R_nb: Array) -> tuple[Array, Array]:
        """Place p_nk (3,) and axes R_nk (3, 3) at a pose of the body."""
        return p_n + R_nb @ self.p_bk, R_nb @ self.R_kb.T


def eyes(rig: StereoRig) -> tuple[Eye, Eye]:
    """Left and right camera of a rig."""
    R_rb = rig.R_rc @ rig.R_bc.T
    return (
        Eye(rig.left, rig.R_bc.T, rig.p_bc, right=False),
        Eye(rig.right, R_rb, rig.p_bc - R_rb.T @ rig.t_rc, right=True),
    )


def sample_edges(edges: ModelEdges, eye: Eye, p_n: Array, R_nb: Array, spacing_px: float, most: int) -> Samples:
    """Points on every edge about spacing_px apart in the picture of `eye`, at most `most` on an edge."""
    p_nk, R_nk = eye.pose(p_n, R_nb)
    ends = np.concatenate((edges.start_n, edges.end_n))
    px = eye.camera.project((ends - p_nk) @ R_nk)
    count = len(edges.kind)
    length = np.nan_to_num(np.hypot(*(px[count:] - px[:count]).T), nan=spacing_px * most)
    number = np.clip(np.rint(length / spacing_px), 2, most).astype(np.int64)
    edge = np.repeat(np.arange(count), number)
    first = np.cumsum(number) - number
    # Ends stay out: there the profile sees the corner.
    t = (np.arange(len(edge)) - first[edge] + 0.5) / number[edge]
    aside = np.minimum(2.5 / np.maximum(length, 1.0), 0.2)[edge]
    t = aside + (1.0 - 2.0 * aside) * t
    points = edges.start_n[edge] + t[:, None] * (edges.end_n - edges.start_n)[edge]
    return Samples(points, t, edge)


def view(edges: ModelEdges, samples: Samples, eye: Eye, p_n: Array, R_nb: Array, occluders: Sequence[object]) -> EdgeView:
    """The samples as `eye` sees them."""
    p_nk, R_nk = eye.pose(p_n, R_nb)
    x_c = (samples.points_n - p_nk) @ R_nk
    direction = (edges.end_n - edges.start_n) @ R_nk
    px, jacobian = eye.camera.project(x_c), eye.camera.project_jacobian(x_c)
    normal, row_c = _normal_rows(jacobian, direction, samples.edge)
    usable = np.isfinite(px).all(axis=1) & np.isfinite(row_c).all(axis=1)
    usable &= ~hidden(samples.points_n, p_nk, occluders)  # type: ignore[arg-type]
    return EdgeView(px, normal, row_c, x_c, usable)


@njit(cache=True)
def _normal_rows(jacobian: Array, direction: Array, edge: Indices) -> tuple[Array, Array]:
    n = edge.shape[0]
    normal, row = np.empty((n, 2)), np.empty((n, 3))
    for i in range(n):
        d = direction[edge[i]]
        tu = jacobian[i, 0, 0] * d[0] + jacobian[i, 0, 1] * d[1] + jacobian[i, 0, 2] * d[2]
        tv = jacobian[i, 1, 0] * d[0] + jacobian[i, 1, 1] * d[1] + jacobian[i, 1, 2] * d[2]
        length = np.sqrt(tu * tu + tv * tv)
        nu, nv = -tv / length, tu / length
        normal[i, 0], normal[i, 1] = nu, nv
        for k in range(3):
            row[i, k] = nu * jacobian[i, 0, k] + nv * jacobian[i, 1, k]
    return normal, row


def edge_gaps(edges: ModelEdges, samples: Samples, seen: EdgeView, eye: Eye, p_n: Array, R_nb: Array) -> Array:
    """Distance (E,) px along the normal, outwards, from each edge to its partner, the mean over its points; 0 without partner."""
    gaps = np.zeros(len(edges.kind))
    rows = np.flatnonzero(edges.partner[samples.edge] >= 0)
    if not len(rows):
        return gaps
    p_nk, R_nk = eye.pose(p_n, R_nb)
    edge = samples.edge[rows]
    partner, t = edges.partner[edge], samples.t[rows, None]
    direction = edges.end_n[partner] - edges.start_n[partner]
    x_c = (edges.start_n[partner] + t * direction - p_nk) @ R_nk
    normal, _ = _normal_rows(eye.camera.project_jacobian(x_c), direction @ R_nk, np.arange(len(rows)))
    offset = np.sum((eye.camera.project(x_c) - seen.px[rows]) * normal, axis=1) / np.sum(seen.normal[rows] * normal, axis=1)
    good = np.isfinite(offset)
    total = np.bincount(edge[good], offset[good], minlength=len(gaps))
    gaps[:] = total / np.maximum(np.bincount(edge[good], minlength=len(gaps)), 1)
    return gaps


def pose_rows(seen: EdgeView, samples: Samples, eye: Eye, p_n: Array, R_nb: Array) -> Array:
    """(N, 6) by dp_n and dtheta_n."""
    row_n = seen.row_c @ eye.pose(p_n, R_nb)[1].T  # n . du/dX
    # row_n . ([X - p]x dtheta) = -((X - p) x row_n) . dtheta
    return np.column_stack((-row_n, -np.cross(samples.points_n - p_n, row_n)))


def map_rows(seen: EdgeView, samples: Samples, edges: ModelEdges, eye: Eye, p_n: Array, R_nb: Array, landmarks: int) -> Array:
    """(N, 4 L) by the unknowns of every landmark (MapError)."""
    row_n = seen.row_c @ eye.pose(p_n, R_nb)[1].T
    t = samples.t[:, None, None]
    by_map = (1.0 - t) * edges.map_start[samples.edge] + t * edges.map_end[samples.edge]
    rows = np.zeros((len(row_n), landmarks, by_map.shape[2]))
    rows[np.arange(len(row_n)), edges.landmark[samples.edge]] = np.einsum("ni,nij->nj", row_n, by_map)
    return rows.reshape(len(row_n), -1)


def rig_rows(seen: EdgeView, eye: Eye, rig: StereoRig) -> tuple[Array, Array, Array]:
    """(N, 6) by covariance_bc's unknowns, (N, 6) by covariance_rc's, (N, 4 + n) by this camera's own."""
    x_c = (seen.x_c - rig.t_rc) @ rig.R_rc if eye.right else seen.x_c
    row_left = seen.row_c @ rig.R_rc if eye.right else seen.row_c  # n . du/dx_c
    row_b = row_left @ rig.R_bc.T
    from_camera_b = x_c @ rig.R_bc.T
    by_bc = np.column_stack((-row_b, -np.cross(from_camera_b, row_b)))
    by_rc = np.zeros((len(row_b), 6))
    if eye.right:
        by_rc = np.column_stack((seen.row_c, np.cross(x_c @ rig.R_rc.T, seen.row_c)))
    own = np.einsum("ni,nij->nj", seen.normal, eye.camera.parameter_jacobian(seen.x_c))
    return by_bc, by_rc, own
