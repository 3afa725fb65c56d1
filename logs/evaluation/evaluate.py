"""Evaluation of a log's estimate, with or without a truth.

    evaluation = evaluate(Path("estimate.mcap"))
    logs.evaluation.table.print_table(evaluation)         # for a person
    msgspec.json.encode(evaluation)                       # for a program

The estimate is interpolated at the truth's stamps.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Final, Self

import numpy as np

from logs.evaluation import metrics
from logs.evaluation.agreement import contradiction
from logs.evaluation.collected import TRUTH_TOPIC, Collected, HealthPoint, read
from logs.evaluation.integrity import summarise
from logs.evaluation.metrics import Mask, Stats, Times
from logs.evaluation.records import (
    Accuracy,
    AidSummary,
    ConsistencySummary,
    Evaluation,
    Outage,
    Percentiles,
    RelativeError,
    ResetRow,
)
from logs.evaluation.trajectory import Trajectory, interpolate, nearest
from models.messages import AidStatus, Array, Reason
from models.radius import horizontal_radius

ABSOLUTE_KINDS: Final = frozenset({"gnss_position", "pose"})  # measurements that say where, not only how fast or how high
LONGEST_STEP_NS: Final = 250_000_000  # an estimate is not interpolated over a longer hole
ALL_SOURCES: Final = "all"
_ODOMETRY: Final = "odometry"
_SHORTEST_OUTAGE_S: Final = 2.0
MOST: Final = 100_000  # estimates, 8 minutes at 200 Hz: of more every 2nd, 4th, ... is compared, so memory does not grow
_SAME_FIX_NS: Final = 10_000_000
_NOT_GIVEN_M2: Final = 9e4
_RELATIVE_S, _RELATIVE_M = (1.0, 10.0), (10.0, 100.0)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Estimate and truth at n common stamps; errors are true minus estimated.

    p_error (n, 3) m; p_covariance (n, 3, 3) of both; theta_error (n, 3) rad about map axes; v_error (n, 3) m/s along the body;
    left_out: truths without estimate.
    """

    estimate: Trajectory
    truth: Trajectory
    p_error: Array
    p_covariance: Array
    theta_error: Array
    v_error: Array
    left_out: int

    def __len__(self) -> int:
        return len(self.truth)

    def __getitem__(self, rows: Mask) -> Self:
        return type(self)(
            self.estimate[rows], self.truth[rows], self.p_error[rows], self.p_covariance[rows],
            self.theta_error[rows], self.v_error[rows], self.left_out,
        )  # fmt: skip

    @property
    def t_ns(self) -> Times:
        """Common stamps, (n,)."""
        return self.truth.t_ns

    @property
    def has_attitude(self) -> Mask:
        """Rows with both attitudes, (n,)."""
        return np.asarray(np.isfinite(self.theta_error).all(axis=1))


def compare(estimate: Trajectory, truth: Trajectory, every: int = 1) -> Comparison:
    """The estimate's errors at the truth's stamps; every: thinning."""
    estimate = estimate[np.asarray(np.isfinite(estimate.p).all(axis=1))]
    step_ns = int(1.5 * np.median(np.diff(estimate.t_ns))) if every > 1 and len(estimate) > 1 else 0
    at, covered = interpolate(estimate, truth.t_ns, max(LONGEST_STEP_NS, step_ns))
    inside = truth[covered]
    theta_error, attitude = np.full((len(inside), 3), np.nan), np.asarray(inside.has_attitude & at.has_attitude)
    if attitude.any():
        theta_error[attitude] = metrics.attitude_error(at.q_wxyz[attitude], inside.q_wxyz[attitude])
    return Comparison(
        estimate=at,
        truth=inside,
        p_error=inside.p - at.p,
        p_covariance=at.covariance[:, :3, :3] + _known(inside.covariance[:, :3, :3]),
        theta_error=theta_error,
        v_error=np.where(at.has_attitude[:, None], inside.v_body - at.v_body, np.nan),
        left_out=int(np.count_nonzero(~covered)),
    )


