"""From pose and map errors to edge lines and Jacobians.

line = H dx + N nu + e      (offset and tilt of every edge in every image; nu of unit variance: errors of map and rig)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.camera import Mount, StereoRig
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.outline import edge_search, profiles, roof_colour, step_fit
from vision.outline.edge_lines import EdgeLines, compress, lines_of
from vision.outline.visibility import Kind, MapError, ModelEdges, Prisms, visible_edges
from vision.pose import small_landmarks
from vision.pose.least_squares import POSE
from vision.pose.sensitivity import MAPPED_FROM, Samples, derived, ends_of, eyes, partners_off, viewed

Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
Drawn = tuple[Array, Array, Indices, Indices, Indices, Mask, Array, Array]
OnEdges = tuple[Array, Array, Indices, Array, Indices, Mask]
Bodies = tuple[Array, Indices, Array, Array]
Stand = tuple[Array, Array, Array, Array]
Roots = tuple[Array, Array, Array, int]
Seen = tuple["Line", int, Array]
Line = tuple[Array, Mask, Array, Array, Array, Array, Array, Array]
_ROOF, _BASE = int(Kind.ROOF), int(Kind.BASE)  # compiled code reads plain integers
_BESIDE_PX = 1.5  # another edge of the model must be this far beyond a profile's end
_SEARCH_BESIDE_PX = 2.5  # in a search
_SEEN_GAP_PX = 0.2  # walls narrower than this are not fitted as such
_DEEPER_PX, _INTERIOR_HALF_PX = 5.0, 2  # how much farther in the shade of a roof's slope is sampled, and half how far
_GAP_FACTOR = 4.0  # real walls are not two clean steps: measured over predicted variance of their offsets
_WIDEST_OPEN_PX = 0.7  # an edge whose position is left this open by its gap says nothing
_NOTHING = np.zeros((0, 0))
_COARSE = 1.5  # how much farther apart points are in a search
_CLIPPED_PX = 0.25  # how far saturation may shift an edge


class ObservationConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How outlines are searched for."""

    search_px: tuple[int, ...] = (16, 8)  # half widths of the searches, one after the other
    farthest_px: tuple[float, ...] = (2.5, 1.5)  # how far edges may be off in the sub-pixel fits, one after the other
    fit_half_px: Annotated[int, Meta(ge=3, description="half width of the sub-pixel fit")] = 5
    spacing_px: Annotated[float, Meta(gt=0, description="distance of points along an edge")] = 4.0
    most_points: Annotated[int, Meta(ge=4, description="on one edge")] = 20
    least_points: Annotated[int, Meta(ge=3, description="that make an edge")] = 4


@dataclass(frozen=True, slots=True)
class Observation:
    """One observation of E edges in K images; a small landmark is one edge, its first.

    block: (N,) edge of each sample; kind: (E,) Kind; line: (E, K, 2) px; found: (E, K); A: (E, K, 2, 6 + P) by pose (H) and map
    and rig (N); opened: (K, E) px^2 left by gaps; cornered: (E, K) px, sigma by corner errors; lines: of each image; usable:
    points in view.
    """

    edges: ModelEdges
    samples: Samples
    block: Indices
    kind: Indices
    lines: list[EdgeLines]
    line: Array
    found: Mask
    A: Array
    opened: Array
    cornered: Array
    usable: int

    @property
    def share(self) -> float:
        """Found share of the points in view, all images."""
        return sum(float(line.points.sum()) for line in self.lines) / max(self.usable, 1)

    @property
    def numbers(self) -> int:
        """Measured directions over all images: two of a small landmark, one of an edge."""
        return int(self.found.sum() + self.found[self.kind == Kind.SMALL].sum())

    def off(self, line: Array) -> Array:
        """How far (E, K) px lines (E, K, 2) are off."""
        aside = line[..., 1] * (self.kind == Kind.SMALL)[:, None]
        return np.asarray(np.hypot(line[..., 0], aside))

    def within(self, off_px: Array, farthest_px: float) -> "Observation":
        """Without edges of offset (E, K) px beyond farthest_px."""
        found = self.found & (np.abs(off_px) <= farthest_px)
        lines = [line.only(near, self.block) for line, near in zip(self.lines, found.T, strict=True)]
        return replace(self, lines=lines, found=found)

    @property
    def H(self) -> Array:
        """(E, K, 2, 6)."""
        return self.A[..., :POSE]


