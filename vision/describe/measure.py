"""A region and its disparities to metres (docs/vision.md, section 7).

    Z = f b / (d - offset)                                                       (thesis eq. 3.128; offset = cx_l - cx_r)
    1 / Z = A x + B y + C  for  d = c + p (u - u0) + q (v - v0):  A = p / b, B = q / b, C = (c - offset + ...) / (f b)

Covariance by perturbation of the plane, each outline side, all sides together (blur), and the rig.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from models.camera import StereoRig
from models.maps import outline as polygon
from models.messages import Array
from vision.describe.correspond import Match, disparity_offset
from vision.describe.plane import DisparityPlane
from vision.describe.regions import Region

QUANTITIES = ("distance_m", "width_m", "length_m", "size_m2", "fill_ratio")  # the order of Measured.covariance

_CENTRE, _SIZES, _ORIENTATION = slice(0, 3), slice(3, 8), 8  # of a row of _quantities
_ARCS = 4  # a contour that is no polygon is uncertain in so many pieces, one by one
_CORRELATED_PX = 4.0  # along an edge: its points err together over so far


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors beyond the images' scatter, and limits of measuring."""

    disparity_px: float = 0.03  # of a region as a whole: interpolation, edges that hide what is behind them
    edge_px: float = 0.05  # of a side of an outline
    all_edges_px: float = 0.06  # of all sides alike, outwards
    most_depth_sigma: float = 0.25  # relative; beyond it a distance is no distance


# Of recorded images: flat regions of KITTI 06 are 0.2 px off in the median (lens, rectification, JPEG: not in their scatter).
RECORDED = Accuracy(disparity_px=0.2)


@dataclass(frozen=True, slots=True)
class Level:
    """The surface's normal as known from elsewhere (a level roof, the filter's attitude)."""

    normal_c: Array  # (3,) unit
    sigma_rad: float


@dataclass(frozen=True, slots=True)
class Measured:
    """A region in metres, in the frame c of the left rectified camera.

    centre_c          (3,) centroid of the outline on its plane, m;  covariance_c (3, 3)
    normal_c          (3,) unit normal, towards the camera
    axis_c            (3,) unit vector along the length, either sign
    outline_c         (K, 3) region.outline on the plane, m
    width_m, length_m sides of the smallest rectangle around it, width <= length
    size_m2           area inside it;  fill_ratio: size / (width length), thesis section 5.4
    orientation_rad   axis_c from x_c towards y_c on the plane, [0, pi);  orientation_sigma_rad
    covariance        (5, 5) of (distance, width, length, size, fill ratio)
    disparity_px      f b / Z at the centre;  disparity_sigma_px: own, rig_sigma_px: common to all regions
    """

    region: Region
    centre_c: Array
    covariance_c: Array
    normal_c: Array
    axis_c: Array
    outline_c: Array
    distance_m: float
    width_m: float
    length_m: float
    size_m2: float
    fill_ratio: float
    orientation_rad: float
    orientation_sigma_rad: float
    covariance: Array
    disparity_px: float
    disparity_sigma_px: float
    rig_sigma_px: float

    def sigma(self, quantity: str) -> float:
        """Standard deviation of one of QUANTITIES."""
        i = QUANTITIES.index(quantity)
        return float(np.sqrt(self.covariance[i, i]))


@dataclass(frozen=True, slots=True)
class Unmeasured:
    """A region without metric size, and why."""

    region: Region
    reason: str


