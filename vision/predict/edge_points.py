"""Voting points on predicted outlines: roof edges, and wall feet and corners distinct from them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.maps.landmarks import Landmark
from models.messages import Array
from vision.outline.visibility import Kind, MapError, Prisms, visible_edges
from vision.pose.pose import Pose
from vision.pose.sensitivity import Eye, edge_gaps, ends_px, sample_edges, view
from vision.predict.motion import enlarged
from vision.predict.votes import aim

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_GAP_PX, _UPRIGHT_PX, _EDGE_PX = 1.5, 3.0, 2.0  # nearer feet of walls, shorter corners, shorter edges are left out
_CHAIN_PX = 8.0  # shorter edges are joined with their neighbours,
_BEND = 0.5  # unless they turn by more than 60 degrees (cosine)
_ROOF, _BASE, _UPRIGHT = int(Kind.ROOF), int(Kind.BASE), int(Kind.UPRIGHT)  # compiled code reads plain integers
_MOST_ON_EDGE = 24
_LEAST = 4
_GROWTH, _LEAST_M = int(MapError.GROWTH), 1e-9  # corners of walls point nowhere
_LEAST_CHROMA = 30.0  # grey values; a paler map colour has no side


@dataclass(frozen=True, slots=True)
class EdgePoints:
    """N points of E edges of L landmarks, edge by edge.

    points_n, direction_n (N, 3); mark_of_point (N,); first (E + 1,): points of edge e are first[e] to first[e + 1]; mark, length,
    chroma: as vote(); depth (L,): m, roofs below the camera.
    """

    points_n: Array
    direction_n: Array
    mark_of_point: Indices
    first: Indices
    mark: Indices
    length: Array
    chroma: Array
    depth: Array

    def moved(self, shift_m: Array) -> Array:
        """Points (N, 3) with map errors shift_m (L, M): shift and growth; wall corners do not grow."""
        return np.asarray(_moved(self.points_n, self.direction_n, self.mark_of_point, shift_m))

    def middles(self, marks: int) -> Array:
        """The mean (L, 3) of each landmark's points; NaN where it has none."""
        count = np.bincount(self.mark_of_point, minlength=marks)[:, None]
        sums = np.stack([np.bincount(self.mark_of_point, along, marks) for along in self.points_n.T], axis=1)
        return np.where(count > 0, sums / np.maximum(count, 1), np.nan)

    def aimed(self, eye: Eye, pose: Pose, gain: Array, shift_m: Array | None = None) -> Array:
        """Points (N, 11) for vote() from a pose; gain (6, 2): pose per image shift; shift_m: as moved()."""
        points_n = self.points_n if shift_m is None else self.moved(shift_m)
        return aim(points_n, self.direction_n, pose[0], gain, *eye.pose(*pose), eye.camera.fx, eye.camera.fy)


def edge_points(eye: Eye, body: Prisms, chroma: Array, pose: Pose, reach_px: float, most: int) -> EdgePoints | None:
    """About `most` points within reach_px of the image; None without any.

    eye: reduced undistorted camera; chroma (L, 3): chromas() of the landmarks.
    """
    p_nk, _ = eye.pose(*pose)
    eye = Eye(enlarged(eye.camera, math.ceil(reach_px)), eye.R_kb, eye.p_bk, eye.right)
    edges = visible_edges(body, p_nk)
    samples = sample_edges(edges, eye, *pose, 1.0, _MOST_ON_EDGE)
    if len(samples.t) > most:
        samples = sample_edges(edges, eye, *pose, len(samples.t) / most, _MOST_ON_EDGE)
    seen = view(edges, samples, eye, *pose, body)
    rows, first, ids, length = _chosen(
        edges.landmark, edges.kind, ends_px(edges, eye, pose), edge_gaps(edges, samples, seen, eye, *pose), samples.edge, seen.px,
        seen.usable, eye.camera.width, eye.camera.height,
    )  # fmt: skip
    if len(rows) < _LEAST:
        return None
    edge, mark = samples.edge[rows], edges.landmark[ids]
    sided = chroma[mark] * (edges.kind[ids] == _ROOF)[:, None]
    return EdgePoints(
        samples.points_n[rows], (edges.end_n - edges.start_n)[edge], edges.landmark[edge], first, mark, length, sided,
        body.base_d - body.height_m - p_nk[2],
    )  # fmt: skip


