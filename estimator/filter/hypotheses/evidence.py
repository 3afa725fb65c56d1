"""Likelihood of a reading for each hypothesis: true, false, or the last false one again.

    again_k = ln (sum w_j N(nu_j; 0, S_j) / sum w_j) - dt / tau_k

j: the hypotheses that fuse it. They predict the next false reading too, so one that rejected the last never gains on
them.
"""

import math

import msgspec

from estimator.filter.eskf import Innovation
from estimator.filter.hypotheses.follower import again_s
from estimator.filter.hypotheses.hypothesis import MARGIN, SENSORS, Hypothesis
from estimator.filter.hypotheses.mixture import ln_sum
from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import lasts_s


class Evidence(msgspec.Struct, frozen=True, eq=False):
    """One reading, by hypothesis: seen; passed: inside the gate; again: ln weight, None after a reading that was not false.

    doubted: largest weight of one that leaves the source out; by_receiver: what a velocity adds on average to the weights of
    those that follow its receiver's positions, -inf without any, or where all do.
    """

    aid: Aid
    seen: list[Innovation]
    passed: list[bool]
    again: list[float | None]
    doubted: float
    by_receiver: float


def weighed(members: list[Hypothesis], aid: Aid, seen: list[Innovation], passed: list[bool], *, vouched: bool) -> Evidence:
    """Evidence of a reading; vouched: another source gave positions lately."""
    if not any(aid.topic in m.doubts or aid.receiver in m.doubts for m in members):  # most of the time
        return Evidence(aid, seen, passed, [None] * len(members), -math.inf, -math.inf)
    again = _again(members, aid, seen, passed, vouched=vouched)
    doubted = max(
        (
            m.weight + by_member
            for m, by_member in zip(members, again, strict=True)
            if by_member is not None and m.doubts[aid.topic].deliberate and not m.has_settled(aid.t_ns)
        ),
        default=-math.inf,
    )
    # A receiver is right or wrong in both: where its positions are doubted, its velocities are no evidence.
    by_receiver = -math.inf
    if aid.receiver and any(aid.receiver in m.doubts and not m.omits(aid) for m in members):
        follow = [j for j, m in enumerate(members) if m.without != SENSORS and aid.receiver not in m.doubts]
        gains = [seen[j].log_likelihood if passed[j] else aid.log_false for j in follow]
        by_receiver = _mean([members[j].weight for j in follow], gains) if follow else -math.inf
    return Evidence(aid, seen, passed, again, doubted, by_receiver)


def _again(
    members: list[Hypothesis], aid: Aid, seen: list[Innovation], passed: list[bool], *, vouched: bool
) -> list[float | None]:
    """ln weight of the last false reading again; unless absolute it founds no hypothesis: who takes it for true predicts too."""
    doubts = [m.doubts.get(aid.topic) for m in members]
    if not any(doubts):  # most of the time
        return [None] * len(doubts)
    lasts, refused_s = lasts_s(aid.kind), again_s(members[0], aid, vouched=vouched)
    fades = [
        -(aid.t_ns - doubt.last_ns) * 1e-9 / (refused_s if aid.absolute and not doubt.deliberate else lasts) if doubt else 0.0
        for doubt in doubts
    ]
    predicts = [p and m.without != SENSORS for p, m in zip(passed, members, strict=True)]
    follow = [j for j, doubt in enumerate(doubts) if predicts[j] and (doubt is None or (aid.absolute and not doubt.deliberate))]
    predicted = by_all = _predicted(members, follow, seen)
    if not aid.absolute:
        follow += [
            j
            for j, doubt in enumerate(doubts)
            if predicts[j] and doubt and not doubt.deliberate and predicted + fades[j] <= seen[j].log_likelihood + MARGIN
        ]
        by_all = _predicted(members, follow, seen)
    again = [(predicted if fits else by_all) + fade for fits, fade in zip(passed, fades, strict=True)]
    return [a if doubt and a > -math.inf else None for a, doubt in zip(again, doubts, strict=True)]


def _predicted(members: list[Hypothesis], by: list[int], seen: list[Innovation]) -> float:
    if not by:
        return -math.inf
    return _mean([members[j].weight for j in by], [seen[j].log_likelihood for j in by])


def _mean(weights: list[float], gains: list[float]) -> float:
    """ln (sum w_j g_j / sum w_j), all as ln."""
    return ln_sum([w + gain for w, gain in zip(weights, gains, strict=True)]) - ln_sum(weights)
