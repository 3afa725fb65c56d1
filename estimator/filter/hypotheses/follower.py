"""Followers: one begins at a fix that no hypothesis predicts, because the filter may be wrong.

It assumes that the IMU was wrong since the last fix, or the estimate elsewhere, and takes every fix that its last one predicts.
Consistent fixes win when they are three more than those of the leading hypothesis (hypothesis.holds_s). Once it leads, the IMU is
taken for right again by a branch that its next fixes confirm.
"""

import math

import numpy as np

from estimator.filter.hypotheses.hypothesis import MARGIN, MORE, RUN_ENDS_S, Hypothesis
from estimator.filter.hypotheses.innovation import innovation
from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import LONG_S, lasts_s
from models import imu
from models.measurements import Measurement
from models.messages import Array
from models.state import E, X

AGAIN_S = 0.4  # a fix that is refused again costs 1 / AGAIN_S a second, ln
_RECEIVER_S = 0.8  # the same of a receiver alone, whose readings share their error: a barometer has its say
_UNSEEN_S, _FORGOTTEN_S = 0.5, 5.0  # a wrong IMU has been so since the last fix, within these limits
_LIKELY = 0.25  # share of the unknown motion within which an IMU that is wrong explains a fix
_SEEN = 3.0  # ln: so far behind the leading one a new follower counts in the covariance
_UNSEEN = 10.0  # ln: by so much less one counts there whose source is refused already
_OTHER_BIASES = np.repeat((0.01, 0.1), 3)  # rad/s, m/s^2: by so much they may differ after a fault of the IMU
_MOVES = 0.75  # share of the velocity that a displacement by the IMU makes expected
_HARDLY = 0.05  # of the largest singular value of H_p: what a fix measures less is no jump


def begin(lead: Hypothesis, aid: Aid, z: Measurement, gyro_b: Array, limit: float, *, vouched: bool) -> Hypothesis | None:
    """A copy of the leading hypothesis that fuses the fix; weight: relative to it.

    IMU wrong: P <- P + Q(dt) of an unknown motion since the last fix; from here on it coasts. Where that does not explain the
    fix: P_pp <- P_pp + o o^T, o the shortest with H_p o = nu, same motion; likewise the attitude, half a turn at most.
    """
    other = lead.copy()
    other.without, other.doubts = "", {}
    other.adopt(lead.filter.constants if lead.right is None else lead.right, doubts_imu=True)
    eskf = other.filter
    eskf.forget_clones()  # a kept pose may be wrong, too
    since_s = min(max((aid.t_ns - lead.fused_ns) * 1e-9, _UNSEEN_S), _FORGOTTEN_S)
    unknown = imu.unknown_motion(eskf.constants, since_s)
    eskf.cov[: E.SIZE, : E.SIZE] += _LIKELY * unknown
    seen = innovation(eskf, aid, z, gyro_b)
    if not math.isfinite(seen.distance2):
        return None
    by_imu = seen.distance2 <= limit
    eskf.cov[: E.SIZE, : E.SIZE] += (1.0 - _LIKELY) * unknown
    if not by_imu:
        for part in (E.P, E.THETA):
            off = np.linalg.pinv(seen.h[:, part], rcond=_HARDLY) @ seen.nu
            if part is E.THETA:
                off *= math.pi / max(float(np.linalg.norm(off)), math.pi)
            eskf.cov[part, part] += np.outer(off, off)
    seen = innovation(eskf, aid, z, gyro_b)
    other.weight = behind(lead, aid, vouched=vouched, by_imu=by_imu)
    is_first = aid.topic not in lead.doubts  # that is refused: it may be the true one
    other.benefit = max(-other.weight - _SEEN, 0.0) if is_first else -_UNSEEN
    eskf.update(seen)
    other.note_jump(lead.filter.x[X.P], aid.t_ns)
    other.fused_ns = other.run_ns = other.parted_ns = aid.t_ns
    other.run = 1
    return other


def behind(lead: Hypothesis, aid: Aid, *, vouched: bool, by_imu: bool) -> float:
    """ln weight of a contradiction's start, relative to the leading hypothesis.

    margin - max(t / AGAIN_S, t' / again_s): t that the leading one holds, t' its confirmed run.
    """
    holds_s = confirmed_s = lead.holds_s(aid.t_ns, imu_may_be_wrong=by_imu)
    pace_s = again_s(lead, aid, vouched=vouched)
    if pace_s > _RECEIVER_S:  # another source confirms it
        confirmed_s = max(holds_s, min((lead.fused_ns - lead.run_ns) * 1e-9, LONG_S))
    return MARGIN - max(holds_s / AGAIN_S, confirmed_s / pace_s)


def again_s(lead: Hypothesis, aid: Aid, *, vouched: bool) -> float:
    """Seconds of refused fixes in which the leading hypothesis loses 1 in ln.

    Most where another source confirms it; more for a receiver, whose errors are correlated, than for fixes.
    """
    own = f"{aid.topic}/"  # velocities of the same receiver
    others = any(topic != aid.topic and not topic.startswith(own) for topic in lead.doubts)
    if vouched and not others:
        return max(lasts_s(aid.kind), AGAIN_S)
    return AGAIN_S if aid.log_misled is None else _RECEIVER_S


def raise_alternative(members: list[Hypothesis], aid: Aid, fused: list[bool], *, vouched: bool) -> None:
    """Give a follower's weight at least to a hypothesis that fuses what the leading one begins to reject."""
    lead = members[0]
    others = [m for m, was_fused in zip(members, fused, strict=True) if was_fused and not m.without]
    if others:
        best = max(others, key=lambda m: m.weight)
        best.weight = max(best.weight, lead.weight + behind(lead, aid, vouched=vouched, by_imu=best.doubts_imu))


def overtake(members: list[Hypothesis], aid: Aid) -> None:
    """Soon after an outage the fourth fix leads where an error of the IMU explains the fixes: it still moves.

    dp = (1 - T / 2 U) T dv

    by a constant false acceleration; dp [m], dv [m/s]: from the leading hypothesis; T [s]: since its last fix; U [s]: since its
    last run that lasted. False fixes of one place do not move.
    """
    lead = members[0]
    since_s, unproven_s = (aid.t_ns - lead.fused_ns) * 1e-9, lead.unproven_s(aid.t_ns)
    for member in members[1:]:
        if member.doubts_imu and member.fused_ns == aid.t_ns and member.run >= MORE and unproven_s > RUN_ENDS_S:
            off, moves = member.filter.x[X.P] - lead.filter.x[X.P], member.filter.x[X.V] - lead.filter.x[X.V]
            if since_s * (1.0 - 0.5 * since_s / unproven_s) * float(moves @ off) >= _MOVES * float(off @ off):
                member.weight = max(member.weight, lead.weight + MARGIN)


def with_imu_right(lead: Hypothesis, t_ns: int) -> Hypothesis:
    """Branch from the newest fix of a leader that takes the IMU for wrong: right again."""
    assert lead.right is not None
    other = lead.copy()
    other.adopt(lead.right, doubts_imu=False)
    other.filter.widen_biases(_OTHER_BIASES)
    other.weight, other.parted_ns = lead.weight - MARGIN, t_ns
    return other
