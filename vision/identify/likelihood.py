"""Options of each region for assignment.py, and their likelihood. Landmark j shown by region i:

    l_j - (p + r_i) = dp - [r_i]x dtheta + r_i (exp(s) - 1) + e,   log w_j - log w_i = s + e,   psi_j - psi_i = dtheta_z + e

r_i: body to region at the prior, s: log scale of depth. A landmark is two options: measured well, or badly.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.messages import Array
from vision.identify import clutter
from vision.identify.assignment import COLUMNS, GROWTH, POSITION, ROWS, SCALE, STATES, Options
from vision.identify.catalogue import OBLONG, Assumptions, Catalogue, Sighting, chroma
from vision.identify.similarity import similarity

_GATE = 30.0  # chi-square of 3: a position further off than this is not followed (2e-6)


def similarities(sightings: list[Sighting], landmarks: Catalogue, scale: Array) -> Array:
    """Eq. 5.5 of each region and landmark (M, J); scale (M, J): on lengths."""
    s = np.array([(r.size_m2, r.width_m, r.length_m, r.fill_ratio) for r in sightings]).reshape(-1, 1, 4)
    factor = np.stack([scale**2, scale, scale, np.ones_like(scale)], axis=-1)
    return similarity(s * factor, landmarks.description[None], landmarks.weights[None])


def options(
    sightings: list[Sighting], landmarks: Catalogue, p_n: Array, covariance: Array, candidate: NDArray[np.bool_], scale: Array,
    assumptions: Assumptions,
) -> Options:  # fmt: skip
    """Not in the map, and each candidate (M, J), measured well or badly.

    covariance (7, 7) of x; scale (M, J): on lengths.
    """
    b = assumptions
    arm = np.array([r.arm_n for r in sightings]).reshape(-1, 3)
    moved = np.array([r.moved_n for r in sightings]).reshape(-1, 3)
    own = np.array([r.covariance_n for r in sightings]).reshape(-1, 3, 3)
    depth = np.array([r.depth_sigma for r in sightings])
    features = np.array([_features(r) for r in sightings]).reshape(-1, 4)
    noise = np.array([_feature_noise(r, b) for r in sightings]).reshape(-1, 4, 4)
    wide = np.array([_bad_noise(r, b) for r in sightings]).reshape(-1, ROWS)
    of_each = [_pairs_of(i, r, landmarks, candidate[i], scale[i]) for i, r in enumerate(sightings)]
    pairs = _Pairs(*map(np.concatenate, zip(_NO_PAIRS, *of_each, strict=True)))
    region, landmark, bad, y, A, log_density = _whitened(
        p_n, moved, depth, own + b.centre_sigma_m**2 * np.eye(3), noise, wide, landmarks.outline_sigma_m, covariance,
        *pairs,
    )  # fmt: skip
    colours = np.array([r.colour_bgr or (math.nan,) * 3 for r in sightings]).reshape(-1, 3)
    colour, ground_colour = _colour(chroma(colours), landmarks.chroma, b)
    there = math.log(b.found_fraction * (1.0 - b.gone_fraction))
    weight = there + np.where(bad, math.log(b.bad_fraction), math.log1p(-b.bad_fraction)) + log_density
    weight += colour[region, landmark]

    count = len(sightings)
    own = own + depth[:, None, None] ** 2 * arm[:, :, None] * arm[:, None, :]
    clutter_y, clutter_a, clutter_log = clutter.row(p_n + moved, arm, own, landmarks, b)
    turns, log_scales = clutter.grid(covariance)
    by_depth = depth[:, None, None] ** 2 * np.outer((1.0, 1.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0))
    attributes = clutter.attributes(features, noise + by_depth, landmarks, turns, log_scales, b)
    for i, r in enumerate(sightings):
        if r.partial is not None:
            attributes[i] = clutter.sides(r.partial, noise[i] + by_depth[i], len(landmarks.ids), turns, log_scales, b)
            own[i] += np.cov(landmarks.position_n[r.partial.landmark] - r.partial.target_n, rowvar=False, bias=True)
    clutter_density = clutter.clutter_density(moved + arm, own, attributes, landmarks, turns, log_scales, b)
    clutter_log += ground_colour + clutter_density.highest
    order = np.argsort(np.concatenate([np.arange(count), region]), kind="stable")
    all_regions = np.concatenate([np.arange(count), region])[order]
    return Options(
        start=np.searchsorted(all_regions, np.arange(count + 1)),
        landmark=np.concatenate([np.full(count, -1), landmark])[order],
        y=np.concatenate([clutter_y, y])[order],
        A=np.concatenate([clutter_a, A])[order],
        log_weight=np.concatenate([clutter_log, weight])[order],
        clutter_density=clutter_density,
    )


class _Pairs(NamedTuple):
    """N pairs: arm (N, 3); target, variance (N, 3) mapped; features, described, known (N, 4)."""

    region: NDArray[np.int64]
    landmark: NDArray[np.int64]
    arm: Array
    target: Array
    variance: Array
    features: Array
    described: Array
    known: NDArray[np.bool_]


_NONE, _NONE_3, _NONE_4 = np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4))
_NO_PAIRS = _Pairs(_NONE, _NONE, _NONE_3, _NONE_3, _NONE_3, _NONE_4, _NONE_4, np.empty((0, 4), np.bool_))


def _pairs_of(i: int, r: Sighting, landmarks: Catalogue, candidate: NDArray[np.bool_], scale: Array) -> _Pairs:
    part = r.partial
    if part is None:
        j = np.flatnonzero(candidate)
        arm, seen, known = r.arm_n, np.array(_features(r)), np.ones(4, np.bool_)
        target, described, variance = landmarks.position_n[j], landmarks.features[j], landmarks.variance_n[j]
    else:
        kept = candidate[part.landmark]
        j, arm, seen, known = part.landmark[kept], part.middle_n, part.features, part.known
        target, described = part.target_n[kept], part.described[kept]
        variance = landmarks.variance_n[j] + np.outer(landmarks.outline_sigma_m[j] ** 2, (1.0, 1.0, 0.0))
    features = seen + np.outer(np.log(scale[j]), (1.0, 1.0, 0.0, 0.0))
    rows = len(j)
    return _Pairs(
        np.full(rows, i), j, arm * scale[j, None], target, variance, features, described, np.broadcast_to(known, (rows, 4))
    )


def _features(r: Sighting) -> tuple[float, float, float, float]:
    return math.log(r.width_m), math.log(r.length_m), r.fill_ratio, r.orientation_rad


def _feature_noise(r: Sighting, b: Assumptions) -> Array:
    fill, turn = r.fill_ratio_sigma**2 + b.fill_ratio_sigma**2, r.orientation_sigma_rad**2
    if r.length_m < OBLONG * r.width_m and abs(r.fill_ratio - 0.25 * math.pi) < 0.07:
        turn += 1.0  # round: it has no orientation
    noise = np.diag([b.size_sigma**2, b.size_sigma**2, fill, turn])
    noise[:2, :2] += r.log_size_covariance
    return noise


def _bad_noise(r: Sighting, b: Assumptions) -> list[float]:
    centre = (b.bad_centre * r.length_m) ** 2
    size, turn = b.bad_log_size**2, math.radians(b.bad_orientation_deg) ** 2
    return [size, size, b.bad_fill_ratio**2, turn, centre, centre, 1.0]


def _colour(region: Array, landmark: Array, b: Assumptions, sigma: float = 0.06, any_colour: float = 0.3) -> tuple[Array, Array]:
    """Log density of a region's chroma as each landmark (M, J), and as none (M,): normal, or uniform (any_colour of the time)."""
    squared = ((region[:, None] - landmark[None]) ** 2).sum(axis=-1) / sigma**2
    density = (1.0 - any_colour) * np.exp(-0.5 * squared) / (2.0 * math.pi * sigma**2) + any_colour * 2.0
    known = np.isfinite(density)
    counted = known.sum(axis=1)
    population = np.where(known, density, 0.0).sum(axis=1) / np.maximum(counted, 1)
    none = np.where(counted > 0, b.look_alike_fraction * population + (1.0 - b.look_alike_fraction) * 2.0, 1.0)
    return np.log(np.where(known, density, none[:, None])), np.log(none)


