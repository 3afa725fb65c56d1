"""Small landmarks: the whole outline measured by its shift delta (2,) [px].

    d = argmax_d |sum_i n_i . g(x_i + d)|^2 / sum_i (|g(x_i + d)| + g_0)                             (whole pixels)
    r_i = n_i . delta + e_i

g: gradients of all channels; x_i, n_i: outline points and normals; r_i: steepest contrast near d. None is sought where the inside
is darker ground (shadow).
"""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.maps.landmarks import Landmark
from models.messages import Array
from vision.image.rectify import Image
from vision.image.reduced import gradient
from vision.outline import profiles
from vision.outline.visibility import Kind, ModelEdges, Prisms, visible_edges
from vision.pose.sensitivity import Eye, Samples, ends_px, sample_edges

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
_ROOF = int(Kind.ROOF)
_LONGEST_PX = 12.0  # of a side that is no edge: of four points, three pixels apart, that make one
_SPACING_PX = 1.5  # of its points
_LEAST_POINTS = 6
_LEAST_IN_VIEW = 0.7  # of its points, in the image
_SPAN = 0.1  # of n_i n_i^T, the mean: what the border leaves of a rim must still tell both directions
_FLOOR = 2.0  # g_0, grey values per pixel
_LEAST = 0.5  # of all gradients along the rim lead to the same side, at least
_ASIDE_PX = 2.0  # from the rim, where the colours inside and outside are examined
_RIVAL = 0.85  # of the best shift's score: another one that has so much makes a small landmark ambiguous,
_APART_PX = 3  # if it is farther off than this
_HALF, _STEP_PX = 5, 0.5  # of profiles on which the steepest position is found


def blocks(edges: ModelEdges, eye: Eye, pose: tuple[Array, Array]) -> tuple[Indices, Mask]:
    """Measured-together edges (E,), by their first; which (E,) are of small landmarks."""
    return _blocks(edges.landmark, edges.kind, ends_px(edges, eye, pose))


@njit(cache=True)
def _blocks(landmark: Indices, kind: Indices, ends: Array) -> tuple[Indices, Mask]:
    count = len(kind)
    block, is_small, e = np.arange(count), np.zeros(count, np.bool_), 0
    while e < count:
        stop, longest = e, 0.0
        while stop < count and kind[stop] == _ROOF and landmark[stop] == landmark[e]:
            length = math.hypot(ends[count + stop, 0] - ends[stop, 0], ends[count + stop, 1] - ends[stop, 1])
            longest = np.inf if math.isnan(length) else max(longest, length)
            stop += 1
        small = longest < _LONGEST_PX
        while stop < count and landmark[stop] == landmark[e]:
            stop += 1
        if small:
            for i in range(e, stop):
                block[i], is_small[i] = e, True
        e = stop
    return block, is_small


def small(landmarks: Sequence[Landmark], eye: Eye, pose: tuple[Array, Array]) -> Mask:
    """Small landmarks (L,) in the image of a pose."""
    edges = visible_edges(Prisms.of(landmarks), eye.pose(*pose)[0])
    are_small = np.zeros(len(landmarks), np.bool_)
    are_small[edges.landmark[blocks(edges, eye, pose)[1]]] = True
    return are_small


def sampled(
    edges: ModelEdges, eye: Eye, pose: tuple[Array, Array], spacing_px: float, most: int, wanted: Mask, is_small: Mask
) -> Samples:
    """Points on wanted edges (E,), as sample_edges; small landmarks: closer, rims only."""
    samples = sample_edges(edges, eye, *pose, spacing_px, most, wanted & ~is_small)
    if not is_small.any():
        return samples
    more = sample_edges(edges, eye, *pose, _SPACING_PX, most, is_small & (edges.kind == Kind.ROOF))
    return Samples(
        np.concatenate((samples.points_n, more.points_n)), np.concatenate((samples.t, more.t)),
        np.concatenate((samples.edge, more.edge)), np.concatenate((samples.tau, more.tau)),
    )  # fmt: skip


