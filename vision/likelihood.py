"""What each region may be, and how likely what was measured is then: the options of vision/assignment.py.

A landmark j shown by region i, both described by (place, log width, log length, fill ratio, orientation):

    l_j - (p + r_i) = dp - [r_i]x dtheta + r_i (exp(s) - 1) + e,   log w_j - log w_i = s + e,   psi_j - psi_i = dtheta_z + e

r_i: arm from body to region in n at the prior, s: the log scale of depth that all regions share. Each landmark stands there
twice, measured well and, rarely, measured badly (a shadow or a neighbour grown into the region): same equations, wide noise.

Of a region that the border cuts off its corners take the place of the centre (partial.py).

A region that is no landmark of the map is an object like those of the map (unmapped objects look like mapped ones, and stand
in the same streets) or anything. Its density is estimated from the map around: assuming it uniform would make every look-alike
a sure landmark.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import msgspec
import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import so3
from models.landmarks import Landmark
from models.messages import Array
from vision.assignment import COLUMNS, GROWTH, PLACE, SCALE, STATES, Options
from vision.partial import Partial
from vision.similarity import normalised, similarity

_ROWS = 7  # log width, log length, fill ratio, orientation, place (3)
_GATE = 30.0  # chi-square of 3: a place further off than this is not followed (2e-6)
_AROUND_M = 40.0  # radius over which the density of objects around an object is taken
_CONSIDERED = 30  # landmarks, the nearest, among which displacements are counted
_OBLONG = 1.3  # below this ratio of length to width the axes may be exchanged


class Beliefs(msgspec.Struct, frozen=True):
    """What is taken for granted about world and segmentation, before a picture is seen."""

    unmapped_fraction: float = 0.3  # of the objects that look like landmarks
    gone_fraction: float = 0.1  # of the map
    found_fraction: float = 0.7  # a landmark wholly in view gives a region
    bad_fraction: float = 0.03  # of the regions: measured badly
    bad_log_size: float = 0.25
    bad_fill_ratio: float = 0.2
    bad_orientation_deg: float = 20.0
    bad_centre: float = 0.3  # of the length
    look_alike_fraction: float = 0.7  # of what is not in the map: resembles what is
    background_per_m2: float = 1e-4  # regions that are no objects at all: shadows, cars, fields
    centre_sigma_m: float = 0.1  # centre of the region against centre of the roof
    size_sigma: float = 0.01  # relative: edges of a region against edges of the roof
    fill_ratio_sigma: float = 0.02
    height_spread_m: float = 1.0  # of what is not in the map, about heights of what is


@dataclass(frozen=True, slots=True)
class Sighting:
    """A region as identification sees it; n at the prior's attitude.

    arm_n (3,) from body to region, moved_n (3,) from the body now to the body then; depth_sigma: relative error of its depth,
    its own (place and sizes share it; what all regions share is not in it); covariance_n (3, 3) and log_size_covariance (2, 2)
    of (log width, log length): the other errors; orientation_rad of the length, from north to east; now: in the present
    picture, not remembered. partial: of a region that the border cuts off; then the arm ends where the centre would be, were it
    like the landmarks that it may be, the covariance of log sizes is of two sides, and the sizes are lower bounds.
    """

    arm_n: Array
    depth_sigma: float
    covariance_n: Array
    size_m2: float
    width_m: float
    length_m: float
    fill_ratio: float
    log_size_covariance: Array
    fill_ratio_sigma: float
    orientation_rad: float
    orientation_sigma_rad: float
    colour_bgr: tuple[float, float, float] | None = None
    moved_n: Array = field(default_factory=lambda: np.zeros(3))
    now: bool = True
    partial: Partial | None = None


@dataclass(frozen=True, slots=True)
class Catalogue:
    """Landmarks near the prior as arrays.

    place_n (J, 3) of the roof's centre, variance_n (J, 3) of it; features (J, 4): log width, log length, fill ratio, orientation;
    description and weights (J, 4) of the similarity; chroma (J, 2), NaN unknown; density_per_m2: of objects around an object.
    vertices (V, 2), offsets (J + 1,): the outlines one after the other.
    """

    ids: tuple[str, ...]
    place_n: Array
    variance_n: Array
    features: Array
    outline_sigma_m: Array
    description: Array
    weights: Array
    chroma: Array
    density_per_m2: float
    vertices: Array
    offsets: NDArray[np.int64]

    @property
    def radius_m(self) -> Array:
        """(J,) half the diagonal of the least rectangle."""
        return np.asarray(0.5 * np.hypot(self.description[:, 1], self.description[:, 2]))


def catalogue(landmarks: list[Landmark]) -> Catalogue:
    """The landmarks' numbers side by side."""
    m = landmarks
    place = np.array([(*k.centre_n, k.roof_d) for k in m]).reshape(-1, 3)
    colour = [k.colour_bgr or (math.nan,) * 3 for k in m]
    features = [(math.log(k.width_m), math.log(k.length_m), k.fill_ratio, k.orientation_rad) for k in m]
    return Catalogue(
        ids=tuple(k.id for k in m),
        place_n=place,
        variance_n=np.array([(k.sigma_m, k.sigma_m, k.height_sigma_m) for k in m]).reshape(-1, 3) ** 2,
        features=np.array(features).reshape(-1, 4),
        outline_sigma_m=np.array([k.outline_sigma_m for k in m]),
        description=np.array([(k.size_m2, k.width_m, k.length_m, k.fill_ratio) for k in m]).reshape(-1, 4),
        weights=normalised(np.array([k.weights for k in m]).reshape(-1, 4)),
        chroma=chroma(np.array(colour).reshape(-1, 3)),
        density_per_m2=_density(place),
        vertices=np.concatenate([np.empty((0, 2)), *(k.outline_n for k in m)]),
        offsets=np.cumsum([0, *(len(k.outline_n) for k in m)]),
    )


