"""One look at the pictures: from a pose and map errors as now believed to lines of edges and how they depend on what is unknown.

line = H dx + N nu + e      (offset and tilt of every edge in every picture; nu of unit variance: errors of map and rig)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from models import so3
from models.camera import StereoRig
from models.landmarks import Landmark
from models.messages import Array
from vision import outline, step_fit
from vision.edge_lines import EdgeLines, compress, fit_lines
from vision.sensitivity import Derivatives, EdgeView, Eye, Samples, derivatives, edge_gaps, eyes, sample_edges, view
from vision.visibility import Kind, MapError, ModelEdges, Prisms, visible_edges

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
_BESIDE_PX = 1.5  # another edge of the model must be this far beyond a profile's end
_SEARCH_BESIDE_PX = 2.5  # in a search
_SEEN_GAP_PX = 0.2  # walls narrower than this are not fitted as such
_DEEPER_PX, _INTERIOR_HALF_PX = 5.0, 2  # how much farther in the shade of a roof's slope is looked up, and half how far
_GAP_FACTOR = 4.0  # real walls are not two clean steps: measured over predicted variance of their offsets
_WIDEST_OPEN_PX = 0.7  # an edge whose place is left this open by its gap says nothing
_MAPPED_FROM = 18  # columns before those of the map: pose 6, camera on the body 6, right against left camera 6
_COARSE = 1.5  # how much farther apart points are before the last look
_CLIPPED_PX = 0.25  # how far saturation may shift an edge


class LookConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How outlines are looked for."""

    search_px: tuple[int, ...] = (16, 8)  # half widths of the searches, one after the other
    farthest_px: tuple[float, ...] = (2.5, 1.5)  # how far edges may be off in the sub-pixel fits, one after the other
    fit_half_px: Annotated[int, Meta(ge=3, description="half width of the sub-pixel fit")] = 5
    spacing_px: Annotated[float, Meta(gt=0, description="distance of points along an edge")] = 4.0
    most_points: Annotated[int, Meta(ge=4, description="on one edge")] = 20
    least_points: Annotated[int, Meta(ge=3, description="that make an edge")] = 4


@dataclass(frozen=True, slots=True)
class Look:
    """What one look gave, of E edges in K pictures.

    line: (E, K, 2) px; found: (E, K); H: (E, K, 2, 6); N: (E, K, 2, P); opened: (K, E) px^2, what gaps leave open of the offsets;
    lines: of each picture; share: of the points in view that was found.
    """

    edges: ModelEdges
    samples: Samples
    lines: list[EdgeLines]
    line: Array
    found: Mask
    H: Array
    N: Array
    opened: Array
    share: float