def measure(match: Match, rig: StereoRig, accuracy: Accuracy | None = None, level: Level | None = None) -> Measured | Unmeasured:
    """A matched region in metres; rig: rectified."""
    accuracy = accuracy or Accuracy()
    outline = match.region.outline
    plane = match.plane if level is None else _levelled(match.plane, level, rig)
    centre = outline.mean(axis=0)
    disparity = float(plane.at(centre[None])[0]) - disparity_offset(rig)
    own = plane.covariance.copy()
    own[0, 0] += accuracy.disparity_px**2
    row = np.concatenate(([1.0], centre - plane.origin))
    sigma = float(np.sqrt(row @ own @ row))
    if disparity <= 0.0:
        return Unmeasured(match.region, f"disparity {disparity:.1f} px: behind the camera")
    if sigma > accuracy.most_depth_sigma * disparity:
        return Unmeasured(match.region, f"too far: disparity {disparity:.2f} +- {sigma:.2f} px")
    from_rig = _rig_error(rig, plane, outline, disparity)
    values, of_plane, bends, of_sides = _spread(match.region, plane, own + from_rig, rig)
    if not np.isfinite(of_plane).all():
        return Unmeasured(match.region, "the plane is seen edge-on")
    of_all = accuracy.all_edges_px * of_sides[:, : len(outline) if match.region.corners is not None else _ARCS].sum(axis=1)
    of_sides = of_sides * _side_sigmas(match.region, accuracy)
    covariance = of_plane @ of_plane.T + 3.0 * bends @ bends.T + of_sides @ of_sides.T + np.outer(of_all, of_all)
    inverse_depth = _inverse_depth(plane, rig)
    normal = -inverse_depth / np.linalg.norm(inverse_depth)
    e1, e2 = _axes(normal)
    turn = float(values[_ORIENTATION])
    rays = np.column_stack(((outline - (rig.left.cx, rig.left.cy)) / (rig.left.fx, rig.left.fy), np.ones(len(outline))))
    return Measured(
        region=match.region,
        centre_c=values[_CENTRE],
        covariance_c=covariance[_CENTRE, _CENTRE],
        normal_c=normal,
        axis_c=np.cos(turn) * e1 + np.sin(turn) * e2,
        outline_c=rays / (rays @ inverse_depth)[:, None],
        distance_m=float(values[3]),
        width_m=float(values[4]),
        length_m=float(values[5]),
        size_m2=float(values[6]),
        fill_ratio=float(values[7]),
        orientation_rad=turn,
        orientation_sigma_rad=float(np.sqrt(covariance[_ORIENTATION, _ORIENTATION])),
        covariance=covariance[_SIZES, _SIZES],
        disparity_px=float(rig.left.fx * rig.baseline_m / values[2]),
        disparity_sigma_px=sigma,
        rig_sigma_px=float(np.sqrt(row @ from_rig @ row)),
    )


def _inverse_depth(plane: DisparityPlane, rig: StereoRig) -> Array:
    """(A, B, C): 1 / Z = A x + B y + C, x = X / Z, y = Y / Z."""
    camera = rig.left
    c, p, q = plane.coefficients
    middle = c - disparity_offset(rig) + p * (camera.cx - plane.origin[0]) + q * (camera.cy - plane.origin[1])
    return np.array([p * camera.fx, q * camera.fy, middle]) / (camera.fx * rig.baseline_m)


def _axes(normal: Array) -> tuple[Array, Array]:
    """Unit vectors on a plane: e1 nearest to x_c, e2 turned from it towards y_c."""
    e1 = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(e1, normal)


def _levelled(plane: DisparityPlane, level: Level, rig: StereoRig) -> DisparityPlane:
    """The plane with a known normal: p = b A, q = b B, (A, B, C) along -n; a Kalman update of (p, q)."""
    camera = rig.left
    ray = np.array([(plane.origin[0] - camera.cx) / camera.fx, (plane.origin[1] - camera.cy) / camera.fy, 1.0])
    depth_of_disparity = (plane.coefficients[0] - disparity_offset(rig)) / camera.fx
    facing = -level.normal_c @ ray
    if abs(facing) < 0.1:
        return plane
    expected = -level.normal_c[:2] / facing * depth_of_disparity
    H = np.eye(3)[1:]
    R = np.eye(2) * (level.sigma_rad * depth_of_disparity / facing**2) ** 2
    gain = plane.covariance @ H.T @ np.linalg.inv(H @ plane.covariance @ H.T + R)
    coefficients = plane.coefficients + gain @ (expected - plane.coefficients[1:])
    covariance = (np.eye(3) - gain @ H) @ plane.covariance
    return DisparityPlane(plane.origin, coefficients, 0.5 * (covariance + covariance.T), plane.scatter, plane.used)


