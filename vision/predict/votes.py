"""Agreement of outlines with image edges, many shifts at once (docs/vision_predict.md).

    c_e = sum_{i != j} (g_i . n_i) . (g_j . n_j) / sum_{i != j} |g_i| |g_j|,      support = sum_e l_e c_e

g_i: gradients of all channels at point i of edge e, n_i its normal, l_e visible length. An edge with less of the map's colour
inside than outside loses most of its vote.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.image.reduced import Field

Indices = NDArray[np.int64]
WRONG_SIDE = 0.3  # what is left of an edge's vote if the map's colour is on the wrong side
LEAST_POINTS = 2  # in view that make an edge


@njit(cache=True)
def vote(
    field: Field, camera: Array, aimed: Array, first: Indices, mark: Indices, length: Array, chroma: Array, marks: int,
    floor: float, su: Array, sv: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Support and length in view (L, U, V) per landmark at shifts su (U,), sv (V,) px.

    camera: fx fy cx cy; aimed (N, 11): x_c, d x_c per px in u and v, normal; first (E + 1,): points of edge e are first[e] to
    first[e + 1]; mark (E,): landmark; length (E,): px a point; chroma (E, 3): unit roof colour less grey, else 0; marks: L;
    floor: of a gradient.
    """
    rows, columns = field.shape[0], field.shape[1]
    pixels = field.reshape(rows * columns, field.shape[2])
    shifts = len(su) * len(sv)
    u, v, most = np.empty(shifts), np.empty(shifts), 0
    for k in range(shifts):
        u[k], v[k] = su[k // len(sv)], sv[k % len(sv)]
    for e in range(len(mark)):
        most = max(most, first[e + 1] - first[e])
    support, seen = np.zeros((marks, shifts)), np.zeros((marks, shifts))
    at = np.empty((most, shifts), np.int32)  # the pixels that an edge's points meet at each shift
    for e in range(len(mark)):  # edge by edge: what it meets of the field stays in the cache
        points, m, begin = first[e + 1] - first[e], mark[e], first[e]
        for i in range(points):
            _pixels_met(aimed[begin + i], camera, u, v, rows, columns, at[i])
        for k in range(shifts):
            g0, g1, g2, total, count = 0.0, 0.0, 0.0, 0.0, 0
            own, own_total = 0.0, 0.0
            for i in range(points):
                if at[i, k] < 0:
                    continue
                here = pixels[np.uint64(at[i, k])]
                if here[6] < 0.0:
                    continue
                nu, nv, size = aimed[begin + i, 9], aimed[begin + i, 10], here[6] + floor
                h0, h1, h2 = here[0] * nu + here[3] * nv, here[1] * nu + here[4] * nv, here[2] * nu + here[5] * nv
                g0 += h0
                g1 += h1
                g2 += h2
                own += h0 * h0 + h1 * h1 + h2 * h2
                total += size
                own_total += size * size
                count += 1
            if count < LEAST_POINTS:
                continue
            n = count * length[e]
            share = (g0 * g0 + g1 * g1 + g2 * g2 - own) / (total * total - own_total)
            if g0 * chroma[e, 0] + g1 * chroma[e, 1] + g2 * chroma[e, 2] > 0.0 and share > 0.0:
                share *= WRONG_SIDE
            support[m, k] += n * share
            seen[m, k] += n
    return support.reshape(marks, len(su), len(sv)), seen.reshape(marks, len(su), len(sv))


@njit(cache=True, error_model="numpy")
def _pixels_met(aimed: Array, camera: Array, su: Array, sv: Array, rows: int, columns: int, at: NDArray[np.int32]) -> None:
    """Pixel number at (S,) met by aimed (11,) at shifts su, sv (S,), -1 outside: K (x_c + su d_u + sv d_v); branchless."""
    fx, fy, cx, cy = camera[0], camera[1], camera[2] + 0.5, camera[3] + 0.5
    x, y, z, xv, yv, zv = aimed[0], aimed[1], aimed[2], aimed[6], aimed[7], aimed[8]
    xu, yu, zu = fx * aimed[3], fy * aimed[4], aimed[5]
    right, bottom = columns - 1.0, rows - 1.0
    for k in range(len(at)):
        depth = z + sv[k] * zv + su[k] * zu
        u, v = (fx * (x + sv[k] * xv) + su[k] * xu) / depth + cx, (fy * (y + sv[k] * yv) + su[k] * yu) / depth + cy
        met = (depth > 0.0) & (u >= 1.0) & (v >= 1.0) & (u < right) & (v < bottom)
        pixel = np.int32(v) * np.int32(columns) + np.int32(u)
        at[k] = pixel if met else np.int32(-1)


@njit(cache=True)
def aim(points: Array, direction: Array, p_n: Array, gain: Array, p_nk: Array, R_nk: Array, fx: float, fy: float) -> Array:
    """Points (N, 3), direction (N, 3) as vote() takes them (N, 11); undistorted camera at p_nk, axes R_nk.

    A shift by one pixel moves p_n by a column of gain (6, 2):  dx_c = R^T ([X - p]x dtheta - dp).
    """
    out = np.empty((len(points), 11))
    lever, turned = np.empty(3), np.empty(3)
    for i in range(len(points)):
        for k in range(3):
            out[i, k] = 0.0
            turned[k] = 0.0
            lever[k] = points[i, k] - p_n[k]
            for m in range(3):
                out[i, k] += (points[i, m] - p_nk[m]) * R_nk[m, k]
                turned[k] += direction[i, m] * R_nk[m, k]
        for c in range(2):
            d, e, f = gain[3, c], gain[4, c], gain[5, c]
            along = (
                lever[1] * f - lever[2] * e - gain[0, c],
                lever[2] * d - lever[0] * f - gain[1, c],
                lever[0] * e - lever[1] * d - gain[2, c],
            )
            for k in range(3):
                out[i, 3 + 3 * c + k] = along[0] * R_nk[0, k] + along[1] * R_nk[1, k] + along[2] * R_nk[2, k]
        z = out[i, 2]
        tu, tv = fx * (turned[0] - out[i, 0] / z * turned[2]), fy * (turned[1] - out[i, 1] / z * turned[2])
        size = max(np.sqrt(tu * tu + tv * tv), 1e-12)
        out[i, 9], out[i, 10] = -tv / size, tu / size
    return out
