"""All causes of a stretch, likeliest first."""

import re
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Final

import numpy as np

from logs.findings import clocks, heights, held, inertial, jumps, numbers, position, pull, scatter, turning
from logs.findings.relation import Relation
from logs.findings.streams import ATTITUDE, FIX, IMU, ODOMETRY, POSE, TURNING, VELOCITY, Cause, Finding, Stream, Streams
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
    for name, s in known.items():
        if jump := clocks.together(s, [other for topic, other in known.items() if topic != name]):
            yield "1", Finding(name, jump.what, jump.since_s, jump.advice)
            return  # what is on both sides of it is no motion
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
            clocks.sawtooth(s) or clocks.few_stamps(s) or clocks.two_clocks(s) or held.again(s) or clocks.disorder(s)
            or clocks.batches(s) or clocks.step(s, others) or clocks.rate(s, others) or clocks.shifted(s, others)
        )  # fmt: skip
        if cause:
            yield name, "", cause


def _values(streams: Streams, origin: Vec3 | None) -> Iterator[tuple[str, str, Cause]]:
    imu = next((s for s in streams.values() if s.kind == IMU), None)
    alt_m = next(
        (float(np.median(s.in_order().values[:, 2])) for s in streams.values() if s.kind == FIX and len(s.in_order().t_s)), None
    )
    for name, s in sorted(streams.items(), key=lambda item: item[1].kind != IMU):
        others = [other for topic, other in streams.items() if topic != name]
        found: Cause | None
        if s.kind == IMU:
            found = (
                inertial.slow(s) or inertial.halves(s) or held.copies(s) or held.held(s, None) or inertial.frozen_axis(s)
                or inertial.mixed(s) or inertial.units(s) or inertial.tilted(s) or inertial.spikes(s) or inertial.clipped(s)
                or clocks.silence(s, others) or clocks.lost(s) or numbers.rounded(s) or inertial.off_at_rest(s)
                or scatter.scattered(s)
            )  # fmt: skip
            imu = None if found else imu  # no witness of motion
        else:
            found = held.zero(s) or (held.held(s, imu) or held.copies(s) if s.kind != ATTITUDE else None)
        if s.kind == FIX and not found:
            found = (
                position.far(s, origin) or position.accuracy(s) or numbers.rounded(s) or held.standing(s, imu)
                or scatter.scattered(s) or jumps.jump(s)
            )  # fmt: skip
        if s.kind in TURNING and not found:
            found = numbers.no_quaternions(s) or (held.placeless(s) or jumps.jump(s) if s.kind in (POSE, ODOMETRY) else None)
        if s.kind == _BARO and not found:
            found = position.pressure(s, alt_m) or scatter.scattered(s) or position.pressure_jump(s)
        if s.kind == VELOCITY and not found:
            found = scatter.scattered(s)
        if s.kind == _FIELD and not found:
            found = inertial.frozen_axis(s)
        if found:
            yield name, "", found


def _relations(streams: Streams, guilty: set[str]) -> Iterator[tuple[str, str, Cause]]:
    sound = {name: s for name, s in streams.items() if name not in guilty}
    imu = next(((name, s) for name, s in sound.items() if s.kind == IMU), None)
    yield from chain(_turns(sound, *imu) if imu else (), _ways(sound), _lengths(sound))
    if odd := heights.odd(sound):
        yield odd[0], "way up", odd[1]


def _turns(streams: Streams, name: str, imu: Stream) -> Iterator[tuple[str, str, Cause]]:
    turned = turning.Turned(imu)
    related = {n: turning.attitude_relation(turned, s) for n, s in streams.items() if s.kind in TURNING}
    bad = {n: r for n, r in related.items() if r is not None and r.differs()}
    if len(bad) > 1 and len(bad) == sum(r is not None for r in related.values()) and _alike([r.O for r in bad.values()]):
        theirs = next(iter(bad.values()))  # the other way round: b = s O a, a = O^T b / s
        cause = turning.misturned(theirs._replace(O=theirs.O.T, scale=1.0 / theirs.scale), imu, " and ".join(bad))
        if cause:
            yield (
                name,
                "turn",
                cause._replace(advice="set [imu] axes and mounting_rpy_deg, or mend its driver"),
            )
        return
    for n, found in bad.items():
        if cause := turning.reordered(turned, streams[n], found.rest) or turning.misturned(found, streams[n], name):
            yield n, "turn", cause
    yield from _against(name, imu, {n: s for n, s in streams.items() if n in related and n not in bad}, turned, related)
    for n, s in streams.items():
        if s.kind == _FIELD and (cause := turning.field(turned, s)):
            headings = [n for n, other in streams.items() if other.kind == "attitude"]
            more = f"; leave out the autopilot's heading that rests on it ({', '.join(headings)})" if headings else ""
            yield n, "field", cause._replace(advice=cause.advice + more)