class Scene:
    """Constants: images, cameras, landmarks, errors of map and rig."""

    def __init__(self, rig: StereoRig, views: Sequence[Image | None], landmarks: Sequence[Landmark]) -> None:
        self.rig, self.prisms = rig, Prisms.of(landmarks)
        self.images = [None if image is None else channels(image) for image in views]
        self.map_sigma = np.array([_sigmas(m) for m in landmarks])  # (L, M)
        self.corner_sigma = np.array([m.corner_sigma_m for m in landmarks])  # (L,)
        self.map_used = np.flatnonzero(self.map_sigma.ravel() > 0.0)
        self.map_column = np.full(self.map_sigma.size, -1)
        self.map_column[self.map_used] = np.arange(len(self.map_used))
        self.rig_roots = _rig_roots(rig)

    def moved_rig(self, bc: Array, rc: Array) -> Mount:
        """The rig with errors of its camera poses, in units of their own standard deviations."""
        rig = self.rig
        if not (bc.any() or rc.any()):
            return rig
        on_body, between = (
            root @ error if error.size else np.zeros(6) for root, error in zip(self.rig_roots[:2], (bc, rc), strict=True)
        )
        R_bc, R_rc = (so3.matrix(so3.quat_exp(error[3:])) @ R for error, R in ((on_body, rig.R_bc), (between, rig.R_rc)))
        return Mount(rig.left, rig.right, R_rc, rig.t_rc + between[:3], R_bc, rig.p_bc + on_body[:3])

    def observe(
        self,
        p_n: Array,
        R_nb: Array,
        shift_m: Array,
        rig: Mount,
        config: ObservationConfig,
        search_px: int = 0,
        farthest_px: float = 0.0,
    ) -> Observation:
        """Search roof edges within search_px, or (0) fit edges within farthest_px.

        shift_m (L, M), rig: estimated errors of map and rig.
        """
        shown = [(eye, image) for eye, image in zip(eyes(rig), self.images, strict=False) if image is not None]
        prisms, edges = self.prisms.moved(shift_m), visible_edges(self.prisms, shown[0][0].pose(p_n, R_nb)[0], shift_m)
        wanted = edges.kind == _ROOF if search_px else np.ones(len(edges.kind), np.bool_)
        block, is_small = small_landmarks.blocks(edges, shown[0][0], (p_n, R_nb))
        spacing = config.spacing_px * (_COARSE if search_px else 1.0)
        samples = small_landmarks.sampled(edges, shown[0][0], (p_n, R_nb), spacing, config.most_points, wanted, is_small)
        count, with_rig = len(edges.kind), not search_px
        lines, points = list[EdgeLines](), 0
        line_all, found = np.empty((count, len(shown), 2)), np.empty((count, len(shown)), np.bool_)
        opened, cornered = np.empty((len(shown), count)), np.empty((count, len(shown)))
        A = np.zeros((count, len(shown), 2, POSE + len(self.map_used) + with_rig * sum(r.shape[1] for r in self.rig_roots)))
        drawn = (
            edges.start_n, edges.end_n, edges.landmark, edges.kind, edges.partner, edges.raised, edges.map_start, edges.map_end,
        )  # fmt: skip
        on_edges = samples.points_n, samples.t, samples.edge, samples.tau, block[samples.edge], is_small[samples.edge]
        bodies, on_map = (prisms.vertices, prisms.offsets, prisms.base_d, prisms.height_m), (self.map_sigma, self.map_column)
        for k, (eye, image) in enumerate(shown):
            own = 4 + len(eye.camera.distortion) if with_rig else 0
            roots = self._roots(right=eye.right) if with_rig else (_NOTHING, _NOTHING, _NOTHING, 0)
            line, usable, grown = _observed(
                image, drawn, on_edges, bodies, eye.stand(p_n, R_nb), eye.camera.parameters, search_px, config.fit_half_px,
                farthest_px, config.least_points, own, (rig.p_bc, rig.t_rc), eye.right, on_map, roots, k, A, opened,
            )  # fmt: skip
            lines.append(EdgeLines(*line))
            line_all[:, k], found[:, k] = lines[k].line, lines[k].found
            cornered[:, k] = np.abs(grown) * self.corner_sigma[edges.landmark] / math.sqrt(2.0)
            points += usable
        kind = np.where(is_small, int(Kind.SMALL), edges.kind)
        return Observation(edges, samples, block[samples.edge], kind, lines, line_all, found, A, opened, cornered, points)

    def _roots(self, *, right: bool) -> Roots:
        """Roots of covariances: camera on body, right against left, own; columns before the last."""
        bc, rc, left, own_right = self.rig_roots
        return bc, rc, own_right if right else left, left.shape[1] if right else 0


