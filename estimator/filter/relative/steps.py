"""Odometry in the hypotheses: each keeps the pose where an increment begins, and fuses it where it ends.

    w_k <- w_k + max(l_k - max_j l_j, -c),   l = ln N(nu; 0, S), or ln of the density of a false one

An increment founds no hypothesis; one that fails the gate is left out. Where no position decides, P <- P + e e^T, e = K nu.
"""

from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from estimator.filter.eskf import Innovation
from estimator.filter.hypotheses import SENSORS, Hypotheses, clone_of, innovation
from estimator.filter.relative import drift
from estimator.sources import odometry
from estimator.sources.base.gating import gate
from estimator.sources.base.learnt_noise import LearntNoise
from estimator.sources.base.machine import Phase, SourceState
from estimator.sources.odometry import Begins, Increment, Kept, Lost, OdometryAid, Posed
from models import so3
from models.messages import Array, Reason
from models.relative_pose import RelativePose
from models.state import XYZ, E

_MOST_SAID = 0.5  # ln: c
_NO_RATE = np.zeros(3)
_OVERLAPS = "overlaps with another increment, or begins where there was no estimate"
_BEGINS, _JUMPED = "the first of its frame", "the pose has jumped by {:.2f} m: begun anew"
_SAYS_LOST = "its tracking is lost"
_BREAK, _LOST = "no pose for {:.1f} s: begun anew", "the estimate has jumped since it began"
_DISPUTED = "has contradicted the estimate: taken to be wrong by {:.2g} m/s"


class Step(NamedTuple):
    """What became of it: seen and gate where it was compared with the leading filter."""

    reason: Reason
    detail: str
    kept: Kept | None
    state: SourceState
    seen: Innovation | None = None
    gate: float = 0.0


def take(bank: Hypotheses, aid: OdometryAid, kept: Kept | None, state: SourceState, *, alone: bool) -> Step:
    """One place of an odometry in the order; kept: of its topic; alone: no position confirms the filters."""
    motion = aid.motion
    if isinstance(motion, Begins):
        if kept is None or kept.until_ns <= aid.t_ns:
            kept = _keep(bank, aid, kept, Kept(aid.t_ns, motion.until_ns, motion.name, motion.epoch))
        return Step(Reason.THINNED, "", kept, state)
    if isinstance(motion, Lost):
        kept = kept or Kept(aid.t_ns, motion.until_ns, b"", "")
        return Step(Reason.NO_FIX, _SAYS_LOST, kept._replace(until_ns=motion.until_ns, pose=None), state)
    if isinstance(motion, Increment):
        if kept is None or kept.name != motion.name:
            return Step(Reason.THINNED, _OVERLAPS, kept, state)
        return _judge(bank, aid, motion, kept, state, alone=alone)
    return _pose(bank, aid, motion, kept, state, alone=alone)


def _pose(bank: Hypotheses, aid: OdometryAid, at: Posed, kept: Kept | None, state: SourceState, *, alone: bool) -> Step:
    begun = Kept(aid.t_ns, aid.t_ns, b"", at.epoch, at.pose, (aid.t_ns, at.pose, None))
    if kept is not None and kept.pose is None and aid.t_ns <= kept.until_ns:
        return Step(Reason.NO_FIX, _SAYS_LOST, kept, state)
    if kept is None or kept.pose is None or kept.epoch != at.epoch:
        return Step(Reason.THINNED, _BEGINS, _keep(bank, aid, kept, begun), state)
    off, velocity = odometry.jumped(kept, aid.t_ns, at.pose)
    seconds = (aid.t_ns - kept.t_ns) * 1e-9
    if off:
        return Step(Reason.IMPLAUSIBLE, _JUMPED.format(off), _keep(bank, aid, kept, begun), state)
    begun = begun._replace(newest=(aid.t_ns, at.pose, velocity))
    if seconds > at.config.longest_s:
        return Step(Reason.THINNED, _BREAK.format(seconds), _keep(bank, aid, kept, begun), state)
    if seconds < at.config.interval_s:
        return Step(Reason.THINNED, "", kept if velocity is None else kept._replace(newest=begun.newest), state)
    z, errors = at.since(kept.pose)
    step = _judge(bank, replace(aid, slow_errors=errors), Increment(b"", z), kept, state, alone=alone)
    return step._replace(kept=_keep(bank, aid, kept, begun))


def _keep(bank: Hypotheses, aid: OdometryAid, before: Kept | None, now: Kept) -> Kept:
    """Every filter keeps its pose; errors constant within an epoch are unknown in the next."""
    stale = odometry.slow_blocks(aid.topic) if before is not None and before.epoch != now.epoch else ()
    for member in bank.members:
        for block in stale:
            if block in member.filter.slow.columns:
                member.filter.forget(block)
        if member.without != SENSORS:
            member.filter.keep_pose(clone_of(aid.topic))
    return now


