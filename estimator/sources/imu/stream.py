"""Recent samples of an IMU: constancy of each axis, block means."""

from collections import deque
from collections.abc import Sequence

import numpy as np

from models.messages import Array, ImuSample

BLOCK_NS = 200_000_000  # of the means that are compared: longer than a vibration, shorter than a manoeuvre
_BLOCKS = 100  # kept: 20 s
_KEPT_NS = 3_000_000_000  # of samples


class Stream:
    """Samples of one IMU by arrival; older ones are passed over."""

    def __init__(self) -> None:
        self.newest_ns = -(2**62)
        self.began_ns = 0
        self._samples: deque[ImuSample] = deque()
        self._last: tuple[float, ...] = ()
        self._same_since_ns = [0] * 6
        self._means: dict[int, Array] = {}
        self._variances: dict[int, Array] = {}  # of the means, as the samples scatter
        self._block, self._in_block = -1, list[tuple[float, ...]]()

    def add(self, sample: ImuSample) -> None:
        """Take the next sample."""
        if sample.t_ns <= self.newest_ns:
            return
        u = sample.gyro_b + sample.accel_b
        if not self._last:
            self.began_ns, self._last = sample.t_ns, u
            self._same_since_ns = [sample.t_ns] * 6
        of_axes = zip(self._same_since_ns, self._last, u, strict=True)
        self._same_since_ns = [since_ns if before == now else sample.t_ns for since_ns, before, now in of_axes]
        self._last, self.newest_ns = u, sample.t_ns
        self._samples.append(sample)
        while self._samples[0].t_ns < sample.t_ns - _KEPT_NS:
            self._samples.popleft()
        if (block := sample.t_ns // BLOCK_NS) != self._block:
            self._close()
            self._block = block
        self._in_block.append(u)

    def after(self, t_ns: int) -> list[ImuSample]:
        """Kept samples later than t_ns."""
        return [s for s in self._samples if s.t_ns > t_ns]

    def held(self, stuck_ns: int) -> Sequence[int]:
        """Which of six axes are constant for stuck_ns."""
        return [axis for axis, since_ns in enumerate(self._same_since_ns) if self.newest_ns - since_ns >= stuck_ns]

    def is_stuck(self, stuck_ns: int) -> bool:
        """Whether all axes have read the same for stuck_ns."""
        return self.newest_ns - max(self._same_since_ns) >= stuck_ns

    def held_since_ns(self, axes: Sequence[int]) -> int:
        """Since when the first of these axes reads the same."""
        return min(self._same_since_ns[axis] for axis in axes)

    def blocks(self, other: "Stream") -> tuple[list[int], Array]:
        """Common blocks, and the other's means less these, (k, 6)."""
        both = [b for b in self._means if b in other._means]
        if not both:
            return both, np.empty((0, 6))
        mine, theirs = (np.concatenate([stream._means[b] for b in both]).reshape(-1, 6) for stream in (self, other))
        return both, theirs - mine

    def mean(self, block: int) -> tuple[Array, Array]:
        """Mean over a block, and its variance from white scatter, (6,) each."""
        return self._means[block], self._variances[block]

    def _close(self) -> None:
        if self._in_block:
            u = np.array(self._in_block)
            self._means[self._block], self._variances[self._block] = u.mean(axis=0), u.var(axis=0) / len(u)
            self._in_block.clear()
        if len(self._means) > _BLOCKS:
            oldest = next(iter(self._means))
            del self._means[oldest], self._variances[oldest]
