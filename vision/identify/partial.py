"""Regions cut off by the border: which corners of which landmark they show.

    c_0 ... c_m     visible corners of the region, on the plane of its roof, m >= 1
    l_a ... l_a+m   a run: corners of a landmark with sides alike, its other corners hidden beyond the border
    mean l - (p + mean c) = dp - [mean c]x dtheta + mean c (exp(s) - 1) + e

Two sides' lengths replace width and length, a side's direction (0 to 2 pi) the orientation.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.messages import Array
from vision.image.rectify import Mask

_BORDER_PX: Final = 4  # a corner nearer to where the image ends is one that the border made
_TURN_RAD: Final = 0.35  # between a side seen and a landmark's: the prior's heading, and a street's houses, differ by less
_LOG_LENGTH: Final = 0.6  # of whole sides: what a short baseline leaves open, and then some
_SHORT: Final = 10.0  # times a pixel: shorter ends of sides have no direction
_HIDDEN: Final = 0.02  # of x/z: nearer to the border a hidden corner may be seen after all


@dataclass(frozen=True, slots=True)
class Partial:
    """The visible part of an outline, and N possible runs.

    middle_n (3,): body to the corners' mean; features (4,): log lengths of the longest side and the next, unused, direction of
    the longest; known (4,): measured; landmark (N,); target_n (N, 3): corners' mean; described (N, 4).
    """

    middle_n: Array
    features: Array
    known: NDArray[np.bool_]
    landmark: NDArray[np.int64]
    target_n: Array
    described: Array

    @property
    def sides_m(self) -> Array:
        """(2,) side lengths; for a cut side the other's."""
        lengths = np.exp(self.features[:2])
        return np.where(self.known[:2], lengths, lengths[0])

    def similarity(self, scale: Array, sigma: float) -> Array:
        """Agreement of visible sides with each landmark's (J,) at the best scale within 3 sigma, as eq. 5.5; scale (J,): prior
        factor.
        """
        like = np.zeros(len(scale))
        apart = (self.described - self.features)[:, :2][:, self.known[:2]] - np.log(scale[self.landmark])[:, None]
        fitted = np.clip(apart.mean(axis=1, keepdims=True), -3.0 * sigma, 3.0 * sigma)
        np.maximum.at(like, self.landmark, np.exp(-np.abs(apart - fitted)).mean(axis=1))
        return like


def seen_corners(corners: Array, width: int, height: int, valid: Mask | None) -> NDArray[np.bool_]:
    """Corners (K, 2) px of a region not made by the border."""
    b = _BORDER_PX
    inside = np.all((corners > b) & (corners < (width - 1.0 - b, height - 1.0 - b)), axis=1)
    if valid is not None:
        for k in np.flatnonzero(inside):
            u, v = np.round(corners[k]).astype(int)
            inside[k] = bool(valid[v - b : v + b + 1, u - b : u + b + 1].all())
    return np.asarray(inside)


def chain(points: Array, seen: NDArray[np.bool_]) -> Array | None:
    """The longest run of two or more visible corners of a closed outline (K, D), with its two neighbours."""
    count = len(points)
    if seen.all() or not seen.any():
        return None
    start = int(np.flatnonzero(~seen)[0])
    best: list[int] = []
    run: list[int] = []
    for k in range(start, start + count + 1):
        if seen[k % count]:
            run.append(k)
        else:
            best, run = max(best, run, key=len), []
    return None if len(best) < 2 else points[[k % count for k in range(best[0] - 1, best[-1] + 2)]]


