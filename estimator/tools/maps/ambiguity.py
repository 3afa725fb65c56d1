"""Ambiguous landmarks and repeated surroundings.

Landmark i with a similar j is ambiguous; its position is, where t = l_j - l_i maps its surroundings onto similar ones.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from models.maps import outline as polygon
from models.maps.landmarks import LandmarkMap
from models.maps.table import WEIGHTS, Alike
from models.messages import Array
from vision.identify.similarity import normalised, similarity

RADIUS_M, SIMILAR = 50.0, 0.9  # what counts as near and as alike, by default
MOST_PAIRS = 20_000_000
_OTHER_COLOUR = 100.0  # distance in BGR; lighting alone changes a colour by less
_IN_VIEW_M = 50.0  # to each side: what one image shows
_SAME_SHIFT_M = 2.0  # to each side: map errors, and what an image's scale leaves open
_SHARE = 0.7  # of what is in view
_COLUMNS = [polygon.SIZE, polygon.WIDTH, polygon.LENGTH, polygon.FILL]


def look_alikes(the_map: LandmarkMap, radius_m: float, alike: float) -> tuple[NDArray[np.intp], Array, Array]:
    """Pairs (P, 2) of rows, distances [m], similarities. Raises ValueError for too many."""
    described = the_map.description
    tree = cKDTree(described[:, [polygon.NORTH, polygon.EAST]])
    if tree.count_neighbors(tree, radius_m) > 2 * MOST_PAIRS:
        raise ValueError(f"more than {MOST_PAIRS:.0e} pairs within {radius_m:g} m: look within a smaller radius")
    pairs = tree.query_pairs(radius_m, output_type="ndarray")
    a, b = pairs.T
    similarities = similarity(described[a][:, _COLUMNS], described[b][:, _COLUMNS], normalised(WEIGHTS))
    colour = the_map.columns.colour_bgr.astype(np.float64)
    known = (colour[a, 0] >= 0.0) & (colour[b, 0] >= 0.0)
    kept = (similarities >= alike) & ~(known & (np.linalg.norm(colour[a] - colour[b], axis=1) > _OTHER_COLOUR))
    distances = np.hypot(*(described[a] - described[b])[kept][:, [polygon.NORTH, polygon.EAST]].T)
    return pairs[kept], distances, similarities[kept]


def marks(the_map: LandmarkMap, pairs: NDArray[np.intp], distances: Array) -> Alike:
    """Per landmark: number of look-alikes, the nearest, nearest repeating shift."""
    count = np.bincount(pairs.ravel(), minlength=len(the_map))
    nearest = np.full(len(the_map), np.inf)
    np.minimum.at(nearest, pairs.ravel(), np.repeat(distances, 2))
    return Alike(count, nearest, _repeats(the_map.description[:, [polygon.NORTH, polygon.EAST]], pairs, distances))


def _repeats(places: Array, pairs: NDArray[np.intp], distances: Array) -> Array:
    repeats = np.full(len(places), np.inf)
    if not len(pairs):
        return repeats
    both = np.concatenate((pairs, pairs[:, ::-1]))
    shift = places[both[:, 1]] - places[both[:, 0]]
    around = cKDTree(places)
    in_view = around.query_ball_point(places[both[:, 0]], _IN_VIEW_M, p=np.inf, return_length=True)
    shifted = cKDTree(np.hstack((places[both[:, 0]] / _IN_VIEW_M, shift / _SAME_SHIFT_M)))
    alike = shifted.query_ball_point(shifted.data, 1.0, p=np.inf, return_length=True)
    same = (in_view >= 3) & (alike >= _SHARE * in_view)
    np.minimum.at(repeats, both[same, 0], np.tile(distances, 2)[same])
    return repeats


def marked(the_map: LandmarkMap) -> Alike | None:
    """Marks to write into a map; None where too dense."""
    try:
        pairs, distances, _ = look_alikes(the_map, RADIUS_M, SIMILAR)
    except ValueError:
        return None
    return marks(the_map, pairs, distances)
