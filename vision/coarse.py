"""Where in the picture the predicted outlines truly lie: a search over what the prior leaves open.

    score(q) = sum_l max_{|d| <= 2 s_l} (support_l - tau length_l)(q + d) - q^T Q^-1 q / 2

q: shift, turn and scale of the outlines (motion.py); support: how well landmark l lies on edges (votes.py). The prior's
ellipsoid is searched on a grid in a reduced picture. All landmarks vote together, each as far off as its map error s_l lets it
be, so that a neighbour that looks alike does not catch one of them. The best places are looked at again in a picture twice as
large: there every landmark finds its own place, and pose and map errors are solved for together,

    y_l = D_l dx - D_l,p m_l + e,       dx ~ N(0, P),  m_l ~ N(0, s_l^2).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import cv2
import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from models import so3
from models.camera import CameraModel
from models.landmarks import Landmark
from models.messages import Array
from vision.motion import Motion, moved
from vision.pose import Pose, difference
from vision.rectify import Image
from vision.reduced import Level, levels
from vision.sensitivity import Eye
from vision.visibility import MapError, Prisms
from vision.voters import Voters, voters
from vision.votes import vote

Mask = NDArray[np.bool_]
_MOST_REDUCED = 64
_SLACK = 1  # pixels of the level that a landmark may be off beside its map error
_PLACE_PX = 1.0  # of the level: how well a landmark's place is found
_APART_PX = 1.5  # of the reduced picture, across the edges: nearer places are one
_FLOOR = 0.5  # of the median gradient of the picture
_NEVER = -1e6


class CoarseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How far is searched, and what a vote is compared with."""

    limit_px: Annotated[float, Meta(gt=0, description="largest shift searched, in a picture 640 px wide")] = 160.0
    turn_deg: Annotated[float, Meta(gt=0, description="largest turn searched")] = 10.0
    sigmas: Annotated[float, Meta(gt=0, description="of the prior that are searched")] = 3.0
    roof_px: Annotated[float, Meta(gt=1, description="a roof's width in the reduced picture, at least")] = 6.0
    steps: Annotated[int, Meta(ge=4, description="of the shift, to either side, at most")] = 24
    turns: Annotated[int, Meta(ge=0, description="of turn and scale, to either side, at most")] = 6
    points: Annotated[int, Meta(ge=20, description="that vote at once")] = 160
    expected: Annotated[float, Meta(gt=0, lt=1, description="tau: support per length that speaks neither for nor against")] = 0.2
    peaks: Annotated[int, Meta(ge=1, description="places looked at again")] = 5