def partial_of(
    arms: Array, vertices: Array, offsets: NDArray[np.int64], roof_d: Array, R_cn: Array, p_c: Array, view: Array, pixel_m: float
) -> Partial | None:  # fmt: skip
    """The visible part and its possible runs; None without any.

    arms (K, 3): body to a chain's corners, anticlockwise from above;  vertices, offsets: outlines, roof_d (J,);  R_cn, p_c: x_c =
    R_cn r - p_c;  view: x/z, y/z limits;  pixel_m: pixel size there.
    """
    seen, middle = arms[1:-1], arms[1:-1].mean(axis=0)
    landmark, first = _runs(
        np.ascontiguousarray(arms[:, :2]), middle, vertices, offsets, np.ascontiguousarray(R_cn), p_c, view, _SHORT * pixel_m
    )  # fmt: skip
    if not len(landmark):
        return None
    sides = len(seen) - 1
    longest = int(np.linalg.norm(np.diff(seen[:, :2], axis=0), axis=1).argmax())
    beside = longest + 1 if longest + 1 < sides else longest - 1
    rows = (longest, beside) if sides > 1 else (longest,)
    corners = np.array([
        vertices[offsets[j] + (a + np.arange(len(seen))) % (offsets[j + 1] - offsets[j])]
        for j, a in zip(landmark.tolist(), first.tolist(), strict=True)
    ])  # fmt: skip
    features, described = _features(seen[None, :, :2], rows)[0], _features(corners, rows)
    described[:, 3] = features[3] + (described[:, 3] - features[3] + math.pi) % (2.0 * math.pi) - math.pi
    target = np.column_stack((corners.mean(axis=1), roof_d[landmark]))
    return Partial(middle, features, np.array([True, sides > 1, False, True]), landmark, target, described)


def _features(corners: Array, rows: tuple[int, ...]) -> Array:
    """(N, 4) of corner runs (N, K, 2): log lengths of sides `rows`, nothing, direction of the first."""
    side = np.diff(corners, axis=1)[:, list(rows)]
    table = np.zeros((len(corners), 4))
    table[:, : len(rows)] = np.log(np.linalg.norm(side, axis=2))
    table[:, 3] = np.arctan2(side[:, 0, 1], side[:, 0, 0])
    return table


@njit(cache=True)
def _runs(
    arms: Array, middle: Array, vertices: Array, offsets: NDArray[np.int64], R_cn: Array, p_c: Array, view: Array, short_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
    landmark, first = np.empty(len(vertices), np.int64), np.empty(len(vertices), np.int64)
    found = 0
    for j in range(len(offsets) - 1):
        outline = vertices[offsets[j] : offsets[j + 1]]
        for a in range(len(outline)):
            if _alike(arms, outline, a, short_m) and _hidden(arms, middle, outline, a, R_cn, p_c, view):
                landmark[found], first[found] = j, a
                found += 1
    return landmark[:found], first[:found]


@njit(cache=True)
def _alike(arms: Array, outline: Array, a: int, short_m: float) -> bool:
    last, n = arms.shape[0] - 2, outline.shape[0]
    if n < last:
        return False
    for k in range(last + 1):
        here, before = outline[(a + k) % n], outline[(a + k - 1) % n]
        dn, de = arms[k + 1, 0] - arms[k, 0], arms[k + 1, 1] - arms[k, 1]
        ln, le = here[0] - before[0], here[1] - before[1]
        length, whole = math.hypot(dn, de), 0 < k < last
        if not whole and length < short_m:
            continue
        ratio = math.log(length / math.hypot(ln, le))
        if ratio > _LOG_LENGTH or (whole and ratio < -_LOG_LENGTH):
            return False
        if abs(math.atan2(dn * le - de * ln, dn * ln + de * le)) > _TURN_RAD:
            return False
    return True


@njit(cache=True)
def _hidden(arms: Array, middle: Array, outline: Array, a: int, R_cn: Array, p_c: Array, view: Array) -> bool:
    seen, n = arms.shape[0] - 2, outline.shape[0]
    north = east = 0.0
    for k in range(seen):
        north += outline[(a + k) % n, 0] / seen
        east += outline[(a + k) % n, 1] / seen
    for k in range(seen, n):
        corner = outline[(a + k) % n]
        to_n, to_e, to_d = middle[0] + corner[0] - north, middle[1] + corner[1] - east, middle[2]
        z = R_cn[2, 0] * to_n + R_cn[2, 1] * to_e + R_cn[2, 2] * to_d - p_c[2]
        if z <= 0.0:
            continue
        x = (R_cn[0, 0] * to_n + R_cn[0, 1] * to_e + R_cn[0, 2] * to_d - p_c[0]) / z
        y = (R_cn[1, 0] * to_n + R_cn[1, 1] * to_e + R_cn[1, 2] * to_d - p_c[1]) / z
        if view[0] + _HIDDEN < x < view[1] - _HIDDEN and view[2] + _HIDDEN < y < view[3] - _HIDDEN:
            return False
    return True
