"""An unconfigured delay tau of a source: detected in its innovations, then estimated (docs/decision.md).

    z = h(x(t - tau)) + v = h(x(t)) + J tau + v,   J = - d h / d t
    position  J = -(v + R_nb (w x l))        velocity  J = -(R_nb f + g)        attitude  J = -R_nb w
    J' = E[nu tau] / s0^2,   A = sum J'^T S^-1 J',   b = sum J'^T S^-1 nu,   b / sqrt(A) ~ N(0, 1) where tau = 0
    P <- P + E[tau^2] v v^T,   E[tau^2] = 1 / (A + s^-2) + (b / (A + s^-2))^2

With another source, a constant difference of the two positions c ~ N(0, 3 m) explains them too, nu = J' tau + c + e:

    A <- A - B^T (C + I / 3^2)^-1 B,   b <- b - B^T (C + I / 3^2)^-1 d,   C, B, d = sum (S^-1)_pp, (S^-1 J')_p, (S^-1 nu)_p

s0: negligible sigma of tau, considered; s: configured. Beyond the limit tau becomes a state with estimate b / A. A filter aligned
with this source alone, or relinearised, knows x(t - tau): E[dx tau] / s0^2 = dx / dt. (Rao 1948; Friedland 1969.)
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from msgspec.structs import replace
from numba import njit

from estimator.filter.eskf import Eskf, Innovation
from estimator.filter.hypotheses import Hypothesis
from estimator.sources.base.aid import Aid, SlowError
from models import cholesky, so3
from models.frames import GRAVITY
from models.measurements import Measurement, PartialPose, Pose, Position, Velocity
from models.messages import Array
from models.state import E, X

_ANEW_S = 60.0  # the sums begin anew
_SIGMAS = 6.0
_FEWEST = 3  # readings
_LONGEST_S = 0.5  # no longer delay is found
_APART = np.eye(3) / 3.0**2  # m^-2: information on the difference of two sources' positions, MAP_M of the faults
_KNOWN_S = 0.02  # sigma of tau that the sums must reach
_SIGMA_S = 0.1  # of tau, to begin with, where it is a state
_PROBE_S = 1e-4  # s0: less than the motion of any vehicle shows
_WALK = np.array([2e-3**2])  # s^2 / s
_STATE, _PROBE = np.array([[_SIGMA_S**2]]), np.array([[_PROBE_S**2]])
_G_N = np.array([0.0, 0.0, GRAVITY])
_AT_IMU = np.zeros(3)
_COUNTS_M2 = 1e-3  # less is not worth the time of an estimate
_XYZ, _TINY = 3, 1e-12
_NOTHING = np.zeros((0, 5))


class Delay(NamedTuple):
    """Sums of one source since since_ns, and number of readings; is_state: the delay is estimated.

    before: information and score of the previous minute; offset (3, 5): B, C, d.
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

    def covariance(self, sigma_s: float, v_n: Array) -> Array | None:
        """E[tau^2] v v^T of the position, (3, 3), prior sigma_s; None where negligible."""
        if self.is_state or not sigma_s:
            return None
        information, score = max(self.evidence, self.before)
        information += sigma_s**-2
        variance = 1.0 / information + (score / information) ** 2
        if variance * math.hypot(*v_n.tolist()) ** 2 <= _COUNTS_M2:
            return None
        return variance * (v_n[:, None] * v_n)

    def also(
        self, t_ns: int, seen: Innovation, column: int, gate: float = math.inf, weight: float = 1.0, *, apart: bool = False
    ) -> "Delay":
        """The evidence with one more innovation; column: of tau in P; weight: of a reading that shares errors with the last.

        gate: a reading beyond it counts only where it shows a delay by itself; apart: of a position, with another source.
        """
        if self.is_state:
            return self
        is_new = not 0.0 <= (t_ns - self.since_ns) * 1e-9 < _ANEW_S
        sums = Delay(t_ns, before=self.evidence) if is_new else self
        place = np.zeros((_XYZ, 5)) if apart else _NOTHING
        information, score = _score(seen.nu, seen.s, seen.hp, column, place)
        if math.isnan(information):
            return sums
        total, scores = sums.information + weight * information, sums.score + weight * score
        if seen.distance2 > gate:
            tau = scores / total if total > 0.0 else 0.0  # at rest no reading shows a delay
            left = seen.distance2 - 2.0 * tau * score + tau**2 * information  # (nu - J' tau)^T S^-1 (nu - J' tau)
            if left > gate or score**2 < _SIGMAS**2 * information or abs(score) > _LONGEST_S * information:
                return sums
        readings = sums.readings + 1
        offset = sums.offset
        if apart:
            offset = weight * place if offset is None else offset + weight * place
        now = Delay(sums.since_ns, total, scores, readings, False, sums.before, offset)
        shown = readings >= _FEWEST and scores**2 > _SIGMAS**2 * total
        if shown:
            total, scores = now.evidence
            shown = total * _KNOWN_S**2 > 1.0 and scores**2 > _SIGMAS**2 * total
        return now._replace(is_state=True) if shown else now


