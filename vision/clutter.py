"""A region that is no landmark of the map: an object like those of the map, or anything.

Unmapped objects look like mapped ones, and stand in the same streets. Their density is estimated from the map around: assuming
it uniform would make every look-alike a sure landmark.
"""

import math

import numpy as np
from numba import njit

from models.messages import Array
from vision.assignment import COLUMNS, GROWTH, PLACE, ROWS, SCALE
from vision.catalogue import OBLONG, Beliefs, Catalogue
from vision.partial import Partial

_CONSIDERED = 30  # landmarks, the nearest, among which displacements are counted


def row(p_n: Array, arm: Array, own: Array, landmarks: Catalogue, b: Beliefs) -> tuple[Array, Array, Array]:
    """Something not in the map stands as high as what is: one row, whitened."""
    count = len(arm)
    y, A = np.zeros((count, ROWS)), np.zeros((count, ROWS, COLUMNS))
    if not len(landmarks.ids):
        return y, A, np.zeros(count)
    roof = landmarks.place_n[:, 2]
    sigma = np.sqrt(float(np.var(roof)) + b.height_spread_m**2 + own[:, 2, 2])
    d = PLACE + 2
    y[:, d] = (float(np.mean(roof)) - p_n[:, 2] - arm[:, 2]) / sigma
    A[:, d, 2] = 1.0 / sigma
    A[:, d, 3], A[:, d, 4], A[:, d, GROWTH] = arm[:, 1] / sigma, -arm[:, 0] / sigma, arm[:, 2] / sigma
    return y, A, -0.5 * math.log(2.0 * math.pi) - np.log(sigma)


def attributes(features: Array, noise: Array, depth: Array, landmarks: Catalogue, covariance: Array, b: Beliefs) -> Array:
    """Density of (log width, log length, fill ratio, orientation) of an object that is not in the map (M,).

    A kernel estimate over the map around, mixed with: width and length anything from 1 to 100 m, any fill, any orientation.
    """
    anything = 1.0 / math.log(100.0) ** 2 / 0.7 / math.pi
    if not len(landmarks.ids):
        return np.full(len(features), anything)
    e = landmarks.features[None] - features[:, None]
    half_turn = np.where(landmarks.features[:, 1] - landmarks.features[:, 0] > math.log(OBLONG), math.pi, 0.5 * math.pi)
    e[..., 3] = (e[..., 3] + 0.5 * half_turn) % half_turn - 0.5 * half_turn
    kernel = _kernel(noise, covariance)
    inverse, volume = np.linalg.inv(kernel), np.sqrt(np.linalg.det(2.0 * math.pi * kernel))
    density = np.zeros(len(features))
    scale_sigma = math.sqrt(covariance[SCALE, SCALE] + float(np.max(depth, initial=0.0)) ** 2)
    for s in _offsets(scale_sigma, 0.06):  # at the scale that suits it best
        shifted = e - np.array([s, s, 0.0, 0.0])
        squared = np.einsum("mja,mab,mjb->mj", shifted, inverse, shifted)
        density = np.maximum(density, np.exp(-0.5 * squared).mean(axis=1) / volume)
    return np.asarray(b.look_alike_fraction * density + (1.0 - b.look_alike_fraction) * anything)


def _kernel(noise: Array, covariance: Array) -> Array:
    """Covariance (..., 4, 4) of the estimate's kernel: what was measured badly, and how far an object is from its like."""
    return np.asarray(noise + np.diag([0.05**2, 0.05**2, 0.03**2, 0.1**2 + covariance[5, 5]]))


def sides(part: Partial, noise: Array, depth: float, count: int, covariance: Array, b: Beliefs) -> float:
    """As attributes, of the sides that the border leaves: a kernel estimate over the `count` landmarks' runs."""
    k = np.flatnonzero(part.known)
    anything = 4.0 / (2.0 * math.pi) / math.log(100.0) ** int(part.known[:2].sum())  # a corner of four
    kernel = _kernel(noise, covariance)[np.ix_(k, k)]
    inverse, volume = np.linalg.inv(kernel), math.sqrt(np.linalg.det(2.0 * math.pi * kernel))
    density = 0.0
    for s in _offsets(math.hypot(math.sqrt(covariance[SCALE, SCALE]), depth), 0.06):
        e = (part.described - part.features - np.array([s, s, 0.0, 0.0]))[:, k]
        density = max(density, float(np.exp(-0.5 * np.einsum("na,ab,nb->n", e, inverse, e)).sum()) / count / volume)
    return b.look_alike_fraction * density + (1.0 - b.look_alike_fraction) * anything


def _offsets(sigma: float, step: float) -> Array:
    """Values within 2 sigma, a step or less apart, but no more than 9."""
    return np.asarray(sigma * np.linspace(-2.0, 2.0, min(max(3, 2 * math.ceil(2.0 * sigma / step) + 1), 9)))


def intensity(arm: Array, own: Array, landmarks: Catalogue, covariance: Array, b: Beliefs) -> Array:
    """Objects per m^2 that are not in the map, at the place of each region as seen from the others (M,).

    In streets an unmapped object stands where a landmark would stand if the map were moved by a block, so its density is that of
    the landmarks at the same displacement from a landmark, not the mean density.
    """
    unmapped = b.unmapped_fraction / (1.0 - b.unmapped_fraction)
    radius = np.maximum(1.0, 1.4 * np.sqrt(2.0 * own[:, :2, :2].trace(axis1=1, axis2=2) / 2.0))
    turns = _offsets(math.sqrt(covariance[5, 5]), math.radians(2.0))
    grown = np.exp(_offsets(math.sqrt(covariance[SCALE, SCALE]), 0.04))
    moved = _displacement_density(arm[:, :2].copy(), radius, landmarks.place_n[:_CONSIDERED, :2].copy(), turns, grown)
    return np.asarray(unmapped * np.maximum(landmarks.density_per_m2, moved) + b.background_per_m2)


@njit(cache=True)
def _displacement_density(region: Array, radius: Array, place: Array, turns: Array, grown: Array) -> Array:
    """Density of landmarks at region i's displacement from region r, seen from any landmark.

    Mean over r, greatest over turns and scales.

    One pair of landmarks is left out, for it may be these very regions.
    """
    result = np.zeros(region.shape[0])
    if region.shape[0] < 2 or place.shape[0] < 2:
        return result
    for i in range(region.shape[0]):
        for turn in turns:
            for growth in grown:
                total = 0.0
                for r in range(region.shape[0]):
                    if r != i:
                        total += max(_pairs_apart(region[i] - region[r], turn, growth, place, radius[i]) - 1, 0)
                mean = total / (region.shape[0] - 1) / place.shape[0] / (math.pi * radius[i] * radius[i])
                result[i] = max(result[i], mean)
    return result


@njit(cache=True)
def _pairs_apart(displacement: Array, turn: float, growth: float, place: Array, radius: float) -> int:
    """Pairs of landmarks that are displaced like this, turned and grown."""
    c, s = growth * math.cos(turn), growth * math.sin(turn)
    n, e = c * displacement[0] - s * displacement[1], s * displacement[0] + c * displacement[1]
    close = 0
    for k in range(place.shape[0]):
        for m in range(place.shape[0]):
            un, ue = place[m, 0] - place[k, 0] - n, place[m, 1] - place[k, 1] - e
            if un * un + ue * ue < radius * radius and k != m:
                close += 1
    return close
