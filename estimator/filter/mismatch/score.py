"""A constant c of a source that nobody configured: detected by its score, then estimated (docs/decision.md).

    z = h(x) + J c + v,     J' = E[nu c] / s0^2,     A = sum J'^T S^-1 J',     b = sum J'^T S^-1 nu
    b / sqrt(A) ~ N(0, 1) where c = 0;  beyond the limit c becomes a state with the estimate b / A

With another source, a constant difference of the two positions d ~ N(0, 3 m) explains them too, nu = J' c + d + e:

    A <- A - B^T (C + I / 3^2)^-1 B,   b <- b - B^T (C + I / 3^2)^-1 e,   C, B, e = sum (S^-1)_pp, (S^-1 J')_p, (S^-1 nu)_p

s0: negligible sigma of c, considered. A filter aligned with this source alone, or relinearised, has its error: E[dx c] / s0^2 is
dx / dc of the readings. (Rao 1948; Friedland 1969.)
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import msgspec
import numpy as np
from msgspec.structs import replace
from numba import njit

from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.hypotheses import Hypothesis
from estimator.sources.base.aid import Aid, SlowError
from estimator.sources.base.faults import LONG_S
from models import cholesky
from models.measurements import Measurement
from models.messages import Array
from models.state import XYZ, E

_SIGMAS = 6.0
_FEWEST = 3  # readings
_APART = np.eye(3) / 3.0**2  # m^-2: information on the difference of two sources' positions, MAP_M of the faults
_PROBE = 1e-4  # s0, s or rad: less than the motion of any vehicle shows
_CONSIDERED = np.array([[_PROBE**2]])
_TINY = 1e-12
_NOTHING = np.zeros((0, 5))


class Constant(msgspec.Struct, frozen=True, eq=False):
    """What a source may have, and how it shows.

    sigma, walk: of c as a state, its variance per second; known: sigma that the sums must reach; most: largest |c|. jacobian: J
    (m,) of the whole measurement z at the state x (16,), with rate and force u (6,); None: it does not depend on c. follows: dx
    / dc (15,) of a filter that has the error of the readings. says: of a topic, c and its sigma.
    """

    name: str
    sigma: float
    walk: float
    known: float
    most: float
    jacobian: Callable[[Measurement, Array, Array], Array | None]
    follows: Callable[[Array, Array], Array]
    says: Callable[[str, float, float], str]

    def block(self, topic: str) -> str:
        """The slow error of a source."""
        return f"{topic}.{self.name}"


class Sums(msgspec.Struct, frozen=True, eq=False):
    """Sums of one constant of one source since since_ns, and number of readings; is_state: it is estimated.

    before: information and score of the previous minute; offset (3, 5): B, C, e.
    """

    since_ns: int
    information: float = 0.0
    score: float = 0.0
    readings: int = 0
    is_state: bool = False
    before: tuple[float, float] = (0.0, 0.0)
    offset: Array | None = None

    @property
    def evidence(self) -> tuple[float, float]:
        """A and b."""
        if self.offset is None:
            return self.information, self.score
        by, score = self.offset[:, 0], self.offset[:, 4]
        known = by @ cholesky.inverse(self.offset[:, 1:4] + _APART)
        return max(self.information - float(known @ by), _TINY), self.score - float(known @ score)

    def also(
        self, c: Constant, t_ns: int, seen: Innovation, column: int, gate: float = math.inf, weight: float = 1.0, *,
        apart: bool = False,
    ) -> "Sums":  # fmt: skip
        """The evidence with one more innovation; column: of c in P; weight: of a reading that shares errors with the last.

        gate: a reading beyond it counts only where c explains it; apart: of a position, with another source.
        """
        if self.is_state:
            return self
        is_new = not 0.0 <= (t_ns - self.since_ns) * 1e-9 < LONG_S
        sums = Sums(t_ns, before=self.evidence) if is_new else self
        place = np.zeros((XYZ, 5)) if apart else _NOTHING
        information, score = _score(seen.nu, seen.s, seen.hp, column, place)
        if math.isnan(information):
            return sums
        total, scores = sums.information + weight * information, sums.score + weight * score
        if seen.distance2 > gate:
            found = scores / total if total > 0.0 else 0.0  # at rest no reading shows a delay
            left = seen.distance2 - 2.0 * found * score + found**2 * information  # (nu - J' c)^T S^-1 (nu - J' c)
            if left > gate or abs(score) > c.most * information:
                return sums
        readings = sums.readings + 1
        offset = sums.offset
        if apart:
            offset = weight * place if offset is None else offset + weight * place
        now = Sums(sums.since_ns, total, scores, readings, False, sums.before, offset)
        shown = readings >= _FEWEST and scores**2 > _SIGMAS**2 * total
        if shown:
            total, scores = now.evidence
            shown = total * c.known**2 > 1.0 and scores**2 > _SIGMAS**2 * total
        return replace(now, is_state=True) if shown else now


Scores: TypeAlias = Mapping[str, Sums]  # by block


def carried(
    constants: Sequence[Constant], aid: Aid, z: Measurement, u: Array | None, scores: Scores, members: Sequence[Hypothesis], *,
    alone: bool,
) -> Aid:  # fmt: skip
    """The reading with the constants of its source among its errors; u (6,): rate, specific force; alone: no other source."""
    if u is None or not (aid.absolute or aid.receiver):
        return aid
    lead, errors, topic = members[0].filter, list(aid.slow_errors), aid.witness
    for c in constants:
        j, block = c.jacobian(z, lead.x, u), c.block(topic)
        if j is None:
            continue
        known = scores.get(block)
        is_state = known is not None and known.is_state
        if alone and (known is None or is_state):
            for member in members:
                if block not in member.filter.slow.columns:
                    begin(c, member.filter, topic, u)
                    if known is not None:
                        estimate(c, member.filter, topic, known)
        covariance, walk = (np.array([[c.sigma**2]]), np.array([c.walk])) if is_state else (_CONSIDERED, None)
        errors.append(SlowError(block, covariance, math.inf, j[:, None], walk, starts_at_zero=True))
    return replace(aid, slow_errors=tuple(errors))


def noted(
    constants: Sequence[Constant], aid: Aid, seen: Innovation, gate: float, scores: Scores, members: Sequence[Hypothesis],
    weight: float = 1.0, *, alone: bool,
) -> Scores:  # fmt: skip
    """After a reading of the leading filter; a constant that it shows becomes a state of each filter."""
    apart, lead = aid.absolute and not alone and len(seen.nu) >= XYZ, members[0].filter
    found = dict(scores)
    for c in constants:
        block = c.block(aid.witness)
        before = scores.get(block) or Sums(aid.t_ns)
        columns = lead.slow.columns.get(block)
        if columns is None or before.is_state or columns.stop > seen.hp.shape[1]:
            continue
        found[block] = now = before.also(c, aid.t_ns, seen, columns.start, gate, weight, apart=apart)
        if now.is_state:
            for member in members:
                if block in member.filter.slow.columns:
                    estimate(c, member.filter, aid.witness, now)
    return found


def remarks(constants: Sequence[Constant], scores: Scores, lead: Eskf) -> list[str]:
    """A sentence for each constant that is a state."""
    found: list[str] = []
    for c in constants:
        topics = sorted(
            block.removesuffix(c.block("")) for block, s in scores.items() if s.is_state and block.endswith(c.block(""))
        )
        for topic in topics:
            if (columns := lead.slow.columns.get(c.block(topic))) is not None:
                at = columns.start
                found.append(c.says(topic, float(lead.slow.mean[at - E.SIZE]), math.sqrt(lead.cov[at, at])))
    return found


def begin_again(constants: Sequence[Constant], eskf: Eskf, topic: str, u: Array | None) -> None:
    """After a run, which leaves the constants out."""
    for c in constants:
        if u is not None and c.block(topic) in eskf.slow.columns:
            eskf.forget(c.block(topic))
            begin(c, eskf, topic, u)


def begin(c: Constant, eskf: Eskf, topic: str, u: Array) -> None:
    """Note c of the only source of an alignment."""
    eskf.consider(c.block(topic), _CONSIDERED, math.inf)
    v = np.zeros(len(eskf.cov))
    v[: E.SIZE] = c.follows(eskf.x, u)
    v[-1] = 1.0
    eskf.cov[-1, -1] = 0.0
    eskf.cov += _PROBE**2 * np.outer(v, v)


def estimate(c: Constant, eskf: Eskf, topic: str, found: Sums) -> None:
    """Make c a state with four times its variance: S is an estimate, too."""
    at = eskf.slow.columns[c.block(topic)].start
    v = eskf.cov[:, at] / eskf.cov[at, at]
    eskf.cov += (c.sigma**2 - eskf.cov[at, at]) * np.outer(v, v)
    eskf.slow = eskf.slow.as_state(c.block(topic), np.array([c.walk]))
    information, score = found.evidence
    nu, noise, h = np.array([score / information]), np.array([[4.0 / information]]), np.zeros((1, len(v)))
    h[0, at] = 1.0
    for part in (E.P, E.V, E.THETA, E.BG, E.BA):  # the correction is linear, and may be wrong by its own size
        eskf.cov[part, part] += float(nu[0]) ** 2 * float(v[part] @ v[part]) * np.eye(XYZ)
    eskf.update(Innovation(nu, h, h @ eskf.cov, noise, eskf.cov[at : at + 1, at : at + 1] + noise, 0.0, 0.0))


@njit(cache=True, error_model="numpy")
def _score(nu: Array, s: Array, hp: Array, column: int, offset: Array) -> tuple[float, float]:
    """J'^T S^-1 J' and J'^T S^-1 nu, J' (m,) from column c of H P (m, n); nan where S is not positive definite.

    offset (3, 5) or empty: becomes S^-1 J', S^-1, S^-1 nu of the first three components.
    """
    m, information, score = nu.shape[0], 0.0, 0.0
    low, weighed, unit = np.empty((m, m)), np.empty(m), np.empty(m)
    for i in range(m):
        weighed[i] = hp[i, column] / _PROBE**2
    if not cholesky.factor(s, low):
        return np.nan, np.nan
    cholesky.substitute(low, weighed)
    for i in range(m):
        information += weighed[i] * (hp[i, column] / _PROBE**2)
        score += weighed[i] * nu[i]
    for k in range(offset.shape[0]):
        for i in range(m):
            unit[i] = 1.0 if i == k else 0.0
        cholesky.substitute(low, unit)
        offset[k, 0] = weighed[k]
        for i in range(3):
            offset[k, 1 + i] = unit[i]
        for i in range(m):
            offset[k, 4] += unit[i] * nu[i]
    return information, score