def measure(
    image: Image, px: Array, normal: Array, of_small: Mask, block: Indices, half: int, seen: Mask, offsets: Array, usable: Mask
) -> None:
    """Set offsets (N,) px (NaN: none) and usable (N,) of small landmarks, shifts within half px.

    px, normal (N, 2); of_small (N,), block (N,): points of one in a row.
    """
    points = np.flatnonzero(of_small)
    if not len(points):
        return
    (rows, columns), (u, v) = image.shape[:2], px.T
    inside = seen & (u >= 1.0) & (v >= 1.0) & (u < columns - 2) & (v < rows - 2)
    for is_small in np.split(points, np.flatnonzero(np.diff(block[points])) + 1):
        offsets[is_small], usable[is_small] = np.nan, False
        some = is_small[inside[is_small]]
        if len(some) >= max(_LEAST_POINTS, _LEAST_IN_VIEW * len(is_small)) and _span(normal[some]) >= _SPAN:
            usable[some] = True
            offsets[some] = _shifted(image, px[some], normal[some], half)


@njit(cache=True)
def _span(normal: Array) -> float:
    """The smaller eigenvalue of the mean of n n^T, 0 ... 1/2, of normals (N, 2)."""
    uu = vv = uv = 0.0
    for i in range(len(normal)):
        uu += normal[i, 0] ** 2
        vv += normal[i, 1] ** 2
        uv += normal[i, 0] * normal[i, 1]
    uu, vv, uv = uu / len(normal), vv / len(normal), uv / len(normal)
    return float(0.5 * (uu + vv) - math.hypot(0.5 * (uu - vv), uv))


def _shifted(image: Image, px: Array, normal: Array, half: int) -> Array:
    du, dv, contrast = _whole_shift(image, px, normal, half)
    offsets = np.full(len(px), np.nan)
    if not np.any(contrast):
        return offsets
    at, usable = px + np.array([du, dv]), np.ones(len(px), np.bool_)
    values = profiles.profiles(image, at, normal, _HALF, _STEP_PX, 1, usable)
    _steepest(values, contrast, normal, du, dv, usable, offsets)
    return offsets


@njit(cache=True)
def _steepest(values: Array, contrast: Array, normal: Array, du: int, dv: int, usable: Mask, offsets: Array) -> None:
    """Steepest change along the contrast (C,) on profiles (N, S, C); fills usable offsets (N,)."""
    steep = np.zeros(2 * _HALF + 1)
    for i in range(len(values)):
        if not usable[i]:
            continue
        for j in range(1, 2 * _HALF):
            steep[j] = 0.0
            for c in range(len(contrast)):
                steep[j] += (values[i, j + 1, c] - values[i, j - 1, c]) * contrast[c]
        j = 2
        for k in range(3, 2 * _HALF - 1):
            j = k if steep[k] > steep[j] else j
        before, here, after = steep[j - 1], steep[j], steep[j + 1]
        if here > 0.0 and here >= before and here >= after and here > 0.5 * (before + after):
            s = (j - _HALF + 0.5 * (before - after) / (before - 2.0 * here + after)) * _STEP_PX
            offsets[i] = du * normal[i, 0] + dv * normal[i, 1] + s


