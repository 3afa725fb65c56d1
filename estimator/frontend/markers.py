"""Landmarks for viewers."""

from typing import Final

import numpy as np

from logs.wire.encoding import Encoded
from logs.wire.markers import encode_landmarks
from models.maps.landmarks import LandmarkMap
from models.messages import Array

_REACH_M: Final = 300.0
_MOST: Final = 300  # landmarks in a message
_MOVED_M: Final = 100.0  # from where they were published last
_LEAST_NS: Final = 1_000_000_000  # between two messages


class LandmarkBoard:
    """Landmarks within 300 m, once a second, changes only."""

    def __init__(self, landmarks: LandmarkMap) -> None:
        self._landmarks = landmarks
        self._sent_ns: int | None = None
        self._used: frozenset[str] = frozenset()
        self._place = np.zeros(3)

    def news(self, t_ns: int, p_n: Array, used: frozenset[str]) -> list[Encoded]:
        """The message if due; used: landmark ids of the newest fix."""
        if self._sent_ns is not None:
            same = used == self._used and np.linalg.norm((p_n - self._place)[:2]) <= _MOVED_M
            if same or 0 <= t_ns - self._sent_ns < _LEAST_NS:
                return []
        self._sent_ns, self._used, self._place = t_ns, used, p_n
        near = self._landmarks.near(float(p_n[0]), float(p_n[1]), _REACH_M)[:_MOST]
        return [encode_landmarks(t_ns, near, used)]