def chroma(colour_bgr: Array) -> Array:
    """(b, g) / (b + g + r) of colours (..., 3): what exposure does not change."""
    total = np.maximum(colour_bgr.sum(axis=-1, keepdims=True), 1.0)
    return np.asarray(colour_bgr[..., :2] / total)


def similarities(sightings: list[Sighting], landmarks: Catalogue, scale: Array) -> Array:
    """Eq. 5.5 for each region and landmark (M, J); scale (M, J): by which the region's lengths are to be multiplied."""
    s = np.array([(r.size_m2, r.width_m, r.length_m, r.fill_ratio) for r in sightings]).reshape(-1, 1, 4)
    factor = np.stack([scale**2, scale, scale, np.ones_like(scale)], axis=-1)
    return similarity(s * factor, landmarks.description[None], landmarks.weights[None])


def options(
    sightings: list[Sighting], landmarks: Catalogue, p_n: Array, covariance: Array, candidate: NDArray[np.bool_], scale: Array,
    beliefs: Beliefs,
) -> Options:  # fmt: skip
    """All that each region may be: none of the map, and each candidate (M, J), measured well or badly, whose place is possible.

    covariance (7, 7) of x at the prior; scale (M, J): by which lengths of the region are to be multiplied.
    """
    b = beliefs
    arm = np.array([r.arm_n for r in sightings]).reshape(-1, 3)
    moved = np.array([r.moved_n for r in sightings]).reshape(-1, 3)
    own = np.array([r.covariance_n for r in sightings]).reshape(-1, 3, 3)
    depth = np.array([r.depth_sigma for r in sightings])
    features = np.array([_features(r) for r in sightings]).reshape(-1, 4)
    noise = np.array([_feature_noise(r, b) for r in sightings]).reshape(-1, 4, 4)
    wide = np.array([_bad_noise(r, b) for r in sightings]).reshape(-1, _ROWS)
    pairs = [pair for i, r in enumerate(sightings) for pair in _pairs_of(i, r, landmarks, candidate[i], scale[i])]
    region, landmark, bad, y, A, log_density = _whitened(
        p_n, moved, depth, own + b.centre_sigma_m**2 * np.eye(3), noise, wide, landmarks.outline_sigma_m, covariance,
        *_columns(pairs),
    )  # fmt: skip
    colours = np.array([r.colour_bgr or (math.nan,) * 3 for r in sightings]).reshape(-1, 3)
    colour, ground_colour = _colour(chroma(colours), landmarks.chroma, b)
    there = math.log(b.found_fraction * (1.0 - b.gone_fraction))
    weight = there + np.where(bad, math.log(b.bad_fraction), math.log1p(-b.bad_fraction)) + log_density
    weight += colour[region, landmark]

    count = len(sightings)
    own = own + depth[:, None, None] ** 2 * arm[:, :, None] * arm[:, None, :]
    clutter_y, clutter_a, clutter_log = _clutter_row(p_n + moved, arm, own, landmarks, b)
    attributes = _clutter_attributes(features, noise, depth, landmarks, covariance, b)
    for i, r in enumerate(sightings):
        if r.partial is not None:
            attributes[i] = _clutter_sides(r.partial, noise[i], float(depth[i]), len(landmarks.ids), covariance, b)
            own[i] += np.cov(landmarks.place_n[r.partial.landmark] - r.partial.target_n, rowvar=False, bias=True)
    clutter_log += ground_colour + np.log(attributes)
    clutter_log += np.log(_clutter_intensity(moved + arm, own, landmarks, covariance, b))
    order = np.argsort(np.concatenate([np.arange(count), region]), kind="stable")
    all_regions = np.concatenate([np.arange(count), region])[order]
    return Options(
        start=np.searchsorted(all_regions, np.arange(count + 1)),
        landmark=np.concatenate([np.full(count, -1), landmark])[order],
        y=np.concatenate([clutter_y, y])[order],
        A=np.concatenate([clutter_a, A])[order],
        log_weight=np.concatenate([clutter_log, weight])[order],
    )


