"""All causes of a stretch, likeliest first."""

from collections.abc import Iterator
from itertools import chain
from typing import Final

import numpy as np

from logs.findings import clocks, held, inertial, numbers, position, pull, turning
from logs.findings.streams import ATTITUDE, FIX, IMU, POSE, TURNING, VELOCITY, Cause, Finding, Stream, Streams
from models.messages import Vec3

_LEAST_SAMPLES: Final = 20
_FIELD, _BARO = "magnetometer", "baro"


def judged(streams: Streams, origin: Vec3 | None) -> Iterator[tuple[str, Finding]]:
    """Kind of cause (ordered) and finding; a faulty stream is no witness."""
    for name, s in streams.items():
        if s.kind == IMU and (n := len(s.t_s)) < _LEAST_SAMPLES:
            what = f"{n} sample{'s' * (n > 1)} in all"
            yield "0", Finding(name, what, max(0.0, float(s.arrived_s[0])), inertial.RATE_ADVICE, unfit=True)
    whole = {name: s for name, s in sorted(streams.items()) if len(s.t_s) >= _LEAST_SAMPLES}
    known = {name: s for name, given in whole.items() if len((s := numbers.finite(given)).t_s) >= _LEAST_SAMPLES}
    guilty = set[str]()
    stages = (_numbers(whole), _stamps(known), _values(known, origin), _relations(known, guilty))
    for stage, found in enumerate(stages):
        for who, kind, cause in list(found):
            guilty.add(who)
            unfit = cause.unfit and streams[who].kind == IMU
            yield f"{stage}{kind}", Finding(who, cause.what, max(0.0, cause.since_s), cause.advice, unfit)


def _numbers(streams: Streams) -> Iterator[tuple[str, str, Cause]]:
    for name, s in streams.items():
        if cause := numbers.not_finite(s):
            yield name, "", cause


def _stamps(streams: Streams) -> Iterator[tuple[str, str, Cause]]:
    for name, s in streams.items():
        others = [other for topic, other in streams.items() if topic != name]
        cause = (
            clocks.sawtooth(s) or clocks.few_stamps(s) or clocks.two_clocks(s) or clocks.batches(s) or clocks.step(s, others)
            or clocks.rate(s, others) or clocks.shifted(s, others) or clocks.disorder(s)
        )  # fmt: skip
        if cause:
            yield name, "", cause


def _values(streams: Streams, origin: Vec3 | None) -> Iterator[tuple[str, str, Cause]]:
    imu = next((s for s in streams.values() if s.kind == IMU), None)
    for name, s in streams.items():
        others = [other for topic, other in streams.items() if topic != name]
        found: Cause | None
        if s.kind == IMU:
            found = (
                inertial.slow(s) or inertial.halves(s) or held.copies(s) or held.held(s, None) or inertial.frozen_axis(s)
                or inertial.units(s) or inertial.tilted(s) or inertial.spikes(s) or inertial.clipped(s)
                or clocks.silence(s, others)
            )  # fmt: skip
        else:
            found = held.zero(s) or (held.held(s, imu) or held.copies(s) if s.kind != ATTITUDE else None)
        if s.kind == FIX and not found:
            found = position.far(s, origin) or position.scattered(s)
        if s.kind == _BARO and not found:
            found = position.pressure(s)
        if s.kind == _FIELD and not found:
            found = inertial.frozen_axis(s)
        if found:
            yield name, "", found


def _relations(streams: Streams, guilty: set[str]) -> Iterator[tuple[str, str, Cause]]:
    sound = {name: s for name, s in streams.items() if name not in guilty}
    imu = next(((name, s) for name, s in sound.items() if s.kind == IMU), None)
    yield from chain(_turns(sound, *imu) if imu else (), _ways(sound))


def _turns(streams: Streams, name: str, imu: Stream) -> Iterator[tuple[str, str, Cause]]:
    turned = turning.Turned(imu)
    related = {n: turning.attitude_relation(turned, s) for n, s in streams.items() if s.kind in TURNING}
    bad = {n: r for n, r in related.items() if r is not None and r.differs()}
    if len(bad) > 1 and len(bad) == sum(r is not None for r in related.values()) and _alike([r.O for r in bad.values()]):
        cause = turning.misturned(next(iter(bad.values())), imu, " and ".join(bad))
        if cause:
            yield (
                name,
                "turn",
                cause._replace(advice="set [imu] axes and mounting_rpy_deg, or mend its driver"),
            )
        return
    for n, found in bad.items():
        if cause := turning.misturned(found, streams[n], name):
            yield n, "turn", cause
    for n, s in streams.items():
        if s.kind == POSE and n not in bad and (cause := pull.pulled(imu, s)):
            yield n, "pull", cause
        if s.kind == _FIELD and (cause := turning.field(turned, s)):
            headings = [n for n, other in streams.items() if other.kind == "attitude"]
            more = f"; leave out the autopilot's heading that rests on it ({', '.join(headings)})" if headings else ""
            yield n, "field", cause._replace(advice=cause.advice + more)


def _alike(turns: list[np.ndarray]) -> bool:
    return all(np.abs(t - turns[0]).max() < 0.3 for t in turns)


def _ways(streams: Streams) -> Iterator[tuple[str, str, Cause]]:
    fixes = {n: s for n, s in streams.items() if s.kind == FIX}
    for name, fix in fixes.items():
        speed = {n: position.velocity_relation(fix, s) for n, s in streams.items() if s.kind == VELOCITY}
        other = {n: position.position_relation(fix, s) for n, s in streams.items() if s.kind in (POSE, FIX) and n != name}
        agreed = [r for r in (*speed.values(), *other.values()) if r is not None and not r.differs() and r.equal < 0.5]
        if not agreed and len([r for r in (*speed.values(), *other.values()) if r is not None and r.differs()]) > 1:
            found = next(r for r in (*other.values(), *speed.values()) if r is not None)
            yield name, "way", _cause(fix, f"{position.of_velocity(found)} against the other sources")
            continue
        for n, r in speed.items():
            if r is not None and r.differs():
                yield n, "way", _cause(streams[n], f"{position.of_velocity(r)}, against the positions of {name}")
        for n, r in other.items():
            if r is not None and r.differs() and streams[n].kind == POSE:
                yield n, "way", _cause(streams[n], f"{position.of_position(r)}, against the positions of {name}")


def _cause(stream: Stream, what: str) -> Cause:
    return Cause(what, float(stream.arrived_s[0]), "see the order, the signs and the unit of its components")
