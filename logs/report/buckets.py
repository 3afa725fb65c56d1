"""Extremes of signals in a bounded number of time spans."""

from typing import Final

import numpy as np

from logs.evaluation.metrics import Times
from models.messages import Array

_SPANS: Final = 1600  # even
_FIRST_NS: Final = 10_000_000


class Buckets:
    """k signals: low, high (n, k), nan: empty; span i starts at start_ns + i step_ns."""

    def __init__(self, signals: int, start_ns: int, spans: int = _SPANS) -> None:
        self.start_ns, self.step_ns = start_ns, _FIRST_NS
        self._low, self._high = np.full((spans, signals), np.inf), np.full((spans, signals), -np.inf)

    def add(self, t_ns: Times, values: Array) -> None:
        """values (n, k) at (n,) stamps; non-finite or earlier ones dropped."""
        known = t_ns >= self.start_ns
        order = np.argsort(t_ns[known], kind="stable")
        t_ns, values = t_ns[known][order], values[known][order]
        if not len(t_ns):
            return
        while (int(t_ns[-1]) - self.start_ns) // self.step_ns >= len(self._low):
            self._join()
        span = (t_ns - self.start_ns) // self.step_ns
        first = np.flatnonzero(np.diff(span, prepend=-1))
        finite = np.isfinite(values)
        low = np.minimum.reduceat(np.where(finite, values, np.inf), first, axis=0)
        high = np.maximum.reduceat(np.where(finite, values, -np.inf), first, axis=0)
        self._low[span[first]] = np.minimum(self._low[span[first]], low)
        self._high[span[first]] = np.maximum(self._high[span[first]], high)

    def _join(self) -> None:
        low, high = np.full_like(self._low, np.inf), np.full_like(self._high, -np.inf)
        half = len(low) // 2
        low[:half] = np.minimum(self._low[0::2], self._low[1::2])
        high[:half] = np.maximum(self._high[0::2], self._high[1::2])
        self._low, self._high, self.step_ns = low, high, 2 * self.step_ns

    @property
    def low(self) -> Array:
        """Least of each span, to the last filled."""
        return self._of_buckets(self._low)

    @property
    def high(self) -> Array:
        """Greatest of each span, to the last filled."""
        return self._of_buckets(self._high)

    def _of_buckets(self, extremes: Array) -> Array:
        some = np.flatnonzero(np.isfinite(self._low).any(axis=1))
        shown = extremes[: some[-1] + 1] if len(some) else extremes[:0]
        return np.where(np.isfinite(shown), shown, np.nan)