_Pair = tuple[int, int, Array, Array, Array, Array, Array, NDArray[np.bool_]]


def _pairs_of(i: int, r: Sighting, landmarks: Catalogue, candidate: NDArray[np.bool_], scale: Array) -> Iterator[_Pair]:
    """Region i beside each landmark that it may be.

    Indices; arm to what was measured, where the map has that, variance of the map there; features measured, features of the map,
    which of them are known.
    """
    longer = np.array([1.0, 1.0, 0.0, 0.0])
    if r.partial is None:
        seen, known = np.array(_features(r)), np.ones(4, np.bool_)
        for j in np.flatnonzero(candidate).tolist():
            features = seen + longer * math.log(scale[j])
            yield i, j, r.arm_n * scale[j], landmarks.place_n[j], landmarks.variance_n[j], features, landmarks.features[j], known
        return
    part = r.partial
    for j, target, described in zip(part.landmark.tolist(), part.target_n, part.described, strict=True):
        if candidate[j]:
            variance = landmarks.variance_n[j] + np.array([1.0, 1.0, 0.0]) * landmarks.outline_sigma_m[j] ** 2
            features = part.features + longer * math.log(scale[j])
            yield i, j, part.middle_n * scale[j], target, variance, features, described, part.known


def _columns(
    pairs: list[_Pair],
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array, Array, Array, Array, NDArray[np.bool_]]:
    region, landmark, arm, target, variance, features, described, known = zip(*pairs, strict=True) if pairs else ((),) * 8
    return (
        np.array(region, np.int64), np.array(landmark, np.int64), np.array(arm).reshape(-1, 3), np.array(target).reshape(-1, 3),
        np.array(variance).reshape(-1, 3), np.array(features).reshape(-1, 4), np.array(described).reshape(-1, 4),
        np.array(known, np.bool_).reshape(-1, 4),
    )  # fmt: skip


