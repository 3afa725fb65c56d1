"""Search of the whole prior in the most reduced image (docs/vision_predict.md).

    score(q) = sum_l max_{|d| <= 2 s_l} (support_l - tau length_l)(q + d) - q^T Q^-1 q / 2,     q: shift, turn, log scale
    support_l(q) = support_l,k(y_l(q) - y_l(q_k)),    q_k: the nearest turn and scale of a grid by the landmarks' own radius

y_l: image of the middle of its points, in whole pixels; so votes serve many turns and scales.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.predict.motion import Motion
from vision.predict.rigid_votes import Window
from vision.predict.search_level import SearchLevel

Indices = NDArray[np.int64]
_NEVER = -1e6
_SUMMITS = 6  # of each turn and scale that are kept
_OTHERS = 9.0  # what turn and scale may add to the squared distance of the shift
_FARTHEST = 4.0  # times from the middle of the image to its border: from farther away nothing is moved into view

Other = tuple[float, float]  # turn and log scale


@dataclass(frozen=True, slots=True)
class Grid:
    """Shifts su, sv px, pairs of turn and log scale, largest squared distance from the prior."""

    su: Array
    sv: Array
    others: list[Other]
    chi2: float

    @classmethod
    def of(cls, motion: Motion, sigmas: float, most_turn: float, step: int, limit_px: float) -> "Grid":
        """For so many sigmas, a turn [rad] and shift, image reduced `step` times."""
        width, reach = _width(motion.radius, step), (min(sigmas * motion.turn_rad, most_turn), sigmas * motion.log_scale)
        u, v = (math.ceil(min(sigmas * math.sqrt(motion.covariance[k, k]), limit_px) / step) + 1 for k in range(2))
        turns, scales = (math.ceil(max(half / width - 0.5, 0.0)) for half in reach)
        others = [(a * width, b * width) for a in range(-turns, turns + 1) for b in range(-scales, scales + 1)]
        return cls(step * np.arange(-u, u + 1.0), step * np.arange(-v, v + 1.0), others, sigmas**2 + _OTHERS)

    @property
    def positions(self) -> int:
        """Number of positions."""
        return len(self.su) * len(self.sv) * len(self.others)


def summits(search_level: SearchLevel, motion: Motion, grid: Grid) -> tuple[Array, Array]:
    """Scores (N,) and q (N, 4) of local summits by turn and scale, best first."""
    information = np.linalg.inv(motion.covariance).astype(np.float64)
    scores, found = list[Array](), list[Array]()
    for shape, others in _by_shape(grid.others, _width(search_level.own_radius(), search_level.level.size)).items():
        start = _middles(search_level, motion, shape)
        middles = np.array([_middles(search_level, motion, other) for other in others])
        px = np.where(start[:, 2:3] > 0.0, start[:, :2] / start[:, 2:3] * search_level.camera[:2], np.nan)
        window = _window(middles, px, search_level.camera, grid.su, grid.sv)
        votes = search_level.rigid_votes(search_level.aimed(motion.pose(motion.gain @ np.array([0.0, 0.0, *shape]))), window)
        score, q = _summits(
            votes,
            middles,
            np.array(others),
            px,
            window,
            search_level.camera,
            grid.su,
            grid.sv,
            search_level.level.size,
            information,
            grid.chi2,
        )
        scores.append(score)
        found.append(q)
    every = np.concatenate(scores)
    order = np.argsort(-every, kind="stable")
    return every[order], np.concatenate(found)[order]


def _width(radius: float, step: int) -> float:
    """Step of turn [rad] and scale that moves ends at `radius` by two reduced pixels."""
    return 2.0 * step / radius


def _by_shape(others: list[Other], width: float) -> dict[Other, list[Other]]:
    shapes: dict[Other, list[Other]] = {}
    for turn, scale in others:
        shapes.setdefault((width * round(turn / width), width * round(scale / width)), []).append((turn, scale))
    return shapes


def _middles(search_level: SearchLevel, motion: Motion, other: Other) -> Array:
    return search_level.middles(motion.pose(motion.gain @ np.array([0.0, 0.0, *other])))


@njit(cache=True)
def _window(middles: Array, start_px: Array, camera: Array, su: Array, sv: Array) -> Window:
    """Pixels by which middles (K, L, 11) move from start_px (L, 2); linear quotients peak at corners."""
    left, right, top, bottom = 0.0, 0.0, 0.0, 0.0
    for k in range(middles.shape[0]):
        for m in range(middles.shape[1]):
            row = middles[k, m]
            for a in (su[0], su[-1]):
                for b in (sv[0], sv[-1]):
                    z = row[2] + a * row[5] + b * row[8]
                    if z > 0.0 and np.isfinite(start_px[m, 0]):
                        u = camera[0] * (row[0] + a * row[3] + b * row[6]) / z - start_px[m, 0]
                        v = camera[1] * (row[1] + a * row[4] + b * row[7]) / z - start_px[m, 1]
                        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
    most = _FARTHEST * camera[2], _FARTHEST * camera[3]
    left, right, top, bottom = max(left, -most[0]), min(right, most[0]), max(top, -most[1]), min(bottom, most[1])
    return int(np.rint(left)), int(np.rint(right)), int(np.rint(top)), int(np.rint(bottom))


@njit(cache=True)
def _summits(
    votes: Array, middles: Array, others: Array, start_px: Array, window: Window, camera: Array, su: Array, sv: Array,
    size: float, information: Array, most: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Scores (N,), q (N, 4) of local summits at turns and scales (K, 2), middles (K, L, 11)."""
    scores, q, n = np.empty(_SUMMITS * len(others)), np.empty((_SUMMITS * len(others), 4)), 0
    for k in range(len(others)):
        total = _together(votes, middles[k], start_px, window, camera, su, sv)
        _score(total, size, su, sv, others[k], information, most)
        score, v, u = _peaks(total)
        for i in range(len(score)):
            scores[n], q[n, 0], q[n, 1], q[n, 2], q[n, 3] = score[i], su[u[i]], sv[v[i]], others[k, 0], others[k, 1]
            n += 1
    return scores[:n].copy(), q[:n].copy()


