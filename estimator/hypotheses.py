"""Which measurements are true? A few filters side by side, each with its own answer, weighed by the evidence.

One filter with a gate cannot tell a false fix after an outage, when almost anything passes, from the true ones that contradict
it later: it keeps the lie and locks the truth out. So the decision stays open while it is open:

* a fix is fused although a false reading would explain it nearly as well (as after an outage): a *sceptic* goes on without it,
  and without whatever agrees with it;
* a fix fails the gate: a *believer* goes on with it.

    true:          w <- w + ln(1 - e) + ln N(nu; 0, S)          false:  w <- w + ln(e u)
    false again, and in agreement with the last false one:      w <- w - dt / tau + ln N(nu; 0, S of who believes it)

e is the share of false readings, u their uniform density, tau how long a fault that repeats itself lasts. The leading
hypothesis is the estimate; another takes over when its weight is larger by a margin. A believer starts with at least the
weight of "the filter itself is wrong", e^-b, whatever its distance: consistent fixes are believed after believe_after_s (sooner when
the filter has long been unaided), never locked out, and a cluster of consistent lies that is shorter does not win. (Multiple hypothesis tracking with
fault modes; Blackman and Popoli 1999, ch. 16.)
"""

import math
from dataclasses import dataclass, field

from estimator.eskf import Eskf, Innovation
from estimator.gating import gate
from estimator.sources.source import Aid
from models.measurements import Measurement
from models.messages import Array

_MOST = 3  # hypotheses at a time
_TAKE_OVER = 3.0  # ln: margin by which another must lead
_FORGET = 20.0  # ln: further behind than this, a hypothesis is dropped
_LEAST_DOUBT = 1.0  # ln: a new hypothesis starts at least this far behind
_TRUST_FADES_S = 10.0  # s: without an absolute fix for so long, the filter itself is doubted twice as fast
_SETTLED_S = 20.0  # a hypothesis that has agreed with the leading one for so long goes
_OVERCONFIDENT, _OVERCONFIDENT_SHARE = 9.0, 0.1  # one filter in ten is taken to have errors three times what it says


@dataclass(slots=True)
class Doubt:
    """A hypothesis disbelieves a source: since the fix at last_ns at least; deliberate: though the fix passed the gate."""

    last_ns: int
    deliberate: bool