def _observed(
    image: Image, drawn: Drawn, on_edges: OnEdges, bodies: Bodies, stand: Stand, camera: Array, search: int, fit_half: int,
    farthest: float, least: int, own: int, levers: tuple[Array, Array], right: bool, on_map: tuple[Array, Indices], roots: Roots,
    k: int, A: Array, opened: Array,
) -> Seen:  # fmt: skip
    """Fields of EdgeLines of image k, usable samples, px (E,) per metre of growth; fills A (E, K, 2, 6 + P), opened (K, E) px^2.

    drawn: ModelEdges; on_edges: Samples, blocks, of small landmarks; bodies: Prisms; stand: Eye.stand; search: half width, px, 0:
    sub-pixel fit; own: camera parameters; levers: p_bc, t_rc; on_map, roots: as _dependence.
    """
    start, end, landmark, kind, partner, raised, map_start, map_end = drawn
    points, t, edge, tau, block, of_small = on_edges
    px, normal, row_c, x_c, seen = viewed(points, edge, start, end, *stand, camera, *bodies)
    ends = ends_of(start, end, *stand, camera)
    if search:
        distance, usable, hidden = distance_from_roof(
            image, px, normal, seen & ~of_small, edge, kind, raised, landmark, partner, ends, search
        )
        usable &= ~hidden
        offsets = edge_search.search(distance, edge, len(kind), 1.0, usable)
        opened[k] = 0.0
    else:
        gap = partners_off(start, end, partner, edge, t, *stand, camera, px, normal)
        offsets, usable, opened[k] = _fit_steps(
            image, px, normal, seen & ~of_small, edge, kind, raised, landmark, partner, ends, gap, fit_half, farthest
        )
    small_landmarks.measure(image, px, normal, of_small, block, search if search else math.ceil(farthest), seen, offsets, usable)
    line = lines_of(offsets, _regressors(tau, normal, of_small), block, len(kind), least)
    map_sigma, map_column = on_map
    bc, rc, own_root, own_skipped = roots
    rows, of_camera = derived(row_c, x_c, normal, points, t, edge, map_start, map_end, *stand, camera, own, *levers, right)
    _dependence(A, k, line[2], rows, of_camera, block, landmark, map_sigma, map_column, bc, rc, own_root, own_skipped)
    growth = np.ascontiguousarray(rows[:, MAPPED_FROM + MapError.GROWTH, None])
    return line, int(np.count_nonzero(usable)), compress(line[2], growth, block, len(kind))[:, 0, 0]


@njit(cache=True)
def _regressors(tau: Array, normal: Array, of_small: Mask) -> Array:
    x = np.empty(normal.shape)
    for i in range(len(tau)):
        x[i, 0] = normal[i, 0] if of_small[i] else 1.0
        x[i, 1] = normal[i, 1] if of_small[i] else tau[i]
    return x


@njit(cache=True)
def _dependence(
    A: Array, image: int, gain: Array, rows: Array, own: Array, edge: Indices, landmark: Indices, map_sigma: Array,
    map_column: Indices, bc: Array, rc: Array, own_root: Array, own_skipped: int,
) -> None:  # fmt: skip
    """Fill A (E, K, 2, 6 + P) of one image by pose, and errors of map and rig in sigmas.

    rows (N, 18 + M), own (N, 4 + n): as of `derived`; gain (N, 2): points to lines; map_column (L M,): columns of map errors, -1:
    exact; then camera on body, right against left, left and right camera.
    """
    by_line, by_own = compress(gain, rows, edge, len(A)), compress(gain, own, edge, len(A))
    errors = map_sigma.shape[1]
    for e in range(len(A)):
        for i in range(2):
            for m in range(POSE):
                A[e, image, i, m] = by_line[e, i, m]
            for m in range(errors):
                column = map_column[landmark[e] * errors + m]
                if column >= 0:
                    A[e, image, i, POSE + column] = by_line[e, i, MAPPED_FROM + m] * map_sigma[landmark[e], m]
    at = POSE
    for m in range(len(map_column)):
        at += map_column[m] >= 0
    for part in range(3):  # camera on body, right against left camera, this camera's own
        root, first = (bc, 6) if part == 0 else ((rc, 12) if part == 1 else (own_root, 0))
        at += own_skipped if part == 2 else 0
        _through(by_own if part == 2 else by_line, first, root, A, image, at)
        at += root.shape[1]


@njit(cache=True)
def _through(rows: Array, first: int, root: Array, A: Array, image: int, at: int) -> None:
    """A (E, image, 2, at ...) = rows (E, 2, first ...) root (n, r)."""
    for e in range(len(A)):
        for i in range(2):
            for j in range(root.shape[1]):
                for k in range(root.shape[0]):
                    A[e, image, i, at + j] += rows[e, i, first + k] * root[k, j]