def _judge(bank: Hypotheses, aid: OdometryAid, end: Increment, kept: Kept, state: SourceState, *, alone: bool) -> Step:
    z, block, velocity = end.z, clone_of(aid.topic), odometry.drift_block(aid.topic)
    if block not in bank.lead.clones:
        return Step(Reason.THINNED, _LOST, kept._replace(name=b""), state)
    if odometry.may_be_scale(state, alone=alone) and _open_scale(bank, aid.topic):
        state = replace(state, phase=Phase.ACTIVE, passed=0, is_refuted=False, noise=LearntNoise(is_renewed=True))
    state = odometry.arrived(state, aid.rules, aid.t_ns, alone=alone)
    if end.reported is not None:
        aid, z, spread_m = odometry.widened(aid, z, end.reported, state.spread_m)
        state = replace(state, spread_m=spread_m)
    seconds = (aid.t_ns - kept.t_ns) * 1e-9
    aid, z = odometry.as_learnt(aid, z, state.noise.roots)
    aid = odometry.drifting(aid, bank.lead.clones[block], seconds)
    if not alone:
        for member in bank.members:
            drift.fade(member.filter, velocity, seconds)
    seen = [innovation(m.filter, aid, z, _NO_RATE) if block in m.filter.clones else None for m in bank.members]
    first = seen[0]
    assert first is not None
    limit, widest = gate(aid.rules.gate_probability, len(z.rows)), odometry.widest(state, aid.rules)
    passed = [s is not None and s.distance2 <= limit and bool(_off(s).max() <= widest) for s in seen]
    state, is_found = odometry.judged(state, alone=alone, passed=passed[0], off=_level(first, z, bank.lead.clones[block]))
    is_active, is_found = state.phase is Phase.ACTIVE and state.noise.is_noise, is_found and state.noise.is_noise
    noise = state.noise
    if not (alone and odometry.is_disputed(state)):
        noise = noise.also(first.nu, first.s, first.noise, z.rows, seconds)
    if is_found:
        _found(bank, aid, z, seen, alone=alone)
    elif is_active:
        _fuse(bank, aid, z, seen, passed)
        if passed[0]:
            noise = noise.fused(first.hp[:, E.V], first.s, seconds)
            bank.sensed |= {aid.topic}
            for member in bank.members:
                if member.without != SENSORS:
                    drift.hide(member.filter, velocity, noise.hidden_m_s)
    state = replace(state, noise=noise)
    sigma_m_s = drift.sigma_m_s(bank.lead, velocity)
    for member in bank.members:
        if block in member.filter.clones:
            member.filter.forget(block)
    fused = is_active and passed[0] and not is_found
    reason = Reason.FUSED if fused else Reason.PROBATION if passed[0] and not is_active else Reason.GATED
    said = _DISPUTED.format(sigma_m_s) if sigma_m_s > drift.WORTH_SAYING_M_S else ""
    said = said if state.noise.is_noise else odometry.WRONG
    return Step(reason, said, kept._replace(name=b""), state if not fused else replace(state, fused_ns=aid.t_ns), first, limit)


def _open_scale(bank: Hypotheses, topic: str) -> bool:
    """P_ss <- P_ss + 0.3^2 in every filter; whether the leading one has a scale."""
    block = odometry.scale_block(topic)
    for member in bank.members:
        if block in member.filter.slow.columns:
            at = member.filter.slow.columns[block]
            member.filter.cov[at, at] += odometry.WRONG_SCALE**2 / member.filter.variance_factor
    return block in bank.lead.slow.columns


def _off(seen: Innovation) -> Array:
    return np.abs(seen.nu) / np.sqrt(seen.s.diagonal())


def _level(seen: Innovation, z: RelativePose, origin: Array) -> Array:
    """nu_i / sigma_i of a translation, in n where all of it is given: there a drift lasts. Else of the rotation."""
    rows = z.rows < XYZ
    if rows.sum() < XYZ:
        rows = rows if rows.any() else ~rows
        return seen.nu[rows] / np.sqrt(seen.s.diagonal()[rows])
    R = so3.matrix(origin[XYZ:])
    level: Array = R @ seen.nu[rows] / np.sqrt((R @ seen.s[np.ix_(rows, rows)] @ R.T).diagonal())
    return level


def _found(bank: Hypotheses, aid: OdometryAid, z: RelativePose, seen: list[Innovation | None], *, alone: bool) -> None:
    """Increments contradict the estimate: widen the drift and, alone, cover both; nothing is fused."""
    for member, s in zip(bank.members, seen, strict=True):
        if s is not None:
            drift.suspect(member.filter, s, aid, z, 1.0)
            if alone:
                member.filter.cover(s)


def _fuse(bank: Hypotheses, aid: OdometryAid, z: RelativePose, seen: list[Innovation | None], passed: list[bool]) -> None:
    for k, (member, s) in enumerate(zip(bank.members, seen, strict=True)):
        if s is not None and passed[k] and drift.suspect(member.filter, s, aid, z, aid.rules.false_share):
            seen[k] = innovation(member.filter, aid, z, _NO_RATE)
    said = [None if s is None else s.log_likelihood if p else aid.log_false for s, p in zip(seen, passed, strict=True)]
    best = max(t for t in said if t is not None)
    for member, s, was_passed in zip(bank.members, seen, passed, strict=True):
        if s is not None and was_passed:
            member.filter.update(s)
        if was_passed != passed[0]:
            member.parted_ns = aid.t_ns
    gained = [0.0 if t is None else max(t - best, -_MOST_SAID) for t in said]
    bank.weigh(aid.t_ns, [gained[0] if m.without == SENSORS else g for m, g in zip(bank.members, gained, strict=True)])
