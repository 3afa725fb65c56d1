"""Fault modes of protection.py: probability, offset and sigma.

    nominal                  sigma of the leading hypothesis
    a hypothesis             p = exp(w_k) / sum exp(w_j);  offset |x_k - x|, sigma of P_k
    a source wrong for long  the hypothesis without GNSS, each newest position of another source
    map, rig, timing, IMU    an offset from the configuration
    IMU wrong, any size      offset |v - v_source| t, t: since this velocity agreed, until the next level
    a false fix in the gate  offset 4 sigma

A rate r has the probability r correlation_s / 3600, raised by a separation d to (Bayes; ARAIM has a threshold)

    p' = p / (p + exp(-t^2 / 2)),   t^2 = d_h^2 / sigma_h^2 + d_v^2 / sigma_v^2
"""

import math
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from estimator.filter.hypotheses import Hypotheses, Hypothesis
from estimator.integrity.config import IntegrityConfig
from estimator.integrity.protection import Mode, allowed
from models.messages import RADIAN_M, Array
from models.state import E, X

GNSS, FIX, VELOCITY = "gnss_position", "pose", "gnss_velocity"  # kinds of sources
IN_USE_S: Final = 60.0  # since it was last fused: what it did is in the estimate so long
OTHER_SOURCE_S: Final = 2.0  # old at most, a position of another source that the estimate is compared with
_GATED_SIGMAS: Final = 4.0


class Position(NamedTuple):
    """Newest position of a source: innovation and sigma, NED [m], (3,)."""

    kind: str
    t_ns: int
    innovation: tuple[float, ...]
    sigma: tuple[float, ...]
    fused_ns: int


class Velocity(NamedTuple):
    """Newest velocity of a source: innovation and sigma, NED [m/s], (3,); when it last agreed."""

    t_ns: int
    innovation: tuple[float, ...]
    sigma: tuple[float, ...]
    agreed_ns: int


class Snapshot(NamedTuple):
    """State for the faults; covariance (3, 3): of the position, without other hypotheses; holds_s: until the next level."""

    t_ns: int
    hypotheses: Hypotheses
    covariance: Array
    absolute_age_s: float
    positions: Mapping[str, Position]
    single: bool  # the hypotheses are in the covariance already
    variance_factor: float  # of what is published
    velocities: Mapping[str, Velocity] = {}
    holds_s: float = 0.0


class Fault(NamedTuple):
    """A fault, horizontally and vertically [m]."""

    name: str
    probability: float
    offset_h: float
    sigma_h: float
    offset_v: float
    sigma_v: float

    @property
    def horizontal(self) -> Mode:
        """In the plane."""
        return Mode(self.name, self.probability, self.offset_h, self.sigma_h)

    @property
    def vertical(self) -> Mode:
        """Along the vertical."""
        return Mode(self.name, self.probability, self.offset_v, self.sigma_v)


def faults(now: Snapshot, config: IntegrityConfig) -> list[Fault]:
    """The filter's probabilities sum to 1, rates come on top (union bound)."""
    found = list(_weighed(now))
    nominal = found[0]
    for topic, position in now.positions.items():
        if (now.t_ns - position.fused_ns) * 1e-9 <= IN_USE_S:
            found += _of_source(topic, position, now, nominal, config)
    for topic, velocity in now.velocities.items():
        if 0.0 <= (now.t_ns - velocity.t_ns) * 1e-9 <= OTHER_SOURCE_S:
            found.append(_runaway(topic, velocity, now, nominal, config))
    fallen = 0.5 * config.imu_fault_m_s2 * now.absolute_age_s**2
    found.append(_moved(nominal, "the IMU wrong", _share(config.imu_fault_per_hour, config), fallen, fallen))
    return found


def _weighed(now: Snapshot) -> Iterator[Fault]:
    sigma_h, sigma_v = sigmas(now.covariance)
    lead, *others = now.hypotheses.members
    others = [] if now.single else [m for m in others if m.benefit or not m.without]  # no spare ones
    whole = 1.0 + sum(math.exp(m.weight + m.benefit) for m in others)
    yield Fault("nominal errors", 1.0 / whole, 0.0, sigma_h, 0.0, sigma_v)
    for member in others:
        yield _separated(_said(member, lead), math.exp(member.weight + member.benefit) / whole, member, now)


def _said(member: Hypothesis, lead: Hypothesis) -> str:
    refused = sorted(member.doubts.keys() - lead.doubts.keys()), sorted(lead.doubts.keys() - member.doubts.keys())
    if refused[0]:
        return f"{refused[0][0]} fused and false"
    return f"{refused[1][0]} refused and true" if refused[1] else "another hypothesis true"


