"""Which measurements are true? A few filters side by side, each with its own answer, weighed by the evidence.

One filter with a gate cannot tell a false fix after an outage, when almost anything passes, from the true ones that contradict
it later: it keeps the lie and locks the truth out. So the decision stays open while it is open:

* a fix is fused although a false reading would explain it nearly as well (as after an outage): a *sceptic* goes on without it,
  and without whatever agrees with it;
* a fix fails the gate: a *believer* goes on with it.

A false fix that was sought where the vehicle was expected fits well too. So in the covariance, though not in the decision, a
sceptic begins with the weight e at least, and loses twice dt / tau: after an outage the first fixes are told with the chance that
they are a look-alike, until that is less than 1 in 10,000: 500 m with a chance of 1 in a million make no ellipsoid of use.

    true:          w <- w + ln N(nu; 0, S)                      false:  w <- w + ln(e u)
    false again, and in agreement with the last false one:      w <- w - dt / tau + ln (sum w_j N(nu; 0, S_j) / sum w_j)

j: who believes in the source; e is the share of false readings, u their uniform density, tau how long a fault that repeats
itself lasts. The leading hypothesis is the estimate; another takes over when its weight is larger by a margin. By the same margin
a reading must be better foretold as the last falsehood than as true, where a gate was all that spoke against the last one.

A receiver (GNSS) may be misled for minutes, slowly, by an error that all of its readings share. So where the leading hypothesis
fuses it and another absolute source, one goes on *without* it. That one takes no reading of the receiver, and none is evidence
for or against it. Each fix may raise it by ln 1/e at most; its weight stays above ln(1 - trust). A fix that it takes and the
leading one refuses is a conflict: both count alike in the covariance until it is decided. (Solution separation: Blanch et al.,
Baseline advanced RAIM user algorithm, 2015, sec. IV.)

A believer starts with at least the weight of "the filter itself is wrong", whatever its distance, so that consistent fixes are
believed in the end and never locked out: after as long as the leading hypothesis has stood itself (5 s to reset_after_s),
sooner when it has long been unaided. A cluster of consistent lies that is shorter does not win. (Multiple hypothesis tracking;
Blackman and Popoli 1999, ch. 16.)
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numba import njit

from estimator.filter.eskf import Eskf, Innovation
from estimator.sources.gating import gate
from estimator.sources.source import Aid
from models.measurements import Measurement
from models.messages import Array
from models.relative_pose import RelativePose
from models.state import E, X, local

_N = E.SIZE  # compiled code reads plain integers
_OF_STATE = (slice(0, _N), slice(0, _N))  # of P
MOST_OF_A_KIND = 8  # slow errors of landmarks at a time
_MOST = 4  # hypotheses at a time
_HALF_TURN = 3.14  # rad
_MARGIN = 3.0  # ln: by which another must be better
_FORGET = 20.0  # ln: further behind than this, a hypothesis is dropped
_SHOWS = 9.2  # ln 10,000: further behind, it is not told in the covariance; a gate refuses one in as many good readings
_LEAST_DOUBT = 1.0  # ln: a sceptic starts at least this far behind
_LEAST_CONTRADICTION_S = 2.0  # s: contradiction shorter than this never wins
_LEAST_PATIENCE_S = 5.0  # s: nor one shorter than this against a hypothesis that is being aided
_TRUST_FADES_S = 10.0  # s: without an absolute fix for so long, the filter itself is doubted twice as fast
_LEFT_OUT_S = 60.0  # without a fix for so long, a hypothesis without the receiver no longer serves
_TINY = 1e-9
_AGREES = 0.5  # share of good fixes that are so near
_SETTLED_S = 20.0  # a hypothesis that has agreed with the leading one for so long goes
_OVERCONFIDENT, _OVERCONFIDENT_SHARE = 9.0, 0.1  # one filter in ten is taken to have errors three times what it says


@dataclass(slots=True)
class Doubt:
    """A hypothesis disbelieves a source: since the fix at last_ns at least; deliberate: though the fix passed the gate."""

    last_ns: int
    deliberate: bool


@dataclass(slots=True, eq=False)
class Hypothesis:
    """One filter and the logarithm of its weight.

    fused_ns: when it last fused a position; established_ns: since when it has done so without a long break;
    parted_ns: when it last differed from the leading one; doubts: what it disbelieves, by topic; benefit: ln, of the doubt that a
    sceptic stands for: it counts for so much more in the covariance than in the decision; without: the topic of the receiver that
    it leaves out for good; least: ln, below which its weight does not fall, for that receiver may be misled at any time; decided:
    topics that it rejects since a conflict that it has won.
    """

    filter: Eskf
    weight: float = 0.0
    fused_ns: int = 0
    established_ns: int = 0
    parted_ns: int = 0
    doubts: dict[str, Doubt] = field(default_factory=dict)
    benefit: float = 0.0
    without: str = ""
    least: float = -math.inf
    decided: frozenset[str] = frozenset()

    def copy(self) -> "Hypothesis":
        """An independent hypothesis in the same state."""
        doubts = {topic: Doubt(d.last_ns, d.deliberate) for topic, d in self.doubts.items()}
        return replace(self, filter=self.filter.copy(), doubts=doubts)

    def note_fused(self, t_ns: int) -> None:
        """A position was fused."""
        if (t_ns - self.fused_ns) * 1e-9 > _LEAST_PATIENCE_S:
            self.established_ns = t_ns
        self.fused_ns = t_ns

    @property
    def rejected(self) -> set[str]:
        """Topics whose last reading was false to it, or that it leaves out."""
        return {topic for topic, doubt in self.doubts.items() if not doubt.deliberate or topic == self.without}

    def matters_beside(self, lead: "Hypothesis") -> bool:
        """It may still lead, or it shows in the covariance."""
        return self.weight > lead.weight - _FORGET or self.shows_beside(lead)

    def shows_beside(self, lead: "Hypothesis") -> bool:
        """It is likely enough for the covariance to tell of it."""
        if self.without and not self.benefit:
            return False
        return self.weight + self.benefit > lead.weight - _SHOWS

    def has_settled(self, t_ns: int) -> bool:
        """It has agreed with the leading hypothesis for so long that there is no question any more."""
        return (t_ns - self.parted_ns) * 1e-9 >= _SETTLED_S

    def patience_s(self, t_ns: int, most_s: float) -> float:
        """How long consistent contradiction must last: as long as the hypothesis itself has stood, less when it is unaided."""
        stood_s = (self.fused_ns - self.established_ns) * 1e-9
        unaided_s = (t_ns - self.fused_ns) * 1e-9
        return min(max(stood_s, _LEAST_PATIENCE_S), most_s) / (1.0 + unaided_s / _TRUST_FADES_S)


class Verdict(NamedTuple):
    """What the leading hypothesis made of a measurement; foreseen: by any."""

    seen: Innovation
    gate: float
    passed: bool
    fused: bool
    foreseen: bool


class Hypotheses:
    """The filters that are still in question; the first is the estimate.

    switches: how often another one took over; conflict_ns: since when sources are in conflict; disputed: the rejected ones.
    """

    __slots__ = ("conflict_ns", "disputed", "members", "switches")

    def __init__(
        self,
        members: list[Hypothesis],
        switches: int = 0,
        conflict_ns: int | None = None,
        disputed: frozenset[str] = frozenset(),
    ) -> None:
        self.members, self.switches = members, switches
        self.conflict_ns, self.disputed = conflict_ns, disputed

    def copy(self) -> "Hypotheses":
        """Independent hypotheses in the same state."""
        return Hypotheses([h.copy() for h in self.members], self.switches, self.conflict_ns, self.disputed)

    @property
    def lead(self) -> Eskf:
        """The filter that is the estimate."""
        return self.members[0].filter

    def covariance(self) -> Array:
        """Of the leading state's error, (15, 15): sum of w_k (P_k + d_k d_k^T), d_k = x_k (-) x, over all that is told."""
        lead = self.members[0]
        if len(self.members) == 1:  # most of the time
            cov, factor = lead.filter.cov[_OF_STATE], lead.filter.variance_factor
            return cov.copy() if factor == 1.0 else _scaled(cov, factor)
        shown = [lead, *(m for m in self.members[1:] if m.shows_beside(lead))]
        weights = [math.exp(m.weight + m.benefit) for m in shown]
        total, whole = np.zeros((E.SIZE, E.SIZE)), sum(weights)
        for weight, member in zip(weights, shown, strict=True):
            _mix(
                total,
                weight / whole,
                member.filter.cov,
                local(lead.filter.x, member.filter.x) / math.sqrt(lead.filter.variance_factor),
            )
        return _scaled(total, lead.filter.variance_factor)

    @property
    def conflict(self) -> tuple[frozenset[str], float] | None:
        """Topics that the leading hypothesis rejects and another one, in the covariance, does not; their distance [m]."""
        lead, rejected = self.members[0], self.members[0].rejected
        for member in self.members[1:]:
            if member.benefit > 0.0 and (topics := rejected - member.doubts.keys()):
                off = member.filter.x[X.P] - lead.filter.x[X.P]
                return frozenset(topics), float(np.linalg.norm(off))
        return None

    def scale(self, variance_factor: float, topic: str = "") -> None:
        """The errors of every filter are larger than it says; `topic` has shown it: too much of it was refused."""
        lead = self.members[0]
        if variance_factor > lead.filter.variance_factor and (doubt := lead.doubts.get(topic)) and not doubt.deliberate:
            del lead.doubts[topic]
        for member in self.members:
            member.filter.variance_factor = variance_factor

    def forget(self, block: str) -> None:
        """No filter takes the slow error `block` into account any more."""
        for member in self.members:
            if block in member.filter.slow.columns:
                member.filter.forget(block)

    def judge(self, aid: Aid, z: Measurement, gyro_b: Array, *, trusted: bool, vouched: bool = False) -> Verdict:
        """Let every hypothesis answer a measurement.

        trusted: the source's machine lets it be fused; vouched: another source has given positions lately.
        """
        limit = gate(aid.rules.gate_probability, len(z.rows))
        seen = [innovation(m.filter, aid, z, gyro_b) for m in self.members]
        passed = [s.distance2 <= limit for s in seen]
        if not trusted:
            return Verdict(seen[0], limit, passed[0], fused=False, foreseen=any(passed))
        if not aid.weighs:
            for member, by_member, fits in zip(self.members, seen, passed, strict=True):
                if fits:
                    member.filter.update(by_member)
            return Verdict(seen[0], limit, passed[0], passed[0], foreseen=any(passed))
        if vouched and passed[0] and self._leave_out(aid):
            seen.append(seen[0])
            passed.append(True)
        believer = self._believer(aid, z, gyro_b, seen[0]) if aid.absolute and not any(passed) else None
        born: list[Hypothesis] = []
        agreement = self._agreement(aid, seen, passed)
        doubted = self._doubted(aid, agreement)
        # Position and velocity of one receiver are false together: to who doubts the position, its velocity is no more news.
        by_receiver = self._told([j for j, m in enumerate(self.members) if aid.receiver not in m.doubts], seen)
        fused = [False] * len(seen)

        def answer(k: int) -> float:
            """What hypothesis k gains."""
            member, before = self.members[k], self.members[k].weight
            lead_refuses = k > 0 and not fused[0]
            fused[k] = self._answer(
                k, aid, seen[k], passed[k], agreement[k], doubted, born, by_receiver, lead_refuses=lead_refuses
            )
            return member.weight - before

        following = [k for k, m in enumerate(self.members) if aid.witness not in m.doubts]
        gained = {k: answer(k) for k, m in enumerate(self.members) if m.without != aid.witness}
        by_others = gained[0] if 0 in gained else max((gained[k] for k in following), default=None)
        for k, member in enumerate(self.members):
            if k in gained:
                self._limit(k, aid, gained, fused)
            elif by_others is not None:
                member.weight += by_others
            else:  # no other one follows the receiver: it is judged again
                member.without = ""
                answer(k)
        self._begin_again(aid, fused, believer, agrees=seen[0].distance2 <= gate(_AGREES, len(z.rows)))
        for member, was_fused in zip(self.members, fused, strict=True):
            doubt = member.doubts.get(aid.topic)
            if was_fused != fused[0] and not (doubt and doubt.deliberate):
                member.parted_ns = aid.t_ns
        self.members += born + ([believer] if believer else [])
        self._rank(aid.t_ns)
        return Verdict(seen[0], limit, passed[0], fused[0], foreseen=any(passed))

    def _leave_out(self, aid: Aid) -> bool:
        """Whether from now on a hypothesis goes on without this receiver, which may be misled for long."""
        lead = self.members[0]
        if aid.log_misled is None or lead.doubts or any(m.without == aid.topic for m in self.members):
            return False
        other = lead.copy()
        other.weight = other.least = aid.log_misled
        other.without, other.parted_ns = aid.topic, aid.t_ns
        other.doubts[aid.topic] = Doubt(aid.t_ns, deliberate=True)
        self.members.append(other)
        return True

    def _limit(self, k: int, aid: Aid, gained: dict[int, float], fused: list[bool]) -> None:
        """What a fix may add to a hypothesis k without a receiver; where the leading one refuses it, there is a conflict."""
        member = self.members[k]
        if k == 0 or not member.without or not aid.absolute:
            return
        member.weight += min(0.0, gained.get(0, 0.0) - math.log(aid.rules.false_share) - gained[k])
        member.benefit = float(not fused[0] and (fused[k] or bool(member.benefit)) and not self._is_decided(aid))

    def _begin_again(self, aid: Aid, fused: list[bool], believer: Hypothesis | None, *, agrees: bool) -> None:
        """A hypothesis without a receiver that refuses a fix begins again as the leading one or the believer that takes it."""
        for member, was_fused in zip(self.members, fused, strict=True):
            if not member.without or member is self.members[0] or not aid.absolute or member.without == aid.witness:
                continue
            if was_fused and not (agrees and fused[0]):
                continue
            if fused[0] or believer is not None:
                right = self.members[0] if fused[0] else believer
                assert right is not None
                member.filter, member.fused_ns = right.filter.copy(), aid.t_ns
                member.doubts.pop(aid.topic, None)

    def leave(self, topic: str) -> None:
        """The receiver has been found out: the hypothesis without it leads, where there is one."""
        for member in self.members[1:]:
            if member.without == topic:
                self.members.remove(member)
                self.members[0].weight = -_MARGIN
                member.weight = member.benefit = 0.0
                self.members.insert(0, member)
                self.switches += 1
                return

    def weigh(self, t_ns: int, gained: list[float]) -> None:
        """What only tells the hypotheses apart: w_k <- w_k + gained_k (ln); the heaviest leads."""
        for member, more in zip(self.members, gained, strict=True):
            member.weight += more
        self._rank(t_ns)

    def drop(self, is_impossible: Callable[[Hypothesis], bool]) -> None:
        """Drop what no vehicle can be, but never the last hypothesis; the heaviest that is left leads."""
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

    def _agreement(self, aid: Aid, seen: list[Innovation], passed: list[bool]) -> list[float | None]:
        """ln of the evidence that a hypothesis, which took the source's last reading for false, sees the same falsehood again.

        Those who believe in the source say what it reads next, each with his weight: so who disbelieves never gains on them. No
        hypothesis is made about a reading that is not absolute, so there who believes in it again speaks too: it must not be news
        that only those pay for who do not foresee it.
        """
        doubts = [m.doubts.get(aid.topic) for m in self.members]
        if not any(doubts):  # most of the time
            return [None] * len(doubts)
        fades = [-(aid.t_ns - doubt.last_ns) * 1e-9 / aid.rules.fault_s if doubt else 0.0 for doubt in doubts]
        believe = [j for j, doubt in enumerate(doubts) if passed[j] and doubt is None]
        told = self._told(believe, seen)
        again = [
            j
            for j, doubt in enumerate(doubts)
            if passed[j]
            and doubt
            and not doubt.deliberate
            and not aid.absolute
            and told + fades[j] <= seen[j].log_likelihood + _MARGIN
        ]
        told_by_all = self._told(believe + again, seen)
        agreement = [(told if passed[k] else told_by_all) + fade for k, fade in enumerate(fades)]
        return [a if doubt and a > -math.inf else None for a, doubt in zip(agreement, doubts, strict=True)]

    def _told(self, by: list[int], seen: list[Innovation]) -> float:
        """ln of a reading's density to the hypotheses `by`: sum of w_j N(nu_j; 0, S_j) / sum of w_j; -inf without any."""
        if not by:
            return -math.inf
        weights = [self.members[j].weight for j in by]
        return ln_sum([w + seen[j].log_likelihood for w, j in zip(weights, by, strict=True)]) - ln_sum(weights)

    def _answer(
        self,
        k: int,
        aid: Aid,
        seen: Innovation,
        passed: bool,
        agreement: float | None,
        doubted: float,
        born: list[Hypothesis],
        by_receiver: float,
        *,
        lead_refuses: bool,
    ) -> bool:
        """Hypothesis k takes the measurement for true (and fuses it), for false, or for the last falsehood again.

        doubted: weight of the heaviest sceptic that there is already; by_receiver: ln of the density of a velocity to those who
        believe in its receiver's positions, -inf where nobody does; lead_refuses: the leading hypothesis took it for false.
        """
        member, doubt = self.members[k], self.members[k].doubts.get(aid.topic)
        true = seen.log_likelihood
        if k > 0 and aid.receiver in member.doubts and by_receiver > -math.inf:
            member.weight += by_receiver
            return False
        if doubt and agreement is not None and (doubt.deliberate or not passed or agreement > true + _MARGIN):
            member.weight += agreement
            member.benefit = max(member.benefit - (aid.t_ns - doubt.last_ns) * 1e-9 / aid.rules.fault_s, 0.0)
            doubt.last_ns = aid.t_ns
            return False
        if passed:
            margin = max(true - aid.log_false, _LEAST_DOUBT)
            may_doubt = aid.absolute and (k == 0 or not member.without)
            if may_doubt and margin < _FORGET and member.weight + true - margin > doubted:
                sceptic = member.copy()
                sceptic.weight += true - margin
                sceptic.benefit = max(margin + math.log(aid.rules.false_share), 0.0) if aid.resembles else 0.0
                sceptic.parted_ns, sceptic.without = aid.t_ns, ""
                sceptic.doubts[aid.topic] = Doubt(aid.t_ns, deliberate=True)
                born.append(sceptic)
            member.weight += true
            if member.doubts.pop(aid.topic, None):
                member.benefit = 0.0
            member.filter.update(seen)
            if aid.absolute:
                member.note_fused(aid.t_ns)
                behind = self.members[0].weight - member.weight
                member.decided -= {aid.topic}
                if (
                    lead_refuses and behind < _FORGET and not self._is_decided(aid)
                ):  # until it is decided, the covariance covers both
                    member.benefit = max(member.benefit, behind)
            return True
        member.weight += aid.log_false
        member.doubts[aid.topic] = Doubt(aid.t_ns, deliberate=False)
        return False

    def _doubted(self, aid: Aid, agreement: list[float | None]) -> float:
        """Weight of the heaviest hypothesis that goes on without the source deliberately, after this measurement; none: -inf.

        One of the last outage has all but died away until the next, and does not stand for the doubt of the first fix after it.
        """
        return max(
            (
                m.weight + again
                for m, again in zip(self.members, agreement, strict=True)
                if again is not None and m.doubts[aid.topic].deliberate and not m.has_settled(aid.t_ns)
            ),
            default=-math.inf,
        )

    def _believer(self, aid: Aid, z: Measurement, gyro_b: Array, seen: Innovation) -> Hypothesis | None:
        """The leading hypothesis gone wrong: fuses what contradicts it, as much less certain as the contradiction is large."""
        if not math.isfinite(seen.distance2):
            return None
        believer = self.members[0].copy()
        dof = len(seen.nu)
        overconfident = (
            math.log(_OVERCONFIDENT_SHARE) + seen.log_likelihood
            + 0.5 * seen.distance2 * (1.0 - 1.0 / _OVERCONFIDENT) - 0.5 * dof * math.log(_OVERCONFIDENT)
        )  # fmt: skip
        patience_s = self.members[0].patience_s(aid.t_ns, aid.rules.reset_after_s)
        broken = aid.log_false + _MARGIN - patience_s / aid.rules.fault_s
        most = aid.log_false + _MARGIN - _LEAST_CONTRADICTION_S / aid.rules.fault_s
        believer.weight += min(max(overconfident, broken), most)
        believer.fused_ns = believer.established_ns = believer.parted_ns = aid.t_ns
        believer.doubts.pop(aid.topic, None)
        believer.filter.widen(math.sqrt(seen.distance2 / dof))
        believer.filter.update(innovation(believer.filter, aid, z, gyro_b))
        return believer

    def _rank(self, t_ns: int) -> None:
        """Let the heaviest lead if its margin is enough; drop those that are far behind or no longer differ."""
        if len(self.members) == 1:  # most of the time
            self.members[0].weight = 0.0
            if self.conflict_ns is not None:
                self._note_conflict(t_ns)
            return
        lead, *others = self.members
        best = max(others, key=lambda m: m.weight, default=lead)
        if best.weight > lead.weight + _MARGIN:
            others = [lead, *(m for m in others if m is not best)]
            best.decided, self.disputed = frozenset(best.rejected - lead.doubts.keys()), frozenset()
            lead = best
            lead.benefit = 0.0
            self.switches += 1
        kept = [m for m in others if m.without and (t_ns - m.fused_ns) * 1e-9 < _LEFT_OUT_S]
        others = [m for m in others if not m.without and m.matters_beside(lead) and not m.has_settled(t_ns)]
        others.sort(key=lambda m: -(m.weight + m.benefit))
        self.members = [lead, *others[: _MOST - 1], *kept]
        top = lead.weight
        for member in self.members:
            member.weight -= top
        for member in kept:
            member.weight = max(member.weight, member.least)
            member.benefit = max(-member.weight, _TINY) if member.benefit else 0.0  # in a conflict it counts like the leading one
        self._note_conflict(t_ns)

    def _note_conflict(self, t_ns: int) -> None:
        """A conflict begins, goes on or is decided."""
        if (found := self.conflict) is None:
            self.members[0].decided |= self.disputed
            self.conflict_ns, self.disputed = None, frozenset()
        else:
            self.conflict_ns, self.disputed = self.conflict_ns or t_ns, found[0]

    def _is_decided(self, aid: Aid) -> bool:
        """The leading hypothesis has won against this source, and other ones still confirm it: it is not in question again."""
        lead = self.members[0]
        return aid.topic in lead.decided and (aid.t_ns - lead.fused_ns) * 1e-9 < _LEFT_OUT_S