def limit_px(camera: CameraModel, config: CoarseConfig) -> float:
    """Largest shift searched in this camera's picture."""
    return config.limit_px * camera.width / 640.0


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place: p_n, R_nb, map errors (L, 4); support and length in view (L,) px of each landmark; score px."""

    p_n: Array
    R_nb: Array
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
        self.body = Prisms.of(landmarks)
        self.map_sigma = np.array([mark.sigma_m for mark in landmarks])

    def candidates(self, picture: Image) -> list[Candidate]:
        """Places where the outlines may lie, best first, each apart from the better ones across its edges."""
        size = self._reduction()
        fine, wide = levels(picture, self.eye.camera, (max(size // 2, 1), size))[:: 1 if size > 1 else -1]
        found = [self._near(fine, q, size // fine.size) for q in self._wide(wide)]
        chosen: list[Candidate] = []
        for one in sorted((c for c in found if c is not None), key=lambda c: -c.score):
            if all(self._across(wide, better, one) > _APART_PX for better in chosen):
                chosen.append(one)
        return chosen

    def _reduction(self) -> int:
        """By how much the picture is reduced: roofs keep a width, and the search stays small."""
        reach = min(self.config.sigmas * self.motion.shift_px, self._limit_px)
        by_roof = math.floor(math.log2(max(self.motion.roof_px / self.config.roof_px, 1.0)))
        by_reach = math.ceil(math.log2(max(reach / self.config.steps, 1.0)))
        return int(min(2 ** max(by_roof, by_reach), _MOST_REDUCED))

    @property
    def _limit_px(self) -> float:
        return limit_px(self.eye.camera, self.config)

    def _wide(self, level: Level) -> list[Array]:
        """The best q of the whole grid."""
        grid = _grid(self.motion, self.config, level.size, self._limit_px)
        eye, shape = self._eye(level), (len(grid.su), len(grid.sv))
        reach = float(max(grid.su[-1], grid.sv[-1])) / level.size
        every = voters(eye, self.landmarks, self.body, self.motion.pose(np.zeros(4)), None, reach, self.config.points)
        if every is None:
            return []
        information = np.linalg.inv(self.motion.covariance)
        best, q_best = np.full(shape, _NEVER), np.zeros((*shape, 4))
        q = np.zeros((*shape, 4))
        q[:, :, 0], q[:, :, 1] = grid.su[:, None], grid.sv[None, :]
        for q[:, :, 2], q[:, :, 3] in grid.others:
            chi2 = np.einsum("abi,ij,abj->ab", q, information, q)
            inside = chi2 <= grid.chi2
            if inside.any():
                pose = self.motion.pose(np.array([0.0, 0.0, *q[0, 0, 2:]]))
                support, length = self._vote(level, every, pose, grid.su, grid.sv, inside)
                votes = support - self.config.expected * length
                score = self._together(votes, inside, self._freedom(every, level)) - 0.5 * chi2
                better = inside & (score > best)
                best[better], q_best[better] = score[better], q[better]
        return [q_best[a, b] for a, b in _peaks(best)[: 2 * self.config.peaks]]

    def _near(self, level: Level, q: Array, steps: int) -> Candidate | None:
        """Every landmark's own place near a q, and the pose and map errors that follow."""
        pose = self.motion.pose(q)
        every = voters(self._eye(level), self.landmarks, self.body, pose, None, 2.0 * steps, 2 * self.config.points)
        if every is None:
            return None
        free = self._freedom(every, level) + _SLACK
        half = steps + int(free.max())
        s = np.arange(-half, half + 1.0) * level.size
        everywhere = np.ones((len(s), len(s)), dtype=np.bool_)
        support, length = self._vote(level, every, pose, s, s, everywhere)
        votes = support - self.config.expected * length
        total = self._together(votes, everywhere, free)
        inner = total[half - steps : half + steps + 1, half - steps : half + steps + 1]
        common = np.array(np.unravel_index(int(np.argmax(inner)), inner.shape)) + half - steps
        places = np.array([_own_place(one, common, int(radius)) for one, radius in zip(votes, free, strict=True)])
        k, (a, b) = np.arange(len(votes)), np.rint(places).astype(int).T
        support, length = support[k, a, b], length[k, a, b]
        trusted = support > self.config.expected * np.maximum(length, 1.0)
        p_n, R_nb, shift_m, chi2 = self._settle(level, every, pose, (places - half) * level.size, trusted)
        score = float((support - self.config.expected * length).sum()) * level.size - 0.5 * chi2
        return Candidate(p_n, R_nb, shift_m, support * level.size, length * level.size, score)

    def _settle(
        self, level: Level, every: Voters, pose: Pose, shift_px: Array, trusted: Mask
    ) -> tuple[Array, Array, Array, float]:
        """Pose, map errors (L, 4) and the prior's chi-square from where the trusted landmarks were found beside a pose."""
        prior, eye = self.motion.prior, self._eye(level)
        q0, P = np.asarray(prior.q_nb_wxyz, dtype=float), np.asarray(prior.covariance, dtype=float)
        delta = difference(*pose, np.asarray(prior.p_n, dtype=float), q0)
        x_c, _ = every.aim(eye, pose)
        D = moved(eye.camera, x_c, every.points_n - pose[0], eye.pose(*pose)[1]) * level.size
        H, noise, y = np.zeros((2 * len(shift_px), 6)), np.zeros((2 * len(shift_px),) * 2), np.zeros(2 * len(shift_px))
        for k in range(len(shift_px)):
            rows, mine = slice(2 * k, 2 * k + 2), every.mark_of_point == k
            if trusted[k] and mine.any():
                H[rows] = D[mine].mean(axis=0)
                y[rows] = shift_px[k] + H[rows] @ delta
            spread = self.map_sigma[k] * H[rows, :2]
            noise[rows, rows] = (_PLACE_PX * level.size) ** 2 * np.eye(2) + spread @ spread.T
        total = P @ H.T @ np.linalg.solve(H @ P @ H.T + noise, y)
        left = np.linalg.solve(noise, y - H @ total)
        shift_m = np.zeros((len(shift_px), len(MapError)))
        for k in range(len(shift_px)):
            rows = slice(2 * k, 2 * k + 2)
            shift_m[k, :2] = -(self.map_sigma[k] ** 2) * H[rows, :2].T @ left[rows]
        turn = so3.matrix(so3.quat_exp(np.ascontiguousarray(total[3:])))
        return prior.p_n + total[:3], turn @ prior.R_nb, shift_m, float(total @ np.linalg.solve(P, total))

    def _across(self, level: Level, one: Candidate, other: Candidate) -> float:
        """By how much the outlines in view at one place lie beside those at another, across the edges: RMS, px of the level."""
        eye = self._eye(level)
        every = voters(eye, self.landmarks, self.body, one.pose, one.shift_m, 0.0, self.config.points)
        if every is None:
            return math.inf
        x_c, normal = every.aim(eye, one.pose)
        p_nk, R_nk = eye.pose(*other.pose)
        points = every.points_n.copy()
        points[:, :2] += (other.shift_m - one.shift_m)[every.mark_of_point, :2]
        step = eye.camera.project((points - p_nk) @ R_nk) - eye.camera.project(x_c)
        aside = np.sum(step * normal, axis=1)
        return float(np.sqrt(np.mean(aside**2))) if np.isfinite(aside).all() else math.inf

    def _vote(self, level: Level, every: Voters, pose: Pose, su: Array, sv: Array, inside: Mask) -> tuple[Array, Array]:
        """Support and length in view (L, U, V) of the landmarks at shifts of the picture that a pose gives."""
        c, eye = level.camera, self._eye(level)
        x_c, normal = every.aim(eye, pose)
        along = every.along(eye, pose, self.motion.gain[:, :2])
        floor = _FLOOR * float(np.median(level.field[::2, ::2, 6])) + 0.5
        return vote(
            level.field, np.array([c.fx, c.fy, c.cx, c.cy]), x_c, along, normal, every.first, every.mark, every.length,
            every.chroma, len(self.landmarks), floor, su, sv, inside,
        )  # fmt: skip

    def _together(self, votes: Array, inside: Mask, free: Array) -> Array:
        """Sum over landmarks of the best vote within what each one's place leaves open."""
        total = np.zeros(inside.shape)
        for one, radius in zip(votes, free.tolist(), strict=True):
            width = 2 * int(radius) + 1
            total += cv2.dilate(np.where(inside, one, _NEVER), np.ones((width, width), np.uint8))
        return total

    def _freedom(self, every: Voters, level: Level) -> Array:
        """How far (L,), px of the level, the map lets each landmark be off."""
        return np.rint(2.0 * self.map_sigma * level.camera.fx / np.maximum(every.depth, 1.0))

    def _eye(self, level: Level) -> Eye:
        return Eye(level.camera, self.eye.R_kb, self.eye.p_bk, self.eye.right)


