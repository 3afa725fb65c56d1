"""Motion of an image point with pose, map and rig, along the outline's normal.

    x_c = R_nc^T (X - p_nc),   R_nc = R_nb R_bc,   p_nc = p + R_nb p_bc
    dx_c = R_nc^T (-dp + [X - p]x dtheta + dX)                  pose (R_true = exp(dtheta) R) and map point
         + R_bc^T (-dt_bc + [x_b - p_bc]x dtheta_bc)            camera on the body
    dx_r = R_rc dx_c + dt_rc - [R_rc x_c]x dtheta_rc            right camera

A row is n . du/d(unknown) [px per unit] (thesis, Table 1, for any camera).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.camera import CameraModel, Mount, parameter_jacobian, project, projected
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.outline.visibility import ModelEdges, Prisms, hide

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_CORNER_PX = 2.5  # ends of edges that stay out: there a profile sees the corner
MAPPED_FROM = 18  # columns before those of the map: pose 6, camera on the body 6, right against left camera 6
_FEW, _CLOSEST_PX = 7, 3.0  # short edges get so many points, unless they came closer than that


@dataclass(frozen=True, slots=True)
class Samples:
    """points_n (N, 3) m, t (N,) in 0 ... 1, edge (N,); tau (N,): -1 ... 1 over the visible part."""

    points_n: Array
    t: Array
    edge: Indices
    tau: Array


@dataclass(frozen=True, slots=True)
class EdgeView:
    """Samples in one image: px (N, 2), unit normal (N, 2), row_c (N, 3) = n . du/dx_camera, x_c (N, 3)."""

    px: Array
    normal: Array
    row_c: Array
    x_c: Array
    usable: Mask


@dataclass(frozen=True, slots=True)
class Eye:
    """A camera's model and its pose from the body, x_k = R_kb (x_b - p_bk)."""

    camera: CameraModel
    R_kb: Array
    p_bk: Array
    right: bool

    def pose(self, p_n: Array, R_nb: Array) -> tuple[Array, Array]:
        """Position p_nk (3,) and axes R_nk (3, 3) at a pose of the body."""
        placed: tuple[Array, Array] = _placed(*self.stand(p_n, R_nb))
        return placed

    def stand(self, p_n: Array, R_nb: Array) -> tuple[Array, Array, Array, Array]:
        """p_n, R_nb, p_bk, R_kb for kernels."""
        return np.ascontiguousarray(p_n), np.ascontiguousarray(R_nb), self.p_bk, self.R_kb


@njit(cache=True)
def _placed(p_n: Array, R_nb: Array, p_bk: Array, R_kb: Array) -> tuple[Array, Array]:
    R_nk = np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            R_nk[i, k] = R_nb[i, 0] * R_kb[k, 0] + R_nb[i, 1] * R_kb[k, 1] + R_nb[i, 2] * R_kb[k, 2]
    p_nk = so3.applied(R_nb, p_bk)
    for i in range(3):
        p_nk[i] = p_n[i] + p_nk[i]
    return p_nk, R_nk


@lru_cache(maxsize=8)
def eyes(rig: Mount) -> tuple[Eye, Eye]:
    """Left and right camera of a rig."""
    R_rb = rig.R_rc @ rig.R_bc.T
    return (
        Eye(rig.left, np.ascontiguousarray(rig.R_bc.T), rig.p_bc, right=False),
        Eye(rig.right, R_rb, rig.p_bc - R_rb.T @ rig.t_rc, right=True),
    )


def sample_edges(
    edges: ModelEdges, eye: Eye, p_n: Array, R_nb: Array, spacing_px: float, most: int, wanted: Mask | None = None
) -> Samples:
    """Points on visible parts of (wanted) edges, spacing_px apart, `most` per edge."""
    chosen = np.ones(len(edges.kind), dtype=np.bool_) if wanted is None else wanted
    camera, borders = eye.camera.parameters, _borders(eye.camera)
    return Samples(*_sampled(edges.start_n, edges.end_n, *eye.stand(p_n, R_nb), camera, borders, spacing_px, most, chosen))


@njit(cache=True)
def _sampled(
    start: Array, end: Array, p_n: Array, R_nb: Array, p_bk: Array, R_kb: Array, camera: Array, borders: Array, spacing: float,
    most: int, wanted: Mask,
) -> tuple[Array, Array, Indices, Array]:  # fmt: skip
    p_nk, R_nk = _placed(p_n, R_nb, p_bk, R_kb)
    part, ends_c = _cut(start, end, p_nk, R_nk, borders)
    return _spread(start, end, part, project(ends_c, camera), spacing, most, wanted)