def _whitened(
    p_n: Array, moved: Array, depth: Array, own: Array, noise: Array, wide: Array, outline_sigma: Array, prior: Array,
    region: NDArray[np.int64], landmark: NDArray[np.int64], arm: Array, target: Array, variance: Array, features: Array,
    described: Array, known: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_], Array, Array, Array]:  # fmt: skip
    y, A = _rows(p_n + moved[region], arm, features, target, described)
    N, unit = np.zeros((len(region), ROWS, ROWS)), np.eye(3)
    turn_variance = prior[3, 3] + prior[4, 4] + prior[5, 5]
    # what the linear equations leave out: 1/2 dtheta^2 r and s dtheta r
    left_out = turn_variance * (0.75 * turn_variance + prior[SCALE, SCALE]) * (arm * arm).sum(axis=1)
    N[:, POSITION:, POSITION:] = own[region] + (variance + left_out[:, None])[:, :, None] * unit
    N[:, :POSITION, :POSITION] = noise[region]
    grown = 2.0 * outline_sigma[landmark, None] * np.exp(-described[:, :2])
    N[:, :2, :2] += _outer(grown)
    N += depth[region, None, None] ** 2 * _outer(A[:, :, SCALE] + A[:, :, GROWTH])
    bad_noise = wide[region]
    spread = N[:, POSITION:, POSITION:] + bad_noise[:, POSITION:, None] * unit
    possible = ~_excluded(y[:, POSITION:], A[:, POSITION:], spread, prior, arm)
    for pair, row in np.argwhere(~known & possible[:, None]):
        _say_nothing(row, y[pair], A[pair], N[pair], bad_noise[pair])
    pair, diagonal = np.repeat(np.flatnonzero(possible), 2), np.arange(ROWS)
    y, A, N = y[pair], A[pair], N[pair]
    N[1::2, diagonal, diagonal] += bad_noise[possible]
    log_density = _whiten(N, y, A)
    return region[pair], landmark[pair], np.arange(len(pair)) % 2 == 1, y, A, log_density


