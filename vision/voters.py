"""Points on predicted outlines that vote in the coarse search: which can be told apart there, and how each pose aims them.

Roof edges, and feet and corners of walls as far as they are not drowned by the roof's edge beside them at this size.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.landmarks import Landmark
from models.messages import Array
from vision.motion import enlarged
from vision.pose import Pose
from vision.sensitivity import Eye, Samples, edge_gaps, ends_px, sample_edges, view
from vision.visibility import Kind, ModelEdges, Prisms, visible_edges
from vision.votes import aim

Indices = NDArray[np.int64]
_GAP_PX, _UPRIGHT_PX, _EDGE_PX = 1.5, 3.0, 2.0  # nearer feet of walls, shorter corners, shorter edges are left out
_CHAIN_PX = 8.0  # shorter edges are joined with their neighbours,
_BEND = 0.5  # unless they turn by more than 60 degrees (cosine)
_UPRIGHT = int(Kind.UPRIGHT)
_MOST_ON_EDGE = 24
_LEAST = 4
_LEAST_CHROMA = 30.0  # grey values; a paler map colour has no side


@dataclass(frozen=True, slots=True)
class Voters:
    """N points of E edges of L landmarks, edge by edge.

    points_n, direction_n (N, 3): point, and direction of its edge; mark_of_point (N,); first (E + 1,): points of edge e are
    first[e] to first[e + 1]; mark, length, chroma: as vote() wants them; depth (L,): m, of the roofs below the camera.
    """

    points_n: Array
    direction_n: Array
    mark_of_point: Indices
    first: Indices
    mark: Indices
    length: Array
    chroma: Array
    depth: Array

    def aimed(self, eye: Eye, pose: Pose, gain: Array) -> Array:
        """The points (N, 11) as vote() wants them, from a pose; gain (6, 2): how it goes with a shift of the picture."""
        p_nk, R_nk = eye.pose(*pose)
        return aim(self.points_n, self.direction_n, pose[0], gain, p_nk, R_nk, eye.camera.fx, eye.camera.fy)


def voters(eye: Eye, body: Prisms, chroma: Array, pose: Pose, reach_px: float, most: int) -> Voters | None:
    """About `most` points of what is seen from a pose and comes into the picture within reach_px; None where there is nothing.

    eye: with the camera of the reduced picture, without distortion; chroma (L, 3): chromas() of the landmarks.
    """
    p_nk, _ = eye.pose(*pose)
    eye = Eye(enlarged(eye.camera, math.ceil(reach_px)), eye.R_kb, eye.p_bk, eye.right)
    edges = visible_edges(body, p_nk)
    samples = sample_edges(edges, eye, *pose, 1.0, _MOST_ON_EDGE)
    if len(samples.t) > most:
        samples = sample_edges(edges, eye, *pose, len(samples.t) / most, _MOST_ON_EDGE)
    seen = view(edges, samples, eye, *pose, body)
    gap = np.abs(edge_gaps(edges, samples, seen, eye, *pose))
    length, direction = _in_picture(edges, eye, pose)
    chain = chains(edges.landmark, edges.kind, length, direction)
    total = np.bincount(chain, length)[chain]
    wanted = (total > np.where(edges.kind == Kind.UPRIGHT, _UPRIGHT_PX, _EDGE_PX)) & ((edges.kind != Kind.BASE) | (gap > _GAP_PX))
    chosen = seen.usable & eye.camera.contains(seen.px) & wanted[samples.edge]
    if chosen.sum() < _LEAST:
        return None
    count = np.bincount(chain[samples.edge], minlength=len(total))
    apart = np.bincount(chain, length, len(total)) / np.maximum(count, 1)
    return _chosen(edges, samples, chosen, chain, apart, body, chroma, p_nk)


def _in_picture(edges: ModelEdges, eye: Eye, pose: Pose) -> tuple[Array, Array]:
    """Length (E,) px and direction (E, 2) of the edges in the picture; 0 where an end is behind the camera."""
    ends = ends_px(edges, eye, pose)
    step = np.nan_to_num(ends[len(edges.kind) :] - ends[: len(edges.kind)])
    length = np.linalg.norm(step, axis=1)
    return length, step / np.maximum(length, 1e-9)[:, None]


@njit(cache=True)
def chains(landmark: Indices, kind: Indices, length: Array, direction: Array) -> Indices:
    """Which chain (E,) each edge belongs to: neighbours of one landmark and kind, joined until they are long enough to have a
    direction, unless they turn by much. A curve is a polygon of edges that are too short to be told apart.
    """
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


def _chosen(
    edges: ModelEdges, samples: Samples, chosen: NDArray[np.bool_], chain: Indices, length: Array,
    body: Prisms, chroma: Array, p_nk: Array,
) -> Voters:  # fmt: skip
    edge = samples.edge[chosen]
    chain_ids, first = np.unique(chain[edge], return_index=True)
    ids = edge[first]
    mark = edges.landmark[ids]
    sided = chroma[mark] * (edges.kind[ids] == Kind.ROOF)[:, None]
    depth = body.base_d - body.height_m - p_nk[2]
    return Voters(
        samples.points_n[chosen], (edges.end_n - edges.start_n)[edge], edges.landmark[edge], np.append(first, len(edge)),
        mark, length[chain_ids], sided, depth,
    )  # fmt: skip


def chromas(landmarks: Sequence[Landmark]) -> Array:
    """Unit vectors (L, 3) of the colours without their grey part, 0 where there is none."""
    return np.array([_chroma(mark) for mark in landmarks])


def _chroma(mark: Landmark) -> Array:
    if mark.colour_bgr is None:
        return np.zeros(3)
    chroma = np.array(mark.colour_bgr, dtype=float) - np.mean(mark.colour_bgr)
    size = float(np.linalg.norm(chroma))
    return chroma / size if size > _LEAST_CHROMA else np.zeros(3)