@dataclass(frozen=True, slots=True)
class _Grid:
    """Shifts su, sv px, pairs of turn and log scale, and the squared distance from the prior that is searched."""

    su: Array
    sv: Array
    others: list[tuple[float, float]]
    chi2: float


def _grid(motion: Motion, config: CoarseConfig, step: int, limit_px: float) -> _Grid:
    """Steps of one pixel of the reduced picture, and turns and scales that move the outlines' ends by about as much."""
    reach = np.minimum(config.sigmas * np.sqrt(np.diag(motion.covariance)[:2]), limit_px)
    su, sv = (np.arange(-n, n + 1.0) * step for n in np.ceil(reach / step).astype(int) + 1)
    width, others = 1.4 * step / motion.radius, []
    for half in (min(config.sigmas * motion.turn_rad, math.radians(config.turn_deg)), config.sigmas * motion.log_scale):
        n = min(math.ceil(max(half / width - 0.5, 0.0)), config.turns)
        others.append(np.arange(-n, n + 1.0) * width)
    return _Grid(su, sv, [(float(a), float(b)) for a in others[0] for b in others[1]], config.sigmas**2 + 6.0)


def _peaks(score: Array) -> list[tuple[int, int]]:
    """Local maxima, best first."""
    top = (score >= cv2.dilate(score, np.ones((3, 3), np.uint8))) & (score > _NEVER)
    places = np.argwhere(top)
    return [(int(a), int(b)) for a, b in places[np.argsort(-score[top], kind="stable")]]


def _own_place(votes: Array, common: NDArray[np.int64], radius: int) -> Array:
    """Row and column, to a fraction, of a landmark's best place within radius of the common one."""
    low = np.maximum(common - radius, 0)
    window = votes[low[0] : common[0] + radius + 1, low[1] : common[1] + radius + 1]
    at = low + np.array(np.unravel_index(int(np.argmax(window)), window.shape))
    place = at.astype(float)
    for axis in range(2):
        step = np.eye(2, dtype=int)[axis]
        if 0 < at[axis] < votes.shape[axis] - 1:
            before, here, after = (float(votes[tuple(at + k * step)]) for k in (-1, 0, 1))
            curvature = before - 2.0 * here + after
            if curvature < 0.0:
                place[axis] += min(max(0.5 * (before - after) / curvature, -0.5), 0.5)
    return place