Delays: TypeAlias = dict[str, Delay]  # by topic of the source, or of its receiver's positions


def block(topic: str) -> str:
    """Slow error of a source's delay."""
    return f"{topic}.delay"


def carried(aid: Aid, z: Measurement, u: Array | None, delays: Delays, members: Sequence[Hypothesis], *, alone: bool) -> Aid:
    """The reading with its source's delay among its errors; u (6,): rate, specific force; alone: no other source."""
    if u is None or not (aid.absolute or aid.receiver):
        return aid
    topic = aid.witness
    if topic not in delays and alone:
        for member in members:
            begin(member.filter, topic, u)
    is_state = topic in delays and delays[topic].is_state
    covariance, walk = (_STATE, _WALK) if is_state else (_PROBE, None)
    j = jacobian(z, members[0].filter.x, u)[:, None]
    error = SlowError(block(topic), covariance, math.inf, j, walk, starts_at_zero=True)
    return replace(aid, slow_errors=(*aid.slow_errors, error))


def explains(off: Array, s: Array, x: Array) -> bool:
    """Whether a delay may explain a source's distance off (3,) [m] of covariance s (3, 3).

    |off| <= |v| tau_max + 3 sigma, sigma^2 = tr s.
    """
    return float(np.linalg.norm(off)) <= _LONGEST_S * float(np.linalg.norm(x[X.V])) + 3.0 * math.sqrt(float(s.trace()))


def noted(
    aid: Aid, seen: Innovation, gate: float, delays: Delays, members: Sequence[Hypothesis], weight: float = 1.0, *, alone: bool
) -> Delays:
    """After a reading of the leading filter; a detected delay becomes a state of each filter."""
    topic = aid.witness
    before = delays.get(topic) or Delay(aid.t_ns)
    name, lead = block(topic), members[0].filter
    now = before
    if not before.is_state and name in lead.slow.columns and lead.slow.columns[name].stop <= seen.hp.shape[1]:
        apart = aid.absolute and not alone and len(seen.nu) >= _XYZ
        now = before.also(aid.t_ns, seen, lead.slow.columns[name].start, gate, weight, apart=apart)
    if now.is_state and not before.is_state:
        for member in members:
            if name in member.filter.slow.columns:
                estimate(member.filter, topic, now)
    return {**delays, topic: now}


def remarks(delays: Delays, lead: Eskf) -> list[str]:
    """Sources with late or early stamps, by how much."""
    found: list[str] = []
    for topic in sorted(topic for topic, delay in delays.items() if delay.is_state and block(topic) in lead.slow.columns):
        at = lead.slow.columns[block(topic)].start
        late_ms, sigma_ms = 1e3 * float(lead.slow.mean[at - E.SIZE]), 1e3 * float(np.sqrt(lead.cov[at, at]))
        side = "late" if late_ms >= 0.0 else "early"
        found.append(f"stamps of {topic} are {abs(late_ms):.0f} ms {side} (sigma {sigma_ms:.0f} ms), beyond the configured delay")
    return found


def begin_again(eskf: Eskf, topic: str, u: Array | None) -> None:
    """After a run, which leaves out the delay of what came before the alignment."""
    if u is not None and block(topic) in eskf.slow.columns:
        eskf.forget(block(topic))
        begin(eskf, topic, u)