def _scaled(cov: Array, factor: float) -> Array:
    """f P (15, 15); an attitude has no sigma beyond half a turn."""
    if factor == 1.0:
        return cov
    scaled = factor * cov
    sigma = math.sqrt(max(scaled.diagonal()[E.THETA].tolist()))
    if sigma > _HALF_TURN:
        scaled[E.THETA] *= _HALF_TURN / sigma
        scaled[:, E.THETA] *= _HALF_TURN / sigma
    return scaled


def ln_sum(terms: list[float]) -> float:
    """ln of the sum of exp(terms)."""
    top = max(terms)
    return top + math.log(sum(math.exp(term - top) for term in terms))


@njit(cache=True)
def _mix(total: Array, weight: float, cov: Array, off: Array) -> None:
    """Add weight (P + d d^T) of the 15 error states to total (15, 15), in place; cov: (n, n), off: d (15,)."""
    for i in range(_N):
        for j in range(_N):
            total[i, j] += weight * (cov[i, j] + off[i] * off[j])


def clone_of(topic: str) -> str:
    """The block of the pose that is kept for an odometry."""
    return f"{topic}.kept"


def innovation(eskf: Eskf, aid: Aid, z: Measurement, gyro_b: Array) -> Innovation:
    """The measurement seen from one filter, with its slow errors."""
    carried = [(slow.block, slow.moves(eskf.x)) for slow in aid.slow_errors]
    if isinstance(z, RelativePose):
        kept = clone_of(aid.topic)
        z = z.since(eskf.clones[kept])
        carried.append((kept, z.by_origin(eskf.x)))
    eskf.slow = eskf.slow.used([block for block, _ in carried])  # first: none of them makes room for another one of them
    for slow, block in zip(aid.slow_errors, carried, strict=False):  # a kept pose, behind them, is there
        known = eskf.slow.columns.get(slow.block)
        if known and known.stop - known.start != len(slow.covariance):  # told otherwise than before: another error
            eskf.forget(slow.block)
        if slow.block not in eskf.slow.columns:
            if oldest := eskf.slow.oldest(slow.block.rpartition("/")[0], MOST_OF_A_KIND):
                eskf.forget(oldest)
            eskf.consider(slow.block, slow.covariance, slow.tau_s, slow.walk)
            if slow.walk is not None and not slow.starts_at_zero:
                eskf.zero(slow.block, eskf.innovation(z, gyro_b, [block]))
    return eskf.innovation(z, gyro_b, carried)