def _features(r: Sighting) -> tuple[float, float, float, float]:
    return math.log(r.width_m), math.log(r.length_m), r.fill_ratio, r.orientation_rad


def _feature_noise(r: Sighting, b: Beliefs) -> Array:
    fill, turn = r.fill_ratio_sigma**2 + b.fill_ratio_sigma**2, r.orientation_sigma_rad**2
    if r.length_m < _OBLONG * r.width_m and abs(r.fill_ratio - 0.25 * math.pi) < 0.07:
        turn += 1.0  # round: it has no orientation
    noise = np.diag([b.size_sigma**2, b.size_sigma**2, fill, turn])
    noise[:2, :2] += r.log_size_covariance
    return noise


def _bad_noise(r: Sighting, b: Beliefs) -> list[float]:
    centre = (b.bad_centre * r.length_m) ** 2
    size, turn = b.bad_log_size**2, math.radians(b.bad_orientation_deg) ** 2
    return [size, size, b.bad_fill_ratio**2, turn, centre, centre, 1.0]


def _density(place: Array) -> float:
    """Objects per m^2 around an object."""
    if len(place) < 2:
        return 0.0
    apart = np.hypot(*(place[:, None, :2] - place[None, :, :2]).transpose(2, 0, 1))
    return float(((apart < _AROUND_M).sum() - len(place)) / len(place) / (math.pi * _AROUND_M**2))


def _colour(region: Array, landmark: Array, b: Beliefs, sigma: float = 0.06, any_colour: float = 0.3) -> tuple[Array, Array]:
    """Log density of a region's chroma as each landmark (M, J), and as none of them (M,).

    A normal about the map's colour, or (any_colour of the time: paint fades, light is coloured) uniform over the triangle of
    chromas, whose area is 1/2. Where either colour is unknown it says nothing.
    """
    squared = ((region[:, None] - landmark[None]) ** 2).sum(axis=-1) / sigma**2
    density = (1.0 - any_colour) * np.exp(-0.5 * squared) / (2.0 * math.pi * sigma**2) + any_colour * 2.0
    known = np.isfinite(density)
    counted = known.sum(axis=1)
    population = np.where(known, density, 0.0).sum(axis=1) / np.maximum(counted, 1)
    none = np.where(counted > 0, b.look_alike_fraction * population + (1.0 - b.look_alike_fraction) * 2.0, 1.0)
    return np.log(np.where(known, density, none[:, None])), np.log(none)


def _clutter_row(p_n: Array, arm: Array, own: Array, landmarks: Catalogue, b: Beliefs) -> tuple[Array, Array, Array]:
    """Something not in the map stands as high as what is: one row, whitened."""
    count = len(arm)
    y, A = np.zeros((count, _ROWS)), np.zeros((count, _ROWS, COLUMNS))
    if not len(landmarks.ids):
        return y, A, np.zeros(count)
    roof = landmarks.place_n[:, 2]
    sigma = np.sqrt(float(np.var(roof)) + b.height_spread_m**2 + own[:, 2, 2])
    d = PLACE + 2
    y[:, d] = (float(np.mean(roof)) - p_n[:, 2] - arm[:, 2]) / sigma
    A[:, d, 2] = 1.0 / sigma
    A[:, d, 3], A[:, d, 4], A[:, d, GROWTH] = arm[:, 1] / sigma, -arm[:, 0] / sigma, arm[:, 2] / sigma
    return y, A, -0.5 * math.log(2.0 * math.pi) - np.log(sigma)


