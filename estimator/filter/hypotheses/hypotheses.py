"""Filters side by side, each with its own answer which measurements are true (docs/decision.md).

* a fix is fused although a false reading explains it nearly as well: one goes on without it and all that agrees with it;
* a fix fails the gate, and no hypothesis that fused the last one predicts it: a *follower* goes on with it;
* a receiver may be misled for long: one goes on *without* it (left_out.py).

    true:          w <- w + ln N(nu; 0, S)                      false:  w <- w + ln(e u)
    false again, and in agreement with the last false one:      w <- w - dt / tau + ln (sum w_j N(nu; 0, S_j) / sum w_j)

j: hypotheses that take the source for true; e, u: share and uniform density of false readings; tau: duration of a repeated fault.
The leading hypothesis is the estimate; another takes over by a margin. In the covariance, not in the decision, one without a
measurement begins with weight e at least and loses 2 dt / tau. Readings of a receiver are no evidence about the hypothesis
without it; a fix raises that one by ln 1/e at most, and its weight stays above ln(1 - trust). A fix that a hypothesis takes and
the leading one refuses is a conflict: both count alike in the covariance until decided. (Blackman and Popoli 1999, ch. 16.)
"""

import math
from collections.abc import Callable

import msgspec
import numpy as np

from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.hypotheses import attitude, follower, left_out
from estimator.filter.hypotheses.evidence import Evidence, weighed
from estimator.filter.hypotheses.follower import AGAIN_S
from estimator.filter.hypotheses.hypothesis import FORGET, MARGIN, RUN_ENDS_S, SENSORS, Doubt, Hypothesis
from estimator.filter.hypotheses.innovation import innovation
from estimator.filter.hypotheses.mixture import covariance
from estimator.sources.base.aid import Aid
from estimator.sources.base.faults import LONG_S, lasts_s
from estimator.sources.base.gating import gate
from models.measurements import Measurement
from models.messages import Array
from models.state import X

_MOST = 4  # hypotheses at a time, those without a receiver not counted
_LEAST_DOUBT = 1.0  # ln: one without the measurement starts at least this far behind
_TINY = 1e-9


class Verdict(msgspec.Struct, frozen=True, eq=False):
    """The leader's answer; used: what of the reading counts; wrong: sensors that the leader does without."""

    seen: Innovation
    used: Innovation
    gate: float
    passed: bool
    fused: bool
    wrong: frozenset[str] = frozenset()