def _sigmas(mark: Landmark) -> tuple[float, ...]:
    ground = mark.height_sigma_m if mark.height_m == 0.0 else 0.0
    return mark.sigma_m, mark.sigma_m, mark.height_sigma_m, mark.outline_sigma_m, ground, ground


def channels(image: Image) -> Image:
    """(H, W, C), writable, as compiled."""
    return np.require(image if image.ndim == 3 else image[:, :, None], np.uint8, ["C", "W"])


@lru_cache(maxsize=8)
def _rig_roots(rig: StereoRig) -> tuple[Array, Array, Array, Array]:
    """Covariance roots: camera on body, right against left, left and right camera; once a rig."""
    return _root(rig.covariance_bc), _root(rig.covariance_rc), _root(rig.left.covariance), _root(rig.right.covariance)


def _root(covariance: Array | None) -> Array:
    """L (n, r) with covariance = L L^T; empty where there is none."""
    if covariance is None:
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(covariance)
    keep = values > 1e-14 * max(values[-1], 1e-300)
    root: Array = np.ascontiguousarray(vectors[:, keep] * np.sqrt(values[keep]))
    return root


def distance_from_roof(
    image: Image, px: Array, normal: Array, seen: Mask, edge: Indices, kind: Indices, raised: Mask, landmark: Indices,
    partner: Indices, ends: Array, half: int,
) -> tuple[Array, Mask, Mask]:  # fmt: skip
    """Distance of roof-edge profiles (N, 2 half + 1) from the roof's colour, usable and covered samples (N,); ends (2 E, 2) px of
    the edges.
    """
    roof = kind == _ROOF
    usable = seen & ~edge_search.crossed(px, normal, edge, partner, ends[: len(kind)], ends[len(kind) :], _SEARCH_BESIDE_PX)
    values = profiles.profiles(image, px, normal, half, 1.0, 1, usable)
    beside = _roof_beside(image, values, px, normal, edge, landmark, roof, raised, half, usable)
    hidden = roof_colour.covered(values, beside, edge, landmark, roof, usable)
    distance = roof_colour.off_roof(values, beside, edge, roof, usable)
    return distance, usable, hidden


def _roof_beside(
    image: Image, values: Array, px: Array, normal: Array, edge: Indices, landmark: Indices, roof: Mask, raised: Mask, half: int,
    usable: Mask,
) -> Array:  # fmt: skip
    """Roof colour (N, C) beside each sample, profiles of half width half and farther inside.

    Painted marks have no slopes, and other paint inside.
    """
    inside = usable & (roof & raised)[edge]
    interior = profiles.profiles(image, px - (half + _DEEPER_PX) * normal, normal, _INTERIOR_HALF_PX, 1.0, 3, inside)
    return roof_colour.roof_beside(values, interior, inside, edge, landmark, roof, usable)


def _fit_steps(
    image: Image, px: Array, normal: Array, seen: Mask, edge: Indices, kind: Indices, raised: Mask, landmark: Indices,
    partner: Indices, ends: Array, gap: Array, half: int, farthest: float,
) -> tuple[Array, Mask, Array]:  # fmt: skip
    """Sub-pixel offsets (N,) px, usable samples (N,), variance (E,) px^2 by walls and saturation."""
    count, roof, reach = len(kind), kind == _ROOF, half + _BESIDE_PX
    near = np.abs(gap) < reach  # base edges there are fitted along with the roof edge
    usable = seen & ~edge_search.crossed(px, normal, edge, partner, ends[:count], ends[count:], reach)
    usable &= ~((kind == _BASE) & near)[edge]
    values = profiles.profiles(image, px, normal, half, 1.0, 3, usable)
    beside = _roof_beside(image, values, px, normal, edge, landmark, roof, raised, half, usable)
    usable &= ~roof_colour.covered(values, beside, edge, landmark, roof, usable)
    usable &= ~(raised & roof_colour.alien(values, beside, edge, roof, usable))[edge]
    narrow = roof & (gap > 0.0) & near
    grey, clipped = profiles.along_contrast(values, edge, roof & ~narrow, usable)
    double = np.where(narrow & (gap > _SEEN_GAP_PX), gap, 0.0)
    offsets, _, variance = step_fit.fit(grey, edge, double, farthest, 1.0, usable)
    variance = _GAP_FACTOR * variance + np.where(narrow & (gap <= _SEEN_GAP_PX), _SEEN_GAP_PX**2, 0.0)
    offsets[(variance > _WIDEST_OPEN_PX**2)[edge]] = np.nan
    return offsets, usable, variance + np.where(clipped, _CLIPPED_PX**2, 0.0)