def _say_nothing(row: int, y: Array, A: Array, N: Array, wide: Array) -> None:
    y[row], A[row], wide[row] = 0.0, 0.0, 0.0
    N[row], N[:, row] = 0.0, 0.0
    N[row, row] = 0.5 / math.pi


def _whiten(N: Array, y: Array, A: Array) -> Array:
    """y, A <- L^-1 y, L^-1 A with N = L L', in place; returns -1/2 log det(2 pi N)."""
    low = np.linalg.cholesky(N)
    white = np.linalg.solve(low, np.concatenate((y[..., None], A), axis=-1))
    y[...], A[...] = white[..., 0], white[..., 1:]
    log_root = np.log(np.diagonal(low, axis1=-2, axis2=-1)).sum(axis=-1)
    return np.asarray(-log_root - 0.5 * y.shape[-1] * math.log(2.0 * math.pi))


def _outer(a: Array) -> Array:
    return a[:, :, None] * a[:, None, :]


def _excluded(y: Array, A: Array, spread: Array, prior: Array, r: Array) -> NDArray[np.bool_]:
    linear = A[:, :, :STATES].copy()
    linear[:, :, SCALE] += A[:, :, GROWTH]
    whole = linear @ prior @ linear.transpose(0, 2, 1) + spread + 0.75 * prior[SCALE, SCALE] ** 2 * _outer(r)
    chi2 = (y * np.linalg.solve(whole, y[:, :, None])[:, :, 0]).sum(axis=1)
    return np.asarray(chi2 > _GATE)


def _rows(p_n: Array, r: Array, features: Array, position: Array, described: Array) -> tuple[Array, Array]:
    y, A = np.empty((len(r), ROWS)), np.zeros((len(r), ROWS, COLUMNS))
    y[:, :POSITION] = described - features
    y[:, POSITION:] = position - p_n - r
    half_turn = np.where(described[:, 1] - described[:, 0] > math.log(OBLONG), math.pi, 0.5 * math.pi)
    y[:, 3] = (y[:, 3] + 0.5 * half_turn) % half_turn - 0.5 * half_turn
    A[:, 0, SCALE] = A[:, 1, SCALE] = 1.0
    A[:, 3, 5] = 1.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        A[:, POSITION + i, i] = 1.0
        A[:, POSITION + j, 3 + k], A[:, POSITION + k, 3 + j] = r[:, i], -r[:, i]  # -[r]x
    A[:, POSITION:, GROWTH] = r
    return y, A
