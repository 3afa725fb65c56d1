"""A pose whose position fits and whose attitude does not: the attitude may be false alone.

    w <- w + ln N(nu_p; 0, S_pp) + a,   a = ln(e u) at first,   max(ln(e u), max_j ln(N(nu_j) / N(nu_jp)) - dt / tau) again

p: its position, where that is likelier by a margin than a fix that is false altogether; e u: false attitude; j: hypotheses that
take the whole. So what decides between an attitude and the IMU are positions, and a longer run where these do not.
"""

import math
from typing import NamedTuple

from estimator.filter.eskf import Innovation
from estimator.filter.hypotheses.follower import AGAIN_S
from estimator.filter.hypotheses.hypothesis import MARGIN, Hypothesis
from estimator.sources.base.aid import FALSE_ATTITUDE_RAD, Aid
from estimator.sources.base.gating import gate
from models.measurements import Measurement, Pose

_XYZ = 3


class Judged(NamedTuple):
    """By hypothesis: what of a reading counts, whether that is inside the gate, and whether all of the reading is."""

    seen: list[Innovation]
    passed: list[bool]
    whole: list[bool]


def judged(members: list[Hypothesis], aid: Aid, z: Measurement, seen: list[Innovation], limit: float, *, proven: bool) -> Judged:
    """The reading, or its position alone where its attitude is taken for false."""
    whole = [by_member.distance2 <= limit for by_member in seen]
    turns = len(z.rows) - _XYZ
    if not (proven and aid.absolute and isinstance(z, Pose) and turns > 0 and int(z.rows[_XYZ - 1]) == _XYZ - 1):
        return Judged(seen, whole, whole)
    if all(whole) and not any(m.turned for m in members):  # most of the time
        return Judged(seen, whole, whole)
    parts, counts, passed = [by_member.first(_XYZ) for by_member in seen], seen.copy(), whole.copy()
    true = max((a.log_likelihood - p.log_likelihood for a, p, w in zip(seen, parts, whole, strict=True) if w), default=-math.inf)
    false = math.log(aid.rules.false_share) - turns * math.log(2.0 * FALSE_ATTITUDE_RAD)
    for k, (member, part) in enumerate(zip(members, parts, strict=True)):
        if whole[k]:
            member.turned = {}
        elif part.distance2 <= gate(aid.rules.gate_probability, _XYZ) and part.log_likelihood + false > aid.log_false + MARGIN:
            last_ns = member.turned.get(aid.topic)
            again = -math.inf if last_ns is None else true - (aid.t_ns - last_ns) * 1e-9 / AGAIN_S
            counts[k], passed[k] = part._replace(besides=max(false, again)), True
            member.turned = {**member.turned, aid.topic: aid.t_ns}
    return Judged(counts, passed, whole)