@njit(cache=True, error_model="numpy")
def _together(votes: Array, middle: Array, start_px: Array, window: Window, camera: Array, su: Array, sv: Array) -> Array:
    """Sum (V, U) of votes (L, rows, columns) about start_px (L, 2), middles (L, 11) shifted; none outside."""
    total, rows, columns = np.zeros((len(sv), len(su))), votes.shape[1], votes.shape[2]
    at = np.empty(len(su), np.int32)
    for m in range(len(votes)):
        one, row = votes[m].ravel(), middle[m]
        left, top = start_px[m, 0] + window[0] - 0.5, start_px[m, 1] + window[2] - 0.5
        for b in range(len(sv)):
            x, y, z0 = row[0] + sv[b] * row[6], row[1] + sv[b] * row[7], row[2] + sv[b] * row[8]
            for a in range(len(su)):  # without a branch, so that it is done for several shifts at once
                z = z0 + su[a] * row[5]
                u, v = camera[0] * (x + su[a] * row[3]) / z - left, camera[1] * (y + su[a] * row[4]) / z - top
                met = (z > 0.0) & (u >= 0.0) & (v >= 0.0) & (u < columns) & (v < rows)
                position = np.int32(v) * np.int32(columns) + np.int32(u)
                at[a] = position if met else np.int32(-1)
            for a in range(len(su)):
                if at[a] >= 0:
                    total[b, a] += one[np.uint64(at[a])]
    return total


@njit(cache=True)
def _score(total: Array, size: float, su: Array, sv: Array, other: Array, information: Array, most: float) -> None:
    """Scores (V, U) from votes: size total - q^T Q^-1 q / 2, _NEVER where q^T Q^-1 q exceeds `most`."""
    q = np.array([0.0, 0.0, other[0], other[1]])
    for b in range(len(sv)):
        for a in range(len(su)):
            q[0], q[1], chi2 = su[a], sv[b], 0.0
            for j in range(4):
                for k in range(4):
                    chi2 += q[j] * information[j, k] * q[k]
            total[b, a] = size * total[b, a] - 0.5 * chi2 if chi2 <= most else _NEVER


@njit(cache=True)
def _peaks(score: Array) -> tuple[Array, Indices, Indices]:
    rows, columns = score.shape
    best, at, count = np.empty(_SUMMITS + 1), np.empty((2, _SUMMITS + 1), np.int64), 0
    for b in range(rows):
        for a in range(columns):
            here = score[b, a]
            if here <= _NEVER or (count == _SUMMITS and here <= best[count - 1]):
                continue
            top = here
            for i in range(max(b - 1, 0), min(b + 2, rows)):
                for j in range(max(a - 1, 0), min(a + 2, columns)):
                    top = max(top, score[i, j])
            if here < top:
                continue
            k = count
            while k > 0 and best[k - 1] < here:
                best[k], at[0, k], at[1, k] = best[k - 1], at[0, k - 1], at[1, k - 1]
                k -= 1
            best[k], at[0, k], at[1, k] = here, b, a
            count = min(count + 1, _SUMMITS)
    return best[:count].copy(), at[0, :count].copy(), at[1, :count].copy()