def _rig_error(rig: StereoRig, plane: DisparityPlane, outline: Array, disparity: float) -> Array:
    """(3, 3) covariance of the plane's coefficients by the right camera's pose and the lenses.

    x_r = exp(theta) x_r0 + dt moves a point's right pixel by
    du = f / Z (dt_x - x dt_z + (1 + x^2) Z theta_y - x y Z theta_x - y Z theta_z),  x, y in the right camera: an error of d.
    """
    if rig.covariance_rc is None and rig.left.covariance is None and rig.right.covariance is None:
        return np.zeros((3, 3))
    camera, extent = rig.left, max(float(np.ptp(outline, axis=0).max()), 1.0)
    offsets = np.array([[0.0, 0.0], [extent, 0.0], [0.0, extent]])
    px = plane.origin + offsets - (disparity + disparity_offset(rig), 0.0)
    x, y = (px[:, 0] - rig.right.cx) / camera.fx, (px[:, 1] - rig.right.cy) / camera.fy
    f_z = disparity / rig.baseline_m
    f = camera.fx
    by_pose = np.column_stack((np.full(3, f_z), np.zeros(3), -x * f_z, -x * y * f, (1.0 + x * x) * f, -y * f))
    to_plane = np.linalg.inv(np.column_stack((np.ones(3), offsets)))
    error = np.zeros((3, 3))
    if rig.covariance_rc is not None:
        error += by_pose @ rig.covariance_rc @ by_pose.T
    for lens in (rig.left, rig.right):
        if lens.covariance is not None:
            by_lens = np.column_stack((x, np.ones(3)))  # of fx, cx
            error += by_lens @ lens.covariance[np.ix_((0, 2), (0, 2))] @ by_lens.T
    return np.asarray(to_plane @ error @ to_plane.T)


def _side_sigmas(region: Region, accuracy: Accuracy) -> Array:
    """Position and turn of each outline side, px; fitted sides average their points, arcs do not."""
    if region.corners is None:
        return np.full(_ARCS, np.hypot(region.edge_sigma_px, accuracy.edge_px))
    length = np.linalg.norm(np.roll(region.corners, -1, axis=0) - region.corners, axis=1)
    variance = region.edge_sigma_px**2 / np.maximum(length / _CORRELATED_PX, 1.0)
    return np.sqrt(np.concatenate((variance, 3.0 * variance)) + accuracy.edge_px**2)


def _spread(region: Region, plane: DisparityPlane, covariance: Array, rig: StereoRig) -> tuple[Array, Array, Array, Array]:
    """Centre, distance, width, length, size, fill ratio, orientation (9,); their change with each plane sigma s, linear (9, 3)
    and quadratic (9, 3); per pixel with each side (9, S).

    A rectangle's fill ratio changes with the square of a tilt only: y(+-s) = y +- a s + q s^2, second moment 3 q^2.
    """
    outline = region.outline
    moves = _side_moves(outline) if region.corners is not None else _arc_moves(outline)
    steps = np.linalg.cholesky(covariance + 1e-18 * np.eye(3)).T
    outlines = np.concatenate((np.repeat(outline[None], 7, axis=0), outline + 1e-3 * moves))
    planes = np.repeat(plane.coefficients[None], len(outlines), axis=0)
    planes[1:4] += steps
    planes[4:7] -= steps
    camera = np.array([rig.left.fx, rig.left.fy, rig.left.cx, rig.left.cy, rig.baseline_m, disparity_offset(rig)])
    table = _quantities(outlines, planes, plane.origin, camera)
    change = table[1:] - table[0]
    quarter = 0.5 * np.pi  # a square's length may become its width
    change[:, _ORIENTATION] = (change[:, _ORIENTATION] + 0.5 * quarter) % quarter - 0.5 * quarter
    up, down = change[:3].T, change[3:6].T
    return table[0], 0.5 * (up - down), 0.5 * (up + down), change[6:].T / 1e-3