def part_in_view(eye: Eye, start_n: Array, end_n: Array, pose: tuple[Array, Array]) -> Array:
    """Part in view (E, 2) of 0 ... 1; none: first not smaller."""
    part, _ = _cut(start_n, end_n, *eye.pose(*pose), _borders(eye.camera))
    return part


def ends_px(edges: ModelEdges, eye: Eye, pose: tuple[Array, Array]) -> Array:
    """Ends of edges (2 E, 2) px, starts first; NaN behind the camera."""
    return np.asarray(ends_of(edges.start_n, edges.end_n, *eye.stand(*pose), eye.camera.parameters))


@njit(cache=True)
def ends_of(start: Array, end: Array, p_n: Array, R_nb: Array, p_bk: Array, R_kb: Array, camera: Array) -> Array:
    """ends_px of edges start-end (E, 3)."""
    p_nk, R_nk = _placed(p_n, R_nb, p_bk, R_kb)
    x_c, count = np.empty((2 * len(start), 3)), len(start)
    for e in range(count):
        _into(start[e], p_nk, R_nk, x_c[e])
        _into(end[e], p_nk, R_nk, x_c[count + e])
    return project(x_c, camera)


@lru_cache(maxsize=8)
def _borders(camera: CameraModel) -> Array:
    """Normals (4, 3) of the view's border planes: n . x_c >= 0."""
    u, v = camera.width - 1.0, camera.height - 1.0
    rim = [(a * u, b * v) for a in (0.0, 0.5, 1.0) for b in (0.0, 0.5, 1.0)]
    rays = camera.ray(np.array(rim))
    slope = rays[:, :2] / rays[:, 2:]
    (left, top), (right, bottom) = slope.min(axis=0), slope.max(axis=0)
    return np.array([[1.0, 0.0, -left], [-1.0, 0.0, right], [0.0, 1.0, -top], [0.0, -1.0, bottom]])


@njit(cache=True)
def _cut(start: Array, end: Array, p_nk: Array, R_nk: Array, borders: Array) -> tuple[Array, Array]:
    """Part (E, 2) of edges inside all borders (none: first not smaller), and its ends in the camera (2 E, 3), starts first."""
    count = len(start)
    part, ends_c = np.empty((count, 2)), np.empty((2 * count, 3))
    for e in range(count):
        part[e, 0], part[e, 1] = 0.0, 1.0
        begin, over = ends_c[e], ends_c[count + e]
        _into(start[e], p_nk, R_nk, begin)
        _into(end[e], p_nk, R_nk, over)
        for b in range(len(borders)):
            first = borders[b, 0] * begin[0] + borders[b, 1] * begin[1] + borders[b, 2] * begin[2]
            last = borders[b, 0] * over[0] + borders[b, 1] * over[1] + borders[b, 2] * over[2]
            if first < 0.0 and last < 0.0:
                part[e, 1] = -1.0
            elif first < 0.0:
                part[e, 0] = max(part[e, 0], first / (first - last))
            elif last < 0.0:
                part[e, 1] = min(part[e, 1], first / (first - last))
        for k in range(3):
            along = over[k] - begin[k]
            begin[k] += part[e, 0] * along
            over[k] -= (1.0 - part[e, 1]) * along
    return part, ends_c


@njit(cache=True)
def _in_camera(points: Array, p_nk: Array, R_nk: Array) -> Array:
    x_c = np.empty((len(points), 3))
    for i in range(len(points)):
        _into(points[i], p_nk, R_nk, x_c[i])
    return x_c


@njit(cache=True)
def _into(X: Array, p_nk: Array, R_nk: Array, x_c: Array) -> None:
    n, e, d = X[0] - p_nk[0], X[1] - p_nk[1], X[2] - p_nk[2]
    for k in range(3):
        x_c[k] = n * R_nk[0, k] + e * R_nk[1, k] + d * R_nk[2, k]


@njit(cache=True)
def _spread(
    start: Array, end: Array, part: Array, ends_px: Array, spacing: float, most: int, wanted: Mask
) -> tuple[Array, Array, Indices, Array]:
    """Fields of Samples on parts (E, 2) of edges with ends ends_px (2 E, 2)."""
    count = len(start)
    points, position, edge = np.empty((count * most, 3)), np.empty(count * most), np.empty(count * most, np.int64)
    tau = np.empty(count * most)
    n = 0
    for e in range(count):
        if not (wanted[e] and part[e, 0] < part[e, 1]):
            continue
        length = np.hypot(ends_px[count + e, 0] - ends_px[e, 0], ends_px[count + e, 1] - ends_px[e, 1])
        if np.isnan(length):
            length = spacing * most
        number = min(max(int(length / spacing + 0.5), min(_FEW, int(length / _CLOSEST_PX)), 2), most)
        aside = min(_CORNER_PX / max(length, 1.0), 0.2)
        for i in range(number):
            within = aside + (1.0 - 2.0 * aside) * (i + 0.5) / number
            t = part[e, 0] + (part[e, 1] - part[e, 0]) * within
            position[n], edge[n], tau[n] = t, e, 2.0 * within - 1.0
            for k in range(3):
                points[n, k] = start[e, k] + t * (end[e, k] - start[e, k])
            n += 1
    return points[:n].copy(), position[:n].copy(), edge[:n].copy(), tau[:n].copy()


