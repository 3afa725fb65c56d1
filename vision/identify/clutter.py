"""Density of unmapped objects, like mapped ones or anything, estimated from the map around.

A uniform density would make every similar object a certain landmark.
"""

import itertools
import math

import numpy as np
from numba import njit

from models.messages import Array
from vision.identify.assignment import COLUMNS, GROWTH, POSITION, ROWS, SCALE
from vision.identify.catalogue import OBLONG, Assumptions, Catalogue
from vision.identify.clutter_density import ClutterDensity
from vision.identify.partial import Partial

_LIKENESS = np.array([0.05, 0.05, 0.03])  # at most: how far width, length (logarithms), fill ratio of an object are from its like
_LIKE_FEW = 5  # objects that differ so much are added to those of the map: of a few the spread is not known
_NEIGHBOURS, _HEADING_LIKENESS = 5, (math.radians(0.5), 0.1)  # the same of its orientation lies between these
_CONSIDERED = 30  # landmarks, the nearest, from which displacements are counted


def row(p_n: Array, arm: Array, own: Array, landmarks: Catalogue, b: Assumptions) -> tuple[Array, Array, Array]:
    """Unmapped objects are as high as mapped ones: one whitened row."""
    count = len(arm)
    y, A = np.zeros((count, ROWS)), np.zeros((count, ROWS, COLUMNS))
    if not len(landmarks.ids):
        return y, A, np.zeros(count)
    roof = landmarks.position_n[:, 2]
    sigma = np.sqrt(float(np.var(roof)) + b.height_spread_m**2 + own[:, 2, 2])
    d = POSITION + 2
    y[:, d] = (float(np.mean(roof)) - p_n[:, 2] - arm[:, 2]) / sigma
    A[:, d, 2] = 1.0 / sigma
    A[:, d, 3], A[:, d, 4], A[:, d, GROWTH] = arm[:, 1] / sigma, -arm[:, 0] / sigma, arm[:, 2] / sigma
    return y, A, -0.5 * math.log(2.0 * math.pi) - np.log(sigma)


def clutter_density(
    arm: Array, own: Array, attributes: Array, landmarks: Catalogue, turns: Array, log_scales: Array, b: Assumptions
) -> ClutterDensity:
    """Density of unmapped objects at each region's position (arm, covariance own) and attributes (M, T, S)."""
    density = intensity(arm, own, landmarks, turns, log_scales, b)
    above = np.log(density / _anywhere(landmarks, b)).sum(axis=0) / max(len(arm), 1)
    return ClutterDensity(np.log(density * attributes), above, turns, log_scales)


def grid(covariance: Array) -> tuple[Array, Array]:
    """Turns (T,), log scales (S,) that the common errors, covariance (7, 7), leave open."""
    return _offsets(math.sqrt(covariance[5, 5]), math.radians(1.0)), _offsets(math.sqrt(covariance[SCALE, SCALE]), 0.02)


def attributes(features: Array, noise: Array, landmarks: Catalogue, turns: Array, log_scales: Array, b: Assumptions) -> Array:
    """Density of an unmapped object's (log width, log length, fill ratio, orientation) (M, T, S).

    A kernel estimate over the map, mixed with uniform: 1 to 100 m, any fill and orientation. noise (M, 4, 4): of the features,
    own depth error included.
    """
    anything = 1.0 / math.log(100.0) ** 2 / 0.7 / math.pi
    density = np.zeros((len(features), len(turns), len(log_scales)))
    if not len(landmarks.ids):
        return density + anything
    e = landmarks.features[None] - features[:, None]
    half_turn = np.where(landmarks.features[:, 1] - landmarks.features[:, 0] > math.log(OBLONG), math.pi, 0.5 * math.pi)
    kernel = noise + np.diag(_bandwidth(landmarks.features)) ** 2
    white = np.linalg.inv(np.linalg.cholesky(kernel)).transpose(0, 2, 1)  # e white has the covariance 1
    volume = (2.0 * math.pi) ** 2 / np.linalg.det(white)
    grown = white[:, :2].sum(axis=1)
    for k, turn in enumerate(turns):
        turned = e.copy()
        turned[..., 3] = (turned[..., 3] - turn + 0.5 * half_turn) % half_turn - 0.5 * half_turn
        apart = turned @ white
        along, across = (apart @ grown[:, :, None]) * log_scales, (grown**2).sum(axis=1)[:, None, None] * log_scales**2
        squared = (apart**2).sum(axis=2)[:, :, None] - 2.0 * along + across
        density[:, k] = np.exp(-0.5 * squared).mean(axis=1) / volume[:, None]
    return np.asarray(b.look_alike_fraction * density + (1.0 - b.look_alike_fraction) * anything)


