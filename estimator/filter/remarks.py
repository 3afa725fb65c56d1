"""Why an estimate is less certain than configured, a sentence each."""

import cmath
import math
from collections.abc import Container, Iterable, Mapping

import numpy as np

from estimator.filter.conflict import Conflicts
from estimator.filter.hypotheses import Hypotheses
from estimator.filter.mismatch import CONSTANTS, Frame, Scatters, Scores, score
from estimator.filter.relative import drift
from estimator.sources.base.faults import RECENT_NS
from estimator.sources.base.machine import SourceState
from estimator.sources.base.similarity import Similarity
from estimator.sources.odometry import DRIFT, WRONG, drift_block

_NEW_NS = 1_000_000_000
_NOISY = 9.0  # times the variance
_COVERED, _ALLOWED = ", but the covariance covers it", ", but the covariance allows for an error of the map"
_WORTH_SAYING = 2.0  # of the variance of unit weight


def conflict(hypotheses: Hypotheses | None, absolute: Iterable[str], sources: Mapping[str, SourceState], t_ns: int) -> str:
    """Disagreeing absolute sources, distance, duration; "" for none."""
    if hypotheses is None or hypotheses.conflict_ns is None or (found := hypotheses.conflict) is None:
        return ""
    (rejected, distance_m), since_s = found, (t_ns - hypotheses.conflict_ns) * 1e-9
    known = (set(absolute) - rejected) & sources.keys()  # a source that was not judged yet has no state
    used = {topic for topic in known if t_ns - sources[topic].fused_ns < RECENT_NS}
    sides = ", ".join(sorted(rejected)), ", ".join(sorted(used)) or "the estimate"
    return f"{sides[0]} and {sides[1]} disagree by {distance_m:.1f} m for {since_s:.0f} s: the covariance covers both"


def turned(hypotheses: Hypotheses | None) -> list[str]:
    """Sources whose attitude is taken for false."""
    of = hypotheses.members[0].turned if hypotheses is not None else ()
    return [
        f"the attitude of {topic} contradicts the estimate, its positions do not: they alone are used" for topic in sorted(of)
    ]


def apart(found: Conflicts, undecided: Container[str]) -> list[str]:
    """Rejected sources and their distances; undecided: against which nothing decides."""
    return [
        f"{topic} is {np.linalg.norm(a.off):.1f} m from the estimate for {(a.last_ns - a.since_ns) * 1e-9:.0f} s: not used"
        + (_COVERED if topic in undecided else _ALLOWED if a.may_be_right else "")
        + _likeness(found.newest[topic].path)
        for topic, a in sorted(found.apart.items())
        if a.lasts
    ]


def _likeness(path: Similarity) -> str:
    if not path.is_turned:
        return ""
    turn_deg, times = math.degrees(cmath.phase(path.a)), abs(path.a)
    return f"; its path is that of the estimate, turned by {turn_deg:.1f} deg, times {times:.3f}: the map's north, or its scale?"


def frames(known: Mapping[str, Frame]) -> list[str]:
    """Fixes in other axes or in another unit."""
    return [f"{topic}: {frame.says}" for topic, frame in sorted(known.items()) if frame.says]


def heading(topic: str) -> str:
    """The heading rests on one sensor."""
    return f"the heading is that of {topic} alone until the vehicle accelerates"


def wrong(sources: Mapping[str, SourceState]) -> list[str]:
    """Odometry that is not used."""
    return [f"{topic}: {WRONG}" for topic, state in sorted(sources.items()) if not state.noise.is_noise]


def refuted(sources: Mapping[str, SourceState], t_ns: int) -> list[str]:
    """Sensors that positions contradict."""
    return [
        f"{topic} contradicts the positions: used again once it has agreed with them for {state.agrees_s:.0f} s"
        for topic, state in sorted(sources.items())
        if state.is_refuted and t_ns <= state.silent_ns
    ]


def two_headings(topics: tuple[str, str]) -> str:
    """Neither is taken."""
    return f"the headings of {' and '.join(topics)} differ: neither is used, the motion shows it"


def drifts(hypotheses: Hypotheses | None) -> list[str]:
    """Odometry that contradicted the IMU."""
    if hypotheses is None:
        return []
    lead = hypotheses.lead
    topics = sorted(block.removesuffix(DRIFT) for block in lead.slow.columns if block.endswith(DRIFT))
    found = [(topic, drift.sigma_m_s(lead, drift_block(topic))) for topic in topics]
    return [
        f"{topic} and the IMU have contradicted each other: each may be wrong by {sigma:.2g} m/s"
        for topic, sigma in found
        if sigma > drift.WORTH_SAYING_M_S
    ]


def constants(found: Scores, hypotheses: Hypotheses | None) -> list[str]:
    """Delays and headings of sources that nobody configured."""
    return score.remarks(CONSTANTS, found, hypotheses.lead) if hypotheses is not None else []


def held(found: Mapping[str, int], t_ns: int) -> list[str]:
    """Sources that repeat a reading."""
    return [
        f"{topic} repeats the same reading to the bit: not used"
        for topic, at_ns in sorted(found.items())
        if t_ns - at_ns < _NEW_NS
    ]


def imu(hypotheses: Hypotheses | None) -> list[str]:
    """Whether fixes show a wrong IMU."""
    doubts = hypotheses is not None and hypotheses.members[0].doubts_imu
    return ["the IMU contradicts the fixes: unknown motion is assumed between them"] if doubts else []


def scatter(found: Scatters, t_ns: int) -> list[str]:
    """Noisy sources."""
    return [
        f"{topic} scatters {math.sqrt(s.factor):.0f} times as far as it claims: jammed?"
        for topic, s in sorted(found.items())
        if s.factor > _NOISY and t_ns - s.t_ns < _NEW_NS
    ]


def variance(factor: float) -> list[str]:
    """Whether innovations are larger than configured, or were lately."""
    if factor < _WORTH_SAYING:
        return []
    return [
        f"innovations of the last minutes are {math.sqrt(factor):.1f} times as large as configured: the covariance is widened"
    ]
