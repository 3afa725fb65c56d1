"""Content of a map, missing properties, ambiguous landmarks."""

import msgspec
import numpy as np

from estimator.tools.doctor.machine import Check, judge
from estimator.tools.maps.ambiguity import look_alikes, marks
from models.maps import outline as polygon
from models.maps.landmarks import LandmarkMap
from models.maps.table import Alike, Finding
from models.messages import Array

FEW = 3  # landmarks in view make a fix that stands by itself

_MISSING = {
    "height_m": "roofs at a guessed height move the fix when seen from the side; give height_m (map build --height-m)",
    "ground_alt_m": "the ground is taken at the origin's height; give ground_alt_m, or the origin's (map build --origin)",
    "sigma_m": "a guessed map error makes fixes overconfident or too cautious; give sigma_m (map build --sigma-m)",
    "colour": "regions then differ by shape and position alone; give colour (map build --colour-from)",
}


class LookAlike(msgspec.Struct, frozen=True):
    """Two landmarks, centre distance, similarity 0..1."""

    a: str
    b: str
    distance_m: float
    similarity: float


class Repeat(msgspec.Struct, frozen=True):
    """A landmark, and its nearest repeating shift."""

    id: str
    shift_m: float


class Nested(msgspec.Struct, frozen=True):
    """A landmark inside another's outline."""

    outer: str
    inner: str


class MapCheck(msgspec.Struct, frozen=True, kw_only=True):
    """Findings; rejected: features left out, with reasons."""

    landmarks: int
    features: int
    usable: bool
    origin: tuple[float, float, float]
    checks: list[Check]
    rejected: tuple[Finding, ...]
    remarks: tuple[Finding, ...]
    look_alikes: list[LookAlike]
    repeats: list[Repeat]
    nested: list[Nested]


def check(the_map: LandmarkMap, radius_m: float, alike: float) -> MapCheck:
    """All checks; look_alikes: within radius_m, similarity >= `alike`."""
    pairs, distances, similarities = look_alikes(the_map, radius_m, alike)
    marked = marks(the_map, pairs, distances)
    order = np.lexsort((distances, -similarities))
    names = the_map.columns.ids
    nested = [Nested(names[outer], names[inner]) for outer, inner in the_map.nested().tolist()]
    repeated = np.flatnonzero(marked.repeats_m < np.inf)
    repeats = [Repeat(names[i], round(float(marked.repeats_m[i]), 2)) for i in repeated.tolist()]
    listed = [
        LookAlike(names[a], names[b], round(float(distances[k]), 2), round(float(similarities[k]), 4))
        for k in order.tolist()
        for a, b in [pairs[k].tolist()]
    ]
    return MapCheck(
        landmarks=len(the_map),
        features=the_map.report.features,
        usable=len(the_map) > 0,
        origin=the_map.origin,
        checks=[*_contents(the_map), *(_quality(the_map, marked, len(nested), radius_m, alike) if len(the_map) else [])],
        rejected=the_map.report.rejected,
        remarks=the_map.report.remarks,
        look_alikes=listed,
        repeats=repeats,
        nested=nested,
    )


def _contents(the_map: LandmarkMap) -> list[Check]:
    found, count, missing = the_map.report, len(the_map), the_map.report.missing
    left_out = len(found.rejected)
    few = judge(
        "landmarks", f"{count}, from {found.features} features", fail=count == 0, warn=count < FEW,
        advice="give it polygons" if count == 0 else f"a fix needs {FEW} landmarks in view",
    )  # fmt: skip
    rejected = judge(
        "rejected", f"{left_out} features", warn=left_out > 0, advice="they are not in the map; the reasons are below"
    )
    doubt = the_map.report.doubt
    order = judge("coordinates", doubt or "in their order", warn=bool(doubt), advice="exchange latitude and longitude")
    unchecked = "landmarks were picked by a program: one alone gives no fix"
    checked = judge(
        "automatic", unchecked if the_map.automatic else "no", warn=the_map.automatic,
        advice="look at each (landfix map show), delete what may move, then landfix map build --checked",
    )  # fmt: skip
    lacks = [
        judge(f"without {name}", str(missing.get(name, 0)), warn=missing.get(name, 0) > 0, advice=advice)
        for name, advice in _MISSING.items()
    ]
    return [few, rejected, order, checked, *lacks]


def _quality(the_map: LandmarkMap, marked: Alike, nested: int, radius_m: float, alike: float) -> list[Check]:
    d, columns = the_map.description, the_map.columns
    north, east, size = d[:, polygon.NORTH], d[:, polygon.EAST], d[:, polygon.SIZE]
    far_km = float(np.hypot(north, east).max()) / 1000.0
    twins, repeated = int(np.sum(marked.count > 0)), int(np.sum(marked.repeats_m < np.inf))
    extent = f"{np.ptp(north):.0f} m north-south, {np.ptp(east):.0f} m east-west, up to {far_km:.1f} km from the origin"
    similar = f"{twins} landmarks ({twins / len(the_map):.0%}) have one at {alike:.0%} or more within {radius_m:g} m"
    tilted = "beyond 20 km the origin's down is more than 0.2 degrees off: make a map of the place itself"
    small = "landmarks under 1 m2 are seen from close by only"
    exact = "sigma_m = 0 says that the map is exact; no survey is"
    waiting = "they cannot be distinguished by shape and size: a fix needs several of them in view"
    same = f"{repeated} landmarks repeat their arrangement under a shift of at most {radius_m:g} m"
    by_prior = "several in view stay ambiguous there: arrive with a prior better than half the shift, or add distinct landmarks"
    one_place = "a roof is one landmark: keep the whole or its parts (building or building:part)"
    return [
        judge("extent", extent, warn=far_km > 20.0, advice=tilted),
        judge("size", f"{_spread(size)} m2", warn=bool(np.median(size) < 1.0), advice=small),
        judge("fill ratio", _spread(d[:, polygon.FILL], 2)),
        judge("height", f"{_spread(columns.height_m)} m, sigma {_spread(columns.height_sigma_m)} m"),
        judge("map sigma", f"{_spread(columns.sigma_m, 2)} m", warn=bool(np.any(columns.sigma_m == 0.0)), advice=exact),
        judge("one in another", f"{nested} pairs", warn=nested > 0, advice=one_place),
        judge("ambiguous landmarks", similar, warn=twins > 0.5 * len(the_map), advice=waiting),
        judge("repetition", same, warn=repeated > 0, advice=by_prior),
    ]


def _spread(values: Array, digits: int = 1) -> str:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:.{digits}f} (5-95 %: {low:.{digits}f} to {high:.{digits}f})"
