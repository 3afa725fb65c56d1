"""The posterior of the joint assignment of regions to landmarks (docs/vision_identify.md).

    x = (dp, dtheta, s): errors common to all regions: prior position [m] and attitude (about n's axes) [rad], log scale of depth
    y_ij = A_ij (x, exp(s) - 1) + e,  e ~ N(0, I): the value of landmark j minus that of region i, whitened
    p(a | Y) ~ prod_i c_i(a_i) . integral N(x; 0, P) prod_i N(y_ia; A_ia (x, exp(s) - 1), I) dx . prod_j missed_j(a, x)

The integral is a Kalman update per region; a breadth of the best hypotheses is kept (Reid 1979; Neira and Tardos 2001).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order as ordering
from models.messages import Array
from vision.identify.clutter_density import ClutterDensity

SCALE, STATES = 6, 7
GROWTH, COLUMNS = 7, 8  # the last column of A is of exp(s) - 1: distances grow so, logarithms of sizes by s
ROWS = 7  # log width, log length, fill ratio, orientation, position (3)
POSITION = 4  # first of the three rows that say where; sizes stand before them, so that s is known when they come

_NOTHING: Final = -1e300
_EXPECTED_SIGMAS: Final = 1.0  # a landmark is expected in view when its position is, and this many sigmas around it


@dataclass(frozen=True, slots=True)
class Options:
    """Options of region i are start[i] ... start[i + 1] - 1; N in all, R rows each.

    landmark (N,) index, -1: not in the map;  y (N, R), A (N, R, 8) whitened, zeros where unused;  log_weight (N,): independent of
    x;  clutter_density: at each x relative to its maximum, None: uniform.
    """

    start: NDArray[np.int64]
    landmark: NDArray[np.int64]
    y: Array
    A: Array
    log_weight: Array
    clutter_density: ClutterDensity | None = None


@dataclass(frozen=True, slots=True)
class Expected:
    """Landmarks that should be seen: (J,) each.

    x_c (J, 3), A (J, 3, 7): camera position at the prior and its derivative by x;  radius_m
    log_missed: log probability of no region though in view;  log_gone: of no longer standing
    view: (4,) x/z and y/z limits: left, right, top, bottom
    position_c (M, 3): of the regions (NaN: remembered)
    """

    x_c: Array
    A: Array
    radius_m: Array
    log_missed: Array
    log_gone: float
    view: Array
    position_c: Array


@dataclass(frozen=True, slots=True)
class Hypotheses:
    """Joint assignments, best first: option (H, M) per region, probability (H,), x (H, 7), covariance (H, 7, 7).

    Probabilities and `unexplored`, an estimate of what was cut off, sum to one.
    """

    option: NDArray[np.int64]
    probability: Array
    x: Array
    covariance: Array
    unexplored: float


def search(options: Options, expected: Expected, covariance: Array, breadth: int = 300, drop: float = 20.0) -> Hypotheses:
    """Most probable joint assignments under x ~ N(0, covariance (7, 7)).

    breadth: hypotheses kept per region; drop: log factor below the best at which they end.
    """
    count = len(options.start) - 1
    order = np.argsort(np.diff(options.start), kind="stable")  # the least ambiguous first: the pose is known early
    o = options
    option, weight, x, cov, cut = _search(o.start, order, o.landmark, o.y, o.A, o.log_weight, covariance, breadth, drop)
    e = expected
    clutter = o.landmark[option] < 0 if count else np.zeros((len(weight), 0), np.bool_)
    weight = weight + _missed(
        o.landmark[option].reshape(len(weight), count), clutter, x, cov, e.x_c, e.A, e.radius_m, e.log_missed, e.log_gone,
        e.view, e.position_c,
    )  # fmt: skip
    if o.clutter_density is not None:
        weight = weight + o.clutter_density.below_highest(clutter, x, cov)
    best = np.argsort(-weight, kind="stable")
    probability = np.exp(weight[best] - weight[best[0]])
    total = float(probability.sum()) + cut
    return Hypotheses(option[best], probability / total, x[best], cov[best], cut / total)


@njit(cache=True)
def _update(x: Array, cov: Array, y: Array, A: Array, floor: float) -> float:
    """x, cov after rows y = A (x, exp(s) - 1) + e, in place; log density without 2 pi.

    Rows are linearised at the updated s; stops with a very low number below floor.
    """
    log_density = 0.0
    row, pa = np.empty(STATES), np.empty(STATES)
    for r in range(y.shape[0]):
        v, s = _linear(x, y[r], A[r], row), 1.0
        for a in range(STATES):
            total = 0.0
            for b in range(STATES):
                total += cov[a, b] * row[b]
            pa[a] = total
            s += row[a] * total
        log_density -= 0.5 * (v * v / s + math.log(s))
        if log_density < floor:
            return _NOTHING
        for a in range(STATES):
            x[a] += pa[a] * v / s
            for b in range(STATES):
                cov[a, b] -= pa[a] * pa[b] / s
    return log_density


@njit(cache=True)
def _linear(x: Array, y: float, A: Array, row: Array) -> float:
    growth = math.exp(x[SCALE])
    v = y - A[GROWTH] * (growth - 1.0)
    for a in range(STATES):
        row[a] = A[a]
        v -= A[a] * x[a]
    row[SCALE] += A[GROWTH] * growth
    return float(v)


@njit(cache=True)
def _far(x: Array, cov: Array, h: int, y: Array, A: Array, o: int, r: int, row: Array, room: float) -> bool:
    """Whether row r alone makes option o of hypothesis h worse than `room`: v^2 / s + log s > room."""
    growth, root = math.exp(x[h, SCALE]), 0.0
    v = y[o, r] - A[o, r, GROWTH] * (growth - 1.0)
    for a in range(STATES):
        row[a] = A[o, r, a]
        v -= row[a] * x[h, a]
    row[SCALE] += A[o, r, GROWTH] * growth
    for a in range(STATES):
        root += abs(row[a]) * math.sqrt(cov[h, a, a])
    if v * v > room * (1.0 + root * root):  # which s does not exceed
        return True
    s = 1.0
    for a in range(STATES):
        for b in range(STATES):
            s += row[a] * cov[h, a, b] * row[b]
    return bool(v * v / s + math.log(s) > room)


@njit(cache=True)
def _search(
    start: NDArray[np.int64], order: NDArray[np.int64], landmark: NDArray[np.int64], y: Array, A: Array, log_weight: Array,
    prior: Array, breadth: int, drop: float,
) -> tuple[NDArray[np.int64], Array, Array, Array, float]:  # fmt: skip
    """Breadth-limited search; last: weight cut off, relative to the best at that depth."""
    count = order.shape[0]
    chosen = np.full((1, count), -1, np.int64)
    weight, x, cov = np.zeros(1), np.zeros((1, STATES)), np.empty((1, STATES, STATES))
    _copy(x[0], prior, x[0], cov[0])
    x_new, cov_new, row = np.empty(STATES), np.empty((STATES, STATES)), np.empty(STATES)
    cut = 0.0
    for i in order:
        choices = start[i + 1] - start[i]
        children = np.full(weight.shape[0] * choices, _NOTHING)
        best = _NOTHING
        for h in range(weight.shape[0]):
            for k in range(choices):
                o = start[i] + k
                if _taken(chosen[h], landmark, o):
                    continue
                base = weight[h] + log_weight[o]
                room = 2.0 * (base - best + drop)
                if h and (_far(x, cov, h, y, A, o, POSITION, row, room) or _far(x, cov, h, y, A, o, POSITION + 1, row, room)):
                    continue
                _copy(x[h], cov[h], x_new, cov_new)
                children[h * choices + k] = base + _update(x_new, cov_new, y[o], A[o], best - drop - base)
                best = max(best, children[h * choices + k])
        alive = np.flatnonzero(children >= best - drop)
        ranked = alive[ordering.ranked(-children[alive])]
        for child in ranked[breadth:]:
            cut += math.exp(children[child] - best)
        chosen, weight, x, cov = _grow(chosen, children, ranked[:breadth], choices, start[i], i, x, cov, y, A)
    return chosen, weight, x, cov, cut


@njit(cache=True)
def _copy(x: Array, cov: Array, to_x: Array, to_cov: Array) -> None:
    for a in range(STATES):
        to_x[a] = x[a]
        for b in range(STATES):
            to_cov[a, b] = cov[a, b]


@njit(cache=True)
def _grow(
    chosen: NDArray[np.int64], children: Array, ranked: NDArray[np.int64], choices: int, first: int, region: int, x: Array,
    cov: Array, y: Array, A: Array,
) -> tuple[NDArray[np.int64], Array, Array, Array]:  # fmt: skip
    kept = ranked.shape[0]
    next_chosen, next_weight = np.empty((kept, chosen.shape[1]), np.int64), np.empty(kept)
    next_x, next_cov = np.empty((kept, STATES)), np.empty((kept, STATES, STATES))
    for n in range(kept):
        h, o = ranked[n] // choices, first + ranked[n] % choices
        for k in range(chosen.shape[1]):
            next_chosen[n, k] = o if k == region else chosen[h, k]
        next_weight[n] = children[ranked[n]]
        _copy(x[h], cov[h], next_x[n], next_cov[n])
        _update(next_x[n], next_cov[n], y[o], A[o], _NOTHING)
    return next_chosen, next_weight, next_x, next_cov


@njit(cache=True)
def _taken(chosen: NDArray[np.int64], landmark: NDArray[np.int64], option: int) -> bool:
    if landmark[option] < 0:
        return False
    for o in chosen:  # noqa: SIM110  (numba has no any() of a generator)
        if o >= 0 and landmark[o] == landmark[option]:
            return True
    return False


@njit(cache=True)
def _missed(
    landmark: NDArray[np.int64], clutter: NDArray[np.bool_], x: Array, cov: Array, x_c: Array, A: Array, radius: Array,
    log_missed: Array, log_gone: float, view: Array, position_c: Array,
) -> Array:  # fmt: skip
    """Log probability (H,) of the missing regions of expected landmarks.

    An unmapped object at a landmark's position means that it is gone.
    """
    result = np.zeros(landmark.shape[0])
    assigned, position = np.empty(x_c.shape[0], np.bool_), np.empty(3)
    for h in range(landmark.shape[0]):
        assigned[:] = False
        for i in landmark[h]:
            if i >= 0:
                assigned[i] = True
        for j in range(x_c.shape[0]):
            if assigned[j]:
                continue
            for a in range(3):
                position[a] = x_c[j, a]
                for b in range(STATES):
                    position[a] += A[j, a, b] * x[h, b]
            u, v = position[0] / position[2], position[1] / position[2]
            if not (position[2] > 1.0 and view[0] < u < view[1] and view[2] < v < view[3]):
                continue
            sigma = math.sqrt(max(_variance(A[j, 0], cov[h]), _variance(A[j, 1], cov[h])))
            margin = (radius[j] + _EXPECTED_SIGMAS * sigma) / position[2]
            if sigma < radius[j] and _occupied(clutter[h], position_c, math.exp(x[h, SCALE]), position, 0.5 * radius[j]):
                result[h] += log_gone
            elif view[0] + margin < u < view[1] - margin and view[2] + margin < v < view[3] - margin:
                result[h] += log_missed[j]
    return result


@njit(cache=True)
def _variance(a: Array, cov: Array) -> float:
    total = 0.0
    for i in range(STATES):
        for k in range(STATES):
            total += a[i] * cov[i, k] * a[k]
    return total


@njit(cache=True)
def _occupied(clutter: NDArray[np.bool_], position_c: Array, growth: float, position: Array, radius: float) -> bool:
    for i in range(position_c.shape[0]):
        if clutter[i]:
            square = 0.0
            for a in range(3):
                square += (position_c[i, a] * growth - position[a]) ** 2
            if square < radius * radius:
                return True
    return False
