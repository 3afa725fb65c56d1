"""The flight from above."""

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from logs.evaluation.collected import Collected
from logs.evaluation.metrics import Indices, Mask, Times
from logs.evaluation.trajectory import Trajectory
from logs.report.charts import Colour, Ellipse, MapChart, Marks, Numbers, Path, Place, Shape
from logs.report.gather import Gathered, seconds
from logs.report.plots import MODES
from models.maps.landmarks import Landmark
from models.messages import Array

_MOST_POINTS: Final = 2000
_MOST_PLACES: Final = 3000
_ELLIPSES: Final = 30
# whether of GNSS -> marks of a fix that was used, and that was not; others are of landmarks and poses
_SHAPES: Final[dict[bool, tuple[Shape, Shape]]] = {True: ("dot", "cross"), False: ("diamond", "plus")}
_HOLE_NS: Final = 2_000_000_000
_SIGMAS_95_PLANE: Final = 2.447747


def flight(collected: Collected, gathered: Gathered, outages: list[tuple[int, int]], landmarks: Sequence[Landmark]) -> MapChart:
    """The map; landmarks: in its frame, those of fixes stand out."""
    estimate, truth, start_ns = collected.estimate, collected.truth, int(collected.estimate.t_ns[0])
    estimate = estimate[np.asarray(np.isfinite(estimate.p).all(axis=1))]
    paths = _by_mode(estimate, gathered, start_ns)
    if len(truth):
        paths = [*_paths(collected.yardstick, "black", truth[_few(len(truth))], start_ns, dashed=True), *paths]
    box = _box(np.vstack([estimate.p[:, :2], truth.p[:, :2]]))
    used = {name for frame in gathered.frames.values() if frame.fix for name in frame.fix.landmarks}
    return MapChart(
        title="From above: east to the right, north up",
        paths=paths,
        ellipses=_ellipses(estimate, outages, start_ns, max(box[2] - box[0], box[3] - box[1])),
        places=_places(landmarks, used, box),
        marks=_marks(collected, estimate, start_ns),
        box=box,
    )


def _by_mode(estimate: Trajectory, gathered: Gathered, start_ns: int) -> list[Path]:
    stretches = gathered.states.get("mode", [])
    few = estimate[_few(len(estimate))]
    if not stretches:
        return _paths("estimate", "blue", few, start_ns)
    ends = [s.t_ns for s in stretches[1:]] + [int(few.t_ns[-1]) + 1]
    paths = []
    for stretch, end in zip(stretches, ends, strict=True):
        rows = np.flatnonzero((few.t_ns >= stretch.t_ns) & (few.t_ns < end))
        if len(rows):
            part = few[np.arange(max(0, rows[0] - 1), rows[-1] + 1)]
            paths += _paths(stretch.state.replace("_", " "), MODES.get(stretch.state, "grey"), part, start_ns)
    return paths


def _paths(name: str, colour: Colour, way: Trajectory, start_ns: int, *, dashed: bool = False) -> list[Path]:
    step = np.diff(way.t_ns)
    longest = max(_HOLE_NS, 3.0 * float(np.median(step))) if len(step) else _HOLE_NS
    holes = np.flatnonzero(step > longest) + 1
    parts = (way[rows] for rows in np.split(np.arange(len(way)), holes))
    return [Path(name, colour, _m(part.p[:, 0]), _m(part.p[:, 1]), _s(part.t_ns, start_ns), dashed) for part in parts]


def _ellipses(estimate: Trajectory, outages: list[tuple[int, int]], start_ns: int, view_m: float) -> list[Ellipse]:
    even = np.linspace(int(estimate.t_ns[0]), int(estimate.t_ns[-1]), _ELLIPSES).astype(np.int64)
    wanted = np.concatenate([even, np.array([end - 1 for _, end in outages], np.int64)])
    rows = np.unique(np.clip(np.searchsorted(estimate.t_ns, wanted, side="right") - 1, 0, len(estimate) - 1))
    ellipses = []
    for row in rows.tolist():
        covariance = estimate.covariance[row, :2, :2]
        if not np.isfinite(covariance).all():
            continue
        values, vectors = np.linalg.eigh(covariance)
        b, a = (_SIGMAS_95_PLANE * np.sqrt(np.clip(values, 0.0, None))).tolist()
        if a < 0.3 * view_m:
            turn = float(np.rad2deg(np.arctan2(vectors[1, 1], vectors[0, 1])))
            x, y = estimate.p[row, :2].tolist()
            at = (int(estimate.t_ns[row]) - start_ns) * 1e-9
            ellipses.append(Ellipse(round(x, 2), round(y, 2), round(a, 3), round(b, 3), round(turn, 2), f"{at:.1f} s"))
    return ellipses


def _places(landmarks: Sequence[Landmark], used: Collection[str], box: tuple[float, float, float, float]) -> list[Place]:
    west, south, east, north = box
    reach = max(east - west, north - south)
    near = [
        mark
        for mark in landmarks
        if mark.id in used
        or (west - reach < mark.centre_n[1] < east + reach and south - reach < mark.centre_n[0] < north + reach)
    ]
    near.sort(key=lambda mark: mark.id not in used)
    return [Place(m.label, m.id in used, _m(m.outline_n[:, 1]), _m(m.outline_n[:, 0])) for m in near[:_MOST_PLACES]][::-1]


def _marks(collected: Collected, estimate: Trajectory, start_ns: int) -> list[Marks]:
    marks = []
    gnss = {aid.topic for aid in collected.aids if aid.kind == "gnss_position"}
    attitudes = {aid.topic for aid in collected.aids if aid.kind == "attitude"}  # that have no position
    for topic, fixes in sorted(collected.fixes.items()):
        if topic in attitudes:
            continue
        used, not_used = _SHAPES[topic in gnss]
        kinds: tuple[tuple[Mask, str, Colour, Shape], ...] = (
            (fixes.used, f"{topic} used", "green", used),
            (~fixes.used, f"{topic} not used", "vermillion", not_used),
        )
        for rows, name, colour, shape in kinds:
            known = np.flatnonzero(rows & np.isfinite(fixes.p[:, :2]).all(axis=1))
            known = known[_few(len(known))]
            if len(known):
                text = [f"{t:.1f} s" for t in seconds(fixes.t_ns[known], start_ns).tolist()]
                marks.append(Marks(name, colour, shape, _m(fixes.p[known, 0]), _m(fixes.p[known, 1]), text))
    ends: tuple[tuple[int, str, Shape], ...] = ((0, "start", "triangle"), (-1, "end", "square"))
    for row, name, shape in ends:
        x, y = estimate.p[row, :2]
        marks.append(Marks(name, "black", shape, _m(np.array([x])), _m(np.array([y])), [name]))
    return marks


def _box(p: Array) -> tuple[float, float, float, float]:
    p = p[np.isfinite(p).all(axis=1)]
    (west, south), (east, north) = p.min(axis=0).tolist(), p.max(axis=0).tolist()
    return west - 2.0, south - 2.0, east + 2.0, north + 2.0


def _few(n: int) -> Indices:
    return np.unique(np.linspace(0, n - 1, min(n, _MOST_POINTS)).round().astype(np.intp)) if n else np.empty(0, np.intp)


def _m(values: Array) -> Numbers:
    return [round(x, 2) for x in values.tolist()]


def _s(t_ns: Times, start_ns: int) -> Numbers:
    return [round(t, 2) for t in seconds(t_ns, start_ns).tolist()]
