"""Protection levels: two in `time_to_alert_s` with an alert limit, else one in twice that.

One comes at once with a jump of the estimate and, while the state is usable, with a position or a GNSS velocity that is off by
more than 3 sigma of its innovation.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from estimator.filter.tracker import Tracker
from estimator.integrity.alert import CAUTION_RISK, Judge, Levels
from estimator.integrity.config import IntegrityConfig
from estimator.integrity.faults import FIX, GNSS, IN_USE_S, VELOCITY, Fault, Position, Snapshot, Velocity, faults
from estimator.integrity.protection import Mode, Tail, allowed, exceeded, in_plane, one_axis, protection_level, protection_levels
from models.messages import AidStatus, Alert, Integrity, Reason
from models.state import E

RISKS: Final = (1e-3, 1e-5, 1e-7)  # per hour
_PER_ALERT: Final = 2
_OFF_SIGMAS: Final = 3.0
_USED: Final = frozenset({Reason.FUSED, Reason.ALIGNING})
_NEVER: Final = -(2**62)
_UNKNOWN: Final = Levels(math.inf, math.inf)


class Monitor:
    """note() decisions; at() when due()."""

    def __init__(self, config: IntegrityConfig) -> None:
        self._config = config
        self._tail = Tail(config.core_scale, config.tail_scale, config.tail_share)
        is_judged = config.hal_m is not None or config.val_m is not None
        self._period_ns = round(config.time_to_alert_s * 1e9 * (1.0 / _PER_ALERT if is_judged else 2.0))
        self._judge = Judge(config)
        self._positions: dict[str, Position] = {}
        self._velocities: dict[str, Velocity] = {}
        self._next_ns: int | None = None
        self.last: Integrity | None = None
        risks = (*RISKS, config.risk_per_hour, min(1.0, CAUTION_RISK * config.risk_per_hour))
        self._shares = [allowed(risk, config.correlation_s) for risk in risks]
        self._once, each = np.unique(self._shares, return_inverse=True)
        self._each = each.tolist()
        gaussian = [Mode("", 1.0, 0.0, 1.0)]  # of sigma 1 m, at the first risk
        pure = Tail(1.0, 1.0, 0.0)
        self._units = [protection_level(gaussian, self._shares[0], pure, q) for q in (in_plane, one_axis)]

    def begin_again(self) -> None:
        """Forget all, answer at once."""
        self._positions, self._velocities, self._next_ns = {}, {}, None

    @property
    def summary(self) -> str:
        """Of the last answer, for Health."""
        last = self.last
        return "" if last is None else f"{last.state}: {last.reason}" if last.reason else str(last.state)

    def note(self, status: AidStatus, position: tuple[tuple[float, ...], tuple[float, ...]] | None) -> None:
        """Note a decision, and its innovation as a position with sigma, if any."""
        if status.kind == VELOCITY and len(status.innovation) == len(status.innovation_sigma) == 3:
            self._note_velocity(status)
        if status.kind not in {GNSS, FIX}:
            return
        last = self._positions.get(status.topic)
        used_ns = status.t_ns if status.reason in _USED else _NEVER
        fused_ns = max(used_ns, last.fused_ns if last else _NEVER)
        if position is not None and (last is None or status.t_ns >= last.t_ns):
            self._positions[status.topic] = Position(status.kind, status.t_ns, *position, fused_ns)
            self._alarm(*position)
        elif last is not None:
            self._positions[status.topic] = last._replace(fused_ns=fused_ns)
        else:
            self._positions[status.topic] = Position(status.kind, _NEVER, (), (), fused_ns)

    def _note_velocity(self, status: AidStatus) -> None:
        last = self._velocities.get(status.topic)
        if last is None or status.t_ns >= last.t_ns:
            off = self._alarm(status.innovation, status.innovation_sigma)
            agreed_ns = last.agreed_ns if off and last else status.t_ns
            self._velocities[status.topic] = Velocity(status.t_ns, status.innovation, status.innovation_sigma, agreed_ns)

    def _alarm(self, innovation: tuple[float, ...], sigma: tuple[float, ...]) -> bool:
        """Whether it is off; while the state is usable levels are due then."""
        off = any(abs(x) > _OFF_SIGMAS * s for x, s in zip(innovation, sigma, strict=True))
        if off and self.last is not None and self.last.state is Alert.USABLE:
            self.at_once()
        return off

    def at_once(self) -> None:
        """Levels are due with the next estimate."""
        self._next_ns = None

    def due(self, t_ns: int) -> bool:
        """Whether levels are due."""
        return self._next_ns is None or t_ns >= self._next_ns

    def at(self, tracker: Tracker, t_ns: int, arrived_ns: int) -> Integrity:
        """Protection levels and alert at t_ns."""
        self._next_ns = t_ns + self._period_ns
        reason = "there is no estimate"
        try:
            found = self._faults(tracker, t_ns)
            levels = self._levels(found)
        except (ArithmeticError, ValueError) as error:  # a defect here costs the level, never the estimate
            found, reason = None, f"internal error: {type(error).__name__}: {error}"
            levels = self._levels(None)
        at_risk, at_caution = levels[-2:]
        state = self._judge.judge(t_ns, at_risk, at_caution)
        if found is not None:
            reason = self._reason(found, at_risk) if state in {Alert.CAUTION, Alert.DO_NOT_USE} else ""
        config = self._config
        self.last = Integrity(
            t_ns,
            arrived_ns,
            state,
            reason,
            config.risk_per_hour,
            *at_risk,
            math.inf if config.hal_m is None else config.hal_m,
            math.inf if config.val_m is None else config.val_m,
            RISKS,
            tuple(level.hpl_m for level in levels[: len(RISKS)]),
            tuple(level.vpl_m for level in levels[: len(RISKS)]),
            levels[0].hpl_m / self._units[0],
            levels[0].vpl_m / self._units[1],
        )
        return self.last

    def _levels(self, found: list[Fault] | None) -> list[Levels]:
        if found is None:
            return [_UNKNOWN] * len(self._shares)
        h, v = protection_levels(np.array([f[1:] for f in found]), self._once, self._tail)
        return [Levels(h[k], v[k]) for k in self._each]

    def _faults(self, tracker: Tracker, t_ns: int) -> list[Fault] | None:
        shown = tracker.alignment.shown
        if shown is None or not shown.lead.sound:
            return None
        single = not tracker.core.is_aligned or tracker.alignment.without_sensor is not None
        factor = tracker.core.variance_factor.lasting
        covariance = tracker.shown_covariance()[E.P, E.P] if single else factor * shown.lead.cov[E.P, E.P]
        age_s = (t_ns - tracker.core.last_absolute_ns) * 1e-9 if tracker.core.last_absolute_ns >= 0 else math.inf
        for topic in [k for k, p in self._positions.items() if (t_ns - max(p.t_ns, p.fused_ns)) * 1e-9 > IN_USE_S]:
            del self._positions[topic]
        positions, holds_s = self._positions, self._period_ns * 1e-9
        now = Snapshot(t_ns, shown, covariance, max(age_s, 0.0), positions, single, factor, self._velocities, holds_s)
        return faults(now, self._config)

    def _reason(self, found: list[Fault], at_risk: Levels) -> str:
        config = self._config
        sides: list[tuple[str, float, float | None, list[Mode], Callable[[float], float]]] = [
            ("HPL", at_risk.hpl_m, config.hal_m, [f.horizontal for f in found], in_plane),
            ("VPL", at_risk.vpl_m, config.val_m, [f.vertical for f in found], one_axis),
        ]
        for name, level, limit, modes, exceeds in sides:
            if limit is not None and not level <= limit:
                worst = self._largest(modes, limit, exceeds)
                shown = f"{level:.1f} m" if math.isfinite(level) else "unbounded"
                return f"{name} {shown}, limit {limit:g} m: {worst}"
        return "within the limits again, for less than 2 s"

    def _largest(self, modes: Sequence[Mode], limit_m: float, exceeds: Callable[[float], float]) -> str:
        shares = exceeded(modes, limit_m, self._tail, exceeds)
        return modes[shares.index(max(shares))].name
