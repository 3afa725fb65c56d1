"""Search of noise parameters: Sobol' sequence, then COBYQA (Ragonneau & Zhang 2024).

Of indistinguishable values the nearest to a wider start (Breiman et al. 1984).
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Annotated, Final

import msgspec
import numpy as np
from msgspec import Meta
from scipy.optimize import Bounds, OptimizeResult, minimize
from scipy.stats import qmc

from estimator.config import Config, parse
from estimator.tools.tune.keys import Key, Values, bounds, from_search, to_search, value_of
from estimator.tools.tune.score import Job, Window, score
from models.messages import Array

_DECADES: Final = 1.0  # the coarse search looks so far to either side of the start
_FIRST_STEP, _LAST_STEP = 0.25, 0.02  # of the fine search, decades
_SEED: Final = 1
_DOUBLED: Final = math.log10(2.0)
_SURE: Final = 2.0  # standard errors
_ROUNDS: Final = 3  # of polishing
_BACK: Final = (0.25, 0.5, 0.75, 1.0)  # parts of the way back to a wider start


class Summary(msgspec.Struct, frozen=True):
    """score: mean log score; false: probably false fixes, not in nis_per_dof."""

    windows: int
    fixes: int
    score: float
    false: int
    nis_per_dof: float
    position_rms_m: float
    inside95: float


class Gain(msgspec.Struct, frozen=True):
    """Score difference of two configurations per fix: mean, standard error."""

    mean: float
    error: float

    @property
    def is_sure(self) -> bool:
        """Whether it exceeds chance."""
        return abs(self.mean) > _SURE * self.error


class TunedKey(msgspec.Struct, frozen=True):
    """half, double: gain of score there; determined: loss on both sides beyond chance."""

    name: str
    before: float
    after: float
    half: Gain
    double: Gain
    determined: bool
    at_bound: bool


class TuneResult(msgspec.Struct, frozen=True):
    """Result; held_out: logs not tuned on."""

    values: Values
    keys: tuple[TunedKey, ...]
    evaluations: int
    before: Summary
    after: Summary
    gain: Gain
    held_out_before: Summary | None = None
    held_out_after: Summary | None = None
    held_out_gain: Gain | None = None
    logs: tuple[str, ...] = ()
    held_out_logs: tuple[str, ...] = ()


class TuneConfig(msgspec.Struct, frozen=True):
    """coarse, fine: evaluations at most; outage_s, truth: as score.Job."""

    coarse: Annotated[int, Meta(ge=0)] = 16
    fine: Annotated[int, Meta(ge=0)] = 40
    outage_s: float = 10.0
    truth: str = ""


class Tuner:
    """Search over logs with a configuration (TOML), by an executor."""

    def __init__(
        self,
        logs: Sequence[str],
        config: str,
        keys: Sequence[Key],
        settings: TuneConfig,
        executor: Executor,
        progress: Callable[[float], None] = lambda _: None,
    ) -> None:
        self._logs, self._config, self._keys, self._settings = tuple(logs), config, tuple(keys), settings
        self._executor, self._progress = executor, progress
        self._known: dict[tuple[object, ...], list[Window]] = {}
        self._expected = settings.coarse + settings.fine + 2 * len(self._keys) + len(_BACK) * (len(self._keys) + 1) + 1

    def run(self, held_out: Sequence[str] = ()) -> TuneResult:
        """Tune and report the gain. Raises LogError."""
        config = parse(self._config)
        start = np.array([to_search(key, value_of(config, key)) for key in self._keys])
        before, untouched = self._of([{}])[0], self._of([{}], held_out)[0] if held_out else []
        best = self._cautious(self._polished(self._fine(self._coarse(start))), start)
        values = self._values(best)
        if not _gain(self._windows([best])[0], before).mean > 0.0:  # what is there is not made worse
            best, values = start, {key.name: value_of(config, key) for key in self._keys}
        after = self._of([values])[0]
        afterwards = self._of([values], held_out)[0] if held_out else []
        return TuneResult(
            values=values,
            keys=self._judged(config, best, values, after),
            evaluations=len(self._known),
            before=summary(before),
            after=summary(after),
            gain=_gain(after, before),
            held_out_before=summary(untouched) if held_out else None,
            held_out_after=summary(afterwards) if held_out else None,
            held_out_gain=_gain(afterwards, untouched) if held_out else None,
            logs=self._logs,
            held_out_logs=tuple(held_out),
        )

    def _coarse(self, start: Array) -> Array:
        low, high = self._box()
        low, high = np.maximum(low, start - _DECADES), np.minimum(high, start + _DECADES)
        places = [start]
        if self._settings.coarse and np.all(high > low):
            unit = qmc.Sobol(len(start), scramble=True, rng=_SEED).random_base2(max(0, (self._settings.coarse - 1).bit_length()))
            places += list(qmc.scale(unit, low, high)[: self._settings.coarse])
        costs = [-summary(windows).score for windows in self._windows(places)]
        return places[int(np.argmin(costs))]

    def _fine(self, start: Array) -> Array:
        low, high = self._box()
        if self._settings.fine < 1:
            return start

        def cost(place: Array) -> float:
            return -summary(self._windows([place])[0]).score

        result: OptimizeResult = minimize(
            cost,
            start,
            method="COBYQA",
            bounds=Bounds(low, high),
            options={"maxfev": self._settings.fine, "initial_tr_radius": _FIRST_STEP, "final_tr_radius": _LAST_STEP},
        )
        return np.asarray(result.x, float) if result.fun <= cost(start) else start

    def _aside(self, place: Array) -> list[Array]:
        low, high = self._box()
        return [np.clip(place + sign * _DOUBLED * row, low, high) for row in np.eye(len(place)) for sign in (-1.0, 1.0)]

    def _polished(self, place: Array) -> Array:
        for _ in range(_ROUNDS):
            places = [place, *self._aside(place)]
            costs = [-summary(windows).score for windows in self._windows(places)]
            if int(np.argmin(costs)) == 0:
                break
            place = places[int(np.argmin(costs))]
        return place

    def _cautious(self, best: Array, start: Array) -> Array:
        reference = self._windows([best])[0]
        back = np.where([key.is_noise for key in self._keys], np.maximum(start - best, 0.0), 0.0)
        place, end = best, best + back
        for way in (back, *np.diag(back)):
            places = [np.minimum(place + part * way, end) for part in _BACK if way.any()]
            for nearer, windows in zip(places, self._windows(places), strict=True):
                if (loss := _gain(windows, reference)).is_sure and loss.mean < 0.0:
                    break
                place = nearer
        return place

    def _judged(self, config: Config, best: Array, values: Values, after: list[Window]) -> tuple[TunedKey, ...]:
        low, high = self._box()
        gains = [_gain(windows, after) for windows in self._windows(self._aside(best))]
        judged = []
        for k, key in enumerate(self._keys):
            half, double = gains[2 * k], gains[2 * k + 1]
            judged.append(
                TunedKey(
                    name=key.name,
                    before=value_of(config, key),
                    after=values[key.name],
                    half=half,
                    double=double,
                    determined=all(g.mean < 0.0 and g.is_sure for g in (half, double)),
                    at_bound=bool(min(best[k] - low[k], high[k] - best[k]) < _LAST_STEP),
                )
            )
        return tuple(judged)

    def _box(self) -> tuple[Array, Array]:
        low, high = np.array([bounds(key) for key in self._keys]).T
        return low, high

    def _values(self, place: Array) -> Values:
        return {key.name: from_search(key, float(x)) for key, x in zip(self._keys, place, strict=True)}

    def _windows(self, places: Sequence[Array]) -> list[list[Window]]:
        return self._of([self._values(place) for place in places])

    def _of(self, several: Sequence[Values], logs: Sequence[str] = ()) -> list[list[Window]]:
        logs = tuple(logs) or self._logs
        names = [(logs, tuple(values.items())) for values in several]
        new = {name: values for name, values in zip(names, several, strict=True) if name not in self._known}
        outage_s, truth = self._settings.outage_s, self._settings.truth
        jobs = [Job(log, self._config, values, outage_s, truth) for values in new.values() for log in logs]
        answers = iter(self._executor.map(score, jobs))
        for name in new:
            self._known[name] = [window for _ in logs for window in next(answers)]
        self._progress(min(1.0, len(self._known) / self._expected))
        return [self._known[name] for name in names]


def summary(windows: Sequence[Window]) -> Summary:
    """All windows together; each counts the same."""
    fixes, false, dof = (sum(n) for n in zip(*((w.n, w.false, w.dof) for w in windows), strict=True))
    true = max(fixes - false, 1)
    return Summary(
        windows=len(windows),
        fixes=fixes,
        score=math.fsum(w.score for w in windows) / len(windows),
        false=false,
        nis_per_dof=math.fsum(w.nis for w in windows) / max(dof, 1),
        position_rms_m=math.sqrt(math.fsum(w.p_sq_m2 for w in windows) / true),
        inside95=sum(w.covered for w in windows) / true,
    )


def warning(result: TuneResult) -> str:
    """Objections to the new values from held-out logs; empty for none."""
    gain = result.held_out_gain
    if gain is None or all(key.after == key.before for key in result.keys):
        return ""
    if gain.mean < 0.0:
        return "the held-out logs are worse for it: these logs are too few, or not like those"
    if not gain.is_sure:
        return "what the held-out logs gain may be chance: keep what you had, above all where it was the wider"
    return ""


def _gain(after: Sequence[Window], before: Sequence[Window]) -> Gain:
    """Paired by window: the fixes in one depend on each other."""
    difference = np.array([a.score - b.score for a, b in zip(after, before, strict=True)])
    spread = float(np.std(difference, ddof=1)) if len(difference) > 1 else math.inf
    return Gain(float(difference.mean()), spread / math.sqrt(len(difference)))
