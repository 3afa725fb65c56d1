"""Final check: do outlines lie where the fit says, in both images alike?

    r_right,i - r_left,i = n_i . (du, dv) + e_i         (offsets along the normals of the same points in the two images, px)

A landmark that mostly disagrees is absent; swapped, unsynchronised or foreign images differ by a common shift.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order
from models.camera import StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.image.rectify import Image
from vision.outline import edge_search
from vision.outline.visibility import Kind, Prisms, visible_edges
from vision.pose import small_landmarks
from vision.pose.observation import ObservationConfig, channels, distance_from_roof
from vision.pose.pose import PoseEstimate
from vision.pose.sensitivity import ends_of, eyes, partners_off, sample_edges, viewed
from vision.predict.presence import across, log_likelihood_ratio, small_missed

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Drawn = tuple[Array, Array, Indices, Indices, Indices, Mask]
OnRoofs = tuple[Array, Indices, Indices, Mask]
OnWalls = tuple[Array, Array, Indices]
Bodies = tuple[Array, Indices, Array, Array]
Stand = tuple[Array, Array, Array, Array]
_ROOF = int(Kind.ROOF)
_HALF_PX = 8
_NEAR_PX = 2.5  # an edge farther off than this is not the one that was fitted,
_OF_MAP = 2.0  # and so many standard deviations of the map's outline, both squared,
_FARTHEST_PX = 4.0  # but half the window at most: else anything in it would do
_GAP_PX = 4.0  # feet of walls nearer to the roof's edge say nothing by themselves
_LEAST = 12  # points in both images that tell a shift
_ROUNDS = 4
_TUKEY = 4.7
_CORRELATED = 4.0  # neighbouring points on an edge are not independent
_FLOOR_PX = 0.2
_REGULAR, _LEAST_INFORMATION = 1e-3, 2.0  # points across the direction that is measured worst


@dataclass(frozen=True, slots=True)
class FinalCheck:
    """share (L,) of each visible roof that agrees, NaN where none can be examined.

    images: the same per image; present (L,): log odds standing / gone (presence.py); covered: share of all roofs covered in every
    image; apart: (du, dv) right against left, px, and sigma, or None.
    """

    share: Array
    present: Array
    images: tuple[float, ...]
    covered: float
    apart: tuple[float, float, float] | None


class _Checked(NamedTuple):
    """Roof samples of an image: offsets (N,) px, normals (N, 2), x_c (N, 3) m; usable, hidden (N,); across() (E, C + 1) of roofs,
    walls.
    """

    offset: Array
    normal: Array
    x_c: Array
    usable: Mask
    hidden: Mask
    sums: Array


def final_check(
    rig: StereoRig,
    views: Sequence[Image | None],
    landmarks: Sequence[Landmark],
    fit: PoseEstimate,
    observation: ObservationConfig,
) -> FinalCheck:
    """Examine the roofs from the joint pose."""
    pose, as_mapped = (fit.joint_p_n, fit.joint_R_nb), Prisms.of(landmarks)
    shown = [(eye, channels(image)) for eye, image in zip(eyes(rig), views, strict=True) if image is not None]
    prisms, edges = as_mapped.moved(fit.shift_m), visible_edges(as_mapped, shown[0][0].pose(*pose)[0], fit.shift_m)
    block, is_small = small_landmarks.blocks(edges, shown[0][0], pose)
    roofs = small_landmarks.sampled(
        edges, shown[0][0], pose, 1.5 * observation.spacing_px, observation.most_points, edges.kind == _ROOF, is_small
    )
    walls = sample_edges(
        edges, shown[0][0], *pose, 1.5 * observation.spacing_px, observation.most_points, (edges.kind != _ROOF) & ~is_small
    )
    outline_sigma = np.array([one.outline_sigma_m for one in landmarks])
    found, given = np.zeros((2, len(shown), len(landmarks)))
    drawn = edges.start_n, edges.end_n, edges.landmark, edges.kind, edges.partner, edges.raised
    bodies = prisms.vertices, prisms.offsets, prisms.base_d, prisms.height_m
    on_roofs = roofs.points_n, roofs.edge, block[roofs.edge], is_small[roofs.edge]
    on_walls = walls.points_n, walls.t, walls.edge
    seen = [_checked(image, drawn, on_roofs, on_walls, bodies, eye.stand(*pose), eye.camera.parameters) for eye, image in shown]
    offsets, normals, sums = [one.offset for one in seen], [one.normal for one in seen], [one.sums for one in seen]
    hidden = np.logical_and.reduce([one.hidden for one in seen])
    asked = np.logical_and.reduce([one.usable for one in seen])
    for k, ((eye, _), one) in enumerate(zip(shown, seen, strict=True)):
        slack = _OF_MAP * eye.camera.fx * outline_sigma
        _count(one.offset, one.usable & ~hidden, one.x_c, roofs.edge, edges.landmark, slack, found[k], given[k])
    images = tuple((found.sum(axis=1) / np.maximum(given.sum(axis=1), 1.0)).tolist())
    apart = _shift(offsets[1] - offsets[0], normals[0]) if len(shown) == 2 else None
    present = log_likelihood_ratio(sums, edges.landmark, len(landmarks), np.where(is_small, int(Kind.SMALL), edges.kind))
    found, given = found.sum(axis=0), given.sum(axis=0)
    share, small = np.where(given > 0.0, found / np.maximum(given, 1.0), np.nan), np.unique(edges.landmark[is_small])
    present[small] = small_missed(present[small], share[small])
    return FinalCheck(share, present, images, float(hidden.sum() / max(asked.sum(), 1)), apart)


def _checked(image: Image, drawn: Drawn, roofs: OnRoofs, walls: OnWalls, bodies: Bodies, stand: Stand, camera: Array) -> _Checked:
    """drawn: ModelEdges; roofs: Samples, blocks, small ones; walls: Samples; bodies: Prisms; stand: Eye.stand.

    Wall feet near the roof's edge share its gradient and do not count.
    """
    start, end, landmark, kind, partner, raised = drawn
    points, edge, block, of_small = roofs
    px, normal, _, x_c, seen = viewed(points, edge, start, end, *stand, camera, *bodies)
    ends = ends_of(start, end, *stand, camera)
    distance, usable, hidden = distance_from_roof(
        image, px, normal, seen & ~of_small, edge, kind, raised, landmark, partner, ends, _HALF_PX
    )
    offset = edge_search.search(distance, edge, len(kind), 1.0, usable)
    small_landmarks.measure(image, px, normal, of_small, block, _HALF_PX, seen, offset, usable)
    sums = across(image, px, normal, block, len(kind), seen)
    points, t, edge = walls
    px, along, _, _, seen = viewed(points, edge, start, end, *stand, camera, *bodies)
    gap = partners_off(start, end, partner, edge, t, *stand, camera, px, along)
    apart = (partner < 0) | (np.abs(gap) > _GAP_PX)
    sums += across(image, px, along, edge, len(kind), seen & apart[edge])
    return _Checked(offset, normal, x_c, usable, hidden, sums)


@njit(cache=True)
def _count(
    offset: Array, usable: Mask, x_c: Array, edge: Indices, landmark: Indices, slack: Array, found: Array, given: Array
) -> None:
    """Count usable points per landmark in given (L,), near ones (offset (N,) px) in found (L,).

    x_c (N, 3) m in the camera; edge (N,), landmark (E,); slack (L,): map's outline error, px m.
    """
    for i in range(len(offset)):
        if usable[i]:
            m = landmark[edge[i]]
            given[m] += 1.0
            if abs(offset[i]) < min(math.hypot(_NEAR_PX, slack[m] / max(x_c[i, 2], 1e-3)), _FARTHEST_PX):
                found[m] += 1.0


def _shift(difference: Array, normal: Array) -> tuple[float, float, float] | None:
    """(du, dv) and their sigma; None with too few points (N,), NaN: no offset."""
    du, dv, sigma = _common_shift(difference, normal)
    return None if math.isnan(sigma) else (du, dv, sigma)


@njit(cache=True)
def _common_shift(difference: Array, normal: Array) -> tuple[float, float, float]:
    """(du, dv) = (sum w n n^T)^-1 sum w n d, robust (Huber, then Tukey); sigma, NaN if unmeasured."""
    good, count = np.empty(len(difference), np.int64), 0
    for i in range(len(difference)):
        if math.isfinite(difference[i]):
            good[count] = i
            count += 1
    good = good[:count]
    if len(good) < _LEAST:
        return 0.0, 0.0, np.nan
    weight, z = np.ones(len(good)), np.empty(len(good))
    du = dv = scale = uu = uv = vv = 0.0
    for k in range(_ROUNDS + 1):
        uu = uv = vv = bu = bv = 0.0
        for i in range(len(good)):
            nu, nv, d, w = normal[good[i], 0], normal[good[i], 1], difference[good[i]], weight[i]
            uu, uv, vv = uu + w * nu * nu, uv + w * nu * nv, vv + w * nv * nv
            bu, bv = bu + w * nu * d, bv + w * nv * d
        if k == _ROUNDS:
            break
        a, c = uu + _REGULAR, vv + _REGULAR
        du, dv = (c * bu - uv * bv) / (a * c - uv * uv), (a * bv - uv * bu) / (a * c - uv * uv)
        for i in range(len(good)):
            z[i] = abs(difference[good[i]] - normal[good[i], 0] * du - normal[good[i], 1] * dv)
        scale = max(1.4826 * order.median(z), _FLOOR_PX)
        for i in range(len(good)):
            r = z[i] / scale
            weight[i] = 1.0 / max(r, 1.0) if k < _ROUNDS // 2 else max(1.0 - (r / _TUKEY) ** 2, 0.0) ** 2
    if 0.5 * (uu + vv) - math.hypot(0.5 * (uu - vv), uv) < _LEAST_INFORMATION:
        return 0.0, 0.0, np.nan
    return du, dv, scale * math.sqrt(_CORRELATED * max(uu, vv) / (uu * vv - uv * uv))