def _clutter_attributes(
    features: Array, noise: Array, depth: Array, landmarks: Catalogue, covariance: Array, b: Beliefs
) -> Array:
    """Density of (log width, log length, fill ratio, orientation) of an object that is not in the map (M,).

    A kernel estimate over the map around, mixed with: width and length anything from 1 to 100 m, any fill, any orientation.
    """
    anything = 1.0 / math.log(100.0) ** 2 / 0.7 / math.pi
    if not len(landmarks.ids):
        return np.full(len(features), anything)
    e = landmarks.features[None] - features[:, None]
    half_turn = np.where(landmarks.features[:, 1] - landmarks.features[:, 0] > math.log(_OBLONG), math.pi, 0.5 * math.pi)
    e[..., 3] = (e[..., 3] + 0.5 * half_turn) % half_turn - 0.5 * half_turn
    kernel = noise + np.diag([0.05**2, 0.05**2, 0.03**2, 0.1**2 + covariance[5, 5]])
    inverse, volume = np.linalg.inv(kernel), np.sqrt(np.linalg.det(2.0 * math.pi * kernel))
    density = np.zeros(len(features))
    scale_sigma = math.sqrt(covariance[SCALE, SCALE] + float(np.max(depth, initial=0.0)) ** 2)
    for s in _offsets(scale_sigma, 0.06):  # at the scale that suits it best
        shifted = e - np.array([s, s, 0.0, 0.0])
        squared = np.einsum("mja,mab,mjb->mj", shifted, inverse, shifted)
        density = np.maximum(density, np.exp(-0.5 * squared).mean(axis=1) / volume)
    return np.asarray(b.look_alike_fraction * density + (1.0 - b.look_alike_fraction) * anything)


def _clutter_sides(part: Partial, noise: Array, depth: float, count: int, covariance: Array, b: Beliefs) -> float:
    """As _clutter_attributes, of the sides that the border leaves: a kernel estimate over the `count` landmarks' runs."""
    k = np.flatnonzero(part.known)
    anything = 4.0 / (2.0 * math.pi) / math.log(100.0) ** int(part.known[:2].sum())  # a corner of four
    kernel = (noise + np.diag([0.05**2, 0.05**2, 0.03**2, 0.1**2 + covariance[5, 5]]))[np.ix_(k, k)]
    inverse, volume = np.linalg.inv(kernel), math.sqrt(np.linalg.det(2.0 * math.pi * kernel))
    density = 0.0
    for s in _offsets(math.hypot(math.sqrt(covariance[SCALE, SCALE]), depth), 0.06):
        e = (part.described - part.features - np.array([s, s, 0.0, 0.0]))[:, k]
        density = max(density, float(np.exp(-0.5 * np.einsum("na,ab,nb->n", e, inverse, e)).sum()) / count / volume)
    return b.look_alike_fraction * density + (1.0 - b.look_alike_fraction) * anything


def _offsets(sigma: float, step: float) -> Array:
    """Values within 2 sigma, a step or less apart, but no more than 9."""
    return np.asarray(sigma * np.linspace(-2.0, 2.0, min(max(3, 2 * math.ceil(2.0 * sigma / step) + 1), 9)))


def _clutter_intensity(arm: Array, own: Array, landmarks: Catalogue, covariance: Array, b: Beliefs) -> Array:
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


