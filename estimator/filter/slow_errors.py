"""Errors that repeat from fix to fix, behind the 15 states: blocks of first-order Gauss-Markov processes."""

from collections.abc import Sequence

import msgspec
import numpy as np

from models.messages import Array
from models.state import E


class SlowErrors(msgspec.Struct, frozen=True, eq=False):
    """columns: of each block in P, the last used last; tau_s, psd, mean: (k,);

    psd: variance per second, 2 sigma^2 / tau for a steady sigma; estimated: (k,) 1, considered: 0.
    """

    columns: dict[str, slice]
    tau_s: Array
    psd: Array
    mean: Array
    estimated: Array

    def also(self, block: str, psd: Array, tau_s: float, *, estimated: bool) -> "SlowErrors":
        """With one more block behind the others, of mean zero."""
        start, k = E.SIZE + len(self.tau_s), len(psd)
        return SlowErrors(
            self.columns | {block: slice(start, start + k)},
            np.concatenate((self.tau_s, np.full(k, tau_s))),
            np.concatenate((self.psd, psd)),
            np.concatenate((self.mean, np.zeros(k))),
            np.concatenate((self.estimated, np.full(k, float(estimated)))),
        )

    def joined(self, blocks: Sequence[str], other: "SlowErrors") -> "SlowErrors":
        """With these blocks of another appended."""
        columns, every = self.columns, [self.tau_s, self.psd, self.mean, self.estimated]
        for block in blocks:
            start, at = E.SIZE + len(every[0]), other.columns[block]
            own = slice(at.start - E.SIZE, at.stop - E.SIZE)
            columns = columns | {block: slice(start, start + at.stop - at.start)}
            theirs = (other.tau_s, other.psd, other.mean, other.estimated)
            every = [np.concatenate((mine, a[own])) for mine, a in zip(every, theirs, strict=True)]
        return SlowErrors(columns, *every)

    def without(self, block: str) -> "SlowErrors":
        """With one block less."""
        gone = self.columns[block]
        size = gone.stop - gone.start
        columns = {
            name: slice(c.start - size, c.stop - size) if c.start > gone.start else c
            for name, c in self.columns.items()
            if name != block
        }
        begin, end = gone.start - E.SIZE, gone.stop - E.SIZE
        every = (self.tau_s, self.psd, self.mean, self.estimated)
        return SlowErrors(columns, *(np.concatenate((values[:begin], values[end:])) for values in every))

    def as_state(self, block: str, psd: Array) -> "SlowErrors":
        """With a block estimated, a random walk of psd (k,)."""
        at = slice(self.columns[block].start - E.SIZE, self.columns[block].stop - E.SIZE)
        tau_s, driven, estimated = self.tau_s.copy(), self.psd.copy(), self.estimated.copy()
        tau_s[at], driven[at], estimated[at] = np.inf, psd, 1.0
        return SlowErrors(self.columns, tau_s, driven, self.mean, estimated)

    def used(self, blocks: Sequence[str]) -> "SlowErrors":
        """With these blocks as the last used."""
        columns = self.columns.copy()
        for block in blocks:
            if block in columns:
                columns[block] = columns.pop(block)
        return SlowErrors(columns, self.tau_s, self.psd, self.mean, self.estimated)

    def oldest(self, kind: str, most: int) -> str | None:
        """The least recently used block called kind/..., where there are `most` or more."""
        same = [name for name in self.columns if name.rpartition("/")[0] == kind] if kind else []
        return same[0] if len(same) >= most else None

    def of(self, block: str) -> Array:
        """The mean of a block."""
        at = self.columns[block]
        return self.mean[at.start - E.SIZE : at.stop - E.SIZE]

    def moved(self, by: Array) -> "SlowErrors":
        """With the estimated means moved by `by` (k,)."""
        return SlowErrors(self.columns, self.tau_s, self.psd, self.mean + self.estimated * by, self.estimated)


NO_SLOW_ERRORS = SlowErrors({}, *(np.zeros(0) for _ in range(4)))
