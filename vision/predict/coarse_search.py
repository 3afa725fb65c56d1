"""Search for the predicted outlines over the prior's range (docs/vision_predict.md).

    score(q) = sum_l max_{|d| <= 2 s_l} (support_l - tau length_l)(q + d) - q^T Q^-1 q / 2
    max_{|d| <= 2 s_l, |g| <= 2 t_l} (support_l - tau length_l)(q + d, outline grown by g)              in the finer images
    y_l = D_l dx - D_l,p m_l + e,       dx ~ N(0, P),  m_l ~ N(0, s_l^2)

q: shift, turn and scale (motion.py); support: votes.py; s_l: map error.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import msgspec
import numpy as np
from msgspec import Meta
from numba import njit
from numpy.typing import NDArray

from models.camera import CameraModel
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.image.rectify import Image
from vision.image.reduced import levels
from vision.outline.visibility import MapError
from vision.pose.pose import Pose
from vision.pose.sensitivity import Eye
from vision.predict.global_search import Grid, summits
from vision.predict.landmark_shifts import own_positions, shifted
from vision.predict.motion import Motion, roofs_in_view, straight
from vision.predict.search_level import SearchLevel

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_LEAST_WIDTH = 80  # px of the reduced image
_SLACK = 1  # pixels of the level that a landmark may be off beside its map error
_POSITION_PX = 1.0  # of the level: how well a landmark's position is found
_STILL_PX = 1.5  # of the level: a position that an observation moves by less is not refined
_APART_PX = 1.5  # of the reduced image, across the edges: nearer positions are one
_WIDE_POINTS, _POINTS = 16, 25  # of each landmark on the average, at least: in the whole search, near a position
_FEW_VOTES = 300_000  # are quicker than to reduce the image once more, and to search again in it
_CLOSE = 6  # summits ranked for each that is to be apart from the others
_LOW = 0.4  # of the best summit's score: what is lower is not refined


class CoarseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Range of the search, expected votes."""

    limit_px: Annotated[float, Meta(gt=0, description="largest shift searched, in an image 640 px wide")] = 160.0
    turn_deg: Annotated[float, Meta(gt=0, description="largest turn searched")] = 30.0
    sigmas: Annotated[float, Meta(gt=0, description="of the prior that are searched")] = 3.0
    roof_px: Annotated[float, Meta(gt=1, description="a roof's width in the reduced image, at least")] = 6.0
    most_votes: Annotated[
        int, Meta(ge=10_000, description="of points, in the whole search; else the image is reduced further")
    ] = 128_000_000
    points: Annotated[int, Meta(ge=20, description="that vote at once")] = 160
    expected: Annotated[float, Meta(gt=0, lt=1, description="tau: support per length that speaks neither for nor against")] = 0.2
    summits: Annotated[int, Meta(ge=1, description="positions of the whole search refined in an image twice as large")] = 60
    peaks: Annotated[int, Meta(ge=1, description="the best of these, examined in one twice as large again")] = 8