def view(
    edges: ModelEdges, samples: Samples, eye: Eye, p_n: Array, R_nb: Array, landmarks: Prisms | Sequence[Landmark]
) -> EdgeView:
    """The samples as `eye` sees them."""
    prisms = landmarks if isinstance(landmarks, Prisms) else Prisms.of(landmarks)
    return EdgeView(*viewed(
        samples.points_n, samples.edge, edges.start_n, edges.end_n, *eye.stand(p_n, R_nb), eye.camera.parameters,
        prisms.vertices, prisms.offsets, prisms.base_d, prisms.height_m,
    ))  # fmt: skip


@njit(cache=True)
def viewed(
    points: Array, edge: Indices, start: Array, end: Array, p_n: Array, R_nb: Array, p_bk: Array, R_kb: Array, camera: Array,
    vertices: Array, offsets: Indices, base_d: Array, height: Array,
) -> tuple[Array, Array, Array, Array, Mask]:  # fmt: skip
    """The fields of EdgeView."""
    p_nk, R_nk = _placed(p_n, R_nb, p_bk, R_kb)
    x_c = _in_camera(points, p_nk, R_nk)
    (px, jacobian), direction = projected(x_c, camera), _directions(start, end, R_nk)
    n = len(edge)
    normal, row, unseen = np.empty((n, 2)), np.empty((n, 3)), np.zeros(n, np.bool_)
    for i in range(n):
        _normal_row(jacobian[i], direction[edge[i]], normal[i], row[i])
        unseen[i] = not np.isfinite(px[i, 0] + px[i, 1] + row[i, 0] + row[i, 1] + row[i, 2])
    hide(points, p_nk, vertices, offsets, base_d, height, unseen)
    return px, normal, row, x_c, ~unseen


@njit(cache=True)
def _directions(start: Array, end: Array, R_nk: Array) -> Array:
    direction = np.empty((len(start), 3))
    for e in range(len(start)):
        n, east, d = end[e, 0] - start[e, 0], end[e, 1] - start[e, 1], end[e, 2] - start[e, 2]
        for k in range(3):
            direction[e, k] = n * R_nk[0, k] + east * R_nk[1, k] + d * R_nk[2, k]
    return direction


@njit(cache=True)
def _normal_row(jacobian: Array, direction: Array, normal: Array, row: Array) -> None:
    tu = jacobian[0, 0] * direction[0] + jacobian[0, 1] * direction[1] + jacobian[0, 2] * direction[2]
    tv = jacobian[1, 0] * direction[0] + jacobian[1, 1] * direction[1] + jacobian[1, 2] * direction[2]
    length = np.sqrt(tu * tu + tv * tv)
    normal[0], normal[1] = -tv / length, tu / length
    for k in range(3):
        row[k] = normal[0] * jacobian[0, k] + normal[1] * jacobian[1, k]


def edge_gaps(edges: ModelEdges, samples: Samples, seen: EdgeView, eye: Eye, p_n: Array, R_nb: Array) -> Array:
    """Mean distance (E,) px along the outward normal to the partner edge; 0 without."""
    return np.asarray(partners_off(
        edges.start_n, edges.end_n, edges.partner, samples.edge, samples.t, *eye.stand(p_n, R_nb), eye.camera.parameters, seen.px,
        seen.normal,
    ))  # fmt: skip


@njit(cache=True)
def partners_off(
    start: Array, end: Array, partner: Indices, edge: Indices, t: Array, p_n: Array, R_nb: Array, p_bk: Array, R_kb: Array,
    camera: Array, own_px: Array, own_normal: Array,
) -> Array:  # fmt: skip
    """edge_gaps of the samples' edge (N,), position t (N,), pixels and normals (N, 2)."""
    p_nk, R_nk = _placed(p_n, R_nb, p_bk, R_kb)
    rows, x_c = _on_partners(start, end, partner, edge, t, p_nk, R_nk)
    px, jacobian = projected(x_c, camera)
    return _gaps(rows, px, jacobian, _directions(start, end, R_nk), partner, own_px, own_normal, edge)