@njit(cache=True)
def _side_moves(corners: Array) -> Array:
    """(2 K, K, 2): moves of the corners when side i moves outwards by one; then, turns by one at its ends."""
    count = corners.shape[0]
    normals, moves = np.empty((count, 2)), np.zeros((2 * count, count, 2))
    for i in range(count):
        after = corners[(i + 1) % count]
        du, dv = after[0] - corners[i, 0], after[1] - corners[i, 1]
        normals[i, 0], normals[i, 1] = -dv / np.hypot(du, dv), du / np.hypot(du, dv)
    for i in range(count):  # the corner where side i begins: n_before . m = 0 or 1, n_i . m = 1 or 0
        before = (i - 1) % count
        a, b = normals[before], normals[i]
        det = a[0] * b[1] - a[1] * b[0]
        moves[i, i, 0], moves[i, i, 1] = -a[1] / det, a[0] / det
        moves[before, i, 0], moves[before, i, 1] = b[1] / det, -b[0] / det
        for k in range(2):
            moves[count + i, i, k], moves[count + before, i, k] = -moves[i, i, k], moves[before, i, k]
    return moves


@njit(cache=True)
def _arc_moves(contour: Array) -> Array:
    """(_ARCS, N, 2): moves of the points when one arc of the contour moves outwards by one."""
    count = contour.shape[0]
    moves = np.zeros((_ARCS, count, 2))
    for i in range(count):
        after, before = contour[(i + 2) % count], contour[(i - 2) % count]
        du, dv = after[0] - before[0], after[1] - before[1]
        length = max(np.hypot(du, dv), 1e-9)
        arc = i * _ARCS // count
        moves[arc, i, 0], moves[arc, i, 1] = -dv / length, du / length
    return moves


@njit(cache=True)
def _quantities(outlines: Array, planes: Array, origin: Array, camera: Array) -> Array:
    """(M, 9) of outlines (M, K, 2) on planes (M, 3); camera: fx fy cx cy baseline offset. NaN behind it."""
    fx, fy, cx, cy, baseline, offset = camera
    count, corners = outlines.shape[0], outlines.shape[1]
    table, flat, bounds = np.full((count, 9), np.nan), np.empty((corners, 2)), np.empty(2, np.int64)
    n, normal, foot, e1, e2, ray = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.ones(3)
    bounds[0], bounds[1] = 0, corners
    for m in range(count):
        c, p, q = planes[m, 0], planes[m, 1], planes[m, 2]
        n[0], n[1], n[2] = p * fx, q * fy, c - offset + p * (cx - origin[0]) + q * (cy - origin[1])
        square, length = 0.0, 0.0
        for a in range(3):
            n[a] /= fx * baseline
            square += n[a] * n[a]
        for a in range(3):
            normal[a], foot[a] = -n[a] / np.sqrt(square), n[a] / square  # foot: the plane's nearest point to the camera
        for a in range(3):
            e1[a] = (1.0 if a == 0 else 0.0) - normal[0] * normal[a]
            length += e1[a] * e1[a]
        for a in range(3):
            e1[a] /= np.sqrt(length)
        for a in range(3):
            b, d = (a + 1) % 3, (a + 2) % 3
            e2[a] = e1[b] * normal[d] - e1[d] * normal[b]
        behind = False
        for k in range(corners):
            ray[0], ray[1], inverse = (outlines[m, k, 0] - cx) / fx, (outlines[m, k, 1] - cy) / fy, 0.0
            for a in range(3):
                inverse += ray[a] * n[a]
            if inverse <= 0.0:
                behind = True
                break
            flat[k, 0] = flat[k, 1] = 0.0
            for a in range(3):
                x = ray[a] / inverse - foot[a]
                flat[k, 0] += x * e1[a]
                flat[k, 1] += x * e2[a]
        if behind:
            continue
        row, square = polygon.describe(flat, bounds)[0], 0.0
        for a in range(3):
            table[m, a] = foot[a] + row[polygon.NORTH] * e1[a] + row[polygon.EAST] * e2[a]
            square += table[m, a] * table[m, a]
        table[m, 3] = np.sqrt(square)
        table[m, 4], table[m, 5] = row[polygon.WIDTH], row[polygon.LENGTH]
        table[m, 6], table[m, 7], table[m, 8] = row[polygon.SIZE], row[polygon.FILL], row[polygon.ORIENTATION]
    return table
