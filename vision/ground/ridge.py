"""A river, road or tree belt: best scores along one line, position known across it only.

    rivals = {d: score(d) > usual + (best - usual) / ratio},   n = least eigenvector of their covariance, weights score - level

n mean(rivals): measured with the scatter across, valid at the weighted mean of the evidence.
"""

from dataclasses import dataclass

import numpy as np

from models.messages import Array
from vision.ground.image import Float
from vision.ground.view import Mask

LOBE_PX = 6.0  # from a peak: another position begins there


@dataclass(frozen=True, slots=True)
class Line:
    """In search points: normal (2,) column, row; offset: from the best position; sigma: across.

    ratio, deviations: as a Peak's.
    """

    normal: Array
    offset: float
    sigma: float
    ratio: float
    deviations: float


@dataclass(frozen=True, slots=True)
class Ridge:
    """normal_n (2,): measured direction; seen_n (3,): evidence by the prior; shown_n (2,): by the map; sigma_m: across."""

    normal_n: Array
    seen_n: Array
    shown_n: Array
    sigma_m: float
    ratio: float
    deviations: float


def find_line(scores: Float, inside: Mask, extent: Array, ratio: float) -> Line | None:
    """The line of all positions above 1 / ratio of the peak, or None.

    scores (turns, rows, columns), -1: not searched; extent (2, 2): d^T extent^-1 d <= 1.
    """
    k, i, j = np.unravel_index(int(np.argmax(scores)), scores.shape)
    highest, best = scores.max(axis=0), float(scores[k, i, j])
    usual = float(np.median(highest[inside]))
    level = usual + (best - usual) / ratio
    rows, columns = np.indices(inside.shape)
    d = np.stack((columns - j, rows - i), axis=-1).astype(np.float64)
    rivals = inside & (highest > level)
    at, weight = d[rivals], (highest[rivals] - level).astype(np.float64)
    middle = weight @ at / weight.sum()
    off = at - middle
    values, vectors = np.linalg.eigh((off.T * weight) @ off / weight.sum())
    normal, along = vectors.T
    offset, reach = float(normal @ middle), float(np.sqrt(normal @ extent @ normal))
    from_middle = float(normal @ (np.array([j, i]) - len(inside) // 2)) + offset
    too_wide = float(np.abs(off @ normal).max()) > LOBE_PX or abs(from_middle) + LOBE_PX > reach
    if too_wide or float(np.abs(off @ along).max()) <= LOBE_PX:
        return None
    beside = inside & (np.abs(d @ normal - offset) > LOBE_PX)
    second, scatter = float(highest[beside].max(initial=-1.0)), float(scores[k][beside].std()) if beside.any() else 0.0
    if not (second > usual and scatter > 0.0):
        return None
    return Line(normal, offset, float(np.sqrt(max(values[0], 0.0))), (best - usual) / (second - usual), best / scatter)


def where_evidence_is(template: Float, image: Float, mask: Float) -> Array:
    """Column, row: template points by their share of the correlation."""
    seen = mask > 0.0
    product = np.where(seen, (template - template[seen].mean()) * (image - image[seen].mean()), 0.0).clip(0.0)
    rows, columns = np.indices(template.shape)
    total = float(product.sum())
    return np.array([float((columns * product).sum()), float((rows * product).sum())]) / total