def limit_px(camera: CameraModel, config: CoarseConfig) -> float:
    """Largest shift searched in this camera's image."""
    return config.limit_px * camera.width / 640.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A hypothesis: p_n, R_nb (error (6,) of the prior); map errors (L, M); support, length in view (L,) px; score px."""

    p_n: Array
    R_nb: Array
    error: Array
    shift_m: Array
    support: Array
    length: Array
    score: float

    @classmethod
    def as_mapped(cls, eye: Eye, landmarks: Sequence[Landmark], pose: Pose, error: Array) -> "Candidate":
        """A position without votes, landmarks as mapped."""
        pinhole = straight(eye)
        ends, mark = roofs_in_view(pinhole, landmarks, pose, 0.0)
        p_nk, R_nk = pinhole.pose(*pose)
        px = pinhole.camera.project((ends - p_nk) @ R_nk)
        length = np.zeros(len(landmarks))
        np.add.at(length, mark[::2], np.linalg.norm(px[1::2] - px[::2], axis=1))
        return cls(*pose, error, np.zeros((len(landmarks), len(MapError))), length, length, float(length.sum()))

    @property
    def pose(self) -> Pose:
        """Position and attitude."""
        return self.p_n, self.R_nb


class Search:
    """The search of one camera's image for landmarks that the prior lets move as `motion` says."""

    def __init__(self, eye: Eye, landmarks: Sequence[Landmark], motion: Motion, config: CoarseConfig) -> None:
        self.eye, self.landmarks, self.motion, self.config = eye, landmarks, motion, config
        self.map_sigma = np.array([mark.sigma_m for mark in landmarks])
        self.information = motion.prior.information

    def candidates(self, image: Image) -> list[Candidate]:
        """Candidate positions, best first, apart across their edges."""
        sizes = self._sizes()
        size = sizes[-1]
        reach = limit_px(self.eye.camera, self.config) + 2.0 * size
        stages = [
            SearchLevel(level, self.eye, self.landmarks, self.motion, self.config.expected, reach, self._points(each))
            for level, each in zip(
                levels(image, self.eye.camera, tuple(sizes)), [_POINTS] * (len(sizes) - 1) + [_WIDE_POINTS], strict=True
            )
        ]
        fine, middle, wide = stages[0], stages[len(stages) // 2], stages[-1]
        steps = size // middle.level.size
        apart_px = _APART_PX * size
        found = self._best(middle, [self._first(middle, self.motion.gain @ q, steps) for q in self._wide(wide)], apart_px)
        found = [self._climb(middle, c, steps) for c in found]
        return self._best(middle, [self._nearest(fine, c, 2) for c in found], apart_px)

    def _best(self, search_level: SearchLevel, positions: list[Candidate], apart_px: float) -> list[Candidate]:
        ranked = sorted(positions, key=_score, reverse=True)
        return _apart(ranked, [self.motion.J @ c.error for c in ranked], search_level, apart_px, self.config.peaks)

    def _sizes(self) -> list[int]:
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
        return self._grid(size).positions * self._points(_WIDE_POINTS)

    def _points(self, each: int) -> int:
        return max(self.config.points, each * len(self.landmarks))

    def _grid(self, size: int) -> Grid:
        c = self.config
        return Grid.of(self.motion, c.sigmas, math.radians(c.turn_deg), size, limit_px(self.eye.camera, c))

    def _wide(self, search_level: SearchLevel) -> list[Array]:
        if search_level.edge_points is None:
            return []
        score, q = (
            most[: _CLOSE * self.config.summits]
            for most in summits(search_level, self.motion, self._grid(search_level.level.size))
        )
        peaks = list(q[score >= np.minimum(_LOW * score[:1], score[:1])])
        return _apart(peaks, peaks, search_level, _APART_PX * search_level.level.size, self.config.summits)

    def _climb(self, search_level: SearchLevel, hypothesis: Candidate, steps: int) -> Candidate:
        return max(hypothesis, self._again(search_level, hypothesis, steps), key=_score)

    def _nearest(self, search_level: SearchLevel, hypothesis: Candidate, steps: int) -> Candidate:
        near = self._again(search_level, hypothesis, steps)
        shift_u, shift_v, turn, scale = self.motion.J @ (near.error - hypothesis.error)
        moved_px = math.hypot(shift_u, shift_v, self.motion.radius * turn, self.motion.radius * scale)
        return near if moved_px < _STILL_PX * search_level.level.size else self._climb(search_level, near, steps)

    def _first(self, search_level: SearchLevel, error: Array, steps: int) -> Candidate:
        as_mapped = np.zeros((len(self.landmarks), len(MapError)))
        return self._near(search_level, error, as_mapped, search_level.growth_m[:1], search_level.free + _SLACK, steps)

    def _again(self, search_level: SearchLevel, hypothesis: Candidate, steps: int) -> Candidate:
        return self._near(
            search_level, hypothesis.error, hypothesis.shift_m, search_level.growth_m, search_level.sides + _SLACK, steps
        )

    def _near(
        self, search_level: SearchLevel, error: Array, shift_m: Array, growth_m: Array, free: Array, steps: int
    ) -> Candidate:
        """Each landmark's position and size near an error of the prior, and the resulting pose and map errors.

        At most free (L,) px from shift_m (L, M), grown by growth_m (K, L).
        """
        size, half = search_level.level.size, steps + int(free.max())
        s, pose = np.arange(-half, half + 1.0) * size, self.motion.pose(error)
        sought = np.repeat(shift_m[None], len(growth_m), axis=0)
        sought[:, :, MapError.GROWTH] = growth_m
        voted = [search_level.vote(search_level.aimed(pose, each), s, s) for each in sought]
        positions, grown, votes, length = _own(np.array([v for v, _ in voted]), np.array([n for _, n in voted]), free, steps)
        support = votes + self.config.expected * length
        trusted = support > self.config.expected * np.maximum(length, 1.0)
        D, P = search_level.motions(pose, shift_m), self.motion.prior.covariance
        found_px = (positions - half) * size - np.einsum("lij,lj->li", D[:, :, :2], shift_m[:, :2])
        total, off_m = shifted(D, found_px, trusted, self.map_sigma, _POSITION_PX * size, error, P)
        found = np.zeros_like(shift_m)
        found[:, :2], found[:, MapError.GROWTH] = off_m, growth_m[grown, np.arange(len(grown))]
        score = float(votes.sum()) * size - 0.5 * float(total @ self.information @ total)
        return Candidate(*self.motion.pose(total), total, found, support * size, length * size, score)


@njit(cache=True)
def _own(votes: Array, length: Array, free: Array, steps: int) -> tuple[Array, Indices, Array, Array]:
    """Each landmark's position (L, 2) (row, column, sub-pixel), size (L,), votes and length (L,).

    votes, length (K, L, U, U): by size and shift; at most free (L,) from the common one.
    """
    sizes, marks = votes.shape[:2]
    best = votes[0].copy()
    for k in range(1, sizes):
        for m in range(marks):
            for i in range(votes.shape[2]):
                for j in range(votes.shape[3]):
                    best[m, i, j] = max(best[m, i, j], votes[k, m, i, j])
    common = _common(best, free, steps)
    a, b = common
    size, at, shown = np.zeros(marks, np.int64), np.empty(marks), np.empty(marks)
    for m in range(marks):
        radius, most = int(free[m]), -np.inf
        for k in range(sizes):
            here = _highest(votes[k, m], a, b, radius)
            if here > most:
                most, size[m] = here, k
        for i in range(votes.shape[2]):
            for j in range(votes.shape[3]):
                best[m, i, j] = votes[size[m], m, i, j]
    positions = own_positions(best, common, free)
    for m in range(marks):
        i, j = int(np.rint(positions[m, 0])), int(np.rint(positions[m, 1]))
        at[m], shown[m] = best[m, i, j], length[size[m], m, i, j]
    return positions, size, at, shown


@njit(cache=True)
def _highest(votes: Array, a: int, b: int, radius: int) -> float:
    most = -np.inf
    for i in range(a - radius, a + radius + 1):
        for j in range(b - radius, b + radius + 1):
            most = max(most, votes[i, j])
    return most


@njit(cache=True)
def _common(votes: Array, free: Array, steps: int) -> Indices:
    """Row, column (2,) within `steps` of the middle where the best votes within free (L,) have the largest sum."""
    middle, best, common = votes.shape[1] // 2, -np.inf, np.empty(2, np.int64)
    for a in range(middle - steps, middle + steps + 1):
        for b in range(middle - steps, middle + steps + 1):
            total = 0.0
            for m in range(len(votes)):
                radius = int(free[m])
                total += _highest(votes[m], a, b, radius)
            if total > best:
                best, common[0], common[1] = total, a, b
    return common


def _score(hypothesis: Candidate) -> float:
    return hypothesis.score


T = TypeVar("T")


def _apart(ranked: Sequence[T], q: Sequence[Array], search_level: SearchLevel, least_px: float, most: int) -> list[T]:
    chosen, at, left = list[T](), np.array(q), np.arange(len(ranked))
    while len(left) and len(chosen) < most:
        chosen.append(ranked[left[0]])
        off = at[left] - at[left[0]]
        left = left[np.einsum("ki,ij,kj->k", off, search_level.across(at[left[0]]), off) > least_px**2]
    return chosen