def _known(covariance: Array) -> Array:
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    given = np.isfinite(covariance).all(axis=(1, 2)) & ((variances >= 0.0) & (variances < _NOT_GIVEN_M2)).all(axis=1)
    return np.where(np.reshape(given, (-1, 1, 1)), covariance, 0.0)


@dataclass(frozen=True, slots=True)
class Outages:
    """Outages of a source (a topic, or "all"): waits longer than longer_than_s."""

    longer_than_s: float
    spans: list[tuple[int, int]]


def find_outages(
    aids: Iterable[AidStatus], health: Iterable[HealthPoint], estimate: Trajectory, longer_than_s: float | None = None
) -> dict[str, Outages]:
    """Spans without absolute information, of all sources ("all") and each topic.

    Wait: from the validity of the newest absolute measurement (fused or aligning; the start counts) to the arrival of a newer
    one. Outage: longer than 3 x the median wait and 2 s, or longer_than_s. Without AidStatus: by Health's age.
    """
    aids, health = tuple(aids), tuple(health)
    start, end = int(estimate.t_ns[0]), int(estimate.t_ns[-1])
    seen: dict[str, list[tuple[int, int]]] = {}
    for aid in aids:
        if is_absolute(aid.kind, aid.reason, aid.t_ns, start):
            seen.setdefault(aid.topic, []).append((aid.t_ns, aid.arrived_ns))
    if not seen and health:
        seen[ALL_SOURCES] = _from_ages(health)
    if not seen and aids:
        seen[ALL_SOURCES] = []
    return outages_between(seen, start, end, longer_than_s)


def is_absolute(kind: str, reason: Reason, t_ns: int, start_ns: int) -> bool:
    """Whether the measurement gave the position."""
    return kind in ABSOLUTE_KINDS and (reason is Reason.FUSED or (reason is Reason.ALIGNING and t_ns >= start_ns))


def outages_between(
    seen: Mapping[str, list[tuple[int, int]]], start: int, end: int, longer_than_s: float | None = None
) -> dict[str, Outages]:
    """Outages by source, of validity and arrival of absolute measurements; start, end: of the estimate."""
    outages = {source: _outages_of(points, start, end, longer_than_s) for source, points in seen.items()}
    if len(outages) > 1:
        return {ALL_SOURCES: _in_all(list(outages.values())), **outages}
    return {ALL_SOURCES: next(iter(outages.values()), Outages(_SHORTEST_OUTAGE_S, []))}


def _from_ages(health: Iterable[HealthPoint]) -> list[tuple[int, int]]:
    points: list[tuple[int, int]] = []
    for h in health:
        if np.isfinite(h.absolute_age_s):
            valid = h.t_ns - round(1e9 * h.absolute_age_s)
            if not points or valid > points[-1][0] + _SAME_FIX_NS:
                points.append((valid, h.t_ns))
    return points


def _outages_of(points: list[tuple[int, int]], start: int, end: int, longer_than_s: float | None) -> Outages:
    valid, arrived = np.array([*points, (start, start)], np.int64).T
    waited = np.diff(metrics.waits(valid, arrived))
    usual_s = float(np.median(waited)) * 1e-9 if len(waited) else 0.0
    threshold_s = max(_SHORTEST_OUTAGE_S, 3.0 * usual_s) if longer_than_s is None else longer_than_s
    return Outages(threshold_s, metrics.gaps(valid, arrived, end, round(1e9 * threshold_s)))


def _in_all(outages: list[Outages]) -> Outages:
    threshold_s = min(o.longer_than_s for o in outages)
    spans = reduce(metrics.common, (o.spans for o in outages))
    return Outages(threshold_s, [(a, b) for a, b in spans if b - a > 1e9 * threshold_s])