def _of_source(topic: str, position: Position, now: Snapshot, nominal: Fault, config: IntegrityConfig) -> Iterator[Fault]:
    is_gnss = position.kind == GNSS
    any_size = config.gnss_fault_per_hour if is_gnss else config.fix_fault_per_hour
    lead = now.hypotheses.lead
    v = lead.x[X.V].tolist()
    late_h, late_v = math.hypot(v[0], v[1]) * config.timing_s, abs(v[2]) * config.timing_s
    kinds = [(f"stamps of {topic} wrong", config.timing_fault_per_hour, late_h, late_v)]
    if not is_gnss:
        shift, turn = config.map_shift_m, math.radians(config.rig_turn_deg) * RADIAN_M
        n, e, d = (0.01 * config.map_scale_percent * lead.x[X.P]).tolist()
        kinds.append(("the map shifted", config.map_fault_per_hour, shift, shift))
        kinds.append(("the map's scale wrong", config.map_fault_per_hour, math.hypot(n, e), abs(d)))
        kinds.append(("the cameras turned on their mount", config.rig_fault_per_hour, turn, turn))
    prior, name = _share(any_size, config), f"{topic} wrong for long"
    without = list(_without(topic, position, now, config))
    for offset_h, sigma_h, offset_v, sigma_v, t2 in without:
        yield Fault(name, _raised(prior, t2), offset_h, sigma_h, offset_v, sigma_v)
    if not without:
        yield Fault(f"{name}: no second source checks it", prior, 0.0, math.inf, 0.0, math.inf)
    for said, rate, offset_h, offset_v in kinds:
        yield _moved(nominal, said, _share(rate, config), offset_h, offset_v)
    if not is_gnss:
        p = _share(config.landmark_fault_per_hour, config)
        gated_h, gated_v = _GATED_SIGMAS * nominal.sigma_h, _GATED_SIGMAS * nominal.sigma_v
        yield _moved(nominal, "a false fix inside the gate", p, gated_h, gated_v)


def _without(
    topic: str, position: Position, now: Snapshot, config: IntegrityConfig
) -> Iterator[tuple[float, float, float, float, float]]:
    lead = now.hypotheses.members[0]
    for member in now.hypotheses.members[1:]:
        if member.without == topic and _is_confirmed(member, topic, now):
            f = _separated("", 0.0, member, now)
            yield f.offset_h, f.sigma_h, f.offset_v, f.sigma_v, _t2(f)
    rejected = lead.rejected if config.exclude_rejected else ()
    for other, seen in now.positions.items():
        fresh = 0.0 <= (now.t_ns - seen.t_ns) * 1e-9 <= OTHER_SOURCE_S
        if other == topic or not fresh or other in rejected or (seen.kind == GNSS and position.kind == GNSS):
            continue
        n, e, d = seen.innovation
        sigma_h, sigma_v = max(seen.sigma[0], seen.sigma[1]), seen.sigma[2]
        t2 = (n / seen.sigma[0]) ** 2 + (e / seen.sigma[1]) ** 2 + (d / sigma_v) ** 2
        yield math.hypot(n, e), sigma_h, abs(d), sigma_v, t2


def _runaway(topic: str, velocity: Velocity, now: Snapshot, nominal: Fault, config: IntegrityConfig) -> Fault:
    """A constant acceleration a over t makes v = a t and p = v t / 2; until the next level both grow."""
    (n, e, d), (sn, se, sd) = velocity.innovation, velocity.sigma
    t_s = (now.t_ns - velocity.agreed_ns) * 1e-9 + now.holds_s
    p = _raised(_share(config.imu_fault_per_hour, config), (n / sn) ** 2 + (e / se) ** 2 + (d / sd) ** 2)
    return _moved(nominal, f"the IMU wrong: {topic} says another velocity", p, math.hypot(n, e) * t_s, abs(d) * t_s)


def _raised(prior: float, t2: float) -> float:
    """By a separation of t2 = t^2 (Bayes)."""
    return prior / (prior + math.exp(-0.5 * t2)) if prior else 0.0


def _is_confirmed(member: Hypothesis, topic: str, now: Snapshot) -> bool:
    others = (seen for other, seen in now.positions.items() if other != topic and seen.kind != GNSS)
    return any(seen.t_ns >= member.fused_ns for seen in others)


def _separated(name: str, probability: float, member: Hypothesis, now: Snapshot) -> Fault:
    n, e, d = (member.filter.x[X.P] - now.hypotheses.lead.x[X.P]).tolist()
    sigma_h, sigma_v = sigmas(now.variance_factor * member.filter.cov[E.P, E.P])
    return Fault(name, probability, math.hypot(n, e), sigma_h, abs(d), sigma_v)


def _moved(nominal: Fault, name: str, probability: float, offset_h: float, offset_v: float) -> Fault:
    return Fault(name, probability, offset_h, nominal.sigma_h, offset_v, nominal.sigma_v)


def _t2(f: Fault) -> float:
    h, v = f.offset_h / f.sigma_h, f.offset_v / f.sigma_v
    return h * h + v * v


def sigmas(P: Array) -> tuple[float, float]:
    """Largest in the plane, and vertical, of a covariance (3, 3)."""
    (a, b, _), (_, c, _), (_, _, v) = P.tolist()
    largest = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    return math.sqrt(max(largest, 0.0)), math.sqrt(max(v, 0.0))


def _share(rate_per_hour: float, config: IntegrityConfig) -> float:
    return allowed(rate_per_hour, config.correlation_s)