def _against(
    name: str, imu: Stream, poses: Streams, turned: turning.Turned, related: Mapping[str, Relation | None]
) -> Iterator[tuple[str, str, Cause]]:
    """Each source of attitudes against the IMU, which is at fault where two and all of them say the same."""
    found = {n: cause for n, s in poses.items() if (cause := _pose_cause(turned, imu, s, related[n]))}
    kinds = {re.sub(r"[-\d.]+", "", cause.what) for cause in found.values()}
    if len(found) > 1 and len(found) == len(poses) and len(kinds) == 1:
        first = next(iter(found.values())).what
        late = "early" if "late" in first else "late"
        what = f"its stamps are {late}, or those of" if "stamps" in first else "its accelerometer contradicts the motion of"
        advice = "see its scale, offset and mounting" if "stamps" not in first else "stamp samples when they are measured"
        yield name, "pull", Cause(f"{what} {' and '.join(found)}, which agree", float(imu.arrived_s[0]), advice)
        return
    for n, cause in found.items():
        yield n, "pull", cause
    offsets = {n: o for n, s in poses.items() if n not in found and (o := turning.offset(turned, s)) is not None}
    if offsets and len(offsets) == sum(r is not None for r in related.values()):
        x, y, z = next(iter(offsets.values())).tolist()
        what = f"its gyroscope is off by ({x:.2f}, {y:.2f}, {z:.2f}) rad/s against {' and '.join(offsets)}"
        yield name, "offset", Cause(what, float(imu.arrived_s[0]), "calibrate it at rest, or mend its driver")


def _pose_cause(turned: turning.Turned, imu: Stream, s: Stream, found: Relation | None) -> Cause | None:
    cause = None
    if found is None or found.equal > 0.5:
        cause = turning.reordered(turned, s) or (turning.late(turned, s, found.equal) if found else None)
    moves = s.kind in (POSE, ODOMETRY) and bool(np.ptp(s.values[:, :3], axis=0).any())
    return cause or (pull.pulled(imu, s) if moves else None)


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
            if (r is None or r.equal > 0.5) and (cause := position.still_or_forward(fix, streams[n], name)):
                yield n, "way", cause
            elif r is not None and not r.differs() and (cause := position.runs_away(fix, streams[n], n)):
                yield name, "way", cause
            elif r is not None and not r.differs() and (late_s := position.late(fix, streams[n])) is not None:
                yield _late(name, n, streams, late_s)
            elif r is not None and r.differs():
                yield n, "way", _cause(streams[n], f"{position.of_velocity(r)}, against the positions of {name}")
        for n, r in other.items():
            if r is not None and r.differs() and streams[n].kind == POSE:
                yield n, "way", _cause(streams[n], f"{position.of_position(r)}, against the positions of {name}")


def _lengths(streams: Streams) -> Iterator[tuple[str, str, Cause]]:
    known = [(n, s) for kind in (POSE, FIX) for n, s in streams.items() if s.kind == kind]
    for n, s in streams.items():
        if s.kind == ODOMETRY and (found := next((c for k, p in known if (c := position.stretched(s, p, k))), None)):
            yield n, "pull", found


def _late(fix: str, velocity: str, streams: Streams, late_s: float) -> tuple[str, str, Cause]:
    """The later of the two is at fault: stamps of the future are rare."""
    who, other = (fix, velocity) if late_s > 0.0 else (velocity, fix)
    what = f"its stamps are {abs(late_s):.1f} s late against {other}"
    return who, "late", Cause(what, float(streams[who].arrived_s[0]), "stamp with the time of measurement, or set [gnss] delay_s")


def _cause(stream: Stream, what: str) -> Cause:
    return Cause(what, float(stream.arrived_s[0]), "see the order, the signs and the unit of its components")
