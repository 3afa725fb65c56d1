"""How well outlines lie on edges of a picture, for many shifts at once.

    c_e = || sum_i g_i . n_i || / sum_i (||g_i|| + floor),      support = sum_e l_e c_e^2

g_i: gradient (all channels) at point i of an edge e, n_i its normal, l_e the edge's length in view. The sum over an edge is taken
before its length: a step has the same sign and colour all along, texture has not. Contrast drops out, so a shadow's rim has no
more votes than a pale roof. An edge whose roof side is less of the map's colour than the other side loses most of its vote.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.reduced import Field

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_WRONG_SIDE = 0.3  # what is left of an edge's vote if the map's colour is on the wrong side
_LEAST_POINTS = 2  # in view that make an edge


@njit(cache=True, fastmath=True)
def vote(
    field: Field, camera: Array, x: Array, along: Array, normal: Array, first: Indices, mark: Indices, length: Array,
    chroma: Array, marks: int, floor: float, su: Array, sv: Array, inside: Mask,
) -> tuple[Array, Array]:  # fmt: skip
    """Support and length in view (L, U, V) of each landmark at shifts su (U,), sv (V,); 0 where not inside (U, V).

    camera: fx fy cx cy of the field's pixels; x (N, 3): points in the camera; along (N, 3, 2): how a shift by 1 px in u and v
    moves them; normal (N, 2); first (E + 1,): points of edge e are first[e] to first[e + 1]; mark (E,): its landmark; length
    (E,): px that one of its points stands for; chroma (E, 3): unit colour of the roof inside it, without the grey part, else 0;
    marks: L; floor: of a gradient, so that smooth places have no direction.
    """
    rows, columns = field.shape[0], field.shape[1]
    support = np.zeros((marks, len(su), len(sv)))
    seen = np.zeros((marks, len(su), len(sv)))
    fx, fy, cx, cy = camera[0], camera[1], camera[2] + 0.5, camera[3] + 0.5
    for a in range(len(su)):
        for b in range(len(sv)):
            if not inside[a, b]:
                continue
            s, t = su[a], sv[b]
            for e in range(len(mark)):
                g0, g1, g2, total, count = 0.0, 0.0, 0.0, 0.0, 0
                for i in range(first[e], first[e + 1]):
                    z = x[i, 2] + s * along[i, 2, 0] + t * along[i, 2, 1]
                    if z <= 0.0:
                        continue
                    scale = 1.0 / z
                    u = fx * scale * (x[i, 0] + s * along[i, 0, 0] + t * along[i, 0, 1]) + cx
                    v = fy * scale * (x[i, 1] + s * along[i, 1, 0] + t * along[i, 1, 1]) + cy
                    if not (u >= 1.0 and v >= 1.0 and u < columns - 1.0 and v < rows - 1.0):
                        continue
                    here = field[int(v), int(u)]
                    if here[6] < 0.0:
                        continue
                    nu, nv = normal[i, 0], normal[i, 1]
                    g0 += here[0] * nu + here[3] * nv
                    g1 += here[1] * nu + here[4] * nv
                    g2 += here[2] * nu + here[5] * nv
                    total += here[6]
                    count += 1
                if count < _LEAST_POINTS:
                    continue
                m, n = mark[e], count * length[e]
                total += count * floor
                share = (g0 * g0 + g1 * g1 + g2 * g2) / (total * total)
                if g0 * chroma[e, 0] + g1 * chroma[e, 1] + g2 * chroma[e, 2] > 0.0:
                    share *= _WRONG_SIDE
                support[m, a, b] += n * share
                seen[m, a, b] += n
    return support, seen