@njit(cache=True)
def _whole_shift(image: Image, px: Array, normal: Array, half: int) -> tuple[int, int, Array]:
    """d and the outward colour direction (C,) there; 0 where no shift stands out."""
    pixel = np.empty(px.shape, np.int64)
    for i in range(len(px)):
        pixel[i, 0], pixel[i, 1] = int(px[i, 0] + 0.5), int(px[i, 1] + 0.5)
    size, none = 2 * half + 1, np.zeros(image.shape[2])
    left = right = pixel[0, 0]
    top = bottom = pixel[0, 1]
    for i in range(1, len(pixel)):
        left, right = min(left, pixel[i, 0]), max(right, pixel[i, 0])
        top, bottom = min(top, pixel[i, 1]), max(bottom, pixel[i, 1])
    left, top = left - half, top - half
    g = _gradients(image, left, top, right + half - left + 1, bottom + half - top + 1)
    score, best, at = np.zeros((size, size)), 0.0, (0, 0)
    for b in range(size):
        for a in range(size):
            across, total = _across(g, pixel, normal, a - half - left, b - half - top)
            square = 0.0
            for c in range(len(across)):
                square += across[c] ** 2
            if square > (_LEAST * total) ** 2:
                score[b, a] = square / total
    for _ in range(size * size):
        a = b = 0
        for k in range(size * size):
            if score[k // size, k % size] > score[b, a]:
                b, a = k // size, k % size
        if score[b, a] <= _RIVAL * best:
            break
        if _in_shadow(image, pixel, normal, a - half, b - half):
            score[b, a] = 0.0
        elif best == 0.0:
            best, at = score[b, a], (b, a)
            for i in range(max(b - _APART_PX, 0), min(b + _APART_PX + 1, size)):
                for j in range(max(a - _APART_PX, 0), min(a + _APART_PX + 1, size)):
                    score[i, j] = 0.0
        else:
            return 0, 0, none
    if best == 0.0:
        return 0, 0, none
    across, _ = _across(g, pixel, normal, at[1] - half - left, at[0] - half - top)
    square = 0.0
    for c in range(len(across)):
        square += across[c] ** 2
    for c in range(len(across)):
        across[c] /= math.sqrt(square)
    return at[1] - half, at[0] - half, across


@njit(cache=True)
def _in_shadow(image: Image, pixel: Indices, normal: Array, du: int, dv: int) -> bool:
    rows, columns, channels = image.shape
    inside, outside = np.zeros(channels), np.zeros(channels)
    for i in range(len(pixel)):
        for side in (-_ASIDE_PX, _ASIDE_PX):
            u = min(max(int(pixel[i, 0] + du + side * normal[i, 0] + 0.5), 0), columns - 1)
            v = min(max(int(pixel[i, 1] + dv + side * normal[i, 1] + 0.5), 0), rows - 1)
            for c in range(channels):
                if side < 0.0:
                    inside[c] += float(image[v, u, c])
                else:
                    outside[c] += float(image[v, u, c])
    return profiles.shaded(inside, outside)


@njit(cache=True)
def _across(g: Array, pixel: Indices, normal: Array, du: int, dv: int) -> tuple[Array, float]:
    """sum_i n_i . g_i (C,), sum_i (|g_i| + g_0) at pixel (N, 2) moved by du, dv; 0 if outside."""
    channels = g.shape[2] // 2
    across, total = np.zeros(channels), 0.0
    for i in range(len(pixel)):
        here = g[pixel[i, 1] + dv, pixel[i, 0] + du]
        square = 0.0
        for c in range(channels):
            across[c] += here[c] * normal[i, 0] + here[channels + c] * normal[i, 1]
            square += here[c] ** 2 + here[channels + c] ** 2
        if not square >= 0.0:
            return across, 0.0
        total += math.sqrt(square) + _FLOOR
    return across, total


@njit(cache=True)
def _gradients(image: Image, left: int, top: int, width: int, height: int) -> Array:
    """d/du, d/dv of all channels (height, width, 2 C), Sobel; NaN outside."""
    rows, columns, channels = image.shape
    g = np.full((height, width, 2 * channels), np.nan)
    for y in range(max(top, 1), min(top + height, rows - 1)):
        for x in range(max(left, 1), min(left + width, columns - 1)):
            for c in range(channels):
                g[y - top, x - left, c], g[y - top, x - left, channels + c] = gradient(image, y - 1, y, y + 1, x - 1, x, x + 1, c)
    return g
