"""Hypotheses without a receiver, which may be misled for minutes, or without all sensors and odometry (docs/decision.md).

Replaced by a copy of the leading hypothesis at each fix that this one predicts better; one begins at a fix that no hypothesis
takes, and is dropped where the next does not follow (wrong unit). An omitted receiver returns once its positions agree, its
velocities not before. The one without sensors stays apart from the leading one, whose biases they move.
(Solution separation: Blanch et al. 2015, sec. IV.)
"""

import math

import numpy as np

from estimator.filter.eskf import Innovation
from estimator.filter.hypotheses.hypothesis import RUN_ENDS_S, SENSORS, Doubt, Hypothesis
from estimator.filter.hypotheses.innovation import innovation
from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import LONG_S, RECENT_S
from estimator.sources.base.gating import gate
from models.measurements import Measurement
from models.messages import Array
from models.state import E

_PULL_M_S = 2.0  # by which a misled receiver may have moved the velocity
_SENSOR_WRONG = math.log(0.01)  # one of the sensors is wrong


def add(members: list[Hypothesis], aid: Aid) -> bool:
    """Whether a hypothesis without this fix' receiver is added."""
    lead = members[0]
    if aid.log_misled is None or lead.doubts or any(m.without == aid.topic for m in members):
        return False
    members.append(_without(lead, aid.topic, aid.log_misled, aid.t_ns))
    members[-1].begun_at_fix = False
    return True


def add_at_fix(members: list[Hypothesis], at_fix: Hypothesis, aid: Aid) -> None:
    """Add one without the receiver, perhaps misled from the start, at a fix that none takes."""
    receiver = members[0].receiver
    if receiver is None or aid.log_misled is not None or any(m.without == receiver[0] for m in members):
        return
    if (aid.t_ns - members[0].refuted_ns) * 1e-9 > LONG_S:
        members.append(_without(at_fix, *receiver, aid.t_ns))
        members[-1].weight += members[0].weight
        members[-1].benefit = members[0].weight - members[-1].weight  # until the next fix both count alike


def add_unaided(members: list[Hypothesis], aid: Aid) -> bool:
    """Whether one without sensors is added, at a fix that the leading one fuses."""
    if not aid.absolute or members[0].without or any(m.without == SENSORS for m in members):
        return False
    other = members[0].copy()
    other.filter.forget_clones()
    other.weight = other.least = _SENSOR_WRONG
    other.without, other.parted_ns = SENSORS, aid.t_ns
    members.append(other)
    return True


def unaided(member: Hypothesis, aid: Aid, before: float, gained: float, by_lead: Innovation, seen: Innovation) -> float:
    """ln weight of the one without sensors, relative to the leading one, after a reading.

        w <- w + min(ln N(nu; 0, S) - ln N(nu_0; 0, S_0), d) + (f - 1) d,     d = (nu_0^T S_0^-1 nu_0 - nu^T S^-1 nu) / 2

    before: w; gained: the difference of ln N; nu_0, S_0: by_lead. d: the smaller S that a lasting error leaves is no evidence.
    f: variance factor, counted where this one fits without it. A receiver is one witness against the sensors: it raises no
    weight above 0.
    """
    if not member.is_established(aid.t_ns):
        return member.least
    nearer, f = 0.5 * (by_lead.distance2 - seen.distance2), member.filter.variance_factor
    gained = min(gained, nearer)
    if aid.geodetic or aid.receiver:
        gained = min(gained, max(-before, 0.0))
    elif f * seen.distance2 <= gate(aid.rules.gate_probability, len(seen.nu)):
        gained += (f - 1.0) * nearer
    return before + min(gained, -math.log(aid.rules.false_share))