class Scene:
    """What does not change from look to look: pictures, cameras, landmarks, and how wrong map and rig may be."""

    def __init__(self, rig: StereoRig, views: Sequence[Image | None], landmarks: Sequence[Landmark]) -> None:
        self.rig, self.prisms = rig, Prisms.of(landmarks)
        self.images = [None if image is None else _channels(image) for image in views]
        self.map_sigma = np.array([_sigmas(m) for m in landmarks])  # (L, M)
        self.map_used = np.flatnonzero(self.map_sigma.ravel() > 0.0)
        self.rig_roots = _rig_roots(rig)

    def moved_rig(self, bc: Array, rc: Array) -> StereoRig:
        """The rig with errors of its camera poses, in units of their own standard deviations."""
        if not bc.any() and not rc.any():
            return self.rig
        on_body, between = (
            root @ error if error.size else np.zeros(6) for root, error in zip(self.rig_roots[:2], (bc, rc), strict=True)
        )
        return msgspec.structs.replace(
            self.rig,
            p_bc=self.rig.p_bc + on_body[:3],
            R_bc=so3.matrix(so3.quat_exp(on_body[3:])) @ self.rig.R_bc,
            t_rc=self.rig.t_rc + between[:3],
            R_rc=so3.matrix(so3.quat_exp(between[3:])) @ self.rig.R_rc,
        )

    def look(
        self,
        p_n: Array,
        R_nb: Array,
        shift_m: Array,
        rig: StereoRig,
        config: LookConfig,
        search_px: int = 0,
        farthest_px: float = 0.0,
    ) -> Look:
        """Search roof edges within search_px, or (0) fit all edges that are not farther off than farthest_px.

        shift_m (L, M), rig: errors of map and rig as now believed.
        """
        shown = [(eye, image) for eye, image in zip(eyes(rig), self.images, strict=False) if image is not None]
        prisms, edges = self.prisms.moved(shift_m), visible_edges(self.prisms, shown[0][0].pose(p_n, R_nb)[0], shift_m)
        wanted = edges.kind == Kind.ROOF if search_px else None
        spacing = config.spacing_px * (1.0 if farthest_px == config.farthest_px[-1] else _COARSE)
        samples = sample_edges(edges, shown[0][0], p_n, R_nb, spacing, config.most_points, wanted)
        count, lines, opened, H, N, points = len(edges.kind), [], [], [], [], 0.0
        for eye, image in shown:
            seen = view(edges, samples, eye, p_n, R_nb, prisms)
            if search_px:
                offsets, usable, variance = roof_offsets(image, edges, samples, seen, (p_n, R_nb), eye, search_px)
            else:
                offsets, usable, variance = _fit(image, edges, samples, seen, p_n, R_nb, eye, config.fit_half_px, farthest_px)
            line = fit_lines(offsets, samples.tau, samples.edge, count, config.least_points)
            d = derivatives(edges, samples, seen, eye, rig, p_n, R_nb)
            pose, nuisances = self._rows(d, edges, samples, line, right=eye.right, with_rig=not search_px)
            lines.append(line)
            opened.append(variance)
            H.append(pose)
            N.append(nuisances)
            points += float(usable.sum())
        share = sum(float(line.points.sum()) for line in lines) / max(points, 1.0)
        line_all, found = np.stack([line.line for line in lines], axis=1), np.stack([line.found for line in lines], axis=1)
        return Look(edges, samples, lines, line_all, found, np.stack(H, axis=1), np.stack(N, axis=1), np.array(opened), share)

    def _rows(
        self, d: Derivatives, edges: ModelEdges, samples: Samples, line: EdgeLines, *, right: bool, with_rig: bool
    ) -> tuple[Array, Array]:
        """H (E, 2, 6) and N (E, 2, P) of one picture; P counts map errors only, without the rig's."""
        count = len(edges.kind)
        every = compress(line.gain, np.hstack((d.pose, d.bc, d.rc, d.mapped, d.own)), samples.edge, count)
        own_from = _MAPPED_FROM + len(MapError)
        mapped = np.zeros((count, 2, len(self.map_sigma), len(MapError)))
        own_map = every[:, :, _MAPPED_FROM:own_from]
        mapped[np.arange(count), :, edges.landmark] = own_map * self.map_sigma[edges.landmark][:, None, :]
        parts = [mapped.reshape(count, 2, -1)[:, :, self.map_used]]
        if with_rig:
            bc, rc, *own = self.rig_roots
            parts += [every[:, :, columns] @ root for columns, root in ((slice(6, 12), bc), (slice(12, 18), rc)) if root.size]
            for root, mine in zip(own, (not right, right), strict=True):
                if root.size:
                    parts.append(every[:, :, own_from:] @ root if mine else np.zeros((count, 2, root.shape[1])))
        return every[:, :, :6], np.concatenate(parts, axis=2)


def _sigmas(mark: Landmark) -> Array:
    """Standard deviations (M,) of MapError. A roof is level; ground that a mark is painted on may slope as it may be too high."""
    ground = mark.height_sigma_m if mark.height_m == 0.0 else 0.0
    return np.array([mark.sigma_m, mark.sigma_m, mark.height_sigma_m, mark.outline_sigma_m, ground, ground])


def _channels(image: Image) -> Image:
    return np.ascontiguousarray(image if image.ndim == 3 else image[:, :, None])


@lru_cache(maxsize=8)
def _rig_roots(rig: StereoRig) -> tuple[Array, Array, Array, Array]:
    """Roots of the covariances of camera on body, right against left camera, left and right camera's own; once a rig."""
    return _root(rig.covariance_bc), _root(rig.covariance_rc), _root(rig.left.covariance), _root(rig.right.covariance)