@njit(cache=True)
def _whitened(
    p_n: Array, moved: Array, depth: Array, own: Array, noise: Array, wide: Array, outline_sigma: Array, prior: Array,
    region: NDArray[np.int64], landmark: NDArray[np.int64], arm: Array, target: Array, variance: Array, features: Array,
    described: Array, known: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_], Array, Array, Array]:  # fmt: skip
    """Whitened rows and log density constant of every possible pair, well and badly measured."""
    most = 2 * region.shape[0]
    regions, landmarks, bad = np.empty(most, np.int64), np.empty(most, np.int64), np.zeros(most, np.bool_)
    y, A, log_density = np.empty((most, _ROWS)), np.empty((most, _ROWS, COLUMNS)), np.empty(most)
    turn_variance = prior[3, 3] + prior[4, 4] + prior[5, 5]
    n = 0
    for pair in range(region.shape[0]):
        i, j, r = region[pair], landmark[pair], arm[pair]
        y[n], A[n] = _rows(p_n + moved[i], r, features[pair], target[pair], described[pair])
        N = np.zeros((_ROWS, _ROWS))
        N[PLACE:, PLACE:] = own[i] + np.diag(variance[pair])
        # what the linear equations leave out: 1/2 dtheta^2 r and s dtheta r
        N[PLACE:, PLACE:] += turn_variance * (0.75 * turn_variance + prior[SCALE, SCALE]) * (r @ r) * np.eye(3)
        N[:PLACE, :PLACE] = noise[i]
        grown = 2.0 * outline_sigma[j] * np.exp(-described[pair, :2])
        N[:2, :2] += np.outer(grown, grown)
        by_scale = A[n, :, SCALE] + A[n, :, GROWTH]
        N += depth[i] ** 2 * np.outer(by_scale, by_scale)
        if _excluded(y[n, PLACE:], A[n, PLACE:], N[PLACE:, PLACE:] + np.diag(wide[i, PLACE:]), prior, r):
            continue
        blurred = wide[i].copy()
        for row in range(PLACE):
            if not known[pair, row]:
                _say_nothing(row, y[n], A[n], N, blurred)
        y[n + 1], A[n + 1] = y[n], A[n]
        for k in range(2):
            regions[n], landmarks[n], bad[n] = i, j, k == 1
            log_density[n] = _whiten(N + k * np.diag(blurred), y[n], A[n])
            n += 1
    return regions[:n], landmarks[:n], bad[:n], y[:n], A[:n], log_density[:n]


@njit(cache=True)
def _say_nothing(row: int, y: Array, A: Array, N: Array, wide: Array) -> None:
    """A row that was not measured, in place: zeros, of density one."""
    y[row], A[row], wide[row] = 0.0, 0.0, 0.0
    N[row], N[:, row] = 0.0, 0.0
    N[row, row] = 0.5 / math.pi


@njit(cache=True)
def _excluded(y: Array, A: Array, N: Array, prior: Array, r: Array) -> bool:
    """Whether a place is impossible under the prior, whatever else is seen; 1/2 s^2 r is what the linear equation leaves out."""
    linear = A[:, :STATES].copy()
    linear[:, SCALE] += A[:, GROWTH]
    spread = linear @ prior @ linear.T + N + 0.75 * prior[SCALE, SCALE] ** 2 * np.outer(r, r)
    return bool(y @ np.linalg.solve(spread, y) > _GATE)


@njit(cache=True)
def _rows(p_n: Array, r: Array, features: Array, place: Array, described: Array) -> tuple[Array, Array]:
    y, A = np.empty(_ROWS), np.zeros((_ROWS, COLUMNS))
    y[:PLACE] = described - features
    y[PLACE:] = place - p_n - r
    half_turn = math.pi if described[1] - described[0] > math.log(_OBLONG) else 0.5 * math.pi
    y[3] = (y[3] + 0.5 * half_turn) % half_turn - 0.5 * half_turn
    A[0, SCALE] = A[1, SCALE] = 1.0
    A[3, 5] = 1.0
    A[PLACE:, :3] = np.eye(3)
    A[PLACE:, 3:6] = -so3.skew(r)
    A[PLACE:, GROWTH] = r
    return y, A


@njit(cache=True)
def _whiten(N: Array, y: Array, A: Array) -> float:
    """y, A <- L^-1 y, L^-1 A with N = L L', in place; returns -1/2 log det(2 pi N)."""
    L = np.linalg.cholesky(N)
    total = 0.0
    for a in range(N.shape[0]):
        for b in range(a):
            y[a] -= L[a, b] * y[b]
            A[a] -= L[a, b] * A[b]
        y[a] /= L[a, a]
        A[a] /= L[a, a]
        total -= math.log(L[a, a])
    return float(total - 0.5 * N.shape[0] * math.log(2.0 * math.pi))
