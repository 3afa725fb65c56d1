"""A pose whose position fits and whose attitude does not: the attitude may be false alone.

    w <- w + ln N(nu_p; 0, S_pp) + a,   a = ln(e u) at first,   max(ln(e u), max_j ln(N(nu_j) / N(nu_jp)) - dt / tau) again

p: its position, where that is known, tr S_pp < 5 tr R_pp, and likelier by a margin than a false fix; e u: false
attitude; j: hypotheses that take the whole. So positions decide between an attitude and the IMU, and a longer run where they do
not.
"""

import math

from msgspec.structs import replace

from estimator.filter.eskf import Innovation
from estimator.filter.hypotheses.follower import AGAIN_S
from estimator.filter.hypotheses.hypothesis import MARGIN, Hypothesis
from estimator.sources.base.aid import FALSE_ATTITUDE_RAD, Aid
from estimator.sources.base.gating import gate
from models.measurements import Measurement, Pose
from models.state import XYZ

_KNOWN = 5.0  # tr S / tr R


def taken(members: list[Hypothesis], aid: Aid, z: Measurement, seen: list[Innovation], whole: list[bool]) -> list[Innovation]:
    """What counts of a reading, by hypothesis; whole: all of it is inside the gate."""
    turns = len(z.rows) - XYZ
    if not (isinstance(z, Pose) and turns > 0 and int(z.rows[XYZ - 1]) == XYZ - 1):
        return seen
    if all(whole) and not any(m.turned for m in members):  # most of the time
        return seen
    parts, counts = [by_member.first(XYZ) for by_member in seen], seen.copy()
    true = max((a.log_likelihood - p.log_likelihood for a, p, w in zip(seen, parts, whole, strict=True) if w), default=-math.inf)
    false = math.log(aid.rules.false_share) - turns * math.log(2.0 * FALSE_ATTITUDE_RAD)
    for k, (member, part) in enumerate(zip(members, parts, strict=True)):
        last_ns = member.turned.get(aid.topic)
        if whole[k]:
            member.turned = {topic: t_ns for topic, t_ns in member.turned.items() if topic != aid.topic}
        elif _confirms(part, aid) and part.log_likelihood + false > aid.log_false + MARGIN:
            again = -math.inf if last_ns is None else true - (aid.t_ns - last_ns) * 1e-9 / AGAIN_S
            counts[k] = replace(part, besides=max(false, again))
            member.turned = {**member.turned, aid.topic: aid.t_ns}
    return counts


def _confirms(part: Innovation, aid: Aid) -> bool:
    """Whether the position was known, and fits; to one that was not known any false fix does."""
    is_known = float(part.s.trace()) < _KNOWN * float(part.noise.trace())
    return is_known and part.distance2 <= gate(aid.rules.gate_probability, XYZ)