@dataclass(slots=True, eq=False)
class Hypothesis:
    """One filter, the logarithm of its weight, when it last fused a position, when it last differed from the leading one,
    and what it disbelieves (by topic)."""

    filter: Eskf
    weight: float = 0.0
    fused_ns: int = 0
    parted_ns: int = 0
    doubts: dict[str, Doubt] = field(default_factory=dict)

    def copy(self) -> "Hypothesis":
        """An independent hypothesis in the same state."""
        doubts = {topic: Doubt(d.last_ns, d.deliberate) for topic, d in self.doubts.items()}
        return Hypothesis(self.filter.copy(), self.weight, self.fused_ns, self.parted_ns, doubts)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the leading hypothesis made of a measurement."""

    seen: Innovation
    gate: float
    passed: bool
    fused: bool


class Hypotheses:
    """The filters that are still in question; the first is the estimate. `switches` counts take-overs."""

    __slots__ = ("members", "switches")

    def __init__(self, members: list[Hypothesis], switches: int = 0) -> None:
        self.members, self.switches = members, switches

    def copy(self) -> "Hypotheses":
        """Independent hypotheses in the same state."""
        return Hypotheses([h.copy() for h in self.members], self.switches)

    @property
    def lead(self) -> Eskf:
        """The filter that is the estimate."""
        return self.members[0].filter

    def judge(self, aid: Aid, z: Measurement, gyro_b: Array, *, trusted: bool) -> Verdict:
        """Let every hypothesis answer a measurement; trusted: the source's machine lets it be fused."""
        limit = gate(aid.rules.gate_probability, len(z.rows))
        seen = [innovation(m.filter, aid, z, gyro_b) for m in self.members]
        passed = [s.distance2 <= limit for s in seen]
        if not trusted:
            return Verdict(seen[0], limit, passed[0], fused=False)
        born = self._fork(aid, z, gyro_b, seen, passed) if aid.absolute else []
        fused = [self._answer(k, aid, seen, passed) for k in range(len(self.members))]
        for member, was_fused in zip(self.members, fused, strict=True):
            doubt = member.doubts.get(aid.topic)
            if was_fused != fused[0] and not (doubt and doubt.deliberate):
                member.parted_ns = aid.t_ns
        self.members += born
        self._rank(aid.t_ns)
        return Verdict(seen[0], limit, passed[0], fused[0])

    def _answer(self, k: int, aid: Aid, seen: list[Innovation], passed: list[bool]) -> bool:
        """Hypothesis k takes the measurement for true (and fuses it), for false, or for the last falsehood again."""
        member, doubt = self.members[k], self.members[k].doubts.get(aid.topic)
        if doubt and (doubt.deliberate or not passed[k]):
            agreeing = [
                seen[j].log_likelihood
                for j, other in enumerate(self.members)
                if j != k and passed[j] and aid.topic not in other.doubts
            ]
            if agreeing:
                member.weight += max(agreeing) - (aid.t_ns - doubt.last_ns) * 1e-9 / aid.rules.lie_s
                doubt.last_ns = aid.t_ns
                return False
        if passed[k]:
            member.weight += math.log1p(-aid.rules.false_share) + seen[k].log_likelihood
            member.doubts.pop(aid.topic, None)
            member.filter.update(seen[k])
            if aid.absolute:
                member.fused_ns = aid.t_ns
            return True
        member.weight += aid.log_false
        member.doubts[aid.topic] = Doubt(aid.t_ns, deliberate=False)
        return False

    def _fork(
        self, aid: Aid, z: Measurement, gyro_b: Array, seen: list[Innovation], passed: list[bool]
    ) -> list[Hypothesis]:
        """The sceptic or the believer that the leading hypothesis calls for, from its state before the measurement."""
        lead, first = self.members[0], seen[0]
        if passed[0]:
            margin = max(first.log_likelihood - aid.log_false, _LEAST_DOUBT)
            if margin > _FORGET or any(d.deliberate for m in self.members for d in m.doubts.values()):
                return []
            sceptic = lead.copy()
            sceptic.weight += math.log1p(-aid.rules.false_share) + first.log_likelihood - margin
            sceptic.parted_ns = aid.t_ns
            sceptic.doubts[aid.topic] = Doubt(aid.t_ns, deliberate=True)
            return [sceptic]
        if any(passed) or not math.isfinite(first.distance2):
            return []
        believer = lead.copy()
        dof = len(first.nu)
        overconfident = (
            math.log(_OVERCONFIDENT_SHARE) + first.log_likelihood
            + 0.5 * first.distance2 * (1.0 - 1.0 / _OVERCONFIDENT) - 0.5 * dof * math.log(_OVERCONFIDENT)
        )  # fmt: skip
        unaided_s = (aid.t_ns - lead.fused_ns) * 1e-9
        patience_s = aid.rules.believe_after_s / (1.0 + unaided_s / _TRUST_FADES_S)
        broken = aid.log_false + _TAKE_OVER - patience_s / aid.rules.lie_s
        believer.weight += min(max(overconfident, broken), aid.log_false - _LEAST_DOUBT)
        believer.fused_ns = aid.t_ns
        believer.parted_ns = aid.t_ns
        believer.doubts.pop(aid.topic, None)
        believer.filter.widen(math.sqrt(first.distance2 / dof))
        believer.filter.update(innovation(believer.filter, aid, z, gyro_b))
        return [believer]

    def _rank(self, t_ns: int) -> None:
        """Let the heaviest lead if its margin is enough; drop those that are far behind or no longer differ."""
        lead, *others = self.members
        best = max(others, key=lambda m: m.weight, default=lead)
        if best.weight > lead.weight + _TAKE_OVER:
            others = [lead, *(m for m in others if m is not best)]
            lead = best
            self.switches += 1
        others = [
            m for m in others if m.weight > lead.weight - _FORGET and t_ns - m.parted_ns < _SETTLED_S * 1e9
        ]
        others.sort(key=lambda m: -m.weight)
        self.members = [lead, *others[: _MOST - 1]]
        top = lead.weight
        for member in self.members:
            member.weight -= top


def innovation(eskf: Eskf, aid: Aid, z: Measurement, gyro_b: Array) -> Innovation:
    """The measurement seen from one filter, its slow error considered."""
    slow = aid.slow_error
    if slow is None:
        return eskf.innovation(z, gyro_b)
    eskf.consider(slow.block, slow.covariance, slow.tau_s)
    return eskf.innovation(z, gyro_b, slow.block)
