"""Other poses that show the same picture: half or quarter a turn about a symmetric landmark, and the mirrored tilt of a flat one.

    turn:       p' = c + Z (p - c),  R' = Z R,            Z = exp(pi e_d) or exp(+-pi/2 e_d), c the landmarks' middle
    mirror:     the same, then half a turn about the line of sight, R' = exp(pi u') Z R,  u' = Z u

Seen from far enough a flat roof cannot tell the mirrored pose from the true one (Oberkampf, DeMenthon and Davis 1996); a
rectangle, or several laid out like one, cannot tell half a turn, nor a square a quarter. A round roof, drawn as a polygon, cannot
tell any turn: its edges fit wherever the polygon is turned to.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models import so3
from models.landmarks import Landmark
from models.messages import Array

ANY_TURN_RAD = math.pi / math.sqrt(3.0)  # standard deviation
_HALF_TURN = np.diag([-1.0, -1.0, 1.0])
_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
_FEWEST_CORNERS, _OUT_OF_ROUND = 10, 0.05  # of a polygon that stands for a circle; of the corners' distances from the middle


def round_landmarks(vertices: Array, offsets: NDArray[np.int64]) -> list[tuple[int, Array]]:
    """Index and middle (2,) of the outlines, vertices (n, 2) from offsets (L + 1,) on, that stand for circles."""
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
    centre = np.array(
        [*np.mean([mark.centre_n for mark in landmarks], axis=0), float(np.mean([mark.roof_d for mark in landmarks]))]
    )
    turned_p, turned_R = centre + _HALF_TURN @ (p_n - centre), _HALF_TURN @ R_nb
    sight = centre - turned_p
    mirrored_R = so3.matrix(so3.quat_exp(math.pi * sight / np.linalg.norm(sight))) @ turned_R
    quarters = [(centre + Z @ (p_n - centre), Z @ R_nb) for Z in (_QUARTER_TURN, _QUARTER_TURN.T)]
    return [(turned_p, turned_R), (turned_p, mirrored_R), *quarters]