def moved(lead: Hypothesis, aid: Aid, z: Measurement, gyro_b: Array, seen: Innovation) -> Hypothesis:
    """The leading hypothesis at the fix, with its own motion but for a pull: P_pp += |nu|^2 I, P_vv += sigma^2 I.

    Fixes in a wrong unit then do not predict one another. seen: the fix from the leading one.
    """
    other = lead.copy()
    cov = other.filter.cov
    cov[E.P, E.P] += float(seen.nu @ seen.nu) * np.eye(3)
    cov[E.V, E.V] += _PULL_M_S**2 * np.eye(3)
    other.doubts.pop(aid.topic, None)
    other.filter.update(innovation(other.filter, aid, z, gyro_b))
    other.fused_ns, other.run, other.run_ns = aid.t_ns, 1, aid.t_ns
    other.begun_at_fix = True
    return other


def _without(hypothesis: Hypothesis, topic: str, log_misled: float, t_ns: int) -> Hypothesis:
    other = hypothesis.copy()
    other.weight = other.least = log_misled
    other.without, other.parted_ns = topic, t_ns
    other.doubts[topic] = Doubt(t_ns, deliberate=True)
    return other


def is_confirmed(lead: Hypothesis, aid: Aid) -> bool:
    """The leading hypothesis leaves this receiver out, and fixes confirm it."""
    aided = (aid.t_ns - lead.fused_ns) * 1e-9 <= RECENT_S
    return lead.without == aid.witness and aided and not lead.rejected - {lead.without}


def end(lead: Hypothesis, aid: Aid, *, passed: bool) -> None:
    """Use the receiver again once its positions pass the leading hypothesis' gate without a break.

    The first suffices where nothing else confirms it.
    """
    if not aid.absolute or lead.without != aid.topic:
        return
    lead.agreed_ns = (aid.t_ns if lead.agreed_ns is None else lead.agreed_ns) if passed else None
    if lead.agreed_ns is None:
        return
    if not is_confirmed(lead, aid) or (aid.t_ns - lead.agreed_ns) * 1e-9 >= RECENT_S:
        lead.without, lead.agreed_ns = "", None
        lead.doubts.pop(aid.topic, None)


def has_jumped(members: list[Hypothesis], aid: Aid) -> bool:
    """Whether a fix that all refuse contradicts the last ones of its source, without a break: that is no fault of a receiver."""
    for member in members:
        if member.without and member.without not in {aid.witness, SENSORS}:
            doubt = member.doubts.get(aid.topic)
            last_ns = max(member.fused_ns, doubt.last_ns) if doubt else member.fused_ns
            return (aid.t_ns - last_ns) * 1e-9 < RUN_ENDS_S
    return False


def begin_again(
    members: list[Hypothesis], aid: Aid, fused: list[bool], at_fix: Hypothesis | None, seen: list[Innovation]
) -> None:
    """After another source's fix, begin again as the leading hypothesis where that predicted it better, or this one refused it.

    Where all refused it, begin at the fix. fused, seen: by member; at_fix: of moved().
    """
    if not aid.absolute or len(members) == 1:  # most of the time
        return
    right = members[0] if fused[0] else at_fix
    for member, was_fused, by_member in [*zip(members, fused, seen, strict=True)][1:]:
        if not member.without or member.without == aid.witness:
            continue
        if was_fused and not (member.without != SENSORS and fused[0] and seen[0].log_likelihood >= by_member.log_likelihood):
            member.begun_at_fix = False
        elif member.begun_at_fix and not was_fused:  # fixes that do not follow from one another are no evidence
            members[0].refuted_ns = aid.t_ns
            members.remove(member)
        elif right is not None and (fused[0] or member.without != SENSORS):
            member.filter, member.right = right.filter.copy(), right.right
            if member.without == SENSORS:
                member.filter.forget_clones()
            member.fused_ns, member.begun_at_fix = aid.t_ns, not fused[0]
            if member.begun_at_fix:
                member.benefit = members[0].weight - member.weight  # until the next fix both count alike
            member.doubts.pop(aid.topic, None)