class Hypotheses:
    """The filters in question; the first is the estimate.

    switches: changes of the leading one; conflict_ns: start of a conflict of sources; disputed: sources it rejects; sensed:
    sensors fused since one goes on without them.
    """

    __slots__ = ("conflict_ns", "disputed", "members", "sensed", "switches")

    def __init__(
        self,
        members: list[Hypothesis],
        switches: int = 0,
        conflict_ns: int | None = None,
        disputed: frozenset[str] = frozenset(),
        sensed: frozenset[str] = frozenset(),
    ) -> None:
        self.members, self.switches = members, switches
        self.conflict_ns, self.disputed, self.sensed = conflict_ns, disputed, sensed

    def copy(self) -> "Hypotheses":
        """Independent hypotheses in the same state."""
        return Hypotheses([h.copy() for h in self.members], self.switches, self.conflict_ns, self.disputed, self.sensed)

    @property
    def lead(self) -> Eskf:
        """The estimate's filter."""
        return self.members[0].filter

    def covariance(self) -> Array:
        """Of the leading state's error, (15, 15), over all likely hypotheses."""
        return covariance(self.members)

    @property
    def conflict(self) -> tuple[frozenset[str], float] | None:
        """Topics that only the leading hypothesis rejects, and their distance [m]."""
        lead = self.members[0]
        for member in self.members[1:]:
            if member.benefit > 0.0 and (topics := lead.rejected - member.doubts.keys()):
                off = member.filter.x[X.P] - lead.filter.x[X.P]
                return frozenset(topics), float(np.linalg.norm(off))
        return None

    @property
    def weights(self) -> dict[str, float]:
        """ln weight in the covariance of the likeliest hypothesis for each assumption."""
        found: dict[str, float] = {}
        for member in self.members[1:]:
            found[member.assumes] = max(found.get(member.assumes, -math.inf), member.weight + member.benefit)
        return found

    def scale(self, variance_factor: float) -> None:
        """The errors of every filter are larger than it says."""
        for member in self.members:
            member.filter.variance_factor = variance_factor

    def expire(self, t_ns: int) -> None:
        """Without positions the one without sensors shows nothing."""
        for member in self.members[1:]:
            if member.without == SENSORS and (t_ns - member.fused_ns) * 1e-9 > RUN_ENDS_S:
                self.members.remove(member)

    def forget(self, block: str) -> None:
        """No filter takes the slow error `block` into account any more."""
        for member in self.members:
            if block in member.filter.slow.columns:
                member.filter.forget(block)

    def judge(
        self, aid: Aid, z: Measurement, gyro_b: Array, *, trusted: bool, vouched: bool = False, proven: bool = False
    ) -> Verdict:
        """Let every hypothesis judge a measurement.

        trusted: the source's machine permits fusion; vouched: another source gave positions lately; proven: the filter has been
        right for a while.
        """
        limit = gate(aid.rules.gate_probability, len(z.rows))
        for member in self.members:
            if member.doubts_imu:  # nothing shows its attitude until the IMU is right again
                member.filter.limit_attitude()
        as_it_came = innovation(self.members[0].filter, aid, z, gyro_b)
        seen = [as_it_came, *[self._seen(m, aid, z, gyro_b, as_it_came) for m in self.members[1:]]]
        if not trusted:
            return Verdict(as_it_came, as_it_came, limit, as_it_came.distance2 <= limit, fused=False)
        whole = [s.distance2 <= limit for s in seen]
        if proven and aid.absolute:
            seen = attitude.taken(self.members, aid, z, seen, whole)
        passed = [fits or s.besides != 0.0 for s, fits in zip(seen, whole, strict=True)]
        if passed[0] and aid.is_sensor:
            self.sensed |= {aid.topic}
        if not aid.weighs:
            for member, by_member, fits in zip(self.members, seen, passed, strict=True):
                if fits and member.without != SENSORS:
                    member.filter.update(by_member)
            return Verdict(as_it_came, as_it_came, limit, passed[0], passed[0])
        left_out.end(self.members[0], aid, passed=passed[0])
        if vouched and passed[0] and left_out.add(self.members, aid):
            seen.append(seen[0])
            passed.append(True)
            whole = [*whole, whole[0]]
        set_aside = left_out.is_confirmed(self.members[0], aid)
        newborn = None
        if aid.absolute and not set_aside and not self._is_predicted(aid, whole):
            newborn = follower.begin(self.members[0], aid, z, gyro_b, limit, vouched=vouched)
        anew = aid.absolute and not set_aside and not passed[0] and aid.topic not in self.members[0].doubts
        may_be_misled = newborn is not None and not passed[0] and not left_out.has_jumped(self.members, aid)
        evidence = weighed(self.members, aid, seen, passed, vouched=vouched)
        born: list[Hypothesis] = []
        fused = self._answers(evidence, born)
        if aid.absolute and not fused[0]:
            follower.overtake(self.members, aid)
        if anew:
            follower.raise_alternative(self.members, aid, fused, vouched=vouched)
        at_fix = left_out.moved(self.members[0], aid, z, gyro_b, seen[0]) if may_be_misled and self.members[0].receiver else None
        left_out.begin_again(self.members, aid, fused, at_fix, seen)
        if newborn:
            newborn.weight += self.members[0].weight
            born.append(newborn)
        self.members += born
        if at_fix:
            left_out.add_at_fix(self.members, at_fix, aid)
        if aid.absolute and fused[0] and self.members[0].doubts_imu:
            self.members.append(follower.with_imu_right(self.members[0], aid.t_ns))
        if self.sensed and fused[0] and left_out.add_unaided(self.members, aid):
            self.sensed = frozenset()
        self._rank(aid.t_ns, newborn)
        wrong = frozenset[str]()
        if self.members[0].without == SENSORS:
            self.members[0].without, wrong, self.sensed = "", self.sensed, wrong
        limit = gate(aid.rules.gate_probability, len(seen[0].nu))
        return Verdict(as_it_came, seen[0], limit, passed[0], fused[0], wrong)

    def _seen(self, member: Hypothesis, aid: Aid, z: Measurement, gyro_b: Array, by_lead: Innovation) -> Innovation:
        """The leading one's where it is not asked: it leaves the receiver out, of whose readings none was false."""
        if member.without == aid.witness and (aid.absolute or not any(aid.topic in m.doubts for m in self.members)):
            return by_lead
        return innovation(member.filter, aid, z, gyro_b)

    def _is_predicted(self, aid: Aid, passed: list[bool]) -> bool:
        return passed[0] or any(p and aid.topic not in m.doubts for p, m in zip(passed, self.members, strict=True))

    def _answers(self, e: Evidence, born: list[Hypothesis]) -> list[bool]:
        """Answers of all hypotheses, and which fuse; one without the source gains what the leading one gains.

        born: receives those without the measurement.
        """
        aid, fused = e.aid, [False] * len(e.seen)
        if len(fused) == 1 and not self.members[0].omits(aid):  # most of the time
            return [self._answer(0, e, born, lead_refuses=False)]

        def answer(k: int) -> float:
            member, before = self.members[k], self.members[k].weight
            fused[k] = self._answer(k, e, born, lead_refuses=k > 0 and not fused[0])
            return member.weight - before

        asked = [k for k, m in enumerate(self.members) if not m.omits(aid)]
        following = [0] if 0 in asked else [k for k in asked if aid.witness not in self.members[k].doubts]
        gained = {k: answer(k) for k in asked}
        by_others = max([gained[k] for k in following], default=None)
        for k, member in enumerate(self.members):
            if k in gained:
                self._limit(k, e, gained, fused)
                doubt = member.doubts.get(aid.topic)
                if k and 0 in gained and not fused[0] and not fused[k] and doubt and doubt.deliberate:
                    member.weight += min(0.0, gained[0] - gained[k])  # false to both: no evidence between them
            elif by_others is not None:
                member.weight += by_others
        for member, was_fused in zip(self.members, fused, strict=True):
            doubt = member.doubts.get(aid.topic)
            if was_fused != fused[0] and not (doubt and doubt.deliberate):
                member.parted_ns = aid.t_ns
        return fused

    def _limit(self, k: int, e: Evidence, gained: dict[int, float], fused: list[bool]) -> None:
        aid, lead, member = e.aid, self.members[0], self.members[k]
        if k == 0 or not member.without:
            return
        by_lead = gained.get(0, 0.0)
        if member.without == SENSORS:
            before = member.weight - gained[k] - (lead.weight - by_lead)
            weight = left_out.unaided(member, aid, before, gained[k] - by_lead, e.seen[0], e.seen[k])
            member.weight = lead.weight + weight
            shows = member.weight > lead.weight + member.least + _LEAST_DOUBT
            member.benefit = _TINY if shows else 0.0  # it counts by its weight
        elif aid.absolute:
            member.weight += min(0.0, by_lead - math.log(aid.rules.false_share) - gained[k])
            member.benefit = float(not fused[0] and (fused[k] or bool(member.benefit)) and not self._is_decided(aid))
        elif aid.is_sensor:
            before = member.weight - gained[k] - (lead.weight - by_lead)
            member.weight = min(member.weight, lead.weight + max(before, 0.0))  # two witnesses: either may be wrong

    def leave(self, topic: str) -> None:
        """The receiver is found wrong: the hypothesis without it leads, if any."""
        for member in self.members[1:]:
            if member.without == topic and not member.begun_at_fix and not member.rejected - {topic}:
                self.members.remove(member)
                self.members[0].weight = -MARGIN
                member.weight = member.benefit = 0.0
                self.members.insert(0, member)
                self.switches += 1
                return

    def lead_from(self, aid: Aid, z: Measurement, gyro_b: Array) -> None:
        """More sources contradict the estimate than support it: one that begins at their reading leads alone."""
        lead, limit = self.members[0], gate(aid.rules.gate_probability, len(z.rows))
        if (newborn := follower.begin(lead, aid, z, gyro_b, limit, vouched=True)) is not None and newborn.right is not None:
            newborn.adopt(newborn.right, doubts_imu=False)
            newborn.weight, newborn.benefit, newborn.past = 0.0, 0.0, None
            self.members, self.switches = [newborn], self.switches + 1

    def weigh(self, t_ns: int, gained: list[float]) -> None:
        """w_k <- w_k + gained_k (ln); the heaviest leads."""
        for member, more in zip(self.members, gained, strict=True):
            member.weight += more
        self._rank(t_ns)

    def drop(self, is_impossible: Callable[[Hypothesis], bool]) -> None:
        """Drop impossible states, but never the last hypothesis; the heaviest left leads."""
        if len(self.members) == 1:  # most of the time
            return
        possible = [m for m in self.members if not is_impossible(m)]
        if not possible or len(possible) == len(self.members):
            return
        if possible[0] is not self.members[0]:
            possible.sort(key=lambda m: -m.weight)
            self.switches += 1
        top = possible[0].weight
        for member in possible:
            member.weight -= top
        self.members = possible

    def _answer(self, k: int, e: Evidence, born: list[Hypothesis], *, lead_refuses: bool) -> bool:
        """Hypothesis k takes the measurement for true (and fuses it), false, or the last false one again.

        born: receives one without it; lead_refuses: the leading one took it for false.
        """
        aid, seen, passed, again = e.aid, e.seen[k], e.passed[k], e.again[k]
        member, doubt = self.members[k], self.members[k].doubts.get(aid.topic)
        true = seen.log_likelihood
        if (k > 0 or not passed) and aid.receiver in member.doubts and e.by_receiver > -math.inf:
            member.weight += e.by_receiver
            return False
        foretold = not aid.absolute and again is not None and again > true + MARGIN
        if doubt and again is not None and (doubt.deliberate or not passed or foretold):
            member.weight += again
            member.benefit = max(member.benefit - (aid.t_ns - doubt.last_ns) * 1e-9 / lasts_s(aid.kind), 0.0)
            doubt.last_ns = aid.t_ns
            return False
        if passed:
            margin = max(true - aid.log_false, _LEAST_DOUBT)
            if aid.absolute and member.without != SENSORS and margin < FORGET and member.weight + true - margin > e.doubted:
                doubter = member.copy()
                doubter.weight += true - margin
                doubter.benefit = max(margin + math.log(aid.rules.false_share), 0.0) if aid.resembles else 0.0
                doubter.parted_ns, doubter.without = aid.t_ns, ""
                doubter.doubts[aid.topic] = Doubt(aid.t_ns, deliberate=True)
                born.append(doubter)
            member.weight += true
            before_n = member.filter.x[X.P].copy()
            member.filter.update(seen)
            if doubt:
                del member.doubts[aid.topic]
                if aid.absolute:
                    member.benefit = 0.0
                    member.note_jump(before_n, aid.t_ns)
            if aid.absolute:
                member.note_fused(aid.t_ns)
                if aid.log_misled is not None:
                    member.receiver = aid.topic, aid.log_misled
                behind = self.members[0].weight - member.weight
                member.decided -= {aid.topic}
                if lead_refuses and behind < FORGET and not self._is_decided(aid):
                    member.benefit = max(member.benefit, behind)  # until it is decided, the covariance covers both
            return True
        member.weight += aid.log_false
        if k and member.doubts_imu and aid.absolute:  # its fixes do not agree among themselves
            member.weight -= (aid.t_ns - member.fused_ns) * 1e-9 / AGAIN_S
        member.doubts[aid.topic] = Doubt(aid.t_ns, deliberate=False)
        return False

    def _rank(self, t_ns: int, newborn: Hypothesis | None = None) -> None:
        """Let the heaviest lead by a margin; drop those far behind or no longer different.

        Of too many, a new follower replaces the least likely: all others rejected the fix.
        """
        if len(self.members) == 1:  # most of the time
            self.members[0].weight = 0.0
            if self.conflict_ns is not None:
                self._note_conflict(t_ns)
            return
        lead, *others = self.members
        best = max(others, key=lambda m: m.weight, default=lead)
        if best.weight > lead.weight + MARGIN:
            others = [lead, *(m for m in others if m is not best)]
            best.decided, self.disputed = frozenset(best.rejected - lead.doubts.keys()), frozenset()
            lead = best
            lead.benefit = 0.0
            self.switches += 1
        kept = [m for m in others if m.omits_more_than(lead) and (t_ns - m.fused_ns) * 1e-9 < LONG_S]
        others = [m for m in others if not m.omits_more_than(lead) and m.matters_beside(lead) and not m.has_settled(t_ns)]
        others.sort(key=lambda m: -(m.weight + m.benefit))
        if newborn in others[_MOST - 1 :]:
            others[_MOST - 2] = newborn
        self.members = [lead, *others[: _MOST - 1], *kept]
        top = lead.weight
        for member in self.members:
            member.weight -= top
        for member in kept:
            member.weight = max(member.weight, member.least)
            if member.without != SENSORS:
                member.benefit = (
                    max(-member.weight, _TINY) if member.benefit else 0.0
                )  # in a conflict it counts like the leading one
        self._note_conflict(t_ns)

    def _note_conflict(self, t_ns: int) -> None:
        if (found := self.conflict) is None:
            self.members[0].decided |= self.disputed
            self.conflict_ns, self.disputed = None, frozenset()
        else:
            self.conflict_ns, self.disputed = self.conflict_ns or t_ns, found[0]

    def _is_decided(self, aid: Aid) -> bool:
        lead = self.members[0]
        return aid.topic in lead.decided and (aid.t_ns - lead.fused_ns) * 1e-9 < LONG_S