def evaluate(
    path: Path,
    truth_topic: str = TRUTH_TOPIC,
    *,
    burn_in_s: float = 0.0,
    outage_s: float | None = None,
    without_odometry: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Evaluation:
    """Evaluate /landfix/odometry against a truth in the log, or without one.

    burn_in_s: not compared; outage_s: see find_outages; without_odometry: the same flight without. Raises LogError.
    """
    collected = read(path, truth_topic, progress, most=MOST)
    without = read(without_odometry, truth_topic, most=MOST).estimate if without_odometry else None
    return assess(collected, str(path), burn_in_s, outage_s, without)


def assess(
    collected: Collected,
    name: str,
    burn_in_s: float = 0.0,
    outage_s: float | None = None,
    without_odometry: Trajectory | None = None,
    *,
    relative: bool = True,
) -> Evaluation:
    """Evaluate collected data; relative: with relative errors."""
    estimate, truth = collected.estimate, collected.truth
    outages = find_outages(collected.aids, collected.health, estimate, outage_s)
    start, end = int(estimate.t_ns[0]), int(estimate.t_ns[-1])
    comparison = compare(estimate, truth, collected.every)
    comparison = comparison[np.asarray(comparison.t_ns >= start + burn_in_s * 1e9)]
    aided = ~metrics.within(comparison.t_ns, _with_jumps(outages[ALL_SOURCES].spans, estimate))
    compared = len(comparison) > 0
    without_odometry = without_odometry if without_odometry is not None and len(without_odometry) else None
    beside = compare(without_odometry, truth, collected.every) if without_odometry is not None else None
    steps = np.array([a.t_ns for a in collected.aids if a.kind == _ODOMETRY and a.reason is Reason.FUSED], np.int64)
    path = truth.p if compared else estimate.p[np.isfinite(estimate.p).all(axis=1)]
    without = sum(b - a for a, b in outages[ALL_SOURCES].spans) * 1e-9
    return Evaluation(
        log=name,
        compared_with=f"reference ({collected.reference})" if collected.reference else "truth",
        duration_s=(end - start) * 1e-9,
        estimates=collected.estimates,
        distance_m=float(metrics.path_length(path)[-1]) if len(path) else 0.0,
        truth_samples=len(truth),
        compared=len(comparison),
        without_estimate=comparison.left_out,
        without_truth=_count_far(truth, estimate),
        modes=_mode_shares(collected.health, end),
        without_absolute_s=without,
        accuracy=_accuracy(comparison, aided, relative=relative) if compared else None,
        consistency=_consistency(comparison, aided) if compared else None,
        outages=tuple(
            _outage(source, span, comparison, start, steps, beside) for source, of in outages.items() for span in of.spans
        ),
        outage_thresholds_s={source: of.longer_than_s for source, of in outages.items()},
        aids=_aid_summaries(collected.aids),
        latency_s=_latency(collected),
        resets=tuple(
            ResetRow(
                (j.t_ns - start) * 1e-9, j.counter, _norm(j.delta_p), _norm(j.delta_v), float(np.rad2deg(_norm(j.delta_theta)))
            )
            for j in collected.resets
        ),
        notes=_notes(collected, comparison),
        integrity=summarise(collected.integrity, comparison.t_ns, comparison.p_error),
    )


def _with_jumps(outages: list[tuple[int, int]], estimate: Trajectory) -> list[tuple[int, int]]:
    step = int(np.median(np.diff(estimate.t_ns))) if len(estimate) > 1 else 0
    return [(start, end + 2 * step) for start, end in outages]


def _norm(v: Iterable[float]) -> float:
    return float(np.linalg.norm(list(v)))


def _count_far(truth: Trajectory, estimate: Trajectory) -> int:
    if not len(truth):
        return len(estimate)
    step = int(np.median(np.diff(truth.t_ns))) if len(truth) > 1 else 0
    _, near = nearest(truth.t_ns, estimate.t_ns, max(step, 10_000_000))
    return int(np.count_nonzero(~near))


def _mode_shares(health: tuple[HealthPoint, ...], end_ns: int) -> dict[str, float]:
    total: Counter[str] = Counter()
    for here, until in zip(health, [*(h.t_ns for h in health), end_ns][1:], strict=True):
        total[here.mode] += max(0, until - here.t_ns)
    return {mode: ns / total.total() for mode, ns in total.items()} if total.total() else {}


def _accuracy(c: Comparison, aided: Mask, *, relative: bool) -> Accuracy:
    p_est, p_true = c.estimate.p, c.truth.p
    attitude = c.has_attitude
    theta_deg, velocity = np.rad2deg(c.theta_error), np.isfinite(c.v_error).all(axis=1)
    return Accuracy(
        position_m=metrics.stats(c.p_error),
        horizontal_m=metrics.stats(c.p_error[:, :2]),
        vertical_m=metrics.stats(c.p_error[:, 2]),
        aided_position_m=metrics.stats(c.p_error[aided]),
        yaw_aligned_m=metrics.ate(p_est, p_true, "yaw"),
        se3_aligned_m=metrics.ate(p_est, p_true, "se3"),
        sim3_aligned_m=metrics.ate(p_est, p_true, "sim3"),
        sim3_scale=metrics.align(p_est, p_true, "sim3").scale,
        attitude_deg=metrics.stats(theta_deg[attitude]),
        aided_attitude_deg=metrics.stats(theta_deg[attitude & aided]),
        tilt_deg=metrics.stats(theta_deg[attitude, :2]),
        heading_deg=metrics.stats(theta_deg[attitude, 2]),
        velocity_m_s=metrics.stats(c.truth.v[velocity] - c.estimate.v[velocity]),
        relative=_relative(c[attitude]) if relative else (),
    )


def _relative(c: Comparison) -> tuple[RelativeError, ...]:
    t = (c.t_ns - c.t_ns[0]) * 1e-9 if len(c) else np.empty(0)
    path = metrics.path_length(c.truth.p)
    poses = (c.estimate.p, c.estimate.q_wxyz, c.truth.p, c.truth.q_wxyz)
    spans = [(f"{s:g} s", t, s) for s in _RELATIVE_S] + [(f"{d:g} m", path, d) for d in _RELATIVE_M]
    errors = ((name, metrics.rpe(*poses, metrics.pairs_apart(x, delta, 0.1 * delta))) for name, x, delta in spans)
    return tuple(RelativeError(name, p, _degrees(turn)) for name, (p, turn) in errors if p.n)


def _degrees(s: Stats) -> Stats:
    factor = 180.0 / np.pi
    return Stats(factor * s.rmse, factor * s.mean, factor * s.median, factor * s.max, s.n)


def _consistency(c: Comparison, aided: Mask) -> ConsistencySummary:
    nees_p = metrics.nees(c.p_error, c.p_covariance)
    attitude, velocity = c.has_attitude, np.asarray(np.isfinite(c.v_error).all(axis=1))
    pose_error, pose_covariance = np.hstack([c.p_error, c.theta_error]), c.estimate.covariance.copy()
    pose_covariance[:, :3, :3] = c.p_covariance
    radius = horizontal_radius(c.p_covariance[:, :2, :2])
    horizontal = np.linalg.norm(c.p_error[:, :2], axis=1)
    return ConsistencySummary(
        position=metrics.consistency(nees_p, 3),
        position_aided=metrics.consistency(nees_p[aided], 3),
        position_outages=metrics.consistency(nees_p[~aided], 3),
        attitude=metrics.consistency(metrics.nees(c.theta_error[attitude], c.estimate.covariance[attitude, 3:, 3:]), 3),
        velocity=metrics.consistency(metrics.nees(c.v_error[velocity], c.estimate.v_covariance[velocity]), 3),
        pose=metrics.consistency(metrics.nees(pose_error[attitude], pose_covariance[attitude]), 6),
        radius95_covered=float(np.mean(horizontal <= radius)),
        radius95_median_m=float(np.median(radius)),
        radius95_max_m=float(np.max(radius)),
    )


def _outage(
    source: str, span: tuple[int, int], comparison: Comparison, start: int, steps: Times, beside: Comparison | None
) -> Outage:
    without = beside.p_error[metrics.within(beside.t_ns, [span])] if beside is not None else np.empty((0, 3))
    c = comparison[metrics.within(comparison.t_ns, [span])]
    attitude = np.rad2deg(np.linalg.norm(c.theta_error[c.has_attitude], axis=1))
    nees_p = metrics.nees(c.p_error, c.p_covariance)
    radius = horizontal_radius(c.p_covariance[-1:, :2, :2])
    return Outage(
        source=source,
        start_s=(span[0] - start) * 1e-9,
        duration_s=(span[1] - span[0]) * 1e-9,
        drift=metrics.drift(c.p_error, c.truth.p) if len(c) else None,
        attitude_rmse_deg=float(np.sqrt(np.mean(attitude**2))) if len(attitude) else None,
        attitude_end_deg=float(attitude[-1]) if len(attitude) else None,
        nees_position=float(nees_p.mean() / 3) if len(c) else None,
        radius95_end_m=float(radius[0]) if len(c) else None,
        increments=int(np.count_nonzero((steps > span[0]) & (steps <= span[1]))),
        without_odometry_m=_norm(without[-1]) if len(without) else None,
    )


def _aid_summaries(aids: tuple[AidStatus, ...]) -> tuple[AidSummary, ...]:
    by_source: dict[tuple[str, str], list[AidStatus]] = {}
    for aid in aids:
        by_source.setdefault((aid.topic, aid.kind), []).append(aid)
    return tuple(_aid_summary(topic, kind, group) for (topic, kind), group in sorted(by_source.items()))


def _aid_summary(topic: str, kind: str, group: list[AidStatus]) -> AidSummary:
    fused = [a for a in group if a.reason is Reason.FUSED and a.innovation]
    squares, dof = 0.0, 0
    for size in {len(a.innovation) for a in fused}:
        same = [a for a in fused if len(a.innovation) == size]
        squares += float(metrics.nis(np.array([a.innovation for a in same]), np.array([a.innovation_sigma for a in same])).sum())
        dof += size * len(same)
    return AidSummary(
        topic=topic,
        kind=kind,
        reasons=dict(Counter(a.reason.value for a in group).most_common()),
        revised=sum(a.revision > 0 for a in group),
        nis=squares / dof if dof else None,
        test_ratio=_percentiles([a.test_ratio for a in fused]),
        delay_s=_percentiles([a.delay_s for a in group]),
    )


def _latency(collected: Collected) -> dict[str, Percentiles]:
    late = _percentiles(((collected.estimate.arrived_ns - collected.estimate.t_ns) * 1e-9).astype(float))
    return {"/landfix/odometry": late} if late else {}


def _percentiles(values: Array | list[float]) -> Percentiles | None:
    if not len(values):
        return None
    p50, p95, p99, most = (float(x) for x in np.percentile(np.asarray(values, float), [50, 95, 99, 100]))
    return Percentiles(p50, p95, p99, most)


def _notes(collected: Collected, c: Comparison) -> tuple[str, ...]:
    estimate = collected.estimate
    finite = np.isfinite(estimate.p).all(axis=1)
    broken, level = np.count_nonzero(~finite), np.count_nonzero(finite & ~estimate.has_attitude)
    not_definite = np.count_nonzero(np.isinf(metrics.nees(c.p_error, c.p_covariance)))
    notes = {
        "the log is truncated: read to its last whole record": collected.torn,
        f"{collected.unreadable} messages could not be read": collected.unreadable > 0,
        f"errors are computed from one of {collected.every} estimates": collected.every > 1,
        f"{broken} estimates are not finite": broken > 0,
        f"{level} estimates have no attitude that is known: of these the position counts": level > 0,
        f"{not_definite} position covariances are not positive definite: their NEES is infinite": not_definite > 0,
        "no truth: nothing can be said about errors": not len(collected.truth),
        f"the {collected.yardstick} and the estimate have no stamp in common": len(collected.truth) > 0 and not len(c),
        f"/truth is {collected.reference}, of the same sensors: differences are no errors": bool(collected.reference),
        f"the {collected.yardstick} has no attitude": len(c) > 0 and not c.truth.has_attitude.any(),
        "no /landfix/aid_status: outages are found from the health alone": bool(collected.health) and not collected.aids,
        "neither /landfix/aid_status nor /landfix/health: outages are not known": not collected.health and not collected.aids,
    }
    return tuple(text for text, holds in notes.items() if holds) + tuple(filter(None, [contradiction(collected)]))
