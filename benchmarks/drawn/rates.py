"""From drawn flights to a rate: weights, effective sample size, and a bound that a reader can follow by hand.

    P(event in a flight) = 1/N sum_k w_k x_k        x_k: 1 where flight k had an event; unbiased, for E_q[w x] = E_p[x]
    ESS = (sum w)^2 / sum w^2

The bound is by strata (no fault; one fault of a cause, bounded by the fault table or not; several): the nominal probability of
the stratum times the Clopper-Pearson bound of the share of its flights with an event. The kinds of a cause share its rate, and
are drawn as often, so that this share is the nominal one. A stratum that was never drawn counts whole.
"""

import math
from collections.abc import Sequence
from typing import Final

import msgspec

from benchmarks.drawn.faults import KINDS, Fault, kinds_of, nominal, within
from benchmarks.drawn.lockout import Lockout
from benchmarks.integrity.report import bound
from benchmarks.integrity.rows import Row

NONE, SEVERAL, UNBOUNDED = "no fault", "several faults", ", not bounded"
AIDS: Final = {"fixes": "fixes alone", "both": "GNSS and fixes"}


class Flown(msgspec.Struct, frozen=True):
    """A drawn flight; row: what the campaign counts of it; cautions_s: from each fault to an alert, None: none while it lasts."""

    seed: int
    program: str
    vehicle: str
    aids: str
    duration_s: float
    faults: tuple[Fault, ...]
    weight: float
    row: Row
    cautions_s: tuple[float | None, ...] = ()
    locked: Lockout | None = None

    @property
    def stratum(self) -> str:
        """Its fault's cause."""
        if len(self.faults) != 1:
            return SEVERAL if self.faults else NONE
        (fault,) = self.faults
        return KINDS[fault.kind].cause + ("" if fault.bounded(self.aids) else UNBOUNDED)

    @property
    def is_bounded(self) -> bool:
        """Whether the fault table bounds all of its faults."""
        return all(f.bounded(self.aids) for f in self.faults)

    @property
    def has_event(self) -> bool:
        """Whether the error was above the level at 1e-5 per hour while the state was usable."""
        return self.row.misled > 0


class Stratum(msgspec.Struct, frozen=True):
    """per_hour: what it nominally adds to the rate at most (95 %), of the condition and the share."""

    name: str
    flights: int
    with_event: int
    nominal: float
    share_at_most: float
    per_hour: float
    worst: float


class Rate(msgspec.Struct, frozen=True):
    """Of flights with the same sources. per_hour: estimate and its standard error; at_most: sum over the strata; of it the faults
    that the table bounds, and the others; ess: of the weights; hours: flown.
    """

    aids: str
    flights: int
    hours: float
    per_hour: float
    error: float
    ess: float
    at_most: float
    faults_at_most: float
    unbounded_at_most: float
    strata: tuple[Stratum, ...]


def rates(flown: Sequence[Flown]) -> list[Rate]:
    """For each set of sources."""
    return [rate([f for f in flown if f.aids == aids]) for aids in AIDS if any(f.aids == aids for f in flown)]


def rate(flown: Sequence[Flown]) -> Rate:
    """Of flights of one duration and the same sources; the bounds hold at 95 % for each stratum."""
    aids, hours = flown[0].aids, flown[0].duration_s / 3600.0
    terms = [f.weight * f.has_event for f in flown]
    mean = math.fsum(terms) / len(terms)
    spread = math.sqrt(math.fsum((t - mean) ** 2 for t in terms) / max(len(terms) - 1, 1) / len(terms))
    weights = [f.weight for f in flown]
    strata = tuple(_stratum(name, p, flown, hours) for name, p in probabilities(aids, flown[0].duration_s).items())
    return Rate(
        aids=aids,
        flights=len(flown),
        hours=hours * len(flown),
        per_hour=mean / hours,
        error=spread / hours,
        ess=math.fsum(weights) ** 2 / math.fsum(w * w for w in weights),
        at_most=math.fsum(s.per_hour for s in strata),
        faults_at_most=math.fsum(s.per_hour for s in strata if s.name != NONE and UNBOUNDED not in s.name),
        unbounded_at_most=math.fsum(s.per_hour for s in strata if UNBOUNDED in s.name),
        strata=strata,
    )


def probabilities(aids: str, duration_s: float) -> dict[str, float]:
    """Nominal probability of each stratum; they sum to 1."""
    p = {kind: nominal(kind, aids, duration_s) for kind in kinds_of(aids)}
    none = math.prod(1.0 - x for x in p.values())
    found = {NONE: none}
    for kind, x in p.items():
        cause, alone, share = KINDS[kind].cause, none * x / (1.0 - x), within(kind, aids)
        for name, y in ((cause, alone * share), (cause + UNBOUNDED, alone * (1.0 - share))):
            if y > 0.0:
                found[name] = found.get(name, 0.0) + y
    return found | {SEVERAL: max(0.0, 1.0 - math.fsum(found.values()))}


def _stratum(name: str, p: float, flown: Sequence[Flown], hours: float) -> Stratum:
    some = [f for f in flown if f.stratum == name]
    events = sum(f.has_event for f in some)
    most = bound(events, len(some)) if some else 1.0
    return Stratum(name, len(some), events, p, most, p * most / hours, max((f.row.worst for f in some), default=0.0))
