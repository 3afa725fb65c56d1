"""Plots of a report."""

from collections.abc import Iterable
from statistics import mode
from typing import Final

import msgspec
import numpy as np

from logs.evaluation import metrics
from logs.evaluation.collected import Collected
from logs.evaluation.evaluate import Comparison
from logs.report.buckets import Buckets
from logs.report.charts import Band, BarChart, Chart, Colour, Level, Line, Points, Stay, StripChart, TimeChart, band, line, short
from logs.report.gather import BIASES, NUMBERS, SIGMAS_95, WEIGHTS, Gathered, Stretch, attitude_deg, seconds
from models.messages import AidStatus, Array, Mode, Reason

MODES: Final[dict[str, Colour]] = {
    Mode.STARTING: "grey",
    Mode.ALIGNING: "purple",
    Mode.ALIGNING_HEADING: "sky",
    Mode.AIDED: "blue",
    Mode.ODOMETRY: "green",
    Mode.DEAD_RECKONING: "orange",
    Mode.COASTING: "vermillion",
}
_SOURCES: Final[dict[str, Colour]] = {"active": "green", "starting": "sky", "stopped": "vermillion"}
_AXES: Final = ("east", "north", "up")
_OF_AXES: Final[tuple[Colour, ...]] = ("vermillion", "green", "blue")
MOST_POINTS: Final = 1000  # of one colour
_COMPONENTS: Final = {3: ("north", "east", "down"), 6: ("north", "east", "down", "about north", "about east", "about down")}
_COLOURS: Final[tuple[Colour, ...]] = ("vermillion", "green", "blue", "purple", "orange", "sky")

Charts = dict[str, Chart]


def reported_and_true(collected: Collected, gathered: Gathered, c: Comparison) -> Charts:
    """95 % radius, horizontal error if a truth exists, fix times."""
    start_ns, parts = _start(collected), list[Line | Band | Points]()
    if gathered.signals is not None:
        parts.append(line("95 % radius", "blue", gathered.signals, 18, start_ns))
    if len(c):
        horizontal = np.linalg.norm(c.p_error[:, :2], axis=1)
        parts.append(line("horizontal error", "black", _buckets(c, horizontal[:, None]), 0, start_ns))
    parts += _events(collected)
    title = "Horizontal error and the radius that holds it 95 % of the time" if len(c) else "The radius that holds the error 95 %"
    return {"radius": TimeChart(title, "m", parts, scale="log", height=280)}


def errors(collected: Collected, c: Comparison) -> Charts:
    """Axis errors in 95 % bands."""
    if not len(c):
        return {}
    start_ns = _start(collected)
    with np.errstate(invalid="ignore"):
        p_sigma = np.sqrt(np.diagonal(c.p_covariance, axis1=1, axis2=2))
        theta_sigma = np.rad2deg(np.sqrt(np.diagonal(c.estimate.covariance, axis1=1, axis2=2)[:, 3:]))
        v_sigma = np.sqrt(np.diagonal(c.estimate.v_covariance, axis1=1, axis2=2))
    groups = (
        ("p", "m", _AXES, c.p_error, p_sigma),
        ("v", "m/s", ("forward velocity", "left velocity", "upward velocity"), c.v_error, v_sigma),
        ("theta", "deg", ("tilt about east", "tilt about north", "heading"), np.rad2deg(c.theta_error), theta_sigma),
    )
    charts: Charts = {}
    for name, unit, axes, error, sigma in groups:
        if not np.isfinite(error).any():
            continue
        buckets = _buckets(c, np.hstack([error, SIGMAS_95 * sigma]))
        bands = SIGMAS_95 * sigma[np.isfinite(sigma)]
        usual = float(np.median(bands)) if len(bands) else 0.0
        far = float(bands.max(initial=0.0)) > 12.0 * usual > 0.0
        for k, axis in enumerate(axes):
            width = buckets.high[:, 3 + k]
            parts: list[Line | Band | Points] = [
                Band("95 % band", "sky", _first(buckets, start_ns), buckets.step_ns * 1e-9, short(-width), short(width)),
                line("error", "blue", buckets, k, start_ns),
            ]
            charts[f"error_{name}{k}"] = TimeChart(
                f"{axis} error",
                unit,
                parts,
                scale="asinh" if far else "linear",
                linear=float(10.0 ** np.ceil(np.log10(usual))) if far else 1.0,
                height=165,
            )
    return charts


