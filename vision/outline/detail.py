"""An outline simplified to the image's resolution.

Short sides cannot be measured: corners between sides that hardly turn are removed repeatedly while the curve stays within a pixel
of its chords; the lost area is restored.
"""

import math

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.maps import outline as polygon
from models.maps.landmarks import Landmark
from models.messages import Array

_SHORT_PX = 16.0  # of a side: two corners are left out, and some points between them
_ASIDE_PX = 1.0  # of the curve from its chord
_BEND = math.cos(math.radians(50.0))


def as_seen(mark: Landmark, px_per_m: float) -> Landmark:
    """The landmark for an image of that scale; itself where its sides are long enough."""
    outline = mark.outline_n
    while len(outline) > 4:
        wanted = _drop(outline, px_per_m)
        if not wanted.any():
            break
        outline = outline[~wanted]
    if len(outline) == len(mark.outline_n):
        return mark
    return msgspec.structs.replace(mark, outline_n=_grown(outline, polygon.area(mark.outline_n)))


@njit(cache=True)
def _drop(outline: Array, px_per_m: float) -> NDArray[np.bool_]:
    count = len(outline)
    may = np.zeros(count, np.bool_)
    for k in range(count):
        if may[k - 1] or (k == count - 1 and may[0]):
            continue
        bn, be = outline[k, 0] - outline[k - 1, 0], outline[k, 1] - outline[k - 1, 1]  # the side before the corner
        an, ae = outline[(k + 1) % count, 0] - outline[k, 0], outline[(k + 1) % count, 1] - outline[k, 1]  # and after it
        before, after, chord = math.hypot(bn, be), math.hypot(an, ae), math.hypot(bn + an, be + ae)
        turns = (bn * an + be * ae) / max(before * after, 1e-9) <= _BEND
        aside = abs(bn * ae - be * an) / max(chord, 1e-9)
        may[k] = not turns and min(before, after) * px_per_m < _SHORT_PX and aside * px_per_m < 2.0 * _ASIDE_PX
    return may


def _grown(outline: Array, area: float) -> Array:
    side = np.roll(outline, -1, axis=0) - outline
    length = np.linalg.norm(side, axis=1)
    distance = (area - polygon.area(outline)) / float(length.sum())
    outward = np.column_stack((-side[:, 1], side[:, 0])) / length[:, None]
    before = np.roll(outward, 1, axis=0)
    mitre = (before + outward) / (1.0 + np.sum(before * outward, axis=1))[:, None]
    return np.asarray(outline + distance * mitre)