def sides(part: Partial, noise: Array, count: int, turns: Array, log_scales: Array, b: Assumptions) -> Array:
    """attributes (T, S) of visible sides: a kernel estimate over `count` landmarks' runs."""
    known = np.flatnonzero(part.known)
    anything = 4.0 / (2.0 * math.pi) / math.log(100.0) ** int(part.known[:2].sum())  # a corner of four
    kernel = (noise + np.diag(_bandwidth(part.described)) ** 2)[np.ix_(known, known)]
    inverse, volume = np.linalg.inv(kernel), math.sqrt(np.linalg.det(2.0 * math.pi * kernel))
    density = np.empty((len(turns), len(log_scales)))
    for (k, turn), (n, s) in itertools.product(enumerate(turns), enumerate(log_scales)):
        e = (part.described - part.features - np.array([s, s, 0.0, turn]))[:, known]
        density[k, n] = np.exp(-0.5 * np.einsum("na,ab,nb->n", e, inverse, e)).sum() / count / volume
    return np.asarray(b.look_alike_fraction * density + (1.0 - b.look_alike_fraction) * anything)


def _bandwidth(features: Array) -> Array:
    """Kernel bandwidth (4,) for features (n, 4): h = sigma (4 / ((d + 2) n))^(1 / (d + 4)), d = 4 (Silverman 1986, eq. 4.14,
    4.15).
    """
    n = len(features) + _LIKE_FEW
    spread = np.sqrt((len(features) * features[:, :3].var(axis=0) + _LIKE_FEW * _LIKENESS**2) / n)
    return np.array([*np.minimum(spread * (4.0 / (6.0 * n)) ** 0.125, _LIKENESS), _heading_likeness(features[:, 3])])


def _heading_likeness(orientation: Array) -> float:
    """Median distance of orientations to their nearest; small in streets."""
    apart = np.abs((orientation[:, None] - orientation + 0.25 * math.pi) % (0.5 * math.pi) - 0.25 * math.pi)
    nearest = np.sort(apart, axis=1)[:, min(_NEIGHBOURS, len(orientation) - 1)]
    return float(np.clip(np.median(nearest), *_HEADING_LIKENESS))


def _offsets(sigma: float, step: float) -> Array:
    return np.asarray(sigma * np.linspace(-2.0, 2.0, min(max(3, 2 * math.ceil(2.0 * sigma / step) + 1), 9)))


def intensity(arm: Array, own: Array, landmarks: Catalogue, turns: Array, log_scales: Array, b: Assumptions) -> Array:
    """Unmapped objects per m^2 at each region's position as seen from the others (M, T, S).

    In streets they stand where landmarks would if the map moved by a block: the landmarks' density at that displacement.
    """
    radius = np.maximum(1.0, 1.4 * np.sqrt(2.0 * own[:, :2, :2].trace(axis1=1, axis2=2) / 2.0))
    position = landmarks.position_n[:, :2].copy()
    moved = _displacement_density(arm[:, :2].copy(), radius, position, turns, np.exp(log_scales))
    return np.maximum(_anywhere(landmarks, b), _unmapped(b) * moved + b.background_per_m2)


def _anywhere(landmarks: Catalogue, b: Assumptions) -> float:
    return _unmapped(b) * landmarks.density_per_m2 + b.background_per_m2


def _unmapped(b: Assumptions) -> float:
    return b.unmapped_fraction / (1.0 - b.unmapped_fraction)


@njit(cache=True)
def _displacement_density(region: Array, radius: Array, position: Array, turns: Array, grown: Array) -> Array:
    """Mean over r (M, T, S) of the landmark density at region i's displacement from region r.

    One pair is left out: it may be these regions.
    """
    result = np.zeros((region.shape[0], turns.shape[0], grown.shape[0]))
    if region.shape[0] < 2 or position.shape[0] < 2:
        return result
    apart = _apart(position)
    for i in range(region.shape[0]):
        norm = (region.shape[0] - 1) * min(position.shape[0], _CONSIDERED) * math.pi * radius[i] * radius[i]
        for t in range(turns.shape[0]):
            for s in range(grown.shape[0]):
                total = 0.0
                for r in range(region.shape[0]):
                    if r != i:
                        total += max(_pairs_apart(region[i] - region[r], turns[t], grown[s], apart, radius[i]) - 1, 0)
                result[i, t, s] = total / norm
    return result


@njit(cache=True)
def _apart(position: Array) -> Array:
    """Displacements (2, D) of all landmarks (L, 2) from each of the nearest."""
    apart, d = np.empty((2, min(len(position), _CONSIDERED) * (len(position) - 1))), 0
    for k in range(min(len(position), _CONSIDERED)):
        for m in range(len(position)):
            if k != m:
                apart[0, d], apart[1, d] = position[m, 0] - position[k, 0], position[m, 1] - position[k, 1]
                d += 1
    return apart


@njit(cache=True)
def _pairs_apart(displacement: Array, turn: float, growth: float, apart: Array, radius: float) -> int:
    c, s = growth * math.cos(turn), growth * math.sin(turn)
    n, e = c * displacement[0] - s * displacement[1], s * displacement[0] + c * displacement[1]
    close, square = 0, radius * radius
    for d in range(apart.shape[1]):
        un, ue = apart[0, d] - n, apart[1, d] - e
        close += un * un + ue * ue < square
    return close
