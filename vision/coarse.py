"""Where in the picture the predicted outlines truly lie: a search over what the prior leaves open.

    score(q) = sum_l max_{|d| <= 2 s_l} (support_l - tau length_l)(q + d) - q^T Q^-1 q / 2

q: shift, turn and scale of the outlines (motion.py); support: how well landmark l lies on edges (votes.py). The prior's
ellipsoid is searched on a grid in a reduced picture. All landmarks vote together, each as far off as its map error s_l lets it
be, so that a neighbour that looks alike does not catch one of them. In the reduced picture the true place is seldom the very best
one, but nearly always among the summits; so many of them, apart in shift, turn or scale, are looked at again in a picture twice
as large, and the best of these once more. There every landmark finds its own place and, once it has one, its own size,

    max_{|d| <= 2 s_l, |g| <= 2 t_l} (support_l - tau length_l)(q + d, outline grown by g),

because an outline too small lies on half of its sides at best; pose and map errors are solved for together,

    y_l = D_l dx - D_l,p m_l + e,       dx ~ N(0, P),  m_l ~ N(0, s_l^2).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import cv2
import msgspec
import numpy as np
from msgspec import Meta
from numba import njit
from numpy.typing import NDArray

from models.camera import CameraModel
from models.landmarks import Landmark
from models.messages import Array
from vision.motion import Motion
from vision.pose import Pose
from vision.rectify import Image
from vision.reduced import Level, levels
from vision.sensitivity import Eye
from vision.settle import motions, own_places, settled
from vision.visibility import MapError, Prisms
from vision.voters import chromas, voters
from vision.votes import vote

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_LEAST_WIDTH = 80  # px of the reduced picture
_OPEN = 2.0  # standard deviations of a landmark's place and size on the map
_SLACK = 1  # pixels of the level that a landmark may be off beside its map error
_PLACE_PX = 1.0  # of the level: how well a landmark's place is found
_APART_PX = 1.5  # of the reduced picture, across the edges: nearer places are one
_WIDE_POINTS, _POINTS = 16, 25  # of each landmark on the average, at least: in the whole search, near a place
_FEW_VOTES = 300_000  # are quicker than to reduce the picture once more, and to look again in it
_FLOOR = 0.5  # of the median gradient of the picture
_NEVER = -1e6
_SUMMITS = 6  # of each turn and scale that are kept
_CLOSE = 6  # summits ranked for each that is to be apart from the others
_LOW = 0.4  # of the best summit's score: what is lower is not looked at again
_OTHERS = 9.0  # what turn and scale may add to the squared distance of the shift


class CoarseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How far is searched, and what a vote is compared with."""

    limit_px: Annotated[float, Meta(gt=0, description="largest shift searched, in a picture 640 px wide")] = 160.0
    turn_deg: Annotated[float, Meta(gt=0, description="largest turn searched")] = 10.0
    sigmas: Annotated[float, Meta(gt=0, description="of the prior that are searched")] = 3.0
    roof_px: Annotated[float, Meta(gt=1, description="a roof's width in the reduced picture, at least")] = 6.0
    most_votes: Annotated[
        int, Meta(ge=10_000, description="of points, in the whole search; else the picture is reduced further")
    ] = 8_000_000
    points: Annotated[int, Meta(ge=20, description="that vote at once")] = 160
    expected: Annotated[float, Meta(gt=0, lt=1, description="tau: support per length that speaks neither for nor against")] = 0.2
    summits: Annotated[int, Meta(ge=1, description="places of the whole search looked at again in a picture twice as large")] = 20
    peaks: Annotated[int, Meta(ge=1, description="the best of these, looked at in one twice as large again")] = 5