def _root(covariance: Array | None) -> Array:
    """L (n, r) with covariance = L L^T; empty where there is none."""
    if covariance is None:
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-14 * max(values[-1], 1e-300)
    root: Array = vectors[:, keep] * np.sqrt(values[keep])
    return root


def _alone(edges: ModelEdges, samples: Samples, seen: EdgeView, eye: Eye, pose: tuple[Array, Array], reach: float) -> Mask:
    """Samples whose profile no other edge of the model crosses."""
    p_nk, R_nk = eye.pose(*pose)
    count = len(edges.kind)
    ends = eye.camera.project((np.concatenate((edges.start_n, edges.end_n)) - p_nk) @ R_nk)
    crossed = outline.crossed(seen.px, seen.normal, samples.edge, edges.partner, ends[:count], ends[count:], reach)
    alone: Mask = seen.usable & ~crossed
    return alone


def roof_offsets(
    image: Image, edges: ModelEdges, samples: Samples, seen: EdgeView, pose: tuple[Array, Array], eye: Eye, half: int
) -> tuple[Array, Mask, Array]:
    """Offsets (N,) px of roof edges from where the roof's colour ends, usable samples (N,), and 0 (E,)."""
    usable = _alone(edges, samples, seen, eye, pose, _SEARCH_BESIDE_PX)
    values = outline.profiles(image, seen.px, seen.normal, half, 1.0, 1, usable)
    roof = edges.kind == Kind.ROOF
    beside = _roof_beside(image, values, edges, samples, seen, half, usable)
    distance = outline.off_roof(values, beside, samples.edge, roof, usable)
    return outline.search(distance, samples.edge, len(edges.kind), 1.0, usable), usable, np.zeros(len(edges.kind))


def _roof_beside(
    image: Image, values: Array, edges: ModelEdges, samples: Samples, seen: EdgeView, half: int, usable: Mask
) -> Array:
    """Colour (N, C) of the roof beside each sample, from profiles of half width half and what lies farther inside."""
    inside = usable.copy()
    px = seen.px - (half + _DEEPER_PX) * seen.normal
    interior = outline.profiles(image, px, seen.normal, _INTERIOR_HALF_PX, 1.0, 3, inside)
    return outline.roof_beside(values, interior, inside, samples.edge, edges.landmark, edges.kind == Kind.ROOF, usable)


def _fit(
    image: Image,
    edges: ModelEdges,
    samples: Samples,
    seen: EdgeView,
    p_n: Array,
    R_nb: Array,
    eye: Eye,
    half: int,
    farthest: float,
) -> tuple[Array, Mask, Array]:
    """Offsets (N,) px by sub-pixel fits, usable samples (N,), and the variance (E,) px^2 that walls and saturation leave."""
    roof, count = edges.kind == Kind.ROOF, len(edges.kind)
    usable = _alone(edges, samples, seen, eye, (p_n, R_nb), half + _BESIDE_PX)
    gap = edge_gaps(edges, samples, seen, eye, p_n, R_nb)
    near = np.abs(gap) < half + _BESIDE_PX  # base edges there are fitted along with the roof edge
    usable &= ~((edges.kind == Kind.BASE) & near)[samples.edge]
    values = outline.profiles(image, seen.px, seen.normal, half, 1.0, 3, usable)
    beside = _roof_beside(image, values, edges, samples, seen, half, usable)
    usable &= ~outline.alien(values, beside, samples.edge, roof, usable)[samples.edge]
    grey, clipped = outline.along_contrast(values, samples.edge, count, usable)
    narrow = roof & (gap > 0.0) & near
    double = np.where(narrow & (gap > _SEEN_GAP_PX), gap, 0.0)
    offsets, _, variance = step_fit.fit(grey, samples.edge, double, farthest, 1.0, usable)
    variance = _GAP_FACTOR * variance + np.where(narrow & (gap <= _SEEN_GAP_PX), _SEEN_GAP_PX**2, 0.0)
    offsets[(variance > _WIDEST_OPEN_PX**2)[samples.edge]] = np.nan
    return offsets, usable, variance + np.where(clipped, _CLIPPED_PX**2, 0.0)