@njit(cache=True)
def _on_partners(
    start: Array, end: Array, partner: Indices, edge: Indices, t: Array, p_nk: Array, R_nk: Array
) -> tuple[Indices, Array]:
    """Samples (R,) with a partner, and their points on it in the camera (R, 3)."""
    rows, count = np.empty(len(edge), np.int64), 0
    for i in range(len(edge)):
        if partner[edge[i]] >= 0:
            rows[count] = i
            count += 1
    rows = rows[:count]
    x_c, point = np.empty((len(rows), 3)), np.empty(3)
    for k in range(len(rows)):
        e = partner[edge[rows[k]]]
        for m in range(3):
            point[m] = start[e, m] + t[rows[k]] * (end[e, m] - start[e, m])
        _into(point, p_nk, R_nk, x_c[k])
    return rows, x_c


@njit(cache=True, error_model="numpy")
def _gaps(
    rows: Indices, px: Array, jacobian: Array, direction: Array, partner: Indices, own_px: Array, own_normal: Array, edge: Indices
) -> Array:
    """Mean over an edge's samples of (u_partner - u) . n_partner / n . n_partner."""
    gaps, count, normal, row = np.zeros(len(partner)), np.zeros(len(partner)), np.empty(2), np.empty(3)
    for k in range(len(rows)):
        i = rows[k]
        _normal_row(jacobian[k], direction[partner[edge[i]]], normal, row)
        off = (px[k, 0] - own_px[i, 0]) * normal[0] + (px[k, 1] - own_px[i, 1]) * normal[1]
        off /= own_normal[i, 0] * normal[0] + own_normal[i, 1] * normal[1]
        if np.isfinite(off):
            gaps[edge[i]] += off
            count[edge[i]] += 1.0
    for e in range(len(gaps)):
        gaps[e] /= max(count[e], 1.0)
    return gaps


@njit(cache=True)
def derived(
    row_c: Array, x_c: Array, normal: Array, points: Array, t: Array, edge: Indices, map_start: Array, map_end: Array, p_n: Array,
    R_nb: Array, p_bk: Array, R_kb: Array, camera: Array, own: int, p_bc: Array, t_rc: Array, right: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """n . du of samples: (N, 18 + M) by p_n, theta_n, covariance_bc, covariance_rc, MapError; (N, own) by the camera's own."""
    _, R_nk = _placed(p_n, R_nb, p_bk, R_kb)
    lever_b, R_bk = np.empty(3), np.empty((3, 3))
    for i in range(3):
        lever_b[i] = p_bk[i] - p_bc[i]
        for k in range(3):
            R_bk[i, k] = R_kb[k, i]
    rows = _rows(row_c, x_c, points, t, edge, map_start, map_end, p_n, R_nk, R_bk, lever_b, t_rc, right)
    return rows, _along(normal, parameter_jacobian(x_c, camera), own) if own else np.empty((len(normal), 0))


@njit(cache=True)
def _along(normal: Array, jacobian: Array, columns: int) -> Array:
    """n^T J (N, P) of normals (N, 2) and the first P columns of (N, 2, ...)."""
    rows = np.empty((len(normal), columns))
    for i in range(len(normal)):
        for k in range(columns):
            rows[i, k] = normal[i, 0] * jacobian[i, 0, k] + normal[i, 1] * jacobian[i, 1, k]
    return rows


@njit(cache=True)
def _rows(
    row_c: Array, x_c: Array, points: Array, t: Array, edge: Indices, map_start: Array, map_end: Array, p_n: Array, R_nk: Array,
    R_bk: Array, lever_b: Array, t_rc: Array, right: bool,
) -> Array:  # fmt: skip
    """(N, 18 + M): pose 6, bc 6, rc 6, map M.  row . (q x dtheta) = -(q x row) . dtheta."""
    n, errors = row_c.shape[0], map_start.shape[2]
    rows, row_n, row_b, q = np.zeros((n, MAPPED_FROM + errors)), np.empty(3), np.empty(3), np.empty(3)
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
                out[MAPPED_FROM + k] += row_n[a] * ((1.0 - t[i]) * map_start[e, a, k] + t[i] * map_end[e, a, k])
        if right:
            for a in range(3):
                out[12 + a] = row_k[a]
                q[a] = x_c[i, a] - t_rc[a]
            _minus_cross(row_k, q, out[15:18])
    return rows


@njit(cache=True)
def _turn(R: Array, x: Array, out: Array) -> None:
    for a in range(3):
        out[a] = R[a, 0] * x[0] + R[a, 1] * x[1] + R[a, 2] * x[2]


@njit(cache=True)
def _minus_cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[2] * b[1] - a[1] * b[2]
    out[1] = a[0] * b[2] - a[2] * b[0]
    out[2] = a[1] * b[0] - a[0] * b[1]
