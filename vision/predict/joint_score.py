"""Agreement of all outlines with edges at one common shift (docs/vision_aerial.md).

    S(q) = sum_i (c_i(q) - c) / N,      c_i(q) = |n_i . g(x_i + q)| / (|g(x_i + q)| + g_0)
    q_1 = argmax S(q)^2 / (2 s^2) - q^T P^-1 q / 2,     ratio = S(q_1) / max S(q),   |q - q_1| > apart

g: gradients of all channels; n_i: outline normal; c: mean of c_i over all shifts; s: standard deviation of S over them. Points
outside the image are neutral.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from models.messages import Array
from vision.image.reduced import Field


@dataclass(frozen=True, slots=True)
class Summit:
    """q (4,): shift u, v [px], turn [rad], log scale; its score, ratio to the highest elsewhere (< 1: by the prior); step_px:
    shift spacing; least: ratio without the outline that it needs most (jackknife), 0 where the summit is elsewhere without it.
    """

    q: Array
    score: float
    ratio: float
    step_px: float
    least: float = np.inf


def joint_score(field: Field, camera: Array, aimed: Array, floor: float, su: Array, sv: Array) -> Array:
    """S (U, V) at shifts su (U,), sv (V,) px; aimed (N, 11), camera, floor (g_0): as vote()."""
    total, count = _sums(field, camera, aimed, floor, su, sv)
    chance = total.sum() / max(count.sum(), 1.0)
    return np.asarray((total - chance * count) / max(len(aimed), 1))


def summit(score: Array, turned: Array, su: Array, sv: Array, covariance: Array, apart_px: float) -> Summit:
    """Of S (T, U, V) at turned (T, 2), prior covariance (4, 4) of q.

    Within apart_px, at any turn and scale, is the same position.
    """
    q = np.stack(np.broadcast_arrays(su[:, None], sv[None, :]), axis=-1)
    information, best, at = np.linalg.inv(covariance), -np.inf, (0, 0, 0)
    deviation = max(float(score.std()), 1e-9)
    for k, (turn, grown) in enumerate(turned):
        whole = np.concatenate((q, np.broadcast_to((turn, grown), q.shape)), axis=-1)
        squared = np.sum(whole @ information * whole, axis=-1)
        likely = 0.5 * (np.maximum(score[k], 0.0) / deviation) ** 2 - 0.5 * squared
        a, b = (int(i) for i in np.unravel_index(int(np.argmax(likely)), likely.shape))
        if likely[a, b] > best:
            best, at = float(likely[a, b]), (k, a, b)
    k, a, b = at
    other = np.hypot(su[:, None] - su[a], sv[None, :] - sv[b]) > apart_px
    second = max(float(score.max(axis=0)[other].max(initial=0.0)), 1e-9)
    return Summit(np.array([su[a], sv[b], *turned[k]]), float(score[at]), float(score[at]) / second, float(su[1] - su[0]))


@njit(cache=True)
def _sums(field: Field, camera: Array, aimed: Array, floor: float, su: Array, sv: Array) -> tuple[Array, Array]:
    rows, columns = field.shape[0], field.shape[1]
    total, count = np.zeros((len(su), len(sv))), np.zeros((len(su), len(sv)))
    fx, fy, cx, cy = camera[0], camera[1], camera[2] + 0.5, camera[3] + 0.5
    x = np.empty(3)
    for i in range(len(aimed)):
        nu, nv = aimed[i, 9], aimed[i, 10]
        for a in range(len(su)):
            for k in range(3):
                x[k] = aimed[i, k] + su[a] * aimed[i, 3 + k]
            for b in range(len(sv)):
                z = x[2] + sv[b] * aimed[i, 8]
                scale = 1.0 / z
                u = fx * scale * (x[0] + sv[b] * aimed[i, 6]) + cx
                v = fy * scale * (x[1] + sv[b] * aimed[i, 7]) + cy
                if not (z > 0.0 and u >= 1.0 and v >= 1.0 and u < columns - 1.0 and v < rows - 1.0):
                    continue
                g = field[int(v), int(u)]
                if g[6] < 0.0:
                    continue
                h0, h1, h2 = g[0] * nu + g[3] * nv, g[1] * nu + g[4] * nv, g[2] * nu + g[5] * nv
                total[a, b] += np.sqrt(h0 * h0 + h1 * h1 + h2 * h2) / (g[6] + floor)
                count[a, b] += 1.0
    return total, count
