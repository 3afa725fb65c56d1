"""A clock that never steps, and foreign stamps on it.

    now = wall(start) + steady - steady(start)

A stamp t' of a clock ahead by a:  t = t' - a,  lag = arrival - t. Bounds of a: the quickest one-way message,
a <= t' - arrival + delay; half a round trip (Cristian 1989). Disjoint intervals [a +- h]: it stepped (Marzullo 1984).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Final

import msgspec
from msgspec import Meta

SECOND_NS: Final = 1_000_000_000
_WINDOW_NS: Final = 10 * SECOND_NS  # of which the quickest message counts, and of the window before
_SLEW: Final = 1e-3  # s/s: how fast an offset that has settled may follow
_DRIFT_NS: Final = int(2 * _WINDOW_NS * _SLEW)  # of the other clock while a reading counts, at most
_SETTLING_NS: Final = 2 * SECOND_NS
_STEP_NS: Final = 1_000_000  # the wall clock has stepped, not been read late
_READING_NS: Final = 100_000  # the two clocks are read together, or not at all
_OURS: Final = 0

_MINUTE_NS: Final = 60 * SECOND_NS
_TRIAL_COUNT, _TRIAL_NS = 5, SECOND_NS // 5  # of coherent stamps, before a foreign clock is accepted
_COHERENT_NS: Final = SECOND_NS // 4
_AHEAD_NS: Final = SECOND_NS // 2  # by which a stamp may be ahead of its arrival


class ClockConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """[clock]: accepted foreign stamps."""

    foreign: Annotated[
        tuple[str, ...], Meta(description="topics stamped by a clock that is not set to ours: its offset is always estimated")
    ] = ()
    late_s: Annotated[float, Meta(ge=1e-3, le=60, description="s: a message may take this long; more is another clock")] = 6.0
    quickest_s: Annotated[
        float, Meta(ge=0, le=1, description="s: what the quickest message of a foreign clock takes on its way")
    ] = 0.001


class Clock:
    """ns since 1970: the wall clock at the start, carried on by the monotonic clock.

    anchor_ns: wall - steady of an earlier daemon of this boot.
    """

    def __init__(
        self,
        anchor_ns: int | None = None,
        *,
        wall: Callable[[], int] = time.time_ns,
        steady: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._wall, self._steady = wall, steady
        self.anchor_ns = wall() - steady() if anchor_ns is None else anchor_ns

    def now_ns(self) -> int:
        """The time."""
        return self.anchor_ns + self._steady()

    def wall_ahead_ns(self) -> int | None:
        """Step of the wall clock since the start, or None."""
        before = self._steady()
        wall = self._wall()
        after = self._steady()
        return None if after - before > _READING_NS else wall - self.anchor_ns - (before + after) // 2


@dataclass(slots=True)
class Offset:
    """Offset of another clock; quickest_ns: least delay; bound_ns: of the error."""

    quickest_ns: int
    ahead_ns: int | None = None
    bound_ns: int = 0
    _best: list[tuple[int, int]] = field(default_factory=list)  # -bound, ahead: of the window before, and of this one
    _since_ns: int = 0
    _settled_ns: int = 0
    _seen_ns: int = 0
    _contrary: tuple[int, int] | None = None  # ahead, bound: the last reading, where it contradicts the best one
    steps: int = 0

    def one_way(self, stamp_ns: int, arrived_ns: int) -> None:
        """A message stamped by the other clock arrived now."""
        self._observe(stamp_ns - arrived_ns + self.quickest_ns, self.quickest_ns, arrived_ns)

    def round_trip(self, asked_ns: int, stamp_ns: int, answered_ns: int) -> None:
        """A question of ours was answered by the other clock's time."""
        middle, half = (asked_ns + answered_ns) // 2, (answered_ns - asked_ns) // 2
        self._look_for_step(stamp_ns - middle, half)
        self._observe(stamp_ns - middle, half, answered_ns)

    def ours(self, stamp_ns: int) -> int | None:
        """A stamp of the other clock on ours."""
        return None if self.ahead_ns is None else stamp_ns - self.ahead_ns

    def theirs(self, t_ns: int) -> int | None:
        """A time of ours on the other clock."""
        return None if self.ahead_ns is None else t_ns + self.ahead_ns

    def _look_for_step(self, ahead_ns: int, bound_ns: int) -> None:
        before, self._contrary = self._contrary, None
        if not self._best:
            return
        narrow, best_ns = max(self._best)
        if abs(ahead_ns - best_ns) <= bound_ns - narrow + _DRIFT_NS:
            return
        self._contrary = ahead_ns, bound_ns
        if before is not None and abs(ahead_ns - before[0]) <= bound_ns + before[1] + _DRIFT_NS:
            self._best, self.ahead_ns, self._contrary = [], None, None
            self.steps += 1

    def _observe(self, ahead_ns: int, bound_ns: int, now_ns: int) -> None:
        """Keep the narrowest bound of a window, then the quickest."""
        reading = (-bound_ns, ahead_ns)
        if not self._best or now_ns - self._since_ns > _WINDOW_NS:
            self._best = [*self._best[-1:], reading]
            self._since_ns = now_ns
        elif reading > self._best[-1]:
            self._best[-1] = reading
        narrow, target = max(self._best)
        self.bound_ns = -narrow
        if self.ahead_ns is None:
            self._settled_ns = now_ns + _SETTLING_NS
        if self.ahead_ns is None or now_ns < self._settled_ns:
            self.ahead_ns = target
        else:
            most = int(_SLEW * max(0, now_ns - self._seen_ns))
            self.ahead_ns += min(max(target - self.ahead_ns, -most), most)
        self._seen_ns = now_ns