def states(collected: Collected, gathered: Gathered) -> Charts:
    """Position, velocity, attitude with 95 % bands, and truth."""
    signals, start_ns, truth = gathered.signals, _start(collected), None
    if signals is None:
        return {}
    if len(collected.truth):
        attitude = attitude_deg(collected.truth.q_wxyz)
        attitude[:, 2] = _nearest_turn(attitude[:, 2], collected)
        truth = Buckets(9, signals.start_ns)
        truth.add(collected.truth.t_ns, np.hstack([collected.truth.p, collected.truth.v, attitude]))
    titles = [*_AXES, *(f"velocity {a}" for a in _AXES), "roll", "pitch, nose up", "heading, from north clockwise"]
    charts: Charts = {}
    for k, (title, unit) in enumerate(zip(titles, ["m"] * 3 + ["m/s"] * 3 + ["deg"] * 3, strict=True)):
        turn = 360.0 if k == 8 else 0.0
        parts: list[Line | Band | Points] = [band("95 % band", "sky", signals, k, 9 + k, start_ns)]
        if truth is not None and np.isfinite(truth.low[:, k]).any():
            parts.append(line(collected.yardstick, "black", truth, k, start_ns, turn))
        parts.append(line("estimate", "blue", signals, k, start_ns, turn))
        charts[f"state{k}"] = TimeChart(title, unit, parts, height=165)
    return charts


def biases(collected: Collected, gathered: Gathered) -> Charts:
    """Biases of gyroscope and accelerometer from Health."""
    numbers = gathered.numbers
    columns = [NUMBERS.index(name) for name in BIASES]
    if numbers is None or not np.isfinite(numbers.low[:, columns]).any():
        return {}
    charts: Charts = {}
    for first, title, unit in ((0, "gyroscope bias", "rad/s"), (3, "accelerometer bias", "m/s²")):
        parts = list[Line | Band | Points]()
        for axis, colour, name in zip("xyz", _OF_AXES, BIASES[first : first + 3], strict=True):
            column, sigma = NUMBERS.index(name), NUMBERS.index(f"{name}_sigma")
            half = SIGMAS_95 * numbers.high[:, sigma]
            parts.append(band(axis, colour, numbers, column, half, _start(collected)))
            parts.append(line(axis, colour, numbers, column, _start(collected)))
        charts[f"bias{first}"] = TimeChart(title, unit, parts, height=210)
    return charts


def innovations(collected: Collected) -> Charts:
    """Normalised innovations, NIS, gate by source."""
    by_source: dict[tuple[str, str], list[AidStatus]] = {}
    for aid in collected.aids:
        if aid.innovation:
            by_source.setdefault((aid.topic, aid.kind), []).append(aid)
    charts: Charts = {}
    for number, ((topic, kind), members) in enumerate(sorted(by_source.items())):
        fused, others = _split(members)
        group = [*thinned(fused), *thinned(others)]
        charts[f"innovation{number}"] = _innovation(f"{topic} {kind}: innovation / its sigma", group, _start(collected))
        charts[f"ratio{number}"] = _ratio(f"{topic} {kind}: squared distance / gate", group, _start(collected))
        charts[f"nis{number}"] = _nis(f"{topic} {kind}: NIS / degrees of freedom", group, _start(collected))
    return charts


def thinned(aids: list[AidStatus]) -> list[AidStatus]:
    """At most MOST_POINTS: first and worst of equal parts."""
    return [aids[row] for row in _worst([aid.test_ratio for aid in aids])]


