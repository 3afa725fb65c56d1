"""A line of width w (road, canal, railway) as outlines on the ground.

    p_i +- w / 2 m_i,      m_i = (n_a + n_b) / (1 + n_a . n_b)      (n_a, n_b: unit normals before and after corner p_i)

Turns beyond 120 degrees are cut; pieces of at most PIECE_M are landmarks.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from models.messages import Array

PIECE_M = 150.0
_METRES_A_DEGREE = 111_320.0  # of latitude, 0.6 % off at most
_LEAST_COSINE = -0.5  # between neighbouring normals


def strips(line: Sequence[Sequence[float]], width_m: float) -> Iterator[list[list[float]]]:
    """Outlines (longitude, latitude [deg]) of a line."""
    lonlat = np.array([position[:2] for position in line], dtype=np.float64).reshape(-1, 2)
    if not len(lonlat):
        return
    scale = _METRES_A_DEGREE * np.array([math.cos(math.radians(float(np.mean(lonlat[:, 1])))), 1.0])
    for piece in _pieces((lonlat - lonlat[0]) * scale):
        outline: list[list[float]] = (_outline(piece, width_m) / scale + lonlat[0]).tolist()
        yield outline


def _pieces(line_m: Array) -> Iterator[Array]:
    step = np.linalg.norm(np.diff(line_m, axis=0), axis=1)
    line_m = line_m[np.concatenate(([True], step > 0.0))]
    if len(line_m) < 2:
        return
    way = np.diff(line_m, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    sharp = 1 + np.flatnonzero(np.sum(way[1:] * way[:-1], axis=1) < _LEAST_COSINE)
    for part in np.split(np.arange(len(line_m)), sharp):
        corners = line_m[part[0] : part[-1] + 2]
        along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))))
        ends = np.linspace(0.0, along[-1], math.ceil(along[-1] / PIECE_M) + 1)
        for begin, end in pairwise(ends):
            at = np.concatenate(([begin], along[(along > begin) & (along < end)], [end]))
            yield np.column_stack([np.interp(at, along, corners[:, axis]) for axis in (0, 1)])


def _outline(line_m: Array, width_m: float) -> Array:
    way = np.diff(line_m, axis=0)
    normal = way[:, ::-1] * np.array([-1.0, 1.0]) / np.linalg.norm(way, axis=1, keepdims=True)
    before, after = np.concatenate((normal[:1], normal)), np.concatenate((normal, normal[-1:]))
    side = (before + after) / (1.0 + np.sum(before * after, axis=1, keepdims=True)) * (0.5 * width_m)
    return np.concatenate((line_m + side, (line_m - side)[::-1]))