@njit(cache=True)
def _moved(points: Array, direction: Array, mark: Indices, shift_m: Array) -> Array:
    """Points (N, 3) on edges of direction (N, 3), roof to the left, of landmarks (N,) off by shift_m (L, M)."""
    moved = points.copy()
    for i in range(len(points)):
        off, n, e = shift_m[mark[i]], direction[i, 0], direction[i, 1]
        grown = off[_GROWTH] / max(math.hypot(n, e), _LEAST_M)
        moved[i, 0] += off[0] - grown * e
        moved[i, 1] += off[1] + grown * n
    return moved


@njit(cache=True)
def _chosen(
    landmark: Indices, kind: Indices, ends: Array, gap: Array, edge: Indices, px: Array, usable: Mask, width: int, height: int
) -> tuple[Indices, Indices, Indices, Array]:
    """Voting samples (N,), chain by chain; chain starts and first edges (C + 1,), (C,), px per sample (C,).

    ends (2 E, 2) px, starts first; gap (E,) px to the partner; edge (S,), px (S, 2), usable (S,).
    """
    edges = len(kind)
    size, direction = np.zeros(edges), np.zeros((edges, 2))
    for e in range(edges):
        du, dv = ends[edges + e, 0] - ends[e, 0], ends[edges + e, 1] - ends[e, 1]
        if np.isfinite(du) and np.isfinite(dv):  # else an end is behind the camera
            size[e] = np.sqrt(du * du + dv * dv)
            direction[e, 0], direction[e, 1] = du / max(size[e], 1e-9), dv / max(size[e], 1e-9)
    chain = chains(landmark, kind, size, direction)
    total, count = np.zeros(edges), np.zeros(edges)
    for e in range(edges):
        total[chain[e]] += size[e]
    for i in range(len(edge)):
        count[chain[edge[i]]] += 1.0
    rows, first, ids = np.empty(len(edge), np.int64), np.empty(edges + 1, np.int64), np.empty(edges, np.int64)
    length, n, found = np.empty(edges), 0, 0
    for i in range(len(edge)):
        e = edge[i]
        large = total[chain[e]] > (_UPRIGHT_PX if kind[e] == _UPRIGHT else _EDGE_PX)
        apart = kind[e] != _BASE or abs(gap[e]) > _GAP_PX
        inside = -0.5 <= px[i, 0] <= width - 0.5 and -0.5 <= px[i, 1] <= height - 0.5
        if not (usable[i] and large and apart and inside):
            continue
        if n == 0 or chain[e] != chain[edge[rows[n - 1]]]:
            first[found], ids[found], length[found] = n, e, total[chain[e]] / count[chain[e]]
            found += 1
        rows[n] = i
        n += 1
    first[found] = n
    return rows[:n].copy(), first[: found + 1].copy(), ids[:found].copy(), length[:found].copy()


@njit(cache=True)
def chains(landmark: Indices, kind: Indices, length: Array, direction: Array) -> Indices:
    """Chain (E,) of each edge: neighbours of one landmark and kind joined until long enough, unless they turn much."""
    chain = np.zeros(len(kind), np.int64)
    begin, total = 0, 0.0
    for e in range(len(kind)):
        new = e == 0
        if not new:
            cosine = direction[e, 0] * direction[begin, 0] + direction[e, 1] * direction[begin, 1]
            same = landmark[e] == landmark[begin] and kind[e] == kind[begin] and kind[e] != _UPRIGHT
            new = not same or total >= _CHAIN_PX or cosine < _BEND
        if new:
            begin, total = e, 0.0
        total += length[e]
        chain[e] = chain[e - 1] + 1 if new and e > 0 else chain[max(e - 1, 0)]
    return chain


def chromas(landmarks: Sequence[Landmark]) -> Array:
    """Unit vectors (L, 3) of the colours without their grey part, 0 where there is none."""
    colour = np.array([mark.colour_bgr or (0, 0, 0) for mark in landmarks], dtype=np.float64).reshape(-1, 3)
    chroma = colour - np.mean(colour, axis=1, keepdims=True)
    size = np.linalg.norm(chroma, axis=1, keepdims=True)
    return np.where(size > _LEAST_CHROMA, chroma / np.maximum(size, _LEAST_CHROMA), 0.0)
