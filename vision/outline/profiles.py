"""Profiles across a projected outline in one image, what colours they run through, and where, to a pixel, they leave the roof.

A profile is read along the normal n of a projected edge; its offset s [px] is the residual of the outline, + in the direction of
n (outwards for roof and base edges). Profiles are read in the image as it is: lens distortion bends the outline, not the
image.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models import order
from models.messages import Array

Picture = NDArray[np.uint8]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

_BOX = 3  # samples on either side of a step that the search compares
_AGREE = 3.0  # samples that a point's edge may lie from the edge's common offset
_SECOND = 0.75  # a rival that has this share of the best vote makes an edge ambiguous
_STANDS_OUT = 3.0  # standard deviations of the mean of its points that a step has: by chance the largest of a dozen has no more
_CLIPPED = 253.0  # grey values from here on may have been cut off by the sensor
_UNCLIPPED = 0.36  # share of the squared contrast that channels must keep which are not clipped
_ENDING, _MOST_CONTRAST = 0.5, 0.8  # what ends at a rim has so much of the contrast that is exceeded by one point in five
_OTHER, _SCATTER, _LEAST_OTHER = 0.4, 4.0, 4.0  # of the contrast; of the lower quartile; grey values: farther off is not the roof
_SHADOW = 0.5  # of the light that a roof has in the sun
_STRIP, _LEAST_STRIP = 0.3, 10.0  # of the contrast, and grey values: farther from both sides there is something between them
_ALIKE, _DARKER = 0.96, 0.8  # the same colour (cosine), in a shadow
_SHADE = 1.3  # by how much lighter or darker than the roof's colour a slope may be
_BESIDE = 2  # points on either side that tell its shade along
_LEAST_CONTRAST = 3.0  # grey values; below it an edge is not looked at
_SLACK_PX = 1.0  # more than rounding


@njit(cache=True)
def profiles(picture: Picture, px: Array, normal: Array, half: int, step: float, width: int, usable: Mask) -> Array:
    """Values (N, 2 half + 1, C) of picture (H, W, C) at px + s normal, s = -half step ... half step; bilinear.

    px, normal: (N, 2); width: neighbours along the edge, 1 px apart, that are averaged. usable (N,) is cleared where a profile
    leaves the image.
    """
    rows, columns, channels = picture.shape
    n, size = px.shape[0], 2 * half + 1
    values = np.zeros((n, size, channels), dtype=np.float64)
    for i in range(n):
        if not usable[i]:
            continue
        nu, nv = normal[i, 0], normal[i, 1]
        reach, aside = half * step, 0.5 * (width - 1)
        eu, ev = abs(nu) * reach + abs(nv) * aside, abs(nv) * reach + abs(nu) * aside
        u0, v0 = px[i, 0], px[i, 1]
        if not (u0 - eu >= 0.0 and v0 - ev >= 0.0 and u0 + eu < columns - 1 and v0 + ev < rows - 1):
            usable[i] = False
            continue
        for j in range(size):
            s = (j - half) * step
            for k in range(width):
                t = k - aside
                u, v = u0 + s * nu - t * nv, v0 + s * nv + t * nu
                column, row = int(u), int(v)
                fu, fv = u - column, v - row
                w00, w01, w10, w11 = (1.0 - fv) * (1.0 - fu), (1.0 - fv) * fu, fv * (1.0 - fu), fv * fu
                for c in range(channels):
                    values[i, j, c] += (
                        w00 * picture[row, column, c]
                        + w01 * picture[row, column + 1, c]
                        + w10 * picture[row + 1, column, c]
                        + w11 * picture[row + 1, column + 1, c]
                    )
            for c in range(channels):
                values[i, j, c] /= width
    return values


@njit(cache=True)
def along_contrast(values: Array, edge: Indices, shaded: Mask, usable: Mask) -> tuple[Array, Mask]:
    """Profiles (N, S) of one value: colour along the unit vector of each edge's contrast; and which edges (E,) are clipped.

    Contrast is between the two sides, or between the middle and both sides where that is larger (a dark wall between roof and
    ground); where a shadow may lie between them (shaded, (E,)) and does, it is between the inner side and the shadow, for at its
    far side no roof ends. A channel that is saturated anywhere on the edge shifts it and is left out, as long as another has
    contrast.
    """
    n, size, channels = values.shape
    edges, third = len(shaded), size // 3
    mean, count = np.zeros((edges, size, channels)), np.zeros(edges)
    bright = np.zeros((edges, channels))
    for i in range(n):
        if usable[i]:
            e = edge[i]
            count[e] += 1.0
            for j in range(size):
                for c in range(channels):
                    mean[e, j, c] += values[i, j, c]
                    bright[e, c] += 1.0 if values[i, j, c] >= _CLIPPED else 0.0
    direction, clipped = np.empty((edges, channels)), np.zeros(edges, dtype=np.bool_)
    for e in range(edges):
        for j in range(size):
            for c in range(channels):
                mean[e, j, c] /= max(count[e], 1.0)
        clipped[e] = _contrast(mean[e], bright[e], 0.1 * third * count[e], shaded[e], direction[e])
    result = np.zeros((n, size))
    for i in range(n):
        if usable[i]:
            for j in range(size):
                total = 0.0
                for c in range(channels):
                    total += values[i, j, c] * direction[edge[i], c]
                result[i, j] = total
    return result, clipped


@njit(cache=True)
def _contrast(profile: Array, bright: Array, most_bright: float, may_be_shaded: bool, direction: Array) -> bool:
    """The unit vector (C,) of a mean profile's (S, C) contrast, into direction; whether a channel of it is clipped too much."""
    size, channels = profile.shape
    third = size // 3
    inside, d, shadow = np.empty(channels), np.empty(channels), np.empty(channels)
    outside, middle, free = np.empty(channels), np.empty(channels), np.empty(channels)
    across2 = middle2 = 0.0
    for c in range(channels):
        inside[c], outside[c] = _average(profile, 0, third, c), _average(profile, size - third, size, c)
        d[c] = outside[c] - inside[c]
        middle[c] = _average(profile, third, 2 * third, c) - 0.5 * (inside[c] + outside[c])
        across2 += d[c] ** 2
        middle2 += middle[c] ** 2
    is_shaded = may_be_shaded and _shadow_between(profile, inside, outside, shadow)
    square = free2 = 0.0
    for c in range(channels):
        if is_shaded:
            d[c] = shadow[c] - inside[c]
        elif not across2 >= middle2:
            d[c] = middle[c]
        free[c] = 0.0 if bright[c] > most_bright else d[c]
        square += d[c] ** 2
        free2 += free[c] ** 2
    clipped = free2 < _UNCLIPPED * square
    norm = math.sqrt(square if clipped else free2)
    for c in range(channels):
        part = d[c] if clipped else free[c]
        direction[c] = part / norm if norm > 0.0 else 1.0 / math.sqrt(channels)
    return bool(clipped)


