"""Other poses that show the same image.

    turn:       p' = c + Z (p - c),  R' = Z R,            Z = exp(pi e_d) or exp(+-pi/2 e_d), c the landmarks' middle
    mirror:     the same, then half a turn about the line of sight, R' = exp(pi u') Z R,  u' = Z u
    step:       p' = p + l' - l,  R' = R                   l' a landmark like l

(Oberkampf, DeMenthon and Davis 1996). Rectangle: half turns; square: quarters; round roof: any turn.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models import so3
from models.maps.landmarks import Landmark
from models.messages import Array
from vision.identify.similarity import normalised, similarity

ANY_TURN_RAD = math.pi / math.sqrt(3.0)  # standard deviation
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])
_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_ALIKE = 0.75  # similarity from which one may be taken for the other, as in identify.py
_OBLONG, _TURNED_RAD = 1.3, 0.26  # length over width; by which the prior's heading, and a row's houses, may differ
_STEP_M = 5.0  # to which rows of houses keep their distance
_ONE_STEP = 0.1  # of a house's width: steps that differ by less are one
_FEWEST_CORNERS, _OUT_OF_ROUND = 10, 0.05  # of a polygon that stands for a circle; of the corners' distances from the middle


def round_landmarks(vertices: Array, offsets: NDArray[np.int64]) -> list[tuple[int, Array]]:
    """Index and middle (2,) of outlines that stand for circles; vertices (n, 2) by offsets (L + 1,)."""
    found = []
    for mark, (start, stop) in enumerate(pairwise(offsets.tolist())):
        if stop - start < _FEWEST_CORNERS:
            continue
        middle = vertices[start:stop].mean(axis=0)
        radius = np.linalg.norm(vertices[start:stop] - middle, axis=1)
        if np.ptp(radius) < _OUT_OF_ROUND * radius.mean():
            found.append((mark, middle))
    return found


def alternatives(p_n: Array, R_nb: Array, landmarks: Sequence[Landmark]) -> list[tuple[Array, Array]]:
    """Poses (p_n, R_nb) that may look the same."""
    centre = np.array([(*mark.centre_n, mark.roof_d) for mark in landmarks]).mean(axis=0)
    turned_p, turned_R = centre + _HALF_TURN @ (p_n - centre), _HALF_TURN @ R_nb
    sight = centre - turned_p
    mirrored_R = so3.matrix(so3.quat_exp(math.pi * sight / math.sqrt(sight @ sight))) @ turned_R
    quarters = [(centre + Z @ (p_n - centre), Z @ R_nb) for Z in (_QUARTER_TURN, _QUARTER_TURN.T)]
    return [(turned_p, turned_R), (turned_p, mirrored_R), *quarters]


def steps_off(
    p_n: Array, used: Sequence[Landmark], near: Sequence[Landmark], prior_p_n: Array, prior_covariance: Array, odds: float,
    share: float,
) -> Array:  # fmt: skip
    """Steps (S, 3) to positions less than `odds` times less likely by the prior, where enough of the landmarks `used` have a
    similar one.
    """
    several, weights = _described(near), normalised(np.array([mark.weights for mark in near]))
    positions = np.array([(*mark.centre_n, mark.roof_d) for mark in near])
    own = np.array([(*mark.centre_n, mark.roof_d) for mark in used]).reshape(-1, 3)
    alike = np.array([[_as_turned(one, mark) for one in near] for mark in used])
    alike &= similarity(_described(used)[:, None], several[None], weights[None]) >= _ALIKE
    steps = positions[None] - own[:, None]
    alike &= np.linalg.norm(steps[..., :2], axis=2) > 0.5 * np.array([mark.width_m for mark in used])[:, None]  # not the same one
    step = steps[alike]
    inverse, apart = np.linalg.inv(prior_covariance[:3, :3]), p_n - prior_p_n
    limit = float(apart @ inverse @ apart) + 2.0 * math.log(odds)
    allowed = step[np.einsum("sa,ab,sb->s", apart + step, inverse, apart + step) < limit]
    beside = np.linalg.norm(own[None, :, None, :2] + allowed[:, None, None, :2] - positions[None, None, :, :2], axis=3) < _STEP_M
    repeated = (beside & alike[None]).any(axis=2).sum(axis=1)
    return _apart(allowed[repeated > share * len(used)], _ONE_STEP * min((mark.width_m for mark in used), default=0.0))


def _apart(steps: Array, least_m: float) -> Array:
    kept = np.zeros((0, 3))
    for step in steps:
        if not (np.linalg.norm(kept - step, axis=1) < least_m).any():
            kept = np.vstack((kept, step))
    return kept


def _as_turned(one: Landmark, other: Landmark) -> bool:
    """Whether orientations agree; sides of a nearly square one may be exchanged."""
    half_turn = math.pi if one.length_m > _OBLONG * one.width_m else 0.5 * math.pi
    apart = (one.orientation_rad - other.orientation_rad + 0.5 * half_turn) % half_turn - 0.5 * half_turn
    return abs(apart) < _TURNED_RAD


def _described(marks: Sequence[Landmark]) -> Array:
    return np.array([(mark.size_m2, mark.width_m, mark.length_m, mark.fill_ratio) for mark in marks])