def limit_px(camera: CameraModel, config: CoarseConfig) -> float:
    """Largest shift searched in this camera's picture."""
    return config.limit_px * camera.width / 640.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place: p_n, R_nb (the prior's with error (6,)); map errors (L, M); support and length in view (L,) px; score px."""

    p_n: Array
    R_nb: Array
    error: Array
    shift_m: Array
    support: Array
    length: Array
    score: float

    @property
    def pose(self) -> Pose:
        """Position and attitude."""
        return self.p_n, self.R_nb


class Search:
    """The search of one camera's picture for landmarks that the prior lets move as `motion` says."""

    def __init__(self, eye: Eye, landmarks: Sequence[Landmark], motion: Motion, config: CoarseConfig) -> None:
        self.eye, self.landmarks, self.motion, self.config = eye, landmarks, motion, config
        self.map_sigma = np.array([mark.sigma_m for mark in landmarks])
        self.body, self.chroma = Prisms.of(landmarks), chromas(landmarks)
        self.information = motion.prior.information

    def candidates(self, picture: Image) -> list[Candidate]:
        """Places where the outlines may lie, best first, each apart from the better ones across its edges."""
        sizes = self._sizes()
        size = sizes[-1]
        reach = limit_px(self.eye.camera, self.config) + 2.0 * size
        stages = [
            _Stage(level, self, reach, max(self.config.points, each * len(self.landmarks)))
            for level, each in zip(
                levels(picture, self.eye.camera, tuple(sizes)), [_POINTS] * (len(sizes) - 1) + [_WIDE_POINTS], strict=True
            )
        ]
        fine, middle, wide = stages[0], stages[len(stages) // 2], stages[-1]
        steps = size // middle.level.size
        found = _best([self._first(middle, self.motion.gain @ q, steps) for q in self._wide(wide)], self.config.peaks)
        found = [self._climb(middle, c, steps) for c in found]
        ranked = _best([self._climb(fine, self._again(fine, c, 2), 2) for c in found], self.config.peaks)
        return _apart(ranked, [self.motion.J @ c.error for c in ranked], middle, _APART_PX * size)

    def _sizes(self) -> list[int]:
        """By how much the picture is reduced, rising: roofs keep a width in the last one, unless the search would be too long.

        Where the prior leaves little open, a less reduced one is searched at once.
        """
        size = 1
        while size * _LEAST_WIDTH < self.eye.camera.width:
            if self._votes(size) <= self.config.most_votes and self.motion.roof_px < 2.0 * size * self.config.roof_px:
                break
            size *= 2
        sizes = sorted({max(size // 4, 1), max(size // 2, 1), size})
        while len(sizes) > 1 and self._votes(sizes[-2]) <= _FEW_VOTES:
            sizes.pop()
        return sizes

    def _votes(self, size: int) -> int:
        """Of points, in the whole search of a picture reduced `size` times."""
        u, v, turns, scales = _halves(self.motion, self.config, size, limit_px(self.eye.camera, self.config))
        points = max(self.config.points, _WIDE_POINTS * len(self.landmarks))
        return (2 * u + 1) * (2 * v + 1) * (2 * turns + 1) * (2 * scales + 1) * points

    def _wide(self, stage: "_Stage") -> list[Array]:
        """The best summits q of the whole grid, apart in shift, turn or scale."""
        grid = _grid(self.motion, self.config, stage.level.size, limit_px(self.eye.camera, self.config))
        if stage.voters is None:
            return []
        information = np.linalg.inv(self.motion.covariance).astype(np.float64)
        found: list[tuple[float, Array]] = []
        for pair in grid.others:
            chi2 = _squared(information, grid, np.array(pair))
            inside = chi2 <= grid.chi2
            if inside.any():
                aimed = stage.aimed(self.motion.pose(self.motion.gain @ np.array([0.0, 0.0, *pair])))
                votes, _ = stage.vote(aimed, grid.su, grid.sv, inside)
                total = np.where(inside, stage.level.size * _together(votes, inside, stage.free) - 0.5 * chi2, _NEVER)
                found += [(float(total[a, b]), np.array([grid.su[a], grid.sv[b], *pair])) for a, b in _peaks(total)[:_SUMMITS]]
        found.sort(key=lambda one: -one[0])
        peaks = [q for score, q in found[: _CLOSE * self.config.summits] if score >= min(_LOW * found[0][0], found[0][0])]
        return _apart(peaks, peaks, stage, _APART_PX * stage.level.size)[: self.config.summits]

    def _climb(self, stage: "_Stage", place: Candidate, steps: int) -> Candidate:
        """The better of a place and the place near it: turn and scale follow only from the look before."""
        return max(place, self._again(stage, place, steps), key=_score)

    def _first(self, stage: "_Stage", error: Array, steps: int) -> Candidate:
        """The place near an error of the prior: landmarks as large as mapped, as far off the map as it leaves open."""
        as_mapped = np.zeros((len(self.landmarks), len(MapError)))
        return self._near(stage, error, as_mapped, stage.growth_m[:1], stage.free + _SLACK, steps)

    def _again(self, stage: "_Stage", place: Candidate, steps: int) -> Candidate:
        """The place near a place: landmarks near where they were found, as large as the map leaves open."""
        return self._near(stage, place.error, place.shift_m, stage.growth_m, stage.sides + _SLACK, steps)

    def _near(self, stage: "_Stage", error: Array, shift_m: Array, growth_m: Array, free: Array, steps: int) -> Candidate:
        """Every landmark's own place and size near an error of the prior, and the pose and map errors that follow.

        Each is sought at most free (L,) px of the level from where shift_m (L, M) has it, grown by each of growth_m (K, L).
        """
        size, half = stage.level.size, steps + int(free.max())
        s = np.arange(-half, half + 1.0) * size
        pose, whole = self.motion.pose(error), np.ones((len(s), len(s)), dtype=np.bool_)
        sought = np.repeat(shift_m[None], len(growth_m), axis=0)
        sought[:, :, MapError.GROWTH] = growth_m
        voted = [stage.vote(stage.aimed(pose, each), s, s, whole) for each in sought]
        places, grown, votes, length = _own(np.array([v for v, _ in voted]), np.array([n for _, n in voted]), free, steps)
        support = votes + self.config.expected * length
        trusted = support > self.config.expected * np.maximum(length, 1.0)
        D, P = stage.motions(pose, shift_m), self.motion.prior.covariance
        found_px = (places - half) * size - np.einsum("lij,lj->li", D[:, :, :2], shift_m[:, :2])
        total, off_m = settled(D, found_px, trusted, self.map_sigma, _PLACE_PX * size, error, P)
        found = np.zeros_like(shift_m)
        found[:, :2], found[:, MapError.GROWTH] = off_m, growth_m[grown, np.arange(len(grown))]
        score = float(votes.sum()) * size - 0.5 * float(total @ self.information @ total)
        return Candidate(*self.motion.pose(total), total, found, support * size, length * size, score)


@njit(cache=True)
def _own(votes: Array, length: Array, free: Array, steps: int) -> tuple[Array, Indices, Array, Array]:
    """Each landmark's own place (L, 2), row and column to a fraction, its size (L,), and its votes and length (L,) there.

    votes, length (K, L, U, U): in K sizes, shifted about the middle; landmarks lie at most free (L,) from what is common to all.
    """
    sizes, marks = votes.shape[:2]
    best = votes[0].copy()
    for k in range(1, sizes):
        best = np.maximum(best, votes[k])
    a, b = _common(best, free, steps)
    size, at, shown = np.zeros(marks, np.int64), np.empty(marks), np.empty(marks)
    for m in range(marks):
        radius, most = int(free[m]), -np.inf
        for k in range(sizes):
            here = np.max(votes[k, m, a - radius : a + radius + 1, b - radius : b + radius + 1])
            if here > most:
                most, size[m] = here, k
        best[m] = votes[size[m], m]
    places = own_places(best, np.array([a, b]), free)
    for m in range(marks):
        i, j = int(np.rint(places[m, 0])), int(np.rint(places[m, 1]))
        at[m], shown[m] = best[m, i, j], length[size[m], m, i, j]
    return places, size, at, shown


@njit(cache=True)
def _common(votes: Array, free: Array, steps: int) -> Indices:
    """Row and column (2,), at most `steps` from the middle, where the best votes within free (L,) have the largest sum."""
    middle, best, common = votes.shape[1] // 2, -np.inf, np.empty(2, np.int64)
    for a in range(middle - steps, middle + steps + 1):
        for b in range(middle - steps, middle + steps + 1):
            total = 0.0
            for m in range(len(votes)):
                radius = int(free[m])
                total += np.max(votes[m, a - radius : a + radius + 1, b - radius : b + radius + 1])
            if total > best:
                best, common[0], common[1] = total, a, b
    return common


class _Stage:
    """One reduced picture and the points that vote in it."""

    def __init__(self, level: Level, search: Search, reach_px: float, points: int) -> None:
        self.level, self.motion, self.expected = level, search.motion, search.config.expected
        self.eye = Eye(level.camera, search.eye.R_kb, search.eye.p_bk, search.eye.right)
        pose = self.motion.pose(np.zeros(6))
        self.voters = voters(self.eye, search.body, search.chroma, pose, reach_px / level.size, points)
        depth = search.body.base_d - search.body.height_m - self.eye.pose(*pose)[0][2]
        metre_px = level.camera.fx / np.maximum(depth, 1.0)
        outline_sigma = np.array([mark.outline_sigma_m for mark in search.landmarks])
        self.free = np.rint(_OPEN * search.map_sigma * metre_px)  # px (L,) that the map leaves open of a landmark's place,
        self.sides = np.rint(_OPEN * outline_sigma * metre_px)  # and of its sides
        self.growth_m = _growths(_OPEN * outline_sigma, metre_px)
        self.floor = _FLOOR * level.typical() + 0.5

    def aimed(self, pose: Pose, shift_m: Array | None = None) -> Array:
        """The points (N, 11) as vote() wants them, from a pose, of landmarks as mapped or off the map by shift_m (L, M)."""
        assert self.voters is not None
        points = self.voters if shift_m is None else self.voters.moved(shift_m)
        return points.aimed(self.eye, pose, self.motion.gain[:, :2])

    def vote(self, aimed: Array, su: Array, sv: Array, inside: Mask) -> tuple[Array, Array]:
        """Votes and length in view (L, U, V) px of the level, of the landmarks at shifts of points as aimed."""
        assert self.voters is not None
        v, c, marks = self.voters, self.level.camera, len(self.free)
        field = self.level.field(aimed, (float(su[0]), float(su[-1])), (float(sv[0]), float(sv[-1])))
        support, length = vote(
            field, np.array([c.fx, c.fy, c.cx, c.cy]), aimed, v.first, v.mark, v.length, v.chroma, marks, self.floor,
            su, sv, inside,
        )  # fmt: skip
        return support - self.expected * length, length

    def motions(self, pose: Pose, shift_m: Array) -> Array:
        """How each landmark off the map by shift_m (L, M) moves with the pose (L, 2, 6), px of the picture."""
        assert self.voters is not None
        v, c = self.voters.moved(shift_m), self.level.camera
        p_nk, R_nk = self.eye.pose(*pose)
        D = motions((v.points_n - p_nk) @ R_nk, v.points_n - pose[0], v.mark_of_point, len(self.free), R_nk, c.fx, c.fy)
        return np.asarray(D * self.level.size)

    def across(self, q: Array) -> Array:
        """M (4, 4): outlines in view at q lie beside those at q' by (dq^T M dq)^(1/2) px across their edges, RMS."""
        assert self.voters is not None
        aimed, c = self.aimed(self.motion.pose(self.motion.gain @ q)), self.level.camera
        return np.asarray(
            _across(aimed, np.array([c.fx, c.fy, c.cx, c.cy]), c.width, c.height, self.level.size, self.motion.middle + q[:2])
        )


@njit(cache=True)
def _across(aimed: Array, camera: Array, width: int, height: int, size: int, middle: Array) -> Array:
    """Mean of (n^T B)^T (n^T B) (4, 4) over the points in view; n: their normals, B (2, 4) = (I, turned r, r): similarity(r)."""
    M, row, count = np.zeros((4, 4)), np.empty(4), 0
    for i in range(len(aimed)):
        x, y, z = aimed[i, 0], aimed[i, 1], aimed[i, 2]
        if z <= 0.0:
            continue
        u, v = camera[0] * x / z + camera[2], camera[1] * y / z + camera[3]
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
            continue
        ru, rv = (u + 0.5) * size - 0.5 - middle[0], (v + 0.5) * size - 0.5 - middle[1]
        row[0], row[1] = aimed[i, 9], aimed[i, 10]
        row[2], row[3] = row[1] * ru - row[0] * rv, row[0] * ru + row[1] * rv
        count += 1
        for j in range(4):
            for k in range(4):
                M[j, k] += row[j] * row[k]
    return M / max(count, 1)


def _growths(open_m: Array, metre_px: Array) -> Array:
    """Growths (K, L) m up to open_m (L,), none first; from the next of them sides are off by a pixel, as turns and scales."""
    n = math.ceil(max(float(np.max(open_m * metre_px)) / 2.0 - 0.5, 0.0))
    return np.outer(sorted(range(-n, n + 1), key=abs), open_m / max(n, 1))


def _score(place: Candidate) -> float:
    return place.score


def _best(places: list[Candidate], most: int) -> list[Candidate]:
    return sorted(places, key=_score, reverse=True)[:most]


T = TypeVar("T")


def _apart(ranked: Sequence[T], q: Sequence[Array], stage: _Stage, least_px: float) -> list[T]:
    """Those of ranked, which lie at q, that are apart from every better one."""
    chosen: list[tuple[int, Array]] = []
    for k in range(len(ranked)):
        if all((q[k] - q[other]) @ M @ (q[k] - q[other]) > least_px**2 for other, M in chosen):
            chosen.append((k, stage.across(q[k])))
    return [ranked[k] for k, _ in chosen]


def _together(votes: Array, inside: Mask, free: Array) -> Array:
    """Sum over landmarks of the best vote within what each one's place leaves open."""
    total = np.zeros(inside.shape)
    for one, radius in zip(votes, free.tolist(), strict=True):
        width = 2 * int(radius) + 1
        total += cv2.dilate(np.where(inside, one, _NEVER), np.ones((width, width), np.uint8)) if width > 1 else one
    return total


def _squared(information: Array, grid: "_Grid", other: Array) -> Array:
    """q^T Q^-1 q (U, V) of the whole grid of shifts with one turn and scale."""
    linear = 2.0 * information[:2, 2:] @ other
    u = information[0, 0] * grid.su**2 + linear[0] * grid.su
    v = information[1, 1] * grid.sv**2 + linear[1] * grid.sv + other @ information[2:, 2:] @ other
    return np.asarray(u[:, None] + v[None, :] + 2.0 * information[0, 1] * grid.su[:, None] * grid.sv[None, :])


@dataclass(frozen=True, slots=True)
class _Grid:
    """Shifts su, sv px, pairs of turn and log scale, and the squared distance from the prior that is searched."""

    su: Array
    sv: Array
    others: list[tuple[float, float]]
    chi2: float


def _grid(motion: Motion, config: CoarseConfig, step: int, limit_px: float) -> _Grid:
    """Steps of one pixel of the reduced picture, and turns and scales that move the outlines' ends by a pixel at most."""
    u, v, turn, scale = (np.arange(-n, n + 1.0) for n in _halves(motion, config, step, limit_px))
    width = _width(motion, step)
    others = [(float(a), float(b)) for a in turn * width for b in scale * width]
    return _Grid(u * step, v * step, others, config.sigmas**2 + _OTHERS)


def _halves(motion: Motion, config: CoarseConfig, step: int, limit_px: float) -> tuple[int, int, int, int]:
    """How many steps to either side the grid has in shift u, v, in turn and in scale."""
    sigma_u, sigma_v = math.sqrt(motion.covariance[0, 0]), math.sqrt(motion.covariance[1, 1])
    u, v = (math.ceil(min(config.sigmas * sigma, limit_px) / step) + 1 for sigma in (sigma_u, sigma_v))
    reach = min(config.sigmas * motion.turn_rad, math.radians(config.turn_deg)), config.sigmas * motion.log_scale
    turns, scales = (math.ceil(max(half / _width(motion, step) - 0.5, 0.0)) for half in reach)
    return u, v, turns, scales


def _width(motion: Motion, step: int) -> float:
    """Of a step in turn [rad] and scale that moves the outlines' ends by two pixels of the reduced picture."""
    return 2.0 * step / motion.radius


def _peaks(score: Array) -> list[tuple[int, int]]:
    """Local maxima, best first."""
    top = (score >= cv2.dilate(score, np.ones((3, 3), np.uint8))) & (score > _NEVER)
    places = np.argwhere(top)
    return [(int(a), int(b)) for a, b in places[np.argsort(-score[top], kind="stable")]]
