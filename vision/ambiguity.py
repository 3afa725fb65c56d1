"""Other poses that show the same picture: half a turn about a symmetric landmark, and the mirrored tilt of a flat one.

    half turn:  p' = c + Z (p - c),  R' = Z R,            Z = exp(pi e_d), c the landmarks' middle
    mirror:     the same, then half a turn about the line of sight, R' = exp(pi u') Z R,  u' = Z u

Seen from far enough a flat roof cannot tell the mirrored pose from the true one (Oberkampf, DeMenthon and Davis 1996); a
rectangle, or several laid out like one, cannot tell half a turn.
"""

import math
from collections.abc import Sequence

import numpy as np

from models import so3
from models.landmarks import Landmark
from models.messages import Array

_HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def alternatives(p_n: Array, R_nb: Array, landmarks: Sequence[Landmark]) -> list[tuple[Array, Array]]:
    """Poses (p_n, R_nb) that may look the same."""
    centre = np.array(
        [*np.mean([mark.centre_n for mark in landmarks], axis=0), float(np.mean([mark.roof_d for mark in landmarks]))]
    )
    turned_p, turned_R = centre + _HALF_TURN @ (p_n - centre), _HALF_TURN @ R_nb
    sight = centre - turned_p
    mirrored_R = so3.matrix(so3.quat_exp(math.pi * sight / np.linalg.norm(sight))) @ turned_R
    return [(turned_p, turned_R), (turned_p, mirrored_R)]
