"""How the picture of a point moves with the pose, the map and the rig, seen along the outline's normal.

    x_c = R_nc^T (X - p_nc),   R_nc = R_nb R_bc,   p_nc = p + R_nb p_bc
    dx_c = R_nc^T (-dp + [X - p]x dtheta + dX)                  pose (R_true = exp(dtheta) R) and map point
         + R_bc^T (-dt_bc + [x_b - p_bc]x dtheta_bc)            camera on the body
    dx_r = R_rc dx_c + dt_rc - [R_rc x_c]x dtheta_rc            right camera

A row is n . du/d(unknown) [px per unit]: the thesis' Table 1 (after Lowe), for any camera model and with
all that else may be wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.camera import CameraModel, StereoRig
from models.landmarks import Landmark
from models.messages import Array
from vision.visibility import ModelEdges, Prisms, hidden

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_CORNER_PX = 2.5  # ends of edges that stay out: there a profile sees the corner
_FEW, _CLOSEST_PX = 7, 3.0  # short edges get so many points, unless they came closer than that


@dataclass(frozen=True, slots=True)
class Samples:
    """Points on model edges: points_n (N, 3) m, place t (N,) in 0 ... 1 and edge (N,) index; tau (N,): their place in -1 ... 1 of
    what is in view of the edge.
    """

    points_n: Array
    t: Array
    edge: Indices
    tau: Array


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


def sample_edges(
    edges: ModelEdges, eye: Eye, p_n: Array, R_nb: Array, spacing_px: float, most: int, wanted: Mask | None = None
) -> Samples:
    """Points on what `eye` has in view of every (wanted) edge, about spacing_px apart in the picture, at most `most` on one."""
    p_nk, R_nk = eye.pose(p_n, R_nb)
    count = len(edges.kind)
    part = part_in_view(eye, edges.start_n, edges.end_n, (p_n, R_nb))
    along = edges.end_n - edges.start_n
    cut = np.concatenate((edges.start_n + part[:, :1] * along, edges.end_n - (1.0 - part[:, 1:]) * along))
    px = eye.camera.project((cut - p_nk) @ R_nk)
    chosen = part[:, 0] < part[:, 1] if wanted is None else wanted & (part[:, 0] < part[:, 1])
    return Samples(*_sample(edges.start_n, edges.end_n, part, px[:count], px[count:], spacing_px, most, chosen))


def part_in_view(eye: Eye, start_n: Array, end_n: Array, pose: tuple[Array, Array]) -> Array:
    """From where to where (E, 2), of 0 ... 1, edges are in view; nowhere: the first is not smaller."""
    p_nk, R_nk = eye.pose(*pose)
    ends_c = (np.concatenate((start_n, end_n)) - p_nk) @ R_nk
    return np.asarray(_in_view(ends_c[: len(start_n)], ends_c[len(start_n) :], _borders(eye.camera)))


@lru_cache(maxsize=8)
def _borders(camera: CameraModel) -> Array:
    """Normals (4, 3) of the planes that hold what is in view: n . x_c >= 0."""
    u, v = camera.width - 1.0, camera.height - 1.0
    rim = [(a * u, b * v) for a in (0.0, 0.5, 1.0) for b in (0.0, 0.5, 1.0)]
    rays = camera.ray(np.array(rim))
    slope = rays[:, :2] / rays[:, 2:]
    (left, top), (right, bottom) = slope.min(axis=0), slope.max(axis=0)
    return np.array([[1.0, 0.0, -left], [-1.0, 0.0, right], [0.0, 1.0, -top], [0.0, -1.0, bottom]])


@njit(cache=True)
def _in_view(start: Array, end: Array, borders: Array) -> Array:
    """From where to where (E, 2), of 0 ... 1, edges are on the inner side of all borders; nowhere: the first is not smaller."""
    part = np.empty((len(start), 2))
    for e in range(len(start)):
        part[e, 0], part[e, 1] = 0.0, 1.0
        for b in range(len(borders)):
            first, last = np.dot(borders[b], start[e]), np.dot(borders[b], end[e])
            if first < 0.0 and last < 0.0:
                part[e, 1] = -1.0
            elif first < 0.0:
                part[e, 0] = max(part[e, 0], first / (first - last))
            elif last < 0.0:
                part[e, 1] = min(part[e, 1], first / (first - last))
    return part


@njit(cache=True)
def _sample(
    start: Array, end: Array, part: Array, start_px: Array, end_px: Array, spacing: float, most: int, wanted: Mask
) -> tuple[Array, Array, Indices, Array]:
    count = len(start)
    points, place, edge = np.empty((count * most, 3)), np.empty(count * most), np.empty(count * most, np.int64)
    tau = np.empty(count * most)
    n = 0
    for e in range(count):
        if not wanted[e]:
            continue
        length = np.sqrt(np.sum((end_px[e] - start_px[e]) ** 2))
        if np.isnan(length):
            length = spacing * most
        number = min(max(int(length / spacing + 0.5), min(_FEW, int(length / _CLOSEST_PX)), 2), most)
        aside = min(_CORNER_PX / max(length, 1.0), 0.2)
        for i in range(number):
            within = aside + (1.0 - 2.0 * aside) * (i + 0.5) / number
            t = part[e, 0] + (part[e, 1] - part[e, 0]) * within
            place[n], edge[n], tau[n] = t, e, 2.0 * within - 1.0
            points[n] = start[e] + t * (end[e] - start[e])
            n += 1
    return points[:n].copy(), place[:n].copy(), edge[:n].copy(), tau[:n].copy()


def view(
    edges: ModelEdges, samples: Samples, eye: Eye, p_n: Array, R_nb: Array, landmarks: Prisms | Sequence[Landmark]
) -> EdgeView:
    """The samples as `eye` sees them."""
    p_nk, R_nk = eye.pose(p_n, R_nb)
    x_c = (samples.points_n - p_nk) @ R_nk
    direction = (edges.end_n - edges.start_n) @ R_nk
    px, jacobian = eye.camera.project(x_c), eye.camera.project_jacobian(x_c)
    normal, row_c = _normal_rows(jacobian, direction, samples.edge)
    usable = np.isfinite(px).all(axis=1) & np.isfinite(row_c).all(axis=1)
    usable &= ~hidden(samples.points_n, p_nk, landmarks)
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


@dataclass(frozen=True, slots=True)
class Derivatives:
    """n . du of the samples: by dp_n and dtheta_n (N, 6), by their landmark's MapError (N, M), by what covariance_bc (N, 6) and
    covariance_rc (N, 6) speak of, and by the camera's own parameters (N, 4 + n).
    """

    pose: Array
    mapped: Array
    bc: Array
    rc: Array
    own: Array


def derivatives(
    edges: ModelEdges, samples: Samples, seen: EdgeView, eye: Eye, rig: StereoRig, p_n: Array, R_nb: Array
) -> Derivatives:
    """All that moves the samples along their normals in this picture."""
    lever_b = eye.p_bk - rig.p_bc
    rows = _derivative_rows(
        seen.row_c, seen.x_c, samples.points_n, samples.t, samples.edge, edges.map_start, edges.map_end, p_n, R_nb @ eye.R_kb.T,
        np.ascontiguousarray(eye.R_kb.T), lever_b, rig.t_rc, eye.right,
    )  # fmt: skip
    own = np.matmul(seen.normal[:, None, :], eye.camera.parameter_jacobian(seen.x_c))[:, 0]
    return Derivatives(rows[:, :6], rows[:, 18:], rows[:, 6:12], rows[:, 12:18], own)


@njit(cache=True)
def _derivative_rows(
    row_c: Array, x_c: Array, points: Array, t: Array, edge: Indices, map_start: Array, map_end: Array, p_n: Array, R_nk: Array,
    R_bk: Array, lever_b: Array, t_rc: Array, right: bool,
) -> Array:  # fmt: skip
    """(N, 18 + M): pose 6, bc 6, rc 6, map M.  row . (q x dtheta) = -(q x row) . dtheta."""
    n, errors = row_c.shape[0], map_start.shape[2]
    rows, row_n, row_b, q = np.zeros((n, 18 + errors)), np.empty(3), np.empty(3), np.empty(3)
    for i in range(n):
        out, row_k, e = rows[i], row_c[i], edge[i]
        _turn(R_nk, row_k, row_n)
        _turn(R_bk, row_k, row_b)
        _turn(R_bk, x_c[i], q)
        for a in range(3):
            out[a], out[6 + a] = -row_n[a], -row_b[a]
            q[a] += lever_b[a]
        _minus_cross(q, row_b, out[9:12])
        for a in range(3):
            q[a] = points[i, a] - p_n[a]
        _minus_cross(q, row_n, out[3:6])
        for k in range(errors):
            for a in range(3):
                out[18 + k] += row_n[a] * ((1.0 - t[i]) * map_start[e, a, k] + t[i] * map_end[e, a, k])
        if right:
            for a in range(3):
                out[12 + a] = row_k[a]
                q[a] = x_c[i, a] - t_rc[a]
            _minus_cross(row_k, q, out[15:18])
    return rows


@njit(cache=True)
def _turn(R: Array, x: Array, out: Array) -> None:
    """R x."""
    for a in range(3):
        out[a] = R[a, 0] * x[0] + R[a, 1] * x[1] + R[a, 2] * x[2]


@njit(cache=True)
def _minus_cross(a: Array, b: Array, out: Array) -> None:
    """-a x b."""
    out[0] = a[2] * b[1] - a[1] * b[2]
    out[1] = a[0] * b[2] - a[2] * b[0]
    out[2] = a[1] * b[0] - a[0] * b[1]