@njit(cache=True)
def _average(colours: Array, begin: int, end: int, c: int) -> float:
    """Of channel c of colours (S, C), begin to end."""
    total = 0.0
    for j in range(begin, end):
        total += colours[j, c]
    return total / (end - begin)


@njit(cache=True)
def _shadow_between(profile: Array, inside: Array, outside: Array, shadow: Array) -> bool:
    """Colour (C,) of a profile (S, C), beyond its inner third, where it is farthest from what one blurred step shows, into
    shadow; False if that is not the outer side's in a shadow, or black.

        r = |c - a - t (b - a)|,  0 <= t <= 1:    r > 0.3 |b - a|,    c b / (|c| |b|) > 0.96,    |c| < 0.8 |b|

    a: inside, b: outside.
    """
    size, channels = profile.shape
    square, farthest, at = 0.0, 0.0, -1
    for c in range(channels):
        square += (outside[c] - inside[c]) ** 2
    for j in range(size // 3, size):
        along = r = 0.0
        for c in range(channels):
            along += (profile[j, c] - inside[c]) * (outside[c] - inside[c])
        t = min(max(along / max(square, 1e-9), 0.0), 1.0)
        for c in range(channels):
            r += ((profile[j, c] - inside[c]) - t * (outside[c] - inside[c])) ** 2
        if r > farthest:
            farthest, at = r, j
    if farthest < max(_STRIP**2 * square, _LEAST_STRIP**2):
        return False
    total = 0.0
    for c in range(channels):
        shadow[c] = profile[at, c]
        total += shadow[c]
    return shaded(shadow, outside) and total > 0.0


@njit(cache=True)
def shaded(colour: Array, ground: Array) -> bool:
    """Whether a colour (C,) c is that of the ground, b, in a shadow:  c b > 0.96 |c| |b|,  |c| < 0.8 |b|."""
    dark = light = both = 0.0
    for c in range(len(colour)):
        dark += colour[c] ** 2
        light += ground[c] ** 2
        both += colour[c] * ground[c]
    dark, light = math.sqrt(dark), math.sqrt(light)
    return both > _ALIKE * dark * light and dark < _DARKER * light


@njit(cache=True)
def _ends(values: Array) -> tuple[Array, Array]:
    """Colours (N, C) of the inner and the outer quarter of profiles (N, S, C)."""
    n, size, channels = values.shape
    quarter = size // 4
    inside, outside = np.zeros((n, channels)), np.zeros((n, channels))
    for i in range(n):
        for j in range(quarter):
            for c in range(channels):
                inside[i, c] += values[i, j, c] / quarter
                outside[i, c] += values[i, size - 1 - j, c] / quarter
    return inside, outside


@njit(cache=True)
def _rim(m: int, edge: Indices, landmark: Indices, roof: Mask, usable: Mask) -> Indices:
    """The usable points of landmark m's roof edges; landmark, roof: (E,) of the edges."""
    rim, count = np.empty(len(edge), np.int64), 0
    for i in range(len(edge)):
        if usable[i] and roof[edge[i]] and landmark[edge[i]] == m:
            rim[count] = i
            count += 1
    return rim[:count]


@njit(cache=True)
def _marks(landmark: Indices) -> int:
    """How many landmarks there are, one at least; landmark (E,) of the edges."""
    most = 0
    for e in range(len(landmark)):
        most = max(most, landmark[e])
    return most + 1


@njit(cache=True)
def roof_colours(values: Array, edge: Indices, landmark: Indices, roof: Mask, usable: Mask) -> Array:
    """Colour (L, C) of each landmark's roof: the median, along its rim, of what ends there; NaN where no point is usable.

    What hides a part of a roof goes on beyond its rim. values (N, S, C): profiles that run outwards; roof: (E,).
    """
    inside, outside = _ends(values)
    n, channels = inside.shape
    contrast, of_rim, marks = np.empty(n), np.empty(n), _marks(landmark)
    for i in range(n):
        square = 0.0
        for c in range(channels):
            square += (outside[i, c] - inside[i, c]) ** 2
        contrast[i] = math.sqrt(square)
    colour = np.empty((marks, channels))
    for m in range(marks):
        rim = _rim(m, edge, landmark, roof, usable)
        for k in range(len(rim)):
            of_rim[k] = contrast[rim[k]]
        least = _ENDING * order.quantile(of_rim[: len(rim)], _MOST_CONTRAST)
        for c in range(channels):
            count = 0
            for k in range(len(rim)):
                if contrast[rim[k]] >= least:
                    of_rim[count] = inside[rim[k], c]
                    count += 1
            colour[m, c] = order.median(of_rim[:count])
    return colour


@njit(cache=True)
def roof_beside(
    values: Array, interior: Array, inside: Mask, edge: Indices, landmark: Indices, roof: Mask, usable: Mask
) -> Array:
    """Colour (N, C) of the roof beside each point: the landmark's, as light or dark as the slope there; gables have two.

    interior (N, S', C): what lies farther inside than profiles values (N, S, C), where inside (N,); neighbours on the edge
    count as well.
    """
    n, size, channels = interior.shape
    colour = roof_colours(values, edge, landmark, roof, usable)
    single, beside = np.empty(n), np.empty((n, channels))
    for i in range(n):
        single[i] = np.nan
        whole = total = 0.0
        for c in range(channels):
            whole += colour[landmark[edge[i]], c]
        if inside[i] and whole > 0.0:  # not where it is NaN
            for j in range(size):
                for c in range(channels):
                    total += interior[i, j, c]
            single[i] = total / size / whole
    for i in range(n):
        total = count = 0.0
        for k in range(max(i - _BESIDE, 0), min(i + _BESIDE + 1, n)):
            if edge[k] == edge[i] and not math.isnan(single[k]):
                total += single[k]
                count += 1.0
        shade = min(max(total / count, 1.0 / _SHADE), _SHADE) if count > 0.0 else 1.0
        for c in range(channels):
            beside[i, c] = shade * colour[landmark[edge[i]], c]
    return beside


@njit(cache=True)
def off_roof(values: Array, beside: Array, edge: Indices, roof: Mask, usable: Mask) -> Array:
    """How far colours are from the roof's beside them (N, C) along profiles (N, S) that run outwards; 0 where there is none."""
    n, size, channels = values.shape
    distance = np.zeros((n, size))
    for i in range(n):
        if usable[i] and roof[edge[i]]:
            for j in range(size):
                total = 0.0
                for c in range(channels):
                    total += (values[i, j, c] - beside[i, c]) ** 2
                distance[i, j] = math.sqrt(total)
    return distance


@njit(cache=True)
def alien(values: Array, beside: Array, edge: Indices, roof: Mask, usable: Mask) -> Mask:
    """Which roof edges (E,) have something else than the roof, of colour beside (N, C), all along inside: the foot of a wall.

        |inside - beside| > 0.4 |outside - inside| + 4

    of the means along the edge.
    """
    inside, outside = _ends(values)
    n, channels = inside.shape
    ours, ends, beyond = np.zeros((len(roof), channels)), np.zeros((len(roof), channels)), np.zeros((len(roof), channels))
    found, count = np.zeros(len(roof), dtype=np.bool_), np.zeros(len(roof))
    for i in range(n):
        if usable[i]:
            e = edge[i]
            count[e] += 1.0
            for c in range(channels):
                ours[e, c] += beside[i, c]
                ends[e, c] += inside[i, c]
                beyond[e, c] += outside[i, c]
    for e in range(len(roof)):
        if roof[e] and count[e] > 0.0:
            off = across = 0.0
            for c in range(channels):
                off += (ends[e, c] / count[e] - ours[e, c] / count[e]) ** 2
                across += (beyond[e, c] / count[e] - ends[e, c] / count[e]) ** 2
            found[e] = math.sqrt(off) > _OTHER * math.sqrt(across) + _LEAST_OTHER
    return found


@njit(cache=True)
def covered(values: Array, beside: Array, edge: Indices, landmark: Indices, roof: Mask, usable: Mask) -> Mask:
    """Points (N,) of roof edges inside of which there is something else than the roof, of colour beside (N, C): a tree, ground.

        d_i > max(0.4 median |outside - beside|, 4 quartile d) + 4,    d = min_k |inside - k beside|, k = 0.5 ... 1

    of the points along a landmark's rim: what lies in a shadow is the roof still. The arguments are those of roof_colours.
    """
    inside, outside = _ends(values)
    n, channels = inside.shape
    off, across, of_rim = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        both = square = off2 = across2 = 0.0
        for c in range(channels):
            both += inside[i, c] * beside[i, c]
            square += beside[i, c] ** 2
        shade = min(max(both / max(square, 1.0), _SHADOW), 1.0)
        for c in range(channels):
            off2 += (inside[i, c] - shade * beside[i, c]) ** 2
            across2 += (outside[i, c] - beside[i, c]) ** 2
        off[i], across[i] = math.sqrt(off2), math.sqrt(across2)
    found = np.zeros(n, dtype=np.bool_)
    for m in range(_marks(landmark)):
        rim = _rim(m, edge, landmark, roof, usable)
        for k in range(len(rim)):
            of_rim[k] = across[rim[k]]
        usual = _OTHER * order.median(of_rim[: len(rim)])
        for k in range(len(rim)):
            of_rim[k] = off[rim[k]]
        usual = max(usual, _SCATTER * order.quantile(of_rim[: len(rim)], 0.25))
        for k in range(len(rim)):
            found[rim[k]] = off[rim[k]] > usual + _LEAST_OTHER
    return found


@njit(cache=True)
def search(distance: Array, edge: Indices, edges: int, step: float, usable: Mask) -> Array:
    """Offsets (N,) px at which all points of a roof edge leave the roof; NaN where there is no such position.

    distance (N, S): from the roof's colour. Its box differences are added over the points of an edge; the offset of the largest
    sum wins, if inside it is the roof, unless a second one, farther off than a slope could explain, is nearly as large.
    """
    n, size = distance.shape
    last = size - _BOX
    response, vote, square = np.zeros((n, size)), np.zeros((edges, size)), np.zeros((edges, size))
    mean, count = np.zeros((edges, size)), np.zeros(edges)
    for i in range(n):
        if usable[i]:
            e = edge[i]
            count[e] += 1.0
            for j in range(size):
                mean[e, j] += distance[i, j]
            for j in range(_BOX, last):
                total = 0.0
                for k in range(1, _BOX + 1):
                    total += distance[i, j + k] - distance[i, j - k]
                response[i, j] = total / _BOX
                vote[e, j] += response[i, j]
                square[e, j] += response[i, j] ** 2
    best = _elect(vote, square, mean, count)
    offsets = np.full(n, np.nan)
    for i in range(n):
        e = edge[i]
        if not usable[i] or best[e] < 0:
            continue
        low, high = max(_BOX + 1, int(best[e] - _AGREE)), min(last - 2, int(best[e] + _AGREE))
        top, at = 0.0, -1
        for j in range(low, high + 1):
            value = response[i, j]
            if value > top and value >= response[i, j - 1] and value >= response[i, j + 1]:
                top, at = value, j
        if at >= 0 and top > 0.4 * vote[e, int(best[e])] / count[e]:
            before, after = response[i, at - 1], response[i, at + 1]
            curvature = before - 2.0 * top + after
            shift = 0.5 * (before - after) / curvature if curvature < 0.0 else 0.0
            offsets[i] = (at + shift - size // 2) * step
    return offsets


@njit(cache=True)
def _elect(vote: Array, square: Array, mean: Array, count: Array) -> Array:
    """Best position (E,), -1 where none or ambiguous, of the edges' votes (E, S) and the sums of their squares (E, S).

    mean (E, S): summed distances from the roof. A step stands out of the scatter of its points; what texture makes does not.
    """
    edges, size = vote.shape
    best = np.full(edges, -1.0)
    for e in range(edges):
        if count[e] < 2:
            continue
        top, rival, at = _LEAST_CONTRAST * count[e], 0.0, -1
        for j in range(_BOX + 1, size - _BOX - 1):
            value = vote[e, j]
            if value < top * _SECOND or value <= vote[e, j - 1] or value < vote[e, j + 1]:
                continue
            if value**2 < _STANDS_OUT**2 * (square[e, j] - value**2 / count[e]):
                continue
            if mean[e, max(j - 4, 0)] > _OTHER * mean[e, min(j + 4, size - 1)] + 8.0 * count[e]:
                continue
            if value > top:
                rival = top if at >= 0 and j - at > _BOX else rival
                top, at = value, j
            elif at >= 0 and j - at > _BOX:
                rival = max(rival, value)
        if at >= 0 and rival < _SECOND * top:
            best[e] = at
    return best


@njit(cache=True)
def crossed(px: Array, normal: Array, edge: Indices, partner: Indices, start: Array, end: Array, reach: float) -> Mask:
    """Points (N,) whose profile, within reach px, meets the chord start-end (E, 2) of an edge that is neither its own nor
    that one's partner (E,). Points are in the order of their edges.
    """
    n, first = px.shape[0], 0
    result = np.zeros(n, dtype=np.bool_)
    near = np.empty(len(start), np.int64)
    while first < n:
        own, stop = edge[first], first
        while stop < n and edge[stop] == own:
            stop += 1
        count = 0
        for e in _chords_near(px[first:stop], start, end, reach + _SLACK_PX, near):
            if e != own and e != partner[own]:
                near[count] = e
                count += 1
        for i in range(first, stop):
            u, v, nu, nv = px[i, 0], px[i, 1], normal[i, 0], normal[i, 1]
            for e in near[:count]:
                au, av, bu, bv = start[e, 0] - u, start[e, 1] - v, end[e, 0] - u, end[e, 1] - v
                side_a, side_b = nu * av - nv * au, nu * bv - nv * bu
                if (side_a > 0.0) == (side_b > 0.0):
                    continue
                s = side_a / (side_a - side_b)
                along = (au + s * (bu - au)) * nu + (av + s * (bv - av)) * nv
                if abs(along) < reach:
                    result[i] = True
                    break
        first = stop
    return result


@njit(cache=True)
def _chords_near(px: Array, start: Array, end: Array, reach: float, near: Indices) -> Indices:
    """The chords start-end (E, 2) whose box comes within reach px of that of points px (N, 2); near (E,): room for them."""
    left, top, right, bottom = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(px)):
        left, right = min(left, px[i, 0] - reach), max(right, px[i, 0] + reach)
        top, bottom = min(top, px[i, 1] - reach), max(bottom, px[i, 1] + reach)
    count = 0
    for e in range(len(start)):
        across = max(start[e, 0], end[e, 0]) >= left and min(start[e, 0], end[e, 0]) <= right
        if across and max(start[e, 1], end[e, 1]) >= top and min(start[e, 1], end[e, 1]) <= bottom:
            near[count] = e
            count += 1
    return near[:count]
