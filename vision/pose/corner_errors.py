"""Effect of corner errors on edges and pose.

    offset = n^T (e_1 + e_2) / 2,   tilt = n^T (e_2 - e_1) / 2,   e ~ N(0, sigma^2 I)

n: normal of an edge, e_1, e_2: errors of its corners. Both: variance sigma^2 / 2, independent.
"""

import numpy as np
from numpy.typing import NDArray

from models.measurements import DIRECTION_SCALE
from models.messages import Array
from vision.pose.least_squares import POSE


def by_corners(cornered: Array) -> Array:
    """B (E, 2 K, 2): offset and tilt of each edge in K images by two unit-variance errors; cornered (E, K)."""
    own = np.zeros((*cornered.shape, 2, 2))
    own[:, :, 0, 0] = own[:, :, 1, 1] = cornered
    return own.reshape(len(own), -1, 2)


def repeating(moved: Array, landmark: NDArray[np.int64], count: int, room: int) -> Array:
    """(L, 6, room): main part, as unit-variance errors, of edge errors' (E, 6, c) effect on the pose.

    landmark (E,) of `count`.
    """
    whole = np.zeros((count, POSE, POSE))
    np.add.at(whole, landmark, moved @ moved.transpose(0, 2, 1))
    values, vectors = np.linalg.eigh(whole / DIRECTION_SCALE[:, None] / DIRECTION_SCALE)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.asarray(DIRECTION_SCALE[:, None] * root[:, :, ::-1][:, :, :room])
