"""Points on predicted outlines that vote in the coarse search: which can be told apart there, and how each pose aims them.

Roof edges, and feet and corners of walls as far as they are not drowned by the roof's edge beside them at this size.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.landmarks import Landmark
from models.messages import Array
from vision.pose import Pose
from vision.sensitivity import Eye, Samples, edge_gaps, sample_edges, view
from vision.visibility import Kind, ModelEdges, Prisms, visible_edges
from vision.votes import aim

Indices = NDArray[np.int64]
_GAP_PX, _UPRIGHT_PX, _EDGE_PX = 1.5, 3.0, 2.0  # nearer feet of walls, shorter corners, shorter edges are left out
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


def voters(eye: Eye, landmarks: Sequence[Landmark], body: Prisms, pose: Pose, reach_px: float, most: int) -> Voters | None:
    """About `most` points of what is seen from a pose and comes into the picture within reach_px; None where there is nothing.

    eye: with the camera of the reduced picture, without distortion.
    """
    p_nk, _ = eye.pose(*pose)
    edges = visible_edges(body, p_nk)
    samples = sample_edges(edges, eye, *pose, 1.0, _MOST_ON_EDGE)
    if len(samples.t) > most:
        samples = sample_edges(edges, eye, *pose, len(samples.t) / most, _MOST_ON_EDGE)
    seen = view(edges, samples, eye, *pose, body)
    length = _length(seen.px, samples, len(edges.kind))
    gap = np.abs(edge_gaps(edges, samples, seen, eye, *pose))
    count = np.bincount(samples.edge, minlength=len(edges.kind))
    wanted = (length * count > np.where(edges.kind == Kind.UPRIGHT, _UPRIGHT_PX, _EDGE_PX)) & (
        (edges.kind != Kind.BASE) | (gap > _GAP_PX)
    )
    chosen = seen.usable & eye.camera.contains(seen.px, -reach_px) & wanted[samples.edge]
    if chosen.sum() < _LEAST:
        return None
    return _chosen(edges, samples, chosen, length, landmarks, p_nk)


def _chosen(
    edges: ModelEdges, samples: Samples, chosen: NDArray[np.bool_], length: Array, landmarks: Sequence[Landmark], p_nk: Array
) -> Voters:
    edge = samples.edge[chosen]
    ids, first = np.unique(edge, return_index=True)
    mark = edges.landmark[ids]
    chroma = np.array([_chroma(m) for m in landmarks])[mark] * (edges.kind[ids] == Kind.ROOF)[:, None]
    depth = np.array([m.roof_d for m in landmarks]) - p_nk[2]
    return Voters(
        samples.points_n[chosen], (edges.end_n - edges.start_n)[edge], edges.landmark[edge], np.append(first, len(edge)),
        mark, length[ids], chroma, depth,
    )  # fmt: skip


def _length(px: Array, samples: Samples, count: int) -> Array:
    """Picture length (E,) that one point of each edge stands for: the mean distance of neighbours."""
    step = np.linalg.norm(px[1:] - px[:-1], axis=1)
    good = (samples.edge[1:] == samples.edge[:-1]) & np.isfinite(step)
    edge = samples.edge[1:][good]
    total = np.bincount(edge, step[good], minlength=count)
    return np.asarray(total / np.maximum(np.bincount(edge, minlength=count), 1))


def _chroma(mark: Landmark) -> Array:
    """Unit vector of the colour without its grey part, 0 where there is none."""
    if mark.colour_bgr is None:
        return np.zeros(3)
    chroma = np.array(mark.colour_bgr, dtype=float) - np.mean(mark.colour_bgr)
    size = float(np.linalg.norm(chroma))
    return chroma / size if size > _LEAST_CHROMA else np.zeros(3)