def begin(eskf: Eskf, topic: str, u: Array) -> None:
    """Note the delay of the only source of an alignment, unless it is known."""
    if block(topic) in eskf.slow.columns:
        return
    eskf.consider(block(topic), _PROBE, math.inf)
    rotation, rate, force = so3.matrix(eskf.x[X.Q]), u[:_XYZ] - eskf.x[X.BG], u[_XYZ:] - eskf.x[X.BA]
    v = np.zeros(len(eskf.cov))
    v[E.P], v[E.V], v[E.THETA] = eskf.x[X.V], rotation @ force + _G_N, rate
    v[-1] = 1.0
    eskf.cov[-1, -1] = 0.0
    eskf.cov += _PROBE_S**2 * np.outer(v, v)


def estimate(eskf: Eskf, topic: str, found: Delay) -> None:
    """Make the delay a state with four times its variance: S is an estimate, too."""
    at = eskf.slow.columns[block(topic)].start
    v = eskf.cov[:, at] / eskf.cov[at, at]
    eskf.cov += (_SIGMA_S**2 - eskf.cov[at, at]) * np.outer(v, v)
    eskf.slow = eskf.slow.as_state(block(topic), _WALK)
    information, score = found.evidence
    nu, noise, h = np.array([score / information]), np.array([[4.0 / information]]), np.zeros((1, len(v)))
    h[0, at] = 1.0
    for part in (E.P, E.V, E.THETA, E.BG, E.BA):  # the correction is linear, and may be wrong by its own size
        eskf.cov[part, part] += float(nu[0]) ** 2 * float(v[part] @ v[part]) * np.eye(_XYZ)
    eskf.update(Innovation(nu, h, h @ eskf.cov, noise, eskf.cov[at : at + 1, at : at + 1] + noise, 0.0, 0.0))


def jacobian(z: Measurement, x: Array, u: Array) -> Array:
    """J of all components of a measurement, (m,), 1/s; zero for what has no delay here."""
    if isinstance(z, Pose | PartialPose):
        by_pose = _jacobian(x, u, _AT_IMU)[: 2 * _XYZ]
        return np.asarray(z.directions @ by_pose) if isinstance(z, PartialPose) else by_pose
    if isinstance(z, Position):
        return _jacobian(x, u, z.lever_b)[:_XYZ]
    if isinstance(z, Velocity):
        return _jacobian(x, u, _AT_IMU)[2 * _XYZ :]
    return np.zeros(len(z.rows))


_XV, _XQ, _XG, _XA = X.V.start, X.Q.start, X.BG.start, X.BA.start  # compiled code reads plain integers


@njit(cache=True, error_model="numpy")
def _jacobian(x: Array, u: Array, lever: Array) -> Array:
    """J (9,) of a position at lever_b, of the attitude and of the velocity."""
    rotation, rate, force, j = so3.matrix(x[_XQ:_XG]), np.empty(3), np.empty(3), np.empty(9)
    for i in range(3):
        rate[i], force[i] = u[i] - x[_XG + i], u[3 + i] - x[_XA + i]
    moved, turned, pushed = so3.applied(so3.skew(rate), lever), so3.applied(rotation, rate), so3.applied(rotation, force)
    moved = so3.applied(rotation, moved)
    for i in range(3):
        j[i], j[3 + i], j[6 + i] = -(x[_XV + i] + moved[i]), -turned[i], -pushed[i]
    j[8] -= GRAVITY
    return j


@njit(cache=True, error_model="numpy")
def _score(nu: Array, s: Array, hp: Array, column: int, offset: Array) -> tuple[float, float]:
    """J'^T S^-1 J' and J'^T S^-1 nu, J' (m,) from column tau of H P (m, n); nan where S is not positive definite.

    offset (3, 5) or empty: becomes S^-1 J', S^-1, S^-1 nu of the first three components.
    """
    m, information, score = nu.shape[0], 0.0, 0.0
    low, weighed, unit = np.empty((m, m)), np.empty(m), np.empty(m)
    for i in range(m):
        weighed[i] = hp[i, column] / _PROBE_S**2
    if not cholesky.factor(s, low):
        return np.nan, np.nan
    cholesky.substitute(low, weighed)
    for i in range(m):
        information += weighed[i] * (hp[i, column] / _PROBE_S**2)
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