@dataclass(slots=True)
class _Trial:
    ahead_ns: int
    since_ns: int
    count: int = 1


class Stamps:
    """Times of validity on our clock, from plausible stamps.

    Known: the wall clock, now and before its last step, and steady foreign clocks over a minute off. Of those with 0 <= lag <=
    late_s the one with the topic's usual lag counts.
    """

    def __init__(self, clock: Clock, config: ClockConfig) -> None:
        self._clock = clock
        self._forced = frozenset(config.foreign)
        self._late_ns = round(config.late_s * SECOND_NS)
        self._quickest_ns = round(config.quickest_s * SECOND_NS)
        self._wall: list[int] = [_OURS]  # ahead of ours: at the start, before the last step, now
        self._foreign: list[Offset] = []
        self._trials: dict[str, _Trial] = {}
        self._lags: dict[str, int] = {}
        self.steps = 0  # of the wall clock

    def report(self) -> dict[str, Any]:
        """For the status."""
        values: dict[str, Any] = {"wall_ahead_s": f"{self._wall[-1] * 1e-9:.3f}", "wall_steps": self.steps}
        for k, clock in enumerate(self._foreign):
            values |= {
                f"foreign_{k}_ahead_s": f"{(clock.ahead_ns or 0) * 1e-9:.6f}",
                f"foreign_{k}_bound_ms": clock.bound_ns * 1e-6,
            }
        return values

    def validity_ns(self, topic: str, stamp_ns: int, arrived_ns: int) -> int | None:
        """A message's stamp on our clock; None: of no known clock (yet)."""
        self._watch_wall()
        raw = arrived_ns - stamp_ns
        forced = topic in self._forced
        walls = [] if forced else [(ahead, None) for ahead in self._wall]
        clocks = walls + [(f.ahead_ns, f) for f in self._foreign if f.ahead_ns is not None]
        plausible = [(raw + ahead, f) for ahead, f in clocks if -_AHEAD_NS <= raw + ahead <= self._late_ns]
        if not plausible:
            return self._unknown(topic, stamp_ns, arrived_ns, forced=forced)
        usual = self._lags.get(topic)
        lag, foreign = plausible[0] if usual is None else min(plausible, key=lambda p: abs(p[0] - usual))
        self._lags[topic] = lag
        self._trials.pop(topic, None)
        if foreign is not None:
            foreign.one_way(stamp_ns, arrived_ns)
            return foreign.ours(stamp_ns)
        return arrived_ns - lag

    def _watch_wall(self) -> None:
        ahead = self._clock.wall_ahead_ns()
        if ahead is None or abs(ahead - self._wall[-1]) < _STEP_NS:
            return
        self._wall = [_OURS, *self._wall[1:][-1:], ahead]
        self.steps += 1

    def _unknown(self, topic: str, stamp_ns: int, arrived_ns: int, *, forced: bool) -> int | None:
        ahead = stamp_ns - arrived_ns
        if abs(ahead) < _MINUTE_NS and not forced:
            return stamp_ns
        trial = self._trials.get(topic)
        if trial is None or abs(ahead - trial.ahead_ns) > _COHERENT_NS:
            self._trials[topic] = _Trial(ahead, arrived_ns)
            return None
        trial.count += 1
        trial.ahead_ns = max(trial.ahead_ns, ahead)
        if trial.count < _TRIAL_COUNT or arrived_ns - trial.since_ns < _TRIAL_NS:
            return None
        offset = Offset(self._quickest_ns)
        offset.one_way(arrived_ns + trial.ahead_ns, arrived_ns)
        self._foreign = [*self._foreign[-3:], offset]
        self._lags[topic] = 0
        del self._trials[topic]
        return offset.ours(stamp_ns)