def _worst(misfit: list[float]) -> list[int]:
    rows = list(range(len(misfit)))
    if len(rows) <= MOST_POINTS:
        return rows
    parts = [part.tolist() for part in np.array_split(rows, MOST_POINTS // 2)]
    return sorted({row for part in parts for row in (part[0], max(part, key=misfit.__getitem__))})


def _innovation(title: str, group: list[AidStatus], start_ns: int) -> Chart:
    sizes = {len(a.innovation) for a in group}
    names = _COMPONENTS.get(max(sizes)) if len(sizes) == 1 else None  # parts of a fix have directions of their own
    names = names or tuple(f"{k + 1}." for k in range(max(sizes)))
    parts = list[Line | Band | Points]()
    for k, name in enumerate(names):
        given = [a for a in group if len(a.innovation) > k and a.reason is Reason.FUSED]
        y = np.array([a.innovation[k] / (a.innovation_sigma[k] or np.nan) for a in given])
        text = [f"{a.innovation[k]:.3g} of {a.innovation_sigma[k]:.3g}" for a in given]
        parts.append(Points(name, _COLOURS[k % 6], "dot", _times(given, start_ns), short(y, 4), text))
    others = [a for a in group if a.reason is not Reason.FUSED]
    if others:
        parts.append(Points("not fused", "vermillion", "top", _times(others, start_ns), [0.0] * len(others), _whys(others)))
    return TimeChart(title, "", parts, [Level(SIGMAS_95, "95 %"), Level(-SIGMAS_95, "")])


def _ratio(title: str, group: list[AidStatus], start_ns: int) -> Chart:
    fused, others = _split(group)
    parts: list[Line | Band | Points] = [_marks("fused", "green", "dot", fused, start_ns, [a.test_ratio for a in fused])]
    if others:
        parts.append(_marks("not fused", "vermillion", "cross", others, start_ns, [a.test_ratio for a in others]))
    return TimeChart(title, "", parts, [Level(1.0, "gate")], scale="log")


def _nis(title: str, group: list[AidStatus], start_ns: int) -> Chart:
    fused = [a for a in group if a.reason is Reason.FUSED]
    with np.errstate(divide="ignore", invalid="ignore"):
        values = [float(np.mean(np.square(np.divide(a.innovation, a.innovation_sigma)))) for a in fused]
    size = mode(len(a.innovation) for a in group)
    low, high = metrics.chi2_band(size)
    parts: list[Line | Band | Points] = [_marks("fused", "blue", "dot", fused, start_ns, values)]
    return TimeChart(title, "", parts, [Level(high / size, "95 % of single ones"), Level(low / size, "")], scale="log")


def consistency(collected: Collected, c: Comparison) -> Charts:
    """NEES / 3 of position, velocity, attitude, with 95 % interval."""
    if not len(c):
        return {}
    attitude, velocity = c.has_attitude, np.isfinite(c.v_error).all(axis=1)
    values = np.full((len(c), 3), np.nan)
    values[:, 0] = metrics.nees(c.p_error, c.p_covariance) / 3.0
    values[velocity, 1] = metrics.nees(c.v_error[velocity], c.estimate.v_covariance[velocity]) / 3.0
    values[attitude, 2] = metrics.nees(c.theta_error[attitude], c.estimate.covariance[attitude, 3:, 3:]) / 3.0
    buckets, (low, high) = _buckets(c, values), metrics.chi2_band(3)
    names: list[tuple[str, Colour]] = [("position", "blue"), ("velocity", "green"), ("attitude", "purple")]
    parts: list[Line | Band | Points] = [
        line(name, colour, buckets, k, _start(collected))
        for k, (name, colour) in enumerate(names)
        if np.isfinite(values[:, k]).any()
    ]
    levels = [Level(high / 3.0, "97.5 % below"), Level(low / 3.0, "2.5 % below")]
    return {
        "nees": TimeChart(
            "NEES / degrees of freedom (mean 1 if the covariance is consistent)", "", parts, levels, "log", height=230
        )
    }


def mode_and_sources(collected: Collected, gathered: Gathered) -> Charts:
    """Mode and sources as stripes."""
    start_ns, end_ns = _start(collected), int(collected.estimate.t_ns[-1])
    rows = {
        name: _stays(stretches, MODES if name == "mode" else _SOURCES, start_ns, end_ns)
        for name, stretches in gathered.states.items()
    }
    return {"states": StripChart("Mode and sources", rows)} if rows else {}


def health(collected: Collected, gathered: Gathered) -> Charts:
    """Age of the last absolute fix, attitude sigma, hypotheses and weights."""
    charts: Charts = {}
    if gathered.numbers is not None:
        for name, title, unit in (
            ("absolute_age_s", "Since an absolute position was fused", "s"),
            ("attitude_sigma_deg", "Attitude, 1 sigma of the worst axis", "deg"),
            ("hypotheses", "Hypotheses: what may be true at the same time", ""),
        ):
            given = line("by the health", "blue", gathered.numbers, NUMBERS.index(name), _start(collected))
            charts[name] = TimeChart(title, unit, [given], height=165)
        if np.isfinite(gathered.numbers.low[:, [NUMBERS.index(name) for name in WEIGHTS]]).any():
            charts["weights"] = _weights(gathered.numbers, _start(collected))
    return charts


def _weights(numbers: Buckets, start_ns: int) -> TimeChart:
    colours: tuple[Colour, ...] = ("vermillion", "orange", "green", "blue")
    parts: list[Line | Band | Points] = [
        line(name, colour, numbers, NUMBERS.index(name), start_ns) for name, colour in zip(WEIGHTS, colours, strict=True)
    ]
    return TimeChart("Weight of the other hypotheses (0: as likely)", "ln", parts, height=210)


def times(collected: Collected, gathered: Gathered) -> Charts:
    """Ages at arrival, spacing of estimates."""
    charts: Charts = {
        "latency": _bars("Age of estimates at arrival", gathered.latency.edges_s, gathered.latency.counts),
        "steps": _bars("From one estimate's stamp to the next", gathered.steps.edges_s, gathered.steps.counts),
    }
    by_topic: dict[str, list[float]] = {}
    for aid in collected.aids:
        by_topic.setdefault(aid.topic, []).append(aid.delay_s)
    for number, (topic, delays) in enumerate(sorted(by_topic.items())):
        counts = np.histogram(np.clip(delays, 1.001e-4, 99.9), gathered.latency.edges_s)[0]
        charts[f"delay{number}"] = _bars(f"Age of {topic} at arrival", gathered.latency.edges_s, counts, "green")
    return charts


def vision(collected: Collected, gathered: Gathered) -> Charts:
    """Vision results, fit quality, durations."""
    frames = [(t, frame.report) for t, frame in sorted(gathered.frames.items()) if frame.report]
    if not frames:
        return {}
    start_ns = _start(collected)
    rows: dict[str, list[Stay]] = {}
    step = float(np.median(np.diff(seconds([t for t, _ in frames], start_ns)))) if len(frames) > 1 else 0.1
    for t, report in frames:
        at = (t - start_ns) * 1e-9
        colour: Colour = "green" if report.outcome == "fixed" else "orange"
        rows.setdefault(report.outcome.replace("_", " "), []).append(
            Stay(at, at + step, colour, report.detail or report.outcome, "fix" if colour == "green" else "no fix")
        )
    span = (frames[-1][0] - frames[0][0]) * 1e-9 / MOST_POINTS
    strips = {outcome: _joined(stays, span) for outcome, stays in sorted(rows.items(), key=lambda r: -len(r[1]))}
    charts: Charts = {"outcomes": StripChart("What came of each pair of images", strips)}
    fits = [(t, r) for t, r in frames if np.isfinite(r.residual_px)]
    if fits:
        fits = [fits[row] for row in _worst([r.residual_px for _, r in fits])]
        y = short(np.array([r.residual_px for _, r in fits]))
        points = Points("fit", "green", "dot", short(seconds([t for t, _ in fits], start_ns), 7), y, [f"{v} px" for v in y])
        charts["fit"] = TimeChart("RMS of the outline fit", "px", [points], height=165)
    spent = [r.processing_s for _, r in frames if r.processing_s > 0]
    if spent:
        edges = np.geomspace(1e-4, 1e2, 61)
        charts["spent"] = _bars("Time vision took", edges, np.histogram(np.clip(spent, 1.001e-4, 99.9), edges)[0])
    return charts


def _bars(title: str, edges_s: Array, counts: Iterable[int], colour: Colour = "blue") -> BarChart:
    return BarChart(title, "ms", short(1e3 * edges_s, 4), [int(n) for n in counts], colour)


def _joined(stays: list[Stay], span: float) -> list[Stay]:
    joined: list[Stay] = []
    for stay in stays:
        if joined and stay.start - joined[-1].start < span:
            joined[-1] = msgspec.structs.replace(joined[-1], end=stay.end)
        else:
            joined.append(stay)
    return joined


def _stays(stretches: list[Stretch], colours: dict[str, Colour], start_ns: int, end_ns: int) -> list[Stay]:
    ends = [s.t_ns for s in stretches[1:]] + [max(end_ns, stretches[-1].t_ns)]
    return [
        Stay(
            round((s.t_ns - start_ns) * 1e-9, 3),
            round((e - start_ns) * 1e-9, 3),
            colours.get(s.state, "grey"),
            s.state,
            s.state.replace("_", " "),
        )
        for s, e in zip(stretches, ends, strict=True)
    ]


def _events(collected: Collected) -> list[Points]:
    absolute = [a for a in collected.aids if a.kind in {"gnss_position", "pose"}]
    used = thinned([a for a in absolute if a.reason in {Reason.FUSED, Reason.ALIGNING}])
    others = thinned([a for a in absolute if a.reason not in {Reason.FUSED, Reason.ALIGNING}])
    events = [Points("fix used", "green", "tick", _times(used, _start(collected)), [None] * len(used), [a.topic for a in used])]
    if others:
        events.append(
            Points("fix not used", "vermillion", "top", _times(others, _start(collected)), [None] * len(others), _whys(others))
        )
    return events if absolute else []


def _split(group: list[AidStatus]) -> tuple[list[AidStatus], list[AidStatus]]:
    return [a for a in group if a.reason is Reason.FUSED], [a for a in group if a.reason is not Reason.FUSED]


def _marks(name: str, colour: Colour, shape: str, aids: list[AidStatus], start_ns: int, y: list[float]) -> Points:
    values = short(np.array(y), 4)
    text = [f"{v}" if a.reason is Reason.FUSED else f"{v} {a.reason} {a.detail}" for v, a in zip(values, aids, strict=True)]
    return Points(name, colour, shape, _times(aids, start_ns), values, text)  # type: ignore[arg-type]


def _times(aids: list[AidStatus], start_ns: int) -> list[float | None]:
    return [round((a.t_ns - start_ns) * 1e-9, 3) for a in aids]


def _whys(aids: list[AidStatus]) -> list[str]:
    return [f"{a.topic} {a.reason} {a.detail}".strip() for a in aids]


def _buckets(c: Comparison, values: Array) -> Buckets:
    buckets = Buckets(values.shape[1], int(c.t_ns[0]))
    buckets.add(c.t_ns, values)
    return buckets


def _nearest_turn(heading_deg: Array, collected: Collected) -> Array:
    c = collected.estimate
    given = c.has_attitude
    drawn = np.unwrap(attitude_deg(c.q_wxyz[given])[:, 2], period=360.0)
    if not len(drawn):
        return heading_deg
    beside = np.interp(collected.truth.t_ns.astype(float), c.t_ns[given].astype(float), drawn)
    turned: Array = heading_deg + 360.0 * np.round((beside - heading_deg) / 360.0)
    return turned


def _first(buckets: Buckets, start_ns: int) -> float:
    return (buckets.start_ns + buckets.step_ns // 2 - start_ns) * 1e-9


def _start(collected: Collected) -> int:
    return int(collected.estimate.t_ns[0])
